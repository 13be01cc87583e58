"""Advice beside a verdict, and verdicts that the data do not carry."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.lone_hill import above_it, bump_catalog

from lcp_catalog.images.image import Image
from lcp_catalog.matching.fix import CANNOT_SAY, NOT_HERE, Fix
from lcp_catalog.matching.matches import Matches
from lcp_catalog.validation.advice import (
    albedo_advice,
    opposite_advice,
    turned_or_unlit,
)
from lcp_catalog.validation.ground_comparison import WindowComparison

bump = pytest.fixture(bump_catalog, scope="module")
above = pytest.fixture(above_it, scope="module")
REFUTED = Fix(NOT_HERE, "no shift is significant", Matches.none())


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
