"""What points are worth for a frame to be located: units, by which points of different probabilities add up.

`lcp validate` accepts a position by at least K matches that agree (`log10_false_alarms`). Of n points that are each found
with the probability p, and whose failures have a common cause (the factor u of `matching.joint_detection`), at least K are found
with a probability P(p, n). Let n(p) be the least n for which that is as much as wanted. A point with the probability p is then
worth `MOST_UNITS` n(1) / n(p) units, rounded down, and points with together `MOST_UNITS` n(1) units are enough.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import Array

SIGNIFICANT = -6.0
"""log10 of the number of false alarms below which an agreement is significant: one frame in a
million.
"""

GATE = 3.0
"""Sigmas within which a match agrees."""

COMMON_VARIANCE = 0.1
"""rho: the variance of the common factor. It was 0.08 to 0.13 over 105 frames of two cameras."""

WRONG = 0.05
"""Share of the points that are not found of which another place is accepted."""

MOST_UNITS = 15
"""Units of a point that is as good as certain (`_CERTAIN`)."""

UNITS_MAX = 254
"""Most units that a catalogue states."""

_CERTAIN = 0.98
_LEAST_PERCENT = 10
_MINIMAL = 3
"""Matches that determine the six unknowns of a camera."""

_SIGMA_PX = 0.5
"""1 sigma of a match, and what is known of the camera before: 1 km (`matching.options.USUAL`), searched for within
3 sigma, but 16 to 64 pixels."""
_TOLERANCE_PX = 1.0
_POSITION_M = 1000.0
_REACH_PX = 16.0, 64.0

_EXPONENTS = np.linspace(0.02, 0.98, 49)
NODES, WEIGHTS = np.polynomial.hermite_e.hermegauss(15)
WEIGHTS = WEIGHTS / WEIGHTS.sum()
"""Nodes and weights of the mean over the common factor."""


def log10_false_alarms(
    chance: ArrayLike, agrees: ArrayLike, minimal: int, share: float = 1.0
) -> float:
    """log10 of the expected number of solutions as good by chance (`matching.consensus`), from the chance of each match to agree by
    accident and the agreeing matches (both (n,)), the size of a minimal set, and k_eff / k. Never above log10 C(n, minimal).
    """
    p = np.clip(np.asarray(chance, dtype=np.float64), 1e-300, 1.0)
    evidence = np.sort(-np.log(p[np.asarray(agrees, dtype=bool)]))[: -minimal or None].sum()
    tests = math.lgamma(len(p) + 1) - math.lgamma(minimal + 1) - math.lgamma(len(p) - minimal + 1)
    t = _EXPONENTS[:, None]
    bound = np.log1p(p ** (1.0 - t) - p).sum(-1) - _EXPONENTS * evidence
    return float((tests + share * min(0.0, bound.min())) / math.log(10.0))


@dataclass(frozen=True)
class Units:
    """``least`` (u,), rising: the probabilities from which a point is worth 1, 2, ... units; ``demand``: units that
    are wanted; ``chance``: of a match to agree by accident.
    """

    least: tuple[float, ...]
    demand: int
    chance: float

    @classmethod
    def of_usable(cls, count: int, min_detection: float, gsd_m: float) -> Units:
        """Every usable point is worth one unit, and ``count`` are wanted."""
        return cls((min_detection,), count, chance_of(gsd_m))

    @classmethod
    @functools.cache
    def of_located(cls, probability: float, gsd_m: float) -> Units:
        """A frame is to be located with this probability in cells of this size, metres.

        ValueError for a probability that needs more points than `UNITS_MAX` units.
        """
        chance = chance_of(gsd_m)
        first = _least_number(_CERTAIN, probability, chance)
        if first * MOST_UNITS > UNITS_MAX:
            raise ValueError(
                f"a probability of {probability:g} needs {first} points that are found"
            )
        percents = range(_LEAST_PERCENT, round(100 * _CERTAIN) + 1)
        steps = [p / 100.0 for p in percents]
        worth = [MOST_UNITS * first // _least_number(p, probability, chance) for p in steps]
        least = tuple(
            next(p for p, units in zip(steps, worth, strict=True) if units >= wanted)
            for wanted in range(1, MOST_UNITS + 1)
        )
        return cls(least, MOST_UNITS * first, chance)

    @functools.cached_property
    def located(self) -> Array:
        """Probability, at least, that a frame is located by 0, 1, ... units, (`UNITS_MAX` + 1,)."""
        limits = np.clip(self.least, 0.01, _CERTAIN).tolist()
        tables = [_located(p, k, self.chance) for k, p in enumerate(limits, 1)]
        return np.asarray(np.min(tables, axis=0))


def chance_of(gsd_m: float) -> float:
    """Chance of a match to agree by accident, in an image whose pixel is the cell."""
    reach = reach_of(gsd_m)
    area = math.pi * (GATE**2 * _SIGMA_PX**2 + _TOLERANCE_PX**2)
    return area / (2.0 * reach + 1.0) ** 2


def reach_of(gsd_m: float) -> float:
    """How far a point is searched for, pixels, in an image whose pixel is the cell."""
    return float(np.clip(GATE * _POSITION_M / gsd_m, *_REACH_PX))


def needed(count: int, probability: float, chance: float) -> int:
    """Fewest matches whose agreement is significant, of points (their number) that are each found with a probability, beside
    the wrong matches of the others.
    """
    return _significant(round(WRONG * count * (1.0 - probability)), chance)


@functools.cache
def _significant(wrong: int, chance: float) -> int:
    """Fewest matches whose agreement is significant beside so many wrong ones."""
    k = _MINIMAL + 1
    while (
        log10_false_alarms(np.full(k + wrong, chance), np.arange(k + wrong) < k, _MINIMAL)
        >= SIGNIFICANT
    ):
        k += 1
    return k


def equal_points(count: int, probability: float, chance: float) -> float:
    """Probability that a frame is located by points that are each found with the same probability."""
    least = needed(count, probability, chance)
    if least > count:
        return 0.0
    probit, normal = NormalDist().inv_cdf(probability), NormalDist()
    total = 0.0
    for u, weight in zip(NODES.tolist(), WEIGHTS.tolist(), strict=True):
        moved = probit + math.sqrt(COMMON_VARIANCE) * u
        p = normal.cdf(moved / math.sqrt(1.0 - COMMON_VARIANCE))
        below = sum(math.comb(count, k) * p**k * (1.0 - p) ** (count - k) for k in range(least))
        total += weight * (1.0 - below)
    return min(1.0, max(0.0, total))


def _least_number(probability: float, located: float, chance: float) -> int:
    """Fewest points, of one probability, by which a frame is located with a probability; `MOST_UNITS` times as many as can be
    stated where these are not enough.
    """
    low, high = _MINIMAL, UNITS_MAX
    if equal_points(high, probability, chance) < located:
        return MOST_UNITS * UNITS_MAX
    while high - low > 1:
        middle = (low + high) // 2
        if equal_points(middle, probability, chance) >= located:
            high = middle
        else:
            low = middle
    return high


def _located(probability: float, units: int, chance: float) -> Array:
    """Probability that a frame is located by points of one probability, each worth so many units, by the sum of units,
    (`UNITS_MAX` + 1,). More points than needed do no harm.
    """
    most = UNITS_MAX // units
    by_count = [equal_points(n, probability, chance) for n in range(most + 1)]
    rising = np.maximum.accumulate(by_count)
    return np.asarray(rising[np.arange(UNITS_MAX + 1) // units])
