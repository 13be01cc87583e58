"""``lcp diff``: exit codes, and what is printed."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import catalogs
from helpers.commands import refusal
from lcp_cli.main import run

from lcp_catalog.catalog.writing import write_catalog


@pytest.fixture(scope="module")
def paths(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """A catalogue of 14 points, and one of 12 of them with higher patches; no test changes them."""
    folder = tmp_path_factory.mktemp("diff")
    one = catalogs.catalog(14)
    middle = one.patch_nodes // 2
    other = one.take(np.arange(12))
    dem = other.dem + np.float32(2.5)
    dem[:, middle, middle] = 0.0
    names = [str(folder / "a.h5"), str(folder / "b.h5")]
    for name, catalog in zip(names, (one, replace(other, dem=dem)), strict=True):
        write_catalog(catalog, name)
    return names


@pytest.mark.slow
def test_text_is_short(paths: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["diff", *paths]) == 4
    out = capsys.readouterr().out
    for text in (
        f"{paths[0]}: 14 points; {paths[1]}: 12 points\n",
        "points: 12 matched, 0 came, 2 went, 0 moved, 12 changed\n",
        "dem: 12 points, at most 2.5 m",
        "changed most, 10 of 12:\n",
    ):
        assert text in out
    assert len(out.splitlines()) == 14


def test_equal_catalogues(paths: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["diff", paths[0], paths[0]]) == 0
    assert "no difference, 14 points" in capsys.readouterr().out
    assert run(["diff", paths[0], paths[0], "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["differs"] is False


def test_json_and_table_hold_everything(
    paths: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = tmp_path / "d.csv"
    assert run(["diff", *paths, "--json", "-o", str(table)]) == 4
    shown = capsys.readouterr()
    found = json.loads(shown.out)
    assert len(found["changed"]) == 12
    assert len(found["went"]) == 2
    assert len(table.read_text().splitlines()) == 15
    assert "written" in shown.err


def test_refusals(paths: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "same file" in refusal(["diff", *paths, "-o", paths[0]], 2, capsys)
    assert "none.h5" in refusal(["diff", paths[0], str(tmp_path / "none.h5")], 1, capsys)
    (tmp_path / "d.csv").write_text("mine")
    assert "--overwrite" in refusal(["diff", *paths, "-o", str(tmp_path / "d.csv")], 1, capsys)
    assert (tmp_path / "d.csv").read_text() == "mine"
    (tmp_path / "no.h5").write_bytes(b"no")
    assert "no.h5" in refusal(["diff", paths[0], str(tmp_path / "no.h5")], 1, capsys)
