"""Advice beside a verdict, and verdicts that the data do not carry."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.lone_hill import above_it, bump_catalog, plain_photo

from lcp_catalog.cameras.sensor import Uncertainty
from lcp_catalog.matching import fix_advice, position_fix
from lcp_catalog.matching.fix import CANNOT_SAY, NOT_HERE, Fix
from lcp_catalog.matching.fix_advice import advised
from lcp_catalog.matching.matches import Matches

bump = pytest.fixture(bump_catalog, scope="module")
above = pytest.fixture(above_it, scope="module")
REFUTED = Fix(NOT_HERE, "no shift is significant", Matches.none())


def test_few_points_refute_no_place(bump, above) -> None:
    found = advised(REFUTED, bump, above, Uncertainty(10.0), 3.0)
    assert found.verdict == CANNOT_SAY
    assert found.reason.startswith("no shift is significant; only 1 points may be in view")
    assert "smaller spacing" in found.reason
    assert "sigma" not in found.reason


def test_locate_says_so_itself(bump, above, monkeypatch) -> None:
    """Also from Python, without a validation around it."""
    monkeypatch.setattr(position_fix, "fix_in_area", lambda *_: REFUTED)
    photo = plain_photo(np.ones(above.shape), above)
    assert position_fix.locate(bump, photo, Uncertainty(10.0)).verdict == CANNOT_SAY
    monkeypatch.setattr(fix_advice, "FEWEST", 1)
    assert position_fix.locate(bump, photo, Uncertainty(10.0)) is REFUTED


@pytest.mark.parametrize(
    ("uncertainty", "option"),
    [(Uncertainty(1e5), "m of position"), (Uncertainty(1.0, 1.0), "deg of attitude")],
)
def test_an_image_smaller_than_the_search_refutes_no_place(
    bump, above, monkeypatch, uncertainty, option
) -> None:
    monkeypatch.setattr(fix_advice, "FEWEST", 1)
    found = advised(REFUTED, bump, above, uncertainty, 3.0)
    assert found.verdict == CANNOT_SAY
    assert "; the stated uncertainty reaches" in found.reason
    assert found.reason.endswith(option)
    assert "smaller spacing" not in found.reason
    assert advised(REFUTED, bump, above, Uncertainty(10.0), 3.0) is REFUTED


def test_the_uncertainty_advised_reaches_half_of_the_image(bump, above, monkeypatch) -> None:
    monkeypatch.setattr(fix_advice, "FEWEST", 1)
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
