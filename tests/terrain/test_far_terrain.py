"""Far terrain: nested levels against brute force over all their triangles, drafts of its shadows
against exact ones, and the finite solar disc behind it.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from helpers.synthetic import cratered
from helpers.twins import blocking, in_cells, triangles
from helpers.twins_disc import sampled_share
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from lcp_catalog.accuracy import TIERS
from lcp_catalog.geometry.frames import direction_enu
from lcp_catalog.kernels.rays import horizon
from lcp_catalog.light.solar_disc import SolarDisc, sunlit_share
from lcp_catalog.terrain.far_terrain import PLACES, FarTerrain, Footprint, Nodes, _Blocks
from lcp_catalog.terrain.heightfield import Heightfield
from lcp_catalog.terrain.occlusion import occluded, occluded_sweep

GSD = 4.0
CORE = (3, 8, 3, 8)
"""Nodes for which no level has heights: more than a cell inside the finer terrain."""

quick = settings(max_examples=50, deadline=None, suppress_health_check=list(HealthCheck))


def holed(z: np.ndarray, gsd_m: float, half_m: float) -> Heightfield:
    """A square level around the origin, without the nodes more than a cell inside +-half_m."""
    away = (np.arange(len(z)) - len(z) // 2) * gsd_m
    inside = np.abs(away) <= half_m - gsd_m
    z = z.astype(np.float32)
    z[np.ix_(inside, inside)] = np.nan
    return Heightfield(z, gsd_m, away[0], -away[0])


@st.composite
def places(draw) -> tuple[Heightfield, FarTerrain]:
    """11 x 11 nodes with the window `CORE`, and two levels around: noise, ties or spikes, some with
    nodata.
    """
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    kind, scale = draw(st.sampled_from(["noise", "ties", "spikes"])), draw(st.floats(0.5, 8.0))

    def heights(size: int) -> np.ndarray:
        if kind == "ties":
            return rng.integers(-2, 3, (size, size)).astype(float)
        z = rng.normal(size=(size, size)) * scale
        if kind == "spikes":
            z.flat[rng.integers(0, z.size, 2)] += 60.0
        return z

    z = heights(11)
    levels = [holed(heights(13), 2 * GSD, 5 * GSD), holed(heights(13), 4 * GSD, 12 * GSD)]
    if draw(st.booleans()):
        z[rng.random(z.shape) < 0.2] = np.nan
        for level in levels:
            level.z_m[rng.random(level.shape) < 0.1] = np.nan
    return Heightfield(z, GSD, -5 * GSD, 5 * GSD), FarTerrain(tuple(levels))


azimuths = st.builds(lambda k, off: 45.0 * k + off, st.integers(0, 7), st.floats(0.01, 44.99))
"""Directions off the grid's lines and diagonals: along these a float direction misses nodes by
1e-16, and the reference and the kernel differ beside nodata (rules of the kernels:
test_heightfield_occluded.py).
"""

elevations = st.sampled_from([0.0, 1.0, -5.0, 30.0]) | st.floats(-30, 60)


def core(field: Heightfield) -> np.ndarray:
    return field.z_m[CORE[0] : CORE[1], CORE[2] : CORE[3]]


def judged(field: Heightfield, far: FarTerrain, direction: np.ndarray) -> np.ndarray:
    """Greatest height of the levels' triangles above the ray of each core node, metres."""
    row0, row1, col0, col1 = CORE
    out = np.full((row1 - row0, col1 - col0), -math.inf)
    for level in far.levels:
        corners, ray = triangles(level.z_m), in_cells(direction, level.gsd_m)
        for i, j in np.argwhere(np.isfinite(core(field))):
            u = (field.x0_m + (j + col0) * field.gsd_m - level.x0_m) / level.gsd_m
            v = (level.y0_m - field.y0_m + (i + row0) * field.gsd_m) / level.gsd_m
            start = (u, v, float(core(field)[i, j]))
            out[i, j] = max(out[i, j], blocking(corners, start, ray))
    return out


@quick
@given(places(), azimuths, elevations)
def test_far_shadows_are_those_of_all_triangles(place, azimuth_deg, elevation_deg) -> None:
    field, far = place
    direction = direction_enu(azimuth_deg, elevation_deg)
    margin = judged(field, far, direction)
    alone = occluded(field, direction, TIERS["reference"], CORE)
    for tier in ("high", "reference"):
        found = occluded(field, direction, TIERS[tier], CORE, far)
        decided = np.abs(margin) > 1e-6
        np.testing.assert_array_equal(found[decided], (alone | (margin > 0))[decided])


@quick
@given(places(), azimuths, elevations)
def test_shadows_reach_as_high_as_the_triangles_do(place, azimuth_deg, elevation_deg) -> None:
    """At a place of height 0 the shadow's height is that of the triangles above the ray from there."""
    _, far = place
    direction = direction_enu(azimuth_deg, elevation_deg)
    u, v = (one.ravel() for one in np.meshgrid([5.3, 6.0, 6.9], [5.1, 6.0, 6.7]))
    for level in far.levels:
        du, dv, dz = level.ray_in_cells(direction)
        found = np.full((1, u.size), -1e6)
        z, _, pyramid, summit = level.traced
        horizon.shadow_heights(z, pyramid, summit, u, v, du, dv, np.array([dz]), found)
        corners, ray = triangles(level.z_m), in_cells(direction, level.gsd_m)
        want = [blocking(corners, (a, b, 0.0), ray) for a, b in zip(u, v, strict=True)]
        np.testing.assert_allclose(found[0], np.maximum(want, -1e6), atol=1e-6)


@quick
@given(places(), azimuths)
def test_a_far_horizon_is_where_rays_are_just_free(place, azimuth_deg) -> None:
    field, far = place
    rows, cols = np.nonzero(np.isfinite(core(field)))
    nodes = Nodes(field, rows + CORE[0], cols + CORE[2], far)
    du, dv, _ = field.ray_in_cells(direction_enu(azimuth_deg, 0.0))
    slopes = nodes.horizons(np.array([[du, dv, -1e9, 1e9]]))[:, 0]
    length_m = field.gsd_m * math.hypot(du, dv)
    for k in range(0, len(rows), 5):
        if slopes[k] < -1e8:
            continue  # no terrain ahead
        elevation = math.degrees(math.atan(slopes[k] / length_m))
        for off, dark in ((-1e-4, True), (1e-4, False)):
            ray = direction_enu(azimuth_deg, elevation + off)
            assert nodes[k : k + 1].occluded(ray)[0] == dark


@quick
@given(places(), azimuths, elevations)
def test_a_level_that_is_not_asked_shadows_nothing(place, azimuth_deg, elevation_deg) -> None:
    field, far = place
    direction = direction_enu(azimuth_deg, elevation_deg)
    heights = core(field)[np.isfinite(core(field))]
    if not heights.size:
        return
    side = 3 * GSD
    asked = far.towards(Footprint((-side, side), (-side, side), float(heights.min())), direction)
    for level in far.levels:
        if not any(level is one for one in asked):
            margin = judged(field, FarTerrain((level,)), direction)
            assert margin.max() <= 1e-9


def test_most_levels_are_not_asked_under_a_high_sun() -> None:
    level = holed(np.zeros((13, 13)), 2 * GSD, 3 * GSD)
    far = FarTerrain((level,))
    place = Footprint((-12.0, 12.0), (-12.0, 12.0), 0.0)
    assert far.towards(place, direction_enu(30.0, 10.0)) == ()
    assert far.towards(place, direction_enu(30.0, -10.0)) == (level,)
    assert far.towards(place, np.array([0.0, 0.0, 1.0])) == ()


@pytest.fixture(scope="module")
def highland() -> tuple[Heightfield, FarTerrain]:
    """241 x 241 nodes of a smooth plain, surrounded by ranges on cells twice as wide, which shadow
    most of it.
    """
    z = cratered(1024, seed=5)
    field = Heightfield(0.05 * z[392:633, 392:633], 20.0, -2400.0, 2400.0)
    coarse = 3.0 * z[2::2, 2::2]  # of 511 nodes the middle one is the origin's, (512, 512)
    return field, FarTerrain((holed(coarse, 40.0, 2400.0),))


@pytest.mark.slow
@pytest.mark.parametrize("elevation_deg", [3.0, 6.0, 10.0, 15.0])
def test_tiers_keep_their_shares_of_wrong_nodes(highland, elevation_deg) -> None:
    """docs/explanation/accuracy.md: draft 0.5 %, standard 0.02 %; near and far shadows together."""
    field, far = highland
    window = (20, 221, 20, 221)
    wrong = {"draft": [], "standard": [], "high": []}
    beyond = []
    for azimuth_deg in np.arange(8) * 45.0 + 7.0:
        sun = direction_enu(azimuth_deg, elevation_deg)
        exact = occluded(field, sun, TIERS["reference"], window, far)
        beyond.append((exact & ~occluded(field, sun, TIERS["reference"], window)).mean())
        for tier, shares in wrong.items():
            shares.append((occluded(field, sun, TIERS[tier], window, far) != exact).mean())
    assert np.mean(beyond) > 0.3  # far terrain has an effect
    assert np.mean(wrong["draft"]) < 0.001
    assert np.mean(wrong["standard"]) < 0.0002
    assert max(wrong["high"]) == 0.0


@pytest.mark.parametrize("tier", ["draft", "standard", "high"])
def test_a_sweep_is_its_suns(highland, tier) -> None:
    field, far = highland
    window, elevations = (70, 150, 60, 160), np.radians([3.0, 10.0, 20.0])
    sweep = occluded_sweep(field, 1.0, elevations, TIERS[tier], window, far)
    for mask, elevation in zip(sweep, elevations, strict=True):
        sun = direction_enu(math.degrees(1.0), math.degrees(elevation))
        np.testing.assert_array_equal(mask, occluded(field, sun, TIERS[tier], window, far))


@pytest.mark.slow
@pytest.mark.parametrize("tier", ["standard", "high", "reference"])
def test_a_far_ridge_cuts_the_disc(tier) -> None:
    """A plain, and around it a wall of uneven height on far cells: shares of the disc against 420
    directions of the disc on one field with both.
    """
    rng = np.random.default_rng(3)
    size, half = 81, 40
    r = np.hypot(*(np.indices((size, size)) - half))
    wall = np.where(np.abs(r - 30) < 3, 12.0 + rng.normal(size=(size, size)), 0.0)
    whole = Heightfield(wall, 2 * GSD, -half * 2 * GSD, half * 2 * GSD)
    near = Heightfield(np.zeros((9, 9)), 2 * GSD, -4 * 2 * GSD, 4 * 2 * GSD)
    far = FarTerrain((holed(wall, 2 * GSD, 4 * 2 * GSD),))
    disc = SolarDisc(math.radians(0.8))
    shares = []
    for azimuth_deg in (0.0, 33.0, 245.0):
        sun = direction_enu(azimuth_deg, 2.8)
        found = sunlit_share(near, sun, TIERS[tier], disc=disc, far=far)
        same = sunlit_share(whole, sun, TIERS[tier], (36, 45, 36, 45), disc)
        np.testing.assert_allclose(found, same, atol=1e-6)
        want = sampled_share(whole, sun, disc.radius_rad, 20, (36, 45, 36, 45))
        if (
            tier != "standard"
        ):  # three strips are coarser than this wall (docs/measurements/accuracy.md)
            np.testing.assert_allclose(found, want, atol=0.012)
        shares.append(want)
    assert 0.05 < np.mean(shares) < 0.95


def test_a_flat_field_is_shadowed_by_far_terrain_alone() -> None:
    """The field itself does not shadow its nodes; the terrain beyond does."""
    near = Heightfield(np.zeros((5, 5)), GSD, -8.0, 8.0)
    z = np.zeros((21, 21))
    z[:, 18:] = 40.0
    far = FarTerrain((holed(z, 2 * GSD, 8.0),))
    sun = direction_enu(90.0, 20.0)
    assert not occluded(near, sun, TIERS["reference"]).any()
    for tier in TIERS.values():
        assert occluded(near, sun, tier, far=far).all()
        assert (sunlit_share(near, sun, tier, far=far) == 0.0).all()
        assert (sunlit_share(near, direction_enu(270.0, 20.0), tier, far=far) == 1.0).all()


@pytest.mark.parametrize("shape", [(5, 300), (129, 129), (200, 65)])
def test_every_node_of_a_block_has_its_four_places(shape) -> None:
    """Places around the nodes of the chosen blocks, also those on a block's far edge, the first of
    the next block.
    """
    field = Heightfield(np.zeros(shape), GSD)
    blocks = _Blocks(field, (0, shape[0], 0, shape[1]), np.zeros(shape, np.bool_))
    rng = np.random.default_rng(4)
    for _ in range(20):
        which = rng.random(blocks.shape) < 0.4
        there, nodes = blocks.at_places(which), blocks.spread(which)
        assert nodes.shape == shape
        i, j = np.nonzero(nodes)
        a = np.minimum(i // PLACES, there.shape[0] - 2)
        b = np.minimum(j // PLACES, there.shape[1] - 2)
        for corner in (there[a, b], there[a + 1, b], there[a, b + 1], there[a + 1, b + 1]):
            assert corner.all()
