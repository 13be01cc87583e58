"""Statistics of a match and its probabilities in plain NumPy, in double precision: the formulas before they were compiled.

Nothing here uses the library; error models and registrations are read by their fields' names. Arrays are stacks of patches (n, p,
p), columns are x. Covariances of the noise are matrices between all rows and between all columns, not principal components or
values by distance.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

Array = NDArray[np.float64]


class Statistics(NamedTuple):
    """As in `lcp_catalog.landmarks.localization.Registration`."""

    contrast: Array
    noise_variance: Array
    along: Array
    shift_loss: Array
    covariance_px2: Array
    slope_noise: Array
    bias: Array
    own: Array


def node_slopes(patches: Array, axis: int) -> Array:
    """Derivatives along an axis: differences over seven nodes, over five, three and two near the edge."""
    z = np.moveaxis(patches, axis, 0)
    slope = np.gradient(z, axis=0)
    if len(z) > 4:
        slope[2:-2] = (8.0 * (z[3:-1] - z[1:-3]) - (z[4:] - z[:-4])) / 12.0
    if len(z) > 6:
        near, middle, far = z[4:-2] - z[2:-4], z[5:-1] - z[1:-5], z[6:] - z[:-6]
        slope[3:-3] = (45.0 * near - 9.0 * middle + far) / 60.0
    return np.moveaxis(slope, 0, axis)


def fields_of(patches: Array) -> tuple[Array, Array]:
    """Slopes along columns and rows without their parts along a constant and the patch; the centred patch of unit norm; a
    constant of unit norm: (n, 4, p, p). And the sum of the squared slopes before the projection, (n,).
    """
    p = patches.shape[1]
    unit = patches - patches.mean(axis=(1, 2), keepdims=True)
    power = np.einsum("nij,nij->n", unit, unit)
    unit = unit / np.sqrt(np.where(power > 1e-12 * p * p, power, 1.0))[:, None, None]
    slopes = np.stack([node_slopes(patches, 2), node_slopes(patches, 1)], axis=1)
    square = np.einsum("naij,naij->n", slopes, slopes)
    slopes -= slopes.mean(axis=(2, 3), keepdims=True)
    slopes -= np.einsum("naij,nij->na", slopes, unit)[..., None, None] * unit[:, None]
    flat = np.full_like(unit, 1.0 / p)
    return np.concatenate([slopes, unit[:, None], flat[:, None]], axis=1), square


def noise_products(
    fields: Array, sources: tuple[Array, Array, Array], model: Any, pixel_m: float
) -> tuple[Array, Array]:
    """Covariances (n, m, m) of the noise's products with fields (n, m, p, p), and the mean variance of a node (n,).

    sources: radiance and its derivatives by the slopes along the columns and the rows.
    """
    p = fields.shape[-1]
    level, east, south = (np.asarray(a, np.float64)[:, None] for a in sources)
    lag = (np.arange(p)[:, None] - np.arange(p)) * pixel_m
    value, first, second = (
        model.height_sigma_m * a for a in _gaussian(lag, model.height_length_m, pixel_m)
    )
    bright = model.albedo_sigma * _gaussian(lag, model.albedo_length_m, pixel_m)[0]

    def apply(rows: Array, cols: Array, some: Array) -> Array:
        return rows @ some @ cols.T

    by_east, by_south = fields * east, fields * south
    noise = model.sensor_noise**2 * fields
    noise = noise + east * (apply(value, second, by_east) + apply(-first, first, by_south))
    noise += south * (apply(second, value, by_south) + apply(-first, first, by_east))
    noise += level * apply(bright, bright, fields * level)
    products = np.einsum("naij,nbij->nab", fields, noise)
    slope2, bright2 = value[0, 0] * second[0, 0], bright[0, 0] ** 2
    variance = model.sensor_noise**2 + np.mean(
        slope2 * (east**2 + south**2) + bright2 * level**2, axis=(1, 2, 3)
    )
    return 0.5 * (products + products.transpose(0, 2, 1)), variance


def _gaussian(lag: Array, length: float, pixel: float) -> tuple[Array, Array, Array]:
    """exp(-x^2 / 2 l^2) at lags x averaged over pixels, minus its first derivative and minus its second."""
    wide2 = length**2 + pixel**2 / 6.0
    value = length / math.sqrt(wide2) * np.exp(-0.5 * lag**2 / wide2)
    return value, lag / wide2 * value, (1.0 - lag**2 / wide2) / wide2 * value


def statistics(
    patches: NDArray[Any], errors: Any, model: Any, pixel_m: float, level: NDArray[Any] | float
) -> Statistics:
    """Of patches, and of the images at their places (``errors.level``)."""
    by = np.broadcast_to(np.asarray(level, np.float64), len(patches))[:, None, None]
    patches, image, east, south = (
        np.asarray(a, np.float64) / by for a in (patches, errors.level, errors.east, errors.south)
    )
    nodes = patches[0].size
    fields, square = fields_of(patches)
    power = nodes * patches.var(axis=(1, 2))
    textured = power > 1e-12 * nodes
    safe = np.where(textured, power, 1.0)
    normal = np.einsum("naij,nbij->nab", fields[:, :2], fields[:, :2])
    products, variance = noise_products(fields, (image, east, south), model, pixel_m)
    wide = math.exp(2.0 * model.spread**2)
    return Statistics(
        contrast=np.sqrt(power / nodes),
        noise_variance=np.maximum(variance - products[:, 3, 3] / nodes, 0.0),
        along=np.where(textured, products[:, 2, 2], np.inf),
        shift_loss=np.clip(square / safe / 24.0, 0.0, 1.0),
        covariance_px2=wide * _shift_covariance(normal, products[:, :2, :2]),
        slope_noise=products[:, :2, :2] / safe[:, None, None],
        bias=shift_bias(fields[:, :2], normal, image - patches),
        own=_correlations(patches, image),
    )


def shift_bias(slopes: Array, normal: Array, differences: Array) -> Array:
    """-F^-1 B e for differences e; infinite for a singular F."""
    products = np.einsum("naij,nij->na", slopes, differences)
    inverse = _inverse(normal)
    found = -np.einsum("nab,nb->na", np.nan_to_num(inverse), products)
    return np.where(np.isnan(inverse[:, 0]), np.inf, found)


def _inverse(normal: Array) -> Array:
    """Of 2 x 2 matrices; NaN where they are singular."""
    xx, yy, xy = normal[:, 0, 0], normal[:, 1, 1], normal[:, 0, 1]
    determinant = xx * yy - xy * xy
    good = determinant > 1e-9 * (xx + yy) ** 2
    safe = np.where(good, determinant, np.nan)
    return np.stack([yy, -xy, -xy, xx], axis=-1).reshape(-1, 2, 2) / safe[:, None, None]


def _shift_covariance(normal: Array, products: Array) -> Array:
    """F^-1 S F^-1; infinite without correlation for a singular F."""
    inverse = _inverse(normal)
    return np.where(np.isnan(inverse), np.diag([np.inf, np.inf]), inverse @ products @ inverse)


def _correlations(one: Array, other: Array) -> Array:
    """Pearson's coefficient of each pair; 0 for constant ones."""
    a, b = (x - x.mean(axis=(1, 2), keepdims=True) for x in (one, other))
    power = (a * a).sum(axis=(1, 2)) * (b * b).sum(axis=(1, 2))
    product = (a * b).sum(axis=(1, 2))
    return np.where(power > 0.0, product / np.sqrt(np.where(power > 0.0, power, 1.0)), 0.0)


def correlation_moments(
    contrast: Array, rho: Array, noise_variance: Array, along: Array, nodes: Array
) -> tuple[Array, Array]:
    """Mean and variance of the correlation with a window of a contrast and a noise-free correlation; arrays that broadcast."""
    total = np.square(contrast) + noise_variance
    safe = np.where(total > 0.0, total, 1.0)
    mean = np.where(total > 0.0, rho * contrast / np.sqrt(safe), 0.0)
    return mean, np.maximum(
        along / nodes / safe * (1.0 - mean**2 * (1.0 + 0.5 * noise_variance / safe)), 1e-12
    )


def top_probability(
    match: Any, offsets: Array, around: Array, contrast: Array, own: Array
) -> Array:
    """That the correlation at the true place is above that at the strongest of the places around it, (n,)."""
    noise, along = match.noise_variance[:, None], match.along[:, None]
    mean, variance = correlation_moments(
        match.contrast[:, None], own[:, None], noise, along, match.pixels[:, None]
    )
    there, spread = correlation_moments(contrast, around, noise, along, match.pixels[:, None])
    power = match.pixels * (match.contrast**2 + match.noise_variance)
    apart = np.einsum("ka,nab,kb->nk", offsets, match.slope_noise, offsets) / power[:, None]
    apart = np.maximum(np.minimum(apart, variance + spread), 1e-12)
    return np.asarray(ndtr(np.nanmin((mean - there) / np.sqrt(apart), axis=1)))


def light_of(patches: NDArray[np.float32]) -> tuple[Array, Array]:
    """Share of lit nodes (> 0) and their mean, NaN where a node is missing or none is lit, (n,) each."""
    image = patches.astype(np.float64)
    lit = np.nan_to_num(image) > 0.0
    count = lit.sum(axis=(1, 2))
    level = np.where(lit, image, 0.0).sum(axis=(1, 2)) / np.maximum(count, 1)
    complete = np.isfinite(image).all(axis=(1, 2))
    return lit.mean(axis=(1, 2)), np.where((count > 0) & complete, level, np.nan)


def harris_response(patches: NDArray[np.float32]) -> Array:
    """det M - 0.04 trace(M)^2 of patches divided by their lit level, over the squared number of nodes."""
    level = light_of(patches)[1]
    down, across = np.gradient(patches / level[:, None, None], axis=(1, 2))
    xx, yy, xy = (
        np.einsum("nij,nij->n", a, b) for a, b in ((across, across), (down, down), (across, down))
    )
    return (xx * yy - xy * xy - 0.04 * (xx + yy) ** 2) / patches[0].size ** 2
