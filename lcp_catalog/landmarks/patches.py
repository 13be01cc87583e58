"""Patches of an image, and the image at half resolution."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import Float32


def gather_patches(
    array: NDArray[Any], rows: NDArray[np.int64], cols: NDArray[np.int64], half: int
) -> NDArray[Any]:
    """The (2 half + 1)^2 nodes around each (row, col), shape (n, 2 half + 1, 2 half + 1), of the
    array's type.

    Nodes outside the array are NaN for floats, False for booleans, 0 for integers.
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


def halved(image: Float32) -> Float32:
    """Means of 2 x 2 pixels (rows // 2, cols // 2); an odd last row or column is left out."""
    rows, cols = (n // 2 for n in image.shape)
    pairs = image[: 2 * rows, : 2 * cols].astype(np.float64)
    pairs = pairs[::2] + pairs[1::2]
    return np.asarray(0.25 * (pairs[:, ::2] + pairs[:, 1::2]), dtype=np.float32)
