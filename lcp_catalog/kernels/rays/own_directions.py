"""Nodes towards a camera that moves during the exposure: every node has a direction of its own.

Rays and units as in `tracing`.
"""

import math

from numba import njit, prange

from .bundles import NODE_LEVEL, scaled
from .surface import node_exists
from .tracing import NEVER, blocked


@njit(cache=True, nogil=True, error_model="numpy", parallel=True)
def occluded_nodes(z, holes, pyramid, summit, gsd, directions, window, out):
    """Write True into out for nodes of the window where the surface rises above the ray along their
    ENU direction (rows, cols, 3); nodata and directions with NaN: False.
    """
    row0, row1, col0, col1 = window
    for i in prange(row0, row1):
        for j in range(col0, col1):
            east, north, up = directions[i - row0, j - col0]
            hidden = False
            if math.isfinite(east + north + up) and not math.isnan(z[i, j]):
                du, dv, dz, longest = scaled(east, -north, up * gsd)
                if longest == 0.0:
                    hidden = dz < 0.0 and node_exists(z, i, j)
                else:
                    hidden = blocked(
                        z, holes, pyramid, summit, float(j), float(i), float(z[i, j]),
                        du, dv, dz, NEVER, NODE_LEVEL,
                    )  # fmt: skip
            out[i - row0, j - col0] = hidden
