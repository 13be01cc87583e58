"""The finite Sun: comparison with straight edges (mpmath), with thousands of directions, and with
rotated and refined scenes.
"""

from __future__ import annotations

import dataclasses
import math
from functools import cache

import mpmath
import numpy as np
import pytest
from helpers.synthetic import cratered
from helpers.twins_disc import LAW, cap_share, ridge_share, sampled_share, towards
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from lcp_catalog.accuracy import TIERS
from lcp_catalog.constants import ASTRONOMICAL_UNIT_M, SOLAR_RADIUS_RAD
from lcp_catalog.ephemeris.limb_darkening import STEPS, VISIBLE, LimbDarkening, strips
from lcp_catalog.light.solar_disc import (
    SolarDisc,
    penumbra_m,
    radius_at,
    share_at_points,
    sunlit_share,
)
from lcp_catalog.terrain.far_terrain import on_rim
from lcp_catalog.terrain.heightfield import Heightfield
from lcp_catalog.threads import limit_threads, thread_limit

DRAFT, STANDARD, HIGH, REFERENCE = (TIERS[t] for t in ("draft", "standard", "high", "reference"))
GSD = 20.0
RADIUS = SOLAR_RADIUS_RAD
quick = settings(max_examples=25, deadline=None, suppress_health_check=list(HealthCheck))


def rms(values: np.ndarray) -> float:
    return math.sqrt(float(np.mean(np.square(values, dtype=np.float64))))


def spiky(size: int = 96) -> np.ndarray:
    """Single-node boulders, three to five cells high, on cratered terrain."""
    rng, z = np.random.default_rng(0), cratered(size)
    z.flat[rng.integers(0, z.size, z.size // 200)] += rng.choice(
        [60.0, 100.0, -40.0], z.size // 200
    )
    return z


def holed(size: int = 96) -> np.ndarray:
    rng, z = np.random.default_rng(1), cratered(size, seed=5)
    z[20:31, 40:57] = np.nan
    z[rng.random(z.shape) < 0.01] = np.nan
    return z


# -- the disc's brightness


@pytest.mark.parametrize("height", [-1.0, -0.93, -0.5, 0.0, 0.3, 0.77, 1.0])
def test_flux_above_a_straight_edge(height) -> None:
    assert VISIBLE.share_above(height) == pytest.approx(float(cap_share(height)), abs=1e-12)


@pytest.mark.parametrize("count", [1, 2, 3, 9, 64])
def test_strips_together_are_the_disc(count) -> None:
    cut, y = strips(VISIBLE, count), np.linspace(-1.0, 1.0, STEPS + 1)
    np.testing.assert_allclose(cut.flux.sum(axis=0), VISIBLE.share_above(y), atol=3e-8)
    np.testing.assert_allclose(cut.flux[:, 0] @ cut.middle, 0.0, atol=1e-12)
    between = 0.5 * (y[1:] + y[:-1])
    linear = 0.5 * (cut.flux[:, 1:] + cut.flux[:, :-1]).sum(axis=0)
    np.testing.assert_allclose(linear, VISIBLE.share_above(between), atol=3e-6)


@pytest.mark.parametrize(("k", "step"), [(0, 1500), (0, 2048), (2, 1000), (2, 3800), (4, 2600)])
def test_a_strip_above_a_height(k, step) -> None:
    """Fifths of the disc, integrated in x and y."""
    left, right, y0 = -1.0 + 0.4 * k, -0.6 + 0.4 * k, -1.0 + 2.0 * step / STEPS
    a, b, c = LAW

    def column(x: mpmath.mpf) -> mpmath.mpf:
        half = mpmath.sqrt(max(1 - x * x, 0))
        if half <= y0:
            return mpmath.mpf(0)
        low = max(y0, -half)

        def light(y: mpmath.mpf) -> mpmath.mpf:
            square = max(half * half - y * y, 0)
            return a + b * mpmath.sqrt(square) + c * square

        return mpmath.quad(light, [low, half])

    edge = math.sqrt(1.0 - y0 * y0)
    places = sorted({left, right, *(p for p in (-edge, edge) if left < p < right)})
    with mpmath.workdps(10):
        expected = float(mpmath.quad(column, places, maxdegree=5)) / VISIBLE.flux
    assert strips(VISIBLE, 5).flux[k, step] == pytest.approx(expected, abs=2e-7)


def test_samples_carry_equal_flux() -> None:
    points = VISIBLE.samples(5000)
    for height in (-0.8, -0.2, 0.4, 0.9):
        share = np.mean(points[:, 1] > height)
        assert share == pytest.approx(float(cap_share(height)), abs=2e-3)


# -- straight ridges


@cache
def ridge() -> Heightfield:
    """A wall along column 20, 30 m above level terrain, 1200 rows long."""
    z = np.zeros((1201, 61))
    z[:, 20] = 30.0
    return Heightfield(z, 1.0)


@pytest.mark.parametrize("col", [50, 23])
@pytest.mark.parametrize("azimuth_deg", [270.0, 250.0, 300.0])
@pytest.mark.parametrize("height", [-0.9, 0.0, 0.5])
def test_a_straight_ridge_cuts_the_disc_in_a_straight_line(azimuth_deg, height, col) -> None:
    """The crest is ``height`` radii above the disc's centre, at elevations of 41 to 45 deg seen
    from column 50, and of 83 to 84 deg from column 23, where vertical planes converge over the
    disc.
    """
    field, radius = ridge(), math.radians(0.6)
    crest = np.array([20.0 - col, 0.0, 30.0])
    turn = math.radians(azimuth_deg - 270.0)
    skyline = math.atan(30.0 / (col - 20.0) * math.cos(turn))
    sun = towards(azimuth_deg, math.degrees(skyline - height * radius))
    expected = ridge_share(crest, np.array([0.0, 1.0, 0.0]), sun, radius)
    window = (600, 601, col, col + 1)
    for tier, bound in ((STANDARD, 0.013), (HIGH, 0.002), (REFERENCE, 1e-4)):
        found = sunlit_share(field, sun, tier, window, SolarDisc(radius))[0, 0]
        assert found == pytest.approx(expected, abs=bound if azimuth_deg != 270.0 else 1e-5)


def test_the_higher_the_sun_the_more_of_it_is_seen() -> None:
    x = np.arange(21.0, 60.0, 0.7)
    points = np.stack([x, np.full(x.size, -600.0), 0.0 * x], axis=-1)
    suns = [towards(262.0, e) for e in np.arange(30.0, 87.9, 0.29)]
    shares = np.array([share_at_points(ridge(), points, sun, STANDARD) for sun in suns])
    assert (np.diff(shares, axis=0) >= -1e-6).all()
    assert shares[0].max() < 1e-6
    assert shares[-1, 4:].min() > 1.0 - 1e-6


def test_on_a_plain_the_horizon_cuts_the_disc() -> None:
    field = Heightfield(np.zeros((60, 60)), 5.0)
    for below in (-1.2, -0.7, 0.0, 0.4, 1.1):
        sun = towards(37.0, -below * math.degrees(RADIUS))
        for tier in TIERS.values():
            share = sunlit_share(field, sun, tier)
            np.testing.assert_allclose(share[1:-1, 1:-1], VISIBLE.share_above(below), atol=1e-5)


# -- terrain against thousands of directions


@pytest.mark.slow
@pytest.mark.parametrize(
    ("make", "azimuth_deg", "elevation_deg"),
    [
        (cratered, 37, 0.3),
        (cratered, 200, 5),
        (spiky, 310, 3),
        (spiky, 80, 86.5),
        (holed, 250, 8),
        (spiky, 80, 89.9),
        (cratered, 37, -0.2),
    ],
)
def test_against_directions_over_the_disc(make, azimuth_deg, elevation_deg) -> None:
    """At twice the Sun's radius; 300 directions leave about 1 % of a step at the edge of a share."""
    z, radius = make(36), 2.0 * RADIUS
    if elevation_deg > 80:  # only walls shade from such a Sun
        z[:, ::9] = z[:, 1::9] + GSD * math.tan(math.radians(elevation_deg))
    field, sun = Heightfield(z, GSD), towards(azimuth_deg, elevation_deg)
    expected = sampled_share(field, sun, radius, 10)
    tier = REFERENCE if elevation_deg < 88 else HIGH  # by 2048 directions, or by 512
    found = sunlit_share(field, sun, tier, disc=SolarDisc(radius))
    mixed = (expected > 0.0) & (expected < 1.0)
    assert mixed.any()
    assert rms((found - expected)[mixed]) < 0.01
    assert abs(found - expected).max() < 0.04
    assert abs(found - expected)[~mixed].max() < 0.01


# -- the tiers


@cache
def scenes() -> list[tuple[Heightfield, np.ndarray, np.ndarray]]:
    """Fields, Suns, and the shares of ``reference``; at low, middle and high Sun."""
    field = Heightfield(cratered(100), GSD)
    low = Heightfield(cratered(100, seed=3, relief_m=0.25), GSD)
    cases = [(field, 37, 0.3), (field, 90, 1), (field, 200, 2), (field, 310, 5), (field, 37, 15)]
    cases += [(low, 37, 0.3), (low, 100, 2)]
    return [(f, s, sunlit_share(f, s, REFERENCE)) for f, *a in cases for s in [towards(*a)]]


def errors(tier) -> list[tuple[float, float]]:
    """Rms error over all nodes, and over those in a penumbra, inside the raster's border."""
    found = []
    for field, sun, exact in scenes():
        inner = exact[1:-1, 1:-1]
        wrong = sunlit_share(field, sun, tier)[1:-1, 1:-1] - inner
        found.append((rms(wrong), rms(wrong[(inner > 1e-6) & (inner < 1.0 - 1e-6)])))
    return found


@pytest.mark.slow
@pytest.mark.parametrize(
    ("tier", "penumbra"), [(STANDARD, 0.005), (HIGH, 0.0006)], ids=["standard", "high"]
)
def test_rms_error_of_a_tier(tier, penumbra) -> None:
    for everywhere, within in errors(tier):
        assert everywhere <= tier.disc_rms
        assert within <= penumbra


def test_rms_error_of_draft() -> None:
    """The error follows from the errors of the draft's shadows."""
    for everywhere, within in errors(DRAFT):
        assert everywhere <= DRAFT.disc_rms
        assert within <= 0.2


@pytest.mark.parametrize(("tier", "fewer"), [(STANDARD, 2), (HIGH, 5)], ids=["standard", "high"])
def test_fewer_strips_break_a_tiers_bound(tier, fewer) -> None:
    coarser = dataclasses.replace(tier, disc_strips=fewer)
    with pytest.raises(AssertionError):
        test_rms_error_of_a_tier(coarser, {"standard": 0.005, "high": 0.0006}[tier.tier])


def nodes_as_points(field: Heightfield) -> np.ndarray:
    rows, cols = np.indices(field.shape)
    x, y = field.x0_m + cols * field.gsd_m, field.y0_m - rows * field.gsd_m
    return np.stack([x, y, field.z_m.astype(float)], axis=-1).reshape(-1, 3)


@quick
@given(
    st.sampled_from(["noise", "spikes", "cratered"]),
    st.integers(0, 1000),
    st.sampled_from([0.0, 90.0, 180.0, 270.0]) | st.floats(0, 360),
    st.floats(-1, 60),
)
@example(
    "cratered", 312, 270.0, 0.0
)  # a node that sees the whole disc: points 0.99994 by nine strips
def test_where_no_penumbra_can_be_there_is_none(kind, seed, azimuth_deg, elevation_deg) -> None:
    """Points always get horizons; nodes are excluded beforehand by the steepest facet. A horizon beside the disc that
    rises with azimuth is above the limb in a part of a strip, though not at its middle, so strips err where nothing is
    hidden: where the two differ, rays to all of the disc say the same as the node.
    """
    rng = np.random.default_rng(seed)
    z = cratered(24, seed=seed) if kind == "cratered" else rng.normal(size=(24, 24)) * 8
    if kind == "spikes":
        z.flat[rng.integers(0, z.size, 9)] += 90.0
    # proved for a surface without an edge: the border is the lowest terrain, so that the end of the
    # raster has no effect
    ramp = np.minimum(np.minimum(np.arange(24), np.arange(24)[::-1]) / 4.0, 1.0)
    z = (z - z.min()) * np.outer(ramp, ramp)
    field, sun = Heightfield(z, GSD, 7.0, 5.0), towards(azimuth_deg, elevation_deg)
    disc = SolarDisc(3.0 * RADIUS)
    beforehand = sunlit_share(field, sun, HIGH, disc=disc)
    points = share_at_points(field, nodes_as_points(field), sun, HIGH, disc).reshape(field.shape)
    # horizons jump along the border: the two outer rows are left out
    inner = (slice(2, -2), slice(2, -2))
    apart = np.abs(beforehand[inner] - points[inner]) > 2e-6
    if apart.any():
        by_rays = sampled_share(field, sun, disc.radius_rad, 24)
        np.testing.assert_allclose(beforehand[inner][apart], by_rays[inner][apart], atol=1e-9)
        assert np.isin(beforehand[inner][apart], (0.0, 1.0)).all()
    rim = on_rim(field, field.whole)  # half of the disc may be beyond the raster: not tested
    np.testing.assert_allclose(beforehand[rim], points[rim], atol=2e-6)


# -- properties


def test_points_between_nodes_follow_the_nodes() -> None:
    """Along a ridge the share depends only on the distance, on nodes and between them."""
    field, sun = ridge(), towards(270.0, 45.0)
    x = np.array([50.0, 49.7, 50.4, 50.0])
    y = np.array([-600.0, -600.3, -599.6, -601.0])
    shares = share_at_points(field, np.stack([x, y, 0.0 * x], axis=-1), sun, HIGH)
    crest = [
        ridge_share(np.array([20.0 - d, 0, 30.0]), np.array([0.0, 1, 0]), sun, RADIUS) for d in x
    ]
    np.testing.assert_allclose(shares, crest, atol=1e-5)


def test_points_below_outside_and_nan() -> None:
    field = Heightfield(np.zeros((9, 9)), 1.0)
    points = [[4, -4, -2.0], [4, -4, 0.0005], [50, 50, 0.0], [math.nan, 0, 0], [4, -4, 10.0]]
    np.testing.assert_allclose(
        share_at_points(field, points, towards(10.0, 0.0), HIGH),
        [0.0, 0.5, 1.0, 1.0, 1.0],
        atol=1e-5,
    )


@pytest.mark.parametrize("tier", [STANDARD, HIGH, REFERENCE], ids=lambda t: t.tier)
def test_a_scene_mirrored_at_its_diagonal_is_lit_alike(tier) -> None:
    """Rows and columns are exchanged (the cells' diagonal remains): east becomes south."""
    z, sun = spiky(64), towards(70.0, 4.0)
    share = sunlit_share(Heightfield(z, GSD), sun, tier)
    mirrored = sunlit_share(Heightfield(z.T, GSD), [-sun[1], -sun[0], sun[2]], tier)
    np.testing.assert_allclose(mirrored.T, share, atol=2e-6)


def test_a_window_is_a_part_of_the_whole() -> None:
    for z in (spiky(64), holed(64)):
        field, sun = Heightfield(z, GSD), towards(20.0, 3.0)
        whole = sunlit_share(field, sun, HIGH)
        part = sunlit_share(field, sun, HIGH, (10, 41, 33, 64))
        np.testing.assert_array_equal(part, whole[10:41, 33:64])


def test_results_do_not_depend_on_threads() -> None:
    field, sun = Heightfield(spiky(), GSD), towards(20.0, 3.0)
    for tier in TIERS.values():
        answers = []
        for threads in (1, thread_limit()):
            with limit_threads(threads):
                answers.append(sunlit_share(field, sun, tier))
        np.testing.assert_array_equal(*answers)


def test_nodata_and_single_rows_are_fully_lit() -> None:
    z = holed(64)
    for elevation_deg, tier in ((-0.1, REFERENCE), (2.0, HIGH), (89.0, STANDARD)):
        share = sunlit_share(Heightfield(z, GSD), towards(20.0, elevation_deg), tier)
        assert (share[np.isnan(z)] == 1.0).all()
        assert np.isfinite(share).all()
    line = Heightfield(np.array([[0.0, 9.0, 0.0]]), 1.0)
    np.testing.assert_array_equal(sunlit_share(line, towards(90.0, 1.0), HIGH), 1.0)
    empty = sunlit_share(Heightfield(z, GSD), towards(20.0, 2.0), HIGH, (5, 5, 0, 64))
    assert empty.shape == (0, 64)


def test_a_sun_overhead_and_one_underfoot() -> None:
    field = Heightfield(cratered(12), GSD)
    for tier in TIERS.values():
        np.testing.assert_array_equal(sunlit_share(field, [0.0, 0.0, 1.0], tier), 1.0)
    for tier in (DRAFT, STANDARD):
        below = sunlit_share(field, [0.0, 0.0, -1.0], tier)
        np.testing.assert_array_equal(below[2:-2, 2:-2], 0.0)


def test_invalid_suns() -> None:
    field = Heightfield(np.zeros((4, 4)), 1.0)
    for direction in ([0.0, 0.0, 0.0], [math.nan, 0.0, 1.0]):
        with pytest.raises(ValueError, match="no such direction"):
            sunlit_share(field, direction, HIGH)
    with pytest.raises(ValueError, match="radius"):
        SolarDisc(0.0)


# -- sizes


def test_radius_follows_distance() -> None:
    assert radius_at(ASTRONOMICAL_UNIT_M) == pytest.approx(RADIUS, rel=1e-15)
    assert math.degrees(radius_at(0.9833 * ASTRONOMICAL_UNIT_M)) == pytest.approx(0.2711, abs=1e-4)
    with pytest.raises(ValueError, match="invalid distance"):
        radius_at(1e6)


@pytest.mark.parametrize("elevation_deg", [0.5, 3.7, 20.0, 45.0])
def test_a_penumbras_width_is_that_of_the_limbs_shadows(elevation_deg) -> None:
    e, r, distance = (mpmath.radians(elevation_deg), mpmath.mpf(RADIUS), 1234)
    height = distance * mpmath.tan(e)
    expected = height * (mpmath.cot(e - r) - mpmath.cot(e + r))
    assert penumbra_m(distance, math.radians(elevation_deg)) == pytest.approx(
        float(expected), rel=1e-9
    )


def test_an_infinite_penumbra() -> None:
    assert np.isinf(penumbra_m([1.0, 2.0], 0.5 * RADIUS)).all()


def test_a_disc_without_limb_darkening_is_flat() -> None:
    flat = LimbDarkening(1.0, 0.0, 0.0)
    assert flat.share_above(0.5) == pytest.approx(
        (math.acos(0.5) - 0.5 * math.sqrt(0.75)) / math.pi
    )
