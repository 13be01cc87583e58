"""Probability that all points of a frame together show its place, though single points do not agree on one.

`matching.joint_offset` adds up the votes of all points for each offset of the image. A claim p_i says that the correlation at
the true place exceeds the highest other one: in sigmas of the point's map,
z_i = `RIVAL_Z` + Phi^-1(p_i) + sqrt(rho) u + sqrt(1 - rho) e_i, all of them standard normal (u: the common factor of
`matching.joint_detection`). Its vote is then -ln(1 - Phi(z_i)), but at most ln of the number of offsets, the sum of the votes is
normal for given u (patches that overlap count as fewer), and the sum that is significant is that of
`matching.search_area.coarse_shift`.

Mean and variance of the sum are sums over the points, so what a place's points add up to is known from how many of them
have which claims (`VoteTable`). A plan counts so; `lcp query` by the same functions. The promise of a
build counts points alone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import gammainccinv, log_ndtr, ndtr, ndtri

from ..arrays import Array
from .located import COMMON_VARIANCE, NODES, SIGNIFICANT, WEIGHTS, needed

RIVAL_Z = 2.7
"""Level of a point's highest rival, in sigmas of its map of correlations (artanh). The most likely one for the joint votes of 38
simulated frames under Suns of 45 to 75 deg is 2.72, for 38 others 2.74 (`benchmarks.evidence frames`, 2026-11-27); for 66 new ones
2.8 gains 0.1 +- 0.9 in log score (2026-11-29)."""

FEWEST = 10
"""Least number of points by which all together show a place."""

MOST_POINTS = 200
"""Points that are added up: the likeliest."""

MOST_SLACK_PX = 0.5
"""Largest distance (1 sigma, searched pixels) of single points from a common offset that is their place: what is known of the
camera must not turn and scale the image by more.
"""

FARTHEST_PX = 64
"""Largest reach in searched pixels, for speed; `locate` finds a coarse offset first."""

_Z = np.linspace(-4.0, 12.0, 65)
"""Levels at which the mean and the variance of a vote are computed."""


def independent_share(places_px: Array, width_px: float) -> float:
    """k_eff / k of patches of one width at places (k, 2): 1 if none overlap."""
    if width_px <= 0.0 or not len(places_px):
        return 1.0
    off = np.abs(places_px[:, None] - places_px[None])
    shared = np.clip(1.0 - off / width_px, 0.0, None).prod(-1)
    return float(len(places_px) / shared.sum())


def independent_votes(n: int, share: float) -> int:
    """Number of independent votes that stand for n dependent ones: a share of them, rounded down."""
    return max(1, math.floor(share * n))


def offsets_of(reach_px: float) -> int:
    """Number of offsets of an image that are tried, of searched pixels."""
    return (2 * math.ceil(reach_px) + 1) ** 2


def ground_shows(probability: ArrayLike, offsets: int, independent: float = 1.0) -> Array:
    """Probabilities (15,), at the nodes of the common factor, that the votes of n points with the claims (n,), above 0 and
    below 1, for their true offset, one of so many, are significant; ``independent``: the share of the points that share no
    ground.
    """
    given = VoteTable(tuple(np.asarray(probability, np.float64)), offsets)
    shown = given.shows(np.ones((1, len(given.probability))), np.array([independent]))
    return np.asarray(shown[0])


@dataclass(frozen=True)
class VoteTable:
    """The votes of points with the claims ``probability`` (k,), above 0 and below 1, in a search of so many ``offsets``."""

    probability: tuple[float, ...]
    offsets: int
    common_variance: float = COMMON_VARIANCE

    @cached_property
    def _moments(self) -> tuple[Array, Array]:
        """Mean and variance of each claim's vote at the nodes of the common factor, (k, 15) each."""
        most, common = math.log(self.offsets), self.common_variance
        levels = _Z[:, None] + math.sqrt(1.0 - common) * NODES
        votes = np.minimum(-log_ndtr(-levels), most)
        mean = votes @ WEIGHTS
        spread = np.maximum(votes**2 @ WEIGHTS - mean**2, 0.0)
        z = RIVAL_Z + ndtri(np.array(self.probability))[:, None] + math.sqrt(common) * NODES
        return np.interp(z, _Z, mean), np.interp(z, _Z, spread)

    def shows(self, numbers: Array, independent: Array) -> Array:
        """Probabilities (m, 15), at the nodes of the common factor, that the votes of a set of points are significant;
        ``numbers`` (m, k): how many of its points have each claim; ``independent`` (m,): share of those that share no ground.
        """
        mean, spread = self._moments
        count = numbers.sum(axis=1)
        sigma = np.sqrt((numbers @ spread) / independent[:, None])
        total = numbers @ mean
        least = np.array([self._least(n, s) for n, s in zip(count, independent, strict=True)])
        return np.asarray(ndtr((total - least[:, None]) / np.maximum(sigma, 1e-9)))

    def found(self, numbers: Array, chance: float) -> Array:
        """Probabilities (m, 15), at the nodes, that as many of a set of points are found as `located.needed` says; their number is
        about normal. ``numbers`` as in `shows`; ``chance``: of a match to agree by accident.
        """
        claims, rho = np.array(self.probability), self.common_variance
        moved = (ndtri(claims)[:, None] + math.sqrt(rho) * NODES) / math.sqrt(1.0 - rho)
        p, count = ndtr(moved), numbers.sum(axis=1)
        mean = (numbers @ claims) / np.maximum(count, 1e-9)
        least = [
            needed(round(n), m, chance) for n, m in zip(count.tolist(), mean.tolist(), strict=True)
        ]
        spare = numbers @ p - (np.array(least) - 0.5)[:, None]
        return np.asarray(ndtr(spare / np.sqrt(np.maximum(numbers @ (p * (1.0 - p)), 1e-9))))

    def _least(self, count: float, independent: float) -> float:
        """The sum of so many votes that is significant."""
        votes = independent_votes(int(count), independent)
        return float(gammainccinv(votes, 10.0**SIGNIFICANT / self.offsets)) * float(count) / votes
