"""Prediction of a match from a catalogue's claims: detection probability and error ellipse of a point
under a Sun, a view and an image scale between those that were evaluated.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import Array, Index, Mask
from ..geometry.bounds import turned_deg, wrapped_deg
from ..geometry.ellipses import ellipse_covariance
from ..geometry.frames import direction_enu
from ..landmarks.point_spread import border_px, sharper_sigma
from ..landmarks.relief_signal import log_of, log_signal, peak_height, probability_at, relief_signal
from .catalogue import Catalog
from .point_errors import slope_sigma
from .schema import DETECTION_STEP, PACKED, UNOCCLUDED, UNSHADOWED, reaches

VIEW_REACH_DEG = 20.0
"""Distance of a view from those of the catalogue up to which the claims of the nearest hold. In two regions with
views at 0 and 50 deg, 99 to 100 % of the points claimed usable at 30 deg, between the views, are usable, and
96 to 100 % at 55 to 70 deg, 5 to 20 deg beyond them (before `BEYOND_MARGIN`); the mean error of the probability is
0.01 to 0.05 at both.
"""

BEYOND_DEG = 2.5
"""Distance of a Sun from the lowest and the highest of the catalogue up to which their claims hold, at most. In Embree's frames of
two regions no farther below or above them, claims of 0.97 and 0.56 were found in 0.97 and 0.56; 2.5 to 7.5 deg below 15 deg
claims of 0.99 in 0.87 (e92825c0, 2026-11-30).
"""

LONE_STEP_DEG = 10.0
"""Step of a grid with one Sun elevation or azimuth."""

BETWEEN_MARGIN = 0.5
"""Logits by which the mean probability must exceed the least one between the grid's angles, times
1 - (sum of the squared weights of evaluated conditions), which is 0 at a grid angle. Measured by
`claims_between_angles.py` of c896266: without margins 94 % of the points claimed usable under
random Suns and views are usable there, with them 99 %.
"""

BEYOND_MARGIN = 1.5
"""The same for a condition beyond the evaluated ones, times the weight that is missing: that of the
neighbours that were not evaluated, and up to a half for a view outside those of the catalogue.
"""

FREE_SHARE = 0.7
"""Least share of the weight of evaluated conditions that is unshadowed and unoccluded, of a usable
point.
"""

_LEAST_WEIGHT = 1e-9
"""Corners with a smaller weight do not count."""

CAUSES = (
    "usable",
    "sun",  # below the horizon, or outside the evaluated elevations and azimuths
    "view",  # more than `VIEW_REACH_DEG` from the evaluated ones
    "scale",  # pixel coarser than the coarsest evaluated one
    "not evaluated",
    "shadow",  # of terrain outside the patch
    "occlusion",  # by terrain outside the patch
    "detection",  # the probability is below the least one of a usable condition
)
"""Why a point is not usable: the first of these that holds."""


@dataclass(frozen=True, eq=False)
class Prediction:
    """Claims of n points in an image. NaN and False: no claim, because the catalogue makes none or the
    condition lies outside what was evaluated.
    """

    detection_probability: Array  # (n,)
    sigma_major_m: Array  # (n,) 1-sigma on the ground along the major axis of the error ellipse
    sigma_minor_m: Array  # (n,)
    sigma_angle_deg: Array  # (n,) of the major axis, clockwise from north, 0..180
    cause: Index  # (n,) number in `CAUSES`; 0 for usable points and no others

    @property
    def usable(self) -> Mask:
        """True for points that can be used, (n,)."""
        return np.asarray(self.cause == 0)

    @property
    def covariance_m2(self) -> Array:
        """Covariances (n, 2, 2) of a match on the ground, axes east and north."""
        sigma = np.stack([self.sigma_major_m, self.sigma_minor_m], axis=-1)
        return ellipse_covariance(sigma, self.sigma_angle_deg)


@dataclass(frozen=True)
class _Weights:
    """Neighbours along one axis of the grid: indices (n, k) and weights (n, k), rows of zeros where
    outside.
    """

    index: Index
    weight: Array

    def some(self, which: Index) -> _Weights:
        return _Weights(self.index[which], self.weight[which])


def predict(
    catalog: Catalog,
    rows: ArrayLike,
    sun_enu: ArrayLike,
    view_enu: ArrayLike,
    pixel_m: ArrayLike,
    altitude_km: ArrayLike = math.inf,
    factor: ArrayLike = 1,
) -> Prediction:
    """Claims of the points ``rows`` (n,) under directions to the Sun and to the camera, (n, 3) unit
    vectors in each point's own east-north-up frame, for pixels of ``pixel_m`` (n,) on the ground
    and a camera at ``altitude_km`` (n,) or () above the points. ``factor`` (n,) or (): how many times
    the image is reduced for the search, which makes sigmas smaller
    (`landmarks.point_spread.sharper_sigma`) and templates larger (`border_px`).

    Weights are linear in the Sun's elevation and azimuth, in the logarithm of pixel over cell, and
    barycentric between views in the azimuthal equidistant plane. Where a catalogue has views at
    several altitudes, weights are linear in one over the altitude, to which the effects of
    perspective are proportional; beyond the lowest and the highest those of the nearest hold, and
    an altitude without a view in reach of the direction leaves its weight to the other. Only evaluated conditions count,
    and at least half of the weight must be theirs. Probabilities are averaged as heights of the peak over
    how clearly relief shows (`relief_signal`), ellipses as logarithms of their covariance matrices
    (log-Euclidean mean: Arsigny et al. 2006, SIAM J. Matrix Anal. Appl. 29, 328) with sigmas times the
    same. A pixel below the cell counts as the cell: the image is reduced to it. No claim: Suns more
    than half a step outside the grid, or `BEYOND_DEG` below or above it, views more than 20 deg
    from the catalogue's, pixels above the coarsest scale, and a Sun or camera below the horizon.

    ``usable``: the mean probability is at least `Catalog.min_detection` by the margins
    `BETWEEN_MARGIN` and `BEYOND_MARGIN`, conditions with at least `FREE_SHARE` of the weight are
    unshadowed and unoccluded, and the Sun lies within the grid's elevations. ValueError for arrays
    of unequal lengths.
    """
    rows = np.asarray(rows, np.int64).reshape(-1)
    sun, view = (np.asarray(a, np.float64).reshape(-1, 3) for a in (sun_enu, view_enu))
    pixel = np.asarray(pixel_m, np.float64).reshape(-1)
    if not len(rows) == len(sun) == len(view) == len(pixel):
        raise ValueError("rows, sun_enu, view_enu and pixel_m differ in length")
    if not len(rows):
        return _none(len(rows))
    axes = (
        _scale_weights(catalog, pixel / catalog.gsd[rows]),
        _view_weights(catalog, view, np.broadcast_to(altitude_km, len(rows))),
        *_sun_weights(catalog, sun),
    )
    scale, at_view, elevation, azimuth = (axis.weight.sum(axis=1) <= 0.0 for axis in axes)
    inside = np.flatnonzero(~(scale | at_view | elevation | azimuth))
    found = _none(len(rows))
    if len(inside):
        slope = slope_sigma(catalog, rows[inside])
        bright = float(catalog.errors.get("albedo_sigma", 0.0))
        signal = log_signal(sun[inside], view[inside], bright, slope)
        reduced = np.broadcast_to(factor, len(rows))[inside]
        for name, values in vars(
            _interpolated(catalog, rows[inside], axes, inside, signal, slope, reduced)
        ).items():
            getattr(found, name)[inside] = values
    sharper = sharper_sigma(factor)
    major, minor = sharper * found.sigma_major_m, sharper * found.sigma_minor_m
    dark = elevation | azimuth | ~_between_elevations(catalog, sun)
    outside = zip(("scale", "view", "sun"), (scale, at_view, dark), strict=True)
    cause = found.cause
    for name, where in outside:  # the last one that holds is the first of `CAUSES`
        cause = np.where(where, CAUSES.index(name), cause)
    return replace(found, sigma_major_m=major, sigma_minor_m=minor, cause=cause)


def conditions_used(
    catalog: Catalog, sun_enu: Array, view_enu: Array, altitude_km: Array
) -> tuple[Mask, Mask]:
    """True for the views (v,) and for the Suns (e, a) whose claims `predict` takes into account for directions (n, 3)
    and altitudes (n,).
    """
    view = _view_weights(catalog, view_enu, altitude_km)
    up, along = _sun_weights(catalog, sun_enu)
    views = np.zeros(len(catalog.view_off_nadir), bool)
    reached = view.weight.reshape(len(sun_enu), -1, 3).sum(axis=2) > _LEAST_WEIGHT
    views[view.index.reshape(len(sun_enu), -1, 3)[reached]] = True  # all corners of a triangle
    index, weight = _combined((up, along))
    suns = np.zeros((len(catalog.sun_elevation), len(catalog.sun_azimuth)), bool)
    suns[tuple(axis[weight > _LEAST_WEIGHT] for axis in index)] = True
    return views, suns


def _between_elevations(catalog: Catalog, sun: Array) -> Mask:
    """True for Suns within the grid's elevations, with slack for rounding. Below the lowest, shadows
    grow faster than a margin could tell: 79 % of points claimed there would be usable.
    """
    elevation = _elevation_deg(sun)
    low, high = catalog.sun_elevation[0] - 1e-6, catalog.sun_elevation[-1] + 1e-6
    return np.asarray((elevation >= low) & (elevation <= high))


def _elevation_deg(sun: Array) -> Array:
    return np.asarray(np.degrees(np.arctan2(sun[:, 2], np.hypot(sun[:, 0], sun[:, 1]))))


def _none(count: int) -> Prediction:
    probability, major, minor, angle = (np.full(count, np.nan) for _ in range(4))
    cause = np.full(count, CAUSES.index("not evaluated"))
    return Prediction(probability, major, minor, angle, cause)


def _interpolated(
    catalog: Catalog,
    rows: Index,
    axes: tuple[_Weights, ...],
    which: Index,
    signal: Array,
    slope: Array,
    factor: Index,
) -> Prediction:
    """Weighted means over all combinations of the neighbours along the axes, of which ``which`` (n,)
    are those of the points ``rows`` (n,); ``signal`` (n,): how clearly relief shows there; ``slope`` (n,): 1 sigma
    of slopes; ``factor`` (n,): of the images' reduction.
    """
    index, weight = _combined(tuple(axis.some(which) for axis in axes))
    flags = catalog.at("condition", rows, index[1:])
    given = {name: catalog.at(name, rows, index).astype(np.float64) for name in PACKED}
    probability = given["detection_probability"]
    known = np.isfinite(probability) & (weight > _LEAST_WEIGHT)
    whole = weight.sum(axis=1)
    weight = np.where(known, weight, 0.0)
    enough = (weight.sum(axis=1) >= 0.5 * whole) & (whole > 0.0)
    gain = signal[:, None] - _grid_signal(
        catalog, index, slope
    )  # sigmas fall as relief shows more clearly
    mean_logit = _mean_logit(probability, weight, gain + _log_wider(catalog, index[0], factor))
    free = UNSHADOWED | UNOCCLUDED
    clear, unshadowed, unoccluded = (
        np.where((flags & wanted) == wanted, weight, 0.0).sum(axis=1)
        for wanted in (free, UNSHADOWED, UNOCCLUDED)
    )
    independent = clear >= FREE_SHARE * weight.sum(axis=1) - _LEAST_WEIGHT
    spread = 1.0 - (weight**2).sum(axis=1)
    missing = 1.0 - weight.sum(axis=1)
    lowered = _logistic(mean_logit - BETWEEN_MARGIN * spread - BEYOND_MARGIN * missing)
    likely = reaches(lowered, catalog.min_detection)
    none, shadow, occlusion, unlikely = (
        CAUSES.index(name) for name in ("not evaluated", "shadow", "occlusion", "detection")
    )
    dependent = np.where(unshadowed <= unoccluded, shadow, occlusion)
    cause = np.select([~enough, ~independent, ~likely], [none, dependent, unlikely])
    major_m, minor_m = (given[name] * np.exp(-gain) for name in ("sigma_major", "sigma_minor"))
    ellipse = _mean_ellipse(major_m, minor_m, given["sigma_angle"], weight)
    columns = (np.where(enough, values, np.nan) for values in (_logistic(mean_logit), *ellipse))
    probability, major, minor, angle = columns
    return Prediction(probability, major, minor, angle, cause)


def _combined(axes: tuple[_Weights, ...]) -> tuple[list[Index], Array]:
    """Indices along each axis (n, m) and weights (n, m) of all m combinations of neighbours."""
    count = len(axes[0].index)
    shape = (count, *(axis.index.shape[1] for axis in axes))
    indices, weight = [], np.ones(shape)
    for k, axis in enumerate(axes):
        spread = [count, *(axis.index.shape[1] if j == k else 1 for j in range(len(axes)))]
        indices.append(np.broadcast_to(axis.index.reshape(spread), shape).reshape(count, -1))
        weight = weight * axis.weight.reshape(spread)
    return indices, weight.reshape(count, -1)


def _logistic(logit: Array) -> Array:
    return np.asarray(1.0 / (1.0 + np.exp(-logit)))


def _grid_signal(catalog: Catalog, index: list[Index], slope: Array) -> Array:
    """`log_signal` (n, m) in the evaluated conditions with given indices along the axes; ``slope`` (n,)."""
    _, at_view, at_elevation, at_azimuth = index
    suns = direction_enu(catalog.sun_azimuth, catalog.sun_elevation[:, None])
    views = direction_enu(catalog.view_azimuth, 90.0 - catalog.view_off_nadir)
    shown = relief_signal(suns, views[:, None, None])[at_view, at_elevation, at_azimuth]
    return log_of(shown, float(catalog.errors.get("albedo_sigma", 0.0)), slope[:, None])


def _log_wider(catalog: Catalog, scale: Index, factor: Index) -> Array:
    """Logarithm (n, m) of the side of a template in an image that is reduced ``factor`` (n,) times, over that in which it
    was evaluated, of scales with given indices (n, m): heights of peaks grow with the root of the number of pixels.
    """
    width_px = ((catalog.patch_nodes - 1) / np.asarray(catalog.image_scale, np.float64))[scale]
    here, there = (np.maximum(width_px - b, 1.0) for b in (border_px(factor)[:, None], border_px()))
    return np.asarray(np.log(here / there))


def _mean(values: Array, weight: Array) -> Array:
    """Weighted mean (n,); NaN without weight."""
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray((values * weight).sum(axis=1) / weight.sum(axis=1))


def _mean_logit(probability: Array, weight: Array, gain: Array) -> Array:
    """Logit (n,) of the mean of probabilities (n, m) of conditions than which relief shows exp(``gain``) (n, m) times as
    clearly; probabilities are kept half a step of their storage from 0 and 1. NaN without weight.
    """
    half = DETECTION_STEP / 2.0
    height = peak_height(np.clip(np.nan_to_num(probability), half, 1.0 - half)) * np.exp(gain)
    found = np.clip(probability_at(_mean(height, weight)), half, 1.0 - half)
    return np.asarray(np.log(found / (1.0 - found)))


def _mean_ellipse(
    major: Array, minor: Array, angle_deg: Array, weight: Array
) -> tuple[Array, Array, Array]:
    """Log-Euclidean mean of error ellipses, (n,) each: the logarithm of a covariance matrix with
    axes a, b and direction t is (log a + log b) I + (log a - log b) R(2t), which is linear.
    """
    weight = np.where(np.isfinite(major) & np.isfinite(angle_deg), weight, 0.0)
    tiny = np.finfo(np.float32).tiny
    log_a, log_b = (np.log(np.maximum(np.nan_to_num(v), tiny)) for v in (major, minor))
    double = np.radians(2.0 * np.nan_to_num(angle_deg))
    half_gap = (log_a - log_b) / 2.0
    terms = ((log_a + log_b) / 2.0, half_gap * np.cos(double), half_gap * np.sin(double))
    with np.errstate(invalid="ignore", divide="ignore"):
        size, cosine, sine = ((t * weight).sum(axis=1) / weight.sum(axis=1) for t in terms)
    gap = np.hypot(cosine, sine)
    return (
        np.exp(size + gap),
        np.exp(size - gap),
        np.degrees(np.arctan2(sine, cosine)) / 2.0 % 180.0,
    )


# -- axes


def _scale_weights(catalog: Catalog, scale: Array) -> _Weights:
    grid = np.log2(np.asarray(catalog.image_scale, np.float64))
    at = np.log2(np.maximum(scale, 1.0))
    return _linear(grid, at, 0.0, 1e-9)


def _view_weights(catalog: Catalog, view: Array, altitude_km: Array) -> _Weights:
    heights = np.asarray(catalog.view_altitude, np.float64)
    levels = np.unique(heights)[::-1]  # one over the altitude rises
    parts = [_directions_at(catalog, view, np.flatnonzero(heights == level)) for level in levels]
    with np.errstate(divide="ignore"):
        between = _linear(1.0 / levels, 1.0 / altitude_km, math.inf, math.inf)
    share = np.zeros((len(view), len(levels)))
    np.put_along_axis(share, between.index, between.weight, axis=1)
    reached = np.stack([part.weight.sum(axis=1) > 0.0 for part in parts], axis=1)
    share = _given_over(share, reached)
    weights = [part.weight * share[:, k : k + 1] for k, part in enumerate(parts)]
    return _Weights(
        np.concatenate([part.index for part in parts], axis=1), np.concatenate(weights, axis=1)
    )


def _given_over(share: Array, reached: Mask) -> Array:
    """Shares (n, k) of neighbours along an axis, of which the ones that are not ``reached`` give theirs to
    the nearest that is.
    """
    out = np.where(reached, share, 0.0)
    numbers = np.arange(share.shape[1])
    for k in numbers:
        others = numbers[np.argsort(np.abs(numbers - k), kind="stable")]
        left = np.flatnonzero(~reached[:, k] & (share[:, k] > 0.0) & reached.any(axis=1))
        nearest = others[np.argmax(reached[np.ix_(left, others)], axis=1)]
        out[left, nearest] += share[left, k]
    return out


def _directions_at(catalog: Catalog, view: Array, which: Index) -> _Weights:
    """Weights of the views ``which``, by their directions alone."""
    places = view_plane(catalog.view_off_nadir[which], catalog.view_azimuth[which])
    off = np.degrees(np.arctan2(np.hypot(view[:, 0], view[:, 1]), view[:, 2]))
    azimuth = np.degrees(np.arctan2(view[:, 0], view[:, 1]))
    corners, weights, away = ViewMesh.of(places).weights(view_plane(off, azimuth))
    weights *= (1.0 - 0.5 * away / VIEW_REACH_DEG)[:, None]
    weights[(away > VIEW_REACH_DEG) | (off >= 90.0)] = 0.0
    return _Weights(which[corners], weights)


def _sun_weights(catalog: Catalog, sun: Array) -> tuple[_Weights, _Weights]:
    """Weights along the Sun's elevation and azimuth."""
    elevation = _elevation_deg(sun)
    azimuth = turned_deg(np.degrees(np.arctan2(sun[:, 0], sun[:, 1])))
    grid = np.asarray(catalog.sun_elevation, np.float64)
    lowest, highest = claimed_elevations(grid)
    vertical = _linear(grid, elevation, grid[0] - lowest, highest - grid[-1])
    vertical.weight[elevation <= 0.0] = 0.0
    return vertical, _azimuth_weights(np.asarray(catalog.sun_azimuth, np.float64), azimuth)


def claimed_elevations(grid: Array) -> tuple[float, float]:
    """The lowest and the highest Sun, degrees, above the horizon, at which claims of a rising grid of elevations hold: half a step
    beyond its ends, `BEYOND_DEG` at most, where they are those of the end.
    """
    first, last = (min(step / 2.0, BEYOND_DEG) for step in _end_steps(grid))
    return max(float(grid[0]) - first, 0.0), float(grid[-1]) + last


def _end_steps(grid: Array) -> tuple[float, float]:
    """First and last step of a rising grid."""
    steps = np.diff(grid) if len(grid) > 1 else np.array([LONE_STEP_DEG])
    return float(steps[0]), float(steps[-1])


def _azimuth_weights(grid: Array, azimuth: Array) -> _Weights:
    """Linear weights along the azimuths; they wrap if the gap over north is no wider than the widest
    step.
    """
    steps = np.diff(grid)
    if len(grid) > 1 and grid[0] + 360.0 - grid[-1] <= steps.max() + 1e-9:
        wrapped = np.append(grid, grid[0] + 360.0)
        found = _linear(wrapped, (azimuth - grid[0]) % 360.0 + grid[0], 0.0, 0.0)
        return _Weights(found.index % len(grid), found.weight)
    first, last = _end_steps(grid)
    middle = (grid[0] + grid[-1]) / 2.0
    near = wrapped_deg(azimuth - middle) + middle
    return _linear(grid, near, first / 2.0, last / 2.0)


def _linear(grid: Array, at: Array, below: float, above: float) -> _Weights:
    """Linear weights of the two neighbours in a rising grid; outside it the end's alone, up to
    ``below`` and ``above``, and none farther out or for NaN.
    """
    inside = (at >= grid[0] - below) & (at <= grid[-1] + above)
    at = np.clip(np.where(inside, at, grid[0]), grid[0], grid[-1])
    right = np.clip(np.searchsorted(grid, at, side="right"), 1, max(len(grid) - 1, 1))
    if len(grid) == 1:
        zero = np.zeros((len(at), 1), np.int64)
        return _Weights(zero, np.where(inside, 1.0, 0.0)[:, None])
    left = right - 1
    share = (at - grid[left]) / (grid[right] - grid[left])
    weight = np.stack([1.0 - share, share], axis=-1) * inside[:, None]
    return _Weights(np.stack([left, right], axis=-1), weight)


# -- between views

_TOUCHING = 1e-9
"""Slack, in degrees, for a place on the border of a triangle or a circle."""


def view_plane(off_nadir_deg: ArrayLike, azimuth_deg: ArrayLike) -> Array:
    """Places of directions in the azimuthal equidistant plane about the vertical, degrees, (..., 2):
    x east, y north.
    """
    off, azimuth = np.asarray(off_nadir_deg, np.float64), np.radians(azimuth_deg)
    return np.stack([off * np.sin(azimuth), off * np.cos(azimuth)], axis=-1)


@dataclass(frozen=True)
class ViewMesh:
    """Delaunay triangles of places (v, 2); for places on one line its segments, for one place that
    place alone.
    """

    places: Array
    simplices: Index  # (m, 3); a segment repeats its last corner, a single place is (0, 0, 0)

    @classmethod
    def of(cls, places: Array) -> ViewMesh:
        """The mesh of some ten places; the triples of places are all tried."""
        places = np.asarray(places, np.float64)
        found = [t for t in itertools.combinations(range(len(places)), 3) if _empty(places, t)]
        if not found and len(places) > 1:
            spread = np.ptp(places, axis=0)
            order = np.lexsort(
                (places[:, int(np.argmin(spread))], places[:, int(np.argmax(spread))])
            )
            found = [(int(a), int(b), int(b)) for a, b in itertools.pairwise(order)]
        return cls(places, np.array(found or [(0, 0, 0)], dtype=np.int64))

    def weights(self, at: Array) -> tuple[Index, Array, Array]:
        """Corners (n, 3) and their weights (n, 3), 0 or above with a sum of 1, at places (n, 2); and the
        distance of each place from the mesh (n,), 0 inside. Outside the weights are those of the
        nearest place of the mesh.
        """
        count = len(at)
        best = np.full(count, np.inf)
        corners = np.zeros((count, 3), np.int64)
        weights = np.tile([1.0, 0.0, 0.0], (count, 1))
        for simplex in self.simplices:
            share = _nearest(self.places[simplex], at)
            away = np.linalg.norm(share @ self.places[simplex] - at, axis=-1)
            better = away < best - _TOUCHING
            best[better], corners[better], weights[better] = away[better], simplex, share[better]
        return corners, weights, np.where(best <= _TOUCHING, 0.0, best)


def _empty(places: Array, triple: tuple[int, int, int]) -> bool:
    """True for a triangle whose circumcircle has no other place inside."""
    a, b, c = places[list(triple)]
    double = 2.0 * ((b - a)[0] * (c - a)[1] - (b - a)[1] * (c - a)[0])
    if abs(double) < 1e-6:
        return False
    p, q = (b - a) @ (b - a), (c - a) @ (c - a)
    centre = a + np.array(
        [(c - a)[1] * p - (b - a)[1] * q, (b - a)[0] * q - (c - a)[0] * p]
    ) / double  # fmt: skip
    radius = float(np.linalg.norm(centre - a))
    others = np.delete(places, list(triple), axis=0)
    return bool((np.linalg.norm(others - centre, axis=-1) >= radius - 1e-6).all())


def _nearest(corners: Array, at: Array) -> Array:
    """Barycentric weights (n, 3) of the place in a triangle (3, 2) nearest to each place (n, 2)."""
    inside = _barycentric(corners, at)
    within = (inside >= -_TOUCHING).all(axis=-1)
    best = np.full(len(at), np.inf)
    out = np.tile([1.0, 0.0, 0.0], (len(at), 1))
    for i, j in ((0, 1), (1, 2), (0, 2)):
        edge = corners[j] - corners[i]
        length = float(edge @ edge)
        along = (
            np.clip((at - corners[i]) @ edge / length, 0.0, 1.0) if length else np.zeros(len(at))
        )
        away = np.linalg.norm(corners[i] + along[:, None] * edge - at, axis=-1)
        better = away < best
        best[better] = away[better]
        share = np.zeros((len(at), 3))
        share[:, i], share[:, j] = 1.0 - along, along
        out[better] = share[better]
    out[within] = np.clip(inside[within], 0.0, 1.0)
    return out


def _barycentric(corners: Array, at: Array) -> Array:
    """Barycentric coordinates (n, 3); -1 for a triangle without area."""
    sides = np.stack([corners[1] - corners[0], corners[2] - corners[0]], axis=-1)
    if abs(np.linalg.det(sides)) < 1e-9:
        return np.full((len(at), 3), -1.0)
    two = np.linalg.solve(sides, (at - corners[0]).T).T
    return np.concatenate([1.0 - two.sum(axis=-1, keepdims=True), two], axis=-1)
