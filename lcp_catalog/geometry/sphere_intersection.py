"""Intersections of camera rays with the reference sphere.

Positions are metres, MCMF or any axes whose origin is the centre of the sphere; directions have any
length. Ranges are good to a few 1e-16 of themselves from any height, inside or outside, and up to
the limb, for the numbers as given. A ray misses the sphere only if it passes it by more than 1e-20
of the radius (`kernels.sphere_rays`); the usual discriminant loses its digits there.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import Array
from ..constants import MOON_RADIUS_M
from ..kernels import sphere_rays as kernel
from .frames import mcmf_to_lonlat


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
