"""The detector: signal of a pixel, noise, numbers; integrals compared with scipy."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import integrate, ndimage, stats

from lcp_catalog.errors import ConfigError
from lcp_catalog.simulation.detector import Detector, gathered, response

BLURS = st.floats(0.0, 3.0)
SAMPLES = st.integers(1, 6)


@pytest.mark.parametrize(("blur_px", "samples"), [(0.3, 2), (0.6, 3), (1.0, 4), (2.5, 1)])
def test_a_response_is_the_square_spread_by_the_gaussian(blur_px, samples):
    """Each weight compared with quadrature of square times Gaussian over the sub-pixel, without the
    part beyond 4 sigma.
    """
    spread = stats.norm(scale=blur_px)
    weights = response(blur_px, samples)
    left = -0.5 * len(weights) / samples
    for number, weight in enumerate(weights):
        bounds = left + number / samples, left + (number + 1) / samples
        exact, _ = integrate.quad(lambda x: spread.cdf(x + 0.5) - spread.cdf(x - 0.5), *bounds)
        assert weight == pytest.approx(exact, abs=1e-4 * max(weights))


def test_without_blur_a_pixel_is_its_own_square():
    assert response(0.0, 4).tolist() == [0.25] * 4


@given(BLURS, SAMPLES)
def test_a_response_is_whole_even_and_lies_in_the_middle(blur_px, samples):
    weights = response(blur_px, samples)
    assert weights.sum() == pytest.approx(1.0)
    assert (weights >= 0.0).all()
    np.testing.assert_allclose(weights, weights[::-1], atol=1e-12)
    assert len(weights) == samples * (2 * Detector(blur_px=blur_px).margin_px + 1)


@given(st.floats(0.2, 2.0))
def test_a_responses_width_is_that_of_both(blur_px):
    """Variances add: the Gaussian's, and 1/12 of the square."""
    weights = response(blur_px, 50)
    at = (np.arange(len(weights)) - (len(weights) - 1) / 2) / 50
    assert np.sum(weights * at**2) == pytest.approx(blur_px**2 + 1 / 12, rel=5e-3)


@given(BLURS, SAMPLES, st.floats(-5, 5), st.floats(-5, 5))
def test_a_plane_of_light_is_left_where_it_was(blur_px, samples, down, right):
    """No half pixels: of light that increases linearly a pixel has the value at its centre."""
    margin, shape = Detector(blur_px=blur_px).margin_px, (5, 7)
    row, col = (
        (np.arange(samples * (n + 2 * margin)) + 0.5) / samples - 0.5 - margin for n in shape
    )
    fine = 100.0 + down * row[:, None] + right * col
    found = gathered(fine, response(blur_px, samples), samples)
    expected = 100.0 + down * np.arange(5)[:, None] + right * np.arange(7)
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_a_scene_is_blurred_as_scipy_blurs_it():
    """At eight sub-pixels per pixel: a Gaussian in sub-pixels, then means over squares."""
    fine = np.random.default_rng(1).random((8 * 26, 8 * 29))
    smooth = ndimage.gaussian_filter(fine, 8 * 0.8, truncate=6.0)
    means = smooth.reshape(26, 8, 29, 8).mean(axis=(1, 3))
    margin = Detector(blur_px=0.8).margin_px
    found = gathered(fine, response(0.8, 8), 8)
    inner = means[margin:-margin, margin:-margin]
    assert found.shape == inner.shape
    assert np.abs(found - inner).max() < 2e-4


def test_what_is_not_known_does_not_count():
    fine = np.full((12, 12), 3.0)
    fine[:, :5] = np.nan  # of the second pixel one of three columns is known
    found = gathered(fine, response(0.0, 3), 3)
    assert np.isnan(found[:, :2]).all()
    np.testing.assert_allclose(found[:, 2:], 3.0)
    fine[:, 4] = 6.0  # two of three
    np.testing.assert_allclose(gathered(fine, response(0.0, 3), 3)[:, 1], [4.5] * 4)


def lit(level=0.1, shape=(400, 500)):
    return np.full(shape, level)


@pytest.mark.parametrize("shot_share", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("noise", [0.02, 0.2])
def test_noise_at_the_mean_is_what_was_asked_for(noise, shot_share):
    """200 000 pixels: the standard deviation is known to 0.16 %, the mean to noise / 450."""
    found = Detector(noise=noise, shot_share=shot_share, seed=4).noisy(lit())
    assert found.std() / 0.1 == pytest.approx(noise, rel=0.01)
    assert found.mean() / 0.1 == pytest.approx(1.0, abs=noise / 90)


def test_variance_grows_with_the_signal_by_the_photons_share():
    """Halves with 0.5 and 1.5 times the mean: variances 1 - s / 2 and 1 + s / 2 of that at the
    mean.
    """
    signal = np.concatenate([lit(0.05), lit(0.15)])
    for share in (0.0, 0.4, 1.0):
        found = Detector(noise=0.1, shot_share=share, seed=2).noisy(signal)
        variance = found.reshape(2, -1).var(axis=1) / 0.01**2
        np.testing.assert_allclose(variance, [1 - share / 2, 1 + share / 2], rtol=0.02)


def test_shadow_is_not_lit_and_has_read_noise_only():
    """The mean is that of lit pixels: a dark half of the image has no effect."""
    signal = np.concatenate([lit(0.0), lit(0.1)])
    dark, bright = np.split(Detector(noise=0.1, shot_share=0.4, seed=2).noisy(signal), 2)
    assert bright.std() == pytest.approx(0.01, rel=0.02)
    assert dark.std() == pytest.approx(0.01 * np.sqrt(0.6), rel=0.02)
    assert abs(dark.mean()) < 1e-4


def test_faint_light_in_shadow_changes_neither_noise_nor_exposure():
    """Shadow with 1 % of the brightness, four fifths of the image, beside black shadow."""
    sunlit, shadow = lit(0.1, (100, 500)), lit(0.0)
    frames = [np.concatenate([shadow + faint, sunlit]) for faint in (0.0, 0.001)]
    detector = Detector(noise=0.1, shot_share=0.0, seed=2)
    black, grey = (detector.noisy(one) - one for one in frames)
    np.testing.assert_allclose(grey, black, atol=1e-12)
    assert detector.scale_of(frames[0]) == detector.scale_of(frames[1])


def test_a_seed_is_a_noise():
    one, again, other = (Detector(noise=0.1, seed=seed).noisy(lit()) for seed in (1, 1, 2))
    assert (one == again).all()
    assert (one != other).any()
    assert Detector(noise=0.1).noisy(np.zeros((3, 3))).tolist() == [[0.0] * 3] * 3


@pytest.mark.parametrize(
    ("bits", "kind"), [(1, "u1"), (8, "u1"), (10, "u2"), (12, "u2"), (16, "u2")]
)
def test_numbers_are_rounded_and_end_at_full_scale(bits, kind):
    top = 2**bits - 1
    signal = np.array([[0.0, 0.49 / top, 0.51 / top, 1.0, 1.5, np.nan]]) * 0.3
    found = Detector(bits=bits).numbers(signal, 0.3)
    assert found.dtype == np.dtype(kind)
    assert found.tolist() == [[0, 0, 1, top, top, 0]]


def test_noise_does_not_fall_below_zero_or_light_what_is_not_known():
    signal = lit()
    signal[:10] = np.nan
    signal[10:20] = 0.0
    found = Detector(noise=0.3, bits=12).numbers(signal, 0.12)
    assert (found[:10] == 0).all()
    assert 0.4 < (found[10:20] == 0).mean() < 0.6
    assert found.max() == 4095


def test_the_exposure_that_is_not_stated():
    """By default the 99.5th percentile of lit pixels falls at 80 % of full scale; a stated exposure
    is kept.
    """
    signal = np.concatenate([np.zeros(5000), np.linspace(0.001, 0.2, 2000)])
    scale = Detector().scale_of(signal)
    assert np.mean(signal[5000:] <= 0.8 * scale) == pytest.approx(0.995, abs=1e-3)
    assert Detector(full_scale=0.7).scale_of(signal) == 0.7
    assert Detector().scale_of(np.zeros(4)) == 1.0


@pytest.mark.parametrize(
    ("given", "named"),
    [
        ({"blur_px": -0.1}, "blur"),
        ({"blur_px": 17.0}, "blur"),
        ({"blur_px": float("nan")}, "blur"),
        ({"noise": -0.1}, "noise"),
        ({"noise": float("nan")}, "noise"),
        ({"shot_share": 1.1}, "photon"),
        ({"full_scale": 0.0}, "exposure"),
        ({"full_scale": float("inf")}, "exposure"),
        ({"bits": 0}, "bits"),
        ({"bits": 17}, "bits"),
        ({"seed": -1}, "seed"),
    ],
)
def test_detectors_that_cannot_be(given, named):
    with pytest.raises(ConfigError, match=named):
        Detector(**given)
