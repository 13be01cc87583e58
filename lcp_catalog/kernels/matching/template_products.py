"""Sums of products of a template with windows of an image: at every place of a rectangle, at the 3 x 3
places around one, and at single places.

A template of p x p pixels stands in rows of `row_length` places, zeros behind its own, between two
rows of zeros above and two below (`place_for`). Images are flat arrays of rows of any length. They must
reach as far, and be finite, as rows of a template do; nothing tests that.
"""

import numpy as np

from ..cache import njit
from ..vectors import LANES, aligned, load, multiple, splat, splat_at, store_four, total

_ROWS = 4
"""Rows of places, or twice as many, whose sums are held in registers together."""
_FEW = LANES // 4
"""Greatest number of last columns of a map that are computed by themselves."""


@njit(nogil=True, error_model="numpy")
def row_length(pixels):
    """Places of a row of pixels in whole vectors."""
    return multiple(pixels, LANES)


@njit(nogil=True, error_model="numpy")
def place_for(p):
    """Room for a template of p x p pixels, all 0: pixel (y, x) stands at (y + 2) `row_length` + x."""
    out = aligned((p + 4) * row_length(p))
    out[:] = np.float32(0.0)
    return out


@njit(nogil=True, error_model="numpy")
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


@njit(nogil=True, error_model="numpy")
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


@njit(nogil=True, error_model="numpy")
def _eight_rows(columns, p, image, wide, start, out, long, at):
    """Products at 8 rows x `LANES` places; columns (p, p): the template's columns, one behind the
    other.
    """
    zero = splat(np.float32(0.0))
    a = b = c = d = e = f = g = h = zero
    for j in range(p):
        here = start + j
        s, t, u = load(image, here), load(image, here + wide), load(image, here + 2 * wide)
        here += 3 * wide
        v, w, x = load(image, here), load(image, here + wide), load(image, here + 2 * wide)
        here += 3 * wide
        y = load(image, here)
        for i in range(p):
            here += wide
            k, z = splat_at(columns, j * p + i), load(image, here)
            a, b, c, d = a + k * s, b + k * t, c + k * u, d + k * v
            e, f, g, h = e + k * w, f + k * x, g + k * y, h + k * z
            s, t, u, v, w, x, y = t, u, v, w, x, y, z
    store_four(out, at, long, a, b, c, d)
    store_four(out, at + 4 * long, long, e, f, g, h)


@njit(nogil=True, error_model="numpy")
def _four_rows(columns, p, image, wide, start, out, long, at):
    """Products at 4 rows x `LANES` places. Two of the template's columns at a time have sums of their
    own: each sum waits for the one before.
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
            s, t = splat_at(columns, i), splat_at(columns, i + p)
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
            t, u3 = splat_at(columns, i), load(image, here)
            a0, a1, a2, a3 = a0 + t * u0, a1 + t * u1, a2 + t * u2, a3 + t * u3
            u0, u1, u2 = u1, u2, u3
            here += wide
    store_four(out, at, long, a0 + b0, a1 + b1, a2 + b2, a3 + b3)


@njit(nogil=True, error_model="numpy")
def _eight_below(template, p, image, wide, start, out):
    """Write the products of a template with the windows at eight places, one below the other,
    into out (8,).
    """
    n, zero = row_length(p), splat(np.float32(0.0))
    a = b = c = d = e = f = g = h = zero
    for column in range(0, n, LANES):
        here = start + column
        s, t, u = load(image, here), load(image, here + wide), load(image, here + 2 * wide)
        here += 3 * wide
        v, w, x = load(image, here), load(image, here + wide), load(image, here + 2 * wide)
        here += 3 * wide
        y = load(image, here)
        for i in range(2 * n + column, (p + 2) * n + column, n):
            here += wide
            k, z = load(template, i), load(image, here)
            a, b, c, d = a + k * s, b + k * t, c + k * u, d + k * v
            e, f, g, h = e + k * w, f + k * x, g + k * y, h + k * z
            s, t, u, v, w, x, y = t, u, v, w, x, y, z
    out[0], out[1], out[2], out[3] = total(a), total(b), total(c), total(d)
    out[4], out[5], out[6], out[7] = total(e), total(f), total(g), total(h)


@njit(nogil=True, error_model="numpy")
def extent(p, ny, nx):
    """Rows and places of a row that `at_all` reads of the image, and those that it writes."""
    high, long = max(multiple(ny, _ROWS), 2 * _ROWS), row_length(nx)
    return high + p - 1, max(long + p - 1, nx - 1 + row_length(p)), high, long


@njit(nogil=True, error_model="numpy")
def at_all(template, p, image, ny, nx, out):
    """Write the products of a template with the windows at ny x nx places into out, in rows;
    image and out as in `extent`.
    """
    n, columns = row_length(p), np.empty(p * p, np.float32)
    for j in range(p):
        for i in range(p):
            columns[j * p + i] = template[(i + 2) * n + j]
    _, wide, high, long = extent(p, ny, nx)
    few = nx % LANES <= _FEW  # last columns are not worth vectors along the rows
    end = nx - nx % LANES if few else long
    for x in range(0, end, LANES):
        y = 0
        while y + _ROWS < high:
            _eight_rows(columns, p, image, wide, y * wide + x, out, long, y * long + x)
            y += 2 * _ROWS
        if y < high:
            _four_rows(columns, p, image, wide, y * wide + x, out, long, y * long + x)
    found = np.empty(8, np.float32)
    for x in range(end, nx):
        for y in range(0, high, 8):
            y = min(y, high - 8)  # noqa: PLW2901
            _eight_below(template, p, image, wide, y * wide + x, found)
            for k in range(8):
                out[(y + k) * long + x] = found[k]
