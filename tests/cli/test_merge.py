"""``lcp merge``: its line, and what it refuses."""

from __future__ import annotations

from pathlib import Path

import pytest
from helpers import merges
from helpers.commands import refusal
from helpers.verified import verify
from lcp_cli.main import run

from lcp_catalog.catalog.writing import write_catalog


@pytest.mark.slow
def test_it_joins_catalogues(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    every = merges.whole(30)
    paths = [str(tmp_path / name) for name in ("a.h5", "b.h5")]
    for path, (west, east) in zip(paths, ((2.1, 3.7), (3.3, 4.9)), strict=True):
        write_catalog(merges.part(every, west, east), path)
    output = str(tmp_path / "m.h5")
    assert run(["merge", *paths, "-o", output]) == 0
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.startswith(f"{output}: ")
    assert "in 2 catalogues" in said.err
    assert "cells of 118 m" in said.err
    assert verify(output) == []
    assert "--overwrite" in refusal(["merge", *paths, "-o", output], 1, capsys)
    assert "same file" in refusal(["merge", *paths, "-o", paths[1], "--overwrite"], 2, capsys)
    other = str(tmp_path / "n.h5")
    assert "at least two" in refusal(["merge", paths[0], "-o", other], 2, capsys)
    assert "none.h5" in refusal(["merge", paths[0], "none.h5", "-o", f"{output}.h5"], 1, capsys)
