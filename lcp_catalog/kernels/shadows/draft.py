"""Draft shadows: several Suns of one azimuth from one pass of lines over the raster.

Two lines per column carry the shadows of the row crossings; the height of a shadow at a node is
interpolated between the two lines beside it. The first two cells towards the Sun, where that
interpolation is worst, are covered by a stencil of their edge crossings. Approximate: see
`terrain.occlusion.occluded_sweep`.
"""

import math

import numpy as np
from numba import prange

from ..cache import njit
from ..completion import all_done
from .scan_lines import (
    FAST,
    LINES,
    LOWEST,
    TILE,
    line_range,
    near_row,
    raise_crossing,
    raise_node,
    rebase,
    strip_of,
    turned_row,
)

NEAR_CELLS = 2
DENSITY = 2
SUNS = 8
"""Elevations processed in one pass: one bit of a byte for each."""


@njit(nogil=True, error_model="numpy", fastmath=FAST)
def _between(za, zb, wa, wb, out):
    for q in range(out.size):
        out[q] = wa * za[q] + wb * zb[q]


@njit(nogil=True, error_model="numpy", fastmath=FAST)
def _answer(a, b, f, heights, level, near, slope, bit, kept, bits):
    """Set a bit where the lines beside a node, or the stencil, give shadow; of the other bits,
    those in ``kept`` remain.
    """
    g = np.float32(1.0) - f
    for q in range(heights.size):
        dark = (g * a[q] + f * b[q] > heights[q] + level) | (near[q] > slope)
        bits[q] = (bits[q] & kept) | (bit if dark else np.uint8(0))


@njit(nogil=True, error_model="numpy", fastmath=FAST)
def _answer_four(
    a0, b0, a1, b1, a2, b2, a3, b3, w, slope, left, right, f, heights, level, bits
):  # fmt: skip
    """`near_row` for four edges and `_answer` for one Sun, in one pass."""
    g = np.float32(1.0) - f
    w0, v0, t0, w1, v1, t1 = w[0, 0], w[0, 1], w[0, 2], w[1, 0], w[1, 1], w[1, 2]
    w2, v2, t2, w3, v3, t3 = w[2, 0], w[2, 1], w[2, 2], w[3, 0], w[3, 1], w[3, 2]
    for q in range(heights.size):
        z = heights[q]
        dark = g * left[q] + f * right[q] > z + level
        dark |= w0 * a0[q] + (v0 * b0[q] - t0 * z) > slope
        dark |= w1 * a1[q] + (v1 * b1[q] - t1 * z) > slope
        dark |= w2 * a2[q] + (v2 * b2[q] - t2 * z) > slope
        dark |= w3 * a3[q] + (v3 * b3[q] - t3 * z) > slope
        bits[q] = dark


@njit(nogil=True, error_model="numpy")
def _inside(z, nodes):
    """Half-open range of columns, then of rows, for which all edges of a stencil are inside the
    raster.
    """
    low = min(nodes[:, 0].min(), nodes[:, 2].min())
    high = max(nodes[:, 0].max(), nodes[:, 2].max())
    left = min(nodes[:, 1].min(), nodes[:, 3].min())
    right = max(nodes[:, 1].max(), nodes[:, 3].max())
    return -left, z.shape[1] - right, -low, z.shape[0] - high


@njit(nogil=True, error_model="numpy")
def _carry(z, flip, shear, rises, k, origin, b0, carried, heights):
    """Raise all lines to their crossings of turned row k."""
    cols, row = z.shape[1], turned_row(z, flip, k)
    for p in range(DENSITY):
        x = p / DENSITY + shear * k
        shift = math.floor(x)
        f = x - shift
        if rises.size == 1:
            level = rises[0] * (k - origin)
            raise_crossing(row, shift, row, shift + 1, f, level, b0, carried[0, p])
            continue
        first = max(b0, -shift)
        last = min(b0 + carried.shape[2], cols - shift - (1 if f > 0.0 else 0))
        if last <= first:
            continue
        part = heights[: last - first]
        if f == 0.0:
            part[:] = row[first + shift : last + shift]
        else:
            after = row[first + shift + 1 : last + shift + 1]
            _between(
                row[first + shift : last + shift], after, np.float32(1.0 - f), np.float32(f), part
            )
        for s in range(rises.size):
            level = np.float32(rises[s] * (k - origin))
            raise_node(part, level, carried[s, p, first - b0 : last - b0])


@njit(nogil=True, error_model="numpy")
def _scan_lines(
    z, flip, shear, rises, slopes, nodes, weights, stride, top, window, upright, awake, line0, line1, bits
):  # fmt: skip
    """Process the nodes beside the lines line0 .. line1 - 1 of a window."""
    row0, row1, col0, col1 = window
    b0, count = line0, line1 - line0 + 1
    carried = np.full((rises.size, DENSITY, count), LOWEST, np.float32)
    near, heights = np.empty(count, np.float32), np.empty(count, np.float32)
    origin = top
    four = rises.size == 1 and nodes.shape[0] == 4
    box, weights32 = _inside(z, nodes), weights.astype(np.float32)
    for r in range(top, row1):
        if r - origin >= stride:
            for s in range(rises.size):
                rebase(carried[s], rises[s] * (r - origin))
            origin = r
        if not awake[r // TILE]:
            shift = math.floor(-shear * r)
            first, last = max(col0, line0 - shift), min(col1, line1 - shift)
            if r >= row0 and last > first:
                row = row1 - 1 - r if upright and flip else r - row0
                bits[row, first - col0 : last - col0] = 0
            continue
        if r - NEAR_CELLS >= top:  # nearer rows are covered by the stencil
            _carry(z, flip, shear, rises, r - NEAR_CELLS, origin, b0, carried, heights)
        shift, p, f = strip_of(shear, r, DENSITY)
        first, last = max(col0, line0 - shift), min(col1, line1 - shift)
        if r >= row0 and last > first:
            q, size = first + shift - b0, last - first
            here = turned_row(z, flip, r)[first:last]
            if four and first >= box[0] and last <= box[1] and box[2] <= r < box[3]:
                row = row1 - 1 - r if upright and flip else r - row0
                _answer_four(
                    turned_row(z, flip, r + nodes[0, 0])[first + nodes[0, 1] : last + nodes[0, 1]],
                    turned_row(z, flip, r + nodes[0, 2])[first + nodes[0, 3] : last + nodes[0, 3]],
                    turned_row(z, flip, r + nodes[1, 0])[first + nodes[1, 1] : last + nodes[1, 1]],
                    turned_row(z, flip, r + nodes[1, 2])[first + nodes[1, 3] : last + nodes[1, 3]],
                    turned_row(z, flip, r + nodes[2, 0])[first + nodes[2, 1] : last + nodes[2, 1]],
                    turned_row(z, flip, r + nodes[2, 2])[first + nodes[2, 3] : last + nodes[2, 3]],
                    turned_row(z, flip, r + nodes[3, 0])[first + nodes[3, 1] : last + nodes[3, 1]],
                    turned_row(z, flip, r + nodes[3, 2])[first + nodes[3, 3] : last + nodes[3, 3]],
                    weights32, np.float32(slopes[0]), carried[0, p, q : q + size],
                    carried[0, p + 1, q : q + size] if p + 1 < DENSITY else carried[0, 0, q + 1 : q + 1 + size],
                    np.float32(f), here, np.float32(rises[0] * (r - origin)),
                    bits[row, first - col0 : last - col0],
                )  # fmt: skip
                continue
            near_row(z, z, flip, r, first, last, nodes, weights, near)
            for s in range(rises.size):
                a = carried[s, p, q : q + size]
                b = (
                    carried[s, p + 1, q : q + size]
                    if p + 1 < DENSITY
                    else carried[s, 0, q + 1 : q + 1 + size]
                )
                _answer(
                    a,
                    b,
                    np.float32(f),
                    here,
                    np.float32(rises[s] * (r - origin)),
                    near[:size],
                    np.float32(slopes[s]),
                    np.uint8(1 << s),
                    np.uint8(0 if s == 0 else 255),
                    bits[
                        row1 - 1 - r if upright and flip else r - row0, first - col0 : last - col0
                    ],
                )


@njit(nogil=True, error_model="numpy", parallel=True)
def draft(
    z, flip, shear, rises, slopes, nodes, weights, stride, top, window, upright, awake, bits
):  # fmt: skip
    """Set bit s of bits (rows, cols) uint8 where a node of the window of z (turned) is in the
    shadow of Sun s, and clear the others; ``upright``: rows as in the raster, not turned towards
    the Sun.

    shear: columns by which a line moves per row; rises (s <= 8,): metres by which the ray climbs
    per row; slopes (s,): metres per cell of length; stride: rows after which heights are rebased;
    top: the first row that can cast a shadow.
    """
    first, last = line_range(shear, window)
    blocks = (last - first + LINES - 1) // LINES
    done = 0
    for block in prange(blocks):
        done += 1
        line0 = first + block * LINES
        line1 = min(last, line0 + LINES)
        _scan_lines(
            z,
            flip,
            shear,
            rises,
            slopes,
            nodes,
            weights,
            stride,
            top,
            window,
            upright,
            awake[block],
            line0,
            line1,
            bits,
        )
    all_done(done, blocks)


@njit(nogil=True, error_model="numpy", parallel=True)
def unpack(bits, transpose, flip, out):
    """Write bits (a, b), rows upright unless ``transpose``, into out (k, rows, cols) uint8 in the
    raster's orientation; ``flip``: direction of the rows of a transposed window.
    """
    count, rows, cols = out.shape
    last = bits.shape[0] - 1
    bands = (rows + TILE - 1) // TILE
    done = 0
    for band in prange(bands):
        done += 1
        i0, i1 = band * TILE, min(band * TILE + TILE, rows)
        part = np.empty((TILE, TILE), np.uint8)
        for j0 in range(0, cols, TILE):
            j1 = min(j0 + TILE, cols)
            if transpose:
                for j in range(j0, j1):
                    source = bits[last - j if flip else j, i0:i1]
                    for i in range(i1 - i0):
                        part[i, j - j0] = source[i]
            else:
                part[: i1 - i0, : j1 - j0] = bits[i0:i1, j0:j1]
            for k in range(count):
                shift = np.uint8(k)
                for i in range(i0, i1):
                    source, target = part[i - i0], out[k, i, j0:j1]
                    for q in range(j1 - j0):
                        target[q] = (source[q] >> shift) & np.uint8(1)
    all_done(done, bands)
