"""What candidates serve at places at real moments: the Sun stands in one direction, whose elevation and azimuth
differ between the points of a footprint.
"""

from __future__ import annotations

import math

import numpy as np

from ..arrays import AnyArray, Array, Index, Mask
from ..catalog.sun_cells import SunCells
from ..constants import MOON_RADIUS_M, SUBSOLAR_LATITUDE_MAX_DEG
from ..ephemeris.reachable import reachable_suns
from ..geometry.frames import enu_rotation, lonlat_to_mcmf
from ..kernels.sun_moments import serve
from ..landmarks.multicover import Cover, packed

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


def moment_cover(
    sites: tuple[Array, Array],
    usable: Mask,
    places: tuple[Array, Array],
    radius_m: float,
    links: tuple[Index, AnyArray],
    grid: SunCells,
    columns: Index,
) -> tuple[Cover, Mask]:
    """The candidates at ``sites`` (longitudes, latitudes; degrees), of which those that are ``usable`` (n,
    condition) under all Suns of a cell by the angles at the candidate serve a cell at a place if they
    are usable under all Suns that stand in it at the place; and (place, condition) whether there are any.

    ``links``: the places within ``radius_m`` of each candidate: where they start, and their numbers.
    ``columns``: the conditions in views x cells of the grid, flat; views have the same cells. A
    direction without extent (`SunCells`) is served by what is usable in it by the angles at the candidate.
    """
    first, place = links
    cells = math.prod(grid.shape)
    own = columns[columns < cells]
    lone_rows, lone_columns = (other == np.arange(len(other)) for other in (grid.above, grid.after))
    lone = (lone_rows[:, None] | lone_columns).ravel()
    number = np.full(cells, -1, np.int64)
    number[own] = np.where(lone[own], -1, np.arange(len(own)))
    alone = np.tile(lone[own], len(columns) // len(own))
    found = np.tile(alone, (len(places[0]), 1))
    candidate = np.repeat(np.arange(len(first) - 1), np.diff(first))
    row, owner, spread = _rows(sites, places, radius_m, place, candidate)
    bits = (packed(usable) | packed(~alone[None]))[owner]
    order = np.argsort(place, kind="stable")
    starts = np.concatenate([[0], np.cumsum(np.bincount(place, minlength=len(places[0])))])
    near = starts, candidate[order], row[order]
    frames = np.radians(places[1]), enu_rotation(*places), enu_rotation(*sites)
    axes = grid.elevation, grid.azimuth, grid.above, grid.after
    limit = math.radians(SUBSOLAR_LATITUDE_MAX_DEG)
    views = len(columns) // len(own)
    suns = _suns(sites[1], grid)
    serve(bits, found, near, frames, spread, usable, suns, axes, number, views, limit)
    return Cover(first, place, row, bits, *found.shape), found


def _rows(
    sites: tuple[Array, Array],
    places: tuple[Array, Array],
    radius_m: float,
    place: AnyArray,
    candidate: Index,
) -> tuple[AnyArray, Index, float]:
    """The row of what a candidate serves at a place, for each of their pairs; the candidate of each row; and
    how far apart the places of a row are, radians. One for each pair, or where these are too many
    one for each part of the circle around a candidate.
    """
    if len(place) <= _ROWS:
        return np.arange(len(place), dtype=np.int32), candidate, 0.0
    parts = max(_PARTS, math.isqrt(_ROWS // len(sites[0])))
    axes, spots = enu_rotation(*sites), lonlat_to_mcmf(*places) / MOON_RADIUS_M
    half = math.sin(min(radius_m / MOON_RADIUS_M, math.pi / 2.0)) * (1.0 + 1e-9)
    row = np.empty(len(place), np.int32)
    for start in range(0, len(place), _TOGETHER):
        some = slice(start, start + _TOGETHER)
        offset = np.einsum("kij,kj->ki", axes[candidate[some], :2], spots[place[some]])
        part = np.clip((offset / half + 1.0) / 2.0 * parts, 0, parts - 1).astype(np.int64)
        row[some] = (candidate[some] * parts + part[:, 0]) * parts + part[:, 1]
    owner = np.repeat(np.arange(len(sites[0])), parts**2)
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
