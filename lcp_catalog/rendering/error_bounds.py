"""Bounds on the error of leaving an effect out of a render; each function states its proof."""

from __future__ import annotations

import math

import numpy as np

from ..arrays import Array
from ..cameras.view import CameraView, ScannerView, View, finest_pixel_m
from ..constants import HIGHEST_M, MOON_RADIUS_M, SOLAR_RADIUS_RAD
from ..kernels.photometry.laws import LAMBERT, LOMMEL_SEELIGER
from ..light.solar_disc import penumbra_m
from ..photometry.laws import DEFAULT_MODEL, Reflectance
from ..terrain.relief_bounds import Box, Relief, tangent_of

NORMAL_ROUNDING_RAD = 2.0**-24
"""Greatest turn of a normal that is stored in float32, radians: the relative error of each component
is at most 2^-24, and so is that of the vector.
"""

STORED = 2.0**-21
"""Bound on the difference of two equal bands after rounding to float32: 2^-23 of a radiance, 2.7e-7 rad
of an angle of up to 180 deg.
"""

BOUNDED_LAWS = frozenset({LAMBERT, LOMMEL_SEELIGER})
"""Reflectance models for which `parallel_error` is proved."""

PENUMBRA_PX = 0.1
"""Penumbras narrower than this on level terrain are left out in tiers that permit errors at nodes."""


def limb_tangent(sun: Array, radius_rad: float = SOLAR_RADIUS_RAD) -> float:
    """Tangent of the elevation of the lowest point of a disc around an ENU direction (3,)."""
    return math.tan(math.atan(tangent_of(sun)) - radius_rad)


def penumbra_px(relief: Relief, sun: Array, pixel_m: float) -> float:
    """Width of the widest penumbra that the terrain can cast on level terrain, in pixels.

    The height of the terrain above a node of the core is at most ``shading_height_m``, and only the
    height whose shadow crosses the whole terrain matters.
    """
    elevation = math.atan(tangent_of(sun))
    steep = math.tan(elevation)  # finite straight up
    height = min(relief.shading_height_m, relief.span_m * max(steep, 0.0))
    if steep <= 0.0 or pixel_m <= 0.0:
        return math.inf
    return height / steep * float(penumbra_m(1.0, elevation)) / pixel_m


def pixel_m(relief: Relief, view: View, in_camera_plane: bool) -> float:
    """Size of the finest pixel of a render on the surface, metres: a cell, or the width of a camera's
    pixel at the nearest corner of the core's box (foreshortening increases it).
    """
    if in_camera_plane and isinstance(view, ScannerView):
        return finest_pixel_m(view.scanner)
    if not in_camera_plane or not isinstance(view, CameraView) or view.camera is None:
        return relief.gsd_m
    nearest = np.clip(view.position_m, relief.box.low_m, relief.box.high_m)
    return float(np.linalg.norm(view.position_m - nearest)) / view.camera.focal_length_px


def parallel_direction(box: Box, view: View) -> Array:
    """Unit ENU direction (3,) from the middle of a core's box to the camera."""
    return np.asarray(view.directions(box.middle_m))


def ray_angle_rad(box: Box, view: CameraView) -> float:
    """Greatest angle between `parallel_direction` and the direction from any point of a core's box to a
    camera at a finite position; pi if the camera is too near for a bound.

    Directions within an angle below 90 deg of an axis form a convex cone with its apex at the camera;
    it contains a box if it contains the corners.
    """
    if np.linalg.norm(view.position_m - box.middle_m) == 0.0:
        return math.pi
    axis = parallel_direction(box, view)
    away = view.position_m - box.corners_m
    along = away @ axis
    if not (along > 0.0).all():
        return math.pi
    across = np.linalg.norm(np.cross(away, axis), axis=-1)
    return float(np.arctan2(across, along).max())


def parallel_error(
    relief: Relief, angle_rad: float, least_tangent: float, model: Reflectance = DEFAULT_MODEL
) -> float:
    """Greatest relative change of the radiance factor when directions to the camera are turned by
    an angle; it also bounds the change of emission and phase, radians. inf if there is no bound.

    Lommel-Seeliger: mu0 / (mu0 + mu') over mu0 / (mu0 + mu) is 1 + (mu - mu') / (mu0 + mu'), with
    |mu - mu'| <= 2 sin(a / 2), mu0 >= 0 and mu' >= sin(e - s), e the least elevation of the camera
    from any node (``least_tangent``), s the greatest tilt of a node's normal. Lambert does not
    depend on mu; for other models, which depend on the phase, there is no proof. If
    sin(e - s) > 0, every node faces the camera in both cases.

    The middle of the box also sees the camera at an elevation of e or more: the points that do form a
    convex cone, together with all points below it. The point half way between the highest node and the
    opposite one is at least as high as the middle of the box.
    """
    if model.code not in BOUNDED_LAWS or not relief.slope.clears(least_tangent):
        return math.inf
    leaning = math.sin(math.atan(least_tangent) - math.atan(relief.node_tangent))
    leaning -= 2.0 * NORMAL_ROUNDING_RAD
    if leaning <= 0.0:
        return math.inf
    return max(angle_rad, 2.0 * math.sin(0.5 * angle_rad) / leaning) + STORED


def horizon_beyond_rad(
    distance_m: float, lowest_m: float, origin_m: float, frame_height_m: float = 0.0
) -> float:
    """Greatest elevation, in the frame of an area, of terrain at least ``distance_m`` from all its
    nodes in the frame's plane, and ``origin_m`` from the frame's origin; at least 0.

    Terrain of radius b is not above the plane z = sqrt(b^2 - origin^2) - (R + h), and no node is below
    z = ``lowest_m``: the tangent is at most their difference over the distance.
    """
    if distance_m <= 0.0:
        return math.pi / 2
    top = math.sqrt(max(0.0, (MOON_RADIUS_M + HIGHEST_M) ** 2 - max(0.0, origin_m) ** 2))
    rise = top - (MOON_RADIUS_M + frame_height_m) - lowest_m
    return max(0.0, math.atan2(rise, distance_m))
