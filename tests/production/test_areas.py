"""The grid of areas: every place belongs to one area, areas keep their size, and nodes do not depend on the
region.
"""

from __future__ import annotations

import dataclasses
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lcp_catalog.geometry.frames import EnuFrame, central_angle_deg, lonlat_to_mcmf, mcmf_to_lonlat
from lcp_catalog.production.area_job import AreaJob, run_area
from lcp_catalog.production.areas import AreaGrid, plan_areas
from lcp_catalog.production.config import BuildConfig
from lcp_catalog.production.model_config import ModelConfig
from lcp_catalog.production.point_config import PointConfig
from lcp_catalog.production.run import Build
from lcp_catalog.terrain.area import Area

SAMPLE = Path(__file__).parents[2] / "sample_data"
GRID = AreaGrid.for_cell(118.0, ModelConfig())


@given(lon=st.floats(-180.0, 360.0), lat=st.floats(-90.0, 90.0))
def test_a_place_lies_in_its_owners_box(lon: float, lat: float) -> None:
    row, column = (int(v) for v in GRID.owner(np.array(lon), np.array(lat)))
    west, south, east, north = GRID.box(row, column)
    assert west - 1e-9 <= lon % 360.0 <= east + 1e-9
    assert south - 1e-9 <= lat <= north + 1e-9


@pytest.mark.parametrize("tolerance_deg", [0.1, 0.5, 2.0])
def test_corners_are_within_the_tolerance_of_the_centre(tolerance_deg: float) -> None:
    grid = AreaGrid.for_cell(1e6, ModelConfig(direction_tolerance_deg=tolerance_deg))
    for row in range(grid.rows):
        west, south, east, north = grid.box(row, 0)
        middle = (west + east) / 2.0, (south + north) / 2.0
        away = central_angle_deg(
            *middle, np.array([west, east, west, east]), np.array([south, south, north, north])
        )
        # a wedge that ends at the pole is no square: 1.2 is the most that any row needs
        assert away.max() <= 1.2 * tolerance_deg, (row, away)


def test_fine_cells_make_small_areas() -> None:
    model = ModelConfig(area_nodes_max=200)
    grid = AreaGrid.for_cell(10.0, model)
    tasks = plan_areas(grid, Area(30.0, 45.0, 5.0), 10.0)
    assert all(max(task.window.shape) <= 1.1 * model.area_nodes_max for task in tasks)


@settings(deadline=None, max_examples=60)
@given(
    lon=st.sampled_from([0.0, 3.5, 179.9, 180.0, -0.1, 359.99]),
    lat=st.sampled_from([0.0, 26.0, -75.0, 89.0, 90.0, -90.0]),
    size=st.floats(3.0, 80.0),
)
def test_every_place_of_the_region_lies_in_a_window(lon: float, lat: float, size: float) -> None:
    region = Area(lon, lat, size)
    tasks = {(task.row, task.column): task for task in plan_areas(GRID, region, 118.0)}
    x, y = np.meshgrid(*(np.linspace(-500.0, 500.0, 23) * size,) * 2)
    z = np.sqrt(1737.4e3**2 - x**2 - y**2) - 1737.4e3
    lons, lats, _ = mcmf_to_lonlat(region.frame.to_mcmf(np.stack([x, y, z], axis=-1)))
    rows, columns = GRID.owner(lons, lats)
    for row, column in set(zip(rows.flat, columns.flat, strict=True)):
        task, own = tasks[int(row), int(column)], (rows == row) & (columns == column)
        east, north, _ = (
            EnuFrame(task.lon_deg, task.lat_deg).from_mcmf(lonlat_to_mcmf(lons[own], lats[own])).T
        )
        assert task.window.row0 <= (-north / 118.0).min()
        assert (-north / 118.0).max() <= task.window.row1 - 1
        assert task.window.col0 <= (east / 118.0).min()
        assert (east / 118.0).max() <= task.window.col1 - 1


def test_frames_do_not_depend_on_the_region() -> None:
    small = {task.name: task.frame for task in plan_areas(GRID, Area(3.5, 26.0, 30.0), 118.0)}
    large = {task.name: task.frame for task in plan_areas(GRID, Area(3.7, 26.1, 90.0), 118.0)}
    assert small
    assert all(large[name] == frame for name, frame in small.items())


@pytest.mark.slow
@pytest.mark.parametrize(
    "bounds", [(-180.0, -60.0, 180.0, 60.0), (-180.0, 80.0, 180.0, 90.0), (-180.0, -90.0, 180.0, 90.0)]
)  # fmt: skip
def test_large_regions_are_planned_within_seconds(
    bounds: tuple[float, float, float, float],
) -> None:
    start = time.process_time()
    tasks = plan_areas(GRID, Area.from_bounds(*bounds), 118.0)
    assert time.process_time() - start < 15.0  # an area at a time took 40 s for the first
    south, north = bounds[1], bounds[3]
    rows = [r for r in range(GRID.rows) if GRID.latitudes(r)[1] > south and GRID.latitudes(r)[0] < north]  # fmt: skip
    assert [(t.row, t.column) for t in tasks] == [(r, c) for r in rows for c in range(GRID.columns(r))]  # fmt: skip


@pytest.mark.slow
def test_areas_wholly_inside_a_large_region_have_the_windows_that_they_have_alone() -> None:
    west, south, east, north = 0.0, 40.0, 60.0, 45.0
    inner = 0
    for task in plan_areas(GRID, Area.from_bounds(west, south, east, north), 118.0)[::7]:
        w, s, e, n = GRID.box(task.row, task.column)
        if west < w < e < east and south < s < n < north:
            inner += 1
            box = Area.from_bounds(w - 0.01, s - 0.01, e + 0.01, n + 0.01)
            alone = {t.name: t.window for t in plan_areas(GRID, box, 118.0)}
            assert alone[task.name] == task.window
    assert inner > 30


@settings(deadline=None, max_examples=40)
@given(
    lon=st.sampled_from([3.5, 180.0, -0.1]),
    lat=st.sampled_from([0.0, 26.0, -75.0, 89.0, 90.0, -90.0]),
    size=st.floats(3.0, 80.0),
)
def test_a_border_moves_no_pixel_of_coarser_images(lon: float, lat: float, size: float) -> None:
    """Images are halved from the first node of an area's window: a window that a border cuts begins a multiple of the
    coarsest scale after that of the whole area, and lies in it.
    """
    scales = PointConfig(patch_nodes=161).scales
    assert max(scales) == 16
    for task in plan_areas(GRID, Area(lon, lat, size), 118.0):
        middle = EnuFrame(task.lon_deg, task.lat_deg)
        west, south, east, north = GRID.box(task.row, task.column)
        lons, lats = np.meshgrid(np.linspace(west, east, 97), np.linspace(south, north, 97))
        x, y, _ = np.moveaxis(middle.from_mcmf(lonlat_to_mcmf(lons, lats)), -1, 0)
        row0, col0 = (int(np.floor(value.min() / 118.0 - 1.0)) for value in (-y, x))
        window = task.window
        for first, whole in ((window.row0, row0), (window.col0, col0)):
            assert first >= whole
            assert (first - whole) % max(scales) == 0
        assert window.row1 <= np.ceil(-y.min() / 118.0 + 1.0) + 1
        assert window.col1 <= np.ceil(x.max() / 118.0 + 1.0) + 1


def jobs_of_sample(size_km: float) -> dict[str, AreaJob]:
    """The jobs of a part of the sample with two Suns, by the names of their areas."""
    config = BuildConfig.from_toml(SAMPLE / "hadley.toml")
    config = dataclasses.replace(
        config,
        area=dataclasses.replace(config.area, size_km=size_km),
        sun=dataclasses.replace(
            config.sun, elevations_deg=(15.0, 30.0), azimuths_deg=(90.0, 270.0)
        ),
    )
    jobs = Build.plan([SAMPLE / "hadley_gld100_256ppd.tif"], config).jobs
    return {job.task.name: job for job in jobs}


def test_claims_do_not_depend_on_the_border_of_the_region() -> None:
    """Those of the same candidates of an area, of which a region has a part, and of the whole area, at all scales."""
    (name, cut), *_ = jobs_of_sample(10.0).items()
    whole = jobs_of_sample(80.0)[name]
    assert cut.nodes < 0.5 * whole.nodes
    one, other = (run_area(job).candidates for job in (cut, whole))
    apart = np.hypot(one.lon_deg[:, None] - other.lon_deg, one.lat_deg[:, None] - other.lat_deg)
    mine, theirs = np.nonzero(apart < 1e-9)
    assert len(mine) >= 3
    assert one.evaluation.detection.shape[1] == 3
    assert np.ptp(one.evaluation.detection[mine, 2], axis=None) > 0.1
    for field in ("detection", "sigma_major_m"):
        np.testing.assert_allclose(
            getattr(one.evaluation, field)[mine],
            getattr(other.evaluation, field)[theirs],
            rtol=1e-3,
        )
