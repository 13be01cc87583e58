"""Fragments of the surface traced as if each were all the terrain there is: what a navigator sees of a patch alone.

A fragment is small, so every ray walks its cells one by one; the edge tests are those of `tracing`.
"""

import math

import numpy as np
from numba import njit, prange

from .tracing import NEVER, _crossing, _unit, node_exists


@njit(cache=True, nogil=True, error_model="numpy")
def walk(z, holes, summit, j, i, du, dv, dz):
    """Whether the surface z, nowhere above ``summit``, rises above the ray that leaves node (i, j); (du, dv) not both 0."""
    rows, cols = z.shape
    oz = float(z[i, j])
    right, down = (1 if du > 0.0 else 0), (1 if dv > 0.0 else 0)
    col = min(j if du >= 0.0 else j - 1, cols - 2)
    row = min(i if dv >= 0.0 else i - 1, rows - 2)
    if col < 0 or row < 0 or (du > 0.0 and j == cols - 1) or (dv > 0.0 and i == rows - 1):
        return False
    across, s = du - dv, 0.0
    while True:
        s_u = (col + right - j) / du if du != 0.0 else NEVER
        s_v = (row + down - i) / dv if dv != 0.0 else NEVER
        s_out = min(s_u, s_v)
        if across != 0.0:
            s_diagonal = ((col - row) - (j - i)) / across
            if s < s_diagonal < s_out:
                f = _unit(j + du * s_diagonal - col)
                if _crossing(z, holes, row, col, row + 1, col + 1, f) > oz + dz * s_diagonal:
                    return True
        if s_u < s_v:
            edge, f = col + right, _unit(i + dv * s_out - row)
            height = _crossing(z, holes, row, edge, row + 1, edge, f)
        else:
            edge, f = row + down, _unit(j + du * s_out - col)
            height = _crossing(z, holes, edge, col, edge, col + 1, f)
        if s_out > 0.0 and height > oz + dz * s_out:
            return True
        s = s_out
        if dz > 0.0 and oz + dz * s > summit:
            return False
        if s_u < s_v:
            col += 1 if du > 0.0 else -1
        else:
            row += 1 if dv > 0.0 else -1
        if col < 0 or row < 0 or col > cols - 2 or row > rows - 2:
            return False


@njit(cache=True, nogil=True, error_model="numpy", parallel=True)
def occluded_alone(z, rows, cols, half, du, dv, dz, out):
    """out (n, size, size): for every node of each fragment, whether the fragment itself rises above its ray."""
    size = 2 * half + 1
    for n in prange(rows.size):
        part = np.full((size, size), np.float32(np.nan), np.float32)
        holes, summit = False, -np.inf
        for a in range(size):
            for b in range(size):
                i, j = rows[n] - half + a, cols[n] - half + b
                if 0 <= i < z.shape[0] and 0 <= j < z.shape[1]:
                    part[a, b] = z[i, j]
                holes |= math.isnan(part[a, b])
                if part[a, b] > summit:
                    summit = float(part[a, b])
        for a in range(size):
            for b in range(size):
                hit = False
                if not math.isnan(part[a, b]):
                    if du == 0.0 and dv == 0.0:
                        hit = dz < 0.0 and node_exists(part, a, b)
                    else:
                        hit = walk(part, holes, summit, b, a, du, dv, dz)
                out[n, a, b] = hit
