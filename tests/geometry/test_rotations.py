"""Rotations against scipy's."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation, Slerp

from lcp_catalog.geometry.rotations import (
    apart_rad,
    between,
    by_vector,
    inverse,
    product,
    quaternion_of,
    same_sides,
    turned,
)

vectors = arrays(float, 3, elements=st.floats(-4.0, 4.0))
quaternions = arrays(float, 4, elements=st.floats(-1.0, 1.0)).filter(
    lambda q: np.linalg.norm(q) > 0.1
)


def theirs(wxyz):
    return Rotation.from_quat(np.asarray(wxyz)[..., [1, 2, 3, 0]])


def unit(q):
    return q / np.linalg.norm(q)


@given(vectors, st.integers(-12, 0))
@settings(deadline=None)
def test_a_turn_by_a_vector(turn, power):
    turn = turn * 10.0**power
    assert np.abs(by_vector(turn) - Rotation.from_rotvec(turn).as_matrix()).max() < 1e-14


def test_small_turns_keep_their_digits():
    turn = np.array([3e-9, -2e-9, 1e-9])
    off = 0.5 * (by_vector(turn) - by_vector(-turn))
    assert [off[2, 1], off[0, 2], off[1, 0]] == pytest.approx(turn, rel=1e-14, abs=0.0)
    even = 0.5 * (by_vector(turn) + by_vector(-turn))
    assert even[0, 1] == pytest.approx(-3e-18, rel=1e-6, abs=0.0)  # x y / 2


@given(quaternions, quaternions, vectors)
@settings(deadline=None)
def test_products_and_turned_vectors(q, p, v):
    q, p = unit(q), unit(p)
    both = theirs(q) * theirs(p)
    assert np.abs(turned(product(q, p), v) - both.apply(v)).max() < 1e-14
    assert np.abs(turned(inverse(q), turned(q, v)) - v).max() < 1e-14


@given(quaternions)
@settings(deadline=None)
def test_a_matrix_and_its_quaternion(q):
    matrix = theirs(unit(q)).as_matrix()
    found = quaternion_of(matrix)
    assert np.linalg.norm(found) == pytest.approx(1.0, abs=1e-15)
    assert np.abs(theirs(found).as_matrix() - matrix).max() < 1e-14


def test_half_turns_have_quaternions_too():
    for matrix in (np.diag([1.0, -1, -1]), np.diag([-1.0, 1, -1]), np.diag([-1.0, -1, 1])):
        assert theirs(quaternion_of(matrix)).as_matrix() == pytest.approx(matrix, abs=1e-15)


@given(quaternions, quaternions, st.floats(0.0, 1.0))
@settings(deadline=None)
def test_between_two_at_a_constant_rate(q, p, share):
    first, second = same_sides(np.stack([q, p]))
    angle = apart_rad(first[None], second[None])
    # arccos, which scipy's way ends in, keeps 1e-8 of a small angle
    if angle[0] > np.pi / 2 - 1e-3:
        return  # half a turn apart: either way round is right
    expected = Slerp([0.0, 1.0], theirs(np.stack([first, second])))(share)
    found = between(first[None], second[None], angle, np.array([share]))[0]
    assert np.abs(theirs(found).as_matrix() - expected.as_matrix()).max() < 1e-13


def test_beyond_both_ends_the_rate_goes_on():
    first, second = np.array([[1.0, 0, 0, 0]]), quaternion_of(by_vector([0.0, 0.0, 0.2]))[None]
    second = second * np.sign(second[0, 0])
    for share in (-1.5, 2.5):
        found = between(first, second, apart_rad(first, second), np.array([share]))[0]
        assert theirs(found).as_rotvec() == pytest.approx([0, 0, 0.2 * share], abs=1e-14)


def test_small_angles_apart():
    """Twice the vectors' angle is the rotations': from a chord, so that 1e-9 keeps its digits."""
    second = np.array([[np.cos(1e-9), np.sin(1e-9), 0.0, 0.0]])
    assert apart_rad(np.array([[1.0, 0, 0, 0]]), second)[0] == pytest.approx(1e-9, rel=1e-9)


def test_signs_in_a_table_do_not_matter():
    rng = np.random.default_rng(4)
    path = Rotation.from_rotvec(np.cumsum(rng.normal(size=(9, 3)) * 0.3, axis=0)).as_quat()
    path = path[:, [3, 0, 1, 2]]
    signs = rng.choice([-1.0, 1.0], size=(9, 1))
    found = same_sides(3.0 * signs * path)
    assert np.abs(np.linalg.norm(found, axis=1) - 1.0).max() < 1e-15
    assert (np.einsum("ij,ij->i", found[1:], found[:-1]) > 0.0).all()
    assert np.abs(theirs(found).as_matrix() - theirs(path).as_matrix()).max() < 1e-14
