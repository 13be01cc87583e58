"""How clearly relief shows, against Lommel-Seeliger light on tilted facets, and claims between conditions with it."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.twins_relief import by_facets, height

from lcp_catalog.geometry.frames import direction_enu
from lcp_catalog.landmarks.relief_signal import log_signal, peak_height, probability_at


@pytest.mark.parametrize("sun", [(60.0, 30.0), (200.0, 70.0), (10.0, 5.0)])
@pytest.mark.parametrize("view", [(0.0, 90.0), (240.0, 40.0)])
def test_signal_of_slopes(sun: tuple[float, float], view: tuple[float, float]) -> None:
    towards = direction_enu(*sun), direction_enu(*view)
    slopes = by_facets(*towards)
    for albedo, slope in ((0.09, 0.0), (0.09, 0.05)):
        want = np.log(slopes / np.hypot(albedo, slope * slopes))
        assert log_signal(*towards, albedo, slope) == pytest.approx(want, abs=1e-9)


def test_relief_hardly_shows_with_the_sun_behind_the_camera() -> None:
    sun = direction_enu(120.0, 50.0)
    away = [
        log_signal(sun, direction_enu(120.0, e), 0.1, 0.0) for e in (20.0, 40.0, 50.0, 60.0, 90.0)
    ]
    assert np.argmin(away) == 2
    assert np.exp(min(away)) == pytest.approx(0.3)  # what the first order leaves out
    assert log_signal(sun, direction_enu(0.0, 90.0), 0.0, 0.1) == 0.0  # no unmapped brightness


def test_heights_and_probabilities() -> None:
    p = np.array([0.002, 0.04, 0.3, 0.9, 0.998])
    np.testing.assert_allclose(peak_height(p), height(p), rtol=1e-12)
    np.testing.assert_allclose(probability_at(peak_height(p)), p, atol=1e-12)
