"""Places of an image that resemble a part of it: the maxima of a template's centred, normalised
correlation around its own place, and its correlation at given distances.

The images of a stack share their pixels' positions. The norm of every window of an image is computed
once for all templates (`window_norms`). Large search areas are searched at half resolution first;
from the highest maxima there steepest ascents lead to maxima at full resolution.
"""

import math

import numpy as np
from numba import prange

from ..cache import njit
from ..completion import all_done
from ..vectors import LANES, aligned, load, splat, store, total
from .correlation import FLAT, window
from .maxima import highest, map_row, surround
from .template_products import at_all, at_eight, at_nine, extent, place_for, row_length

_ASCENTS = 6
"""Greatest number of maxima at half resolution that are followed to full resolution."""
_LOSS = 0.1
"""A maximum at full resolution is at most so much above the one at half resolution."""
_AROUND = 5
"""Greatest distance of the ring."""
_STEPS = 8
"""Greatest number of steps of an ascent. Longer ones start at the border of the search, and seldom end."""
_MARGIN = 3.0
"""Pixels by which a maximum at half resolution may lie nearer than the exclusion."""
_FEW = 16
"""Maxima at half resolution that are kept however low they are."""
_PARTS = 8
"""Parts of the templates, for threads; those of a part share work arrays."""


@njit(nogil=True, error_model="numpy", fastmath={"contract", "reassoc"})
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


@njit(nogil=True, error_model="numpy", parallel=True)
def centred(stack, out, power):
    """Write images (k, rows, cols) less their means into out, and their variances into power (k,): NaN
    for images with missing pixels.
    """
    done = 0
    for k in prange(stack.shape[0]):
        done += 1
        mean = np.float32(_moments(stack[k])[0])
        for r in range(stack.shape[1]):
            source, target = stack[k, r], out[k, r]
            for c in range(source.size):
                target[c] = source[c] - mean
        power[k] = _moments(out[k])[1]
    all_done(done, stack.shape[0])


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
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


@njit(nogil=True, error_model="numpy", parallel=True)
def window_norms(stack, size, out):
    """Write the reciprocal of the norm of every centred window of size x size pixels into out (k,
    rows - size + 1, cols - size + 1), and 0 for windows whose variance is not above `FLAT` times
    that of their image; stack (k, rows, cols) float32 without NaN, about 0.
    """
    count = size * size
    done = 0
    for k in prange(stack.shape[0]):
        done += 1
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
    all_done(done, stack.shape[0])


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
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


@njit(nogil=True, error_model="numpy")
def _prepare(values, at, p, out):
    """Write the p x p numbers from place ``at`` of an array on, less their mean, into the rows of a template
    (`template_products`) whose other places are 0. Return their norm, 0 if they are alike.
    """
    whole, n = p // LANES * LANES, row_length(p)
    sums, rest = splat(np.float32(0.0)), 0.0
    for y in range(at, at + p * p, p):
        for x in range(y, y + whole, LANES):
            sums = sums + load(values, x)
        for x in range(y + whole, y + p):
            rest += np.float64(values[x])
    mean = (np.float64(total(sums)) + rest) / (p * p)
    middle, left = splat(np.float32(mean)), np.float32(mean)
    sums, rest = splat(np.float32(0.0)), 0.0
    for y in range(p):
        source, target = at + y * p, (y + 2) * n
        for x in range(0, whole, LANES):
            off = load(values, source + x) - middle
            sums = sums + off * off
            store(out, target + x, off)
        for x in range(whole, p):
            one = values[source + x] - left
            rest += np.float64(one * one)
            out[target + x] = one
    power = np.float64(total(sums)) + rest
    return math.sqrt(power) if power > 1e-14 * mean * mean * p * p else 0.0


@njit(nogil=True, error_model="numpy")
def _blocks(values, at, p, row, col, out):
    """Write the means of a template's 2 x 2 pixels on the blocks of an image at half resolution, as far
    as they are complete, into out (side, side). The template's p x p pixels stand from place ``at`` of
    an array on; row, col: place of its first pixel in the image. Return side, and the first block's
    row and column.
    """
    top, left = row % 2, col % 2
    side = min((p - top) // 2, (p - left) // 2, p // 2)
    for r in range(side):
        first = at + (top + 2 * r) * p + left
        one, other = values[first : first + 2 * side], values[first + p : first + p + 2 * side]
        for c in range(side):
            two = (one[2 * c] + one[2 * c + 1]) + (other[2 * c] + other[2 * c + 1])
            out[r * side + c] = np.float32(0.25) * two
    return side, (row + 1) // 2, (col + 1) // 2


@njit(nogil=True, error_model="numpy")
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


@njit(nogil=True, error_model="numpy")
def _room(p, reach):
    """Work arrays of `_map` for templates of p x p pixels and a search of +-``reach``: pixels, products,
    the map (`maxima.surround`), and numbers of maxima.
    """
    n = 2 * reach + 1
    rows, length, many, long = extent(p, n, n)
    pixels, products = aligned(rows * length), aligned(many * long)
    pixels[:] = np.float32(0.0)  # those behind a smaller region must be finite
    return pixels, products, aligned((n + 2) * map_row(n)), np.empty(n * n, np.int64)


@njit(nogil=True, error_model="numpy")
def _map(flat, wide, norms, template, scale, p, row, col, ny, nx, room):
    """Write the correlations (ny, nx) of a template of p x p pixels (`_prepare`; scale: over its norm)
    with the windows from (row, col) of an image (its pixels in rows of ``wide``) on into the map of
    room (`_room`).
    """
    pixels, products, score, _ = room
    high, across, first = ny + p - 1, nx + p - 1, row * wide + col
    mean = 0.0
    for y in range(first, first + high * wide, 8 * wide):
        for x in range(y, y + across, 8):
            mean += flat[x]
    level = np.float32(mean / (((high + 7) // 8) * ((across + 7) // 8)))
    _, length, _, long = extent(p, ny, nx)
    whole, middle = across // LANES * LANES, splat(level)
    for y in range(high):
        source, target = first + y * wide, y * length
        for x in range(0, whole, LANES):
            store(pixels, target + x, load(flat, source + x) - middle)
        for x in range(whole, across):
            pixels[target + x] = flat[source + x] - level
    at_all(template, p, pixels, ny, nx, products)
    many, own, even, factor = norms.shape[1], norms.ravel(), nx // LANES * LANES, splat(scale)
    for y in range(ny):
        source, norm, target = y * long, (row + y) * many + col, (y + 1) * map_row(nx) + 1
        for x in range(0, even, LANES):
            found = load(products, source + x) * (load(own, norm + x) * factor)
            store(score, target + x, found)
        for x in range(even, nx):
            score[target + x] = products[source + x] * (own[norm + x] * scale)
    surround(score, ny, nx)


@njit(nogil=True, error_model="numpy")
def _climb(image, flat, norms, template, scale, p, row, col, limits, around):
    """Steepest ascent of a template's correlation (`_map`) from (row, col), one pixel a step, within
    limits (first and last row and column). Return the last place, its correlation, and True if it is a
    maximum. flat: the image's pixels; around (9,): work array.
    """
    best, wide, own, many = np.float32(0.0), image.shape[1], norms.ravel(), norms.shape[1]
    last = flat.size - (p + 1) * wide - 2 - row_length(p)
    for _ in range(_STEPS):
        start = (row - 1) * wide + col - 1
        if 0 <= start <= last:
            at_nine(template, p, flat, wide, start, around)
        else:
            pixels, length, start = _pixels_around(image, row, col, p, 1)
            at_nine(template, p, pixels, length, start, around)
        best, up, left = around[4] * (own[row * many + col] * scale), 0, 0
        for y in range(max(-1, limits[0] - row), min(1, limits[1] - row) + 1):
            for x in range(max(-1, limits[2] - col), min(1, limits[3] - col) + 1):
                here = around[3 * y + x + 4] * (own[(row + y) * many + col + x] * scale)
                if here > best:
                    best, up, left = here, y, x
        if up == 0 and left == 0:
            return row, col, np.float64(best), True
        row, col = row + up, col + left
    return row, col, np.float64(best), False


@njit(nogil=True, error_model="numpy")
def _top(score, wide, ny, nx, row, col):
    """The place of a maximum in half pixels of a map (`maxima.surround`), from parabolas along its row and
    column.
    """
    up, left, at = 2 * row, 2 * col, (row + 1) * wide + col + 1
    if 0 < row < ny - 1:
        up += _vertex(score[at - wide], score[at], score[at + wide])
    if 0 < col < nx - 1:
        left += _vertex(score[at - 1], score[at], score[at + 1])
    return up, left


@njit(nogil=True, error_model="numpy")
def _vertex(before, here, after):
    """Half pixels, -1, 0 or 1, from the highest one of three values to the top of their parabola."""
    slope, curve = after - before, 2.0 * here - before - after
    if 2.0 * abs(slope) < curve:  # within a quarter of a pixel
        return 0
    return 1 if slope > 0.0 else -1


@njit(nogil=True, error_model="numpy")
def _from_half(
    image, flat, norms, half, half_norms, values, at, template, scale, p, row, col, limits, reach,
    exclusion, least, work, room, places, heights, best,
):  # fmt: skip
    """The highest maxima by ascents from those at half resolution, into places (k, 2) and heights
    (k,), and their number; the other arguments as in `_rivals_of`.
    """
    blocks, coarse, around = work
    side, top, left = _blocks(values, at, p, row, col, blocks)
    if p % 2 == 0:  # the side depends on the place: a longer row was here
        coarse[:] = np.float32(0.0)
    norm = _prepare(blocks, 0, side, coarse)
    small = np.float32(1.0 / norm if norm > 0.0 else 0.0)
    box = window(half.shape, side, side, top, left, (reach + 1) // 2)
    ny, nx = box[1] - box[0] + 1, box[3] - box[2] + 1
    if ny < 1 or nx < 1:
        return 0
    _map(half.ravel(), half.shape[1], half_norms, coarse, small, side, box[0], box[2], ny, nx, room)
    away = max(0.5 * (exclusion - _MARGIN), 0.0)
    lowest, up, across = least - _LOSS, top - box[0], left - box[2]
    found = highest(room[2], ny, nx, lowest, _FEW, up, across, away, places, heights, room[3], best)
    kept, wide = 0, map_row(nx)
    for k in range(found):
        height = np.float64(heights[k])
        if kept > 0 and height < lowest:
            break
        r, c = _top(room[2], wide, ny, nx, places[k, 0], places[k, 1])
        r = min(max(row - 2 * up + r, limits[0]), limits[1])
        c = min(max(col - 2 * across + c, limits[2]), limits[3])
        settled, again = True, False
        if k < _ASCENTS:
            r, c, height, settled = _climb(
                image, flat, norms, template, scale, p, r, c, limits, around
            )
            for i in range(kept):
                again = again or (places[i, 0] == r and places[i, 1] == c)
        if settled and not again and (r - row) ** 2 + (c - col) ** 2 > exclusion**2:
            places[kept, 0], places[kept, 1], heights[kept] = r, c, height
            kept += 1
    return kept


@njit(nogil=True, error_model="numpy")
def _rivals_of(
    image, flat, norms, half, half_norms, values, at, template, scale, p, row, col, reach,
    exclusion, coarse, least, work, room, places, heights, best,
):  # fmt: skip
    """The highest maxima of the correlation of a template (its p x p values from place ``at`` of an array
    on, and as in `_map`) around (row, col), best first, into places (k, 2) and heights (k,), and
    their number. flat: the image's pixels; work, room, best: work arrays.
    """
    limits = window(image.shape, p, p, row, col, reach)
    found = 0
    if coarse:
        found = _from_half(
            image, flat, norms, half, half_norms, values, at, template, scale, p, row, col, limits,
            reach, exclusion, least, work, room, places, heights, best,
        )  # fmt: skip
    if found == 0:
        ny, nx = limits[1] - limits[0] + 1, limits[3] - limits[2] + 1
        whole = _room(p, reach) if coarse else room
        _map(flat, image.shape[1], norms, template, scale, p, limits[0], limits[2], ny, nx, whole)
        found = highest(
            whole[2], ny, nx, least, 2, row - limits[0], col - limits[2], exclusion, places,
            heights, whole[3], best,
        )  # fmt: skip
        for k in range(found):
            places[k, 0] += limits[0]
            places[k, 1] += limits[2]
    return found


@njit(nogil=True, error_model="numpy")
def _near(image, norms, template, scale, p, row, col, ring, starts, found, around, contrast):
    """Correlations of a template (`_map`) and contrasts at distances ring from (row, col), as in
    `rivals`; starts, found (8,): work arrays.
    """
    pixels, wide, start = _pixels_around(image, row, col, p, _AROUND)
    for first in range(0, ring.shape[0], 8):
        last = min(first + 8, ring.shape[0])
        for k in range(8):
            i = min(first + k, last - 1)
            starts[k] = start + (ring[i, 1] + _AROUND) * wide + ring[i, 0] + _AROUND
        at_eight(template, p, pixels, wide, starts, found)
        for k in range(first, last):
            r, c = row + ring[k, 1], col + ring[k, 0]
            if 0 <= r < norms.shape[0] and 0 <= c < norms.shape[1]:
                around[k] = found[k - first] * (norms[r, c] * scale)
                contrast[k] = 1.0 / (norms[r, c] * p) if norms[r, c] > 0.0 else 0.0


@njit(nogil=True, error_model="numpy", parallel=True)
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
    p, count, values = templates.shape[1], templates.shape[0], templates.ravel()
    parts = min(count, _PARTS)
    done = 0
    for part in prange(parts):
        done += 1
        template, coarse_template = place_for(p), place_for(p // 2)
        work = np.empty((p // 2) ** 2, np.float32), coarse_template, np.empty(9, np.float32)
        room = _room(p // 2, (reach + 1) // 2) if coarse else _room(p, reach)
        places, heights = np.empty((out.shape[1], 2), np.int64), np.empty(out.shape[1])
        best = np.empty(out.shape[1], np.int64)
        starts, eight = np.empty(8, np.int64), np.empty(8, np.float32)
        for n in range(part, count, parts):
            image, own = stack[which[n]], norms[which[n]]
            col, row = origins[n, 0], origins[n, 1]
            out[n], spread[n], around[n], contrast[n] = math.nan, math.nan, math.nan, math.nan
            if not (0 <= row < own.shape[0] and 0 <= col < own.shape[1]):
                continue
            norm = _prepare(values, n * p * p, p, template)
            if not norm > least_norm[which[n]]:
                out[n, 0], spread[n, 0] = 1.0, norm / p
                continue
            scale = np.float32(1.0 / norm)
            found = _rivals_of(
                image, image.ravel(), own, half[which[n]], half_norms[which[n]], values, n * p * p,
                template, scale, p, row, col, reach, exclusion, coarse, least[n], work, room,
                places, heights, best,
            )  # fmt: skip
            for k in range(found):
                i = k
                while (
                    i > 0 and out[n, i - 1] < heights[k]
                ):  # an ascent can end above an earlier one
                    out[n, i], spread[n, i] = out[n, i - 1], spread[n, i - 1]
                    i -= 1
                norm = own[places[k, 0], places[k, 1]]
                out[n, i] = heights[k]
                spread[n, i] = 1.0 / (norm * p) if norm > 0.0 else 0.0
            _near(
                image, own, template, scale, p, row, col, ring, starts, eight, around[n],
                contrast[n],
            )  # fmt: skip
    all_done(done, parts)
