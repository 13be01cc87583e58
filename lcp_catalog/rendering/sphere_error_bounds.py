"""Error of the plain sphere in place of a terrain's heightfield."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..accuracy import Accuracy
from ..arrays import Array
from ..cameras.view import View
from ..constants import MOON_RADIUS_M
from ..photometry.laws import Reflectance, radiance_under
from ..terrain.relief_bounds import nodes_enu
from ..terrain.terrain import Terrain
from .error_bounds import NORMAL_ROUNDING_RAD, STORED

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
