"""Covariances of the error model in the statistics of a match: against dense matrices, whose
derivatives are differences, against products with matrices of rows and columns, and against random
fields made on a finer grid.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from helpers import twins_registration as twin
from scipy.integrate import dblquad

from lcp_catalog.errors import ConfigError
from lcp_catalog.landmarks.error_model import ErrorModel, NoiseTerms, PatchErrors
from lcp_catalog.landmarks.localization import registration

CELL_M = 474.0
MODEL = ErrorModel(
    sensor_noise=0.03,
    height_sigma_m=12.0,
    height_length_m=600.0,
    albedo_sigma=0.06,
    albedo_length_m=1500.0,
)
SHORT_M, LONG_M = 250.0, 1200.0
"""Correlation lengths of heights that the kernel applies by distance and by principal components."""


def of_length(length_m: float) -> ErrorModel:
    return dataclasses.replace(MODEL, height_length_m=length_m)


def only(model: ErrorModel, alone: str) -> ErrorModel:
    """A model with one source of error, all of them ("everything") or none."""
    for name in ("sensor_noise", "height_sigma_m", "albedo_sigma"):
        if alone not in ("everything", name):
            model = dataclasses.replace(model, **{name: 0.0})
    return model


def sources(seed: int, n: int = 2, p: int = 9) -> PatchErrors:
    """Radiances about 1 and sensitivities of both signs, different at every node."""
    rng = np.random.default_rng(seed)
    level = 1.0 + 0.2 * rng.normal(size=(n, p, p))
    return PatchErrors(*(a.astype(np.float32) for a in (level, *rng.normal(size=(2, n, p, p)))))


def textures(seed: int, n: int = 2, p: int = 9) -> np.ndarray:
    """Patches about 1: waves, and the last one white noise."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[0:p, 0:p]
    k, phase = rng.normal(size=(2, n, 12, 1, 1)) * 0.5, rng.uniform(0, 6.28, size=(n, 12, 1, 1))
    waves = 1.0 + 0.05 * np.cos(k[0] * x + k[1] * y + phase).sum(axis=1)
    waves[-1] = 1.0 + 0.2 * rng.normal(size=(p, p))
    return waves.astype(np.float32)


def gaussian(sigma: float, length_m: float, lag_x, lag_y):
    """Autocovariance of a Gaussian field whose values are means over pixels (module docstring)."""
    wide2 = length_m**2 + CELL_M**2 / 6.0
    return sigma**2 * length_m**2 / wide2 * np.exp(-0.5 * (lag_x**2 + lag_y**2) / wide2)


def dense(errors: PatchErrors, k: int, model: ErrorModel) -> np.ndarray:
    """Covariance matrix (p^2, p^2) of the noise of patch k, all pairs of nodes; derivatives are
    differences over 2 m.
    """
    p = errors.level.shape[1]
    y, x = (a.ravel() * CELL_M for a in np.mgrid[0:p, 0:p])
    dx, dy = x[:, None] - x, y[:, None] - y

    def height(a, b):
        return gaussian(model.height_sigma_m, model.height_length_m, a, b)

    h = 1.0
    along = -(height(dx + h, dy) - 2 * height(dx, dy) + height(dx - h, dy)) / h**2
    across = -(height(dx, dy + h) - 2 * height(dx, dy) + height(dx, dy - h)) / h**2
    corners = [a * b * height(dx + a * h, dy + b * h) for a in (1, -1) for b in (1, -1)]
    mixed = -sum(corners) / (4 * h**2)
    e, s, level = (
        np.asarray(a[k], np.float64).ravel() for a in (errors.east, errors.south, errors.level)
    )
    slopes = np.outer(e, e) * along + np.outer(s, s) * across
    slopes += (np.outer(e, s) + np.outer(s, e)) * mixed
    albedo = np.outer(level, level) * gaussian(model.albedo_sigma, model.albedo_length_m, dx, dy)
    return slopes + albedo + model.sensor_noise**2 * np.eye(p * p)


ALONE = ["everything", "sensor_noise", "height_sigma_m", "albedo_sigma", "nothing"]


def test_both_ways_of_applying_slope_errors_are_tested():
    for p in (9, 17, 33):
        assert NoiseTerms.of(of_length(SHORT_M), p, CELL_M).taps.shape[1] > 0
        assert NoiseTerms.of(of_length(LONG_M), p, CELL_M).taps.shape[1] == 0


@pytest.mark.parametrize("alone", ALONE)
@pytest.mark.parametrize("length_m", [SHORT_M, LONG_M])
@pytest.mark.parametrize("p", [9, 17, pytest.param(33, marks=pytest.mark.slow)])
def test_statistics_are_those_of_the_dense_covariance(p, length_m, alone):
    """Products with the fields, and the covariance of least squares with the four columns as they
    are, without a projection. The kernel leaves out parts below 1e-5 of the greatest covariance or
    eigenvalue.
    """
    model = only(of_length(length_m), alone)
    patches, errors = textures(p, p=p), sources(1, p=p)
    found = registration(patches, errors, model, CELL_M)
    fields, _ = twin.fields_of(patches.astype(np.float64))
    assert (found.along > 0).any() == (alone != "nothing")
    for k in range(2):
        covariance, flat = dense(errors, k, model), fields[k].reshape(4, -1)
        expected = flat @ covariance @ flat.T
        power = patches[k].size * patches[k].var(dtype=np.float64)
        slopes = found.slope_noise[k] * power
        scale = np.diag(expected)[:2].max()
        np.testing.assert_allclose(slopes, expected[:2, :2], atol=4e-5 * scale, rtol=0)
        assert found.along[k] == pytest.approx(expected[2, 2], rel=4e-5)
        within = np.diag(covariance).mean() - covariance.mean()
        assert found.noise_variance[k] == pytest.approx(within, rel=2e-5, abs=1e-12)
        image = patches[k].astype(np.float64)
        ones = np.ones_like(image)
        rows = np.stack([twin.node_slopes(image, 1), twin.node_slopes(image, 0), ones, image])
        inverse = np.linalg.pinv(rows.reshape(4, -1))
        shift = (inverse.T @ covariance @ inverse)[:2, :2]
        np.testing.assert_allclose(
            found.covariance_px2[k], shift, atol=4e-5 * np.diag(shift).max(), rtol=0
        )
        bias = -inverse.T @ (errors.level[k] - image).ravel()
        np.testing.assert_allclose(
            found.bias[k], bias[:2], atol=2e-5 * np.abs(bias[:2]).max(), rtol=0
        )
        own = np.corrcoef(patches[k].ravel(), errors.level[k].ravel())[0, 1]
        assert found.own[k] == pytest.approx(own, abs=2e-6)


@pytest.mark.parametrize("alone", ALONE)
@pytest.mark.parametrize("length_m", [SHORT_M, 600.0, LONG_M, 5000.0])
@pytest.mark.parametrize("p", [7, 9, 17, 33])
def test_statistics_are_those_of_the_plain_formulas(p, length_m, alone):
    """Patches and sources that are divided by their levels; six patches are more than one block."""
    model = dataclasses.replace(only(of_length(length_m), alone), spread=0.2)
    patches, errors = textures(p + 1, 6, p), sources(2, 6, p)
    level = np.random.default_rng(p).uniform(0.01, 3.0, 6)
    by = level[:, None, None].astype(np.float32)
    scaled = PatchErrors(errors.level * by, errors.east * by, errors.south * by)
    found = registration(patches * by, scaled, model, CELL_M, level)
    said = twin.statistics(patches * by, scaled, model, CELL_M, level)
    for name, expected in said._asdict().items():
        worst = np.abs(expected).reshape(6, -1).max(axis=1)
        error = np.abs(getattr(found, name) - expected).reshape(6, -1).max(axis=1)
        assert (error <= (1e-6 if name == "own" else 4e-5 * worst)).all(), name
    np.testing.assert_array_equal(found.pixels, p * p)
    assert found.spread == 0.2


def made_noise(errors: PatchErrors, model: ErrorModel, count: int, fine: int = 4) -> np.ndarray:
    """Noise (count, p, p) of patch 0 from fields on a grid ``fine`` times finer, made by Fourier
    transforms: height errors, whose slopes are exact derivatives, and brightness, both as means over
    pixels; and white noise of pixels.
    """
    rng, p = np.random.default_rng(3), errors.level.shape[1]
    size, step = 2 * p * fine, CELL_M / fine  # repeats after twice the patch
    k = 2.0 * np.pi * np.fft.fftfreq(size, step)
    kx, ky = k[None, :], k[:, None]

    def spectrum(sigma, length):
        power = np.exp(-0.5 * length**2 * (kx**2 + ky**2))
        return sigma * np.sqrt(power / power.mean())

    heights = spectrum(model.height_sigma_m, model.height_length_m)
    albedo = spectrum(model.albedo_sigma, model.albedo_length_m)
    noise = []
    for _ in range(count):
        white = [np.fft.fft2(rng.normal(size=(size, size))) for _ in range(2)]
        raw = [1j * kx * heights * white[0], 1j * ky * heights * white[0], albedo * white[1]]
        bands = [np.fft.ifft2(band).real[: p * fine, : p * fine] for band in raw]
        means = [b.reshape(p, fine, p, fine).mean(axis=(1, 3)) for b in bands]
        one = sum(
            m * part[0]
            for m, part in zip(means, (errors.east, errors.south, errors.level), strict=True)
        )
        noise.append(one + model.sensor_noise * rng.normal(size=(p, p)))
    return np.array(noise)


@pytest.mark.slow
@pytest.mark.parametrize("length_m", [300.0, 600.0])
def test_statistics_are_those_of_random_fields(length_m):
    """Within 3 standard errors of 1500 draws (11 %); by distance and by principal components."""
    model = of_length(length_m)
    by_distance = NoiseTerms.of(model, 9, CELL_M).taps.shape[1] > 0
    assert by_distance == (length_m < 500.0)
    errors, y, x = sources(4, n=1), *(np.mgrid[0:9, 0:9] / 8.0)
    patch = (1.0 + 0.1 * np.cos(3 * x) + 0.1 * np.sin(5 * y) * x + 0.05 * (x - y))[None]
    found = registration(patch, errors, model, CELL_M)
    fields, _ = twin.fields_of(patch)
    power = patch.size * patch.var()
    stated = np.zeros((3, 3))
    stated[:2, :2], stated[2, 2] = found.slope_noise[0] * power, found.along[0]
    noise = made_noise(errors, model, 1500)
    seen = np.cov(np.einsum("aij,nij->na", fields[0, :3], noise).T)
    scale = np.sqrt(np.outer(np.diag(stated), np.diag(stated)))
    for part in (np.s_[:2, :2], np.s_[2, 2]):
        np.testing.assert_allclose((seen / scale)[part], (stated / scale)[part], atol=0.11)
    within = noise.var(axis=(1, 2)).mean()
    assert within == pytest.approx(found.noise_variance[0], rel=0.05)


@pytest.mark.parametrize(("length", "worst"), [(0.35, 0.11), (0.5, 0.04), (1.0, 0.003)])
def test_the_mean_over_a_pixel_widens_a_field(length, worst):
    """The model's variance of a pixel's mean, in units of the field's, against the integral over both
    pixels; lengths in pixels.
    """
    exact, _ = dblquad(lambda u, v: math.exp(-0.5 * ((u - v) / length) ** 2), 0, 1, 0, 1)
    stated = length / math.sqrt(length**2 + 1.0 / 6.0)
    assert stated == pytest.approx(exact, rel=worst)


def test_values_go_through_dictionaries_and_bad_ones_are_refused():
    other = MODEL.to_dict() | {"min_detection": 0.9}
    assert ErrorModel.from_dict(other) == MODEL
    below = dataclasses.replace(MODEL, detection_shift=-0.1)  # the only one of two signs
    assert ErrorModel.from_dict(below.to_dict()) == below
    for name in MODEL.to_dict():
        for bad in (
            (math.inf, math.nan) if name == "detection_shift" else (-0.1, math.inf, math.nan)
        ):
            with pytest.raises(ConfigError, match=rf"`errors\.{name}` must be"):
                dataclasses.replace(MODEL, **{name: bad})
    for name in ("height_length_m", "albedo_length_m"):
        with pytest.raises(ConfigError, match=rf"`errors\.{name}` must be above 0"):
            dataclasses.replace(MODEL, **{name: 0.0})
