"""Max pyramid over the cells of a heightfield: what a ray may skip because it passes above.

Level 0 holds, for every cell, the highest of its four nodes; each further level the highest of 2 x 2. Nodata (NaN) counts as
minus infinity. All levels lie one after the other in one flat array; 5.4 bytes a node in float32.
"""

import numpy as np
from numba import njit, prange

LOWEST = np.float32(-np.inf)


def build_pyramid(z):
    """Flat levels (float32), and offset, width and height of each (int64), for heights z (rows >= 2, cols >= 2)."""
    shapes = [(z.shape[0] - 1, z.shape[1] - 1)]
    while max(shapes[-1]) > 1:
        shapes.append(((shapes[-1][0] + 1) // 2, (shapes[-1][1] + 1) // 2))
    sizes = np.array([rows * cols for rows, cols in shapes], dtype=np.int64)
    offsets = np.concatenate([np.zeros(1, np.int64), np.cumsum(sizes)])
    levels = np.empty(int(offsets[-1]), dtype=np.float32)
    _cells(z, levels[: sizes[0]].reshape(shapes[0]))
    for level in range(1, len(shapes)):
        below = levels[offsets[level - 1] : offsets[level]].reshape(shapes[level - 1])
        _halve(below, levels[offsets[level] : offsets[level + 1]].reshape(shapes[level]))
    heights = np.array([shape[0] for shape in shapes], dtype=np.int64)
    widths = np.array([shape[1] for shape in shapes], dtype=np.int64)
    return levels, offsets[:-1].copy(), widths, heights


@njit(cache=True, nogil=True, error_model="numpy", parallel=True)
def _cells(z, out):
    rows, cols = out.shape
    for i in prange(rows):
        for j in range(cols):
            top = LOWEST
            for value in (z[i, j], z[i, j + 1], z[i + 1, j], z[i + 1, j + 1]):
                if value > top:  # False for NaN
                    top = value
            out[i, j] = top


@njit(cache=True, nogil=True, error_model="numpy", parallel=True)
def _halve(below, out):
    rows, cols = out.shape
    for i in prange(rows):
        for j in range(cols):
            top = LOWEST
            for a in range(2 * i, min(2 * i + 2, below.shape[0])):
                for b in range(2 * j, min(2 * j + 2, below.shape[1])):
                    top = max(top, below[a, b])
            out[i, j] = top
