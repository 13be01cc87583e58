"""Occlusion of nodes by terrain in a direction (the Sun, a camera at infinity), by accuracy tier.

- draft: two lines per column and a stencil of the nearest cells (`kernels.shadows.draft`). Measured:
  at most 0.5 % of the nodes are wrong, 95 % of these within two nodes of a shadow's edge.
- standard: a proved upper bound gives lit nodes; a node is dark if the two lines beside it are
  dark; all others are traced (`kernels.shadows.proved_bounds`). Measured: at most 0.02 % are wrong
  (dark instead of lit, where light passes between two lines).
- high: proved bounds on both sides; nodes that they leave undecided are traced. No node is wrong.
- reference: every node is traced.

Terrain beyond the field (`far_terrain`) is tested for the nodes that the field itself leaves lit.
In draft and standard the heights of its shadows at every eighth node are used where these are
clear; otherwise, and in high and reference, rays are traced.

Shadows of parallel light by scan lines over the raster: drafts, and hybrids with exact rays.

This module has the geometry; the passes are in `kernels.shadows`: scan_lines, draft and
proved_bounds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..accuracy import Accuracy
from ..arrays import Array, Mask
from ..geometry.frames import Direction, direction_enu_rad
from ..kernels.rays import bundles
from ..kernels.shadows import draft, proved_bounds, scan_lines, steep_tiles
from .far_terrain import FarTerrain
from .heightfield import Heightfield, Window

EPSILON = 2.0**-24
"""Rounding of one float32 operation, relative."""

STEEPEST = 1e8
"""Upper limit of tangents: float32 does not hold that of the zenith, and no terrain is so steep."""


_LEAST_STRIDE = (
    56  # rows; a sweep rebases heights as its highest Sun needs, which suits all lower Suns
)


@dataclass(frozen=True)
class Effort:
    """Settings of a hybrid: lines per column, rows covered by the stencil, and True if dark nodes
    are proved.
    """

    density: int
    cells: int
    proved: bool


LIKELY = Effort(density=4, cells=2, proved=False)
PROVED = Effort(density=4, cells=4, proved=True)


class SunAhead:
    """Orientation of a heightfield in which a ray (du, dv in cells, the greater one 1; dz in
    metres) goes towards row 0, and the part of the field that can shadow a window.
    """

    def __init__(self, field: Heightfield, ray: tuple[float, float, float], window: Window) -> None:
        row0, row1, col0, col1 = window
        du, dv, self.rise = ray  # metres by which a ray climbs from one row to the next
        self.field = field
        self.length = math.hypot(du, dv)  # cells along the ray from one row to the next
        self._unit = (du / self.length, dv / self.length)
        self.transposed = abs(du) > abs(dv)
        rows = field.shape[0]
        if self.transposed:
            du, dv, rows = dv, du, field.shape[1]
            row0, row1, col0, col1 = col0, col1, row0, row1
        self.flipped = dv > 0.0
        if self.flipped:
            dv, row0, row1 = -dv, rows - row1, rows - row0
        self.shear = du / dv  # columns that a line moves from one row to the next
        self.lean = -1 if self.flipped else 1
        self.window = (row0, row1, col0, col1)
        self.z = field.transposed_m if self.transposed else field.z_m
        self.top = max(0, row0 - self._reach(window))

    @property
    def sure(self) -> NDArray[np.float32]:
        """The heights ``z`` without the nodes beside nodata."""
        return self.field.transposed_borderless_m if self.transposed else self.field.borderless_m

    def stencil(
        self, cells: int, on_node: float = scan_lines.ON_LINE
    ) -> tuple[NDArray[np.int64], Array]:
        """The edges nearest to a node, in the turned raster (`scan_lines.near_stencil`)."""
        nodes, weights = scan_lines.near_stencil(*self._unit, cells, on_node)
        if self.transposed:
            nodes = np.ascontiguousarray(nodes[:, [1, 0, 3, 2]])
        if self.flipped:
            nodes = nodes * np.array([-1, 1, -1, 1])
        return nodes, weights

    def stride(self, steepest_rise: float) -> int:
        """Rows after which heights are rebased: a shadow has then fallen below all terrain, and
        numbers have not grown beyond a few times the relief.
        """
        return 8 + self._rows_of_relief(abs(steepest_rise), self.field.extremes_m[0])

    def awake(self, slope: float, width: int) -> Mask:
        """True for stretches of blocks of ``width`` lines that may contain a shadow
        (`kernels.shadows.steep_tiles`).
        """
        reach = 8 + self._rows_of_relief(self.rise, self.field.extremes_m[0])
        gradients, holed = self.field.tile_gradients_m
        cliffs = np.where(holed, math.inf, gradients)  # beside nodata the slope is unknown
        found = steep_tiles.awake(
            cliffs, self.transposed, self.flipped, self.z.shape, self.shear, slope, reach, self.top,
            self.window, width,
        )  # fmt: skip
        return np.asarray(found)

    def _reach(self, window: Window) -> int:
        """Rows towards the Sun beyond which not even the highest node shadows the window."""
        low = self.field.lowest_m(window)
        return 2 + self._rows_of_relief(self.rise, low) if math.isfinite(low) else 0

    def _rows_of_relief(self, rise: float, low: float) -> int:
        rows = (self.field.extremes_m[1] - low) / rise if rise > 0.0 else math.inf
        return int(min(rows, 1e9))


def draft_occluded(
    field: Heightfield, azimuth_rad: float, elevations_rad: Array, window: Window
) -> NDArray[np.uint8]:
    """Masks uint8 (elevations, rows, cols) of one azimuth, 1 where dark; approximate."""
    row0, row1, col0, col1 = window
    tangents = np.tan(np.minimum(elevations_rad, math.pi / 2))
    slopes = np.clip(tangents, -STEEPEST, STEEPEST) * field.gsd_m
    shape = (slopes.size, row1 - row0, col1 - col0)
    if not _casts(field, shape, float(slopes.min(initial=0.0))):
        return np.zeros(shape, dtype=np.uint8)
    du, dv, _, _ = bundles.scaled(math.sin(azimuth_rad), -math.cos(azimuth_rad), 0.0)
    rises = slopes * math.hypot(du, dv)
    sun = SunAhead(field, (du, dv, float(rises.min())), window)
    nodes, weights = _padded(*sun.stencil(draft.NEAR_CELLS))
    stride = _LEAST_STRIDE + sun.stride(float(np.abs(rises).max()))
    a0, a1, b0, b1 = sun.window
    awake = sun.awake(float(slopes.min()), scan_lines.LINES)
    out = np.empty(shape if slopes.size > 1 or sun.transposed else 0, dtype=np.uint8)
    for first in range(0, slopes.size, draft.SUNS):
        some = slice(first, first + draft.SUNS)
        bits = np.empty((a1 - a0, b1 - b0), dtype=np.uint8)
        draft.draft(
            sun.z, sun.flipped, sun.shear, rises[some], slopes[some], nodes, weights, stride,
            sun.top, sun.window, not sun.transposed, awake, bits,
        )  # fmt: skip
        if not out.size:
            return bits[np.newaxis]
        draft.unpack(bits, sun.transposed, sun.flipped, out[some])
    return out


def hybrid_occluded(
    field: Heightfield, ray: tuple[float, float, float], window: Window, effort: Effort
) -> tuple[Mask, int]:
    """Mask bool (rows, cols) of a ray in cells (not vertical), and the number of nodes that were
    traced.
    """
    row0, row1, col0, col1 = window
    out = np.empty((row1 - row0, col1 - col0), dtype=np.bool_)
    if not _casts(field, out.shape, ray[2]):
        return np.zeros_like(out), 0
    sun = SunAhead(field, ray, window)
    if not sun.awake(ray[2] / sun.length, scan_lines.LINES).any():
        return np.zeros_like(out), 0
    stencil, sure_stencil = sun.stencil(effort.cells), sun.stencil(effort.cells, on_node=0.0)
    stride = sun.stride(sun.rise)
    # beside nodata only the proved bounds use the edges of existing triangles alone
    proved = effort.proved or field.has_holes
    unlike = field.has_holes or (effort.proved and not np.array_equal(stencil[0], sure_stencil[0]))
    a0, a1, b0, b1 = sun.window
    marks = np.empty((a1 - a0, b1 - b0), dtype=np.uint8)
    proved_bounds.mark(
        sun.z, sun.sure, proved, unlike,
        sun.flipped, (sun.shear, sun.rise, sun.rise / sun.length, sun.lean), effort.density,
        effort.cells, stencil, sure_stencil,
        slacks(field, sun.rise, stride, sun.window[1] - sun.top), (sun.top, stride), sun.window, marks,
    )  # fmt: skip
    traced = proved_bounds.settle(
        *field.traced, ray, marks, sun.transposed, sun.flipped, window, out
    )
    return out, int(traced)


def slacks(field: Heightfield, rise: float, stride: int, rows: int) -> tuple[float, float]:
    """Bounds of the float32 rounding error of a line's height (m) and of a stencil's tangent (m per
    cell).

    A line's height is two products, two sums and the rounded level, each within EPSILON of numbers
    not above M = the highest |z| + |rise| (stride + 8); the ray's is one sum and a level: 8 EPSILON
    M together, of which twice is used. Every rebase may add EPSILON M while a height still counts:
    twice for a Sun above the horizon, since the height is below all terrain after that; at every
    rebase for a Sun below the horizon. A stencil's weights are at most sqrt 2: three products, two
    sums, three rounded weights of numbers not above sqrt 2 |z|.
    """
    low, high, _ = field.extremes_m
    largest = max(abs(low), abs(high))
    size = largest + abs(rise) * (stride + 8)
    rebases = 2 if rise > 0.0 else rows // stride + 1
    return EPSILON * size * (16 + 2 * rebases), 32.0 * EPSILON * largest


def _padded(nodes: NDArray[np.int64], weights: Array) -> tuple[NDArray[np.int64], Array]:
    """A stencil of at least four edges, the last one repeated: four are processed in one pass."""
    which = np.arange(max(4, len(nodes))).clip(max=len(nodes) - 1)
    return nodes[which], weights[which]


def _casts(field: Heightfield, shape: tuple[int, ...], rise: float) -> bool:
    """True if the field can rise above rays of this slope and the result is not empty."""
    low, high, _ = field.extremes_m
    return field.is_surface and math.prod(shape) > 0 and (high > low or rise < 0.0 <= high - low)


def occluded(
    field: Heightfield,
    direction: ArrayLike,
    accuracy: Accuracy,
    window: Window | None = None,
    far: FarTerrain | None = None,
) -> Mask:
    """True for nodes of the window, bool (rows, cols), where the surface rises above the ray in
    ``direction`` (3,), an ENU vector; at most a share ``accuracy.node_error`` of them is wrong.

    ``far``: terrain beyond the field. Nodata is not occluded. ValueError for an invalid direction
    or a window outside the raster.
    """
    out = _occluded(field, direction, accuracy, window)
    if far is not None:
        towards = np.asarray(direction, dtype=np.float64)
        far.shadowed(field, towards, accuracy, field.checked_window(window), out)
    return out


def _occluded(
    field: Heightfield, direction: ArrayLike, accuracy: Accuracy, window: Window | None
) -> Mask:
    """Occlusion by the field alone."""
    ray = field.ray_in_cells(direction)
    if accuracy.shadows == "rays" or ray[:2] == (0.0, 0.0):
        return field.occluded_nodes(direction, window)
    inside = field.checked_window(window)
    if accuracy.shadows == "lines":
        towards = Direction.of(direction)
        elevations = np.array([towards.elevation_rad])
        masks = draft_occluded(field, towards.azimuth_rad, elevations, inside)
        return np.asarray(masks[0].view(np.bool_))
    effort = PROVED if accuracy.shadows == "proved" else LIKELY
    return hybrid_occluded(field, ray, inside, effort)[0]


def occluded_sweep(
    field: Heightfield,
    azimuth_rad: float,
    elevations_rad: ArrayLike,
    accuracy: Accuracy,
    window: Window | None = None,
    far: FarTerrain | None = None,
) -> NDArray[np.uint8]:
    """Occlusion for several elevations at one azimuth, uint8 (elevations, rows, cols): 1 where
    dark.

    ValueError unless elevations lie between -90 (excluded) and 90 degrees and the azimuth is
    finite.
    """
    elevations = np.atleast_1d(np.asarray(elevations_rad, dtype=np.float64))
    if not ((elevations > -math.pi / 2) & (elevations <= math.pi / 2 + 1e-12)).all():
        raise ValueError("elevations must lie above -90 and up to 90 degrees")
    if not math.isfinite(azimuth_rad):
        raise ValueError(f"invalid azimuth {azimuth_rad}")
    inside = field.checked_window(window)
    directions = direction_enu_rad(azimuth_rad, elevations)
    if accuracy.shadows == "lines":
        masks_ = draft_occluded(field, azimuth_rad, elevations, inside)
        if far is not None:
            for mask, direction in zip(masks_, directions, strict=True):
                far.shadowed(field, direction, accuracy, inside, mask.view(np.bool_))
        return masks_
    masks = [occluded(field, direction, accuracy, inside, far) for direction in directions]
    rows, cols = inside[1] - inside[0], inside[3] - inside[2]
    return np.array(masks, dtype=np.uint8).reshape(len(masks), rows, cols)
