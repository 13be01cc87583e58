"""Which candidates become points, what covers each cell, and the id that the same ground has in
every build.
"""

from __future__ import annotations

import math
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..arrays import Array, Index, Mask
from ..constants import MOON_RADIUS_M
from ..geometry.frames import lonlat_to_mcmf

Places = tuple[ArrayLike, ArrayLike]

ID_ROWS = 180_000
"""Rows of 0.001 degrees of latitude (30.3 m)."""

_ID_STRIDE = 2**20
"""More than the most columns that a row has (360 000)."""

_PAIRS = 4_000_000
"""Pairs that are compared at once."""


class Status(IntEnum):
    """What a spacing cell holds, or why it holds nothing; the numbers are those of the catalogue's
    ``coverage/status``.
    """

    POINT = 0
    FEATURELESS = 1
    AMBIGUOUS = 2
    DEPENDENT = 3
    NODATA = 4


_BY_STAGE = np.array(
    [Status.FEATURELESS, Status.AMBIGUOUS, Status.DEPENDENT, Status.POINT], dtype=np.uint8
)


def stable_id(lon_deg: ArrayLike, lat_deg: ArrayLike) -> Index:
    """A positive number for a place, the same in every build: (row + 1) * 2^20 + column of a fixed
    grid of cells.

    Rows are 0.001 degrees of latitude (30 m) from the south pole; a row has round(360000
    cos(latitude of its middle)) columns from longitude 0 eastwards, so cells are about 30 m wide
    everywhere; the row at either pole is one cell. Longitudes 0 and 360 are the same. ValueError
    for a place that is not one.
    """
    lon, lat = np.broadcast_arrays(np.asarray(lon_deg, np.float64), np.asarray(lat_deg, np.float64))
    if not (np.isfinite(lon).all() and (np.abs(lat) <= 90.0).all()):
        raise ValueError("a longitude is not finite, or a latitude lies outside -90..90 degrees")
    row = np.clip(np.floor((lat + 90.0) * 1000.0).astype(np.int64), 0, ID_ROWS - 1)
    columns = _id_columns(row)
    turn = lon % 360.0
    turn = np.where(turn >= 360.0, 0.0, turn)  # -1e-17 % 360 rounds to 360
    column = np.minimum(np.floor(turn / 360.0 * columns).astype(np.int64), columns - 1)
    return np.asarray((row + 1) * _ID_STRIDE + column)


def id_to_lonlat(point_id: ArrayLike) -> tuple[Array, Array]:
    """Longitude (0..360) and latitude, degrees, of the middle of an id's cell; a pole for the cell
    around it.

    ValueError for a number that is no id.
    """
    row, column = np.divmod(np.asarray(point_id, dtype=np.int64), _ID_STRIDE)
    row = row - 1
    if ((row < 0) | (row >= ID_ROWS)).any() or (column >= _id_columns(row)).any():
        raise ValueError("not the id of a place")
    lat = (row + 0.5) / 1000.0 - 90.0
    lat = np.where(row == 0, -90.0, np.where(row == ID_ROWS - 1, 90.0, lat))
    columns = _id_columns(row)
    return np.where(columns == 1, 0.0, (column + 0.5) * 360.0 / columns), lat


def _id_columns(row: Index) -> Index:
    middle = np.radians((row + 0.5) / 1000.0 - 90.0)
    columns = np.rint(2.0 * ID_ROWS * np.cos(middle)).astype(np.int64)
    return np.where((row == 0) | (row == ID_ROWS - 1), 1, np.maximum(columns, 1))


def select(
    lon_deg: ArrayLike,
    lat_deg: ArrayLike,
    usable_count: ArrayLike,
    quality: ArrayLike,
    spacing_m: float,
    fill: float = 1.0,
) -> Index:
    """Indices of the candidates to keep, in the order of their stable ids.

    Greedy over the whole Moon: most usable conditions first, then the higher quality, then the
    lower id (then longitude and latitude), whatever the order of the input. Nobody is chosen closer
    than ``spacing_m`` (along the sphere) to a point chosen before, so every candidate with a usable
    condition lies less than ``spacing_m`` from a point. ``fill`` < 1 adds a second pass, in the
    same order, that takes candidates at least ``fill * spacing_m`` from every point: it evens out
    the gaps that a greedy choice leaves, and ``fill * spacing_m`` is then both the least distance
    of two points and the bound on the distance from a candidate. Candidates with no usable
    condition, or with a quality that is NaN, are never chosen, and no id twice.
    """
    if not (spacing_m > 0.0 and 0.0 < fill <= 1.0):
        raise ValueError("spacing_m must be positive and fill in 0..1")
    lon, lat = np.asarray(lon_deg, np.float64), np.asarray(lat_deg, np.float64)
    usable, quality = np.asarray(usable_count), np.asarray(quality, np.float64)
    if not len(lon):
        return np.zeros(0, dtype=np.int64)
    ids = stable_id(lon, lat)
    order = np.lexsort((lat, lon % 360.0, ids, -quality, -usable.astype(np.int64)))
    order = order[(usable[order] > 0) & ~np.isnan(quality[order])]
    chosen = _Spread(spacing_m)
    place = _unit(lon, lat)
    for distance in (spacing_m, fill * spacing_m) if fill < 1.0 else (spacing_m,):
        order = order[~chosen.take(place, ids, order, distance)]
    picked = np.array(chosen.indices, dtype=np.int64)
    return picked[np.argsort(ids[picked], kind="stable")]


class _Spread:
    """Points chosen so far, in cubes a chord wide, so that a neighbour lies in the same cube or one
    of the 26 around it.
    """

    def __init__(self, spacing_m: float) -> None:
        self.side = max(_chord(spacing_m), 1e-9)
        self.cubes: dict[int, list[tuple[float, float, float]]] = {}
        self.indices: list[int] = []
        self.ids: set[int] = set()
        span = int(2.0 / self.side) + 4
        self._strides = np.array([span * span, span, 1], dtype=np.int64)
        self._around = [
            int(self._strides @ (i, j, k))
            for i in (0, -1, 1)
            for j in (0, -1, 1)
            for k in (0, -1, 1)
        ]

    def take(self, place: Array, ids: Index, order: Index, distance_m: float) -> Mask:
        """Choose in the given order whoever is at least ``distance_m`` away from all; which of them
        were taken.
        """
        limit = _chord(distance_m) ** 2
        keys = (np.floor((place[order] + 1.0) / self.side).astype(np.int64) + 1) @ self._strides
        taken = np.zeros(len(order), dtype=np.bool_)
        rows = zip(
            order.tolist(), place[order].tolist(), keys.tolist(), ids[order].tolist(), strict=True
        )
        for slot, (index, (x, y, z), key, point_id) in enumerate(rows):
            if point_id in self.ids or self._crowded(x, y, z, key, limit):
                continue
            self.cubes.setdefault(key, []).append((x, y, z))
            self.ids.add(point_id)
            self.indices.append(index)
            taken[slot] = True
        return taken

    def _crowded(self, x: float, y: float, z: float, key: int, limit: float) -> bool:
        cubes = self.cubes
        for step in self._around:
            for a, b, c in cubes.get(key + step, ()):
                if (a - x) ** 2 + (b - y) ** 2 + (c - z) ** 2 < limit:
                    return True
        return False


def _chord(distance_m: float) -> float:
    """Chord on the unit sphere of a distance along the reference sphere; more than any chord beyond
    half a turn.
    """
    half_angle = distance_m / (2.0 * MOON_RADIUS_M)
    return 2.0 * math.sin(half_angle) if half_angle <= math.pi / 2.0 else 3.0


def _unit(lon_deg: ArrayLike, lat_deg: ArrayLike) -> Array:
    return lonlat_to_mcmf(lon_deg, lat_deg) / MOON_RADIUS_M


def nearest(
    lon_deg: ArrayLike, lat_deg: ArrayLike, to_lon_deg: ArrayLike, to_lat_deg: ArrayLike
) -> tuple[Index, Array]:
    """For each place the index of the nearest of the others and the distance along the sphere,
    metres (-1, inf: there is none).

    Compares every pair: 1e4 with 1e4 takes about 0.3 s. Of equals the first.
    """
    here, there = (
        _unit(lon_deg, lat_deg).reshape(-1, 3),
        _unit(to_lon_deg, to_lat_deg).reshape(-1, 3),
    )
    if not len(there):
        return np.full(len(here), -1, dtype=np.int64), np.full(len(here), np.inf)
    step = max(1, _PAIRS // len(there))
    parts = [np.argmax(here[i : i + step] @ there.T, axis=1) for i in range(0, len(here), step)]
    index = np.concatenate([np.zeros(0, dtype=np.int64), *parts]).astype(np.int64)
    chord = np.linalg.norm(here - there[index], axis=1)
    return index, 2.0 * MOON_RADIUS_M * np.arcsin(np.clip(chord / 2.0, 0.0, 1.0))


def coverage(
    cells: Places,
    has_ground: Mask,
    candidates: Places,
    stages: Index,
    points: Places,
    spacing_m: float,
) -> NDArray[np.uint8]:
    """What each spacing cell holds, as `Status`; places are (longitudes, latitudes) in degrees,
    cells are given by their centres.

    ``stages`` of the candidates: 0 never localisable, 1 never unique as well, 2 never independent
    as well, 3 usable. A candidate counts for the cell whose centre is nearest, within one spacing.
    POINT: a point lies within one spacing of the centre, or a usable candidate lies in the cell
    (and then, by `select`, a point within one spacing of that candidate). Else the furthest stage
    that a candidate of the cell reached: DEPENDENT, AMBIGUOUS, or FEATURELESS, also where there is
    no candidate. NODATA: no ground, no point near and no candidate.
    """
    best = np.where(np.asarray(has_ground, dtype=np.bool_), 0, -1)
    cell, away_m = nearest(*candidates, *cells)
    own = away_m <= spacing_m
    np.maximum.at(best, cell[own], np.asarray(stages, dtype=np.int64)[own])
    best[nearest(*cells, *points)[1] <= spacing_m] = 3
    return np.where(best < 0, np.uint8(Status.NODATA), _BY_STAGE[best])


def largest_hole(cells: Places, status: NDArray[np.uint8], points: Places) -> float:
    """Greatest distance, metres, from the centre of a cell that is neither featureless nor without
    data to its nearest point.

    0 where there is no such cell, infinite where there is one and no point.
    """
    counts = (status != Status.FEATURELESS) & (status != Status.NODATA)
    if not counts.any():
        return 0.0
    lon, lat = (np.asarray(c, dtype=np.float64)[counts] for c in cells)
    return float(nearest(lon, lat, *points)[1].max())
