"""An area of the Moon as a heightfield in the east-north-up frame of its centre.

The surface point over a node (x, y) of the tangent plane is the intersection of the frame's
vertical line with the terrain: ``|origin + x e + y n + z u| = R + h(lon, lat)``. It is found by
iteration on h, with secants after the first step. A step without them multiplies the error by the
slope of the terrain times the tangent of the angle between node and origin seen from the Moon's
centre (0.02 at 100 km on a 20 degree slope). The iteration stops for each node separately, so that
a node's height does not depend on the window.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array, Int16
from ..constants import MOON_RADIUS_M
from ..dem.dem import Dem
from ..dem.mosaic import DemSet
from ..errors import AreaError
from ..geometry.bounds import wrapped_deg
from ..geometry.frames import EnuFrame
from ..kernels.resampling import heights as resample
from .area import Area, NodeWindow, require_place
from .far_terrain import FarTerrain
from .heightfield import Heightfield, Window

_TOLERANCE_M = 1e-3
_ITERATIONS = 40
_LIMB = 0.985
"""Nodes further out than this share of the radius (80 deg from the centre), where the terrain is
seen edge-on, get no height.
"""
_BLOCK_NODES = 200_000
"""Nodes that are solved together, each with some 200 bytes; their heights do not depend on the others."""

_NODES_MAX = 400_000_000


@dataclass(frozen=True, eq=False)
class Terrain:
    """A heightfield with its frame, the area's window in it (``core``: rows and columns of the
    field), the source of each height, and the far terrain that can shadow it.
    """

    field: Heightfield
    frame: EnuFrame
    core: Window
    window: NodeWindow  # of the whole field
    product_index: Int16  # (rows, cols): index into ``products``, -1 without a height
    products: tuple[str, ...]
    far: FarTerrain | None = None


@dataclass(frozen=True, eq=False)
class Patch:
    """Square patch of terrain in the frame of its own centre node, whose origin lies on the
    surface: z is 0 there.
    """

    z_m: NDArray[np.float32]
    frame: EnuFrame
    product: int
    """Index of the DEM that gave the centre's height."""


@dataclass(frozen=True)
class Ground:
    """Where a terrain is made: nodes of a window of a frame, and the DEMs that give their heights."""

    dems: DemSet
    frame: EnuFrame
    window: NodeWindow
    gsd_m: float

    def terrain(self, ring_m: float | Array = 0.0) -> Terrain:
        """`build_terrain` of the window."""
        return build_terrain(self.dems, self.frame, self.window, self.gsd_m, ring_m)


def build_terrain(
    dems: DemSet, frame: EnuFrame, window: NodeWindow, gsd_m: float, ring_m: float | Array = 0.0
) -> Terrain:
    """The heightfield of a window of the frame's nodes (the core) and of a ring of at least
    ``ring_m`` metres around it: one width, or those to the north, south, west and east (4,).

    Nodes without a height are NaN, and so are those 80 degrees or more from the frame's origin. A
    terrain without any height is no error here. ``AreaError`` for too many nodes.
    """
    _require_gsd(gsd_m)
    sides = np.broadcast_to(np.asarray(ring_m, np.float64), 4)
    if not ((sides >= 0.0) & (sides < math.inf)).all():
        raise AreaError(f"invalid width {sides.max():g} m of the ring")
    north, south, west, east = np.ceil(sides / gsd_m - 1e-6).astype(int).tolist()
    whole = window.extended(north, south, west, east)
    rows, cols = whole.shape
    widest = max(north, south, west, east)
    require_room(whole, float(sides.max()) if 10 * widest > min(rows, cols) else 0.0)
    z, index = _heights(dems, frame, whole, gsd_m)
    field = Heightfield(z, gsd_m, whole.col0 * gsd_m, -whole.row0 * gsd_m)
    core = (north, rows - south, west, cols - east)
    return Terrain(field, frame, core, whole, index, dems.products)


def require_room(window: NodeWindow, ring_m: float = 0.0) -> None:
    """AreaError if a window has too many nodes; ``ring_m``: width of the ring around the area, for
    the message (0: not mentioned).
    """
    rows, cols = window.shape
    if rows * cols > _NODES_MAX:
        around = f" with the {ring_m / 1e3:.1f} km around it that can shadow or hide it"
        raise AreaError(
            f"{rows} x {cols} nodes are too many for one area{around if ring_m else ''} "
            f"(limit {_NODES_MAX:.0e}); take a coarser `gsd_m`"
        )


def terrain_from_area(
    dems: DemSet, area: Area, gsd_m: float | None = None, ring_m: float = 0.0
) -> Terrain:
    """Terrain of an area in the frame of its centre; cell size ``gsd_m`` (default: the DEM's at the
    centre).

    ``AreaError`` if the DEM has no height in the area.
    """
    gsd_m = native_gsd_m(dems, area) if gsd_m is None else gsd_m
    _require_gsd(gsd_m)
    terrain = build_terrain(
        dems, area.frame, NodeWindow.covering(area.extent_m, gsd_m), gsd_m, ring_m
    )
    row0, row1, col0, col1 = terrain.core
    if not (terrain.product_index[row0:row1, col0:col1] >= 0).any():
        raise no_height(dems, area)
    return terrain


def no_height(dems: DemSet, area: Area) -> AreaError:
    """The error for an area without a height in the DEMs."""
    lon, lat = wrapped_deg(area.lon_deg), area.lat_deg
    exchanged = abs(lon) <= 90.0 and dems.candidates_at(lat, lon).any()
    return AreaError(
        f"the area ({area.bounds}) has no height in the DEM, which covers {dems.bounds}"
        f"{': are longitude and latitude exchanged?' if exchanged else ''}"
    )


def sample_patches(
    dems: DemSet, lon_deg: Array, lat_deg: Array, size: int, gsd_m: float
) -> list[Patch]:
    """``size`` x ``size`` nodes around each surface point (n,) in its own frame, z relative to that
    point; ``size`` is odd. ``AreaError`` for a point that has no height.
    """
    if size < 1 or size % 2 == 0:
        raise AreaError(f"a patch of {size} nodes has no centre node; its size must be odd")
    for lon, lat in zip(lon_deg, lat_deg, strict=True):
        require_place(lon, lat)
    _require_gsd(gsd_m)
    if not len(lon_deg):
        return []
    together = max(1, _BLOCK_NODES // size**2)
    patches: list[Patch] = []
    for first in range(0, len(lon_deg), together):
        some = np.s_[first : first + together]
        patches += _patches(dems, lon_deg[some], lat_deg[some], size, gsd_m)
    return patches


def _patches(dems: DemSet, lon_deg: Array, lat_deg: Array, size: int, gsd_m: float) -> list[Patch]:
    """`sample_patches` of points that are solved together."""
    heights, numbers = dems.heights(lon_deg, lat_deg, gsd_m)
    if (numbers < 0).any():
        lon, lat = (float(angle[numbers < 0][0]) for angle in (lon_deg, lat_deg))
        raise AreaError(
            f"no DEM has a height at longitude {lon:g}, latitude {lat:g}; the DEM "
            f"covers {dems.bounds}"
        )
    frames = [
        EnuFrame(float(lon), float(lat), float(height))
        for lon, lat, height in zip(lon_deg, lat_deg, heights, strict=True)
    ]
    half = size // 2
    step = np.arange(-half, half + 1) * gsd_m
    x, y = np.tile(step, size), np.repeat(-step, size)
    z, _ = _solve(dems, frames, np.tile(x, len(frames)), np.tile(y, len(frames)), gsd_m)
    patches = z.reshape(-1, size, size).astype(np.float32)
    patches[:, half, half] = 0.0  # by definition; the solution agrees to a micrometre
    made = zip(patches, frames, numbers.tolist(), strict=True)
    return [Patch(z_m, frame, number) for z_m, frame, number in made]


def native_gsd_m(dems: DemSet, area: Area) -> float:
    """Cell size of the `native_dem` of an area. ``AreaError`` if there is none."""
    return native_dem(dems, area).gsd_m


def native_dem(dems: DemSet, area: Area) -> Dem:
    """The DEM used at the area's centre; in a gap there, the DEM used at most places of the area.
    ``AreaError`` if there is none.
    """
    try:
        return dems.native_dem(area.lon_deg, area.lat_deg)
    except AreaError:
        x0, x1, y0, y1 = area.extent_m
        x, y = np.meshgrid(np.linspace(x0, x1, 33), np.linspace(y0, y1, 33))
        coarsest = max(dem.gsd_m for dem in dems.dems)
        _, index = _solve(dems, [area.frame], x.ravel(), y.ravel(), coarsest)
        if not (index >= 0).any():
            raise no_height(dems, area) from None
        return dems.dems[int(np.bincount(index[index >= 0]).argmax())]


def _heights(
    dems: DemSet, frame: EnuFrame, window: NodeWindow, gsd_m: float
) -> tuple[NDArray[np.float32], Int16]:
    """ENU z of a window's nodes and the index of each one's DEM, block by block of rows."""
    rows, cols = window.shape
    z, index = np.empty((rows, cols), np.float32), np.empty((rows, cols), np.int16)
    x = np.arange(window.col0, window.col1) * gsd_m
    step = max(1, _BLOCK_NODES // cols)
    for row in range(0, rows, step):
        y = -np.arange(window.row0 + row, window.row0 + min(row + step, rows)) * gsd_m
        block = np.s_[row : row + len(y)]
        heights, numbers = _solve(dems, [frame], np.tile(x, len(y)), np.repeat(y, cols), gsd_m)
        z[block], index[block] = heights.reshape(-1, cols), numbers.reshape(-1, cols)
    return z, index


def _solve(
    dems: DemSet, frames: Sequence[EnuFrame], x: Array, y: Array, gsd_m: float
) -> tuple[Array, Int16]:
    """ENU z over nodes (n,) of frames, the same number of nodes in each, NaN without a height, and
    the index of each one's DEM (-1: none).
    """
    origins = np.array([(frame.lon_deg, frame.lat_deg) for frame in frames])
    which = np.repeat(np.arange(len(frames)), x.size // len(frames))
    origin = np.array([frame.height_m for frame in frames])[which]
    away2 = x * x + y * y
    height, index = origin.copy(), np.full(x.size, -1, np.int16)
    height[away2 >= (_LIMB * MOON_RADIUS_M) ** 2] = np.nan
    before, gap = np.full(x.size, np.nan), np.full(x.size, np.nan)
    active = np.flatnonzero(np.isfinite(height))
    for _ in range(_ITERATIONS):
        if active.size == 0:
            break
        lon, lat = np.empty(active.size), np.empty(active.size)
        resample.lonlat_over(x, y, height, active, which, origins, lon, lat)
        found, index[active] = dems.heights(lon, lat, gsd_m)
        left = np.empty_like(active)
        count = resample.improve_heights(
            found, active, x, y, height, before, gap, _TOLERANCE_M, left
        )
        active = left[:count]
    height[active], index[active] = (
        np.nan,
        -1,
    )  # not converged: a cliff seen edge-on, far from the centre
    return np.sqrt((MOON_RADIUS_M + height) ** 2 - away2) - (MOON_RADIUS_M + origin), index


def _require_gsd(gsd_m: float) -> None:
    if not 0.0 < gsd_m < math.inf:
        raise AreaError(f"invalid cell size {gsd_m:g} m; `gsd_m` must be positive")
