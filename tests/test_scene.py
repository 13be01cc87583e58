"""The scene plan: what is left out near every threshold, against everything modelled."""

import json
import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from lcp_catalog.accuracy import TIERS
from lcp_catalog.assemble import decisions
from lcp_catalog.config import BuildConfig, SunConfig, ViewConfig
from lcp_catalog.constants import HIGHEST_M, MOON_RADIUS_M, SOLAR_RADIUS_RAD
from lcp_catalog.errors import SunError
from lcp_catalog.heightfield import Heightfield
from lcp_catalog.reflectance import radiance_under, reflectance_model
from lcp_catalog.relief import core_box, lowest_core_tangent, relief, steepness, tangent_of
from lcp_catalog.render import render_camera, render_enu
from lcp_catalog.scene import plan_scene, ring_decision
from lcp_catalog.scene_bounds import (
    NORMAL_ROUNDING_RAD,
    PENUMBRA_PX,
    horizon_beyond_rad,
    limb_tangent,
    parallel_direction,
    parallel_error,
    penumbra_px,
    ray_angle_rad,
)
from lcp_catalog.sphere import EnuFrame, direction_enu
from lcp_catalog.terrain import NodeWindow, Terrain
from lcp_catalog.threads import limit_threads
from lcp_catalog.view import View, camera_view, looking_camera, nadir_view, oblique_view

GSD = 20.0


@pytest.fixture(autouse=True, scope="module")
def one_thread():
    """Scenes of a hundred nodes: waking a second thread takes longer than they do."""
    with limit_threads(1):
        yield


BANDS = ("radiance", "sunlit", "visible", "incidence_deg", "emission_deg", "phase_deg")
REFERENCE, STANDARD, DRAFT = TIERS["reference"], TIERS["standard"], TIERS["draft"]


def make(z, core=None, gsd=GSD):
    z = np.asarray(z, dtype=np.float32)
    rows, cols = z.shape
    field = Heightfield(z, gsd, -(cols // 2) * gsd, (rows // 2) * gsd)
    window = NodeWindow(-(rows // 2), rows - rows // 2, -(cols // 2), cols - cols // 2)
    core = core or (0, rows, 0, cols)
    return Terrain(
        field, EnuFrame(12.0, 34.0), core, window, np.zeros(z.shape, np.int16), ("made",)
    )


@st.composite
def terrains(draw, smallest=1, holes=False):
    """Random nodes, rough or smooth, sometimes with a core inside, one row wide, or with holes."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    rows, cols = draw(st.tuples(st.integers(smallest, 12), st.integers(smallest, 12)))
    z = rng.normal(size=(rows, cols)) * draw(st.sampled_from([0.05, 3.0, 40.0]))
    if draw(st.booleans()):
        z = np.cumsum(np.cumsum(z, 0), 1) / max(rows, cols)
    if holes:
        z[rng.random(z.shape) < 0.15] = np.nan
    core = None
    if rows > 5 and cols > 5 and draw(st.booleans()):
        core = (2, rows - 1, 1, cols - 2)
    return make(z, core)


def same(a, b, bands=BANDS):
    for band in bands:
        np.testing.assert_array_equal(getattr(a, band), getattr(b, band), err_msg=band)


def both(terrain, sun, view, accuracy=REFERENCE, disc=False, **how):
    """The plan, the render by it, and the render of everything."""
    plan = plan_scene(terrain, sun, view, accuracy=accuracy, disc=disc)
    full = plan_scene(terrain, sun, view, accuracy=accuracy, disc=disc, everything=True)
    renders = (
        render_enu(terrain, sun, view, accuracy=accuracy, disc=disc, plan=p, **how)
        for p in (plan, full)
    )
    return plan, *renders


def towards(azimuth_deg, tangent):
    return direction_enu(azimuth_deg, math.degrees(math.atan(tangent)))


AZIMUTHS = st.sampled_from([0.0, 45.0, 90.0, 135.0, 270.0]) | st.floats(0.0, 360.0)
JUST_ABOVE = st.sampled_from([2e-6, 1e-4, 1e-2])
QUICK = settings(deadline=None, max_examples=60)


# ---- cast shadows and occlusion


@QUICK
@given(terrain=terrains(), azimuth=AZIMUTHS, above=JUST_ABOVE)
def test_shadows_left_out_were_none(terrain, azimuth, above):
    steepest = steepness(terrain.field).tangent
    sun = towards(azimuth, max(steepest, 1e-3) * (1 + above))
    plan, short, full = both(terrain, sun, nadir_view())
    assert not plan.cast_shadows.modelled
    assert plan.cast_shadows.error_bound == 0.0
    same(short, full)


@QUICK
@given(terrain=terrains(smallest=2), azimuth=AZIMUTHS, below=st.sampled_from([0.0, 1e-9, 1e-3]))
def test_a_sun_as_low_as_the_steepest_slope_has_shadows_modelled(terrain, azimuth, below):
    steepest = steepness(terrain.field).tangent
    sun = towards(azimuth, steepest * (1 - below))
    plan = plan_scene(terrain, sun, nadir_view())
    assert plan.cast_shadows.modelled
    assert plan_scene(terrain, sun, View(direction=sun)).occlusion.modelled


@QUICK
@given(terrain=terrains(), azimuth=AZIMUTHS, above=JUST_ABOVE)
def test_occlusion_left_out_was_none(terrain, azimuth, above):
    view = View(
        direction=towards(azimuth, max(steepness(terrain.field).tangent, 1e-3) * (1 + above))
    )
    plan, short, full = both(terrain, direction_enu(77.0, 50.0), view)
    assert not plan.occlusion.modelled
    same(short, full)


def camera_at(terrain, azimuth_deg, away_m, tangent):
    """A camera that the lowest of the core's nodes' rays reaches under a tangent."""
    x, y = (
        away_m * math.sin(math.radians(azimuth_deg)),
        away_m * math.cos(math.radians(azimuth_deg)),
    )
    field, (row0, row1, col0, col1) = terrain.field, terrain.core
    row, col = np.mgrid[row0:row1, col0:col1]
    off = np.hypot(field.x0_m + col * GSD - x, field.y0_m - row * GSD - y)
    z = np.nanmax(field.z_m[row0:row1, col0:col1].astype(float) + tangent * off)
    return View(position_m=np.array([x, y, z]))


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
    """A ridge with flanks of one slope: a hair lower and its foot is dark, or hidden."""
    z = np.zeros((9, 40))
    z[:, 19], z[:, 20], z[:, 21] = 8.0, 16.0, 8.0
    ray = towards(90.0, 8.0 / GSD * share)
    terrain = make(z)
    for sun, view, effect in (
        (ray, nadir_view(), "cast_shadows"),
        (direction_enu(0.0, 89.0), View(direction=ray), "occlusion"),
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
    plan = plan_scene(terrain, low, View(direction=low), accuracy=accuracy)
    assert plan.cast_shadows.error_bound == plan.occlusion.error_bound == accuracy.node_error
    assert tier in plan.cast_shadows.reason
    near = plan_scene(terrain, low, View(position_m=np.array([0, 500.0, 90.0])), accuracy=accuracy)
    assert near.occlusion.modelled
    assert near.occlusion.error_bound == 0.0
    camera = looking_camera(terrain.frame, [0, 0, 3000.0], GSD, (300.0, 300.0))
    pixels = plan_scene(terrain, low, camera_view(camera, terrain.frame), True, accuracy=accuracy)
    for decision in (pixels.cast_shadows, pixels.occlusion, pixels.perspective):
        assert decision.modelled
        assert decision.error_bound == 0.0


# ---- perspective


def farthest_within(terrain, direction, tolerance):
    """Distance at which the bound on parallel rays just falls below a tolerance; inf for none."""

    found = relief(terrain)

    def cost(distance):
        view = View(position_m=distance * direction)
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
    view = View(position_m=1.001 * distance * direction)
    to_sun = direction_enu(*sun)
    plan, full_plan = (
        plan_scene(terrain, to_sun, view, accuracy=accuracy, everything=e) for e in (False, True)
    )
    assert not plan.perspective.modelled
    assert not plan.occlusion.modelled
    assert full_plan.perspective.modelled
    assert 0.9 * accuracy.tolerance < plan.perspective.error_bound <= accuracy.tolerance
    short, full = (
        render_enu(
            terrain, to_sun, view, accuracy=REFERENCE, model=reflectance_model(model), plan=p
        )
        for p in (plan, full_plan)
    )
    assert relative_change(short, full) <= plan.perspective.error_bound
    same(short, full, ("sunlit", "visible", "incidence_deg"))
    for band in ("emission_deg", "phase_deg"):
        turned = np.abs(getattr(short, band).astype(np.float64) - getattr(full, band))
        assert np.radians(np.nanmax(turned, initial=0.0)) <= plan.perspective.error_bound
    nearer = View(position_m=0.98 * distance * direction)
    assert plan_scene(terrain, to_sun, nearer, accuracy=accuracy).perspective.modelled
    assert plan_scene(terrain, to_sun, view).perspective.modelled  # reference: nothing is given up


def test_the_bound_on_parallel_rays_is_nearly_reached():
    """Saw teeth, one flank of which leans away from a camera just over it, in grazing light."""
    slope, col = 0.3, np.mgrid[0:5, 0:73][1]
    terrain = make(slope * GSD * np.abs((col % 12) - 6.0), core=(2, 3, 1, 72))
    flank = math.degrees(math.atan(slope))
    direction, sun = direction_enu(270.0, flank + 2.0), direction_enu(270.0, flank + 0.01)
    distance = farthest_within(terrain, direction, DRAFT.tolerance)
    view = View(position_m=1.001 * distance * direction)
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
    view = View(position_m=position)
    least = lowest_core_tangent(view, terrain)
    if least > 0:
        assert tangent_of(parallel_direction(found.box, view)) >= least - 1e-9 * abs(least)


def test_a_corners_normal_is_steeper_than_any_facet():
    """Its differences east and south belong to two facets."""
    z = np.array([[0.0, 8, 8], [8, 8, 8], [8, 8, 8]])
    found = relief(make(z))
    assert found.slope.tangent == pytest.approx(8 / GSD)
    east, _, up = make(z).field.normals()[0, 0]
    assert abs(east / up) == pytest.approx(8 / GSD)
    assert found.node_tangent == pytest.approx(8 / GSD * math.sqrt(2))
    inner = make(np.pad(z, 1, mode="edge"), core=(1, 4, 1, 4))
    assert relief(inner).node_tangent == relief(inner).slope.tangent


def test_holes_have_everything_modelled():
    """A step across a gap is no facet: nothing can be ruled out."""
    z = np.zeros((20, 20))
    z[:, 12:] = 500.0
    z[:, 10:12] = np.nan
    terrain, far = make(z), View(position_m=direction_enu(30.0, 89.0) * 1e9)
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
    view = View(position_m=rng.normal(size=3) * [300.0, 300.0, 900.0])
    angle = ray_angle_rad(box, view)
    inside = box.low_m + rng.random((200, 3)) * (box.high_m - box.low_m)
    cosines = view.directions(inside) @ parallel_direction(box, view)
    assert np.arccos(np.clip(cosines, -1, 1)).max() <= angle + 1e-7


# ---- the disc


def rim(sun, times=1.0, count=256):
    """Directions around the disc, its radius stretched."""
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
    plan, short, full = both(terrain, sun, nadir_view(), disc=True)
    assert not plan.solar_disc.modelled
    assert not plan.cast_shadows.modelled
    assert plan.solar_disc.error_bound == 0.0
    same(short, full)
    for direction in rim(sun, count=16):
        assert not terrain.field.occluded_nodes(direction, terrain.core).any()
    tangent = steepness(terrain.field).tangent
    lower = direction_enu(azimuth, math.degrees(math.atan(tangent) + 0.999 * SOLAR_RADIUS_RAD))
    decided = plan_scene(terrain, lower, nadir_view(), disc=True)
    if tangent > 1e-3:
        assert decided.solar_disc.modelled
        assert decided.cast_shadows.modelled


def test_the_discs_lower_limb_is_where_it_begins():
    z = np.zeros((9, 40))
    z[:, 19], z[:, 20], z[:, 21] = 8.0, 16.0, 8.0
    terrain, flank = make(z), math.degrees(math.atan(8.0 / GSD))
    for above_deg, cut in ((0.2, True), (0.3, False)):  # a radius of 0.267 deg
        sun = direction_enu(90.0, flank + above_deg)
        plan, short, full = both(terrain, sun, nadir_view(), disc=True)
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
    """On level ground behind a wall: what a point Sun gets wrong lies within the stated width."""
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
    plan, short, full = both(terrain, sun, nadir_view(), accuracy, disc=True)
    assert stated == pytest.approx(float(height) * (cot[0] - cot[2]) / GSD, rel=1e-9)
    assert plan.solar_disc.modelled == (stated > PENUMBRA_PX)
    differ = np.abs(short.sunlit - full.sunlit)
    assert differ.max() <= plan.solar_disc.error_bound
    off = np.abs((width - 3) - np.arange(width) - edge)
    assert differ[2][off > stated].max(initial=0.0) < 1e-6  # the disc's flux is a sum of strips
    exact = plan_scene(terrain, sun, nadir_view(), accuracy=TIERS["high"], disc=True)
    assert exact.solar_disc.modelled


@settings(deadline=None, max_examples=25)
@given(
    terrain=terrains(smallest=3, holes=True),
    azimuth=AZIMUTHS,
    elevation=st.sampled_from([0.1, 3.0, 25.0, 60.0]),
)
def test_a_point_sun_is_wrong_only_where_the_disc_is_cut(terrain, azimuth, elevation):
    """Nodes that see all of a slightly larger disc's rim, or nothing of it, are exact."""
    sun = direction_enu(azimuth, elevation)
    plan = plan_scene(terrain, sun, nadir_view())
    assert not plan.solar_disc.modelled
    point, disc = (render_enu(terrain, sun, nadir_view(), disc=d).sunlit for d in (False, True))
    blocked = sum(terrain.field.occluded_nodes(d, terrain.core).astype(int) for d in rim(sun, 1.05))
    sure = (blocked == 0) | (blocked == 256)
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
            return render_enu(terrain, sun, nadir_view(), disc=disc, accuracy=accuracy)
        return render_camera(terrain, camera, sun, disc=disc, accuracy=accuracy)

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
            render_enu(terrain, direction_enu(10.0, elevation), nadir_view(), disc=disc)
            continue
        with pytest.raises(SunError, match="below the horizon"):
            render_enu(terrain, direction_enu(10.0, elevation), nadir_view(), disc=disc)


@pytest.mark.parametrize("incidence", [0.0, 30.0, 80.0, 89.7, 89.9, 90.0, 90.2, 91.0])
@pytest.mark.parametrize(("name", "scale"), [("lambert", 0.12), ("lommel-seeliger", 0.0525)])
def test_a_grazed_facet_is_dark_within_the_bound(incidence, name, scale):
    """The radiance factor of the disc's middle against the mean over the disc: docs/scene-plan.md."""
    sun = direction_enu(0.0, 90.0 - incidence)
    rings = [rim(sun, r, 64) for r in np.sqrt((np.arange(16) + 0.5) / 16)]
    up = np.array([[0.0, 0.0, 1.0]])

    def radiance(to_sun, mu):
        camera = np.array([math.sqrt(1.0 - mu * mu), 0.0, mu])
        return radiance_under(up, to_sun, camera, np.array([True]), reflectance_model(name))[0]

    for mu in (1.0, 0.3, 0.05):
        mean = np.mean([radiance(point, mu) for point in np.concatenate(rings)])
        middle = radiance(sun, mu)
        steep = 1.0 if name == "lambert" else 1.0 / mu
        assert abs(mean - middle) <= scale * math.sin(SOLAR_RADIUS_RAD) * steep


# ---- beyond the area


@QUICK
@given(seed=st.integers(0, 2**32 - 1), distance=st.floats(1e3, 3e5), half=st.floats(1e2, 1e5))
def test_nothing_beyond_stands_higher_than_the_bound(seed, distance, half):
    """Random nodes of an area and random ground beyond, as points of the sphere's frame."""
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
    """The highest ground of all just beyond a capped ring: above its bound it shadows nothing."""
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
        short, full = (render_enu(t, sun, nadir_view()).sunlit for t in (area, everything))
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


@settings(deadline=None, max_examples=40)
@given(
    terrain=terrains(holes=True),
    sun=st.tuples(AZIMUTHS, st.sampled_from([0.0, 1e-6, 0.1, 45.0, 89.9, 90.0])),
    where=st.sampled_from(["ground", "far", "zenith", "oblique", "node"]),
    tier=st.sampled_from(list(TIERS)),
    disc=st.booleans(),
)
def test_the_ends_of_the_world(terrain, sun, where, tier, disc):
    """Whatever the scene: a plan that is JSON, a render that is whole, and what is said to be the
    same is.
    """
    field, accuracy = terrain.field, TIERS[tier]
    row, col = terrain.core[0], terrain.core[2]
    ground = float(field.z_m[row, col])
    ground = ground if math.isfinite(ground) else float(field.extremes_m[1])
    assume(math.isfinite(ground))
    here = np.array([field.x0_m + col * GSD, field.y0_m - row * GSD, ground])
    view = {
        "ground": View(position_m=here + np.array([0, 0, 1.0])),
        "node": View(position_m=here),
        "far": View(position_m=direction_enu(30.0, 50.0) * 1e9),
        "zenith": nadir_view(),
        "oblique": oblique_view(60.0, 200.0),
    }[where]
    to_sun = direction_enu(*sun)
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
    """The cheaper one where an effect is off, the fuller one where it is on."""
    from lcp_catalog import render

    called = []
    for name in ("occluded", "sunlit_share", "_hidden", "parallel_view"):
        original = getattr(render, name)
        monkeypatch.setattr(
            render, name, lambda *a, n=name, f=original, **k: (called.append(n), f(*a, **k))[1]
        )
    flat, rough = make(np.zeros((9, 9))), make(np.random.default_rng(1).normal(size=(9, 9)) * 30)
    sun, far = direction_enu(80.0, 20.0), View(position_m=direction_enu(30.0, 50.0) * 1e9)
    for terrain, disc, expected in (
        (flat, True, ["parallel_view"]),
        (rough, False, ["occluded", "_hidden"]),
        (rough, True, ["sunlit_share", "_hidden"]),
    ):
        called.clear()
        render_enu(terrain, sun, far, accuracy=STANDARD, disc=disc)
        assert called == expected


# ---- builds


def test_a_builds_decisions_are_the_renders():
    config = BuildConfig(
        sun=SunConfig(elevations_deg=(5.0, 30.0)),
        view=ViewConfig((0.0, 40.0), (0.0, 90.0), (math.inf, 100.0)),
    )
    found = {d["effect"]: d for d in decisions(config, 20.0, 26.0)}
    json.dumps(found, allow_nan=False)
    rough = make(np.random.default_rng(1).normal(size=(9, 9)) * 30)
    plan = plan_scene(rough, direction_enu(0, 5.0), oblique_view(40.0, 90.0), accuracy=STANDARD)
    for decision in plan.decisions:
        if decision.effect == "perspective":
            continue
        there = found[decision.effect]
        assert (there["modelled"], there["unit"]) == (decision.modelled, decision.unit)
        # the Sun's parallax and the law's cost are those of a whole build, not of one image
        if decision.effect not in ("parallax of the Sun", "reflectance"):
            assert there["error_bound"] == decision.error_bound
    assert "5.000 deg" in found["cast shadows"]["reason"]
    assert "50.000 deg" in found["occlusion"]["reason"]
    half = 16 * 20.0 * math.sqrt(2)
    assert half / 150e3 < found["perspective"]["error_bound"] < half / 100e3
    nadir = BuildConfig(view=ViewConfig((0.0,), (0.0,), (math.inf,)))
    found = {d["effect"]: d for d in decisions(nadir, 20.0, 26.0)}
    assert not found["occlusion"]["modelled"]
    assert found["perspective"]["error_bound"] == 0.0


def test_the_lower_limb():
    for elevation in (0.0, 0.1, 30.0, 90.0):
        expected = math.tan(math.radians(elevation) - SOLAR_RADIUS_RAD)
        assert limb_tangent(direction_enu(20.0, elevation)) == pytest.approx(expected, rel=1e-9)
