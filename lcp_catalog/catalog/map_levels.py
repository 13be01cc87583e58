"""Coarser levels of the maps of a large region: means of the overview, and counts of the coverage."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..arrays import AnyArray, Array
from ..constants import MOON_RADIUS_M
from ..geometry.map_plane import ORTHOGRAPHIC
from .model import Coverage, CoverageLevels, Overview
from .schema import COVERAGE_STATUS, COVERAGE_UNKNOWN, LEVEL_FACTORS

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
