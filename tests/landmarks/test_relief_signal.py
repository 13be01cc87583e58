"""How clearly relief shows, against Lommel-Seeliger light on tilted facets, and claims between conditions with it."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest
from helpers import catalogs

from lcp_catalog.catalog.prediction import predict
from lcp_catalog.landmarks.relief_signal import directions, log_signal, peak_height, probability_at
from tests.catalog.test_prediction import chance, everywhere, height


def by_facets(sun: np.ndarray, view: np.ndarray) -> float:
    """|d log I / d slope| of flat ground by mpmath's derivatives, I = mu0 / (mu0 + mu) of a facet's own normal."""

    def brightness(east: float, south: float) -> mpmath.mpf:
        normal = mpmath.matrix([-east, south, 1]) / mpmath.sqrt(1 + east**2 + south**2)
        mu0, mu = (mpmath.fdot(normal, mpmath.matrix(v.tolist())) for v in (sun, view))
        return mpmath.log(mu0 / (mu0 + mu))

    parts = [mpmath.diff(brightness, (0, 0), order) for order in ((1, 0), (0, 1))]
    return float(mpmath.hypot(*parts))


@pytest.mark.parametrize("sun", [(30.0, 60.0), (70.0, 200.0), (5.0, 10.0)])
@pytest.mark.parametrize("view", [(90.0, 0.0), (40.0, 240.0)])
def test_signal_of_slopes(sun: tuple[float, float], view: tuple[float, float]) -> None:
    towards = directions(*sun), directions(*view)
    slopes = by_facets(*towards)
    for albedo, slope in ((0.09, 0.0), (0.09, 0.05)):
        want = np.log(slopes / np.hypot(albedo, slope * slopes))
        assert log_signal(*towards, albedo, slope) == pytest.approx(want, abs=1e-9)


def test_relief_hardly_shows_with_the_sun_behind_the_camera() -> None:
    sun = directions(50.0, 120.0)
    away = [log_signal(sun, directions(e, 120.0), 0.1, 0.0) for e in (20.0, 40.0, 50.0, 60.0, 90.0)]
    assert np.argmin(away) == 2
    assert np.exp(min(away)) == pytest.approx(0.3)  # what the first order leaves out
    assert log_signal(sun, directions(90.0, 0.0), 0.0, 0.1) == 0.0  # no unmapped brightness


def test_heights_and_probabilities() -> None:
    p = np.array([0.002, 0.04, 0.3, 0.9, 0.998])
    np.testing.assert_allclose(peak_height(p), height(p), rtol=1e-12)
    np.testing.assert_allclose(probability_at(peak_height(p)), p, atol=1e-12)


def test_claims_follow_the_signal_between_conditions() -> None:
    """Straight down, between views of 30 deg to the east and to the west: heights over signals are averaged."""
    catalog = everywhere(errors=catalogs.ERRORS | {"albedo_sigma": 0.09})
    assert catalog.view_off_nadir[1:].tolist() == [30.0, 30.0]
    sun, here = directions(75.0, 45.0), directions(90.0, 0.0)
    e, a = len(catalog.sun_elevation) - 1, int(np.argmin(np.abs(catalog.sun_azimuth - 45.0)))
    assert (catalog.sun_elevation[e], catalog.sun_azimuth[a]) == (75.0, 45.0)
    slope = catalogs.ERRORS["height_sigma_m"] / catalogs.ERRORS["height_length_m"]

    def signal(view: np.ndarray) -> float:
        slopes = by_facets(sun, view)
        return float(np.log(slopes / np.hypot(0.09, slope * slopes)))

    ends = [signal(directions(60.0, azimuth)) for azimuth in catalog.view_azimuth[1:].tolist()]
    gains = signal(here) - np.array(ends)
    assert np.abs(gains).max() > 0.1
    stored = catalog.detection_probability[0, 0, 1:, e, a].astype(float)
    found = predict(catalog, [0], [sun], [here], [catalogs.GSD_M], catalog.view_altitude[1])
    want = chance(np.mean(height(stored) * np.exp(gains)))
    assert found.detection_probability[0] == pytest.approx(want, abs=1e-6)
    area = np.log(catalog.sigma_major[0, 0, 1:, e, a] * catalog.sigma_minor[0, 0, 1:, e, a])
    size = np.log(found.sigma_major_m * found.sigma_minor_m)[0]
    assert size == pytest.approx(
        np.mean(area) - 2.0 * gains.mean(), abs=1e-5
    )  # the trace of a logarithm
