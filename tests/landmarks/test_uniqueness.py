"""Other places that resemble a patch, against OpenCV at every place, with copies, borders and gaps."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lcp_catalog.kernels.matching.rivals import _ASCENTS, window_norms
from lcp_catalog.landmarks.patches import patches_of
from lcp_catalog.landmarks.uniqueness import (
    RING,
    RIVALS,
    OtherPlaces,
    SearchImages,
    other_places,
    searched_exactly,
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


def places(images, rows, cols, half=HALF, search=SEARCH, which=None, **how) -> OtherPlaces:
    """Places that resemble the images' own patches."""
    rows, cols = np.asarray(rows, np.int64), np.asarray(cols, np.int64)
    image_of = np.zeros(len(rows), np.int64) if which is None else which
    own = patches_of(images, image_of, rows, cols, half)
    return other_places(images, own, rows, cols, search, which, **how)


def others(image, *where, exact=True, **how):
    """Correlations and contrasts of the places that resemble one image's own patches."""
    found = places(image[None], *where, exact=exact, **how)
    return found.correlation, found.contrast


def highest(*given, **how):
    """The highest correlation of each patch with another place; -1 for none."""
    return np.fmax(others(*given, **how)[0][:, 0], -1.0)


def opencv(part, patch):
    """Correlations by cv2.matchTemplate of pixels less their mean: with a mean of 1 its error is up to 1e-4, in
    other places on other processors.
    """
    parts = part - part.mean(), patch - patch.mean()
    return cv2.matchTemplate(*parts, cv2.TM_CCOEFF_NORMED)


def exhaustive(image, row, col, half, search, exclusion):
    """Correlations, best first, and contrasts of all maxima by cv2.matchTemplate in the search square."""
    patch = image[row - half : row + half + 1, col - half : col + half + 1]
    r0, c0 = max(row - search - half, 0), max(col - search - half, 0)
    part = image[r0 : row + search + half + 1, c0 : col + search + half + 1]
    score = opencv(part, patch)
    top = score == cv2.dilate(score, np.ones((3, 3)))
    places = [
        (score[i, j], part[i : i + 2 * half + 1, j : j + 2 * half + 1].std(dtype=np.float64))
        for i, j in np.argwhere(top)
        if np.hypot(i + r0 + half - row, j + c0 + half - col) > exclusion
    ]
    return np.array(sorted(places, reverse=True)).reshape(-1, 2).T


PLACES = [(60, 60), (60, 20), (10, 60), (111, 111), (30, 95)]


@pytest.mark.slow
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
    at = np.array([60])
    found = other_places(image[None], alone[None], at, at, SEARCH, exact=True).correlation
    score = opencv(image[32:89, 32:89], alone)
    top = (score == cv2.dilate(score, np.ones((3, 3)))) & (score < score[SEARCH, SEARCH])
    assert found[0, 0] == pytest.approx(score[top].max(), abs=5e-5)


def half_resolution(image, row, col, half, search):
    """Correlations of all maxima at half resolution: the patch's complete 2 x 2 blocks with the image's."""
    small = cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    first = (row - half + 1) // 2, (col - half + 1) // 2
    side = min((n + half + 1) // 2 - f for n, f in zip((row, col), first, strict=True))
    reach = (search + 1) // 2
    patch = small[first[0] : first[0] + side, first[1] : first[1] + side]
    part = small[
        first[0] - reach : first[0] + side + reach, first[1] - reach : first[1] + side + reach
    ]
    score = opencv(part, patch)
    return score[score == cv2.dilate(score, np.ones((3, 3)))]


def counterparts(quick, exact, k):
    """For each place of patch k that the quick search found: True if the exhaustive search found one with
    its correlation and contrast.
    """
    some = np.isfinite(quick[0][k])
    alike = np.abs(quick[0][k, some, None] - exact[0][k]) < 1e-5
    near = np.abs(quick[1][k, some, None] / exact[1][k] - 1.0) < 1e-4
    return (alike & near).any(axis=1)


@pytest.mark.parametrize("half", [7, 16])
def test_half_resolution_first_loses_little_and_what_is_followed_never_gains(half):
    """The highest maxima at half resolution are followed to maxima at full resolution; the others keep
    their correlation at half resolution.
    """
    image = field(2, (300, 300), smooth=2.0)
    rng = np.random.default_rng(0)
    rows, cols = rng.integers(80, 220, size=(2, 100))
    assert not searched_exactly(2 * half + 1, 60)
    quick, exact = (others(image, rows, cols, half, 60, exact=e) for e in (False, True))
    assert (np.diff(np.nan_to_num(quick[0], nan=-2.0), axis=1) <= 0.0).all()  # best first
    lost = exact[0][:, 0] - quick[0][:, 0]
    assert np.mean(np.abs(lost) > 1e-4) < 0.1
    assert np.sqrt(np.mean(lost**2)) < 0.02
    followed, best = [], []
    for k in range(100):
        real = counterparts(quick, exact, k)
        coarse = half_resolution(image, rows[k], cols[k], half, 60)
        rest = quick[0][k, : len(real)][~real]
        assert (np.abs(rest[:, None] - coarse).min(axis=1, initial=2.0) < 1e-4).all()
        followed.append(real.sum())
        best.append(real[0])
    assert np.mean(followed) > 0.8 * _ASCENTS
    assert np.median(followed) == _ASCENTS
    assert max(followed) <= _ASCENTS + 1  # one of the others can be a maximum by chance
    assert np.mean(best) > 0.9


@pytest.mark.parametrize(("half", "search"), [(8, 14), (8, 40)])
def test_a_place_that_two_ascents_reach_counts_once(half, search):
    """No two places of a random image have exactly the same correlation."""
    image = field(2, (300, 300), smooth=1.5)
    rows, cols = np.random.default_rng(0).integers(80, 220, size=(2, 100))
    for found in others(image, rows, cols, half, search, exact=False)[0]:
        some = found[np.isfinite(found)]
        assert len(np.unique(some)) == len(some)


def test_where_all_maxima_are_followed_none_gains():
    image = field(6, (300, 300), smooth=3.0)
    rows, cols = np.random.default_rng(3).integers(60, 240, size=(2, 80))
    quick, exact = (others(image, rows, cols, 8, 14, exact=e) for e in (False, True))
    few = [k for k in range(80) if len(half_resolution(image, rows[k], cols[k], 8, 14)) <= _ASCENTS]
    assert len(few) > 30
    for k in few:
        assert counterparts(quick, exact, k).all()
        assert not quick[0][k, 0] > exact[0][k, 0] + 1e-5


@pytest.mark.parametrize("exact", [False, True])
def test_places_below_the_least_are_left_out_and_those_above_are_not(exact):
    """Each patch's own least correlation; the two highest places stay."""
    image = field(2, (300, 300), smooth=2.0)
    rows, cols = np.random.default_rng(0).integers(80, 220, size=(2, 100))
    whole, _ = others(image, rows, cols, 16, 60, exact=exact)
    least = np.linspace(0.2, 1.5, 100)
    some, _ = others(image, rows, cols, 16, 60, exact=exact, least=least)
    for k in range(100):
        left, all_of_them = (a[k][np.isfinite(a[k])] for a in (some, whole))
        assert np.isin(left, all_of_them).all()
        above = all_of_them[all_of_them >= least[k]]
        np.testing.assert_array_equal(left[: len(above)], above)
        assert len(left) >= 1
    count = np.isfinite(some).sum(axis=1)
    assert count[:10].mean() > 5.0
    assert (count[-40:] <= 2).all()  # no correlation is above 1


@pytest.mark.parametrize(("half", "search"), [(6, 40), (16, 11), (8, 11), (3, 5)])
def test_small_patches_and_areas_are_searched_at_full_resolution(half, search):
    image = field(4, (200, 200), smooth=1.0)
    rows, cols = np.random.default_rng(0).integers(60, 140, size=(2, 20))
    assert searched_exactly(2 * half + 1, search)
    one, other = (others(image, rows, cols, half, search, exact=e) for e in (True, False))
    np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("exact", [True, False])
def test_patches_of_several_images_are_those_of_each_alone(exact):
    """And of images that are prepared once."""
    images = np.stack([field(seed, (150, 140), level=seed) for seed in (1, 2, 3)])
    rng = np.random.default_rng(5)
    (rows, cols), which = rng.integers(5, 135, (2, 40)), rng.integers(0, 3, 40)
    found = places(images, rows, cols, which=which, exact=exact)
    own = patches_of(images, which, rows, cols, HALF)
    prepared = SearchImages.of(images, 2 * HALF + 1)
    again = other_places(prepared, own, rows, cols, SEARCH, which, exact=exact)
    for number in range(3):
        some = which == number
        alone = places(images[number : number + 1], rows[some], cols[some], exact=exact)
        for part, expected, repeated in zip(found, alone, again, strict=True):
            np.testing.assert_array_equal(part[some], expected)
            np.testing.assert_array_equal(repeated, part)
    inside = np.isfinite(found.correlation[:, 0])
    assert 20 < inside.sum() < 40
    assert np.isnan(found.near[~inside]).all()


def test_places_nearby_are_those_of_numpy():
    """NaN where the window leaves the image."""
    image = field(7)
    rows, cols = np.array([60, 8, 111, 30]), np.array([60, 60, 9, 111])
    found = places(image[None], rows, cols)
    own = patches_of(image[None], np.zeros(4, np.int64), rows, cols, HALF)
    left = 0
    for k, (right, down) in enumerate(RING.tolist()):
        assert 4.2 < np.hypot(right, down) < 5.7
        r, c = rows + down, cols + right
        windows = patches_of(image[None], np.zeros(4, np.int64), r, c, HALF)
        for i in range(4):
            if np.isnan(windows[i]).any():
                assert np.isnan([found.near[i, k], found.near_contrast[i, k]]).all()
                left += 1
                continue
            rho = np.corrcoef(own[i].ravel(), windows[i].ravel())[0, 1]
            assert found.near[i, k] == pytest.approx(rho, abs=2e-6)
            spread = windows[i].std(dtype=np.float64)
            assert found.near_contrast[i, k] == pytest.approx(spread, rel=1e-5)
    assert left > 10


@pytest.mark.parametrize("size", [1, 4, 8, 17])
def test_norms_of_windows_are_those_of_numpy(size):
    """0 for windows without contrast; a high level costs no digits."""
    images = np.stack([field(1, (40, 33)), field(2, (40, 33), level=0.0, contrast=30.0)])
    images[0, 10:32, 5:30] = 1.0
    images[1] += 500.0
    found = np.full((2, 41 - size, 34 - size), np.nan, np.float32)
    window_norms(images, size, found)
    windows = np.lib.stride_tricks.sliding_window_view(
        images.astype(np.float64), (size, size), (1, 2)
    )
    power = size**2 * windows.var(axis=(3, 4))
    flat = power <= 1e-6 * size**2 * images.var(axis=(1, 2), dtype=np.float64)[:, None, None]
    assert flat[0].any()
    assert flat.all() == (size == 1)
    expected = np.where(flat, 0.0, 1.0 / np.sqrt(np.where(flat, 1.0, power)))
    np.testing.assert_allclose(found, expected, rtol=1e-5)


def test_an_image_smaller_than_the_patch_has_no_places():
    image = field(1, (30, 16))[None]
    at, patch = np.array([8]), field(2, (17, 17))[None]
    for images in (image, SearchImages.of(image, 17)):
        for part in other_places(images, patch, at, at, SEARCH):
            assert np.isnan(part).all()
    with pytest.raises(ValueError, match="patches of 15 nodes, not 17"):
        other_places(SearchImages.of(image, 15), patch, at, at, SEARCH)


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
    at = np.array([30])
    assert other_places(blank[None], patch, at, at, SEARCH).correlation[0, 0] == 1.0


def test_two_gaps_of_the_same_shape_do_not_correlate():
    image = field(11)
    for col in (60, 80):
        image[54:67, col - 6 : col + 3] = np.nan
    filled = np.where(np.isfinite(image), image, np.nanmean(image)).astype(np.float32)
    patch = filled[52:69, 52:69][None]
    at = np.array([60])
    for exact in (True, False):
        found = other_places(image[None], patch, at, at, SEARCH, exact=exact)
        assert found.correlation[0, 0] < 0.6


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
