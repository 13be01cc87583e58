"""Statistics of the registration of patches in images that differ from them by correlated noise.

For every patch: its slopes, the covariances of the noise's products with four fields (both slopes,
the patch, a constant; `noise`), and all that follows for the match (`landmarks.localization`).

`LANES` patches are computed together: node by node, the numbers of as many patches stand side by side
(`kernels.vectors`). An array of n nodes has n LANES places, and sums are taken row by row.
"""

import math

import numpy as np
from numba import prange

from ..cache import njit
from ..completion import all_done
from ..vectors import LANES, aligned, load, splat, store, transpose
from .noise import FIELDS, PAIRS, by_components, by_distance, scratch, whole_tiles

NUMBERS = 13
"""Results for each patch, in this order: contrast; variance of the noise about its mean; V; expected
loss of correlation by the place between pixels; covariance of the shift xx, yy, xy (x: columns, y:
rows); covariance of the noise's products with the slopes xx, yy, xy; displacement x, y by the known
difference; correlation with the image. Without a determined shift its covariance and displacement
are infinite.
"""

_TEXTURED = 1e-12
_DETERMINED = 1e-9
_FLAT = 1e-6
"""Share of a patch's power, a thousandth of its contrast, up to which another one is flat: differences of
single precision have errors of 1e-7 of it, which differ between processors.
"""
_PARTS = 8
"""Parts of the patches, for threads; those of a part share scratch memory."""

# sums over a patch's nodes: the patch and its mean, the known change, the image and its two derivatives
# with respect to slopes, the patch's two slopes (x, y), and products of these
(
    _MEAN, _CHANGE_MEAN, _IMAGE2, _EAST2, _SOUTH2, _PATCH2, _CHANGE2, _X, _Y, _X2, _Y2, _XY, _X_PATCH,
    _Y_PATCH, _UNIT2, _UNIT_CHANGE, _X_CHANGE, _Y_CHANGE, _SUMS,
) = range(19)  # fmt: skip


@njit(nogil=True, error_model="numpy")
def side_by_side(stack, first, inverse, out):
    """Write the nodes of patches first, first + 1 ... of a stack (n, p, p), times inverse (LANES,),
    side by side into out; the last patch stands for those that are missing.
    """
    flat, n = stack.ravel(), stack.shape[1] * stack.shape[2]
    at = np.minimum(np.arange(first, first + LANES), stack.shape[0] - 1) * n
    whole = n // LANES * LANES
    factor = load(inverse, 0)
    for x in range(0, whole, LANES):
        transpose(flat, at, x, factor, out, x * LANES)
    for k in range(LANES):
        for x in range(whole, n):
            out[x * LANES + k] = inverse[k] * flat[at[k] + x]


@njit(nogil=True, error_model="numpy")
def _compare(p, patch, scaled, sums):
    """Write the patch less the image into scaled[3]; means of both, powers of the others."""
    n, zero = p * LANES, splat(np.float32(0.0))
    image, east, south, change = scaled[0], scaled[1], scaled[2], scaled[3]
    mean = off = light = across = down = zero
    for y in range(0, p * n, n):
        a = b = c = d = e = zero
        for x in range(y, y + n, LANES):
            u, v, g, h = load(patch, x), load(image, x), load(east, x), load(south, x)
            store(change, x, u - v)
            a, b, c, d, e = a + u, b + (u - v), c + v * v, d + g * g, e + h * h
        mean, off, light, across, down = mean + a, off + b, light + c, across + d, down + e
    share = splat(np.float32(1.0 / (p * p)))
    store(sums[_MEAN], 0, mean * share)
    store(sums[_CHANGE_MEAN], 0, off * share)
    store(sums[_IMAGE2], 0, light)
    store(sums[_EAST2], 0, across)
    store(sums[_SOUTH2], 0, down)


@njit(nogil=True, error_model="numpy")
def _less(p, values, mean):
    """Subtract a mean, a vector, from values in place. Return what is left of it and the power."""
    n, zero = p * LANES, splat(np.float32(0.0))
    left = power = zero
    for y in range(0, p * n, n):
        a = b = zero
        for x in range(y, y + n, LANES):
            u = load(values, x) - mean
            store(values, x, u)
            a, b = a + u, b + u * u
        left, power = left + a, power + b
    return left * splat(np.float32(1.0 / (p * p))), power


@njit(nogil=True, error_model="numpy")
def _centre(p, patch, change, sums):
    """Centre the patch, twice because the mean is rounded, and the change; their powers."""
    left, _ = _less(p, patch, load(sums[_MEAN], 0))
    _, power = _less(p, patch, left)
    store(sums[_PATCH2], 0, power)
    _, power = _less(p, change, load(sums[_CHANGE_MEAN], 0))
    store(sums[_CHANGE2], 0, power)


@njit(nogil=True, error_model="numpy")
def _slope(image, at, step, k, p):
    """Derivative at node k of the p nodes of a line, ``step`` places apart: a difference of the sixth
    order over seven nodes, of lower order in the three outer ones.
    """
    away = min(k, p - 1 - k)
    if away == 0:
        if k == 0:
            return load(image, at + step) - load(image, at)
        return load(image, at) - load(image, at - step)
    near = load(image, at + step) - load(image, at - step)
    if away == 1:
        return splat(np.float32(0.5)) * near
    middle = load(image, at + 2 * step) - load(image, at - 2 * step)
    if away == 2:
        return splat(np.float32(2.0 / 3.0)) * near - splat(np.float32(1.0 / 12.0)) * middle
    far = load(image, at + 3 * step) - load(image, at - 3 * step)
    three, two = splat(np.float32(1.0 / 60.0)) * far, splat(np.float32(0.15)) * middle
    return splat(np.float32(0.75)) * near - two + three


@njit(nogil=True, error_model="numpy")
def differentiate(p, patch, across, down, sums):
    """Write the patch's derivatives along its columns and rows; their means, powers, and products with
    the patch.
    """
    n, zero = p * LANES, splat(np.float32(0.0))
    mean_x = mean_y = xx = yy = xu = yu = zero
    for y in range(p):
        a = b = c = d = e = f = zero
        for x in range(p):
            at = y * n + x * LANES
            u = load(patch, at)
            g, h = _slope(patch, at, LANES, x, p), _slope(patch, at, n, y, p)
            store(across, at, g)
            store(down, at, h)
            a, b, c, d, e, f = a + g, b + h, c + g * g, d + h * h, e + g * u, f + h * u
        mean_x, mean_y, xx, yy, xu, yu = mean_x + a, mean_y + b, xx + c, yy + d, xu + e, yu + f
    share = splat(np.float32(1.0 / (p * p)))
    store(sums[_X], 0, mean_x * share)
    store(sums[_Y], 0, mean_y * share)
    store(sums[_X2], 0, xx)
    store(sums[_Y2], 0, yy)
    store(sums[_X_PATCH], 0, xu)
    store(sums[_Y_PATCH], 0, yu)


@njit(nogil=True, error_model="numpy")
def _project(p, fields, change, scale, sums):
    """Scale the patch to unit norm by scale (LANES,), and take their means and their shares of it
    from the slopes; powers and products of all.
    """
    n, zero, s = p * LANES, splat(np.float32(0.0)), load(scale, 0)
    across, down, unit = fields[0], fields[1], fields[2]
    mean_x, mean_y = load(sums[_X], 0), load(sums[_Y], 0)
    share_x, share_y = load(sums[_X_PATCH], 0) * s, load(sums[_Y_PATCH], 0) * s
    xx = yy = xy = uu = uc = xc = yc = zero
    for y in range(0, p * n, n):
        a = b = c = d = e = f = i = zero
        for x in range(y, y + n, LANES):
            u, w = load(unit, x) * s, load(change, x)
            g = load(across, x) - mean_x - share_x * u
            h = load(down, x) - mean_y - share_y * u
            store(unit, x, u)
            store(across, x, g)
            store(down, x, h)
            a, b, c, d = a + g * g, b + h * h, c + g * h, d + u * u
            e, f, i = e + u * w, f + g * w, i + h * w
        xx, yy, xy, uu = xx + a, yy + b, xy + c, uu + d
        uc, xc, yc = uc + e, xc + f, yc + i
    store(sums[_X2], 0, xx)
    store(sums[_Y2], 0, yy)
    store(sums[_XY], 0, xy)
    store(sums[_UNIT2], 0, uu)
    store(sums[_UNIT_CHANGE], 0, uc)
    store(sums[_X_CHANGE], 0, xc)
    store(sums[_Y_CHANGE], 0, yc)


@njit(nogil=True, error_model="numpy")
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


@njit(nogil=True, error_model="numpy")
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


@njit(nogil=True, error_model="numpy")
def _write(sums, loss, products, noise, nodes, out):
    """The statistics of a patch from its sums, its loss and the noise's products."""
    power = sums[_PATCH2]
    textured = power > _TEXTURED * nodes
    variance = noise[0] + noise[2] * sums[_IMAGE2] / nodes
    variance += noise[1] * (sums[_EAST2] + sums[_SOUTH2]) / nodes
    out[0] = math.sqrt(power / nodes)
    out[1] = max(variance - products[4] / nodes, 0.0)
    out[2] = products[3] if textured else math.inf
    out[3] = min(max(loss, 0.0), 1.0)
    out[7:10] = products[:3] / (power if textured else 1.0)
    out[12] = _own_correlation(power, -sums[_UNIT_CHANGE], sums[_CHANGE2]) if textured else 0.0
    _shift((sums[_X2], sums[_Y2], sums[_XY]), products, sums[_X_CHANGE], sums[_Y_CHANGE], out)


@njit(nogil=True, error_model="numpy")
def _register(stacks, first, level, noise, terms, work, out):
    """The statistics of the patches first, first + 1 ... of stacks (patches, images, east, south); the
    other arguments as in `registrations`, and work arrays.
    """
    fields, scaled, sums, spare = work
    p = stacks[0].shape[1]
    scale, loss = np.empty(LANES, np.float32), np.empty(LANES)
    for k in range(LANES):
        scale[k] = 1.0 / level[min(first + k, level.size - 1)]
    side_by_side(stacks[0], first, scale, fields[2])
    for k in range(3):
        side_by_side(stacks[k + 1], first, scale, scaled[k])
    _compare(p, fields[2], scaled, sums)
    _centre(p, fields[2], scaled[3], sums)
    differentiate(p, fields[2], fields[0], fields[1], sums)
    for k in range(LANES):
        safe = sums[_PATCH2, k] if sums[_PATCH2, k] > _TEXTURED * p * p else np.float32(1.0)
        loss[k] = (np.float64(sums[_X2, k]) + np.float64(sums[_Y2, k])) / safe / 24.0
        scale[k] = 1.0 / math.sqrt(safe)
    _project(p, fields, scaled[3], scale, sums)
    fields[3] = np.float32(1.0 / p)
    products = np.empty((len(PAIRS), LANES))
    products[0], products[1], products[2] = sums[_X2], sums[_Y2], sums[_XY]
    products[3], products[4] = sums[_UNIT2], 1.0
    products *= noise[0]
    taps, heights, albedo = terms
    if noise[1] > 0.0 and taps.shape[1]:
        by_distance(fields, scaled[1], scaled[2], p, taps, spare, products)
    elif noise[1] > 0.0:
        by_components(fields, scaled[1:3], p, heights, products)
    if noise[2] > 0.0:
        by_components(fields, scaled[:1], p, albedo, products)
    for k in range(min(LANES, out.shape[0] - first)):
        own = sums[:, k].astype(np.float64)
        _write(own, loss[k], products[:, k], noise, p * p, out[first + k])


@njit(nogil=True, error_model="numpy", parallel=True)
def registrations(patches, images, east, south, level, noise, taps, heights, albedo, out):
    """Write the statistics (n, `NUMBERS`) of n patches.

    patches, images, east, south (n, p, p) float32: the patches, the image at their places, and its
    derivatives with respect to the terrain's slopes; all are divided by level (n,). noise (3,):
    variances of white noise, of slope errors and of relative brightness. The slope errors' term is
    given by taps (`noise.by_distance`) or, without any, by heights (2, 2, r, p), the brightness by
    albedo (2, 1, r, p), principal components along the rows and along the columns.
    """
    n, p = patches.shape[0], patches.shape[1]
    stacks, terms = (
        (patches, images, east, south),
        (taps, whole_tiles(heights), whole_tiles(albedo)),
    )
    groups = (n + LANES - 1) // LANES
    parts = min(groups, _PARTS)
    done = 0
    for part in prange(parts):
        done += 1
        work = (
            aligned(FIELDS * p * p * LANES).reshape(FIELDS, p * p * LANES),
            aligned(4 * p * p * LANES).reshape(4, p * p * LANES),
            aligned(_SUMS * LANES).reshape(_SUMS, LANES),
            scratch(p, taps.shape[1] // 2),
        )
        for group in range(part, groups, parts):
            _register(stacks, group * LANES, level, noise, terms, work, out)
    all_done(done, parts)
