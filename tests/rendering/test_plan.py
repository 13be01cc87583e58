"""The scene plan: terrain beyond the area, extreme scenes, and the path of a render that follows the plan."""

import json
import math

import numpy as np
import pytest
from helpers.random_scenes import AZIMUTHS, GSD, QUICK, STANDARD, both, make, same, terrains
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from lcp_catalog.accuracy import TIERS
from lcp_catalog.cameras.view import CameraView, oblique_view
from lcp_catalog.constants import HIGHEST_M, MOON_RADIUS_M, SOLAR_RADIUS_RAD
from lcp_catalog.errors import SunError
from lcp_catalog.geometry.frames import direction_enu
from lcp_catalog.rendering.error_bounds import NORMAL_ROUNDING_RAD, horizon_beyond_rad, limb_tangent
from lcp_catalog.rendering.plan import ring_decision
from lcp_catalog.rendering.renderer import Method, render_enu

pytestmark = pytest.mark.usefixtures("one_thread")


# ---- beyond the area


@QUICK
@given(seed=st.integers(0, 2**32 - 1), distance=st.floats(1e3, 3e5), half=st.floats(1e2, 1e5))
def test_nothing_beyond_stands_higher_than_the_bound(seed, distance, half):
    """Random nodes of an area and random terrain beyond it, in the frame on the sphere."""
    rng = np.random.default_rng(seed)
    nodes = rng.uniform(-half, half, (200, 2))
    sites = rng.uniform(-3, 3, (2000, 2)) * (half + distance)
    sites = sites[np.abs(sites).max(axis=1) >= half + distance][:200]
    heights = np.full(len(sites), HIGHEST_M) - rng.choice([0.0, 5e3], len(sites))
    z = np.sqrt((MOON_RADIUS_M + heights) ** 2 - (sites**2).sum(axis=1)) - MOON_RADIUS_M
    ground = rng.uniform(-9e3, 0, len(nodes)) - (nodes**2).sum(axis=1) / (2 * MOON_RADIUS_M)
    bound = horizon_beyond_rad(distance, float(ground.min()), half + distance)
    away = np.linalg.norm(sites[:, None] - nodes, axis=-1)
    assert np.arctan2(z[:, None] - ground, away).max() <= bound


def test_a_sun_above_the_bound_needs_no_terrain_beyond():
    """The Moon's greatest height just beyond a limited ring shadows nothing for a Sun above the bound."""
    z = np.full((11, 81), -1000.0)
    z[:, -1] = HIGHEST_M
    ring = 40 * 200.0
    area = make(z[:, :80], core=(0, 11, 35, 40), gsd=200.0)
    everything = make(z, core=(0, 11, 35, 40), gsd=200.0)
    decision = ring_decision(area, ring, 2 * ring)
    assert "capped" in decision.reason
    assert decision.unit == "deg of the horizon"
    for above, changed in ((0.01, False), (-1.0, True)):
        sun = direction_enu(90.0, decision.error_bound + above)
        short, full = (
            render_enu(t, sun, oblique_view(0.0, 0.0)).sunlit for t in (area, everything)
        )
        assert bool((short != full).any()) == changed


def test_a_ring_says_what_it_lacks():
    z = np.zeros((31, 31))
    whole = make(z, core=(10, 21, 10, 21))
    assert ring_decision(whole, 200.0, 200.0).error_bound == 0.0
    z[3, 15] = np.nan  # 7 nodes off: its cells begin 6 nodes off
    gap = ring_decision(make(z, core=(10, 21, 10, 21)), 200.0, 200.0)
    assert gap.error_bound == pytest.approx(
        math.degrees(horizon_beyond_rad(6 * GSD, 0.0, 11 * GSD))
    )
    assert "has no height" in gap.reason
    z[15, 15] = np.nan  # inside the area
    assert ring_decision(make(z, core=(10, 21, 10, 21)), 200.0, 200.0) == gap


# ---- what always is, and the ends of the world


@QUICK
@given(terrain=terrains(smallest=2))
def test_a_normal_in_float32_is_turned_by_its_bound_at_most(terrain):
    z = terrain.field.z_m.astype(np.float64)
    y, x = (np.gradient(z, GSD, axis=axis) for axis in (0, 1))
    exact = np.stack([-x, y, np.ones_like(z)], -1)
    exact /= np.linalg.norm(exact, axis=-1)[..., None]
    off = np.linalg.norm(np.cross(exact, terrain.field.normals().astype(np.float64)), axis=-1)
    assert off.max() <= NORMAL_ROUNDING_RAD * (1 + 1e-6)


def is_set(terrain, azimuth_deg, elevation_deg, limb_rad):
    """True if a Sun is below the horizon of every node of the area, by the formulas of small angles: away from the area's
    origin the vertical turns, and from a height above the lowest node the horizon dips.
    """
    field, (row0, row1, col0, col1) = terrain.field, terrain.core
    rows, cols = np.indices(field.z_m.shape)
    x, y = field.x0_m + cols * GSD, field.y0_m - rows * GSD
    height = field.z_m + (x**2 + y**2) / (2.0 * MOON_RADIUS_M)
    dip = np.sqrt(2.0 * (height - np.nanmin(height)) / MOON_RADIUS_M)
    towards = x * math.sin(math.radians(azimuth_deg)) + y * math.cos(math.radians(azimuth_deg))
    above = math.radians(elevation_deg) + limb_rad + towards / MOON_RADIUS_M + dip
    return bool(np.nanmax(above[row0:row1, col0:col1]) < -1e-11)


@settings(deadline=None, max_examples=40)
@example(make([[0.06, np.nan]]), (45.0, 0.0), "ground", "draft", False)  # 20 m west of the origin
@given(
    terrain=terrains(holes=True),
    sun=st.tuples(AZIMUTHS, st.sampled_from([0.0, 1e-6, 0.1, 45.0, 89.9, 90.0])),
    where=st.sampled_from(["ground", "far", "zenith", "oblique", "node"]),
    tier=st.sampled_from(list(TIERS)),
    disc=st.booleans(),
)
def test_the_ends_of_the_world(terrain, sun, where, tier, disc):
    """For any scene: the plan is valid JSON, the render has no undefined values, and effects that are left
    out with a bound of 0 do not change it. A Sun that is below every horizon is refused.
    """
    field, accuracy = terrain.field, TIERS[tier]
    row, col = terrain.core[0], terrain.core[2]
    ground = float(field.z_m[row, col])
    ground = ground if math.isfinite(ground) else float(field.extremes_m[1])
    assume(math.isfinite(ground))
    here = np.array([field.x0_m + col * GSD, field.y0_m - row * GSD, ground])
    view = {
        "ground": CameraView(here + np.array([0, 0, 1.0])),
        "node": CameraView(here),
        "far": CameraView(direction_enu(30.0, 50.0) * 1e9),
        "zenith": oblique_view(0.0, 0.0),
        "oblique": oblique_view(60.0, 200.0),
    }[where]
    to_sun = direction_enu(*sun)
    if is_set(terrain, *sun, SOLAR_RADIUS_RAD if disc else 0.0):
        with pytest.raises(SunError, match="below the horizon"):
            both(terrain, to_sun, view, accuracy, disc)
        return
    plan, short, full = both(terrain, to_sun, view, accuracy, disc)
    json.dumps(plan.to_json(), allow_nan=False)
    assert all(d.error_bound is None or d.error_bound >= 0 for d in plan.decisions)
    assert ((short.sunlit >= 0) & (short.sunlit <= 1)).all()
    assert np.isfinite(short.radiance[short.visible]).all()
    left_out = [d for d in (plan.cast_shadows, plan.occlusion, plan.perspective) if not d.modelled]
    if disc and not plan.solar_disc.modelled:
        left_out.append(plan.solar_disc)
    if accuracy.exact and all(d.error_bound == 0 for d in left_out):
        same(short, full)


def test_renders_take_the_path_that_the_plan_says(monkeypatch):
    """The shorter path if an effect is not modelled, the full one if it is."""
    from lcp_catalog.rendering import renderer
    from lcp_catalog.terrain.heightfield import Heightfield

    called = []
    names = ("occluded", "sunlit_share", "parallel_view")
    for owner, name in (*((renderer, n) for n in names), (Heightfield, "occluded_nodes_from")):
        original = getattr(owner, name)
        monkeypatch.setattr(
            owner, name, lambda *a, n=name, f=original, **k: (called.append(n), f(*a, **k))[1]
        )
    flat, rough = make(np.zeros((9, 9))), make(np.random.default_rng(1).normal(size=(9, 9)) * 30)
    sun, far = direction_enu(80.0, 20.0), CameraView(direction_enu(30.0, 50.0) * 1e9)
    for terrain, disc, expected in (
        (flat, True, ["parallel_view"]),
        (rough, False, ["occluded", "occluded_nodes_from"]),
        (rough, True, ["sunlit_share", "occluded_nodes_from"]),
    ):
        called.clear()
        render_enu(terrain, sun, far, Method(accuracy=STANDARD, disc=disc))
        assert called == expected


def test_the_lower_limb():
    for elevation in (0.0, 0.1, 30.0, 90.0):
        expected = math.tan(math.radians(elevation) - SOLAR_RADIUS_RAD)
        assert limb_tangent(direction_enu(20.0, elevation)) == pytest.approx(expected, rel=1e-9)
