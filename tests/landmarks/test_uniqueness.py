"""Other places that resemble a patch, against OpenCV at every place, with copies, borders and gaps."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lcp_catalog.landmarks.patches import gather_patches
from lcp_catalog.landmarks.uniqueness import RIVALS, other_places

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


def others(image, rows, cols, half=HALF, search=SEARCH, **how):
    """Correlations and contrasts of the places that resemble the image's own patches."""
    rows, cols = np.asarray(rows, np.int64), np.asarray(cols, np.int64)
    return other_places(image, gather_patches(image, rows, cols, half), rows, cols, search, **how)


def highest(*given, **how):
    """The highest correlation of each patch with another place; -1 for none."""
    return np.fmax(others(*given, **how)[0][:, 0], -1.0)


def exhaustive(image, row, col, half, search, exclusion):
    """Correlations, best first, and contrasts of all maxima by cv2.matchTemplate in the search square."""
    patch = image[row - half : row + half + 1, col - half : col + half + 1]
    r0, c0 = max(row - search - half, 0), max(col - search - half, 0)
    part = image[r0 : row + search + half + 1, c0 : col + search + half + 1]
    score = cv2.matchTemplate(part, patch, cv2.TM_CCOEFF_NORMED)
    top = score == cv2.dilate(score, np.ones((3, 3)))
    places = [
        (score[i, j], part[i : i + 2 * half + 1, j : j + 2 * half + 1].std(dtype=np.float64))
        for i, j in np.argwhere(top)
        if np.hypot(i + r0 + half - row, j + c0 + half - col) > exclusion
    ]
    return np.array(sorted(places, reverse=True)).reshape(-1, 2).T


PLACES = [(60, 60), (60, 20), (10, 60), (111, 111), (30, 95)]


@pytest.mark.parametrize("smooth", [1.0, 2.0, 4.0])
@pytest.mark.parametrize("exclusion", [2.0, 3.5, 8.0])
def test_all_places_are_those_of_opencv(smooth, exclusion):
    image = field(1, smooth=smooth)
    found, spread = others(image, *np.array(PLACES).T, exclusion=exclusion)
    for k, (row, col) in enumerate(PLACES):
        expected, contrast = exhaustive(image, row, col, HALF, SEARCH, exclusion)
        count = min(len(expected), RIVALS)
        assert count >= 3
        assert np.isfinite(found[k]).sum() == count
        np.testing.assert_allclose(found[k, :count], expected[:count], atol=5e-5)
        # equal correlations may change places; the contrasts belong to the correlations
        np.testing.assert_allclose(spread[k, :count], contrast[:count], rtol=1e-3)


def test_a_patch_of_another_image_is_searched_for_at_its_own_place():
    """The patch rendered alone differs from the image where terrain around it casts shadows."""
    image = field(2)
    alone = image[52:69, 52:69] + field(3, (17, 17), contrast=0.05)
    found, _ = other_places(image, alone[None], np.array([60]), np.array([60]), SEARCH)
    mixed = image.copy()
    mixed[52:69, 52:69] = alone
    score = cv2.matchTemplate(image[32:89, 32:89], alone, cv2.TM_CCOEFF_NORMED)
    top = (score == cv2.dilate(score, np.ones((3, 3)))) & (score < score[SEARCH, SEARCH])
    assert found[0, 0] == pytest.approx(score[top].max(), abs=5e-5)


def test_half_resolution_first_loses_little_and_never_gains():
    image = field(2, (300, 300), smooth=2.0)
    rng = np.random.default_rng(0)
    rows, cols = rng.integers(80, 220, size=(2, 100))
    exact, quick = (highest(image, rows, cols, 16, 60, exact=e) for e in (True, False))
    assert (quick <= exact + 1e-5).all()
    assert np.mean(exact - quick > 1e-4) < 0.1
    assert np.sqrt(np.mean((exact - quick) ** 2)) < 0.02
    found, spread = others(image, rows, cols, 16, 60)
    all_of_them, theirs = others(image, rows, cols, 16, 60, exact=True)
    assert np.isfinite(found).sum() < 0.5 * np.isfinite(all_of_them).sum()  # the lower ones
    assert (np.diff(np.nan_to_num(found, nan=-2.0), axis=1) <= 0.0).all()  # best first
    for k in range(20):
        for rho, contrast in zip(found[k, :3], spread[k, :3], strict=True):
            if np.isfinite(rho):
                same = np.abs(all_of_them[k] - rho) + np.abs(theirs[k] - contrast)
                assert np.nanmin(same) < 1e-4


def test_small_patches_and_areas_are_searched_at_full_resolution():
    image = field(4, (200, 200), smooth=1.0)
    rows, cols = np.random.default_rng(0).integers(60, 140, size=(2, 20))
    for half, search in ((15, 40), (16, 23)):
        one, other = (others(image, rows, cols, half, search, exact=e) for e in (True, False))
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize(("dr", "dc"), [(0, 17), (13, 14), (-19, 6)])
def test_a_second_crater_within_the_search_resembles_the_first(dr, dc):
    image = field(3, contrast=0.02)
    crater(image, 60, 60)
    alone = highest(image, [60], [60])[0]
    crater(image, 60 + dr, 60 + dc)
    twin = highest(image, [60], [60])[0]
    assert alone < 0.7
    assert twin > 0.9
    nearer = max(abs(dr), abs(dc)) - 4
    assert highest(image, [60], [60], search=nearer)[0] < 0.8  # outside the search it has no effect


def test_the_flank_of_a_broad_main_lobe_is_no_other_place():
    row, col = np.mgrid[0:120, 0:120] - 60.0
    image = np.exp(-(row**2 + col**2) / (2 * 12.0**2)).astype(np.float32)
    patch = image[52:69, 52:69].ravel()
    assert np.corrcoef(patch, image[52:69, 56:73].ravel())[0, 1] > 0.6  # 4 nodes away
    assert highest(image, [60], [60], exclusion=3.0)[0] < 0.4


@pytest.mark.parametrize(("half", "search"), [(HALF, SEARCH), (17, 30)])
def test_a_ridge_without_change_along_itself_is_a_chain_of_equal_places(half, search):
    row, _ = np.mgrid[0:120, 0:120] - 60.0
    image = np.exp(-(row**2) / 18.0).astype(np.float32)
    found, spread = others(image, [60], [60], half, search)
    np.testing.assert_allclose(found[0, :4], 1.0, atol=1e-4)
    np.testing.assert_allclose(spread[0, :4], image[60 - half : 61 + half].std(), rtol=1e-3)


@given(st.integers(0, 50), st.floats(1e-2, 1e2), st.floats(-5.0, 5.0))
@settings(max_examples=20)
def test_gain_and_offset_do_not_matter(seed, gain, offset):
    image = field(seed, (70, 70))
    changed = (image * gain + offset * gain).astype(np.float32)
    one, other = (others(z, [35], [35]) for z in (image, changed))
    np.testing.assert_allclose(one[0][0, :8], other[0][0, :8], atol=2e-3)
    np.testing.assert_allclose(one[1][0, :3] * gain, other[1][0, :3], rtol=2e-3)


@pytest.mark.parametrize("flip", [np.flipud, np.fliplr, np.transpose])
def test_a_mirrored_image_has_the_same_places(flip):
    image = field(4, (121, 121))
    one, other = (others(np.ascontiguousarray(z), [60], [60]) for z in (image, flip(image)))
    np.testing.assert_allclose(one, other, atol=1e-5)


def test_shifted_terrain_has_the_same_places():
    image = field(5, (140, 140))
    one = others(image, [70], [70])
    other = others(np.ascontiguousarray(image[13:, 22:]), [57], [48])
    np.testing.assert_allclose(one, other, atol=1e-5)


@pytest.mark.parametrize("half", [HALF, 16])
def test_patches_without_contrast_and_at_borders(half):
    image = field(8)
    image[40:81, 40:81] = 1.0
    found, spread = others(image, [60, 60, half - 1], [60, 20, 60], half, 30)
    assert found[0, 0] == 1.0  # flat: one other place, alike
    assert spread[0, 0] == 0.0
    assert np.isnan(found[0, 1:]).all()
    assert np.isfinite(found[1, 0])
    assert np.isnan(found[2]).all()  # cut by the border
    assert np.isnan(spread[2]).all()
    assert np.isnan(others(image, [60], [20], half, 1)[0]).all()  # no other place in the search
    assert others(image, [], [], half)[0].shape == (0, RIVALS)
    blank = np.full((60, 60), np.nan, np.float32)
    patch = np.zeros((1, 17, 17), np.float32)
    assert other_places(blank, patch, np.array([30]), np.array([30]), SEARCH)[0][0, 0] == 1.0


def test_two_gaps_of_the_same_shape_do_not_correlate():
    image = field(11)
    for col in (60, 80):
        image[54:67, col - 6 : col + 3] = np.nan
    filled = np.where(np.isfinite(image), image, np.nanmean(image)).astype(np.float32)
    patch = filled[52:69, 52:69][None]
    assert other_places(image, patch, np.array([60]), np.array([60]), SEARCH)[0][0, 0] < 0.6


def test_a_high_level_does_not_reduce_precision():
    image = field(12, contrast=1.0, level=0.0)
    rows, cols = np.array(PLACES).T
    low, high = (highest(z, rows, cols) for z in (image, image + np.float32(3000)))
    np.testing.assert_allclose(low, high, atol=1e-3)


def test_an_ascent_that_ends_inside_the_exclusion_is_no_other_place():
    image = field(13, (300, 300), smooth=4.0)
    rows, cols = np.random.default_rng(1).integers(60, 240, size=(2, 60))
    exact, quick = (
        highest(image, rows, cols, 16, 30, exclusion=4.0, exact=e) for e in (True, False)
    )
    assert (quick <= exact + 1e-5).all()
