"""A camera that moves during the exposure: nodes towards it, each in a direction of its own, and its
lines towards the surface, each from a position of its own.

Rays and units as in `tracing`.
"""

import math

from numba import prange

from ..cache import njit
from ..completion import all_done
from .bundles import NODE_LEVEL, approach, hit_from, on_grid, scaled
from .surface import node_exists
from .tracing import NEVER, blocked


@njit(nogil=True, error_model="numpy", parallel=True)
def occluded_nodes(z, holes, pyramid, summit, gsd, directions, window, out):
    """Write True into out for nodes of the window where the surface rises above the ray along their
    ENU direction (rows, cols, 3); nodata and directions with NaN: False.
    """
    row0, row1, col0, col1 = window
    done = 0
    for i in prange(row0, row1):
        done += 1
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
    all_done(done, row1 - row0)


@njit(nogil=True, error_model="numpy", parallel=True)
def first_hits(z, holes, pyramid, summit, origins, gsd, directions, out):
    """Write the first hits of rays along ENU directions (rows, cols, 3) into out (rows, cols), those of a
    row from its own point of ``origins`` (rows, 3): `bundles.first_hits`.
    """
    done = 0
    for i in prange(out.shape[0]):
        done += 1
        ou, ov = on_grid(origins[i, 0], origins[i, 1])
        oz = origins[i, 2]
        for j in range(out.shape[1]):
            east, north, up = directions[i, j]
            du, dv, dz, inverse_u, inverse_v, inverse_z, length, first, u, v, height = approach(
                z.shape[0], z.shape[1], summit, ou, ov, oz, east, north, up, gsd
            )
            out[i, j] = hit_from(
                z, holes, pyramid, summit, oz, math.inf,
                du, dv, dz, inverse_u, inverse_v, inverse_z, length, first, u, v, height,
            )  # fmt: skip
    all_done(done, out.shape[0])
