"""Coverage by condition: the spacing cells that have a usable point nearby under each view and Sun."""

from __future__ import annotations

import numpy as np

from ..arrays import AnyArray, Bytes
from ..landmarks.selection import Places, within
from .schema import COVERAGE_UNKNOWN, evaluated, usable

_POINTS_AT_ONCE = 4096


def usable_nearby(cells: Places, points: Places, condition: AnyArray, spacing_m: float) -> Bytes:
    """Coverage of each cell by condition, (cell, view, sun_elevation, sun_azimuth).

    1: a point that is usable in the condition lies within ``spacing_m`` (along the sphere) of the
    cell's centre; 0: none does; 255: the condition was evaluated for no point at all. ``cells`` and
    ``points``: (longitudes, latitudes) in degrees; ``condition``: uint8 (point, view,
    sun_elevation, sun_azimuth), an array or a dataset, which is read in blocks of points.
    """
    near = within(cells, points, spacing_m)
    cell = np.repeat(np.arange(len(near)), [len(rows) for rows in near])
    point = np.array([row for rows in near for row in rows], dtype=np.int64)
    order = np.argsort(point, kind="stable")
    cell, point = cell[order], point[order]
    shape = condition.shape[1:]
    found, known = np.zeros((len(near), *shape), np.uint8), np.zeros(shape, np.bool_)
    for start in range(0, len(condition), _POINTS_AT_ONCE):
        flags = np.asarray(condition[start : start + _POINTS_AT_ONCE])
        known |= evaluated(flags).any(axis=0)
        first, last = np.searchsorted(point, (start, start + len(flags)))
        works = usable(flags)
        for c, p in zip(cell[first:last], point[first:last] - start, strict=True):
            found[c] |= works[p]
    found[:, ~known] = COVERAGE_UNKNOWN
    return found
