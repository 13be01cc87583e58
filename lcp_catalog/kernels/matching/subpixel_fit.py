"""Least squares between drawings and an image: the shift to a fraction of a pixel, and its
covariance.
"""

import math

import numpy as np
from numba import prange

from ..cache import njit
from ..completion import all_done
from .point_spread import blurred, margin_for, unpack_drawing

NUMBERS = 10
"""Results of `refine` for each drawing: shift right and down, correlation, covariance xx, xy, yy
(px^2), gain, noise, pixels, correlation of neighbouring residuals.
"""

_STEPS = 16
_SETTLED_PX = 0.004
_LAST_STEP_PX = 0.05
_FARTHEST_PX = 1.5
_LONGER = 1.5
"""Factor of the share of a step that is made, after each step that agrees with the one before."""
_LAGS = 7
"""Distance in pixels beyond which residuals are taken as independent."""
_MISMATCH = 3.0
"""Factor of the growth of the variance with the correlation of neighbouring residuals; measured.
Errors of a render are smooth over more than the lags, and part of them resembles a shift and leaves
no residual.
"""
_FEWEST = 12


@njit(nogil=True, error_model="numpy")
def _solve3(a, b, c, d, e, f, r0, r1, r2):
    """Solution of the symmetric system [[a, b, c], [b, d, e], [c, e, f]] x = r; NaN when singular."""
    m00, m01, m02 = d * f - e * e, c * e - b * f, b * e - c * d
    det = a * m00 + b * m01 + c * m02
    m11, m12, m22 = a * f - c * c, b * c - a * e, a * d - b * b
    scale = abs(a * d * f)
    inverse = 1.0 / det if abs(det) > 1e-12 * scale and scale > 0.0 else math.nan
    return (
        (m00 * r0 + m01 * r1 + m02 * r2) * inverse,
        (m01 * r0 + m11 * r1 + m12 * r2) * inverse,
        (m02 * r0 + m12 * r1 + m22 * r2) * inverse,
    )


@njit(nogil=True, error_model="numpy")
def _weights(seen, weight, least, row0, col0, out):
    """Write the weight of each pixel of a template in the image into out (rows, cols). Return the
    sum of weights.

    At a patch's edge the weight rises linearly with the cover of the point spread, from 2 least - 1
    to 1. With a step at ``least`` the squared error would jump as pixels enter and leave with the
    shift, and would have no minimum to converge to.
    """
    low, rise = 2.0 * least - 1.0, 1.0 / max(2.0 - 2.0 * least, 1e-6)
    total = 0.0
    for r in range(out.shape[0]):
        for c in range(out.shape[1]):
            i, j = row0 + r, col0 + c
            inside = 0 <= i < weight.shape[0] and 0 <= j < weight.shape[1]
            covered = min(max((seen[3, r, c] - low) * rise, 0.0), 1.0)
            w = weight[i, j] * covered if inside else 0.0
            out[r, c] = w
            total += w
    return total


@njit(nogil=True, error_model="numpy")
def _centre(values, w, total):
    """Subtract the weighted mean from values (rows, cols), in place."""
    mean = 0.0
    for r in range(w.shape[0]):
        for c in range(w.shape[1]):
            mean += w[r, c] * values[r, c]
    mean /= total
    for r in range(w.shape[0]):
        for c in range(w.shape[1]):
            values[r, c] -= mean


@njit(nogil=True, error_model="numpy", fastmath={"contract", "reassoc"})
def _dot(a, b, w):
    total = 0.0
    for r in range(w.shape[0]):
        for c in range(w.shape[1]):
            total += w[r, c] * (a[r, c] * b[r, c])
    return total


@njit(nogil=True, error_model="numpy")
def _step(seen, light, w):
    """One Gauss-Newton step from a centred template, its slopes and the centred image: right, down,
    the gain, and the correlation before the step; NaN for a singular system or a gain that is not
    positive.
    """
    t, gx, gy = seen[0], seen[1], seen[2]
    tt, ti, ii = _dot(t, t, w), _dot(t, light, w), _dot(light, light, w)
    if not (tt > 0.0 and ii > 0.0):
        return math.nan, math.nan, math.nan, math.nan
    right, down, gain = _solve3(
        _dot(gx, gx, w), _dot(gx, gy, w), _dot(gx, t, w), _dot(gy, gy, w), _dot(gy, t, w), tt,
        _dot(gx, light, w), _dot(gy, light, w), ti,
    )  # fmt: skip
    if not gain > 0.0:
        return math.nan, math.nan, math.nan, math.nan
    return right / gain, down / gain, gain, ti / math.sqrt(tt * ii)


@njit(nogil=True, error_model="numpy")
def _gather(image, row0, col0, seen, w, light, total):
    """Write the image's pixels of positive weight into light; subtract its mean, and those of the
    template and its slopes.
    """
    for r in range(w.shape[0]):
        for c in range(w.shape[1]):
            light[r, c] = image[row0 + r, col0 + c] if w[r, c] > 0.0 else 0.0
    for k in range(3):
        _centre(seen[k], w, total)
    _centre(light, w, total)


@njit(nogil=True, error_model="numpy")
def _fit(
    drawn, known, margin, sub, sigma, least, image, weight, row0, col0, start, seen, light, w, out
):
    """Gauss-Newton iteration on shift, gain and offset from the template at (row0, col0). Return
    False if it does not converge nearby.

    On return ``seen`` has the centred template and its slopes, ``light`` the centred image, w the
    weights, and out the shift, correlation and gain. The correlation is that before the last,
    negligible step. Where the residuals are large, whole steps are too long and can alternate
    between two places for ever: a step against the one before halves the share of the step that is
    made, and every other step raises it by `_LONGER`, up to the whole step. The fit has converged
    when the whole step is short, so that a small share does not end it.
    """
    dx, dy, size = start[0], start[1], math.inf
    last_right, last_down, share = 0.0, 0.0, 1.0
    for _ in range(_STEPS):
        blurred(drawn, known, margin, sub, sigma, dx, dy, seen)
        total = _weights(seen, weight, least, row0, col0, w)
        if total < _FEWEST:
            return False
        _gather(image, row0, col0, seen, w, light, total)
        right, down, out[6], out[2] = _step(seen, light, w)
        if right * last_right + down * last_down < 0.0:
            share *= 0.5
        else:
            share = min(1.0, _LONGER * share)
        last_right, last_down = right, down
        size = math.hypot(right, down)
        short = share / max(size, 1.0)
        dx, dy = dx + right * short, dy + down * short
        out[0], out[1] = dx, dy
        if not math.hypot(dx - start[0], dy - start[1]) < _FARTHEST_PX:  # also for a NaN step
            return False
        if size < _SETTLED_PX:
            return True
    return size < _LAST_STEP_PX


@njit(nogil=True, error_model="numpy", fastmath={"contract", "reassoc"})
def _at_lag(w, rest, gx, gy, lag):
    """Sums over pairs of pixels that lie ``lag`` places apart: of weights, of residuals, and of the slopes' products xx,
    xy (both ways, halved), yy. Arrays (n,) as `_covariance` lays them out.
    """
    count = w.size - lag
    wa, ra, xa, ya = w[:count], rest[:count], gx[:count], gy[:count]
    wb, rb, xb, yb = w[lag:], rest[lag:], gx[lag:], gy[lag:]
    pairs = both = xx = xy = yy = 0.0
    for c in range(count):
        pairs += wa[c] * wb[c]
        both += ra[c] * rb[c]
        xx += xa[c] * xb[c]
        xy += xa[c] * yb[c] + ya[c] * xb[c]
        yy += ya[c] * yb[c]
    return pairs, both, xx, 0.5 * xy, yy


@njit(nogil=True, error_model="numpy")
def _covariance(seen, light, w, out):
    """Covariance of the shift, into out[3:6], the noise of a pixel, out[7], and pixels used,
    out[8].

    M^-1 B M^-1, M the sum of a a^T over the pixels, a the slopes after their projections on gain
    and offset are subtracted; B the same sum over pairs of pixels up to `_LAGS` apart, each
    weighted with the covariance of the residuals at that lag (Newey and West 1987, in two
    dimensions), tapered. Not less than for white residuals.
    """
    rows, cols = w.shape
    t, gx, gy = seen[0], seen[1], seen[2]
    tt = _dot(t, t, w)
    gain = _dot(t, light, w) / tt
    share_x, share_y = _dot(gx, t, w) / tt, _dot(gy, t, w) / tt
    # rows one behind the other, with zeros between them that no lag crosses
    wide = cols + _LAGS
    weight, rest = np.zeros(rows * wide), np.zeros(rows * wide)
    along, across = np.zeros(rows * wide, np.float32), np.zeros(rows * wide, np.float32)
    count = 0
    for r in range(rows):
        for c in range(cols):
            k = r * wide + c
            along[k] = (gx[r, c] - share_x * t[r, c]) * gain * w[r, c]
            across[k] = (gy[r, c] - share_y * t[r, c]) * gain * w[r, c]
            rest[k] = (light[r, c] - gain * t[r, c]) * w[r, c]
            weight[k] = w[r, c]
            count += w[r, c] > 0.0
    bxx = bxy = byy = 0.0
    white = near = 0.0
    for down in range(_LAGS + 1):
        for right in range(-_LAGS if down else 0, _LAGS + 1):
            lag = down * wide + right
            pairs, both, xx, xy, yy = _at_lag(weight, rest, along, across, lag)
            if pairs <= 0.0:
                continue
            taper = (1.0 - abs(right) / (_LAGS + 1.0)) * (1.0 - down / (_LAGS + 1.0))
            here = both / pairs
            if down == 0 and right == 0:
                white = here * count / max(count - 4.0, 1.0)
                mxx, mxy, myy = xx, xy, yy
                bxx, bxy, byy = white * xx, white * xy, white * yy
            else:
                if down + abs(right) == 1:
                    near += 0.5 * here
                bxx += 2.0 * taper * here * xx
                bxy += 2.0 * taper * here * xy
                byy += 2.0 * taper * here * yy
    det = mxx * myy - mxy * mxy
    if not det > 1e-9 * mxx * myy:
        out[3] = out[4] = out[5] = math.nan
        return
    ixx, ixy, iyy = myy / det, -mxy / det, mxx / det
    pxx, pxy = ixx * bxx + ixy * bxy, ixx * bxy + ixy * byy
    pyx, pyy = ixy * bxx + iyy * bxy, ixy * bxy + iyy * byy
    out[3], out[4] = pxx * ixx + pxy * ixy, pxx * ixy + pxy * iyy
    out[5] = pyx * ixy + pyy * iyy
    if not (out[3] > white * ixx and out[5] > white * iyy and out[3] * out[5] > out[4] * out[4]):
        out[3], out[4], out[5] = white * ixx, white * ixy, white * iyy
    likeness = near / white if white > 0.0 else 0.0
    grow = 1.0 + _MISMATCH * min(max(likeness, 0.0), 1.0)
    out[3], out[4], out[5] = out[3] * grow, out[4] * grow, out[5] * grow
    out[7], out[8], out[9] = math.sqrt(max(white, 0.0)), count, likeness


@njit(nogil=True, error_model="numpy", parallel=True)
def refine(fine, sub, sigma, least, image, weight, places, starts, whole, out):
    """Locate n drawings in an image to a fraction of a pixel, from whole pixels ``places`` (n, 2:
    column and row of the template's first pixel) and shifts ``starts`` (n, 2); out (n, `NUMBERS`),
    NaN where the fit does not converge, and NaN in the numbers from 3 on without ``whole``, except for the gain.

    image (rows, cols) float32 without NaN, weight (rows, cols) 0..1.
    """
    n = fine.shape[0]
    rows, cols = fine.shape[1] // sub, fine.shape[2] // sub
    done = 0
    for k in prange(n):
        done += 1
        seen = np.empty((4, rows, cols), np.float32)
        farthest = _FARTHEST_PX + max(abs(starts[k, 0]), abs(starts[k, 1]))
        margin = margin_for(sub, sigma, farthest)
        drawn, known = unpack_drawing(fine[k], sub, margin)
        light, w = np.empty((rows, cols)), np.empty((rows, cols))
        out[k] = np.nan
        out[k, 0], out[k, 1] = starts[k, 0], starts[k, 1]
        col0, row0 = places[k, 0], places[k, 1]
        if _fit(
            drawn, known, margin, sub, sigma, least, image, weight, row0, col0, starts[k], seen, light, w, out[k],
        ):  # fmt: skip
            if whole:
                _covariance(seen, light, w, out[k])
        else:
            out[k] = np.nan
    all_done(done, n)
