"""Probability that a frame is located: that so many of its points are found together as `locate` asks for.

Points of one frame fail together, because what makes one of them hard to find (the photometry, the
albedo, the DEM) is common to others. With the claims p_i of n points and one standard normal factor u
in the probits of all of them, of the variance rho,

    P(at least K found) = E_u PB_{>= K}[Phi((Phi^-1(p_i) + sqrt(rho) u) / sqrt(1 - rho))]

PB is the Poisson binomial distribution: the number of independent trials that succeed (Vasicek's one-factor
model; the mean of each probability stays p_i). The mean over u is a Gauss-Hermite sum.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtr, ndtri

from ..arrays import Array, Index
from ..cameras.sensor import Sensor, Uncertainty
from ..catalog.catalogue import Catalog
from ..catalog.schema import DETECTION_STEP
from ..landmarks.located import COMMON_VARIANCE, SIGNIFICANT, WRONG, log10_false_alarms
from .consensus import by_chance, independent_share, minimal_set, widened
from .point_choice import at_one_scale, patch_width_px, reduction
from .position_fix import USUAL, Options
from .search_area import search_reach_px

DEFAULTS = Options()

_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(15)
_WEIGHTS = _WEIGHTS / _WEIGHTS.sum()


def at_least_found(probability: ArrayLike, common_variance: float = COMMON_VARIANCE) -> Array:
    """Probabilities (n + 1,) that at least 0, 1, ... n of n points are found, whose probabilities are (n,).

    Probabilities are kept half a step of their storage from 0 and 1. ValueError for NaN.
    """
    half = DETECTION_STEP / 2.0
    p = np.clip(np.asarray(probability, np.float64).reshape(-1), half, 1.0 - half)
    if not np.isfinite(p).all():
        raise ValueError("a probability is not a number")
    moved = ndtri(p) + np.sqrt(common_variance) * _NODES[:, None]
    chance = ndtr(moved / np.sqrt(1.0 - common_variance))  # (15, n)
    count = np.zeros((len(_NODES), len(p) + 1))
    count[:, 0] = 1.0
    for k in range(len(p)):
        hit = chance[:, k : k + 1]
        count[:, 1 : k + 2] = count[:, 1 : k + 2] * (1.0 - hit) + count[:, : k + 1] * hit
        count[:, :1] *= 1.0 - hit
    tail = np.cumsum(count[:, ::-1], axis=1)[:, ::-1]
    return np.asarray(np.clip(_WEIGHTS @ tail, 0.0, 1.0))


@dataclass(frozen=True, eq=False)
class JointDetection:
    """How many of n points in view are found in one image, of which each has a claim.

    ``at_least`` (n + 1,): probability that at least 0, 1, ... n of them are found; ``needed``: so many matches
    must agree for `locate` to accept a position; above n where even all of them would not do.
    """

    expected: float  # sum of the claims
    at_least: Array
    needed: int

    @property
    def located(self) -> float:
        """Probability that as many points are found as `locate` needs."""
        return float(self.at_least[self.needed]) if self.needed < len(self.at_least) else 0.0

    def of_numbers(self, most: int) -> dict[str, float]:
        """``at_least`` by number, from one point on, of at most so many points."""
        return {str(k): float(p) for k, p in enumerate(self.at_least[: most + 1]) if k}


def joint_detection(
    catalog: Catalog,
    rows: Index,
    sensor: Sensor,
    probability: Array,
    covariance_px2: Array,
    uncertainty: Uncertainty = USUAL,
    options: Options = DEFAULTS,
) -> JointDetection:
    """Joint detection of the points ``rows`` (n,) in view of a sensor with the claimed ``probability`` (n,) and
    the covariances (n, 2, 2) of their matches, pixels of the sensor's image; ``uncertainty``: what is known of the sensor
    when the points are searched for. `locate` looks for the points of one scale, at most `Options.most_first`.
    """
    some = np.isin(rows, at_one_scale(catalog, rows, sensor))
    order = np.argsort(-probability[some], kind="stable")[: options.most_first]
    chosen = np.flatnonzero(some)[order]
    rows, p, covariance = rows[chosen], probability[chosen], covariance_px2[chosen]
    needed = _needed(catalog, rows, sensor, p, covariance, uncertainty, options) if len(rows) else 1
    return JointDetection(float(p.sum()), at_least_found(p), needed)


def _needed(
    catalog: Catalog,
    rows: Index,
    sensor: Sensor,
    probability: Array,
    covariance_px2: Array,
    uncertainty: Uncertainty,
    options: Options,
) -> int:
    """Fewest matches whose agreement is significant by the rule of `matching.consensus`, among themselves and the wrong
    matches (`WRONG`). Which points are found follows their claims: those at even steps of the summed claims, in the
    order of their chances to agree by accident.
    """
    factor = reduction(catalog, sensor, rows)
    places = catalog.position_mcmf[rows]
    reach = search_reach_px(sensor, places, uncertainty, options.sigmas)
    reach = np.clip(reach, options.least_reach_px * factor, options.most_reach_px * factor)
    chance = by_chance(widened(covariance_px2, options.tolerance_px * factor), reach)
    order, pixels = np.argsort(chance), sensor.project(places)
    minimal = minimal_set(sensor, uncertainty)
    width = patch_width_px(catalog, sensor, rows)
    summed = np.cumsum(probability[order]) / max(float(probability.sum()), 1e-12)
    wrong = np.full(round(WRONG * float((1.0 - probability).sum())), float(np.median(chance)))
    for count in range(minimal + 1, len(rows) + 1):
        steps = (np.arange(count) + 0.5) / count
        found = order[np.minimum(np.searchsorted(summed, steps), len(rows) - 1)]
        agrees = np.arange(count + len(wrong)) < count
        share = independent_share(pixels[found], width)
        if (
            log10_false_alarms(np.append(chance[found], wrong), agrees, minimal, share)
            < SIGNIFICANT
        ):
            return count
    return len(rows) + 1
