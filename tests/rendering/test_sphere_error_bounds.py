"""The plan's choice of the sphere for a heightfield, and its error bound."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lcp_catalog.accuracy import TIERS
from lcp_catalog.cameras.view import CameraView, oblique_view
from lcp_catalog.constants import MOON_RADIUS_M
from lcp_catalog.geometry.frames import EnuFrame, direction_enu
from lcp_catalog.light.sources import Lighting
from lcp_catalog.photometry.laws import reflectance_model
from lcp_catalog.rendering.error_bounds import SHIFT_PX, SphereCost, sphere_cost
from lcp_catalog.rendering.plan import plan_scene
from lcp_catalog.rendering.renderer import Method, render_enu
from lcp_catalog.rendering.sphere_renderer import render_sphere_enu, sphere_nodes
from lcp_catalog.terrain.area import NodeWindow
from lcp_catalog.terrain.heightfield import Heightfield
from lcp_catalog.terrain.terrain import Terrain

R = MOON_RADIUS_M
FRAME = EnuFrame(12.0, -34.0)
HALF, GSD = 16, 1000.0
DRAFT, STANDARD = TIERS["draft"], TIERS["standard"]
WINDOW = NodeWindow(-HALF, HALF + 1, -HALF, HALF + 1)


def ground(relief_m=0.0, offset_m=0.0, seed=0, hole=False):
    """Random waves on the sphere, up to 16 km from the centre."""
    x = np.arange(-HALF - 1, HALF + 2) * GSD
    x, y = np.meshgrid(x, -x)
    nodes = sphere_nodes(x, y)
    rng = np.random.default_rng(seed)
    waves = sum(
        np.sin(
            rng.uniform(0.2, 1.0) * (x * math.cos(t) + y * math.sin(t)) / 3e3 + rng.uniform(0, 6)
        )
        for t in rng.uniform(0, 6, 4)
    )
    vertical = nodes + np.array([0.0, 0.0, R])
    z = nodes[..., 2] + (offset_m + relief_m * waves / 4.0) * R / vertical[..., 2]
    if hole:
        z[5, 5] = np.nan
    field = Heightfield(z.astype(np.float32), GSD, float(x[0, 0]), float(y[0, 0]))
    core = (1, 2 * HALF + 2, 1, 2 * HALF + 2)
    index = np.zeros((2 * HALF + 1, 2 * HALF + 1), np.int16)
    window = NodeWindow(-HALF - 1, HALF + 2, -HALF - 1, HALF + 2)
    return Terrain(field, FRAME, core, window, index, ("made",))


def decision(terrain, view, sun, accuracy=DRAFT, model="lommel-seeliger", **more):
    plan = plan_scene(
        terrain,
        sun,
        view,
        accuracy=accuracy,
        model=reflectance_model(model),
        **({"sphere_may_do": True} | more),
    )
    return plan.relief


HIGH_SUN = direction_enu(100.0, 50.0)


def test_smooth_ground_is_a_sphere_and_rough_ground_is_not():
    assert not decision(ground(), oblique_view(0.0, 0.0), HIGH_SUN).modelled
    assert not decision(ground(2.0), oblique_view(0.0, 0.0), HIGH_SUN).modelled
    assert decision(ground(30.0), oblique_view(0.0, 0.0), HIGH_SUN).modelled
    assert decision(ground(1000.0), oblique_view(0.0, 0.0), HIGH_SUN).modelled


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"sphere_may_do": False}, "nobody asked"),
        ({"accuracy": TIERS["high"]}, "no node may be wrong"),
        ({"accuracy": TIERS["reference"]}, "no node may be wrong"),
        ({"sun": direction_enu(100.0, 0.05)}, "a Sun so low changes brightness"),
        ({"terrain": ground(0.0, hole=True)}, "nodata is never rendered"),
        ({"terrain": ground(0.0, -2000.0), "view": oblique_view(60.0, 0.0, 1e6)}, "it is shifted"),
    ],
)
def test_what_forbids_the_sphere(change, why):
    how = {"terrain": ground(), "view": oblique_view(0.0, 0.0), "sun": HIGH_SUN}
    assert not decision(**how).modelled
    assert decision(**(how | change)).modelled, why


def test_far_terrain_may_throw_shadows_on_the_smoothest_ground():
    """The slopes of an area do not bound terrain beyond it, on other cells."""
    far = SimpleNamespace(highest_m=9e3, span_m=4e5)
    assert decision(replace(ground(), far=far), oblique_view(0.0, 0.0), HIGH_SUN).modelled


def test_what_is_not_looked_at_costs_everything():
    how = (HIGH_SUN, oblique_view(0.0, 0.0), reflectance_model("lambert"), math.inf, GSD, 5e-3)
    assert sphere_cost(ground(0.0, hole=True), *how) is None
    assert sphere_cost(ground(1000.0), *how) is None
    found = sphere_cost(ground(), *how)
    assert found is not None
    assert found.within(DRAFT)
    nothing = SphereCost(0.0, 0.0, 0.0)
    assert nothing.within(STANDARD)
    assert not nothing.within(TIERS["high"])
    assert not SphereCost(0.11, 0.0, 0.0).within(DRAFT)
    night = sphere_cost(ground(), direction_enu(0.0, -5.0), *how[1:])
    assert night is not None
    assert night.radiance == math.inf


def test_the_reason_says_what_the_sphere_costs():
    chosen = decision(ground(2.0), oblique_view(0.0, 0.0), HIGH_SUN)
    assert "turns normals by up to" in chosen.reason
    assert "within 0.005 and 0.1 pixels" in chosen.reason
    assert 0 < chosen.error_bound <= DRAFT.tolerance
    kept = decision(ground(30.0), oblique_view(0.0, 0.0), HIGH_SUN)
    assert "the heightfield's own triangles; the plain sphere" in kept.reason
    assert kept.error_bound == 0.0


@settings(max_examples=40, deadline=None)
@given(
    st.floats(-2.0, 1.5),
    st.floats(-40.0, 40.0),
    st.integers(0, 99),
    st.floats(3.0, 88.0),
    st.floats(0.0, 75.0),
    st.floats(0.0, 360.0),
    st.sampled_from(["lommel-seeliger", "lambert", "hapke"]),
)
def test_the_bound_holds_where_the_sphere_is_taken(
    log_relief, offset, seed, elevation, off_nadir, azimuth, model
):
    """Renders of the heightfield and of the sphere, node by node, for terrains just smooth enough for the
    plan to choose the sphere.
    """
    terrain = ground(10.0**log_relief, offset, seed)
    sun, view = direction_enu(azimuth, elevation), oblique_view(off_nadir, 77.0)
    for accuracy in (DRAFT, STANDARD):
        chosen = decision(terrain, view, sun, accuracy, model)
        if chosen.modelled:
            continue
        law = reflectance_model(model)
        light = Lighting.of_sun(sun)
        full = render_enu(terrain, light, view, Method(model=law, accuracy=TIERS["reference"]))
        short = render_sphere_enu(FRAME, WINDOW, GSD, light, view, model=law)
        assert (full.visible == short.visible).all()
        assert (full.sunlit == short.sunlit).all()
        change = np.abs(short.radiance.astype(float) / full.radiance - 1.0).max()
        assert change <= chosen.error_bound <= accuracy.tolerance
        for band in ("incidence_deg", "emission_deg", "phase_deg"):
            turned = np.abs(getattr(short, band).astype(float) - getattr(full, band)).max()
            assert math.radians(turned) <= chosen.error_bound
        off_m = np.abs(short.height_m.astype(float) - full.height_m).max()
        assert off_m * math.tan(math.radians(off_nadir)) <= SHIFT_PX * GSD * 1.001


def test_the_sphere_is_taken_for_a_camera_nearby_too():
    view = CameraView(np.array([0.0, 0.0, 80e3]))
    assert not decision(ground(1.0), view, HIGH_SUN).modelled
    flat = CameraView(np.array([300e3, 0.0, 30e3]))
    assert decision(ground(3.0, 90.0), flat, HIGH_SUN).modelled
