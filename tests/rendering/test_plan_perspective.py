"""The scene plan's perspective: parallel rays within their bound, and the assumptions of the bound."""

import math

import numpy as np
import pytest
from helpers.random_scenes import (
    AZIMUTHS,
    DRAFT,
    GSD,
    QUICK,
    REFERENCE,
    STANDARD,
    both,
    everything,
    make,
    same,
    terrains,
)
from hypothesis import assume, given
from hypothesis import strategies as st

from lcp_catalog.cameras.view import CameraView
from lcp_catalog.geometry.frames import direction_enu
from lcp_catalog.photometry.laws import reflectance_model
from lcp_catalog.rendering.error_bounds import parallel_direction, parallel_error, ray_angle_rad
from lcp_catalog.rendering.plan import plan_scene
from lcp_catalog.rendering.renderer import Method, render_enu
from lcp_catalog.terrain.relief_bounds import core_box, lowest_core_tangent, relief, tangent_of

pytestmark = pytest.mark.usefixtures("one_thread")


def farthest_within(terrain, direction, tolerance):
    """Distance at which the bound on parallel rays falls just below a tolerance; inf if there is none."""

    found = relief(terrain)

    def cost(distance):
        view = CameraView(distance * direction)
        least = lowest_core_tangent(view, terrain)
        return parallel_error(found, ray_angle_rad(found.box, view), least)

    low, high = 1.0, 1e10
    if cost(high) > tolerance:
        return math.inf
    for _ in range(40):
        middle = math.sqrt(low * high)
        low, high = (low, middle) if cost(middle) <= tolerance else (middle, high)
    return high


def relative_change(short, full):
    seen = full.visible & (full.radiance > 0)
    both_ = np.stack([short.radiance[seen], full.radiance[seen]]).astype(np.float64)
    return float(np.abs(both_[0] / both_[1] - 1.0).max(initial=0.0))


@QUICK
@given(
    terrain=terrains(smallest=2),
    azimuth=AZIMUTHS,
    over_deg=st.sampled_from([0.5, 5.0, 30.0]),
    sun=st.tuples(AZIMUTHS, st.sampled_from([2.0, 20.0, 89.0])),
    accuracy=st.sampled_from([DRAFT, STANDARD]),
    model=st.sampled_from(["lommel-seeliger", "lambert"]),
)
def test_parallel_rays_stay_within_their_bound(terrain, azimuth, over_deg, sun, accuracy, model):
    tilt = math.degrees(math.atan(relief(terrain).node_tangent))
    direction = direction_enu(azimuth, min(90.0, tilt + over_deg))
    distance = farthest_within(terrain, direction, accuracy.tolerance)
    assume(math.isfinite(distance))
    view = CameraView(1.001 * distance * direction)
    to_sun = direction_enu(*sun)
    plan = plan_scene(terrain, to_sun, view, accuracy=accuracy)
    assert not plan.perspective.modelled
    assert not plan.occlusion.modelled
    assert 0.9 * accuracy.tolerance < plan.perspective.error_bound <= accuracy.tolerance
    short, full = (
        render_enu(
            terrain,
            to_sun,
            view,
            Method(accuracy=REFERENCE, model=reflectance_model(model), plan=p),
        )
        for p in (plan, everything(plan, view, disc=False))
    )
    assert relative_change(short, full) <= plan.perspective.error_bound
    same(short, full, ("sunlit", "visible", "incidence_deg"))
    for band in ("emission_deg", "phase_deg"):
        turned = np.abs(getattr(short, band).astype(np.float64) - getattr(full, band))
        assert np.radians(np.nanmax(turned, initial=0.0)) <= plan.perspective.error_bound
    nearer = CameraView(0.98 * distance * direction)
    assert plan_scene(terrain, to_sun, nearer, accuracy=accuracy).perspective.modelled
    assert plan_scene(terrain, to_sun, view).perspective.modelled  # reference: nothing is given up


def test_the_bound_on_parallel_rays_is_nearly_reached():
    """A sawtooth profile with one flank facing away from a camera just above it, in grazing light."""
    slope, col = 0.3, np.mgrid[0:5, 0:73][1]
    terrain = make(slope * GSD * np.abs((col % 12) - 6.0), core=(2, 3, 1, 72))
    flank = math.degrees(math.atan(slope))
    direction, sun = direction_enu(270.0, flank + 2.0), direction_enu(270.0, flank + 0.01)
    distance = farthest_within(terrain, direction, DRAFT.tolerance)
    view = CameraView(1.001 * distance * direction)
    plan, short, full = both(terrain, sun, view, accuracy=DRAFT)
    assert not plan.perspective.modelled
    assert 0.5 * plan.perspective.error_bound < relative_change(short, full)
    assert relative_change(short, full) <= plan.perspective.error_bound


@QUICK
@given(terrain=terrains(smallest=2), seed=st.integers(0, 2**32 - 1))
def test_what_the_bound_on_parallel_rays_takes_for_granted(terrain, seed):
    """No node's normal is tilted by more than is said; the box's middle sees the camera as high as
    the lowest node at least.
    """
    found = relief(terrain)
    east, north, up = np.moveaxis(terrain.field.normals(terrain.core).astype(float), -1, 0)
    assert (np.hypot(east, north) <= found.node_tangent * up + 1e-6).all()
    position = np.random.default_rng(seed).normal(size=3) * [200.0, 200.0, 300.0]
    view = CameraView(position)
    least = lowest_core_tangent(view, terrain)
    if least > 0:
        assert tangent_of(parallel_direction(found.box, view)) >= least - 1e-9 * abs(least)


def test_a_corners_normal_is_steeper_than_any_facet():
    """Its differences to the east and to the south belong to two facets."""
    z = np.array([[0.0, 8, 8], [8, 8, 8], [8, 8, 8]])
    found = relief(make(z))
    assert found.slope.tangent == pytest.approx(8 / GSD)
    east, _, up = make(z).field.normals()[0, 0]
    assert abs(east / up) == pytest.approx(8 / GSD)
    assert found.node_tangent == pytest.approx(8 / GSD * math.sqrt(2))
    inner = make(np.pad(z, 1, mode="edge"), core=(1, 4, 1, 4))
    assert relief(inner).node_tangent == relief(inner).slope.tangent


def test_holes_have_everything_modelled():
    """A step across a gap is not a facet: no effect can be excluded."""
    z = np.zeros((20, 20))
    z[:, 12:] = 500.0
    z[:, 10:12] = np.nan
    terrain, far = make(z), CameraView(direction_enu(30.0, 89.0) * 1e9)
    for disc in (False, True):
        plan = plan_scene(terrain, direction_enu(90.0, 80.0), far, accuracy=DRAFT, disc=disc)
        assert plan.cast_shadows.modelled
        assert plan.occlusion.modelled
        assert plan.perspective.modelled
        assert plan.solar_disc.modelled == disc
        assert plan.solar_disc.error_bound > 0


@QUICK
@given(terrain=terrains(smallest=2), seed=st.integers(0, 2**32 - 1))
def test_no_ray_is_turned_by_more_than_the_boxs_angle(terrain, seed):
    rng, box = np.random.default_rng(seed), core_box(terrain)
    view = CameraView(rng.normal(size=3) * [300.0, 300.0, 900.0])
    angle = ray_angle_rad(box, view)
    inside = box.low_m + rng.random((200, 3)) * (box.high_m - box.low_m)
    cosines = view.directions(inside) @ parallel_direction(box, view)
    assert np.arccos(np.clip(cosines, -1, 1)).max() <= angle + 1e-7
