"""Covariances of the error model: against dense matrices, whose derivatives are differences, and
against random fields made on a finer grid.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from scipy.integrate import dblquad

from lcp_catalog.errors import ConfigError
from lcp_catalog.landmarks.error_model import ErrorModel, PatchErrors, noise_products

CELL_M = 474.0
MODEL = ErrorModel(
    sensor_noise=0.03,
    height_sigma_m=12.0,
    height_length_m=600.0,
    albedo_sigma=0.06,
    albedo_length_m=1500.0,
)


def sources(seed: int, n: int = 2, p: int = 9) -> PatchErrors:
    """Radiances about 1 and sensitivities of both signs, different at every node."""
    rng = np.random.default_rng(seed)
    level = 1.0 + 0.2 * rng.normal(size=(n, p, p))
    return PatchErrors(*(a.astype(np.float32) for a in (level, *rng.normal(size=(2, n, p, p)))))


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


@pytest.mark.parametrize(
    "alone", ["everything", "sensor_noise", "height_sigma_m", "albedo_sigma", "nothing"]
)
def test_products_are_those_of_the_dense_covariance(alone):
    model = MODEL
    for name in ("sensor_noise", "height_sigma_m", "albedo_sigma"):
        if alone not in ("everything", name):
            model = dataclasses.replace(model, **{name: 0.0})
    errors = sources(1)
    fields = np.random.default_rng(2).normal(size=(2, 3, 9, 9)).astype(np.float32)
    products, variance = noise_products(fields, errors, model, CELL_M)
    assert (products > 0).any() == (alone != "nothing")
    for k in range(2):
        covariance, flat = dense(errors, k, model), fields[k].reshape(3, -1).astype(np.float64)
        expected = flat @ covariance @ flat.T
        scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected))).max()
        np.testing.assert_allclose(products[k], expected, atol=2e-5 * scale, rtol=0)
        assert variance[k] == pytest.approx(np.diag(covariance).mean(), rel=2e-5)


def made_noise(errors: PatchErrors, count: int, fine: int = 4) -> np.ndarray:
    """Noise (count, p, p) of patch 0 from fields on a grid ``fine`` times finer, made by Fourier
    transforms: height errors, whose slopes are exact derivatives, and brightness, both as means over
    pixels; and white noise of pixels.
    """
    rng, p = np.random.default_rng(3), errors.level.shape[1]
    size, step = 4 * p * fine, CELL_M / fine
    k = 2.0 * np.pi * np.fft.fftfreq(size, step)
    kx, ky = k[None, :], k[:, None]

    def spectrum(sigma, length):
        power = np.exp(-0.5 * length**2 * (kx**2 + ky**2))
        return sigma * np.sqrt(power / power.mean())

    heights = spectrum(MODEL.height_sigma_m, MODEL.height_length_m)
    albedo = spectrum(MODEL.albedo_sigma, MODEL.albedo_length_m)
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
        noise.append(one + MODEL.sensor_noise * rng.normal(size=(p, p)))
    return np.array(noise)


def test_products_are_those_of_random_fields():
    """Within 3 standard errors of 1500 draws (11 %)."""
    errors = sources(4, n=1)
    y, x = np.mgrid[0:9, 0:9] / 8.0
    fields = np.stack([np.ones((9, 9)), np.cos(3 * x), np.sin(5 * y) * x, x - y])[None]
    products, variance = noise_products(fields.astype(np.float32), errors, MODEL, CELL_M)
    noise = made_noise(errors, 1500)
    found = np.einsum("aij,nij->na", fields[0], noise)
    scale = np.sqrt(np.outer(np.diag(products[0]), np.diag(products[0])))
    np.testing.assert_allclose(np.cov(found.T) / scale, products[0] / scale, atol=0.11)
    assert noise.var() == pytest.approx(variance[0], rel=0.05)


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
    for name in MODEL.to_dict():
        for bad in (-0.1, math.inf, math.nan):
            with pytest.raises(ConfigError, match=rf"errors\.{name} must be"):
                dataclasses.replace(MODEL, **{name: bad})
    for name in ("height_length_m", "albedo_length_m"):
        with pytest.raises(ConfigError, match=rf"errors\.{name} must be above 0"):
            dataclasses.replace(MODEL, **{name: 0.0})
