"""Probabilities of detection: the stated normal model by random numbers and by integration, the
moments of correlations in noise, and the ends.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from helpers import twins_registration as twin
from numba import njit
from scipy.integrate import quad
from scipy.stats import norm

from lcp_catalog.kernels.elementary import normal
from lcp_catalog.kernels.matching import acquisition as kernel
from lcp_catalog.kernels.vectors import LANES, load, store
from lcp_catalog.landmarks.detection import (
    detection_probability,
    least_rival,
    mistake_probability,
    top_probability,
)
from lcp_catalog.landmarks.localization import Registration

NODES = 17 * 17


def case(contrast=0.1, noise=0.1, gain=1.0, spread=0.0, loss=0.0, n=1) -> Registration:
    """Statistics of n equal patches in noise whose V is ``gain`` times that of white noise."""
    whole = np.ones(n)
    return Registration(
        contrast=contrast * whole,
        noise_variance=noise**2 * whole,
        along=gain * noise**2 * whole,
        shift_loss=loss * whole,
        covariance_px2=np.zeros((n, 2, 2)),
        slope_noise=np.zeros((n, 2, 2)),
        bias=np.zeros((n, 2)),
        own=whole,
        pixels=np.full(n, float(NODES)),
        spread=spread,
    )


def moments(match: Registration, rho, contrast, factor=1.0):
    """Means and sigmas of the stated normal model, written out (module docstring of detection)."""
    noise, along = (float(a[0]) * factor**2 for a in (match.noise_variance, match.along))
    total = np.asarray(contrast) ** 2 + noise
    mean = np.asarray(rho) * np.asarray(contrast) / np.sqrt(total)
    left = 1.0 - mean**2 * (1.0 + 0.5 * noise / total)
    return mean, np.sqrt(along / match.pixels[0] * left / total)


def drawn(match, rho, contrast, self_correlation, least, count=200_000):
    """Shares of draws in which the patch is found; above ``least``; the highest of all."""
    rng = np.random.default_rng(0)
    factor = np.exp(match.spread * rng.normal(size=count)) if match.spread else np.ones(1)
    noise, along = (float(a[0]) * factor**2 for a in (match.noise_variance, match.along))

    def scores(r, c):
        total = c**2 + noise
        mean = r * c / np.sqrt(total)
        left = 1.0 - mean**2 * (1.0 + 0.5 * noise / total)
        return mean + np.sqrt(along / match.pixels[0] * left / total) * rng.normal(size=count)

    own = scores(self_correlation * (1.0 - match.shift_loss[0]), match.contrast[0])
    best = np.max([scores(r, c) for r, c in zip(rho, contrast, strict=True)], axis=0)
    return [np.mean(a) for a in ((own > best) & (own > least), own > least, own > best)]


RHO, CONTRAST = np.array([[0.8, 0.5, -0.2, np.nan]]), np.array([[0.1, 0.3, 0.1, np.nan]])


@pytest.mark.parametrize("spread", [0.0, 0.3])
@pytest.mark.parametrize(("noise", "gain"), [(0.05, 10.0), (0.2, 2.0), (0.5, 1.0), (0.2, 30.0)])
def test_probabilities_are_those_of_the_stated_model(noise, gain, spread):
    """Three standard errors of the draws are 0.0034. A quadrature so fine that its own error is below that."""
    match = case(noise=noise, gain=gain, spread=spread, loss=0.02)
    found = detection_probability(match, RHO, CONTRAST, 0.97, 0.35, spread_nodes=25)
    expected = drawn(match, RHO[0, :3], CONTRAST[0, :3], 0.97, 0.35)
    np.testing.assert_allclose(np.ravel(found), expected, atol=0.006)
    assert found[0] <= min(found[1], found[2])


def test_the_cases_of_that_test_are_neither_sure_nor_hopeless():
    values = [
        detection_probability(case(noise=n, gain=g, loss=0.02), RHO, CONTRAST, 0.97, 0.35)[0][0]
        for n, g in ((0.05, 10.0), (0.2, 2.0), (0.5, 1.0), (0.2, 30.0))
    ]
    assert min(values) < 0.3
    assert sum(0.3 < v < 0.99 for v in values) >= 2


def test_the_integral_is_exact():
    """Against adaptive integration, for one rival at all distances."""
    for rho in np.linspace(-1.0, 1.0, 21):
        match = case(noise=0.15, gain=8.0)
        (own, sigma), (other, theirs) = (moments(match, r, 0.1) for r in (1.0, rho))

        def density(x, own=own, sigma=sigma, other=other, theirs=theirs):
            return norm.pdf(x, own, sigma) * norm.cdf((x - other) / theirs)

        expected, _ = quad(density, 0.4, own + 9 * sigma, points=[own], epsabs=1e-10)
        rivals = np.array([[rho]]), np.array([[0.1]])
        found = detection_probability(match, *rivals, 1.0, 0.4)[0][0]
        assert found == pytest.approx(expected, abs=2e-6)


def test_the_least_correlation_is_the_lower_end_of_the_integral():
    """The probability follows the normal distribution at every limit."""
    match = case(noise=0.15, gain=8.0)
    mean, sigma = moments(match, 1.0, 0.1)
    for least in np.linspace(mean - 3 * sigma, mean + 3 * sigma, 41):
        found = detection_probability(match, np.full((1, 1), np.nan), np.zeros((1, 1)), 1.0, least)
        assert found[1][0] == pytest.approx(norm.sf(least, mean, sigma), abs=2e-6)
        assert found[0] == found[1]
        assert found[2][0] == pytest.approx(1.0)


def test_the_ends():
    none = np.full((1, 2), np.nan)
    alike = np.array([[1.0, np.nan]]), np.array([[0.1, np.nan]])

    def p(match, rivals=none, contrast=none, **how):
        return detection_probability(match, rivals, contrast, **how)[0][0]

    assert p(case(noise=0.0)) == pytest.approx(1.0)
    assert p(case(noise=0.0), *(np.array([[v, np.nan]]) for v in (0.999, 0.1))) == pytest.approx(1)
    assert p(case(noise=0.0, gain=0.0), self_correlation=0.2) == pytest.approx(0.0)  # below least
    assert p(case(), *alike, least_correlation=-1.0) == pytest.approx(0.5, abs=1e-3)
    three = np.ones((1, 3)), np.full((1, 3), 0.1)
    assert p(case(), *three, least_correlation=-1.0) == pytest.approx(0.25, abs=2e-3)
    assert p(case(contrast=0.0)) == 0.0
    assert p(case(contrast=np.nan)) == 0.0
    flat = dataclasses.replace(case(), along=np.array([np.inf]))
    assert p(flat) == 0.0
    assert p(case(noise=100.0), least_correlation=0.3) < 1e-3
    quiet = [p(case(noise=s, gain=20.0), *alike) for s in (0.05, 0.1, 0.3, 1.0)]
    assert (np.diff(quiet) < 0.0).all()
    empty = detection_probability(case(n=0), np.zeros((0, 3)), np.zeros((0, 3)))
    assert all(part.shape == (0,) for part in empty)


def smooth_noise(rng, count, size, length):
    """Fields of unit variance with the autocorrelation exp(-r^2 / 2 l^2); l = 0: white."""
    k = 2.0 * np.pi * np.fft.fftfreq(2 * size)
    power = np.exp(-0.5 * length**2 * (k[:, None] ** 2 + k**2))
    shape = np.sqrt(power / power.mean())[:, : size + 1]  # the other half is its mirror image
    white = np.fft.rfft2(rng.normal(size=(count, 2 * size, 2 * size)))
    return np.fft.irfft2(shape * white)[:, :size, :size]


@pytest.mark.slow
@pytest.mark.parametrize("length", [0.0, 1.5])
def test_moments_are_those_of_correlations_in_noise(length):
    """Of the patch and of a window that resembles it by 0.5; 1000 images."""
    rng = np.random.default_rng(1)
    patch, other = smooth_noise(rng, 2, 17, 2.0) * 0.1
    patch, other = (a - a.mean() for a in (patch, other))
    other -= patch * (patch * other).sum() / (patch**2).sum()
    other = 0.5 * patch / patch.std() + np.sqrt(0.75) * other / other.std()
    for level in (0.05, 0.1, 0.2):
        noise = level * smooth_noise(rng, 1000, 17, length)
        for window, rho in ((patch, 1.0), (0.1 * other, 0.5)):
            seen = (window + noise).reshape(1000, -1)
            seen = seen - seen.mean(axis=1, keepdims=True)
            unit = patch.ravel() / np.linalg.norm(patch)
            scores = seen @ unit / np.linalg.norm(seen, axis=1)
            within = (noise - noise.mean(axis=(1, 2), keepdims=True)).var(axis=(1, 2)).mean()
            along = (noise.reshape(1000, -1) @ unit).var()
            mean, variance = kernel.moments(window.std(), rho, within, along, 289)
            assert mean == pytest.approx(scores.mean(), abs=0.01)
            assert np.sqrt(variance) == pytest.approx(scores.std(), rel=0.1)


def test_moments_are_those_of_the_formula():
    """Against NumPy, at all figures; without contrast and noise there is no correlation."""
    rng = np.random.default_rng(0)
    for _ in range(300):
        contrast, noise, along = np.exp(rng.uniform(-7, 1, 3))
        figures = contrast, rng.uniform(-1, 1), noise, along
        expected = [float(a) for a in twin.correlation_moments(*figures, NODES)]
        assert list(kernel.moments(*figures, NODES)) == pytest.approx(expected, rel=1e-12)
    assert kernel.moments(0.0, 0.7, 0.0, 1.0, NODES) == (0.0, pytest.approx(1e-12))
    assert kernel.moments(0.1, 1.0, 0.0, 0.0, NODES) == (1.0, pytest.approx(1e-12))


@njit
def normal_of(at, out):
    for k in range(0, at.size - LANES + 1, LANES):
        store(out, k, normal(load(at, k)))


@pytest.mark.slow
def test_the_normal_distribution_is_that_of_scipy():
    """At random places and far out, in single precision."""
    rng = np.random.default_rng(0)
    places = rng.uniform(-7, 7, 20_000), rng.normal(size=999), rng.normal(size=99) * 1e-3
    ends = [-np.inf, -1e6, -13.0, -6.0, 0.0, 6.0, 13.0, 1e6, np.inf]
    at = np.concatenate([*places, ends]).astype(np.float32)
    found = np.empty(at.size + LANES, np.float32)
    normal_of(np.append(at, np.zeros(LANES, np.float32)), found)
    found = found[: at.size].astype(np.float64)
    assert np.abs(found - norm.cdf(at.astype(np.float64))).max() < 3e-7


def random_cases(rng, n: int, spread: float) -> tuple[Registration, np.ndarray]:
    """Matches of contrasts, noise and V of any size, and their correlations at the true place."""
    noise, gain = np.exp(rng.uniform(-4.6, 0.0, n)), np.exp(rng.uniform(0.0, 4.0, n))
    slopes = rng.normal(size=(n, 2, 2)) * noise[:, None, None]
    match = dataclasses.replace(
        case(spread=spread, n=n),
        contrast=np.exp(rng.uniform(-4.0, -0.7, n)),
        noise_variance=noise**2,
        along=gain * noise**2,
        shift_loss=rng.uniform(0.0, 0.05, n),
        slope_noise=slopes @ slopes.transpose(0, 2, 1),
    )
    own = rng.uniform(0.6, 1.0, n)
    dice = np.random.default_rng(n)
    moved = dice.normal(size=(n, 2, 2)) * dice.uniform(0.0, 1.5, (n, 1, 1))
    return dataclasses.replace(match, covariance_px2=moved @ moved.transpose(0, 2, 1)), own


SLOW = pytest.mark.slow


@pytest.mark.parametrize(
    ("contrasts", "spread", "clear_by"),
    [
        ((0.5, 1.0), 0.0, 0.17),
        pytest.param((0.5, 1.0), 0.3, 0.0, marks=SLOW),
        pytest.param((0.5, 10.0), 0.0, 0.0, marks=SLOW),
        pytest.param((0.5, 10.0), 0.3, 0.17, marks=SLOW),
        pytest.param((5.0, 1000.0), 0.0, 0.17, marks=SLOW),
        pytest.param((5.0, 1000.0), 0.3, 0.0, marks=SLOW),
    ],
)
def test_rivals_below_the_least_one_change_no_probability(contrasts, spread, clear_by):
    """All of 64 rivals, and one just below it."""
    rng = np.random.default_rng(1)
    match, own = random_cases(rng, 3000, spread)

    def detected(rivals, there):
        return detection_probability(match, rivals, there, own, clear_by=clear_by)

    least = least_rival(match, own, clear_by)[:, None]
    rho = rng.uniform(-0.5, 1.0, (3000, 64)) * rng.uniform(0.0, 1.0, (3000, 1))
    contrast = match.contrast[:, None] * np.exp(rng.uniform(*np.log(contrasts), rho.shape))
    below = rho < least
    assert 0.1 < below.mean() < 0.9
    whole = np.array(detected(rho, contrast))
    assert np.mean((whole[2] > 0.05) & (whole[2] < 0.95)) > 0.2
    rest = detected(np.where(below, np.nan, rho), contrast)
    np.testing.assert_allclose(rest, whole, atol=1e-4)
    just, one = np.where((least > -1.0) & (least <= 1.0), least - 1e-6, np.nan), contrast[:, :1]
    assert np.isfinite(just).mean() > 0.3
    alone = detected(np.full_like(just, np.nan), one)
    np.testing.assert_allclose(detected(just, one), alone, atol=1e-5)


@pytest.mark.parametrize("rho", [-0.2, 0.05, 0.15, 0.5, 0.9])
def test_noise_raises_low_tops_most(rho):
    """One rival, of the true place's height times rho; a slope of the noise of 0.05 and a peak that it raises by 0.025."""
    match = case(contrast=0.1, noise=0.2, gain=10.0)
    power = 0.1**2 + 0.2**2
    match = dataclasses.replace(
        match,
        slope_noise=np.eye(2)[None] * 0.05**2 * power * NODES,
        covariance_px2=np.eye(2)[None] * 0.5**2,
    )
    found = detection_probability(match, np.array([[rho]]), np.array([[0.1]]), 1.0, -1.0)[0][0]
    mean, sigma = moments(match, 1.0, 0.1)
    steep = 0.7 * 0.05 / 0.025
    rise = 3.0 * 0.05 * (np.exp(-steep * max(rho, 0.0)) - np.exp(-steep))
    other, theirs = moments(match, rho + rise * np.sqrt(power) / 0.1, 0.1)
    assert found == pytest.approx(norm.cdf((mean - other) / np.hypot(sigma, theirs)), abs=2e-4)
    assert 0.4 < found < 0.995


def test_a_flat_window_is_no_rival_where_noise_raises_tops():
    match = case(contrast=0.1, noise=0.2, gain=10.0)
    match = dataclasses.replace(
        match, slope_noise=np.eye(2)[None] * 0.1, covariance_px2=np.eye(2)[None] * 0.5**2
    )

    def found(rho, there):
        rivals = np.array([[rho, 0.5]]), np.array([[there, 0.1]])
        return detection_probability(match, *rivals, 1.0, 0.3)[0][0]

    assert found(0.0, 0.0) == found(np.nan, np.nan)
    assert found(0.0, 0.05) < found(0.0, 0.0) < 0.999


def test_the_least_rival_is_not_far_below_those_that_matter():
    """Rivals 0.3 above it reduce the probability in most matches where it is high."""
    match, own = random_cases(np.random.default_rng(2), 500, 0.0)
    least = least_rival(match, own)
    some = (least > 0.0) & (least < 0.6)
    assert some.sum() > 50
    rho = np.repeat((least + 0.3)[:, None], 10, axis=1)
    found = detection_probability(match, rho, match.contrast[:, None] + 0 * rho, own, -1.0)[0]
    assert np.median(found[some]) < 0.995


def test_the_top_of_a_peak_against_the_formula():
    """Places outside the image (NaN) do not count; without any, the top is where it belongs."""
    rng = np.random.default_rng(3)
    match, own = random_cases(rng, 200, 0.0)
    offsets = np.array([[3, 0], [-2, 2], [0, -3], [1, 3]])
    near = own[:, None] - rng.uniform(0.0, 0.3, (200, 4))
    contrast = match.contrast[:, None] * np.exp(rng.uniform(-0.5, 0.5, (200, 4)))
    gone = rng.random((200, 4)) < 0.3
    gone[:, 0] = False
    near, contrast = np.where(gone, np.nan, near), np.where(gone, np.nan, contrast)
    found = top_probability(match, offsets, near, contrast, own)
    expected = twin.top_probability(match, offsets, near, contrast, own)
    np.testing.assert_allclose(found, expected, atol=1e-9)
    assert ((found > 0.1) & (found < 0.9)).sum() > 30
    none = np.full((200, 4), np.nan)
    assert (top_probability(match, offsets, none, none, own) == 1.0).all()


def test_mistakes_are_as_frequent_as_stated():
    """A template in noise with one rival of any likeness: how often the lower of two correlations was
    the true one, among draws with about the stated probability.
    """
    rng = np.random.default_rng(2)
    count, size = 3000, 17
    patch = smooth_noise(rng, 1, size, 2.0)[0]
    patch = (patch - patch.mean()) / np.linalg.norm(patch - patch.mean())
    level, length = 0.13, 1.5
    noise = level * smooth_noise(rng, 2 * count, size, length).reshape(2, count, -1)
    rival = rng.normal(size=(count, size * size))
    rival -= rival.mean(axis=1, keepdims=True)
    rival -= (rival @ patch.ravel())[:, None] * patch.ravel()
    rival /= np.linalg.norm(rival, axis=1, keepdims=True)
    rho = rng.uniform(0.2, 1.0, size=(count, 1))
    rival = rho * patch.ravel() + np.sqrt(1.0 - rho**2) * rival

    def score(seen):
        seen = seen - seen.mean(axis=1, keepdims=True)
        return seen @ patch.ravel() / np.linalg.norm(seen, axis=1)

    true, false = score(patch.ravel() + noise[0]), score(rival + noise[1])
    best, second = np.maximum(true, false), np.minimum(true, false)
    templates = np.broadcast_to(patch.astype(np.float32), (count, size, size))
    masks = np.ones_like(templates, dtype=bool)
    neighbours = np.full(count, np.exp(-0.5 / length**2))
    stated = mistake_probability(best, second, templates, masks, neighbours, 0.5)
    wrong = false > true
    assert wrong.mean() > 0.15
    assert stated.mean() == pytest.approx(wrong.mean(), abs=0.04)
    for low, high in ((0.0, 0.1), (0.1, 0.3), (0.3, 0.5)):
        some = (stated >= low) & (stated < high)
        assert stated[some].mean() == pytest.approx(wrong[some].mean(), abs=0.05)
    sure = mistake_probability(best, second, templates, masks, neighbours, 0.99)
    assert (sure <= stated).all()
    assert np.ravel(mistake_probability(
        np.array([0.9]), np.array([0.9]), templates[:1], masks[:1], neighbours[:1]
    )) == pytest.approx(0.5)  # fmt: skip
