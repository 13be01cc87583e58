"""The coverage of a catalogue as a raster, which GDAL and QGIS can place."""

from __future__ import annotations

import math

import numpy as np

from ..arrays import Array
from ..geometry.map_plane import MapPlane
from ..landmarks.selection import nearest
from .map_levels import usable_conditions
from .model import Coverage, CoverageMap
from .schema import NO_CELL

_NEAR = 0.75
"""Greatest distance of a node from its cell, in distances of the cells: half a cell's diagonal, and some."""

_MOST_NODES = 1_000_000


def coverage_map(cells: Coverage, plane: MapPlane) -> CoverageMap | None:
    """The coverage in a plane, on nodes as far apart as its cells: each has the status of the nearest cell,
    and the share of the cell's known conditions with a usable point near. Cells of the plane itself lie on
    nodes. Regions that are far from one another have nodes further apart. None for a coverage without cells
    in the plane.
    """
    lon, lat = np.asarray(cells.longitude, np.float64), np.asarray(cells.latitude, np.float64)
    x, y = plane.at(lon, lat)
    shown = np.flatnonzero(np.isfinite(x) & np.isfinite(y))
    if not len(shown):
        return None
    wide, high = float(np.ptp(x[shown])), float(np.ptp(y[shown]))
    step_m = cells.spacing_m if cells.step_m is None else cells.step_m
    step_m = max(step_m, math.sqrt(wide * high / _MOST_NODES))
    across, down = _nodes(x[shown], step_m), _nodes(y[shown], step_m)[::-1]
    status = np.full((len(down), len(across)), NO_CELL, np.uint8)
    share = np.full(status.shape, np.nan, np.float32)
    node_lon, node_lat = plane.lonlat(*np.meshgrid(across, down))
    on_moon = np.isfinite(node_lon)
    cell, away_m = nearest(node_lon[on_moon], node_lat[on_moon], lon, lat)
    cell = cell[held := away_m <= _NEAR * step_m]
    on_moon[on_moon] = held
    good, known = usable_conditions(cells)
    share_of = np.where(known > 0, good / np.maximum(known, 1), np.nan)
    status[on_moon] = np.asarray(cells.status)[cell]
    share[on_moon] = share_of[cell]
    return CoverageMap(
        status, share, across, down, plane.center_lon, plane.center_lat, plane.projection
    )


def _nodes(along: Array, step_m: float) -> Array:
    """Places a step apart, rising, over the span of others."""
    low, high = float(along.min()), float(along.max())
    count = round((high - low) / step_m) + 1
    return np.asarray((low + high) / 2.0 + (np.arange(count) - (count - 1) / 2.0) * step_m)
