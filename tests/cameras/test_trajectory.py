"""Positions and attitudes from tables, compared with scipy's splines and rotations."""

import numpy as np
import pytest
from scipy.interpolate import BarycentricInterpolator, CubicHermiteSpline
from scipy.spatial.transform import Rotation, Slerp

from lcp_catalog.approximations import APPROXIMATIONS
from lcp_catalog.cameras.trajectory import Attitude, Track, Trajectory

TIMES = np.array([-3.0, -1.5, -1.0, 0.2, 1.0, 2.5, 2.75, 3.0, 4.0, 5.0, 6.5])
QUERIES = np.concatenate([TIMES, np.linspace(-3.0, 6.5, 101)])


def orbit(times):
    """A circular orbit of 1787 km in 7000 s, and its velocity."""
    rate = 2 * np.pi / 7000.0
    a = rate * np.asarray(times)
    where = 1787e3 * np.stack([np.cos(a), np.sin(a), 0.3 * np.sin(2 * a)], -1)
    speed = 1787e3 * rate * np.stack([-np.sin(a), np.cos(a), 0.6 * np.cos(2 * a)], -1)
    return where, speed


def table(n=11, seed=1):
    turns = Rotation.from_rotvec(
        np.cumsum(np.random.default_rng(seed).normal(size=(n, 3)) * 0.2, axis=0)
    )
    return turns, turns.as_quat()[:, [3, 0, 1, 2]]


def test_positions_with_velocities_are_hermites():
    track = Track(TIMES, *orbit(TIMES))
    expected = CubicHermiteSpline(TIMES, *orbit(TIMES))(QUERIES)
    assert np.abs(track.at(QUERIES) - expected).max() < 1e-8
    # the error of a cubic over a step h is h^4 / 384 of the fourth derivative: 1.5 s, r (2 pi / T)^4
    assert np.abs(track.at(QUERIES) - orbit(QUERIES)[0]).max() < 1.5**4 / 384 * 1787e3 * 10e-12


def test_positions_alone_are_lagranges_through_eight():
    where = np.random.default_rng(5).normal(size=(len(TIMES), 3))  # rough: every node matters
    track = Track(TIMES, where)
    for t in (-2.0, -1.2, 0.7, 2.6, 5.9):
        after = np.searchsorted(TIMES, t, side="right")
        first = min(max(after - 4, 0), len(TIMES) - 8)
        nodes = slice(first, first + 8)
        expected = BarycentricInterpolator(TIMES[nodes], where[nodes])(t)
        assert np.abs(track.at(np.array([t]))[0] - expected).max() < 1e-11
    track = Track(TIMES, orbit(TIMES)[0])
    # the remainder is rounding: 2.3e-10 m at 1787 km, times the weights of uneven times
    assert np.abs(track.at(QUERIES) - orbit(QUERIES)[0]).max() < 1e-7


def test_few_positions_are_a_polynomial_through_all():
    times = np.array([0.0, 1.0, 3.0])
    track = Track(times, np.stack([times**2, times, 1.0 - times], -1))
    assert track.at(np.array([2.0]))[0] == pytest.approx([4.0, 2.0, -1.0], abs=1e-14)


def test_beyond_the_table_the_last_speed_goes_on():
    where, speed = orbit(TIMES)
    ends = np.array([TIMES[0] - 2.0, TIMES[-1] + 3.0])
    expected = np.stack([where[0] - 2.0 * speed[0], where[-1] + 3.0 * speed[-1]])
    assert Track(TIMES, where, speed).at(ends) == pytest.approx(expected, abs=1e-8)
    alone = Track(
        np.array([0.0, 2.0, 3.0]), np.array([[0.0, 0, 0], [4.0, 2.0, 0], [9.0, 2.0, 1.0]])
    )
    expected = np.array([[-2.0, -1, 0], [14.0, 2, 2]])
    assert alone.at(np.array([-1.0, 4.0])) == pytest.approx(expected, abs=1e-14)


def test_one_position_moves_with_its_velocity_or_stays():
    one, place, speed = np.zeros(1), np.array([[1.0, 2, 3]]), np.array([[1.0, 0, -1]])
    assert Track(one, place, speed).at(np.array([2.0]))[0] == pytest.approx([3.0, 2, 1])
    assert Track(one, place).at(np.array([2.0]))[0] == pytest.approx([1.0, 2, 3])


def test_rotations_turn_at_a_constant_rate_between_times():
    turns, quaternions = table()
    after = Rotation.from_rotvec([0.3, -0.2, 0.9])
    signs = np.where(np.arange(11) % 3 == 0, -1.0, 1.0)[:, None]
    found = Attitude.of_table(TIMES, signs * quaternions, after.as_matrix()).at(QUERIES)
    expected = after * Slerp(TIMES, turns)(QUERIES)
    there = Rotation.from_quat(found[:, [1, 2, 3, 0]])
    assert (there * expected.inv()).magnitude().max() < 1e-13


def test_what_lies_between_rows_is_as_stated():
    """A rate that changes by 0.001 deg/s in a second, about one axis, rows 10 s apart."""
    turn = np.radians(0.5 * 0.001 * np.array([0.0, 10.0]) ** 2 + 0.2 * np.array([0.0, 10.0]))
    found = Attitude(np.array([0.0, 10.0]), _about_x(turn)).at(np.linspace(0.0, 10.0, 101))
    times = np.linspace(0.0, 10.0, 101)
    exact = np.radians(0.5 * 0.001 * times**2 + 0.2 * times)
    off = np.degrees(2.0 * np.arctan2(found[:, 1], found[:, 0]) - exact)
    name = "motion of a camera between rows of its table"
    stated = next(one for one in APPROXIMATIONS if one.name == name).error
    assert np.abs(off).max() == pytest.approx(stated.value, rel=1e-6)


def _about_x(turn):
    return np.stack([np.cos(turn / 2.0), np.sin(turn / 2.0), 0.0 * turn, 0.0 * turn], axis=-1)


def test_camera_axes_of_a_trajectory():
    """Camera axes: from body-fixed to inertial axes, then to those of the camera, then the
    correction.
    """
    body, bodies = table(seed=2)
    pointing, pointings = table(seed=3)
    where, speed = orbit(TIMES)
    eye = np.eye(3)
    there = Trajectory(
        Track(TIMES, where, speed),
        Attitude.of_table(TIMES, bodies, eye),
        Attitude.of_table(TIMES, pointings, eye),
    )
    points = np.random.default_rng(0).normal(size=(len(QUERIES), 3)) * 1.7e6
    b, p = Slerp(TIMES, body)(QUERIES), Slerp(TIMES, pointing)(QUERIES)
    at = b.apply(CubicHermiteSpline(TIMES, where, speed)(QUERIES))
    seen = (p * b.inv()).apply(points - at)
    assert np.abs(there.positions(QUERIES) - at).max() < 1e-7
    assert np.abs(there.to_camera(QUERIES, points) - seen).max() < 1e-6
    assert np.abs(there.to_mcmf(QUERIES, seen) - (points - at)).max() < 1e-6

    shift, turn = np.array([100.0, -50.0, 20.0]), np.array([1e-2, -2e-2, 3e-2])
    moved = there.moved(np.concatenate([shift, turn])).moved(np.concatenate([shift, 0 * turn]))
    expected = Rotation.from_rotvec(turn).apply((p * b.inv()).apply(points - at - 2 * shift))
    assert np.abs(moved.to_camera(QUERIES, points) - expected).max() < 1e-6
    assert np.abs(moved.positions(QUERIES) - at - 2 * shift).max() < 1e-7

    fixed = Trajectory(there.track, there.body, there.pointing, fixed=True)
    assert (
        np.abs(fixed.positions(QUERIES) - CubicHermiteSpline(TIMES, where, speed)(QUERIES)).max()
        < 1e-7
    )
