"""Shadows of far terrain on the nodes of an area, interpolated from their heights over a lattice of
places.
"""

from numba import prange

from ..cache import njit
from ..completion import all_done

LIT, DARK, OPEN = 0, 1, 2


@njit(nogil=True, error_model="numpy", parallel=True)
def shade(z, window, step, heights, doubt, marks):
    """Mark the window's nodes that are not `DARK` yet: `DARK` below the shadow's heights over the
    four places around them, `OPEN` between these heights or within ``doubt`` times their range,
    `LIT` above. Places lie ``step`` nodes apart, from the window's first node on (``heights``:
    rows, columns of places). Nodata is lit.
    """
    row0, row1, col0, col1 = window
    done = 0
    for k in prange(row1 - row0):
        done += 1
        a = min(k // step, heights.shape[0] - 2)
        for m in range(col1 - col0):
            if marks[k, m] == DARK:
                continue
            b = min(m // step, heights.shape[1] - 2)
            h00, h01 = heights[a, b], heights[a, b + 1]
            h10, h11 = heights[a + 1, b], heights[a + 1, b + 1]
            low, high = min(h00, h01, h10, h11), max(h00, h01, h10, h11)
            slack = doubt * (high - low)
            here = z[row0 + k, col0 + m]
            if here < low - slack:
                marks[k, m] = DARK
            elif here < high + slack:
                marks[k, m] = OPEN
            else:
                marks[k, m] = LIT
    all_done(done, row1 - row0)
