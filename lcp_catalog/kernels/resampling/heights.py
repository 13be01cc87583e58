"""Resampling of height grids: cubic convolution that does not spread nodata, block means, ENU to
longitude and latitude.
"""

from __future__ import annotations

import math

import numpy as np

from ...constants import MOON_RADIUS_M
from ..cache import njit


@njit(nogil=True, inline="always")
def _keys(t, w):
    """Weights of Keys' cubic convolution with a = -0.5 (IEEE ASSP 29, 1981, eq. 15) at fraction
    ``t`` of the middle interval.

    Third order: exact for quadratics.
    """
    w[0] = t * (-0.5 + t * (1.0 - 0.5 * t))
    w[1] = 1.0 + t * t * (-2.5 + 1.5 * t)
    w[2] = t * (0.5 + t * (2.0 - 1.5 * t))
    w[3] = t * t * (-0.5 + 0.5 * t)


@njit(nogil=True, inline="always")
def _column(col, col0, cols, period):
    """Index in the window of a column of the raster, modulo ``period`` if the raster has a seam; -1
    outside.
    """
    c = col - col0
    if period > 0:
        if c < 0:
            c += period
        elif c >= cols:
            c -= period
    if c < 0 or c >= cols:
        return -1
    return c


@njit(nogil=True)
def sample(grid, row0, col0, period, u, v, out):
    """Heights at fractional pixels (column ``u``, row ``v``) of a raster of which ``grid`` is the
    window from (row0, col0).

    Cubic convolution where all sixteen pixels are valid, otherwise bilinear over the valid ones of
    the four; NaN where the nearest pixel is missing. ``period``: columns around the Moon, 0 if the
    raster has no seam.
    """
    rows, cols = grid.shape
    wx = np.empty(4)
    wy = np.empty(4)
    for k in range(u.size):
        if not (math.isfinite(u[k]) and math.isfinite(v[k])):
            out[k] = np.nan
            continue
        fi = math.floor(v[k])
        fj = math.floor(u[k])
        tv = v[k] - fi
        tu = u[k] - fj
        i = int(fi) - row0
        j = int(fj)
        if i < -1 or i > rows - 1:
            out[k] = np.nan
            continue
        c0 = _column(j - 1, col0, cols, period)
        c1 = _column(j, col0, cols, period)
        c2 = _column(j + 1, col0, cols, period)
        c3 = _column(j + 2, col0, cols, period)
        value = np.nan
        if i >= 1 and i + 2 < rows and c0 >= 0 and c1 >= 0 and c2 >= 0 and c3 >= 0:
            _keys(tu, wx)
            _keys(tv, wy)
            value = 0.0
            for a in range(4):
                g = grid[i - 1 + a]
                value += wy[a] * (wx[0] * g[c0] + wx[1] * g[c1] + wx[2] * g[c2] + wx[3] * g[c3])
        if math.isnan(value):
            value = _bilinear(grid, i, c1, c2, tu, tv)
        out[k] = value


@njit(nogil=True)
def _bilinear(grid, i, c1, c2, tu, tv):
    """Mean of the valid pixels with their bilinear weights; NaN if the nearest is missing."""
    rows = grid.shape[0]
    nearest_there = False  # half-way between pixels two or four are nearest
    for a in range(2):
        if i + a < 0 or i + a >= rows or (a == 0 and tv > 0.5) or (a == 1 and tv < 0.5):
            continue
        for b in range(2):
            c = c2 if b == 1 else c1
            if c < 0 or (b == 0 and tu > 0.5) or (b == 1 and tu < 0.5):
                continue
            nearest_there = nearest_there or grid[i + a, c] == grid[i + a, c]
    if not nearest_there:
        return np.nan
    total = 0.0
    weight = 0.0
    for a in range(2):
        if i + a < 0 or i + a >= rows:
            continue
        wa = tv if a == 1 else 1.0 - tv
        for b in range(2):
            c = c2 if b == 1 else c1
            if c < 0 or grid[i + a, c] != grid[i + a, c]:
                continue
            w = wa * (tu if b == 1 else 1.0 - tu)
            total += w * grid[i + a, c]
            weight += w
    return total / weight


@njit(nogil=True)
def block_means(grid, weight, factor, out):
    """Means of ``factor`` x ``factor`` blocks by ``weight``; NaN where less than half a block's
    weight has data.

    ``weight`` broadcasts by its shape: (rows, cols), or (rows, 1) if it depends on the row only.
    """
    wide = weight.shape[1] > 1
    for bi in range(out.shape[0]):
        for bj in range(out.shape[1]):
            total = 0.0
            there = 0.0
            whole = 0.0
            for a in range(bi * factor, (bi + 1) * factor):
                for b in range(bj * factor, (bj + 1) * factor):
                    w = weight[a, b if wide else 0]
                    whole += w
                    if grid[a, b] == grid[a, b]:
                        total += w * grid[a, b]
                        there += w
            out[bi, bj] = total / there if there >= 0.5 * whole and there > 0.0 else np.nan


@njit(nogil=True)
def enu_to_lonlat(x, y, z, rotation, up_m, lon, lat):
    """Longitude (0..2 pi) and latitude, radians, of ENU points; ``rotation`` is MCMF -> ENU, the
    frame's origin ``up_m`` from the centre.
    """
    for k in range(x.size):
        e = x[k]
        n = y[k]
        h = z[k] + up_m
        px = rotation[0, 0] * e + rotation[1, 0] * n + rotation[2, 0] * h
        py = rotation[0, 1] * e + rotation[1, 1] * n + rotation[2, 1] * h
        pz = rotation[0, 2] * e + rotation[1, 2] * n + rotation[2, 2] * h
        a = math.atan2(py, px)
        lon[k] = a if a >= 0.0 else a + 2.0 * math.pi
        lat[k] = math.atan2(pz, math.sqrt(px * px + py * py))


_STEEP = 2.0
"""Slope of terrain (63 deg), as a tangent, that the bound on the error of `improve_heights` holds for."""


_NARROW = 0.2
"""Tangent up to which `_narrow_atan` holds."""
_RUN = 256
"""Nodes of `lonlat_over` that are processed at once."""


@njit(nogil=True, inline="always")
def _narrow_atan(t):
    """Arc tangent of |t| <= `_NARROW`, by its series; the error is below that of rounding."""
    q = t * t
    s = -1.0 / 23.0
    s = 1.0 / 21.0 + q * s
    s = -1.0 / 19.0 + q * s
    s = 1.0 / 17.0 + q * s
    s = -1.0 / 15.0 + q * s
    s = 1.0 / 13.0 + q * s
    s = -1.0 / 11.0 + q * s
    s = 1.0 / 9.0 + q * s
    s = -1.0 / 7.0 + q * s
    s = 1.0 / 5.0 + q * s
    s = -1.0 / 3.0 + q * s
    return t + t * q * s


@njit(nogil=True, error_model="numpy")
def _turned_from(sine, cosine, east, north, up, lon_turn, lat_turn):
    """Differences of longitude and latitude, radians, of ENU directions (k,) from the origin of
    their frame, whose latitude has this sine and cosine.
    """
    wide = 0
    for k in range(east.size):
        level = cosine * up[k] - sine * north[k]
        axial = cosine * north[k] + sine * up[k]
        away = math.sqrt(east[k] * east[k] + level * level)
        a = east[k] / level
        b = (axial * cosine - away * sine) / (away * cosine + axial * sine)
        wide += (level <= 0.0) | (abs(a) > _NARROW) | (abs(b) > _NARROW)
        lon_turn[k], lat_turn[k] = _narrow_atan(a), _narrow_atan(b)
    if wide == 0:
        return
    for k in range(east.size):
        level = cosine * up[k] - sine * north[k]
        axial = cosine * north[k] + sine * up[k]
        away = math.sqrt(east[k] * east[k] + level * level)
        aside, above = axial * cosine - away * sine, away * cosine + axial * sine
        if level <= 0.0 or abs(east[k] / level) > _NARROW or abs(aside / above) > _NARROW:
            lon_turn[k], lat_turn[k] = math.atan2(east[k], level), math.atan2(aside, above)


@njit(nogil=True, error_model="numpy")
def lonlat_over(x, y, height, some, which, origins, lon, lat):
    """Longitude (0..360) and latitude, degrees, (k,) of the points at a height above the sphere over
    the nodes ``some`` (k,) of tangent planes.

    x, y, height, which (n,): place, height and frame of each node; origins (f, 2): longitude and
    latitude of the frames' origins, degrees.
    """
    east, north, up = np.empty(_RUN), np.empty(_RUN), np.empty(_RUN)
    lon_turn, lat_turn = np.empty(_RUN), np.empty(_RUN)
    first = 0
    while first < some.size:
        frame, count = which[some[first]], 0
        while count < _RUN and first + count < some.size and which[some[first + count]] == frame:
            i = some[first + count]
            radius = MOON_RADIUS_M + height[i]
            east[count], north[count] = x[i], y[i]
            up[count] = math.sqrt(radius * radius - (x[i] * x[i] + y[i] * y[i]))
            count += 1
        lon0, lat0 = origins[frame, 0], origins[frame, 1]
        turn = math.radians(lat0)
        _turned_from(
            math.sin(turn),
            math.cos(turn),
            east[:count],
            north[:count],
            up[:count],
            lon_turn,
            lat_turn,
        )
        for k in range(count):
            there = lon0 + math.degrees(lon_turn[k])
            there = there if there >= 0.0 else there + 360.0
            lon[first + k] = there if there < 360.0 else there - 360.0
            lat[first + k] = min(max(lat0 + math.degrees(lat_turn[k]), -90.0), 90.0)
        first += count


@njit(nogil=True)
def improve_heights(found, some, x, y, height, before, gap_before, tolerance, left):
    """One step towards the heights at which vertical lines meet the terrain: heights (n,) of the
    nodes ``some`` (k,) from the terrain's heights ``found`` (k,) at the points that they give. Write
    the nodes that need another step into ``left`` and return their number.

    A node is finished if its error is at most ``tolerance``: a height that differs by d from the
    terrain at its point is wrong by at most d q / (1 - q), where q is the terrain's slope times the
    tangent of the angle between the frame's vertical and the node's. A node without a height (NaN)
    is finished. The first step takes the height that was found, later ones the secant's root;
    ``before`` (NaN at first) and ``gap_before``: height and difference of the step before.
    """
    count = 0
    for k in range(some.size):
        i = some[k]
        guess, gap = height[i], found[k] - height[i]
        height[i] = found[k]
        if math.isnan(gap):
            continue
        away2 = x[i] * x[i] + y[i] * y[i]
        radius = MOON_RADIUS_M + found[k]
        rate = _STEEP * math.sqrt(away2 / max(radius * radius - away2, 1.0))
        if abs(gap) < tolerance or (rate < 1.0 and abs(gap) * rate <= tolerance * (1.0 - rate)):
            continue
        slope = 1.0 + (gap - gap_before[i]) / (guess - before[i])  # NaN at first
        if abs(slope) < 0.5:
            height[i] += gap * slope / (1.0 - slope)
        before[i], gap_before[i] = guess, gap
        left[count] = i
        count += 1
    return count


_STEPS = 8192.0
"""Steps in a metre: sums along a row are sums of integers, so that they do not depend on its first
column.
"""


@njit(nogil=True)
def row_means(grid, length, turn, pad, out):
    """Means along the rows of ``grid`` over ``length`` (rows,) pixels, real numbers of at least 1,
    corrected for the curvature of the parallel.

    ``grid`` has one row more on either side than ``out``, and ``pad`` columns more. A mean is that
    of the valid pixels, NaN if less than half are valid. Along a parallel near a pole the centre of
    a mean lies off the parallel; the mean is moved back along the meridian by ``turn`` (rows,)
    rows, with the slope between the neighbouring rows.
    """
    rows, wide = grid.shape
    cols = wide - 2 * pad
    means = np.empty((rows, cols))
    total = np.empty(wide + 1, np.int64)
    there = np.empty(wide + 1, np.int64)
    for i in range(rows):
        if length[i] <= 1.0:
            for j in range(cols):
                means[i, j] = grid[i, j + pad]
            continue
        total[0] = 0
        there[0] = 0
        for k in range(wide):
            known = grid[i, k] == grid[i, k]
            total[k + 1] = total[k] + (math.floor(grid[i, k] * _STEPS + 0.5) if known else 0)
            there[k + 1] = there[k] + (1 if known else 0)
        whole = math.floor((length[i] - 1.0) / 2.0)
        part = (length[i] - 1.0) / 2.0 - whole
        for j in range(cols):
            first = j + pad - whole
            last = j + pad + whole + 1
            summed = float(total[last] - total[first])
            weight = float(there[last] - there[first])
            if part > 0.0:
                summed += part * float(total[first] - total[first - 1])
                summed += part * float(total[last + 1] - total[last])
                weight += part * float(there[first] - there[first - 1])
                weight += part * float(there[last + 1] - there[last])
            means[i, j] = summed / weight / _STEPS if weight >= 0.5 * length[i] else np.nan
    for i in range(rows - 2):
        for j in range(cols):
            value = means[i + 1, j]
            moved = value + turn[i + 1] * 0.5 * (means[i + 2, j] - means[i, j])
            out[i, j] = value if turn[i + 1] == 0.0 or math.isnan(moved) else moved


@njit(nogil=True)
def clearance(grid, row0, col0, period, cover, u, v, reach, out):
    """Distance (pixels, at most ``reach``) of fractional pixels from the nearest missing one's
    square; the window is that of `sample` and must contain ``reach`` + 1 pixels around every place.
    ``cover``: first and last row, first and last column of the raster; pixels beyond it do not
    count as missing.
    """
    rows, cols = grid.shape
    span = math.ceil(reach) + 1
    for k in range(u.size):
        out[k] = reach
        if not (math.isfinite(u[k]) and math.isfinite(v[k])):
            continue
        i0 = math.floor(v[k] + 0.5)
        j0 = math.floor(u[k] + 0.5)
        nearest = reach * reach
        for i in range(i0 - span, i0 + span + 1):
            if i < row0 or i >= row0 + rows or i < cover[0] or i > cover[1]:
                continue
            dy = max(abs(v[k] - i) - 0.5, 0.0)
            if dy * dy >= nearest:
                continue
            for j in range(j0 - span, j0 + span + 1):
                c = _column(j, col0, cols, period)
                if j < cover[2] or j > cover[3] or c < 0 or grid[i - row0, c] == grid[i - row0, c]:
                    continue
                dx = max(abs(u[k] - j) - 0.5, 0.0)
                nearest = min(nearest, dx * dx + dy * dy)
        out[k] = math.sqrt(nearest)
