"""Resampling of gridded values to coarser cells with a stated point spread.

An image and a render can be compared only if they are equally sharp. The point spread is a Gaussian
with a stated full width at half maximum on the terrain; missing cells have no weight. The Gaussian
is evaluated at the nodes of the new grid, so that any ratio of cell sizes is possible.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import Array
from ..constants import SIGMA_PER_FWHM

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
