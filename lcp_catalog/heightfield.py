"""A heightfield: the triangulated surface over a regular grid of nodes, and the rays that meet it.

Nodes are ENU metres: node (i, j) lies at x = x0_m + j gsd_m, y = y0_m - i gsd_m. Every cell is split from its north-west to its
south-east node. Directions are unit ENU vectors from the surface to the Sun or the camera. NaN is nodata: a triangle with a
NaN node does not exist. Kernels work in float64 on float32 heights; results do not depend on the number of threads.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .kernels import fragments, normals, pyramid, scan, tracing

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Window = tuple[int, int, int, int]
"""First row, row behind the last, first column, column behind the last."""

_LEVEL = 1e-15
"""A direction whose horizontal part is smaller is vertical."""

_ALONG = 1e-12
"""A direction this near (radians) to a grid line runs along it: sin(pi) is not 0 in floating point."""


@dataclass(frozen=True, eq=False)
class Heightfield:
    """Heights z_m (rows, cols) in metres, cell size, and ENU position of node [0, 0].

    Heights are stored as float32; infinite ones become nodata. ValueError for anything but two dimensions with at least one node.
    """

    z_m: NDArray[np.float32]
    gsd_m: float
    x0_m: float = 0.0
    y0_m: float = 0.0

    def __post_init__(self) -> None:
        z = np.ascontiguousarray(self.z_m, dtype=np.float32)
        if z.ndim != 2 or z.size == 0:
            raise ValueError(f"heights must be rows x columns, not of shape {z.shape}")
        if not (math.isfinite(self.gsd_m) and self.gsd_m > 0.0):
            raise ValueError(f"the cell size must be positive, not {self.gsd_m}")
        if np.isinf(z).any():
            z = np.where(np.isinf(z), np.float32(np.nan), z)
        object.__setattr__(self, "z_m", z)

    @property
    def shape(self) -> tuple[int, int]:
        return self.z_m.shape[0], self.z_m.shape[1]

    @property
    def whole(self) -> Window:
        """The window of all nodes."""
        return 0, self.shape[0], 0, self.shape[1]

    @cached_property
    def has_holes(self) -> bool:
        """Whether any node is nodata."""
        return bool(np.isnan(self.z_m).any())

    @cached_property
    def _pyramid(self) -> tuple[NDArray[np.float32], NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
        return pyramid.build_pyramid(self.z_m)

    @property
    def _is_surface(self) -> bool:
        """Whether there are cells at all: one row or column of nodes has no area and hides nothing."""
        return min(self.shape) >= 2

    def _window(self, window: Window | None) -> Window:
        row0, row1, col0, col1 = window or self.whole
        if not (0 <= row0 <= row1 <= self.shape[0] and 0 <= col0 <= col1 <= self.shape[1]):
            raise ValueError(f"window {window} is not inside {self.shape}")
        return row0, row1, col0, col1

    def _cells(self, direction: ArrayLike) -> tuple[float, float, float]:
        """A direction per cell of horizontal length: (du, dv) of length 1 and metres of rise; (0, 0, sign) when vertical."""
        east, north, up = (float(v) for v in np.asarray(direction, dtype=np.float64))
        level = math.hypot(east, north)
        if not math.isfinite(level + up) or level + abs(up) == 0.0:
            raise ValueError(f"no direction: {direction}")
        if level <= _LEVEL * abs(up):
            return 0.0, 0.0, math.copysign(1.0, up)
        du, dv = east / level, -north / level
        du, dv = (0.0 if abs(c) < _ALONG else c for c in (du, dv))
        return du, dv, up / level * self.gsd_m

    def occluded_nodes(self, direction: ArrayLike, window: Window | None = None) -> Mask:
        """For each node of the window, bool (rows, cols): whether the surface rises above the ray in ``direction`` (3,).

        Exact. Nodata is not occluded. Straight up nothing is; straight down every node of a triangle is.
        """
        row0, row1, col0, col1 = bounds = self._window(window)
        out = np.zeros((row1 - row0, col1 - col0), dtype=np.bool_)
        du, dv, dz = self._cells(direction)
        if not self._is_surface or out.size == 0:
            return out
        if du == 0.0 and dv == 0.0:
            if dz < 0.0:
                normals.existing_nodes(self.z_m, bounds, out)
            return out
        tracing.occluded_nodes(self.z_m, self.has_holes, *self._pyramid, du, dv, dz, bounds, out)
        return out

    def occluded_nodes_from(self, position_m: ArrayLike, window: Window | None = None) -> Mask:
        """The same for the segments from the nodes to a camera at an ENU position (3,), metres."""
        row0, row1, col0, col1 = bounds = self._window(window)
        out = np.zeros((row1 - row0, col1 - col0), dtype=np.bool_)
        if self._is_surface and out.size:
            camera = self._node_units(position_m)
            tracing.occluded_nodes_from(self.z_m, self.has_holes, *self._pyramid, *camera, bounds, out)
        return out

    def _node_units(self, position_m: ArrayLike) -> tuple[float, float, float]:
        x, y, z = (float(v) for v in np.asarray(position_m, dtype=np.float64))
        if not math.isfinite(x + y + z):
            raise ValueError(f"no position: {position_m}")
        return (x - self.x0_m) / self.gsd_m, (self.y0_m - y) / self.gsd_m, z

    def occluded_points(self, points_m: ArrayLike, direction: ArrayLike) -> Mask:
        """For surface points (n, 3), of which x and y count, whether the surface rises above the ray in ``direction``.

        The ray starts at the height that the triangle has under (x, y), so that the rounding of a hit casts no shadow.
        Points off the surface are not occluded.
        """
        points = np.asarray(points_m, dtype=np.float64).reshape(-1, 3)
        out = np.zeros(len(points), dtype=np.bool_)
        du, dv, dz = self._cells(direction)
        u, v, inside = self._inside(points[:, 0], points[:, 1])
        if not self._is_surface or not inside.any():
            return out
        if du == 0.0 and dv == 0.0:
            return inside if dz < 0.0 else out
        found = np.empty(int(inside.sum()), dtype=np.bool_)
        tracing.occluded_points(
            self.z_m, self.has_holes, *self._pyramid, u[inside], v[inside], du, dv, dz, found
        )
        out[inside] = found
        return out

    def _inside(self, x_m: Array, y_m: Array) -> tuple[Array, Array, Mask]:
        u, v = (x_m - self.x0_m) / self.gsd_m, (self.y0_m - y_m) / self.gsd_m
        rows, cols = self.shape
        return u, v, (u >= 0.0) & (u <= cols - 1) & (v >= 0.0) & (v <= rows - 1)

    def first_hits(self, origin_m: ArrayLike, directions: ArrayLike) -> Array:
        """Where camera rays first meet the surface: range in units of each direction, shape (...) of ``directions`` (..., 3).

        NaN where a ray misses, starts or enters under the ground, or comes through a hole from below.
        """
        rays = np.array(directions, dtype=np.float64)
        flat = rays.reshape(-1, 3)
        out = np.full(len(flat), np.nan)
        if self._is_surface and len(flat):
            flat[:, 0] /= self.gsd_m
            flat[:, 1] /= -self.gsd_m
            origin = self._node_units(origin_m)
            tracing.first_hits(self.z_m, self.has_holes, *self._pyramid, *origin, flat, out)
        return out.reshape(rays.shape[:-1])

    def sweep_occluded(
        self, azimuth_rad: float, elevations_rad: ArrayLike, window: Window | None = None
    ) -> NDArray[np.uint8]:
        """Shadows under several Suns of one azimuth, uint8 (elevations, rows, cols): 1 where occluded. Approximate.

        One scan over sheared lines with an exact stencil of the nearest cells (`kernels.scan`). Elevations must lie in (0, 90]
        degrees. Below 0.5 % of nodes differ from `occluded_nodes` on cratered terrain, 90 % of them within a node of a shadow's edge;
        docs/performance.md has the measured table.
        """
        row0, row1, col0, col1 = bounds = self._window(window)
        elevations = np.atleast_1d(np.asarray(elevations_rad, dtype=np.float64))
        if not ((elevations > 0.0) & (elevations <= math.pi / 2 + 1e-12)).all():
            raise ValueError("a sweep wants elevations above 0 and up to 90 degrees")
        out = np.zeros((elevations.size, row1 - row0, col1 - col0), dtype=np.uint8)
        if not self._is_surface or out.size == 0:
            return out
        du, dv = math.sin(azimuth_rad), -math.cos(azimuth_rad)
        return _Oriented(self.z_m, du, dv, bounds).scan(np.tan(elevations) * self.gsd_m, out)

    def occluded_alone(self, rows: ArrayLike, cols: ArrayLike, half: int, direction: ArrayLike) -> Mask:
        """For n fragments of (2 half + 1)^2 nodes around (rows, cols), bool (n, size, size): occluded by the fragment alone."""
        centre_rows = np.ascontiguousarray(rows, dtype=np.int64)
        centre_cols = np.ascontiguousarray(cols, dtype=np.int64)
        size = 2 * half + 1
        out = np.zeros((centre_rows.size, size, size), dtype=np.bool_)
        if half > 0 and centre_rows.size:
            fragments.occluded_alone(self.z_m, centre_rows, centre_cols, half, *self._cells(direction), out)
        return out

    def normals(self, window: Window | None = None) -> NDArray[np.float32]:
        """Unit normals of the window's nodes, float32 (rows, cols, 3) east, north, up; NaN where none can be had.

        The gradient is that of central differences, one-sided beside nodata and at the border.
        """
        row0, row1, col0, col1 = bounds = self._window(window)
        out = np.empty((row1 - row0, col1 - col0, 3), dtype=np.float32)
        normals.node_normals(self.z_m, self.gsd_m, bounds, out)
        return out

    def heights_at(self, x_m: ArrayLike, y_m: ArrayLike) -> Array:
        """Height of the surface at ENU x, y (any shape), on its triangles; NaN off the surface."""
        x, y = np.broadcast_arrays(np.asarray(x_m, dtype=np.float64), np.asarray(y_m, dtype=np.float64))
        out = np.full(x.size, np.nan)
        if self._is_surface:
            u, v, inside = self._inside(x.ravel(), y.ravel())
            found = np.empty(int(inside.sum()))
            normals.surface_heights(self.z_m, u[inside], v[inside], found)
            out[inside] = found
        return out.reshape(x.shape)

    def normals_at(self, x_m: ArrayLike, y_m: ArrayLike) -> Array:
        """Normals (..., 3) between the nodes: those of the triangle's three nodes, interpolated and made unit again."""
        x, y = np.broadcast_arrays(np.asarray(x_m, dtype=np.float64), np.asarray(y_m, dtype=np.float64))
        out = np.full((x.size, 3), np.nan)
        if self._is_surface:
            u, v, inside = self._inside(x.ravel(), y.ravel())
            found = np.empty((int(inside.sum()), 3))
            normals.surface_normals(self.z_m, self.gsd_m, u[inside], v[inside], found)
            out[inside] = found
        return out.reshape(*x.shape, 3)


class _Oriented:
    """A copy of what can shadow a window, turned so that the Sun stands towards row 0."""

    def __init__(self, z: NDArray[np.float32], du: float, dv: float, window: Window) -> None:
        row0, row1, col0, col1 = window
        self.transposed = abs(du) > abs(dv)
        if self.transposed:
            z, du, dv = z.T, dv, du
            row0, row1, col0, col1 = col0, col1, row0, row1
        self.flipped = dv > 0.0
        if self.flipped:
            z, dv = z[::-1], -dv
            row0, row1 = z.shape[0] - row1, z.shape[0] - row0
        self.shear = du / dv
        drift = self.shear * (row1 - 1)
        left = max(0, col0 - math.ceil(max(drift, 0.0)) - scan.NEAR_CELLS - 2)
        right = min(z.shape[1], col1 + math.ceil(max(-drift, 0.0)) + scan.NEAR_CELLS + 2)
        self.z = np.ascontiguousarray(z[:row1, left:right])
        self.window = (row0, row1, col0 - left, col1 - left)
        self.length = 1.0 / abs(dv)  # cells along the ray from one row to the next
        self.nodes, self.weights = self._stencil(du, dv)

    def _stencil(self, du: float, dv: float) -> tuple[NDArray[np.int64], Array]:
        """The near stencil of the raster's own direction, in the turned axes: the diagonal does not turn with a flip."""
        turned_v = -dv if self.flipped else dv
        raster = (turned_v, du) if self.transposed else (du, turned_v)
        nodes, weights = scan.near_stencil(*raster)
        if self.transposed:
            nodes = nodes[:, [1, 0, 3, 2]]
        if self.flipped:
            nodes = nodes * np.array([-1, 1, -1, 1])
        return np.ascontiguousarray(nodes), weights

    def scan(self, slopes: Array, out: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Scan with slopes (k,), metres a cell, into masks of the raster's own orientation."""
        row0, row1, col0, col1 = self.window
        masks = np.zeros((slopes.size, row1 - row0, col1 - col0), dtype=np.uint8)
        slopes = np.minimum(slopes, 1e8)  # the zenith: float32 has no room for more, and nothing is that steep
        lines = col1 - col0 + abs(int(self.shear * row1)) + 4
        blocks = max(1, min(16, lines // 256))
        scan.scan(
            self.z, self.shear, slopes * self.length, slopes, self.nodes, self.weights, blocks, self.window, masks
        )
        scan.turn(masks, self.transposed, self.flipped, out)
        return out
