"""Builds of the whole Moon, on virtual files of coarse cells."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
import rasterio
import xarray
from helpers.pages import parsed
from helpers.verified import verify
from helpers.virtual_moon import virtual_moon

from lcp_catalog.catalog.layout import grid_mapping
from lcp_catalog.catalog.maps import overview_levels
from lcp_catalog.catalog.report import render_report
from lcp_catalog.catalog.schema import LEVEL_FACTORS
from lcp_catalog.catalog.summary import describe
from lcp_catalog.catalog.verification import open_catalog
from lcp_catalog.dem.mosaic import DemSet
from lcp_catalog.landmarks.selection import Places, Status, nearest
from lcp_catalog.production.config import AreaConfig, BuildConfig, SunConfig, ViewConfig
from lcp_catalog.production.estimate import estimate
from lcp_catalog.production.model_config import ModelConfig
from lcp_catalog.production.run import Build, BuildRun

pytestmark = pytest.mark.slow

NADIR = ViewConfig((0.0,), (0.0,), (float("inf"),))
COARSE = BuildConfig(
    area=AreaConfig(bounds_deg=(-180.0, -90.0, 180.0, 90.0)),
    sun=SunConfig((88.0, 90.0), (18.0, 20.0)),
    view=NADIR,
    model=ModelConfig(direction_tolerance_deg=10.0),
)
"""Areas of 14 degrees; at those azimuths the Sun is low near the equator only."""


@pytest.fixture(scope="module")
def moon(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    return virtual_moon(tmp_path_factory.mktemp("moon"), 4, tile_px=256)


def test_the_estimate_is_taken_from_areas_that_the_sun_reaches(moon: list[Path]) -> None:
    build = Build.plan(moon, COARSE)
    lit = [job for job in build.jobs if job.work]
    assert 0 < len(lit) < len(build.jobs) / 2
    belt = (-180.0, -6.0, 180.0, 6.0)
    alone = Build.plan(moon, replace(COARSE, area=AreaConfig(bounds_deg=belt)))
    whole, part = estimate(build, 1), estimate(alone, 1)
    assert whole["bytes_estimate"] > 0.3 * part["bytes_estimate"]
    assert whole["seconds_estimate"] < 30.0 * part["seconds_estimate"]


@pytest.fixture(scope="module")
def polar(moon: list[Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A catalogue of everything north of 66 degrees."""
    output = tmp_path_factory.mktemp("polar") / "cap.h5"
    cap = AreaConfig(bounds_deg=(-180.0, 66.0, 180.0, 90.0))
    low = SunConfig((90.0, 270.0), (10.0, 30.0))
    BuildRun(Build.plan(moon, replace(COARSE, area=cap, sun=low)), output).whole()
    return output


def test_a_default_build_at_a_pole_has_the_suns_that_come_there(moon: list[Path]) -> None:
    site = AreaConfig(center_deg=(0.0, -89.9), size_km=200.0)
    build = Build.plan(moon, replace(COARSE, area=site, sun=SunConfig()))
    assert build.recipe.config.sun.elevations_deg[0] == 0.5
    document = estimate(build, 1)
    assert document["suns"] >= 48
    (suns,) = (d["reason"] for d in document["decisions"] if d["effect"] == "Suns")
    assert "24 azimuths at 0.5, 1, 1.5, 2, 3, 4, 5" in suns
    assert "the default for regions up to latitude -90.0 deg" in suns
    given = Build.plan(moon, replace(COARSE, area=site, sun=SunConfig((90.0,), (1.0,))))
    (suns,) = (d["reason"] for d in estimate(given, 1)["decisions"] if d["effect"] == "Suns")
    assert suns == "1 azimuth at 1 deg: as configured"


def test_a_catalogue_of_a_polar_cap_has_a_polar_map_and_cells_all_around(
    polar: Path, moon: list[Path]
) -> None:
    assert verify(polar) == []
    found = open_catalog(polar)
    assert found.overview.projection == "polar stereographic"
    lon, lat = found.overview.plane.lonlat(*np.meshgrid(found.overview.x, found.overview.y))
    assert (np.isfinite(found.overview.height) == (lat >= 66.0)).mean() > 0.999
    shown = np.isfinite(found.overview.height)
    at, _ = DemSet.open(moon).heights(lon, lat, 8e3)
    assert np.corrcoef(at[shown], found.overview.height[shown])[0, 1] > 0.99
    cells = found.coverage
    assert cells.step_m == cells.spacing_m
    assert np.histogram(cells.longitude, 4, (0.0, 360.0))[0].min() > 0.2 * len(cells.longitude)
    near = nearest(
        Places(cells.longitude, cells.latitude), Places(found.longitude, found.latitude)
    )[1]
    assert (cells.status[near <= cells.spacing_m] == Status.POINT).all()
    with xarray.open_dataset(polar, engine="h5netcdf", group="overview") as raster:
        assert raster.attrs["projection"] == "polar stereographic"
        assert raster.x.attrs["long_name"] == "east of the centre, polar stereographic"


def test_a_catalogue_of_a_polar_cap_has_levels_of_its_maps(polar: Path) -> None:
    found = open_catalog(polar)
    levels, cells = found.overview_levels, found.coverage_levels
    assert cells is not None
    expected = overview_levels(found.overview)
    for factor, one, other in zip(LEVEL_FACTORS, levels, expected, strict=True):
        np.testing.assert_array_equal(one.height, other.height)
        assert one.plane == found.overview.plane
        of_level = np.asarray(cells.factor) == factor
        assert cells.cells[of_level].sum() == len(found.coverage.longitude)
    with rasterio.open(f"netcdf:{polar}:/overview_2/height") as raster:
        np.testing.assert_array_equal(raster.read(1), levels[0].height)
    assert describe(polar)["map_levels"] == [1, 2, 4, 8]


@pytest.mark.parametrize(
    ("name", "value", "problem"),
    [
        ("overview_4/x", -1e9, "overview_4/x: is not strictly rising"),
        ("overview_8/height", np.inf, "overview_8/height: infinite"),
        ("coverage_levels/factor", 3, "coverage_levels/factor: is no level"),
        ("coverage_levels/cells", -1, "coverage_levels/cells: below 0"),
        ("coverage_levels/usable_share", 1.5, "coverage_levels/usable_share: not in 0..1"),
        ("coverage_levels/block", 7, "coverage_levels/block: is not 0, 1, 2, ..."),
    ],
)
def test_levels_that_are_wrong_are_problems_of_the_file(
    name: str, value: float, problem: str, polar: Path, tmp_path: Path
) -> None:
    forged = tmp_path / "forged.h5"
    forged.write_bytes(polar.read_bytes())
    with h5py.File(forged, "r+") as file:
        file[name][(-1,) * file[name].ndim] = value
    assert any(line.startswith(problem) for line in verify(forged))


def test_levels_in_another_plane_are_a_problem_of_the_file(polar: Path, tmp_path: Path) -> None:
    forged = tmp_path / "forged.h5"
    forged.write_bytes(polar.read_bytes())
    with h5py.File(forged, "r+") as file:
        numbers = dict(file["overview_2"].attrs) | {"center_lat": -90.0}
        file["overview_2"].attrs.update(numbers)
        file["overview_2/crs"].attrs.update(grid_mapping("overview_2", numbers))
    assert "overview_2: is in another plane than the overview" in verify(forged)


def test_the_report_of_a_polar_cap_shows_its_map(polar: Path) -> None:
    text = render_report(open_catalog(polar), polar.name)
    parsed(text)
    assert "polar stereographic projection" in text
    assert "nan" not in text.split("</figure>")[0]


def test_a_plane_that_does_not_exist_is_a_problem_of_the_file(polar: Path, tmp_path: Path) -> None:
    forged = tmp_path / "forged.h5"
    forged.write_bytes(polar.read_bytes())
    with h5py.File(forged, "r+") as file:
        file["overview"].attrs["center_lat"] = 80.0
    assert any("overview: a polar map has its centre at a pole" in line for line in verify(forged))
    with h5py.File(forged, "r+") as file:
        file["overview"].attrs["projection"] = 3.0
    assert any("the attribute projection is not a text" in line for line in verify(forged))
