"""What candidates are worth at places at real moments: the Sun stands in one direction, whose elevation and azimuth
differ between the points of a footprint. Their claims are averaged there as `catalog.prediction` does.
"""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from ..arrays import AnyArray, Array, Bytes, Index, Mask
from ..catalog.prediction import BETWEEN_MARGIN, BEYOND_MARGIN, claimed_elevations
from ..catalog.schema import DETECTION_STEP, NO_CELL
from ..catalog.sun_cells import SunCells
from ..constants import MOON_RADIUS_M, SUBSOLAR_LATITUDE_MAX_DEG
from ..geometry.frames import direction_enu, enu_rotation
from ..kernels.sun_moments import UNKNOWN, serve
from ..landmarks.relief_signal import (
    LEAST_COSINE,
    LEAST_SLOPE_SIGNAL,
    log_of,
    peak_height,
    probability_at,
    relief_signal,
)
from ..landmarks.selection import Cover, Places
from ..threads import thread_count
from .config import BuildConfig
from .finished_area import units_of

_ROWS = 1_000_000
"""Pairs of a candidate and a place that are kept one by one. Of more, a candidate is worth at all places in one part of the
circle around it what it is worth at the worst of them.
"""

_PARTS = 4
"""Least number of parts across the circle."""

_TOGETHER = 1_000_000

_HEIGHTS = np.linspace(0.0, 8.0, 801)
"""Heights of peaks, sigmas, at which logits are tabled."""

_MIDDLE = 0.75
"""1 - the sum of the squared weights of four directions in their middle, where the margin between them is greatest."""

_SLOPE_STEP = 0.02
"""Step of the logarithm of slope errors."""


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


@dataclass(frozen=True)
class Claimed:
    """What candidates claim in the conditions of a grid, and what that is worth."""

    grid: SunCells
    codes: Bytes
    """(n, v, e, a): detection probabilities in steps of `DETECTION_STEP`; `UNKNOWN` where not evaluated."""
    slope_sigma: Array
    """(n,)"""
    views: Array
    """(v, 3) directions to the cameras, east, north, up."""
    albedo_sigma: float
    least: tuple[float, ...]
    """Probabilities from which a point is worth 1, 2, ... units."""
    margins: tuple[float, float]
    """Logits that a probability must exceed them by, between the grid's directions and beyond them (`catalog.prediction`)."""

    @classmethod
    def of(cls, codes: Bytes, slope_sigma: Array, config: BuildConfig) -> Claimed:
        """Codes (n, v e a) of a build's candidates (`finished_area.cell_stages`). A frame is located by points with their mean
        probabilities, as `lcp query` counts them; that a point is usable must be sure.
        """
        sun, view = config.sun, config.view
        located = config.points.located is not None
        return cls(
            SunCells.of(sun.elevations_deg, sun.azimuths_deg),
            codes.reshape(len(codes), len(view), len(sun.elevations_deg), len(sun.azimuths_deg)),
            np.asarray(slope_sigma, np.float64),
            direction_enu(np.asarray(view.azimuth_deg), 90.0 - np.asarray(view.off_nadir_deg)),
            config.errors.model(height_sigma_m=1.0, height_length_m=1.0).albedo_sigma,
            units_of(config).least,
            (0.0, 0.0) if located else (_MIDDLE * BETWEEN_MARGIN, BEYOND_MARGIN),
        )

    def of_directions(self, columns: Index) -> Bytes:
        """Units (n, condition) in cells that do not extend both ways, numbers in views x cells: the least at the known corners."""
        least = np.full_like(self.codes, UNKNOWN)  # above all others
        for row, column in zip(*self.grid.corners(), strict=True):
            np.minimum(least, self.codes[:, :, row, column], out=least)
        codes = least.reshape(len(least), math.prod(least.shape[1:]))[:, columns]
        up, along = (o != np.arange(len(o)) for o in (self.grid.above, self.grid.after))
        extends = (up[:, None] | along).ravel()[columns % math.prod(self.grid.shape)]
        logit = _logit(_inside(codes * DETECTION_STEP)) - self.margins[0] * extends
        units = self._bars.searchsorted(logit, "right")
        return np.where(codes == UNKNOWN, 0, units).astype(np.uint8)

    @property
    def _bars(self) -> Array:
        """Least logits of 1, 2, ... units."""
        return _logit(_inside(np.asarray(self.least) - DETECTION_STEP / 2.0)) - 1e-9

    def tables(self) -> tuple[tuple[AnyArray, ...], tuple[object, ...]]:
        """Claims and rule of `kernels.sun_moments.serve`."""
        suns = direction_enu(self.grid.azimuth, self.grid.elevation[:, None])
        shown = relief_signal(suns, self.views[:, None, None])
        steps = np.rint(np.log(np.maximum(self.slope_sigma, 1e-9)) / _SLOPE_STEP)
        rounded, number = np.unique(steps, return_inverse=True)
        slopes = np.exp(_SLOPE_STEP * rounded)
        signal = log_of(shown, self.albedo_sigma, slopes[:, None, None, None])
        heights = peak_height(_inside(np.arange(UNKNOWN + 1) * DETECTION_STEP))
        logits = _logit(_inside(probability_at(np.maximum(_HEIGHTS, 1e-9))))
        light = self.albedo_sigma, LEAST_COSINE, LEAST_SLOPE_SIGNAL
        rule = heights, self.views, light, logits, float(_HEIGHTS[1]), self._bars, self.margins
        ends = claimed_elevations(self.grid.elevation)
        if self.margins[0] > 0.0:  # usable points lie within the grid
            ends = float(self.grid.elevation[0]), float(self.grid.elevation[-1])
        return (self.codes, number.astype(np.int64), slopes, np.exp(-signal)), (*rule, ends)


def _inside(probability: AnyArray) -> Array:
    half = DETECTION_STEP / 2.0
    return np.asarray(np.clip(probability, half, 1.0 - half))


def _logit(probability: Array) -> Array:
    return np.asarray(np.log(probability / (1.0 - probability)))


def moment_cover(near: Near, claims: Claimed, columns: Index) -> tuple[Cover, Mask]:
    """What candidates are worth at places, the least at the moments at which the Sun stands in a cell at the place
    (`kernels.sun_moments`); and (place, condition) whether there are any.

    ``columns``: the conditions in views x cells of the grid, flat; views have the same cells. A
    direction without extent (`SunCells`) counts as it does by the angles at the candidate.
    """
    first, place, sites, places, grid = near.first, near.place, near.sites, near.places, claims.grid
    cells = math.prod(grid.shape)
    own = columns[columns < cells]
    lone_rows, lone_columns = (other == np.arange(len(other)) for other in (grid.above, grid.after))
    lone = (lone_rows[:, None] | lone_columns).ravel()
    number = np.full(cells, -1, np.int64)
    number[own] = np.where(lone[own], -1, np.arange(len(own)))
    alone = np.tile(lone[own], len(columns) // len(own))
    found = np.tile(alone, (len(places.lon_deg), 1))
    candidate = np.repeat(np.arange(len(first) - 1), np.diff(first))
    row, owner = _rows(near, candidate)
    there = np.where(alone, claims.of_directions(columns), np.uint8(NO_CELL))[owner]
    axes_there = enu_rotation(places.lon_deg, places.lat_deg)
    frames = np.radians(places.lat_deg), axes_there, enu_rotation(sites.lon_deg, sites.lat_deg)
    axes = grid.elevation, grid.azimuth, grid.above, grid.after
    limit = math.radians(SUBSOLAR_LATITUDE_MAX_DEG)
    codes, rule = claims.tables()

    ends = first[np.linspace(0, len(first) - 1, thread_count() + 1).astype(np.int64)]

    def of_some(begin: int, end: int) -> None:
        some = begin + np.argsort(place[begin:end], kind="stable")
        starts = np.searchsorted(place[some], np.arange(len(found) + 1))
        pairs = starts, candidate[some], row[some]
        serve(there, found, pairs, frames, codes, rule, axes, number, limit)

    with ThreadPoolExecutor(thread_count()) as pool:  # a row is of one candidate
        list(pool.map(of_some, ends[:-1], ends[1:]))
    return Cover(first, place, row, there, len(found)), found


def _rows(near: Near, candidate: Index) -> tuple[AnyArray, Index]:
    """The row of what a candidate is worth at a place, for each of their pairs; and the candidate of each row.
    One for each pair, or where these are too many one for each part of the circle around a candidate.
    """
    place, count = near.place, len(near.sites.lon_deg)
    if len(place) <= _ROWS:
        return np.arange(len(place), dtype=np.int32), candidate
    parts = max(_PARTS, math.isqrt(_ROWS // count))
    axes, spots = enu_rotation(near.sites.lon_deg, near.sites.lat_deg), near.places.unit
    half = math.sin(min(near.radius_m / MOON_RADIUS_M, math.pi / 2.0)) * (1.0 + 1e-9)
    row = np.empty(len(place), np.int32)
    for start in range(0, len(place), _TOGETHER):
        some = slice(start, start + _TOGETHER)
        offset = np.einsum("kij,kj->ki", axes[candidate[some], :2], spots[place[some]])
        part = np.clip((offset / half + 1.0) / 2.0 * parts, 0, parts - 1).astype(np.int64)
        row[some] = (candidate[some] * parts + part[:, 0]) * parts + part[:, 1]
    return row, np.repeat(np.arange(count), parts**2)
