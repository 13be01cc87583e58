"""Sensors: the geometry of an image, from points to pixels and from pixels to rays.

A sensor is a frame camera (`frame_camera`), a line scanner or a push-frame camera (`scanners`), or
the map of a map-projected image (`map_projected`). Pixel coordinates are (column, row) with pixel
centres at whole numbers. Positions are MCMF metres, directions unit MCMF vectors.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Protocol, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..arrays import Array
from ..errors import PoseError

_JUMP = 0.5
"""Two steps of a metre whose pixel differences differ by more than this share of the shorter one
are not two sides of a slope.
"""

POSE = ("x_m", "y_m", "z_m", "turn_x_rad", "turn_y_rad", "turn_z_rad")
"""Corrections of a camera: a shift in MCMF, then a small rotation about the camera's own axes
(right, down, ahead): rotation' = exp([turn]_x) rotation.
"""

ON_MAP = ("east_m", "north_m")
"""Corrections of a map-projected image: the shift of its surface from the mapped position."""


class Sensor(Protocol):
    """The geometry of one image. Frozen: `moved` returns another sensor."""

    @property
    def name(self) -> str:
        """Name of the file that describes the sensor."""

    @property
    def kind(self) -> str:
        """Kind of sensor, as reports print it: framing camera, line scanner, push-frame camera or
        map-projected image.
        """

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the image."""

    @property
    def full(self) -> Sensor:
        """Sensor of the image at full resolution; itself unless `Reduced`."""

    @property
    def factor(self) -> int:
        """Side of a pixel in pixels at full resolution; 1 unless `Reduced`."""

    @property
    def sun_position_mcmf_m(self) -> Array | None:
        """Position of the Sun, (3,); None if unknown."""

    @property
    def time_utc(self) -> str | None:
        """Time of the middle of the image; None if unknown."""

    @property
    def corrections(self) -> tuple[str, ...]:
        """Names of the numbers that `moved` takes: `POSE` or `ON_MAP`."""

    def project(self, points_mcmf_m: ArrayLike) -> Array:
        """Pixels (..., 2) of MCMF points (..., 3); NaN for points that the sensor cannot see."""

    def project_near(self, points_mcmf_m: ArrayLike, pixels: ArrayLike) -> Array:
        """Pixels (n, 2) of MCMF points (n, 3) that were found at pixels (n, 2).

        The same as `project`, except for a push-frame camera: it uses the framelet in which each
        point was found. Near the edge of a framelet a small move of the camera takes `project` to
        the next framelet, and the pixel jumps by as many rows as framelets overlap; a least-squares
        solution would stop at that jump.
        """

    def in_image(self, pixels: ArrayLike) -> NDArray[np.bool_]:
        """True for pixels (..., 2) within the image; False for NaN."""

    def looks(self, pixels: ArrayLike) -> tuple[Array, Array]:
        """Origins and unit directions, both (..., 3), of the rays of pixels (..., 2)."""

    def towards(self, points_mcmf_m: ArrayLike) -> Array:
        """Unit directions (..., 3) from points (..., 3) of the surface to the sensor."""

    def moved(self, correction: ArrayLike) -> Self:
        """The sensor with corrected geometry; one number for each of `corrections`."""


def within_image(pixels: ArrayLike, shape: tuple[int, int]) -> NDArray[np.bool_]:
    """True for pixels (..., 2) within an image of ``shape`` (rows, columns); False for NaN."""
    column, row = np.moveaxis(np.asarray(pixels, dtype=np.float64), -1, 0)
    rows, cols = shape
    return np.asarray((column >= -0.5) & (column < cols - 0.5) & (row >= -0.5) & (row < rows - 0.5))


class FullSensor:
    """Base of sensors that see the image at full resolution, and see every point once."""

    factor: ClassVar[int] = 1
    sun_position_mcmf_m: Array | None
    time_utc: str | None

    @property
    def full(self) -> Self:
        return self

    @property
    def has_sun(self) -> bool:
        """True if the sensor has a Sun of its own, by position or by time."""
        return self.sun_position_mcmf_m is not None or self.time_utc is not None

    @property
    def shape(self) -> tuple[int, int]:
        raise NotImplementedError

    def project(self, points_mcmf_m: ArrayLike) -> Array:
        raise NotImplementedError

    def project_near(self, points_mcmf_m: ArrayLike, pixels: ArrayLike) -> Array:
        return self.project(points_mcmf_m)

    def in_image(self, pixels: ArrayLike) -> NDArray[np.bool_]:
        return within_image(pixels, self.shape)


def middle_ray(sensor: Sensor) -> tuple[Array, Array]:
    """Origin and direction (3,) of the ray through the middle of a sensor's image."""
    rows, cols = sensor.shape
    return sensor.looks([(cols - 1) / 2.0, (rows - 1) / 2.0])


@dataclass(frozen=True, eq=False)
class Reduced:
    """A sensor whose pixels are blocks of ``factor`` x ``factor`` pixels of another sensor.

    Blocks that are not whole are left out. A reduced sensor that is reduced again has the product
    of both factors.
    """

    full: Sensor
    factor: int

    def __post_init__(self) -> None:
        object.__setattr__(self, "factor", self.factor * self.full.factor)
        object.__setattr__(self, "full", self.full.full)

    @property
    def name(self) -> str:
        return self.full.name

    @property
    def kind(self) -> str:
        return self.full.kind

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
        return self._reduced(self.full.project(points_mcmf_m))

    def project_near(self, points_mcmf_m: ArrayLike, pixels: ArrayLike) -> Array:
        return self._reduced(self.full.project_near(points_mcmf_m, self._full(pixels)))

    def in_image(self, pixels: ArrayLike) -> NDArray[np.bool_]:
        return within_image(pixels, self.shape)

    def looks(self, pixels: ArrayLike) -> tuple[Array, Array]:
        return self.full.looks(self._full(pixels))

    def towards(self, points_mcmf_m: ArrayLike) -> Array:
        return self.full.towards(points_mcmf_m)

    def moved(self, correction: ArrayLike) -> Reduced:
        return Reduced(self.full.moved(correction), self.factor)

    def _full(self, pixels: ArrayLike) -> Array:
        """Pixels of the image at full resolution."""
        return (np.asarray(pixels, dtype=np.float64) + 0.5) * self.factor - 0.5

    def _reduced(self, pixels: Array) -> Array:
        return (pixels + 0.5) / self.factor - 0.5


@dataclass(frozen=True)
class Uncertainty:
    """1 sigma of each component of a sensor's position (m) and attitude (rad). A component with 0 is
    exact: it is not solved for.

    Examples
    --------
    >>> lcp.Uncertainty(position_m=2000.0, attitude_rad=0.0035).sigmas(lcp.read_camera(camera)).tolist()
    [2000.0, 2000.0, 2000.0, 0.0035, 0.0035, 0.0035]
    """

    position_m: float
    attitude_rad: float = 0.0

    def __post_init__(self) -> None:
        # A turn of many radians (degrees, by mistake) would search the whole image for every point: minutes, gigabytes.
        turn = self.attitude_rad
        if not (self.position_m >= 0.0 and (0.0 <= turn <= np.pi / 2.0 or turn == np.inf)):
            raise PoseError(
                f"{self}: a sigma is 0 or more, that of an attitude in radians, at most pi / 2 or inf"
            )

    def sigmas(self, sensor: Sensor) -> Array:
        """1 sigma of each of a sensor's corrections."""
        if sensor.corrections == ON_MAP:
            return np.full(2, self.position_m)
        return np.repeat([self.position_m, self.attitude_rad], 3)


def altitude_km(sensor: Sensor, points_mcmf_m: ArrayLike) -> Array:
    """Heights (n,) of the sensor above points (n, 3) when it sees them: differences of the distances
    from the Moon's centre, km. inf where it is not known: for an image on a map, and for points
    that are not seen.
    """
    points = np.asarray(points_mcmf_m, dtype=np.float64).reshape(-1, 3)
    if sensor.corrections == ON_MAP or not len(points):
        return np.full(len(points), np.inf)
    origins, _ = sensor.looks(sensor.project(points))
    above_m = np.linalg.norm(origins, axis=-1) - np.linalg.norm(points, axis=-1)
    return np.where(np.isfinite(above_m), 1e-3 * above_m, np.inf)


def pixel_size_m(sensor: Sensor, points_mcmf_m: ArrayLike) -> Array:
    """Ground sample distance in metres, (...,), at points (..., 3) of the surface: the square root of
    the area of one pixel across the line of sight.
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


def ground_slopes(sensor: Sensor, points_mcmf_m: Array, rotation: Array) -> Array:
    """Derivatives (n, 2, 2) of the pixels of points (n, 3) with respect to displacements east and
    north (last axis) in their horizontal planes, pixels per metre; ``rotation`` (n, 3, 3): MCMF to
    each point's ENU frame. NaN for points that the sensor cannot see.
    """
    here = sensor.project(points_mcmf_m)
    axes = rotation[:, 0], rotation[:, 1]
    return np.stack([_slope(sensor, points_mcmf_m, here, axis) for axis in axes], axis=-1)


def ground_errors_m(
    sensor: Sensor, points_mcmf_m: Array, rotation: Array, offset_px: Array
) -> Array:
    """Displacements (n, 2), east and north in metres, in the horizontal planes of points (n, 3), that
    the sensor shows as offsets (n, 2) in pixels, to first order. ``rotation`` (n, 3, 3): MCMF to
    each point's ENU frame. NaN where the sensor shows no such displacement.
    """
    slopes = ground_slopes(sensor, points_mcmf_m, rotation)
    (east_x, east_y), (north_x, north_y) = slopes[..., 0].T, slopes[..., 1].T
    x, y = offset_px.T
    with np.errstate(divide="ignore", invalid="ignore"):
        area = east_x * north_y - north_x * east_y
        found = np.stack([north_y * x - north_x * y, east_x * y - east_y * x], axis=-1)
        found /= area[:, None]
    return np.where(np.isfinite(found), found, np.nan)


def _slope(sensor: Sensor, points: Array, here: Array, axis: Array) -> Array:
    """Change of the pixels (..., 2) by a metre along ``axis``."""
    return mean_step(sensor.project(points + axis) - here, here - sensor.project(points - axis))


def mean_step(forward: Array, back: Array) -> Array:
    """Change of pixels (..., 2) by a step: the mean of a step forward and one back, or the shorter
    where one of the two leads to another framelet of a push-frame camera.
    """
    lengths = np.linalg.norm(forward, axis=-1), np.linalg.norm(back, axis=-1)
    apart = np.linalg.norm(forward - back, axis=-1)
    jumps = (apart > _JUMP * np.minimum(*lengths))[..., None]
    shorter = np.where((lengths[0] < lengths[1])[..., None], forward, back)
    return np.where(jumps, shorter, 0.5 * (forward + back))
