"""An image for comparison: signal, weights, sensor and Sun."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..arrays import Array, Float32, sizes
from ..cameras.sensor import Reduced, Sensor


@dataclass(frozen=True, eq=False)
class Image:
    """One image.

    ``signal`` (rows, cols) is proportional to radiance, up to an offset if that is unknown; NaN
    where it is missing. ``weight`` (rows, cols) 0..1 is 0 where the signal is missing or saturated.
    The Sun is a position (``sun_position_mcmf_m``) or one direction for the whole image
    (``sun_direction_mcmf``). ValueError for shapes that differ from the sensor's, and unless
    exactly one Sun is given.

    Examples
    --------
    >>> image = lcp.open_image(folder / "AS15-M-0414.png", camera)
    >>> image.name, image.reduced(4).signal.shape
    ('AS15-M-0414.png', (101, 101))
    """

    name: str
    signal: Float32
    weight: Float32
    sensor: Sensor
    sun_position_mcmf_m: Array | None = None
    sun_direction_mcmf: Array | None = None
    saturated_share: float = 0.0
    missing_share: float = 0.0

    __repr__ = sizes

    def __post_init__(self) -> None:
        if self.signal.shape != self.sensor.shape or self.weight.shape != self.sensor.shape:
            raise ValueError(
                f"{self.name}: {self.signal.shape} pixels, {self.sensor.shape} in the camera"
            )
        if (self.sun_position_mcmf_m is None) == (self.sun_direction_mcmf is None):
            raise ValueError(f"{self.name}: give either a position or a direction of the Sun")

    def sun_directions(self, points_mcmf_m: ArrayLike) -> Array:
        """Unit MCMF directions (..., 3) from points (..., 3) to the Sun."""
        points = np.asarray(points_mcmf_m, dtype=np.float64)
        if self.sun_position_mcmf_m is None:
            return np.broadcast_to(np.asarray(self.sun_direction_mcmf), points.shape)
        away = self.sun_position_mcmf_m - points
        return np.asarray(away / np.linalg.norm(away, axis=-1, keepdims=True))

    def with_sensor(self, sensor: Sensor) -> Image:
        """The same image with another sensor."""
        return replace(self, sensor=sensor)

    def reduced(self, factor: int) -> Image:
        """The image with blocks of ``factor`` x ``factor`` pixels as one: weighted means. The
        weight of a block is the mean of the weights of its pixels.
        """
        if factor == 1:
            return self
        rows, cols = (n // factor for n in self.signal.shape)
        block = np.s_[: rows * factor, : cols * factor]
        weight = self.weight[block].astype(np.float64)
        light = np.where(weight > 0.0, np.nan_to_num(self.signal[block]), 0.0) * weight
        sums = [
            values.reshape(rows, factor, cols, factor).sum(axis=(1, 3))
            for values in (light, weight)
        ]
        with np.errstate(invalid="ignore"):
            signal = np.where(sums[1] > 0.0, sums[0] / sums[1], np.nan).astype(np.float32)
        share = (sums[1] / factor**2).astype(np.float32)
        return replace(self, signal=signal, weight=share, sensor=Reduced(self.sensor, factor))

    @cached_property
    def valid(self) -> NDArray[np.bool_]:
        """Mask (rows, cols): True for pixels with a finite signal and a positive weight."""
        return np.asarray((self.weight > 0.0) & np.isfinite(self.signal))
