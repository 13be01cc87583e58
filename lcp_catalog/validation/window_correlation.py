"""An image held against a render, window by window: the centred normalised correlation of every 16 x 16 cells.

Pivovarchuk et al. (2026) judge their renders by the histogram of these correlations, by its mode and by
the share above 0.9. Gain and offset drop out of a correlation; nothing else is taken from the image, and
no window with enough valid cells is left out. Arrays are (rows, cols) on one grid of the ground.

Each window is centred by its own weighted means before anything is multiplied. Sums over the whole image
(integral images) would be faster where windows overlap much, and lose the digits that level ground needs:
its contrast is a thousandth of its brightness.
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
"""Share of a window's weight that must be there for it to count."""

MODE_BIN = 0.005
"""Width of the bins whose fullest is the mode: it resolves the paper's 0.985."""


@dataclass(frozen=True, eq=False)
class WindowComparison:
    """All n windows of one comparison, in rows from north to south.

    ``shift_px`` is by how many cells (column, row) the image lay right of and below the render. It was undone
    where ``offset`` says "removed"; where it says "kept" none was sought and it is (0, 0).
    """

    size: int
    step: int
    gsd_m: float
    row: NDArray[np.int64]  # (n,) first row of the window
    col: NDArray[np.int64]  # (n,) first column
    correlation: Array  # (n,) -1..1; 0 where one of the two is flat
    contrast: Array  # (n,) standard deviation of the render, in its own unit
    valid: Array  # (n,) share of the window's weight that is there
    offset: Literal["kept", "removed"]
    shift_px: tuple[float, float] = (0.0, 0.0)
    offset_px: Array | None = (
        None  # (n, 2) where the image matches best, column and row; NaN: at the search's edge
    )
    peak: Array | None = None  # (n,) the correlation there
    patch: NDArray[np.int64] | None = (
        None  # (n,) which patch a window lies in, where patches were compared
    )

    @property
    def count(self) -> int:
        return len(self.correlation)

    def share_above(self, bound: float) -> float:
        """Share of all windows that correlate by more; NaN without any window."""
        return float(np.mean(self.correlation > bound)) if self.count else float("nan")

    @property
    def median(self) -> float:
        """NaN without any window."""
        return float(np.median(self.correlation)) if self.count else float("nan")

    @property
    def mode(self) -> float:
        """Middle of the fullest bin of `MODE_BIN`, of several the highest; NaN without any window."""
        if not self.count:
            return float("nan")
        counts, edges = self.histogram(MODE_BIN)
        last = len(counts) - 1 - int(counts[::-1].argmax())
        return float(0.5 * (edges[last] + edges[last + 1]))

    def histogram(self, width: float = 0.01) -> tuple[NDArray[np.int64], Array]:
        """Counts (m,) in bins of a width from -1 to 1, and their edges (m + 1,)."""
        edges = np.linspace(-1.0, 1.0, round(2.0 / width) + 1)
        counts, _ = np.histogram(np.clip(self.correlation, -1.0, 1.0), edges)
        return counts.astype(np.int64), edges

    @property
    def textured(self) -> WindowComparison:
        """The half of the windows with the greater contrast in the render."""
        return self.where(
            self.contrast >= np.median(self.contrast) if self.count else self.contrast > 0
        )

    def where(self, chosen: NDArray[np.bool_]) -> WindowComparison:
        """Some of the windows, for a closer look: a share of them is no share of all."""
        arrays = ("row", "col", "correlation", "contrast", "valid", "offset_px", "peak", "patch")
        kept = {name: getattr(self, name) for name in arrays}
        return replace(self, **{name: a[chosen] for name, a in kept.items() if a is not None})

    def map(self, shape: tuple[int, int]) -> Array:
        """Correlations drawn on the grid (rows, cols), NaN where no window counts; of windows that overlap the last."""
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
    """Every window of ``size`` x ``size`` cells, ``step`` cells apart, of an image and a render (rows, cols).

    ``weight`` (rows, cols) 0..1, none: all alike; cells without a value in one of the two count as 0.
    Windows in which the weights' mean is below ``least_valid`` do not count. ``offset``: "removed" undoes one
    common shift of the whole image first (`common_shift`). ``search_px``: how far to look for each window's own best
    place, for a quiver: correlations never use it. ValueError for shapes or sizes that do not fit.
    """
    a, b, w = _checked(image, render, weight, size, step)
    if offset not in ("kept", "removed"):
        raise ValueError(f"offset is kept or removed, not {offset!r}")
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
    least_valid: float = LEAST_VALID,
) -> WindowComparison:
    """The same without a DEM: n patches of a catalogue (n, rows, cols), each with the image on its own nodes.

    ``row`` and ``col`` count within a patch, ``patch`` says which. Patches smaller than a window are one
    window each: ``size`` says so. Offsets are kept: each patch was placed by its own point.
    """
    a, b = np.asarray(images, dtype=np.float64), np.asarray(renders, dtype=np.float64)
    if a.ndim != 3:
        raise ValueError(f"patches are (n, rows, cols), not {a.shape}")
    w = np.ones(a.shape) if weights is None else np.asarray(weights, dtype=np.float64)
    size = min(size, *a.shape[1:])
    each = [
        compare(*arrays, gsd_m=gsd_m, size=size, step=step, least_valid=least_valid)
        for arrays in zip(a, b, w, strict=True)
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


def common_shift(
    image: Array, render: Array, weight: Array, *, size: int = SIZE, reach_px: int = 4
) -> tuple[float, float]:
    """By how many cells (column, row) an image lies right of and below a render: where the mean correlation of the
    windows is highest within ``reach_px``, by the quadratic through its neighbours.

    The quadratic's own error is below 0.05 cells for images smoothed to their cells (`tests/test_windows.py`).
    """
    scores = np.full((2 * reach_px + 1, 2 * reach_px + 1), -np.inf)
    for (i, j), place in moves(reach_px):
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
    """Of all windows (r, c), whether they count or not."""

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
    """Image, render and weights, float64, 0 where nothing is."""
    a, b = np.array(image, dtype=np.float64), np.array(render, dtype=np.float64)
    w = np.ones(a.shape) if weight is None else np.array(weight, dtype=np.float64)
    if a.ndim != 2 or a.shape != b.shape or a.shape != w.shape:
        raise ValueError(
            f"image, render and weight have the shapes {a.shape}, {b.shape}, {w.shape}"
        )
    if size < 2 or step < 1:
        raise ValueError(f"windows of {size} cells, {step} apart, are none")
    if min(a.shape) < size:
        raise ValueError(f"a window of {size} cells does not fit into {a.shape[0]} x {a.shape[1]}")
    there = np.isfinite(a) & np.isfinite(b) & (w > 0.0)
    return np.where(there, a, 0.0), np.where(there, b, 0.0), np.where(there, w, 0.0)


def _with_offsets(
    found: WindowComparison, a: Array, b: Array, w: Array, reach: int
) -> WindowComparison:
    """Each window's own best place within ``reach`` cells."""
    scores = np.full((2 * reach + 1, 2 * reach + 1, found.count), -np.inf)
    i, j = found.row // found.step, found.col // found.step
    for place, shift in moves(reach):
        grid = _correlations(*moved(a, b, w, shift), found.size, found.step)
        scores[place] = np.where(grid.valid[i, j] >= 0.5, grid.correlation[i, j], -np.inf)
    column, row, peak = peaks(scores)
    return replace(found, offset_px=np.stack([column, row], axis=-1), peak=peak)
