"""The choice among all candidates: evenly spread, those first that serve under the most conditions; and why holes are holes."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ..constants import MOON_RADIUS_M
from ..sphere import lonlat_to_mcmf

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

ID_ROWS = 180_000
"""Rows of the identifiers' grid: 0.001 degrees of latitude, 30 m."""

POINT, FEATURELESS, AMBIGUOUS, DEPENDENT, NODATA = 1, 2, 3, 4, 5
STATUS = {POINT: "point", FEATURELESS: "featureless", AMBIGUOUS: "ambiguous", DEPENDENT: "dependent", NODATA: "nodata"}


def select(lon_deg: Array, lat_deg: Array, usable: Indices, quality: Array, spacing_m: float) -> Indices:
    """Indices of the chosen candidates, rising.

    Greedy: most usable conditions first, then quality, then identifier; a candidate is taken unless a taken one lies nearer than
    ``spacing_m`` (straight line). So no two points are nearer than that, and every usable candidate has a point within it.
    Candidates with no usable condition are never taken.
    """
    position = lonlat_to_mcmf(lon_deg, lat_deg)
    cells = np.floor(position / spacing_m).astype(np.int64)
    order = np.lexsort((stable_id(lon_deg, lat_deg), -quality, -usable))
    taken: dict[tuple[int, int, int], list[int]] = {}
    chosen = []
    for index in order[usable[order] > 0].tolist():
        x, y, z = cells[index].tolist()
        near = [
            other
            for dx in (-1, 0, 1)
            for dy in (-1, 0, 1)
            for dz in (-1, 0, 1)
            for other in taken.get((x + dx, y + dy, z + dz), ())
        ]
        if near and (np.linalg.norm(position[near] - position[index], axis=1) < spacing_m).any():
            continue
        taken.setdefault((x, y, z), []).append(index)
        chosen.append(index)
    return np.array(sorted(chosen), dtype=np.int64)


def stable_id(lon_deg: Array, lat_deg: Array) -> Indices:
    """Identifier of the ground: the cell of a fixed grid of about 30 m (rows of 0.001 deg, columns as wide at the row's middle).

    row * 2^20 + column, 1-based rows; decoded by `id_to_lonlat`. At a pole every longitude of the last row's cell counts.
    """
    row = np.clip(np.floor((np.asarray(lat_deg) + 90.0) / 180.0 * ID_ROWS).astype(np.int64), 0, ID_ROWS - 1)
    columns = _columns(row)
    column = np.minimum(np.floor((np.asarray(lon_deg) % 360.0) / 360.0 * columns).astype(np.int64), columns - 1)
    return (row + 1) * 2**20 + column


def id_to_lonlat(identifier: Indices) -> tuple[Array, Array]:
    """Centre of an identifier's cell, degrees."""
    row, column = np.asarray(identifier) // 2**20 - 1, np.asarray(identifier) % 2**20
    return (column + 0.5) * 360.0 / _columns(row), (row + 0.5) * 180.0 / ID_ROWS - 90.0


def _columns(row: Indices) -> Indices:
    middle = np.radians((row + 0.5) * 180.0 / ID_ROWS - 90.0)
    return np.maximum(1, np.round(2 * ID_ROWS * np.cos(middle))).astype(np.int64)


def nearest_m(lon_deg: Array, lat_deg: Array, points_lon: Array, points_lat: Array) -> Array:
    """Straight-line distance from each place to the nearest point, metres; infinite where there is none."""
    places, points = lonlat_to_mcmf(lon_deg, lat_deg), lonlat_to_mcmf(points_lon, points_lat)
    if not len(points):
        return np.full(len(places), math.inf)
    step = max(1, 4_000_000 // max(len(points), 1))
    parts = [
        np.sqrt(np.min(((places[i : i + step, None] - points) ** 2).sum(axis=2), axis=1))
        for i in range(0, len(places), step)
    ]
    return np.concatenate(parts) if parts else np.zeros(0)


def coverage(
    cells: tuple[Array, Array], has_ground: NDArray[np.bool_], candidates: tuple[Array, Array], stages: Indices,
    points: tuple[Array, Array], spacing_m: float,
) -> NDArray[np.uint8]:
    """Status of every spacing cell (lon, lat): a point within one spacing, or else how far the best candidate near it came.

    stages (n,) of the candidates: 0 never localisable, 1 localisable but never unique, 2 unique but dependent on the relief
    around, 3 usable.
    """
    status = np.full(len(has_ground), FEATURELESS, dtype=np.uint8)
    for stage, name in ((1, AMBIGUOUS), (2, DEPENDENT)):
        some = stages == stage
        near = nearest_m(*cells, candidates[0][some], candidates[1][some]) <= spacing_m * math.sqrt(0.5)
        status[near] = name
    status[nearest_m(*cells, *points) <= spacing_m] = POINT
    status[~has_ground] = NODATA
    return status


def largest_hole_m(cells: tuple[Array, Array], status: NDArray[np.uint8], points: tuple[Array, Array]) -> float:
    """Greatest distance from a cell that is neither featureless nor without data to the nearest point, metres."""
    counted = (status != FEATURELESS) & (status != NODATA)
    away = nearest_m(cells[0][counted], cells[1][counted], *points)
    return min(float(away.max()), math.pi * MOON_RADIUS_M) if away.size else 0.0
