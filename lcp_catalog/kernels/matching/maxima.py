"""Maxima of a correlation map."""

import numpy as np
from numba import njit

from ..vectors import LANES, larger, load, multiple, not_below

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


@njit(cache=True, nogil=True, error_model="numpy")
def _surrounded(score):
    """A map (rows, cols) with lower places around it: before and behind each row, and a row above and
    below; and the length of its rows, which whole vectors may be read from.
    """
    ny, nx = score.shape
    wide = multiple(nx, LANES) + 2
    out = np.full((ny + 2, wide), _OUTSIDE)
    for y in range(ny):
        source, target = score[y], out[y + 1, 1 : nx + 1]
        for x in range(nx):
            target[x] = source[x]
    return out.ravel(), wide


@njit(cache=True, nogil=True, error_model="numpy")
def _peaks(values, wide, y, nx, columns):
    """Write the columns of a row's places that have no higher neighbour into columns; their number.
    values, wide: `_surrounded`.
    """
    found = 0
    for first in range(0, nx, LANES):
        at = (y + 1) * wide + first + 1
        around = larger(load(values, at - 1), load(values, at + 1))
        for k in range(at - 1, at + 2):
            around = larger(around, larger(load(values, k - wide), load(values, k + wide)))
        bits = not_below(load(values, at), around) & ((1 << min(LANES, nx - first)) - 1)
        k = first
        while bits:
            columns[found] = k
            found += bits & 1
            bits >>= 1
            k += 1
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def _keys(score, row, col, exclusion, keys):
    """Write height and place of every maximum farther than ``exclusion`` from (row, col) into keys as
    one number; how many.
    """
    ny, nx = score.shape
    found, columns = 0, np.empty(nx + 1, np.int64)
    near = exclusion * exclusion if exclusion >= 0.0 else -1.0
    values, wide = _surrounded(score)
    for y in range(ny):
        for k in range(_peaks(values, wide, y, nx, columns)):
            x = columns[k]
            if (y - row) ** 2 + (x - col) ** 2 > near:
                level = np.int64((np.float64(score[y, x]) + _ABOVE) * _STEPS)
                keys[found] = (level << _BITS) + _LAST - (y * nx + x)
                found += 1
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def _least_class(keys, lowest, few, size):
    """The class of heights (`_CLASS`) from which on the highest ``size`` keys are found, or those above
    ``lowest`` and the highest ``few``; there may be others in it.
    """
    counts = np.zeros(_CLASSES, np.int32)
    for k in range(keys.size):
        counts[keys[k] >> _CLASS] += 1
    wanted = np.int64((max(lowest, -_ABOVE) + _ABOVE) * _STEPS) >> (_CLASS - _BITS)
    number, total = _CLASSES - 1, 0
    while number > 0:
        total += counts[number]
        if total >= size or (number <= wanted and total >= few):
            break
        number -= 1
    return number


@njit(cache=True, nogil=True, error_model="numpy")
def maxima(score, lowest, few, row, col, exclusion, places, heights):
    """Write the highest maxima (3 x 3) of a map of correlations into places (k, 2; row and column) and
    heights (k,), best first: those above ``lowest``, and the ``few`` highest. Return their number.
    Places within ``exclusion`` (negative: none) of (row, col) are left out.
    """
    nx, size = score.shape[1], heights.size
    every, best = np.empty(score.size, np.int64), np.empty(size, np.int64)
    every = every[: _keys(score, row, col, exclusion, every)]
    least, found = _least_class(every, lowest, few, size), 0
    for key in every:
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
        places[k, 0], places[k, 1], heights[k] = y, x, score[y, x]
    while found > few and heights[found - 1] <= lowest:
        found -= 1
    return found
