"""Warnings of hollow results: a region off its DEM, cells that it does not resolve."""

import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from helpers.renders import write_dem
from lcp_cli.main import run

from lcp_catalog.dem.error_maps import warn_of_unknown
from lcp_catalog.dem.mosaic import DemSet
from lcp_catalog.geometry.bounds import Bounds
from lcp_catalog.terrain.area import Area
from lcp_catalog.terrain.useful_cell import warn_of_region

SAMPLE = Path(__file__).resolve().parents[2] / "sample_data" / "hadley_gld100_256ppd.tif"


@pytest.fixture(scope="module")
def sample() -> DemSet:
    """Longitudes 0 to 10, latitudes 20 to 30."""
    return DemSet.open([SAMPLE])


def said(caplog: pytest.LogCaptureFixture) -> list[str]:
    lines = [record.getMessage() for record in caplog.records]
    assert not any("\n" in line for line in lines)
    return lines


@pytest.mark.parametrize(("west", "off"), [(-0.3, "50"), (-0.1, "25"), (-0.01, ""), (1.0, "")])
def test_an_area_off_the_dem(sample, caplog, west, off) -> None:
    east = 0.3 if west < 0.0 else 1.3
    warn_of_region(sample, Area.from_bounds(*Bounds(west, 24.9, east, 25.1)), None)
    found = said(caplog)
    assert len(found) == bool(off)
    if off:
        share = float(found[0].split(" %")[0])
        assert share == pytest.approx(float(off), abs=3.0)
        assert "outside of the DEM files (hadley_gld100_256ppd.tif)" in found[0]


@pytest.mark.parametrize(("gsd_m", "warned"), [(120.0, True), (474.0, False), (None, False)])
def test_cells_finer_than_the_dem_resolves(sample, caplog, gsd_m, warned) -> None:
    warn_of_region(sample, Area.from_bounds(*Bounds(3.0, 25.0, 4.0, 26.0)), gsd_m)
    found = said(caplog)
    assert len(found) == warned
    if warned:
        assert "cells of 120 m are finer than the DEM resolves" in found[0]
        assert "cells of 473.8 m" in found[0]


def test_a_renamed_file_is_not_known(sample, caplog, tmp_path) -> None:
    warn_of_unknown(sample, [3.0], [25.0])
    assert not said(caplog)
    renamed = DemSet.open([shutil.copy(SAMPLE, tmp_path / "renamed.tif")])
    warn_of_unknown(renamed, [3.0], [25.0])
    (line,) = said(caplog)
    assert line.startswith("renamed.tif: not recognised as a product with a known error")
    assert all(
        name in line
        for name in (
            "1 sigma of 24.5 m",
            "2.45 %",
            "height_sigma_m",
            "`dem.sigma_map`",
            "`dem.resolution_map`",
        )
    )


@pytest.mark.slow
def test_a_catalogue_without_points_says_why(tmp_path, caplog) -> None:
    flat = write_dem(tmp_path / "flat.tif", np.ones((64, 64)), 30.0, 11.0)
    out = tmp_path / "c.h5"
    suns = ["--sun-azimuths", "100", "--sun-elevations", "45", "--view", "0:0"]
    assert run(["build-catalog", flat, "-o", str(out), "--jobs", "1", *suns]) == 0
    lines = [line for line in said(caplog) if "holds no point" in line]
    assert len(lines) == 1
    assert "c.h5: holds no point; cells by cause: " in lines[0]
    (cause,) = (line for line in said(caplog) if "featureless: the ground has too little" in line)
    assert re.search("no change helps|could be tried|may help", cause)


def test_azimuths_that_the_sun_never_has_are_named(tmp_path, capsys) -> None:
    """At 10.6 deg of latitude the Sun is never 45 deg high in the north-east."""
    hills = write_dem(tmp_path / "d.tif", np.ones((64, 64)), 30.0, 11.0)
    suns = ["--sun-azimuths", "45", "--sun-elevations", "45"]
    assert run(["build-catalog", hills, "-o", str(tmp_path / "c.h5"), *suns]) == 1
    assert "give other --sun-elevations or --sun-azimuths" in capsys.readouterr().err
