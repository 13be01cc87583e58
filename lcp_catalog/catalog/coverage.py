"""Coverage by condition: the spacing cells that have a usable point nearby under each view and Sun."""

from __future__ import annotations

import numpy as np

from ..arrays import AnyArray, Bytes
from ..landmarks.selection import Places, within
from .schema import COVERAGE_UNKNOWN, evaluated, usable


def usable_nearby(cells: Places, points: Places, condition: AnyArray, spacing_m: float) -> Bytes:
    """Coverage of each cell by condition, (cell, view, sun_elevation, sun_azimuth).

    1: a point that is usable in the condition lies within ``spacing_m`` (along the sphere) of the
    cell's centre; 0: none does; 255: the condition was evaluated for no point at all. ``cells`` and
    ``points``: (longitudes, latitudes) in degrees; ``condition``: uint8 (point, view,
    sun_elevation, sun_azimuth).
    """
    works = usable(condition)
    near = within(cells, points, spacing_m)
    found = np.zeros((len(near), *works.shape[1:]), np.uint8)
    for cell, rows in enumerate(near):
        found[cell] = works[rows].any(axis=0)
    found[:, ~evaluated(condition).any(axis=0)] = COVERAGE_UNKNOWN
    return found
