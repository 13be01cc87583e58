"""Conversions between longitude, latitude, height and the Moon-centred, Moon-fixed frame (MCMF),
and east-north-up (ENU) frames.

Latitudes are planetocentric, longitudes positive east, both in degrees. Heights are metres above
the reference sphere of 1 737 400 m. The closed forms are exact on a sphere; pyproj agrees to the
last bits.

A direction at a place: one value that gives its vector and its angles.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import Array
from ..constants import MOON_RADIUS_M
from .bounds import turned_deg


def lonlat_to_mcmf(lon_deg: ArrayLike, lat_deg: ArrayLike, height_m: ArrayLike = 0.0) -> Array:
    """MCMF positions, metres, shape (..., 3), of places in degrees and heights in metres above the
    sphere.
    """
    lon, lat, height = np.broadcast_arrays(np.radians(lon_deg), np.radians(lat_deg), height_m)
    radius = MOON_RADIUS_M + np.asarray(height, dtype=np.float64)
    ring = radius * np.cos(lat)
    return np.stack([ring * np.cos(lon), ring * np.sin(lon), radius * np.sin(lat)], axis=-1)


def mcmf_to_lonlat(position_m: ArrayLike) -> tuple[Array, Array, Array]:
    """Longitude (0..360 deg), latitude (deg) and height above the sphere (m) of MCMF positions
    (..., 3).

    At a pole the longitude is atan2(y, x) of the position: 0 for exact zeros.
    """
    x, y, z = np.moveaxis(np.asarray(position_m, dtype=np.float64), -1, 0)
    ring = np.hypot(x, y)
    lon = turned_deg(np.degrees(np.arctan2(y, x)))
    return lon, np.degrees(np.arctan2(z, ring)), np.hypot(ring, z) - MOON_RADIUS_M


def enu_rotation(lon_deg: ArrayLike, lat_deg: ArrayLike) -> Array:
    """Rotations MCMF to ENU at places, shape (..., 3, 3): rows east, north, up.

    At a pole east is its limit along the given meridian.
    """
    lon, lat = np.radians(lon_deg), np.radians(lat_deg)
    sin_lon, cos_lon, sin_lat, cos_lat = np.sin(lon), np.cos(lon), np.sin(lat), np.cos(lat)
    rotation = np.zeros((*np.shape(lon), 3, 3))
    rotation[..., 0, 0], rotation[..., 0, 1] = -sin_lon, cos_lon
    rotation[..., 1, 0], rotation[..., 1, 1] = -sin_lat * cos_lon, -sin_lat * sin_lon
    rotation[..., 1, 2] = cos_lat
    rotation[..., 2, 0], rotation[..., 2, 1] = cos_lat * cos_lon, cos_lat * sin_lon
    rotation[..., 2, 2] = sin_lat
    return rotation


def direction_enu(azimuth_deg: ArrayLike, elevation_deg: ArrayLike) -> Array:
    """Unit vectors (..., 3) east, north, up; azimuth clockwise from north, elevation above the
    horizontal plane, both in degrees, scalars or arrays that broadcast.
    """
    return direction_enu_rad(np.radians(azimuth_deg), np.radians(elevation_deg))


def direction_enu_rad(azimuth_rad: ArrayLike, elevation_rad: ArrayLike) -> Array:
    """`direction_enu` of angles in radians."""
    azimuth, elevation = np.broadcast_arrays(azimuth_rad, elevation_rad)
    level = np.cos(elevation)
    return np.stack([level * np.sin(azimuth), level * np.cos(azimuth), np.sin(elevation)], axis=-1)


def azimuth_elevation(direction: ArrayLike) -> tuple[Array, Array]:
    """Azimuth (0..360 deg, clockwise from north) and elevation (deg) of ENU directions (..., 3) of
    any length.
    """
    east, north, up = np.moveaxis(np.asarray(direction, dtype=np.float64), -1, 0)
    azimuth = turned_deg(np.degrees(np.arctan2(east, north)))
    return azimuth, np.degrees(np.arctan2(up, np.hypot(east, north)))


def central_angle_deg(lon1: ArrayLike, lat1: ArrayLike, lon2: ArrayLike, lat2: ArrayLike) -> Array:
    """Angle between two places as seen from the centre of the Moon, degrees; accurate at 0 and 180
    (atan2 of cross and dot product).
    """
    a, b = lonlat_to_mcmf(lon1, lat1), lonlat_to_mcmf(lon2, lat2)
    cross = np.linalg.norm(np.cross(a, b), axis=-1)
    return np.asarray(np.degrees(np.arctan2(cross, np.sum(a * b, axis=-1))))


@dataclass(frozen=True)
class EnuFrame:
    """The tangent frame at a place: x east, y north, z up, metres; origin ``height_m`` above the
    sphere. ValueError for an invalid place.
    """

    lon_deg: float
    lat_deg: float
    height_m: float = 0.0

    def __post_init__(self) -> None:
        if not (
            np.isfinite(self.lon_deg) and abs(self.lat_deg) <= 90.0 and np.isfinite(self.height_m)
        ):
            raise ValueError(f"invalid place: longitude {self.lon_deg}, latitude {self.lat_deg}")

    @cached_property
    def rotation(self) -> Array:
        """Rotation MCMF to ENU, shape (3, 3): rows east, north, up."""
        return enu_rotation(self.lon_deg, self.lat_deg)

    @cached_property
    def origin_mcmf_m(self) -> Array:
        """Origin of the frame, MCMF metres, shape (3,)."""
        return lonlat_to_mcmf(self.lon_deg, self.lat_deg, self.height_m)

    def to_mcmf(self, enu_m: ArrayLike) -> Array:
        """MCMF metres of ENU points (..., 3)."""
        return np.asarray(enu_m, dtype=np.float64) @ self.rotation + self.origin_mcmf_m

    def from_mcmf(self, position_m: ArrayLike) -> Array:
        """ENU metres of MCMF points (..., 3)."""
        return (np.asarray(position_m, dtype=np.float64) - self.origin_mcmf_m) @ self.rotation.T

    def direction_to_mcmf(self, direction: ArrayLike) -> Array:
        """MCMF components of ENU directions (..., 3)."""
        return np.asarray(direction, dtype=np.float64) @ self.rotation

    def direction_from_mcmf(self, direction: ArrayLike) -> Array:
        """ENU components of MCMF directions (..., 3)."""
        return np.asarray(direction, dtype=np.float64) @ self.rotation.T


@dataclass(frozen=True, eq=False)
class Direction:
    """A direction to the Sun, the Earth or a camera in the east-north-up (ENU) frame of a place.

    ``vector`` (3,): unit vector east, north, up. The angles are computed from the vector. NumPy
    functions take a `Direction` as its vector. ValueError for a vector that is not finite, is zero
    or has another shape.
    """

    vector: Array

    def __post_init__(self) -> None:
        vector = np.asarray(self.vector, dtype=np.float64)
        if vector.shape != (3,) or not np.isfinite(vector).all() or not vector.any():
            raise ValueError(f"no such direction: {vector.tolist()}")
        object.__setattr__(self, "vector", vector)

    @classmethod
    def of(cls, direction: Direction | ArrayLike) -> Direction:
        """The direction itself, or a `Direction` from an ENU vector (3,)."""
        return direction if isinstance(direction, Direction) else cls(np.asarray(direction))

    @classmethod
    def from_mcmf(cls, direction_mcmf: ArrayLike, frame: EnuFrame) -> Direction:
        """From an MCMF vector (3,), in the axes of a frame."""
        return cls(frame.direction_from_mcmf(direction_mcmf))

    @cached_property
    def azimuth_rad(self) -> float:
        """Azimuth clockwise from north, -pi..pi; 0 for a vertical direction."""
        east, north, _ = self.vector
        return math.atan2(east, north)

    @cached_property
    def elevation_rad(self) -> float:
        """Elevation above the horizontal, -pi/2..pi/2."""
        east, north, up = self.vector
        return math.atan2(up, math.hypot(east, north))

    @cached_property
    def azimuth_deg(self) -> float:
        """Azimuth clockwise from north, 0 <= azimuth < 360; 0 for a vertical direction."""
        return float(azimuth_elevation(self.vector)[0])

    @cached_property
    def elevation_deg(self) -> float:
        """Elevation above the horizontal, -90..90."""
        return float(azimuth_elevation(self.vector)[1])

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Array:
        return np.array(self.vector, dtype=dtype, copy=copy)
