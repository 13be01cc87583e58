"""What candidates serve at places at real moments: the Sun stands in one direction, whose elevation and azimuth
differ between the points of a footprint.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..arrays import AnyArray, Array, Index, Mask
from ..catalog.sun_cells import SunCells
from ..constants import MOON_RADIUS_M, SUBSOLAR_LATITUDE_MAX_DEG
from ..ephemeris.reachable import reachable_suns
from ..geometry.frames import enu_rotation
from ..kernels.sun_moments import serve
from ..landmarks.multicover import Cover, packed
from ..landmarks.selection import Places

_ROWS = 1_000_000
"""Pairs of a candidate and a place that are looked at one by one. Of more, the places in one part of the
circle around a candidate are taken together: it serves there what it surely serves at each.
"""

_PARTS = 4
"""Least number of parts across the circle."""

_SAFETY = 1.1
"""Factor of distances in the plane of the horizon, for the sphere's curvature."""

_LATITUDE_STEP_DEG = 0.25
"""Latitudes to which those of candidates are rounded for the Suns that can happen and are evaluated."""

_TOGETHER = 1_000_000


@dataclass(frozen=True)
class Near:
    """Candidates at ``sites``, and the ``places`` within a radius of each: where they start, (n + 1,), and
    their numbers.
    """

    sites: Places
    places: Places
    radius_m: float
    first: Index
    place: AnyArray


def moment_cover(near: Near, usable: Mask, grid: SunCells, columns: Index) -> tuple[Cover, Mask]:
    """The candidates near places, of which those that are ``usable`` (n, condition)
    under all Suns of a cell by the angles at the candidate serve a cell at a place if they
    are usable under all Suns that stand in it at the place; and (place, condition) whether there are any.

    ``columns``: the conditions in views x cells of the grid, flat; views have the same cells. A
    direction without extent (`SunCells`) is served by what is usable in it by the angles at the candidate.
    """
    first, place, sites, places = near.first, near.place, near.sites, near.places
    cells = math.prod(grid.shape)
    own = columns[columns < cells]
    lone_rows, lone_columns = (other == np.arange(len(other)) for other in (grid.above, grid.after))
    lone = (lone_rows[:, None] | lone_columns).ravel()
    number = np.full(cells, -1, np.int64)
    number[own] = np.where(lone[own], -1, np.arange(len(own)))
    alone = np.tile(lone[own], len(columns) // len(own))
    found = np.tile(alone, (len(places.lon_deg), 1))
    candidate = np.repeat(np.arange(len(first) - 1), np.diff(first))
    row, owner, spread = _rows(near, candidate)
    bits = (packed(usable) | packed(~alone[None]))[owner]
    order = np.argsort(place, kind="stable")
    starts = np.concatenate([[0], np.cumsum(np.bincount(place, minlength=len(places.lon_deg)))])
    pairs = starts, candidate[order], row[order]
    axes_there = enu_rotation(places.lon_deg, places.lat_deg)
    frames = np.radians(places.lat_deg), axes_there, enu_rotation(sites.lon_deg, sites.lat_deg)
    axes = grid.elevation, grid.azimuth, grid.above, grid.after
    limit = math.radians(SUBSOLAR_LATITUDE_MAX_DEG)
    views = len(columns) // len(own)
    suns = _suns(sites.lat_deg, grid)
    serve(bits, found, pairs, frames, spread, usable, suns, axes, number, views, limit)
    return Cover(first, place, row, bits, len(found), len(columns)), found


def _rows(near: Near, candidate: Index) -> tuple[AnyArray, Index, float]:
    """The row of what a candidate serves at a place, for each of their pairs; the candidate of each row; and
    how far apart the places of a row are, radians. One for each pair, or where these are too many
    one for each part of the circle around a candidate.
    """
    place, count = near.place, len(near.sites.lon_deg)
    if len(place) <= _ROWS:
        return np.arange(len(place), dtype=np.int32), candidate, 0.0
    parts = max(_PARTS, math.isqrt(_ROWS // count))
    axes, spots = enu_rotation(near.sites.lon_deg, near.sites.lat_deg), near.places.unit
    half = math.sin(min(near.radius_m / MOON_RADIUS_M, math.pi / 2.0)) * (1.0 + 1e-9)
    row = np.empty(len(place), np.int32)
    for start in range(0, len(place), _TOGETHER):
        some = slice(start, start + _TOGETHER)
        offset = np.einsum("kij,kj->ki", axes[candidate[some], :2], spots[place[some]])
        part = np.clip((offset / half + 1.0) / 2.0 * parts, 0, parts - 1).astype(np.int64)
        row[some] = (candidate[some] * parts + part[:, 0]) * parts + part[:, 1]
    owner = np.repeat(np.arange(count), parts**2)
    return row, owner, _SAFETY * math.sqrt(2.0) * 2.0 * half / parts


def _suns(lat_deg: Array, grid: SunCells) -> tuple[Index, Mask, Mask]:
    """The number of each candidate's latitude, and at each latitude the cells (l, e a) in which the Sun can
    stand and the directions (l, e, a) that are evaluated.
    """
    rounded = np.round(lat_deg / _LATITUDE_STEP_DEG) * _LATITUDE_STEP_DEG
    latitudes, number = np.unique(rounded, return_inverse=True)
    shape = (len(latitudes), *grid.shape)
    happens, known = np.zeros(shape, np.bool_), np.zeros(shape, np.bool_)
    for k, lat in enumerate(latitudes.tolist()):
        happens[k] = grid.happens(lat)
        known[k] = reachable_suns(lat, grid.azimuth, grid.elevation)
    return number.astype(np.int64), happens.reshape(len(latitudes), math.prod(grid.shape)), known
