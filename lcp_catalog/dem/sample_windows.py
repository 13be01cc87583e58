"""Representative windows of a DEM file: a fixed lattice of them, so that what is measured in them
belongs to the file alone, and a global product is read in part.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from ..arrays import Array, Float32
from ..constants import MOON_RADIUS_M
from .georeferenced import Gridded

WINDOW_PX = 1024
"""Greatest side of a window, pixels."""

ACROSS, DOWN = 4, 4
"""Greatest numbers of windows across and down; a file that fewer windows cover is read whole."""

_ROWS_DEG = 12.0
"""Greatest height of a window of a cylinder, over which the width of its pixels changes."""

_FURTHEST_DEG = 75.0
"""Absolute latitude up to which a cylinder is sampled if it reaches nearer to the equator."""

_NARROWEST = 16
"""Greatest number of pixels of a cylinder that are averaged along a row to make cells square."""


class Heights(NamedTuple):
    """Heights (rows, cols) of a window, metres, NaN without one, and the distances of its nodes on
    the surface, (down, across) in metres.
    """

    z_m: Array | Float32
    steps_m: tuple[float, float]


def sample_windows(dem: Gridded) -> Iterator[Heights]:
    """The windows of a file from north to south and west to east. Pixels of a cylinder that are
    narrower than half of their height are averaged along the row, so that cells are about square.
    """
    for row0, row1 in _spans(*_rows(dem), _most_rows(dem), DOWN):
        stretch = _pixel_shape(dem, row0, row1)
        factor = max(1, min(_NARROWEST, math.floor(stretch[0] / stretch[1] + 1e-9)))
        for col0, col1 in _spans(0, _columns(dem), WINDOW_PX * factor, ACROSS):
            z = dem.read(row0, row1, col0, col1)
            whole = (col1 - col0) // factor * factor
            if not whole:
                continue
            means = z[:, :whole].reshape(len(z), -1, factor).mean(axis=2, dtype=np.float32)
            yield Heights(means, (stretch[0], stretch[1] * factor))


def _columns(dem: Gridded) -> int:
    """Columns of a file, those of a global cylinder once."""
    return min(dem.grid.width, dem.grid.period) if dem.grid.wraps else dem.grid.width


def _rows(dem: Gridded) -> tuple[int, int]:
    """First and last row (half open) that are sampled."""
    grid = dem.grid
    if grid.pole:
        return 0, grid.height
    per_degree = math.radians(1.0) * MOON_RADIUS_M / grid.pixel_m
    equator = grid.y0_m / grid.pixel_m
    top = max(0, math.ceil(equator - _FURTHEST_DEG * per_degree))
    bottom = min(grid.height, math.floor(equator + _FURTHEST_DEG * per_degree) + 1)
    return (top, bottom) if 2 * (bottom - top) > min(grid.height, WINDOW_PX) else (0, grid.height)


def _most_rows(dem: Gridded) -> int:
    """Greatest number of rows of a window."""
    if dem.grid.pole:
        return WINDOW_PX
    per_degree = math.radians(1.0) * MOON_RADIUS_M / dem.grid.pixel_m
    return max(1, min(WINDOW_PX, math.floor(_ROWS_DEG * per_degree)))


def _spans(first: int, last: int, side: int, most: int) -> list[tuple[int, int]]:
    """At most ``most`` spans of ``side`` or less in first..last, from end to end, evenly placed."""
    side = min(side, last - first)
    count = min(most, math.ceil((last - first) / side))
    starts = np.linspace(first, last - side, count).round().astype(int).tolist()
    return [(start, start + side) for start in starts]


def _pixel_shape(dem: Gridded, row0: int, row1: int) -> tuple[float, float]:
    """Size of the pixels of some rows on the surface, (down, across) in metres: at their middle."""
    grid = dem.grid
    middle = 0.5 * (row0 + row1 - 1)
    if grid.pole:
        scale = math.sqrt(float(grid.cell_weight(0.5 * (grid.width - 1), middle)))
        return grid.pixel_m * scale, grid.pixel_m * scale
    lat = (grid.y0_m - middle * grid.pixel_m) / MOON_RADIUS_M
    narrow = math.cos(lat) / math.cos(math.radians(grid.true_lat_deg))
    return grid.pixel_m, grid.pixel_m * max(narrow, 1e-3)
