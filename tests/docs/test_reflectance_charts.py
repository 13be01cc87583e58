"""Charts of the reflectance models: their numbers compared with closed forms, their lines with the
models.
"""

from __future__ import annotations

import math
import re
from xml.etree import ElementTree

import numpy as np
import pytest
from helpers.twins_reflectance import SPECS, disc_albedo
from reflectance_charts import (
    ALLEN_1973,
    disc_reflectance,
    incidence_chart,
    phase_curve_chart,
)

from lcp_catalog.photometry.laws import reflectance_model

SVG = "{http://www.w3.org/2000/svg}"


def curves(svg: str) -> dict[str, np.ndarray]:
    """Points (n, 2) of each line by its class; pixels, y down."""
    lines = ElementTree.fromstring(svg).iter(f"{SVG}polyline")
    return {
        line.get("class"): np.array([p.split(",") for p in line.get("points").split()], float)
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


@pytest.mark.slow
def test_a_phase_chart_has_a_line_and_a_name_for_each_law():
    laws = [reflectance_model(spec) for spec in SPECS[:8]]
    svg = phase_curve_chart(laws)
    lines = curves(svg)
    assert len(lines) == len(laws)
    for law in laws:
        assert svg.count(f">{law.name}<") == 1
    for points in lines.values():
        assert np.isfinite(points).all()
        assert (np.diff(points[:, 0]) > 0).all()
        assert (np.diff(points[:, 1]) >= -0.1).all()  # fainter as the phase grows: down the page
    circles = ElementTree.fromstring(svg).findall(f"{SVG}circle")
    assert len(circles) == len(ALLEN_1973)


def test_the_moons_circles_lie_on_the_lunar_laws():
    svg = phase_curve_chart([reflectance_model("hapke"), reflectance_model("lambert")])
    hapke, lambert = curves(svg).values()
    for circle in ElementTree.fromstring(svg).findall(f"{SVG}circle")[2:8]:
        x, y = float(circle.get("cx")), float(circle.get("cy"))
        assert np.interp(x, *hapke.T) == pytest.approx(y, abs=12.0)
        assert np.interp(x, *lambert.T) < y - 10.0


def rays(svg: str, style: str) -> list[np.ndarray]:
    """Points (n, 2) of the lines of a style; the origin of a polar chart is (0, 0)."""
    lines = ElementTree.fromstring(svg).iter(f"{SVG}polyline")
    return [
        np.array([p.split(",") for p in line.get("points").split()], float)
        for line in lines
        if line.get("class") == style
    ]


def test_a_polar_chart_points_at_the_sun():
    """Hapke's greatest radiance is towards the Sun, on the left; Lambert's curve is an arc about the origin."""
    (back,) = rays(incidence_chart(reflectance_model("hapke"), [50.0]), "solid")
    brightest = back[np.hypot(*back.T).argmax()]
    assert math.degrees(math.atan2(-brightest[0], -brightest[1])) == pytest.approx(50.0, abs=1.0)
    (even,) = rays(incidence_chart(reflectance_model("lambert"), [50.0]), "solid")
    assert np.ptp(np.hypot(*even.T)) < 0.2


def test_charts_stand_alone():
    for svg in (
        incidence_chart(reflectance_model("hapke")),
        phase_curve_chart([reflectance_model("hapke")]),
    ):
        assert svg.startswith("<svg xmlns=")
        assert not re.search(r"nan|inf\b", svg)
