"""Points on the unit sphere: a greedy choice among them, and the conditions in which cells have one."""

import math

import numpy as np

from .cache import njit

_MARGIN = 1.0 + 1e-9
"""Factor that keeps the rounding of a box's number from leaving out a place on its edge."""


@njit(nogil=True)
def thinned(places, order, below, labels, kept):
    """Indices of the chosen places (n, 3): first ``kept``, then those of ``order`` that are farther
    than ``below`` from every place chosen before and whose label was not chosen before.

    ``labels`` (n,): numbers from 0 to n - 1.
    """
    side, reach = 2.0 * below * _MARGIN**2, below * _MARGIN
    limit = below * below
    mask = 1
    while mask < 2 * places.shape[0]:
        mask *= 2
    mask -= 1
    # chosen places in boxes of the side: the last one of each box, by the box's hash, and of each the one before
    last = np.full(mask + 1, -1, np.int64)
    before = np.empty(places.shape[0], np.int64)
    taken = np.zeros(places.shape[0], np.bool_)
    chosen = np.empty(len(kept) + len(order), np.int64)
    count = 0
    for step in range(len(kept) + len(order)):
        k = kept[step] if step < len(kept) else order[step - len(kept)]
        x, y, z = places[k, 0], places[k, 1], places[k, 2]
        if step >= len(kept) and (
            taken[labels[k]]
            or _has_neighbour(places, x, y, z, reach, side, limit, last, before, mask)
        ):
            continue
        chosen[count] = k
        count += 1
        taken[labels[k]] = True
        box = _hash(math.floor(x / side), math.floor(y / side), math.floor(z / side)) & mask
        before[k] = last[box]
        last[box] = k
    return chosen[:count]


@njit(nogil=True)
def _has_neighbour(places, x, y, z, reach, side, limit, last, before, mask):
    """True if a chosen place lies no farther away than the root of ``limit``: the boxes around are at
    most two along each axis.
    """
    for i in range(math.floor((x - reach) / side), math.floor((x + reach) / side) + 1):
        for j in range(math.floor((y - reach) / side), math.floor((y + reach) / side) + 1):
            for m in range(math.floor((z - reach) / side), math.floor((z + reach) / side) + 1):
                k = last[_hash(i, j, m) & mask]
                while k >= 0:
                    dx, dy, dz = places[k, 0] - x, places[k, 1] - y, places[k, 2] - z
                    if dx * dx + dy * dy + dz * dz <= limit:
                        return True
                    k = before[k]
    return False


@njit(nogil=True)
def _hash(i, j, m):
    """A number for a box; those of neighbours are far apart."""
    number = (
        np.int64(i) * np.int64(73856093)
        ^ np.int64(j) * np.int64(19349663)
        ^ np.int64(m) * np.int64(83492791)
    )
    return number ^ (number >> np.int64(17))


@njit(nogil=True)
def mark(found, cells, points, flags, wanted):
    """Set ``found`` (cell, condition) to 1 where ``flags`` (point, condition) have all bits of ``wanted``, for pairs
    of a cell and a point.
    """
    for pair in range(len(cells)):
        own, some = found[cells[pair]], flags[points[pair]]
        for k in range(len(some)):
            if some[k] & wanted == wanted:
                own[k] = 1
