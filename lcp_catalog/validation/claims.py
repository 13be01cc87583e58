"""Scores of a catalogue's claims: detection probability, usability and 1-sigma ellipses, compared
with searches in images.

Scores of the probabilities follow Brier (1950, Monthly Weather Review 78, 1-3); reliability and the
expected calibration error are those of Naeini et al. (2015, AAAI 29, 2901-2907) with bins of equal
width.

Trials of a catalogue's claims in an image: a search for every point in view as the claims assume
it.

The claim of a point is that a search within the catalogue's search radius finds the true place and
no other. The final matches of `matching.position_fix` come from a search of a few pixels, which is
easier. Therefore every point with a claim is searched for once more, in the image as it was searched
(`matching.point_choice.working_image`), within the radius of the build. These searches do not use
the claims, which they judge.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import Array, Index, Mask
from ..cameras.sensor import Sensor, ground_errors_m, pixel_size_m
from ..catalog.catalogue import Catalog
from ..catalog.origins import origins
from ..catalog.patch_terrain import nodes_mcmf
from ..catalog.prediction import CAUSES
from ..geometry.ellipses import ellipse_covariance
from ..images.image import Image
from ..matching.matches import CODE, Matches
from ..matching.point_choice import NO_CLAIM, claimed, points_in_view, working_image
from ..matching.point_search import Criteria, find_points
from ..photometry.laws import Reflectance

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

_UNKNOWN = CAUSES.index("not evaluated")

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
    cause: Index | None = (
        None  # (n,) numbers in `prediction.CAUSES`, of points without a claim; None: not kept
    )

    @classmethod
    def none(cls, count: int = 0, reason: str = "") -> Claims:
        """``count`` points without claims and trials."""
        no, unknown = np.zeros(count, bool), np.full(count, np.nan)
        pairs = np.full((count, 2), np.nan)
        return cls(unknown, no, pairs, unknown, no, no, pairs, reason)

    @classmethod
    def pooled(cls, parts: Sequence[Claims]) -> Claims:
        """All points of several images together."""
        if not parts:
            return cls.none(reason="no image was searched")
        tried = np.concatenate([part.tried for part in parts])
        reasons = dict.fromkeys(part.reason for part in parts if part.reason)
        causes = [np.full(len(p), _UNKNOWN) if p.cause is None else p.cause for p in parts]
        return cls(
            np.concatenate([part.probability for part in parts]),
            np.concatenate([part.usable for part in parts]),
            np.concatenate([part.sigma_m for part in parts]),
            np.concatenate([part.angle_deg for part in parts]),
            tried,
            np.concatenate([part.found for part in parts]),
            np.concatenate([part.error_m for part in parts]),
            "" if tried.any() else "; ".join(reasons),
            np.concatenate(causes),
        )

    def __len__(self) -> int:
        return len(self.probability)

    @property
    def claimed(self) -> Mask:
        """True (n,) for points with a claim."""
        return np.isfinite(self.probability)

    @property
    def unclaimed_by_cause(self) -> dict[str, int]:
        """Numbers of points without a claim by the cause, of those that occur."""
        causes = np.full(len(self), _UNKNOWN) if self.cause is None else self.cause
        counts = np.bincount(causes[~self.claimed], minlength=len(CAUSES)).tolist()
        return {name: count for name, count in zip(CAUSES, counts, strict=True) if count}

    @property
    def covariance_m2(self) -> Array:
        """Claimed covariances (n, 2, 2) of a match on the ground, axes east and north."""
        return ellipse_covariance(self.sigma_m, self.angle_deg)

    @property
    def squared_distance(self) -> Array:
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

    ``count``: trials with a claim. ``unclaimed``: points without a claim, left out of all scores;
    ``unclaimed_by_cause``: the same by the causes of `catalog.prediction.CAUSES`.
    ``brier``: mean of (p - found)^2; ``brier_of_the_mean``: the same for the observed share as a
    constant prediction. ``expected_calibration_error``: mean of abs(predicted - observed) of the
    bins, weighted by their counts. ``normalised_squared_error``: mean of e^T Cov^-1 e / 2 of the
    ``errors`` usable points that were found; 1 for right covariances, and 0.95 for normal errors
    cut off at `GATE_SIGMAS`. ``normalised_squared_error_median``: their median over 2 ln 2, its
    value for normal errors; single outliers do not change it.
    """

    count: int
    unclaimed: int
    unclaimed_by_cause: dict[str, int]
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
    squared = claims.squared_distance[use & claims.usable & claims.found]
    squared = squared[np.isfinite(squared)]
    median = float(np.median(squared)) if len(squared) else math.nan
    return Scores(
        count=int(use.sum()),
        unclaimed=int((~claims.claimed).sum()),
        unclaimed_by_cause=claims.unclaimed_by_cause,
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
        normalised_squared_error_median=median / (2.0 * math.log(2.0)),
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


def wilson_interval(found: int, count: int) -> tuple[float, float]:
    """Confidence limits of a probability after ``found`` successes in ``count`` trials, at `Z95`
    sigmas (Wilson 1927, JASA 22, 209-212); (0, 1) without trials.
    """
    if not count:
        return 0.0, 1.0
    share, more = found / count, Z95 * Z95 / count
    middle = (share + more / 2.0) / (1.0 + more)
    half = Z95 * math.sqrt(share * (1.0 - share) / count + more / (4.0 * count)) / (1.0 + more)
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


def _mean(values: Array | Mask) -> float:
    return float(np.mean(values, dtype=np.float64)) if len(values) else math.nan


NO_TRIAL = tuple(CODE[reason] for reason in ("at the edge", "no data", "saturated"))
"""Codes of points whose surroundings the image does not show."""

SHOWN_SHARE = 0.9
"""Least share of a patch's nodes on valid pixels: a claim is about a patch that the image shows."""

_AT_ONCE = 256
_SEARCH_NODES = 64
"""Search radius of a build that does not state one, cells."""


@dataclass(frozen=True, eq=False)
class ClaimSearch:
    """Search for the points of a catalogue in an image, as their claims assume it.

    ``image``: at full resolution, with the best sensor known. ``true``: sensor that predicts the true
    places for the errors; None: the image's own. ``criteria``: those of the search that located the
    image.
    """

    catalog: Catalog
    image: Image
    model: Reflectance
    criteria: Criteria
    true: Sensor | None = None

    def claims(self, rows: Index, searched: bool) -> Claims:
        """Claims on points (rows (n,) of the catalogue) and results of their search. ``searched``:
        False if the image's sensor is too uncertain to tell true places, so that there is no trial.
        """
        if not len(rows):
            return Claims.none(reason="no point is in view")
        working = working_image(self.catalog, self.image, rows)
        claims = self._stated(working, rows)
        inside = np.isin(rows, points_in_view(self.catalog, self.image.sensor))
        inside[inside] = self._shown(working, rows[inside])
        if not claims.claimed.any():
            reason = "the catalogue claims nothing for this Sun, view and scale"
            return replace(claims, reason=reason)
        if not searched:
            return replace(claims, reason="the image was not located")
        return self._tried(working, rows, np.flatnonzero(claims.claimed & inside), claims)

    def _stated(self, working: Image, rows: Index) -> Claims:
        """The claims, without trials."""
        suns = working.sun_directions(self.catalog.position_mcmf[rows])
        stated = claimed(self.catalog, rows, working.sensor, suns)
        sigma = np.stack([stated.sigma_major_m, stated.sigma_minor_m], axis=-1)
        return replace(
            Claims.none(len(rows)),
            probability=np.asarray(stated.detection_probability, np.float64),
            usable=np.asarray(stated.usable, bool),
            sigma_m=sigma.astype(np.float64),
            angle_deg=np.asarray(stated.sigma_angle_deg, np.float64),
            cause=stated.cause,
        )

    def _shown(self, working: Image, rows: Index) -> Mask:
        """True for points whose patch lies in the image, with at least `SHOWN_SHARE` of its nodes on
        valid pixels, (n,).
        """
        height, width = working.signal.shape
        shown = np.zeros(len(rows), np.bool_)
        for start in range(0, len(rows), _AT_ONCE):
            part = rows[start : start + _AT_ONCE]
            pixels = working.sensor.project(nodes_mcmf(self.catalog, part))
            column, row = np.moveaxis(
                np.rint(np.nan_to_num(pixels, nan=-1.0)).astype(np.int64), -1, 0
            )
            inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
            valid = working.valid[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)]
            enough = valid.mean(axis=(1, 2)) >= SHOWN_SHARE
            shown[start : start + _AT_ONCE] = inside.all(axis=(1, 2)) & enough
        return shown

    def _tried(self, working: Image, rows: Index, chosen: Index, claims: Claims) -> Claims:
        """The claims with trials of some of them, ``chosen`` (m,)."""
        places = self.catalog.position_mcmf[rows[chosen]]
        sensor, factor = self.image.sensor, working.sensor.factor
        matches = find_points(
            self.catalog,
            working,
            self.model,
            search_radius_m(self.catalog, rows[chosen]) / pixel_size_m(sensor, places),
            points=rows[chosen],
            criteria=replace(self.criteria, prior=NO_CLAIM),
        )
        offset = matches.found_px - sensor.project(places)
        sigmas = np.sqrt(
            squared_distance(
                self._error_m(sensor, rows[chosen], matches), claims.covariance_m2[chosen]
            )
        )
        at_place = (sigmas <= GATE_SIGMAS) | (np.linalg.norm(offset, axis=-1) <= GATE_PX * factor)
        tried, found, error = claims.tried.copy(), claims.found.copy(), claims.error_m.copy()
        tried[chosen] = ~np.isin(matches.code, NO_TRIAL)
        found[chosen] = matches.found & at_place
        error[chosen] = self._error_m(self.true or sensor, rows[chosen], matches)
        return replace(claims, tried=tried, found=found, error_m=error)

    def _error_m(self, sensor: Sensor, rows: Index, matches: Matches) -> Array:
        """Places found minus those that a sensor predicts, metres on the ground."""
        places = self.catalog.position_mcmf[rows]
        offset = matches.found_px - sensor.project(places)
        return ground_errors_m(sensor, places, self.catalog.rotation_mcmf_to_enu[rows], offset)


def search_radius_m(catalog: Catalog, rows: Index) -> Array:
    """Search radius (n,) of points, metres, from the configuration of the build or, in a merged
    catalogue, of the builds with cells of the point's size.
    """
    gsd_m = catalog.gsd[rows].astype(np.float64)
    radius = _SEARCH_NODES * gsd_m
    builds = origins(catalog.config)
    for config in (build.config for build in builds):
        search_m = config.get("points", {}).get("search_m")
        if search_m is not None:
            own = (gsd_m == config.get("area", {}).get("gsd_m")) | (len(builds) == 1)
            radius[own] = search_m
    return radius
