"""First intersections of rays that leave surface points. Rays and units as in `tracing`."""

import math

from numba import prange

from ..cache import njit
from ..completion import all_done
from .bundles import NODE_LEVEL, on_grid, scaled
from .surface import surface_height
from .tracing import inverse_of, met


@njit(nogil=True, error_model="numpy", parallel=True)
def meetings(z, holes, pyramid, summit, gsd, u, v, directions, out):
    """Write into out (n,) the range, in units of their ENU directions (n, 3), at which rays from the
    surface at column u, row v first meet the surface; NaN without any, for vertical rays, and where
    there is no surface.
    """
    done = 0
    for k in prange(u.size):
        done += 1
        a, b = on_grid(u[k], v[k])
        ground = surface_height(z, a, b)
        du, dv, dz, longest = scaled(directions[k, 0], -directions[k, 1], directions[k, 2] * gsd)
        s = -1.0
        if longest > 0.0 and not math.isnan(ground):
            s = met(
                z, holes, pyramid, summit, a, b, ground, du, dv, dz,
                inverse_of(du), inverse_of(dv), 0.0, NODE_LEVEL,
            )  # fmt: skip
        out[k] = s * gsd / longest if s >= 0.0 else math.nan
    all_done(done, u.size)
