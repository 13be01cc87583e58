"""Vectors of numbers in compiled code against NumPy."""

import numpy as np
import pytest
from numba import njit

from lcp_catalog.kernels.vectors import (
    LANES,
    aligned,
    larger,
    load,
    lowest_bit,
    magnitude,
    not_below,
    rounded,
    smaller,
    splat,
    splat_at,
    store,
    total,
    transpose,
    two_to,
    where_above,
)


@njit
def _line(values, factor, out):
    """factor values + values - factor, vector by vector."""
    f = splat(factor)
    for x in range(0, values.size, LANES):
        v = load(values, x)
        store(out, x, f * v + v - f)


@njit
def _moved(values, at, out, to):
    store(out, to, load(values, at))


def test_operators_work_number_by_number():
    values = np.random.default_rng(0).normal(size=5 * LANES).astype(np.float32)
    out = np.empty_like(values)
    _line(values, np.float32(1.7), out)
    factor = np.float64(np.float32(1.7))
    np.testing.assert_allclose(out, values * (factor + 1.0) - factor, rtol=0.0, atol=1e-6)


@pytest.mark.parametrize("at", range(LANES + 1))
@pytest.mark.parametrize("to", [0, 3])
def test_a_vector_is_moved_from_and_to_any_place(at, to):
    values, out = np.arange(2.0 * LANES + 1, dtype=np.float32), np.zeros(2 * LANES, np.float32)
    _moved(values, at, out, to)
    expected = np.zeros_like(out)
    expected[to : to + LANES] = values[at : at + LANES]
    np.testing.assert_array_equal(out, expected)


@njit
def _compared(one, other, out):
    a, b = load(one, 0), load(other, 0)
    store(out[0], 0, larger(a, b))
    store(out[1], 0, smaller(a, b))
    store(out[2], 0, where_above(a, b, magnitude(b), rounded(b)))
    return not_below(a, b), total(a)


def test_comparisons_and_sum_are_those_of_numpy():
    one, other = np.random.default_rng(1).normal(size=(2, LANES)).astype(np.float32)
    other[2] = one[2]
    out = np.empty((3, LANES), np.float32)
    bits, found = _compared(one, other, out)
    np.testing.assert_array_equal(out[0], np.maximum(one, other))
    np.testing.assert_array_equal(out[1], np.minimum(one, other))
    np.testing.assert_array_equal(out[2], np.where(one > other, np.abs(other), np.rint(other)))
    assert [bool(bits >> k & 1) for k in range(LANES)] == (one >= other).tolist()
    assert found == pytest.approx(one.sum(dtype=np.float64), abs=1e-6)


@njit
def _bit(bits):
    return lowest_bit(bits)


def test_the_lowest_bit():
    numbers = [0, 5, 33, 62]
    assert [_bit(np.int64(1 << k | 1 << 62)) for k in numbers] == numbers
    assert _bit(np.int64(0)) == 64


@njit
def _power(values, out):
    store(out, 0, two_to(load(values, 0)) + splat_at(values, 1))


def test_powers_of_two_and_a_number_repeated():
    values = np.linspace(-126, 120, LANES).round().astype(np.float32)
    out = np.empty_like(values)
    _power(values, out)
    np.testing.assert_array_equal(out, np.exp2(values) + values[1])


@njit
def _transposed(source, starts, factor, out):
    transpose(source, starts, 5, load(factor, 0), out, 3)


def test_a_transposition_puts_vectors_side_by_side():
    source = np.random.default_rng(2).normal(size=3 * LANES + 40).astype(np.float32)
    starts = np.random.default_rng(3).integers(0, source.size - LANES - 5, LANES)
    factor = np.random.default_rng(4).normal(size=LANES).astype(np.float32)
    out = np.zeros(LANES * LANES + 5, np.float32)
    _transposed(source, starts, factor, out)
    expected = np.stack([source[at + 5 : at + 5 + LANES] for at in starts], axis=-1) * factor
    np.testing.assert_array_equal(out[3:-2].reshape(LANES, LANES), expected)
    assert not out[[0, 1, 2, -2, -1]].any()


@pytest.mark.parametrize("count", [1, 7, 1000])
def test_an_aligned_array_begins_with_a_cache_line(count):
    for _ in range(8):
        found = aligned(count)
        assert (found.shape, found.dtype, found.ctypes.data % 64) == ((count,), np.float32, 0)
