"""Patches cut from arrays, and the share of a patch that other terrain occludes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lcp_catalog.landmarks.independence import dependence
from lcp_catalog.landmarks.patches import gather_patches


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


def test_dependence_is_the_share_that_other_terrain_darkens():
    alone = np.ones((3, 4, 5), dtype=bool)
    alone[:, 0] = False  # dark by itself: five of twenty nodes
    full = alone.copy()
    full[1, 1] = False
    full[2] = False
    assert dependence(alone, full) == pytest.approx([0.0, 5 / 20, 15 / 20])


def test_light_that_more_terrain_adds_does_not_count():
    alone, full = np.zeros((1, 3, 3), dtype=bool), np.ones((1, 3, 3), dtype=bool)
    assert dependence(alone, full) == pytest.approx([0.0])


def test_only_valid_nodes_count():
    alone, full = np.ones((2, 2, 2), dtype=bool), np.zeros((2, 2, 2), dtype=bool)
    full[0, 0] = True
    valid = np.array([[[True, False], [True, True]], [[False, False], [False, False]]])
    assert dependence(alone, full, valid) == pytest.approx([2 / 3, np.nan], nan_ok=True)
