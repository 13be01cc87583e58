"""A map-projected image as a sensor: its pixels are places, at any height.

The image is taken as an orthoimage without relief displacement, so that `project` uses longitude
and latitude of a point but not its height. The map does not give the viewing direction: it is
vertical unless given.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import Array
from ..constants import MOON_RADIUS_M
from ..errors import ImageError, LabelError
from ..geometry.bounds import turned_deg
from ..geometry.frames import direction_enu, enu_rotation, lonlat_to_mcmf, mcmf_to_lonlat
from ..geometry.map_plane import MapProjection, map_projection
from .sensor import ON_MAP, FullSensor

ORIGIN_HEIGHT_M = 100e3
"""Height above the sphere of the origin of rays; above all terrain of the Moon."""


@dataclass(frozen=True, eq=False)
class MapImage(FullSensor):
    """A map-projected image.

    ``transform`` (a, b, c, d, e, f) takes corner coordinates of pixels, 0 at the upper left corner
    of the image, to the map (x = a col + b row + c, y = d col + e row + f), as in GDAL: pixel
    centres, which are whole numbers here, are at + 0.5.

    ``shift_m``: shift of the surface, east and north at the image's centre, from its mapped
    position. On the sphere this is a rotation that moves the centre by that distance in that
    direction, so that it is well defined near a pole.

    The viewing direction is ``off_nadir_deg`` from the vertical of each place, towards
    ``view_azimuth_deg`` (clockwise from north), or towards a position (``seen_from_mcmf_m``).
    ImageError for a CRS that is not of the Moon, and for a singular transform.
    """

    kind: ClassVar[str] = "map-projected image"
    corrections: ClassVar[tuple[str, ...]] = ON_MAP

    crs_wkt: str
    transform: tuple[float, ...]
    image_shape: tuple[int, int]
    name: str = "map"
    shift_m: tuple[float, float] = (0.0, 0.0)
    off_nadir_deg: float = 0.0
    view_azimuth_deg: float = 0.0
    seen_from_mcmf_m: Array | None = None
    sun_position_mcmf_m: Array | None = None
    time_utc: str | None = None

    def __post_init__(self) -> None:
        if len(self.transform) != 6 or not np.isfinite(self.transform).all():
            raise ImageError(f"{self.name}: its transform must hold 6 finite numbers")
        if abs(np.linalg.det(self._linear)) == 0.0:
            raise ImageError(f"{self.name}: its transform maps all pixels to one line")
        if not 0.0 <= self.off_nadir_deg < 90.0:
            raise ImageError(
                f"{self.name}: is viewed {self.off_nadir_deg:g} deg from the vertical; allowed are 0 to 90"
            )
        _ = self.projection

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the image."""
        return self.image_shape

    @property
    def projection(self) -> MapProjection:
        """The map projection; ImageError for one that is not of the Moon."""
        try:
            return map_projection(self.crs_wkt)
        except LabelError as error:
            raise ImageError(f"{self.name}: {error}") from error

    def project(self, points_mcmf_m: ArrayLike) -> Array:
        """Pixels (..., 2) of MCMF points (..., 3); NaN for points outside the map projection."""
        points = np.asarray(points_mcmf_m, dtype=np.float64)
        lon, lat, _ = mcmf_to_lonlat(points @ self._turned if self._is_shifted else points)
        x, y = self.projection.forward(lon, lat)
        along = np.stack([x - self.transform[2], y - self.transform[5]], axis=-1)
        return self._nearest_copy(along @ self._inverse_linear.T - 0.5)

    def ground(self, pixels: ArrayLike) -> Array:
        """Unit MCMF vectors (..., 3) from the Moon's centre through the places of pixels (..., 2);
        NaN off the map.
        """
        corner = np.asarray(pixels, dtype=np.float64) + 0.5
        x, y = np.moveaxis(corner @ self._linear.T, -1, 0)
        lon, lat = self.projection.inverse(x + self.transform[2], y + self.transform[5])
        up = lonlat_to_mcmf(lon, lat) / MOON_RADIUS_M
        return up @ self._turned.T if self._is_shifted else up

    def looks(self, pixels: ArrayLike) -> tuple[Array, Array]:
        """Origins `ORIGIN_HEIGHT_M` above the sphere and directions straight down, both (..., 3):
        the surface shown by a pixel of an orthoimage lies below its place, whatever the viewing
        direction.
        """
        up = self.ground(pixels)
        return up * (MOON_RADIUS_M + ORIGIN_HEIGHT_M), -up

    def towards(self, points_mcmf_m: ArrayLike) -> Array:
        """Unit directions (..., 3) from points (..., 3) of the surface to the sensor."""
        points = np.asarray(points_mcmf_m, dtype=np.float64)
        if self.seen_from_mcmf_m is not None:
            return _unit(self.seen_from_mcmf_m - points)
        up = _unit(points)
        if self.off_nadir_deg == 0.0:
            return up
        lon, lat, _ = mcmf_to_lonlat(points)
        return _from_enu(direction_enu(self.view_azimuth_deg, 90.0 - self.off_nadir_deg), lon, lat)

    def moved(self, correction: ArrayLike) -> MapImage:
        """The image with its surface shifted (east, north) by further metres from the mapped
        position.
        """
        east, north = np.asarray(correction, dtype=np.float64)
        return replace(
            self, shift_m=(self.shift_m[0] + float(east), self.shift_m[1] + float(north))
        )

    @cached_property
    def center_deg(self) -> tuple[float, float]:
        """Longitude (0..360) and latitude of the image's centre on its map, degrees; ImageError if
        it is off the map.
        """
        rows, cols = self.shape
        x, y = self._linear @ [cols / 2.0, rows / 2.0] + [self.transform[2], self.transform[5]]
        lon, lat = self.projection.inverse(x, y)
        if not np.isfinite(lat):
            raise ImageError(f"{self.name}: the centre of the image is off its map")
        return turned_deg(float(lon)), float(lat)

    @property
    def _is_shifted(self) -> bool:
        return self.shift_m != (0.0, 0.0)

    @cached_property
    def _turned(self) -> Array:
        """Rotation (3, 3) from the mapped to the shifted position of the surface (Rodrigues'
        formula).
        """
        east, north = self.shift_m
        angle = float(np.hypot(east, north)) / MOON_RADIUS_M
        if angle == 0.0:
            return np.eye(3)
        frame = enu_rotation(*self.center_deg)
        axis = np.array([-north, east, 0.0]) / np.hypot(east, north) @ frame  # up x (east, north)
        x, y, z = axis
        cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        return np.asarray(
            np.eye(3) + np.sin(angle) * cross + 2.0 * np.sin(angle / 2) ** 2 * cross @ cross
        )

    @cached_property
    def _linear(self) -> Array:
        a, b, _, d, e, _ = self.transform
        return np.array([[a, b], [d, e]])

    @cached_property
    def _inverse_linear(self) -> Array:
        return np.asarray(np.linalg.inv(self._linear))

    def _nearest_copy(self, pixels: Array) -> Array:
        """The copy nearest to the image's centre, of the copies of a place in a cylindrical map."""
        period = self.projection.period
        if not np.isfinite(period):
            return pixels
        once_round = self._inverse_linear @ [period, 0.0]
        rows, cols = self.shape
        away = pixels - [(cols - 1) / 2.0, (rows - 1) / 2.0]
        turns = np.round(away @ once_round / (once_round @ once_round))
        return np.asarray(pixels - turns[..., None] * once_round)


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def _from_enu(enu: Array, lon_deg: Array, lat_deg: Array) -> Array:
    """MCMF directions (..., 3) of an ENU direction (3,) at places (...)."""
    lon, lat = np.radians(lon_deg), np.radians(lat_deg)
    zero = np.zeros_like(lon)
    east = np.stack([-np.sin(lon), np.cos(lon), zero], axis=-1)
    up = np.stack([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)], axis=-1)
    return np.asarray(enu[0] * east + enu[1] * np.cross(up, east) + enu[2] * up)
