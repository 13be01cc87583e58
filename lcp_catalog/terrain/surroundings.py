"""An area with the terrain that can shadow it: cells of the area's size near by, nested coarser
ones beyond (`far_terrain`).

Terrain within `NEAR_NODES` of the area has the area's cell size. Beyond, the cells of each level
are twice as wide as those of the level before, and it extends twice as far, so that a cell is never
wider than `CELL_SHARE` of its distance from the area: the detail that a cell smooths away then
subtends the same small angle of the horizon at any distance (`HORIZON_RMS_DEG`). The outermost
level is the last one with terrain that can rise above the lowest ray.

All this is read only where rays go (`SunRays`): a low Sun is in the east or west outside the polar
regions, and the terrain to the north and south of an area cannot shadow it then.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..arrays import AnyArray, Array
from ..constants import HIGHEST_M, LOWEST_M, MOON_RADIUS_M
from .area import NodeWindow
from .far_terrain import FarTerrain
from .heightfield import Heightfield
from .relief_bounds import COARSE_NODES, COARSE_SLOPE, ring_needed_m
from .terrain import Ground, Terrain, build_terrain

NEAR_NODES = 128
"""Greatest width, in nodes, of the ring of the area's cell size; coarser levels follow it."""

CELL_SHARE = 2.0 / NEAR_NODES
"""Greatest width of a far cell, as a share of its distance from the area."""

HORIZON_RMS_DEG = 0.02
"""Error of the horizon's elevation due to far cells, rms over places and azimuths of lunar relief;
measured against horizons of the area's cell size at all distances."""

REACH_MAX_M = 400e3
"""Greatest distance from an area at which terrain is used: with the Sun on the horizon, the highest
terrain of the Moon (10.8 km) shadows the lowest (-9.1 km) from 263 km away."""


@dataclass(frozen=True, eq=False)
class SunRays:
    """Rays towards the Sun from an area: their ``tangents`` of elevation (n,), and how far they get
    to the ``north, south, west, east`` (n, 4) as a share of the larger one of their two distances.
    """

    tangents: Array
    shares: Array

    @classmethod
    def all_around(cls, tangent: float) -> SunRays:
        """Rays of all azimuths that climb with a tangent (inf: straight up)."""
        return cls(np.array([tangent]), np.ones((1, 4)))

    @classmethod
    def towards(cls, directions: AnyArray, spread_rad: float = 0.0) -> SunRays:
        """Rays of ENU directions (n, 3) that are turned by up to ``spread_rad`` in azimuth."""
        east, north, up = np.asarray(directions, np.float64).reshape(-1, 3).T
        sides = np.array([0.0, math.pi, -0.5 * math.pi, 0.5 * math.pi])
        turn = np.arctan2(east, north)[:, None] - sides
        off = np.maximum(np.abs(np.arctan2(np.sin(turn), np.cos(turn))) - spread_rad, 0.0)
        shares = np.minimum(np.maximum(np.cos(off), 0.0) / np.maximum(np.sin(off), 1e-9), 1.0)
        level = np.hypot(east, north)
        return cls(np.where(level > 0.0, up / np.maximum(level, 1e-9), math.inf), shares)

    @property
    def lowest(self) -> float:
        """Least tangent; inf without rays."""
        return float(self.tangents.min(initial=math.inf))

    def sides_m(self, reach_m: AnyArray, cell_m: float) -> Array:
        """How far rays that matter up to the distances ``reach_m`` (n,) get to the four sides, and two
        cells more where that is less than the distance, for the cells that they meet there; (4,).
        """
        reach = np.asarray(reach_m)[:, None]
        sides = np.minimum(self.shares * reach + 2.0 * cell_m, reach)
        return np.asarray(np.where(self.shares < 1.0, sides, reach).max(axis=0, initial=0.0))


@dataclass(frozen=True, eq=False)
class Surroundings:
    """Width of the terrain of the area's cell size around it to the north, south, west and east, the
    terrain beyond (None: it cannot shadow the area), and the distance up to which terrain can shadow
    the area, metres.
    """

    sides_m: Array
    far: FarTerrain | None
    needed_m: float

    @property
    def ring_m(self) -> float:
        """Distance up to which rays are among cells of the area's size."""
        return float(self.sides_m.max())


def surroundings(
    ground: Ground,
    rays: SunRays,
    least_ring_m: float = 0.0,
    limit_m: float = REACH_MAX_M,
) -> Surroundings:
    """Terrain that can shadow the ground under rays.

    The ring of the area's cell size is at least ``least_ring_m`` wide. No terrain further than
    ``limit_m`` from the ground is used.
    """
    gsd_m = ground.gsd_m
    near_m = max(NEAR_NODES * gsd_m, least_ring_m)
    own = Extent.of(ground.window, gsd_m)
    sights_m = [min(limit_m, _sight_m(tangent, own.turn_rad)) for tangent in rays.tangents]
    reach_m = max(sights_m, default=0.0)
    coarse = _coarse(ground, min(near_m, reach_m))
    needed_m = np.array([_needed_m(coarse, tangent) for tangent in rays.tangents])
    sides_m = rays.sides_m(np.minimum(needed_m, min(near_m, limit_m)), gsd_m)
    sides_m = np.maximum(sides_m, least_ring_m)
    if reach_m > near_m:
        found = _levels(ground, near_m, _floor_m(coarse), rays, np.array(sights_m))
        if found is not None:
            far, farthest_m = found
            return Surroundings(sides_m, far, farthest_m)
    return Surroundings(sides_m, None, float(needed_m.max(initial=0.0)))


def ring_for_rays_m(ground: Ground, tangent: float, limit_m: float) -> float:
    """Greatest distance from a ground, metres, at which terrain can rise above rays that climb from
    it with a tangent; at most ``limit_m``.
    """
    if not math.isfinite(tangent):
        return 0.0
    reach_m = min(limit_m, _sight_m(tangent, Extent.of(ground.window, ground.gsd_m).turn_rad))
    return min(_needed_m(_coarse(ground, reach_m), tangent), limit_m)


def most_nodes(
    window: NodeWindow, gsd_m: float, light_tangent: float, view_tangent: float, limit_m: float
) -> int:
    """Greatest number of nodes that the terrain of a window can have, with that around it up to
    ``limit_m``, under light and views that climb with at least a tangent (inf: straight up).
    """
    own = Extent.of(window, gsd_m)
    near_m = max(NEAR_NODES * gsd_m, min(limit_m, _sight_m(view_tangent, own.turn_rad)))
    reach_m = min(limit_m, _sight_m(light_tangent, own.turn_rad))
    spans_m, count = (own.x1 - own.x0, own.y1 - own.y0), 0
    cell_m, outer_m = gsd_m, near_m
    while not count or outer_m < 2.0 * reach_m:
        count += math.prod(
            math.ceil((span + 2.0 * min(outer_m, max(reach_m, near_m))) / cell_m) + 2
            for span in spans_m
        )
        cell_m, outer_m = 2.0 * cell_m, 2.0 * outer_m
    return count


def build_surrounded(ground: Ground, found: Surroundings) -> Terrain:
    """The terrain of a ground with its ring, at least one node wide (for the normals at the
    window's border), and the far terrain.
    """
    terrain = ground.terrain(np.maximum(found.sides_m, ground.gsd_m))
    return replace(terrain, far=found.far)


def _sight_m(tangent: float, turn_rad: float) -> float:
    """Distance, metres, beyond which no terrain of the Moon rises above a ray from any other
    terrain that climbs with a tangent; verticals are tilted from the frame's by up to ``turn_rad``.

    A ray from the lowest terrain, at radius a and elevation e, reaches the radius b of the highest
    after sqrt(b^2 - a^2 cos^2 e) - a sin e, and is above all terrain from there on.
    """
    if not math.isfinite(tangent):
        return 0.0
    elevation = max(math.atan(tangent) - turn_rad, -math.pi / 2)
    a, b = MOON_RADIUS_M + LOWEST_M, MOON_RADIUS_M + HIGHEST_M
    return math.sqrt(b * b - (a * math.cos(elevation)) ** 2) - a * math.sin(elevation)


def _coarse(ground: Ground, ring_m: float) -> Terrain:
    """The ground and a ring around it on coarse nodes."""
    window = ground.window
    spans = (window.row0, window.row1 - 1, window.col0, window.col1 - 1)
    row0, row1, col0, col1 = (span / COARSE_NODES for span in spans)
    inside = NodeWindow(
        math.floor(row0), math.ceil(row1) + 1, math.floor(col0), math.ceil(col1) + 1
    )
    return replace(ground, window=inside, gsd_m=COARSE_NODES * ground.gsd_m).terrain(ring_m)


def _needed_m(terrain: Terrain, tangent: float) -> float:
    """`relief_bounds.ring_needed_m` of a coarse terrain; 0 for a tangent of inf (straight up)."""
    if not math.isfinite(tangent):
        return 0.0
    return ring_needed_m(terrain, tangent, COARSE_SLOPE * terrain.field.gsd_m)


def _floor_m(coarse: Terrain) -> float:
    """Lower bound of the heights of the core's nodes; inf without any height."""
    row0, row1, col0, col1 = coarse.core
    inside = coarse.field.z_m[row0:row1, col0:col1]
    known = bool(np.isfinite(inside).any())
    return float(np.nanmin(inside)) - COARSE_SLOPE * coarse.field.gsd_m if known else math.inf


def _levels(
    ground: Ground, near_m: float, floor_m: float, rays: SunRays, sights_m: Array
) -> tuple[FarTerrain, float] | None:
    """The levels up to the last one that can shadow the area, and the distance up to which it can;
    None if no level can. ``sights_m``: greatest distances at which terrain can rise above the rays.
    """
    own = Extent.of(ground.window, ground.gsd_m)
    hole, cell_m, outer_m = own.grown(np.full(4, near_m)), 2.0 * ground.gsd_m, 2.0 * near_m
    reach_m = float(sights_m.max())
    levels: list[Heightfield] = []
    gaps: list[Gaps] = []
    farthest_m, last = 0.0, 0
    while math.isfinite(floor_m):
        sides_m = rays.sides_m(np.minimum(sights_m, outer_m), cell_m)
        level, gap = _level(ground, own.grown(sides_m), cell_m, hole)
        levels.append(level)
        gaps.append(gap)
        needed_m = _farthest_m(level, own, floor_m, rays.lowest)
        if needed_m > 0.0:
            farthest_m, last = needed_m, len(levels)
        if outer_m >= reach_m:
            break
        hole = Extent.of_field(level).hull(own.grown(np.full(4, outer_m)))
        cell_m, outer_m = 2.0 * cell_m, 2.0 * outer_m
    if not last:
        return None
    # over all levels that were read: one without heights may hide terrain that shadows the area
    missing = sum(gap.missing * level.z_m.size for gap, level in zip(gaps, levels, strict=True))
    everything = sum(level.z_m.size for level in levels)
    nearest_m = min(gap.gap_m for gap in gaps)
    return FarTerrain(tuple(levels[:last]), missing / everything, nearest_m), farthest_m


@dataclass(frozen=True)
class Extent:
    """Least and greatest ENU x and y, metres."""

    x0: float
    x1: float
    y0: float
    y1: float

    @classmethod
    def of(cls, window: NodeWindow, gsd_m: float) -> Extent:
        return cls(
            window.col0 * gsd_m,
            (window.col1 - 1) * gsd_m,
            -(window.row1 - 1) * gsd_m,
            -window.row0 * gsd_m,
        )

    @classmethod
    def of_field(cls, field: Heightfield) -> Extent:
        rows, cols = field.shape
        return cls(
            field.x0_m,
            field.x0_m + (cols - 1) * field.gsd_m,
            field.y0_m - (rows - 1) * field.gsd_m,
            field.y0_m,
        )

    def hull(self, other: Extent) -> Extent:
        """The least extent that holds both."""
        x0, y0 = min(self.x0, other.x0), min(self.y0, other.y0)
        return Extent(x0, max(self.x1, other.x1), y0, max(self.y1, other.y1))

    @property
    def turn_rad(self) -> float:
        """Greatest angle between a vertical inside and that of the frame."""
        farthest_m = math.hypot(max(-self.x0, self.x1), max(-self.y0, self.y1))
        return math.asin(min(1.0, farthest_m / (MOON_RADIUS_M + LOWEST_M)))

    def grown(self, sides_m: Array) -> Extent:
        """The extent with so much more to the north, south, west and east (4,)."""
        north, south, west, east = sides_m.tolist()
        return Extent(self.x0 - west, self.x1 + east, self.y0 - south, self.y1 + north)


class Gaps(NamedTuple):
    """Share of a level's nodes without a height, and the distance of the nearest of them from the
    area, metres (inf: none).
    """

    missing: float
    gap_m: float


def _level(ground: Ground, box: Extent, cell_m: float, hole: Extent) -> tuple[Heightfield, Gaps]:
    """A level over a box, without the nodes that lie more than a cell inside the hole."""
    far_dems = ground.dems.for_cells(cell_m)
    window = NodeWindow.covering((box.x0, box.x1, box.y0, box.y1), cell_m)
    x = np.arange(window.col0, window.col1) * cell_m
    y = -np.arange(window.row0, window.row1) * cell_m
    top, bottom = _span(y, hole.y0 + cell_m, hole.y1 - cell_m)
    left, right = _span(x, hole.x0 + cell_m, hole.x1 - cell_m)
    rows, cols = window.shape
    z = np.full((rows, cols), np.nan, dtype=np.float32)
    for r0, r1, c0, c1 in (
        (0, top, 0, cols),
        (bottom, rows, 0, cols),
        (top, bottom, 0, left),
        (top, bottom, right, cols),
    ):
        if r0 < r1 and c0 < c1:
            part = NodeWindow(
                window.row0 + r0, window.row0 + r1, window.col0 + c0, window.col0 + c1
            )
            z[r0:r1, c0:c1] = build_terrain(far_dems, ground.frame, part, cell_m).field.z_m
    level = Heightfield(z, cell_m, float(x[0]), float(y[0]))
    gaps = ~np.isfinite(z)
    gaps[top:bottom, left:right] = False
    away = np.where(
        gaps, np.maximum(*_off(level, Extent.of(ground.window, ground.gsd_m))), math.inf
    )
    return level, Gaps(float(gaps.mean()), max(0.0, float(away.min()) - cell_m))


def _off(field: Heightfield, own: Extent) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """East-west (1, cols) and north-south (rows, 1) distance of nodes from a box, metres."""
    x = field.x0_m + np.arange(field.shape[1]) * field.gsd_m
    y = field.y0_m - np.arange(field.shape[0]) * field.gsd_m
    dx = np.maximum(np.maximum(own.x0 - x, x - own.x1), 0.0)[np.newaxis, :]
    dy = np.maximum(np.maximum(own.y0 - y, y - own.y1), 0.0)[:, np.newaxis]
    return dx, dy


def _span(values: NDArray[np.floating], low: float, high: float) -> tuple[int, int]:
    """First index, and index behind the last, of monotone values within low..high; the middle index
    twice if there are none.
    """
    inside = np.flatnonzero((values >= low) & (values <= high))
    middle = values.size // 2
    return (int(inside[0]), int(inside[-1]) + 1) if inside.size else (middle, middle)


def _farthest_m(level: Heightfield, own: Extent, floor_m: float, tangent: float) -> float:
    """Greatest distance from the area, metres, at which a level can rise above rays from it; 0 for
    none.
    """
    dx, dy = _off(level, own)
    climb = np.maximum(np.hypot(dx, dy) - level.gsd_m, 0.0) * tangent
    margin_m = COARSE_SLOPE * level.gsd_m
    matters = level.z_m + margin_m - floor_m > climb  # False for NaN
    return float(np.maximum(dx, dy)[matters].max(initial=0.0))
