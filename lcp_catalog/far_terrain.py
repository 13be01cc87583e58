"""Terrain beyond an area's own, for its light: nested heightfields around it, each of cells twice as wide.

All levels are of the area's east-north-up frame, whose heights hold the sphere exactly. A level has
no heights where a finer one (or the area's own terrain) lies, but for a seam of one of its cells.
What is asked of it are points of the area; every answer is exact for the levels' triangles.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .accuracy import Accuracy
from .heightfield import Heightfield, Window
from .kernels import far, horizon

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

PLACES = 8
"""Nodes between the places for which a tier below `high` finds the heights of far shadows."""

DOUBT = {"draft": 0.02, "standard": 1.0}
"""How far outside the range of the heights around it, as a share of that, a node is still traced (`kernels.far.shade`).

Under a far ridge of slopes up to 60 deg, whose shadow covers most of a plain, 0.04 and 0.007 % of the nodes were wrong
(tests/test_far_terrain.py); interpolation between the places, without rays, 2 %."""

_TILE = 4  # level of the max pyramid whose blocks say whether a level can matter


@dataclass(frozen=True)
class Footprint:
    """Least and greatest ENU x and y of the places that ask, and their lowest height, metres."""

    x_m: tuple[float, float]
    y_m: tuple[float, float]
    lowest_m: float


@dataclass(frozen=True, eq=False)
class FarTerrain:
    """Levels from the finest to the coarsest; the share of nodes around the area that lack a height,
    and how near to it the nearest of them is, metres.
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
        """Greatest ENU height; -inf where there is none."""
        return max((level.extremes_m[1] for level in self.levels), default=-math.inf)

    @property
    def lowest_m(self) -> float:
        """Least ENU height; inf where there is none."""
        return min((level.extremes_m[0] for level in self.levels), default=math.inf)

    @property
    def span_m(self) -> float:
        """The longest way across all levels."""
        return max((math.hypot(*one.shape) * one.gsd_m for one in self.levels), default=0.0)

    @property
    def cells_m(self) -> tuple[float, float]:
        """Cells of the finest and of the coarsest level."""
        return self.levels[0].gsd_m, self.levels[-1].gsd_m

    def occluded(self, points_m: ArrayLike, direction: ArrayLike) -> Mask:
        """Whether far terrain rises above the rays from points (n, 3) of the area, bool (n,); NaN: False."""
        points = np.asarray(points_m, dtype=np.float64).reshape(-1, 3)
        out = np.zeros(len(points), dtype=np.bool_)
        asking = np.flatnonzero(~np.isnan(points[:, 2]))
        if not asking.size:
            return out
        low, high = points[asking].min(axis=0), points[asking].max(axis=0)
        place = Footprint((low[0], high[0]), (low[1], high[1]), float(low[2]))
        for level in self.towards(place, direction):
            asking = asking[~out[asking]]
            out[asking] = level.occluded_points(points[asking], direction)
        return out

    def shadowed(
        self,
        field: Heightfield,
        direction: Array,
        accuracy: Accuracy,
        window: Window,
        occluded: Mask,
    ) -> None:
        """Also set ``occluded`` (the window's nodes) where far terrain rises above their rays."""
        if accuracy.tier in DOUBT:
            self._shadowed_by_places(field, direction, DOUBT[accuracy.tier], window, occluded)
            return
        rows, cols = np.nonzero(~occluded)
        occluded[rows, cols] = self.occluded(
            _nodes(field, rows + window[0], cols + window[2]), direction
        )

    def matters(self, field: Heightfield, direction: Array, window: Window) -> bool:
        """Whether any level can rise above the rays of a window's nodes."""
        row0, row1, col0, col1 = window
        x = (field.x0_m + col0 * field.gsd_m, field.x0_m + (col1 - 1) * field.gsd_m)
        y = (field.y0_m - (row1 - 1) * field.gsd_m, field.y0_m - row0 * field.gsd_m)
        return bool(self.towards(Footprint(x, y, field.lowest_m(window)), direction))

    def _shadowed_by_places(
        self, field: Heightfield, direction: Array, doubt: float, window: Window, occluded: Mask
    ) -> None:
        row0, row1, col0, col1 = window
        rows = row0 + np.arange(max(2, math.ceil((row1 - row0 - 1) / PLACES) + 1)) * PLACES
        cols = col0 + np.arange(max(2, math.ceil((col1 - col0 - 1) / PLACES) + 1)) * PLACES
        lowest = field.lowest_m(window)
        x, y = field.x0_m + cols * field.gsd_m, field.y0_m - rows * field.gsd_m
        place = Footprint((x[0], x[-1]), (y[-1], y[0]), lowest)
        levels = self.towards(place, direction) if math.isfinite(lowest) else ()
        if not levels:
            return
        xx, yy = (one.ravel() for one in np.meshgrid(x, y))
        heights = np.full((1, xx.size), lowest - 1.0)  # below all nodes: no shadow
        for level in levels:
            du, dv, dz = level.ray_in_cells(direction)
            u, v = (xx - level.x0_m) / level.gsd_m, (level.y0_m - yy) / level.gsd_m
            z, _, pyramid, summit = level.traced
            horizon.shadow_heights(z, pyramid, summit, u, v, du, dv, np.array([dz]), heights)
        marks = occluded.view(np.uint8)
        far.shade(field.z_m, window, PLACES, heights.reshape(len(rows), len(cols)), doubt, marks)
        open_rows, open_cols = np.nonzero(marks == far.OPEN)
        points = _nodes(field, open_rows + row0, open_cols + col0)
        marks[open_rows, open_cols] = self.occluded(points, direction)

    def horizons(self, points_m: Array, planes: Array, gsd_m: float) -> Array:
        """Steepest slopes (n, k) from points (n, 3), in the planes (k, 4) of a raster of ``gsd_m``
        (`Nodes.horizons`): the least asked for where nothing stands higher.
        """
        out = np.repeat(planes[np.newaxis, :, 2], len(points_m), axis=0)
        for level in self.levels:
            scaled = planes * [1.0, 1.0, level.gsd_m / gsd_m, level.gsd_m / gsd_m]
            found = np.empty_like(out)
            u = (points_m[:, 0] - level.x0_m) / level.gsd_m
            v = (level.y0_m - points_m[:, 1]) / level.gsd_m
            horizon.point_horizons(
                *level.traced, u, v, np.ascontiguousarray(points_m[:, 2]), scaled, found
            )
            np.maximum(out, found * (gsd_m / level.gsd_m), out=out)
        return out

    def towards(self, place: Footprint, direction: ArrayLike) -> tuple[Heightfield, ...]:
        """The levels that can rise above a ray in ``direction`` from a place; the others cannot."""
        east, north, up = (float(v) for v in np.asarray(direction, dtype=np.float64))
        level = math.hypot(east, north)
        if level == 0.0:
            return ()
        ahead = (east / level, north / level)
        return tuple(
            one
            for one, tops in zip(self.levels, self._tops, strict=True)
            if tops.reach(place, ahead, up / level) > place.lowest_m
        )

    @cached_property
    def _tops(self) -> tuple[_Tops, ...]:
        return tuple(_Tops.of(level) for level in self.levels)


@dataclass(frozen=True, eq=False)
class _Tops:
    """Highest ground of a level's blocks: ENU x, y of the middles (n,), half a side's diagonal, height (n,)."""

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

    def reach(self, place: Footprint, ahead: tuple[float, float], tangent: float) -> float:
        """No shadow of parallel rays with a tangent reaches higher over the place; -inf without any."""
        corners = np.array([(x, y) for x in place.x_m for y in place.y_m])
        along, across = corners @ ahead, corners @ (ahead[1], -ahead[0])
        forward = self.x_m * ahead[0] + self.y_m * ahead[1]
        aside = self.x_m * ahead[1] - self.y_m * ahead[0]
        near = (aside >= across.min() - self.half_m) & (aside <= across.max() + self.half_m)
        near &= forward + self.half_m > along.min()
        nearest = np.maximum(forward - self.half_m - along.max(), 0.0)
        farthest = forward + self.half_m - along.min()
        climb = tangent * (nearest if tangent >= 0.0 else farthest)
        return float(np.max((self.top_m - climb)[near], initial=-math.inf))


def _nodes(field: Heightfield, rows: NDArray[np.int64], cols: NDArray[np.int64]) -> Array:
    """ENU positions (n, 3) of a field's nodes."""
    x, y = field.x0_m + cols * field.gsd_m, field.y0_m - rows * field.gsd_m
    return np.stack([x, y, field.z_m[rows, cols].astype(np.float64)], axis=-1)
