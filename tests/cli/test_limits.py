"""Values that would need more memory or time than a computer has: each is refused at once, in one line that
states the figure.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from helpers.commands import refusal
from lcp_cli.main import run

from lcp_catalog.memory import peak_mb

SAMPLE = Path(__file__).resolve().parents[2] / "sample_data"
DEM = str(SAMPLE / "hadley_gld100_256ppd.tif")
SUN = ["--sun-azimuth", "9", "--sun-elevation", "20"]
AREA = ["--center", "3.5", "26", "--size", "20"]
BUILD = ["build-catalog", DEM, *AREA, "-o", "o.h5", "--jobs", "1"]


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    camera = json.loads((SAMPLE / "AS15-M-0414_camera.json").read_text())
    Path("large.json").write_text(json.dumps(camera | {"image_size_px": [20000, 20000]}))
    Path("many.toml").write_text(
        f"[sun]\nazimuths_deg = {[i / 10 for i in range(3600)]}\n"
        f"elevations_deg = {[float(i) for i in range(1, 41)]}"
    )
    Path("cells.toml").write_text("[model]\narea_nodes_max = 100000000")


@pytest.mark.parametrize(
    ("line", "code", "says"),
    [
        ([*BUILD, "--gsd", "1e6"], 2, "0<x<=50000"),
        ([*BUILD, "--gsd", "1e-9"], 1, "the pixels of the DEM are 118450587594 times as large"),
        ([*BUILD, "--gsd", "0.01"], 1, "finer cells hold nothing more; leave it out"),
        (["render", DEM, *SUN, *AREA, "-o", "o.tif", "--gsd", "1e-9"], 1, "too many for one area (limit 4e+08)"),
        (["render", DEM, *SUN, "-o", "o.tif", "--gsd", "1e6"], 2, "0<x<=50000"),
        (["sun", "--lon", "3", "--lat", "26", "--dem", DEM, "--time", "2020-01-01", "--gsd", "1e6"], 2, "0<x<=50000"),
        ([*BUILD, "--sun-azimuths", "0:359:1e-7"], 2, "3590000001 numbers, at most 3600"),
        ([*BUILD, "--sun-elevations", "1e-300:80:1e-300"], 2, "numbers, at most 3600"),
        ([*BUILD, "--spacing", "1e-9", "--gsd", "500"], 2, "at least 4 cells, 2000 m"),
        ([*BUILD, "--spacing", "inf"], 2, "not in the range 0<x<=10000"),
        ([*BUILD, "--spacing", "1e9"], 2, "not in the range 0<x<=10000"),
        ([*BUILD, "--search", "9e3", "--gsd", "500"], 2, "at most 1000 cells, 500000 m"),
        ([*BUILD, "--search", "7.5", "--gsd", "500"], 2, "nothing else would be compared; at least half a patch, 8000 m"),
        ([*BUILD, "--jobs", "100000"], 2, "100000 is not in the range 1<=x<="),
        ([*BUILD, "--config", "many.toml"], 2, "5 views times 144000 Suns are 720000 conditions"),
        ([*BUILD, "--config", "cells.toml"], 2, "16..4096"),
        (["simulate", DEM, "--camera", "large.json", "-o", "f.png"], 1, "20000 x 20000: at most 100 million"),
        (["render", DEM, "--camera", "large.json", "-o", "o.tif"], 1, "20000 x 20000: at most 100 million"),
        (["sun", "--lon", "0", "--lat", "0", "--range", "2020-01-01", "2030-01-01", "1s"], 2, "315619201 instants"),
        (["render", "--surface", "sphere", *AREA[:4], "3000", "--gsd", "1", *SUN, "-o", "o.tif"], 1, "too many for one area"),
    ],
)  # fmt: skip
def test_values_without_bound_are_refused(
    line: list[str], code: int, says: str, capsys: Any
) -> None:
    before = peak_mb()
    assert says in refusal(line, code, capsys)
    assert peak_mb() < before + 300.0
    assert not [name for name in Path().iterdir() if name.suffix not in (".json", ".toml")]


def test_coarse_cells_of_a_fine_dem_read_only_the_dem() -> None:
    """Cells of 50 km: a tile of 64 x 64 means of 424 pixels a side would be 27 000 x 27 000 pixels."""
    before = peak_mb()
    line = ["render", DEM, *SUN, "-o", "o.tif", "--center", "3.5", "26", "--size", "100"]
    assert run([*line, "--gsd", "50000"]) == 0
    assert peak_mb() < before + 400.0
