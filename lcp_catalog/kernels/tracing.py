"""Exact rays over the triangulated surface: a max-mipmap traversal whose leaf compares the ray with the edges it crosses.

Between two edge crossings the profile of the surface under a ray is linear, and so is the ray: the surface rises above the ray if and
only if it does so at a crossing. Every existing triangle is entered and left through its own edges, so testing each
crossed edge that belongs to an existing triangle is complete; no bias or lift is needed, and there are no cracks.

Rays live in cell units: u = column, v = row (down), z in metres; the ray is (ou, ov, oz) + s (du, dv, dz).
Traversal after Amanatides and Woo 1987, hierarchy after Tevs, Ihrke and Seidel 2008 (maximum mipmaps).
"""

import math

import numpy as np
from numba import njit, prange

NEVER = 1e300

TILE = 64
"""Side of the blocks of nodes that are traced one after the other."""
UNDERGROUND_M = 1e-6
"""A ray that starts this far below the surface starts under the ground, and sees nothing."""

SNAP = 1e-9
"""Where the surface has holes, a crossing this near a node (in cells) is a crossing of the node."""


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _unit(value):
    return min(max(value, 0.0), 1.0)


@njit(cache=True, nogil=True, error_model="numpy")
def _triangle_exists(z, i, j, upper):
    """Whether cell (i, j) is inside and its upper (north-east) or lower (south-west) triangle has all three heights."""
    if i < 0 or j < 0 or i >= z.shape[0] - 1 or j >= z.shape[1] - 1:
        return False
    third = z[i, j + 1] if upper else z[i + 1, j]
    return not (math.isnan(z[i, j]) or math.isnan(z[i + 1, j + 1]) or math.isnan(third))


@njit(cache=True, nogil=True, error_model="numpy")
def node_exists(z, i, j):
    """Whether a node belongs to any existing triangle."""
    return (
        _triangle_exists(z, i, j, True)
        or _triangle_exists(z, i, j, False)
        or _triangle_exists(z, i - 1, j - 1, True)
        or _triangle_exists(z, i - 1, j - 1, False)
        or _triangle_exists(z, i, j - 1, True)
        or _triangle_exists(z, i - 1, j, False)
    )


@njit(cache=True, nogil=True, error_model="numpy")
def _edge_exists(z, i, j, i2, j2):
    """Whether the edge from node (i, j) to its east (i, j+1), south (i+1, j) or south-east neighbour belongs to a triangle."""
    if i2 == i:
        return _triangle_exists(z, i, j, True) or _triangle_exists(z, i - 1, j, False)
    if j2 == j:
        return _triangle_exists(z, i, j, False) or _triangle_exists(z, i, j - 1, True)
    return _triangle_exists(z, i, j, True) or _triangle_exists(z, i, j, False)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _edge_height(z, i, j, i2, j2, f):
    """Height of an edge at the share f of its length, float64."""
    start, end = float(z[i, j]), float(z[i2, j2])
    return start + (end - start) * f if f < 1.0 else end  # exact at both ends, and along a level edge


@njit(cache=True, nogil=True, error_model="numpy")
def _edge_height_with_holes(z, i, j, i2, j2, f):
    """The same where nodes may be missing: NaN unless the edge, or the node that the crossing meets, exists."""
    if f <= SNAP:
        return float(z[i, j]) if node_exists(z, i, j) else math.nan
    if f >= 1.0 - SNAP:
        return float(z[i2, j2]) if node_exists(z, i2, j2) else math.nan
    if not _edge_exists(z, i, j, i2, j2):
        return math.nan
    return _edge_height(z, i, j, i2, j2, f)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _crossing(z, holes, i, j, i2, j2, f):
    if holes:
        return _edge_height_with_holes(z, i, j, i2, j2, f)
    return _edge_height(z, i, j, i2, j2, f)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def surface_height(z, u, v):
    """Height of the surface at (u, v) inside the raster (at least 2 x 2), NaN where no triangle is."""
    rows, cols = z.shape
    j = min(max(int(math.floor(u)), 0), cols - 2)
    i = min(max(int(math.floor(v)), 0), rows - 2)
    x, y = u - j, v - i
    z00, z11 = float(z[i, j]), float(z[i + 1, j + 1])
    if x >= y:
        z01 = float(z[i, j + 1])
        return z00 + (z01 - z00) * x + (z11 - z01) * y
    z10 = float(z[i + 1, j])
    return z00 + (z10 - z00) * y + (z11 - z10) * x


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _meeting(above_s, above_by, below_s, below_by):
    """Where the ray meets the surface between a place above it and one below; -1 when it came from under the surface or a hole."""
    if math.isnan(above_by):
        return -1.0
    return above_s + (below_s - above_s) * (above_by / (above_by - below_by))


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def trace(z, holes, levels, offsets, widths, heights, ou, ov, oz, du, dv, dz, s0, s_end, first_hit, level):
    """The ray from parameter s0 (inside the raster) on.

    With ``first_hit`` false: a parameter > 0 as soon as a crossing up to s_end lies strictly above the ray, else -1. With ``first_hit``
    true: the parameter at which the ray, coming from above, first meets the surface, else -1. (du, dv) must not both be 0.
    """
    rows, cols = z.shape
    inverse_u = 1.0 / du if du != 0.0 else NEVER
    inverse_v = 1.0 / dv if dv != 0.0 else NEVER
    right, down = (1 if du > 0.0 else 0), (1 if dv > 0.0 else 0)
    step_u, step_v = (1 if du > 0.0 else -1), (1 if dv > 0.0 else -1)
    across = du - dv
    inverse_across = 1.0 / across if across != 0.0 else NEVER
    top = widths.size - 1
    summit = float(levels[offsets[top]])
    u, v = ou + du * s0, ov + dv * s0
    j = min(max(int(math.floor(u)), 0), cols - 2)
    i = min(max(int(math.floor(v)), 0), rows - 2)
    if du < 0.0 and u == j and j > 0:
        j -= 1
    if dv < 0.0 and v == i and i > 0:
        i -= 1
    s, level = s0, min(level, top)
    col, row = j >> level, i >> level
    above_s = s0  # last parameter at which the ray is known to be above the surface, and by how much
    above_by = NEVER
    while True:
        s_u = (((col + right) << level) - ou) * inverse_u if du != 0.0 else NEVER
        s_v = (((row + down) << level) - ov) * inverse_v if dv != 0.0 else NEVER
        s_out = max(min(s_u, s_v), s)
        lowest = oz + dz * (s if dz > 0.0 else s_out)
        if levels[offsets[level] + row * widths[level] + col] >= lowest:
            if level > 0:
                level -= 1
                c = int(math.floor(ou + du * s)) >> level
                r = int(math.floor(ov + dv * s)) >> level
                c = min(max(c, 2 * col), 2 * col + 1)
                r = min(max(r, 2 * row), 2 * row + 1)
                if du < 0.0 and c > 2 * col and ou + du * s <= (c << level):
                    c -= 1
                if dv < 0.0 and r > 2 * row and ov + dv * s <= (r << level):
                    r -= 1
                col, row = min(c, widths[level] - 1), min(r, heights[level] - 1)
                continue
            if first_hit and above_by == NEVER:
                above_s = s
                above_by = oz + dz * s - surface_height(z, ou + du * s, ov + dv * s)
                if above_by < 0.0:  # after a skip that is rounding; at the start the ray is under the ground
                    above_by = math.nan if s == s0 and above_by < -UNDERGROUND_M else 0.0
            s_diagonal = ((col - row) - (ou - ov)) * inverse_across
            if s < s_diagonal < s_out:
                f = _unit(ou + du * s_diagonal - col)
                gap = oz + dz * s_diagonal - _crossing(z, holes, row, col, row + 1, col + 1, f)
                if gap < 0.0 and s_diagonal <= s_end:
                    if not first_hit:
                        return max(s_diagonal, 1e-300)
                    return _meeting(above_s, above_by, s_diagonal, gap)
                above_s, above_by = s_diagonal, max(gap, 0.0) if gap == gap else math.nan
            if s_u < s_v:
                edge, f = col + right, _unit(ov + dv * s_out - row)
                gap = oz + dz * s_out - _crossing(z, holes, row, edge, row + 1, edge, f)
            else:
                edge, f = row + down, _unit(ou + du * s_out - col)
                gap = oz + dz * s_out - _crossing(z, holes, edge, col, edge, col + 1, f)
            if gap < 0.0 and s0 < s_out <= s_end:
                if not first_hit:
                    return max(s_out, 1e-300)
                return _meeting(above_s, above_by, s_out, gap)
            above_s, above_by = s_out, max(gap, 0.0) if gap == gap else math.nan
        else:
            above_by = NEVER  # skipped: the ray is above everything here
        s = s_out
        if s >= s_end:
            return -1.0
        if s_u < s_v:
            old, col = col, col + step_u
            if col < 0 or col >= widths[level]:
                return -1.0
            climb = (col >> 1) != (old >> 1)
        else:
            old, row = row, row + step_v
            if row < 0 or row >= heights[level]:
                return -1.0
            climb = (row >> 1) != (old >> 1)
        if climb and level < top:
            level, col, row = level + 1, col >> 1, row >> 1
        if dz > 0.0 and oz + dz * s > summit:
            return -1.0


@njit(cache=True, nogil=True, error_model="numpy")
def _blocked_without_holes(z, levels, offsets, widths, heights, ou, ov, oz, du, dv, dz, s_end):
    """`trace` of a shadow ray with its two questions answered at compile time: a third faster."""
    return trace(z, False, levels, offsets, widths, heights, ou, ov, oz, du, dv, dz, 0.0, s_end, False, 0) > 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def _blocked_with_holes(z, levels, offsets, widths, heights, ou, ov, oz, du, dv, dz, s_end):
    return trace(z, True, levels, offsets, widths, heights, ou, ov, oz, du, dv, dz, 0.0, s_end, False, 0) > 0.0


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def blocked(z, holes, levels, offsets, widths, heights, ou, ov, oz, du, dv, dz, s_end):
    """Whether the surface rises above the ray from a point of the surface, up to the parameter s_end."""
    if holes:
        return _blocked_with_holes(z, levels, offsets, widths, heights, ou, ov, oz, du, dv, dz, s_end)
    return _blocked_without_holes(z, levels, offsets, widths, heights, ou, ov, oz, du, dv, dz, s_end)


@njit(cache=True, nogil=True, error_model="numpy", parallel=True)
def occluded_nodes(z, holes, levels, offsets, widths, heights, du, dv, dz, window, out):
    """For every node of the window, whether the surface rises above the ray that leaves it; (du, dv) must not both be 0.

    Tile by tile: neighbouring rays meet the same cells while these are in the cache.
    """
    row0, row1, col0, col1 = window
    across = (col1 - col0 + TILE - 1) // TILE
    for tile in prange(((row1 - row0 + TILE - 1) // TILE) * across):
        top, left = row0 + tile // across * TILE, col0 + tile % across * TILE
        for i in range(top, min(top + TILE, row1)):
            for j in range(left, min(left + TILE, col1)):
                hit = False
                if not math.isnan(z[i, j]):
                    oz = float(z[i, j])
                    hit = blocked(
                        z, holes, levels, offsets, widths, heights, float(j), float(i), oz, du, dv, dz, NEVER
                    )
                out[i - row0, j - col0] = hit


@njit(cache=True, nogil=True, error_model="numpy", parallel=True)
def occluded_nodes_from(z, holes, levels, offsets, widths, heights, cu, cv, cz, window, out):
    """For every node of the window, whether the surface rises above the segment from the node to the camera (cu, cv, cz)."""
    row0, row1, col0, col1 = window
    for k in prange(row1 - row0):
        i = row0 + k
        for j in range(col0, col1):
            hit = False
            if not math.isnan(z[i, j]):
                oz = float(z[i, j])
                du, dv, dz = cu - j, cv - i, cz - oz
                if du == 0.0 and dv == 0.0:
                    hit = dz < 0.0 and node_exists(z, i, j)
                else:
                    hit = blocked(
                        z, holes, levels, offsets, widths, heights, float(j), float(i), oz, du, dv, dz, 1.0
                    )
            out[k, j - col0] = hit


@njit(cache=True, nogil=True, error_model="numpy", parallel=True)
def occluded_points(z, holes, levels, offsets, widths, heights, u, v, du, dv, dz, out):
    """The same for surface points (u, v); the ray starts on the surface itself, at the height that the triangle has there."""
    for k in prange(u.size):
        oz = surface_height(z, u[k], v[k])
        hit = False
        if not math.isnan(oz):
            hit = blocked(z, holes, levels, offsets, widths, heights, u[k], v[k], oz, du, dv, dz, NEVER)
        out[k] = hit


@njit(cache=True, nogil=True, error_model="numpy")
def _enter(limit, origin, direction, span):
    """Parameters at which a ray is inside [0, limit] on one axis, cut with ``span``."""
    if direction == 0.0:
        return span if 0.0 <= origin <= limit else (1.0, 0.0)
    a, b = -origin / direction, (limit - origin) / direction
    return max(span[0], min(a, b)), min(span[1], max(a, b))


@njit(cache=True, nogil=True, error_model="numpy")
def first_hit(z, holes, levels, offsets, widths, heights, ou, ov, oz, du, dv, dz):
    """Parameter at which a ray from anywhere first meets the surface from above; -1 when it never does."""
    rows, cols = z.shape
    if du == 0.0 and dv == 0.0:
        if not (0.0 <= ou <= cols - 1 and 0.0 <= ov <= rows - 1) or dz >= 0.0:
            return -1.0
        s = (surface_height(z, ou, ov) - oz) / dz
        return s if s >= 0.0 else -1.0
    span = _enter(float(cols - 1), ou, du, (0.0, NEVER))
    span = _enter(float(rows - 1), ov, dv, span)
    summit = float(levels[offsets[widths.size - 1]])
    start = span[0]
    if oz + dz * start > summit:
        if dz >= 0.0:
            return -1.0
        start = (summit - oz) / dz
    if not start < span[1]:
        return -1.0
    return trace(z, holes, levels, offsets, widths, heights, ou, ov, oz, du, dv, dz, start, NEVER, True, 3)


@njit(cache=True, nogil=True, error_model="numpy", parallel=True)
def first_hits(z, holes, levels, offsets, widths, heights, ou, ov, oz, directions, out):
    """First hits of rays (n, 3) (du, dv, dz) that leave one point; NaN for none."""
    for k in prange(out.size):
        s = first_hit(
            z, holes, levels, offsets, widths, heights,
            ou, ov, oz, directions[k, 0], directions[k, 1], directions[k, 2],
        )
        out[k] = s if s >= 0.0 else np.nan
