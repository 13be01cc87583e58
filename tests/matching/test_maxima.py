"""Maxima of a map of correlations against a search of every place."""

import itertools

import numpy as np
import pytest

from lcp_catalog.kernels.matching.maxima import maxima


def every(score, row, col, exclusion):
    """Height, row and column of all maxima farther than ``exclusion`` from (row, col), best first, then
    in the order of rows and columns.
    """
    rows, cols = score.shape
    found = []
    for y, x in itertools.product(range(rows), range(cols)):
        around = score[max(y - 1, 0) : y + 2, max(x - 1, 0) : x + 2]
        away = (y - row) ** 2 + (x - col) ** 2 > exclusion * abs(exclusion)
        if score[y, x] >= around.max() and away:
            found.append((score[y, x], y, x))
    return sorted(found, key=lambda one: (-one[0], one[1:]))


def found(score, lowest=-2.0, few=0, where=(0, 0), exclusion=-1.0, size=64):
    """The same by the kernel."""
    places, heights = np.empty((size, 2), np.int64), np.empty(size)
    count = maxima(score, lowest, few, *where, exclusion, places, heights)
    return [(heights[k], *places[k].tolist()) for k in range(count)]


@pytest.mark.parametrize("rows", [1, 2, 3, 9, 30])
@pytest.mark.parametrize("cols", [1, 2, 8, 9, 10, 11, 17, 18, 19, 30])
@pytest.mark.parametrize("steps", [4, 10**6])
def test_maxima_are_those_of_a_search_of_every_place(rows, cols, steps):
    """With few different heights most maxima are ridges and plains."""
    rng = np.random.default_rng(rows * cols)
    score = (rng.integers(-steps, steps, (rows, cols)) / steps).astype(np.float32)
    where = rows // 2, cols // 2
    expected = every(score, *where, 2.0)
    assert found(score, where=where, exclusion=2.0, size=1000) == expected
    assert found(score, where=where, exclusion=2.0, size=5) == expected[:5]


@pytest.mark.parametrize("lowest", [-1.1, 0.0, 0.5, 0.96, 1.5])
@pytest.mark.parametrize("few", [0, 2, 16])
def test_low_maxima_are_left_out_except_the_highest(lowest, few):
    score = np.random.default_rng(3).uniform(-1.0, 1.0, (40, 37)).astype(np.float32)
    whole = every(score, 0, 0, -1.0)
    assert len(whole) > 100
    expected = [one for k, one in enumerate(whole) if one[0] > lowest or k < few]
    assert found(score, lowest, few, size=1000) == expected
    assert found(score, lowest, few, size=20) == expected[:20]
