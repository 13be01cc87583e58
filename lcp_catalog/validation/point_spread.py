"""Values on a grid of the ground, brought to a coarser grid and to a stated point spread.

An image and a render can be held against each other only where both are equally sharp. The point spread is a
Gaussian of a full width at half maximum on the ground; missing cells weigh nothing. The Gaussian is
evaluated where the new grid's nodes lie, so that no ratio of cell sizes is special.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import Array

SIGMA_PER_FWHM = 1.0 / math.sqrt(8.0 * math.log(2.0))
CELL_FWHM = 2.0
"""Width of the point spread that cells get, in cells: the shortest wave that they hold."""

_REACH_SIGMAS = 5.0
"""Beyond it lies 6e-7 of a Gaussian in one dimension."""
_BLOCK = 256


@dataclass(frozen=True)
class Grid:
    """Nodes of a coarser grid among those of a finer one: node (i, j) lies at row ``start_px + i ratio``, column
    ``start_px + j ratio``.
    """

    shape: tuple[int, int]
    ratio: float
    start_px: float

    @classmethod
    def over(cls, shape: tuple[int, int], ratio: float) -> Grid:
        """Whole coarse cells from the fine grid's north-western corner on; ValueError for a finer grid, or none."""
        if not ratio >= 1.0 - 1e-9:
            raise ValueError(f"cells {ratio:g} times as wide are finer, not coarser")
        rows, cols = (int((n + 1e-9) / ratio) for n in shape)
        if min(rows, cols) < 1:
            raise ValueError(
                f"{shape[0]} x {shape[1]} cells do not hold one {ratio:g} times as wide"
            )
        return cls((rows, cols), float(ratio), 0.5 * (ratio - 1.0))


@dataclass(frozen=True, eq=False)
class Pair:
    """An image and a render (rows, cols) on the same cells and with the same point spread; ``weight`` 0..1 is 0 where one
    of them is missing. ``grid``: which of the finer nodes.
    """

    image: Array
    render: Array
    weight: Array
    gsd_m: float
    grid: Grid


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
    """Image and render (rows, cols) on cells of ``gsd_m``, brought to cells of ``target_m`` (as wide or wider).

    Both get a Gaussian of ``cell_fwhm`` target cells. A render lacks what its DEM has smoothed away, so the image gets the
    DEM's own point spread as well: ``dem_fwhm_m`` (`dem_resolution.Resolution.point_spread_m`). For slopes that are
    small enough for brightness to follow them linearly the two are then equally sharp.
    """
    a, b = np.asarray(image, dtype=np.float64), np.asarray(render, dtype=np.float64)
    w = np.where(np.isfinite(a) & np.isfinite(b), np.asarray(weight, dtype=np.float64), 0.0)
    ratio = max(target_m / gsd_m, 1.0) if target_m > gsd_m * (1.0 - 1e-6) else target_m / gsd_m
    grid = Grid.over(a.shape, ratio)
    cell = cell_fwhm * ratio
    image_there, mass = spread(a, w, math.hypot(cell, dem_fwhm_m / gsd_m), grid)
    render_there, other = spread(b, w, cell, grid)
    return Pair(image_there, render_there, np.minimum(mass, other), target_m, grid)


def spread(
    values: ArrayLike, weight: ArrayLike, fwhm_px: float, grid: Grid | None = None
) -> tuple[Array, Array]:
    """Gaussian means (rows, cols) of values by their weights, and the weights' own means; NaN and 0 where nothing is near.

    ``fwhm_px``: in cells of the values; 0 takes each nearest node as it is. ``grid``: where to take the means, none:
    at the nodes themselves. A Gaussian narrower than 1.5 cells is undersampled: its sum is made 1, its width
    is not kept (at 1.5 cells it is 1 % too small, at 1 cell a fifth).
    """
    v, w = np.asarray(values, dtype=np.float64), np.asarray(weight, dtype=np.float64)
    if v.ndim != 2 or v.shape != w.shape:
        raise ValueError(f"values and weights have the shapes {v.shape} and {w.shape}")
    grid = grid or Grid(v.shape, 1.0, 0.0)
    w = np.where(np.isfinite(v), w, 0.0)
    light = np.where(w > 0.0, v, 0.0) * w
    total, mass = (_both_axes(x, grid, fwhm_px) for x in (light, w))
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(mass > 1e-6, total / mass, np.nan), np.where(mass > 1e-6, mass, 0.0)


def _both_axes(values: Array, grid: Grid, fwhm_px: float) -> Array:
    down = _one_axis(values, grid.shape[0], grid, fwhm_px)
    return _one_axis(down.T, grid.shape[1], grid, fwhm_px).T


def _one_axis(values: Array, count: int, grid: Grid, fwhm_px: float) -> Array:
    """Means along the first axis at ``count`` nodes, a block of them after the other; beyond the border is nothing."""
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
    """Weights (n, high - low) of the nodes low..high at n places; each row sums to 1 over all nodes, there or not."""
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
