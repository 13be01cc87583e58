"""Maxima of a correlation map."""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, error_model="numpy")
def _peaks(above, row, below, out):
    """Write True where no neighbour of a row's values (n,) is higher into out, the first and the last
    place as if their values stood beyond the ends again.
    """
    n = row.size
    left, right = row[: n - 2], row[2:]
    a, b, c = above[: n - 2], above[1 : n - 1], above[2:]
    d, e, f = below[: n - 2], below[1 : n - 1], below[2:]
    middle, found = row[1 : n - 1], out[1 : n - 1]
    for x in range(middle.size):
        here = middle[x]
        beside = (here >= left[x]) & (here >= right[x])
        up = (here >= a[x]) & (here >= b[x]) & (here >= c[x])
        found[x] = beside & up & (here >= d[x]) & (here >= e[x]) & (here >= f[x])
    for x, other in ((0, min(1, n - 1)), (n - 1, max(n - 2, 0))):
        here = row[x]
        out[x] = (
            (here >= row[other])
            & (here >= above[x])
            & (here >= above[other])
            & (here >= below[x])
            & (here >= below[other])
        )


@njit(cache=True, nogil=True, error_model="numpy")
def maxima(score, lowest, few, row, col, exclusion, places, heights):
    """Insert the highest maxima (3 x 3) of a map into places (k, 2; row and column) and heights (k,),
    best first: those above ``lowest``, and the ``few`` highest. Return their number. Places within
    ``exclusion`` (negative: none) of (row, col) are left out.
    """
    ny, nx = score.shape
    found, size, peak = 0, heights.size, np.empty(nx, np.bool_)
    near = exclusion * exclusion if exclusion >= 0.0 else -1.0
    for y in range(ny):
        _peaks(score[max(y - 1, 0)], score[y], score[min(y + 1, ny - 1)], peak)
        for x in range(nx):
            if not peak[x]:
                continue
            here = score[y, x]
            if here <= lowest and (few == 0 or (found >= few and here <= heights[few - 1])):
                continue
            if found == size and here <= heights[size - 1]:
                continue
            if (y - row) ** 2 + (x - col) ** 2 <= near:
                continue
            _insert(here, y, x, min(found, size - 1), places, heights)
            found = min(found + 1, size)
    while found > few and heights[found - 1] <= lowest:  # among the highest only for a while
        found -= 1
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def _insert(height, y, x, k, places, heights):
    """Insert a place into the k places before, best first."""
    while k > 0 and heights[k - 1] < height:
        heights[k], places[k, 0], places[k, 1] = heights[k - 1], places[k - 1, 0], places[k - 1, 1]
        k -= 1
    heights[k], places[k, 0], places[k, 1] = height, y, x
