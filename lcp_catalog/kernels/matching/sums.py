"""Sums over long float32 arrays, in the form that a processor computes fastest."""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "reassoc"})
def add_shifted(factors, step, values, out):
    """Add the sum of ``values``, shifted by 0, 1, 2 ... steps and times the factors (k,), to out
    (n,); values has at least n + (k - 1) step places.
    """
    count, n = factors.size, out.size
    k = 0
    while k + 7 < count:
        a, b, c, d = factors[k], factors[k + 1], factors[k + 2], factors[k + 3]
        e, f, g, h = factors[k + 4], factors[k + 5], factors[k + 6], factors[k + 7]
        o = k * step
        r0, r1 = values[o : o + n], values[o + step : o + step + n]
        r2, r3 = values[o + 2 * step : o + 2 * step + n], values[o + 3 * step : o + 3 * step + n]
        r4, r5 = values[o + 4 * step : o + 4 * step + n], values[o + 5 * step : o + 5 * step + n]
        r6, r7 = values[o + 6 * step : o + 6 * step + n], values[o + 7 * step : o + 7 * step + n]
        for x in range(n):
            out[x] += ((a * r0[x] + b * r1[x]) + (c * r2[x] + d * r3[x])) + (
                (e * r4[x] + f * r5[x]) + (g * r6[x] + h * r7[x])
            )
        k += 8
    while k + 1 < count:
        a, b, o = factors[k], factors[k + 1], k * step
        r0, r1 = values[o : o + n], values[o + step : o + step + n]
        for x in range(n):
            out[x] += a * r0[x] + b * r1[x]
        k += 2
    if k < count:
        a, r0 = factors[k], values[k * step : k * step + n]
        for x in range(n):
            out[x] += a * r0[x]


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "reassoc"})
def dot(a, b):
    """Sum of products of two arrays (n,)."""
    total = np.float32(0.0)
    for x in range(a.size):
        total += a[x] * b[x]
    return np.float64(total)
