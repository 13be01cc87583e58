"""Uniqueness: the second peak against plain NumPy, with copies and gaps, and the statistics against
simulated noise.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lcp_catalog.landmarks.patches import gather_patches
from lcp_catalog.landmarks.uniqueness import (
    effective_samples,
    expected_correlation,
    false_match_probability,
    second_peak,
)

HALF, SEARCH = 8, 20


def field(seed, shape=(120, 120), smooth=1.5, level=1.0, contrast=0.1):
    """White noise smoothed by a Gaussian of ``smooth`` nodes, periodic."""
    rng = np.random.default_rng(seed)
    fy, fx = np.fft.fftfreq(shape[0])[:, None], np.fft.fftfreq(shape[1])[None, :]
    transfer = np.exp(-2.0 * (np.pi * smooth) ** 2 * (fx**2 + fy**2))
    z = np.fft.ifft2(np.fft.fft2(rng.normal(size=shape)) * transfer).real
    return (level + contrast * z / z.std()).astype(np.float32)


def crater(image, row, col, radius=4.0):
    r, c = np.mgrid[0 : image.shape[0], 0 : image.shape[1]]
    away = np.hypot(r - row, c - col) / radius
    image += (np.exp(-(away**2)) * (c - col) / radius).astype(np.float32)


def naive_map(image, row, col, half, search):
    """Centred normalised correlation of every place in the search square, float64 loops."""
    image = image.astype(float)
    cut = lambda r, c: image[r - half : r + half + 1, c - half : c + half + 1]  # noqa: E731
    t = cut(row, col) - cut(row, col).mean()
    r0, r1 = max(half, row - search), min(image.shape[0] - half - 1, row + search)
    c0, c1 = max(half, col - search), min(image.shape[1] - half - 1, col + search)
    out = np.zeros((r1 - r0 + 1, c1 - c0 + 1))
    for r in range(r0, r1 + 1):
        for c in range(c0, c1 + 1):
            w = cut(r, c) - cut(r, c).mean()
            power = (w * w).sum() * (t * t).sum()
            out[r - r0, c - c0] = (w * t).sum() / np.sqrt(power) if power > 1e-12 else 0.0
    return out, r0 - row, c0 - col


def naive_second_peak(image, row, col, half, search, exclusion):
    score, dr, dc = naive_map(image, row, col, half, search)
    best = -1.0
    for i, j in np.ndindex(score.shape):
        around = score[max(0, i - 1) : i + 2, max(0, j - 1) : j + 2]
        if np.hypot(i + dr, j + dc) > exclusion and score[i, j] >= around.max():
            best = max(best, score[i, j])
    return best


PLACES = [(60, 60), (60, 20), (10, 60), (111, 111), (30, 95)]


@pytest.mark.parametrize("smooth", [0.5, 1.5, 4.0])
def test_the_exact_result_is_that_of_plain_numpy(smooth):
    image = field(1, smooth=smooth)
    rows, cols = np.array(PLACES).T
    expected = [naive_second_peak(image, r, c, HALF, SEARCH, HALF) for r, c in PLACES]
    np.testing.assert_allclose(
        second_peak(image, rows, cols, HALF, SEARCH, exact=True), expected, atol=2e-5
    )
    expected = [naive_second_peak(image, r, c, HALF, SEARCH, 3.5) for r, c in PLACES[:2]]
    found = second_peak(image, rows[:2], cols[:2], HALF, SEARCH, exclusion=3.5, exact=True)
    np.testing.assert_allclose(found, expected, atol=2e-5)


def test_half_resolution_first_loses_little_and_never_gains():
    image = field(2, (300, 300), smooth=2.0)
    rng = np.random.default_rng(0)
    rows, cols = rng.integers(80, 220, size=(2, 200))
    exact = second_peak(image, rows, cols, 16, 60, exact=True)
    quick = second_peak(image, rows, cols, 16, 60)
    assert (quick <= exact + 1e-5).all()
    assert np.mean(exact - quick > 1e-4) < 0.1
    assert np.sqrt(np.mean((exact - quick) ** 2)) < 0.02
    assert np.corrcoef(exact, quick)[0, 1] > 0.98


@pytest.mark.parametrize("exact", [True, False])
@pytest.mark.parametrize(("dr", "dc"), [(0, 17), (13, 14), (-19, 6)])
def test_a_second_crater_within_the_search_makes_a_point_ambiguous(exact, dr, dc):
    image = field(3, contrast=0.02)
    crater(image, 60, 60)
    alone = second_peak(image, [60], [60], HALF, SEARCH, exact=exact)[0]
    crater(image, 60 + dr, 60 + dc)
    twin = second_peak(image, [60], [60], HALF, SEARCH, exact=exact)[0]
    assert alone < 0.7
    assert twin > 0.9
    nearer = max(abs(dr), abs(dc)) - 4
    assert (
        second_peak(image, [60], [60], HALF, nearer, exact=exact)[0] < 0.8
    )  # outside the search it has no effect


def test_the_flank_of_a_broad_main_lobe_is_no_second_peak():
    row, col = np.mgrid[0:120, 0:120] - 60.0
    image = np.exp(-(row**2 + col**2) / (2 * 12.0**2)).astype(np.float32)
    score, dr, dc = naive_map(image, 60, 60, HALF, SEARCH)
    # just outside an exclusion of 3 nodes the correlation is that of the main lobe
    assert score[-dr, 4 - dc] > 0.6
    assert second_peak(image, [60], [60], HALF, SEARCH, exclusion=3, exact=True)[0] < 0.4


def test_a_ridge_without_change_along_itself_is_ambiguous():
    row, _ = np.mgrid[0:120, 0:120] - 60.0
    image = np.exp(-(row**2) / 18.0).astype(np.float32)
    for exact in (True, False):
        assert second_peak(image, [60], [60], HALF, SEARCH, exact=exact)[0] == pytest.approx(
            1.0, abs=1e-4
        )


@given(st.integers(0, 50), st.floats(1e-2, 1e2), st.floats(-5.0, 5.0))
@settings(max_examples=20)
def test_gain_and_offset_do_not_matter(seed, gain, offset):
    image = field(seed, (70, 70))
    changed = (image * gain + offset * gain).astype(np.float32)
    for exact in (True, False):
        one, other = (
            second_peak(z, [35], [35], HALF, SEARCH, exact=exact) for z in (image, changed)
        )
        np.testing.assert_allclose(one, other, atol=2e-3)


@pytest.mark.parametrize("flip", [np.flipud, np.fliplr, np.transpose])
def test_a_mirrored_image_has_the_same_second_peak(flip):
    image = field(4, (121, 121))
    one = second_peak(image, [60], [60], HALF, SEARCH, exact=True)
    other = second_peak(np.ascontiguousarray(flip(image)), [60], [60], HALF, SEARCH, exact=True)
    np.testing.assert_allclose(one, other, atol=1e-5)


def test_shifted_terrain_has_the_same_second_peak():
    image = field(5, (140, 140))
    one = second_peak(image, [70], [70], HALF, SEARCH, exact=True)
    other = second_peak(np.ascontiguousarray(image[13:, 22:]), [57], [48], HALF, SEARCH, exact=True)
    np.testing.assert_allclose(one, other, atol=1e-5)


@pytest.mark.parametrize("exact", [True, False])
def test_gaps_shadow_and_flat_terrain_correlate_with_nothing(exact):
    image = field(6)
    image[:, 75:90] = np.nan
    image[:45, :] = 0.0
    image[85:, :70] = 0.25
    image[50:54, 62:66] = np.nan  # a gap in the patch itself
    found = second_peak(image, [60], [60], HALF, SEARCH, exact=exact)[0]
    assert np.isfinite(found)
    assert -1.0 <= found < 0.8
    only = np.full((120, 120), 0.5, np.float32)
    only[52:69, 52:69] = field(7)[52:69, 52:69]
    score = second_peak(only, [60], [60], HALF, 40, exclusion=3 * HALF, exact=exact)[0]
    assert score == 0.0  # flat terrain all around, where no window touches the patch


@pytest.mark.parametrize("exact", [True, False])
def test_degenerate_points(exact):
    image = field(8)
    image[:40, :40] = 0.7
    found = second_peak(image, [20, 3, 60], [20, 60, 117], HALF, SEARCH, exact=exact)
    assert found[0] == 1.0  # a flat patch is not unique
    assert np.isnan(found[1:]).all()  # the patch is cut by the border
    assert (
        second_peak(image, [60], [60], HALF, 4, exact=exact)[0] == -1.0
    )  # no other place within the search
    assert second_peak(image, [], [], HALF, SEARCH, exact=exact).shape == (0,)
    blank = np.full((60, 60), np.nan, np.float32)
    assert second_peak(blank, [30], [30], HALF, SEARCH, exact=exact)[0] == 1.0


@pytest.mark.parametrize("noise", [0.02, 0.1, 0.3])
def test_expected_correlation_is_the_mean_over_noisy_images(noise):
    patch = field(9, (33, 33))
    rng = np.random.default_rng(0)
    level = patch.mean()
    noisy = [
        np.corrcoef(patch.ravel(), (patch + noise * level * rng.normal(size=patch.shape)).ravel())[
            0, 1
        ]
        for _ in range(200)
    ]
    assert expected_correlation(patch[None], noise)[0] == pytest.approx(np.mean(noisy), abs=0.01)


def test_expected_correlation_of_what_has_no_contrast():
    flat, gap = np.ones((1, 9, 9), np.float32), np.ones((1, 9, 9), np.float32)
    gap[0, 1, 1] = np.nan
    found = expected_correlation(np.concatenate([flat, gap, 0 * flat]), 0.02)
    assert found.tolist() == [0.0, 0.0, 0.0]
    shadowed = field(9, (9, 9))[None]
    shadowed[0, :4] = 0.0  # noise is relative to the lit level
    lit = shadowed[shadowed > 0].mean()
    assert expected_correlation(shadowed, 0.1)[0] == pytest.approx(
        1 / np.hypot(1, 0.1 * lit / shadowed.std()), rel=1e-5
    )


@pytest.mark.parametrize("smooth", [0.0, 1.0, 2.0, 4.0])
def test_effective_samples_give_the_scatter_of_correlations(smooth):
    size, count = 33, 300
    a, b = (
        np.stack([field(1000 * k + s, (132, 132), smooth)[:size, :size] for s in range(count)])
        for k in (1, 2)
    )
    x, y = (
        (z - z.mean(axis=(1, 2), keepdims=True)).reshape(count, -1).astype(float) for z in (a, b)
    )
    r = (x * y).sum(axis=1) / np.sqrt((x * x).sum(axis=1) * (y * y).sum(axis=1))
    stated = np.median(effective_samples(a))
    assert stated == pytest.approx(1.0 / np.mean(r**2), rel=0.2)


def test_effective_samples_stay_in_bounds():
    row, _ = np.mgrid[0:33, 0:33]
    patches = np.stack([np.ones((33, 33)), np.sin(row / 5.0), np.where(row < 20, np.nan, 1.0)])
    found = effective_samples(patches.astype(np.float32))
    assert ((found >= 1.0) & (found <= 33 * 33)).all()
    assert found[0] == found[2] == 1.0


def test_false_matches_are_as_frequent_as_stated():
    """Two pairs of fields with known correlations and independent samples: frequency with which the
    lower one comes out higher.
    """
    n, rng = 60, np.random.default_rng(0)
    truth, second = 0.6, 0.45
    x = rng.normal(size=(2, 20000, n))
    e = rng.normal(size=(2, 20000, n))
    rho = np.array([truth, second])[:, None, None]
    y = rho * x + np.sqrt(1.0 - rho**2) * e
    x, y = x - x.mean(axis=2, keepdims=True), y - y.mean(axis=2, keepdims=True)
    r = (x * y).sum(axis=2) / np.sqrt((x * x).sum(axis=2) * (y * y).sum(axis=2))
    stated = false_match_probability(np.array([truth]), np.array([second]), np.array([n]))[0]
    assert stated == pytest.approx(np.mean(r[1] > r[0]), abs=0.01)


def test_false_match_probability_at_its_ends():
    p = false_match_probability
    assert p(0.9, 0.9, 50.0) == pytest.approx(0.5)
    assert p(0.99, 0.2, 3.0) == pytest.approx(0.5)
    assert p(1.0, 0.2, 500.0) < 1e-12
    assert p(0.2, 1.0, 500.0) == pytest.approx(1.0)
    assert p(1.0, -1.0, 1000.0) == 0.0
    steps = p(np.full(9, 0.95), np.linspace(-1, 1, 9), np.full(9, 20.0))
    assert (np.diff(steps) > 0).all()
    assert p(np.zeros(0), np.zeros(0), np.zeros(0)).shape == (0,)


def test_the_chain_for_many_points():
    image = field(10, (160, 160))
    rows, cols = np.array([60, 80, 100]), np.array([70, 80, 90])
    patches = gather_patches(image, rows, cols, HALF)
    chance = false_match_probability(
        expected_correlation(patches, 0.02),
        second_peak(image, rows, cols, HALF, SEARCH),
        effective_samples(patches),
    )
    assert ((chance >= 0.0) & (chance < 0.05)).all()


@pytest.mark.parametrize("exact", [True, False])
def test_two_gaps_of_the_same_shape_do_not_correlate(exact):
    image = field(11)
    for col in (60, 80):
        image[54:67, col - 6 : col + 3] = np.nan
    assert second_peak(image, [60], [60], HALF, SEARCH, exact=exact)[0] < 0.6


def test_a_high_level_does_not_reduce_precision():
    image = field(12, contrast=1.0, level=0.0)
    rows, cols = np.array(PLACES).T
    low, high = (
        second_peak(z, rows, cols, HALF, SEARCH, exact=True)
        for z in (image, image + np.float32(3000))
    )
    np.testing.assert_allclose(low, high, atol=1e-3)


def test_an_ascent_that_ends_inside_the_exclusion_is_no_second_peak():
    image = field(13, (300, 300), smooth=4.0)
    rows, cols = np.random.default_rng(1).integers(60, 240, size=(2, 150))
    exact, quick = (second_peak(image, rows, cols, HALF, SEARCH, 4.0, e) for e in (True, False))
    assert (quick <= exact + 1e-5).all()
