"""Terrain around an area that can shadow it: nested heightfields (levels), each with cells twice as
wide as the one before.

All levels are in the area's east-north-up frame, whose heights include the curvature of the sphere
exactly. A level has no heights where a finer one (or the area's own terrain) lies, except for a
seam of one of its cells. Occlusion of points of the area is exact for the triangles of the levels.

Horizons of observers on a heightfield.

A plane is (du, dv, low, high): direction in cell units with max(|du|, |dv|) = 1, and the slopes, in
metres per unit of this direction, between which the horizon is searched for
(`kernels.rays.horizon`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..accuracy import Accuracy
from ..arrays import Array, Mask
from ..kernels.rays import horizon
from ..kernels.shadows import far_terrain
from .heightfield import Heightfield, Window


@dataclass(frozen=True, eq=False)
class Nodes:
    """Nodes (rows, cols) of a field, each int64 (n,), and the terrain beyond the field."""

    field: Heightfield
    rows: NDArray[np.int64]
    cols: NDArray[np.int64]
    far: FarTerrain | None = None

    def __len__(self) -> int:
        return self.rows.size

    def __getitem__(self, which: slice | NDArray[np.intp]) -> Nodes:
        return Nodes(self.field, self.rows[which], self.cols[which], self.far)

    @property
    def points_m(self) -> Array:
        """ENU positions (n, 3)."""
        return self.field.nodes_m(self.rows, self.cols)

    def horizons(self, planes: Array) -> Array:
        """Steepest slope in each plane (k, 4), clipped to low..high, float64 (n, k); low at nodata
        and where there is no terrain ahead.
        """
        out = np.empty((len(self), len(planes)))
        horizon.node_horizons(*self.field.traced, self.rows, self.cols, planes, out)
        return _with_far(self, planes, out)

    def occluded(self, direction: Array) -> NDArray[np.bool_]:
        """True where the surface rises above the ray in ``direction`` (3,), bool (n,)."""
        return _occluded(self, direction)


@dataclass(frozen=True, eq=False)
class HorizonPoints:
    """ENU points (n, 3) on or above a field, metres, and the terrain beyond the field; points
    within 1 mm of the surface are moved onto it.
    """

    field: Heightfield
    points_m: Array
    far: FarTerrain | None = None

    def __len__(self) -> int:
        return len(self.points_m)

    def __getitem__(self, which: slice | NDArray[np.intp]) -> HorizonPoints:
        return HorizonPoints(self.field, self.points_m[which], self.far)

    def horizons(self, planes: Array) -> Array:
        """As `Nodes.horizons`; low for NaN and off the raster, high under the surface."""
        out = np.empty((len(self), len(planes)))
        x, y, z = self.points_m.T
        u, v = self.field.uv(x, y)
        horizon.point_horizons(*self.field.traced, u, v, np.ascontiguousarray(z), planes, out)
        return _with_far(self, planes, out)

    def occluded(self, direction: Array) -> NDArray[np.bool_]:
        """As `Nodes.occluded`."""
        return _occluded(self, direction)


def _with_far(observers: Nodes | HorizonPoints, planes: Array, own: Array) -> Array:
    """The higher of a field's own horizons and those of the far terrain."""
    if observers.far is None or not len(observers):
        return own
    found = observers.far.horizons(observers.points_m, planes, observers.field.gsd_m)
    return np.maximum(own, found, out=own)


def _occluded(observers: Nodes | HorizonPoints, direction: Array) -> NDArray[np.bool_]:
    points = observers.points_m
    out = observers.field.occluded_points(points, direction)
    if observers.far is not None:
        out[~out] = observers.far.occluded(points[~out], direction)
    return out


def on_rim(field: Heightfield, window: Window) -> NDArray[np.bool_]:
    """True for nodes of the window beside nodata or the raster's border, where a horizon may be
    discontinuous in azimuth; bool (rows, cols).
    """
    row0, row1, col0, col1 = window
    out = np.zeros((row1 - row0, col1 - col0), dtype=np.bool_)
    if field.has_holes:
        horizon.rim_nodes(field.z_m, window, out)
    else:
        last_row, last_col = field.shape[0] - 1, field.shape[1] - 1
        out[[i - row0 for i in (0, last_row) if row0 <= i < row1]] = True
        out[:, [j - col0 for j in (0, last_col) if col0 <= j < col1]] = True
    return out


PLACES = 8
"""Nodes between the lattice places at which tiers below `high` compute the heights of far shadows.
"""

_BLOCK, _BLOCKS = 64, 16
"""Least number of nodes along a block of a window; greatest number of blocks along a window."""

_TILE = 4  # level of the max pyramid whose blocks bound the shadows of a terrain level


@dataclass(frozen=True)
class Footprint:
    """Least and greatest ENU x and y of the places to be shadowed, and their lowest height, metres;
    or arrays of these, one element for each group of places.
    """

    x_m: tuple[Any, Any]
    y_m: tuple[Any, Any]
    lowest_m: Any


@dataclass(frozen=True, eq=False)
class FarTerrain:
    """Levels from the finest to the coarsest; the share of nodes around the area without a height,
    and the distance of the nearest of them from the area, metres.
    """

    levels: tuple[Heightfield, ...]
    missing: float = 0.0
    gap_m: float = math.inf

    @property
    def steepest_tangent(self) -> float:
        """Tangent of the steepest facet of all levels."""
        return max((level.steepest_tangent for level in self.levels), default=0.0)

    @property
    def highest_m(self) -> float:
        """Greatest ENU height; -inf without any."""
        return max((level.extremes_m[1] for level in self.levels), default=-math.inf)

    @property
    def span_m(self) -> float:
        """Longest diagonal of all levels, metres."""
        return max((math.hypot(*one.shape) * one.gsd_m for one in self.levels), default=0.0)

    @property
    def cells_m(self) -> tuple[float, float]:
        """Cell sizes of the finest and of the coarsest level."""
        return self.levels[0].gsd_m, self.levels[-1].gsd_m

    def occluded(self, points_m: ArrayLike, direction: ArrayLike) -> Mask:
        """True where far terrain rises above the ray from a point (n, 3) of the area, bool (n,);
        NaN: False.
        """
        points = np.asarray(points_m, dtype=np.float64).reshape(-1, 3)
        out = np.zeros(len(points), dtype=np.bool_)
        remaining = np.flatnonzero(~np.isnan(points[:, 2]))
        if not remaining.size:
            return out
        low, high = points[remaining].min(axis=0), points[remaining].max(axis=0)
        place = Footprint((low[0], high[0]), (low[1], high[1]), float(low[2]))
        for level in self.towards(place, direction):
            remaining = remaining[~out[remaining]]
            out[remaining] = level.occluded_points(points[remaining], direction)
        return out

    def shadowed(
        self,
        field: Heightfield,
        direction: Array,
        accuracy: Accuracy,
        window: Window,
        occluded: Mask,
    ) -> None:
        """Set ``occluded`` (the window's nodes) where far terrain rises above their rays, too."""
        if occluded.size == 0 or not self.matters(field, direction, window):
            return
        blocks = _Blocks(field, window, occluded)
        reaching = self._reaching(blocks, direction)
        if accuracy.far_doubt is None:
            for level, which in reaching:
                rows, cols = np.nonzero(~occluded & blocks.spread(which))
                points = field.nodes_m(rows + window[0], cols + window[2])
                occluded[rows, cols] = level.occluded_points(points, direction)
        elif reaching:
            self._shadowed_by_places(blocks, reaching, direction, accuracy.far_doubt, occluded)

    def _reaching(self, blocks: _Blocks, direction: Array) -> list[tuple[Heightfield, Mask]]:
        """The levels that can rise above rays from some block, each with the mask of these blocks."""
        level_m = math.hypot(direction[0], direction[1])
        ahead = (direction[0] / level_m, direction[1] / level_m)
        found = []
        for level, tops in zip(self.levels, self._tops, strict=True):
            higher = tops.that_reach(blocks.whole, ahead, direction[2] / level_m)
            high = higher.reach(blocks.footprint, ahead, direction[2] / level_m)
            which = (high > blocks.footprint.lowest_m).reshape(blocks.shape)
            if which.any():
                found.append((level, which))
        return found

    def matters(self, field: Heightfield, direction: Array, window: Window) -> bool:
        """True if any level can rise above the rays of a window's nodes."""
        row0, row1, col0, col1 = window
        x = (field.x0_m + col0 * field.gsd_m, field.x0_m + (col1 - 1) * field.gsd_m)
        y = (field.y0_m - (row1 - 1) * field.gsd_m, field.y0_m - row0 * field.gsd_m)
        return bool(self.towards(Footprint(x, y, field.lowest_m(window)), direction))

    def _shadowed_by_places(
        self,
        blocks: _Blocks,
        reaching: list[tuple[Heightfield, Mask]],
        direction: Array,
        doubt: float,
        occluded: Mask,
    ) -> None:
        field, (row0, _, col0, _) = blocks.field, blocks.window
        rows, cols = blocks.places
        x = field.x0_m + (col0 + cols) * field.gsd_m
        y = field.y0_m - (row0 + rows) * field.gsd_m
        # below all nodes: no shadow
        heights = np.full((rows.size, cols.size), blocks.footprint.lowest_m.min() - 1.0)
        for level, which in reaching:
            some = blocks.at_places(which)
            i, j = np.nonzero(some)
            du, dv, dz = level.ray_in_cells(direction)
            u, v = level.uv(x[j], y[i])
            z, _, pyramid, summit = level.traced
            raised = heights[some][np.newaxis]
            horizon.shadow_heights(z, pyramid, summit, u, v, du, dv, np.array([dz]), raised)
            heights[some] = raised[0]
        marks = occluded.view(np.uint8)
        far_terrain.shade(field.z_m, blocks.window, PLACES, heights, doubt, marks)
        open_rows, open_cols = np.nonzero(marks == far_terrain.OPEN)
        points = field.nodes_m(open_rows + row0, open_cols + col0)
        marks[open_rows, open_cols] = self.occluded(points, direction)

    def horizons(self, points_m: Array, planes: Array, gsd_m: float) -> Array:
        """Steepest slopes (n, k) from points (n, 3), in the planes (k, 4) of a raster of ``gsd_m``
        (`Nodes.horizons`): the plane's lower limit where no terrain is steeper.
        """
        out = np.repeat(planes[np.newaxis, :, 2], len(points_m), axis=0)
        for level in self.levels:
            scaled = planes * [1.0, 1.0, level.gsd_m / gsd_m, level.gsd_m / gsd_m]
            found = np.empty_like(out)
            u, v = level.uv(points_m[:, 0], points_m[:, 1])
            horizon.point_horizons(
                *level.traced, u, v, np.ascontiguousarray(points_m[:, 2]), scaled, found
            )
            np.maximum(out, found * (gsd_m / level.gsd_m), out=out)
        return out

    def towards(self, place: Footprint, direction: ArrayLike) -> tuple[Heightfield, ...]:
        """The levels that can rise above a ray in ``direction`` from a place."""
        east, north, up = (float(v) for v in np.asarray(direction, dtype=np.float64))
        level = math.hypot(east, north)
        if level == 0.0:
            return ()
        ahead = (east / level, north / level)
        return tuple(
            one
            for one, tops in zip(self.levels, self._tops, strict=True)
            if tops.reach(place, ahead, up / level)[0] > place.lowest_m
        )

    @cached_property
    def _tops(self) -> tuple[_Tops, ...]:
        return tuple(_Tops.of(level) for level in self.levels)


@dataclass(frozen=True, eq=False)
class _Tops:
    """Highest points of a level's blocks: ENU x, y of the middles (n,), half a block's diagonal,
    height (n,).
    """

    x_m: Array
    y_m: Array
    half_m: float
    top_m: Array

    @classmethod
    def of(cls, level: Heightfield) -> _Tops:
        _, _, (values, offsets, widths, heights), _ = level.traced
        at = min(_TILE, widths.size - 1)
        if at == 0:
            side, tops = max(level.shape) - 1, np.array([level.extremes_m[1]])
            rows = cols = np.zeros(1)
        else:
            side, count = 1 << at, int(heights[at] * widths[at])
            tops = values[offsets[at] : offsets[at] + count].astype(np.float64)
            rows, cols = np.divmod(np.arange(count), widths[at])
        there = np.isfinite(tops)
        x = level.x0_m + (cols[there] + 0.5) * side * level.gsd_m
        y = level.y0_m - (rows[there] + 0.5) * side * level.gsd_m
        return cls(x, y, side * level.gsd_m * math.sqrt(0.5), tops[there])

    def reach(self, place: Footprint, ahead: tuple[float, float], tangent: float) -> Array:
        """Upper bound of the height of shadows over the place, for parallel rays of a tangent; -inf
        without any shadow; (g,) for g groups of places.
        """
        return np.asarray(self._heights(place, ahead, tangent).max(axis=1, initial=-math.inf))

    def that_reach(self, place: Footprint, ahead: tuple[float, float], tangent: float) -> _Tops:
        """The blocks whose shadows reach above the lowest height of the places."""
        some = self._heights(place, ahead, tangent)[0] > place.lowest_m
        return _Tops(self.x_m[some], self.y_m[some], self.half_m, self.top_m[some])

    def _heights(self, place: Footprint, ahead: tuple[float, float], tangent: float) -> Array:
        """Upper bound of the height of each block's shadow over each group of places, (groups,
        blocks).
        """
        x, y = (np.stack(np.atleast_1d(*side)) for side in (place.x_m, place.y_m))
        corners = [(east, north) for east in x for north in y]
        along = np.stack([east * ahead[0] + north * ahead[1] for east, north in corners])
        across = np.stack([east * ahead[1] - north * ahead[0] for east, north in corners])
        forward = self.x_m * ahead[0] + self.y_m * ahead[1]
        aside = self.x_m * ahead[1] - self.y_m * ahead[0]
        left, right = across.min(axis=0)[:, None], across.max(axis=0)[:, None]
        back, front = along.min(axis=0)[:, None], along.max(axis=0)[:, None]
        near = (aside >= left - self.half_m) & (aside <= right + self.half_m)
        near &= forward + self.half_m > back
        if tangent >= 0.0:
            climb = tangent * np.maximum(forward - self.half_m - front, 0.0)
        else:
            climb = tangent * (forward + self.half_m - back)
        return np.where(near, self.top_m - climb, -math.inf)


class _Blocks:
    """Square blocks of a window's nodes, and the lattice of places over them; blocks that far
    terrain cannot shadow are skipped.
    """

    def __init__(self, field: Heightfield, window: Window, occluded: Mask) -> None:
        self.field, self.window = field, window
        row0, row1, col0, col1 = window
        longest = max(row1 - row0, col1 - col0)
        self.side = PLACES * max(_BLOCK // PLACES, math.ceil(longest / (_BLOCKS * PLACES)))
        top, left = np.arange(0, row1 - row0, self.side), np.arange(0, col1 - col0, self.side)
        self.shape = top.size, left.size
        z = np.where(occluded, np.float32(np.inf), field.z_m[row0:row1, col0:col1])
        z = np.fmin.reduceat(np.fmin.reduceat(z, top, axis=0), left, axis=1)
        bottom = np.minimum(top + self.side, row1 - row0) - 1
        right = np.minimum(left + self.side, col1 - col0) - 1
        x = [field.x0_m + (col0 + c) * field.gsd_m for c in (left, right)]
        y = [field.y0_m - (row0 + r) * field.gsd_m for r in (bottom, top)]
        lowest = np.where(np.isnan(z), np.inf, z).astype(np.float64)
        self.footprint = Footprint(
            (np.tile(x[0], top.size), np.tile(x[1], top.size)),
            (np.repeat(y[0], left.size), np.repeat(y[1], left.size)),
            lowest.ravel(),
        )

    @property
    def whole(self) -> Footprint:
        """The footprint of all blocks."""
        (west, east), (south, north) = self.footprint.x_m, self.footprint.y_m
        lowest = float(self.footprint.lowest_m.min())
        return Footprint((west.min(), east.max()), (south.min(), north.max()), lowest)

    def spread(self, which: Mask) -> Mask:
        """The mask of nodes that corresponds to a mask of blocks."""
        rows, cols = self._counts
        wide = np.repeat(np.repeat(which, self.side, axis=0), self.side, axis=1)
        return wide[:rows, :cols]

    @property
    def places(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Rows and columns of the places, counted from the window's first node; they enclose the
        window.
        """
        rows, cols = (max(2, -(-(count - 1) // PLACES) + 1) for count in self._counts)
        return np.arange(rows) * PLACES, np.arange(cols) * PLACES

    @property
    def _counts(self) -> tuple[int, int]:
        """Numbers of rows and columns of the window."""
        row0, row1, col0, col1 = self.window
        return row1 - row0, col1 - col0

    def at_places(self, which: Mask) -> Mask:
        """Mask of the places around the nodes of some blocks: one place before each block, and up
        to the last place of the window, which lies beyond its nodes.
        """
        spans = []
        for first, count in zip(self.places, self._counts, strict=True):
            before = np.maximum(first - PLACES, 0) // self.side
            spans.append((before, np.minimum(first + 2 * PLACES - 1, count - 1) // self.side))
        ways = [which[np.ix_(i, j)] for i in spans[0] for j in spans[1]]
        return np.asarray(np.logical_or.reduce(ways))
