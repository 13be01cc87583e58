"""Choice of points among the candidates, coverage of the spacing cells, and ids that are the same
in every build.

Choice of the fewest candidates that serve every condition at every place as often as wanted, and a
lower bound of their number.
"""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from enum import IntEnum
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..arrays import AnyArray, Array, Bytes, Index, Int16, Mask
from ..constants import MOON_RADIUS_M
from ..geometry.bounds import turned_deg
from ..geometry.frames import lonlat_to_mcmf
from ..kernels import multicover as kernels
from ..kernels.points import thinned
from ..threads import thread_count

EXCHANGE_MAX = 30_000
"""Most candidates among which exchanges are tried: their time grows with the candidates and with the
chosen ones near each."""

BOUND_WORK = 6_000_000_000
"""Prices that the ascent to the lower bound adds up: some seconds."""

BOUND_STEPS = 150, 300
"""Steps of the ascent, at least and at most: where the work does not allow as many, the bound is that
of every so many-th place and condition alone.
"""

_PLACES_LEFT = 2
"""Places near a candidate that are left in such a part."""


@dataclass(frozen=True)
class Cover:
    """What candidates are worth: candidate i has ``worth[row[k], c]`` units in condition c of place p if p is
    ``place[k]`` with k in ``first[i]:first[i + 1]``.

    Candidates are in order of preference: among equally good choices the first is taken.
    """

    first: Index  # (n + 1,)
    place: AnyArray  # (k,) int32
    row: AnyArray  # (k,) int32
    worth: Bytes  # (rows, condition)
    places: int

    def __len__(self) -> int:
        return len(self.first) - 1

    def counts(self, rows: ArrayLike) -> Int16:
        """Units of the candidates ``rows`` in each condition, (place, condition), at most
        `kernels.multicover.FREE`.
        """
        found = np.zeros((self.places, self.worth.shape[1]), np.int16)
        kernels.count(found, *self.links, np.asarray(rows, np.int64))
        return found

    @property
    def links(self) -> tuple[Index, AnyArray, AnyArray, Bytes]:
        return self.first, self.place, self.row, self.worth

    def at_places(self, some: Index) -> Cover:
        """The same candidates at some of the places, which are numbered anew."""
        number = np.full(self.places, -1, np.int32)
        number[some] = np.arange(len(some), dtype=np.int32)
        place = number[self.place]
        near = place >= 0
        candidate = np.repeat(np.arange(len(self)), np.diff(self.first))[near]
        first = np.concatenate([[0], np.cumsum(np.bincount(candidate, minlength=len(self)))])
        return Cover(first, place[near], self.row[near], self.worth, len(some))

    @cached_property
    def _at_places(self) -> tuple[Index, Index]:
        """The candidates of each place: where they start, and their numbers."""
        candidate = np.repeat(np.arange(len(self)), np.diff(self.first))
        order = np.argsort(self.place, kind="stable")
        per_place = np.bincount(self.place, minlength=self.places)
        return np.concatenate([[0], np.cumsum(per_place)]), candidate[order]


@dataclass(frozen=True)
class CoverChoice:
    """Chosen candidates, rising; and for the greedy order, after each of its candidates, the number of
    conditions at places that are served as often as wanted, and the share of all that was wanted.
    """

    chosen: Index
    met: Index
    served: Array


def choose_cover(cover: Cover, wanted: Int16, most: int | None = None) -> CoverChoice:
    """The fewest candidates found with the units that are ``wanted`` (place, condition) in each condition, which
    must not exceed `Cover.counts` of all; or, of the choices of ``most``, a greedy one.

    Greedy by the units that are still lacking; then candidates that none needs are
    left out, and one is exchanged for two or more where that is possible, unless the size is
    limited. ValueError for a limit below 1.
    """
    if most is not None and most < 1:
        raise ValueError("most must be at least 1")
    slack = np.where(wanted > 0, -wanted, kernels.FREE).astype(np.int16)
    most = len(cover) if most is None else most
    order, met, served = kernels.greedy(*cover.links, slack, most)
    total = max(1, int(wanted.sum(dtype=np.int64)))
    is_chosen = np.zeros(len(cover), np.bool_)
    is_chosen[order] = True
    if not (slack < 0).any():  # cut short it has none to spare
        kernels.drop(order, is_chosen, *cover.links, slack)
        if len(cover) <= EXCHANGE_MAX:
            starts, near = cover._at_places
            while kernels.exchange(is_chosen, *cover.links, slack, starts, near):
                pass
    return CoverChoice(np.flatnonzero(is_chosen), met, served / total)


def least_size(cover: Cover, wanted: Int16, size: int) -> float:
    """A lower bound of the number of candidates of any choice with the units that are ``wanted``:
    of the linear relaxation, by subgradient ascent on its dual. ``size``: of a known choice.

    For prices y >= 0 of the conditions the bound is sum(wanted y) - sum(max(0, s - 1)) over the
    candidates' sums s of what they serve; every step's prices give a valid one (Caprara, Fischetti
    and Toth 1999, Oper. Res. 47, 730). The prices of each step are scaled to the best bound. Many
    candidates: the bound is that of a part of the places and conditions, a lower and valid one.
    """
    if not size or not wanted.any():
        return 0.0
    least, most = BOUND_STEPS
    too_much = -(-_work(cover) * least // BOUND_WORK)
    if too_much > 1:
        near = len(cover.place) // max(1, len(cover))  # places of a candidate
        every = max(1, min(too_much, near // _PLACES_LEFT))
        cover, wanted = _part(cover, wanted, every, -(-too_much // every))
    steps = max(least, min(most, BOUND_WORK // max(1, _work(cover))))
    need = wanted.astype(np.float64)
    everyone = np.arange(len(cover))
    shared = cover.counts(everyone).astype(np.float64)
    price = np.where(need > 0.0, 1.0 / np.maximum(shared, 1.0), 0.0)
    best, pace, since = 0.0, 1.0, 0
    for _ in range(steps):
        sums = kernels.prices(*cover.links, price)
        scale, bound = _scaled(sums, float((need * price).sum()))
        if bound > best * (1.0 + 1e-4):
            best, since = bound, 0
        else:
            since += 1
        if since > 5:
            pace, since = pace / 1.5, 0
        price *= scale
        bought = np.flatnonzero(sums * scale > 1.0)
        slope = np.where(need > 0.0, need - cover.counts(bought), 0.0)
        slope[(price <= 0.0) & (slope < 0.0)] = 0.0
        length = float((slope**2).sum())
        if length == 0.0:
            break
        price = np.maximum(0.0, price + pace * max(size - bound, 0.05 * size) / length * slope)
    return best


def _part(cover: Cover, wanted: Int16, places: int, conditions: int) -> tuple[Cover, Int16]:
    """The problem at every so many-th place, in every so many-th condition."""
    part = cover.at_places(np.arange(0, cover.places, places))
    asked = np.arange(cover.worth.shape[1]) % conditions == 0
    fewer = replace(part, worth=part.worth * asked)
    return fewer, np.where(asked, wanted[::places], 0).astype(np.int16)


def _work(cover: Cover) -> int:
    """Prices that a step of the ascent adds up."""
    served = np.count_nonzero(cover.worth, axis=1)
    return 2 * int(served[cover.row].sum())


def _scaled(sums: Array, worth: float) -> tuple[float, float]:
    """The factor of all prices with the greatest bound, and that bound: worth t - sum(max(0, t s - 1))
    rises until the candidates with t s > 1 sum up to the worth.
    """
    falling = np.sort(sums)[::-1]
    total = np.cumsum(falling)
    last = min(int(np.searchsorted(total, worth)), len(falling) - 1)
    if falling[last] <= 0.0:
        return 1.0, 0.0
    scale = 1.0 / falling[last]
    return float(scale), float(worth * scale - np.maximum(0.0, sums * scale - 1.0).sum())


if TYPE_CHECKING:
    from scipy.spatial import cKDTree


class Places(NamedTuple):
    """Places on the Moon: longitudes and latitudes (n,), degrees."""

    lon_deg: Array
    lat_deg: Array

    @property
    def unit(self) -> Array:
        """On the unit sphere, MCMF (n, 3)."""
        return lonlat_to_mcmf(self.lon_deg, self.lat_deg) / MOON_RADIUS_M


ID_ROWS = 180_000
"""Rows of 0.001 degrees of latitude (30.3 m)."""

_ID_STRIDE = 2**20
"""More than the most columns that a row has (360 000)."""


class Status(IntEnum):
    """Content of a spacing cell: a point, or the reason why there is none; the numbers are those of
    the catalogue's ``coverage/status``.
    """

    POINT = 0
    FEATURELESS = 1
    AMBIGUOUS = 2
    DEPENDENT = 3
    NODATA = 4
    SPARE = 5
    """Candidates that would work, none of which is needed."""


USABLE_STAGE, SPARE_STAGE = 3, 4
"""Stages (`coverage`) of a usable candidate: where a point lies within the spacing of all of them, and
where the choice leaves such candidates out.
"""

_BY_STAGE = np.array(
    [Status.FEATURELESS, Status.AMBIGUOUS, Status.DEPENDENT, Status.POINT, Status.SPARE],
    dtype=np.uint8,
)


def stable_id(lon_deg: ArrayLike, lat_deg: ArrayLike) -> Index:
    """A positive number for a position, the same in every build: (row + 1) * 2^20 + column of a
    fixed grid of cells.

    Rows are 0.001 degrees of latitude (30 m) from the south pole; a row has round(360000
    cos(latitude of its middle)) columns from longitude 0 eastwards, so cells are about 30 m wide
    everywhere; the row at either pole is one cell. Longitudes 0 and 360 are the same. ValueError
    for a longitude that is not finite or a latitude outside -90..90.
    """
    lon, lat = np.broadcast_arrays(np.asarray(lon_deg, np.float64), np.asarray(lat_deg, np.float64))
    if not (np.isfinite(lon).all() and (np.abs(lat) <= 90.0).all()):
        raise ValueError("a longitude is not finite, or a latitude lies outside -90..90 degrees")
    row = np.clip(np.floor((lat + 90.0) * 1000.0).astype(np.int64), 0, ID_ROWS - 1)
    columns = _id_columns(row)
    column = np.minimum(np.floor(turned_deg(lon) / 360.0 * columns).astype(np.int64), columns - 1)
    return np.asarray((row + 1) * _ID_STRIDE + column)


def _id_columns(row: Index) -> Index:
    middle = np.radians((row + 0.5) / 1000.0 - 90.0)
    columns = np.rint(2.0 * ID_ROWS * np.cos(middle)).astype(np.int64)
    return np.where((row == 0) | (row == ID_ROWS - 1), 1, np.maximum(columns, 1))


def select(
    candidates: Places,
    usable_count: ArrayLike,
    quality: ArrayLike,
    spacing_m: float,
    fill: float = 1.0,
) -> Index:
    """Indices of the ``candidates`` to keep, in the order of their stable ids.

    Greedy over the whole Moon: most usable conditions first, then the higher quality, then the
    lower id (then longitude and latitude), for any order of the input. No candidate is chosen
    closer than ``spacing_m`` (along the sphere) to a point chosen before, so every candidate with
    a usable condition lies less than ``spacing_m`` from a point. ``fill`` < 1 adds a second pass,
    in the same order, that takes candidates at least ``fill * spacing_m`` from every point: it
    fills the gaps that a greedy choice leaves, and ``fill * spacing_m`` is then both the least
    distance of two points and the bound on the distance of a candidate from a point. Candidates
    without a usable condition or with a NaN quality are never chosen, and no id is chosen twice.
    ValueError for a spacing or fill that is out of range.
    """
    if not (spacing_m > 0.0 and 0.0 < fill <= 1.0):
        raise ValueError("spacing_m must be positive and fill in 0..1")
    lon, lat = candidates
    usable, quality = np.asarray(usable_count), np.asarray(quality, np.float64)
    if not len(lon):
        return np.zeros(0, dtype=np.int64)
    some = np.flatnonzero((usable > 0) & ~np.isnan(quality))
    lon, lat, usable, quality = lon[some], lat[some], usable[some], quality[some]
    labels = np.unique(stable_id(lon, lat), return_inverse=True)[1]
    order = np.lexsort((lat, lon % 360.0, labels, -quality, -usable.astype(np.int64)))
    places, chosen = Places(lon, lat).unit, np.zeros(0, dtype=np.int64)
    for distance_m in (spacing_m, fill * spacing_m) if fill < 1.0 else (spacing_m,):
        below = np.nextafter(_chord(distance_m), 0.0)
        chosen = thinned(places, order, below, labels, chosen)
    return some[chosen[np.argsort(labels[chosen])]]


def _chord(distance_m: float) -> float:
    """Chord on the unit sphere of a distance along the reference sphere; 3, longer than any chord,
    beyond half the circumference.
    """
    half_angle = distance_m / (2.0 * MOON_RADIUS_M)
    return 2.0 * math.sin(half_angle) if half_angle <= math.pi / 2.0 else 3.0


def _tree(unit: Array) -> cKDTree:
    """Search tree of places on the unit sphere (n, 3)."""
    from scipy.spatial import cKDTree

    return cKDTree(unit)


def nearest(places: Places, others: Places) -> tuple[Index, Array]:
    """For each place the index of the nearest of the other places and the distance along the
    sphere, metres; -1 and inf if there is no other place.

    ValueError for places that are not finite.
    """
    here, there = places.unit, others.unit
    if not len(there):
        return np.full(len(here), -1, dtype=np.int64), np.full(len(here), np.inf)
    # SciPy's own threads lose errors, and with them rows of the result
    with ThreadPoolExecutor(thread_count()) as pool:
        found = list(pool.map(_tree(there).query, np.array_split(here, thread_count())))
    chord, index = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return index.astype(np.int64), 2.0 * MOON_RADIUS_M * np.arcsin(np.clip(chord / 2.0, 0.0, 1.0))


def within(cells: Places, points: Places, distance_m: float) -> tuple[Index, Index]:
    """Pairs of a cell and a point within a distance along the sphere of the cell's centre: their
    indices, in the order of the points.

    ValueError for places that are not finite.
    """
    near = _tree(points.unit).sparse_distance_matrix(
        _tree(cells.unit), _chord(distance_m), output_type="ndarray"
    )
    order = np.argsort(near["i"], kind="stable")
    return near["j"][order], near["i"][order]


class Nearby:
    """Places that are looked up around others."""

    def __init__(self, places: Places) -> None:
        self._tree = _tree(places.unit)

    def around(self, others: Places, distance_m: float) -> tuple[Index, NDArray[np.int32]]:
        """The places within a distance along the sphere of each of the others: where they start, (n + 1,),
        and their numbers, rising for each.
        """
        near = self._tree.query_ball_point(others.unit, _chord(distance_m), return_sorted=True)
        first = np.concatenate([[0], np.cumsum([len(rows) for rows in near], dtype=np.int64)])
        if not len(near):
            return first, np.zeros(0, np.int32)
        return first, np.concatenate(near).astype(np.int32)


def coverage(
    cells: Places,
    has_heights: Mask,
    candidates: Places,
    stages: Index,
    points: Places,
    spacing_m: float,
) -> NDArray[np.uint8]:
    """`Status` of each spacing cell; cells are given by their centres.

    ``has_heights``: True for cells with heights. ``stages`` of the candidates: 0 never localisable,
    1 localisable but never unique as well, 2 both but never independent as well, 3 usable, 4 usable
    and perhaps far from every point (`SPARE_STAGE`). A
    candidate counts for the cell whose centre is nearest, within one spacing. POINT: a point lies
    within one spacing of the centre, or a usable candidate lies in the cell (`select` then has a
    point within one spacing of that candidate). Otherwise the furthest stage of the cell's
    candidates: DEPENDENT, AMBIGUOUS, or FEATURELESS, also for a cell without candidates. NODATA:
    no heights, no point near and no candidate.
    """
    best = np.where(np.asarray(has_heights, dtype=np.bool_), 0, -1)
    cell, away_m = nearest(candidates, cells)
    own = away_m <= spacing_m
    np.maximum.at(best, cell[own], np.asarray(stages, dtype=np.int64)[own])
    best[nearest(cells, points)[1] <= spacing_m] = 3
    return np.where(best < 0, np.uint8(Status.NODATA), _BY_STAGE[best])
