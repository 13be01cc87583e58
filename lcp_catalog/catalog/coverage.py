"""Coverage by condition: the spacing cells that have a usable point nearby under each view and Sun."""

from __future__ import annotations

import math

import numpy as np

from ..arrays import AnyArray, Bytes
from ..kernels.points import mark
from ..landmarks.selection import Places, within
from .schema import COVERAGE_UNKNOWN, USABLE, evaluated

_POINTS_AT_ONCE = 4096


def usable_nearby(cells: Places, points: Places, condition: AnyArray, spacing_m: float) -> Bytes:
    """Coverage of each cell by condition, (cell, view, sun_elevation, sun_azimuth).

    1: a point that is usable in the condition lies within ``spacing_m`` (along the sphere) of the
    cell's centre; 0: none does; 255: the condition was evaluated for no point at all. ``cells`` and
    ``points``: (longitudes, latitudes) in degrees; ``condition``: uint8 (point, view,
    sun_elevation, sun_azimuth), an array or a dataset, which is read in blocks of points.
    """
    cell, point = within(cells, points, spacing_m)
    count, shape = np.size(cells[0]), condition.shape[1:]
    found, known = np.zeros((count, math.prod(shape)), np.uint8), np.zeros(shape, np.bool_)
    for start in range(0, len(condition), _POINTS_AT_ONCE):
        flags = np.ascontiguousarray(condition[start : start + _POINTS_AT_ONCE])
        known |= evaluated(np.bitwise_or.reduce(flags, axis=0))
        near = slice(*np.searchsorted(point, (start, start + len(flags))))
        mark(found, cell[near], point[near] - start, flags.reshape(len(flags), -1), USABLE)
    found[:, ~known.ravel()] = COVERAGE_UNKNOWN
    return found.reshape(count, *shape)
