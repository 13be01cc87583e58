"""The share of a patch that other terrain occludes."""

from __future__ import annotations

import numpy as np
import pytest

from lcp_catalog.landmarks.independence import dependence


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
