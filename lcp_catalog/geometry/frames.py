"""Conversions between longitude, latitude, height and the Moon-centred, Moon-fixed frame (MCMF),
and east-north-up (ENU) frames.

Latitudes are planetocentric, longitudes positive east, both in degrees. Heights are metres above
the reference sphere of 1 737 400 m. The closed forms are exact on a sphere; pyproj agrees to the
last bits.

A direction at a place: one value that gives its vector and its angles.

Intersections of camera rays with the reference sphere.

Positions are metres, MCMF or any axes whose origin is the centre of the sphere; directions have any
length. Ranges are good to a few 1e-16 of themselves from any height, inside or outside, and up to
the limb, for the numbers as given. A ray misses the sphere only if it passes it by more than 1e-20
of the radius (`kernels.sphere_rays`); the usual discriminant loses its digits there.

Rotations by a vector (axis times angle) and by unit quaternions (w, x, y, z), which turn a
vector v to q v q*.

`scipy.spatial.transform` gives the same to 1e-14 (the tests compare them), but its products of
arrays of rotations were 20 to 200 times slower than `product`, which a line scanner needs at every
iteration, and its Slerp does not extrapolate.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..arrays import Array
from ..constants import MOON_RADIUS_M
from ..kernels import sphere_rays as kernel
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


Indices = NDArray[np.intp]


def ranges(position_m: ArrayLike, directions: ArrayLike, radius_m: float = MOON_RADIUS_M) -> Array:
    """Distances (...) in metres along rays to the sphere, from one position (3,) or one for each of
    the directions (..., 3); NaN for rays that miss it.

    From outside the nearer crossing, from inside the farther one. On the sphere: 0 for a ray that
    goes down, NaN otherwise. ValueError for positions or directions that are not finite and for a
    direction of length 0.
    """
    rays = np.ascontiguousarray(directions, dtype=np.float64)
    starts = np.ascontiguousarray(position_m, dtype=np.float64)
    if rays.shape[-1:] != (3,) or starts.shape not in ((3,), rays.shape):
        raise ValueError(f"invalid rays: {starts.shape} positions, {rays.shape} directions")
    flat = _scaled(rays.reshape(-1, 3))
    if not (np.isfinite(starts).all() and math.isfinite(radius_m)):
        raise ValueError("invalid rays: a position or the radius is not finite")
    out = np.empty(len(flat))
    kernel.ranges(starts.reshape(-1, 3), flat, float(radius_m), out)
    return out.reshape(rays.shape[:-1])


def _scaled(rays: Array) -> Array:
    """Rays (n, 3); those whose squares would overflow or underflow are multiplied by a power of
    two. ValueError for a ray that is not finite or has no length.
    """
    least, most = kernel.longest_components(rays)
    if least > 1e-100 and most < 1e100:
        return rays
    largest = np.abs(rays).max(axis=-1, initial=0.0)
    if not (np.isfinite(largest).all() and (largest > 0.0).all()):
        raise ValueError("invalid rays: a direction has no length, or is not finite")
    _, exponent = np.frexp(largest)
    return np.asarray(np.ldexp(rays, -exponent[:, None]))


def heights(positions_m: ArrayLike, radius_m: float = MOON_RADIUS_M) -> Array:
    """Heights (...) in metres of positions (..., 3) above the sphere, good to the last bits (|p| -
    R is good to 0.2 nm only).
    """
    points = np.ascontiguousarray(positions_m, dtype=np.float64)
    out = np.empty(points.size // 3)
    kernel.heights(points.reshape(-1, 3), float(radius_m), out)
    return out.reshape(points.shape[:-1])


def hits(
    position_m: ArrayLike, directions: ArrayLike, radius_m: float = MOON_RADIUS_M
) -> tuple[Array, Array]:
    """Ranges (...) of rays and the points (..., 3) where they meet the sphere; NaN for rays that
    miss it.
    """
    rays = np.ascontiguousarray(directions, dtype=np.float64)
    rays = _scaled(rays.reshape(-1, 3)).reshape(rays.shape)
    found = ranges(position_m, rays, radius_m)
    along = found / np.sqrt(np.einsum("...i,...i", rays, rays))
    return found, on_sphere(np.asarray(position_m) + along[..., None] * rays, radius_m)


def on_sphere(points_m: Array, radius_m: float = MOON_RADIUS_M) -> Array:
    """Points (..., 3) moved along their verticals onto the sphere."""
    away = np.sqrt(np.einsum("...i,...i", points_m, points_m))
    return np.asarray(points_m * (radius_m / away)[..., None])


def lonlat(points_m: ArrayLike) -> tuple[Array, Array]:
    """Longitudes (0..360) and latitudes of points (..., 3), degrees."""
    lon, lat, _ = mcmf_to_lonlat(points_m)
    return lon, lat


def nadir_angles(position_m: Array, directions: Array) -> Array:
    """Angles (...) between directions (..., 3) and the direction to the centre of the sphere,
    radians.
    """
    across = np.linalg.norm(np.cross(directions, position_m), axis=-1)
    return np.asarray(np.arctan2(across, -(directions @ position_m)))


def limb_angle(position_m: Array, radius_m: float = MOON_RADIUS_M) -> float:
    """Angle between the limb and the direction to the centre of the sphere, radians; pi / 2 on the
    sphere. ValueError for a position inside.
    """
    height = float(heights(position_m, radius_m))
    if height < 0.0:
        raise ValueError(f"a position {-height:g} m below the sphere has no limb")
    return math.atan2(radius_m, math.sqrt(height * (height + 2.0 * radius_m)))


def by_vector(turn_rad: ArrayLike) -> Array:
    """Rotation matrix exp([turn]x), (3, 3): turns vectors about ``turn`` (3,) by its length in
    radians, counter-clockwise seen from its tip (Rodrigues). Exact for any length; the two factors
    keep their digits for small angles.
    """
    x, y, z = np.asarray(turn_rad, dtype=np.float64)
    angle = float(np.sqrt(x * x + y * y + z * z))
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    once = np.sinc(angle / np.pi)  # sin(a) / a
    twice = 0.5 * np.sinc(0.5 * angle / np.pi) ** 2  # (1 - cos(a)) / a^2
    return np.asarray(np.eye(3) + once * cross + twice * cross @ cross)


def quaternion_of(matrix: Array) -> Array:
    """Unit quaternion (4,) of a rotation matrix (3, 3), the nearest one if the matrix has rounding
    errors (Bar-Itzhack 2000).
    """
    m = np.asarray(matrix, dtype=np.float64)
    axis = np.array([m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]])
    gram = np.empty((4, 4))
    gram[0, 0], gram[0, 1:], gram[1:, 0] = np.trace(m), axis, axis
    gram[1:, 1:] = m + m.T - np.trace(m) * np.eye(3)
    return np.asarray(np.linalg.eigh(gram)[1][:, -1])


def product(later: Array, first: Array) -> Array:
    """Quaternions (..., 4) of the rotation ``first`` followed by ``later``."""
    a, b, c, d = np.moveaxis(later, -1, 0)
    w, x, y, z = np.moveaxis(first, -1, 0)
    return np.stack(
        [
            a * w - b * x - c * y - d * z,
            a * x + b * w + c * z - d * y,
            a * y - b * z + c * w + d * x,
            a * z + b * y - c * x + d * w,
        ],
        axis=-1,
    )


def inverse(quaternions: Array) -> Array:
    """Quaternions (..., 4) of the inverse rotations."""
    return np.asarray(quaternions * np.array([1.0, -1.0, -1.0, -1.0]))


def turned(quaternions: Array, vectors: Array) -> Array:
    """Vectors (..., 3) turned by quaternions (..., 4)."""
    w, a, b, c = np.moveaxis(quaternions, -1, 0)
    x, y, z = np.moveaxis(vectors, -1, 0)
    p, q, r = 2.0 * (b * z - c * y), 2.0 * (c * x - a * z), 2.0 * (a * y - b * x)
    return np.stack(
        [x + w * p + b * r - c * q, y + w * q + c * p - a * r, z + w * r + a * q - b * p], axis=-1
    )


def same_sides(quaternions: Array) -> Array:
    """Quaternions (n, 4) of unit length with signs such that neighbours have a positive dot
    product: q and -q are one rotation, and the shorter way between two rotations is that between
    the nearer signs.
    """
    unit = quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)
    dots = np.einsum("ij,ij->i", unit[1:], unit[:-1])
    signs = np.cumprod(np.concatenate([[1.0], np.where(dots < 0.0, -1.0, 1.0)]))
    return np.asarray(unit * signs[:, None])


def apart_rad(first: Array, second: Array) -> Array:
    """Angles (n,) between unit quaternions (n, 4) as vectors, half of those between the rotations;
    accurate for small angles too.
    """
    chord = np.linalg.norm(first - second, axis=-1)
    return np.asarray(2.0 * np.arctan2(chord, np.linalg.norm(first + second, axis=-1)))


def between(first: Array, second: Array, angle_rad: Array, share: Array) -> Array:
    """Rotations (n, 4) at ``share`` (n,) of the way from one to the other at a constant rate
    (slerp, Shoemake 1985); a share outside 0..1 extrapolates at that rate. Both are (n, 4), unit,
    with the signs of `same_sides`; ``angle_rad`` (n,) is `apart_rad` of both.
    """
    turns = angle_rad / np.pi
    whole = np.sinc(turns)
    a = (1.0 - share) * np.sinc((1.0 - share) * turns) / whole
    b = share * np.sinc(share * turns) / whole
    return np.asarray(a[:, None] * first + b[:, None] * second)
