"""A heightfield: the triangulated surface over a regular grid of nodes, and the rays that meet it.

Nodes are ENU metres: node (i, j) lies at x = x0_m + j gsd_m, y = y0_m - i gsd_m. Every cell is
split from its north-west to its south-east node. Directions are unit ENU vectors from the surface
to the Sun or the camera. NaN is nodata: a triangle with a NaN node does not exist. Kernels work in
float64 on float32 heights; results do not depend on the number of threads.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..arrays import Array, Mask
from ..kernels.rays import bundles, camera_tiles, isolated_patches, max_pyramid, surface
from ..kernels.shadows import scan_lines, steep_tiles

Window = tuple[int, int, int, int]
"""First row, row behind the last, first column, column behind the last."""


@dataclass(frozen=True, eq=False)
class Heightfield:
    """Heights z_m (rows, cols) in metres, cell size, and ENU position of node [0, 0].

    Heights are stored as float32 (an array that already is one is not copied: do not change it
    afterwards); infinite ones become nodata. ValueError for anything but two dimensions with at
    least one node. Kept in memory: 4 bytes a node, 1.33 for the max pyramid after the first ray, 4
    for a transposed copy after the first Sun in the east or west of which shadows are scanned.
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
    def extremes_m(self) -> tuple[float, float, bool]:
        """Lowest and highest height (inf, -inf where there is none), and whether any node is
        nodata.
        """
        low, high, holes = max_pyramid.extremes(self.z_m)
        return float(low), float(high), bool(holes)

    @property
    def has_holes(self) -> bool:
        """Whether any node is nodata."""
        return self.extremes_m[2]

    def lowest_m(self, window: Window) -> float:
        """Lowest height of a window; inf where it has none."""
        if window == self.whole:
            return self.extremes_m[0]
        row0, row1, col0, col1 = window
        low, _, _ = max_pyramid.extremes(np.ascontiguousarray(self.z_m[row0:row1, col0:col1]))
        return float(low)

    @cached_property
    def tile_gradients_m(self) -> tuple[Array, Mask]:
        """Steepest facet of each tile of nodes, metres a cell, and which tiles touch nodata
        (`kernels.steep`).
        """
        gradients, holed = steep_tiles.tile_gradients(self.z_m)
        return gradients, holed

    @property
    def steepest_tangent(self) -> float:
        """Tangent of the steepest facet's slope; 0 without a facet."""
        return float(self.tile_gradients_m[0].max()) / self.gsd_m

    @cached_property
    def transposed_m(self) -> NDArray[np.float32]:
        """Heights with rows and columns exchanged, for passes that go along the rows."""
        return scan_lines.transposed(self.z_m)

    @cached_property
    def _pyramid(
        self,
    ) -> tuple[NDArray[np.float32], NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
        return max_pyramid.build_pyramid(self.z_m)

    @property
    def traced(self) -> tuple[NDArray[np.float32], bool, tuple[Any, ...], float]:
        """What every ray kernel wants first: heights, whether any is missing, pyramid, summit."""
        return self.z_m, self.has_holes, self._pyramid, self.extremes_m[1]

    @property
    def is_surface(self) -> bool:
        """Whether there are cells at all: one row or column of nodes hides nothing."""
        return min(self.shape) >= 2

    def checked_window(self, window: Window | None) -> Window:
        """The window, or all; ValueError where it is not inside."""
        row0, row1, col0, col1 = window or self.whole
        if not (0 <= row0 <= row1 <= self.shape[0] and 0 <= col0 <= col1 <= self.shape[1]):
            raise ValueError(f"window {window} is not inside {self.shape}")
        return row0, row1, col0, col1

    def ray_in_cells(self, direction: ArrayLike) -> tuple[float, float, float]:
        """A direction in cell units with max(|du|, |dv|) = 1; (0, 0, dz) when vertical. ValueError
        when it is none.
        """
        east, north, up = (float(v) for v in np.asarray(direction, dtype=np.float64))
        if not math.isfinite(east + north + up) or max(abs(east), abs(north), abs(up)) == 0.0:
            raise ValueError(f"no direction: {direction!r}")
        du, dv, dz, _ = bundles.scaled(east, -north, up * self.gsd_m)
        return float(du), float(dv), float(dz)

    def occluded_nodes(self, direction: ArrayLike, window: Window | None = None) -> Mask:
        """For each node of the window, bool (rows, cols): whether the surface rises above the ray
        in ``direction`` (3,).

        Exact. Nodata is not occluded. Straight up nothing is; straight down every node of a
        triangle is.
        """
        row0, row1, col0, col1 = bounds = self.checked_window(window)
        out = np.zeros((row1 - row0, col1 - col0), dtype=np.bool_)
        du, dv, dz = self.ray_in_cells(direction)
        if not self.is_surface or out.size == 0:
            return out
        if du == 0.0 and dv == 0.0:
            if dz < 0.0:
                surface.existing_nodes(self.z_m, bounds, out)
            return out
        bundles.occluded_nodes(*self.traced, du, dv, dz, bounds, out)
        return out

    def occluded_nodes_from(self, position_m: ArrayLike, window: Window | None = None) -> Mask:
        """The same for the segments from the nodes to a camera at an ENU position (3,), metres.

        From a camera under the surface (by over 1e-6 m) nothing is seen. Terrain within 1e-6 cells
        of the camera is not looked at: the camera may stand on a node.
        """
        row0, row1, col0, col1 = bounds = self.checked_window(window)
        out = np.zeros((row1 - row0, col1 - col0), dtype=np.bool_)
        if self.is_surface and out.size:
            camera = self._node_units(position_m)
            bundles.occluded_nodes_from(*self.traced, *camera, bounds, out)
        return out

    def _node_units(self, position_m: ArrayLike) -> tuple[float, float, float]:
        x, y, z = (float(v) for v in np.asarray(position_m, dtype=np.float64))
        if not math.isfinite(x + y + z):
            raise ValueError(f"no position: {position_m!r}")
        return (x - self.x0_m) / self.gsd_m, (self.y0_m - y) / self.gsd_m, z

    def occluded_points(self, points_m: ArrayLike, direction: ArrayLike) -> Mask:
        """For points (n, 3), whether the surface rises above the ray in ``direction``, bool (n,).

        A point within 1 mm of the surface is put on it, and within 1e-9 cells of a grid line or
        diagonal on that, so that the rounding of a camera ray's hit casts no shadow: from there on
        the answer is exact, its own triangle included, as for a node. Points further above are
        traced from where they are; those below are occluded; NaN is not.
        """
        points = np.asarray(points_m, dtype=np.float64).reshape(-1, 3)
        out = np.zeros(len(points), dtype=np.bool_)
        ray = self.ray_in_cells(direction)
        if self.is_surface and len(points):
            u, v = self._uv(points[:, 0], points[:, 1])
            bundles.occluded_points(
                *self.traced, u, v, np.ascontiguousarray(points[:, 2]), *ray, out
            )
        return out

    def _uv(self, x_m: Array, y_m: Array) -> tuple[Array, Array]:
        return (x_m - self.x0_m) / self.gsd_m, (self.y0_m - y_m) / self.gsd_m

    def first_hits(self, origin_m: ArrayLike, directions: ArrayLike) -> Array:
        """Where camera rays first meet the surface: range in units of each direction, shape (...)
        of ``directions`` (..., 3).

        NaN where a ray misses, is none, or comes to be under the surface without having met it:
        from a camera under the ground (by over 1e-6 m), over the raster's border, or through a
        hole. What `occluded_nodes_from` calls occluded is never hit.
        """
        ahead = np.ascontiguousarray(directions, dtype=np.float64)
        shape = np.shape(directions)[:-1]
        out = np.full((math.prod(shape[:-1]), shape[-1]) if shape else (1, 1), np.nan)
        if self.is_surface and out.size:
            origin = self._node_units(origin_m)
            ahead = ahead.reshape(*out.shape, 3)
            camera_tiles.first_hits(*self.traced, *origin, self.gsd_m, ahead, out)
        return out.reshape(shape)

    def occluded_alone(
        self, rows: ArrayLike, cols: ArrayLike, half: int, direction: ArrayLike
    ) -> Mask:
        """For n fragments of (2 half + 1)^2 nodes around (rows, cols), bool (n, size, size):
        occluded by the fragment alone.
        """
        centre_rows = np.ascontiguousarray(rows, dtype=np.int64)
        centre_cols = np.ascontiguousarray(cols, dtype=np.int64)
        size = 2 * half + 1
        out = np.zeros((centre_rows.size, size, size), dtype=np.bool_)
        if half > 0 and centre_rows.size:
            isolated_patches.occluded_alone(
                self.z_m, centre_rows, centre_cols, half, *self.ray_in_cells(direction), out
            )
        return out

    def normals(self, window: Window | None = None) -> NDArray[np.float32]:
        """Unit normals of the window's nodes, float32 (rows, cols, 3) east, north, up; NaN where
        none can be had.

        The gradient is that of central differences, one-sided beside nodata and at the border.
        """
        row0, row1, col0, col1 = self.checked_window(window)
        out = np.empty((row1 - row0, col1 - col0, 3), dtype=np.float32)
        surface.normals(self.z_m, self.gsd_m, row0, col0, out)
        return out

    def heights_at(self, x_m: ArrayLike, y_m: ArrayLike) -> Array:
        """Height of the surface at ENU x, y (any shape), on its triangles; NaN off the surface."""
        x, y = np.broadcast_arrays(
            np.asarray(x_m, dtype=np.float64), np.asarray(y_m, dtype=np.float64)
        )
        return surface.heights_at(self.z_m, *self._uv(x.ravel(), y.ravel())).reshape(x.shape)

    def normals_at(self, x_m: ArrayLike, y_m: ArrayLike) -> Array:
        """Normals (..., 3) between the nodes: those of the triangle's three nodes, interpolated and
        made unit again.
        """
        x, y = np.broadcast_arrays(
            np.asarray(x_m, dtype=np.float64), np.asarray(y_m, dtype=np.float64)
        )
        found = surface.normals_at(self.z_m, self.gsd_m, *self._uv(x.ravel(), y.ravel()))
        return found.reshape(*x.shape, 3)
