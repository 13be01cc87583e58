"""Angles in one turn: both ends, tiny negative angles, arrays like scalars."""

from __future__ import annotations

import math

import numpy as np
import pytest

from lcp_catalog.geometry.bounds import turned_deg, wrapped_deg

ANGLES = (-720.0, -540.0, -360.0, -180.0, -1e-17, 0.0, 90.0, 180.0, 359.5, 360.0, 540.0, 725.0)


@pytest.mark.parametrize("angle", ANGLES)
def test_angles_stay_in_their_turn_and_keep_their_direction(angle: float):
    turned, wrapped = turned_deg(angle), wrapped_deg(angle)
    assert 0.0 <= turned < 360.0
    assert -180.0 <= wrapped < 180.0
    for found in (turned, wrapped):
        assert math.cos(math.radians(found - angle)) == pytest.approx(1.0, abs=1e-12)


def test_arrays_give_what_scalars_give_and_unknown_stays_unknown():
    found = turned_deg(np.array([*ANGLES, np.nan]))
    assert found[:-1].tolist() == [turned_deg(angle) for angle in ANGLES]
    assert np.isnan(found[-1])
    assert math.isnan(wrapped_deg(math.nan))
