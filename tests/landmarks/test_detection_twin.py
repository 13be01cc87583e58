"""Detection probability and covariance of the match against sums written out in NumPy and SciPy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.twins_detection import (
    Surroundings,
    correlation,
    further_rise,
    noise_field,
    probability_among,
    refined_probability,
    shift_covariance,
    sixth_order_slopes,
)
from scipy.ndimage import map_coordinates, maximum_filter, spline_filter
from scipy.optimize import least_squares
from scipy.stats import norm

from lcp_catalog.kernels.matching.acquisition import slope_of_noise
from lcp_catalog.landmarks.detection import (
    clearance,
    detection_probability,
    mistake_probability,
    settling_probability,
    top_probability,
)
from lcp_catalog.landmarks.error_model import ErrorModel, PatchErrors
from lcp_catalog.landmarks.localization import registration
from lcp_catalog.landmarks.uniqueness import RING, other_places

CELL_M = 100.0
NODES, SEARCH = 17, 20


def ground(seed: int, length: float = 2.5, nodes: int = 120) -> np.ndarray:
    """Brightness of relief without shadows, mean 1."""
    return (1.0 + 0.2 * noise_field(np.random.default_rng(seed), nodes, length)).astype(np.float32)


def around(seed: int) -> Surroundings:
    return Surroundings.of(ground(seed), 60, 60, NODES // 2, SEARCH)


def noise_model(level: float, length: float) -> ErrorModel:
    """Noise of 1 sigma ``level`` with a correlation length in nodes, on uniform ground. The library's is a mean over a pixel:
    l^2 wider by 1/6, the variance less by (l / wider)^2.
    """
    if length == 0.0:
        return ErrorModel(sensor_noise=level, height_sigma_m=0.0, albedo_sigma=0.0)
    inner = np.sqrt(length**2 - 1.0 / 6.0)
    return ErrorModel(0.0, 0.0, 500.0, level * length / inner, inner * CELL_M, 0.0)


def near_places(image: np.ndarray, patch: np.ndarray, at: int):
    """Correlations and contrasts at the distances `RING` from (at, at), (1, k) each."""
    centre = np.array([at])
    found = other_places(
        image.astype(np.float32)[None], patch[None].astype(np.float32), centre, centre, 2
    )
    return found.near, found.near_contrast


def library(patch: np.ndarray, level: float, length: float):
    patches = patch[None].astype(np.float32)
    even = np.ones_like(patches)
    errors = PatchErrors(even, 0.0 * even, 0.0 * even)
    return registration(patches, errors, noise_model(level, length), CELL_M)


def noise_at_place(match) -> tuple[float, float]:
    """g and g / G of a match (`further_rise`)."""
    power = match.contrast[0] ** 2 + match.noise_variance[0]
    return slope_of_noise(match.covariance_px2[0], match.slope_noise[0] / (match.pixels[0] * power))


@pytest.mark.parametrize("length", [0.0, 1.5, 4.0])
@pytest.mark.parametrize("seed", [1, 2])
def test_probability_among_given_rivals(seed, length):
    place = around(seed)
    dice = np.random.default_rng(seed)
    for level in (0.05, 0.3, 1.0):
        rho, contrast = dice.uniform(-0.2, 0.9, 9), dice.uniform(0.02, 0.4, 9)
        match = replace(library(place.patch, level, length), shift_loss=np.zeros(1))
        for least, clear in ((-1.0, 0.0), (0.3, 0.0), (0.3, clearance())):
            found = detection_probability(
                match, rho[None], contrast[None], 1.0, least, clear_by=clear
            )[0][0]
            said = probability_among(
                place.patch, level, length, rho, contrast, least, clear, *noise_at_place(match)
            )
            assert found == pytest.approx(said, abs=0.01)


@pytest.mark.slow
def test_clearance_is_what_the_search_asks():
    """Two correlations that far apart are the limit of `mistake_probability` that a search accepts."""
    assert clearance() == pytest.approx(norm.ppf(0.8), abs=1e-12)
    assert clearance(0.9) == 0.0  # Bayes: 0.2 x 0.9 above 0.8 x 0.1
    dice = np.random.default_rng(3)
    template = noise_field(dice, 17, 2.0)[None].astype(np.float32)
    mask = np.ones((1, 17, 17), bool)
    for prior in (0.3, 0.5, 0.7):
        seconds = np.linspace(0.2, 0.6, 4001)
        many = (np.repeat(a, len(seconds), axis=0) for a in (template, mask))
        wrong = mistake_probability(
            np.full(seconds.shape, 0.6), seconds, *many, np.full(seconds.shape, 0.5), prior
        )
        at = np.searchsorted(wrong, 0.2)
        right = 1.0 - norm.cdf(clearance(prior))
        assert right * (1 - prior) / (right * (1 - prior) + (1 - right) * prior) == pytest.approx(
            0.2
        )
        assert 0 < at < len(seconds)


def test_a_search_that_refuses_ambiguous_places():
    """The share of 200 000 draws of normal correlations in which the true place exceeds all others clearly enough."""
    place, dice = around(2), np.random.default_rng(5)
    rho, contrast = np.array([0.7, 0.5, 0.4]), np.array([0.3, 0.2, 0.2])
    match = library(place.patch, 0.3, 1.5)
    match = replace(match, shift_loss=np.zeros(1), slope_noise=np.zeros((1, 2, 2)))  # no rise
    given = (match.contrast[0], contrast), (1.0, rho)
    (own, others), (own_rho, others_rho) = given
    size = np.append(own, others) ** 2 + match.noise_variance[0]
    mean = np.append(own_rho, others_rho) * np.append(own, others) / np.sqrt(size)
    variance = match.along[0] / match.pixels / size
    variance *= 1.0 - mean**2 * (1.0 + 0.5 * match.noise_variance[0] / size)
    draws = mean + np.sqrt(variance) * dice.normal(size=(200_000, 4))
    needed = draws[:, 1:] + 0.8416 * np.sqrt(variance[0] + variance[1:])
    share = np.mean((draws[:, :1] > needed).all(axis=1) & (draws[:, 0] > 0.3))
    found = detection_probability(match, rho[None], contrast[None], clear_by=clearance())
    assert 0.1 < share < 0.9
    assert found[0][0] == pytest.approx(share, abs=0.01)
    plain = detection_probability(match, rho[None], contrast[None])
    np.testing.assert_allclose(
        found[2], plain[2], atol=1e-6
    )  # whatever is asked, the highest is the highest


def test_broad_peaks_lose_fits():
    match = library(around(1).patch, 0.3, 1.5)
    for sigma, kept in ((0.2, 1.0), (0.55, 0.925), (1.0, 0.79), (9.0, 0.0), (np.inf, 0.0)):
        covariance = np.diag([sigma**2, 0.01])[None]
        found = settling_probability(replace(match, covariance_px2=covariance))
        assert found[0] == pytest.approx(kept, abs=1e-9)
    # shares of 3568 searches that were lost, by sigma: those of `detection._LOST`
    for sigma, lost in (
        (0.25, 0.01),
        (0.45, 0.04),
        (0.55, 0.08),
        (0.7, 0.12),
        (1.0, 0.21),
        (1.5, 0.37),
    ):
        covariance = np.diag([sigma**2, 0.01])[None]
        found = settling_probability(replace(match, covariance_px2=covariance))
        assert found[0] == pytest.approx(1.0 - lost, abs=0.0101)  # "within 0.01", as its row says


@pytest.mark.parametrize("length", [0.0, 1.5, 4.0])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_covariance_of_the_match(seed, length):
    patch = around(seed).patch
    found = library(patch, 0.1, length).covariance_px2[0]
    said = shift_covariance(patch, 0.1, length, sixth_order_slopes(patch))
    np.testing.assert_allclose(found, said, rtol=2e-3, atol=1e-7)


@pytest.mark.parametrize(("length", "level"), [(0.0, 0.6), (1.5, 0.3), (4.0, 0.15)])
def test_the_twin_predicts_what_searches_find(length, level):
    """Exhaustive searches in 60 draws of noise for each of 12 places."""
    dice = np.random.default_rng(7)
    said, seen = [], []
    for seed in range(12):
        place = around(seed)
        said.append(refined_probability(place, level, length))
        hits = 0
        for _ in range(60):
            noisy = place.image + level * noise_field(dice, len(place.image), length)
            score = correlation(noisy, place.patch)
            top = np.array(np.unravel_index(np.argmax(score), score.shape)) - SEARCH
            hits += np.hypot(*top) <= 2.0
        seen.append(hits / 60)
    print(np.round(said, 2), seen)
    assert 0.2 < np.mean(seen) < 0.98  # the noise matters
    assert np.mean((np.array(said) - seen) ** 2) < 0.015
    assert np.mean(said) == pytest.approx(np.mean(seen), abs=0.05)


def test_noise_has_the_stated_autocorrelation():
    field = np.stack([noise_field(np.random.default_rng(k), 128, 3.0) for k in range(20)])
    assert field.var() == pytest.approx(1.0, abs=0.03)
    assert np.mean(field[:, :, 3:] * field[:, :, :-3]) == pytest.approx(np.exp(-0.5), abs=0.03)


def test_bias_by_a_shadow_against_a_fit():
    """A shaded corner moves the match; the reference is SciPy's least squares on shift, gain and offset with the patch's spline."""
    place = around(4)
    size, margin = len(place.patch), SEARCH
    surface = spline_filter(place.image, order=3)
    grid = np.indices((size, size)) + margin
    patch = place.patch
    change = np.zeros_like(patch)
    change[:5, :6] = -0.05 * patch[:5, :6]

    def residual(x):
        model = map_coordinates(surface, grid - x[[1, 0], None, None], order=3, prefilter=False)
        return (x[2] * model + x[3] - patch - change).ravel()

    fitted = least_squares(residual, [0.0, 0.0, 1.0, 0.0]).x[:2]
    assert np.hypot(*fitted) > 0.02
    even = np.ones((1, size, size), np.float32)

    def matched(patches: np.ndarray, images: np.ndarray):
        seen = PatchErrors(images.astype(np.float32), 0.0 * even, 0.0 * even)
        return registration(patches, seen, noise_model(0.1, 0.0), CELL_M)

    found = matched(patch[None], patch[None] + change)
    np.testing.assert_allclose(found.bias[0], fitted, atol=0.2 * np.hypot(*fitted))
    own = np.corrcoef(patch.ravel(), (patch + change).ravel())[0, 1]
    assert found.own[0] == pytest.approx(own, abs=1e-6)
    assert own < 0.997
    alike = matched(patch[None], patch[None])
    np.testing.assert_allclose(alike.bias, 0.0, atol=1e-6)
    assert alike.own[0] == pytest.approx(1.0, abs=1e-6)
    assert np.isinf(matched(even, even).bias).all()
    assert matched(even, even).own[0] == 0.0
    assert matched(patch[None], even).own[0] == 0.0


def test_places_around_against_opencv():
    place = around(5)
    found, contrast = near_places(place.image, place.patch, len(place.image) // 2)
    cols, rows = RING.T
    assert len(RING) == 16
    at = rows + SEARCH, cols + SEARCH
    np.testing.assert_allclose(found[0], place.correlation[at], atol=2e-5)
    np.testing.assert_allclose(contrast[0], place.contrast[at], rtol=1e-4)
    edge = NODES // 2
    for part in near_places(place.image, place.image[:NODES, :NODES], edge):
        np.testing.assert_array_equal(np.isnan(part[0]), (cols < 0) | (rows < 0))


@pytest.mark.parametrize(
    ("relief", "length", "level"),
    [(1.7, 0.0, 0.4), (1.7, 1.5, 0.2), (4.0, 1.5, 0.2), (4.0, 3.0, 0.2)],
)
def test_noise_raises_tops_against_draws(relief, length, level):
    """By how much more than at the true place the highest pixel within 2.5 of other peaks exceeds that at the peak, in 30 draws
    over 4 patches, on two grounds that the formula was not fitted to.
    """
    dice = np.random.default_rng(1)
    near = np.hypot(*(np.indices((5, 5)) - 2)) <= 2.5
    found, said = [], []
    for seed in range(4):
        place = Surroundings.of(ground(seed, relief), 60, 60, NODES // 2, SEARCH)
        match = library(place.patch, level, length)
        height = place.correlation * place.contrast
        height /= np.sqrt(place.contrast**2 + match.noise_variance[0])
        height /= height[SEARCH, SEARCH]
        tops = np.argwhere(place.tops() & (height > 0.2))
        inner = tops[(tops >= 3).all(axis=1) & (tops <= 2 * SEARCH - 3).all(axis=1)]
        rows, cols = inner.T
        own = np.flatnonzero((inner == SEARCH).all(axis=1))
        seen = np.zeros(len(inner))
        for _ in range(30):
            noisy = place.image + level * noise_field(dice, len(place.image), length)
            score = correlation(noisy, place.patch)
            highest = maximum_filter(score, footprint=near)
            seen += (highest - score)[rows, cols] / 30
        others = np.hypot(*(inner - SEARCH).T) > 4
        slope, steep = noise_at_place(match)
        found += (seen - seen[own])[others].tolist()
        said += further_rise(slope, steep, height[rows, cols])[others].tolist()
    assert len(found) >= 18
    assert np.mean(found) > 0.02  # the noise matters
    assert np.mean(said) == pytest.approx(np.mean(found), abs=0.012)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("length", "level", "bound"),
    [
        (0.0, 0.8, 0.1),
        (1.5, 0.3, 0.1),
        (4.0, 0.25, 0.1),
        (0.0, 0.35, 0.03),
        (1.5, 0.18, 0.03),
        (4.0, 0.13, 0.03),
    ],
)
def test_top_probability_against_draws(length, level, bound):
    """Share of 200 draws of the noise in which the highest correlation within 2.5 nodes is above all those around, over 10 broad
    peaks; the bounds are those that the function states.
    """
    dice = np.random.default_rng(11)
    said, seen = [], []
    for seed in range(10):
        place = Surroundings.of(ground(seed, 5.0), 60, 60, NODES // 2, 6)
        cols, rows = RING.T
        near = near_places(place.image, place.patch, len(place.image) // 2)
        said.append(top_probability(library(place.patch, level, length), RING, *near)[0])
        inside, above = np.hypot(*(np.indices((13, 13)) - 6)) <= 2.5, 0
        for _ in range(200):
            noisy = place.image + level * noise_field(dice, len(place.image), length)
            score = correlation(noisy, place.patch)
            above += score[inside].max() > score[rows + 6, cols + 6].max()
        seen.append(above / 200)
    assert abs(np.mean(said) - np.mean(seen)) < bound
    assert np.mean(seen) < 0.99  # the noise matters
