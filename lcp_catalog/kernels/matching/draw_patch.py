"""Drawing of patches of terrain, each without other terrain, as a camera sees them, on a grid finer
than its pixels.

For each node of a patch the radiance and the clearance of its ray to the Sun above the patch are
computed. Both are interpolated over the surface's triangles; at each sample the triangle nearest to
the camera counts. A sample is lit if the interpolated clearance is positive, so that the edge of a
shadow lies between nodes.
"""

import math

import numpy as np
from numba import prange

from ..cache import njit
from ..completion import all_done
from ..photometry.laws import phase_terms, radiance_factor
from ..rays.surface import node_normal

_ALONG = 1e-12
"""A ray that deviates by less than this from a row or a column runs along it."""
_ENDLESS = 1e9
_NEAR = 2.5
"""Steps from a node within which the ray's clearance is not used as a distance from a shadow: it
starts at 0.
"""
_FAR = np.float32(np.inf)
_TOUCHING = 1.0 + 1e-12


@njit(nogil=True, error_model="numpy")
def _over_lines(z, i, dv, dz, side, step, reach, least):
    """Lower the least clearances (n,) of the rays from the nodes of row i to those at their crossings with columns, each ray
    up to its ``reach`` (n,) steps away. dv, dz: rows and metres per step; a ray crosses a column towards ``side`` (1, -1)
    every ``step`` steps. A clearance near the start of a ray counts only where the surface rises above it.
    """
    rows, cols = z.shape
    farthest = reach.max()
    k = 1
    while k * step <= farthest and k < cols:
        s = k * step
        v = i + dv * s
        r = min(max(math.floor(v), 0), rows - 2)
        share, rise, is_far = v - r, dz * s, s >= _NEAR
        first, last = (0, cols - k) if side > 0 else (k, cols)
        upper, lower = (
            z[r, first + side * k : last + side * k],
            z[r + 1, first + side * k : last + side * k],
        )
        here, limit, out = z[i, first:last], reach[first:last], least[first:last]
        for j in range(here.size):
            gap = here[j] + rise - (upper[j] + (lower[j] - upper[j]) * share)
            counts = (s <= limit[j]) & (gap < out[j]) & (is_far | (gap < 0.0))
            out[j] = gap if counts else out[j]
        k += 1


@njit(nogil=True, error_model="numpy")
def _over_diagonals(z, j, du, dv, dz, reach, least):
    """The same for the rays from the nodes of column j and their crossings with the cells' diagonals; z and the results as rows
    of columns. A node of the border counts in its row or column.
    """
    cols, rows = z.shape
    across = du - dv
    step = 1.0 / abs(across)
    farthest = reach.max()
    k = 1
    while k * step <= farthest:
        s = k * step
        u = j + du * s
        c = min(max(math.floor(u), 0), cols - 2)
        away = c - j + (-k if across > 0.0 else k)
        share, rise, is_far = u - c, dz * s, s >= _NEAR
        first, last = max(0, -away), min(rows, rows - 1 - away)
        if first < last:
            left, right = (
                z[c, first + away : last + away],
                z[c + 1, first + away + 1 : last + away + 1],
            )
            here, limit, out = z[j, first:last], reach[first:last], least[first:last]
            for i in range(here.size):
                gap = here[i] + rise - (left[i] + (right[i] - left[i]) * share)
                counts = (s <= limit[i]) & (gap < out[i]) & (is_far | (gap < 0.0))
                out[i] = gap if counts else out[i]
        k += 1


@njit(nogil=True, error_model="numpy", inline="always")
def _to_border(place, rate, last):
    """Steps until a ray from ``place`` leaves 0..last, increased by rounding, so that the crossing
    on the border itself, which is computed differently, is not later.
    """
    if rate == 0.0:
        return _ENDLESS
    return _TOUCHING * ((last - place) / rate if rate > 0.0 else -place / rate)


@njit(nogil=True, error_model="numpy")
def _reach(heights, du, dv, dz, summit, out):
    """Write the steps after which a ray from each node, towards the Sun, is beyond the border or above the summit."""
    rows, cols = heights.shape
    for i in range(rows):
        down = _to_border(i, dv, rows - 1)
        for j in range(cols):
            out[i, j] = min(_to_border(j, du, cols - 1), down)
            if dz > 0.0:
                out[i, j] = min(out[i, j], (summit - heights[i, j]) / dz + _NEAR)


@njit(nogil=True, error_model="numpy")
def _relief(z):
    """Greatest height, and the gradient of the steepest facet in metres per cell; 0 for missing
    nodes.
    """
    rows, cols = z.shape
    summit, steepest = -1e30, 0.0
    for i in range(rows):
        for j in range(cols):
            if z[i, j] > summit:
                summit = np.float64(z[i, j])
            if i < rows - 1 and j < cols - 1:
                z00, z11 = np.float64(z[i, j]), np.float64(z[i + 1, j + 1])
                for corner in (np.float64(z[i, j + 1]), np.float64(z[i + 1, j])):
                    g = (corner - z00) ** 2 + (z11 - corner) ** 2
                    steepest = max(steepest, g)
    return summit, math.sqrt(steepest)


@njit(nogil=True, error_model="numpy")
def clearances(z, gsd, sun, out):
    """Write the least clearance of each node's ray towards the Sun (3,) above the patch's own
    surface, metres, into out; 1 everywhere if no facet is as steep as the rays.
    """
    rows, cols = z.shape
    summit, steepest = _relief(z)
    flat = math.hypot(sun[0], sun[1])
    if sun[2] * gsd >= steepest * flat or flat == 0.0:
        out[:] = np.float32(1.0 if sun[2] > 0.0 else -1.0)
        return
    largest = max(abs(sun[0]), abs(sun[1]))
    du, dv, dz = sun[0] / largest, -sun[1] / largest, sun[2] * gsd / largest
    du, dv = (du if abs(du) > _ALONG else 0.0), (dv if abs(dv) > _ALONG else 0.0)
    # at every crossing with a row, a column or a diagonal the ray's height is compared with the edge crossed;
    # rays of one row cross columns at one height of the row, so that a row, or a column, is one loop
    heights = z.astype(np.float64)
    reach, least = np.empty((rows, cols)), np.full((rows, cols), _ENDLESS)
    _reach(heights, du, dv, dz, summit, reach)
    if du != 0.0:
        for i in range(rows):
            _over_lines(
                heights, i, dv, dz, 1 if du > 0.0 else -1, 1.0 / abs(du), reach[i], least[i]
            )
    turned, far, low = heights.T.copy(), reach.T.copy(), least.T.copy()
    for j in range(cols):
        if dv != 0.0:
            _over_lines(turned, j, du, dz, 1 if dv > 0.0 else -1, 1.0 / abs(dv), far[j], low[j])
        if du != dv:
            _over_diagonals(turned, j, du, dv, dz, far[j], low[j])
    out[:] = low.T


@njit(nogil=True, error_model="numpy")
def _corner_weights(f, g, out):
    """Bilinear weights of the corners north-west, north-east, south-west, south-east at shares f
    (east) and g (south).
    """
    out[0], out[1] = (1.0 - f) * (1.0 - g), f * (1.0 - g)
    out[2], out[3] = (1.0 - f) * g, f * g


@njit(nogil=True, error_model="numpy")
def shade(z, gsd, sun, towards, code, law, out):
    """Write the radiance factors of a patch's nodes, without cast shadows, into out (rows, cols)
    float32. towards (4, 3): directions to the camera from the corners nw, ne, sw, se; they and the
    law's terms of the phase are interpolated between.

    0 where the Sun is behind a node, NaN where a node has no normal.
    """
    rows, cols = z.shape
    terms = np.empty((4, 2))
    cosines = np.empty(4)
    for c in range(4):
        cos_g = sun[0] * towards[c, 0] + sun[1] * towards[c, 1] + sun[2] * towards[c, 2]
        cosines[c] = min(1.0, max(-1.0, cos_g))
        terms[c, 0], terms[c, 1] = phase_terms(code, law, cosines[c])
    w = np.empty(4)
    here = np.empty(2)
    for i in range(rows):
        for j in range(cols):
            x, y, up = node_normal(z, gsd, i, j)
            mu0 = x * sun[0] + y * sun[1] + up * sun[2]
            if not mu0 > 0.0:
                out[i, j] = np.float32(0.0 * mu0)
                continue
            _corner_weights(j / (cols - 1), i / (rows - 1), w)
            vx = vy = vz = cos_g = 0.0
            here[0] = here[1] = 0.0
            for c in range(4):
                vx += w[c] * towards[c, 0]
                vy += w[c] * towards[c, 1]
                vz += w[c] * towards[c, 2]
                cos_g += w[c] * cosines[c]
                here[0] += w[c] * terms[c, 0]
                here[1] += w[c] * terms[c, 1]
            mu = (x * vx + y * vy + up * vz) / math.sqrt(vx * vx + vy * vy + vz * vz)
            out[i, j] = np.float32(radiance_factor(code, law, here, mu0, mu, cos_g))


@njit(nogil=True, error_model="numpy", inline="always")
def _span(a, b, c, size):
    """First and last integer between the least and the greatest of three values, within 0..size -
    1.
    """
    low, high = min(a, b, c), max(a, b, c)
    return max(math.ceil(low), 0), min(math.floor(high), size - 1)


@njit(nogil=True, error_model="numpy")
def _triangle(x, y, d, b, m, depth, out):
    """Draw one triangle where it is the nearest so far: x, y (3,) samples, d depths, b radiance, m
    clearances.

    Corners run clockwise as seen from outside the Moon (rows grow downwards). In the opposite order
    the surface is seen from below: it occludes what is behind it and is drawn as NaN.
    """
    x0, y0 = x[0], y[0]
    ax, ay, bx, by = x[1] - x0, y[1] - y0, x[2] - x0, y[2] - y0
    area = ax * by - ay * bx
    if not abs(area) > 1e-12:
        return
    col0, col1 = _span(x0, x[1], x[2], out.shape[1])
    row0, row1 = _span(y0, y[1], y[2], out.shape[0])
    inverse = 1.0 / area
    for row in range(row0, row1 + 1):
        py = row - y0
        for col in range(col0, col1 + 1):
            px = col - x0
            s = (px * by - py * bx) * inverse
            t = (ax * py - ay * px) * inverse
            # one branch: three would be mispredicted more often than they save
            if (s < -1e-9) | (t < -1e-9) | (s + t > 1.0 + 1e-9):
                continue
            far = np.float32(d[0] + s * (d[1] - d[0]) + t * (d[2] - d[0]))
            if far < depth[row, col]:
                depth[row, col] = far
                if area < 0.0:
                    out[row, col] = np.float32(np.nan)
                    continue
                clear = m[0] + s * (m[1] - m[0]) + t * (m[2] - m[0])
                light = b[0] + s * (b[1] - b[0]) + t * (b[2] - b[0])
                out[row, col] = np.float32(light) if clear >= 0.0 else np.float32(0.0 * light)


@njit(nogil=True, error_model="numpy")
def _draw(x, y, far, light, clear, depth, out):
    """Draw all triangles of a patch; x, y, far, light, clear (rows, cols)."""
    rows, cols = x.shape
    corners = np.empty((5, 3))
    for i in range(rows - 1):
        for j in range(cols - 1):
            for upper in range(2):
                i1, j1 = (i, j + 1) if upper else (i + 1, j + 1)
                i2, j2 = (i + 1, j + 1) if upper else (i + 1, j)
                _pick(corners, 0, x, y, far, light, clear, i, j)
                _pick(corners, 1, x, y, far, light, clear, i1, j1)
                _pick(corners, 2, x, y, far, light, clear, i2, j2)
                _triangle(corners[0], corners[1], corners[2], corners[3], corners[4], depth, out)


@njit(nogil=True, error_model="numpy", inline="always")
def _pick(corners, k, x, y, far, light, clear, i, j):
    corners[0, k], corners[1, k], corners[2, k] = x[i, j], y[i, j], far[i, j]
    corners[3, k], corners[4, k] = light[i, j], clear[i, j]


@njit(nogil=True, error_model="numpy", parallel=True)
def draw_patches(z, gsd, albedo, suns, towards, pixels, origins, sub, code, law, out):
    """Draw n patches into out (n, rows, cols) float32: radiance factor at ``sub`` x ``sub`` samples
    of each pixel, NaN where the patch is not visible.

    z (n, p, p) heights, gsd (n,), albedo (n, p, p) or (n, 0, 0) for 1, suns (n, 3), towards (n, 4,
    3) to the camera from the corners nw, ne, sw, se, all in each patch's own frame; pixels (n, p,
    p, 2) of the nodes; origins (n, 2): column and row of each drawing's first pixel.
    """
    n, p, q = z.shape
    done = 0
    for k in prange(n):
        done += 1
        light, clear = np.empty((p, q), np.float32), np.empty((p, q), np.float32)
        shade(z[k], gsd[k], suns[k], towards[k], code, law, light)
        clearances(z[k], gsd[k], suns[k], clear)
        x, y, far = np.empty((p, q)), np.empty((p, q)), np.empty((p, q))
        look = towards[k, 0] + towards[k, 1] + towards[k, 2] + towards[k, 3]
        for i in range(p):
            for j in range(q):
                x[i, j] = (pixels[k, i, j, 0] - origins[k, 0] + 0.5) * sub - 0.5
                y[i, j] = (pixels[k, i, j, 1] - origins[k, 1] + 0.5) * sub - 0.5
                east, north = (j - 0.5 * (q - 1)) * gsd[k], (0.5 * (p - 1) - i) * gsd[k]
                far[i, j] = -(east * look[0] + north * look[1] + z[k, i, j] * look[2])
                if albedo.shape[1] > 0:
                    light[i, j] *= albedo[k, i, j]
        depth = np.full(out.shape[1:], _FAR)
        out[k] = np.float32(np.nan)
        _draw(x, y, far, light, clear, depth, out[k])
    all_done(done, n)
