"""Claims as whole numbers."""

from __future__ import annotations

import math

import numpy as np

from lcp_catalog.catalog.layout import axis_direction


def test_directions_of_axes_are_remainders_of_whole_degrees() -> None:
    angles = [*(0.25 * k for k in range(-1600, 1600)), 1e15, math.nan]
    found = axis_direction(angles)
    assert np.array_equal(found[:-1], [round(angle) % 180 for angle in angles[:-1]])
    assert np.isnan(found[-1])
    assert not np.signbit(found).any()
    assert axis_direction(np.float32(-3.6)) == 176.0
