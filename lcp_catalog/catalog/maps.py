"""Maps of a catalogue: the coverage by condition, as a raster that GDAL and QGIS can place, and in coarser levels; the
levels of the overview.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..arrays import AnyArray, Array, Bytes
from ..constants import MOON_RADIUS_M
from ..geometry.map_plane import ORTHOGRAPHIC, MapPlane
from ..kernels.points import mark
from ..landmarks.selection import Places, nearest, within
from .model import Coverage, CoverageLevels, CoverageMap, Overview
from .schema import COVERAGE_STATUS, COVERAGE_UNKNOWN, LEVEL_FACTORS, NO_CELL, USABLE, evaluated

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


# -- coarser levels

_CELLS_AT_ONCE = 4096


def overview_levels(view: Overview) -> tuple[Overview, ...]:
    """Means of 2 x 2, 4 x 4 and 8 x 8 nodes of an overview; none for one in a tangent plane."""
    if view.projection == ORTHOGRAPHIC:
        return ()
    found = [view]
    for _ in LEVEL_FACTORS:
        finer = found[-1]
        height, x, y = _halved(finer.height), _middles(finer.x), _middles(finer.y)
        found.append(replace(view, height=height, x=x, y=y))
    return tuple(found[1:])


def _halved(height: AnyArray) -> AnyArray:
    """Means of 2 x 2 nodes without NaN, NaN where there is none; a last odd row or column is left out
    unless it is the only one.
    """
    rows, cols = (max(1, length // 2) for length in height.shape)
    parts = np.stack(
        [
            height[r::2, c::2][:rows, :cols]
            for r in (0, 1)
            for c in (0, 1)
            if height[r::2, c::2].size
        ]
    )
    known = np.isfinite(parts)
    count = known.sum(axis=0)
    total = np.where(known, parts, 0.0).sum(axis=0, dtype=np.float64)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan).astype(np.float32)


def _middles(axis: AnyArray) -> AnyArray:
    """Means of neighbouring pairs of coordinates."""
    return axis[: len(axis) // 2 * 2].reshape(-1, 2).mean(axis=1) if len(axis) > 1 else axis


def coverage_levels(cells: Coverage) -> CoverageLevels | None:
    """Cells on latitude rings counted in cells that are 2, 4 and 8 times as wide and high, on rings of their
    own; None for the cells of a plane.
    """
    if cells.step_m is None:
        return None
    lon, lat = np.asarray(cells.longitude, np.float64), np.asarray(cells.latitude, np.float64)
    near, known = usable_conditions(cells)
    parts: list[tuple[AnyArray, ...]] = []
    for factor in LEVEL_FACTORS:
        places, own = _ring_cells(lon, lat, factor * cells.step_m)
        count = np.zeros((len(places), len(COVERAGE_STATUS)), np.int32)
        np.add.at(count, (own, np.asarray(cells.status)), 1)
        all_ = np.bincount(own, known, len(places))
        good = np.bincount(own, near, len(places))
        share = np.where(all_ > 0, good / np.maximum(all_, 1), np.nan).astype(np.float32)
        parts.append((np.full(len(places), factor, np.int32), *places.T, count, share))
    level, west, south, count, share = (np.concatenate(own) for own in zip(*parts, strict=True))
    return CoverageLevels(level, west, south, count, share, cells.step_m)


def usable_conditions(cells: Coverage) -> tuple[Array, Array]:
    """Numbers of conditions with a usable point near a cell, and of those that are known, (cell,)."""
    near, known = np.zeros(len(cells.longitude)), np.zeros(len(cells.longitude))
    if cells.usable is None:
        return near, known
    for start in range(0, len(near), _CELLS_AT_ONCE):
        rows = slice(start, start + _CELLS_AT_ONCE)
        flags = np.asarray(cells.usable[rows])
        near[rows] = np.count_nonzero(flags == 1, axis=(1, 2, 3))
        known[rows] = np.count_nonzero(flags != COVERAGE_UNKNOWN, axis=(1, 2, 3))
    return near, known


def _ring_cells(lon: Array, lat: Array, step_m: float) -> tuple[Array, NDArray[np.intp]]:
    """Centres (n, 2) of the cells on rings ``step_m`` apart that hold any of some places, degrees, from the
    south and from longitude 0, and the cell of each place.
    """
    rings = max(1, math.ceil(math.pi * MOON_RADIUS_M / step_m))
    height = 180.0 / rings
    ring = np.clip(np.floor((lat + 90.0) / height), 0, rings - 1)
    middle = -90.0 + (ring + 0.5) * height
    across = np.maximum(1.0, np.rint(360.0 * np.cos(np.radians(middle)) / height))
    column = np.minimum(np.floor(lon % 360.0 / 360.0 * across), across - 1.0)
    held, first, own = np.unique(
        np.stack([ring, column], axis=1), axis=0, return_index=True, return_inverse=True
    )
    centre = np.stack([(held[:, 1] + 0.5) * 360.0 / across[first], middle[first]], axis=1)
    return centre, own.reshape(-1)


# -- a raster of the coverage

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
    cell, away_m = nearest(Places(node_lon[on_moon], node_lat[on_moon]), Places(lon, lat))
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
