"""Covariance of the registration of a patch in an image that differs from its render.

Let a known patch t be matched with an image t(x - d) + n by least squares on the shift d, a gain and
an offset, with equal weights. With the rows B = [dt/dx, dt/dy, 1, t], F = B B^T and S = B C B^T, C
the covariance of the noise n, the covariance of the estimates is to first order F^-1 S F^-1. For
white noise it is noise^2 F^-1, the Cramer-Rao bound (Foerstner and Guelch 1987; the part of F for the
shift is the matrix of Harris and Stephens 1988). Correlated noise, as from smooth errors of a DEM,
moves a match much farther than white noise of the same variance.

Limits: first order, so for sigmas well below the width of the features; at a low signal the match
fails before the bound does, which `detection` describes. Differences damp detail near one pixel (an
ideal step counts half), so very sharp patches are located better than stated.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..arrays import AnyArray, Array, Float32
from .error_model import ErrorModel, PatchErrors, noise_products

HARRIS_K = 0.04


@dataclass(frozen=True, eq=False)
class Registration:
    """Statistics of the match of n patches with noisy images of themselves.

    ``contrast``: standard deviation of each patch relative to its mean signal; ``noise_variance``:
    of the noise about its mean over the patch; ``along``: V, variance of the noise's product with
    the centred patch of unit norm; ``shift_loss``: expected loss of correlation because the true
    place lies between whole pixels; (n,). ``covariance_px2`` (n, 2, 2) of the shift, columns first,
    rows downwards; infinite where the patch is not located in some direction. ``slope_noise`` (n, 2,
    2): covariance of the noise's products with the slopes of the patch, after the projection, in
    units of the squared norm of the centred patch. ``spread``: of the
    error model; the covariance is the mean over places, the other figures are those of a place with
    typical noise.
    """

    contrast: Array
    noise_variance: Array
    along: Array
    shift_loss: Array
    covariance_px2: Array
    nodes: int
    spread: float = 0.0
    slope_noise: Array | None = None


def registration(
    patches: AnyArray, errors: PatchErrors, model: ErrorModel, pixel_m: float
) -> Registration:
    """Statistics of patches (n, p, p) that are divided by their mean signal, with their sources of
    error; the patches are complete.

    The covariance is that of least squares on shift, gain and offset with unweighted pixels in
    correlated noise: with B = [dx, dy, 1, t], F = B B^T and S = B C B^T it is F^-1 S F^-1,
    restricted to the shift. The slopes are projected onto the complement of 1 and t first, which
    gives the same.
    """
    p = patches.shape[1]
    nodes = p * p
    image = np.asarray(patches, dtype=np.float64)
    centred = image - image.mean(axis=(1, 2), keepdims=True)
    power = np.einsum("nij,nij->n", centred, centred)
    textured = power > 1e-12 * nodes
    unit = centred / np.sqrt(np.where(textured, power, 1.0))[:, None, None]
    slopes = np.stack([node_slopes(image, 2), node_slopes(image, 1)], axis=1)
    loss = np.einsum("naij,naij->n", slopes, slopes) / np.where(textured, power, 1.0) / 24.0
    slopes -= slopes.mean(axis=(2, 3), keepdims=True)
    slopes -= np.einsum("naij,nij->na", slopes, unit)[..., None, None] * unit[:, None]
    normal = np.einsum("naij,nbij->nab", slopes, slopes)
    flat = np.full_like(unit, 1.0 / p)
    fields = np.concatenate([slopes, unit[:, None], flat[:, None]], axis=1)
    products, variance = noise_products(fields.astype(np.float32), errors, model, pixel_m)
    return Registration(
        contrast=np.sqrt(power / nodes),
        noise_variance=np.maximum(variance - products[:, 3, 3] / nodes, 0.0),
        along=np.where(textured, products[:, 2, 2], np.inf),
        shift_loss=np.clip(loss, 0.0, 1.0),
        covariance_px2=_shift_covariance(normal, products[:, :2, :2])
        * math.exp(2.0 * model.spread**2),
        nodes=nodes,
        spread=model.spread,
        slope_noise=products[:, :2, :2] / np.where(textured, power, 1.0)[:, None, None],
    )


def shift_bias(patches: AnyArray, differences: AnyArray) -> Array:
    """Displacement of the match of patches (n, p, p) in images that differ from them by known
    ``differences`` (n, p, p), as by shadows that terrain outside a patch casts into it: (n, 2)
    nodes, columns and rows, to first order; infinite where the patch is not located.

    It is that of the least squares of `registration`: -F^-1 B e, restricted to the shift, for the
    difference e.
    """
    image, e = (np.asarray(a, dtype=np.float64) for a in (patches, differences))
    unit = image - image.mean(axis=(1, 2), keepdims=True)
    power = np.einsum("nij,nij->n", unit, unit)
    unit /= np.sqrt(np.where(power > 0.0, power, 1.0))[:, None, None]
    slopes = np.stack([node_slopes(image, 2), node_slopes(image, 1)], axis=1)
    slopes -= slopes.mean(axis=(2, 3), keepdims=True)
    slopes -= np.einsum("naij,nij->na", slopes, unit)[..., None, None] * unit[:, None]
    xx, yy, xy = (
        np.einsum("nij,nij->n", slopes[:, a], slopes[:, b]) for a, b in ((0, 0), (1, 1), (0, 1))
    )
    x, y = (np.einsum("nij,nij->n", slopes[:, a], e) for a in (0, 1))
    determinant = xx * yy - xy * xy
    good = determinant > 1e-9 * (xx + yy) ** 2
    safe = np.where(good, determinant, 1.0)
    bias = np.stack([xy * y - yy * x, xy * x - xx * y], axis=-1) / safe[:, None]
    return np.where(good[:, None], bias, np.inf)


def node_slopes(patches: Array, axis: int) -> Array:
    """Derivative of patches (n, p, p) along an axis at their nodes: differences of the sixth order
    over seven nodes, of lower order in the three outer rows.

    Central differences over three nodes damp detail near a node's width, and the covariance grows
    with the square or, in smooth noise, the fourth power of that: measured over stated variance of
    the match was 0.78, 0.66 and 0.58 in white noise and noise of 1.5 and 4 nodes' length, and is
    0.96, 0.90 and 0.85 with these (`benchmarks/claims.py simulated`).
    """
    z = np.moveaxis(patches, axis, 0)
    slope = np.gradient(z, axis=0)
    if len(z) > 4:
        slope[2:-2] = (8.0 * (z[3:-1] - z[1:-3]) - (z[4:] - z[:-4])) / 12.0
    if len(z) > 6:
        near, middle, far = z[4:-2] - z[2:-4], z[5:-1] - z[1:-5], z[6:] - z[:-6]
        slope[3:-3] = (45.0 * near - 9.0 * middle + far) / 60.0
    return np.moveaxis(slope, 0, axis)


def _shift_covariance(normal: Array, products: Array) -> Array:
    """F^-1 S F^-1 of 2 x 2 matrices (n, 2, 2); infinite for a singular F."""
    xx, yy, xy = normal[:, 0, 0], normal[:, 1, 1], normal[:, 0, 1]
    determinant = xx * yy - xy * xy
    good = determinant > 1e-9 * (xx + yy) ** 2
    safe = np.where(good, determinant, 1.0)
    inverse = np.stack([yy, -xy, -xy, xx], axis=-1).reshape(-1, 2, 2) / safe[:, None, None]
    covariance = inverse @ products @ inverse
    out = np.zeros_like(covariance)
    out[:, [0, 1], [0, 1]] = np.inf
    out[good] = covariance[good]
    return out


def harris_response(patches: Float32) -> Float32:
    """det M - 0.04 trace(M)^2 of each patch (n, p, p), divided by its mean lit level, over the
    squared number of nodes (Harris and Stephens 1988), (n,); NaN where a node is missing or no node
    is lit.
    """
    level = mean_lit_level(patches)
    good = np.isfinite(level)
    image = np.where(good[:, None, None], patches, 0.0) / np.where(good, level, 1.0)[:, None, None]
    down, across = np.gradient(image, axis=(1, 2))
    xx, yy, xy = (
        np.einsum("nij,nij->n", a, b) for a, b in ((across, across), (down, down), (across, down))
    )
    response = (xx * yy - xy * xy - HARRIS_K * (xx + yy) ** 2) / patches[0].size ** 2
    return np.where(good, response, np.nan).astype(np.float32)


def lit_share(patches: Float32) -> Array:
    """Share of each patch's nodes that are lit (> 0), (n,); missing nodes are not lit."""
    return np.asarray((np.nan_to_num(patches) > 0.0).mean(axis=(1, 2)))


def mean_lit_level(patches: Float32) -> Array:
    """Mean of each patch's lit (> 0) nodes, (n,); NaN where a node is missing or no node is lit."""
    image = np.asarray(patches, dtype=np.float64)
    lit = np.nan_to_num(image) > 0.0
    count = lit.sum(axis=(1, 2))
    level = np.where(lit, image, 0.0).sum(axis=(1, 2)) / np.maximum(count, 1)
    return np.where((count > 0) & np.isfinite(image).all(axis=(1, 2)), level, np.nan)
