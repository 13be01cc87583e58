"""Scores of a catalogue's claims: detection probability, usability and 1-sigma ellipses, compared
with searches in images.

Scores of the probabilities follow Brier (1950, Monthly Weather Review 78, 1-3); reliability and the
expected calibration error are those of Naeini et al. (2015, AAAI 29, 2901-2907) with bins of equal
width.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import Array, Mask
from ..geometry.ellipses import ellipse_covariance

BINS = 10
"""Number of bins of predicted probability, of equal width, from 0 to 1. A value on a limit belongs
to the bin above it; 1 belongs to the last bin.
"""

GATE_SIGMAS = 3.0
"""Distance from the true place in units of the stated 1-sigma ellipse within which a place is the
true one.
"""

GATE_PX = 1.5
"""Least distance from the true place, in pixels of the searched image, within which a place is the
true one.
"""

_ON_LIMIT = 1e-5
"""Share of a bin's width by which a packed probability on a limit may lie below it."""

Z95 = 1.959964
"""Quantile 0.975 of the normal distribution."""


@dataclass(frozen=True, eq=False)
class Claims:
    """Claims on n points in an image, and results of their search.

    A trial is a point that was searched for and whose surroundings the image shows
    (`claim_trials`). ``error_m`` is the place found minus the true place on the ground.
    """

    probability: Array  # (n,) claimed detection probability, NaN: no claim
    usable: Mask  # (n,) claimed usable
    sigma_m: Array  # (n, 2) claimed 1 sigma, major and minor axis, NaN: no claim
    angle_deg: Array  # (n,) of the major axis, clockwise from north
    tried: Mask  # (n,)
    found: Mask  # (n,) found at the true place; False without a trial
    error_m: Array  # (n, 2) east, north; NaN: not measured
    reason: str = ""  # for which there are no trials; empty with trials

    @classmethod
    def none(cls, count: int = 0, reason: str = "") -> Claims:
        """``count`` points without claims and trials."""
        no, unknown = np.zeros(count, bool), np.full(count, np.nan)
        pairs = np.full((count, 2), np.nan)
        return cls(unknown, no, pairs, unknown, no, no, pairs, reason)

    @classmethod
    def pooled(cls, parts: Sequence[Claims]) -> Claims:
        """All points of several images together."""
        names = [f.name for f in fields(cls) if f.name != "reason"]
        if not parts:
            return cls.none(reason="no image was searched")
        arrays = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
        reasons = dict.fromkeys(part.reason for part in parts if part.reason)
        return cls(**arrays, reason="" if arrays["tried"].any() else "; ".join(reasons))

    def __len__(self) -> int:
        return len(self.probability)

    @property
    def claimed(self) -> Mask:
        """True (n,) for points with a claim."""
        return np.isfinite(self.probability)

    @property
    def covariance_m2(self) -> Array:
        """Claimed covariances (n, 2, 2) of a match on the ground, axes east and north."""
        return ellipse_covariance(self.sigma_m, self.angle_deg)

    @property
    def squared_error(self) -> Array:
        """Squared errors (n,) in units of the claimed covariance; the expectation is 2. NaN where
        one of the two is unknown.
        """
        return squared_distance(self.error_m, self.covariance_m2)


@dataclass(frozen=True)
class Bin:
    """Trials whose predicted probability lies in [low, high): their number, the mean prediction, and
    the share that was found; NaN for an empty bin.
    """

    low: float
    high: float
    count: int
    predicted: float
    observed: float

    @property
    def interval(self) -> tuple[float, float]:
        """Limits of the true share at 95 % confidence (`wilson_interval`)."""
        found = 0 if not self.count else round(self.observed * self.count)
        return wilson_interval(found, self.count)


@dataclass(frozen=True)
class Scores:
    """Scores of claims; NaN for what was not measured.

    ``count``: trials with a claim. ``unclaimed``: points without a claim, left out of all scores.
    ``brier``: mean of (p - found)^2; ``brier_of_the_mean``: the same for the observed share as a
    constant prediction. ``expected_calibration_error``: mean of abs(predicted - observed) of the
    bins, weighted by their counts. ``normalised_squared_error``: mean of e^T Cov^-1 e / 2 of the
    ``errors`` usable points that were found; 1 for right covariances, and 0.95 for normal errors
    cut off at `GATE_SIGMAS`. ``normalised_squared_error_median``: their median over 2 ln 2, its
    value for normal errors; single outliers do not change it.
    """

    count: int
    unclaimed: int
    usable: int
    found: int
    brier: float
    brier_of_the_mean: float
    expected_calibration_error: float
    found_of_usable: float
    found_of_unusable: float
    usable_of_found: float
    errors: int
    normalised_squared_error: float
    normalised_squared_error_median: float
    reliability: tuple[Bin, ...]
    reason: str = ""  # for which there are no trials

    def figures(self) -> dict[str, Any]:
        """``claims`` in ``report.json``."""
        figures = {f.name: getattr(self, f.name) for f in fields(self)}
        rows = [[b.low, b.high, b.count, b.predicted, b.observed] for b in self.reliability]
        return figures | {"reliability": rows}


def score(claims: Claims) -> Scores:
    """Scores of claims, over all trials with a claim."""
    use = claims.tried & claims.claimed
    p, found, usable = claims.probability[use], claims.found[use], claims.usable[use]
    share = _mean(found)
    reliability = bins(p, found)
    squared = claims.squared_error[use & claims.usable & claims.found]
    squared = squared[np.isfinite(squared)]
    return Scores(
        count=int(use.sum()),
        unclaimed=int((~claims.claimed).sum()),
        usable=int(usable.sum()),
        found=int(found.sum()),
        brier=_mean((p - found) ** 2),
        brier_of_the_mean=share * (1.0 - share),
        expected_calibration_error=_calibration_error(reliability),
        found_of_usable=_mean(found[usable]),
        found_of_unusable=_mean(found[~usable]),
        usable_of_found=_mean(usable[found]),
        errors=len(squared),
        normalised_squared_error=_mean(squared) / 2.0,
        normalised_squared_error_median=_median(squared) / (2.0 * math.log(2.0)),
        reliability=reliability,
        reason=claims.reason,
    )


def bins(probability: ArrayLike, found: ArrayLike) -> tuple[Bin, ...]:
    """`BINS` bins of the trials (n,) by predicted probability."""
    p, seen = np.asarray(probability, np.float64), np.asarray(found, bool)
    place = np.clip(np.floor(BINS * p + _ON_LIMIT), 0, BINS - 1).astype(np.int64)
    return tuple(
        Bin(k / BINS, (k + 1) / BINS, int(inside.sum()), _mean(p[inside]), _mean(seen[inside]))
        for k in range(BINS)
        for inside in [place == k]
    )


def wilson_interval(found: int, count: int, z: float = Z95) -> tuple[float, float]:
    """Confidence limits of a probability after ``found`` successes in ``count`` trials, at ``z``
    sigmas (Wilson 1927, JASA 22, 209-212); (0, 1) without trials.
    """
    if not count:
        return 0.0, 1.0
    share, more = found / count, z * z / count
    middle = (share + more / 2.0) / (1.0 + more)
    half = z * math.sqrt(share * (1.0 - share) / count + more / (4.0 * count)) / (1.0 + more)
    return max(min(middle - half, share), 0.0), min(max(middle + half, share), 1.0)


def squared_distance(error: Array, covariance: Array) -> Array:
    """Squared Mahalanobis distances (n,) of errors (n, 2) for covariances (n, 2, 2); NaN where one of
    the two is not finite, or the covariance is singular.
    """
    xx, xy, yy = covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1]
    east, north = error.T
    area = xx * yy - xy * xy
    with np.errstate(divide="ignore", invalid="ignore"):
        squared = (yy * east**2 - 2.0 * xy * east * north + xx * north**2) / area
    known = np.isfinite(squared) & (area > 0.0)
    return np.where(known, squared, np.nan)


def _calibration_error(reliability: Sequence[Bin]) -> float:
    filled = [b for b in reliability if b.count]
    total = sum(b.count for b in filled)
    off = sum(b.count * abs(b.predicted - b.observed) for b in filled)
    return off / total if total else math.nan


def _median(values: Array) -> float:
    return float(np.median(values)) if len(values) else math.nan


def _mean(values: Array | Mask) -> float:
    return float(np.mean(values, dtype=np.float64)) if len(values) else math.nan
