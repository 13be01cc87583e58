"""Patches cut from arrays, thinning of points, and images at half resolution."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lcp_catalog.landmarks.patches import gather_patches, halved, through_optics
from lcp_catalog.landmarks.thinning import thinned


@given(st.integers(-9, 30), st.integers(-9, 35), st.integers(0, 6))
def test_a_patch_is_what_a_slice_of_the_padded_array_is(row, col, half):
    array = np.arange(20 * 25, dtype=np.float32).reshape(20, 25)
    padded = np.pad(array, 20, constant_values=np.nan)
    found = gather_patches(array, np.array([row, 10]), np.array([col, 12]), half)
    for patch, (r, c) in zip(found, ((row, col), (10, 12)), strict=True):
        np.testing.assert_array_equal(
            patch, padded[20 + r - half : 21 + r + half, 20 + c - half : 21 + c + half]
        )


def test_patches_keep_their_type_and_do_not_alias():
    array = np.ones((9, 9), dtype=bool)
    inside = gather_patches(array, np.array([4]), np.array([4]), 2)
    outside = gather_patches(array, np.array([0]), np.array([4]), 2)
    assert inside.dtype == outside.dtype == bool
    assert not outside[0, :2].any()
    assert outside[0, 2:].all()
    inside[...] = False
    assert array.all()
    assert gather_patches(array, np.array([], dtype=int), np.array([], dtype=int), 2).shape == (
        0,
        5,
        5,
    )


def test_half_resolution_is_the_area_mean():
    """Against OpenCV's; an odd last row and column are left out."""
    image = np.random.default_rng(0).normal(1e3, 1.0, (21, 35)).astype(np.float32)
    expected = cv2.resize(image[:20, :34], (17, 10), interpolation=cv2.INTER_AREA)
    np.testing.assert_allclose(halved(image), expected, rtol=1e-6)
    assert halved(image).dtype == np.float32


@given(st.integers(0, 10_000), st.floats(0.01, 0.6), st.sampled_from([1.0, 2.0, np.inf]))
def test_thinning_is_greedy_in_the_given_order(seed, distance, norm):
    """Against a loop over all pairs, with labels and places that were chosen before."""
    rng = np.random.default_rng(seed)
    places, labels = rng.random((60, 2)), rng.integers(0, 40, 60)
    order, kept = rng.permutation(60)[:50], [3, 7]
    chosen = list(kept)
    for k in order:
        away = [np.linalg.norm(places[k] - places[c], ord=norm) for c in chosen]
        if min(away) >= distance and labels[k] not in labels[chosen]:
            chosen.append(k)
    found = thinned(places, order, distance, norm=norm, labels=labels, kept=kept)
    assert found.tolist() == chosen
    assert thinned(places, order[:0], distance).size == 0


def test_places_at_exactly_the_distance_are_kept():
    places = np.array([[0.0], [1.0], [1.5], [2.0]])
    assert thinned(places, np.arange(4), 1.0).tolist() == [0, 1, 3]


@pytest.mark.parametrize("scale", [1, 2, 4])
def test_optics_are_a_pixel_and_a_point_spread(scale):
    """The second moment of a point's image at a pixel's scale, from the definition."""
    point = np.zeros((21, 21), np.float32)
    point[10, 10] = 1.0
    image = through_optics(point, scale).astype(np.float64)
    at = np.arange(21.0) - 10.0
    assert image.sum() == pytest.approx(1.0, abs=1e-5)
    assert image.sum(axis=0) @ at**2 == pytest.approx(0.25 + 1.0 / (12.0 * scale**2), rel=1e-3)
    assert image.sum(axis=1) @ at**2 == pytest.approx(0.25 + 1.0 / (12.0 * scale**2), rel=1e-3)
    np.testing.assert_allclose(
        through_optics(np.full((9, 9), 3.0, np.float32), scale), 3.0, rtol=1e-6
    )
