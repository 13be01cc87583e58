"""Images of drawings on a fine grid through a pixel's square and a Gaussian point spread, at any
fraction of a pixel.
"""

import math

import numpy as np
from numba import prange

from ..cache import njit
from ..completion import all_done
from ..vectors import LANES, load, load_four, multiple, splat, splat_at, store, store_four

_ROOT_HALF = math.sqrt(0.5)
_INVERSE_ROOT_TWO_PI = 1.0 / math.sqrt(2.0 * math.pi)


@njit(nogil=True, error_model="numpy")
def _ramp(x, sigma):
    """Twice the integral of a Gaussian step from -infinity to x, and the step: (x Phi + sigma phi,
    Phi).
    """
    if sigma <= 0.0:
        return max(x, 0.0), (1.0 if x > 0.0 else (0.5 if x == 0.0 else 0.0))
    t = x / sigma
    step = 0.5 * math.erfc(-t * _ROOT_HALF)
    return x * step + sigma * _INVERSE_ROOT_TWO_PI * math.exp(-0.5 * t * t), step


@njit(nogil=True, error_model="numpy")
def _narrowed(sub, sigma):
    """Sigma of the Gaussian without the square of a sample."""
    return math.sqrt(max(sigma * sigma - 1.0 / (12.0 * sub * sub), 0.0))


@njit(nogil=True, error_model="numpy")
def _half_width(sub, sigma):
    """Pixels from a pixel's middle to the farthest sample that counts."""
    return 0.5 + 4.0 * _narrowed(sub, sigma) + 1.0 / sub


@njit(nogil=True, error_model="numpy")
def taps(sub, sigma, shift):
    """Weights of the samples around a pixel, their derivatives with respect to the shift, and the
    index of the first of them, counted from the pixel's own first sample.

    A sample represents a square of 1/sub pixel; a pixel is the mean over a unit square and a
    Gaussian of ``sigma`` pixels; the drawing is moved by ``shift`` pixels. The square of a sample
    widens the spread by 1/(12 sub^2) px^2, which is subtracted from the Gaussian's variance.
    """
    narrow, half = _narrowed(sub, sigma), _half_width(sub, sigma)
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


@njit(nogil=True, error_model="numpy")
def margin_for(sub, sigma, farthest):
    """Pixels beside a drawing that the point spread reaches with shifts of up to ``farthest`` pixels."""
    return math.ceil(_half_width(sub, sigma) + farthest + 1.5)


@njit(nogil=True, error_model="numpy")
def unpack_drawing(drawing, sub, margin):
    """Light and mask (0 and 1) of a drawing (rows * sub, cols * sub), with 0 for NaN: two arrays (rows * sub, sub * wide).
    Column c * sub + s is stored at s * wide + margin + c, so that samples with the same weight in neighbouring
    pixels are adjacent; beside them are ``margin`` and more zeros.
    """
    cols = drawing.shape[1] // sub
    wide = multiple(cols, LANES) + 2 * margin
    light = np.zeros((drawing.shape[0], sub * wide), np.float32)
    known = np.zeros_like(light)
    for r in range(drawing.shape[0]):
        for s in range(sub):
            for c in range(cols):
                value = drawing[r, c * sub + s]
                if not math.isnan(value):
                    light[r, s * wide + margin + c] = value
                    known[r, s * wide + margin + c] = np.float32(1.0)
    return light, known


@njit(nogil=True, error_model="numpy")
def _four(weights, k, a, b, c, d):
    """Sum of four vectors with the weights from k on."""
    return (splat_at(weights, k) * a + splat_at(weights, k + 1) * b) + (
        splat_at(weights, k + 2) * c + splat_at(weights, k + 3) * d
    )


@njit(nogil=True, error_model="numpy")
def _down(light, known, long, first, at, weights, slopes, line):
    """Sums along a column of `LANES` samples, from row ``first`` on and place ``at`` in each row, into four lines (4 long,):
    light with the weights and with the slopes, and the mask with both. Rows beyond the drawing are left out.
    """
    a = b = c = d = splat(np.float32(0.0))
    k, end = max(0, -first), min(weights.size, light.size // long - first)
    here = (first + k) * long + at
    while k + 3 < end:
        p, q, r, s = load_four(light, here, long)
        a, b = a + _four(weights, k, p, q, r, s), b + _four(slopes, k, p, q, r, s)
        p, q, r, s = load_four(known, here, long)
        c, d = c + _four(weights, k, p, q, r, s), d + _four(slopes, k, p, q, r, s)
        k, here = k + 4, here + 4 * long
    while k < end:
        w, g, p, q = splat_at(weights, k), splat_at(slopes, k), load(light, here), load(known, here)
        a, b, c, d = a + w * p, b + g * p, c + w * q, d + g * q
        k, here = k + 1, here + long
    store_four(line, at, long, a, b, c, d)


@njit(nogil=True, error_model="numpy")
def _across(line, long, wide, sub, first, at, weights, slopes, sums):
    """Sums along the rows of `_down` for `LANES` pixels from place ``at`` on, into sums (6 `LANES`,): of light, of its
    slopes right and down, and the same of the mask.
    """
    a = b = c = d = e = f = splat(np.float32(0.0))
    for k in range(weights.size):
        here = (first + k) % sub * wide + (first + k) // sub + at
        w, g, (p, q, r, s) = splat_at(weights, k), splat_at(slopes, k), load_four(line, here, long)
        a, b, c = a + w * p, b + g * p, c + w * q
        d, e, f = d + w * r, e + g * r, f + w * s
    store_four(sums, 0, LANES, a, b, c, d)
    store(sums, 4 * LANES, e)
    store(sums, 5 * LANES, f)


@njit(nogil=True, error_model="numpy")
def blurred(light, known, margin, sub, sigma, shift_x, shift_y, out):
    """Write the pixels of a drawing in the layout of `unpack_drawing`, with the same margin, moved by a shift, into out
    (4, rows, cols) float32: value, its derivatives with respect to the shift right and down, and the
    share of the point spread that falls on the drawing; 0 where this share is 0. The margin is at least
    that of `margin_for` the shift.
    """
    _, rows, cols = out.shape
    wx, gx, fx = taps(sub, sigma, shift_x)
    wy, gy, fy = taps(sub, sigma, shift_y)
    long = light.shape[1]
    wide = long // sub
    flat, mask = light.reshape(-1), known.reshape(-1)
    line, sums = np.zeros(4 * long, np.float32), np.empty(6 * LANES, np.float32)
    for r in range(rows):
        for at in range(margin, margin + cols, LANES):
            for s in range(sub):
                _down(flat, mask, long, r * sub + fy, s * wide + at, wy, gy, line)
        for start in range(0, cols, LANES):
            _across(line, long, wide, sub, fx, margin + start, wx, gx, sums)
            for k in range(min(LANES, cols - start)):
                c, cover = start + k, sums[3 * LANES + k]
                inverse = np.float32(1.0) / cover if cover > np.float32(1e-6) else np.float32(0.0)
                value = sums[k] * inverse
                out[0, r, c], out[3, r, c] = value, cover
                out[1, r, c] = (sums[LANES + k] - value * sums[4 * LANES + k]) * inverse
                out[2, r, c] = (sums[2 * LANES + k] - value * sums[5 * LANES + k]) * inverse


@njit(nogil=True, error_model="numpy", parallel=True)
def templates(drawings, sub, sigma, least, values, mask):
    """Write the templates of n drawings (n, rows * sub, cols * sub), not moved, into values (n,
    rows, cols) float32, and into mask True where at least a share ``least`` of the point spread
    falls on the drawing; values are 0 elsewhere.
    """
    n, rows, cols = values.shape
    margin = margin_for(sub, sigma, 0.0)
    done = 0
    for k in prange(n):
        done += 1
        seen = np.empty((4, rows, cols), np.float32)
        light, known = unpack_drawing(drawings[k], sub, margin)
        blurred(light, known, margin, sub, sigma, 0.0, 0.0, seen)
        for r in range(rows):
            for c in range(cols):
                good = seen[3, r, c] >= least
                mask[k, r, c] = good
                values[k, r, c] = seen[0, r, c] if good else np.float32(0.0)
    all_done(done, n)
