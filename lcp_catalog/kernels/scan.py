"""Shadows of one azimuth under many elevations, from one pass over the raster.

The heights are turned so that the Sun stands towards row 0; parallel lines run down them, shifted
by ``shear`` columns a row (|shear| <= 1). Along each line the highest shadow so far is kept:
max(height, previous - rise). A node between two lines takes what the two give, interpolated. The
first cells towards the Sun, where that interpolation is worst, are answered exactly by a stencil of
edge crossings. Nodata (NaN) compares false: it casts nothing.

Error against the exact answer: see `Heightfield.sweep_occluded`.
"""

import math

import numpy as np
from numba import njit, prange

LOWEST = np.float32(-1e30)
FAST = {"contract", "reassoc", "nsz"}  # not nnan: NaN must compare false
NEAR_CELLS = 4
LINES = 512
"""Lines that one task carries down the raster; their state stays in the first cache."""

TILE = 64
SUNS = 8
"""Elevations answered in one pass: one bit each of a byte."""


def near_stencil(du, dv):
    """Edge crossings of a ray from a node (to u, v direction of unit length) within `NEAR_CELLS`
    rows or columns.

    Two arrays: (n, 4) row and column offsets of the edge's ends, and (n, 3) the ends' weights and
    the whole, each divided by the distance in cells, so that w0 z0 + w1 z1 - w2 z is the tangent of
    the crossing's elevation times the cell size.
    """
    reach = NEAR_CELLS / max(abs(du), abs(dv)) + 1e-9
    nodes, weights = [], []
    for rate, along in (
        (du, (1, 0)),
        (dv, (0, 1)),
        (du - dv, (1, 1)),
    ):  # column lines, row lines, diagonals
        for k in range(1, int(reach * abs(rate) + 1e-9) + 1):
            s, step = k / abs(rate), k if rate > 0.0 else -k
            if along == (1, 0):
                col, row = step, math.floor(dv * s + 1e-12)
            else:
                col = math.floor(du * s + 1e-12)
                row = step if along == (0, 1) else col - step
            f = max(dv * s - row if along == (1, 0) else du * s - col, 0.0)
            end = (row + along[0], col + along[1]) if f > 1e-9 else (row, col)
            nodes.append((row, col, *end))
            weights.append(((1.0 - f) / s, f / s, 1.0 / s))
    return np.array(nodes, np.int64).reshape(-1, 4), np.array(weights, np.float64).reshape(-1, 3)


@njit(cache=True, nogil=True, error_model="numpy", parallel=True)
def turned(z, box, transpose, flip):
    """Copy of a box (row0, row1, col0, col1 of the turned raster) of z, transposed and then flipped
    in rows.
    """
    row0, row1, col0, col1 = box
    rows, cols = row1 - row0, col1 - col0
    last = (z.shape[1] if transpose else z.shape[0]) - 1
    out = np.empty((rows, cols), np.float32)
    for tile in prange((rows + TILE - 1) // TILE):
        a0, a1 = tile * TILE, min(tile * TILE + TILE, rows)
        for b0 in range(0, cols, TILE):
            for a in range(a0, a1):
                i = last - (row0 + a) if flip else row0 + a
                for b in range(b0, min(b0 + TILE, cols)):
                    out[a, b] = z[col0 + b, i] if transpose else z[i, col0 + b]
    return out


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def _near_row(z, r, first, last, nodes, weights, out):
    """Largest tangent (times the cell) over the stencil for the nodes first..last of row r of a
    turned copy.
    """
    rows, cols = z.shape
    for q in range(last - first):
        out[q] = LOWEST
    for e in range(nodes.shape[0]):
        ra, ca, rb, cb = r + nodes[e, 0], nodes[e, 1], r + nodes[e, 2], nodes[e, 3]
        if ra < 0 or ra >= rows or rb < 0 or rb >= rows:
            continue
        a, b = max(first, -ca, -cb), min(last, cols - ca, cols - cb)
        if b <= a:
            continue
        wa, wb, w = np.float32(weights[e, 0]), np.float32(weights[e, 1]), np.float32(weights[e, 2])
        za, zb = z[ra][a + ca : b + ca], z[rb][a + cb : b + cb]
        zr, part = z[r][a:b], out[a - first : b - first]
        for q in range(b - a):
            value = wa * za[q] + wb * zb[q] - w * zr[q]
            part[q] = value if value > part[q] else part[q]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def _answer(lines, f, rise, slope, heights, near, bit, bits):
    """Set a bit where the node between two lines, or the stencil, says shadow."""
    g = np.float32(1.0) - f
    for q in range(heights.size):
        line = g * lines[q + 1] + f * lines[q] - rise
        dark = (line > heights[q]) | (near[q] > slope)
        bits[q] |= bit if dark else np.uint8(0)


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def _advance(lines, rise, heights):
    """Carry the lines one row on, over the heights they have there."""
    for q in range(heights.size):
        previous = lines[q] - rise
        lines[q] = heights[q] if heights[q] > previous else previous


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def _sample(row, f, out):
    """Heights under the lines, a share f of the way between two nodes."""
    if f == 0.0:  # 0 times a missing neighbour would be missing
        for q in range(out.size):
            out[q] = row[q]
    else:
        g = np.float32(1.0) - f
        for q in range(out.size):
            out[q] = g * row[q] + f * row[q + 1]


@njit(cache=True, nogil=True, error_model="numpy")
def _scan_lines(z, shear, rises, slopes, nodes, weights, line0, line1, window, bits):
    """Carry lines line0-1 .. line1-1 down; answers the nodes between the lines b-1 and b for b in
    [line0, line1).
    """
    cols = z.shape[1]
    row0, row1, col0, col1 = window
    count = line1 - line0 + 1
    shadow = np.full((rises.size, count), LOWEST, np.float32)
    near, heights = np.empty(count, np.float32), np.empty(count, np.float32)
    for r in range(row1):
        shift = math.floor(shear * r)
        f = np.float32(shear * r - shift)
        first, last = max(col0, line0 + shift), min(col1, line1 + shift)
        answers = r >= row0 and last > first
        if answers:
            _near_row(z, r, first, last, nodes, weights, near)
        # lines outside the raster carry what they had: nothing when they come in, the last shadow
        # when they leave
        a, b = max(line0 - 1, -shift), min(line1, cols - shift - (1 if f > 0.0 else 0))
        if b > a:
            _sample(z[r][a + shift :], f, heights[: b - a])
        for k in range(rises.size):
            lines, rise = shadow[k], np.float32(rises[k])
            if answers:
                base, size = first - shift - line0, last - first
                _answer(
                    lines[base : base + size + 1],
                    f,
                    rise,
                    np.float32(slopes[k]),
                    z[r][first:last],
                    near[:size],
                    np.uint8(1 << k),
                    bits[r - row0][first - col0 : last - col0],
                )
            if b > a:
                _advance(lines[a - line0 + 1 : b - line0 + 1], rise, heights[: b - a])


@njit(cache=True, nogil=True, error_model="numpy", parallel=True)
def scan(z, shear, rises, slopes, nodes, weights, window, bits):
    """Set bit k of bits (rows, cols) uint8, 0 at first, where a node of the window of z (turned) is
    in the shadow of Sun k.

    shear: columns a line moves a row; rises (k <= 8,): metres the ray climbs a row; slopes (k,):
    metres a cell of length.
    """
    reach = math.floor(shear * (window[1] - 1))
    first, last = window[2] - max(0, reach) - 1, window[3] + max(0, -reach) + 2
    for block in prange((last - first + LINES - 1) // LINES):
        line0 = first + block * LINES
        line1 = min(last, line0 + LINES)
        _scan_lines(z, shear, rises, slopes, nodes, weights, line0, line1, window, bits)


@njit(cache=True, nogil=True, error_model="numpy", parallel=True)
def unpack(bits, transpose, flip, out):
    """Bits (a, b) of the turned raster into out (k, rows, cols) uint8 of the raster's own
    orientation.
    """
    count, rows, cols = out.shape
    last = bits.shape[0] - 1
    for band in prange((rows + TILE - 1) // TILE):
        i0, i1 = band * TILE, min(band * TILE + TILE, rows)
        part = np.empty((TILE, TILE), np.uint8)
        for j0 in range(0, cols, TILE):
            j1 = min(j0 + TILE, cols)
            for i in range(i0, i1):
                for j in range(j0, j1):
                    a, b = (j, i) if transpose else (i, j)
                    part[i - i0, j - j0] = bits[last - a if flip else a, b]
            for k in range(count):
                shift = np.uint8(k)
                for i in range(i0, i1):
                    source, target = part[i - i0], out[k, i, j0:j1]
                    for q in range(j1 - j0):
                        target[q] = (source[q] >> shift) & np.uint8(1)
