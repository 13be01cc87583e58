"""Centred, normalised correlation of masked templates with an image, at every place of a window.

Only pixels under a template's mask are used. Missing pixels of the image are filled before; a place
with too few valid pixels under the mask has no correlation.
"""

import math

import numpy as np
from numba import prange

from ..cache import njit
from ..completion import all_done

NOWHERE = np.float32(-2.0)
"""Value of a correlation map at places without a correlation."""
FLAT = 1e-6
"""A window whose variance is below this share of its region's variance correlates 0."""


@njit(nogil=True, error_model="numpy")
def bounds(mask):
    """Half-open rows and columns of the box around a mask: first row, row behind the last, first
    column, column behind the last.
    """
    rows, cols = mask.shape
    r0, r1, c0, c1 = rows, 0, cols, 0
    for r in range(rows):
        for c in range(cols):
            if mask[r, c]:
                r0, r1 = min(r0, r), max(r1, r + 1)
                c0, c1 = min(c0, c), max(c1, c + 1)
    return r0, r1, c0, c1


@njit(nogil=True, error_model="numpy")
def centred(values, mask, out):
    """Write the template less its mean, of unit length, 0 outside its mask, into out. Return the
    mask's pixels, 0 if it is flat.
    """
    total, count = 0.0, 0
    for r in range(values.shape[0]):
        for c in range(values.shape[1]):
            if mask[r, c]:
                total += values[r, c]
                count += 1
    mean = total / max(count, 1)
    power = 0.0
    for r in range(values.shape[0]):
        for c in range(values.shape[1]):
            power += (values[r, c] - mean) ** 2 if mask[r, c] else 0.0
    if not power > 1e-14 * mean * mean * count:
        return 0
    scale = 1.0 / math.sqrt(power)
    for r in range(values.shape[0]):
        for c in range(values.shape[1]):
            out[r, c] = np.float32((values[r, c] - mean) * scale) if mask[r, c] else np.float32(0.0)
    return count


@njit(nogil=True, error_model="numpy")
def window(shape, high, wide, row, col, reach):
    """First and last row, first and last column at which a window of high x wide pixels lies in an
    image, within ``reach`` of (row, col).
    """
    return (
        max(0, row - reach), min(shape[0] - high, row + reach),
        max(0, col - reach), min(shape[1] - wide, col + reach),
    )  # fmt: skip


@njit(nogil=True, error_model="numpy")
def _prefixes(region, share):
    """Sums along the rows of a region's values, squares and weights, each after a leading 0; and
    True if any weight is not 1.
    """
    rows, cols = region.shape
    one, two = np.zeros((rows, cols + 1)), np.zeros((rows, cols + 1))
    real, gaps = np.zeros((rows, cols + 1)), False
    for r in range(rows):
        for c in range(cols):
            x = np.float64(region[r, c])
            one[r, c + 1] = one[r, c] + x
            two[r, c + 1] = two[r, c] + x * x
            real[r, c + 1] = real[r, c] + share[r, c]
            gaps = gaps or share[r, c] != np.float32(1.0)
    return one, two, real, gaps


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _add_products(template, row, sums):
    """Add the products of a template's row with an image's row at nx places to sums (nx,); four
    pixels at a time.
    """
    nx = sums.size
    j = 0
    while j + 3 < template.size:
        a, b, d, e = template[j], template[j + 1], template[j + 2], template[j + 3]
        x0, x1, x2, x3 = (
            row[j : j + nx],
            row[j + 1 : j + 1 + nx],
            row[j + 2 : j + 2 + nx],
            row[j + 3 : j + 3 + nx],
        )
        for x in range(nx):
            sums[x] += (a * x0[x] + b * x1[x]) + (d * x2[x] + e * x3[x])
        j += 4
    while j < template.size:
        a, x0 = template[j], row[j : j + nx]
        for x in range(nx):
            sums[x] += a * x0[x]
        j += 1


@njit(nogil=True, error_model="numpy")
def _add_run(prefix, j0, j1, sums):
    """Add the sums of a row's pixels j0 to j1, relative to each of nx places, to sums (nx,);
    ``prefix``: sums from the row's start.
    """
    low, high = prefix[j0 : j0 + sums.size], prefix[j1 : j1 + sums.size]
    for x in range(sums.size):
        sums[x] += high[x] - low[x]


@njit(nogil=True, error_model="numpy")
def _region(image, row, col, high, wide):
    """A part of an image less its mean, and its variance."""
    mean = 0.0
    for r in range(high):
        for c in range(wide):
            mean += image[row + r, col + c]
    mean /= high * wide
    out = np.empty((high, wide), np.float32)
    power = 0.0
    for r in range(high):
        for c in range(wide):
            out[r, c] = np.float32(image[row + r, col + c] - mean)
            power += np.float64(out[r, c]) ** 2
    return out, power / (high * wide)


@njit(nogil=True, error_model="numpy")
def _add_row(mask, one, two, real, gaps, first, second, known):
    """Add the image's pixels under a row of the mask to the places' sums (nx,) of values, squares
    and, with gaps, weights.
    """
    j = 0
    while j < mask.size:
        if not mask[j]:
            j += 1
            continue
        j0 = j
        while j < mask.size and mask[j]:
            j += 1
        _add_run(one, j0, j, first)
        _add_run(two, j0, j, second)
        if gaps:
            _add_run(real, j0, j, known)


@njit(nogil=True, error_model="numpy")
def correlations(image, weight, template, mask, count, row, col, ny, nx, least_real):
    """Correlations (ny, nx) of a template (rows, cols; `centred`, ``count`` pixels of mask) with
    the windows from (row, col) on; `NOWHERE` where less than ``least_real`` of the pixels under the
    mask are valid. Also the highest such share, and the variance of the image over all these
    windows.
    """
    rows, cols = template.shape
    region, variance = _region(image, row, col, ny + rows - 1, nx + cols - 1)
    share = weight[row : row + ny + rows - 1, col : col + nx + cols - 1]
    flat = FLAT * variance * count
    one, two, real, gaps = _prefixes(region, share)
    out = np.empty((ny, nx), np.float32)
    best_real = 0.0 if gaps else 1.0
    sums, first, second, known = np.empty(nx, np.float32), np.empty(nx), np.empty(nx), np.empty(nx)
    for y in range(ny):
        sums[:] = np.float32(0.0)
        first[:] = 0.0
        second[:] = 0.0
        known[:] = 0.0 if gaps else count
        for i in range(rows):
            _add_products(template[i], region[y + i], sums)
            _add_row(mask[i], one[y + i], two[y + i], real[y + i], gaps, first, second, known)
        for x in range(nx):
            spread = second[x] - first[x] * first[x] / count
            best_real = max(best_real, known[x] / count)
            here = sums[x] / math.sqrt(spread) if spread > flat else 0.0
            out[y, x] = np.float32(here) if known[x] >= least_real * count else NOWHERE
    return out, best_real, variance


@njit(nogil=True, error_model="numpy", parallel=True)
def maps(image, weight, values, masks, origins, reach, least_real, out):
    """Write the correlations of n templates at every offset within ``reach`` into out (n, 2 reach +
    1, 2 reach + 1) rows and columns; NaN where a template leaves the image or too few pixels under
    it are valid.
    """
    done = 0
    for k in prange(values.shape[0]):
        done += 1
        out[k] = np.nan
        r0, r1, c0, c1 = bounds(masks[k])
        if r0 >= r1:
            continue
        mask = masks[k, r0:r1, c0:c1]
        template = np.empty(mask.shape, np.float32)
        count = centred(values[k, r0:r1, c0:c1], mask, template)
        row, col = origins[k, 1] + r0, origins[k, 0] + c0
        limits = window(image.shape, r1 - r0, c1 - c0, row, col, reach)
        ny, nx = limits[1] - limits[0] + 1, limits[3] - limits[2] + 1
        if count == 0 or ny <= 0 or nx <= 0:
            continue
        score, _, _ = correlations(
            image, weight, template, mask, count, limits[0], limits[2], ny, nx, least_real
        )
        top, left = limits[0] - row + reach, limits[2] - col + reach
        for y in range(ny):
            for x in range(nx):
                if score[y, x] > NOWHERE:
                    out[k, top + y, left + x] = score[y, x]
    all_done(done, values.shape[0])
