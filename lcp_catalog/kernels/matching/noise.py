"""Covariances of the products of correlated noise with fields over a patch.

The noise is that of `landmarks.error_model`: each of its terms is a function of the distance along the
rows times one of the distance along the columns. A term is applied by its values at all distances at
which it is not negligible (short correlation lengths), or by its principal components over a patch's
rows and columns (long ones).

`LANES` patches are computed together: node by node, the numbers of as many patches stand side by side
(`kernels.vectors`). An array of n nodes has n LANES places.
"""

import numpy as np
from numba import njit

from ..vectors import LANES, load, load_four, multiple, splat, store, store_four

FIELDS = 4
"""Slope along the columns, slope along the rows, patch of unit norm, constant of unit norm."""
PAIRS = ((0, 0), (1, 1), (0, 1), (2, 2), (3, 3))
"""Pairs of fields whose products with the noise have a covariance of interest."""
_TILE = 4
"""Nodes of a row, or components, whose sums are held in registers together."""
_RUN = 32 * LANES
"""Places of an array whose products are summed before they are added to the rest."""


@njit(cache=True, nogil=True, error_model="numpy")
def tiled(count):
    """The next multiple of `_TILE`: rows of patches are followed by zeros up to it."""
    return multiple(count, _TILE)


@njit(cache=True, nogil=True, error_model="numpy")
def _add(sums, factor, out):
    """Add factor times a vector to out (LANES,)."""
    part = np.empty(LANES, np.float32)
    store(part, 0, sums)
    for k in range(LANES):
        out[k] += factor * part[k]


@njit(cache=True, nogil=True, error_model="numpy")
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


@njit(cache=True, nogil=True, error_model="numpy")
def _product(field, factor, out, kept):
    """Write the products of two rows (n LANES,) into two others."""
    for x in range(0, field.size, LANES):
        v = load(field, x) * load(factor, x)
        store(out, x, v)
        store(kept, x, v)


@njit(cache=True, nogil=True, error_model="numpy")
def _along_columns(row, even, odd, out, another):
    """Write two sums of a row ((n + 2 b) LANES,) shifted by 0, 1, 2 ... nodes and times factors (2 b +
    1,), which are even and odd about their middle, into out and another (n LANES,), n a multiple of
    `_TILE`. Places at equal distances on both sides are added, and subtracted, first.
    """
    zero, s, b = splat(np.float32(0.0)), LANES, even.size // 2
    for x in range(0, out.size, _TILE * s):
        f, at = splat(even[b]), x + b * s
        a0, a1, a2, a3 = load_four(row, at, s)
        a0, a1, a2, a3 = f * a0, f * a1, f * a2, f * a3
        b0 = b1 = b2 = b3 = zero
        for k in range(1, b + 1):
            f, g, left, right = splat(even[b + k]), splat(odd[b + k]), at - k * s, at + k * s
            v, w = load(row, left), load(row, right)
            a0, b0 = a0 + f * (w + v), b0 + g * (w - v)
            v, w = load(row, left + s), load(row, right + s)
            a1, b1 = a1 + f * (w + v), b1 + g * (w - v)
            v, w = load(row, left + 2 * s), load(row, right + 2 * s)
            a2, b2 = a2 + f * (w + v), b2 + g * (w - v)
            v, w = load(row, left + 3 * s), load(row, right + 3 * s)
            a3, b3 = a3 + f * (w + v), b3 + g * (w - v)
        store_four(out, x, s, a0, a1, a2, a3)
        store_four(another, x, s, b0, b1, b2, b3)


@njit(cache=True, nogil=True, error_model="numpy")
def _along_rows(one, factors, other, others, p, n, by, out):
    """Write sums of p rows of one and of other, times their factors (b + 3,), which begin and end with
    0, into out: row y has those of the rows from y on. Return the sums of the products of out with by,
    a vector. All rows have n places; an odd p has one more row, of zeros in by.

    A few columns at a time, whose rows stay in the cache; two rows at once.
    """
    zero, s = splat(np.float32(0.0)), LANES
    total = zero
    for x in range(0, n, _TILE * s):
        part = zero
        for top in range(x, x + p * n, 2 * n):
            a0 = a1 = a2 = a3 = b0 = b1 = b2 = b3 = zero
            at = top
            for k in range(factors.size - 1):
                f, g = splat(factors[k + 1]), splat(others[k + 1])
                h, i = splat(factors[k]), splat(others[k])
                v, w = load(one, at), load(other, at)
                a0, b0 = a0 + f * v + g * w, b0 + h * v + i * w
                v, w = load(one, at + s), load(other, at + s)
                a1, b1 = a1 + f * v + g * w, b1 + h * v + i * w
                v, w = load(one, at + 2 * s), load(other, at + 2 * s)
                a2, b2 = a2 + f * v + g * w, b2 + h * v + i * w
                v, w = load(one, at + 3 * s), load(other, at + 3 * s)
                a3, b3 = a3 + f * v + g * w, b3 + h * v + i * w
                at += n
            store_four(out, top, s, a0, a1, a2, a3)
            store_four(out, top + n, s, b0, b1, b2, b3)
            c0, c1, c2, c3 = load_four(by, top, s)
            d0, d1, d2, d3 = load_four(by, top + n, s)
            part = part + ((c0 * a0 + c1 * a1) + (c2 * a2 + c3 * a3))
            part = part + ((d0 * b0 + d1 * b1) + (d2 * b2 + d3 * b3))
        total = total + part
    return total


@njit(cache=True, nogil=True, error_model="numpy")
def scratch(p, b):
    """Work arrays of `by_distance` for patches of p x p nodes and terms up to a distance of b nodes: two
    rows with b zeros at both ends, and twelve arrays of p rows with zeros behind each and b + 2 more rows
    of zeros.
    """
    n, m = tiled(p) * LANES, p * LANES
    rows = np.zeros((2, n + 2 * b * LANES), np.float32)
    sums = np.empty((12, (p + b + 2) * n), np.float32)
    sums[:, p * n :] = np.float32(0.0)
    for y in range(p):
        sums[:, y * n + m : y * n + n] = np.float32(0.0)
    return rows, sums


@njit(cache=True, nogil=True, error_model="numpy")
def by_distance(fields, east, south, p, taps, work, products):
    """Add the covariances of slope errors' products with the fields to products (5, LANES), `PAIRS`.

    fields (4, p p LANES); east, south (p p LANES,): sensitivities to slopes along the columns and the
    rows. taps (3, 2 b + 1): covariance of heights along an axis, its first derivative with the other
    sign, and its second derivative with the other sign, at the distances -b..b. work: `scratch`.

    A covariance is a sum over pairs of nodes. The pairs of two rows are the mirror images of those of
    the same rows in the other order: the sums run over the distances of rows from 0 on only, with
    half the term at 0, and both orders of a pair of fields are added.
    """
    value, first, second = taps[0], taps[1], taps[2]
    rows, sums = work
    b, n, m = value.size // 2, tiled(p) * LANES, p * LANES
    halves = np.zeros((3, b + 3), np.float32)
    halves[:, 1 : b + 2] = taps[:, b:]
    halves[:, 1] *= np.float32(0.5)
    values, firsts, seconds = halves[0], -halves[1], halves[2]
    middle, whole = slice(b * LANES, b * LANES + m), slice(0, p * n)
    for f in range(FIELDS):
        own = sums[8:] if f == 1 else sums[4:8]  # those of the first two fields are both kept
        by_east, by_south, for_east, for_south = own[0], own[1], own[2], own[3]
        for y in range(p):
            from_, to = slice(y * m, y * m + m), slice(y * n, y * n + n)
            _product(fields[f, from_], east[from_], rows[0, middle], by_east[to])
            _product(fields[f, from_], south[from_], rows[1, middle], by_south[to])
            _along_columns(rows[0], second, first, sums[0, to], sums[3, to])
            _along_columns(rows[1], value, first, sums[2, to], sums[1, to])
        east_sum = _along_rows(sums[0], values, sums[1], firsts, p, n, by_east, for_east)
        south_sum = _along_rows(sums[2], seconds, sums[3], firsts, p, n, by_south, for_south)
        _add(east_sum + south_sum, 2.0, products[f if f < 2 else f + 1])
        if f == 1:
            sum_ = _dot(sums[4, whole], for_east[whole]) + _dot(sums[5, whole], for_south[whole])
            sum_ = sum_ + _dot(by_east[whole], sums[6, whole])
            sum_ = sum_ + _dot(by_south[whole], sums[7, whole])
            _add(sum_, 1.0, products[2])


@njit(cache=True, nogil=True, error_model="numpy")
def _combine(factors, source, step, between, count, out, out_step, out_between):
    """Add sums of vectors of source, times the factors (r, k), to vectors of out: for all n below
    ``count``, out[r out_step + n out_between] += sum over k of factors[r, k] source[k step + n
    between]. r is a multiple of 4, count an even number.
    """
    for r in range(0, factors.shape[0], 4):
        f0, f1, f2, f3 = factors[r], factors[r + 1], factors[r + 2], factors[r + 3]
        s = out_step
        for n in range(0, count, 2):
            o, u = r * s + n * out_between, r * s + (n + 1) * out_between
            a0, a1, a2, a3 = load_four(out, o, s)
            b0, b1, b2, b3 = load_four(out, u, s)
            for k in range(f0.size):
                at = k * step + n * between
                v, w = load(source, at), load(source, at + between)
                f, g, h, i = splat(f0[k]), splat(f1[k]), splat(f2[k]), splat(f3[k])
                a0, a1, a2, a3 = a0 + f * v, a1 + g * v, a2 + h * v, a3 + i * v
                b0, b1, b2, b3 = b0 + f * w, b1 + g * w, b2 + h * w, b3 + i * w
            store_four(out, o, s, a0, a1, a2, a3)
            store_four(out, u, s, b0, b1, b2, b3)


@njit(cache=True, nogil=True, error_model="numpy")
def whole_tiles(components):
    """Components (2, m, r, p) with zeros up to a multiple of `_TILE` components, for `by_components`."""
    kinds, terms, count, p = components.shape
    out = np.zeros((kinds, terms, tiled(count), p), np.float32)
    out[:, :, :count] = components
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def by_components(fields, factors, p, components, products):
    """Add the covariances of the products of a sum of noise terms with the fields to products (5,
    LANES), `PAIRS`: fields (4, p p LANES), the terms' sensitivities (m, p p LANES), and their principal
    components (2, m, r, p) along the rows and along the columns (`whole_tiles`).
    """
    count, n, m = components.shape[2], tiled(p) * LANES, p * LANES
    source, spare = np.zeros(p * n, np.float32), np.empty(m, np.float32)
    by_rows = np.empty(count * n, np.float32)
    found = np.zeros((FIELDS, count * count * LANES), np.float32)
    for f in range(FIELDS):
        for term in range(components.shape[1]):
            for y in range(p):
                row = slice(y * m, y * m + m)
                _product(fields[f, row], factors[term][row], spare, source[y * n :])
            by_rows[:] = np.float32(0.0)
            _combine(components[0, term], source, n, LANES, n // LANES, by_rows, n, LANES)
            _combine(components[1, term], by_rows, LANES, n, count, found[f], LANES, count * LANES)
    for k, (i, j) in enumerate(PAIRS):
        _add(_dot(found[i], found[j]), 1.0, products[k])
