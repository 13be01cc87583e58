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


@dataclass(frozen=True)
class ErrorModel:
    """Differences between image and render; ConfigError for values that are negative or not finite.

    ``sensor_noise``: 1 sigma of a pixel relative to the mean signal, white. ``height_sigma_m``,
    ``height_length_m``: 1 sigma and correlation length of the DEM's height errors.
    ``albedo_sigma``, ``albedo_length_m``: relative 1 sigma and correlation length of brightness of
    the ground that the render lacks. ``position_sigma_m``: 1 sigma, for each axis, of a patch's
    place on the ground, from errors of the DEM's control and of the camera model that are not
    common to an image. ``spread``: standard deviation of the logarithm of the noise between places;
    the noise of a place is that of the model times exp(spread x), x normal.
    """

    sensor_noise: float = 0.02
    height_sigma_m: float = 10.0
    height_length_m: float = 500.0
    albedo_sigma: float = 0.05
    albedo_length_m: float = 2000.0
    position_sigma_m: float = 0.0
    spread: float = 0.0

    def __post_init__(self) -> None:
        for name, value in dataclasses.asdict(self).items():
            if not 0.0 <= value < math.inf:
                raise ConfigError(f"errors.{name} must be 0 or above, not {value}")
        for name in ("height_length_m", "albedo_length_m"):
            if getattr(self, name) <= 0.0:
                raise ConfigError(f"errors.{name} must be above 0")

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> ErrorModel:
        """The model of a mapping with the fields' names; other keys are left out."""
        names = {f.name for f in dataclasses.fields(cls)}
        return cls(**{name: float(value) for name, value in values.items() if name in names})

    def to_dict(self) -> dict[str, float]:
        """The fields by name."""
        return dataclasses.asdict(self)


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


def noise_products(
    fields: Float32, errors: PatchErrors, model: ErrorModel, pixel_m: float
) -> tuple[Array, Array]:
    """Covariances E[(f_i . n)(f_j . n)] of the noise's products with fields f (n, m, p, p), shape
    (n, m, m), and the mean noise variance of a node, (n,).

    ``pixel_m``: side of a node's cell. The noise is not stationary: brightness and slope
    sensitivity are those of each node. The covariance of a Gaussian field is a product of its axes',
    so that each term is two multiplications with p x p matrices.
    """
    n, m, p = fields.shape[:3]
    terms = _Terms.of(model, p, pixel_m)
    east, south = errors.east[:, None], errors.south[:, None]
    by_east, by_south = fields * east, fields * south
    cross = terms.slope_cross
    smooth = np.float32(model.sensor_noise**2) * fields
    if model.height_sigma_m > 0.0:
        smooth += east * (terms.slope_along.apply(by_east) + cross.apply(by_south))
        smooth += south * (terms.slope_across.apply(by_south) + cross.apply(by_east))
    if model.albedo_sigma > 0.0:
        level = errors.level[:, None]
        smooth += level * terms.albedo.apply(fields * level)
    flat, other = (part.reshape(n, m, p * p) for part in (fields, smooth))
    products = np.matmul(flat, other.transpose(0, 2, 1)).astype(np.float64)
    variance = (
        model.sensor_noise**2
        + terms.slope_along.variance * np.mean(np.square(errors.east, dtype=np.float64), (1, 2))
        + terms.slope_across.variance * np.mean(np.square(errors.south, dtype=np.float64), (1, 2))
        + terms.albedo.variance * np.mean(np.square(errors.level, dtype=np.float64), (1, 2))
    )
    return 0.5 * (products + products.transpose(0, 2, 1)), variance


@dataclass(frozen=True, eq=False)
class _Separable:
    """Covariance of a field at nodes r, s: ``rows``[r_row, s_row] ``cols``[r_col, s_col]."""

    rows: Float32
    cols: Float32

    @property
    def variance(self) -> float:
        return float(self.rows[0, 0] * self.cols[0, 0])

    def apply(self, fields: Float32) -> Float32:
        """The covariance times fields (..., p, p)."""
        return np.asarray(np.matmul(self.rows, fields @ self.cols.T))


@dataclass(frozen=True, eq=False)
class _Terms:
    """Covariances of slope errors (east with east, south with south, east with south) and of
    unmapped brightness.
    """

    slope_along: _Separable
    slope_across: _Separable
    slope_cross: _Separable
    albedo: _Separable

    @staticmethod
    @lru_cache(maxsize=32)
    def of(model: ErrorModel, nodes: int, pixel_m: float) -> _Terms:
        """The terms for patches of ``nodes`` x ``nodes`` pixels of a side in metres."""
        step = np.arange(nodes, dtype=np.float64)
        lag = (step[:, None] - step[None]) * pixel_m
        value, first, second = (
            (model.height_sigma_m * part).astype(np.float32)
            for part in _gaussian(lag, model.height_length_m, pixel_m)
        )
        by_albedo = _gaussian(lag, model.albedo_length_m, pixel_m)[0]
        level = (model.albedo_sigma * by_albedo).astype(np.float32)
        return _Terms(
            _Separable(value, second), _Separable(second, value), _Separable(-first, first),
            _Separable(level, level),
        )  # fmt: skip


def _gaussian(lag: Array, length: float, pixel: float) -> tuple[Array, Array, Array]:
    """exp(-x^2 / 2 l^2) at lags x averaged over pixels, minus its first derivative and minus its
    second.
    """
    wide2 = length**2 + pixel**2 / 6.0
    value = length / math.sqrt(wide2) * np.exp(-0.5 * lag**2 / wide2)
    return value, lag / wide2 * value, (1.0 - lag**2 / wide2) / wide2 * value
