"""Bounds of a terrain's slopes and heights, which limit where it can shadow or hide a point."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array
from ..cameras.view import CameraView, ScannerView, View
from .heightfield import Heightfield, Window
from .terrain import Terrain

COARSE_NODES = 8
"""Factor by which the nodes are coarser on which the width of a ring is computed."""

COARSE_SLOPE = 0.35
"""Bound of the height that coarse nodes smooth away, in coarse cells: half of one at 35 deg."""

BLOCK_ROWS = 512
_ROUNDING = (
    1e-6  # of a slope: a skipped ray clears the steepest facet by more than rounding can take
)


@dataclass(frozen=True)
class Steepness:
    """Tangent of the steepest facet of a surface, and True if the surface is connected (every node
    has a height).
    """

    tangent: float
    connected: bool

    def clears(self, tangent: float) -> bool:
        """True if the surface nowhere meets rays that climb with a tangent."""
        return self.connected and tangent > self.tangent * (1 + _ROUNDING)


@dataclass(frozen=True)
class Box:
    """Least and greatest ENU corner (3,) of a box around the nodes of a core."""

    low_m: Array
    high_m: Array

    @property
    def middle_m(self) -> Array:
        """ENU (3,)."""
        return np.asarray(0.5 * (self.low_m + self.high_m))

    @property
    def corners_m(self) -> Array:
        """ENU (8, 3)."""
        sides = np.meshgrid(*zip(self.low_m, self.high_m, strict=True), indexing="ij")
        return np.stack([side.ravel() for side in sides], axis=-1)


@dataclass(frozen=True)
class Relief:
    """Slopes and heights of a terrain: its steepest facet; the core's box; the highest ENU z of all
    the terrain, metres; the greatest tangent of a node normal's tilt from the vertical; cell size
    and longest diagonal of the terrain, metres.
    """

    slope: Steepness
    box: Box
    highest_m: float
    node_tangent: float
    gsd_m: float
    span_m: float

    @property
    def shading_height_m(self) -> float:
        """Greatest height of the terrain above a node of the core, metres."""
        return max(0.0, self.highest_m - float(self.box.low_m[2]))


def steepness(field: Heightfield) -> Steepness:
    """The steepest facet of all triangles of a heightfield; 0 without any."""
    return Steepness(field.steepest_tangent, not field.has_holes)


def relief(terrain: Terrain) -> Relief:
    """The relief of a terrain.

    A node's gradient is the mean of those of the two facets that hold its east and north, and its
    west and south edges: not steeper than the steepest facet. One-sided differences, at the border,
    take their two components from two facets: at most sqrt(2) times as steep.
    """
    field, (row0, row1, col0, col1) = terrain.field, terrain.core
    rows, cols = field.shape
    slope, box, far = steepness(field), core_box(terrain), terrain.far
    inside = row0 > 0 and col0 > 0 and row1 < rows and col1 < cols
    return Relief(
        slope=slope,
        box=box,
        highest_m=max(
            float(box.high_m[2]), field.extremes_m[1], far.highest_m if far else -math.inf
        ),
        node_tangent=slope.tangent * (1.0 if inside and slope.connected else math.sqrt(2.0)),
        gsd_m=field.gsd_m,
        span_m=far.span_m if far else math.hypot(rows - 1, cols - 1) * field.gsd_m,
    )


def core_box(terrain: Terrain) -> Box:
    """The box around a terrain's core; flat at z = 0 if no node has a height."""
    field, (row0, row1, col0, col1) = terrain.field, terrain.core
    core = field.z_m[row0:row1, col0:col1]
    known = bool(np.isfinite(core).any())
    low, high = (float(np.nanmin(core)), float(np.nanmax(core))) if known else (0.0, 0.0)
    west, north = field.x0_m + col0 * field.gsd_m, field.y0_m - row0 * field.gsd_m
    east, south = west + (col1 - col0 - 1) * field.gsd_m, north - (row1 - row0 - 1) * field.gsd_m
    return Box(np.array([west, south, low]), np.array([east, north, high]))


def nodes_enu(field: Heightfield, window: Window, step: int = 1) -> Array:
    """ENU positions (rows, cols, 3) of every ``step``-th node of a window; z is NaN without a
    height.
    """
    row0, row1, col0, col1 = window
    y, x = np.meshgrid(
        field.y0_m - np.arange(row0, row1, step) * field.gsd_m,
        field.x0_m + np.arange(col0, col1, step) * field.gsd_m,
        indexing="ij",
    )
    z = field.z_m[row0:row1:step, col0:col1:step].astype(np.float64)
    return np.stack([x, y, z], axis=-1)


def tangent_of(direction: Array) -> float:
    """Tangent of the elevation of a direction (3,); inf for straight up."""
    level = math.hypot(direction[0], direction[1])
    return math.inf if level == 0 and direction[2] > 0 else float(direction[2]) / max(level, 1e-300)


def lowest_view_tangent(view: View, points_m: Array) -> float:
    """Tangent of the camera's least elevation as seen from ENU points (..., 3); inf without a
    point.
    """
    if isinstance(view, ScannerView):
        return view.lowest_tangent
    if not isinstance(view, CameraView):
        return tangent_of(view.direction)
    height = view.position_m[2] - points_m[..., 2]
    away = np.hypot(view.position_m[0] - points_m[..., 0], view.position_m[1] - points_m[..., 1])
    with np.errstate(divide="ignore"):
        tangents = np.where(away > 0, height / np.where(away > 0, away, 1.0), np.inf)
    known = tangents[np.isfinite(height)]
    return float(known.min()) if known.size else math.inf


def lowest_core_tangent(view: View, terrain: Terrain) -> float:
    """`lowest_view_tangent` of all nodes of a terrain's core."""
    if not isinstance(view, CameraView):
        return lowest_view_tangent(view, np.empty((0, 3)))
    row0, row1, col0, col1 = terrain.core
    return min(
        lowest_view_tangent(
            view, nodes_enu(terrain.field, (row, min(row + BLOCK_ROWS, row1), col0, col1))
        )
        for row in range(row0, row1, BLOCK_ROWS)
    )


def ring_needed_m(coarse: Terrain, tangent: float, margin_m: float) -> float:
    """Greatest distance from the core, metres, at which terrain can rise above rays that climb from
    the core with a tangent; from coarse heights.

    ``margin_m``: bound of the height that the coarse nodes smooth away; it is added to the terrain
    and subtracted from the core.
    """
    z, (r0, r1, c0, c1) = coarse.field.z_m, coarse.core
    inside = z[r0:r1, c0:c1]
    if not np.isfinite(inside).any():
        return 0.0
    floor = float(np.nanmin(inside)) - margin_m
    rows_off, cols_off = _nodes_off(coarse)
    away = np.hypot(rows_off, cols_off) * coarse.field.gsd_m
    climb = np.maximum(away - coarse.field.gsd_m, 0.0) * tangent
    reach = (away > 0) & (z + margin_m - floor > climb)
    if not reach.any():
        return 0.0
    return float(np.maximum(rows_off, cols_off)[reach].max() + 1) * coarse.field.gsd_m


@dataclass(frozen=True)
class Ring:
    """Gaps of the terrain around a core: share of its nodes without a height, and the distance of
    the nearest missing surface from the core, metres (inf without any).
    """

    missing: float
    gap_m: float


def ring_of(terrain: Terrain) -> Ring:
    """Gaps of the ring around a terrain's core."""
    row0, row1, col0, col1 = terrain.core
    gaps = ~np.isfinite(terrain.field.z_m)
    around = gaps.size - (row1 - row0) * (col1 - col0)
    gaps[row0:row1, col0:col1] = False
    if not gaps.any():
        return Ring(0.0, math.inf)
    rows_off, cols_off = _nodes_off(terrain)
    nearest = (
        int(np.maximum(rows_off, cols_off)[gaps].min()) - 1
    )  # its cells begin a node before it
    return Ring(float(gaps.sum()) / around, nearest * terrain.field.gsd_m)


def _nodes_off(terrain: Terrain) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows (rows, 1) and columns (1, cols) between a node and the core; 0 inside."""
    r0, r1, c0, c1 = terrain.core
    row, col = np.ogrid[0 : terrain.field.shape[0], 0 : terrain.field.shape[1]]
    return (
        np.maximum(np.maximum(r0 - row, row - r1 + 1), 0),
        np.maximum(np.maximum(c0 - col, col - c1 + 1), 0),
    )
