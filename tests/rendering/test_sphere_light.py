"""Light on the plain sphere: the Sun's disc at a level horizon, several sources, and orientation."""

import itertools
import math

import numpy as np
import pytest
from helpers.sphere_views import LAMBERT, WHOLE, R, far_camera, lit_from

from lcp_catalog.cameras.view import oblique_view
from lcp_catalog.constants import SOLAR_RADIUS_RAD
from lcp_catalog.geometry.frames import EnuFrame, direction_enu
from lcp_catalog.light.solar_disc import MEAN_SUN
from lcp_catalog.light.sources import Lighting, LightSource
from lcp_catalog.rendering.sphere_renderer import (
    render_sphere_camera,
    render_sphere_enu,
    share_and_cosine,
)
from lcp_catalog.terrain.area import NodeWindow

# ---- the Sun's disc


@pytest.mark.parametrize("off_radii", [-2.0, -0.99, -0.6, -0.1, 0.0, 0.3, 0.8, 1.2])
def test_a_disc_over_a_level_horizon(off_radii):
    """Share and light of a Lambert facet from 200 000 points of equal flux."""
    elevation = off_radii * SOLAR_RADIUS_RAD
    source = LightSource(np.array([0.0, math.cos(elevation), math.sin(elevation)]), disc=MEAN_SUN)
    share, cosine = share_and_cosine(np.array([math.sin(elevation)]), source)
    x, y = MEAN_SUN.limb_darkening.samples(200_000).T * math.tan(SOLAR_RADIUS_RAD)
    up = math.sin(elevation) + y * math.cos(elevation)
    sine = up / np.sqrt(1.0 + x * x + y * y)
    assert share[0] == pytest.approx(np.mean(sine > 0), abs=2e-4)
    assert share[0] * cosine[0] == pytest.approx(np.maximum(sine, 0.0).mean(), rel=3e-4, abs=2e-8)


def test_the_terminator_is_as_soft_as_the_sun_is_wide():
    """Along the equator with the subsolar point at (90 E, 0): lit up to the horizon of the upper limb."""
    frame, gsd = EnuFrame(0.0, 0.0), 500.0
    window = NodeWindow(0, 1, -100, 101)
    for disc in (False, True):
        result = render_sphere_enu(
            frame, window, gsd, lit_from(90.0, 0.0, disc), oblique_view(0.0, 0.0), model=LAMBERT
        )
        angle = np.arcsin(np.arange(-100, 101) * gsd / R)
        width = SOLAR_RADIUS_RAD if disc else 0.0
        assert (result.radiance[0, angle < -width - 1e-5] == 0).all()
        assert (result.radiance[0, angle > -width + 2e-4] > 0).all()
        assert (np.diff(result.sunlit[0]) >= 0).all()
        middle = result.sunlit[0, 100]
        assert middle == pytest.approx(0.5 if disc else 0.0, abs=1e-6)


def test_several_sources_add():
    frame, view = EnuFrame(0.0, 0.0), oblique_view(0.0, 0.0)
    one, two = (
        LightSource(direction_enu(90, 30)),
        LightSource(direction_enu(270, 50), 0.25, name="Earth"),
    )
    how = (frame, WHOLE, 43e3)
    both = render_sphere_enu(*how, Lighting((one, two)), view, model=LAMBERT)
    first, second = (
        render_sphere_enu(*how, Lighting((s,)), view, model=LAMBERT) for s in (one, two)
    )
    assert both.radiance == pytest.approx(first.radiance + second.radiance, rel=1e-5, nan_ok=True)
    seen = np.nonzero(first.visible)
    mu = np.cos(np.radians(second.incidence_deg[seen].astype(float)))
    assert second.radiance[seen] == pytest.approx(
        0.25 * 0.12 * np.maximum(mu, 0.0), rel=1e-4, abs=1e-8
    )
    assert both.sunlit == pytest.approx(first.sunlit)
    assert both.incidence_deg == pytest.approx(first.incidence_deg, nan_ok=True)


# ---- which way round


def test_the_side_of_the_sun_is_bright():
    places = [(0.0, 0.0), (75.0, 40.0), (180.0, -35.0), (0.0, 90.0), (0.0, -90.0)]
    sides = [(0, "top"), (90, "right"), (180, "bottom"), (270, "left")]
    for (lon, lat), (azimuth, side) in itertools.product(places, sides):
        frame = EnuFrame(lon, lat)
        result = render_sphere_camera(frame, far_camera(frame, pixels=21), lit_from(azimuth, 5.0))
        light = np.nan_to_num(result.radiance)
        halves = {
            "top": light[:10],
            "bottom": light[11:],
            "left": light[:, :10],
            "right": light[:, 11:],
        }
        other = {"top": "bottom", "bottom": "top", "left": "right", "right": "left"}[side]
        assert halves[side].sum() > 10 * halves[other].sum()
        nodes = render_sphere_enu(
            frame, WHOLE, 43e3, lit_from(azimuth, 5.0), oblique_view(0.0, 0.0)
        )
        light = np.nan_to_num(nodes.radiance)
        halves = {
            "top": light[:40],
            "bottom": light[41:],
            "left": light[:, :40],
            "right": light[:, 41:],
        }
        assert halves[side].sum() > 10 * halves[other].sum()
