"""Cameras by field of view, altitude and direction: angles between rays, level rows, refused values."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lcp_catalog.cameras.view import pointed_camera
from lcp_catalog.errors import CameraError

PLACE, SIZE = (200.0, -35.0), (300, 100)


@pytest.mark.parametrize("look", [(0.0, -90.0), (75.0, -90.0), (75.0, -30.0), (250.0, 10.0)])
@pytest.mark.parametrize("fov", [0.5, 60.0, 170.0])
def test_the_field_of_view_is_that_across_the_width(look, fov):
    camera = pointed_camera(PLACE, 1e5, look, fov, SIZE)
    left, right, top, bottom = camera.rays([[-0.5, 49.5], [299.5, 49.5], [149.5, -0.5], [149.5, 99.5]])  # fmt: skip
    assert np.degrees(np.arccos(left @ right)) == pytest.approx(fov, abs=1e-9)
    high = 2.0 * np.degrees(np.arctan(np.tan(np.radians(fov / 2)) / 3.0))
    assert np.degrees(np.arccos(top @ bottom)) == pytest.approx(high, abs=1e-6)


@pytest.mark.parametrize("elevation", [-89.9, -30.0, 10.0])
def test_rows_are_level_and_the_axis_has_its_angles(elevation):
    """Angles from dot products with up and with the direction to the pole."""
    camera = pointed_camera(PLACE, 1e5, (75.0, elevation), 40.0, SIZE)
    up = camera.position_mcmf_m / np.linalg.norm(camera.position_mcmf_m)
    assert np.linalg.norm(camera.position_mcmf_m) == pytest.approx(1837400.0, abs=1e-6)
    right, down, ahead = camera.rotation_mcmf_to_camera
    assert right @ up == pytest.approx(0.0, abs=1e-12)
    assert down @ up < 0.0
    assert np.degrees(np.arcsin(ahead @ up)) == pytest.approx(elevation, abs=1e-6)
    north = np.array([0.0, 0.0, 1.0]) - up[2] * up
    north /= np.linalg.norm(north)
    east = np.cross(north, up)
    assert np.degrees(np.arctan2(ahead @ east, ahead @ north)) == pytest.approx(75.0, abs=1e-6)
    assert np.degrees(np.arctan2(right @ east, right @ north)) == pytest.approx(165.0, abs=1e-9)


@pytest.mark.parametrize(
    ("altitude_m", "look", "fov", "says"),
    [
        (0.0, (0.0, -90.0), 40.0, "altitude"),
        (1e12, (0.0, -90.0), 40.0, "altitude"),
        (1e5, (0.0, -91.0), 40.0, "elevation"),
        (1e5, (np.nan, -90.0), 40.0, "no number"),
        (1e5, (0.0, -90.0), 180.0, "field of view"),
        (1e5, (0.0, -90.0), 0.0, "field of view"),
    ],
)
def test_refused_values(altitude_m, look, fov, says):
    with pytest.raises(CameraError, match=says):
        pointed_camera(PLACE, altitude_m, look, fov, SIZE)


def test_a_direction_in_radians_is_doubted(caplog: pytest.LogCaptureFixture) -> None:
    """From 100 km the limb is 19 deg below the horizontal; what looks lower, or is no direction in radians, is not doubted."""

    def said(azimuth: float, elevation: float) -> str:
        caplog.clear()
        pointed_camera((3.5, 26.0), 100e3, (azimuth, elevation), 45.0, (64, 64))
        return caplog.text

    text = said(math.pi / 2, -math.radians(80.0))
    assert (
        "above the limb (-18.99 deg); in radians these numbers were azimuth 90, elevation -80"
        in text
    )
    for direction in ((0.0, -90.0), (1.0, -30.0), (90.0, -1.2), (1.0, 1.2), (0.0, -0.2)):
        assert said(*direction) == ""


def test_the_page_makes_the_camera_that_looks_down() -> None:
    """The lines for a camera of one's own (docs/reference/cameras.md) against the one of place, height and field of view."""
    page = Path(__file__).parents[2] / "docs" / "reference" / "cameras.md"
    block = page.read_text(encoding="utf-8").partition("**Make one**")[2].split("```")[1]
    names: dict[str, Any] = {"np": np}
    exec(block.removeprefix("python\n"), names)
    made, same = (
        names["camera"],
        pointed_camera((145.0, -20.0), 100e3, (0.0, -90.0), 40.0, (512, 512)),
    )
    assert made["position_mcmf_m"] == pytest.approx(same.position_mcmf_m.tolist(), abs=1e-6)
    np.testing.assert_allclose(
        made["rotation_mcmf_to_camera"], same.rotation_mcmf_to_camera, atol=1e-12
    )
    assert made["focal_length_px"] == pytest.approx(same.focal_length_px)
    assert made["principal_point_px"] == list(same.principal_point_px)
