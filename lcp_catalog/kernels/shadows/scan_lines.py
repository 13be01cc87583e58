"""Parallel lines over the raster towards the Sun, and the highest shadow along each.

The Sun is in the direction of row 0 of the (possibly turned) raster. Lines run down the raster,
``density`` of them for each column, all shifted by ``shear`` columns per row (|shear| <= 1): line
(b, p) lies at column b + p / density + shear r in row r. A point of the surface at height h in row
k shadows points in row r > k on the same line below h - rise (r - k). A line therefore carries only
the highest h + rise k so far, and rounding does not accumulate; rows are counted from an origin
that is moved on (`rebase`) before the numbers grow.

All functions work on a run of neighbouring lines at once, which are shifted by the same fraction of
a cell. Lines outside the raster keep their values. Nodata (NaN) compares false: it casts no shadow.
"""

import math

import numpy as np
from numba import prange

from ..cache import njit
from ..completion import all_done

LOWEST = np.float32(-1e30)
FAST = {"contract", "reassoc", "nsz"}  # not nnan: NaN must compare false
LINES = 512
"""Lines that one task carries down the raster; their values fit into the first-level cache."""

TILE = 64
ON_LINE = 1e-9
"""Distance, in columns, within which a node lies on a line."""


def near_stencil(du, dv, cells, on_node=ON_LINE):
    """Edge crossings of a ray from a node (to u, v direction of unit length) within ``cells`` rows
    or columns.

    Two arrays: (n, 4) row and column offsets of the edge's ends, and (n, 3) the ends' weights and
    the whole, each divided by the distance in cells, so that w0 z0 + w1 z1 - w2 z is the tangent of
    the crossing's elevation times the cell size. A crossing this near a node (``on_node``, in
    cells) is taken to be on it, so that a missing neighbour does not matter.
    """
    reach = cells / max(abs(du), abs(dv)) + 1e-9
    nodes, weights = [], []
    for rate, along in (
        (du, (1, 0)),
        (dv, (0, 1)),
        (du - dv, (1, 1)),
    ):  # column lines, row lines, diagonals
        for k in range(1, int(reach * abs(rate) + 1e-9) + 1):
            s, step = k / abs(rate), k if rate > 0.0 else -k
            if along == (1, 0):
                col, row = step, math.floor(dv * s + on_node)
            else:
                col = math.floor(du * s + on_node)
                row = step if along == (0, 1) else col - step
            f = max(dv * s - row if along == (1, 0) else du * s - col, 0.0)
            end = (row + along[0], col + along[1]) if f > on_node else (row, col)
            nodes.append((row, col, *end))
            weights.append(((1.0 - f) / s, f / s, 1.0 / s))
    return np.array(nodes, np.int64).reshape(-1, 4), np.array(weights, np.float64).reshape(-1, 3)


@njit(nogil=True, error_model="numpy", parallel=True)
def transposed(z):
    """A transposed copy of float32 heights."""
    rows, cols = z.shape
    out = np.empty((cols, rows), np.float32)
    tiles = (cols + TILE - 1) // TILE
    done = 0
    for tile in prange(tiles):
        done += 1
        a0, a1 = tile * TILE, min(tile * TILE + TILE, cols)
        for b0 in range(0, rows, TILE):
            for a in range(a0, a1):
                for b in range(b0, min(b0 + TILE, rows)):
                    out[a, b] = z[b, a]
    all_done(done, tiles)
    return out


@njit(nogil=True, error_model="numpy", inline="always")
def turned_row(z, flip, r):
    """Row r of the raster turned towards the Sun."""
    return z[z.shape[0] - 1 - r if flip else r]


@njit(nogil=True, error_model="numpy", inline="always")
def strip_of(shear, r, density):
    """(shift, p, f) for row r: node c lies between line (c + shift, p) and the next line, a share f
    of the way.
    """
    shift = math.floor(-shear * r)
    place = (-shear * r - shift) * density
    p = min(int(place), density - 1)
    return shift, p, place - p


@njit(nogil=True, error_model="numpy")
def line_range(shear, window):
    """Half-open range of b of the lines beside the nodes of a window (row0, row1, col0, col1)."""
    row0, row1, col0, col1 = window
    a, b = math.floor(-shear * row0), math.floor(-shear * (row1 - 1))
    return col0 + min(a, b), col1 + max(a, b)


@njit(nogil=True, error_model="numpy", fastmath=FAST)
def raise_edge(za, zb, wa, wb, level, carried):
    """Raise each line to a point between two nodes."""
    for q in range(carried.size):
        h = wa * za[q] + (wb * zb[q] + level)
        carried[q] = h if h > carried[q] else carried[q]


@njit(nogil=True, error_model="numpy", fastmath=FAST)
def raise_node(za, level, carried):
    """Raise each line to a node."""
    for q in range(carried.size):
        h = za[q] + level
        carried[q] = h if h > carried[q] else carried[q]


@njit(nogil=True, error_model="numpy", inline="always")
def raise_crossing(above, ja, below, jb, f, level, b0, carried):
    """Raise the lines b0, b0 + 1, ... that cross an edge a share f of the way from node
    above[b + ja] to below[b + jb].
    """
    cols = above.size
    if f == 0.0:  # 0 times NaN is NaN
        first, last = max(b0, -ja), min(b0 + carried.size, cols - ja)
        if last > first:
            part = above[first + ja : last + ja]
            raise_node(part, np.float32(level), carried[first - b0 : last - b0])
        return
    first, last = max(b0, -ja, -jb), min(b0 + carried.size, cols - ja, cols - jb)
    if last > first:
        raise_edge(
            above[first + ja : last + ja],
            below[first + jb : last + jb],
            np.float32(1.0 - f),
            np.float32(f),
            np.float32(level),
            carried[first - b0 : last - b0],
        )


@njit(nogil=True, error_model="numpy", inline="always")
def rebase(carried, drop):
    """Lower all heights by ``drop``, to count them from a later row."""
    flat = carried.reshape(-1)
    for q in range(flat.size):
        flat[q] -= np.float32(drop)


@njit(nogil=True, error_model="numpy", fastmath=FAST)
def _steeper(za, zb, zc, zd, z, wa, wb, wz, wc, wd, wy, out):
    for q in range(out.size):
        one = wa * za[q] + (wb * zb[q] - wz * z[q])
        two = wc * zc[q] + (wd * zd[q] - wy * z[q])
        best = one if one > out[q] else out[q]
        out[q] = two if two > best else best


@njit(nogil=True, error_model="numpy", fastmath=FAST)
def _steeper_one(za, zb, z, wa, wb, wz, out):
    for q in range(out.size):
        one = wa * za[q] + (wb * zb[q] - wz * z[q])
        out[q] = one if one > out[q] else out[q]


@njit(nogil=True, error_model="numpy")
def near_row(z, casting, flip, r, first, last, nodes, weights, out):
    """Largest tangent (times the cell size) over the stencil, float32, for nodes first..last of
    turned row r of z; the edges are those of ``casting`` (z itself, or z without the nodes beside
    nodata).
    """
    rows, cols = z.shape
    out[: last - first] = LOWEST
    count = nodes.shape[0]
    here = turned_row(z, flip, r)
    e = 0
    while e < count:
        # two edges at a time where both are inside for all the nodes: half the stores
        if e + 1 < count:
            left = -min(nodes[e, 1], nodes[e, 3], nodes[e + 1, 1], nodes[e + 1, 3])
            right = max(nodes[e, 1], nodes[e, 3], nodes[e + 1, 1], nodes[e + 1, 3])
            top = r + min(nodes[e, 0], nodes[e, 2], nodes[e + 1, 0], nodes[e + 1, 2])
            low = r + max(nodes[e, 0], nodes[e, 2], nodes[e + 1, 0], nodes[e + 1, 2])
            if first >= left and last + right <= cols and top >= 0 and low < rows:
                f, g = nodes[e], nodes[e + 1]
                w, v = weights[e], weights[e + 1]
                _steeper(
                    turned_row(casting, flip, r + f[0])[first + f[1] : last + f[1]],
                    turned_row(casting, flip, r + f[2])[first + f[3] : last + f[3]],
                    turned_row(casting, flip, r + g[0])[first + g[1] : last + g[1]],
                    turned_row(casting, flip, r + g[2])[first + g[3] : last + g[3]],
                    here[first:last],
                    np.float32(w[0]),
                    np.float32(w[1]),
                    np.float32(w[2]),
                    np.float32(v[0]),
                    np.float32(v[1]),
                    np.float32(v[2]),
                    out[: last - first],
                )
                e += 2
                continue
        ra, ca, rb, cb = r + nodes[e, 0], nodes[e, 1], r + nodes[e, 2], nodes[e, 3]
        a, b = max(first, -ca, -cb), min(last, cols - ca, cols - cb)
        if min(ra, rb) >= 0 and max(ra, rb) < rows and b > a:
            _steeper_one(
                turned_row(casting, flip, ra)[a + ca : b + ca],
                turned_row(casting, flip, rb)[a + cb : b + cb],
                here[a:b],
                np.float32(weights[e, 0]),
                np.float32(weights[e, 1]),
                np.float32(weights[e, 2]),
                out[a - first : b - first],
            )
        e += 1
