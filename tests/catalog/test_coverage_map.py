"""The raster of the coverage: against a search over all cells, and placed by GDAL."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pyproj
import pytest
import rasterio
import xarray
from helpers import catalogs
from helpers.verified import verify

from lcp_catalog.catalog import maps
from lcp_catalog.catalog.layout import grid_mapping
from lcp_catalog.catalog.maps import coverage_map
from lcp_catalog.catalog.model import Coverage, CoverageMap
from lcp_catalog.catalog.verification import open_catalog
from lcp_catalog.catalog.writing import write_catalog
from lcp_catalog.constants import MOON_RADIUS_M
from lcp_catalog.geometry.map_plane import MapPlane
from lcp_catalog.production.region_maps import coverage_cells
from lcp_catalog.terrain.area import Area

REGIONS = [
    (Area(3.5, 26.0, 120.0), 8e3),
    (Area(200.0, -82.0, 400.0), 20e3),
    (Area.from_bounds(0.0, 20.0, 10.0, 30.0), 20e3),
    (Area.from_bounds(-180.0, -90.0, 180.0, 90.0), 300e3),
    (Area.from_bounds(-180.0, 60.0, 180.0, 90.0), 100e3),
]


def cells_of(region: Area, spacing_m: float) -> Coverage:
    """Cells with random status and conditions."""
    rng = np.random.default_rng(8)
    lon, lat, step_m = coverage_cells(region, spacing_m, 100_000)
    usable = rng.choice(np.array([0, 1, 255], np.uint8), (len(lon), 1, 2, 3))
    return Coverage(lon, lat, rng.integers(0, 6, len(lon)).astype(np.uint8), spacing_m, usable, step_m)  # fmt: skip


def plane_of(region: Area) -> MapPlane:
    if region.is_local:
        return MapPlane("orthographic", region.frame.lon_deg, region.frame.lat_deg)
    return MapPlane.showing(region.bounds)


def angles(lon: float, lat: float, cells: Coverage) -> np.ndarray:
    """Haversine distances of a place from all cells, radians."""
    a, b = np.radians(cells.latitude), math.radians(lat)
    half = np.sin((a - b) / 2) ** 2 + np.cos(a) * math.cos(b) * np.sin(np.radians(cells.longitude - lon) / 2) ** 2  # fmt: skip
    return 2.0 * np.arcsin(np.sqrt(half))


@pytest.mark.parametrize(("region", "spacing_m"), REGIONS)
def test_a_node_is_the_nearest_cell(region: Area, spacing_m: float) -> None:
    cells, plane = cells_of(region, spacing_m), plane_of(region)
    found = coverage_map(cells, plane)
    assert isinstance(found, CoverageMap)
    held = 0
    for row, y in enumerate(found.y_cell):
        for column, x in enumerate(found.x_cell):
            lon, lat = (float(v) for v in plane.lonlat(x, y))
            status, share = found.status[row, column], found.usable_share[row, column]
            away = angles(lon, lat, cells) if np.isfinite(lon) else np.full(1, np.inf)
            nearest = int(away.argmin())
            if away[nearest] * MOON_RADIUS_M > 0.75 * (cells.step_m or spacing_m):
                assert (status, np.isnan(share)) == (255, True)
                continue
            held += 1
            ties = np.flatnonzero(away < away[nearest] + 1e-9)
            assert status in cells.status[ties]
            shares = [
                (one[one != 255] == 1).mean() if (one != 255).any() else np.nan
                for one in cells.usable[ties]
            ]
            assert any(np.isclose(share, one, rtol=1e-6, equal_nan=True) for one in shares)
    assert held >= 0.95 * len(cells.longitude)


@pytest.mark.parametrize(("region", "spacing_m"), REGIONS[:3])
def test_cells_of_a_plane_are_its_nodes(region: Area, spacing_m: float) -> None:
    """Each cell is shown once: the map has the numbers of cells by status."""
    cells = cells_of(region, spacing_m)
    found = coverage_map(cells, plane_of(region))
    assert found is not None
    shown = np.bincount(found.status[found.status != 255], minlength=6)
    np.testing.assert_array_equal(shown, np.bincount(cells.status, minlength=6))


@pytest.mark.slow
def test_far_regions_have_a_map_of_bounded_size(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two sites on opposite sides of the Moon, with cells of 500 m; the map has a tenth of the nodes of others."""
    assert maps._MOST_NODES == 1_000_000
    monkeypatch.setattr(maps, "_MOST_NODES", 100_000)
    parts = [cells_of(Area(lon, 10.0, 20.0), 500.0) for lon in (0.0, 170.0)]
    lon, lat, status, usable = (
        np.concatenate([getattr(part, name) for part in parts])
        for name in ("longitude", "latitude", "status", "usable")
    )
    found = coverage_map(Coverage(lon, lat, status, 500.0, usable), MapPlane("equirectangular", 85.0, 10.0))  # fmt: skip
    assert found is not None
    assert 0.5e5 < found.status.size < 1.1e5
    assert (found.status != 255).sum() > 10


def test_a_coverage_without_cells_has_no_map(tmp_path: Path) -> None:
    none = np.zeros(0)
    empty = Coverage(none, none, none.astype(np.uint8), 4e3)
    assert coverage_map(empty, MapPlane("orthographic", 0.0, 0.0)) is None
    write_catalog(catalogs.catalog(3, coverage=empty), tmp_path / "c.h5")
    assert verify(tmp_path / "c.h5") == []
    assert open_catalog(tmp_path / "c.h5").coverage_map is None


def test_gdal_places_the_coverage(tmp_path: Path) -> None:
    """Sampled where PROJ puts the cells in the CRS that GDAL reads."""
    path = tmp_path / "c.h5"
    cells = cells_of(Area(*catalogs.CENTER, 90.0), 8e3)
    write_catalog(catalogs.catalog(12, coverage=replace(cells, usable=None)), path)
    assert verify(path) == []
    sphere = pyproj.CRS.from_dict({"proj": "longlat", "R": 1737400})
    with rasterio.open(f"netcdf:{path}:/coverage_map/status") as found:
        assert found.nodata == 255
        crs = pyproj.CRS.from_wkt(found.crs.to_wkt())
        there = pyproj.Transformer.from_crs(sphere, crs, always_xy=True)
        x, y = there.transform(cells.longitude, cells.latitude)
        sampled = [int(value[0]) for value in found.sample(zip(x, y, strict=True))]
    assert sampled == np.asarray(cells.status).tolist()
    assert len(set(sampled)) > 1
    with rasterio.open(f"netcdf:{path}:/coverage_map/usable_share") as found:
        assert np.isnan(found.nodata)
    with xarray.open_dataset(path, engine="h5netcdf", group="coverage_map") as read:
        assert read["status"].dims == ("y_cell", "x_cell")
        assert read["x_cell"].attrs["standard_name"] == "projection_x_coordinate"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "value", "problem"),
    [
        ("x_cell", -1e9, "coverage_map/x_cell: is not strictly rising"),
        ("y_cell", 1e9, "coverage_map/y_cell: is not strictly falling"),
        ("status", 17, "coverage_map/status: has no meaning"),
        ("usable_share", 1.5, "coverage_map/usable_share: not in 0..1"),
    ],
)
def test_wrong_values_are_problems_of_the_file(
    name: str, value: float, problem: str, tmp_path: Path
) -> None:
    path = tmp_path / "c.h5"
    write_catalog(catalogs.catalog(3), path)
    with h5py.File(path, "r+") as file:
        dataset = file[f"coverage_map/{name}"]
        dataset[(-1,) * dataset.ndim] = value
    assert any(line.startswith(problem) for line in verify(path))


def test_another_plane_is_a_problem_of_the_file(tmp_path: Path) -> None:
    path = tmp_path / "c.h5"
    write_catalog(catalogs.catalog(3), path)
    with h5py.File(path, "r+") as file:
        numbers = dict(file["coverage_map"].attrs) | {"center_lat": -20.0}
        file["coverage_map"].attrs.update(numbers)
        file["coverage_map/crs"].attrs.update(grid_mapping("coverage_map", numbers))
    assert "coverage_map: is in another plane than the overview" in verify(path)
