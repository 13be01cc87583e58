"""The pictures of the laws: their numbers against closed forms, their lines against the laws."""

from __future__ import annotations

import math
import re
from xml.etree import ElementTree

import numpy as np
import pytest
from helpers.twins_reflectance import SPECS, disc_albedo

from lcp_catalog.photometry.laws import radiance_factor, reflectance_model
from lcp_catalog.photometry.phase_curves import (
    ALLEN_1973,
    disc_reflectance,
    ground_reflectance,
    phase_curve_chart,
    polar_chart,
)

SVG = "{http://www.w3.org/2000/svg}"


def curves(svg: str) -> dict[str, np.ndarray]:
    """Points (n, 2) of each line by its colour; pixels, y down."""
    lines = ElementTree.fromstring(svg).iter(f"{SVG}polyline")
    return {
        line.get("stroke"): np.array([p.split(",") for p in line.get("points").split()], float)
        for line in lines
    }


@pytest.mark.parametrize("spec", ["lambert", "hapke", "lunar-lambert"])
@pytest.mark.parametrize("phase", [0.0, 5.0, 90.0, 140.0])
def test_a_spheres_disc(spec, phase):
    law = reflectance_model(spec)
    assert disc_reflectance(law, phase) == pytest.approx(disc_albedo(law, phase), rel=2e-4)
    if spec == "lambert":
        g = math.radians(phase)
        exact = 0.08 * (math.sin(g) + (math.pi - g) * math.cos(g)) / math.pi
        assert disc_reflectance(law, phase) == pytest.approx(exact, rel=1e-4)


def test_ground_seen_from_above():
    law = reflectance_model("hapke")
    g = math.radians(40.0)
    assert ground_reflectance(law, 40.0) == radiance_factor(law, g, 0.0, g)


@pytest.mark.parametrize("of_ground", [False, True])
def test_a_phase_chart_has_a_line_and_a_name_for_each_law(of_ground):
    laws = [reflectance_model(spec) for spec in SPECS[:8]]
    svg = phase_curve_chart(laws, of_ground)
    lines = curves(svg)
    assert len(lines) == len(laws)
    for law in laws:
        assert svg.count(f">{law.name}<") == 1
    for points in lines.values():
        assert np.isfinite(points).all()
        assert (np.diff(points[:, 0]) > 0).all()
        assert (np.diff(points[:, 1]) >= -0.1).all()  # fainter as the phase grows: down the page
    circles = ElementTree.fromstring(svg).findall(f"{SVG}circle")
    assert len(circles) == (0 if of_ground else len(ALLEN_1973))


def test_the_moons_circles_lie_on_the_lunar_laws():
    svg = phase_curve_chart([reflectance_model("hapke"), reflectance_model("lambert")])
    hapke, lambert = curves(svg).values()
    for circle in ElementTree.fromstring(svg).findall(f"{SVG}circle")[2:8]:
        x, y = float(circle.get("cx")), float(circle.get("cy"))
        assert np.interp(x, *hapke.T) == pytest.approx(y, abs=12.0)
        assert np.interp(x, *lambert.T) < y - 10.0


def test_a_polar_chart_points_at_the_sun():
    """Hapke's brightest ray goes back to the Sun, on the left; Lambert's is a circle's arc about the middle."""
    middle, base = 380.0, 372.0
    (back,) = curves(polar_chart(reflectance_model("hapke"), [50.0])).values()
    ray = back - [middle, base]
    brightest = ray[np.hypot(*ray.T).argmax()]
    assert math.degrees(math.atan2(-brightest[0], -brightest[1])) == pytest.approx(50.0, abs=1.0)
    (even,) = curves(polar_chart(reflectance_model("lambert"), [50.0])).values()
    assert np.ptp(np.hypot(*(even - [middle, base]).T)) < 0.2


def test_charts_stand_alone():
    for svg in (
        polar_chart(reflectance_model("hapke")),
        phase_curve_chart([reflectance_model("hapke")]),
    ):
        assert svg.startswith("<svg xmlns=")
        assert not re.search(r"nan|inf\b", svg)
