"""Bounds on the error of leaving an effect out of a render; each function states its proof.

Error of the plain sphere in place of a terrain's heightfield.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..accuracy import Accuracy
from ..arrays import Array
from ..cameras.view import CameraView, ScannerView, View, finest_pixel_m
from ..constants import HIGHEST_M, MOON_RADIUS_M, SOLAR_RADIUS_RAD
from ..kernels.photometry.laws import LAMBERT, LOMMEL_SEELIGER
from ..light.solar_disc import penumbra_m
from ..photometry.laws import DEFAULT_MODEL, Reflectance, radiance_under
from ..terrain.relief_bounds import Box, Relief, nodes_enu, tangent_of
from ..terrain.terrain import Terrain

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


_RADIUS_UP = np.array([0.0, 0.0, MOON_RADIUS_M])

SHIFT_PX = 0.1
"""Greatest permitted shift of the surface by relief, in tiers that permit errors at nodes."""

_BLOCK_ROWS = 256
_SAMPLES = 48
"""Nodes per side at which the reflectance model is evaluated."""
_TURNS = 8
_MARGIN = 1.25
"""Factor on the greatest change among the samples."""


@dataclass(frozen=True)
class SphereCost:
    """Greatest changes at an area's nodes: position, in pixels; normal, in radians; radiance factor,
    relative.
    """

    shift_px: float
    tilt_rad: float
    radiance: float

    def within(self, accuracy: Accuracy) -> bool:
        """True if a tier permits the changes; a tier without errors at nodes permits none."""
        if accuracy.exact or accuracy.tolerance <= 0.0:
            return False
        return self.shift_px <= SHIFT_PX and max(self.tilt_rad, self.radiance) <= accuracy.tolerance


def sphere_cost(
    terrain: Terrain,
    sun: Array,
    view: View,
    model: Reflectance,
    least_view_tangent: float,
    pixel_m: float,
    tolerance: float,
    between_nodes: bool = False,
) -> SphereCost | None:
    """The changes; None, without a computation, if the relief is clearly too rough for the tolerance
    or has no height at some nodes.

    A point at a height h above the sphere, from which a camera has the elevation e, is h / tan(e) from
    the point where the camera's ray meets the sphere. In the plane of a frame, at a distance d from
    its origin, it is h d / R from the sphere's point over the same node. Every node's normal is
    compared with the sphere's. The reflectance model is evaluated at nodes all over the area, with the
    sphere's normal turned by the greatest tilt in eight directions. ``between_nodes``: True for the
    pixels of a camera, whose normals are interpolated between nodes, and taken from the last nodes up
    to half a cell beyond them.
    """
    field = terrain.field
    away_m = float(
        np.hypot(*np.abs(nodes_enu(field, field.whole, _step(field.shape))[..., :2]).max((0, 1)))
    )
    slope = math.atan(field.steepest_tangent)
    if field.has_holes or slope > away_m / MOON_RADIUS_M * 1.1 + 2.0 * tolerance:
        return None
    height_m, tilt = _departure(terrain)
    if between_nodes:
        tilt += _off_nodes(terrain)
    shift_px = height_m * max(1.0 / max(least_view_tangent, 1e-9), away_m / MOON_RADIUS_M) / pixel_m
    change = _MARGIN * _change(terrain, sun, view, model, tilt)
    return SphereCost(shift_px, tilt + STORED, change + STORED)


def _step(shape: tuple[int, int]) -> int:
    return max(1, max(shape) // _SAMPLES)


def _sphere(points: Array) -> tuple[Array, Array]:
    """Heights (...) of ENU points (..., 3) above the sphere, and the sphere's unit normals there."""
    vertical = points + _RADIUS_UP
    away = np.linalg.norm(vertical, axis=-1)
    return away - MOON_RADIUS_M, vertical / away[..., None]


def _departure(terrain: Terrain) -> tuple[float, float]:
    """Greatest height above or below the sphere, metres (with a facet's sagitta), and greatest
    angle between a node's normal and the sphere's.
    """
    field, (row0, row1, col0, col1) = terrain.field, terrain.core
    height = tilt = 0.0
    for row in range(row0, row1, _BLOCK_ROWS):
        window = (row, min(row + _BLOCK_ROWS, row1), col0, col1)
        over, vertical = _sphere(nodes_enu(field, window))
        across = np.linalg.norm(
            np.cross(field.normals(window).astype(np.float64), vertical), axis=-1
        )
        height, tilt = max(height, float(np.abs(over).max())), max(tilt, float(across.max()))
    sagitta = field.gsd_m**2 / (4.0 * MOON_RADIUS_M)
    return height + sagitta, math.asin(min(1.0, tilt)) + NORMAL_ROUNDING_RAD


def _off_nodes(terrain: Terrain) -> float:
    """Greatest difference between interpolated normals of a sphere and its own within half a cell of
    the core's nodes, radians.
    """
    (rows, cols), (row0, row1, col0, col1) = terrain.field.shape, terrain.core
    cell = terrain.field.gsd_m / MOON_RADIUS_M
    # the normals of a field's outermost nodes are one-sided: half a cell off
    inside = row0 > 1 and col0 > 1 and row1 < rows - 1 and col1 < cols - 1
    return cell * cell if inside else cell / math.sqrt(2.0)


def _change(terrain: Terrain, sun: Array, view: View, model: Reflectance, tilt: float) -> float:
    """Greatest relative change of the radiance factor at a sample of nodes when normals turn by an
    angle; inf if a node is not lit.
    """
    points = nodes_enu(terrain.field, terrain.core, _step(terrain.product_index.shape)).reshape(
        -1, 3
    )
    _, normals = _sphere(points)
    towards = np.ascontiguousarray(np.broadcast_to(view.directions(points), points.shape))
    lit = np.ones(len(points), dtype=np.bool_)
    level = radiance_under(normals, sun, towards, lit, model)
    if not (level > 0.0).all():
        return math.inf
    east = np.cross([0.0, 1.0, 0.0], normals)
    east /= np.linalg.norm(east, axis=-1, keepdims=True)
    north = np.cross(normals, east)
    worst = 0.0
    for turn in np.arange(_TURNS) * (2.0 * math.pi / _TURNS):
        side = math.cos(turn) * east + math.sin(turn) * north
        turned = radiance_under(
            math.cos(tilt) * normals + math.sin(tilt) * side, sun, towards, lit, model
        )
        worst = max(worst, float(np.abs(turned / level - 1.0).max()))
    return worst
