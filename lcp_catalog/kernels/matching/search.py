"""Search for templates in an image by centred, normalised correlation: at half resolution
everywhere, then by steepest ascent at full resolution from the highest peaks; or at full resolution
everywhere.

Only pixels under a template's mask are used. Missing
pixels of the image are filled before; a place with too few valid pixels under the mask has no
correlation.
"""

import math

import numpy as np
from numba import prange

from ..cache import njit
from ..completion import all_done
from .correlation import FLAT, NOWHERE, bounds, centred, correlations, window
from .maxima import maxima

NUMBERS = 6
"""Results for each template: offset right and down, correlation, highest other peak (NaN: none),
share of the search area that lies in the image, highest share of valid pixels under the mask.
"""

PEAKS = 6
"""Greatest number of peaks at half resolution from which an ascent at full resolution starts."""
_SLACK = 0.15
"""Peaks at half resolution that lie more than this below the result of the first ascent are left
out.
"""
_STEPS = 8
"""Greatest number of steps of an ascent."""


@njit(nogil=True, error_model="numpy")
def _halved(values, mask, row_odd, col_odd):
    """A template at half resolution, on the 2 x 2 blocks of an image: means of the pixels under the
    mask, and the mask of blocks of which at least half is covered.

    row_odd, col_odd: 1 if the template's first row and column are the second of a block, else 0.
    """
    rows, cols = values.shape
    high, wide = (rows + row_odd + 1) // 2, (cols + col_odd + 1) // 2
    small, cover = np.zeros((high, wide), np.float32), np.zeros((high, wide), np.int64)
    for r in range(rows):
        for c in range(cols):
            if mask[r, c]:
                i, j = (r + row_odd) // 2, (c + col_odd) // 2
                small[i, j] += values[r, c]
                cover[i, j] += 1
    inside = cover >= 2
    for i in range(high):
        for j in range(wide):
            small[i, j] = small[i, j] / cover[i, j] if inside[i, j] else np.float32(0.0)
    return small, inside


@njit(nogil=True, error_model="numpy", fastmath={"contract", "reassoc"})
def _at(image, weight, template, mask, count, flat, row, col, least_real):
    """Correlation of a template with one window; `NOWHERE` if the window leaves the image or too
    few of its pixels are valid.

    A window whose sum of squares is not above ``flat`` correlates 0.
    """
    rows, cols = template.shape
    if row < 0 or col < 0 or row + rows > image.shape[0] or col + cols > image.shape[1]:
        return NOWHERE
    origin = np.float64(image[row, col])
    both = first = second = real = 0.0
    for i in range(rows):
        for j in range(cols):
            x = image[row + i, col + j] - origin
            x = x if mask[i, j] else 0.0
            both += template[i, j] * x
            first += x
            second += x * x
            real += weight[row + i, col + j] if mask[i, j] else 0.0
    if real < least_real * count:
        return NOWHERE
    variance = second - first * first / count
    return both / math.sqrt(variance) if variance > max(flat, 1e-12 * second) else 0.0


@njit(nogil=True, error_model="numpy")
def _climb(image, weight, template, mask, count, flat, row, col, limits, least_real):
    """Steepest ascent from (row, col), one pixel a step, within limits (first and last row and
    column).

    Return the last place and its correlation.
    """
    best = _at(image, weight, template, mask, count, flat, row, col, least_real)
    old_row, old_col = row - 9, col - 9
    for _ in range(_STEPS):
        up, left = row, col
        for i in range(-1, 2):
            for j in range(-1, 2):
                r, c = row + i, col + j
                if (
                    (abs(r - old_row) <= 1 and abs(c - old_col) <= 1)  # compared a step before
                    or (i == 0 and j == 0)
                    or r < limits[0]
                    or r > limits[1]
                    or c < limits[2]
                    or c > limits[3]
                ):
                    continue
                here = _at(image, weight, template, mask, count, flat, r, c, least_real)
                if here > best:
                    best, up, left = here, r, c
        if up == row and left == col:
            return row, col, best
        old_row, old_col, row, col = row, col, up, left
    return row, col, best


@njit(nogil=True, error_model="numpy")
def _choose(rows, cols, heights, exclusion, row, col, out):
    """Write the highest of the peaks and the highest one farther from it than ``exclusion`` into
    out.
    """
    best = 0
    for k in range(heights.size):
        if heights[k] > heights[best]:
            best = k
    out[0], out[1], out[2] = cols[best] - col, rows[best] - row, heights[best]
    for k in range(heights.size):
        if math.hypot(rows[k] - rows[best], cols[k] - cols[best]) > exclusion and heights[k] > -1.0:
            out[3] = heights[k] if math.isnan(out[3]) else max(out[3], heights[k])


@njit(nogil=True, error_model="numpy")
def _maxima(
    fine, fine_weight, half, half_weight, values, mask, template, count, row, col, limits, reach,
    least_real, coarse, places, heights,
):  # fmt: skip
    """The highest maxima of a template's correlation within limits, into places (k, 2; row and
    column) and heights (k,). Return their number and the highest share of valid pixels under the
    mask.
    """
    if not coarse:
        score, real, _ = correlations(
            fine, fine_weight, template, mask, count, limits[0], limits[2],
            limits[1] - limits[0] + 1, limits[3] - limits[2] + 1, least_real,
        )  # fmt: skip
        found = maxima(score, 0.0, 0, 0, 0, -1.0, places, heights)
        for k in range(found):
            places[k, 0], places[k, 1] = places[k, 0] + limits[0], places[k, 1] + limits[2]
        return found, real
    row_odd, col_odd = row % 2, col % 2
    small, inside = _halved(values, mask, row_odd, col_odd)
    narrow = np.empty(small.shape, np.float32)
    few = centred(small, inside, narrow)
    top, left = (row - row_odd) // 2, (col - col_odd) // 2
    box = window(half.shape, small.shape[0], small.shape[1], top, left, (reach + 1) // 2)
    if few == 0 or box[1] < box[0] or box[3] < box[2]:
        return 0, 0.0
    score, real, variance = correlations(
        half, half_weight, narrow, inside, few,
        box[0], box[2], box[1] - box[0] + 1, box[3] - box[2] + 1, least_real,
    )  # fmt: skip
    found = maxima(score, 0.0, 0, 0, 0, -1.0, places, heights)
    kept, flat = 0, FLAT * variance * count
    for k in range(found):
        if kept > 0 and heights[k] < heights[0] - _SLACK:
            break
        r = min(max(row + 2 * (places[k, 0] + box[0] - top), limits[0]), limits[1])
        c = min(max(col + 2 * (places[k, 1] + box[2] - left), limits[2]), limits[3])
        places[kept, 0], places[kept, 1], heights[kept] = _climb(
            fine, fine_weight, template, mask, count, flat, r, c, limits, least_real
        )
        kept += 1
    return kept, real


@njit(nogil=True, error_model="numpy")
def _find_template(
    fine,
    fine_weight,
    half,
    half_weight,
    values,
    mask,
    row,
    col,
    reach,
    exclusion,
    least_real,
    coarse,
    out,
):
    """Search for one template whose first pixel is expected at (row, col); the result goes into
    out.
    """
    r0, r1, c0, c1 = bounds(mask)
    out[:] = math.nan
    out[4] = out[5] = 0.0
    if r0 >= r1:
        return
    values, mask, row, col = values[r0:r1, c0:c1], mask[r0:r1, c0:c1], row + r0, col + c0
    template = np.empty(values.shape, np.float32)
    count = centred(values, mask, template)
    limits = window(fine.shape, r1 - r0, c1 - c0, row, col, reach)
    ny, nx = limits[1] - limits[0] + 1, limits[3] - limits[2] + 1
    if count == 0 or ny <= 0 or nx <= 0:
        return
    out[4] = ny * nx / (2.0 * reach + 1.0) ** 2
    places, heights = np.empty((PEAKS, 2), np.int64), np.zeros(PEAKS)
    found, out[5] = _maxima(
        fine, fine_weight, half, half_weight, values, mask, template, count, row, col, limits, reach,
        least_real, coarse, places, heights,
    )  # fmt: skip
    if found:
        _choose(places[:found, 0], places[:found, 1], heights[:found], exclusion, row, col, out)


@njit(nogil=True, error_model="numpy", parallel=True)
def find_templates(
    fine,
    fine_weight,
    half,
    half_weight,
    values,
    masks,
    origins,
    reaches,
    exclusion,
    least_real,
    coarse,
    out,
):
    """Search for n templates; out (n, `NUMBERS`), NaN where no correlation is above 0.

    fine (rows, cols) float32 without NaN and fine_weight 0..1, half and half_weight their 2 x 2
    means; values (n, h, w) float32, masks (n, h, w); origins (n, 2) column and row at which the
    first pixel is expected; reaches (n,) pixels; exclusion (n,): least distance of another peak
    from the best, pixels; coarse (n,) bool: half resolution first.
    """
    done = 0
    for k in prange(values.shape[0]):
        done += 1
        _find_template(
            fine, fine_weight, half, half_weight, values[k], masks[k], origins[k, 1], origins[k, 0],
            reaches[k], exclusion[k], least_real, coarse[k], out[k],
        )  # fmt: skip
    all_done(done, values.shape[0])
