"""Probability that a search finds a patch at its true place and nowhere else, under a model of the
differences between image and render.

Let t be the centred patch of unit norm with N nodes, c its contrast (standard deviation), n the noise
of the image (`error_model`), V = E[(t . n)^2], s^2 the variance of the noise about its mean over the
patch. The correlation at the true place is nearly normal with

    mean e_0 = rho_0 c / sqrt(c^2 + s^2),   variance v_0 = (V / N) (1 - e_0^2) / (c^2 + s^2)

At every other maximum k of the correlation of the patch with the render around it, with the
noise-free correlation rho_k and the contrast c_k of the window there, e_k = rho_k c_k / sqrt(c_k^2 +
s^2) and v_k accordingly. The patch is found if the correlation at the true place is above that at
all others (Johnson's acquisition probability, with the variances of correlated noise: Ding 1992) and
above the least correlation L that a match must have:

    P = integral from L of phi((x - e_0) / sqrt(v_0)) / sqrt(v_0) prod_k Phi((x - e_k) / sqrt(v_k)) dx

P is multiplied by the probability that noise does not move the top of the true peak itself off by
more than 2 nodes (`top_probability`).

If the noise differs from place to place (`ErrorModel.spread`), P is the mean over its distribution.

rho_0 is below 1 where the patch, rendered alone, differs from the patch among the terrain around it
(shadows that the terrain casts on it), and by the place's distance from a whole pixel.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.special import ndtr

from ..arrays import AnyArray, Array, Float32, Mask
from ..kernels.matching.acquisition import acquisition
from .localization import Registration

LEAST_CORRELATION = 0.3
"""Least correlation of a match."""

_NODES, _NODE_WEIGHTS = np.polynomial.hermite_e.hermegauss(5)
_NODE_WEIGHTS = _NODE_WEIGHTS / _NODE_WEIGHTS.sum()
_LEAST_VARIANCE = 1e-12


def correlation_moments(
    contrast: Array, rho: Array, noise_variance: Array, along: Array, nodes: int
) -> tuple[Array, Array]:
    """Mean and variance of the correlation with a window of a contrast whose noise-free correlation
    is ``rho``; arrays that broadcast. Contrast and noise in the same unit.
    """
    total = np.square(contrast) + noise_variance
    safe = np.where(total > 0.0, total, 1.0)
    mean = np.where(total > 0.0, rho * contrast / np.sqrt(safe), 0.0)
    variance = along / nodes / safe * (1.0 - mean**2)
    return mean, np.maximum(variance, _LEAST_VARIANCE)


def detection_probability(
    match: Registration,
    rivals: Array,
    rival_contrast: Array,
    self_correlation: Array | float = 1.0,
    least_correlation: float = LEAST_CORRELATION,
) -> tuple[Array, Array, Array]:
    """Three probabilities for each of n patches, (n,): that it is found at its true place and
    nowhere else (P); that its correlation there is at least ``least_correlation``; and that this is
    the highest correlation of all, whatever it is.

    ``rivals`` (n, k): noise-free correlation of the other maxima, NaN where there are fewer;
    ``rival_contrast`` (n, k): the contrast of the windows there, in the unit of the patch's;
    ``self_correlation`` (n,): noise-free correlation at the true place.
    """
    rho = np.asarray(self_correlation, dtype=np.float64) * (1.0 - match.shift_loss)
    some = np.isfinite(rivals).any(axis=0)
    rivals, rival_contrast = rivals[:, some], rival_contrast[:, some]
    nodes, weights = (_NODES, _NODE_WEIGHTS) if match.spread > 0.0 else (np.zeros(1), np.ones(1))
    parts = [
        _at_noise(match, rho, rivals, rival_contrast, least_correlation, math.exp(match.spread * x))
        for x in nodes
    ]
    found, there, highest = np.tensordot(weights, np.array(parts), axes=1).T
    return found, there, highest


def _at_noise(
    match: Registration, rho: Array, rivals: Array, contrast: Array, least: float, factor: float
) -> Array:
    """The three probabilities (n, 3) at places whose noise is a factor times the typical one."""
    noise, along = match.noise_variance * factor**2, match.along * factor**2
    mean, variance = correlation_moments(match.contrast, rho, noise, along, match.nodes)
    bad = ~(match.contrast > 0.0) | ~np.isfinite(variance) | ~np.isfinite(mean)
    absent = np.isnan(rivals)
    theirs, spread = correlation_moments(
        np.where(absent, 0.0, contrast),
        np.where(absent, 0.0, rivals),
        noise[:, None],
        np.where(bad, 1.0, along)[:, None],
        match.nodes,
    )
    out = np.empty((len(mean), 3))
    acquisition(
        np.where(bad, 0.0, mean),
        np.sqrt(np.where(bad, 1.0, variance)),
        np.where(absent, np.nan, theirs),
        np.sqrt(spread),
        least,
        out,
    )
    out[bad] = 0.0
    return out


def top_probability(
    match: Registration,
    offsets: AnyArray,
    around: Array,
    contrast: Array,
    self_correlation: Array | float = 1.0,
) -> Array:
    """Probability that the correlation at the true place is above that at the strongest of the
    places around it, (n,): noise moves the top of a broad peak, towards windows of higher contrast.

    ``offsets`` (k, 2): distances of the places, columns and rows; ``around``, ``contrast`` (n, k):
    noise-free correlation and contrast there, NaN outside the image. The two windows share most of
    their noise. The variance of the difference of their correlations is, to first order, that of
    the noise's product with the slope of the patch along the distance, and at most that of two
    independent ones. Places in other directions are left out: the result is up to 0.2 too high where
    it is about 1/2, and wrong by up to 0.06 where it is above 0.9, mostly too low.
    """
    mean, variance = correlation_moments(
        match.contrast,
        np.asarray(self_correlation, dtype=np.float64),
        match.noise_variance,
        match.along,
        match.nodes,
    )
    there, spread = correlation_moments(
        np.nan_to_num(contrast),
        np.nan_to_num(around),
        match.noise_variance[:, None],
        match.along[:, None],
        match.nodes,
    )
    power = match.nodes * (np.square(match.contrast) + match.noise_variance)
    steps, slope_noise = np.asarray(offsets, np.float64), np.asarray(match.slope_noise, np.float64)
    apart = np.einsum("ka,nab,kb->nk", steps, slope_noise, steps)
    with np.errstate(invalid="ignore", divide="ignore"):
        apart = np.minimum(apart / power[:, None], variance[:, None] + spread)
        margin = (mean[:, None] - there) / np.sqrt(np.maximum(apart, _LEAST_VARIANCE))
    margin = np.where(np.isfinite(around) & np.isfinite(margin), margin, np.inf)
    return np.asarray(ndtr(margin.min(axis=1, initial=np.inf)))


def mistake_probability(
    correlation: Array,
    second: Array,
    templates: Float32,
    masks: Mask,
    neighbours: Array,
    prior: Array | float = 0.5,
) -> Array:
    """Probability that the best match of each of n templates is not the true place, (n,), from the
    two highest correlations that a search found.

    The image's noise is what the best match leaves unexplained: its share of the window's variance
    is 1 - r^2. With the correlation ``neighbours`` (n,) of neighbouring residuals a Gaussian
    autocorrelation has the value neighbours^(d^2) at d pixels; V / s^2 follows from it and the
    template's autocorrelation, and the difference of the two correlations has the variance v_0 +
    v_1 of `correlation_moments`. ``prior`` (n,): probability that the true place has the highest
    correlation, before the search (Bayes' rule). templates, masks (n, rows, cols).
    """
    best, other = (np.clip(np.asarray(r, np.float64), -1.0, 1.0) for r in (correlation, second))
    count = np.maximum(masks.sum(axis=(1, 2)), 1)
    gain = _noise_gain(templates, masks, np.clip(np.nan_to_num(neighbours), 0.0, 0.99))
    left = np.maximum(1.0 - best**2, 1e-6)
    variance = gain / count * left * ((1.0 - best**2) + (1.0 - other**2))
    chance = ndtr((other - best) / np.sqrt(np.maximum(variance, _LEAST_VARIANCE)))
    before = np.clip(np.asarray(prior, np.float64), 0.01, 0.99)
    wrong = chance * (1.0 - before)
    return np.asarray(wrong / (wrong + (1.0 - chance) * before))


def _noise_gain(templates: Float32, masks: Mask, neighbours: Array) -> Array:
    """V / s^2 of templates for noise with the autocorrelation neighbours^(d^2), (n,)."""
    count = np.maximum(masks.sum(axis=(1, 2)), 1)[:, None, None]
    values = np.where(masks, templates, 0.0).astype(np.float64)
    values = np.where(masks, values - values.sum(axis=(1, 2), keepdims=True) / count, 0.0)
    rows, cols = values.shape[1:]
    spectrum = np.abs(np.fft.rfft2(values, (2 * rows, 2 * cols), axes=(1, 2))) ** 2
    alike = np.fft.irfft2(spectrum, (2 * rows, 2 * cols), axes=(1, 2))
    down, across = (np.minimum(np.arange(2 * n), 2 * n - np.arange(2 * n)) for n in (rows, cols))
    lag2 = down[:, None] ** 2 + across[None] ** 2
    power = alike[:, 0, 0]
    total = np.array(
        [
            (a * np.where(lag2 > 0, r**lag2, 1.0)).sum()
            for a, r in zip(alike, neighbours, strict=True)
        ]
    )
    return np.where(power > 0.0, np.maximum(total / np.where(power > 0.0, power, 1.0), 1e-3), 1.0)
