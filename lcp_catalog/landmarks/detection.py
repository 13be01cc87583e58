"""Probability that a search finds a patch at its true place and nowhere else, under a model of the
differences between image and render.

Let t be the centred patch of unit norm with N pixels, c its contrast (standard deviation), n the noise
of the image (`error_model`), V = E[(t . n)^2], s^2 the variance of the noise about its mean over the
patch. The correlation at the true place is nearly normal with

    mean e_0 = rho_0 c / sqrt(c^2 + s^2),   variance v_0 = (V / N) (1 - e_0^2 (1 + u_0 / 2)) / (c^2 + s^2)

with u_0 = s^2 / (c^2 + s^2). (By the delta method the factor is 1 - e_0^2 (1 + (1 - k) u_0), k = S s^2 / (2 V), S the sum of the
squared autocorrelation of the noise over all lags; k = 1/2 for white noise, and for noise with the patch's spectrum.)

At every other maximum k of the correlation of the patch with the render around it, with the
noise-free correlation rho_k and the contrast c_k of the window there, e_k = rho_k c_k / sqrt(c_k^2 +
s^2) and v_k accordingly. The patch is found if the correlation at the true place is above that at
all others (Johnson's acquisition probability, with the variances of correlated noise: Ding 1992) and
above the least correlation L that a match must have:

    P = integral from L of phi((x - e_0) / sqrt(v_0)) / sqrt(v_0) prod_k Phi((x - e_k) / sqrt(v_k)) dx

A search also refuses a match that is ambiguous (`mistake_probability` above `AMBIGUOUS`), so the true place must exceed the
others clearly: for P each e_k is z sqrt(v_0 + v_k) higher, z = max(0, Phi^-1(1 - q)), q = A pi / (A pi + (1 - A) (1 - pi)),
with A = `AMBIGUOUS` and the search's prior pi. A claim states a search without a prior, pi = 1/2; a search that takes a claim
above 0.8 as its prior refuses nothing that P does not, so it finds such a point at least as often.

Noise also raises the top of a peak, the more the lower and flatter it is. With the score falling by d^T A d / 2 around a place and
a gradient of the noise there with the covariance N, g^2 = tr(N) / 2, the top would be higher by G = tr(A^-1 N) / 2 = tr((Sigma
N)^(1/2)) / 2 in the mean if the noise had no other slope farther off (Sigma = A^-1 N A^-1: the covariance of a match). The
highest pixel rises by 3 g exp(-0.7 t g / G), where a peak t times as high as the true one is as much flatter (`REACH_PX`,
`SHARPNESS`, fitted to draws). e_k grows by how much more that is than for t = 1, t = e_k / e_0.

Noise can also move the top of the true peak itself off by more than 2.5 nodes (`top_probability`). It is the same noise, so that
the patch is found with the lesser of the two probabilities, times that of the fit (`settling_probability`).

If the noise differs from place to place (`ErrorModel.spread`), P is the mean over its distribution.

rho_0 is below 1 where the patch, rendered alone, differs from the patch among the terrain around it
(shadows that the terrain casts on it), and by the place's distance from a whole pixel.
"""

from __future__ import annotations

import math
from functools import cache
from statistics import NormalDist

import numpy as np

from ..arrays import AnyArray, Array, Float32, Mask
from ..kernels.matching import acquisition as kernel
from .localization import Registration

LEAST_CORRELATION = 0.3
"""Least correlation of a match."""

AMBIGUOUS = 0.2
"""Greatest probability of a mistake (`mistake_probability`) of a match."""

SEEN = 0.2
"""Joint sigmas of a search, over those of P: it takes noise to be correlated over neighbours only (`mistake_probability`). In
frames with a known truth it sees 0.36 to 0.76 of them; the claims of usable points are best with 0.2."""

_FIRM_PX, _LOST = 0.3, 0.3
"""Broad peaks lose fits. Of 3568 searches whose highest pixel was right, under Suns of 5 to 70 deg, at 1 sigma of
0.45, 0.55, 0.7, 1 and 1.5 pixels 0.04, 0.08, 0.12, 0.21 and 0.37 were lost, and 0.01 below 0.3 pixels; below and above
45 deg alike (`benchmarks.evidence frames`)."""

_PROBITS_OF_SEARCH = 0.57
"""Probits of the places that are the highest and refused, as ambiguous or by the fit: 0.48 to 0.77 over claims of 0.1 to
0.9 in the same searches."""

_CLEAR = 4.5
SPREAD_NODES = 5
"""Nodes of the quadrature over places whose noise differs."""

_LEAST_VARIANCE = 1e-12


def detection_probability(
    match: Registration,
    rivals: Array,
    rival_contrast: Array,
    self_correlation: Array | float = 1.0,
    least_correlation: float = LEAST_CORRELATION,
    third_from: float = 0.0,
    clear_by: float = 0.0,
    spread_nodes: int = SPREAD_NODES,
) -> tuple[Array, Array, Array]:
    """Three probabilities for each of n patches, (n,): that it is found at its true place and
    nowhere else (P); that its correlation there is at least ``least_correlation``; and that this is
    the highest correlation of all, whatever it is.

    ``rivals`` (n, k): noise-free correlation of the other maxima, NaN where there are fewer;
    ``rival_contrast`` (n, k): the contrast of the windows there, in the unit of the patch's;
    ``self_correlation`` (n,): noise-free correlation at the true place. For P the true place must exceed each other by
    ``clear_by`` joint sigmas in the mean (`clearance`). The third probability may be NaN
    where the first is below ``third_from``, which takes less time. ``spread_nodes``: of the mean over places.
    """
    rho = np.asarray(self_correlation, dtype=np.float64) * (1.0 - match.shift_loss)
    nodes, weights = _quadrature(spread_nodes if match.spread > 0.0 else 1)
    out = np.empty((len(match.contrast), 3))
    kernel.acquisition(
        match.contrast, match.noise_variance, match.along / match.pixels, rho, 1, *_slopes(match),
        np.asarray(rivals, np.float64), np.asarray(rival_contrast, np.float64),
        np.exp(match.spread * nodes), weights, least_correlation, clear_by, third_from, out,
    )  # fmt: skip
    found, there, highest = out.T
    return found, there, highest


def _slopes(match: Registration) -> tuple[Array, Array]:
    """Covariances (n, 2, 2) of the match at a place with typical noise, and of the slopes of the noise's product with the patch."""
    typical = match.covariance_px2 / math.exp(2.0 * match.spread**2)
    return typical, match.slope_noise / match.pixels[:, None, None]


@cache
def _quadrature(count: int) -> tuple[Array, Array]:
    """Nodes and weights (count,) of a mean over a standard normal variable; of one: its middle."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(count)
    return nodes, weights / weights.sum()


def clearance(prior: float = 0.5) -> float:
    """z, joint sigmas by which the best match must exceed another to be no ambiguous one, for the probability
    ``prior`` before the search that it is the true place.
    """
    right = AMBIGUOUS * prior
    mistake = right / (right + (1.0 - AMBIGUOUS) * (1.0 - prior))
    return max(0.0, NormalDist().inv_cdf(1.0 - mistake))


def settling_probability(match: Registration) -> Array:
    """Probability (n,) that the fit of the place to a fraction of a pixel ends near the true peak's highest pixel, and that
    the backward search confirms it: 1 - `_LOST` (sigma - `_FIRM_PX`) for 1 sigma of the match along the major axis, in pixels.
    """
    covariance = match.covariance_px2
    if not np.isfinite(covariance).all():
        covariance = np.nan_to_num(covariance, posinf=1e12)
    with np.errstate(invalid="ignore"):
        sigma = np.sqrt(np.linalg.eigvalsh(covariance)[:, 1])
    return np.asarray(np.clip(1.0 - _LOST * (sigma - _FIRM_PX), 0.0, 1.0))


def highest_probability(found: Array) -> Array:
    """Probability that the true place has the highest correlation, whatever the search makes of it, where that it is found
    is claimed with ``found``, between 0 and 1: `_PROBITS_OF_SEARCH` more.
    """
    return shifted(found, _PROBITS_OF_SEARCH)


def shifted(probability: Array, probits: float) -> Array:
    """Probabilities (n,) moved by so many probits; 0 and 1 stay."""
    from scipy.special import ndtr, ndtri

    return np.asarray(ndtr(ndtri(np.asarray(probability, np.float64)) + probits))


def least_rival(
    match: Registration,
    self_correlation: Array | float = 1.0,
    clear_by: float = 0.0,
    spread_nodes: int = SPREAD_NODES,
) -> Array:
    """Noise-free correlation (n,) below which another place does not change the detection probability
    of a patch: its correlation in noise is more than `_CLEAR` standard deviations and ``clear_by`` below that at the
    true place, for windows of half the patch's contrast up to any contrast.
    """
    rho = np.asarray(self_correlation, dtype=np.float64) * (1.0 - match.shift_loss)
    nodes, _ = _quadrature(spread_nodes if match.spread > 0.0 else 1)
    out = np.empty(len(match.contrast))
    kernel.least_rivals(
        match.contrast, match.noise_variance, match.along / match.pixels, rho, 1, *_slopes(match),
        np.exp(match.spread * nodes), _CLEAR + clear_by, out,
    )  # fmt: skip
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
    independent ones. Places in other directions are left out: in the mean over ten peaks the result is up to
    0.1 too high where it is about 0.7, and up to 0.03 too low where it is above 0.9.
    """
    rho = np.broadcast_to(np.asarray(self_correlation, np.float64), match.contrast.shape)
    out = np.empty(len(match.contrast))
    kernel.on_top(
        match.contrast, match.noise_variance, match.along / match.pixels, rho, 1,
        match.slope_noise / match.pixels[:, None, None], np.asarray(offsets, np.float64),
        np.asarray(around, np.float64), np.asarray(contrast, np.float64), out,
    )  # fmt: skip
    return out


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
    v_1 with k = 1 (see the module). ``prior`` (n,): probability that the true place has the highest
    correlation, before the search (Bayes' rule). templates, masks (n, rows, cols).
    """
    from scipy.special import ndtr

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
