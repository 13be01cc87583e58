"""Heights of single stored pixels at many places that lie far apart."""

from __future__ import annotations

import numpy as np

from ..arrays import Array
from .dem import Dem
from .mosaic import DemSet

_GAP_PX = 4000
"""Places of a row of pixels that are nearer to each other than this are read in one piece: reading so
many pixels takes about as long as another call."""


def nearest_heights(dems: DemSet, lon_deg: Array, lat_deg: Array) -> Array:
    """Heights of the stored pixels nearest to places (n,), metres, from the file that ranks first among
    those with one there; NaN without one. No blending between files.

    Rows of pixels are read in their order, each at most once from a file, and at most `_GAP_PX`
    pixels for a place.
    """
    height, away = np.full(len(lon_deg), np.nan), np.abs(lat_deg)
    for low, high, files in dems.rankings:
        here = (away >= low) & ((away < high) | (high == 90.0))
        for file in files:
            todo = np.flatnonzero(here & np.isnan(height))
            if todo.size:
                height[todo] = _pixels(dems.dems[file], lon_deg[todo], lat_deg[todo])
    return height


def _pixels(dem: Dem, lon_deg: Array, lat_deg: Array) -> Array:
    """Heights of one file's pixels at places (n,), NaN outside it and without a height."""
    height = np.full(len(lon_deg), np.nan)
    inside, column, row = dem.grid.located(lon_deg, lat_deg)
    u = np.clip(np.rint(column), 0, dem.grid.width - 1).astype(np.int64)
    v = np.clip(np.rint(row), 0, dem.grid.height - 1).astype(np.int64)
    order = np.flatnonzero(inside)
    order = order[np.lexsort((u[order], v[order]))]
    new = (np.diff(v[order]) != 0) | (np.diff(u[order]) > _GAP_PX)
    for places in np.split(order, np.flatnonzero(new) + 1) if order.size else ():
        line, first, last = int(v[places[0]]), int(u[places[0]]), int(u[places[-1]])
        height[places] = dem.read(line, line + 1, first, last + 1)[0, u[places] - first]
    return height
