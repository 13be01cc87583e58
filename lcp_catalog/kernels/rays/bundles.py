"""Bundles of rays: nodes towards a direction or a camera, surface points towards a direction, a
camera towards the surface.

Every ray is traced by one thread, so that results do not depend on the number of threads. Rays and
units as in `tracing`.
"""

import math

import numpy as np
from numba import prange

from ..cache import njit
from ..completion import all_done
from .surface import node_exists, surface_height
from .tracing import NEVER, UNDERGROUND_M, blocked, inverse_of, met

BAND_ROWS = 8
NODE_LEVEL = 1
"""Pyramid level at which a ray from the surface starts: most rays end close by."""

CAMERA_LEVEL = 3
CLEAR_LEVEL = 0
"""Pyramid level at which a camera ray starts that is clear down to the terrain around its hit."""

NEAR_CAMERA = 1e-6
"""Length at the camera's end of a segment, in cells, in which terrain is ignored: the camera may be
at a node.
"""

ON_SURFACE_M = 1e-3
"""Distance within which a point above or below the surface lies on it."""

ON_GRID = 1e-9
"""Distance, in cells, within which a position lies on a grid line or diagonal."""


@njit(nogil=True, error_model="numpy", forceinline=True)
def scaled(du, dv, dz):
    """A ray scaled to max(|du|, |dv|) = 1, and the factor; a direction that differs from an axis or
    a diagonal only by rounding is put on it.

    (0, 0, dz, 0) if vertical. For example sin(pi) is 1.2e-16, not 0; the change moves a ray by
    1e-10 cells over 1e5.
    """
    # without branches, so that many rays are scaled at once
    longest = max(abs(du), abs(dv))
    level = longest > 1e-15 * abs(dz)
    u, v = du / longest, dv / longest
    u = u if abs(u) >= 1e-15 else 0.0
    v = v if abs(v) >= 1e-15 else 0.0
    diagonal = abs(abs(u) - abs(v)) < 1e-15
    u = (1.0 if u > 0.0 else -1.0) if diagonal else u
    v = (1.0 if v > 0.0 else -1.0) if diagonal else v
    return (
        u if level else 0.0,
        v if level else 0.0,
        dz / longest if level else dz,
        longest if level else 0.0,
    )


@njit(nogil=True, error_model="numpy")
def on_grid(u, v):
    """A position moved onto the grid line or diagonal from which it differs only by rounding."""
    if abs(u - round(u)) < ON_GRID:
        u = float(round(u))
    if abs(v - round(v)) < ON_GRID:
        v = float(round(v))
    diagonal = float(round(u - v))
    if abs(u - v - diagonal) < ON_GRID:
        if u == round(u):
            v = u - diagonal
        else:
            u = v + diagonal
    return u, v


@njit(nogil=True, error_model="numpy")
def _enter(rows, cols, ou, ov, du, dv):
    """Parameters s >= 0 between which a ray is over the raster; the first is greater if it never
    is.
    """
    first, last = 0.0, NEVER
    for axis in range(2):
        start, rate, limit = (ou, du, cols - 1.0) if axis == 0 else (ov, dv, rows - 1.0)
        if rate != 0.0:
            a, b = -start / rate, (limit - start) / rate
            first, last = max(first, min(a, b)), min(last, max(a, b))
        elif start < 0.0 or start > limit:
            last = -1.0
    return first, last


@njit(nogil=True, error_model="numpy", inline="always")
def _spread(k, bands):
    """Index of the k-th band to process: successive bands lie a golden section apart, so that every
    thread's share contains all kinds of terrain.
    """
    step = max(int(bands * 0.6180339887498949), 1)
    while math.gcd(step, bands) != 1:
        step += 1
    return (k * step) % bands


@njit(nogil=True, error_model="numpy", parallel=True)
def occluded_nodes(z, holes, pyramid, summit, du, dv, dz, window, out):
    """Write True into out for nodes of the window where the surface rises above their ray; nodata:
    False. (du, dv) must not both be 0.
    """
    row0, row1, col0, col1 = window
    bands = (row1 - row0 + BAND_ROWS - 1) // BAND_ROWS
    done = 0
    for band in prange(bands):
        done += 1
        first = row0 + _spread(band, bands) * BAND_ROWS
        for i in range(first, min(first + BAND_ROWS, row1)):
            for j in range(col0, col1):
                oz = np.float64(z[i, j])
                out[i - row0, j - col0] = not math.isnan(oz) and blocked(
                    z,
                    holes,
                    pyramid,
                    summit,
                    float(j),
                    float(i),
                    oz,
                    du,
                    dv,
                    dz,
                    NEVER,
                    NODE_LEVEL,
                )
    all_done(done, bands)


@njit(nogil=True, error_model="numpy")
def _hidden(z, holes, pyramid, summit, i, j, cu, cv, cz):
    """True if the surface rises above the segment from a node to a camera that is not below the
    surface.
    """
    oz = np.float64(z[i, j])
    du, dv, dz, longest = scaled(cu - j, cv - i, cz - oz)
    if longest == 0.0:
        return dz < 0.0 and node_exists(z, i, j)
    end = longest - NEAR_CAMERA
    return end > 0.0 and blocked(
        z,
        holes,
        pyramid,
        summit,
        float(j),
        float(i),
        oz,
        du,
        dv,
        dz,
        end,
        NODE_LEVEL,
    )


@njit(nogil=True, error_model="numpy", parallel=True)
def occluded_nodes_from(z, holes, pyramid, summit, cu, cv, cz, window, out):
    """Write True into out for nodes of the window where the surface rises above the segment to the
    camera; nodata: False.
    """
    row0, row1, col0, col1 = window
    cu, cv = on_grid(cu, cv)
    buried = surface_height(z, cu, cv) > cz + UNDERGROUND_M
    bands = (row1 - row0 + BAND_ROWS - 1) // BAND_ROWS
    done = 0
    for band in prange(bands):
        done += 1
        first = row0 + _spread(band, bands) * BAND_ROWS
        for i in range(first, min(first + BAND_ROWS, row1)):
            for j in range(col0, col1):
                out[i - row0, j - col0] = not math.isnan(z[i, j]) and (
                    buried or _hidden(z, holes, pyramid, summit, i, j, cu, cv, cz)
                )
    all_done(done, bands)


@njit(nogil=True, error_model="numpy")
def _point_blocked(z, holes, pyramid, summit, u, v, oz, du, dv, dz):
    u, v = on_grid(u, v)
    ground = surface_height(z, u, v)
    if abs(oz - ground) <= ON_SURFACE_M:  # False where there is no surface
        oz = ground
    elif ground > oz:
        return True
    if du == 0.0 and dv == 0.0:
        return dz < 0.0 and ground == oz
    first, last = _enter(z.shape[0], z.shape[1], u, v, du, dv)
    if not first <= last:
        return False
    if first > 0.0:
        u = min(max(u + du * first, 0.0), z.shape[1] - 1.0)
        v = min(max(v + dv * first, 0.0), z.shape[0] - 1.0)
        oz += dz * first
        if surface_height(z, u, v) > oz:
            return True
    return blocked(z, holes, pyramid, summit, u, v, oz, du, dv, dz, NEVER, NODE_LEVEL)


@njit(nogil=True, error_model="numpy", parallel=True)
def occluded_points(z, holes, pyramid, summit, u, v, above, du, dv, dz, out):
    """Write True into out (n,) for points where the surface rises above their ray; NaN: False."""
    done = 0
    for k in prange(u.size):
        done += 1
        known = not math.isnan(u[k] + v[k] + above[k])
        out[k] = known and _point_blocked(
            z, holes, pyramid, summit, u[k], v[k], above[k], du, dv, dz
        )
    all_done(done, u.size)


@njit(nogil=True, error_model="numpy", forceinline=True)
def _across(start, rate, inverse, limit):
    """Parameters between which a ray is between 0 and ``limit`` of an axis; NEVER, -NEVER if it
    never is.
    """
    a, b = -start * inverse, (limit - start) * inverse
    inside = 0.0 <= start <= limit
    low = min(a, b) if rate != 0.0 else (-NEVER if inside else NEVER)
    high = max(a, b) if rate != 0.0 else (NEVER if inside else -NEVER)
    return low, high


@njit(nogil=True, error_model="numpy", forceinline=True)
def approach(rows, cols, summit, ou, ov, oz, east, north, up, gsd):
    """A camera ray in cell units from the point where it is over the raster and below the summit:
    (du, dv, dz, their inverses, length, first, u, v, z).

    length: cells of the direction vector along the greater axis, 0 if vertical; first: the
    parameter of that point, NaN if the ray never gets there or is invalid.
    """
    du, dv, dz, longest = scaled(east, -north, up * gsd)
    inverse_u, inverse_v, inverse_z = inverse_of(du), inverse_of(dv), inverse_of(dz)
    low_u, high_u = _across(ou, du, inverse_u, cols - 1.0)
    low_v, high_v = _across(ov, dv, inverse_v, rows - 1.0)
    first, last = max(low_u, low_v, 0.0), min(high_u, high_v)
    under = max(first, (summit - oz) * inverse_z) if dz < 0.0 else NEVER
    first = under if oz + dz * first > summit else first
    first = first if (first < last) & math.isfinite(east + north + up) else math.nan
    comes = first > 0.0
    u = min(max(ou + du * first, 0.0), cols - 1.0) if comes else ou
    v = min(max(ov + dv * first, 0.0), rows - 1.0) if comes else ov
    height = oz + dz * first if comes else oz
    dz = dz if longest > 0.0 else up
    return du, dv, dz, inverse_u, inverse_v, inverse_z, longest / gsd, first, u, v, height


@njit(nogil=True, error_model="numpy", forceinline=True)
def hit_from(
    z, holes, pyramid, summit, oz, clear,
    du, dv, dz, inverse_u, inverse_v, inverse_z, length, first, u, v, height,
):  # fmt: skip
    """Range of the first intersection of a ray of `approach` with the surface from above, in units
    of its direction; NaN without any.

    ``clear``: a height down to which no terrain lies above the ray, or inf; it changes the time,
    not the result.
    """
    if math.isnan(first):
        return math.nan
    if length == 0.0:
        depth = oz - surface_height(z, u, v)
        return max(depth, 0.0) / -dz if dz < 0.0 and depth >= -UNDERGROUND_M else math.nan
    if height + UNDERGROUND_M < summit and surface_height(z, u, v) > height + UNDERGROUND_M:
        return math.nan
    s_clear, level = 0.0, CAMERA_LEVEL
    if clear < height and dz < 0.0:
        s_clear, level = (clear - height) * inverse_z, CLEAR_LEVEL
    s = met(
        z, holes, pyramid, summit, u, v, height, du, dv, dz,
        inverse_u, inverse_v, s_clear, level,
    )  # fmt: skip
    return (first + s) / length if s >= 0.0 else math.nan


@njit(nogil=True, error_model="numpy", parallel=True)
def first_hits(z, holes, pyramid, summit, ou, ov, oz, gsd, directions, out):
    """First hits of rays along ENU directions (n, 3) of any length from one point, each ray by
    itself; the reference for `camera_tiles.first_hits`.
    """
    rows, cols = z.shape
    ou, ov = on_grid(ou, ov)
    done = 0
    for k in prange(out.size):
        done += 1
        east, north, up = directions[k, 0], directions[k, 1], directions[k, 2]
        du, dv, dz, inverse_u, inverse_v, inverse_z, length, first, u, v, height = approach(
            rows, cols, summit, ou, ov, oz, east, north, up, gsd
        )
        out[k] = hit_from(
            z, holes, pyramid, summit, oz, math.inf,
            du, dv, dz, inverse_u, inverse_v, inverse_z, length, first, u, v, height,
        )  # fmt: skip
    all_done(done, out.size)
