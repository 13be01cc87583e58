"""What took an image, whatever it was: ground to pixels, pixels to rays, and what may be wrong about its place.

A sensor is a framing camera (`camera`), a line scanner or a push-frame camera (`scanners`), or a map
that an image was projected on (`map_image`). Pixel coordinates are (column, row) with pixel centres at
whole numbers. Positions are MCMF metres, directions unit MCMF vectors from the ground to the sensor.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..arrays import Array

_JUMP = 0.5
"""Steps of a metre that differ by more than this share of the shorter are not a slope's two sides."""

POSE = ("x_m", "y_m", "z_m", "turn_x_rad", "turn_y_rad", "turn_z_rad")
"""Corrections of a camera: a shift in MCMF, then a small rotation about the camera's own axes (right,
down, ahead): rotation' = exp([turn]_x) rotation.
"""

ON_MAP = ("east_m", "north_m")
"""Corrections of a map-projected image: where its ground really lies, from where the map puts it."""


class Sensor(Protocol):
    """The geometry of one image. Frozen: `moved` gives another."""

    @property
    def name(self) -> str:
        """The file it was read from."""

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the image."""

    @property
    def sun_position_mcmf_m(self) -> Array | None:
        """Where the Sun stood, (3,), if that is known."""

    @property
    def time_utc(self) -> str | None:
        """When the image was taken (its middle), if that is known."""

    @property
    def corrections(self) -> tuple[str, ...]:
        """What `moved` takes: `POSE` or `ON_MAP`."""

    def project(self, points_mcmf_m: ArrayLike) -> Array:
        """Pixels (..., 2) of MCMF points (..., 3); NaN for what the sensor cannot have seen."""

    def in_image(self, pixels: ArrayLike) -> NDArray[np.bool_]:
        """Whether pixels (..., 2) lie within the image; False for NaN."""

    def looks(self, pixels: ArrayLike) -> tuple[Array, Array]:
        """From where, and in which direction (both (..., 3)), pixels (..., 2) look."""

    def towards(self, points_mcmf_m: ArrayLike) -> Array:
        """Unit directions (..., 3) from ground points (..., 3) to where they were seen from."""

    def moved(self, correction: ArrayLike) -> Self:
        """The sensor with its place corrected, one number for each of `corrections`."""


def within_image(pixels: ArrayLike, shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Whether pixels (..., 2) lie within an image of so many rows and columns; False for NaN."""
    column, row = np.moveaxis(np.asarray(pixels, dtype=np.float64), -1, 0)
    rows, cols = shape
    return np.asarray((column >= -0.5) & (column < cols - 0.5) & (row >= -0.5) & (row < rows - 0.5))


@dataclass(frozen=True, eq=False)
class Reduced:
    """A sensor whose pixels are blocks of ``factor`` x ``factor`` of another's; blocks that are not whole
    are left out.
    """

    full: Sensor
    factor: int

    @property
    def name(self) -> str:
        return self.full.name

    @property
    def shape(self) -> tuple[int, int]:
        rows, cols = self.full.shape
        return rows // self.factor, cols // self.factor

    @property
    def sun_position_mcmf_m(self) -> Array | None:
        return self.full.sun_position_mcmf_m

    @property
    def time_utc(self) -> str | None:
        return self.full.time_utc

    @property
    def corrections(self) -> tuple[str, ...]:
        return self.full.corrections

    def project(self, points_mcmf_m: ArrayLike) -> Array:
        return (self.full.project(points_mcmf_m) + 0.5) / self.factor - 0.5

    def in_image(self, pixels: ArrayLike) -> NDArray[np.bool_]:
        return within_image(pixels, self.shape)

    def looks(self, pixels: ArrayLike) -> tuple[Array, Array]:
        return self.full.looks((np.asarray(pixels, dtype=np.float64) + 0.5) * self.factor - 0.5)

    def towards(self, points_mcmf_m: ArrayLike) -> Array:
        return self.full.towards(points_mcmf_m)

    def moved(self, correction: ArrayLike) -> Reduced:
        return replace(self, full=self.full.moved(correction))


@dataclass(frozen=True)
class Uncertainty:
    """How well a sensor's place is known, 1 sigma of each component; what is 0 is taken as exact and not solved for."""

    position_m: float
    attitude_rad: float = 0.0

    def sigmas(self, sensor: Sensor) -> Array:
        """One sigma for each of a sensor's corrections."""
        if sensor.corrections == ON_MAP:
            return np.full(2, self.position_m)
        return np.repeat([self.position_m, self.attitude_rad], 3)


def pixel_size_m(sensor: Sensor, points_mcmf_m: ArrayLike) -> Array:
    """Ground sample distance at ground points (..., 3): the square root of the area, across the line of sight,
    of one pixel.
    """
    points = np.asarray(points_mcmf_m, dtype=np.float64)
    towards = sensor.towards(points)
    first = np.cross(
        towards, np.where(np.abs(towards[..., 2:]) < 0.9, [0.0, 0.0, 1.0], [1.0, 0.0, 0.0])
    )
    first /= np.linalg.norm(first, axis=-1, keepdims=True)
    second = np.cross(towards, first)
    here = sensor.project(points)
    right, ahead = (_slope(sensor, points, here, axis) for axis in (first, second))
    pixels_per_m2 = np.abs(right[..., 0] * ahead[..., 1] - right[..., 1] * ahead[..., 0])
    return np.asarray(1.0 / np.sqrt(pixels_per_m2))


def _slope(sensor: Sensor, points: Array, here: Array, axis: Array) -> Array:
    """Pixels (..., 2) that a metre along ``axis`` is worth."""
    return mean_step(sensor.project(points + axis) - here, here - sensor.project(points - axis))


def mean_step(forward: Array, back: Array) -> Array:
    """How far pixels (..., 2) move by a step: the mean of one forward and one back. Where one of the two jumps (to the next
    framelet of a push-frame camera) the other.
    """
    lengths = np.linalg.norm(forward, axis=-1), np.linalg.norm(back, axis=-1)
    apart = np.linalg.norm(forward - back, axis=-1)
    jumps = (apart > _JUMP * np.minimum(*lengths))[..., None]
    shorter = np.where((lengths[0] < lengths[1])[..., None], forward, back)
    return np.where(jumps, shorter, 0.5 * (forward + back))
