"""Centred normalised correlation of image and render in windows of 16 x 16 cells.

Pivovarchuk et al. (2026) assess renders by the histogram of these correlations, its mode, and the
share above 0.9. Correlation is independent of gain and offset; nothing else is fitted, and every
window with enough valid cells counts. Arrays are (rows, cols) on one grid of the terrain.

Each window is centred by its own weighted means first. Integral images would be faster for
overlapping windows, but lose the digits that low-contrast terrain needs: its contrast is a
thousandth of its brightness.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike, NDArray

from ..arrays import Array
from ..landmarks.correlation import moments
from ..matching.subpixel import moved, moves, peaks, undone

SIZE = 16
STEP = 16
LEAST_VALID = 0.9
"""Least valid share of the weight of a window that counts."""

BIN = 0.01
"""Bin width of the histogram and of its mode; the value 0.985 of the paper is the centre of a bin."""


@dataclass(frozen=True, eq=False)
class WindowComparison:
    """The n windows of a comparison, row by row from north to south.

    ``shift_px`` is the offset of the whole image from the render, in cells (right, down). If
    ``offset`` is "removed", it was removed before the comparison; if "kept", it was not estimated
    and is (0, 0).
    """

    size: int
    step: int
    gsd_m: float
    row: NDArray[np.int64]  # (n,) first row of the window
    col: NDArray[np.int64]  # (n,) first column
    correlation: Array  # (n,) -1..1; 0 where one of the two is flat
    contrast: Array  # (n,) standard deviation of the render, in its own unit
    valid: Array  # (n,) valid share of the window's weight
    offset: Literal["kept", "removed"]
    shift_px: tuple[float, float] = (0.0, 0.0)
    offset_px: Array | None = None  # (n, 2) best offset, column and row; NaN: at the search's edge
    peak: Array | None = None  # (n,) the correlation there
    patch: NDArray[np.int64] | None = None  # (n,) index of the window's patch, for patches

    @property
    def count(self) -> int:
        return len(self.correlation)

    def share_above(self, bound: float) -> float:
        """Share of the windows with a correlation above ``bound``; NaN without windows."""
        return float(np.mean(self.correlation > bound)) if self.count else float("nan")

    @property
    def median(self) -> float:
        """Median correlation; NaN without windows."""
        return float(np.median(self.correlation)) if self.count else float("nan")

    @property
    def mode(self) -> float:
        """Centre of the fullest bin of `histogram`, the highest of several; NaN without windows."""
        if not self.count:
            return float("nan")
        counts, edges = self.histogram()
        last = len(counts) - 1 - int(counts[::-1].argmax())
        return float(0.5 * (edges[last] + edges[last + 1]))

    def histogram(self, width: float = BIN) -> tuple[NDArray[np.int64], Array]:
        """Counts (m,) in bins of ``width`` from -1 to 1, and the edges of the bins (m + 1,)."""
        edges = np.linspace(-1.0, 1.0, round(2.0 / width) + 1)
        counts, _ = np.histogram(np.clip(self.correlation, -1.0, 1.0), edges)
        return counts.astype(np.int64), edges

    @property
    def textured(self) -> WindowComparison:
        """Half of the windows, those with the higher contrast in the render."""
        return self.where(
            self.contrast >= np.median(self.contrast) if self.count else self.contrast > 0
        )

    def where(self, chosen: NDArray[np.bool_]) -> WindowComparison:
        """Selection of windows by a mask (n,)."""
        arrays = ("row", "col", "correlation", "contrast", "valid", "offset_px", "peak", "patch")
        kept = {name: getattr(self, name) for name in arrays}
        return replace(self, **{name: a[chosen] for name, a in kept.items() if a is not None})

    def map(self, shape: tuple[int, int]) -> Array:
        """Correlations on the grid (rows, cols), NaN without a window; the last of overlapping
        windows.
        """
        drawn = np.full(shape, np.nan)
        for row, col, value in zip(self.row, self.col, self.correlation, strict=True):
            drawn[row : row + self.size, col : col + self.size] = value
        return drawn


def compare(
    image: ArrayLike,
    render: ArrayLike,
    weight: ArrayLike | None = None,
    *,
    gsd_m: float,
    size: int = SIZE,
    step: int = STEP,
    least_valid: float = LEAST_VALID,
    offset: Literal["kept", "removed"] = "kept",
    search_px: int = 0,
) -> WindowComparison:
    """Correlations of an image and a render (rows, cols) in windows of ``size`` x ``size`` cells at
    a spacing of ``step`` cells.

    ``weight`` (rows, cols) 0..1, default 1; cells that are NaN in either count as 0. Windows with a
    mean weight below ``least_valid`` are left out. ``offset``: "removed" first removes one common
    shift of the whole image (`common_shift`). ``search_px``: search radius of the offset of each
    window; the correlations do not use these offsets. ValueError for shapes or sizes that do not
    fit.
    """
    a, b, w = _checked(image, render, weight, size, step)
    if offset not in ("kept", "removed"):
        raise ValueError(f"offset must be kept or removed, not {offset!r}")
    shift = common_shift(a, b, w, size=size) if offset == "removed" else (0.0, 0.0)
    if offset == "removed":
        a, w = undone(a, w, shift)
    rows, cols = (np.arange(0, n - size + 1, step) for n in a.shape)
    grid = _correlations(a, b, w, size, step)
    there = grid.valid >= least_valid - 1e-9
    i, j = np.nonzero(there)
    found = WindowComparison(
        size, step, gsd_m, rows[i], cols[j], grid.correlation[there], grid.contrast[there],
        grid.valid[there], offset, shift,
    )  # fmt: skip
    return _with_offsets(found, a, b, w, search_px) if search_px else found


def of_patches(
    images: ArrayLike,
    renders: ArrayLike,
    weights: ArrayLike | None = None,
    *,
    gsd_m: float,
    size: int = SIZE,
    step: int = STEP,
) -> WindowComparison:
    """Correlations of n patches (n, rows, cols), each an image and a render on the nodes of the
    patch.

    ``row`` and ``col`` refer to the patch; ``patch`` is its index. A patch smaller than a window is
    one window; ``size`` is then its side. Offsets are not removed. ValueError for other shapes.
    """
    a, b = np.asarray(images, dtype=np.float64), np.asarray(renders, dtype=np.float64)
    if a.ndim != 3:
        raise ValueError(f"patches must be (n, rows, cols), not {a.shape}")
    w = np.ones(a.shape) if weights is None else np.asarray(weights, dtype=np.float64)
    size = min(size, *a.shape[1:])
    each = [
        compare(image, render, weight, gsd_m=gsd_m, size=size, step=step)
        for image, render, weight in zip(a, b, w, strict=True)
    ]
    if not each:
        raise ValueError("no patch to compare")

    def joined(name: str) -> NDArray[Any]:
        return np.concatenate([getattr(found, name) for found in each])

    patch = np.repeat(np.arange(len(each)), [found.count for found in each])
    return WindowComparison(
        size=size, step=step, gsd_m=gsd_m, row=joined("row"), col=joined("col"),
        correlation=joined("correlation"), contrast=joined("contrast"), valid=joined("valid"),
        offset="kept", patch=patch,
    )  # fmt: skip


_COMMON_REACH_PX = 4


def common_shift(
    image: Array, render: Array, weight: Array, *, size: int = SIZE
) -> tuple[float, float]:
    """Offset of an image from a render in cells (right, down): the maximum of the mean correlation
    of the windows within 4 cells, interpolated by the quadratic through its neighbours.

    The error of the interpolation is below 0.05 cells for images smoothed to their cells (a test
    measures it).
    """
    scores = np.full(2 * (2 * _COMMON_REACH_PX + 1,), -np.inf)
    for (i, j), place in moves(_COMMON_REACH_PX):
        grid = _correlations(*moved(image, render, weight, place), size, size)
        there = grid.valid >= 0.5
        if there.any():
            scores[i, j] = grid.correlation[there].mean()
    if not np.isfinite(scores).any():
        return 0.0, 0.0
    column, row, _ = peaks(scores[:, :, None])
    return (float(column[0]), float(row[0])) if np.isfinite(column[0]) else (0.0, 0.0)


@dataclass(frozen=True, eq=False)
class _Grid:
    """Figures of all windows (r, c), also of those that do not count."""

    correlation: Array
    contrast: Array
    valid: Array


def _correlations(a: Array, b: Array, w: Array, size: int, step: int) -> _Grid:
    views = [sliding_window_view(x, (size, size))[::step, ::step] for x in (a, b, w)]
    bands = [_of_row(*(np.array(view[k]) for view in views)) for k in range(len(views[0]))]
    stacked = np.array(bands).reshape(len(bands), 3, -1)
    return _Grid(*(np.ascontiguousarray(stacked[:, k]) for k in range(3)))


def _of_row(a: Array, b: Array, w: Array) -> Array:
    """Correlation, contrast and valid share (3, c) of windows (c, size, size)."""
    found = moments(*(x.reshape(len(x), -1) for x in (a, b, w)))
    return np.stack([found.correlation, found.deviation_b, found.weight / w[0].size])


def _checked(
    image: ArrayLike, render: ArrayLike, weight: ArrayLike | None, size: int, step: int
) -> tuple[Array, Array, Array]:
    """Image, render and weights in float64, 0 where either is missing."""
    a, b = np.array(image, dtype=np.float64), np.array(render, dtype=np.float64)
    w = np.ones(a.shape) if weight is None else np.array(weight, dtype=np.float64)
    if a.ndim != 2 or a.shape != b.shape or a.shape != w.shape:
        raise ValueError(
            f"shapes of image, render and weight differ: {a.shape}, {b.shape}, {w.shape}"
        )
    if size < 2 or step < 1:
        raise ValueError(f"invalid window size {size} or step {step}")
    if min(a.shape) < size:
        raise ValueError(
            f"windows of {size} cells are larger than {a.shape[0]} x {a.shape[1]} cells"
        )
    there = np.isfinite(a) & np.isfinite(b) & (w > 0.0)
    return np.where(there, a, 0.0), np.where(there, b, 0.0), np.where(there, w, 0.0)


def _with_offsets(
    found: WindowComparison, a: Array, b: Array, w: Array, reach: int
) -> WindowComparison:
    """Adds the offset with the highest correlation within ``reach`` cells to each window."""
    scores = np.full((2 * reach + 1, 2 * reach + 1, found.count), -np.inf)
    i, j = found.row // found.step, found.col // found.step
    for place, shift in moves(reach):
        grid = _correlations(*moved(a, b, w, shift), found.size, found.step)
        scores[place] = np.where(grid.valid[i, j] >= 0.5, grid.correlation[i, j], -np.inf)
    column, row, peak = peaks(scores)
    return replace(found, offset_px=np.stack([column, row], axis=-1), peak=peak)
