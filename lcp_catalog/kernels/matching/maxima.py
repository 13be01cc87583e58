"""Maxima of a correlation map."""

import numpy as np
from numba import njit

from ..vectors import LANES, larger, load, not_below

_ABOVE, _STEPS = 3.0, 2.0**28
"""Correlations, and `correlation.NOWHERE`, are above -3; heights that differ by less than a step count
as equal.
"""
_BITS = 32
_LAST = (1 << _BITS) - 1
"""Greatest number of a place in a map."""
_CLASS = _BITS + 23
"""Bits behind the class of a height: 32 classes for a unit of correlation."""
_CLASSES = 132


@njit(cache=True, nogil=True, error_model="numpy")
def _is_peak(score, y, x):
    """True if no neighbour of a place is higher."""
    ny, nx = score.shape
    here = score[y, x]
    for i in range(max(y - 1, 0), min(y + 2, ny)):
        for j in range(max(x - 1, 0), min(x + 2, nx)):
            if score[i, j] > here:
                return False
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def _peaks(score, y, columns):
    """Write the columns of a row's places that have no higher neighbour into columns; their number."""
    ny, nx = score.shape
    flat, found = score.ravel(), 0
    above, row, below = max(y - 1, 0) * nx, y * nx, min(y + 1, ny - 1) * nx
    done = 0  # the columns up to this one are decided
    last = nx - 1 - LANES  # the last eight columns before the border's begin here
    if _is_peak(score, y, 0):
        columns[0], found = 0, 1
    for first in range(1, nx - 1, LANES) if last > 0 else range(0):
        x = min(first, last)
        around = larger(load(flat, row + x - 1), load(flat, row + x + 1))
        for k in range(x - 1, x + 2):
            around = larger(around, larger(load(flat, above + k), load(flat, below + k)))
        bits, k = not_below(load(flat, row + x), around) >> (first - x), first
        while bits:
            columns[found] = k
            found += bits & 1
            bits >>= 1
            k += 1
        done = x + LANES - 1
    for x in range(done + 1, nx):
        if _is_peak(score, y, x):
            columns[found] = x
            found += 1
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def _keys(score, row, col, exclusion, keys):
    """Write height and place of every maximum farther than ``exclusion`` from (row, col) into keys as
    one number; how many.
    """
    ny, nx = score.shape
    found, columns = 0, np.empty(nx + 1, np.int64)
    near = exclusion * exclusion if exclusion >= 0.0 else -1.0
    for y in range(ny):
        for k in range(_peaks(score, y, columns)):
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
