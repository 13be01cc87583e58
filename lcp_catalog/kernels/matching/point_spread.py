"""Images of drawings on a fine grid through a pixel's square and a Gaussian point spread, at any
fraction of a pixel.
"""

import math

import numpy as np
from numba import njit, prange

from ..completion import all_done

_ROOT_HALF = math.sqrt(0.5)
_INVERSE_ROOT_TWO_PI = 1.0 / math.sqrt(2.0 * math.pi)


@njit(cache=True, nogil=True, error_model="numpy")
def _ramp(x, sigma):
    """Twice the integral of a Gaussian step from -infinity to x, and the step: (x Phi + sigma phi,
    Phi).
    """
    if sigma <= 0.0:
        return max(x, 0.0), (1.0 if x > 0.0 else (0.5 if x == 0.0 else 0.0))
    t = x / sigma
    step = 0.5 * math.erfc(-t * _ROOT_HALF)
    return x * step + sigma * _INVERSE_ROOT_TWO_PI * math.exp(-0.5 * t * t), step


@njit(cache=True, nogil=True, error_model="numpy")
def taps(sub, sigma, shift):
    """Weights of the samples around a pixel, their derivatives with respect to the shift, and the
    index of the first of them, counted from the pixel's own first sample.

    A sample represents a square of 1/sub pixel; a pixel is the mean over a unit square and a
    Gaussian of ``sigma`` pixels; the drawing is moved by ``shift`` pixels. The square of a sample
    widens the spread by 1/(12 sub^2) px^2, which is subtracted from the Gaussian's variance.
    """
    narrow = math.sqrt(max(sigma * sigma - 1.0 / (12.0 * sub * sub), 0.0))
    half = 0.5 + 4.0 * narrow + 1.0 / sub
    first = math.floor((0.5 - half - shift) * sub)
    last = math.ceil((0.5 + half - shift) * sub)
    weights = np.empty(last - first, np.float32)
    slopes = np.empty(last - first, np.float32)
    for k in range(last - first):
        # extent a..b of the sample's square, from the pixel's middle
        a = (first + k) / sub - 0.5 + shift
        b = a + 1.0 / sub
        r1, s1 = _ramp(b + 0.5, narrow)
        r2, s2 = _ramp(a + 0.5, narrow)
        r3, s3 = _ramp(b - 0.5, narrow)
        r4, s4 = _ramp(a - 0.5, narrow)
        weights[k] = np.float32(r1 - r2 - r3 + r4)
        slopes[k] = np.float32(s1 - s2 - s3 + s4)
    return weights, slopes, first


@njit(cache=True, nogil=True, error_model="numpy")
def unpack_drawing(drawing, sub, light, known):
    """Write a drawing (rows * sub, cols * sub), with 0 for NaN, into light, and its mask as 0 and 1
    into known. Column c * sub + s is stored at s * cols + c, so that samples with the same weight
    in neighbouring pixels are adjacent.
    """
    cols = light.shape[1] // sub
    for r in range(light.shape[0]):
        for s in range(sub):
            for c in range(cols):
                value = drawing[r, c * sub + s]
                seen = not math.isnan(value)
                light[r, s * cols + c] = value if seen else np.float32(0.0)
                known[r, s * cols + c] = np.float32(1.0) if seen else np.float32(0.0)


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _down(rows, first, weights, out):
    """Write the weighted sum of rows (m, n), from ``first`` to the last at most, into out (n,);
    four at a time.
    """
    k0, k1 = max(0, -first), min(weights.size, rows.shape[0] - first)
    out[:] = np.float32(0.0)
    k = k0
    while k + 3 < k1:
        w0, w1, w2, w3 = weights[k], weights[k + 1], weights[k + 2], weights[k + 3]
        x0, x1, x2, x3 = (
            rows[first + k],
            rows[first + k + 1],
            rows[first + k + 2],
            rows[first + k + 3],
        )
        for c in range(out.size):
            out[c] += (w0 * x0[c] + w1 * x1[c]) + (w2 * x2[c] + w3 * x3[c])
        k += 4
    while k < k1:
        w0, x0 = weights[k], rows[first + k]
        for c in range(out.size):
            out[c] += w0 * x0[c]
        k += 1


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _across(values, sub, first, weights, out):
    """Write the weighted sums of the samples ``values`` (sub * cols,), from ``first`` on, into out
    (cols,).
    """
    cols = out.size
    out[:] = np.float32(0.0)
    for k in range(weights.size):
        by = (first + k) // sub
        start = ((first + k) % sub) * cols
        w = weights[k]
        c0, c1 = max(0, -by), min(cols, cols - by)
        x, y = values[start + c0 + by : start + c1 + by], out[c0:c1]
        for c in range(y.size):
            y[c] += w * x[c]


@njit(cache=True, nogil=True, error_model="numpy")
def blurred(light, known, sub, sigma, shift_x, shift_y, sloped, out):
    """Write the pixels of a drawing in the layout of `unpack_drawing`, moved by a shift, into out
    (4, rows, cols) float32: value, its derivatives with respect to the shift right and down (if
    ``sloped``), and the share of the point spread that falls on the drawing; 0 where this share is
    0.
    """
    _, rows, cols = out.shape
    wx, gx, fx = taps(sub, sigma, shift_x)
    wy, gy, fy = taps(sub, sigma, shift_y)
    line = np.empty(sub * cols, np.float32)
    sums = np.zeros((6, cols), np.float32)
    for r in range(rows):
        first = r * sub + fy
        _down(light, first, wy, line)
        _across(line, sub, fx, wx, sums[0])
        if sloped:
            _across(line, sub, fx, gx, sums[1])
            _down(light, first, gy, line)
            _across(line, sub, fx, wx, sums[2])
        _down(known, first, wy, line)
        _across(line, sub, fx, wx, sums[3])
        if sloped:
            _across(line, sub, fx, gx, sums[4])
            _down(known, first, gy, line)
            _across(line, sub, fx, wx, sums[5])
        for c in range(cols):
            cover = sums[3, c]
            inverse = np.float32(1.0) / cover if cover > np.float32(1e-6) else np.float32(0.0)
            value = sums[0, c] * inverse
            out[0, r, c], out[3, r, c] = value, cover
            out[1, r, c] = (sums[1, c] - value * sums[4, c]) * inverse
            out[2, r, c] = (sums[2, c] - value * sums[5, c]) * inverse


@njit(cache=True, nogil=True, error_model="numpy", parallel=True)
def templates(drawings, sub, sigma, least, values, mask):
    """Write the templates of n drawings (n, rows * sub, cols * sub), not moved, into values (n,
    rows, cols) float32, and into mask True where at least a share ``least`` of the point spread
    falls on the drawing; values are 0 elsewhere.
    """
    n, rows, cols = values.shape
    done = 0
    for k in prange(n):
        done += 1
        seen = np.empty((4, rows, cols), np.float32)
        light = np.empty((rows * sub, sub * cols), np.float32)
        known = np.empty_like(light)
        unpack_drawing(drawings[k], sub, light, known)
        blurred(light, known, sub, sigma, 0.0, 0.0, False, seen)
        for r in range(rows):
            for c in range(cols):
                good = seen[3, r, c] >= least
                mask[k, r, c] = good
                values[k, r, c] = seen[0, r, c] if good else np.float32(0.0)
    all_done(done, n)
