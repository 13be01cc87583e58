"""What the plain sphere would cost in place of a terrain's heightfield (docs/sphere.md)."""

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
"""Ground that relief shifts by less is in its place, where a tier admits errors at nodes."""

_BLOCK_ROWS = 256
_SAMPLES = 48
"""Nodes a side at which the law of reflection is tried."""
_TURNS = 8
_MARGIN = 1.25
"""On the greatest change that was found among the samples."""


@dataclass(frozen=True)
class SphereCost:
    """Greatest of what changes at an area's nodes: places, in pixels; normals, radians; the radiance
    factor, relative.
    """

    shift_px: float
    tilt_rad: float
    radiance: float

    def within(self, accuracy: Accuracy) -> bool:
        """Whether a tier admits it; one whose nodes are all right admits none."""
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
    """None where the relief is plainly too rough for the tolerance, or lacks heights: nothing is
    looked at then.

    Ground at a height h over the sphere lies h / tan(e) from where the ray of a camera that it sees
    at an elevation e meets the sphere, and in the plane of a frame, d from its origin, h d / R from
    the sphere's point over the same node. A node's normal is compared with the sphere's; a law of
    reflection is tried at nodes all over the area, the sphere's normal turned by the greatest tilt
    in eight directions. ``between_nodes``: a camera's pixels meet facets, whose normals are
    interpolated, and beyond the field's last nodes are those nodes', half a cell off.
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
    """Heights (...) of ENU points (..., 3) over the sphere, and its unit normals under them."""
    vertical = points + _RADIUS_UP
    away = np.linalg.norm(vertical, axis=-1)
    return away - MOON_RADIUS_M, vertical / away[..., None]


def _departure(terrain: Terrain) -> tuple[float, float]:
    """Greatest height over or under the sphere, metres (a facet's sagitta is added), and greatest
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
    """By how much interpolated normals of a sphere differ from its own within half a cell of the
    core's nodes, radians.
    """
    (rows, cols), (row0, row1, col0, col1) = terrain.field.shape, terrain.core
    cell = terrain.field.gsd_m / MOON_RADIUS_M
    # the normals of a field's outermost nodes are one-sided: half a cell off
    inside = row0 > 1 and col0 > 1 and row1 < rows - 1 and col1 < cols - 1
    return cell * cell if inside else cell / math.sqrt(2.0)


def _change(terrain: Terrain, sun: Array, view: View, model: Reflectance, tilt: float) -> float:
    """Greatest relative change of the radiance factor at a sample of nodes when normals turn by an
    angle; inf where one is not lit.
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
