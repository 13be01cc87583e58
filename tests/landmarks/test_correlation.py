"""Weighted centred correlation against NumPy's covariance with weights, and its degenerate cases."""

from __future__ import annotations

import numpy as np
import pytest

from lcp_catalog.landmarks.correlation import moments


@pytest.mark.parametrize("level", [0.0, 1e4])
def test_moments_are_those_of_numpy(level):
    rng = np.random.default_rng(0)
    a = rng.normal(size=(40, 60)) + level
    b = 0.5 * a + rng.normal(size=a.shape)
    weight = rng.random(a.shape) * (rng.random(a.shape) < 0.8)
    for w in (np.ones_like(a), weight):
        found = moments(a, b, None if w is not weight else w)
        expected = np.array([np.cov(*pair, aweights=v, ddof=0) for *pair, v in zip(a, b, w, strict=True)])  # fmt: skip
        mass = w.sum(axis=1)
        np.testing.assert_allclose(found.weight, mass)
        np.testing.assert_allclose(found.aa / mass, expected[:, 0, 0], rtol=1e-9)
        np.testing.assert_allclose(found.ab / mass, expected[:, 0, 1], rtol=1e-9)
        np.testing.assert_allclose(found.deviation_b**2, expected[:, 1, 1], rtol=1e-9)
        r = expected[:, 0, 1] / np.sqrt(expected[:, 0, 0] * expected[:, 1, 1])
        np.testing.assert_allclose(found.correlation, r, rtol=1e-9)


def test_one_pair_without_weights_is_numpys_corrcoef():
    a, b = np.random.default_rng(1).normal(size=(2, 50))
    assert moments(a, b).correlation == pytest.approx(np.corrcoef(a, b)[0, 1])
    assert moments(a, -3.0 * a + 7.0).correlation == pytest.approx(-1.0)


def test_constant_empty_and_weightless_samples_correlate_zero():
    a = np.random.default_rng(2).normal(size=50)
    constant = np.full(50, 0.1)  # its mean is not exactly 0.1: the rest is rounding
    assert moments(a, constant).correlation == 0.0
    assert moments(constant, a).correlation == 0.0
    assert moments(a[:0], a[:0]).correlation == 0.0
    assert moments(a, a, np.zeros(50)).correlation == 0.0
    assert moments(a, a, np.zeros(50)).deviation_b == 0.0
