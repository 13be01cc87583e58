"""The search for templates: compared with plain loops over every place, with gaps, odd blocks and
borders.
"""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from helpers.twins_match import at_half, correlation_at, correlations_near, sought

from lcp_catalog.kernels.matching import correlation, search

LEAST_REAL = 0.5


def scene(seed: int, blur: float = 1.2) -> tuple[np.ndarray, np.ndarray]:
    """An image of 44 x 52 pixels with texture, and its weights: some columns and a block are
    missing, one row has weight 0.5.
    """
    rng = np.random.default_rng(seed)
    image = cv2.GaussianBlur(rng.standard_normal((44, 52)), (0, 0), blur).astype(np.float32)
    weight = np.ones(image.shape, np.float32)
    weight[:, 30:33], weight[4:16, 40:50], weight[25] = 0.0, 0.0, 0.5
    return image, weight


def cut(
    image: np.ndarray, seed: int, high: int, wide: int
) -> tuple[np.ndarray, np.ndarray, int, int]:
    """A template from an image, with noise and a ragged mask that does not reach its own borders;
    its row and column.
    """
    rng = np.random.default_rng(seed + 1000)
    row, col = (
        int(rng.integers(0, n - m + 1)) for n, m in zip(image.shape, (high, wide), strict=True)
    )
    values = image[row : row + high, col : col + wide].copy()
    values += (0.3 * image.std() * rng.standard_normal(values.shape)).astype(np.float32)
    mask = rng.random(values.shape) < 0.85
    mask[0], mask[:, -1] = False, False
    mask[1, 1:-1], mask[-1, 1:-1], mask[:, 0] = True, True, seed % 2 == 0
    mask[0, 0] = False
    return 3.0 + 40.0 * values, mask, row, col


def find(image, weight, values, mask, origin, reach, exclusion, coarse):
    half = np.s_[: image.shape[0] // 2 * 2, : image.shape[1] // 2 * 2]
    small, share = (
        cv2.resize(a[half], None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
        for a in (image, weight)
    )
    out = np.full((1, search.NUMBERS), np.nan)
    search.find_templates(
        image, weight, small, share, values[None].astype(np.float32), mask[None], np.array([origin]),
        np.array([reach]), np.array([exclusion]), LEAST_REAL, np.array([coarse]), out,
    )  # fmt: skip
    return out[0]


def test_the_search_at_full_resolution_is_a_loop_over_every_place() -> None:
    """Best place, its rival, the share of the area in the image and of valid pixels, from origins
    that may lie beyond the border.
    """
    for seed in range(12):
        image, weight = scene(seed)
        rng = np.random.default_rng(seed)
        values, mask, row, col = cut(
            image, seed, int(rng.integers(6, 13)), int(rng.integers(6, 13))
        )
        origin = (col + int(rng.integers(-6, 7)), row + int(rng.integers(-6, 7)))
        wanted = sought(image, weight, values, mask, origin, 8, 3.0, LEAST_REAL, search.PEAKS)
        found = find(image, weight, values, mask, origin, 8, 3.0, False)
        np.testing.assert_allclose(found, wanted, atol=2e-4)
        assert wanted[2] > 0.5


def test_a_rival_lies_beyond_the_exclusion_and_is_the_highest_there() -> None:
    """Three copies, a fair one 10 to the right and a poor one 14 below: a wider exclusion leaves
    the poor one, then none.
    """
    rng = np.random.default_rng(4)
    piece = cv2.GaussianBlur(rng.standard_normal((12, 12)), (0, 0), 1.0)
    image = 0.05 * rng.standard_normal((60, 60))
    for row, col, noise in ((20, 20, 0.0), (20, 30, 0.25), (34, 20, 0.5)):
        image[row : row + 12, col : col + 12] = piece + noise * piece.std() * rng.standard_normal(
            (12, 12)
        )
    image = image.astype(np.float32)
    piece, mask = piece.astype(np.float32), np.ones((12, 12), bool)
    mask[:, 10:] = False  # the second copy covers the first one's last columns
    fair, poor = (correlation_at(image, piece, mask, r, c) for r, c in ((20, 30), (34, 20)))
    assert fair > poor + 0.05
    ones = np.ones(image.shape, np.float32)
    for exclusion, second in ((5.0, fair), (9.9, fair), (10.0, poor), (13.9, poor)):
        found = find(image, ones, piece, mask, (19, 21), 16, exclusion, False)
        assert (found[0], found[1]) == (1.0, -1.0)
        assert found[3] == pytest.approx(second, abs=1e-4)


def test_from_half_resolution_it_ends_on_the_same_top() -> None:
    """Smooth terrain, templates that begin on odd and even pixels, searches cut by the border: the
    place and correlation of the loop.
    """
    for seed in range(12):
        image, _ = scene(seed, blur=2.5)
        ones = np.ones(image.shape, np.float32)
        values, mask, row, col = cut(image, seed, 17, 16 + seed % 3)
        rng = np.random.default_rng(seed)
        origin = (col + int(rng.integers(-7, 8)), row + int(rng.integers(-7, 8)))
        wanted = sought(image, ones, values, mask, origin, 7, 4.0, LEAST_REAL, search.PEAKS)
        found = find(image, ones, values, mask, origin, 7, 4.0, True)
        np.testing.assert_allclose(found[[0, 1, 2, 4, 5]], wanted[[0, 1, 2, 4, 5]], atol=2e-4)


@pytest.mark.parametrize("coarse", [False, True])
def test_nothing_is_found_beyond_the_reach(coarse: bool) -> None:
    """The true place lies 2 and 1 pixels beyond the search on either side: the place found lies
    within, with its own correlation.
    """
    image, _ = scene(3, blur=2.5)
    ones = np.ones(image.shape, np.float32)
    values, mask = image[14:30, 18:34].copy(), np.ones((16, 16), bool)
    for right, down in ((7, 6), (-6, -7), (7, -6), (0, 7)):
        found = find(image, ones, values, mask, (18 - right, 14 - down), 5, 4.0, coarse)
        assert np.abs(found[:2]).max() <= 5.0
        place = (14 - down + int(found[1]), 18 - right + int(found[0]))
        assert found[2] == pytest.approx(correlation_at(image, values, mask, *place), abs=1e-4)


def test_a_search_area_that_is_partly_real_says_how_much() -> None:
    """All but two columns of an image are missing: at best 2 of a template's 8 are valid, too few
    for a search.
    """
    image, _ = scene(2)
    weight = np.zeros(image.shape, np.float32)
    weight[:, 20:22] = 1.0
    values, mask = image[10:18, 18:26].copy(), np.ones((8, 8), bool)
    for coarse in (False, True):
        found = find(image, weight, values, mask, (18, 10), 6, 4.0, coarse)
        assert np.isnan(found[:4]).all()
        assert found[5] == pytest.approx(0.25)


def test_a_low_peak_at_half_resolution_that_is_the_highest_in_truth_is_climbed_too() -> None:
    """Two places that are equal at half resolution; only the finest detail tells which is right."""
    rng = np.random.default_rng(9)
    smooth = cv2.GaussianBlur(rng.standard_normal((20, 20)), (0, 0), 2.5)
    smooth /= smooth.std()
    fine = 0.6 * np.where(np.indices((20, 20)).sum(axis=0) % 2 == 0, 1.0, -1.0)
    image = 0.2 * rng.standard_normal((50, 90))
    image[15:35, 10:30] = smooth + 0.1 * rng.standard_normal((20, 20))
    image[15:35, 60:80] = smooth + fine + 0.9 * cv2.blur(rng.standard_normal((20, 20)), (2, 2))
    image = image.astype(np.float32)
    ones, mask = np.ones(image.shape, np.float32), np.ones((20, 20), bool)
    found = find(image, ones, smooth + fine, mask, (36, 15), 30, 6.0, True)
    wanted = sought(image, ones, smooth + fine, mask, (36, 15), 30, 6.0, LEAST_REAL, 6)
    assert (found[0], found[1]) == (24.0, 0.0)
    np.testing.assert_allclose(found, wanted, atol=2e-4)


@pytest.mark.slow
@pytest.mark.parametrize("odd", [(0, 0), (0, 1), (1, 0), (1, 1)])
@pytest.mark.parametrize("shape", [(6, 8), (7, 9), (5, 4)])
def test_a_template_at_half_resolution_lies_on_the_images_blocks(odd, shape) -> None:
    rng = np.random.default_rng(sum(shape))
    values = rng.standard_normal(shape).astype(np.float32)
    mask = rng.random(shape) < 0.6
    small, inside = search._halved(values, mask, *odd)
    wanted, share = at_half(values, mask, odd)
    np.testing.assert_array_equal(inside, share >= 0.5)
    np.testing.assert_allclose(small, np.where(share >= 0.5, wanted, 0.0), rtol=1e-5, atol=1e-6)


@pytest.mark.slow
def test_uphill_goes_step_by_step_to_the_top_and_not_beyond_its_limits() -> None:
    image = np.exp(-(np.hypot(*np.meshgrid(np.arange(60) - 31.0, np.arange(50) - 24.0)) ** 2) / 128)
    image = image.astype(np.float32)
    values, mask = image[16:33, 23:40].copy(), np.ones((17, 17), bool)
    template = np.empty(values.shape, np.float32)
    count = correlation.centred(values, mask, template)
    ones = np.ones(image.shape, np.float32)
    for limits, end in (((0, 33, 0, 43), (16, 23)), ((18, 33, 0, 43), (18, 23)), ((0, 14, 25, 43), (14, 25))):  # fmt: skip
        start = (min(max(20, limits[0]), limits[1]), 28)
        row, col, best = search._climb(image, ones, template, mask, count, 0.0, *start, limits, 0.7)
        assert (row, col) == end
        assert best == pytest.approx(correlation_at(image, values, mask, *end), abs=1e-5)
    # the window at the far corner of the image is still one, and the next is none
    assert search._at(image, ones, template, mask, count, 0.0, 33, 43, 0.7) > -1.5
    for row, col in ((34, 43), (33, 44), (-1, 0), (0, -1)):
        assert search._at(image, ones, template, mask, count, 0.0, row, col, 0.7) == -2.0


@pytest.mark.parametrize(("gone", "looked_at"), [(7, True), (8, False)])
def test_uphill_a_place_with_too_little_that_is_real_is_none(gone: int, looked_at: bool) -> None:
    """7 or 8 of 16 columns are missing; 0.53 of the pixels are required."""
    image, _ = scene(1)
    weight = np.ones(image.shape, np.float32)
    weight[:, 20 : 20 + gone] = 0.0
    values, mask = image[10:26, 20:36].copy(), np.ones((16, 16), bool)
    template = np.empty(values.shape, np.float32)
    count = correlation.centred(values, mask, template)
    found = search._at(image, weight, template, mask, count, 0.0, 10, 20, 0.53)
    assert found == (pytest.approx(1.0, abs=1e-5) if looked_at else -2.0)


def test_a_window_of_little_contrast_correlates_zero_in_an_ascent_too() -> None:
    """A window with a copy of the template, a thousand times fainter: 1, or 0 if its sum of squares
    counts as flat.
    """
    image, _ = scene(4)
    values, mask = image[10:26, 20:36].copy(), np.ones((16, 16), bool)
    faint = np.full(image.shape, 2.0, np.float32)
    faint[10:26, 20:36] += 1e-3 * values
    ones, template = np.ones(image.shape, np.float32), np.empty(values.shape, np.float32)
    count = correlation.centred(values, mask, template)
    power = 256 * float(np.var(faint[10:26, 20:36].astype(np.float64)))
    for flat, wanted in ((0.9 * power, pytest.approx(1.0, abs=1e-4)), (1.1 * power, 0.0)):
        assert search._at(faint, ones, template, mask, count, flat, 10, 20, 0.7) == wanted


# -- correlation


def test_bounds_are_those_of_what_is_covered() -> None:
    rng = np.random.default_rng(0)
    for _ in range(50):
        mask = rng.random((7, 9)) < 0.06
        rows, cols = np.nonzero(mask)
        if rows.size:
            wanted = (rows.min(), rows.max() + 1, cols.min(), cols.max() + 1)
            assert correlation.bounds(mask) == wanted
        else:
            assert correlation.bounds(mask)[0] >= correlation.bounds(mask)[1]


@pytest.mark.slow
@pytest.mark.parametrize("contrast", [1e-3, 1e-1])
def test_little_contrast_is_contrast(contrast: float) -> None:
    """A template with a contrast of a thousandth of its brightness, in an image that varies 30
    times as much elsewhere.
    """
    rng = np.random.default_rng(1)
    pattern = rng.standard_normal((8, 8))
    image = 30.0 * rng.standard_normal((20, 40))
    image[6:14, 5:13] = pattern
    values, mask = (1.0 + contrast * pattern).astype(np.float32), np.ones((8, 8), bool)
    template = np.empty(values.shape, np.float32)
    assert correlation.centred(values, mask, template) == 64
    ones = np.ones(image.shape, np.float32)
    score, _, _ = correlation.correlations(
        image.astype(np.float32), ones, template, mask, 64, 0, 0, 13, 33, 0.7
    )
    assert score[6, 5] == pytest.approx(1.0, abs=1e-3)


def test_flat_ground_correlates_with_nothing() -> None:
    """The remainder of a level part beside a rough one, a hundred-thousandth of it, is no texture;
    a flat template has no correlation.
    """
    rng = np.random.default_rng(2)
    image = 1e-5 * rng.standard_normal((30, 60)).astype(np.float32)
    image[:, 30:] += rng.standard_normal((30, 30)).astype(np.float32)
    values, mask = rng.standard_normal((7, 7)).astype(np.float32), np.ones((7, 7), bool)
    template = np.empty(values.shape, np.float32)
    assert correlation.centred(values, mask, template) == 49
    ones = np.ones(image.shape, np.float32)
    score, _, _ = correlation.correlations(image, ones, template, mask, 49, 0, 0, 24, 54, 0.7)
    assert (score[:, :24] == 0.0).all()
    assert correlation.centred(np.full((7, 7), 0.1, np.float32), mask, template) == 0


def test_just_enough_that_is_real_is_enough() -> None:
    """Two of four columns are valid: half, as required."""
    rng = np.random.default_rng(3)
    image = rng.standard_normal((8, 20)).astype(np.float32)
    weight = np.where(np.arange(20) < 8, 0.0, 1.0).astype(np.float32) * np.ones((8, 1), np.float32)
    values, mask = rng.standard_normal((4, 4)).astype(np.float32), np.ones((4, 4), bool)
    template = np.empty(values.shape, np.float32)
    correlation.centred(values, mask, template)
    score, _, _ = correlation.correlations(image, weight, template, mask, 16, 0, 0, 5, 17, 0.5)
    assert (score[:, :6] == correlation.NOWHERE).all()
    assert (score[:, 6:] >= -1.0).all()


@pytest.mark.parametrize("seed", range(6))
def test_maps_are_loops_over_every_offset(seed: int) -> None:
    """Offsets at which a template leaves the image or has too few valid pixels are NaN; negative
    ones are not.
    """
    image, weight = scene(seed)
    values, mask, row, col = cut(image, seed, 9, 11)
    origin = (col + seed - 3, row - 2 * seed + 5)
    out = np.empty((1, 19, 19), np.float32)
    correlation.maps(
        image, weight, values[None].astype(np.float32), mask[None], np.array([origin]), 9, LEAST_REAL, out
    )  # fmt: skip
    wanted, _ = correlations_near(image, weight, values, mask, origin, 9, LEAST_REAL)
    np.testing.assert_allclose(out[0], wanted, atol=2e-4)
    assert np.nanmin(wanted) < -0.1
