"""Heights of single pixels, against reading each alone; and how much is read for a map of the Moon."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.virtual_moon import virtual_moon

from lcp_catalog.dem.dem import Dem
from lcp_catalog.dem.mosaic import DemSet, nearest_heights
from lcp_catalog.dem.raster import Raster
from lcp_catalog.production.region_maps import region_overview
from lcp_catalog.terrain.area import Area


@pytest.fixture(scope="module")
def moon(tmp_path_factory: pytest.TempPathFactory) -> DemSet:
    return DemSet.open(virtual_moon(tmp_path_factory.mktemp("moon"), 16, tile_px=256))


def test_the_height_of_a_place_is_that_of_its_nearest_pixel(moon: DemSet) -> None:
    rng = np.random.default_rng(5)
    lon, lat = rng.uniform(-180.0, 360.0, 400), rng.uniform(-90.0, 90.0, 400)
    found, files = nearest_heights(moon, lon, lat), moon.product_at(lon, lat)
    assert set(files.tolist()) == {0, 1, 2}
    for height, x, y, file in zip(found, lon, lat, files, strict=True):
        column, row = (round(float(v)) for v in moon.dems[file].grid.pixel(x, y))
        assert height == moon.dems[file].read(row, row + 1, column, column + 1)[0, 0]


def test_a_place_without_a_pixel_is_taken_from_the_next_file_or_has_none(
    moon: DemSet, monkeypatch: pytest.MonkeyPatch
) -> None:
    belt, read = moon.dems[0], Dem.read
    gaps = {belt: True}

    def without(dem: Dem, *window: int) -> np.ndarray:
        return read(dem, *window) * (np.nan if dem in gaps else 1.0)

    monkeypatch.setattr(Dem, "read", without)
    lon, lat = np.array([10.0, 10.0]), np.array([55.0, 0.0])  # only the first is in a polar file
    north = moon.dems[1]
    column, row = (round(float(v)) for v in north.grid.pixel(10.0, 55.0))
    expected = read(north, row, row + 1, column, column + 1)[0, 0]
    np.testing.assert_array_equal(nearest_heights(moon, lon, lat), [expected, np.nan])


@pytest.mark.slow
def test_a_map_of_the_whole_moon_reads_no_pixel_twice(
    moon: DemSet, monkeypatch: pytest.MonkeyPatch
) -> None:
    read, pixels = Raster.read, dict.fromkeys((dem.path for dem in moon.dems), 0)

    def counted(raster: Raster, row0: int, row1: int, col0: int, col1: int) -> np.ndarray:
        pixels[raster.path] += (row1 - row0) * (col1 - col0)
        return read(raster, row0, row1, col0, col1)

    monkeypatch.setattr(Raster, "read", counted)
    view = region_overview(moon, Area.from_bounds(-180.0, -90.0, 180.0, 90.0), 5e3)
    assert np.isfinite(view.height).all()
    for dem in moon.dems:
        assert 0 < pixels[dem.path] <= dem.grid.width * dem.grid.height
