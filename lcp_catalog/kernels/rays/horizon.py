"""Exact horizons: greatest slope of the surface along a vertical plane, seen from a node or a point
of it.

The rise of the surface over the observer, divided by the distance, is monotone between two edge
crossings (both are linear in s), so that its maximum lies at a crossing: the same crossings, in the
same arithmetic, as in `tracing`. Rays are in cell units as there: (ou, ov) + s (du, dv) with
max(|du|, |dv|) = 1, slopes in metres per unit of s. Parts of the max pyramid that lie below the
steepest slope so far are skipped.
"""

import math

import numpy as np
from numba import prange

from ..cache import njit
from ..completion import all_done
from .bundles import NODE_LEVEL, ON_SURFACE_M, on_grid
from .surface import surface_height
from .tracing import NEVER, child_at, edge_at, first_cell, inverse_of, unit


@njit(nogil=True, error_model="numpy", forceinline=True)
def _moved_clear(  # noqa: C901, PLR0912, PLR0915  (one loop, kept in registers)
    z, holes, turns, pyramid, summit, ou, ov, du, dv, base, rate, enough
):
    """A line in the vertical plane of (du, dv), at the height base + rate s over (ou, ov) + s (du,
    dv), moved up until it clears every crossing at s > 0: turned about its start (``turns``: return
    its rate, or the first rate found that is at least ``enough``), or lifted (return its base).
    """
    levels, offsets, widths, heights = pyramid
    rows, cols = z.shape
    inverse_u, inverse_v = inverse_of(du), inverse_of(dv)
    right, down = (1 if du > 0.0 else 0), (1 if dv > 0.0 else 0)
    step_u, step_v = (1 if du > 0.0 else -1), (1 if dv > 0.0 else -1)
    inverse_across = inverse_of(du - dv)
    start_across = ou - ov
    top = widths.size - 1
    col, row = first_cell(rows, cols, ou, ov, du, dv)
    level = min(NODE_LEVEL, top)
    col, row, s = col >> level, row >> level, 0.0
    while rate < enough and (rate < 0.0 or base + rate * s < summit):
        s_u = (((col + right) << level) - ou) * inverse_u if du != 0.0 else NEVER
        s_v = (((row + down) << level) - ov) * inverse_v if dv != 0.0 else NEVER
        s_out = max(min(s_u, s_v), s)
        if level > 0:
            lowest = base + rate * (s if rate > 0.0 else s_out)
            if levels[offsets[level] + row * widths[level] + col] > lowest:
                level -= 1
                c, r = child_at(ou + du * s, ov + dv * s, du, dv, col, row, level)
                col, row = min(c, widths[level] - 1), min(r, heights[level] - 1)
                continue
        else:
            s_diagonal = ((col - row) - start_across) * inverse_across
            if s < s_diagonal < s_out:
                f = unit(ou + du * s_diagonal - col)
                rise = edge_at(z, holes, row, col, row + 1, col + 1, f) - base
                if rise > rate * s_diagonal:
                    if turns:
                        rate = rise / s_diagonal
                    else:
                        base += rise - rate * s_diagonal
            if s_u < s_v:
                edge, f = col + right, unit(ov + dv * s_out - row)
                rise = edge_at(z, holes, row, edge, row + 1, edge, f) - base
            else:
                edge, f = row + down, unit(ou + du * s_out - col)
                rise = edge_at(z, holes, edge, col, edge, col + 1, f) - base
            if s_out > 0.0 and rise > rate * s_out:
                if turns:
                    rate = rise / s_out
                else:
                    base += rise - rate * s_out
        s = s_out
        if s_u < s_v:
            old, col = col, col + step_u
            if col < 0 or col >= widths[level]:
                break
            climb = ((col ^ old) >> 1) != 0
        else:
            old, row = row, row + step_v
            if row < 0 or row >= heights[level]:
                break
            climb = ((row ^ old) >> 1) != 0
        if climb and level < top:
            level, col, row = level + 1, col >> 1, row >> 1
    return rate if turns else base


@njit(nogil=True, error_model="numpy")
def _steepest_solid(z, pyramid, summit, ou, ov, oz, du, dv, best, enough):
    return _moved_clear(z, False, True, pyramid, summit, ou, ov, du, dv, oz, best, enough)


@njit(nogil=True, error_model="numpy")
def _steepest_holed(z, pyramid, summit, ou, ov, oz, du, dv, best, enough):
    return _moved_clear(z, True, True, pyramid, summit, ou, ov, du, dv, oz, best, enough)


@njit(nogil=True, error_model="numpy")
def _lifted_holed(z, pyramid, summit, ou, ov, du, dv, lowest, rate):
    return _moved_clear(z, True, False, pyramid, summit, ou, ov, du, dv, lowest, rate, NEVER)


@njit(nogil=True, error_model="numpy", inline="always")
def steepest(z, holes, pyramid, summit, ou, ov, oz, du, dv, best, enough):
    """The horizon's slope, clipped to ``best``..``enough``."""
    if holes:
        return min(_steepest_holed(z, pyramid, summit, ou, ov, oz, du, dv, best, enough), enough)
    return min(_steepest_solid(z, pyramid, summit, ou, ov, oz, du, dv, best, enough), enough)


@njit(nogil=True, error_model="numpy", parallel=True)
def shadow_heights(z, pyramid, summit, u, v, du, dv, rates, heights):
    """Raise ``heights`` (k, n) to the height of the surface's shadow over places (n,) inside the
    raster, under parallel rays that climb by ``rates`` (k,) metres per unit of (du, dv).
    """
    done = 0
    for n in prange(u.size):
        done += 1
        for k in range(rates.size):
            heights[k, n] = _lifted_holed(
                z, pyramid, summit, u[n], v[n], du, dv, heights[k, n], rates[k]
            )
    all_done(done, u.size)


@njit(nogil=True, error_model="numpy", parallel=True)
def node_horizons(z, holes, pyramid, summit, rows, cols, planes, out):
    """Write the horizons of nodes (n,) in the planes (k, 4) du, dv, best, enough into out (n, k),
    metres per unit of s; ``best`` at nodata.
    """
    done = 0
    for n in prange(rows.size):
        done += 1
        i, j = rows[n], cols[n]
        oz = np.float64(z[i, j])
        for k in range(planes.shape[0]):
            du, dv, best, enough = planes[k, 0], planes[k, 1], planes[k, 2], planes[k, 3]
            out[n, k] = best
            if not math.isnan(oz):
                out[n, k] = steepest(
                    z, holes, pyramid, summit, float(j), float(i), oz, du, dv, best, enough
                )
    all_done(done, rows.size)


@njit(nogil=True, error_model="numpy")
def _onto_surface(z, u, v, oz):
    """A point moved onto the surface if it is within 1 mm, and onto a grid line beside it (as in
    `bundles`); its height is NaN off the raster and infinite below the surface.
    """
    u, v = on_grid(u, v)
    ground = surface_height(z, u, v)
    if abs(oz - ground) <= ON_SURFACE_M:  # False where there is no surface
        return u, v, ground
    return u, v, math.inf if ground > oz else oz


@njit(nogil=True, error_model="numpy", parallel=True)
def point_horizons(z, holes, pyramid, summit, u, v, heights, planes, out):
    """`node_horizons` of points (n,) over the raster: ``enough`` for those below the surface,
    ``best`` for NaN and those off the raster.
    """
    rows, cols = z.shape
    done = 0
    for n in prange(u.size):
        done += 1
        inside = 0.0 <= u[n] <= cols - 1.0 and 0.0 <= v[n] <= rows - 1.0
        known = inside and not math.isnan(heights[n])
        x, y, oz = _onto_surface(z, u[n], v[n], heights[n]) if known else (0.0, 0.0, 0.0)
        for k in range(planes.shape[0]):
            du, dv, best, enough = planes[k, 0], planes[k, 1], planes[k, 2], planes[k, 3]
            if not known:
                out[n, k] = best
            elif oz == math.inf:
                out[n, k] = enough
            else:
                out[n, k] = steepest(z, holes, pyramid, summit, x, y, oz, du, dv, best, enough)
    all_done(done, u.size)


@njit(nogil=True, error_model="numpy", parallel=True)
def flux_above(slopes, tangents, sine, cosine, radius, tables, out):
    """Write the flux of a disc above the horizons (n, k) of its k strips into out (n,).

    ``tangents`` (k,): tangent of elevation, foreshortened into the disc's middle plane, of a unit
    slope; ``sine``, ``cosine`` of the middle's elevation; ``radius``: the disc's, a tangent;
    ``tables`` (k, m): flux of each strip above m equal steps from the bottom of the disc to its
    top.
    """
    last = tables.shape[1] - 1
    done = 0
    for n in prange(slopes.shape[0]):
        done += 1
        total = 0.0
        for k in range(tables.shape[0]):
            tangent = slopes[n, k] * tangents[k]
            y = (tangent * cosine - sine) / ((cosine + tangent * sine) * radius)
            place = min(max((y + 1.0) * 0.5, 0.0), 1.0) * last
            cell = min(int(place), last - 1)
            share = place - cell
            total += tables[k, cell] * (1.0 - share) + tables[k, cell + 1] * share
        out[n] = total
    all_done(done, slopes.shape[0])


@njit(nogil=True, error_model="numpy", parallel=True)
def rim_nodes(z, window, out):
    """Write True into out for nodes of a window with a height and a neighbour without one: the
    raster's border and the rims of holes, where a horizon may be discontinuous in azimuth.
    """
    row0, row1, col0, col1 = window
    rows, cols = z.shape
    done = 0
    for k in prange(row1 - row0):
        done += 1
        i = row0 + k
        for j in range(col0, col1):
            rim = i == 0 or j == 0 or i == rows - 1 or j == cols - 1
            for a in range(max(i - 1, 0), min(i + 2, rows)):
                for b in range(max(j - 1, 0), min(j + 2, cols)):
                    rim = rim or math.isnan(z[a, b])
            out[k, j - col0] = rim and not math.isnan(z[i, j])
    all_done(done, row1 - row0)
