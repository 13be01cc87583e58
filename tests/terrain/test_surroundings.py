"""Terrain around an area against closed forms on the sphere and horizons on the area's cell size at
all distances.
"""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rasterio
from helpers.products import DEGREE_M, cylinder, geotiff
from helpers.synthetic import cratered
from hypothesis import given, settings
from hypothesis import strategies as st
from lcp_cli.main import run

from lcp_catalog.cameras.view import oblique_view
from lcp_catalog.constants import MOON_RADIUS_M
from lcp_catalog.dem.mosaic import DemSet
from lcp_catalog.geometry.frames import EnuFrame, direction_enu
from lcp_catalog.kernels.rays.bundles import scaled
from lcp_catalog.landmarks.error_model import ErrorModel
from lcp_catalog.production import area_job
from lcp_catalog.production.area_job import area_sweep
from lcp_catalog.production.config import AreaConfig, BuildConfig, SunConfig, ViewConfig
from lcp_catalog.production.evaluation import evaluate
from lcp_catalog.production.point_config import PointConfig
from lcp_catalog.production.run import Build
from lcp_catalog.rendering.plan import plan_scene
from lcp_catalog.terrain import surroundings as module
from lcp_catalog.terrain.area import NodeWindow
from lcp_catalog.terrain.far_terrain import Nodes
from lcp_catalog.terrain.surroundings import (
    CELL_SHARE,
    HORIZON_RMS_DEG,
    NEAR_NODES,
    SunRays,
    build_surrounded,
    ring_for_rays_m,
    surroundings,
)
from lcp_catalog.terrain.terrain import Ground

RIDGE_DEG, RIDGE_M, RIDGE_WIDTH_DEG = 5.3, 9000.0, 0.8


def ridge(lon: np.ndarray, lat: np.ndarray) -> np.ndarray:
    """A plain on the sphere with a range of mountains from pole to pole, 161 km east of longitude
    0.
    """
    return RIDGE_M * np.exp(
        -(((lon + 180.0) % 360.0 - 180.0 - RIDGE_DEG) ** 2) / RIDGE_WIDTH_DEG**2
    )


def horizon_deg(lon_deg: float) -> float:
    """Elevation of the range seen eastwards from the equator, in the frame of longitude 0.

    The great circle is the equator: a point at longitude a and radius r has east r sin a, up
    r cos a. The greatest elevation over all longitudes, by search.
    """
    a = np.radians(np.linspace(lon_deg + 0.02, lon_deg + 12.0, 200_001))
    r = MOON_RADIUS_M + ridge(np.degrees(a), 0.0)
    here, start = math.radians(lon_deg), MOON_RADIUS_M + float(ridge(np.array(lon_deg), 0.0))
    east, up = r * np.sin(a) - start * math.sin(here), r * np.cos(a) - start * math.cos(here)
    return float(np.degrees(np.arctan2(up, east).max()))


@pytest.fixture(scope="module")
def range_dem(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("range")
    return cylinder(folder / "range.tif", -6.0, 6.0, (192, 352), 16.0, ridge)


@pytest.mark.parametrize("east_km", [-1.5, 0.0, 1.5])
def test_a_range_160_km_away_has_its_elevation_on_the_sphere(range_dem, east_km) -> None:
    """On the tangent plane it would be 7.4 km higher: 2.6 degrees."""
    window = NodeWindow(-20, 21, -20, 21)
    ground = Ground(DemSet.open([range_dem]), EnuFrame(0.0, 0.0), window, 100.0)
    around = surroundings(ground, SunRays.all_around(math.tan(math.radians(0.5))))
    assert around.needed_m > 100e3
    terrain = build_surrounded(ground, around)
    row, col = terrain.core[0] + 20, terrain.core[2] + 20 + round(east_km * 10)
    nodes = Nodes(terrain.field, np.array([row]), np.array([col]), terrain.far)
    slope = nodes.horizons(np.array([[1.0, 0.0, -1e9, 1e9]]))[0, 0]
    want = horizon_deg(math.degrees(math.asin(east_km * 1e3 / MOON_RADIUS_M)))
    assert 0.3 < want < 1.0
    assert math.degrees(math.atan(slope / 100.0)) == pytest.approx(want, abs=0.002)


@pytest.mark.slow
@pytest.mark.parametrize("tier", ["draft", "standard", "reference"])
@pytest.mark.parametrize(("off_deg", "dark"), [(-0.02, True), (0.02, False)])
def test_the_render_sees_it(range_dem, tmp_path, tier, off_deg, dark) -> None:
    """The Sun just below and just above the range, from the area's lowest and highest skyline."""
    edges = [horizon_deg(math.degrees(x / MOON_RADIUS_M)) for x in (-1000.0, 1000.0)]
    elevation = (min(edges) if dark else max(edges)) + off_deg
    out = tmp_path / "range.tif"
    flags = ["--center", "0", "0", "--size", "2", "--gsd", "100", "--accuracy", tier]
    sun = ["--sun-azimuth", "90", "--sun-elevation", repr(elevation), "--sun", "point"]
    assert run(["render", str(range_dem), "-o", str(out), *flags, *sun]) == 0
    with rasterio.open(out) as dataset:
        assert (dataset.read(2) == (0.0 if dark else 1.0)).all()
        decisions = json.loads(dataset.tags()["scene_plan"])["decisions"]
    beyond = next(one for one in decisions if one["effect"] == "terrain beyond the area")
    assert beyond["error_bound"] >= HORIZON_RMS_DEG
    assert "has no height" in beyond["reason"]  # the DEM ends 340 km north and south


@settings(max_examples=200, deadline=None)
@given(
    angle=st.floats(1e-4, 0.9), low=st.floats(-9.2e3, 10.8e3), high=st.floats(-9.2e3, 10.8e3),
    elevation=st.floats(-1.0, 60.0), turn=st.floats(-0.02, 0.02),
)  # fmt: skip
def test_no_ground_of_the_moon_shadows_from_further_than_sight(
    angle, low, high, elevation, turn
) -> None:
    """Observer and terrain on one great circle; the frame's vertical is tilted from the observer's
    by up to the width of an area.
    """
    up = np.array([math.sin(turn), math.cos(turn)])
    east = np.array([math.cos(turn), -math.sin(turn)])
    observer = np.array([0.0, MOON_RADIUS_M + low])
    ground = (MOON_RADIUS_M + high) * np.array([math.sin(angle), math.cos(angle)])
    distance, rise = (ground - observer) @ east, (ground - observer) @ up
    tangent = math.tan(math.radians(elevation))
    if distance > 0 and rise > distance * tangent:
        assert distance <= module._sight_m(tangent, abs(turn))


@pytest.mark.parametrize("elevation_deg", [-0.5, 0.0, 1.0, 5.0, 20.0])
@pytest.mark.parametrize("turn_rad", [-0.02, 0.0, 0.02])
def test_sight_is_not_longer_than_it_must_be(elevation_deg, turn_rad) -> None:
    """The Moon's lowest and highest terrain, further and further apart on the sphere, until it
    casts no shadow.
    """
    angle = np.linspace(1e-3, 0.3, 100_000)
    low, high = MOON_RADIUS_M - 9.2e3, MOON_RADIUS_M + 10.8e3
    east, up = high * np.sin(angle), high * np.cos(angle) - low
    ahead = east * math.cos(turn_rad) - up * math.sin(turn_rad)
    rise = east * math.sin(turn_rad) + up * math.cos(turn_rad)
    farthest = ahead[rise > ahead * math.tan(math.radians(elevation_deg))].max(initial=0.0)
    sight = module._sight_m(math.tan(math.radians(elevation_deg)), abs(turn_rad))
    assert farthest <= sight
    if turn_rad >= 0.0:
        assert farthest >= 0.9 * sight


def test_the_plan_models_shadows_of_far_terrain(range_dem) -> None:
    """The Sun is above all slopes of the plain itself; terrain on far cells may still shadow it."""
    ground = Ground(
        DemSet.open([range_dem]), EnuFrame(0.0, 0.0), NodeWindow(-20, 21, -20, 21), 100.0
    )
    terrain = build_surrounded(
        ground, surroundings(ground, SunRays.all_around(math.tan(math.radians(0.5))))
    )
    for far, modelled in ((terrain.far, True), (None, False)):
        plan = plan_scene(
            replace(terrain, far=far), direction_enu(90.0, 5.0), oblique_view(0.0, 0.0)
        )
        assert plan.cast_shadows.modelled == modelled


def test_cells_grow_with_distance_and_levels_leave_no_gap(range_dem) -> None:
    window = NodeWindow(-30, 31, -10, 11)
    ground = Ground(DemSet.open([range_dem]), EnuFrame(0.0, 0.0), window, 100.0)
    terrain = build_surrounded(
        ground, surroundings(ground, SunRays.all_around(math.tan(math.radians(0.2))))
    )
    assert terrain.far is not None
    own = module.Extent.of(window, 100.0)
    inner = module.Extent.of_field(terrain.field)
    for level in terrain.far.levels:
        dx, dy = module._off(level, own)
        away = np.maximum(*np.broadcast_arrays(dx, dy))
        there = np.isfinite(level.z_m)
        assert level.gsd_m <= CELL_SHARE * (away[there].min() + level.gsd_m) * (1 + 1e-9)
        assert level.gsd_m <= (2.0 / NEAR_NODES) * (away[there].min() + 2 * level.gsd_m)
        x = level.x0_m + np.arange(level.shape[1]) * level.gsd_m
        y = level.y0_m - np.arange(level.shape[0]) * level.gsd_m
        outside = (
            (x[None, :] < inner.x0) | (x[None, :] > inner.x1)
            | (y[:, None] < inner.y0) | (y[:, None] > inner.y1)
        )  # fmt: skip
        known = (np.abs(y[:, None]) < 5.9 * DEGREE_M) & (np.abs(x[None, :]) < 5.9 * DEGREE_M)
        assert there[outside & known].all()  # every node outside the finer terrain
        ring = ~outside & ~np.isnan(level.z_m)
        assert ring.any()  # and a seam of cells in both
        inner = module.Extent.of_field(level)


def test_nothing_far_is_kept_that_cannot_matter(range_dem) -> None:
    window = NodeWindow(-20, 21, -20, 21)
    ground = Ground(DemSet.open([range_dem]), EnuFrame(-3.0, 0.0), window, 100.0)
    high = surroundings(ground, SunRays.all_around(math.tan(math.radians(40.0))))
    assert high.far is None
    assert high.ring_m < NEAR_NODES * 100.0
    straight = surroundings(ground, SunRays.all_around(math.inf))
    assert straight.far is None
    assert surroundings(ground, SunRays.all_around(math.tan(0.02)), limit_m=5e3).far is None
    assert surroundings(ground, SunRays.all_around(math.inf), least_ring_m=700.0).ring_m == 700.0
    assert ring_for_rays_m(ground, math.inf, 1e5) == 0.0
    assert ring_for_rays_m(ground, math.tan(0.02), 3e3) <= 3e3


def test_missing_ground_is_told(range_dem) -> None:
    """The DEM ends 6 degrees west; from 3 degrees east of that edge, 91 km are known."""
    ground = Ground(
        DemSet.open([range_dem]), EnuFrame(-3.0, 0.0), NodeWindow(-20, 21, -20, 21), 100.0
    )
    far = surroundings(ground, SunRays.all_around(math.tan(math.radians(0.2)))).far
    assert far is not None
    assert 0.05 < far.missing < 0.9
    assert far.gap_m == pytest.approx(3.0 * DEGREE_M - 2000.0, rel=0.03)


@pytest.mark.slow
@pytest.mark.parametrize("share", [16, 64])
def test_the_horizons_error(tmp_path, monkeypatch, share) -> None:
    """`HORIZON_RMS_DEG` where far cells form the horizon, against the area's cell size; coarser
    cells are worse.
    """
    monkeypatch.setattr(module, "NEAR_NODES", share)
    z = cratered(700, gsd_m=500.0, seed=8)
    dem = DemSet.open([geotiff(tmp_path / "c.tif", z, -175e3, 175e3, 500.0)])
    ground = Ground(dem, EnuFrame(0.0, 0.0), NodeWindow(-20, 21, -20, 21), 500.0)
    around = surroundings(ground, SunRays.all_around(0.0), limit_m=150e3)
    terrain = build_surrounded(ground, around)
    whole = ground.terrain(150e3)
    errors = []
    for azimuth in np.arange(24) * math.pi / 12 + 0.01:
        du, dv, _, _ = scaled(math.sin(azimuth), -math.cos(azimuth), 0.0)
        planes = np.array([[du, dv, -1e9, 1e9]])
        found = []
        for one, far in ((terrain, terrain.far), (whole, None), (terrain, None)):
            rows, cols = np.indices((41, 41)).reshape(2, -1)[:, ::17]
            nodes = Nodes(one.field, rows + one.core[0], cols + one.core[2], far)
            slope = nodes.horizons(planes)[:, 0] / (500.0 * math.hypot(du, dv))
            found.append(np.degrees(np.arctan(slope)))
        beyond = found[2] < found[1] - 1e-6
        errors.append((found[0] - found[1])[beyond])
    off = np.concatenate(errors)
    assert off.size > 50
    rms = float(np.sqrt(np.mean(off**2)))
    if share == 16:
        assert rms > HORIZON_RMS_DEG
    else:
        # twice the share of the distance that the product's cells have
        assert rms < 3.0 * HORIZON_RMS_DEG


def test_a_build_sees_it(range_dem) -> None:
    """A sweep's images, and the dependence of a patch on terrain outside it, under a Sun behind and
    above the range.
    """
    config = BuildConfig(
        area=AreaConfig(center_deg=(0.0, 0.0), size_km=2.0, gsd_m=100.0),
        sun=SunConfig(azimuths_deg=(90.0,), elevations_deg=(0.5, 3.0)),
        view=ViewConfig((0.0,), (0.0,), (math.inf,)),
        points=PointConfig(patch_nodes=9, search_m=400.0),
    )
    job = Build.plan((range_dem,), config).jobs[0]
    sweep = area_sweep(job)
    assert sweep.far is not None
    behind, above = (image.radiance for image in sweep.images())
    assert (behind == 0.0).all()
    assert (above > 0.0).all()
    middle = np.array([sweep.normals.shape[0] // 2])
    found = evaluate(sweep, middle, middle, config, ErrorModel())
    assert found.shadow_dependence[0, 0, :, 0].tolist() == [1.0, 0.0]


def test_rays_get_as_far_to_each_side_as_their_directions_say() -> None:
    """The farthest points to the north, south, west and east, among many turns of each direction, of
    rays that end on a square.
    """
    rng = np.random.default_rng(4)
    for spread_deg in (0.0, 3.0, 30.0):
        azimuths, reach = rng.uniform(0.0, 360.0, 3), rng.uniform(10.0, 300.0, 3)
        rays = SunRays.towards(direction_enu(azimuths, 5.0), math.radians(spread_deg))
        turned = azimuths[:, None] + np.linspace(-spread_deg, spread_deg, 20_001)
        east, north = np.sin(np.radians(turned)), np.cos(np.radians(turned))
        scale = reach[:, None] / np.maximum(np.abs(east), np.abs(north))
        x, y = east * scale, north * scale
        want = np.maximum([y.max(), -y.min(), -x.min(), x.max()], 0.0)
        np.testing.assert_allclose(rays.sides_m(reach, 0.0), want, atol=0.02)
        assert rays.lowest == pytest.approx(math.tan(math.radians(5.0)))


def test_shadows_are_those_of_terrain_all_around(tmp_path, monkeypatch) -> None:
    """Low Suns in the east and west, higher ones in the south; near and far terrain."""
    monkeypatch.setattr(module, "NEAR_NODES", 32)
    z = cratered(700, gsd_m=500.0, seed=8)
    config = BuildConfig(
        area=AreaConfig(center_deg=(0.0, 0.0), size_km=10.0, gsd_m=500.0),
        sun=SunConfig((75.0, 90.0, 180.0, 270.0), (2.0, 10.0, 80.0)),
        view=ViewConfig((0.0,), (0.0,), (math.inf,)),
        points=PointConfig(patch_nodes=9, search_m=4000.0),
    )
    dem = geotiff(tmp_path / "c.tif", z, -175e3, 175e3, 500.0)
    job = Build.plan((dem,), config).jobs[0]
    sweep = area_sweep(job)
    tangent = math.tan(math.radians(2.0))
    everywhere = SunRays.all_around(tangent)
    nowhere = SunRays(np.array([tangent]), np.zeros((1, 4)))
    whole, bare = (swept_with(monkeypatch, job, rays) for rays in (everywhere, nowhere))
    assert sweep.field.shape[0] < 0.8 * whole.field.shape[0]
    assert sweep.far is not None
    assert whole.far is not None
    assert sum(level.z_m.size for level in sweep.far.levels) < 0.5 * sum(
        level.z_m.size for level in whole.far.levels
    )
    missed = 0
    for azimuth, _ in sweep.suns:
        np.testing.assert_array_equal(sweep.dark(azimuth), whole.dark(azimuth))
        missed += int((whole.dark(azimuth) != bare.dark(azimuth)).sum())
    assert missed > 50


def swept_with(monkeypatch, job, rays: SunRays):
    """The sweep of an area with the terrain around it that some rays need."""
    with monkeypatch.context() as patch:
        patch.setattr(area_job, "_sun_rays", lambda *_: rays)
        return area_sweep(job)
