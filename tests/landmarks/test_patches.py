"""Patches cut from arrays, and images at half resolution."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from lcp_catalog.landmarks.patches import (
    _spread,
    halved,
    halved_changes,
    patches_of,
    through_optics,
)


def cut(image, rows, cols, half):
    """Patches of one image."""
    return patches_of(image[None], np.zeros(len(rows), np.int64), rows, cols, half)


@pytest.mark.parametrize("half", [0, 1, 4, 9, 12])
@pytest.mark.parametrize("seed", range(4))
def test_patches_of_several_images_are_slices_of_padded_ones(seed, half):
    """NaN beyond the border, and missing nodes stay missing; patches may be larger than the image."""
    rng = np.random.default_rng(seed)
    images = rng.normal(size=(3, 20, 25)).astype(np.float32)
    images[1, 4, 5] = np.nan
    which, rows, cols = rng.integers(0, 3, 15), rng.integers(-9, 30, 15), rng.integers(-9, 35, 15)
    found = patches_of(images, which, rows, cols, half)
    assert found.dtype == np.float32
    padded = np.pad(images, ((0, 0), (25, 25), (25, 25)), constant_values=np.nan)
    for k in range(15):
        r, c = 25 + rows[k], 25 + cols[k]
        expected = padded[which[k], r - half : r + half + 1, c - half : c + half + 1]
        np.testing.assert_array_equal(found[k], expected)
        one = cut(images[which[k]], rows[k : k + 1], cols[k : k + 1], half)
        np.testing.assert_array_equal(found[k : k + 1], one)
    assert patches_of(images, which[:0], rows[:0], cols[:0], half).shape == (
        0,
        2 * half + 1,
        2 * half + 1,
    )


def test_half_resolution_is_the_area_mean():
    """Against OpenCV's, for any number of axes; an odd last row and column are left out."""
    images = np.random.default_rng(0).normal(1e3, 1.0, (2, 3, 21, 35)).astype(np.float32)
    small = halved(images)
    assert small.shape == (2, 3, 10, 17)
    assert small.dtype == np.float32
    for image, found in zip(images.reshape(6, 21, 35), small.reshape(6, 10, 17), strict=True):
        expected = cv2.resize(image[:20, :34], (17, 10), interpolation=cv2.INTER_AREA)
        np.testing.assert_allclose(found, expected, rtol=1e-6)
        np.testing.assert_array_equal(halved(image), found)


@pytest.mark.parametrize("half", [6, 7, 8, 16])
def test_a_changed_patch_at_half_resolution_lies_on_the_images_pixels(half):
    """Against the halved image into which the patch was put, for even and odd places."""
    rng = np.random.default_rng(half)
    image = rng.normal(size=(90, 92)).astype(np.float32)
    rows, cols = np.array([40, 41, 40, 41]), np.array([44, 44, 45, 45])
    seen = cut(image, rows, cols, half)
    alone = (seen + rng.normal(size=seen.shape)).astype(np.float32)
    coarse = rows // 2, cols // 2, half // 2
    change = halved_changes(alone - seen, rows, cols)
    assert change.shape == (4, 2 * (half // 2) + 1, 2 * (half // 2) + 1)
    found = cut(halved(image), *coarse) + change
    for k in range(4):
        whole = image.copy()
        r, c = rows[k], cols[k]
        whole[r - half : r + half + 1, c - half : c + half + 1] = alone[k]
        expected = cut(halved(whole), *(a[k : k + 1] for a in coarse[:2]), half // 2)[0]
        np.testing.assert_allclose(found[k], expected, atol=1e-5)
    assert not halved_changes(np.zeros_like(seen), rows, cols).any()


@pytest.mark.parametrize("scale", [1, 2, 4])
def test_optics_are_a_pixel_and_a_point_spread(scale):
    """The second moment of a point's image at a pixel's scale, from the definition."""
    point = np.zeros((1, 21, 21), np.float32)
    point[0, 10, 10] = 1.0
    image = through_optics(point, scale)[0].astype(np.float64)
    at = np.arange(21.0) - 10.0
    assert image.sum() == pytest.approx(1.0, abs=1e-5)
    assert image.sum(axis=0) @ at**2 == pytest.approx(0.25 + 1.0 / (12.0 * scale**2), rel=1e-3)
    assert image.sum(axis=1) @ at**2 == pytest.approx(0.25 + 1.0 / (12.0 * scale**2), rel=1e-3)
    np.testing.assert_allclose(
        through_optics(np.full((1, 9, 9), 3.0, np.float32), scale), 3.0, rtol=1e-6
    )


@pytest.mark.parametrize("shape", [(31, 44), (9, 9), (4, 2), (1, 1)])
def test_optics_are_a_separable_filter(shape):
    """Against OpenCV's, each image alone, borders extended; one without light stays dark."""
    images = np.random.default_rng(0).normal(1.0, 0.3, (4, *shape)).astype(np.float32)
    images[2] = 0.0
    taps = _spread(0.25 + 1.0 / 48.0)
    assert taps.sum() == pytest.approx(1.0, abs=1e-6)
    found = through_optics(images, 2)
    for image, seen in zip(images, found, strict=True):
        expected = cv2.sepFilter2D(image, cv2.CV_32F, taps, taps, borderType=cv2.BORDER_REPLICATE)
        np.testing.assert_allclose(seen, expected, atol=1e-6)
    assert not found[2].any()
    np.testing.assert_array_equal(through_optics(images[1:2], 2), found[1:2])
