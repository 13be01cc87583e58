"""Occlusion within patches of the surface, each traced without the terrain around it."""

import math

import numpy as np
from numba import njit, prange

from .max_pyramid import extremes
from .surface import node_exists
from .tracing import NEVER, blocked


@njit(cache=True, nogil=True, error_model="numpy")
def _trace_part(part, du, dv, dz, row, col, out):
    """Write the occlusion of the nodes of one patch into out, from (row, col) on."""
    rows, cols = part.shape
    _, summit, holes = extremes(part)
    # a pyramid without levels: a patch is small, so every ray walks its cells one by one
    pyramid = (
        np.empty(1, np.float32),
        np.zeros(1, np.int64),
        np.full(1, cols - 1, np.int64),
        np.full(1, rows - 1, np.int64),
    )
    for i in range(rows):
        for j in range(cols):
            oz = np.float64(part[i, j])
            if math.isnan(oz):
                continue
            if du == 0.0 and dv == 0.0:
                out[row + i, col + j] = dz < 0.0 and node_exists(part, i, j)
            else:
                out[row + i, col + j] = blocked(
                    part, holes, pyramid, float(summit), float(j), float(i),
                    oz, du, dv, dz, NEVER, 0,
                )  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy", parallel=True)
def occluded_alone(z, rows, cols, half, du, dv, dz, out):
    """Set out (n, size, size), initially False, to True for nodes of each patch where the patch
    itself rises above their ray.
    """
    for n in prange(rows.size):
        row0, row1 = max(rows[n] - half, 0), min(rows[n] + half + 1, z.shape[0])
        col0, col1 = max(cols[n] - half, 0), min(cols[n] + half + 1, z.shape[1])
        if row1 - row0 > 1 and col1 - col0 > 1:
            part = z[row0:row1, col0:col1].copy()
            _trace_part(part, du, dv, dz, row0 - rows[n] + half, col0 - cols[n] + half, out[n])
