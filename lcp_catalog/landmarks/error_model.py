"""Model of the differences between an image and the render of a DEM, and their covariance over a
patch.

The brightness of a node differs from its render by

    n = I_p dp + I_q dq + I a + L e

I_p, I_q: derivatives of the radiance I with respect to the slopes east and south; dp, dq: errors of
these slopes, the derivatives of the DEM's height error; a: relative brightness of the ground that
no map holds; e: white noise of a pixel relative to L, the mean signal of the patch. Height error
and unmapped brightness are stationary Gaussian fields with the autocorrelation
exp(-r^2 / (2 l^2)). A height error dh with variance s^2 and autocorrelation length l has slopes with
the covariances -d2C/dx2, -d2C/dxdy, -d2C/dy2 of C = s^2 exp(-r^2 / (2 l^2)): variance s^2 / l^2 for
each axis. In brightness they grow as the Sun sinks, because I_p / I is about 1 / tan(elevation)
towards the Sun; the unmapped brightness is the same at every Sun.

A pixel is a mean over its square. For these fields the mean over a side h widens l^2 by h^2 / 6 (the
second moment of the square's autocorrelation) and keeps the integral of C.

A search meets all of this noise, and a match is moved by a part of it (`ErrorModel.moving`): much of the difference between a
photograph and a render is no independent field but resembles the ground itself (detail that the DEM has smoothed away, the law of
reflectance, the film's curve), which lowers correlations and displaces nothing.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from ..arrays import Array, Float32
from ..errors import ConfigError

TYPICAL_CONTRAST, CONTRASTS = 0.06, (0.03, 0.15)
"""Local contrast of the Moon's albedo in maps of 2.7 km per pixel, and the range in which it was seen to count."""


@dataclass(frozen=True)
class ErrorModel:
    """Differences between image and render; ConfigError for values that are negative or not finite.

    ``sensor_noise``: 1 sigma of a pixel relative to the mean signal, white. ``height_sigma_m``,
    ``height_length_m``: 1 sigma and correlation length of the DEM's height errors.
    ``albedo_sigma``, ``albedo_length_m``: relative 1 sigma and correlation length of brightness of
    the ground that the render lacks. ``position_sigma_m``: 1 sigma, for each axis, of a patch's
    place on the ground, from errors of the DEM's control and of the camera model that are not
    common to an image. ``spread``: standard deviation of the logarithm of the noise between places;
    the noise of a place is that of the model times exp(spread x), x normal. ``shadow_shift``: 1 sigma,
    in cells, at grazing light, of the shift that shadows below a cell give all points of an image
    along the Sun's azimuth (`matching.pose`). ``moving_share``, ``contrast_power``: the part of a
    match's covariance in this noise that displaces matches (`moving`). ``position_sigma_cells``: least
    error of a patch's place, in cells (`place_sigma_m`). ``detection_shift``: probits that a kind of images adds
    to the probability to find a patch in this noise; the only figure that may be below 0.
    """

    sensor_noise: float = 0.02
    height_sigma_m: float = 10.0
    height_length_m: float = 500.0
    albedo_sigma: float = 0.05
    albedo_length_m: float = 2000.0
    position_sigma_m: float = 0.0
    spread: float = 0.0
    shadow_shift: float = 0.0
    moving_share: float = 1.0
    contrast_power: float = 0.0
    position_sigma_cells: float = 0.0
    detection_shift: float = 0.0

    def __post_init__(self) -> None:
        for name, value in dataclasses.asdict(self).items():
            signed = name == "detection_shift"
            if not (signed or value >= 0.0) or not math.isfinite(value):
                limits = "a finite number" if signed else "0 or above"
                raise ConfigError(f"`errors.{name}` must be {limits}, not {value}")
        for name in ("height_length_m", "albedo_length_m"):
            if getattr(self, name) <= 0.0:
                raise ConfigError(f"`errors.{name}` must be above 0")

    def moving(self, contrast: Array) -> Array:
        """Share (n,) of the covariance of a match in this noise by which matches are displaced:
        moving_share (m / `TYPICAL_CONTRAST`)^(2 contrast_power), with m the ``contrast`` (n,) of the albedo of a patch's
        ground (standard deviation over mean), within `CONTRASTS`; NaN, without a map: typical.

        Where a map shows strong contrasts, it lacks stronger ones, too.
        """
        known = np.where(np.isfinite(contrast), contrast, TYPICAL_CONTRAST)
        relative = np.clip(known, *CONTRASTS) / TYPICAL_CONTRAST
        return np.asarray(self.moving_share * relative ** (2.0 * self.contrast_power))

    def place_sigma_m(self, cell_m: Array) -> Array:
        """1 sigma (n,), for each axis, of the places of patches with cells of (n,) metres."""
        return np.maximum(self.position_sigma_m, self.position_sigma_cells * np.asarray(cell_m))

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> ErrorModel:
        """The model of a mapping with the fields' names; other keys are left out. Of several figures (a merged
        catalogue's) the largest counts.
        """
        names = {f.name for f in dataclasses.fields(cls)}
        return cls(
            **{name: float(np.max(value)) for name, value in values.items() if name in names}
        )

    def to_dict(self) -> dict[str, float]:
        """The fields by name."""
        return dataclasses.asdict(self)


def local_contrast(albedo: Float32) -> Array:
    """Standard deviation over mean (n,) of the albedo of patches (n, p, p); NaN where a node is missing."""
    whole = np.asarray(albedo, np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(whole.std(axis=(1, 2)) / whole.mean(axis=(1, 2)))


@dataclass(frozen=True, eq=False)
class PatchErrors:
    """Sources of error of n rendered patches, each (n, p, p), relative to the patch's mean signal:
    the radiance ``level`` and its derivatives with respect to the slope towards the columns
    (``east``) and the rows (``south``), 0 where a node is dark or not seen.
    """

    level: Float32
    east: Float32
    south: Float32

    def rows(self, some: Any) -> PatchErrors:
        """A selection of the patches."""
        return PatchErrors(self.level[some], self.east[some], self.south[some])


@dataclass(frozen=True, eq=False)
class NoiseTerms:
    """The noise of an `ErrorModel` on p x p pixels, as `kernels.matching.registration` applies it:
    the variances of white noise, of a slope error and of relative brightness, and for the latter two
    either their values by distance or their principal components.
    """

    variances: Array
    taps: Float32
    heights: Float32
    albedo: Float32

    @staticmethod
    @lru_cache(maxsize=256)
    def of(model: ErrorModel, nodes: int, pixel_m: float) -> NoiseTerms:
        """The terms for patches of ``nodes`` x ``nodes`` pixels of a side in metres."""
        lag = np.arange(1.0 - nodes, nodes) * pixel_m
        value, first, second = (
            model.height_sigma_m * part for part in _gaussian(lag, model.height_length_m, pixel_m)
        )
        bright = model.albedo_sigma * _gaussian(lag, model.albedo_length_m, pixel_m)[0]
        middle = nodes - 1
        heights = _slope_components(value, first, second)
        taps = np.stack([value, first, second])
        large = np.abs(taps) > _NEGLIGIBLE * np.abs(taps).max(axis=1, initial=1e-300, keepdims=True)
        reach = int(np.abs(np.flatnonzero(large.any(axis=0)) - middle).max(initial=0))
        taps = taps[:, middle - reach : middle + reach + 1]
        if _operations_by_distance(nodes, reach) > _operations_by_components(nodes, heights):
            taps = taps[:, :0]
        return NoiseTerms(
            np.array([model.sensor_noise**2, value[middle] * second[middle], bright[middle] ** 2]),
            np.ascontiguousarray(taps, dtype=np.float32),
            heights,
            _level_components(bright),
        )


_NEGLIGIBLE = 1e-5
"""Share of the greatest covariance, or of the greatest eigenvalue, below which a part is left out."""


def _operations_by_distance(nodes: int, reach: int) -> int:
    """Multiplications for each field, both ways of applying the slope errors."""
    return 8 * (2 * reach + 1) * nodes * (nodes + reach)


def _operations_by_components(nodes: int, components: Float32) -> int:
    count = components.shape[2]
    return int(2 * count * nodes * (nodes + count))


def _between(values: Array) -> Array:
    """The matrix (p, p) of values (2 p - 1,) by the difference of row and column."""
    nodes = (len(values) + 1) // 2
    step = np.arange(nodes)
    return np.asarray(values[step[:, None] - step + nodes - 1])


def _roots(covariance: Array) -> Array:
    """Principal components (r, n) of a covariance (n, n), each times the root of its variance."""
    variance, vectors = np.linalg.eigh(covariance)
    some = variance > _NEGLIGIBLE * variance[-1]
    return np.asarray((vectors[:, some] * np.sqrt(variance[some])).T)


def _slope_components(value: Array, first: Array, second: Array) -> Float32:
    """Components (2, 2, r, p) of slope errors towards the columns and the rows; the arguments as in
    `_gaussian`. Heights and derivatives at the nodes of a line have common components, of which one
    half gives the heights and the other the derivatives.
    """
    nodes = (len(value) + 1) // 2
    unit = math.sqrt(max(second[nodes - 1], 1e-300) / max(value[nodes - 1], 1e-300))
    mixed = _between(first) / unit
    joint = np.block([[_between(value), mixed], [mixed.T, _between(second) / unit**2]])
    roots = _roots(joint)
    heights, slopes = roots[:, :nodes], roots[:, nodes:] * unit
    return np.array([[heights, slopes], [slopes, heights]], dtype=np.float32)


def _level_components(value: Array) -> Float32:
    """Components (2, 1, r, p) of brightness."""
    roots = _roots(_between(value))
    return np.array([[roots], [roots]], dtype=np.float32)


def _gaussian(lag: Array, length: float, pixel: float) -> tuple[Array, Array, Array]:
    """exp(-x^2 / 2 l^2) at lags x averaged over pixels, minus its first derivative and minus its
    second.
    """
    wide2 = length**2 + pixel**2 / 6.0
    value = length / math.sqrt(wide2) * np.exp(-0.5 * lag**2 / wide2)
    return value, lag / wide2 * value, (1.0 - lag**2 / wide2) / wide2 * value
