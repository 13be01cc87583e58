"""Claims as whole numbers."""

from __future__ import annotations

import math

import numpy as np

from lcp_catalog.catalog.packing import half_turn


def test_directions_of_axes_are_remainders_of_whole_degrees() -> None:
    angles = [*(0.25 * k for k in range(-1600, 1600)), 1e15, math.nan]
    found = half_turn(angles)
    assert np.array_equal(found[:-1], [round(angle) % 180 for angle in angles[:-1]])
    assert np.isnan(found[-1])
    assert not np.signbit(found).any()
    assert half_turn(np.float32(-3.6)) == 176.0
