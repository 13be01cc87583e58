"""Intersections of rays with a sphere around the origin, without cancellation, and the share of a
pixel inside the limb.

With p the ray's start, d its direction of any length and R the radius: a = d.d, b = p.d,
c = p.p - R^2, and p + t d lies on the sphere where a t^2 + 2 b t + c = 0. Its discriminant
b^2 - a c cancels for far cameras and near the limb, c for low cameras. Both, and b, are sums of
products in double-double arithmetic: two floats hold 106 bits (Dekker, Numer. Math. 18, 1971; sums
after Knuth, TAOCP 2, 4.2.2). Only the rounding of the last few operations remains. The roots are
computed in the form that adds (t = c / (-b +- root) where -b -+ root would cancel).
"""

import math

import numpy as np

from .cache import njit

_LANES = 256
"""Rays whose components are stored side by side first, for SIMD processing."""

_SPLITTER = 134217729.0  # 2^27 + 1: splits a float64 into two halves of 26 bits


@njit(nogil=True, error_model="numpy", forceinline=True)
def _two_sum(a, b):
    """a + b and its rounding error (Knuth)."""
    total = a + b
    part = total - a
    return total, (a - (total - part)) + (b - part)


@njit(nogil=True, error_model="numpy", forceinline=True)
def _two_product(a, b):
    """a b and its rounding error (Veltkamp's splitting, Dekker's product)."""
    product = a * b
    big = _SPLITTER * a
    a1 = big - (big - a)
    a2 = a - a1
    big = _SPLITTER * b
    b1 = big - (big - b)
    b2 = b - b1
    return product, ((a1 * b1 - product) + a1 * b2 + a2 * b1) + a2 * b2


@njit(nogil=True, error_model="numpy", forceinline=True)
def _add(a, a_rest, b, b_rest):
    """Sum of two pairs, accurate to 2^-104 of the larger even if the high parts cancel."""
    high, low = _two_sum(a, b)
    rest, rest_low = _two_sum(a_rest, b_rest)
    low += rest
    total = high + low
    low = (low - (total - high)) + rest_low
    high = total + low
    return high, low - (high - total)


@njit(nogil=True, error_model="numpy", forceinline=True)
def _times(a, a_rest, b, b_rest):
    """Product of two pairs."""
    high, low = _two_product(a, b)
    low += a * b_rest + a_rest * b
    total = high + low
    return total, low - (total - high)


@njit(nogil=True, error_model="numpy", forceinline=True)
def _dot(ax, ay, az, bx, by, bz):
    """Scalar product as a pair."""
    x, x_rest = _two_product(ax, bx)
    y, y_rest = _two_product(ay, by)
    z, z_rest = _two_product(az, bz)
    high, low = _add(x, x_rest, y, y_rest)
    return _add(high, low, z, z_rest)


@njit(nogil=True, error_model="numpy", forceinline=True)
def above(px, py, pz, radius):
    """p.p - R^2 as a pair; positive for p outside the sphere."""
    high, low = _dot(px, py, pz, px, py, pz)
    square, rest = _two_product(radius, radius)
    return _add(high, low, -square, -rest)


@njit(nogil=True, error_model="numpy", forceinline=True)
def range_to(px, py, pz, dx, dy, dz, c, c_rest):
    """Distance along a ray to the sphere, in the unit of p for any length of d; NaN if the ray
    misses.

    From outside the nearer crossing, from inside the only one ahead. From the sphere itself (c = 0)
    0 for a ray that enters, NaN for one that leaves or touches. ``c``: `above` of p.
    """
    a, a_rest = _dot(dx, dy, dz, dx, dy, dz)
    b, b_rest = _dot(px, py, pz, dx, dy, dz)
    square, square_rest = _times(b, b_rest, b, b_rest)
    product, product_rest = _times(a, a_rest, c, c_rest)
    under_root, _ = _add(square, square_rest, -product, -product_rest)
    # without branches, so that many rays are processed at once. From outside b < 0, and the
    # nearer root is c / (root - b); from inside -c / (root + b) or, where that cancels, (root - b) / a
    root = math.sqrt(max(under_root, 0.0))
    sum_of_both = root + abs(b)
    divided = (c >= 0.0) | (b > 0.0)
    t = (abs(c) if divided else sum_of_both) / (sum_of_both if divided else a)
    meets = (c < 0.0) | ((b < 0.0) & (under_root >= 0.0))
    return t * math.sqrt(a) if meets else np.nan


@njit(nogil=True, error_model="numpy")
def ranges(origins, directions, radius, out):
    """Write `range_to` of rays (n, 3) from origins (n, 3), or (1, 3) for all, into ``out`` (n,)."""
    if origins.shape[0] == 1:
        px, py, pz = origins[0]
        c, c_rest = above(px, py, pz, radius)
        dx, dy, dz = np.empty(_LANES), np.empty(_LANES), np.empty(_LANES)
        for first in range(0, directions.shape[0], _LANES):
            count = min(_LANES, directions.shape[0] - first)
            for k in range(count):
                dx[k], dy[k], dz[k] = directions[first + k]
            for k in range(count):
                out[first + k] = range_to(px, py, pz, dx[k], dy[k], dz[k], c, c_rest)
        return
    for k in range(directions.shape[0]):
        px, py, pz = origins[k, 0], origins[k, 1], origins[k, 2]
        c, c_rest = above(px, py, pz, radius)
        dx, dy, dz = directions[k, 0], directions[k, 1], directions[k, 2]
        out[k] = range_to(px, py, pz, dx, dy, dz, c, c_rest)


@njit(nogil=True, error_model="numpy")
def longest_components(directions):
    """Least and greatest of the longest components of rays (n, 3); NaN if their sum is not finite."""
    least, most = np.inf, 0.0
    for k in range(directions.shape[0]):
        x, y, z = abs(directions[k, 0]), abs(directions[k, 1]), abs(directions[k, 2])
        if not math.isfinite(x + y + z):
            return np.nan, np.nan
        longest = max(x, y, z)
        least, most = min(least, longest), max(most, longest)
    return least, most


@njit(nogil=True, error_model="numpy")
def heights(origins, radius, out):
    """Write the height of points (n, 3) over the sphere into ``out`` (n,): (p.p - R^2) / (|p| + R),
    accurate to the last bits at any height.
    """
    for k in range(origins.shape[0]):
        px, py, pz = origins[k]
        c, _ = above(px, py, pz, radius)
        out[k] = c / (math.sqrt(px * px + py * py + pz * pz) + radius)


@njit(nogil=True, error_model="numpy", forceinline=True)
def _crossing(f, g):
    """Share 0..1 of the way from f to g (one above 0, one not) at which a line crosses 0."""
    return f / (f - g)


@njit(nogil=True, error_model="numpy")
def covered(values, shares, middles):
    """Share of each of n pixels in which a function is above 0, and the middle of that part.

    values (n, k + 1, k + 1): the function at the corners of k x k equal cells of a pixel, whose
    zero line is taken as straight within a cell. Results go into shares (n,) and middles (n, 2):
    column and row from the pixel's middle, in pixels; 0 where the share is 0.
    """
    cells = values.shape[1] - 1
    xs, ys = np.empty(8), np.empty(8)
    corner_x, corner_y = (0.0, 1.0, 1.0, 0.0), (0.0, 0.0, 1.0, 1.0)
    for n in range(values.shape[0]):
        total = mean_x = mean_y = 0.0
        for i in range(cells):
            for j in range(cells):
                corners = (
                    values[n, i, j],
                    values[n, i, j + 1],
                    values[n, i + 1, j + 1],
                    values[n, i + 1, j],
                )
                count = 0
                for m in range(4):
                    after = (m + 1) % 4
                    f, g = corners[m], corners[after]
                    if f > 0.0:
                        xs[count], ys[count] = corner_x[m], corner_y[m]
                        count += 1
                    if (f > 0.0) != (g > 0.0):
                        t = _crossing(f, g)
                        xs[count] = corner_x[m] + t * (corner_x[after] - corner_x[m])
                        ys[count] = corner_y[m] + t * (corner_y[after] - corner_y[m])
                        count += 1
                area, x, y = _moments(xs, ys, count)
                total += area
                mean_x += area * j + x
                mean_y += area * i + y
        shares[n] = total / (cells * cells)
        middles[n, 0] = mean_x / total / cells - 0.5 if total > 0.0 else 0.0
        middles[n, 1] = mean_y / total / cells - 0.5 if total > 0.0 else 0.0


@njit(nogil=True, error_model="numpy", forceinline=True)
def _moments(xs, ys, count):
    """Area of a polygon, and the integrals of x and y over it."""
    area = x = y = 0.0
    for m in range(count):
        after = m + 1 if m + 1 < count else 0
        cross = xs[m] * ys[after] - xs[after] * ys[m]
        area += 0.5 * cross
        x += cross * (xs[m] + xs[after]) / 6.0
        y += cross * (ys[m] + ys[after]) / 6.0
    return area, x, y
