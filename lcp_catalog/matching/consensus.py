"""The largest agreement among matches on one correction of a sensor, and its expected number by
chance.

Sets of one to m matches (2 m >= the number of unknowns) each give a correction, with the prior as
weak weights. The correction with which most matches agree is refined with all of them. A match
agrees if it lies within its gate: 3 sigma of its own covariance, widened by a tolerance for errors
that the covariances do not contain.

The background model is that of false matches, uniformly distributed in their own search areas (a
contrario: Desolneux, Moisan and Morel 2000; for geometry Moisan and Stival 2004). Match i agrees by
chance with p_i = area of its gate / its search area. The number of false alarms (NFA), the expected
number of solutions as good by chance, is at most the number of minimal sets times the probability
of such an agreement,

    NFA <= C(n, m) exp( min_t  sum_all log(1 - p_i + p_i^(1-t))  +  t sum_agreeing log p_i ),   0 < t < 1

This is Chernoff's bound for the sum of the agreeing matches' -log p_i without the m largest, which
chose the solution. Matches whose patches overlap see the same terrain and have correlated errors:
the exponent is multiplied by k_eff / k, k_eff = k^2 / sum_ij (shared area of patches i and j,
0..1).
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import Array, Index, Mask
from ..cameras.sensor import Sensor, Uncertainty
from ..errors import PoseError
from ..landmarks.ground_votes import independent_share
from ..landmarks.located import GATE, SIGNIFICANT, log10_false_alarms
from .pose import Pose, jacobian, residuals_px, solve

SHARE_IF_HERE = 0.25
"""Least share of the searchable points that agree in an image of this place. If such an agreement
would not be significant, because the points are too few, the place is not refuted.
"""

_SETS = 2000
_CHUNK = 500
_KEPT = 5
_LOOKED_AT = 200
_ROUNDS = 10
_FARTHEST = 5.0
"""Largest correction that is tried, in sigmas of the prior."""


@dataclass(frozen=True, eq=False)
class Consensus:
    """The largest agreement among n matches, and the largest among the matches outside it."""

    pose: Pose | None  # None: no agreement
    log10_false_alarms: float
    rival_log10: float

    @property
    def significant(self) -> bool:
        """True if the agreement is not by chance and no other solution is nearly as good."""
        return self.log10_false_alarms < SIGNIFICANT and self.rival_log10 > min(
            SIGNIFICANT, 0.5 * self.log10_false_alarms
        )


def agree(
    sensor: Sensor,
    points_mcmf_m: ArrayLike,
    found_px: ArrayLike,
    covariance_px2: ArrayLike,
    uncertainty: Uncertainty,
    reach_px: ArrayLike,
    *,
    tolerance_px: float = 1.0,
    width_px: float = 0.0,
    seed: int = 0,
) -> Consensus:
    """The largest agreement of matches: points (n, 3), MCMF metres, found at pixels (n, 2) with
    covariances (n, 2, 2); NaN for no match.

    Each point was searched within +-``reach_px`` (a number or (n,)) of where the sensor projects
    it. ``width_px``: side of a patch in the image, which tells how much terrain neighbours share;
    0: none.
    """
    points, found, covariance = (
        np.asarray(a, dtype=np.float64) for a in (points_mcmf_m, found_px, covariance_px2)
    )
    reach = np.broadcast_to(np.asarray(reach_px, dtype=np.float64), points.shape[:1])
    valid = np.isfinite(found).all(-1) & np.isfinite(covariance).all((-1, -2))
    valid &= np.isfinite(sensor.project(points)).all(-1)
    table = _Table(
        sensor,
        uncertainty,
        points[valid],
        found[valid],
        widened(covariance[valid], tolerance_px),
        reach[valid],
        width_px,
        seed,
    )
    best, score = table.best()
    if best is None:
        return Consensus(None, score, score)
    rest = table.only(~table.agreeing(best.sensor, 2.0 * GATE))
    used = np.zeros(len(points), dtype=bool)
    used[valid] = best.used
    return Consensus(replace(best, used=used), score, rest.best()[1])


def agreeing(
    sensor: Sensor,
    points_mcmf_m: Array,
    found_px: Array,
    covariance_px2: Array,
    tolerance_px: ArrayLike,
) -> Mask:
    """True (n,) for the matches that lie within their gates of where a sensor projects their
    points; False for NaN.
    """
    covariance = widened(covariance_px2, tolerance_px)
    return _squared(residuals_px(sensor, points_mcmf_m, found_px), covariance) <= GATE**2


def widened(covariance_px2: Array, tolerance_px: ArrayLike) -> Array:
    """Covariances (n, 2, 2) whose gates are widened by a tolerance, one or (n,), added in quadrature."""
    tolerance = np.asarray(tolerance_px, np.float64)[..., None, None]
    return np.asarray(covariance_px2 + (tolerance / GATE) ** 2 * np.eye(2))


def minimal_set(sensor: Sensor, uncertainty: Uncertainty) -> int:
    """Number of matches that determine the unknowns of a sensor."""
    return -(-int((uncertainty.sigmas(sensor) > 0.0).sum()) // 2)


def by_chance(covariance_px2: Array, reach_px: Array) -> Array:
    """p_i (n,): the share of a match's search area, +-``reach_px`` (n,), that its gate covers, by its widened
    covariance (n, 2, 2).
    """
    area = math.pi * GATE**2 * np.sqrt(np.linalg.det(covariance_px2))
    return np.asarray(area / (2.0 * reach_px + 1.0) ** 2)


@dataclass(frozen=True, eq=False)
class _Table:
    """Matches that were found, with widened covariances."""

    sensor: Sensor
    uncertainty: Uncertainty
    points: Array
    found: Array
    covariance: Array
    reach: Array
    width: float
    seed: int

    def __len__(self) -> int:
        return len(self.points)

    def only(self, rows: Mask) -> _Table:
        return replace(
            self,
            points=self.points[rows],
            found=self.found[rows],
            covariance=self.covariance[rows],
            reach=self.reach[rows],
        )

    @property
    def minimal(self) -> int:
        """Number of matches that determine the unknowns."""
        return minimal_set(self.sensor, self.uncertainty)

    def agreeing(self, sensor: Sensor, gate: float = GATE) -> Mask:
        """True (n,) for the matches within their gates of where a sensor projects their points."""
        off = residuals_px(sensor, self.points, self.found)
        return _squared(off, self.covariance) <= gate**2

    def score(self, agrees: Mask) -> float:
        """log10 of the number of false alarms."""
        chance = by_chance(self.covariance, self.reach)
        share = independent_share(self.found[agrees], self.width)
        return log10_false_alarms(chance, agrees, self.minimal, share)

    def best(self) -> tuple[Pose | None, float]:
        """The most significant agreement; (None, 0.0) if there is none."""
        if len(self) <= self.minimal:
            return None, 0.0
        solutions = [self.refined(start) for start in self.starts()]
        scored = [(self.score(pose.used), pose) for pose in solutions if pose is not None]
        if not scored:
            return None, 0.0
        log10, pose = min(scored, key=lambda pair: pair[0])
        return pose, log10

    def refined(self, agrees: Mask) -> Pose | None:
        """The pose solved from the agreeing matches, repeated until the same matches agree; None if
        fewer than a minimal set remain.
        """
        pose = None
        for _ in range(_ROUNDS):
            if agrees.sum() <= self.minimal:
                return None
            try:
                pose = solve(
                    self.sensor, self.points, self.found, self.covariance, self.uncertainty, agrees
                )
            except PoseError:
                return None
            before, agrees = agrees, self.agreeing(pose.sensor)
            if (before == agrees).all():
                return pose
        return pose

    def starts(self) -> list[Mask]:
        """Agreements under the linearised sensor that are worth refining: the best of all sets
        tried, no two alike. For a sensor without unknowns: the matches that agree with it.
        """
        if not self.minimal:
            return [self.agreeing(self.sensor)]
        linear = _Linear.of(self)
        subsets = list(_subsets(len(self), self.minimal, self.seed))
        corrections = np.concatenate([linear.corrections(rows) for rows in subsets])
        corrections = corrections[(np.abs(corrections) <= _FARTHEST).all(-1)]
        chunks = [corrections[i : i + _CHUNK] for i in range(0, len(corrections), _CHUNK)]
        gains = np.concatenate([linear.gains(chunk) for chunk in chunks]) if chunks else np.zeros(0)
        found: list[Mask] = []
        best = np.argsort(-gains, kind="stable")[:_LOOKED_AT]
        best = best[~(gains[best] < 0.3 * gains.max(initial=0.0))]
        for agrees in linear.agreeing(corrections[best]):
            if len(found) == _KEPT:
                break
            if _is_new(agrees, found):
                grown = linear.grown(agrees)
                found += [grown] if _is_new(grown, found) else []
        return found


@dataclass(frozen=True, eq=False)
class _Linear:
    """The matches' offsets as a linear function of the free corrections, which are in sigmas of the
    prior.
    """

    slope: Array  # (n, 2, f)
    offset: Array  # (n, 2)
    inverse: Array  # (n, 2, 2) of the covariances, widened by the linearisation error

    @classmethod
    def of(cls, table: _Table) -> _Linear:
        sigmas = table.uncertainty.sigmas(table.sensor)
        free = sigmas > 0.0
        slope = jacobian(table.sensor, table.points)
        expected = table.sensor.project(table.points)
        bent = np.zeros((len(table), 2, 2))
        draws = np.random.default_rng(table.seed).normal(size=(8, len(sigmas))) * sigmas
        for draw in draws:
            off = np.nan_to_num(
                table.sensor.moved(draw).project(table.points) - expected - slope @ draw
            )
            bent += off[:, :, None] * off[:, None, :] / len(draws)
        inverse = np.asarray(np.linalg.inv(table.covariance + bent), dtype=np.float64)
        return cls(slope[..., free] * sigmas[free], table.found - expected, inverse)

    def corrections(self, rows: Index) -> Array:
        """Corrections (s, f) by sets of rows (s, m) and the prior."""
        weighted = np.einsum("nia,nij->naj", self.slope, self.inverse)
        matrix = np.einsum("naj,njb->nab", weighted, self.slope)[rows].sum(1)
        right = np.einsum("naj,nj->na", weighted, self.offset)[rows].sum(1)
        eye = np.eye(matrix.shape[-1])
        return np.asarray(np.linalg.solve(matrix + eye, right[..., None])[..., 0])

    def squared(self, corrections: Array) -> Array:
        """Squared distances (s, n), in sigmas, of every match under corrections (s, f)."""
        off = self.offset - np.einsum("nia,sa->sni", self.slope, corrections)
        return np.asarray(np.einsum("sni,nij,snj->sn", off, self.inverse, off, optimize=True))

    def gains(self, corrections: Array) -> Array:
        """Quality (s,) of each correction: the sum over the matches of the squared gate less the
        squared distance, where that is positive.
        """
        return np.asarray(np.clip(GATE**2 - self.squared(corrections), 0.0, None).sum(-1))

    def agreeing(self, corrections: Array) -> Mask:
        """True (s, n) for the matches that agree with corrections (s, f)."""
        return np.asarray(self.squared(corrections) <= GATE**2)

    def grown(self, agrees: Mask) -> Mask:
        """The matches that agree with the correction solved from the agreeing ones, repeated until
        they stay the same.
        """
        for _ in range(_ROUNDS):
            before = agrees
            agrees = self.agreeing(self.corrections(np.flatnonzero(agrees)[None]))[0]
            if (agrees == before).all():
                break
        return agrees


def _is_new(agrees: Mask, others: list[Mask]) -> bool:
    """True if at most half of a set of matches lies in each of the others."""
    return all((agrees & other).sum() <= 0.5 * agrees.sum() for other in others)


def _subsets(count: int, most: int, seed: int) -> list[Index]:
    """Sets of one to ``most`` of ``count`` rows, for each size (s, size): all of them, or `_SETS`
    at random.
    """
    dice = np.random.default_rng(seed)
    found = []
    for size in range(1, most + 1):
        if math.comb(count, size) <= _SETS:
            sets = list(itertools.combinations(range(count), size))
        else:
            sets = dice.random((_SETS, count)).argpartition(size, axis=1)[:, :size].tolist()
        found.append(np.array(sets, dtype=np.int64).reshape(-1, size))
    return found


def _squared(off: Array, covariance: Array) -> Array:
    """Squared distances (n,) in sigmas; infinite for NaN."""
    known = np.isfinite(off).all(-1) & np.isfinite(covariance).all((-1, -2))
    solved = np.linalg.solve(covariance[known], off[known, :, None])[..., 0]
    squared = np.full(len(off), np.inf)
    squared[known] = (off[known] * solved).sum(-1)
    return squared
