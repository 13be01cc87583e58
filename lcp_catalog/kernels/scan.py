"""Shadows of one azimuth under many elevations, from one pass over the raster.

The raster is oriented so that the Sun stands towards row 0; parallel lines run down it, one through every column of row 0,
shifted by ``shear`` columns a row. Along each line the highest shadow so far is kept: max(height, previous - rise). A node between two lines
takes what the two lines give, interpolated. The first few cells towards the Sun, where that interpolation is worst, are answered
exactly by a stencil of edge crossings. Nodata (NaN) compares false: it casts nothing.

Error against the exact answer: see `Heightfield.sweep_occluded`.
"""

import math

import numpy as np
from numba import njit, prange

LOWEST = np.float32(-1e9)
FAST = {"contract", "reassoc", "nsz"}  # not nnan: NaN must compare false
NEAR_CELLS = 4


def near_stencil(du, dv):
    """Edge crossings of a ray from a node (to u, v direction of unit length) within `NEAR_CELLS` rows or columns.

    Two arrays: (n, 4) row and column offsets of the edge's ends, and (n, 3) the ends' weights and the whole, each divided by
    the distance in cells, so that w0 z0 + w1 z1 - w2 z is the tangent of the crossing's elevation times the cell size.
    """
    reach = NEAR_CELLS / max(abs(du), abs(dv)) + 1e-9
    nodes, weights = [], []
    families = ((du, (0, 1)), (dv, (1, 0)), (du - dv, (1, 1)))
    for rate, kind in families:
        if abs(rate) < 1e-9:
            continue
        for k in range(1, int(reach * abs(rate) + 1e-9) + 1):
            s = k / abs(rate)
            if kind == (0, 1):  # a column line: the edge runs along rows
                col = k if du > 0 else -k
                row = math.floor(dv * s + 1e-12)
                f, end = dv * s - row, (row + 1, col)
            elif kind == (1, 0):  # a row line
                row = k if dv > 0 else -k
                col = math.floor(du * s + 1e-12)
                f, end = du * s - col, (row, col + 1)
            else:  # a diagonal
                col = math.floor(du * s + 1e-12)
                row = col - (k if rate > 0 else -k)
                f, end = du * s - col, (row + 1, col + 1)
            f = max(f, 0.0)
            end = end if f > 1e-9 else (row, col)
            nodes.append((row, col, *end))
            weights.append(((1.0 - f) / s, f / s, 1.0 / s))
    return np.array(nodes, np.int64).reshape(-1, 4), np.array(weights).reshape(-1, 3)


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def _near_row(z, r, first, last, nodes, weights, out):
    """Largest tangent (times the cell) over the stencil for nodes first..last of row r."""
    rows, cols = z.shape
    for q in range(last - first):
        out[q] = LOWEST
    for e in range(nodes.shape[0]):
        ra, ca, rb, cb = r + nodes[e, 0], nodes[e, 1], r + nodes[e, 2], nodes[e, 3]
        if ra < 0 or ra >= rows or rb < 0 or rb >= rows:
            continue
        a = max(first, max(-ca, -cb))
        b = min(last, min(cols - ca, cols - cb))
        if b <= a:
            continue
        wa, wb, w = np.float32(weights[e, 0]), np.float32(weights[e, 1]), np.float32(weights[e, 2])
        za, zb, zr = z[ra, a + ca : b + ca], z[rb, a + cb : b + cb], z[r, a:b]
        part = out[a - first : b - first]
        for q in range(b - a):
            value = wa * za[q] + wb * zb[q] - w * zr[q]
            part[q] = value if value > part[q] else part[q]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def _scan_lines(z, shear, rises, slopes, nodes, weights, line0, line1, answer, out):
    """Lines line0-1 .. line1-1; answers the nodes between lines b-1 and b for b in [line0, line1)."""
    rows, cols = z.shape
    row0, row1, col0, col1 = answer
    count = rises.size
    shadow = np.full((count, line1 - line0 + 1), LOWEST, np.float32)
    near = np.empty(line1 - line0 + 1, np.float32)
    for r in range(row1):
        shift = int(math.floor(shear * r))
        f = np.float32(shear * r - shift)
        g = np.float32(1.0) - f
        zr = z[r]
        first, last = max(col0, line0 + shift), min(col1, line1 + shift)
        if r >= row0 and last > first:
            _near_row(z, r, first, last, nodes, weights, near)
            base = first - shift - line0
            for k in range(count):
                rise, slope = np.float32(rises[k]), np.float32(slopes[k])
                lines, heights = shadow[k, base : base + last - first + 1], zr[first:last]
                answers = out[k, r - row0, first - col0 : last - col0]
                for q in range(last - first):
                    line = g * lines[q + 1] + f * lines[q] - rise
                    answers[q] = (line > heights[q]) | (near[q] > slope)
        a, b = max(line0 - 1, -shift), min(line1 - 1, cols - 2 - shift)
        if b < a:
            continue
        za = zr[a + shift : b + shift + 2]
        for k in range(count):
            rise = np.float32(rises[k])
            lines = shadow[k, a - line0 + 1 : b - line0 + 2]
            for q in range(b - a + 1):
                height, previous = g * za[q] + f * za[q + 1], lines[q] - rise
                lines[q] = height if height > previous else previous


@njit(cache=True, nogil=True, error_model="numpy", parallel=True)
def scan(z, shear, rises, slopes, nodes, weights, blocks, answer, out):
    """out (k, rows, cols) uint8 of the answer window: 1 where a node of z (Sun towards row 0) is in shadow.

    shear: columns a line moves a row; rises (k,): metres the ray climbs a row; slopes (k,): metres a cell of length.
    """
    reach = int(math.floor(shear * (answer[1] - 1)))
    first = answer[2] - max(0, reach) - 1
    last = answer[3] + max(0, -reach) + 2
    size = (last - first + blocks - 1) // blocks
    for block in prange(blocks):
        line0 = first + block * size
        line1 = min(last, line0 + size)
        if line1 > line0:
            _scan_lines(z, shear, rises, slopes, nodes, weights, line0, line1, answer, out)


@njit(cache=True, nogil=True, error_model="numpy", parallel=True)
def turn(masks, transpose, flip, out):
    """Copy masks (k, a, b) back into the raster's own orientation (undo the flip of rows, then the transposition), in tiles."""
    tile = 64
    count, rows, cols = masks.shape
    tiles = (rows + tile - 1) // tile
    for n in prange(count * tiles):
        k, i0 = n // tiles, (n % tiles) * tile
        for j0 in range(0, cols, tile):
            for i in range(i0, min(i0 + tile, rows)):
                target = rows - 1 - i if flip else i
                for j in range(j0, min(j0 + tile, cols)):
                    if transpose:
                        out[k, j, target] = masks[k, i, j]
                    else:
                        out[k, target, j] = masks[k, i, j]
