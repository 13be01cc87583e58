"""Intersections of rays with the sphere, compared with 60-digit arithmetic."""

import math

import mpmath
import numpy as np
import pytest
from helpers.twins_sphere import exact_miss, exact_range, naive_ranges
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from lcp_catalog.constants import MOON_RADIUS_M
from lcp_catalog.geometry import sphere_intersection
from lcp_catalog.geometry.frames import lonlat_to_mcmf

R = MOON_RADIUS_M
RANGE_ERROR = 2e-15
"""Relative; the issue asks for 1e-12."""


def unit(v):
    v = np.asarray(v, dtype=float)
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def ray(height, angle, rng):
    """A start at a height over a random place and a direction at an angle from the nadir."""
    up = unit(rng.normal(size=3))
    side = unit(np.cross(up, rng.normal(size=3)))
    return up * (R + height), -math.cos(angle) * up + math.sin(angle) * side


def seen_radius(height):
    return math.asin(min(1.0, R / (R + height)))


def relative_error(position, direction):
    """Of our range; inf where one of us sees sky and the other does not."""
    ours, true = (
        float(sphere_intersection.ranges(position, direction)),
        exact_range(position, direction),
    )
    if true is None or math.isnan(ours):
        return 0.0 if true is None and math.isnan(ours) else math.inf
    if true == 0:
        return abs(ours)
    return float(abs((mpmath.mpf(ours) - true) / true))


@pytest.mark.parametrize("exponent", range(0, 10))
def test_ranges_from_a_metre_to_a_million_kilometres(exponent):
    """Random, and ever nearer to the limb from either side."""
    rng = np.random.default_rng(exponent)
    for k in range(60):
        height = 10.0 ** (exponent + rng.random())
        angle = seen_radius(height)
        angle *= (
            rng.random() if k % 3 == 0 else 1.0 + rng.choice([-1, 1]) * 10 ** -rng.uniform(1, 16)
        )
        assert relative_error(*ray(height, angle, rng)) < RANGE_ERROR


def test_ranges_from_inside():
    rng = np.random.default_rng(7)
    for _ in range(200):
        depth = R * rng.random() if rng.random() < 0.5 else 10.0 ** rng.uniform(-3, 4)
        angle = math.pi * rng.random()
        if rng.random() < 0.5:
            angle = math.pi / 2 + rng.choice([-1, 1]) * 10.0 ** rng.uniform(-12, 0)
        assert relative_error(*ray(-depth, angle, rng)) < RANGE_ERROR


numbers = st.floats(-1.0, 1.0, allow_subnormal=False)
vectors = st.tuples(numbers, numbers, numbers).filter(lambda v: np.linalg.norm(v) > 1e-3)


@settings(max_examples=200, deadline=None)
@given(vectors, vectors, st.floats(-9.0, 9.0), st.booleans(), st.floats(-60.0, 60.0))
@example((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), 0.0, False, 0.0)
@example((1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), 9.0, False, 0.0)
@example((1.0, 0.0, 0.0), (1.0, 0.0, 0.0), -9.0, True, 0.0)
def test_any_ray_of_any_length(up, direction, log_height, inside, log_length):
    height = 10.0**log_height * (-1.0 if inside else 1.0)
    assume(height > -R)
    position = unit(up) * (R + height)
    assert relative_error(position, np.array(direction) * 10.0**log_length) < RANGE_ERROR


@settings(max_examples=200, deadline=None)
@given(vectors, vectors, st.floats(0.0, 9.0), st.floats(-15.0, -3.0), st.booleans())
def test_sky_is_what_passes_outside(up, side, log_height, log_off, outside):
    """A ray aimed a share of the radius off the limb: a miss or a hit as with 60 digits, whatever that
    share is (asked: beyond 1e-9).
    """
    up = unit(up)
    across = np.cross(up, side)
    assume(np.linalg.norm(across) > 1e-3)
    position = up * (R + 10.0**log_height)
    sine = R / np.linalg.norm(position) * (1.0 + 10.0**log_off * (1 if outside else -1))
    assume(sine < 1.0)
    direction = -math.sqrt(1.0 - sine * sine) * up + sine * unit(across)
    miss = exact_miss(position, direction)
    assert np.isnan(sphere_intersection.ranges(position, direction)) == bool(miss > 0)


def test_the_textbook_formula_fails_where_ours_does_not():
    """So that the tests above are known to ask for something: the paper's own discriminant."""
    rng = np.random.default_rng(3)
    rays = []
    for _ in range(100):
        height = 10.0 ** rng.uniform(0, 2)
        rays.append(ray(height, seen_radius(height) * (1.0 - 10.0 ** rng.uniform(-14, -6)), rng))
    worst = 0.0
    for position, direction in rays:
        true, found = exact_range(position, direction), float(naive_ranges(position, direction))
        if true is not None and math.isfinite(found):
            worst = max(worst, float(abs(found - true) / true))
        assert relative_error(position, direction) < RANGE_ERROR
    assert worst > 1e-7


def test_on_the_sphere_itself():
    on = np.array([R, 0.0, 0.0])
    assert sphere_intersection.ranges(on, [-1.0, 0.0, 0.0]) == 0.0
    assert np.isnan(sphere_intersection.ranges(on, [1.0, 0.0, 0.0]))
    assert np.isnan(sphere_intersection.ranges(on, [0.0, 1.0, 0.0]))
    assert float(sphere_intersection.heights(on)) == 0.0
    assert sphere_intersection.limb_angle(on) == pytest.approx(math.pi / 2)


def test_spheres_whose_radius_has_a_long_square():
    """R^2 = 1737400^2 is a float64; that of other radii is not, and a camera 1 m up sees it."""
    rng = np.random.default_rng(12)
    for _ in range(60):
        radius = 10.0 ** rng.uniform(0, 8)
        position = unit(rng.normal(size=3)) * (radius * (1.0 + 1e-6 * rng.random()))
        direction = -position / radius + 0.9 * unit(rng.normal(size=3))
        true = exact_range(position, direction, radius)
        found = sphere_intersection.ranges(position, direction, radius)
        assert np.isnan(found) == (true is None)
        if true is not None:
            assert abs(float((mpmath.mpf(float(found)) - true) / true)) < RANGE_ERROR


def test_a_tangent_ray_touches():
    """(R, R, 0) looks along -y: it meets the sphere in (R, 0, 0), where both roots are one."""
    assert sphere_intersection.ranges([R, R, 0.0], [0.0, -2.0, 0.0]) == R


def test_heights_are_exact():
    rng = np.random.default_rng(2)
    for _ in range(100):
        p = unit(rng.normal(size=3)) * (R + rng.choice([-1, 1]) * 10.0 ** rng.uniform(-8, 6))
        with mpmath.workdps(60):
            true = mpmath.sqrt(sum(mpmath.mpf(float(x)) ** 2 for x in p)) - mpmath.mpf(R)
        assert float(sphere_intersection.heights(p)) == pytest.approx(
            float(true), rel=1e-15, abs=0.0
        )


def test_limb_angle_of_low_cameras():
    """asin(R / |p|) of a camera 1 m up is good to 1e-8 only."""
    for away in (R + 0.0137, R + 1.37, R + 1234.567, R + 1.01e9):
        with mpmath.workdps(40):
            true = mpmath.asin(mpmath.mpf(R) / mpmath.mpf(away))
        found = sphere_intersection.limb_angle(np.array([0.0, away, 0.0]))
        assert found == pytest.approx(float(true), rel=1e-15, abs=0.0)
    with pytest.raises(ValueError, match="no limb"):
        sphere_intersection.limb_angle(np.array([0.0, R - 1.0, 0.0]))


def test_hits_and_their_places():
    """Rays aimed at known places come back as those, to the rounding of the camera's own
    coordinates, drawn out where the ray grazes.
    """
    rng = np.random.default_rng(5)
    lon, lat = rng.uniform(0, 360, 400), np.degrees(np.arcsin(rng.uniform(-1, 1, 400)))
    places = lonlat_to_mcmf(lon, lat)
    for distance, good_m in ((1e6, 2e-9), (1e9, 5e-7)):
        camera = unit([1.0, 2.0, -1.5]) * (R + distance)
        facing = places @ camera > R * R + 1e-3 * R * distance
        found, points = sphere_intersection.hits(camera, places[facing] - camera)
        seen_under = np.sum(points * unit(camera - places[facing]), axis=-1) / R
        assert (np.linalg.norm(points - places[facing], axis=-1) * seen_under).max() < good_m
        assert found == pytest.approx(np.linalg.norm(places[facing] - camera, axis=-1), rel=1e-13)
        back_lon, back_lat = sphere_intersection.lonlat(points)
        assert np.abs(back_lat - lat[facing]).max() < 1e-9
        turn = (back_lon - lon[facing] + 180.0) % 360.0 - 180.0
        assert (np.abs(turn) * np.cos(np.radians(back_lat))).max() < 1e-9
        assert back_lon.min() >= 0.0
        assert back_lon.max() < 360.0


def test_shapes_and_refusals():
    d = np.tile([0.0, 0.0, -1.0], (3, 4, 1))
    p = np.array([0.0, 0.0, 2.0 * R])
    assert (sphere_intersection.ranges(p, d) == R).all()
    assert sphere_intersection.ranges(p, d).shape == (3, 4)
    assert (sphere_intersection.ranges(d * -3.0 * R, d) == 2 * R).all()
    assert sphere_intersection.ranges(p, d[0, 0]).shape == ()
    assert sphere_intersection.ranges(p, d * 1e-300)[0, 0] == R
    assert sphere_intersection.ranges(p, d * 1e300)[0, 0] == R
    assert sphere_intersection.ranges(p, np.zeros((0, 3))).shape == (0,)
    for position, direction in ((p[:2], d), (p, d * 0), (p * np.nan, d), (p, d + np.inf)):
        with pytest.raises(ValueError, match="invalid rays"):
            sphere_intersection.ranges(position, direction)
