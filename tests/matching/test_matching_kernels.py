"""Kernels of the search, each compared with plain Python: correlation, sub-pixel fit, backward
search.
"""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from helpers.match_frames import hadley_photo
from hypothesis import given, settings
from hypothesis import strategies as st

from lcp_catalog.kernels.matching import correlation, point_spread, search, subpixel_fit
from lcp_catalog.kernels.matching.backward_search import find_backwards
from lcp_catalog.matching.point_search import SearchImage

photo = pytest.fixture(hadley_photo, scope="module")


# -- correlation


def brute_correlation(window, values, mask):
    a, b = window[mask].astype(np.float64), values[mask].astype(np.float64)
    a, b = a - a.mean(), b - b.mean()
    return (a * b).sum() / np.sqrt((a * a).sum() * (b * b).sum())


@settings(max_examples=30, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    rows=st.integers(2, 9),
    cols=st.integers(2, 11),
    level=st.floats(-1e3, 1e3),
)
def test_correlations_are_the_masked_normalised_ones(seed, rows, cols, level):
    rng = np.random.default_rng(seed)
    image = (rng.standard_normal((26, 31)) + level).astype(np.float32)
    values, mask = (
        rng.standard_normal((rows, cols)).astype(np.float32),
        rng.random((rows, cols)) < 0.7,
    )
    if mask.sum() < 3:
        return
    template = np.empty(values.shape, np.float32)
    count = correlation.centred(values, mask, template)
    ones = np.ones(image.shape, np.float32)
    score, real, _ = correlation.correlations(image, ones, template, mask, count, 3, 4, 7, 6, 0.7)
    expected = [
        [brute_correlation(image[r : r + rows, c : c + cols], values, mask) for c in range(4, 10)]
        for r in range(3, 10)
    ]
    np.testing.assert_allclose(score, expected, atol=2e-4)
    assert (count, real) == (mask.sum(), 1.0)


def test_correlations_are_those_of_opencv(photo):
    image = SearchImage.of(photo)
    values = np.ascontiguousarray(image.fine[100:121, 90:109])
    template = np.empty(values.shape, np.float32)
    whole = np.ones(values.shape, bool)
    count = correlation.centred(values, whole, template)
    ones = np.ones(image.fine.shape, np.float32)
    score, _, _ = correlation.correlations(
        image.fine, ones, template, whole, count, 60, 50, 81, 81, 0.7
    )
    expected = cv2.matchTemplate(image.fine[60:161, 50:149], values, cv2.TM_CCOEFF_NORMED)
    np.testing.assert_allclose(score, expected, atol=1e-5)
    assert np.unravel_index(np.argmax(score), score.shape) == (40, 40)


def test_places_with_too_little_that_is_real_are_not_looked_at():
    rng = np.random.default_rng(3)
    image, weight = rng.standard_normal((20, 20)).astype(np.float32), np.ones((20, 20), np.float32)
    weight[:, :8] = 0.0
    values, mask = rng.standard_normal((5, 5)).astype(np.float32), np.ones((5, 5), bool)
    template = np.empty((5, 5), np.float32)
    count = correlation.centred(values, mask, template)
    score, real, _ = correlation.correlations(
        image, weight, template, mask, count, 0, 0, 16, 16, 0.7
    )
    # of 5 columns 0.7 are 3.5: from column 7 on four of them are real
    assert (score[:, :7] == correlation.NOWHERE).all()
    assert (score[:, 7:] >= -1.0).all()
    assert real == 1.0


def test_a_peak_at_the_edge_of_the_search_counts_and_reach_is_kept():
    rng = np.random.default_rng(8)
    image = cv2.GaussianBlur(rng.standard_normal((90, 90)).astype(np.float32), (0, 0), 1.5)
    half = cv2.resize(image, (45, 45), interpolation=cv2.INTER_AREA)
    ones, half_ones = np.ones((90, 90), np.float32), np.ones((45, 45), np.float32)
    values, mask = image[40:60, 31:51][None].copy(), np.ones((1, 20, 20), bool)
    for reach, (right, down), coarse in [
        (6, (6, -4), True),
        (5, (5, 3), False),
        (9, (-9, 9), True),
    ]:
        out = np.full((1, search.NUMBERS), np.nan)
        origin = np.array([[31 - right, 40 - down]])
        search.find_templates(
            image, ones, half, half_ones, values, mask, origin, np.array([reach]), np.array([10.0]), 0.7,
            np.array([coarse]), out,
        )  # fmt: skip
        assert (out[0, 0], out[0, 1]) == (right, down)
        assert out[0, 2] == pytest.approx(1.0, abs=1e-5)
        assert out[0, 4] == 1.0


# -- the fraction of a pixel


def drawn(seed, size=30, sub=4, smooth=1.3):
    """A drawing with texture and a missing corner."""
    rng = np.random.default_rng(seed)
    fine = 2.0 + cv2.GaussianBlur(
        rng.standard_normal((size * sub, size * sub)), (0, 0), smooth * sub
    )
    fine = 2.0 + (fine - 2.0) / fine.std() * 0.2
    fine[: 6 * sub, : 8 * sub] = np.nan
    return fine.astype(np.float32)[None]


def shifted(fine, sub, sigma, right, down):
    """Result of `point_spread.blurred` for a shifted drawing; 0 where nothing is seen."""
    margin = point_spread.margin_for(sub, sigma, max(abs(right), abs(down)))
    light, known = point_spread.unpack_drawing(fine[0], sub, margin)
    rows, cols = fine.shape[1] // sub, fine.shape[2] // sub
    out = np.empty((4, rows, cols), np.float32)
    point_spread.blurred(light, known, margin, sub, sigma, right, down, out)
    return out[0], out[3]


def refined(fine, sub, sigma, image, weight):
    out = np.full((1, subpixel_fit.NUMBERS), np.nan)
    start = np.zeros((1, 2), np.int64)
    subpixel_fit.refine(fine, sub, sigma, 0.95, image, weight, start, np.zeros((1, 2)), True, out)
    return out[0]


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 1000), right=st.floats(-0.6, 0.6), down=st.floats(-0.6, 0.6),
    gain=st.floats(0.01, 1e4), offset=st.floats(-10, 10),
)  # fmt: skip
def test_any_fraction_is_found_under_any_gain_and_offset(seed, right, down, gain, offset):
    fine = drawn(seed)
    image, cover = shifted(fine, 4, 0.6, right, down)
    result = refined(
        fine,
        4,
        0.6,
        (gain * (image + offset)).astype(np.float32),
        (cover > 0.99).astype(np.float32),
    )
    assert result[:2] == pytest.approx((right, down), abs=2e-3)
    assert result[2] == pytest.approx(1.0, abs=1e-4)
    assert result[6] == pytest.approx(gain, rel=1e-2)


def test_covariance_is_that_of_many_noisy_images_at_every_fraction_of_a_pixel():
    rng = np.random.default_rng(11)
    errors, squares = [], []
    for k in range(400):
        fine = drawn(k % 20)
        right, down = rng.uniform(-0.5, 0.5, 2)
        image, _ = shifted(fine, 4, 0.5, right, down)
        noisy = (image + 0.1 * rng.standard_normal(image.shape)).astype(np.float32)
        result = refined(fine, 4, 0.5, noisy, np.ones(image.shape, np.float32))
        error = result[:2] - (right, down)
        covariance = np.array([[result[3], result[4]], [result[4], result[5]]])
        errors.append([*error, right, down])
        squares.append(error @ np.linalg.solve(covariance, error))
        assert result[7] == pytest.approx(0.1, rel=0.2)
    errors = np.array(errors)
    assert np.mean(squares) == pytest.approx(2.0, rel=0.2)  # Monte Carlo: 2 / sqrt(400) = 0.1
    for axis in (0, 1):  # no locking: the error says nothing of the fraction
        sigma = errors[:, axis].std()
        assert abs(errors[:, axis].mean()) < 4 * sigma / 20
        for low in (-0.5, -0.25, 0.0, 0.25):
            part = (errors[:, 2 + axis] >= low) & (errors[:, 2 + axis] < low + 0.25)
            assert abs(errors[part, axis].mean()) < 4.5 * sigma / np.sqrt(part.sum())


def test_smooth_mismatch_widens_the_covariance():
    rng = np.random.default_rng(5)
    fine, squares, plain = drawn(3), [], []
    image, _ = shifted(fine, 4, 0.5, 0.2, -0.3)
    for _ in range(120):
        wrong = cv2.GaussianBlur(rng.standard_normal(image.shape), (0, 0), 1.5)
        bad = (image + 0.05 * wrong / wrong.std()).astype(np.float32)
        result = refined(fine, 4, 0.5, bad, np.ones(image.shape, np.float32))
        error = result[:2] - (0.2, -0.3)
        covariance = np.array([[result[3], result[4]], [result[4], result[5]]])
        squares.append(error @ np.linalg.solve(covariance, error))
        plain.append(result[9])
    assert np.median(plain) > 0.5
    assert 0.6 < np.mean(squares) < 3.4


def test_the_way_back_ends_where_it_began():
    fine = drawn(7, size=36)
    image, cover = shifted(fine, 4, 0.5, 0.0, 0.0)
    mask = (cover > 0.95)[None]
    values = np.where(mask, image[None], 0).astype(np.float32)
    whole = np.zeros((60, 60), np.float32)
    whole[10:46, 12:48] = image
    ones = np.ones(whole.shape, np.float32)
    for right, down in [(0, 0), (2, -1), (-3, 3)]:
        out = np.full((1, 3), np.nan)
        places = np.array([[12 + right, 10 + down]])
        find_backwards(values, mask, whole, ones, places, 0.6, 5, 0.8, out)
        assert out[0, :2] == pytest.approx((right, down), abs=0.05)
        assert out[0, 2] > 0.99
