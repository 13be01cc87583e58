"""The scene plan's solar disc: left out near every threshold, compared with everything modelled."""

import math

import numpy as np
import pytest
from helpers.random_scenes import (
    AZIMUTHS,
    DRAFT,
    GSD,
    JUST_ABOVE,
    QUICK,
    STANDARD,
    both,
    make,
    same,
    terrains,
)
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from lcp_catalog.accuracy import TIERS
from lcp_catalog.cameras.view import looking_camera, oblique_view
from lcp_catalog.constants import SOLAR_RADIUS_RAD
from lcp_catalog.errors import SunError
from lcp_catalog.geometry.frames import direction_enu
from lcp_catalog.photometry.laws import radiance_under, reflectance_model
from lcp_catalog.rendering.error_bounds import PENUMBRA_PX, penumbra_px
from lcp_catalog.rendering.plan import plan_scene
from lcp_catalog.rendering.renderer import Method, render_camera, render_enu
from lcp_catalog.terrain.relief_bounds import relief, steepness

pytestmark = pytest.mark.usefixtures("one_thread")


def rim(sun, times=1.0, count=256):
    """Directions around the disc, with its radius scaled."""
    azimuth = math.atan2(sun[0], sun[1])
    elevation = math.asin(sun[2])
    right = np.array([math.cos(azimuth), -math.sin(azimuth), 0.0])
    turn = np.linspace(0, 2 * math.pi, count, endpoint=False)[:, None]
    radius = times * SOLAR_RADIUS_RAD
    up = np.cross(
        right,
        [
            math.sin(azimuth) * math.cos(elevation),
            math.cos(azimuth) * math.cos(elevation),
            math.sin(elevation),
        ],
    )
    ring = np.cos(turn) * right + np.sin(turn) * up
    return math.cos(radius) * sun + math.sin(radius) * ring


@QUICK
@given(terrain=terrains(smallest=2), azimuth=AZIMUTHS, above=JUST_ABOVE)
def test_a_disc_left_out_below_its_limb_was_whole(terrain, azimuth, above):
    """Just above the steepest slope no part of the disc is hidden from any node: direction by
    direction.
    """
    steepest = max(steepness(terrain.field).tangent, 1e-3) * (1 + above)
    elevation = math.atan(steepest) + SOLAR_RADIUS_RAD
    assume(elevation < math.pi / 2)
    sun = direction_enu(azimuth, math.degrees(elevation))
    plan, short, full = both(terrain, sun, oblique_view(0.0, 0.0), disc=True)
    assert not plan.solar_disc.modelled
    assert not plan.cast_shadows.modelled
    assert plan.solar_disc.error_bound == 0.0
    same(short, full)
    for direction in rim(sun, count=16):
        assert not terrain.field.occluded_nodes(direction, terrain.core).any()
    tangent = steepness(terrain.field).tangent
    lower = direction_enu(azimuth, math.degrees(math.atan(tangent) + 0.999 * SOLAR_RADIUS_RAD))
    decided = plan_scene(terrain, lower, oblique_view(0.0, 0.0), disc=True)
    if tangent > 1e-3:
        assert decided.solar_disc.modelled
        assert decided.cast_shadows.modelled


def test_the_discs_lower_limb_is_where_it_begins():
    z = np.zeros((9, 40))
    z[:, 19], z[:, 20], z[:, 21] = 8.0, 16.0, 8.0
    terrain, flank = make(z), math.degrees(math.atan(8.0 / GSD))
    for above_deg, cut in ((0.2, True), (0.3, False)):  # a radius of 0.267 deg
        sun = direction_enu(90.0, flank + above_deg)
        plan, short, full = both(terrain, sun, oblique_view(0.0, 0.0), disc=True)
        assert plan.solar_disc.modelled == plan.cast_shadows.modelled == cut
        assert bool(((full.sunlit > 0) & (full.sunlit < 1))[1:-1, 10:19].any()) == cut
        same(short, full)


@QUICK
@given(
    elevation=st.floats(3.0, 60.0),
    pixels=st.sampled_from([0.0999, 0.1001]) | st.floats(0.02, 0.098),
    accuracy=st.sampled_from([DRAFT, STANDARD]),
    offset=st.floats(-1.2, 1.2),
)
def test_a_narrow_penumbra_is_left_out_near_shadows_edges_only(elevation, pixels, accuracy, offset):
    """On level terrain behind a wall: a point Sun is wrong only within the stated width."""
    sun = direction_enu(90.0, elevation)
    cot = [1 / math.tan(math.radians(elevation) + s * SOLAR_RADIUS_RAD) for s in (-1, 0, 1)]
    height = np.float32(pixels * GSD / (cot[0] - cot[2]))
    edge = height * cot[1] / GSD  # cells from the wall
    away = max(2, round(edge))
    # the penumbra falls onto a node: the wall is set so that the edge is a share of its width off
    shift = (away + offset * pixels - edge) * GSD / cot[1]
    assume(height + shift > 0)
    height = np.float32(height + shift)
    width = away + 12
    z = np.zeros((5, width), np.float32)
    z[:, -3] = height
    terrain = make(z)
    stated = penumbra_px(relief(terrain), sun, GSD)
    edge = float(height) * cot[1] / GSD
    assume(float(height) / GSD > math.tan(math.radians(elevation)))
    plan, short, full = both(terrain, sun, oblique_view(0.0, 0.0), accuracy, disc=True)
    assert stated == pytest.approx(float(height) * (cot[0] - cot[2]) / GSD, rel=1e-9)
    assert plan.solar_disc.modelled == (stated > PENUMBRA_PX)
    differ = np.abs(short.sunlit - full.sunlit)
    assert differ.max() <= plan.solar_disc.error_bound
    off = np.abs((width - 3) - np.arange(width) - edge)
    assert differ[2][off > stated].max(initial=0.0) < 1e-6  # the disc's flux is a sum of strips
    exact = plan_scene(terrain, sun, oblique_view(0.0, 0.0), accuracy=TIERS["high"], disc=True)
    assert exact.solar_disc.modelled


@settings(deadline=None, max_examples=25)
@given(
    terrain=terrains(smallest=3, holes=True),
    azimuth=AZIMUTHS,
    elevation=st.sampled_from([0.1, 3.0, 25.0, 60.0]),
)
def test_a_point_sun_is_wrong_only_where_the_disc_is_cut(terrain, azimuth, elevation):
    """Nodes that see all or nothing of the rim of a slightly larger disc are exact."""
    sun = direction_enu(azimuth, elevation)
    plan = plan_scene(terrain, sun, oblique_view(0.0, 0.0))
    assert not plan.solar_disc.modelled
    point, disc = (
        render_enu(terrain, sun, oblique_view(0.0, 0.0), Method(disc=d)).sunlit
        for d in (False, True)
    )
    rays = rim(sun, 1.05, 64)  # their chords stay outside of the disc
    blocked = sum(terrain.field.occluded_nodes(d, terrain.core).astype(int) for d in rays)
    sure = (blocked == 0) | (blocked == 64)
    np.testing.assert_allclose(disc[sure], point[sure], atol=1e-6)
    assert np.abs(disc - point).max() <= plan.solar_disc.error_bound


@pytest.mark.parametrize("frame", ["nodes", "pixels"])
def test_a_disc_lights_by_its_share(frame):
    z = np.zeros((11, 60))
    z[:, 50] = 60.0
    terrain, sun = make(z), direction_enu(90.0, 8.0)
    camera = looking_camera(terrain.frame, [0, 0, 1e5], GSD / 4, (1000.0, 150.0))

    def render(disc, accuracy=TIERS["high"]):
        if frame == "nodes":
            return render_enu(
                terrain, sun, oblique_view(0.0, 0.0), Method(disc=disc, accuracy=accuracy)
            )
        return render_camera(terrain, camera, sun, Method(disc=disc, accuracy=accuracy))

    disc, point = render(True), render(False)
    part = (disc.sunlit > 0) & (disc.sunlit < 1)
    assert part.any()
    assert set(np.unique(point.sunlit)) == {0.0, 1.0}
    lit = part & (point.sunlit == 1)
    assert np.allclose(disc.radiance[lit], disc.sunlit[lit] * point.radiance[lit], rtol=1e-6)
    assert (disc.radiance[part & disc.visible] > 0).all()
    alike = ~part & disc.visible
    np.testing.assert_array_equal(disc.radiance[alike], point.radiance[alike])


def test_part_of_the_disc_is_a_sun():
    terrain = make(np.zeros((9, 9)))
    for elevation, disc, up in ((-0.2, True, True), (-0.2, False, False), (-0.4, True, False)):
        if up:
            render_enu(
                terrain, direction_enu(10.0, elevation), oblique_view(0.0, 0.0), Method(disc=disc)
            )
            continue
        with pytest.raises(SunError, match="below the horizon"):
            render_enu(
                terrain, direction_enu(10.0, elevation), oblique_view(0.0, 0.0), Method(disc=disc)
            )


@pytest.mark.parametrize(("name", "scale"), [("lambert", 0.12), ("lommel-seeliger", 0.0525)])
def test_a_grazed_facet_is_dark_within_the_bound(name, scale):
    """The radiance factor for the disc's centre, compared with the mean over the disc."""
    up = np.array([[0.0, 0.0, 1.0]])

    def radiance(to_sun, mu):
        camera = np.array([math.sqrt(1.0 - mu * mu), 0.0, mu])
        return radiance_under(up, to_sun, camera, np.array([True]), reflectance_model(name))[0]

    for incidence in (0.0, 30.0, 80.0, 89.7, 89.9, 90.0, 90.2, 91.0):
        sun = direction_enu(0.0, 90.0 - incidence)
        rings = [rim(sun, r, 64) for r in np.sqrt((np.arange(16) + 0.5) / 16)]
        for mu in (1.0, 0.3, 0.05):
            mean = np.mean([radiance(point, mu) for point in np.concatenate(rings)])
            middle = radiance(sun, mu)
            steep = 1.0 if name == "lambert" else 1.0 / mu
            assert abs(mean - middle) <= scale * math.sin(SOLAR_RADIUS_RAD) * steep
