"""Renders at extremes: at the poles, on the meridians 0, 180 and 360, cells of 0.5 m and 10 km, the Sun at
the zenith, on and below the horizon, the camera on the surface and far away.

The terrain has a constant height, so all results have closed forms.
"""

from __future__ import annotations

import itertools
import math
from pathlib import Path

import mpmath
import numpy as np
import pytest
from helpers.products import EQC, cylinder, geotiff

from lcp_catalog.accuracy import TIERS
from lcp_catalog.cameras.view import CameraView, looking_camera, oblique_view
from lcp_catalog.dem.mosaic import DemSet
from lcp_catalog.errors import CameraError, SunError
from lcp_catalog.geometry.frames import EnuFrame, direction_enu
from lcp_catalog.rendering.renderer import Method, render_camera, render_enu
from lcp_catalog.terrain.area import Area, NodeWindow
from lcp_catalog.terrain.heightfield import Heightfield
from lcp_catalog.terrain.terrain import Terrain, build_terrain, terrain_from_area
from lcp_catalog.threads import limit_threads, thread_limit

R = 1_737_400.0
HEIGHTS = [0.0, 10_750.0, -9_100.0]
"""The sphere, and about the greatest and the least height on the Moon."""

PLACES = {
    "0": (0.0, 0.0),
    "180": (180.0, 0.0),
    "-180": (-180.0, 12.0),
    "360": (360.0, -12.0),
    "north pole": (0.0, 90.0),
    "north pole, along 77": (77.0, 90.0),
    "south pole": (180.0, -90.0),
    "by the pole, on 180": (180.0, 89.99),
    "by the pole, on 0": (0.0, -89.9),
}


@pytest.fixture(autouse=True, scope="module")
def one_thread():
    """One thread for hundreds of small images."""
    with limit_threads(1):
        yield


@pytest.fixture(scope="module")
def moons(tmp_path_factory: pytest.TempPathFactory) -> dict[float, DemSet]:
    """Whole Moons of constant height, 2 pixels a degree."""
    folder = tmp_path_factory.mktemp("moons")
    return {
        height: DemSet.open(
            [
                cylinder(
                    folder / f"{k}.tif",
                    0.0,
                    90.0,
                    (360, 720),
                    2.0,
                    lambda lon, lat, h=height: h + 0.0 * lon,
                )
            ]
        )
        for k, height in enumerate(HEIGHTS)
    }


def closed_form(terrain: Terrain, height: float) -> tuple[np.ndarray, np.ndarray]:
    """ENU z of a ball's surface over the nodes, and the ball's normals."""
    field = terrain.field
    rows, cols = field.shape
    x = field.x0_m + np.arange(cols) * field.gsd_m
    y = field.y0_m - np.arange(rows)[:, None] * field.gsd_m
    up = np.sqrt((R + height) ** 2 - x * x - y * y)
    normals = np.stack([*np.broadcast_arrays(x, y, up)], axis=-1) / (R + height)
    return up - R, normals


@pytest.mark.slow
@pytest.mark.parametrize(("size_km", "gsd_m"), [(0.02, 0.5), (0.3, 118.45), (2000.0, 10_000.0)])
def test_heights_are_the_balls(moons, size_km, gsd_m):
    for place, height in itertools.product(PLACES, HEIGHTS):
        terrain = terrain_from_area(moons[height], Area(*PLACES[place], size_km), gsd_m)
        want, _ = closed_form(terrain, height)
        z = terrain.field.z_m
        assert np.isfinite(z).all()
        # half a step of float32, and what the solution may be off: 1 mm of height, times 1/cos
        slack = np.abs(want) * 2.0**-24 + 1e-3 * (R + height) / (want + R)
        assert (np.abs(z - want) <= slack).all()
        if size_km > 1000:
            with mpmath.workdps(40):
                edge = mpmath.mpf(10) ** 6
                corner = mpmath.sqrt((mpmath.mpf(R) + mpmath.mpf(height)) ** 2 - 2 * edge**2) - R
            assert z[0, 0] == pytest.approx(float(corner), abs=0.04)
            assert z[0, 0] == z[-1, -1] == z[0, -1] == z[-1, 0]  # to the bit


@pytest.mark.parametrize("place", ["north pole", "180"])
def test_the_limb_is_where_the_ground_ends(moons, place):
    """Beyond the sphere's limb: heights up to 80 degrees from the centre, nodata behind."""
    window = NodeWindow(-180, 181, -180, 181)
    terrain = build_terrain(moons[0.0], Area(*PLACES[place], 1.0).frame, window, 10_000.0)
    with np.errstate(invalid="ignore"):
        want, _ = closed_form(terrain, 0.0)
    away = np.hypot(*np.mgrid[-180:181, -180:181]) * 10_000.0
    known = np.isfinite(terrain.field.z_m)
    assert known[away < 0.984 * R].all()
    assert not known[away > 0.986 * R].any()
    np.testing.assert_allclose(terrain.field.z_m[known], want[known], atol=0.07)


SUNS = [(90.0, 89.9), (0.0, 90.0), (270.0, 0.1), (45.0, 30.0), (10.0, 0.0), (180.0, 1e-6)]


@pytest.mark.slow
@pytest.mark.parametrize("tier", TIERS)
def test_a_balls_light_is_known(moons, tier):
    """Incidence, emission and phase of every node; nodes with the Sun above their horizon are lit."""
    for place, (size_km, gsd_m) in itertools.product(PLACES, [(0.02, 0.5), (2000.0, 50_000.0)]):
        terrain = terrain_from_area(moons[0.0], Area(*PLACES[place], size_km), gsd_m, ring_m=gsd_m)
        row0, row1, col0, col1 = terrain.core
        normals = closed_form(terrain, 0.0)[1][row0:row1, col0:col1]
        # central differences over two cells: gsd^2 / 6 of the third derivative, 3 x / (R^3 cos^5) at most
        steep = float(normals[..., 2].min())
        bend = math.degrees(gsd_m**2 / 6 * 3 * 0.82 / (R**2 * steep**5)) + 2e-4
        for angles in SUNS:
            sun = direction_enu(*angles)
            result = render_enu(terrain, sun, oblique_view(0.0, 0.0), Method(accuracy=TIERS[tier]))
            incidence = np.degrees(np.arccos(np.clip(normals @ sun, -1, 1)))
            emission = np.degrees(np.arccos(normals[..., 2]))
            close = 2e-4 if bend < 1e-3 else bend
            np.testing.assert_allclose(
                result.emission_deg, emission, atol=0.02 if close < 1e-3 else bend
            )
            np.testing.assert_allclose(
                result.incidence_deg, incidence, atol=0.02 if close < 1e-3 else bend
            )
            np.testing.assert_allclose(result.phase_deg, 90.0 - angles[1], atol=1e-5)
            fold = 2 * bend + math.degrees(gsd_m / R)  # of one facet against the next
            lit = np.asarray(result.sunlit) > 0
            assert lit[incidence < 90 - fold].all()
            assert not lit[incidence > 90 + fold].any()
            assert result.visible.all()
            assert np.isfinite(result.radiance).all()
            assert (np.asarray(result.radiance)[~lit] == 0).all()


@pytest.mark.parametrize("place", ["-180", "360", "by the pole, on 180"])
def test_the_sun_overhead_is_no_cause_for_a_warning(moons, place):
    terrain = terrain_from_area(moons[0.0], Area(*PLACES[place], 0.02), 0.5)
    render_enu(terrain, direction_enu(0.0, 90.0), oblique_view(0.0, 0.0))


@pytest.mark.parametrize("tier", TIERS)
def test_a_ball_from_north_and_south_is_the_same_ball(moons, tier):
    """Half a turn about the zenith takes a Sun azimuth of 60 deg to 240 deg and turns the image."""
    terrain = terrain_from_area(moons[0.0], Area(0.0, 90.0, 400.0), 8192.0)
    here = render_enu(
        terrain, direction_enu(60.0, 3.0), oblique_view(0.0, 0.0), Method(accuracy=TIERS[tier])
    )
    there = render_enu(
        terrain, direction_enu(240.0, 3.0), oblique_view(0.0, 0.0), Method(accuracy=TIERS[tier])
    )
    np.testing.assert_array_equal(terrain.field.z_m, terrain.field.z_m[::-1, ::-1])
    np.testing.assert_array_equal(here.sunlit, there.sunlit[::-1, ::-1])
    np.testing.assert_allclose(here.radiance, there.radiance[::-1, ::-1], rtol=1e-4, atol=1e-7)


@pytest.mark.parametrize("tier", TIERS)
def test_the_sun_under_the_horizon(moons, tier):
    terrain = terrain_from_area(moons[0.0], Area(0.0, 90.0, 100.0), 5000.0)
    level = math.degrees(math.atan(50e3 * math.sqrt(2) / R))  # the area's own corners lean so far
    for below in (level + 0.01, 5.0, 30.0, 89.9, 90.0):
        with pytest.raises(SunError, match=r"below the horizon .* state another Sun"):
            render_enu(
                terrain,
                direction_enu(45.0, -below),
                oblique_view(0.0, 0.0),
                Method(accuracy=TIERS[tier]),
            )
    edge = render_enu(
        terrain,
        direction_enu(45.0, -0.5 * level),
        oblique_view(0.0, 0.0),
        Method(accuracy=TIERS[tier]),
    )
    assert np.asarray(edge.sunlit)[1, -2] > 0  # what leans towards the Sun
    assert not np.asarray(edge.sunlit)[10:, :10].any()


def made(z, gsd_m=2.0) -> Terrain:
    z = np.asarray(z, dtype=np.float32)
    rows, cols = z.shape
    field = Heightfield(z, gsd_m, -(cols // 2) * gsd_m, (rows // 2) * gsd_m)
    window = NodeWindow(-(rows // 2), rows - rows // 2, -(cols // 2), cols - cols // 2)
    return Terrain(
        field,
        EnuFrame(12.0, 34.0),
        (0, rows, 0, cols),
        window,
        np.zeros(z.shape, np.int16),
        ("made",),
    )


def shapes() -> dict[str, np.ndarray]:
    """Extreme terrains."""
    rough = np.random.default_rng(8).normal(size=(17, 13)) * 3
    holed, endless = rough.copy(), rough.copy()
    holed[4:7, 3:9] = holed[:, 11] = holed[0, 0] = np.nan
    endless[5, 5], endless[9, 3] = np.inf, -np.inf
    islands = np.full((17, 13), np.nan)
    islands[2, 2], islands[5:7, 5:7], islands[10, 3:9], islands[12:, 10] = 1, 2, 3, 4
    return {
        "level": np.zeros((17, 13)),
        "rough": rough,
        "20 km cliffs": np.where(rough > 0, 20e3, -20e3),
        "spike": np.where(np.arange(221).reshape(17, 13) == 110, 20e3, 0.0),
        "pit": np.where(np.arange(221).reshape(17, 13) == 110, -20e3, 0.0),
        "holes": holed,
        "infinite": endless,
        "islands": islands,
        "1 x 1": np.zeros((1, 1)),
        "1 x 9": rough[:1, :9],
        "9 x 1": rough[:9, :1],
        "2 x 2": rough[:2, :2],
    }


SHAPES = shapes()
VIEWS = {
    "down": oblique_view(0.0, 0.0),
    "level": oblique_view(89.999, 40.0),
    "1 m up": 1.0,
    "on a node": 0.0,
    "a million km up": oblique_view(0.0, 0.0, 1e9),
    "a million km aside": oblique_view(80.0, 200.0, 1e9),
}


@pytest.mark.slow
@pytest.mark.parametrize("tier", TIERS)
def test_nothing_is_silently_nan(tier):
    """At nodes with a normal every angle is finite; at visible nodes the radiance is finite, 0 in shadow; nodes
    without a height are neither lit nor visible.
    """
    for name in SHAPES:
        terrain = made(SHAPES[name])
        z, normals = terrain.field.z_m, terrain.field.normals()
        ground, shaped = np.isfinite(z), np.isfinite(normals[..., 0])
        for angles in SUNS[1::2]:
            for how, view in VIEWS.items():
                place = view
                if isinstance(view, float):
                    middle = z[z.shape[0] // 2, z.shape[1] // 2]
                    place = CameraView(np.array([0.0, 0.0, np.nan_to_num(middle) + view]))
                result = render_enu(
                    terrain, direction_enu(*angles), place, Method(accuracy=TIERS[tier])
                )
                seen, lit = np.asarray(result.visible), np.asarray(result.sunlit) > 0
                assert not (seen | lit)[~ground].any(), how
                assert not (seen | lit)[~shaped].any(), how
                for band in (result.incidence_deg, result.emission_deg, result.phase_deg):
                    assert (np.isfinite(band) == shaped).all(), how
                assert (np.isfinite(result.radiance) == seen).all(), how
                assert (np.asarray(result.radiance)[seen & ~lit] == 0).all(), how
                assert not (np.asarray(result.radiance)[seen] < 0).any(), how


@pytest.mark.parametrize(
    "tier", [pytest.param(t, marks=pytest.mark.slow) if t == "reference" else t for t in TIERS]
)
def test_a_suns_disc_has_shares(tier):
    """Shares are between 0 and 1, 0 at nodes without a height, and one half on level terrain with the disc's
    centre on the horizon.
    """
    for name in SHAPES:
        terrain = made(SHAPES[name])
        ground = np.isfinite(terrain.field.z_m)
        for angles in [(90.0, 89.9), (45.0, 0.2), (200.0, 1e-6), (0.0, 90.0)]:
            result = render_enu(
                terrain,
                direction_enu(*angles),
                oblique_view(0.0, 0.0),
                Method(accuracy=TIERS[tier], disc=True),
            )
            share = np.asarray(result.sunlit)
            assert ((share >= 0) & (share <= 1)).all()
            assert not share[~ground].any()
            assert (np.isfinite(result.radiance) == result.visible).all()
            if name == "level":
                low, high = {0.2: (0.75, 1.0), 1e-6: (0.49, 0.51)}.get(angles[1], (1.0 - 1e-6, 1.0))
                inside = share[1:-1, 1:-1]  # beyond the border there is nothing, no horizon either
                assert ((inside >= low) & (inside <= high)).all(), angles


def test_a_cameras_own_node_is_seen_from_above():
    terrain = made(np.zeros((5, 5)))
    on_it = render_enu(terrain, direction_enu(10.0, 45.0), CameraView(np.zeros(3)))
    assert on_it.visible[2, 2]
    assert on_it.emission_deg[2, 2] == 0.0
    assert on_it.phase_deg[2, 2] == pytest.approx(45.0)
    raised = render_enu(terrain, direction_enu(10.0, 45.0), CameraView(np.array([0, 0, 1.0])))
    assert raised.visible.all()
    x = np.arange(-2, 3) * 2.0
    np.testing.assert_allclose(raised.emission_deg[2], np.degrees(np.arctan(np.abs(x))), atol=1e-4)


def test_cameras_in_the_ground_and_too_far_are_refused():
    terrain = made(np.full((5, 5), 7.0))
    with pytest.raises(CameraError, match="below the surface"):
        render_enu(terrain, direction_enu(0, 45), CameraView(np.array([0, 0, 6.999])))
    for altitude in (1.1e11, 1e200, 1.7e308):
        with pytest.raises(CameraError, match="leave it out for a camera at infinity"):
            oblique_view(10.0, 0.0, altitude)
    with pytest.raises(CameraError, match="not finite"):
        CameraView(np.array([math.nan, 0, 1]))
    far = looking_camera(terrain.frame, oblique_view(30.0, 0.0, 1e9).position_m, 0.5, (8.0, 8.0))
    plane = render_camera(terrain, far, direction_enu(90.0, 10.0))
    assert np.asarray(plane.sunlit)[np.asarray(plane.visible)].all()  # no hit hides itself
    assert plane.emission_deg[8, 8] == pytest.approx(30.0, abs=1e-6)


def test_the_furthest_camera_still_meets_the_ground_and_not_its_own_shadow():
    slope = made(3.0 * np.arange(13.0) + np.zeros((17, 1)))
    view = oblique_view(20.0, 300.0, 1e11)
    camera = looking_camera(slope.frame, view.position_m, 0.5, (10.0, 10.0))
    plane = render_camera(slope, camera, direction_enu(270.0, 1.0))
    assert plane.visible.any()
    assert np.asarray(plane.sunlit)[plane.visible].all()
    points = slope.frame.from_mcmf(plane.position_mcmf_m[plane.visible])
    off = slope.field.heights_at(points[:, 0], points[:, 1]) - points[:, 2]
    assert np.abs(off).max() < 1e-3


@pytest.mark.parametrize("tier", TIERS)
def test_threads_do_not_matter(tier):
    rough = made(np.random.default_rng(4).normal(size=(90, 70)) * 3)
    for view in (oblique_view(0.0, 0.0), oblique_view(80.0, 10.0), oblique_view(60.0, 10.0, 500.0)):
        pictures = []
        for threads in (1, thread_limit()):
            with limit_threads(threads):
                pictures.append(
                    render_enu(rough, direction_enu(70.0, 9.0), view, Method(accuracy=TIERS[tier]))
                )
        one, two = pictures
        for band in ("radiance", "sunlit", "visible", "incidence_deg", "emission_deg", "phase_deg"):
            np.testing.assert_array_equal(getattr(one, band), getattr(two, band))


def test_a_dem_with_infinite_cells_has_holes_there(tmp_path: Path):
    heights = np.full((60, 60), 100.0, np.float32)
    heights[20, 30], heights[40, 10], heights[50, 50] = np.inf, -np.inf, np.nan
    cell = math.radians(1.0) * R / 256
    path = geotiff(tmp_path / "inf.tif", heights, 0.0, 30 * cell, cell, EQC)
    terrain = terrain_from_area(DemSet.open([path]), Area(30 / 256, 0.0, 6.0), cell)
    z = terrain.field.z_m
    assert not np.isinf(z).any()
    assert 0 < np.isnan(z).sum() <= 12
    want, _ = closed_form(terrain, 100.0)
    assert np.nanmax(np.abs(z - want)) < 2e-3  # and nothing of them in their neighbours
