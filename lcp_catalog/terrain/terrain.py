"""An area of the Moon as a heightfield in the east-north-up frame of its centre.

The surface point over a node (x, y) of the tangent plane is where the vertical line of the frame
meets the ground:
``|origin + x e + y n + z u| = R + h(lon, lat)``. It is found by fixed-point iteration on h, whose
error falls by the slope of
the ground times the tangent of the angle between node and origin seen from the Moon's centre with
every step (0.02 a step,
100 km away on a 20 degree slope); it stops for each node on its own, so that a node's height never
depends on the window.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array, Int16
from ..constants import MOON_RADIUS_M
from ..dem.mosaic import DemSet
from ..errors import AreaError
from ..geometry.frames import EnuFrame
from ..kernels.resampling import heights as resample
from .area import Area, NodeWindow, require_place
from .far_terrain import FarTerrain
from .heightfield import Heightfield, Window

_TOLERANCE_M = 1e-3
_ITERATIONS = 40
_LIMB = 0.985
"""Nodes further out than this share of the radius (80 deg from the centre) see the ground edge-on
and get no height.
"""
_BLOCK_NODES = 2_000_000
_NODES_MAX = 400_000_000


@dataclass(frozen=True, eq=False)
class Terrain:
    """A heightfield with its frame, the window of the area inside it (rows and columns of the
    field), where it came from, and what else can shadow it from further away.
    """

    field: Heightfield
    frame: EnuFrame
    core: Window
    window: NodeWindow  # of the whole field
    product_index: Int16  # (rows, cols): which of ``products`` gave the height, -1 none
    products: tuple[str, ...]
    far: FarTerrain | None = None


@dataclass(frozen=True, eq=False)
class Patch:
    """A square fragment in the frame of its own centre node, whose origin lies on the ground: that
    node's z is 0.
    """

    z_m: NDArray[np.float32]
    frame: EnuFrame
    product: int
    """Index of the DEM that gave the centre's height."""


def build_terrain(
    dems: DemSet, frame: EnuFrame, window: NodeWindow, gsd_m: float, ring_m: float = 0.0
) -> Terrain:
    """The heightfield of a window of the frame's nodes (the core) and of a ring of at least
    ``ring_m`` around it.

    Nodes without a height are NaN, and so are those from 80 degrees away from the frame's origin
    on; a terrain without any
    height is no error here. ``AreaError`` when it would have more nodes than memory.
    """
    _require_gsd(gsd_m)
    if not 0.0 <= ring_m < math.inf:
        raise AreaError(f"a ring of {ring_m:g} m is none")
    ring = math.ceil(ring_m / gsd_m - 1e-6)
    whole = window.grown(ring)
    rows, cols = whole.shape
    require_room(whole, ring_m if 10 * ring > min(rows, cols) else 0.0)
    z, index = _heights(dems, frame, whole, gsd_m)
    field = Heightfield(z, gsd_m, whole.col0 * gsd_m, -whole.row0 * gsd_m)
    core = (ring, rows - ring, ring, cols - ring)
    return Terrain(field, frame, core, whole, index, dems.products)


def require_room(window: NodeWindow, ring_m: float = 0.0) -> None:
    """AreaError when a window has more nodes than memory; ``ring_m``: what of its width is not the area's own, if much."""
    rows, cols = window.shape
    if rows * cols > _NODES_MAX:
        around = f" with the {ring_m / 1e3:.1f} km around it that can shadow or hide it"
        raise AreaError(
            f"{rows} x {cols} nodes are too many for one area{around if ring_m else ''} "
            f"(limit {_NODES_MAX:.0e}); take a coarser --gsd"
        )


def terrain_from_area(
    dems: DemSet, area: Area, gsd_m: float | None = None, ring_m: float = 0.0
) -> Terrain:
    """The area in the frame of its centre; the cell is the DEM's own at the centre unless given.

    ``AreaError`` when the area has no height in the DEM.
    """
    gsd_m = native_gsd_m(dems, area) if gsd_m is None else gsd_m
    _require_gsd(gsd_m)
    terrain = build_terrain(
        dems, area.frame, NodeWindow.covering(area.extent_m, gsd_m), gsd_m, ring_m
    )
    row0, row1, col0, col1 = terrain.core
    if not (terrain.product_index[row0:row1, col0:col1] >= 0).any():
        raise AreaError(
            f"the area ({area.bounds}) has no height in the DEM, which covers {dems.bounds}"
        )
    return terrain


def sample_patch(dems: DemSet, lon_deg: float, lat_deg: float, size: int, gsd_m: float) -> Patch:
    """``size`` x ``size`` nodes around a surface point in its own frame, z relative to that point;
    ``size`` is odd.

    ``AreaError`` when the point has no height.
    """
    if size < 1 or size % 2 == 0:
        raise AreaError(f"a patch of {size} nodes has no centre node; its size must be odd")
    require_place(lon_deg, lat_deg)
    _require_gsd(gsd_m)
    height, number = dems.heights(lon_deg, lat_deg, gsd_m)
    if number < 0:
        raise AreaError(
            f"no DEM has a height at longitude {lon_deg:g}, latitude {lat_deg:g}; the DEM "
            f"covers {dems.bounds}"
        )
    frame = EnuFrame(lon_deg, lat_deg, float(height))
    half = size // 2
    z, _ = _heights(dems, frame, NodeWindow(-half, half + 1, -half, half + 1), gsd_m)
    z[half, half] = 0.0  # by definition; the solution says so to a micrometre
    return Patch(z, frame, int(number))


def native_gsd_m(dems: DemSet, area: Area) -> float:
    """The cell of the DEM that answers at the area's centre; where that is a gap, of the one that answers at most places of
    the area. ``AreaError`` without any.
    """
    try:
        return dems.native_gsd_m(area.lon_deg, area.lat_deg)
    except AreaError:
        x0, x1, y0, y1 = area.extent_m
        x, y = np.meshgrid(np.linspace(x0, x1, 33), np.linspace(y0, y1, 33))
        coarsest = max(dem.gsd_m for dem in dems.dems)
        _, index = _solve(dems, area.frame, x.ravel(), y.ravel(), coarsest)
        if not (index >= 0).any():
            raise AreaError(
                f"the area ({area.bounds}) has no height in the DEM, which covers {dems.bounds}"
            ) from None
        return dems.dems[int(np.bincount(index[index >= 0]).argmax())].gsd_m


def _heights(
    dems: DemSet, frame: EnuFrame, window: NodeWindow, gsd_m: float
) -> tuple[NDArray[np.float32], Int16]:
    """ENU z of a window's nodes and the DEM of each, a block of rows after the other."""
    rows, cols = window.shape
    z, index = np.empty((rows, cols), np.float32), np.empty((rows, cols), np.int16)
    x = np.arange(window.col0, window.col1) * gsd_m
    step = max(1, _BLOCK_NODES // cols)
    for row in range(0, rows, step):
        y = -np.arange(window.row0 + row, window.row0 + min(row + step, rows)) * gsd_m
        block = np.s_[row : row + len(y)]
        heights, numbers = _solve(dems, frame, np.tile(x, len(y)), np.repeat(y, cols), gsd_m)
        z[block], index[block] = heights.reshape(-1, cols), numbers.reshape(-1, cols)
    return z, index


def _solve(dems: DemSet, frame: EnuFrame, x: Array, y: Array, gsd_m: float) -> tuple[Array, Int16]:
    """ENU z over nodes (n,), NaN where there is no ground, and the index of each one's DEM."""
    up_m = MOON_RADIUS_M + frame.height_m
    away2 = x * x + y * y
    height = np.full(x.size, frame.height_m)
    height[away2 >= (_LIMB * MOON_RADIUS_M) ** 2] = np.nan
    index = np.full(x.size, -1, np.int16)
    active = np.flatnonzero(np.isfinite(height))
    for _ in range(_ITERATIONS):
        if active.size == 0:
            break
        guess = height[active]
        z = np.sqrt((MOON_RADIUS_M + guess) ** 2 - away2[active]) - up_m
        lon, lat = np.empty(active.size), np.empty(active.size)
        resample.enu_to_lonlat(x[active], y[active], z, frame.rotation, up_m, lon, lat)
        found, numbers = dems.heights(np.degrees(lon), np.degrees(lat), gsd_m)
        height[active], index[active] = found, numbers
        active = active[np.abs(found - guess) >= _TOLERANCE_M]  # NaN is settled: no ground
    height[active], index[active] = (
        np.nan,
        -1,
    )  # never settled: a cliff seen edge-on, far from the centre
    return np.sqrt((MOON_RADIUS_M + height) ** 2 - away2) - up_m, index


def _require_gsd(gsd_m: float) -> None:
    if not 0.0 < gsd_m < math.inf:
        raise AreaError(f"a cell of {gsd_m:g} m is none; --gsd must be positive")
