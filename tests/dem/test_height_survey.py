"""Missing pixels of a file: counted by plain numpy, their ground in closed form."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from helpers.bare_files import NORTH, R_KM, plane_rectangle, rectangle
from helpers.products import DEGREE_M, geotiff, holed

from lcp_catalog.dem.dem import Dem
from lcp_catalog.dem.grid import Grid
from lcp_catalog.dem.height_survey import pixel_km2, survey


def test_a_survey_counts_what_numpy_counts(tmp_path: Path) -> None:
    """1500 x 2600 pixels: blocks of three, the last ones cut; holes of any shape."""
    lost = np.random.default_rng(1).random((1500, 2600)) < 1e-3
    heights = np.where(
        lost, np.nan, np.random.default_rng(2).uniform(-5e3, 5e3, lost.shape)
    ).astype(np.float32)
    dem = Dem.open(geotiff(tmp_path / "a.tif", heights, 0.0, 15 * DEGREE_M, DEGREE_M / 100))
    found = survey(dem)
    assert found.block == 3
    assert found.missing.shape == (500, 867)
    padded = np.zeros((1500, 2601), bool)
    padded[:, :2600] = lost
    assert np.array_equal(found.missing, padded.reshape(500, 3, 867, 3).sum(axis=(1, 3)))
    assert (found.statistics.min_m, found.statistics.max_m) == (
        np.nanmin(heights),
        np.nanmax(heights),
    )
    assert found.statistics.nodata_share == lost.mean()


def test_holes_are_pieces_of_ground(tmp_path: Path) -> None:
    """A global file of one degree: a hole over its seam is one piece, the largest comes first."""
    holes = [np.s_[80:100, :10], np.s_[80:100, 350:], np.s_[10:20, 100:110]]
    found = survey(
        Dem.open(
            holed(tmp_path / "a.tif", (180, 360), holes, -180 * DEGREE_M, 90 * DEGREE_M, DEGREE_M)
        )
    )
    first, second = found.holes()
    assert tuple(first.bounds) == pytest.approx((170, -10, 190, 10))
    assert first.area_km2 == pytest.approx(
        rectangle(170, -10, 190, 10), rel=2e-5
    )  # pixels' centres
    assert tuple(second.bounds) == pytest.approx((-80 % 360, 70, -70 % 360, 80))
    assert second.area_km2 == pytest.approx(rectangle(0, 70, 10, 80), rel=2e-5)
    assert found.hole_km2() == pytest.approx(first.area_km2 + second.area_km2)
    lon, lat = [175.0, -175.0, 185.0, 165.0, -75.0, -75.0], [0.0, 0.0, 9.0, 0.0, 75.0, 65.0]
    assert found.absent(lon, lat).tolist() == [True, True, True, False, True, False]


def test_a_hole_over_the_pole(tmp_path: Path) -> None:
    crs = NORTH.format(lon=0)
    found = survey(
        Dem.open(
            holed(tmp_path / "a.tif", (100, 100), [np.s_[40:60, 40:60]], -5e4, 5e4, 1000.0, crs=crs)
        )
    )
    (hole,) = found.holes()
    assert (hole.bounds.west, hole.bounds.east, hole.bounds.north) == (0.0, 360.0, 90.0)
    assert hole.bounds.south == pytest.approx(
        90.0 - 2.0 * math.degrees(math.atan(math.hypot(10, 10) / 2 / R_KM))
    )
    assert hole.area_km2 == pytest.approx(plane_rectangle(-10, -10, 10, 10), rel=1e-6)


def test_a_hole_beside_the_pole(tmp_path: Path) -> None:
    """Columns 70..79, rows 45..54 of the north polar map: around longitude 90 E."""
    crs = NORTH.format(lon=0)
    found = survey(
        Dem.open(
            holed(tmp_path / "a.tif", (100, 100), [np.s_[45:55, 70:80]], -5e4, 5e4, 1000.0, crs=crs)
        )
    )
    (hole,) = found.holes()
    half = math.degrees(math.atan(5 / 20))
    assert (hole.bounds.west, hole.bounds.east) == pytest.approx((90.0 - half, 90.0 + half))
    assert not found.absent(
        [90.0, 90.0], [90.0 - math.degrees(v / R_KM) for v in (19.0, 31.0)]
    ).any()
    assert found.absent(90.0, 90.0 - math.degrees(25.0 / R_KM))


@pytest.mark.parametrize("true_lat", [0.0, 30.0, -55.0])
def test_pixels_of_a_cylinder_add_up_to_its_ground(true_lat: float) -> None:
    """True to scale away from the equator: a pixel's ground is not its square at the equator."""
    squeeze = math.cos(math.radians(true_lat))
    pixel_m = DEGREE_M / 10
    grid = Grid("equirectangular", 200, 300, pixel_m, 0.5 * pixel_m, 399.5 * pixel_m, 0.0, true_lat)
    total = pixel_km2(grid, 0.0, np.arange(300)).sum() * 200
    assert total == pytest.approx(rectangle(0.0, 10.0, 20.0 / squeeze, 40.0), rel=1e-5)


def test_pixels_of_a_polar_map_add_up_to_its_ground() -> None:
    grid = Grid("polar-stereographic", 400, 400, 1000.0, -199_500.0, 199_500.0, 0.0, -80.0)
    column, row = np.meshgrid(np.arange(400), np.arange(400))
    scale = (1.0 + math.sin(math.radians(80.0))) / 2.0  # the plane's kilometres are true at 80 S
    assert pixel_km2(grid, column, row).sum() == pytest.approx(
        plane_rectangle(*(v / scale for v in (-200, -200, 200, 200))), rel=1e-6
    )
