"""Patches out of arrays, and how much of a patch depends on terrain outside it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import Mask


def gather_patches(
    array: NDArray[Any], rows: NDArray[np.int64], cols: NDArray[np.int64], half: int
) -> NDArray[Any]:
    """The (2 half + 1)^2 nodes around each (row, col), shape (n, 2 half + 1, 2 half + 1), of the
    array's own type.

    Nodes outside the array are NaN for floats, False for booleans, 0 for whole numbers.
    """
    rows, cols = np.asarray(rows, dtype=np.int64), np.asarray(cols, dtype=np.int64)
    height, width = array.shape
    size = 2 * half + 1
    whole = (rows >= half) & (rows < height - half) & (cols >= half) & (cols < width - half)
    if height >= size and width >= size and whole.all():
        windows = np.lib.stride_tricks.sliding_window_view(array, (size, size))
        return windows[rows - half, cols - half]
    step = np.arange(-half, half + 1)
    row, col = rows[:, None, None] + step[:, None], cols[:, None, None] + step
    inside = (row >= 0) & (row < height) & (col >= 0) & (col < width)
    found = array[np.clip(row, 0, height - 1), np.clip(col, 0, width - 1)]
    outside = np.array(np.nan if array.dtype.kind == "f" else 0, dtype=array.dtype)
    return np.where(inside, found, outside)


def dependence(alone: Mask, full: Mask, valid: Mask | None = None) -> NDArray[np.float64]:
    """Share of each patch's valid nodes that are lit (or visible) with the fragment alone but not
    with all terrain, (n,).

    ``alone`` and ``full`` (n, p, p) are traced on the same surface, so a difference is terrain
    outside the patch and nothing else. More terrain can only take light away; should a node be lit
    in ``full`` alone, it does not count. ``valid`` (default: all nodes) are the nodes with a
    height; NaN where a patch has none.
    """
    lost = alone & ~full
    if valid is None:
        return np.asarray(lost.mean(axis=(1, 2)))
    count = valid.sum(axis=(1, 2))
    share = (lost & valid).sum(axis=(1, 2)) / np.maximum(count, 1)
    return np.where(count > 0, share, np.nan)
