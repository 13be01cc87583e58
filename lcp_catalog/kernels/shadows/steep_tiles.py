"""Tiles of a raster that can cast a shadow under a high Sun: those with a facet steeper than its
rays.

A ray gets below the surface through a facet that is steeper than the ray, and the height of the
surface above the ray is greatest at the upper edge of such a facet. A tile without such a facet
casts no shadow, and a stretch of lines is lit if no such tile lies within reach of its shadow.
Beside nodata there may be cliffs: such tiles count as steep.
"""

import math

import numpy as np
from numba import prange

from ..cache import njit
from ..completion import all_done
from .scan_lines import TILE, line_range

STEEPER = 1.0 - 1e-5
"""Factor on slopes that exceeds the rounding of float32 heights and of the stencil's tangents by
far.
"""


@njit(nogil=True, error_model="numpy", parallel=True)
def tile_gradients(z):
    """Greatest gradient of the facets that touch each tile of `TILE` x `TILE` nodes, metres per
    cell, 0 without any; and True if one of their nodes has no height.
    """
    rows, cols = z.shape
    shape = ((rows + TILE - 1) // TILE, (cols + TILE - 1) // TILE)
    gradients, holed = np.zeros(shape), np.zeros(shape, np.bool_)
    done = 0
    for band in prange(shape[0]):
        done += 1
        for column in range(shape[1]):
            most = 0.0
            for i in range(max(band * TILE - 1, 0), min(band * TILE + TILE, rows - 1)):
                for j in range(max(column * TILE - 1, 0), min(column * TILE + TILE, cols - 1)):
                    z00, z11 = np.float64(z[i, j]), np.float64(z[i + 1, j + 1])
                    z01, z10 = np.float64(z[i, j + 1]), np.float64(z[i + 1, j])
                    upper = (z01 - z00) ** 2 + (z11 - z01) ** 2
                    lower = (z10 - z00) ** 2 + (z11 - z10) ** 2
                    most = upper if upper > most else most  # False for NaN
                    most = lower if lower > most else most
                    holed[band, column] |= math.isnan(upper + lower)
            gradients[band, column] = math.sqrt(most)
    all_done(done, shape[0])
    return gradients, holed


@njit(nogil=True, error_model="numpy")
def _casts(gradients, transpose, flip, shape, rows, cols, slope):
    """True if a box of turned rows and columns touches a tile that can cast a shadow."""
    row0, row1 = rows
    if flip:
        row0, row1 = shape[0] - row1, shape[0] - row0
    low, high = max(row0, 0) // TILE, (min(row1, shape[0]) - 1) // TILE
    left, right = max(cols[0], 0) // TILE, (min(cols[1], shape[1]) - 1) // TILE
    for a in range(low, high + 1):
        for b in range(left, right + 1):
            if (gradients[b, a] if transpose else gradients[a, b]) >= slope:
                return True
    return False


@njit(nogil=True, error_model="numpy")
def awake(gradients, transpose, flip, shape, shear, slope, reach, top, window, width):
    """True for stretches of `TILE` turned rows (counted from row 0) of each block of ``width``
    lines that may contain a shadow, bool (blocks, stretches).

    shape: of the turned raster; slope: metres per cell by which the lowest rays climb; reach: rows
    after which they are above all terrain; blocks are counted from the window's first line.
    """
    first, last = line_range(shear, window)
    blocks, stretches = (last - first + width - 1) // width, (shape[0] + TILE - 1) // TILE
    out = np.zeros((blocks, stretches), np.bool_)
    for block in range(blocks):
        line0, line1 = first + block * width, min(last, first + block * width + width)
        cast = -(1 << 60)
        for k in range(top // TILE, stretches):
            row0, row1 = k * TILE, min(k * TILE + TILE, shape[0])
            a, b = math.floor(-shear * row0), math.floor(-shear * (row1 - 1))
            cols = (line0 - max(a, b) - 2, line1 - min(a, b) + 3)
            if _casts(
                gradients, transpose, flip, shape, (row0 - 1, row1 + 1), cols, slope * STEEPER
            ):
                cast = row1 + 1
            out[block, k] = row0 - cast <= reach
    return out
