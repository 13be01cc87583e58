"""Probabilities that a patch is found at its true place and nowhere else (`landmarks.detection`)."""

import math

import numpy as np
from numba import prange

from ..cache import njit
from ..completion import all_done
from ..elementary import exp_lane, normal
from ..vectors import LANES, aligned, larger, load, splat, splat_at, total

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
_SURE = np.float32(6.0)
"""A normal variable is above this with a probability of 1e-9, which is left out."""
_LEAST_VARIANCE = 1e-12
_SMOOTHER = 0.5
"""1 - k for the varying power of the noise in a window (`landmarks.detection`): k is 1/2 if the noise is as rough as the patch."""
REACH_PX, SHARPNESS = 3.0, 0.7
"""By how many pixels' slope of the noise the top of a flat peak rises, and how fast that falls with a peak's curvature. Fitted to
290 peaks of two grounds (correlated over 2.5 and 6 nodes), each in 60 draws of noise; off by 0.015 of a correlation (rms) on 599
of two others (1.7 and 4 nodes), where peaks lower than the true one rise 0.034 more than it in the mean (7178760c, 2026-11-30).
"""
_PARTS = 8
"""Parts of the patches, for threads; those of a part share work arrays."""


@njit(nogil=True, error_model="numpy")
def moments(contrast, rho, noise, along, nodes):
    """Mean and variance of the correlation with a window of a contrast whose noise-free correlation
    is ``rho`` (`landmarks.detection`).
    """
    total = contrast * contrast + noise
    if not total > 0.0:
        return 0.0, _LEAST_VARIANCE
    mean = rho * contrast / math.sqrt(total)
    left = 1.0 - mean * mean * (1.0 + _SMOOTHER * noise / total)
    return mean, max(along / nodes / total * left, _LEAST_VARIANCE)


@njit(nogil=True, error_model="numpy")
def _integral(at, weights, firsts, steps, count):
    """Sum of weights (n,) times the probabilities that all of ``count`` rivals are below a place at
    (n,) rising, n a multiple of `LANES`; the place is first + step at in sigmas from a rival's mean.
    Products stay above 1e-38: with smaller numbers some processors take a hundred times as long.
    """
    lowest, sums = splat(np.float32(1e-30)), splat(np.float32(0.0))
    for k in range(0, at.size, LANES):
        place, part = load(at, k), load(weights, k)
        for j in range(count):
            if firsts[j] + steps[j] * at[k] < _SURE:
                below = normal(splat_at(firsts, j) + splat_at(steps, j) * place)
                part = larger(lowest, part * below)
        sums = sums + part
    return np.float64(total(sums))


@njit(nogil=True, error_model="numpy", fastmath=_FLAGS)
def _gauss_legendre(low, at, weights):
    """Write the places of the quadrature of a normal density from ``low`` to 5.5 sigma, and the shares of
    its weights, into at and weights (32,). Return the factor of their sum.
    """
    half = np.float32(0.5 * (_SIGMAS - low))
    for k in range(at.size):
        z = np.float32(low) + half * (np.float32(1.0) + _AT32[k])
        at[k], weights[k] = z, _WEIGHTS32[k] * exp_lane(np.float32(-0.5) * z * z)
    return np.float64(half) / math.sqrt(2.0 * math.pi)


@njit(nogil=True, error_model="numpy")
def slope_of_noise(covariance, slope_noise):
    """g, the standard deviation of the slope of the noise's product with a patch along an axis, per pixel; and g / G, 0 where the
    patch is not located, in which noise raises the top of the true peak by G (`landmarks.detection`). covariance (2, 2): of the
    match; slope_noise (2, 2): of the slope of that product along columns and rows.
    """
    xx, xy, yy = covariance[0, 0], covariance[0, 1], covariance[1, 1]
    gx, gxy, gy = slope_noise[0, 0], slope_noise[0, 1], slope_noise[1, 1]
    slope = math.sqrt(max(gx + gy, 0.0) / 2.0)
    product = (xx * yy - xy * xy) * (gx * gy - gxy * gxy)
    trace = xx * gx + 2.0 * xy * gxy + yy * gy
    steep = 2.0 * slope / math.sqrt(trace + 2.0 * math.sqrt(max(product, 0.0)))
    return slope, steep if math.isfinite(steep) else 0.0


@njit(nogil=True, error_model="numpy")
def _rise(tops, height):
    """By how much more than the true place noise raises a top that is ``height`` times as high (NaN for NaN), in the unit of the
    slope of ``tops`` (`slope_of_noise`).
    """
    slope, steep = tops
    height = 0.0 if height < 0.0 else 1.0 if height > 1.0 else height
    return REACH_PX * slope * (math.exp(-SHARPNESS * steep * height) - math.exp(-SHARPNESS * steep))


@njit(nogil=True, error_model="numpy")
def _given(rivals, contrast, noise, true, tops, signals, powers):
    """Write the products of correlation and contrast, as noise raises them (`_rise`), and the squared contrasts of the rivals
    that there are (NaN: none) into signals and powers (k,); their number. ``true``: expected correlation at the true place.
    """
    found = 0
    for j in range(rivals.size):
        if rivals[j] > -2.0:
            signal, powers[found] = rivals[j] * contrast[j], contrast[j] * contrast[j]
            spread = math.sqrt(powers[found] + noise)
            more = _rise(tops, signal / spread / true)
            signals[found] = min(signal + more, spread) if more > 0.0 else signal
            if contrast[j] != 0.0 or not more > 0.0:  # left out: a flat window that noise raises
                found += 1
    return found


@njit(nogil=True, error_model="numpy", fastmath=_FLAGS)
def _moments_of_all(signals, powers, noise, along, count, means, variances):
    """Write the `moments` of ``count`` rivals (`_given`) into means and variances (k,); along: V over
    the number of nodes.
    """
    for j in range(count):
        total_ = powers[j] + noise
        total_ = total_ if total_ > 0.0 else 1.0
        mean = signals[j] / math.sqrt(total_)
        variance = along / total_ * (1.0 - mean * mean * (1.0 + _SMOOTHER * noise / total_))
        means[j], variances[j] = mean, max(variance, _LEAST_VARIANCE)


@njit(nogil=True, error_model="numpy")
def _near(mean, sigma, means, variances, count, firsts, steps):
    """Write the terms first and step of `_integral` for those of ``count`` rivals that are not certainly
    below a normal variable into firsts and steps (k,); their number. means, variances (k,) are
    used up.
    """
    near, apart, own = 0, _APART * _APART, sigma * sigma
    for j in range(count):
        off = mean - means[j]
        if off < 0.0 or off * off < apart * (own + variances[j]):
            means[near], variances[near] = off, variances[j]
            near += 1
    for j in range(near):
        inverse = 1.0 / math.sqrt(variances[j])
        firsts[j], steps[j] = np.float32(means[j] * inverse), np.float32(sigma * inverse)
    return near


@njit(nogil=True, error_model="numpy")
def _raise(means, variances, count, variance, rise):
    """Add ``rise`` joint sigmas of a variable with a variance and of ``count`` rivals to the rivals' means."""
    for j in range(count):
        means[j] += rise * math.sqrt(variance + variances[j])


@njit(nogil=True, error_model="numpy")
def _highest(mean, sigma, firsts, steps, near, least, at, weights):
    """Three probabilities: that a normal variable is above ``least`` and above all its ``near``
    independent rivals (firsts, steps: `_near`); that it is above ``least``; that it is above all its
    rivals: NaN if the first does not need it. at, weights (32,): work arrays.
    """
    low = (least - mean) / sigma
    above = 0.5 * math.erfc(low * math.sqrt(0.5))
    if near == 0:
        return above, above, 1.0
    if low <= -_SIGMAS:
        whole = min(_integral(_WHOLE, _WHOLE_WEIGHTS, firsts, steps, near), 1.0)
        return whole, above, whole
    if low >= _SIGMAS:
        return 0.0, above, math.nan
    factor = _gauss_legendre(low, at, weights)
    found = factor * _integral(at, weights, firsts, steps, near)
    return min(found, above), above, math.nan


@njit(nogil=True, error_model="numpy")
def _acquire(
    contrast, noise, along, rho, nodes, given, factors, weights, least, rise, third_from, work, out
):
    """The probabilities of `acquisition` of a patch with ``given`` rivals into out (3,)."""
    signals, powers, means, variances, firsts, steps, at, parts, third = work
    for again in range(2):
        if again and not out[0] >= third_from:
            break
        for m in range(factors.size):
            if again and not math.isnan(third[m]):
                continue
            scale = factors[m] * factors[m]
            mean, variance = moments(contrast, rho, scale * noise, scale * along, nodes)
            sigma, share = math.sqrt(variance), scale * along / nodes
            _moments_of_all(signals, powers, scale * noise, share, given, means, variances)
            if rise > 0.0 and not again:
                _raise(means, variances, given, variance, rise)
            near = _near(mean, sigma, means, variances, given, firsts, steps)
            if again:
                third[m] = min(_integral(_WHOLE, _WHOLE_WEIGHTS, firsts, steps, near), 1.0)
            else:
                found, above, whole = _highest(mean, sigma, firsts, steps, near, least, at, parts)
                third[m] = whole if rise == 0.0 or near == 0 else math.nan
                out[0] += weights[m] * found
                out[1] += weights[m] * above
    for m in range(factors.size):
        out[2] += weights[m] * third[m]


@njit(nogil=True, error_model="numpy", parallel=True)
def acquisition(
    contrast, noise, along, rho, nodes, covariance, slope_noise, rivals, rival_contrast, factors,
    weights, least, rise, third_from, out,
):  # fmt: skip
    """Write the three probabilities of `_highest` for n patches into out (n, 3), as means over the
    noise of places.

    contrast, noise, along, rho (n,): the patch's contrast, the variance of the noise about its mean,
    V, and the noise-free correlation at the true place. covariance, slope_noise (n, 2, 2): see
    `slope_of_noise`. rivals (n, k) noise-free correlations and
    contrasts of other places, NaN where there are fewer. factors, weights (m,): of the noise's sigma
    at places. For the first the rivals' means are ``rise`` joint sigmas higher. The third may be NaN where the
    first is below ``third_from``. All 0 for a patch without
    contrast or with an infinite V.
    """
    many, parts = rivals.shape[1], min(contrast.size, _PARTS)
    done = 0
    for part in prange(parts):
        done += 1
        signals, powers = np.empty(many), np.empty(many)
        work = (
            signals, powers, np.empty(many), np.empty(many),
            np.empty(many, np.float32), np.empty(many, np.float32),
            aligned(_AT32.size), aligned(_AT32.size), np.empty(factors.size),
        )  # fmt: skip
        for i in range(part, contrast.size, parts):
            out[i] = 0.0
            if contrast[i] > 0.0 and math.isfinite(along[i]) and math.isfinite(rho[i]):
                tops = slope_of_noise(covariance[i], slope_noise[i])
                true, _ = moments(contrast[i], rho[i], noise[i], along[i], nodes)
                given = _given(rivals[i], rival_contrast[i], noise[i], true, tops, signals, powers)
                _acquire(
                    contrast[i], noise[i], along[i], rho[i], nodes, given, factors, weights,
                    least, rise, third_from, work, out[i],
                )  # fmt: skip
    all_done(done, parts)


@njit(nogil=True, error_model="numpy", parallel=True)
def on_top(contrast, noise, along, rho, nodes, slope_noise, offsets, near, near_contrast, out):
    """Write the probability that the correlation at the true place is above that at the strongest
    of the places around it into out (n,).

    slope_noise (n, 2, 2), offsets (k, 2), near and near_contrast (n, k): as in
    `landmarks.detection.top_probability`; the others as in `acquisition`.
    """
    done = 0
    for i in prange(contrast.size):
        done += 1
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
    all_done(done, contrast.size)


@njit(nogil=True, error_model="numpy", parallel=True)
def least_rivals(contrast, noise, along, rho, nodes, covariance, slope_noise, factors, clear, out):
    """Write the noise-free correlation below which another place does not matter into out (n,): in
    noise it is ``clear`` standard deviations below that at the true place, for windows of half the
    patch's contrast, of the same, and of ten times as much, which noise raises; the others as in `acquisition`.
    """
    done = 0
    for i in prange(contrast.size):
        done += 1
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
        tops = slope_of_noise(covariance[i], slope_noise[i])
        true, _ = moments(contrast[i], rho[i], noise[i], along[i], nodes)
        half = 0.5 * contrast[i]  # the least of the others, which noise raises most
        share = half / math.sqrt(half * half + noise[i]) / true
        lowest = out[i] - _rise(tops, 0.0) / half
        more = _rise(tops, lowest * share) / half  # lower places rise more
        if math.isfinite(share) and math.isfinite(more):
            out[i] -= more
    all_done(done, contrast.size)
