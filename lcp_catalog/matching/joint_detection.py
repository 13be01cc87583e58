"""Probability that a frame is located: that so many of its points are found together as `locate` asks for, or that
all of them together show the place.

Points of one frame fail together, because what makes one of them hard to find (the photometry, the
albedo, the DEM) is common to others. With the claims p_i of n points and one standard normal factor u
in the probits of all of them, of the variance rho,

    P(at least K found) = E_u PB_{>= K}[Phi((Phi^-1(p_i) + sqrt(rho) u) / sqrt(1 - rho))]

PB is the Poisson binomial distribution: the number of independent trials that succeed (Vasicek's one-factor
model; the mean of each probability stays p_i). The mean over u is a Gauss-Hermite sum.

Without such an agreement `locate` adds up the votes of all points for each offset (`landmarks.ground_votes`). For given u
the frame is located at least with the larger of the two probabilities.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtr, ndtri

from ..arrays import Array, Index
from ..cameras.sensor import Sensor, Uncertainty
from ..catalog.catalogue import Catalog
from ..catalog.schema import DETECTION_STEP
from ..landmarks.ground_votes import (
    FARTHEST_PX,
    FEWEST,
    MOST_POINTS,
    MOST_SLACK_PX,
    ground_shows,
    independent_share,
    offsets_of,
)
from ..landmarks.located import (
    COMMON_VARIANCE,
    NODES,
    SIGNIFICANT,
    WEIGHTS,
    WRONG,
    log10_false_alarms,
)
from .consensus import by_chance, minimal_set, widened
from .options import OPTIONS, USUAL
from .point_choice import patch_width_px, reduction, searched_first
from .search_area import search_reach_px, slack_px


def at_least_found(
    probability: ArrayLike, common_variance: float = COMMON_VARIANCE, most: int | None = None
) -> Array:
    """Probabilities (n + 1,) that at least 0, 1, ... n of n points are found, whose probabilities are (n,); of at most ``most``
    points (None: all).

    Probabilities are kept half a step of their storage from 0 and 1. ValueError for NaN.
    """
    return np.asarray(np.clip(WEIGHTS @ _tails(probability, common_variance, most), 0.0, 1.0))


def _inside(probability: ArrayLike) -> Array:
    """Probabilities (n,) half a step of their storage from 0 and 1. ValueError for NaN."""
    half = DETECTION_STEP / 2.0
    p = np.clip(np.asarray(probability, np.float64).reshape(-1), half, 1.0 - half)
    if not np.isfinite(p).all():
        raise ValueError("a probability is not a number")
    return np.asarray(p)


def _tails(
    probability: ArrayLike, common_variance: float = COMMON_VARIANCE, most: int | None = None
) -> Array:
    """Probabilities (15, k + 1) that at least 0, 1, ... k of n points are found, at the nodes of the common factor; k is n, or
    ``most`` if that is less.
    """
    probit = ndtri(_inside(probability))
    moved = probit + np.sqrt(common_variance) * NODES[:, None]
    chance = ndtr(moved / np.sqrt(1.0 - common_variance))  # (15, n)
    last = len(probit) if most is None else min(most, len(probit))
    tails = np.zeros((len(NODES), last + 1))
    tails[:, 0] = 1.0
    for hit in chance.T[:, :, None]:
        tails[:, 1:] += hit * (tails[:, :-1] - tails[:, 1:])
    return tails


@dataclass(frozen=True, eq=False)
class JointDetection:
    """How many of n points in view, with the claims ``probability`` (n,), one image finds together, and whether it is located.

    ``needed``: so many matches must agree for `locate` to accept a position; more than there are points where even all of them
    would not do. ``located``: probability that as many are found of the points that `locate` searches for first, or that these
    together show the place; ``located_by_points``: that as many are found.
    """

    probability: Array
    needed: int = 1
    located: float = 0.0
    located_by_points: float = 0.0

    @property
    def expected(self) -> float:
        """Number of points that are found in the mean."""
        return float(self.probability.sum())

    def of_numbers(self, most: int) -> dict[str, float]:
        """Probability that at least 1, 2, ... points are found, by number, of at most so many."""
        at_least = at_least_found(self.probability, most=most)
        return {str(k): float(p) for k, p in enumerate(at_least) if k}


def joint_detection(
    catalog: Catalog,
    rows: Index,
    sensor: Sensor,
    probability: Array,
    covariance_px2: Array,
    uncertainty: Uncertainty = USUAL,
    sun_direction: ArrayLike | None = None,
) -> JointDetection:
    """Joint detection of the points ``rows`` (n,) in view of a sensor with the claimed ``probability`` (n,) and
    the covariances (n, 2, 2) of their matches, pixels of the sensor's image; ``uncertainty``: what is known of the sensor
    when the points are searched for. Of these `locate` first looks for the points of one scale under its Sun (``sun_direction``,
    unit MCMF vector), at most `Options.most_first`.
    """
    some = np.isin(rows, searched_first(catalog, rows, sensor, sun_direction))
    order = np.argsort(-probability[some], kind="stable")[: OPTIONS.most_first]
    chosen = np.flatnonzero(some)[order]
    if not len(chosen):
        return JointDetection(np.asarray(probability, np.float64))
    p = probability[chosen]
    search = _Search(catalog, rows[chosen], sensor, p, uncertainty)
    needed, tails = search.needed(covariance_px2[chosen]), _tails(p)
    by_points = tails[:, needed] if needed <= len(p) else np.zeros(len(NODES))
    shown = np.maximum(by_points, search.ground_shows())
    located, as_many = (min(float(WEIGHTS @ chance), 1.0) for chance in (shown, by_points))
    return JointDetection(np.asarray(probability, np.float64), needed, located, as_many)


@dataclass(frozen=True, eq=False)
class _Search:
    """The search for n points in an image, those with the highest claims (n,) first."""

    catalog: Catalog
    rows: Index  # (n,)
    sensor: Sensor
    probability: Array  # (n,)
    uncertainty: Uncertainty

    @cached_property
    def factor(self) -> int:
        """Pixels of the image along the side of a searched one."""
        return reduction(self.catalog, self.sensor, self.rows)

    @cached_property
    def places(self) -> Array:
        """Positions (n, 3), MCMF metres."""
        return np.asarray(self.catalog.position_mcmf[self.rows])

    @cached_property
    def pixels(self) -> Array:
        """Where the sensor projects the points, (n, 2)."""
        return np.asarray(self.sensor.project(self.places))

    @cached_property
    def width_px(self) -> float:
        return patch_width_px(self.catalog, self.sensor, self.rows)

    @cached_property
    def reach_px(self) -> Array:
        reach = search_reach_px(self.sensor, self.places, self.uncertainty, OPTIONS.sigmas)
        least, most = OPTIONS.least_reach_px * self.factor, OPTIONS.most_reach_px * self.factor
        return np.asarray(np.clip(reach, least, most))

    def needed(self, covariance_px2: Array) -> int:
        """Fewest matches whose agreement is significant by the rule of `matching.consensus`, among themselves and the wrong
        matches (`WRONG`). Which points are found follows their claims: those at even steps of the summed claims, in the
        order of their chances to agree by accident.
        """
        probability, count_all = self.probability, len(self.rows)
        tolerance = OPTIONS.tolerance_px * self.factor
        chance = by_chance(widened(covariance_px2, tolerance), self.reach_px)
        order, minimal = np.argsort(chance), minimal_set(self.sensor, self.uncertainty)
        summed = np.cumsum(probability[order]) / max(float(probability.sum()), 1e-12)
        wrong = np.full(round(WRONG * float((1.0 - probability).sum())), float(np.median(chance)))
        for count in range(minimal + 1, count_all + 1):
            steps = (np.arange(count) + 0.5) / count
            found = order[np.minimum(np.searchsorted(summed, steps), count_all - 1)]
            agrees = np.arange(count + len(wrong)) < count
            share = independent_share(self.pixels[found], self.width_px)
            all_chances = np.append(chance[found], wrong)
            if log10_false_alarms(all_chances, agrees, minimal, share) < SIGNIFICANT:
                return count
        return count_all + 1

    def ground_shows(self) -> Array:
        """`ground_shows` for the search, (15,); 0 where `joint_offset` looks for no position: for too few points, and for an
        uncertainty that turns and scales the image.
        """
        some = slice(MOST_POINTS)
        reach = max(float(np.median(self.reach_px[some])), self.width_px)
        if len(self.rows) < FEWEST or reach > FARTHEST_PX * self.factor:
            return np.zeros(len(NODES))
        slack = slack_px(self.sensor, self.places[some], self.uncertainty)
        if slack > MOST_SLACK_PX * self.factor:
            return np.zeros(len(NODES))
        offsets = offsets_of(reach / self.factor)
        share = independent_share(self.pixels[some], self.width_px)
        return ground_shows(_inside(self.probability[some]), offsets, share)
