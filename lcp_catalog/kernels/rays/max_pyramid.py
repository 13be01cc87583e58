"""Max pyramid over the cells of a heightfield, for skipping blocks of cells that a ray passes
above.

Level 1 has the highest node of 2 x 2 cells (3 x 3 nodes), each further level the highest of 2 x 2
values of the level below. There is no level 0: at a single cell a ray reads the nodes. Nodata (NaN)
counts as minus infinity. All levels are stored in sequence in one flat array: 1.33 bytes per node,
besides 4 for the heights.
"""

import numpy as np
from numba import prange

from ..cache import njit
from ..completion import all_done

LOWEST = np.float32(-np.inf)


def build_pyramid(z):
    """(levels, offsets, widths, heights) for float32 heights z (rows >= 2, cols >= 2).

    ``levels``: flat float32; ``offsets``, ``widths``, ``heights``: int64, indexed by level. Entry 0
    has the raster's cells and no values. A raster of one cell has level 0 only.
    """
    shapes = [(z.shape[0] - 1, z.shape[1] - 1)]
    while max(shapes[-1]) > 1:
        shapes.append(((shapes[-1][0] + 1) // 2, (shapes[-1][1] + 1) // 2))
    sizes = [0] + [rows * cols for rows, cols in shapes[1:]]
    offsets = np.concatenate([np.zeros(1, np.int64), np.cumsum(sizes, dtype=np.int64)])[:-1]
    levels = np.empty(max(sum(sizes), 1), dtype=np.float32)
    for level in range(1, len(shapes)):
        out = levels[offsets[level] : offsets[level] + sizes[level]].reshape(shapes[level])
        below = z
        if level > 1:
            below = levels[offsets[level - 1] : offsets[level]].reshape(shapes[level - 1])
        _highest(below, 3 if level == 1 else 2, out)
    heights = np.array([shape[0] for shape in shapes], dtype=np.int64)
    widths = np.array([shape[1] for shape in shapes], dtype=np.int64)
    return levels, offsets, widths, heights


@njit(nogil=True, error_model="numpy", parallel=True)
def _highest(below, side, out):
    """Write the highest of ``side`` x ``side`` values of ``below``, from every second one on, into out; fewer values at the
    far borders.
    """
    done = 0
    for i in prange(out.shape[0]):
        done += 1
        for j in range(out.shape[1]):
            top = LOWEST
            for a in range(2 * i, min(2 * i + side, below.shape[0])):
                for b in range(2 * j, min(2 * j + side, below.shape[1])):
                    if below[a, b] > top:  # noqa: PLR1730  NaN must not win: max(top, NaN) may be NaN
                        top = below[a, b]
            out[i, j] = top
    all_done(done, out.shape[0])


@njit(nogil=True, error_model="numpy")
def extremes(z):
    """(lowest, highest, True if any is NaN) of a raster; (inf, -inf, True) if all are NaN."""
    low, high, holes = np.float32(np.inf), LOWEST, False
    for i in range(z.shape[0]):
        for j in range(z.shape[1]):
            value = z[i, j]
            if np.isnan(value):
                holes = True
            else:
                low, high = min(low, value), max(high, value)
    return low, high, holes
