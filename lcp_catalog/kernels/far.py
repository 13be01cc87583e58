"""Shadows of far terrain on the nodes of an area, from the heights to which they reach over a few
of its places.
"""

import math

from numba import njit, prange

LIT, DARK, OPEN = 0, 1, 2


@njit(cache=True, nogil=True, error_model="numpy", parallel=True)
def shade(z, window, step, heights, doubt, marks):
    """Mark the window's nodes: dark where they lie below the shadow's height, interpolated between
    its places, ``step`` nodes apart from the window's first node on (``heights``: rows, columns of
    places); `OPEN` where that is no further than ``doubt`` times the difference between the highest
    and the lowest of the four places around it from their range. Nodata is lit; dark ones stay.
    """
    row0, row1, col0, col1 = window
    for k in prange(row1 - row0):
        a = min(k // step, heights.shape[0] - 2)
        fa = (k - a * step) / step
        for m in range(col1 - col0):
            if marks[k, m] == DARK:
                continue
            here = z[row0 + k, col0 + m]
            b = min(m // step, heights.shape[1] - 2)
            fb = (m - b * step) / step
            h00, h01 = heights[a, b], heights[a, b + 1]
            h10, h11 = heights[a + 1, b], heights[a + 1, b + 1]
            mark = LIT
            if doubt > 0.0:
                low, high = min(h00, h01, h10, h11), max(h00, h01, h10, h11)
                slack = doubt * (high - low)
                if here < low - slack:
                    mark = DARK
                elif here < high + slack:
                    mark = OPEN
            else:
                upper, lower = h00 + (h01 - h00) * fb, h10 + (h11 - h10) * fb
                if here < upper + (lower - upper) * fa:
                    mark = DARK
            if not math.isnan(here):
                marks[k, m] = mark
