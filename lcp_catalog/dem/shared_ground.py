"""Ground that two sets of heights show: whether they agree about it and where it lies.

Two DEM products where they overlap (`disagreements`), and two catalogues that are merged (`production.overlap`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ..arrays import AnyArray, Array, Index, Mask

FACTOR = 3.0
"""What differs by more than this many sigmas of a difference disagrees."""

PLACES_MIN = 30
"""Places that two must share to be compared."""

REACH = 4
"""Steps of the coarser heights to each side among which a shift is sought."""

_BLOCKS = 16
"""Blocks of places: how much a shift differs when one is left out gives its error."""

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


_TRIED = 2000
"""Places with which it is first tried whether a shift would be seen."""


class Sigmas(NamedTuple):
    """1 sigma of heights at single places, of the place of the ground on each axis, and of the level of all heights, metres."""

    height_m: float
    place_m: float
    level_m: float


def sampled(z: AnyArray, place: Array, beyond: float = 0.0) -> Array:
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


@dataclass(frozen=True, eq=False)
class SharedGround:
    """Ground that two show: heights (n, m) of one at places, and rasters (n, rows, cols) of the other in which
    these places have the rows and columns ``place`` (2, n, m).

    ``along``: rows and columns (2, 2, n, m or 1) that are a metre east, and a metre north; ``block`` (n, m): numbers of parts of
    the ground (`blocks`); ``step_m``: distance of the coarser nodes; ``rough_m``: how rough both are between nodes.
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
        return sampled(self.raster, moved) - self.height

    @property
    def count(self) -> int:
        """Number of places at which both have a height."""
        return int(np.isfinite(self.away(np.zeros(2))).sum())

    def fault(self, one: Sigmas, other: Sigmas, where: str) -> str:
        """How the two contradict each other beyond their errors; empty if they do not, or share too few places to say so.

        Each limit is `FACTOR` times the root of a sum of squares of sigmas, of both:

        - the median absolute difference of heights: the errors of heights, and what heights change between nodes (the
          medians of the difference of a node from the mean of its four neighbours);
        - how far the same ground lies apart: the errors of its place, and the fit's own error;
        - the difference of all heights: the errors of their level, and its own error.

        ``where``: what the places are of, in words.
        """
        away = self.away(np.zeros(2))
        count = int(np.isfinite(away).sum())
        if count < PLACES_MIN:
            return ""
        where = f"{count} places of {where}"
        median_m = float(np.nanmedian(np.abs(away)))
        limit_m = FACTOR * math.hypot(one.height_m, other.height_m, *self.rough_m)
        if median_m > limit_m:
            return (
                f"its heights differ by {median_m:.1f} m (median of {where}), "
                f"beyond the {limit_m:.1f} m that height errors and cell sizes explain"
            )
        away_m, level_m, limit_m = self.apart(one, other)
        if away_m > limit_m:
            return (
                f"the same ground lies {away_m:.0f} +- {level_m:.0f} m apart (fitted to {where}), "
                f"beyond the {limit_m:.0f} m that errors of place explain"
            )
        up_m, own_m = self.up(self._found[0])
        limit_m = FACTOR * math.hypot(one.level_m, other.level_m, own_m)
        if up_m > limit_m:
            return (
                f"its heights differ throughout by {up_m:.1f} +- {own_m:.1f} m ({where}), "
                f"beyond the {limit_m:.1f} m that the DEMs' published errors explain"
            )
        return ""

    def apart(self, one: Sigmas, other: Sigmas) -> tuple[float, float, float]:
        """How far the same ground lies apart, 1 sigma of that, and the limit that errors explain, metres."""
        level, level_m = self._found
        return float(np.hypot(*level)), level_m, self._limit_m(one, other, level_m)

    @cached_property
    def _found(self) -> tuple[Array, float]:
        return self.shift()

    def _limit_m(self, one: Sigmas, other: Sigmas, fit_m: float) -> float:
        """How far the same ground may lie apart: also what could be seen."""
        step_m = _STEP_SHARE * self.step_m
        return FACTOR * math.hypot(one.place_m, other.place_m, fit_m, step_m)

    def unseen_m(self, one: Sigmas, other: Sigmas) -> float:
        """A shift up to which `fault` may name none, because the ground is too small or too flat: 0 if it names twice what
        errors of place explain, whichever way that goes; infinite if it could name none. Tried with shifted ground.
        """
        least = 2.0 * self._limit_m(one, other, 0.0)
        few = max(1, self.place.shape[2] * len(self.height) // _TRIED)
        if self._some(few)._names(least, one, other) or self._names(least, one, other):
            return 0.0
        sizes = least * 2.0 ** np.arange(1, 8)
        for size_m in sizes[sizes < REACH * self.step_m]:
            if self._names(float(size_m), one, other):
                return float(size_m)
        return math.inf

    def _some(self, step: int) -> SharedGround:
        """Every so manieth of the places."""
        return replace(
            self,
            height=self.height[:, ::step],
            place=self.place[..., ::step],
            along=self.along[..., ::step],
            block=self.block[:, ::step],
        )

    def _names(self, size_m: float, one: Sigmas, other: Sigmas) -> bool:
        """Whether a shift of a size would be named, to each side."""
        for axis in (*np.eye(2), *-np.eye(2)):
            moved = self.place - np.tensordot(size_m * axis, self.along, 1)
            level, level_m = replace(self, place=moved).shift()
            if not np.hypot(*level) > self._limit_m(one, other, level_m):
                return False
        return True

    def shift(self) -> tuple[Array, float]:
        """The shift (2,), metres east and north, that leaves the least differences, and its 1 sigma; zeros if none can be
        told from none.

        Something always fits best. So each half of the blocks, as on a chessboard, has a shift of its own. Both must agree
        within a step, and each fit the blocks of the other half better than its opposite, which interpolation smooths alike:
        all of them but so few that chance has a part of `_CHANCE` in it.
        """
        none = np.zeros(2), 0.0
        steps = self.step_m * np.arange(-REACH, REACH + 1.0)
        grid = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
        differences = [self.away(one) for one in grid]
        halves = [self.block % 2 == 0, self.block % 2 == 1]
        found = []
        for half in (*halves, np.ones_like(halves[0])):
            spread = [_spread(away[half]) for away in differences]
            fitted = self._fitted(grid[int(np.argmin(spread))], half)
            if fitted is None:
                return none
            found.append(fitted)
        if not np.hypot(*(found[0][0] - found[1][0])) <= self.step_m:
            return none
        better = [one for k in (0, 1) for one in self._judges(found[k][0], halves[1 - k])]
        count, most = len(better), sum(better)
        chance = sum(math.comb(count, k) for k in range(most, count + 1)) / 2.0**count
        if chance > _CHANCE:
            return none
        level, covariance = found[2]
        along = level / (float(np.hypot(*level)) or 1.0)
        return level, math.sqrt(along @ covariance @ along)

    def _judges(self, level: Array, half: Mask | None = None) -> list[bool]:
        """For each block, of a half, that has places enough both after a shift and after its opposite: whether the shift
        leaves smaller differences.
        """
        here, opposite = self.away(level), self.away(-level)
        both = np.isfinite(here) & np.isfinite(opposite)
        if half is not None:
            both &= half
        numbers, count = np.unique(self.block[both], return_counts=True)
        own = [both & (self.block == number) for number in numbers[count >= 3]]
        return [_spread(here[one], 3) < _spread(opposite[one], 3) for one in own]

    def up(self, level: Array) -> tuple[float, float]:
        """By how much all heights differ after a shift, metres, and 1 sigma of that."""
        away = self.away(level)
        known = np.isfinite(away)
        value, covariance = _solved(np.ones((known.sum(), 1)), away[known], self.block[known])
        return abs(float(value[0])), math.sqrt(covariance[0, 0])

    def _fitted(self, level: Array, half: Mask) -> tuple[Array, Array] | None:
        """The shift near to one, of some places, and its covariance (2, 2), by Gauss and Newton's method; None without.

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
            if good.sum() < PLACES_MIN:
                return None
            design = np.stack([-slopes[0][good], -slopes[1][good], np.ones(good.sum())], axis=-1)
            value, covariance = _solved(design, away[good], self.block[good])
            if not np.all(np.abs(level := level + value[:2]) <= (REACH + 1.0) * self.step_m):
                return None
        return level, covariance[:2, :2]


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
    if count < 4 or not np.linalg.cond(whole - normal).max() < _CONDITION:
        return np.full(len(whole), np.nan), np.full_like(whole, np.nan)
    less = np.linalg.solve(whole - normal, right.sum(axis=0) - right)[..., 0]
    less = less - less.mean(axis=0)
    return np.linalg.solve(whole, right.sum(axis=0))[:, 0], (count - 1.0) / count * less.T @ less


def _spread(away: Array, least: int = PLACES_MIN) -> float:
    """Median absolute deviation of differences; infinite for fewer than ``least``."""
    away = away[np.isfinite(away)]
    return float(np.median(np.abs(away - np.median(away)))) if len(away) >= least else math.inf


def blocks(x: Array, y: Array) -> Index:
    """Numbers of `_BLOCKS` blocks of places (n,), of about equally many each: 4 x 4, or fewer across a strip and more along
    it. Of a block and those beside it one has an even number, the others odd ones.
    """
    wide, high = (max(float(np.ptp(values)), 1e-9) for values in (x, y))
    across = 1 << int(np.clip(round(2.0 + 0.5 * math.log2(wide / high)), 0, 4))
    column = _ranked(x, across)
    row = np.zeros_like(column)
    for number in range(across):
        own = column == number
        row[own] = _ranked(y[own], _BLOCKS // across)
    return 2 * (column * (_BLOCKS // across) + row) + (column + row) % 2


def _ranked(values: Array, parts: int) -> Index:
    rank = np.empty(len(values), np.int64)
    rank[np.argsort(values, kind="stable")] = np.arange(len(values))
    return rank * parts // max(1, len(values))


def roughness_m(z: AnyArray) -> float:
    """Median difference of a node from the mean of its four neighbours, of rasters (..., rows, cols)."""
    z = z.astype(np.float64)
    mean = z[..., :-2, 1:-1] + z[..., 2:, 1:-1] + z[..., 1:-1, :-2] + z[..., 1:-1, 2:]
    away = np.abs(z[..., 1:-1, 1:-1] - mean / 4.0)
    return float(np.median(away[np.isfinite(away)])) if np.isfinite(away).any() else 0.0
