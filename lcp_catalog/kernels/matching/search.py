"""Templates sought in an image by centred, normalised correlation: at half resolution everywhere, then at full resolution from the
best few peaks uphill; or at full resolution everywhere.

A template has a mask: what it does not cover does not count. Missing pixels of the image are filled; where
too few under the mask are real, a place is not looked at.
"""

import math

import numpy as np
from numba import njit, prange

from .correlation import bounds, centred, correlations, window

NUMBERS = 6
"""What is said of each template: offset right and down, correlation, highest other peak (NaN: none), share of the search area
that lies in the image, highest share of real pixels under the mask."""

PEAKS = 6
"""Peaks at half resolution, at most, that are climbed at full resolution."""
_SLACK = 0.15
"""Peaks at half resolution that are lower by more than this than what the highest of them came to at full resolution are left."""


@njit(cache=True, nogil=True, error_model="numpy")
def _halved(values, mask, row_odd, col_odd):
    """A template at half resolution, on the blocks of an image: means of what the mask covers, and where that is half a block.

    row_odd, col_odd: whether its first row and column are the second of a block.
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


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "reassoc"})
def _at(image, weight, template, mask, count, row, col, least_real):
    """Correlation of a template with one window; -2 where it is not in the image or too little is real."""
    rows, cols = template.shape
    if row < 0 or col < 0 or row + rows > image.shape[0] or col + cols > image.shape[1]:
        return -2.0
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
        return -2.0
    variance = second - first * first / count
    return both / math.sqrt(variance) if variance > 1e-12 * second else 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def _peaks(score, places, heights):
    """The highest maxima (3 x 3) of a map, into places (k, 2) row and column and heights (k,), best first; how many."""
    ny, nx = score.shape
    found, size = 0, heights.size
    for y in range(ny):
        for x in range(nx):
            here = score[y, x]
            if here <= 0.0 or (found == size and here <= heights[size - 1]):
                continue
            top = True
            for i in range(max(0, y - 1), min(ny, y + 2)):
                for j in range(max(0, x - 1), min(nx, x + 2)):
                    if score[i, j] > here:
                        top = False
            if not top:
                continue
            k = min(found, size - 1)
            while k > 0 and heights[k - 1] < here:
                heights[k], places[k, 0], places[k, 1] = (
                    heights[k - 1],
                    places[k - 1, 0],
                    places[k - 1, 1],
                )
                k -= 1
            heights[k], places[k, 0], places[k, 1] = here, y, x
            found = min(found + 1, size)
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def _climb(image, weight, template, mask, count, row, col, limits, least_real):
    """Uphill from (row, col), one pixel at a time within limits (first and last row and column): where it ends and how high."""
    best = _at(image, weight, template, mask, count, row, col, least_real)
    for _ in range(8):
        up, left = row, col
        for i in range(-1, 2):
            for j in range(-1, 2):
                r, c = row + i, col + j
                if (
                    (i == 0 and j == 0)
                    or r < limits[0]
                    or r > limits[1]
                    or c < limits[2]
                    or c > limits[3]
                ):
                    continue
                here = _at(image, weight, template, mask, count, r, c, least_real)
                if here > best:
                    best, up, left = here, r, c
        if up == row and left == col:
            break
        row, col = up, left
    return row, col, best


@njit(cache=True, nogil=True, error_model="numpy")
def _choose(rows, cols, heights, exclusion, row, col, out):
    """The best of the peaks and the highest one farther from it than ``exclusion``."""
    best = 0
    for k in range(heights.size):
        if heights[k] > heights[best]:
            best = k
    out[0], out[1], out[2] = cols[best] - col, rows[best] - row, heights[best]
    for k in range(heights.size):
        if math.hypot(rows[k] - rows[best], cols[k] - cols[best]) > exclusion and heights[k] > -1.0:
            out[3] = heights[k] if math.isnan(out[3]) else max(out[3], heights[k])


@njit(cache=True, nogil=True, error_model="numpy")
def _seek(
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
    """One template whose first pixel is expected at (row, col); what is found into out."""
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
    if not coarse:
        score, out[5] = correlations(
            fine, fine_weight, template, mask, count, limits[0], limits[2], ny, nx, least_real
        )
        found = _peaks(score, places, heights)
        for k in range(found):
            places[k, 0], places[k, 1] = places[k, 0] + limits[0], places[k, 1] + limits[2]
    else:
        row_odd, col_odd = row % 2, col % 2
        small, inside = _halved(values, mask, row_odd, col_odd)
        narrow = np.empty(small.shape, np.float32)
        few = centred(small, inside, narrow)
        top, left = (row - row_odd) // 2, (col - col_odd) // 2
        box = window(half.shape, small.shape[0], small.shape[1], top, left, (reach + 1) // 2)
        if few == 0 or box[1] < box[0] or box[3] < box[2]:
            return
        score, out[5] = correlations(
            half, half_weight, narrow, inside, few,
            box[0], box[2], box[1] - box[0] + 1, box[3] - box[2] + 1, least_real,
        )  # fmt: skip
        found = _peaks(score, places, heights)
        kept = 0
        for k in range(found):
            if heights[k] < heights[0] - _SLACK:
                break
            r = min(max(row + 2 * (places[k, 0] + box[0] - top), limits[0]), limits[1])
            c = min(max(col + 2 * (places[k, 1] + box[2] - left), limits[2]), limits[3])
            places[k, 0], places[k, 1], heights[k] = _climb(
                fine, fine_weight, template, mask, count, r, c, limits, least_real
            )
            kept += 1
        found = kept
    if found:
        _choose(places[:found, 0], places[:found, 1], heights[:found], exclusion, row, col, out)


@njit(cache=True, nogil=True, error_model="numpy", parallel=True)
def seek(
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
    """Seek n templates; out (n, `NUMBERS`), NaN where nothing correlates.

    fine (rows, cols) float32 without NaN and fine_weight 0..1, half and half_weight their 2 x 2 means; values (n, h, w) float32,
    masks (n, h, w); origins (n, 2) column and row at which the first pixel is expected; reaches (n,); exclusion: another peak
    is farther from the best than this many pixels; coarse (n,) bool: half resolution first.
    """
    for k in prange(values.shape[0]):
        _seek(
            fine, fine_weight, half, half_weight, values[k], masks[k], origins[k, 1], origins[k, 0],
            reaches[k], exclusion[k], least_real, coarse[k], out[k],
        )  # fmt: skip
