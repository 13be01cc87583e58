"""Backward search: the inner part of an image at the place where a template was found, searched for
in the template.
"""

import math

import numpy as np
from numba import prange

from ..cache import njit
from ..completion import all_done
from .correlation import bounds, centred, correlations


@njit(nogil=True, error_model="numpy")
def _vertex(before, here, after):
    """Offset of the vertex of the parabola through three values from the middle one; 0 for a
    straight line.
    """
    bend = before - 2.0 * here + after
    if before <= -2.0 or after <= -2.0 or not bend < 0.0:
        return 0.0
    return 0.5 * (before - after) / bend


@njit(nogil=True, error_model="numpy")
def _filled(values, mask, share, out):
    """Write a template, with its mean outside the mask, into out, and its mask as 0 and 1 into
    share.
    """
    total, count = 0.0, 0
    for r in range(mask.shape[0]):
        for c in range(mask.shape[1]):
            if mask[r, c]:
                total += values[r, c]
                count += 1
    mean = np.float32(total / max(count, 1))
    for r in range(mask.shape[0]):
        for c in range(mask.shape[1]):
            out[r, c] = values[r, c] if mask[r, c] else mean
            share[r, c] = np.float32(1.0) if mask[r, c] else np.float32(0.0)


@njit(nogil=True, error_model="numpy")
def _chip(mask, image, weight, top, left, chip, known):
    """Write the image's pixels from (top, left) on as a template into chip. Return the number of
    pixels used, 0 if the template is flat or leaves the image.
    """
    rows, cols = chip.shape
    if top < 0 or left < 0 or top + rows > image.shape[0] or left + cols > image.shape[1]:
        return 0
    for r in range(rows):
        for c in range(cols):
            known[r, c] = mask[r, c] and weight[top + r, left + c] > np.float32(0.0)
    return centred(image[top : top + rows, left : left + cols], known, chip)


@njit(nogil=True, error_model="numpy")
def _summit(score):
    """Row and column of a map's maximum, to a fraction of a pixel, and its height; NaN if no value
    is above 0.
    """
    best, i, j = np.float32(0.0), -1, -1
    for y in range(score.shape[0]):
        for x in range(score.shape[1]):
            if score[y, x] > best:
                best, i, j = score[y, x], y, x
    if i < 0:
        return math.nan, math.nan, math.nan
    row, col = float(i), float(j)
    if 0 < i < score.shape[0] - 1:
        row += _vertex(score[i - 1, j], best, score[i + 1, j])
    if 0 < j < score.shape[1] - 1:
        col += _vertex(score[i, j - 1], best, score[i, j + 1])
    return row, col, best


@njit(nogil=True, error_model="numpy")
def _find_backwards(values, mask, image, weight, row0, col0, inner, reach, least_real, out):
    r0, r1, c0, c1 = bounds(mask)
    if r0 >= r1:
        return
    values, mask = values[r0:r1, c0:c1], mask[r0:r1, c0:c1]
    high, wide = r1 - r0, c1 - c0
    cut_r, cut_c = int(0.5 * (1.0 - inner) * high), int(0.5 * (1.0 - inner) * wide)
    rows, cols = high - 2 * cut_r, wide - 2 * cut_c
    chip, known = np.empty((rows, cols), np.float32), np.empty((rows, cols), np.bool_)
    part = mask[cut_r : cut_r + rows, cut_c : cut_c + cols]
    count = _chip(part, image, weight, row0 + r0 + cut_r, col0 + c0 + cut_c, chip, known)
    if count == 0:
        return
    whole, share = np.empty((high, wide), np.float32), np.empty((high, wide), np.float32)
    _filled(values, mask, share, whole)
    y0, y1 = max(0, cut_r - reach), min(high - rows, cut_r + reach)
    x0, x1 = max(0, cut_c - reach), min(wide - cols, cut_c + reach)
    score, _, _ = correlations(
        whole, share, chip, known, count, y0, x0, y1 - y0 + 1, x1 - x0 + 1, least_real
    )
    down, right, out[2] = _summit(score)
    out[0], out[1] = right + x0 - cut_c, down + y0 - cut_r


@njit(nogil=True, error_model="numpy", parallel=True)
def find_backwards(values, masks, image, weight, places, inner, reach, least_real, out):
    """Search for the image's inner part (share ``inner`` of each side) at n found ``places`` (n, 2:
    column, row of the template's first pixel) in the templates (n, h, w), within ``reach`` pixels:
    out (n, 3) shift right and down, correlation; NaN for none.

    A template has its mean outside its mask; at least a share ``least_real`` of the inner part must
    lie on the mask.
    """
    done = 0
    for k in prange(values.shape[0]):
        done += 1
        out[k] = math.nan
        _find_backwards(
            values[k], masks[k], image, weight, places[k, 1], places[k, 0], inner, reach, least_real, out[k],
        )  # fmt: skip
    all_done(done, values.shape[0])
