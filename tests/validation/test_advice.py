"""Advice beside a verdict, and verdicts that the data do not carry."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.lone_hill import above_it, bump_catalog

from lcp_catalog.cameras.sensor import Uncertainty
from lcp_catalog.images.image import Image
from lcp_catalog.matching.fix import CANNOT_SAY, NOT_HERE, Fix
from lcp_catalog.matching.matches import Matches
from lcp_catalog.validation import advice
from lcp_catalog.validation.advice import (
    advised,
    albedo_advice,
    opposite_advice,
    turned_or_unlit,
)
from lcp_catalog.validation.ground_comparison import WindowComparison

bump = pytest.fixture(bump_catalog, scope="module")
above = pytest.fixture(above_it, scope="module")
REFUTED = Fix(NOT_HERE, "no shift is significant", Matches.none())


def test_few_points_refute_no_place(bump, above) -> None:
    found = advised(REFUTED, bump, above, Uncertainty(10.0), 3.0)
    assert found.verdict == CANNOT_SAY
    assert found.reason.startswith("no shift is significant; only 1 points may be in view")
    assert "smaller spacing" in found.reason
    assert "sigma" not in found.reason


@pytest.mark.parametrize(
    ("uncertainty", "option"),
    [(Uncertainty(1e5), "m of position"), (Uncertainty(1.0, 1.0), "deg of attitude")],
)
def test_an_image_smaller_than_the_search_refutes_no_place(
    bump, above, monkeypatch, uncertainty, option
) -> None:
    monkeypatch.setattr(advice, "FEWEST", 1)
    found = advised(REFUTED, bump, above, uncertainty, 3.0)
    assert found.verdict == CANNOT_SAY
    assert "; the stated uncertainty reaches" in found.reason
    assert found.reason.endswith(option)
    assert "smaller spacing" not in found.reason
    assert advised(REFUTED, bump, above, Uncertainty(10.0), 3.0) is REFUTED


def test_the_uncertainty_advised_reaches_half_of_the_image(bump, above, monkeypatch) -> None:
    monkeypatch.setattr(advice, "FEWEST", 1)
    text = advised(REFUTED, bump, above, Uncertainty(1e5), 3.0).reason
    sigma_m = float(text.split(", like ")[1].removesuffix(" m of position"))
    assert advised(REFUTED, bump, above, Uncertainty(sigma_m), 3.0).verdict == NOT_HERE


def test_a_camera_that_sees_no_point_is_explained(bump, above) -> None:
    unseen = Fix(CANNOT_SAY, "none can be in view", Matches.none())
    turned = replace(above, rotation_mcmf_to_camera=above.rotation_mcmf_to_camera.T)
    assert "its transpose" in advised(unseen, bump, turned, Uncertainty(10.0), 3.0).reason
    up = np.diag([1.0, -1.0, -1.0]) @ above.rotation_mcmf_to_camera
    away = replace(above, rotation_mcmf_to_camera=up)
    assert "OpenGL" in advised(unseen, bump, away, Uncertainty(10.0), 3.0).reason
    elsewhere = replace(above, position_mcmf_m=-above.position_mcmf_m)
    assert "transpose" not in advised(unseen, bump, elsewhere, Uncertainty(10.0), 3.0).reason


def windows(textured: float, plain: float) -> WindowComparison:
    """Ten windows, five with texture, of which these correlations are equal."""
    n, none = np.arange(10), np.zeros(10, np.int64)
    correlation = np.where(n < 5, textured, plain)
    return WindowComparison(
        16, 16, 100.0, none, none, correlation, np.where(n < 5, 2.0, 1.0), np.ones(10), "kept"
    )


def test_plain_ground_that_fails_asks_for_an_albedo_map() -> None:
    assert "0 % of the windows with little texture" in albedo_advice(windows(0.9, 0.2))
    assert "try an albedo map" in albedo_advice(windows(0.9, 0.2))
    assert albedo_advice(windows(0.9, 0.9)) == ""
    assert albedo_advice(windows(0.2, 0.2)) == ""


def test_exchanged_light_and_dark_mean_an_opposite_sun() -> None:
    assert "-0.85: light and dark are exchanged" in opposite_advice(windows(-0.85, -0.85))
    assert opposite_advice(windows(-0.3, -0.3)) == ""
    assert opposite_advice(windows(0.9, 0.9)) == ""


def test_an_image_that_is_turned_or_dark_is_explained(bump, above) -> None:
    """The true rotation is a quarter turn of the stated one; the Sun of the dark image is below the point."""
    blank = np.zeros(above.shape, np.float32)
    sun = np.array([1.0, 0.0, 0.0])
    quarter = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    stated = replace(above, rotation_mcmf_to_camera=quarter.T @ above.rotation_mcmf_to_camera)
    image = Image("made up", blank, blank, stated, sun_direction_mcmf=sun)

    def locate(tried: Image) -> Fix:
        error = tried.sensor.rotation_mcmf_to_camera - above.rotation_mcmf_to_camera
        right = np.abs(error).max() < 1e-12
        return replace(REFUTED, reason="5 of 9", pose=object() if right else None)

    text = turned_or_unlit(REFUTED, bump, image, locate)
    assert text.startswith("; turned by 90 deg about the optical axis it would be located (5 of 9)")
    assert text.endswith("from the left by [[0, 1, 0], [-1, 0, 0], [0, 0, 1]]")
    unsaid = replace(REFUTED, verdict=CANNOT_SAY)
    assert turned_or_unlit(unsaid, bump, image, locate) == ""
    dark = replace(image, sun_direction_mcmf=-sun)
    assert "; the Sun is 90.0 deg below" in turned_or_unlit(REFUTED, bump, dark, locate)
