"""Statistics of the registration of patches in images that differ from them by correlated noise.

For every patch: its slopes, the covariances of the noise's products with four fields (both slopes,
the patch, a constant), and all that follows for the match (`landmarks.localization`). The noise is
that of `landmarks.error_model`: each of its terms is a function of the distance along the rows times
one of the distance along the columns. A term is applied by its values at all distances at which it
is not negligible (short correlation lengths), or by its principal components over a patch's rows and
columns (long ones).
"""

import math

import numpy as np
from numba import njit, prange

from .sums import add_shifted, dot

NUMBERS = 13
"""Results for each patch, in this order: contrast; variance of the noise about its mean; V; expected
loss of correlation by the place between pixels; covariance of the shift xx, yy, xy (x: columns, y:
rows); covariance of the noise's products with the slopes xx, yy, xy; displacement x, y by the known
difference; correlation with the image. Without a determined shift its covariance and displacement
are infinite.
"""

_FIELDS = 4
"""Slope along the columns, slope along the rows, patch of unit norm, constant of unit norm."""
_PAIRS = ((0, 0), (1, 1), (0, 1), (2, 2), (3, 3))
"""Pairs of fields whose products with the noise have a covariance of interest."""
_TEXTURED = 1e-12
_DETERMINED = 1e-9
_FLAT = 1e-6
"""Share of a patch's power, a thousandth of its contrast, up to which another one is flat: differences of
single precision have errors of 1e-7 of it, which differ between processors.
"""
_BLOCK = 4
"""Patches that share scratch memory."""


@njit(cache=True, nogil=True, error_model="numpy")
def _spread(field, factor, p, wide, out):
    """A field times a factor, (p p,) each, into out (p wide,), where each row is followed by columns
    that stay as they are.
    """
    for y in range(p):
        row, own, target = field[y * p : y * p + p], factor[y * p : y * p + p], out[y * wide :]
        for x in range(p):
            target[x] = row[x] * own[x]


@njit(cache=True, nogil=True, error_model="numpy")
def _by_distance(fields, east, south, p, taps, work, products):
    """Add the covariances of slope errors' products.

    fields (4, p p); east, south (p p,): sensitivities to slopes along the columns and the rows. taps
    (3, 2 b + 1): covariance of heights along an axis, its first derivative with the other sign, and
    its second derivative with the other sign, at the distances -b..b. work (9, (p + 2 b) (p + b)): its
    first eight arrays are 0 in b rows at both ends and in b columns behind each row.

    A covariance is a sum over pairs of nodes. The pairs of two rows are the mirror images of those of
    the same rows in the other order: the sums run over the distances of rows from 0 on only, with
    half the term at 0, and both orders of a pair of fields are added.
    """
    value, first, second = taps[0], taps[1], taps[2]
    b = value.size // 2
    wide = p + b
    inner = slice(b * wide, (b + p) * wide)
    wider = slice(b * wide - b, (b + p) * wide + b)
    halves = taps[:, b:].copy()
    halves[:, 0] *= np.float32(0.5)
    values, firsts, seconds = halves[0], -halves[1], halves[2]
    for f in range(_FIELDS):
        own = work[4 * (f == 1) : 4 * (f == 1) + 4]  # those of the first two fields are both kept
        by_east, by_south, for_east, for_south = own[0], own[1], own[2], own[3]
        _spread(fields[f], east, p, wide, by_east[b * wide :])
        _spread(fields[f], south, p, wide, by_south[b * wide :])
        for_east[inner] = np.float32(0.0)
        for_south[inner] = np.float32(0.0)
        for source, along_cols, along_rows, target in (
            (by_east, second, values, for_east),
            (by_south, first, firsts, for_east),
            (by_south, value, seconds, for_south),
            (by_east, first, firsts, for_south),
        ):
            straight = work[8]
            straight[inner] = np.float32(0.0)
            add_shifted(along_cols, 1, source[wider], straight[inner])
            add_shifted(along_rows, wide, straight[b * wide :], target[inner])
        same = dot(by_east[inner], for_east[inner]) + dot(by_south[inner], for_south[inner])
        products[f if f < 2 else f + 1] += 2.0 * same
        if f == 1:
            products[2] += dot(work[0][inner], for_east[inner]) + dot(
                work[1][inner], for_south[inner]
            )
            products[2] += dot(by_east[inner], work[2][inner]) + dot(
                by_south[inner], work[3][inner]
            )


@njit(cache=True, nogil=True, error_model="numpy")
def _by_components(fields, factors, p, components, products):
    """Add the covariances of the products of a sum of noise terms: fields (4, p p), the terms'
    sensitivities (m, p p), and their principal components (2, m, r, p) along the rows and along the
    columns.
    """
    count = components.shape[2]
    n, m = _FIELDS * p, _FIELDS * count
    source, by_rows = np.empty(p * n, np.float32), np.empty(n, np.float32)
    turned = np.empty(p * m, np.float32)  # (p, 4, r)
    found = np.zeros((count, m), np.float32)  # (r, 4, r)
    for term in range(components.shape[1]):
        for f in range(_FIELDS):
            _spread(fields[f], factors[term], p, n, source[f * p :])
        for k in range(count):
            by_rows[:] = np.float32(0.0)
            add_shifted(components[0, term, k], n, source, by_rows)
            for f in range(_FIELDS):
                for x in range(p):
                    turned[x * m + f * count + k] = by_rows[f * p + x]
        for k in range(count):
            add_shifted(components[1, term, k], m, turned, found[k])
    for k, (i, j) in enumerate(_PAIRS):
        for c in range(count):
            one, other = found[c, i * count :], found[c, j * count :]
            products[k] += dot(one[:count], other[:count])


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _slopes(image, p, across, down):
    """Derivatives of an image along its columns and rows at the nodes, (p p,) each: differences of
    the sixth order over seven nodes, of lower order in the three outer rows.
    """
    n = p * p
    for step, out in ((1, across), (p, down)):
        if n > 6 * step:
            o, m = 3 * step, n - 6 * step
            inner = out[o : o + m]
            a, b, c = image[o + step :], image[o + 2 * step :], image[o + 3 * step :]
            d, e, f = image[o - step :], image[o - 2 * step :], image[o - 3 * step :]
            for x in range(m):
                inner[x] = (
                    np.float32(0.75) * (a[x] - d[x])
                    - np.float32(0.15) * (b[x] - e[x])
                    + np.float32(1.0 / 60.0) * (c[x] - f[x])
                )
        between = p if step == 1 else 1
        for line in range(p):
            for i in range(min(3, p)):
                for k in (i, p - 1 - i):
                    out[line * between + k * step] = _outer_slope(
                        image[line * between :], step, p, k
                    )


@njit(cache=True, nogil=True, error_model="numpy")
def _outer_slope(line, step, p, k):
    """Derivative at one of the three outer nodes of a line: over five nodes, three, or two."""
    away = min(k, p - 1 - k)
    if away >= 2:
        near = line[(k + 1) * step] - line[(k - 1) * step]
        middle = line[(k + 2) * step] - line[(k - 2) * step]
        return (np.float32(8.0) * near - middle) / np.float32(12.0)
    if away == 1:
        return np.float32(0.5) * (line[(k + 1) * step] - line[(k - 1) * step])
    return line[step] - line[0] if k == 0 else line[(p - 1) * step] - line[(p - 2) * step]


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "reassoc"})
def _mean(values):
    """Mean of an array (n,)."""
    total = 0.0
    for x in range(values.size):
        total += np.float64(values[x])
    return np.float32(total / values.size)


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _less(values, mean, share, other):
    """values - mean - share other, in place; (n,)."""
    for x in range(values.size):
        values[x] = values[x] - mean - share * other[x]


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _scaled(values, factor, mean, out):
    """factor (values - mean) into out; (n,)."""
    for x in range(values.size):
        out[x] = factor * (values[x] - mean)


@njit(cache=True, nogil=True, error_model="numpy")
def _own_correlation(power, product, change):
    """Correlation of a patch with itself and a change, from the patch's squared norm, the product of
    the patch of unit norm with the change, and the squared norm of the centred change. 0 if the changed
    patch is flat.
    """
    own = math.sqrt(power)
    whole = power + 2.0 * own * product + change
    if not whole > _FLAT * power:
        return 0.0
    return min(max((own + product) / math.sqrt(whole), -1.0), 1.0)


@njit(cache=True, nogil=True, error_model="numpy")
def _shift(normal, products, x, y, out):
    """Write covariance and displacement of the shift into out, from F (``normal``: xx, yy, xy), the
    noise's products and those x, y of the slopes with the difference of patch and image.
    """
    xx, yy, xy = normal
    sxx, syy, sxy = products[0], products[1], products[2]
    determinant = xx * yy - xy * xy
    if determinant > _DETERMINED * (xx + yy) ** 2:
        a, b, c = yy / determinant, xx / determinant, -xy / determinant
        out[4] = a * (a * sxx + c * sxy) + c * (a * sxy + c * syy)
        out[5] = c * (c * sxx + b * sxy) + b * (c * sxy + b * syy)
        out[6] = a * (c * sxx + b * sxy) + c * (c * sxy + b * syy)
        out[10], out[11] = a * x + c * y, c * x + b * y
    else:
        out[4], out[5], out[6] = math.inf, math.inf, 0.0
        out[10] = out[11] = math.inf


@njit(cache=True, nogil=True, error_model="numpy")
def _register(patch, p, sources, level, noise, terms, fields, scaled, work, out):
    """The statistics of one patch (p p,); the other arguments as in `registrations`, and scratch
    arrays.
    """
    nodes = p * p
    zero, one, inverse = np.float32(0.0), np.float32(1.0), np.float32(1.0 / level)
    across, down, unit = fields[0], fields[1], fields[2]
    east, south, image, change = scaled[0], scaled[1], scaled[2], scaled[3]
    _scaled(sources[0], inverse, zero, image)
    _scaled(sources[1], inverse, zero, east)
    _scaled(sources[2], inverse, zero, south)
    _scaled(patch, inverse, zero, change)
    _less(change, zero, one, image)
    _less(change, _mean(change), zero, change)  # patch less image, centred
    _scaled(patch, inverse, _mean(patch), unit)
    _less(unit, _mean(unit), zero, unit)  # the rounding of the mean
    power = dot(unit, unit)
    textured = power > _TEXTURED * nodes
    safe = power if textured else 1.0
    _slopes(unit, p, across, down)
    loss = (dot(across, across) + dot(down, down)) / safe / 24.0
    _scaled(unit, np.float32(1.0 / math.sqrt(safe)), zero, unit)
    _less(across, _mean(across), np.float32(dot(across, unit)), unit)
    _less(down, _mean(down), np.float32(dot(down, unit)), unit)
    fields[3] = np.float32(1.0 / p)
    xx, yy, xy = dot(across, across), dot(down, down), dot(across, down)
    products = np.array([xx, yy, xy, dot(unit, unit), 1.0])
    products *= noise[0]
    variance = noise[0] + noise[2] * dot(image, image) / nodes
    variance += noise[1] * (dot(east, east) + dot(south, south)) / nodes
    taps, heights, albedo = terms
    if noise[1] > 0.0 and taps.shape[1]:
        _by_distance(fields, east, south, p, taps, work, products)
    elif noise[1] > 0.0:
        _by_components(fields, scaled[:2], p, heights, products)
    if noise[2] > 0.0:
        _by_components(fields, scaled[2:3], p, albedo, products)

    out[0] = math.sqrt(power / nodes)
    out[1] = max(variance - products[4] / nodes, 0.0)
    out[2] = products[3] if textured else math.inf
    out[3] = min(max(loss, 0.0), 1.0)
    out[7:10] = products[:3] / safe
    out[12] = 0.0
    if textured:
        out[12] = _own_correlation(power, -dot(unit, change), dot(change, change))
    _shift((xx, yy, xy), products, dot(across, change), dot(down, change), out)


@njit(cache=True, nogil=True, error_model="numpy", parallel=True)
def registrations(patches, images, east, south, level, noise, taps, heights, albedo, out):
    """Write the statistics (n, `NUMBERS`) of n patches.

    patches, images, east, south (n, p, p) float32: the patches, the image at their places, and its
    derivatives with respect to the terrain's slopes; all are divided by level (n,). noise (3,):
    variances of white noise, of slope errors and of relative brightness. The slope errors' term is
    given by taps (`_by_distance`) or, without any, by heights (2, 2, r, p), the brightness by albedo
    (2, 1, r, p), principal components along the rows and along the columns.
    """
    n, p = patches.shape[0], patches.shape[1]
    b = taps.shape[1] // 2
    for block in prange((n + _BLOCK - 1) // _BLOCK):
        fields = np.empty((_FIELDS, p * p), np.float32)
        scaled = np.empty((4, p * p), np.float32)
        work = np.zeros((9, (p + 2 * b) * (p + b)), np.float32)
        for k in range(block * _BLOCK, min(n, (block + 1) * _BLOCK)):
            sources = images[k].ravel(), east[k].ravel(), south[k].ravel()
            _register(
                patches[k].ravel(), p, sources, level[k], noise, (taps, heights, albedo), fields,
                scaled, work, out[k],
            )  # fmt: skip
