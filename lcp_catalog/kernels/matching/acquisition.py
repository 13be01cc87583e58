"""Probabilities that a patch is found at its true place and nowhere else (`landmarks.detection`)."""

import math

import numpy as np
from numba import njit, prange

from ..elementary import exp_lane, normal_lane

_FLAGS = {"contract", "nnan", "ninf", "nsz", "arcp"}
_SIGMAS = 5.5
_AT32, _WEIGHTS32 = (x.astype(np.float32) for x in np.polynomial.legendre.leggauss(32))
_WHOLE = np.linspace(-_SIGMAS, _SIGMAS, _AT32.size, dtype=np.float32)
_WHOLE_WEIGHTS = np.exp(-0.5 * _WHOLE**2) * np.float32(
    2.0 * _SIGMAS / (_AT32.size - 1) / math.sqrt(2.0 * math.pi)
)
"""Trapezoidal rule over a whole normal distribution: its error falls exponentially with the number of
points, because the integrand and all its derivatives vanish at both ends.
"""
_APART = 5.6
"""Joint sigmas between two means beyond which the lower variable is the higher one with a probability
below 1.1e-8; 64 such rivals change a result by less than 1e-6.
"""
_LEAST_VARIANCE = 1e-12


@njit(cache=True, nogil=True, error_model="numpy")
def moments(contrast, rho, noise, along, nodes):
    """Mean and variance of the correlation with a window of a contrast whose noise-free correlation
    is ``rho`` (`landmarks.detection`).
    """
    total = contrast * contrast + noise
    if not total > 0.0:
        return 0.0, _LEAST_VARIANCE
    mean = rho * contrast / math.sqrt(total)
    return mean, max(along / nodes / total * (1.0 - mean * mean), _LEAST_VARIANCE)


@njit(cache=True, nogil=True, error_model="numpy", fastmath=_FLAGS)
def _times_all_below(at, mean, sigma, others, inverse, out):
    """Multiply out (n,) by the probabilities that all rivals are below mean + sigma at; at (n,), means
    (k,), reciprocals of sigmas (k,).
    """
    for j in range(others.size):
        first = np.float32((mean - others[j]) * inverse[j])
        step = np.float32(sigma * inverse[j])
        for k in range(at.size):
            out[k] *= normal_lane(first + step * at[k])


@njit(cache=True, nogil=True, error_model="numpy")
def _above_all(mean, sigma, others, inverse):
    """Probability that a normal variable is above all its rivals (`_times_all_below`)."""
    parts = _WHOLE_WEIGHTS.copy()
    _times_all_below(_WHOLE, mean, sigma, others, inverse, parts)
    return min(np.float64(parts.sum()), 1.0)


@njit(cache=True, nogil=True, error_model="numpy", fastmath=_FLAGS)
def _gauss_legendre(low, at, parts):
    """Write the places of the quadrature of a normal density from ``low`` to 5.5 sigma, and the shares of
    its weights, into at and parts (32,). Return the factor of their sum.
    """
    half = np.float32(0.5 * (_SIGMAS - low))
    for k in range(at.size):
        z = np.float32(low) + half * (np.float32(1.0) + _AT32[k])
        at[k], parts[k] = z, _WEIGHTS32[k] * exp_lane(np.float32(-0.5) * z * z)
    return np.float64(half) / math.sqrt(2.0 * math.pi)


@njit(cache=True, nogil=True, error_model="numpy")
def _above_all_from(mean, sigma, others, inverse, low):
    """Probability that a normal variable is above mean + low sigma and above all its rivals.
    Gauss-Legendre quadrature up to 5.5 sigma.
    """
    at, parts = np.empty(_AT32.size, np.float32), np.empty(_AT32.size, np.float32)
    factor = _gauss_legendre(low, at, parts)
    _times_all_below(at, mean, sigma, others, inverse, parts)
    return np.float64(parts.sum()) * factor


@njit(cache=True, nogil=True, error_model="numpy")
def _in_noise(contrast, rho, noise, along, nodes, rivals, rival_contrast, others, inverse):
    """Mean and sigma of a patch's correlation, and the number of its rivals (NaN: none) that are not
    certainly below it; their means go into others, the reciprocals of their sigmas into inverse.
    """
    mean, variance = moments(contrast, rho, noise, along, nodes)
    near = 0
    for j in range(rivals.size):
        if rivals[j] > -2.0:
            other, spread = moments(rival_contrast[j], rivals[j], noise, along, nodes)
            sigma = math.sqrt(spread)
            if mean - other < _APART * math.sqrt(variance + sigma * sigma):
                others[near], inverse[near] = other, 1.0 / sigma
                near += 1
    return mean, math.sqrt(variance), near


@njit(cache=True, nogil=True, error_model="numpy")
def _highest(mean, sigma, others, inverse, least):
    """Three probabilities: that a normal variable is above ``least`` and above all its independent
    rivals; that it is above ``least``; that it is above all its rivals: NaN if the first does not
    need it.
    """
    low = (least - mean) / sigma
    above = 0.5 * math.erfc(low * math.sqrt(0.5))
    if others.size == 0:
        return above, above, 1.0
    if low <= -_SIGMAS:
        whole = _above_all(mean, sigma, others, inverse)
        return whole, above, whole
    if low >= _SIGMAS:
        return 0.0, above, math.nan
    return min(_above_all_from(mean, sigma, others, inverse, low), above), above, math.nan


@njit(cache=True, nogil=True, error_model="numpy", parallel=True)
def acquisition(
    contrast, noise, along, rho, nodes, rivals, rival_contrast, factors, weights, least,
    third_from, out,
):  # fmt: skip
    """Write the three probabilities of `_highest` for n patches into out (n, 3), as means over the
    noise of places.

    contrast, noise, along, rho (n,): the patch's contrast, the variance of the noise about its mean,
    V, and the noise-free correlation at the true place. rivals (n, k) noise-free correlations and
    contrasts of other places, NaN where there are fewer. factors, weights (m,): of the noise's sigma
    at places. The third may be NaN where the first is below ``third_from``. All 0 for a patch without
    contrast or with an infinite V.
    """
    for i in prange(contrast.size):
        out[i] = 0.0
        if not contrast[i] > 0.0 or not math.isfinite(along[i]) or not math.isfinite(rho[i]):
            continue
        others, inverse = np.empty(rivals.shape[1]), np.empty(rivals.shape[1])
        third = np.empty(factors.size)
        for again in range(2):
            if again and not out[i, 0] >= third_from:
                break
            for m in range(factors.size):
                if again and not math.isnan(third[m]):
                    continue
                scale = factors[m] * factors[m]
                mean, sigma, near = _in_noise(
                    contrast[i], rho[i], scale * noise[i], scale * along[i], nodes, rivals[i],
                    rival_contrast[i], others, inverse,
                )  # fmt: skip
                if again:
                    third[m] = _above_all(mean, sigma, others[:near], inverse[:near])
                else:
                    found, above, third[m] = _highest(
                        mean, sigma, others[:near], inverse[:near], least
                    )
                    out[i, 0] += weights[m] * found
                    out[i, 1] += weights[m] * above
        for m in range(factors.size):
            out[i, 2] += weights[m] * third[m]


@njit(cache=True, nogil=True, error_model="numpy", parallel=True)
def on_top(contrast, noise, along, rho, nodes, slope_noise, offsets, near, near_contrast, out):
    """Write the probability that the correlation at the true place is above that at the strongest
    of the places around it into out (n,).

    slope_noise (n, 2, 2), offsets (k, 2), near and near_contrast (n, k): as in
    `landmarks.detection.top_probability`; the others as in `acquisition`.
    """
    for i in prange(contrast.size):
        mean, variance = moments(contrast[i], rho[i], noise[i], along[i], nodes)
        power = nodes * (contrast[i] * contrast[i] + noise[i])
        least = math.inf
        for k in range(offsets.shape[0]):
            if not math.isfinite(near[i, k]):  # beyond the image's border
                continue
            there, spread = moments(near_contrast[i, k], near[i, k], noise[i], along[i], nodes)
            x, y = offsets[k, 0], offsets[k, 1]
            apart = (
                x * x * slope_noise[i, 0, 0]
                + x * y * (slope_noise[i, 0, 1] + slope_noise[i, 1, 0])
                + y * y * slope_noise[i, 1, 1]
            )
            apart = min(apart / power, variance + spread)
            margin = (mean - there) / math.sqrt(max(apart, _LEAST_VARIANCE))
            if math.isfinite(margin) and margin < least:
                least = margin
        out[i] = 0.5 * math.erfc(-least * math.sqrt(0.5))


@njit(cache=True, nogil=True, error_model="numpy", parallel=True)
def least_rivals(contrast, noise, along, rho, nodes, factors, clear, out):
    """Write the noise-free correlation below which another place does not matter into out (n,): in
    noise it is ``clear`` standard deviations below that at the true place, for windows of half the
    patch's contrast, of the same, and of ten times as much; the others as in `acquisition`.
    """
    for i in prange(contrast.size):
        out[i] = math.inf
        for factor in factors:
            scale = factor * factor
            mean, variance = moments(contrast[i], rho[i], scale * noise[i], scale * along[i], nodes)
            for share in (0.5, 1.0, 10.0):
                theirs = share * contrast[i]
                total = theirs * theirs + scale * noise[i]
                spread = variance + scale * along[i] / nodes / total
                least = (mean - clear * math.sqrt(spread)) * math.sqrt(total) / theirs
                out[i] = min(out[i], least)
