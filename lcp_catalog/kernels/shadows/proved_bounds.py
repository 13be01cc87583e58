"""Two bounds on the shadow at each node, and exact rays for the nodes that they leave undecided.

Every node lies in a strip between two neighbouring lines (`scan_lines`), and so does its ray to the
Sun.
Write g = h + rise k for a point of the surface at height h in row k (k not whole between rows): the
node at height z in row r is in shadow if and only if g > z + rise r somewhere on its ray, in a
row k < r.

*Upper bound.* The surface and g are linear within every triangle, so along the ray g is greatest at
a crossing of an edge. The part of that edge inside the closed strip is a segment; its ends are
crossings of the edge with one of the two lines, or nodes inside the strip. g is linear along the
segment, so at the ray's crossing it is at most the greater of the two ends. Hence

    max g on the ray  <=  max(all crossings of the left line, all of the right line, nodes inside).

Each line carries *all* its crossings (row edges, column edges, diagonals), each strip its nodes.
The ends of the raster cut segments only at nodes.

*Lower bound.* In each row the ray crosses row edges between the two lines' crossings, where the
surface is not below the lower one of them, nor below a node that lies between:

    max g on the ray  >=  max over rows k of min(left, right, node between).

Both hold for rows k <= r - N; the crossings nearer than N rows are tested one by one (the stencil
of `scan_lines`). Beside nodata an edge may belong to no triangle: it may be used in an upper bound,
not in a lower one; ``sure`` is the raster without the nodes beside nodata.

Arithmetic is float32; ``slack`` and ``near_slack`` bound its rounding
(`terrain.occlusion.slacks`); nodes within them are left undecided.
"""

import math

import numpy as np
from numba import prange

from ..cache import njit
from ..completion import all_done
from ..rays.tracing import NEVER, blocked
from .scan_lines import (
    FAST,
    LINES,
    LOWEST,
    ON_LINE,
    TILE,
    line_range,
    near_row,
    raise_crossing,
    rebase,
    strip_of,
    turned_row,
)

LIT, DARK, OPEN = np.uint8(0), np.uint8(1), np.uint8(2)
NODE_LEVEL = 1


@njit(nogil=True, error_model="numpy", fastmath=FAST)
def _raise_lowest(za, zb, zc, zd, zn, wa, wb, wc, wd, level, floor):
    """Raise each strip to the lowest of two crossings and a node."""
    for q in range(floor.size):
        left = wa * za[q] + (wb * zb[q] + level)
        right = wc * zc[q] + (wd * zd[q] + level)
        node = zn[q] + level
        low = left if left < right else right
        low = low if low < node else node
        floor[q] = low if low > floor[q] else floor[q]


@njit(nogil=True, error_model="numpy", fastmath=FAST)
def _raise_lower(za, zb, zc, zd, wa, wb, wc, wd, level, floor):
    """Raise each strip to the lower of two crossings."""
    for q in range(floor.size):
        left = wa * za[q] + (wb * zb[q] + level)
        right = wc * zc[q] + (wd * zd[q] + level)
        low = left if left < right else right
        floor[q] = low if low > floor[q] else floor[q]


@njit(nogil=True, error_model="numpy", fastmath=FAST)
def _mark(
    left, right, inside, floor, heights, level, near, near_sure, slope, slack, near_slack, out
):
    for q in range(heights.size):
        ray = heights[q] + level
        highest = left[q] if left[q] > right[q] else right[q]
        highest = highest if highest > inside[q] else inside[q]
        dark = (floor[q] > ray + slack) | (near_sure[q] > slope + near_slack)
        lit = (highest < ray - slack) & (near[q] < slope - near_slack)
        out[q] = DARK if dark else (LIT if lit else OPEN)


@njit(nogil=True, error_model="numpy", fastmath=FAST)
def _mark_likely(left, right, inside, heights, level, near, slope, slack, near_slack, out):
    """`_mark` without a lower bound: dark where both lines give shadow."""
    for q in range(heights.size):
        ray = heights[q] + level
        highest = left[q] if left[q] > right[q] else right[q]
        lowest = left[q] if left[q] < right[q] else right[q]
        highest = highest if highest > inside[q] else inside[q]
        dark = (lowest > ray + slack) | (near[q] > slope + near_slack)
        lit = (highest < ray - slack) & (near[q] < slope - near_slack)
        out[q] = DARK if dark else (LIT if lit else OPEN)


@njit(nogil=True, error_model="numpy")
def _carry_line(z, flip, shear, rise, sigma, density, p, k, top, origin, b0, carried, inside):
    """Raise line p of every column to all its crossings between turned rows k - 1 and k, and the
    strip beside it to the nodes of row k.
    """
    row = turned_row(z, flip, k)
    x = p / density + shear * k
    shift = math.floor(x)
    f = x - shift
    raise_crossing(row, shift, row, shift + 1, f, rise * (k - origin), b0, carried)
    if f + 1.0 / density >= 1.0 - ON_LINE:
        raise_crossing(row, shift + 1, row, shift + 1, 0.0, rise * (k - origin), b0, inside)
    if f <= ON_LINE:
        raise_crossing(row, shift, row, shift, 0.0, rise * (k - origin), b0, inside)
    if k == top:
        return
    above, x0 = turned_row(z, flip, k - 1), x - shear
    # column edges lie at whole x, diagonals at whole x - sigma t; at most one and two of them
    for lean in (0, sigma):
        rate = shear - lean
        low, high = min(x0, x0 + rate), max(x0, x0 + rate)
        n = math.floor(low) + 1
        while n < high:
            t = (n - x0) / rate
            level = rise * (k - 1 + t - origin)
            raise_crossing(above, n, row, n + lean, t, level, b0, carried)
            n += 1


@njit(nogil=True, error_model="numpy")
def _carry_floor(sure, flip, shear, rise, density, p, k, origin, b0, floor):
    """Raise the strip beside line p to the lower bound of the surface there in turned row k."""
    cols, row = sure.shape[1], turned_row(sure, flip, k)
    x = p / density + shear * k
    y = x + 1.0 / density
    i, j = math.floor(x), math.floor(y)
    f, g = x - i, y - j
    level = np.float32(rise * (k - origin))
    node, between = i, f <= ON_LINE
    if f + 1.0 / density >= 1.0 - ON_LINE:
        node, between = i + 1, True
    first, last = max(b0, -i, -j), min(b0 + floor.size, cols - i - 1, cols - j - 1)
    if last <= first:
        return
    left, after_left = row[first + i : last + i], row[first + i + 1 : last + i + 1]
    right, after_right = row[first + j : last + j], row[first + j + 1 : last + j + 1]
    wa, wb, wc, wd = np.float32(1.0 - f), np.float32(f), np.float32(1.0 - g), np.float32(g)
    part = floor[first - b0 : last - b0]
    if between:
        inside = row[first + node : last + node]
        _raise_lowest(left, after_left, right, after_right, inside, wa, wb, wc, wd, level, part)
    else:
        _raise_lower(left, after_left, right, after_right, wa, wb, wc, wd, level, part)


@njit(nogil=True, error_model="numpy")
def _bound_lines(
    z, sure, proved, unlike, flip, sun, density, cells, stencil, sure_stencil, slacks, rows, window, lines, marks
):  # fmt: skip
    """Process the nodes beside the lines lines[0] .. lines[1] - 1 of a window."""
    row0, row1, col0, col1 = window
    shear, rise, slope, sigma = sun
    slack, near_slack = np.float32(slacks[0]), np.float32(slacks[1])
    top, stride = rows
    line0, line1 = lines
    b0, count = line0, line1 - line0 + 1
    carried = np.full((density, count), LOWEST, np.float32)
    inside = np.full((density, count), LOWEST, np.float32)
    floor = np.full((density, count), LOWEST, np.float32)
    near = np.empty(count, np.float32)
    near_sure = np.empty(count, np.float32) if unlike else near
    origin = top
    for r in range(top, row1):
        k = r - cells
        if k - origin >= stride:
            for part in (carried, inside, floor):
                rebase(part, rise * (k - origin))
            origin = k
        if k >= top:
            for p in range(density):
                _carry_line(
                    z, flip, shear, rise, sigma, density, p, k, top, origin, b0, carried[p], inside[p]
                )  # fmt: skip
                if proved:
                    _carry_floor(sure, flip, shear, rise, density, p, k, origin, b0, floor[p])
        shift, p, _ = strip_of(shear, r, density)
        first, last = max(col0, line0 - shift), min(col1, line1 - shift)
        if r < row0 or last <= first:
            continue
        near_row(z, z, flip, r, first, last, stencil[0], stencil[1], near)
        if unlike:
            near_row(z, sure, flip, r, first, last, sure_stencil[0], sure_stencil[1], near_sure)
        q, size = first + shift - b0, last - first
        right, q_right = (p + 1, q) if p + 1 < density else (0, q + 1)
        heights = turned_row(z, flip, r)[first:last]
        level = np.float32(rise * (r - origin))
        out = marks[r - row0, first - col0 : last - col0]
        left_line = carried[p, q : q + size]
        right_line = carried[right, q_right : q_right + size]
        nodes_inside = inside[p, q : q + size]
        if proved:
            _mark(
                left_line, right_line, nodes_inside, floor[p, q : q + size], heights, level,
                near[:size], near_sure[:size], np.float32(slope), slack, near_slack, out,
            )  # fmt: skip
        else:
            _mark_likely(
                left_line, right_line, nodes_inside, heights, level,
                near[:size], np.float32(slope), slack, near_slack, out,
            )  # fmt: skip


@njit(nogil=True, error_model="numpy", parallel=True)
def mark(z, sure, proved, unlike, flip, sun, density, cells, stencil, sure_stencil, slacks, rows, window, marks):  # fmt: skip
    """Mark every node of a window of z (turned) `LIT`, `DARK` or `OPEN` in marks (rows, cols)
    uint8.

    sun: (shear, metres by which the ray climbs per row, metres per cell of length, lean of the
    diagonals: +1 if they run down to the right). density: lines per column; cells: rows covered by
    the stencil. slacks: bounds of the rounding, for the lines (m) and the stencil (m per cell).
    rows: the first row that can cast a shadow, and the rows after which heights are rebased.
    proved: use the lower bound, from ``sure``; without it a node is dark where both its lines are.
    stencil: nodes and weights, with crossings beside a node taken to be on it; sure_stencil:
    without that, since a ray may leave the raster there. unlike: True if ``sure`` differs from z,
    or the stencils differ.
    """
    first, last = line_range(sun[0], window)
    blocks = (last - first + LINES - 1) // LINES
    done = 0
    for block in prange(blocks):
        done += 1
        line0 = first + block * LINES
        _bound_lines(
            z, sure, proved, unlike, flip, sun, density, cells, stencil, sure_stencil, slacks, rows, window,
            (line0, min(last, line0 + LINES)), marks,
        )  # fmt: skip
    all_done(done, blocks)


@njit(nogil=True, error_model="numpy")
def _turned_back(marks, transpose, flip, i0, j0, part, some):
    """Copy the tile at (i0, j0) of the raster's window out of turned marks into part (TILE, TILE);
    some (TILE,) is non-zero in rows with an open node.
    """
    last, (rows, cols) = marks.shape[0] - 1, part.shape
    if transpose:
        for j in range(cols):
            a = j0 + j
            source = marks[last - a if flip else a, i0 : i0 + rows]
            for i in range(rows):
                part[i, j] = source[i]
    else:
        for i in range(rows):
            a = i0 + i
            part[i] = marks[last - a if flip else a, j0 : j0 + cols]
    for i in range(rows):
        found, row = np.uint8(0), part[i]
        for j in range(cols):
            found |= row[j] & OPEN
        some[i] = found


@njit(nogil=True, error_model="numpy", parallel=True)
def settle(z, holes, pyramid, summit, ray, marks, transpose, flip, window, out):
    """Write the marks of the turned window as a mask into out, bool (rows, cols) of the raster's
    own window; open nodes are traced along ray (du, dv, dz). Return their number.
    """
    row0, row1, col0, col1 = window
    rows, cols = row1 - row0, col1 - col0
    across = (cols + TILE - 1) // TILE
    tiles = (rows + TILE - 1) // TILE * across
    traced = np.zeros(tiles, np.int64)
    done = 0
    for tile in prange(tiles):
        done += 1
        i0, j0 = tile // across * TILE, tile % across * TILE
        part = np.empty((min(TILE, rows - i0), min(TILE, cols - j0)), np.uint8)
        some = np.empty(part.shape[0], np.uint8)
        _turned_back(marks, transpose, flip, i0, j0, part, some)
        for i in range(part.shape[0]):
            found, target = part[i], out[i0 + i, j0 : j0 + part.shape[1]]
            for j in range(target.size):
                target[j] = found[j] == DARK
            if not some[i]:
                continue
            for j in range(target.size):
                oz = np.float64(z[row0 + i0 + i, col0 + j0 + j])
                if found[j] == OPEN and not math.isnan(oz):
                    traced[tile] += 1
                    u, v = float(col0 + j0 + j), float(row0 + i0 + i)
                    target[j] = blocked(
                        z, holes, pyramid, summit, u, v, oz, ray[0], ray[1], ray[2], NEVER, NODE_LEVEL
                    )  # fmt: skip
    all_done(done, tiles)
    return traced.sum()


@njit(nogil=True, error_model="numpy", parallel=True)
def without_borders(z):
    """A copy of heights in which nodes beside nodata (8 neighbours) are `LOWEST`, like nodata
    itself.
    """
    rows, cols = z.shape
    out = np.empty((rows, cols), np.float32)
    done = 0
    for i in prange(rows):
        done += 1
        for j in range(cols):
            known = True
            for a in range(max(i - 1, 0), min(i + 2, rows)):
                for b in range(max(j - 1, 0), min(j + 2, cols)):
                    known &= not math.isnan(z[a, b])
            out[i, j] = z[i, j] if known else LOWEST
    all_done(done, rows)
    return out
