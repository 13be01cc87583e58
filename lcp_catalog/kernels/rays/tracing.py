"""Exact rays over the triangulated surface: a max-mipmap traversal that compares the ray, in single
cells, with the edges that it crosses.

Between two edge crossings the profile of the surface under a ray is linear, and so is the ray: the
surface rises above the ray if and only if it does so at a crossing. Every existing triangle is
entered and left through its own edges, so testing each crossed edge that belongs to an existing
triangle is complete; no bias or lift is needed, and there are no cracks.

Rays are in cell units: u = column, v = row (down), z in metres: (ou, ov, oz) + s (du, dv, dz) with
max(|du|, |dv|) = 1, so that crossings along an axis or a diagonal are computed without rounding.
Cell steps after Amanatides and Woo 1987, hierarchy after Tevs, Ihrke and Seidel 2008 (maximum
mipmaps).
"""

import math

import numpy as np

from ..cache import njit
from .surface import edge_height, edge_height_careful, facet_height, stretch_exists, stretch_height

NEVER = 1e300
PATIENCE = 6
"""Cells that a ray from near the surface walks before it uses higher levels of the pyramid."""

AT_ONCE = 1e-300
"""A parameter less than that of any crossing except one at the start itself."""
UNDERGROUND_M = 1e-6
"""Distance within which a camera below the surface is on it; from further below nothing is visible.
"""


@njit(nogil=True, error_model="numpy", forceinline=True)
def inverse_of(rate):
    """1 / rate; `NEVER` for 0."""
    return 1.0 / rate if rate != 0.0 else NEVER


@njit(nogil=True, error_model="numpy", inline="always")
def unit(value):
    """A value moved into 0..1."""
    return min(max(value, 0.0), 1.0)


@njit(nogil=True, error_model="numpy", inline="always")
def edge_at(z, holes, i, j, i2, j2, f):
    if holes:
        return edge_height_careful(z, i, j, i2, j2, f)
    return edge_height(z, i, j, i2, j2, f)


@njit(nogil=True, error_model="numpy", forceinline=True)
def _meeting(z, holes, i, j, ou, ov, oz, du, dv, dz, s, s_below, below):
    """Parameter between s and s_below, in one stretch of cell (i, j), at which a ray passes through
    the surface; ``below`` (< 0) is its height at s_below.

    NEVER if there was no triangle at s: the ray has come below the surface from the side, through a
    hole.
    """
    x, y = unit(ou + du * s - j), unit(ov + dv * s - i)
    if holes:
        middle = 0.5 * (s + s_below)
        mid_x, mid_y = unit(ou + du * middle - j), unit(ov + dv * middle - i)
        if not stretch_exists(z, i, j, mid_x, mid_y):
            return NEVER
        height = stretch_height(z, i, j, x, y, mid_x, mid_y)
    else:
        height = facet_height(z, i, j, x, y)
    above = max(
        oz + dz * s - height, 0.0
    )  # below 0 only by rounding: the last crossing was passed above
    return s + (s_below - s) * (above / (above - below))


@njit(nogil=True, error_model="numpy", forceinline=True)
def met_in_cell(
    z00, z01, z10, z11, i, j, ou, ov, oz, du, dv, dz, s, s_diagonal, s_out, s_end, by_u
):  # fmt: skip
    """Parameter between s and s_out at which a ray first passes through the surface in cell (i, j)
    with nodes z00 (north-west), z01 (north-east), z10 and z11, all float64 heights; -1 without any.

    Equivalent to `_trace` and `_meeting`, with selected values in place of branches: the edge that
    a ray meets is not predictable, and a mispredicted branch costs more than both edges.
    """
    parted = (s < s_diagonal) & (s_diagonal < s_out) & (s_diagonal <= s_end)
    f = unit(ou + du * s_diagonal - j)
    gap_diagonal = oz + dz * s_diagonal - (z00 + (z11 - z00) * f if f < 1.0 else z11)
    gap_diagonal = gap_diagonal if parted else 0.0
    right, down = du > 0.0, dv > 0.0
    start_u, end_u = (z01 if right else z00), (z11 if right else z10)
    start_v, end_v = (z10 if down else z00), (z11 if down else z01)
    start, end = (start_u if by_u else start_v), (end_u if by_u else end_v)
    u, v = ou + du * s_out - j, ov + dv * s_out - i
    f = unit(v if by_u else u)
    gap = oz + dz * s_out - (start + (end - start) * f if f < 1.0 else end)
    gap = gap if (s_out > 0.0) & (s_out <= s_end) else 0.0
    early = gap_diagonal < 0.0
    below, s_below = (gap_diagonal if early else gap), (s_diagonal if early else s_out)
    s = s_diagonal if parted & (not early) else s
    x, y = unit(ou + du * s - j), unit(ov + dv * s - i)
    upper = x >= y
    corner = z01 if upper else z10
    along, across = (x if upper else y), (y if upper else x)
    height = z00 + (corner - z00) * along + (z11 - corner) * across
    above = max(oz + dz * s - height, 0.0)
    met_at = s + (s_below - s) * (above / (above - below))
    return met_at if (gap_diagonal < 0.0) | (gap < 0.0) else -1.0


@njit(nogil=True, error_model="numpy", forceinline=True)
def first_cell(rows, cols, ou, ov, du, dv):
    """(column, row) of the first cell of a ray from (ou, ov), inside the raster."""
    col = min(max(math.floor(ou), 0), cols - 2)
    row = min(max(math.floor(ov), 0), rows - 2)
    if du < 0.0 and ou == col and col > 0:
        col -= 1
    if dv < 0.0 and ov == row and row > 0:
        row -= 1
    return col, row


@njit(nogil=True, error_model="numpy", forceinline=True)
def child_at(u, v, du, dv, col, row, level):
    """(column, row) of the block of ``level`` through which a ray at (u, v) continues, of the four
    in block (col, row) of the next level.
    """
    c = min(max(math.floor(u) >> level, 2 * col), 2 * col + 1)
    r = min(max(math.floor(v) >> level, 2 * row), 2 * row + 1)
    if du < 0.0 and c > 2 * col and u <= (c << level):
        c -= 1
    if dv < 0.0 and r > 2 * row and v <= (r << level):
        r -= 1
    return c, r


@njit(nogil=True, error_model="numpy", forceinline=True)
def entered(start, rate, inverse, size, side, s):
    """The block of ``side`` cells (a power of two) along an axis in which a ray is after all
    crossings with grid lines up to s, and the crossing at which it entered the block; all float64.

    -1 or ``size`` (blocks) if it has left the raster. The position is only a first guess; the
    crossings, computed as in `_trace`, determine the block. Without branches, as `met_in_cell`.
    """
    guess = math.floor(min(max(start + rate * s, 0.0), size * side - 1.0) / side)
    rises, falls = rate > 0.0, rate < 0.0
    low, high = (guess * side - start) * inverse, ((guess + 1.0) * side - start) * inverse
    block = guess - 1.0 if rises & (low > s) & (guess > 0.0) else guess
    block = guess + 1.0 if falls & (high > s) & (guess < size - 1.0) else block
    ahead = block + 1.0 if rises else block
    passed = (ahead * side - start) * inverse <= s
    block = block + 1.0 if rises & passed else block
    block = block - 1.0 if falls & passed else block
    behind = block + 1.0 if falls else block
    return block, (behind * side - start) * inverse if rises | falls else 0.0


@njit(nogil=True, error_model="numpy", forceinline=True)
def _trace(  # noqa: C901, PLR0911, PLR0912, PLR0915  (one loop, kept in registers)
    z, holes, first_hit, pyramid, summit, ou, ov, oz, du, dv, dz,
    inverse_u, inverse_v, s_clear, s_end, level,
):  # fmt: skip
    """Follow a ray from (ou, ov), inside the raster, until it leaves it, rises above ``summit`` or
    passes s_end.

    ``first_hit`` False: return 1 as soon as a crossing with 0 < s <= s_end lies strictly above the
    ray, else -1. ``first_hit`` True, for a ray that starts on or above the surface: return the s at
    which it first meets the surface, else -1. ``holes`` and ``first_hit`` are literals of the
    callers: the compiler makes one function for each pair.

    With ``first_hit`` the ray may start at s_clear > 0, up to which no crossing lies above it. The
    bits of the result depend neither on that nor on the level: a child is chosen by comparing
    crossings, so that the cells and the s of every crossing are those of a walk from cell to cell.
    (For crossings at the same s the row's line comes first.)
    """
    levels, offsets, widths, heights = pyramid
    rows, cols = z.shape
    right, down = (1 if du > 0.0 else 0), (1 if dv > 0.0 else 0)
    step_u, step_v = (1 if du > 0.0 else -1), (1 if dv > 0.0 else -1)
    across = du - dv
    inverse_across = inverse_of(across)
    start_across = ou - ov
    if dz > 0.0:
        s_end = min(s_end, (summit - oz) / dz)
    elif dz == 0.0 and oz >= summit:
        return -1.0
    top = widths.size - 1
    col, row = first_cell(rows, cols, ou, ov, du, dv)
    level = min(level, top)
    col, row, s = col >> level, row >> level, 0.0
    walked = 0 if s_clear > 0.0 else PATIENCE
    if first_hit and s_clear > 0.0:
        side = float(1 << level)
        u_block, in_u = entered(ou, du, inverse_u, float(widths[level]), side, s_clear)
        v_block, in_v = entered(ov, dv, inverse_v, float(heights[level]), side, s_clear)
        col, row = int(u_block), int(v_block)
        if col < 0 or row < 0 or col >= widths[level] or row >= heights[level]:
            return -1.0
        s = max(in_u, in_v, 0.0)
    while True:
        s_u = (((col + right) << level) - ou) * inverse_u if du != 0.0 else NEVER
        s_v = (((row + down) << level) - ov) * inverse_v if dv != 0.0 else NEVER
        s_out = max(min(s_u, s_v), s)
        if level > 0:
            lowest = oz + dz * (s if dz > 0.0 else s_out)
            if levels[offsets[level] + row * widths[level] + col] > lowest:
                level -= 1
                if first_hit:
                    c, r = 2 * col + 1, 2 * row + 1
                    passed_u = ((c << level) - ou) * inverse_u < max(s, AT_ONCE)
                    passed_v = ((r << level) - ov) * inverse_v <= s
                    if passed_u != (du >= 0.0):
                        c -= 1
                    if passed_v != (dv >= 0.0):
                        r -= 1
                else:
                    c, r = child_at(ou + du * s, ov + dv * s, du, dv, col, row, level)
                col, row = min(c, widths[level] - 1), min(r, heights[level] - 1)
                continue
        elif first_hit and not holes:
            s_diagonal = ((col - row) - start_across) * inverse_across
            found = met_in_cell(
                np.float64(z[row, col]), np.float64(z[row, col + 1]),
                np.float64(z[row + 1, col]), np.float64(z[row + 1, col + 1]),
                row, col, ou, ov, oz, du, dv, dz, s, s_diagonal, s_out, s_end, s_u < s_v,
            )  # fmt: skip
            if found >= 0.0:
                return found
        else:
            before = s
            s_diagonal = ((col - row) - start_across) * inverse_across
            if s < s_diagonal < s_out and s_diagonal <= s_end:
                f = unit(ou + du * s_diagonal - col)
                gap = oz + dz * s_diagonal - edge_at(z, holes, row, col, row + 1, col + 1, f)
                if gap < 0.0:
                    if not first_hit:
                        return 1.0
                    met = _meeting(z, holes, row, col, ou, ov, oz, du, dv, dz, s, s_diagonal, gap)
                    if met < NEVER:
                        return met
                    if gap < -UNDERGROUND_M:
                        return -1.0
                before = s_diagonal
            if s_u < s_v:
                edge, f = col + right, unit(ov + dv * s_out - row)
                gap = oz + dz * s_out - edge_at(z, holes, row, edge, row + 1, edge, f)
            else:
                edge, f = row + down, unit(ou + du * s_out - col)
                gap = oz + dz * s_out - edge_at(z, holes, edge, col, edge, col + 1, f)
            if gap < 0.0 and 0.0 < s_out <= s_end:
                if not first_hit:
                    return 1.0
                met = _meeting(z, holes, row, col, ou, ov, oz, du, dv, dz, before, s_out, gap)
                if met < NEVER:
                    return met
                if gap < -UNDERGROUND_M:
                    return -1.0
        s = s_out
        if s >= s_end:
            return -1.0
        if s_u < s_v:
            old, col = col, col + step_u
            if col < 0 or col >= widths[level]:
                return -1.0
            climb = ((col ^ old) >> 1) != 0
        else:
            old, row = row, row + step_v
            if row < 0 or row >= heights[level]:
                return -1.0
            climb = ((row ^ old) >> 1) != 0
        if first_hit:
            walked += 1
            climb = climb and walked > PATIENCE
        if climb and level < top:
            level, col, row = level + 1, col >> 1, row >> 1


@njit(nogil=True, error_model="numpy")
def _blocked_solid(
    z, pyramid, summit, ou, ov, oz, du, dv, dz, s_end, level
):  # fmt: skip
    return _trace(
        z, False, False, pyramid, summit, ou, ov, oz, du, dv, dz,
        inverse_of(du), inverse_of(dv), 0.0, s_end, level,
    ) > 0.0  # fmt: skip


@njit(nogil=True, error_model="numpy")
def _blocked_holed(
    z, pyramid, summit, ou, ov, oz, du, dv, dz, s_end, level
):  # fmt: skip
    return _trace(
        z, True, False, pyramid, summit, ou, ov, oz, du, dv, dz,
        inverse_of(du), inverse_of(dv), 0.0, s_end, level,
    ) > 0.0  # fmt: skip


@njit(nogil=True, error_model="numpy", inline="always")
def blocked(
    z, holes, pyramid, summit, ou, ov, oz, du, dv, dz, s_end, level
):  # fmt: skip
    """True if an existing triangle rises strictly above the ray at 0 < s <= s_end; (du, dv) must
    not both be 0.
    """
    if holes:
        return _blocked_holed(z, pyramid, summit, ou, ov, oz, du, dv, dz, s_end, level)
    return _blocked_solid(z, pyramid, summit, ou, ov, oz, du, dv, dz, s_end, level)


@njit(nogil=True, error_model="numpy", inline="always")
def met(
    z, holes, pyramid, summit, ou, ov, oz, du, dv, dz,
    inverse_u, inverse_v, s_clear, level,
):  # fmt: skip
    """Parameter s at which a ray that starts on or above the surface first meets it; -1 if it never
    does, or gets below it through a hole. No terrain may lie above the ray up to s_clear (0: not
    known).
    """
    if holes:
        return _trace(
            z, True, True, pyramid, summit, ou, ov, oz, du, dv, dz,
            inverse_u, inverse_v, s_clear, NEVER, level,
        )  # fmt: skip
    return _trace(
        z, False, True, pyramid, summit, ou, ov, oz, du, dv, dz,
        inverse_u, inverse_v, s_clear, NEVER, level,
    )  # fmt: skip
