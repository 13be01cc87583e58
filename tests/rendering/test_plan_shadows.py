"""The scene plan's cast shadows and occlusion: left out just above the steepest slope, compared with
everything modelled.
"""

import math

import numpy as np
import pytest
from helpers.random_scenes import (
    AZIMUTHS,
    GSD,
    JUST_ABOVE,
    QUICK,
    both,
    make,
    same,
    terrains,
    towards,
)
from hypothesis import given
from hypothesis import strategies as st

from lcp_catalog.accuracy import TIERS
from lcp_catalog.cameras.view import (
    CameraView,
    ParallelView,
    camera_view,
    looking_camera,
    oblique_view,
)
from lcp_catalog.geometry.frames import direction_enu
from lcp_catalog.rendering.plan import plan_scene
from lcp_catalog.terrain.relief_bounds import steepness

pytestmark = pytest.mark.usefixtures("one_thread")


@QUICK
@given(terrain=terrains(), azimuth=AZIMUTHS, above=JUST_ABOVE)
def test_shadows_left_out_were_none(terrain, azimuth, above):
    steepest = steepness(terrain.field).tangent
    sun = towards(azimuth, max(steepest, 1e-3) * (1 + above))
    plan, short, full = both(terrain, sun, oblique_view(0.0, 0.0))
    assert not plan.cast_shadows.modelled
    assert plan.cast_shadows.error_bound == 0.0
    same(short, full)


@QUICK
@given(terrain=terrains(smallest=2), azimuth=AZIMUTHS, below=st.sampled_from([0.0, 1e-9, 1e-3]))
def test_a_sun_as_low_as_the_steepest_slope_has_shadows_modelled(terrain, azimuth, below):
    steepest = steepness(terrain.field).tangent
    sun = towards(azimuth, steepest * (1 - below))
    plan = plan_scene(terrain, sun, oblique_view(0.0, 0.0))
    assert plan.cast_shadows.modelled
    assert plan_scene(terrain, sun, ParallelView(sun)).occlusion.modelled


@QUICK
@given(terrain=terrains(), azimuth=AZIMUTHS, above=JUST_ABOVE)
def test_occlusion_left_out_was_none(terrain, azimuth, above):
    view = ParallelView(towards(azimuth, max(steepness(terrain.field).tangent, 1e-3) * (1 + above)))
    plan, short, full = both(terrain, direction_enu(77.0, 50.0), view)
    assert not plan.occlusion.modelled
    same(short, full)


def camera_at(terrain, azimuth_deg, away_m, tangent):
    """A camera with a given tangent of its elevation at the node where that is least."""
    x, y = (
        away_m * math.sin(math.radians(azimuth_deg)),
        away_m * math.cos(math.radians(azimuth_deg)),
    )
    field, (row0, row1, col0, col1) = terrain.field, terrain.core
    row, col = np.mgrid[row0:row1, col0:col1]
    off = np.hypot(field.x0_m + col * GSD - x, field.y0_m - row * GSD - y)
    z = np.nanmax(field.z_m[row0:row1, col0:col1].astype(float) + tangent * off)
    return CameraView(np.array([x, y, z]))


@QUICK
@given(
    terrain=terrains(),
    azimuth=AZIMUTHS,
    above=JUST_ABOVE,
    away_m=st.sampled_from([3.0, 500.0, 1e5, 1e9]),
)
def test_a_cameras_occlusion_left_out_was_none(terrain, azimuth, above, away_m):
    steepest = max(steepness(terrain.field).tangent, 1e-3)
    view = camera_at(terrain, azimuth, away_m, steepest * (1 + above))
    plan, short, full = both(terrain, direction_enu(77.0, 50.0), view)
    assert not plan.occlusion.modelled
    same(short, full)
    lower = camera_at(terrain, azimuth, away_m, steepest * (1 - 1e-3))
    if steepness(terrain.field).tangent > 1e-3:
        assert plan_scene(terrain, direction_enu(0, 50), lower).occlusion.modelled


@pytest.mark.parametrize("share", [0.999, 1.001])
def test_the_steepest_slope_is_where_it_begins(share):
    """A ridge with uniform flanks: slightly below their slope, its foot is dark or hidden."""
    z = np.zeros((9, 40))
    z[:, 19], z[:, 20], z[:, 21] = 8.0, 16.0, 8.0
    ray = towards(90.0, 8.0 / GSD * share)
    terrain = make(z)
    for sun, view, effect in (
        (ray, oblique_view(0.0, 0.0), "cast_shadows"),
        (direction_enu(0.0, 89.0), ParallelView(ray), "occlusion"),
    ):
        plan, short, full = both(terrain, sun, view)
        assert getattr(plan, effect).modelled == (share < 1)
        band = full.sunlit if effect == "cast_shadows" else full.visible
        assert bool((band[1:-1, 10:19] == 0).any()) == (share < 1)
        same(short, full)


@pytest.mark.parametrize("tier", TIERS)
def test_the_bound_of_what_is_modelled_is_the_tiers(tier):
    terrain = make(np.random.default_rng(3).normal(size=(20, 20)) * 20)
    low, accuracy = direction_enu(10.0, 5.0), TIERS[tier]
    plan = plan_scene(terrain, low, ParallelView(low), accuracy=accuracy)
    assert plan.cast_shadows.error_bound == plan.occlusion.error_bound == accuracy.node_error
    assert tier in plan.cast_shadows.reason
    near = plan_scene(terrain, low, CameraView(np.array([0, 500.0, 90.0])), accuracy=accuracy)
    assert near.occlusion.modelled
    assert near.occlusion.error_bound == 0.0
    camera = looking_camera(terrain.frame, [0, 0, 3000.0], GSD, (300.0, 300.0))
    pixels = plan_scene(terrain, low, camera_view(camera, terrain.frame), True, accuracy=accuracy)
    for decision in (pixels.cast_shadows, pixels.occlusion, pixels.perspective):
        assert decision.modelled
        assert decision.error_bound == 0.0
