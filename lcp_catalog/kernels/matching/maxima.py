"""Maxima of a correlation map."""

import numpy as np

from ..cache import njit
from ..vectors import LANES, larger, load, lowest_bit, multiple, not_below

_ABOVE, _STEPS = 3.0, 2.0**28
"""Correlations, and `correlation.NOWHERE`, are above -3; heights that differ by less than a step count
as equal.
"""
_OUTSIDE = np.float32(-_ABOVE)
_BITS = 32
_LAST = (1 << _BITS) - 1
"""Greatest number of a place in a map."""
_CLASS = _BITS + 23
"""Bits behind the class of a height: 32 classes for a unit of correlation."""
_CLASSES = 132
_UNSORTED = 24
"""Number of maxima up to which they are not divided into classes first."""


@njit(nogil=True, error_model="numpy")
def map_row(nx):
    """Places of a row of a map of nx columns as `highest` reads it."""
    return multiple(nx, LANES) + 2


@njit(nogil=True, error_model="numpy")
def surround(values, ny, nx):
    """Put lower places around the ny x nx numbers of a map in rows of `map_row` places: the first and the
    last row, the first place of each row, and the places behind its numbers.
    """
    wide = map_row(nx)
    values[:wide] = values[(ny + 1) * wide : (ny + 2) * wide] = _OUTSIDE
    for first in range(wide, (ny + 1) * wide, wide):
        values[first] = _OUTSIDE
        for x in range(first + nx + 1, first + wide):
            values[x] = _OUTSIDE


@njit(nogil=True, error_model="numpy")
def _keys(values, ny, nx, row, col, exclusion, keys):
    """Write height and place of every place without a higher neighbour that is farther than
    ``exclusion`` from (row, col) into keys as one number; how many.
    """
    found, wide = 0, map_row(nx)
    near = exclusion * exclusion if exclusion >= 0.0 else -1.0
    for y in range(ny):
        for first in range(0, nx, LANES):
            at = (y + 1) * wide + first + 1
            around = larger(load(values, at - 1), load(values, at + 1))
            for k in range(at - 1, at + 2):
                around = larger(around, larger(load(values, k - wide), load(values, k + wide)))
            bits = not_below(load(values, at), around) & ((1 << min(LANES, nx - first)) - 1)
            while bits:
                k = lowest_bit(bits)
                bits &= bits - 1
                x = first + k
                if (y - row) ** 2 + (x - col) ** 2 > near:
                    level = np.int64((np.float64(values[at + k]) + _ABOVE) * _STEPS)
                    keys[found] = (level << _BITS) + _LAST - (y * nx + x)
                    found += 1
    return found


@njit(nogil=True, error_model="numpy")
def _least_class(keys, count, lowest, few, size):
    """The class of heights (`_CLASS`) from which on the highest ``size`` of the keys (count,) are
    found, or those above ``lowest`` and the highest ``few``; there may be others in it.
    """
    counts, number = np.zeros(_CLASSES, np.int32), 0
    for k in range(count):
        own = keys[k] >> _CLASS
        counts[own] += 1
        number = max(number, own)
    wanted = np.int64((max(lowest, -_ABOVE) + _ABOVE) * _STEPS) >> (_CLASS - _BITS)
    total = 0
    while number > 0:
        total += counts[number]
        if total >= size or (number <= wanted and total >= few):
            break
        number -= 1
    return number


@njit(nogil=True, error_model="numpy")
def highest(values, ny, nx, lowest, few, row, col, exclusion, places, heights, keys, best):
    """`maxima` of a map whose numbers stand in rows of `map_row` places, after a lower row and a lower
    place (`surround`). keys (ny nx,), best (k,) int64: work arrays.
    """
    size, wide = heights.size, map_row(nx)
    count = _keys(values, ny, nx, row, col, exclusion, keys)
    least = _least_class(keys, count, lowest, few, size) if count > _UNSORTED else 0
    found = 0
    for i in range(count):
        key = keys[i]
        if key >> _CLASS < least or (found == size and key <= best[size - 1]):
            continue
        k = min(found, size - 1)
        while k > 0 and best[k - 1] < key:
            best[k] = best[k - 1]
            k -= 1
        best[k] = key
        found = min(found + 1, size)
    for k in range(found):
        y, x = divmod(_LAST - (best[k] & _LAST), nx)
        places[k, 0], places[k, 1], heights[k] = y, x, values[(y + 1) * wide + x + 1]
    while found > few and heights[found - 1] <= lowest:
        found -= 1
    return found


@njit(nogil=True, error_model="numpy")
def maxima(score, lowest, few, row, col, exclusion, places, heights):
    """Write the highest maxima (3 x 3) of a map of correlations (rows, cols) into places (k, 2; row and
    column) and heights (k,), best first: those above ``lowest``, and the ``few`` highest. Return
    their number. Places within ``exclusion`` (negative: none) of (row, col) are left out.
    """
    ny, nx = score.shape
    wide = map_row(nx)
    values = np.empty((ny + 2) * wide, np.float32)
    for y in range(ny):
        source, first = score[y], (y + 1) * wide + 1
        for x in range(nx):
            values[first + x] = source[x]
    surround(values, ny, nx)
    keys, best = np.empty(ny * nx, np.int64), np.empty(heights.size, np.int64)
    return highest(values, ny, nx, lowest, few, row, col, exclusion, places, heights, keys, best)
