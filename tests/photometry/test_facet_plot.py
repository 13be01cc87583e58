"""Polar plots of a facet model: what is drawn where."""

import re
import xml.etree.ElementTree as ET

import numpy as np
import pytest

from lcp_catalog.photometry.facet_labunets2019 import named_model
from lcp_catalog.photometry.facet_model import Shadowing, shadowing_share
from lcp_catalog.photometry.facet_plot import brightness_chart, intensity_chart, shadowing_chart

MODEL = named_model("labunets-2019-table-3")


def lines(svg, css):
    root = ET.fromstring(svg)
    found = [e for e in root.iter() if e.tag.endswith("polyline") and e.get("class") == css]
    return [np.array(re.findall(r"-?[\d.]+", e.get("points")), float).reshape(-1, 2) for e in found]


def test_the_specular_lobe_is_on_the_right_and_the_light_on_the_left():
    svg = intensity_chart(MODEL, [60, 70])
    whole, glow = lines(svg, "model"), lines(svg, "diffuse")
    assert len(whole) == len(glow) == len(lines(svg, "directional")) == 2
    x, y = whole[1][np.hypot(*whole[1].T).argmax()]
    assert y < 0  # up
    assert np.degrees(np.arctan2(x, -y)) == pytest.approx(75, abs=2)
    lamp = next(e for e in ET.fromstring(svg).iter() if e.get("class") == "light" and e.get("cx"))
    assert float(lamp.get("cx")) < 0


def test_lengths_are_values():
    """At the normal, in units of the half circle's figure."""
    svg = brightness_chart(MODEL, [60])
    (points,) = lines(svg, "model")
    normal = points[np.abs(points[:, 0]).argmin()]
    rims = [
        float(e.text)
        for e in ET.fromstring(svg).iter()
        if e.text and re.fullmatch(r"[\d.]+", e.text)
    ]
    assert -normal[1] / 190 * max(rims) == pytest.approx(float(MODEL.brightness(60, 0)), rel=0.01)
    assert np.abs(np.degrees(np.arctan2(points[:, 0], -points[:, 1]))).max() <= 80.1


def test_shadowing():
    theta = np.array([-89.9, -60, -30, 0.0, 30, 60, 89.9])
    share = shadowing_share(Shadowing(), 30, theta)
    assert (share > 0).all()
    assert (share <= 1).all()
    assert share[[0, -1]].max() < 0.1
    assert share[3] > 0.98
    assert shadowing_share(Shadowing(sigma_p=0.0), 30, theta) == pytest.approx(np.ones(7))
    assert len(lines(shadowing_chart(MODEL, [0, 60]), "model")) == 1
