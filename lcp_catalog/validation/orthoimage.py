"""Image and render on the same cells: the image resampled to the nodes of terrain, both resampled to
coarser cells with a stated point spread, or to area means without further smoothing.

An image and a render can be compared only if they are equally sharp. The point spread is a Gaussian
with a stated full width at half maximum on the terrain; missing cells have no weight. The Gaussian
is evaluated at the nodes of the new grid, so that any ratio of cell sizes is possible.

The footprint of a cell in the image is a parallelogram, given by the projections of its neighbours.
If the image is finer than the terrain, the signal is the mean over that parallelogram
(`kernels.resampling.area_means`), without aliasing; if it is coarser, it is interpolated by cubic
convolution. Missing and saturated pixels have no weight; nodes hidden from the camera are left out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import Array, Mask
from ..constants import SIGMA_PER_FWHM
from ..images.image import Image
from ..kernels.resampling import area_means
from ..terrain.relief_bounds import nodes_enu
from ..terrain.terrain import Terrain

CELL_FWHM = 2.0
"""Full width at half maximum of the point spread, in cells: the shortest wave that the cells
represent.
"""

_REACH_SIGMAS = 5.0
"""Truncation of the Gaussian; 6e-7 of it is beyond, in one dimension."""
_BLOCK = 256


@dataclass(frozen=True)
class CoarseGrid:
    """Coarser grid in coordinates of a finer one: node (i, j) is at row ``start_px + i ratio``,
    column ``start_px + j ratio``.
    """

    shape: tuple[int, int]
    ratio: float
    start_px: float

    @classmethod
    def over(cls, shape: tuple[int, int], ratio: float) -> CoarseGrid:
        """Whole coarse cells from the north-western corner of the fine grid. ValueError for a ratio
        below 1 or too large a one.
        """
        if not ratio >= 1.0 - 1e-9:
            raise ValueError(f"ratio of cell sizes {ratio:g}: the new cells are not coarser")
        rows, cols = (int((n + 1e-9) / ratio) for n in shape)
        if min(rows, cols) < 1:
            raise ValueError(
                f"{shape[0]} x {shape[1]} cells are too few for a cell {ratio:g} times as wide"
            )
        return cls((rows, cols), float(ratio), 0.5 * (ratio - 1.0))


@dataclass(frozen=True, eq=False)
class Pair:
    """Image and render (rows, cols) on the same cells with the same point spread. ``weight`` 0..1
    is 0 where one is missing. ``grid``: the cells in coordinates of the finer grid.
    """

    image: Array
    render: Array
    weight: Array
    gsd_m: float
    grid: CoarseGrid


def paired(
    image: ArrayLike,
    render: ArrayLike,
    weight: ArrayLike,
    *,
    gsd_m: float,
    target_m: float,
    dem_fwhm_m: float = 0.0,
    cell_fwhm: float = CELL_FWHM,
) -> Pair:
    """Image and render (rows, cols) on cells of ``gsd_m``, resampled to equal or larger cells of
    ``target_m``.

    Both are smoothed with a Gaussian of ``cell_fwhm`` target cells. A render lacks the detail that
    its DEM lacks, so the image is also smoothed with the DEM's point spread ``dem_fwhm_m``
    (`effective_resolution.Resolution.point_spread_m`). Both are then equally sharp if slopes are so small
    that brightness is linear in them.
    """
    a, b = np.asarray(image, dtype=np.float64), np.asarray(render, dtype=np.float64)
    w = np.where(np.isfinite(a) & np.isfinite(b), np.asarray(weight, dtype=np.float64), 0.0)
    ratio = max(target_m / gsd_m, 1.0) if target_m > gsd_m * (1.0 - 1e-6) else target_m / gsd_m
    grid = CoarseGrid.over(a.shape, ratio)
    cell = cell_fwhm * ratio
    image_there, mass = spread(a, w, math.hypot(cell, dem_fwhm_m / gsd_m), grid)
    render_there, other = spread(b, w, cell, grid)
    return Pair(image_there, render_there, np.minimum(mass, other), target_m, grid)


def area_paired(
    image: ArrayLike, render: ArrayLike, weight: ArrayLike, *, gsd_m: float, target_m: float
) -> Pair:
    """Image and render (rows, cols) on cells of ``gsd_m``, both reduced to cells of ``target_m`` by
    weighted means over each cell's area, and not smoothed, as Pivovarchuk et al. (2026) compare them.

    A fine cell on a border counts with the share that lies inside. ValueError as `CoarseGrid.over`.
    """
    a, b = np.asarray(image, dtype=np.float64), np.asarray(render, dtype=np.float64)
    w = np.where(np.isfinite(a) & np.isfinite(b), np.asarray(weight, dtype=np.float64), 0.0)
    grid = CoarseGrid.over(a.shape, max(target_m / gsd_m, 1.0))
    down, right = (_overlaps(n, m, grid.ratio) for n, m in zip(grid.shape, a.shape, strict=True))
    mass = down @ w @ right.T
    means = (down @ (np.where(w > 0.0, x, 0.0) * w) @ right.T for x in (a, b))
    with np.errstate(invalid="ignore", divide="ignore"):
        seen, model = (np.where(mass > 1e-6, total / mass, np.nan) for total in means)
    return Pair(seen, model, mass, target_m, grid)


def _overlaps(count: int, cells: int, ratio: float) -> Array:
    """Share (count, cells) of each coarse cell's width that a fine cell covers; rows sum to 1."""
    low = ratio * np.arange(count)[:, None]
    fine = np.arange(cells)[None, :]
    inside = np.minimum(low + ratio, fine + 1.0) - np.maximum(low, fine)
    return np.asarray(np.maximum(inside, 0.0) / ratio)


def spread(
    values: ArrayLike, weight: ArrayLike, fwhm_px: float, grid: CoarseGrid | None = None
) -> tuple[Array, Array]:
    """Weighted Gaussian means (rows, cols) of values, and the means of the weights; NaN and 0
    without values nearby.

    ``fwhm_px``: in cells of the values; 0 takes the nearest node. ``grid``: nodes of the means;
    default: those of the values. A Gaussian narrower than 1.5 cells is undersampled: it is
    normalised, but its width is too small (by 1 % at 1.5 cells, by a fifth at 1 cell).
    """
    v, w = np.asarray(values, dtype=np.float64), np.asarray(weight, dtype=np.float64)
    if v.ndim != 2 or v.shape != w.shape:
        raise ValueError(f"shapes of values and weights differ: {v.shape} and {w.shape}")
    grid = grid or CoarseGrid(v.shape, 1.0, 0.0)
    w = np.where(np.isfinite(v), w, 0.0)
    light = np.where(w > 0.0, v, 0.0) * w
    total, mass = (_both_axes(x, grid, fwhm_px) for x in (light, w))
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(mass > 1e-6, total / mass, np.nan), np.where(mass > 1e-6, mass, 0.0)


def _both_axes(values: Array, grid: CoarseGrid, fwhm_px: float) -> Array:
    down = _one_axis(values, grid.shape[0], grid, fwhm_px)
    return _one_axis(down.T, grid.shape[1], grid, fwhm_px).T


def _one_axis(values: Array, count: int, grid: CoarseGrid, fwhm_px: float) -> Array:
    """Means along the first axis at ``count`` nodes, in blocks; cells beyond the edge have no
    weight.
    """
    sigma = fwhm_px * SIGMA_PER_FWHM
    reach = max(1.0, _REACH_SIGMAS * sigma)
    out = np.empty((count, values.shape[1]))
    for first in range(0, count, _BLOCK):
        nodes = np.arange(first, min(first + _BLOCK, count), dtype=np.float64)
        at: Array = grid.start_px + nodes * grid.ratio
        low = max(0, math.floor(at[0] - reach))
        high = min(len(values), math.ceil(at[-1] + reach) + 1)
        out[first : first + len(at)] = _kernel(at, low, high, sigma) @ values[low:high]
    return out


def _kernel(at: Array, low: int, high: int, sigma: float) -> Array:
    """Weights (n, high - low) of the nodes low..high at n places; each row sums to 1 over an
    unlimited grid.
    """
    if sigma <= 0.0:
        return np.asarray(
            np.arange(low, high)[None] == np.floor(at + 0.5)[:, None], dtype=np.float64
        )
    away = np.arange(low, high)[None] - at[:, None]
    near = np.abs(away) <= max(1.0, _REACH_SIGMAS * sigma)
    rows = np.where(near, np.exp(-0.5 * (away / sigma) ** 2), 0.0)
    reach = math.ceil(max(1.0, _REACH_SIGMAS * sigma)) + 1
    all_nodes = np.arange(-reach, reach + 1)[None] - (at - np.floor(at))[:, None]
    inside = np.abs(all_nodes) <= max(1.0, _REACH_SIGMAS * sigma)
    whole = np.where(inside, np.exp(-0.5 * (all_nodes / sigma) ** 2), 0.0).sum(axis=1)
    return np.asarray(rows / whole[:, None])


_FINE_PX = 4.0
"""If the narrowest footprints are wider than twice this, pixels, the image is reduced first. The
edges of a footprint are then wrong by at most an eighth of its width.
"""


@dataclass(frozen=True, eq=False)
class Ortho:
    """An image at terrain nodes (rows, cols): ``signal``, NaN where ``weight`` is 0; ``weight``
    0..1; ``pixels`` (rows, cols, 2), the projections of the nodes, NaN where there is none.
    """

    signal: Array
    weight: Array
    pixels: Array


def terrain_nodes(terrain: Terrain) -> Array:
    """MCMF positions (rows, cols, 3) of the nodes of a terrain's core, metres; NaN without a
    height.
    """
    return terrain.frame.to_mcmf(nodes_enu(terrain.field, terrain.core))


def orthorectify(image: Image, nodes_mcmf_m: ArrayLike, visible: ArrayLike | None = None) -> Ortho:
    """Mean of the image over the cell of each node of a terrain grid, MCMF metres (rows, cols, 3).

    ``visible`` (rows, cols): True for nodes visible to the camera, as from a render; default: all
    nodes that project into the image. At the edges of the grid and of its heights, footprints are
    from one-sided differences. ValueError for a grid of fewer than 2 x 2 nodes.
    """
    nodes = np.asarray(nodes_mcmf_m, dtype=np.float64)
    if nodes.ndim != 3 or nodes.shape[2] != 3 or min(nodes.shape[:2]) < 2:
        raise ValueError(
            f"nodes must be (rows, cols, 3) with two or more a side, not {nodes.shape}"
        )
    pixels = image.sensor.project(nodes)
    seen = image.sensor.in_image(pixels)
    if visible is not None:
        seen &= np.asarray(visible, dtype=np.bool_)
    down, right = (_steps(pixels, axis) for axis in (0, 1))
    seen &= np.isfinite(down[..., 0]) & np.isfinite(right[..., 0])
    factor = max(1, math.floor(_narrow_px(down, right, seen) / _FINE_PX))
    at, down, right = (pixels + 0.5) / factor - 0.5, down / factor, right / factor
    signal, weight = _means(image.reduced(factor), seen, at, down, right)
    return Ortho(signal, weight, pixels)


def _steps(pixels: Array, axis: int) -> Array:
    """Pixel steps from node to node along an axis: central differences, one-sided beside missing
    nodes, NaN between two missing nodes.
    """
    along = np.moveaxis(pixels, axis, 0)
    nothing = np.full((1, *along.shape[1:]), np.nan)
    ahead = np.concatenate([along[1:] - along[:-1], nothing])
    behind = np.concatenate([nothing, along[1:] - along[:-1]])
    both = np.where(
        np.isnan(ahead), behind, np.where(np.isnan(behind), ahead, 0.5 * (ahead + behind))
    )
    return np.moveaxis(both, 0, axis)


def _narrow_px(down: Array, right: Array, seen: Mask) -> float:
    """5th percentile of the longer sides of the footprints, pixels; 0 without visible nodes."""
    longer = np.maximum(np.linalg.norm(down, axis=-1), np.linalg.norm(right, axis=-1))[seen]
    return float(np.percentile(longer, 5)) if longer.size else 0.0


def _means(image: Image, seen: Mask, at: Array, down: Array, right: Array) -> tuple[Array, Array]:
    """Means over the visible footprints, and their weights, (rows, cols)."""
    weight = np.where(image.valid, image.weight, 0.0).astype(np.float32)
    light = np.where(weight > 0.0, image.signal, 0.0).astype(np.float32)
    signal, mass = np.empty(int(seen.sum())), np.empty(int(seen.sum()))
    area_means.means(light, weight, at[seen], down[seen], right[seen], signal, mass)
    whole = np.full(seen.shape, np.nan), np.zeros(seen.shape)
    for out, values in zip(whole, (signal, mass), strict=True):
        out[seen] = values
    return whole
