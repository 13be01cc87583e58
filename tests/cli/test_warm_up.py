"""`lcp warm-up`, and what a command says before it compiles its kernels."""

from __future__ import annotations

from pathlib import Path

import pytest
from lcp_cli import warm_up as module
from lcp_cli.main import run

from lcp_catalog.kernels.entries import Entry
from lcp_catalog.production import warm_up

SMALL = Entry("vectors.multiple", "(int64, int64)", 0.1, ("build-catalog",))


@pytest.mark.slow
def test_warm_up_says_where_the_kernels_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "own"))
    monkeypatch.setattr(warm_up, "entries", lambda *_: [SMALL])
    assert run(["warm-up", "-o", str(tmp_path / "out")]) == 0
    (folder,) = (tmp_path / "out").iterdir()
    assert capsys.readouterr().err.endswith(
        f"{folder}: 1 kernels\n"
    )  # on a slow machine after progress
    assert [path.name for path in folder.iterdir()] == [SMALL.file_name]
    assert run(["warm-up", "--level", "x86-64-v9"]) == 2


@pytest.mark.slow
def test_a_command_says_that_it_compiles_and_only_then(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "own"))
    monkeypatch.setattr(warm_up, "entries", lambda *_: [SMALL])
    module.compile_missing("render")
    assert capsys.readouterr().err.startswith(
        "compiling kernels for this machine, the first time only: 1\n"
    )
    module.compile_missing("render")
    assert capsys.readouterr().err == ""
