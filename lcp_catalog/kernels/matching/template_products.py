"""Sums of products of a template with windows of an image: at every place of a rectangle, at the 3 x 3
places around one, and at single places.

A template of p x p pixels stands in rows of `row_length` places, zeros behind its own, between two
rows of zeros above and two below (`padded`). Images are flat arrays of rows of any length. They must
reach as far, and be finite, as rows of a template do; nothing tests that.
"""

import numpy as np
from numba import njit

from ..vectors import LANES, load, multiple, splat, store_four, total

_ROWS = 4
"""Rows of places whose sums are held in registers together."""


@njit(cache=True, nogil=True, error_model="numpy")
def row_length(pixels):
    """Places of a row of pixels in whole vectors."""
    return multiple(pixels, LANES)


@njit(cache=True, nogil=True, error_model="numpy")
def padded(template):
    """The rows of a template (p, p) as `at_nine` and `at_eight` read them."""
    p = template.shape[0]
    out = np.zeros((p + 4, row_length(p)), np.float32)
    for y in range(p):
        source, target = template[y], out[y + 2]
        for x in range(p):
            target[x] = source[x]
    return out.ravel()


@njit(cache=True, nogil=True, error_model="numpy")
def at_nine(template, p, image, wide, start, out):
    """Write the products of a template with the 3 x 3 windows from place ``start`` of an image (n,)
    with rows of ``wide`` pixels on into out (9,), row by row.
    """
    n, zero = row_length(p), splat(np.float32(0.0))
    a0 = a1 = a2 = b0 = b1 = b2 = c0 = c1 = c2 = zero
    for y in range(p + 2):
        for x in range(0, n, LANES):
            at = start + y * wide + x
            u, v, w = load(image, at), load(image, at + 1), load(image, at + 2)
            t = load(template, (y + 2) * n + x)
            a0, a1, a2 = a0 + t * u, a1 + t * v, a2 + t * w
            t = load(template, (y + 1) * n + x)
            b0, b1, b2 = b0 + t * u, b1 + t * v, b2 + t * w
            t = load(template, y * n + x)
            c0, c1, c2 = c0 + t * u, c1 + t * v, c2 + t * w
    out[0], out[1], out[2] = total(a0), total(a1), total(a2)
    out[3], out[4], out[5] = total(b0), total(b1), total(b2)
    out[6], out[7], out[8] = total(c0), total(c1), total(c2)


@njit(cache=True, nogil=True, error_model="numpy")
def at_eight(template, p, image, wide, starts, out):
    """Write the products of a template with the windows that begin at eight places of the image into
    out (8,). Fewer places at once would wait for their sums.
    """
    n, zero = row_length(p), splat(np.float32(0.0))
    a = b = c = d = e = f = g = h = zero
    for y in range(p):
        for x in range(0, n, LANES):
            t, at = load(template, (y + 2) * n + x), y * wide + x
            a, b = a + t * load(image, starts[0] + at), b + t * load(image, starts[1] + at)
            c, d = c + t * load(image, starts[2] + at), d + t * load(image, starts[3] + at)
            e, f = e + t * load(image, starts[4] + at), f + t * load(image, starts[5] + at)
            g, h = g + t * load(image, starts[6] + at), h + t * load(image, starts[7] + at)
    out[0], out[1], out[2], out[3] = total(a), total(b), total(c), total(d)
    out[4], out[5], out[6], out[7] = total(e), total(f), total(g), total(h)


@njit(cache=True, nogil=True, error_model="numpy")
def _sixteen(columns, p, image, wide, start, out, long, at):
    """Products at 4 rows x 16 places; columns (p, p): the template's columns, one behind the other."""
    zero = splat(np.float32(0.0))
    a0 = a1 = a2 = a3 = b0 = b1 = b2 = b3 = zero
    for j in range(p):
        here = start + j
        u0, u1, u2 = load(image, here), load(image, here + wide), load(image, here + 2 * wide)
        here += LANES
        v0, v1, v2 = load(image, here), load(image, here + wide), load(image, here + 2 * wide)
        here = start + j + 3 * wide
        for i in range(p):
            t, u3, v3 = splat(columns[j * p + i]), load(image, here), load(image, here + LANES)
            a0, a1, a2, a3 = a0 + t * u0, a1 + t * u1, a2 + t * u2, a3 + t * u3
            b0, b1, b2, b3 = b0 + t * v0, b1 + t * v1, b2 + t * v2, b3 + t * v3
            u0, u1, u2, v0, v1, v2 = u1, u2, u3, v1, v2, v3
            here += wide
    store_four(out, at, long, a0, a1, a2, a3)
    store_four(out, at + LANES, long, b0, b1, b2, b3)


@njit(cache=True, nogil=True, error_model="numpy")
def _eight(columns, p, image, wide, start, out, long, at):
    """Products at 4 rows x 8 places. Two of the template's columns at a time have sums of their own: each
    sum waits for the one before.
    """
    zero = splat(np.float32(0.0))
    a0 = a1 = a2 = a3 = b0 = b1 = b2 = b3 = zero
    for j in range(0, p - 1, 2):
        here = start + j
        u0, u1, u2 = load(image, here), load(image, here + wide), load(image, here + 2 * wide)
        here += 1
        v0, v1, v2 = load(image, here), load(image, here + wide), load(image, here + 2 * wide)
        here = start + j + 3 * wide
        for i in range(j * p, j * p + p):
            s, t = splat(columns[i]), splat(columns[i + p])
            u3, v3 = load(image, here), load(image, here + 1)
            a0, a1, a2, a3 = a0 + s * u0, a1 + s * u1, a2 + s * u2, a3 + s * u3
            b0, b1, b2, b3 = b0 + t * v0, b1 + t * v1, b2 + t * v2, b3 + t * v3
            u0, u1, u2, v0, v1, v2 = u1, u2, u3, v1, v2, v3
            here += wide
    if p % 2:
        here = start + p - 1
        u0, u1, u2 = load(image, here), load(image, here + wide), load(image, here + 2 * wide)
        here += 3 * wide
        for i in range((p - 1) * p, p * p):
            t, u3 = splat(columns[i]), load(image, here)
            a0, a1, a2, a3 = a0 + t * u0, a1 + t * u1, a2 + t * u2, a3 + t * u3
            u0, u1, u2 = u1, u2, u3
            here += wide
    store_four(out, at, long, a0 + b0, a1 + b1, a2 + b2, a3 + b3)


@njit(cache=True, nogil=True, error_model="numpy")
def extent(p, ny, nx):
    """Rows and places of a row that `at_all` reads of the image, and those that it writes."""
    high, long = multiple(ny, _ROWS), row_length(nx)
    return high + p - 1, max(long + p - 1, nx - 1 + row_length(p)), high, long


@njit(cache=True, nogil=True, error_model="numpy")
def at_all(template, p, image, ny, nx, out):
    """Write the products of a template (`padded`) with the windows at ny x nx places into out, in rows;
    image and out as in `extent`.
    """
    n, columns = row_length(p), np.empty(p * p, np.float32)
    for j in range(p):
        for i in range(p):
            columns[j * p + i] = template[(i + 2) * n + j]
    _, wide, high, long = extent(p, ny, nx)
    alone = nx % LANES == 1  # a last column is not worth vectors along the rows
    end = nx - 1 if alone else long
    for y in range(0, high, _ROWS):
        x = 0
        while x + 2 * LANES <= end:
            _sixteen(columns, p, image, wide, y * wide + x, out, long, y * long + x)
            x += 2 * LANES
        if x < end:
            _eight(columns, p, image, wide, y * wide + x, out, long, y * long + x)
    if alone:
        _column(template, p, image, wide, nx - 1, out, high, long)


@njit(cache=True, nogil=True, error_model="numpy")
def _column(template, p, image, wide, x, out, high, long):
    """Products at the places of a column."""
    starts, found = np.empty(8, np.int64), np.empty(8, np.float32)
    for y in range(0, high, 8):
        for k in range(8):
            starts[k] = min(y + k, high - 1) * wide + x
        at_eight(template, p, image, wide, starts, found)
        for k in range(min(8, high - y)):
            out[(y + k) * long + x] = found[k]
