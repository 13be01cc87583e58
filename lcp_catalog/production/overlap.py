"""Catalogues that are merged, and whether two that show the same ground agree about its heights and where it lies."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..arrays import AnyArray, Array, Index, Mask
from ..catalog.catalogue import Catalog
from ..catalog.patch_terrain import nodes_mcmf
from ..catalog.schema import levels
from ..dem.mosaic import FACTOR, UNKNOWN_SIGMA_M
from ..dem.products import facts_of, tie_of
from ..geometry.frames import enu_rotation, lonlat_to_mcmf, mcmf_to_lonlat
from ..landmarks.selection import Places, nearest
from ..terrain.area import Area

_NODES_MOST = 20_000
_PAIRS_MOST = 256
"""Nodes of an overview, and pairs of patches, that are compared at most."""

_PLACES_MIN = 30
"""Places that two must share to be compared, as `dem.mosaic` has it."""

_BLOCKS = 4
"""Blocks of places along each side: how much a shift differs when one of the 16 is left out gives its error."""

_REACH = 4
"""Steps of the coarser heights to each side among which a shift is sought."""

_ROUNDS = 8
"""Steps of Gauss and Newton; a cell is reached to 0.01 in 3 to 5."""

_CHANCE = 1e-3
"""Chance with which a shift may be told where there is none."""

_CONDITION = 1e12
"""Of equations that can be solved."""

_STEP_SHARE = 0.05
"""1 sigma of a shift that heights between nodes leave, in steps of the coarser ones."""

_CLIP = 3.0 * 1.4826
"""Differences beyond so many median absolute deviations (3 sigmas) do not count for a shift."""


@dataclass(frozen=True, eq=False)
class MergedPart:
    """A catalogue that is merged, and the regions of its builds."""

    catalog: Catalog
    regions: Sequence[Area]

    @cached_property
    def step_m(self) -> float:
        """Distance of the overview's nodes."""
        view = self.catalog.overview
        steps = [*np.diff(view.x), *-np.diff(view.y)]
        return float(steps[0]) if steps else self.catalog.coverage.spacing_m

    def contains(self, lon_deg: Array, lat_deg: Array) -> AnyArray:
        """True for places in any of the regions."""
        inside = [region.contains(lon_deg, lat_deg) for region in self.regions]
        return np.asarray(np.any(inside, axis=0))

    def nodes(self, lon_deg: Array, lat_deg: Array) -> Array:
        """Row and column (2, 1, n) of places (n,) in its overview."""
        view = self.catalog.overview
        x, y = view.plane.at(lon_deg, lat_deg)
        return np.stack([view.y[0] - y, x - view.x[0]])[:, None] / self.step_m

    def heights(self, lon_deg: Array, lat_deg: Array) -> Array:
        """Heights of its overview at places (n,), bilinear between the nodes, NaN outside."""
        found = _sampled(self.catalog.overview.height[None], self.nodes(lon_deg, lat_deg), 0.5)
        return np.asarray(found[0])

    @property
    def sigma_m(self) -> float:
        """The stated error of its heights, 1 sigma: of several DEMs the largest."""
        return float(np.max(self.catalog.errors.get("height_sigma_m", UNKNOWN_SIGMA_M)))

    @cached_property
    def _products(self) -> set[str]:
        return {*self.catalog.part("dem_product", slice(None)).tolist()}

    @property
    def level_sigma_m(self) -> float:
        """1 sigma of the level of all its heights, as published of the DEMs, or as `dem.mosaic` has it where nothing is: errors
        that are alike over a correlation length only (`sigma_m`) are gone in the mean.
        """
        known = [facts_of(name).sigma_m or UNKNOWN_SIGMA_M for name in self._products]
        return max(known, default=UNKNOWN_SIGMA_M)

    @property
    def place_sigma_m(self) -> float:
        """1 sigma, each axis, of where its ground lies: of the map in the Moon's frame, and of a patch in the map."""
        ties = [tie_of(name) for name in self._products]
        tie_m = max((tie[0] for tie in ties if tie), default=0.0)
        stated, size_m = self.catalog.errors, float(self.catalog.gsd.max(initial=0.0))
        patch_m = float(np.max(stated.get("position_sigma_m", 0.0)))
        cells_m = float(np.max(stated.get("position_sigma_cells", 0.0))) * size_m
        return math.hypot(tie_m, max(patch_m, cells_m))


def _sampled(z: AnyArray, place: Array, beyond: float = 0.0) -> Array:
    """Heights (n, m) of rasters (n, rows, cols) at rows and columns (2, n, m), bilinear between the nodes; NaN more than
    ``beyond`` steps outside.
    """
    last = np.array(z.shape[1:])[:, None, None] - 1.0
    inside = np.all(np.abs(place - last / 2.0) <= last / 2.0 + beyond, axis=0)
    row, col = np.clip(np.where(inside, place, 0.0), 0.0, last)
    number = np.arange(len(z))[:, None]
    r0, c0 = np.floor(row).astype(np.int64), np.floor(col).astype(np.int64)
    r1, c1 = np.minimum(r0 + 1, z.shape[1] - 1), np.minimum(c0 + 1, z.shape[2] - 1)
    down, right = row - r0, col - c0
    upper = z[number, r0, c0] * (1.0 - right) + z[number, r0, c1] * right
    lower = z[number, r1, c0] * (1.0 - right) + z[number, r1, c1] * right
    return np.where(inside, upper * (1.0 - down) + lower * down, np.nan)


def contradiction(one: MergedPart, other: MergedPart) -> str:
    """How two catalogues contradict each other beyond their errors; empty if they do not, or share no ground.

    Compared are the overviews, at nodes of the coarser one, and the patches of points of one level near to
    each other, at nodes of one. Each limit is `FACTOR` times the root of a sum of squares of sigmas, of both catalogues:

    - the median absolute difference of heights: the stated height errors, and what heights change between nodes (the
      medians of the difference of a node from the mean of its four neighbours);
    - how far the same ground lies apart: where each lies (`MergedPart.place_sigma_m`), and the fit's own error;
    - the difference of all heights: the published errors of the DEMs (`MergedPart.level_sigma_m`), and its own error.
    """
    for name, compared in (("overviews", _overviews), ("patches", _patches)):
        shared = compared(one, other)
        if shared is not None and (text := _fault(shared, one, other, name)):
            return text
    return ""


def _fault(shared: _Shared, one: MergedPart, other: MergedPart, name: str) -> str:
    away = shared.away(np.zeros(2))
    count = int(np.isfinite(away).sum())
    if count < _PLACES_MIN:
        return ""
    where = f"{count} places of the {name}"
    median_m = float(np.nanmedian(np.abs(away)))
    limit_m = FACTOR * math.hypot(one.sigma_m, other.sigma_m, *shared.rough_m)
    if median_m > limit_m:
        return (
            f"its heights differ by {median_m:.1f} m (median of {where}), "
            f"beyond the {limit_m:.1f} m that height errors and cell sizes explain"
        )
    level, level_m = shared.shift()
    away_m = float(np.hypot(*level))
    step_m = _STEP_SHARE * shared.step_m
    limit_m = FACTOR * math.hypot(one.place_sigma_m, other.place_sigma_m, level_m, step_m)
    if away_m > limit_m:
        return (
            f"the same ground lies {away_m:.0f} +- {level_m:.0f} m apart (fitted to {where}), "
            f"beyond the {limit_m:.0f} m that errors of place explain"
        )
    up_m, own_m = shared.up(level)
    limit_m = FACTOR * math.hypot(one.level_sigma_m, other.level_sigma_m, own_m)
    if up_m > limit_m:
        return (
            f"its heights differ throughout by {up_m:.1f} +- {own_m:.1f} m ({where}), "
            f"beyond the {limit_m:.1f} m that the DEMs' published errors explain"
        )
    return ""


@dataclass(frozen=True, eq=False)
class _Shared:
    """Ground that two catalogues show: heights (n, m) of one at places, and rasters (n, rows, cols) of the other in which
    these places have the rows and columns ``place`` (2, n, m).

    ``along``: rows and columns (2, 2, n, m or 1) that are a metre east, and a metre north; ``block`` (n, m): numbers of parts of
    the ground; ``step_m``: distance of the coarser nodes; ``rough_m``: how rough both are between nodes.
    """

    height: Array
    raster: AnyArray
    place: Array
    along: Array
    block: Index
    step_m: float
    rough_m: tuple[float, float]

    def away(self, shift_m: Array) -> Array:
        """The other's heights less the one's (n, m), if the other's ground lies so far east and north; NaN where unknown."""
        moved = self.place + np.tensordot(shift_m, self.along, 1)
        return _sampled(self.raster, moved) - self.height

    def shift(self) -> tuple[Array, float]:
        """The shift (2,), metres east and north, that leaves the least differences, and its 1 sigma; zeros if none can be
        told from none.

        Something always fits best. So each half of the blocks, as on a chessboard, has a shift of its own. Both must agree
        within a step, and each fit the blocks of the other half better than its opposite, which interpolation smooths alike:
        all of them but so few that chance has a part of `_CHANCE` in it.
        """
        none = np.zeros(2), 0.0
        steps = self.step_m * np.arange(-_REACH, _REACH + 1.0)
        grid = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
        differences = [self.away(one) for one in grid]
        halves = [self.block // _BLOCKS % 2 == self.block % 2]
        halves.append(~halves[0])
        found = []
        for half in (*halves, np.ones_like(halves[0])):
            spread = [_spread(away[half]) for away in differences]
            fitted = self._fitted(grid[int(np.argmin(spread))], half)
            if fitted is None:
                return none
            found.append(fitted)
        if not np.hypot(*(found[0][0] - found[1][0])) <= self.step_m:
            return none
        better = []
        for k in (0, 1):
            here, opposite = self.away(found[k][0]), self.away(-found[k][0])
            for number in np.unique(self.block[halves[1 - k]]):
                own = self.block == number
                better.append(_spread(here[own], 3) < _spread(opposite[own], 3))
        count, most = len(better), sum(better)
        chance = sum(math.comb(count, k) for k in range(most, count + 1)) / 2.0**count
        return found[2] if chance <= _CHANCE else none

    def up(self, level: Array) -> tuple[float, float]:
        """By how much all heights differ after a shift, metres, and 1 sigma of that."""
        away = self.away(level)
        known = np.isfinite(away)
        value, covariance = _solved(np.ones((known.sum(), 1)), away[known], self.block[known])
        return abs(float(value[0])), math.sqrt(covariance[0, 0])

    def _fitted(self, level: Array, half: Mask) -> tuple[Array, float] | None:
        """The shift near to one, of some places, and its 1 sigma along it, by Gauss and Newton's method; None without.

        Nuth and Kääb (2011, Cryosphere 5, 271-290) fit the same slopes.
        """
        axes = self.step_m * np.eye(2)
        for _ in range(_ROUNDS):
            away = self.away(level)
            slopes = [
                (self.away(level + axis) - self.away(level - axis)) / (2.0 * self.step_m)
                for axis in axes
            ]
            good = half & np.isfinite(away + slopes[0] + slopes[1])
            if good.sum() < _PLACES_MIN:
                return None
            design = np.stack([-slopes[0][good], -slopes[1][good], np.ones(good.sum())], axis=-1)
            value, covariance = _solved(design, away[good], self.block[good])
            if not np.all(np.abs(level := level + value[:2]) <= (_REACH + 1.0) * self.step_m):
                return None
        along = level / (float(np.hypot(*level)) or 1.0)
        return level, math.sqrt(along @ covariance[:2, :2] @ along)


def _solved(design: Array, values: Array, block: Index) -> tuple[Array, Array]:
    """Least squares of values (n,) by a design (n, m) without those beyond 3 sigmas: the solution (m,) and its covariance
    (m, m) by the jackknife over blocks, because differences of neighbouring places are alike; NaN where it has none.
    """
    off = np.abs(values - np.median(values))
    near = off <= _CLIP * np.median(off)
    design, values, block = design[near], values[near], block[near]
    own = [block == number for number in np.unique(block)]
    normal = np.array([design[k].T @ design[k] for k in own])
    right = np.array([design[k].T @ values[k] for k in own])[..., None]
    whole, count = normal.sum(axis=0), len(own)
    if count < _BLOCKS or not np.linalg.cond(whole - normal).max() < _CONDITION:
        return np.full(len(whole), np.nan), np.full_like(whole, np.nan)
    less = np.linalg.solve(whole - normal, right.sum(axis=0) - right)[..., 0]
    less = less - less.mean(axis=0)
    return np.linalg.solve(whole, right.sum(axis=0))[:, 0], (count - 1.0) / count * less.T @ less


def _spread(away: Array, least: int = _PLACES_MIN) -> float:
    """Median absolute deviation of differences; infinite for fewer than ``least``."""
    away = away[np.isfinite(away)]
    return float(np.median(np.abs(away - np.median(away)))) if len(away) >= least else math.inf


def _overviews(one: MergedPart, other: MergedPart) -> _Shared | None:
    fine, coarse = sorted((one, other), key=lambda part: part.step_m)
    view = coarse.catalog.overview
    step = math.ceil(math.sqrt(view.height.size / _NODES_MOST)) or 1
    some = (slice(None, None, step),) * 2
    x, y = (place[some].ravel() for place in np.meshgrid(view.x, view.y))
    lon, lat = view.plane.lonlat(x, y)
    height = view.height[some].ravel().astype(np.float64)
    known = np.flatnonzero(np.isfinite(lon) & np.isfinite(height))
    known = known[np.isfinite(fine.heights(lon[known], lat[known]))]
    if not len(known):
        return None
    lon, lat, x, y, height = (values[known] for values in (lon, lat, x, y, height))
    place = fine.nodes(lon, lat)
    return _Shared(
        height[None],
        fine.catalog.overview.height[None],
        place,
        (_beside(fine, lon, lat, coarse.step_m) - place) / coarse.step_m,
        _blocks(x, y)[None],
        coarse.step_m,
        (_roughness_m(fine.catalog.overview.height), _roughness_m(view.height)),
    )


def _beside(part: MergedPart, lon_deg: Array, lat_deg: Array, step_m: float) -> Array:
    """Rows and columns (2, 2, 1, n) of places a step east and a step north, in the frame at the middle of all places: a shift
    is one vector also where meridians meet.
    """
    position = lonlat_to_mcmf(lon_deg, lat_deg)
    lon, lat, _ = mcmf_to_lonlat(position.mean(axis=0))
    moved = position + step_m * enu_rotation(lon, lat)[:2, None]
    lon, lat, _ = mcmf_to_lonlat(moved)
    return np.stack([part.nodes(lon[axis], lat[axis]) for axis in (0, 1)])


def _blocks(*coordinates: Array) -> Index:
    """Numbers of blocks of places, `_BLOCKS` along each coordinate."""
    number = np.zeros(coordinates[0].shape, np.int64)
    for values in coordinates:
        width = float(np.ptp(values)) or 1.0
        own = np.minimum((values - values.min()) / width * _BLOCKS, _BLOCKS - 1).astype(np.int64)
        number = number * _BLOCKS + own
    return number


def _patches(one: MergedPart, other: MergedPart) -> _Shared | None:
    mine, its = one.catalog, other.catalog
    half = (mine.patch_nodes - 1) // 2
    here, there = (Places(c.longitude, c.latitude) for c in (mine, its))
    nearby, away_m = nearest(here, there)
    level = levels(np.concatenate([mine.gsd, its.gsd]))
    rows = np.flatnonzero(away_m <= half * mine.gsd)
    rows = rows[level[rows] == level[len(mine) + nearby[rows]]]
    rows = rows[:: math.ceil(len(rows) / _PAIRS_MOST) or 1]
    if not len(rows):
        return None
    found = nearby[rows]
    nodes = nodes_mcmf(mine, rows).reshape(len(rows), -1, 3) - its.position_mcmf[found, None]
    east, north, up = np.moveaxis(nodes @ its.rotation_mcmf_to_enu[found].swapaxes(1, 2), -1, 0)
    patch, ours, cell_m = its.part("dem", found), mine.part("dem", rows), its.gsd[found, None]
    place = half + np.stack([-north, east]) / cell_m
    zero = np.zeros_like(cell_m)
    along = np.stack([np.stack([zero, 1.0 / cell_m]), np.stack([-1.0 / cell_m, zero])])
    block = np.broadcast_to(_blocks(mine.longitude[rows], mine.latitude[rows])[:, None], up.shape)
    step_m = float(max(cell_m.max(), mine.gsd[rows].max()))
    return _Shared(
        up, patch, place, along, block, step_m, (_roughness_m(ours), _roughness_m(patch))
    )


def _roughness_m(z: AnyArray) -> float:
    """Median difference of a node from the mean of its four neighbours, of rasters (..., rows, cols)."""
    z = z.astype(np.float64)
    mean = z[..., :-2, 1:-1] + z[..., 2:, 1:-1] + z[..., 1:-1, :-2] + z[..., 1:-1, 2:]
    away = np.abs(z[..., 1:-1, 1:-1] - mean / 4.0)
    return float(np.median(away[np.isfinite(away)])) if np.isfinite(away).any() else 0.0
