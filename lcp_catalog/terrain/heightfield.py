"""A heightfield: the triangulated surface over a regular grid of nodes, and its intersections with
rays.

Positions are ENU metres: node (i, j) lies at x = x0_m + j gsd_m, y = y0_m - i gsd_m. Every cell is
split from its north-west to its south-east node. Directions are ENU vectors from the surface to the
Sun or the camera. NaN means nodata: a triangle with a NaN node does not exist. Kernels compute in
float64 on float32 heights; results do not depend on the number of threads.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..arrays import AnyArray, Array, Mask
from ..kernels.rays import (
    bundles,
    camera_tiles,
    from_surface,
    isolated_patches,
    max_pyramid,
    own_directions,
    surface,
)
from ..kernels.shadows import proved_bounds, scan_lines, steep_tiles

Window = tuple[int, int, int, int]
"""Rows and columns, half open: first row, row behind the last, first column, column behind the
last.
"""


@dataclass(frozen=True, eq=False)
class Heightfield:
    """Heights z_m (rows, cols) in metres, cell size, and ENU position of node [0, 0].

    Heights are stored as float32 (a float32 array is not copied: do not change it afterwards);
    infinite ones become nodata. ValueError unless the array has two dimensions and at least one
    node, and the cell size is positive. Memory per node: 4 bytes, 1.33 for the max pyramid after
    the first ray, 4 for a transposed copy after the first shadow scan with the Sun in the east or
    west; with nodata, 4 more for each orientation, without the nodes beside it.
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
        """Lowest and highest height (inf, -inf without any), and True if any node is nodata."""
        low, high, holes = max_pyramid.extremes(self.z_m)
        return float(low), float(high), bool(holes)

    @property
    def has_holes(self) -> bool:
        """True if any node is nodata."""
        return self.extremes_m[2]

    def lowest_m(self, window: Window) -> float:
        """Lowest height of a window; inf without any."""
        if window == self.whole:
            return self.extremes_m[0]
        row0, row1, col0, col1 = window
        low, _, _ = max_pyramid.extremes(np.ascontiguousarray(self.z_m[row0:row1, col0:col1]))
        return float(low)

    @cached_property
    def tile_gradients_m(self) -> tuple[Array, Mask]:
        """Steepest facet of each tile of nodes, metres per cell, and the mask of tiles that touch
        nodata (`kernels.shadows.steep_tiles`).
        """
        gradients, holed = steep_tiles.tile_gradients(self.z_m)
        return gradients, holed

    @property
    def steepest_tangent(self) -> float:
        """Tangent of the steepest facet's slope; 0 without a facet."""
        return float(self.tile_gradients_m[0].max()) / self.gsd_m

    @cached_property
    def transposed_m(self) -> NDArray[np.float32]:
        """Heights with rows and columns exchanged, for passes along the rows."""
        return np.asarray(scan_lines.transposed(self.z_m))

    @cached_property
    def borderless_m(self) -> NDArray[np.float32]:
        """Heights without the nodes beside nodata (`kernels.shadows.proved_bounds`)."""
        return proved_bounds.without_borders(self.z_m) if self.has_holes else self.z_m

    @cached_property
    def transposed_borderless_m(self) -> NDArray[np.float32]:
        """`borderless_m` with rows and columns exchanged."""
        return scan_lines.transposed(self.borderless_m) if self.has_holes else self.transposed_m

    @cached_property
    def _pyramid(
        self,
    ) -> tuple[NDArray[np.float32], NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
        levels, first, rows, cols = max_pyramid.build_pyramid(self.z_m)
        return levels, first, rows, cols

    @property
    def traced(self) -> tuple[NDArray[np.float32], bool, tuple[Any, ...], float]:
        """First arguments of every ray kernel: heights, True if any is missing, pyramid, highest
        height.
        """
        return self.z_m, self.has_holes, self._pyramid, self.extremes_m[1]

    @property
    def is_surface(self) -> bool:
        """True if there are cells: a single row or column of nodes has no surface."""
        return min(self.shape) >= 2

    def checked_window(self, window: Window | None) -> Window:
        """The window (default: all nodes); ValueError if it is not inside the raster."""
        row0, row1, col0, col1 = window or self.whole
        if not (0 <= row0 <= row1 <= self.shape[0] and 0 <= col0 <= col1 <= self.shape[1]):
            raise ValueError(f"window {window} is not inside {self.shape}")
        return row0, row1, col0, col1

    def part(self, window: Window) -> Heightfield:
        """The heightfield of a window's nodes alone; ValueError for a window outside the raster."""
        row0, row1, col0, col1 = self.checked_window(window)
        z = np.ascontiguousarray(self.z_m[row0:row1, col0:col1])
        west_m, north_m = self.x0_m + col0 * self.gsd_m, self.y0_m - row0 * self.gsd_m
        return Heightfield(z, self.gsd_m, west_m, north_m)

    def ray_in_cells(self, direction: ArrayLike) -> tuple[float, float, float]:
        """A direction (3,) in cell units with max(|du|, |dv|) = 1; (0, 0, dz) if vertical.
        ValueError for a direction that is zero or not finite.
        """
        east, north, up = (float(v) for v in np.asarray(direction, dtype=np.float64))
        if not math.isfinite(east + north + up) or max(abs(east), abs(north), abs(up)) == 0.0:
            raise ValueError(f"invalid direction {direction!r}")
        du, dv, dz, _ = bundles.scaled(east, -north, up * self.gsd_m)
        return float(du), float(dv), float(dz)

    def occluded_nodes(self, direction: ArrayLike, window: Window | None = None) -> Mask:
        """True for nodes of the window, bool (rows, cols), where the surface rises above the ray in
        ``direction`` (3,).

        Exact. False at nodata. For a ray straight up: all False; straight down: True wherever a
        triangle exists.
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
        """Occlusion of the nodes along the segments to a camera at an ENU position (3,), metres.

        All nodes are occluded for a camera more than 1e-6 m below the surface. Terrain within
        1e-6 cells of the camera is ignored: the camera may be at a node.
        """
        row0, row1, col0, col1 = bounds = self.checked_window(window)
        out = np.zeros((row1 - row0, col1 - col0), dtype=np.bool_)
        if self.is_surface and out.size:
            u, v, z = self._node_units(position_m)
            bundles.occluded_nodes_from(*self.traced, u, v, z, bounds, out)
        return out

    def occluded_nodes_towards(self, directions: ArrayLike, window: Window | None = None) -> Mask:
        """Occlusion of the window's nodes, each along its own ENU direction (rows, cols, 3): that of a
        camera that moves during the exposure. Exact. False at nodata and for directions with NaN.
        """
        row0, row1, col0, col1 = bounds = self.checked_window(window)
        out = np.zeros((row1 - row0, col1 - col0), dtype=np.bool_)
        if self.is_surface and out.size:
            ahead = np.ascontiguousarray(directions, dtype=np.float64)
            own_directions.occluded_nodes(*self.traced, self.gsd_m, ahead, bounds, out)
        return out

    def _node_units(self, position_m: ArrayLike) -> tuple[float, float, float]:
        x, y, z = (float(v) for v in np.asarray(position_m, dtype=np.float64))
        if not math.isfinite(x + y + z):
            raise ValueError(f"invalid position {position_m!r}")
        return (x - self.x0_m) / self.gsd_m, (self.y0_m - y) / self.gsd_m, z

    def occluded_points(self, points_m: ArrayLike, direction: ArrayLike) -> Mask:
        """True for points (n, 3) where the surface rises above the ray in ``direction``, bool (n,).

        A point within 1 mm of the surface is moved onto it, and one within 1e-9 cells of a grid
        line or diagonal onto that, so that the rounding of a camera ray's hit causes no shadow.
        From there the result is exact, its own triangle included, as for a node. Points further
        above are traced from their position; points below are occluded; NaN points are not.
        """
        points = np.asarray(points_m, dtype=np.float64).reshape(-1, 3)
        out = np.zeros(len(points), dtype=np.bool_)
        du, dv, dz = self.ray_in_cells(direction)
        if self.is_surface and len(points):
            u, v = self.uv(points[:, 0], points[:, 1])
            z = np.ascontiguousarray(points[:, 2])
            bundles.occluded_points(*self.traced, u, v, z, du, dv, dz, out)
        return out

    def meetings(self, points_m: ArrayLike, directions: ArrayLike) -> Array:
        """Points (n, 3) at which rays in ``directions`` (n, 3) from surface points (n, 3) first meet
        the surface; NaN for a ray that meets none, and for vertical rays.

        A ray starts on the surface at the point's x and y. One that begins below its own triangle
        meets it at once.
        """
        points = np.asarray(points_m, dtype=np.float64).reshape(-1, 3)
        ahead = np.ascontiguousarray(directions, dtype=np.float64)
        reach = np.full(len(points), np.nan)
        u, v = self.uv(points[:, 0], points[:, 1])
        if self.is_surface and len(points):
            from_surface.meetings(*self.traced, self.gsd_m, u, v, ahead, reach)
        x, y = (points[:, k] + reach * ahead[:, k] for k in (0, 1))
        return np.stack([x, y, self.heights_at(x, y)], axis=-1)

    def nodes_m(self, rows: NDArray[np.int64], cols: NDArray[np.int64]) -> Array:
        """ENU positions (n, 3) of nodes."""
        x, y = self.x0_m + cols * self.gsd_m, self.y0_m - rows * self.gsd_m
        return np.stack([x, y, self.z_m[rows, cols].astype(np.float64)], axis=-1)

    def uv(self, x_m: AnyArray, y_m: AnyArray) -> tuple[Array, Array]:
        """Columns and rows, fractional, of ENU x and y."""
        return (x_m - self.x0_m) / self.gsd_m, (self.y0_m - y_m) / self.gsd_m

    def first_hits(self, origin_m: ArrayLike, directions: ArrayLike) -> Array:
        """Range of the first intersection of camera rays with the surface, in units of each
        direction, shape (...) of ``directions`` (..., 3).

        NaN for a ray that misses, is zero or not finite, or gets below the surface without an
        intersection: from a camera more than 1e-6 m below the surface, over the raster's border, or
        through a hole. Nodes that are occluded by `occluded_nodes_from` are never hit.
        """
        ahead = np.ascontiguousarray(directions, dtype=np.float64)
        shape = np.shape(directions)[:-1]
        out = np.full((math.prod(shape[:-1]), shape[-1]) if shape else (1, 1), np.nan)
        if self.is_surface and out.size:
            u, v, z = self._node_units(origin_m)
            ahead = ahead.reshape(*out.shape, 3)
            camera_tiles.first_hits(*self.traced, u, v, z, self.gsd_m, ahead, out)
        return out.reshape(shape)

    def first_hits_of_lines(self, origins_m: ArrayLike, directions: ArrayLike) -> Array:
        """`first_hits` of camera rays (rows, cols, 3), those of a row from its own ENU position of
        ``origins_m`` (rows, 3).
        """
        ahead = np.ascontiguousarray(directions, dtype=np.float64)
        x, y, z = np.asarray(origins_m, dtype=np.float64).T
        out = np.full(ahead.shape[:2], np.nan)
        if self.is_surface and out.size:
            origins = np.stack([*self.uv(x, y), z], axis=-1)
            own_directions.first_hits(*self.traced, origins, self.gsd_m, ahead, out)
        return out

    def occluded_alone(
        self, rows: ArrayLike, cols: ArrayLike, half: int, direction: ArrayLike
    ) -> Mask:
        """Occlusion by a patch alone, for n patches of (2 half + 1)^2 nodes around (rows, cols),
        bool (n, size, size).
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

    def shadowed_from_outside(
        self,
        dark: NDArray[np.uint8],
        planes: NDArray[np.float32],
        window: Window,
        centres: tuple[ArrayLike, ArrayLike],
        half: int,
        directions: Array,
    ) -> Mask:
        """Nodes of patches that only terrain outside the patch keeps dark, bool (k, n, size, size):
        dark, facing the direction, and not occluded by the patch alone.

        ``dark`` (k, rows, cols): 1 where a node of the window is occluded in a direction of
        ``directions`` (k, 3); ``planes`` (3, rows, cols): components of the
        window's normals; ``centres``: rows and columns in the window of n patches of (2 half + 1)^2
        nodes. Nodes outside the window: False.
        """
        rows, cols = (np.ascontiguousarray(one, dtype=np.int64) for one in centres)
        size = 2 * half + 1
        cast = np.zeros((len(directions), rows.size, size, size), dtype=np.bool_)
        if cast.size:
            rays = np.array([self.ray_in_cells(one) for one in directions])
            isolated_patches.shadowed_from_outside(
                self.z_m, planes, dark, (window[0], window[2]), rows, cols, half,
                rays, directions.astype(np.float32), cast,
            )  # fmt: skip
        return cast

    def normals(self, window: Window | None = None) -> NDArray[np.float32]:
        """Unit normals of the window's nodes, float32 (rows, cols, 3) east, north, up; NaN where no
        gradient exists.

        Gradients are central differences, one-sided beside nodata and at the border.
        """
        row0, row1, col0, col1 = self.checked_window(window)
        out = np.empty((row1 - row0, col1 - col0, 3), dtype=np.float32)
        surface.normals(self.z_m, self.gsd_m, row0, col0, out)
        return out

    def _places(self, x_m: ArrayLike, y_m: ArrayLike) -> tuple[tuple[int, ...], Array, Array]:
        """Common shape of ENU x, y, metres, and their `uv`, flat."""
        x, y = (np.asarray(a, dtype=np.float64) for a in np.broadcast_arrays(x_m, y_m))
        return x.shape, *self.uv(x.ravel(), y.ravel())

    def heights_at(self, x_m: ArrayLike, y_m: ArrayLike) -> Array:
        """Height of the triangulated surface at ENU x, y (any shape), metres; NaN off the surface."""
        shape, u, v = self._places(x_m, y_m)
        return np.asarray(surface.heights_at(self.z_m, u, v)).reshape(shape)

    def normals_at(self, x_m: ArrayLike, y_m: ArrayLike) -> Array:
        """Unit normals (..., 3) at ENU x, y: those of the triangle's three nodes, interpolated and
        normalised.
        """
        shape, u, v = self._places(x_m, y_m)
        return np.asarray(surface.normals_at(self.z_m, self.gsd_m, u, v)).reshape(*shape, 3)
