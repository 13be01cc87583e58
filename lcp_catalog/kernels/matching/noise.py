"""Covariances of the products of correlated noise with fields over a patch.

The noise is that of `landmarks.error_model`: each of its terms is a function of the distance along the
rows times one of the distance along the columns. A term is applied by its values at all distances at
which it is not negligible (short correlation lengths), or by its principal components over a patch's
rows and columns (long ones).

`LANES` patches are computed together: node by node, the numbers of as many patches stand side by side
(`kernels.vectors`). An array of n nodes has n LANES places.
"""

import numpy as np

from ..cache import njit
from ..vectors import LANES, aligned, load, load_four, multiple, splat, splat_at, store, store_four

FIELDS = 4
"""Slope along the columns, slope along the rows, patch of unit norm, constant of unit norm."""
PAIRS = ((0, 0), (1, 1), (0, 1), (2, 2), (3, 3))
"""Pairs of fields whose products with the noise have a covariance of interest."""
_TILE = 4
"""Nodes of a row, or components, whose sums are held in registers together."""
_STRIP = 3
"""Tiles of a strip of columns."""
_RUN = 32 * LANES
"""Places of an array whose products are summed before they are added to the rest."""


@njit(nogil=True, error_model="numpy")
def tiled(count):
    """The next multiple of `_TILE`: rows of patches are followed by zeros up to it."""
    return multiple(count, _TILE)


@njit(nogil=True, error_model="numpy")
def _add(sums, factor, out):
    """Add factor times a vector to out (LANES,)."""
    part = np.empty(LANES, np.float32)
    store(part, 0, sums)
    for k in range(LANES):
        out[k] += factor * part[k]


@njit(nogil=True, error_model="numpy")
def _dot(a, b):
    """The sums of products of two arrays (n LANES,), a vector."""
    zero = splat(np.float32(0.0))
    total = zero
    for first in range(0, a.size, _RUN):
        s = zero
        for x in range(first, min(first + _RUN, a.size), LANES):
            s = s + load(a, x) * load(b, x)
        total = total + s
    return total


@njit(nogil=True, error_model="numpy", forceinline=True)
def _along_row(values, at, taps, even, odd, b, out, to):
    """Write sums of the nodes around the four from place ``at`` on, in their row, times factors up to a
    distance of b, into out from place ``to`` on: four vectors each. The factors, even and odd in the
    distance, stand in taps around the places even and odd. Nodes at equal distances on both sides
    are added, and subtracted, first.
    """
    zero, s, f = splat(np.float32(0.0)), LANES, splat_at(taps, even)
    a0, a1, a2, a3 = load_four(values, at, s)
    a0, a1, a2, a3 = f * a0, f * a1, f * a2, f * a3
    b0 = b1 = b2 = b3 = zero
    for k in range(1, b + 1):
        f, g, left, right = (
            splat_at(taps, even + k),
            splat_at(taps, odd + k),
            at - k * s,
            at + k * s,
        )
        v, w = load(values, left), load(values, right)
        a0, b0 = a0 + f * (w + v), b0 + g * (w - v)
        v, w = load(values, left + s), load(values, right + s)
        a1, b1 = a1 + f * (w + v), b1 + g * (w - v)
        v, w = load(values, left + 2 * s), load(values, right + 2 * s)
        a2, b2 = a2 + f * (w + v), b2 + g * (w - v)
        v, w = load(values, left + 3 * s), load(values, right + 3 * s)
        a3, b3 = a3 + f * (w + v), b3 + g * (w - v)
    store_four(out, to, s, a0, a1, a2, a3)
    store_four(out, to + 4 * s, s, b0, b1, b2, b3)


@njit(nogil=True, error_model="numpy", forceinline=True)
def _along_columns(values, at, wide, taps, one, other, b, out, to):
    """Write sums of the four nodes from place ``at`` on and of those above them, in rows of ``wide``
    places, up to a distance of b, into out as `_along_row` does: half of the factor at distance 0.
    """
    s, half = LANES, splat(np.float32(0.5))
    f, g = half * splat_at(taps, one), half * splat_at(taps, other)
    u, v, w, x = load_four(values, at, s)
    a0, a1, a2, a3 = f * u, f * v, f * w, f * x
    b0, b1, b2, b3 = g * u, g * v, g * w, g * x
    for k in range(1, b + 1):
        f, g = splat_at(taps, one + k), splat_at(taps, other + k)
        u, v, w, x = load_four(values, at - k * wide, s)
        a0, a1, a2, a3 = a0 + f * u, a1 + f * v, a2 + f * w, a3 + f * x
        b0, b1, b2, b3 = b0 + g * u, b1 + g * v, b2 + g * w, b3 + g * x
    store_four(out, to, s, a0, a1, a2, a3)
    store_four(out, to + 4 * s, s, b0, b1, b2, b3)


@njit(nogil=True, error_model="numpy", forceinline=True)
def _filtered(products, by_east, by_south, wide, taps, b, out):
    """Write the sums that `_paired` takes from a field into out (32 LANES,): those along the rows of its
    products with both sensitivities at the four nodes from the places by_east and by_south on, and
    those along the columns. No array is cut here: each part would be counted as another user of it.
    """
    s, value = 4 * LANES, b
    first, second = value + 2 * b + 1, value + 4 * b + 2
    _along_row(products, by_east, taps, second, first, b, out, 0)
    _along_row(products, by_south, taps, value, first, b, out, 2 * s)
    _along_columns(products, by_east, wide, taps, value, first, b, out, 4 * s)
    _along_columns(products, by_south, wide, taps, second, first, b, out, 6 * s)


@njit(nogil=True, error_model="numpy", forceinline=True)
def _paired(one, other):
    """Sum of the products of the sums along the rows of a field with those along the columns of another
    (`_filtered`): second derivative with value, value with second derivative, and the first ones.
    """
    s = 4 * LANES
    a, b, c, d = _four_products(one, 0, other, 4 * s)
    e, f, g, h = _four_products(one, 2 * s, other, 6 * s)
    i, j, k, m = _four_products(one, s, other, 7 * s)
    t, u, v, w = _four_products(one, 3 * s, other, 5 * s)
    return ((a + b) + (c + d)) + ((e + f) + (g + h)) - ((i + j) + (k + m)) - ((t + u) + (v + w))


@njit(nogil=True, error_model="numpy")
def _four_products(one, at, other, to):
    """The products of four vectors from two places on."""
    a, b, c, d = load_four(one, at, LANES)
    e, f, g, h = load_four(other, to, LANES)
    return a * e, b * f, c * g, d * h


@njit(nogil=True, error_model="numpy")
def _wide(p, b):
    """Nodes of a row with b zeros on both sides, an odd number: rows of a power of 2 would take turns in
    few places of the cache.
    """
    return (tiled(p) + 2 * b) | 1


@njit(nogil=True, error_model="numpy")
def _product(field, factor, at, count, out, to):
    """Write the products of ``count`` places of two arrays from place ``at`` on into out from place
    ``to`` on.
    """
    for x in range(0, count, LANES):
        store(out, to + x, load(field, at + x) * load(factor, at + x))


@njit(nogil=True, error_model="numpy")
def _surrounded(field, factor, p, b, out):
    """Write the products of two arrays (p p LANES,) into out, with zeros around that `scratch` has
    left: b nodes before and behind each row, and b rows above the first.
    """
    m, wide = p * LANES, _wide(p, b) * LANES
    for y in range(p):
        _product(field, factor, y * m, m, out, (y + b) * wide + b * LANES)


@njit(nogil=True, error_model="numpy")
def scratch(p, b):
    """Work arrays of `by_distance` for patches of p x p nodes and terms up to a distance of b nodes: two
    fields' products with both sensitivities, surrounded by zeros (`_surrounded`).
    """
    out = aligned(4 * (p + b) * _wide(p, b) * LANES)
    out[:] = np.float32(0.0)
    return out


@njit(nogil=True, error_model="numpy")
def by_distance(fields, east, south, p, taps, work, products):
    """Add the covariances of slope errors' products with the fields to products (5, LANES), `PAIRS`.

    fields (4, p p LANES); east, south (p p LANES,): sensitivities to slopes along the columns and the
    rows. taps (3, 2 b + 1): covariance of heights along an axis, its first derivative with the other
    sign, and its second derivative with the other sign, at the distances -b..b. work: `scratch`.

    A covariance is a sum over pairs of nodes. The pairs of two rows are the mirror images of those of
    the same rows in the other order: the sums run over the distances of rows from 0 on only, with
    half the term at 0, and both orders of a pair of fields are added.
    """
    b, size = taps.shape[1] // 2, work.size // 4
    for first in (0, 2):
        for k in range(2):
            _surrounded(fields[first + k], east, p, b, work[2 * k * size :])
            _surrounded(fields[first + k], south, p, b, work[(2 * k + 1) * size :])
        one, other, both = _by_distance_of_two(work, p, taps.ravel(), b, first == 0)
        _add(one, 2.0, products[0 if first == 0 else 3])
        _add(other, 2.0, products[1 if first == 0 else 4])
        if first == 0:
            _add(both, 1.0, products[2])


@njit(nogil=True, error_model="numpy")
def _by_distance_of_two(work, p, taps, b, mixed):
    """The sums of `by_distance` for a field, for another one, and, if ``mixed``, of both orders of the
    two. A strip of columns at a time, of which the rows in reach stay in the cache.
    """
    n, wide, tile, size = tiled(p) * LANES, _wide(p, b) * LANES, _TILE * LANES, work.size // 4
    own, others = aligned(8 * tile), aligned(8 * tile)
    one = other = both = splat(np.float32(0.0))
    for left in range(0, n, _STRIP * tile):
        right = min(left + _STRIP * tile, n)
        for y in range(b, b + p):
            a = c = d = splat(np.float32(0.0))
            first = y * wide + b * LANES
            for at in range(first + left, first + right, tile):
                _filtered(work, at, at + size, wide, taps, b, own)
                _filtered(work, at + 2 * size, at + 3 * size, wide, taps, b, others)
                a, c = a + _paired(own, own), c + _paired(others, others)
                if mixed:
                    d = d + _paired(own, others) + _paired(others, own)
            one, other, both = one + a, other + c, both + d
    return one, other, both


@njit(nogil=True, error_model="numpy")
def _combine(factors, source, step, between, count, out, first, out_step, out_between):
    """Add sums of vectors of source, times the factors (r, k), to vectors of out: for all n below
    ``count``, out[first + r out_step + n out_between] += sum over k of factors[r, k] source[k step +
    n between]. r is a multiple of 4, count an even number.
    """
    s, p, flat = out_step, factors.shape[1], factors.ravel()
    for n in range(0, count, 2):
        for r in range(0, factors.shape[0], 4):
            o = first + r * s + n * out_between
            u = o + out_between
            a0, a1, a2, a3 = load_four(out, o, s)
            b0, b1, b2, b3 = load_four(out, u, s)
            for k in range(p):
                at, own = k * step + n * between, r * p + k
                v, w = load(source, at), load(source, at + between)
                f, g = splat_at(flat, own), splat_at(flat, own + p)
                h, i = splat_at(flat, own + 2 * p), splat_at(flat, own + 3 * p)
                a0, a1, a2, a3 = a0 + f * v, a1 + g * v, a2 + h * v, a3 + i * v
                b0, b1, b2, b3 = b0 + f * w, b1 + g * w, b2 + h * w, b3 + i * w
            store_four(out, o, s, a0, a1, a2, a3)
            store_four(out, u, s, b0, b1, b2, b3)


@njit(nogil=True, error_model="numpy")
def whole_tiles(components):
    """Components (2, m, r, p) with zeros up to a multiple of `_TILE` components, for `by_components`."""
    kinds, terms, count, p = components.shape
    out = np.zeros((kinds, terms, tiled(count), p), np.float32)
    out[:, :, :count] = components
    return out


@njit(nogil=True, error_model="numpy")
def by_components(fields, factors, p, components, products):
    """Add the covariances of the products of a sum of noise terms with the fields to products (5,
    LANES), `PAIRS`: fields (4, p p LANES), the terms' sensitivities (m, p p LANES), and their principal
    components (2, m, r, p) along the rows and along the columns (`whole_tiles`).
    """
    count, m, s = components.shape[2], p * LANES, LANES
    wide, size = count * s, count * count * s
    pair, by_columns = aligned(2 * m), aligned(multiple(p, 2) * wide)
    found = aligned(FIELDS * size).reshape(FIELDS, size)
    found[:] = np.float32(0.0)
    for f in range(FIELDS):
        field, sums = fields[f], found[f]
        for term in range(components.shape[1]):
            along, across, factor = components[1, term], components[0, term], factors[term]
            by_columns[:] = np.float32(0.0)
            for y in range(0, p, 2):
                _product(field, factor, y * m, min(2, p - y) * m, pair, 0)
                _combine(along, pair, s, m, 2, by_columns, y * wide, s, wide)
            _combine(across, by_columns, wide, s, count, sums, 0, wide, s)
    for k, (i, j) in enumerate(PAIRS):
        _add(_dot(found[i], found[j]), 1.0, products[k])
