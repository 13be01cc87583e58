"""Places of an image that resemble a part of it: the maxima of a template's centred, normalised
correlation around its own place, and its correlation at given distances.

The images of a stack share their pixels' positions. The norm of every window of an image is computed
once for all templates (`window_norms`). Large search areas are searched at half resolution first;
from the highest maxima there steepest ascents lead to maxima at full resolution.
"""

import math

import numpy as np
from numba import njit, prange

from .correlation import FLAT, window
from .maxima import maxima
from .sums import add_shifted, dot

_ASCENTS = 6
"""Greatest number of maxima at half resolution that are followed to full resolution."""
_LOSS = 0.1
"""A maximum at full resolution is at most so much above the one at half resolution."""
_AROUND = 3
"""Pixels around a window that are copied with it; at least the greatest distance of the ring."""
_STEPS = 8
"""Greatest number of steps of an ascent."""
_MARGIN = 3.0
"""Pixels by which a maximum at half resolution may lie nearer than the exclusion."""
_LOWEST = -1.5


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "reassoc"})
def _power(image):
    """Variance of an image (rows, cols) with a mean of about 0."""
    total = power = 0.0
    for r in range(image.shape[0]):
        line = image[r]
        one = two = np.float32(0.0)
        for c in range(line.size):
            one += line[c]
            two += line[c] * line[c]
        total += one
        power += two
    return power / image.size - (total / image.size) ** 2


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _window_sums(image, row, size, first, second):
    """Move sums over ``size`` rows of the pixels and their squares, (cols,) each, to those that end
    with ``row``.
    """
    new = image[row]
    if row < size:
        for c in range(new.size):
            x = np.float64(new[c])
            first[c] += x
            second[c] += x * x
    else:
        old = image[row - size]
        for c in range(new.size):
            x, y = np.float64(new[c]), np.float64(old[c])
            first[c] += x - y
            second[c] += x * x - y * y


@njit(cache=True, nogil=True, error_model="numpy", parallel=True)
def window_norms(stack, size, out):
    """Write the reciprocal of the norm of every centred window of size x size pixels into out (k,
    rows - size + 1, cols - size + 1), and 0 for windows whose variance is not above `FLAT` times
    that of their image; stack (k, rows, cols) float32 without NaN, about 0.
    """
    count = size * size
    for k in prange(stack.shape[0]):
        image, norms = stack[k], out[k]
        rows, cols = image.shape
        first, second, spread = np.zeros(cols), np.zeros(cols), np.empty(cols, np.float32)
        flat = FLAT * _power(image) * count
        for r in range(rows):
            _window_sums(image, r, size, first, second)
            if r < size - 1:
                continue
            one = two = 0.0
            for c in range(size - 1):
                one += first[c]
                two += second[c]
            for c in range(size - 1, cols):
                one += first[c]
                two += second[c]
                own = two - one * one / count
                spread[c] = own if own > 1e-12 * two else 0.0
                one -= first[c - size + 1]
                two -= second[c - size + 1]
            line = norms[r - size + 1]
            for c in range(line.size):
                own = spread[size - 1 + c]
                line[c] = np.float32(1.0) / np.sqrt(own) if own > flat else np.float32(0.0)


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "reassoc"})
def _unit(template, wide):
    """A template (p, q) less its mean, of unit norm, with zeros behind each row up to ``wide``
    columns, (p, wide), all 0 if it is flat; and its norm.
    """
    rows, cols = template.shape
    total = 0.0
    for r in range(rows):
        for c in range(cols):
            total += np.float64(template[r, c])
    mean = total / (rows * cols)
    out, power = np.zeros((rows, wide), np.float32), 0.0
    for r in range(rows):
        for c in range(cols):
            x = template[r, c] - mean
            power += x * x
            out[r, c] = np.float32(x)
    scale = 1.0 / math.sqrt(power) if power > 1e-14 * mean * mean * rows * cols else 0.0
    for r in range(rows):
        for c in range(cols):
            out[r, c] *= np.float32(scale)
    return out, math.sqrt(power)


@njit(cache=True, nogil=True, error_model="numpy")
def _blocks(template, row, col):
    """The means of a template's 2 x 2 pixels on the blocks of an image at half resolution, as far
    as they are complete; row, col: place of its first pixel in the image. Also the first block's row
    and column.
    """
    top, left = row % 2, col % 2
    rows, cols = (template.shape[0] - top) // 2, (template.shape[1] - left) // 2
    side = min(rows, cols, template.shape[0] // 2)
    out = np.empty((side, side), np.float32)
    for r in range(side):
        for c in range(side):
            i, j = top + 2 * r, left + 2 * c
            out[r, c] = np.float32(0.25) * (
                (template[i, j] + template[i, j + 1])
                + (template[i + 1, j] + template[i + 1, j + 1])
            )
    return out, (row + 1) // 2, (col + 1) // 2


@njit(cache=True, nogil=True, error_model="numpy")
def _copied(image, row, col, high, wide, out):
    """Copy high x wide pixels from (row, col) on into out (high, wide), 0 outside the image."""
    out[:] = np.float32(0.0)
    first, last = max(0, -col), min(wide, image.shape[1] - col)
    for r in range(max(0, -row), min(high, image.shape[0] - row)):
        source, target = image[row + r, col + first : col + last], out[r, first:last]
        for c in range(last - first):
            target[c] = source[c]


@njit(cache=True, nogil=True, error_model="numpy")
def _at(region, norms, template, row, col, top, left):
    """Correlation of a template with the window whose first pixel is (row, col): region, a copy of
    the image from (top, left) on, and template (`_unit`) have rows of the same length.
    """
    start, count = (row - top) * region.shape[1] + col - left, template.size - _AROUND * 2
    return dot(template.ravel()[:count], region.ravel()[start : start + count]) * norms[row, col]


@njit(cache=True, nogil=True, error_model="numpy")
def _map(image, norms, template, row, col, ny, nx):
    """Correlations (ny, nx) of a template (`_unit`) with the windows from (row, col) on.

    The pixels are copied row behind row. A sum over the template at all places is then a sum of
    shifted copies of one array; the places between the rows' ends are computed in vain.
    """
    size = template.shape[0]
    high, wide = ny + size - 1, nx + size - 1
    mean = 0.0
    for y in range(0, high, 4):
        for x in range(0, wide, 4):
            mean += image[row + y, col + x]
    level = np.float32(mean / (((high + 3) // 4) * ((wide + 3) // 4)))
    region, sums = np.empty(high * wide, np.float32), np.zeros(ny * wide, np.float32)
    for y in range(high):
        pixels, out = image[row + y, col : col + wide], region[y * wide : (y + 1) * wide]
        for x in range(wide):
            out[x] = pixels[x] - level
    n = ny * wide - size + 1
    for i in range(size):
        add_shifted(template[i, :size], 1, region[i * wide :], sums[:n])
    score = np.empty((ny, nx), np.float32)
    for y in range(ny):
        found, own, out = sums[y * wide : y * wide + nx], norms[row + y, col : col + nx], score[y]
        for x in range(nx):
            out[x] = found[x] * own[x]
    return score


@njit(cache=True, nogil=True, error_model="numpy")
def _climb(image, norms, template, size, row, col, limits, region):
    """Steepest ascent of a template's correlation from (row, col), one pixel a step, within limits
    (first and last row and column). Return the last place, its correlation, and True if it is a
    maximum.
    """
    wide = size + 2 * _AROUND
    top, left = row - _AROUND, col - _AROUND
    _copied(image, top, left, wide, wide, region)
    best = _at(region, norms, template, row, col, top, left)
    old_row, old_col = row - 9, col - 9
    for _ in range(_STEPS):
        up, left_one = row, col
        if abs(row - top - _AROUND) >= _AROUND or abs(col - left - _AROUND) >= _AROUND:
            top, left = row - _AROUND, col - _AROUND
            _copied(image, top, left, wide, wide, region)
        for r in range(max(row - 1, limits[0]), min(row + 2, limits[1] + 1)):
            for c in range(max(col - 1, limits[2]), min(col + 2, limits[3] + 1)):
                if abs(r - old_row) <= 1 and abs(c - old_col) <= 1:  # compared a step before
                    continue
                if r == row and c == col:
                    continue
                here = _at(region, norms, template, r, c, top, left)
                if here > best:
                    best, up, left_one = here, r, c
        if up == row and left_one == col:
            return row, col, best, True
        old_row, old_col, row, col = row, col, up, left_one
    return row, col, best, False


@njit(cache=True, nogil=True, error_model="numpy")
def _from_half(
    image, norms, half, half_norms, values, template, row, col, limits, reach, exclusion, least,
    region, places, heights,
):  # fmt: skip
    """The highest maxima by ascents from those at half resolution, into places (k, 2) and heights
    (k,), and their number; the other arguments as in `_rivals_of`.
    """
    blocks, top, left = _blocks(values, row, col)
    side = blocks.shape[0]
    small, _ = _unit(blocks, side)
    box = window(half.shape, side, side, top, left, (reach + 1) // 2)
    if box[1] < box[0] or box[3] < box[2]:
        return 0
    score = _map(half, half_norms, small, box[0], box[2], box[1] - box[0] + 1, box[3] - box[2] + 1)
    away = max(0.5 * (exclusion - _MARGIN), 0.0)
    found = maxima(score, _LOWEST, top - box[0], left - box[2], away, places, heights)
    kept = 0
    for k in range(found):
        height = np.float64(heights[k])
        if kept > 1 and height < least - _LOSS:
            break
        r = min(max(row + 2 * (places[k, 0] + box[0] - top), limits[0]), limits[1])
        c = min(max(col + 2 * (places[k, 1] + box[2] - left), limits[2]), limits[3])
        settled, again = True, False
        if k < _ASCENTS:
            r, c, height, settled = _climb(
                image, norms, template, values.shape[0], r, c, limits, region
            )
            for i in range(kept):
                again = again or (places[i, 0] == r and places[i, 1] == c)
        if settled and not again and (r - row) ** 2 + (c - col) ** 2 > exclusion**2:
            places[kept, 0], places[kept, 1], heights[kept] = r, c, height
            kept += 1
    return kept


@njit(cache=True, nogil=True, error_model="numpy")
def _rivals_of(
    image, norms, half, half_norms, values, template, row, col, reach, exclusion, coarse, least,
    region, places, heights,
):  # fmt: skip
    """The highest maxima of a template's correlation around (row, col), best first, into places (k,
    2) and heights (k,), and their number.
    """
    size = values.shape[0]
    limits = window(image.shape, size, size, row, col, reach)
    found = 0
    if coarse:
        found = _from_half(
            image, norms, half, half_norms, values, template, row, col, limits, reach, exclusion,
            least, region, places, heights,
        )  # fmt: skip
    if found == 0:
        ny, nx = limits[1] - limits[0] + 1, limits[3] - limits[2] + 1
        score = _map(image, norms, template[:, :size], limits[0], limits[2], ny, nx)
        found = maxima(score, _LOWEST, row - limits[0], col - limits[2], exclusion, places, heights)
        for k in range(found):
            places[k, 0] += limits[0]
            places[k, 1] += limits[2]
    return found


@njit(cache=True, nogil=True, error_model="numpy", parallel=True)
def rivals(
    stack, norms, half, half_norms, least_norm, templates, which, origins, reach, exclusion, coarse,
    least, ring, out, spread, around, contrast,
):  # fmt: skip
    """Search for n templates in the images that they belong to.

    stack, half (images, rows, cols) with their `window_norms` (for half: of half the templates'
    size); least_norm (images,): a template whose norm is not above it has one other place with
    correlation 1; templates (n, p, p); which (n,): image of each; origins (n, 2): column and row of
    each one's first pixel; a template that is not all in the image has no other places.

    Other places are maxima (3 x 3 pixels) within ``reach`` in both axes and farther than
    ``exclusion`` from the template's own place: their correlations, best first, go into out (n, k),
    NaN where there are fewer, the standard deviations of the windows there into spread (n, k). The
    same at the distances ring (m, 2; columns and rows) into around and contrast (n, m), NaN where
    the window leaves the image.

    With half resolution first, maxima that are certainly below least (n,) are left out, except the
    two highest; the highest 6 at half resolution are followed to full resolution, the others keep
    their correlation. If no ascent ends at another place, the search is repeated at full resolution.
    """
    size = templates.shape[1]
    wide = size + 2 * _AROUND
    for n in prange(templates.shape[0]):
        image, own = stack[which[n]], norms[which[n]]
        col, row = origins[n, 0], origins[n, 1]
        out[n], spread[n], around[n], contrast[n] = math.nan, math.nan, math.nan, math.nan
        if not (0 <= row < own.shape[0] and 0 <= col < own.shape[1]):
            continue
        template, norm = _unit(templates[n], wide)
        if not norm > least_norm[which[n]]:
            out[n, 0], spread[n, 0] = 1.0, norm / size
            continue
        region = np.empty((wide, wide), np.float32)
        places, heights = np.empty((out.shape[1], 2), np.int64), np.empty(out.shape[1])
        found = _rivals_of(
            image, own, half[which[n]], half_norms[which[n]], templates[n], template, row, col,
            reach, exclusion, coarse, least[n], region, places, heights,
        )  # fmt: skip
        for k in range(found):
            i = k
            while i > 0 and out[n, i - 1] < heights[k]:  # an ascent can end above an earlier one
                out[n, i], spread[n, i] = out[n, i - 1], spread[n, i - 1]
                i -= 1
            norm = own[places[k, 0], places[k, 1]]
            out[n, i] = heights[k]
            spread[n, i] = 1.0 / (norm * size) if norm > 0.0 else 0.0
        _copied(image, row - _AROUND, col - _AROUND, wide, wide, region)
        for k in range(ring.shape[0]):
            r, c = row + ring[k, 1], col + ring[k, 0]
            if 0 <= r < own.shape[0] and 0 <= c < own.shape[1]:
                around[n, k] = _at(region, own, template, r, c, row - _AROUND, col - _AROUND)
                contrast[n, k] = 1.0 / (own[r, c] * size) if own[r, c] > 0.0 else 0.0
