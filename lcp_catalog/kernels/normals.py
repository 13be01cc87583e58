"""Normals of nodes, and heights and normals between them."""

import math

import numpy as np
from numba import njit, prange

from .tracing import node_exists, surface_height


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _slope(before, here, after, length):
    """Derivative from up to three heights; NaN when both neighbours are missing."""
    if math.isnan(before):
        return (after - here) / length
    if math.isnan(after):
        return (here - before) / length
    return (after - before) / (2.0 * length)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _normal(z, i, j, gsd):
    """Unit normal (east, north, up) of node (i, j), NaN where it has none."""
    rows, cols = z.shape
    here = float(z[i, j])
    west = float(z[i, j - 1]) if j > 0 else math.nan
    east = float(z[i, j + 1]) if j + 1 < cols else math.nan
    north = float(z[i - 1, j]) if i > 0 else math.nan
    south = float(z[i + 1, j]) if i + 1 < rows else math.nan
    a, b = _slope(west, here, east, gsd), _slope(south, here, north, gsd)
    if math.isnan(here):
        a = math.nan
    length = math.sqrt(a * a + b * b + 1.0)
    return -a / length, -b / length, 1.0 / length


@njit(cache=True, nogil=True, error_model="numpy", parallel=True)
def node_normals(z, gsd, window, out):
    """Normals of a window's nodes into out (rows, cols, 3)."""
    row0, row1, col0, col1 = window
    for k in prange(row1 - row0):
        for j in range(col0, col1):
            n = _normal(z, row0 + k, j, gsd)
            out[k, j - col0, 0] = n[0]
            out[k, j - col0, 1] = n[1]
            out[k, j - col0, 2] = n[2] if not math.isnan(n[0] + n[1]) else np.nan


@njit(cache=True, nogil=True, error_model="numpy")
def existing_nodes(z, window, out):
    """Which nodes of a window belong to a triangle."""
    row0, row1, col0, col1 = window
    for i in range(row0, row1):
        for j in range(col0, col1):
            out[i - row0, j - col0] = not math.isnan(z[i, j]) and node_exists(z, i, j)


@njit(cache=True, nogil=True, error_model="numpy", parallel=True)
def surface_heights(z, u, v, out):
    """Heights of the surface at (u, v) inside the raster."""
    for k in prange(u.size):
        out[k] = surface_height(z, u[k], v[k])


@njit(cache=True, nogil=True, error_model="numpy", parallel=True)
def surface_normals(z, gsd, u, v, out):
    """Node normals interpolated over the triangle at (u, v), unit length."""
    rows, cols = z.shape
    for k in prange(u.size):
        j = min(max(int(math.floor(u[k])), 0), cols - 2)
        i = min(max(int(math.floor(v[k])), 0), rows - 2)
        x, y = u[k] - j, v[k] - i
        if x >= y:
            a, b, c = _normal(z, i, j, gsd), _normal(z, i, j + 1, gsd), _normal(z, i + 1, j + 1, gsd)
            wa, wb, wc = 1.0 - x, x - y, y
        else:
            a, b, c = _normal(z, i, j, gsd), _normal(z, i + 1, j, gsd), _normal(z, i + 1, j + 1, gsd)
            wa, wb, wc = 1.0 - y, y - x, x
        n0 = wa * a[0] + wb * b[0] + wc * c[0]
        n1 = wa * a[1] + wb * b[1] + wc * c[1]
        n2 = wa * a[2] + wb * b[2] + wc * c[2]
        length = math.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
        out[k, 0], out[k, 1], out[k, 2] = n0 / length, n1 / length, n2 / length
