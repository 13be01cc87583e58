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
from .template_products import at_all, at_eight, at_nine, extent, padded, row_length

_ASCENTS = 6
"""Greatest number of maxima at half resolution that are followed to full resolution."""
_LOSS = 0.1
"""A maximum at full resolution is at most so much above the one at half resolution."""
_AROUND = 3
"""Greatest distance of the ring."""
_STEPS = 8
"""Greatest number of steps of an ascent. Longer ones start at the border of the search, and seldom end."""
_MARGIN = 3.0
"""Pixels by which a maximum at half resolution may lie nearer than the exclusion."""
_FEW = 16
"""Maxima at half resolution that are kept however low they are."""


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "reassoc"})
def _moments(image):
    """Mean and mean square of an image (rows, cols)."""
    total = power = 0.0
    for r in range(image.shape[0]):
        line = image[r]
        one = two = np.float32(0.0)
        for c in range(line.size):
            one += line[c]
            two += line[c] * line[c]
        total += one
        power += two
    return total / image.size, power / image.size


@njit(cache=True, nogil=True, error_model="numpy", parallel=True)
def centred(stack, out, power):
    """Write images (k, rows, cols) less their means into out, and their variances into power (k,): NaN
    for images with missing pixels.
    """
    for k in prange(stack.shape[0]):
        mean = np.float32(_moments(stack[k])[0])
        for r in range(stack.shape[1]):
            source, target = stack[k, r], out[k, r]
            for c in range(source.size):
                target[c] = source[c] - mean
        power[k] = _moments(out[k])[1]


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
        first, second = np.zeros(cols), np.zeros(cols)
        before, before2 = np.zeros(cols + 1), np.zeros(cols + 1)
        mean, power = _moments(image)
        flat = FLAT * (power - mean * mean) * count
        for r in range(rows):
            _window_sums(image, r, size, first, second)
            if r >= size - 1:
                for c in range(cols):
                    before[c + 1], before2[c + 1] = before[c] + first[c], before2[c] + second[c]
                _norms_between(before, before2, size, flat, norms[r - size + 1])


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _norms_between(before, before2, size, flat, out):
    """Reciprocals of the norms of the windows of a row from the sums of the pixels and of their squares
    over all columns before each column.
    """
    n, share = out.size, 1.0 / (size * size)
    low, low2, high, high2 = before[:n], before2[:n], before[size:], before2[size:]
    for c in range(n):
        one, two = high[c] - low[c], high2[c] - low2[c]
        own = two - one * one * share
        found = (own > 1e-12 * two) & (own > flat)
        out[c] = np.float32(1.0) / np.sqrt(np.float32(own if found else 1.0))
        if not found:
            out[c] = np.float32(0.0)


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "reassoc"})
def _unit(template):
    """A template (p, p) less its mean, of unit norm, all 0 if it is flat; and its norm."""
    out = np.empty(template.shape, np.float32)
    pixels, unit = template.ravel(), out.ravel()
    total = power = 0.0
    for x in range(pixels.size):
        total += np.float64(pixels[x])
    mean = total / pixels.size
    for x in range(pixels.size):
        off = pixels[x] - mean
        power += off * off
        unit[x] = np.float32(off)
    scale = 1.0 / math.sqrt(power) if power > 1e-14 * mean * mean * pixels.size else 0.0
    for x in range(pixels.size):
        unit[x] *= np.float32(scale)
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
def _pixels_around(image, row, col, p, margin):
    """An image's pixels in rows, as `template_products` reads them, their length, and the place of the
    pixel ``margin`` rows above and columns before (row, col): the image itself where templates of p x p
    pixels, moved by up to 2 ``margin`` from there, do not leave its memory; else a copy with 0 outside.
    """
    wide, away = image.shape[1], 2 * margin
    start = (row - margin) * wide + col - margin
    if start >= 0 and start + (p - 1 + away) * wide + away + row_length(p) <= image.size:
        return image.ravel(), wide, start
    out = np.zeros((p + away, row_length(p) + away), np.float32)
    first, last = max(0, margin - col), min(p + away, wide + margin - col)
    for y in range(max(0, margin - row), min(p + away, image.shape[0] + margin - row)):
        for x in range(first, last):
            out[y, x] = image[row - margin + y, col - margin + x]
    return out.ravel(), out.shape[1], 0


@njit(cache=True, nogil=True, error_model="numpy")
def _map(image, norms, template, p, row, col, ny, nx):
    """Correlations (ny, nx) of a template of p x p pixels (`padded`, of unit norm) with the windows from
    (row, col) on.
    """
    high, wide = ny + p - 1, nx + p - 1
    mean = 0.0
    for y in range(0, high, 4):
        for x in range(0, wide, 4):
            mean += image[row + y, col + x]
    level = np.float32(mean / (((high + 3) // 4) * ((wide + 3) // 4)))
    rows, length, many, long = extent(p, ny, nx)
    region, sums = np.zeros((rows, length), np.float32), np.empty((many, long), np.float32)
    for y in range(high):
        pixels, out = image[row + y, col : col + wide], region[y]
        for x in range(wide):
            out[x] = pixels[x] - level
    at_all(template, p, region.ravel(), ny, nx, sums.ravel())
    score = np.empty((ny, nx), np.float32)
    for y in range(ny):
        found, own, out = sums[y], norms[row + y, col : col + nx], score[y]
        for x in range(nx):
            out[x] = found[x] * own[x]
    return score


@njit(cache=True, nogil=True, error_model="numpy")
def _climb(image, norms, template, p, row, col, limits):
    """Steepest ascent of a template's correlation (`padded`) from (row, col), one pixel a step, within
    limits (first and last row and column). Return the last place, its correlation, and True if it is a
    maximum.
    """
    around, best = np.empty(9, np.float32), 0.0
    for _ in range(_STEPS):
        pixels, wide, start = _pixels_around(image, row, col, p, 1)
        at_nine(template, p, pixels, wide, start, around)
        best = np.float64(around[4] * norms[row, col])
        k = 4
        for i in range(9):
            r, c = row + i // 3 - 1, col + i % 3 - 1
            if limits[0] <= r <= limits[1] and limits[2] <= c <= limits[3]:
                here = np.float64(around[i] * norms[r, c])
                if here > best:
                    best, k = here, i
        if k == 4:
            return row, col, best, True
        row, col = row + k // 3 - 1, col + k % 3 - 1
    return row, col, best, False


@njit(cache=True, nogil=True, error_model="numpy")
def _top(score, row, col):
    """The place of a maximum in half pixels of a map, from parabolas along its row and column."""
    up, left = 2 * row, 2 * col
    if 0 < row < score.shape[0] - 1:
        up += _vertex(score[row - 1, col], score[row, col], score[row + 1, col])
    if 0 < col < score.shape[1] - 1:
        left += _vertex(score[row, col - 1], score[row, col], score[row, col + 1])
    return up, left


@njit(cache=True, nogil=True, error_model="numpy")
def _vertex(before, here, after):
    """Half pixels, -1, 0 or 1, from the highest one of three values to the top of their parabola."""
    slope, curve = after - before, 2.0 * here - before - after
    if 2.0 * abs(slope) < curve:  # within a quarter of a pixel
        return 0
    return 1 if slope > 0.0 else -1


@njit(cache=True, nogil=True, error_model="numpy")
def _from_half(
    image, norms, half, half_norms, values, template, row, col, limits, reach, exclusion, least,
    places, heights,
):  # fmt: skip
    """The highest maxima by ascents from those at half resolution, into places (k, 2) and heights
    (k,), and their number; the other arguments as in `_rivals_of`.
    """
    blocks, top, left = _blocks(values, row, col)
    side = blocks.shape[0]
    small, _ = _unit(blocks)
    box = window(half.shape, side, side, top, left, (reach + 1) // 2)
    if box[1] < box[0] or box[3] < box[2]:
        return 0
    ny, nx = box[1] - box[0] + 1, box[3] - box[2] + 1
    score = _map(half, half_norms, padded(small), side, box[0], box[2], ny, nx)
    away = max(0.5 * (exclusion - _MARGIN), 0.0)
    lowest, middle = least - _LOSS, (top - box[0], left - box[2])
    found = maxima(score, lowest, _FEW, middle[0], middle[1], away, places, heights)
    kept = 0
    for k in range(found):
        height = np.float64(heights[k])
        if kept > 0 and height < lowest:
            break
        r, c = _top(score, places[k, 0], places[k, 1])
        r = min(max(row + 2 * (box[0] - top) + r, limits[0]), limits[1])
        c = min(max(col + 2 * (box[2] - left) + c, limits[2]), limits[3])
        settled, again = True, False
        if k < _ASCENTS:
            r, c, height, settled = _climb(image, norms, template, values.shape[0], r, c, limits)
            for i in range(kept):
                again = again or (places[i, 0] == r and places[i, 1] == c)
        if settled and not again and (r - row) ** 2 + (c - col) ** 2 > exclusion**2:
            places[kept, 0], places[kept, 1], heights[kept] = r, c, height
            kept += 1
    return kept


@njit(cache=True, nogil=True, error_model="numpy")
def _rivals_of(
    image, norms, half, half_norms, values, template, row, col, reach, exclusion, coarse, least,
    places, heights,
):  # fmt: skip
    """The highest maxima of the correlation of a template (its values, and `padded` of unit norm)
    around (row, col), best first, into places (k, 2) and heights (k,), and their number.
    """
    size = values.shape[0]
    limits = window(image.shape, size, size, row, col, reach)
    found = 0
    if coarse:
        found = _from_half(
            image, norms, half, half_norms, values, template, row, col, limits, reach, exclusion,
            least, places, heights,
        )  # fmt: skip
    if found == 0:
        ny, nx = limits[1] - limits[0] + 1, limits[3] - limits[2] + 1
        score = _map(image, norms, template, size, limits[0], limits[2], ny, nx)
        middle = row - limits[0], col - limits[2]
        found = maxima(score, least, 2, middle[0], middle[1], exclusion, places, heights)
        for k in range(found):
            places[k, 0] += limits[0]
            places[k, 1] += limits[2]
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def _near(image, norms, template, p, row, col, ring, around, contrast):
    """Correlations of a template (`padded`) and contrasts at distances ring from (row, col), as in
    `rivals`.
    """
    pixels, wide, start = _pixels_around(image, row, col, p, _AROUND)
    starts, found = np.full(8, start), np.empty(8, np.float32)
    for first in range(0, ring.shape[0], 8):
        last = min(first + 8, ring.shape[0])
        for k in range(first, last):
            starts[k - first] = start + (ring[k, 1] + _AROUND) * wide + ring[k, 0] + _AROUND
        at_eight(template, p, pixels, wide, starts, found)
        for k in range(first, last):
            r, c = row + ring[k, 1], col + ring[k, 0]
            if 0 <= r < norms.shape[0] and 0 <= c < norms.shape[1]:
                around[k] = found[k - first] * norms[r, c]
                contrast[k] = 1.0 / (norms[r, c] * p) if norms[r, c] > 0.0 else 0.0


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

    Maxima below least (n,) are left out, except the two highest. With half resolution first these are
    the maxima that are certainly below it, except the highest; the highest 6 at half resolution are followed to full
    resolution, the others keep their correlation. If no ascent ends at another place, the search is
    repeated at full resolution.
    """
    size = templates.shape[1]
    for n in prange(templates.shape[0]):
        image, own = stack[which[n]], norms[which[n]]
        col, row = origins[n, 0], origins[n, 1]
        out[n], spread[n], around[n], contrast[n] = math.nan, math.nan, math.nan, math.nan
        if not (0 <= row < own.shape[0] and 0 <= col < own.shape[1]):
            continue
        unit, norm = _unit(templates[n])
        if not norm > least_norm[which[n]]:
            out[n, 0], spread[n, 0] = 1.0, norm / size
            continue
        template = padded(unit)
        places, heights = np.empty((out.shape[1], 2), np.int64), np.empty(out.shape[1])
        found = _rivals_of(
            image, own, half[which[n]], half_norms[which[n]], templates[n], template, row, col,
            reach, exclusion, coarse, least[n], places, heights,
        )  # fmt: skip
        for k in range(found):
            i = k
            while i > 0 and out[n, i - 1] < heights[k]:  # an ascent can end above an earlier one
                out[n, i], spread[n, i] = out[n, i - 1], spread[n, i - 1]
                i -= 1
            norm = own[places[k, 0], places[k, 1]]
            out[n, i] = heights[k]
            spread[n, i] = 1.0 / (norm * size) if norm > 0.0 else 0.0
        _near(image, own, template, size, row, col, ring, around[n], contrast[n])
