"""Drawings of the catalogue page: shaded relief, Sun discs, map, histograms."""

from __future__ import annotations

import re

import numpy as np
import pytest
from helpers.pages import parsed

from lcp_catalog.catalog import charts
from lcp_catalog.geometry.map_plane import MapPlane


@pytest.mark.parametrize("lat", [-90.0, 89.9, 0.0])
def test_a_map_anywhere_parses(lat: float) -> None:
    x = np.linspace(-40e3, 40e3, 33)
    drawn = charts.ReliefMap(
        np.zeros((33, 33)), x, x[::-1], MapPlane("orthographic", 359.9, lat)
    ).draw([], "map")
    parsed(drawn)
    assert "nan" not in drawn


def test_slopes_to_the_north_west_are_bright() -> None:
    row, col = np.indices((21, 21)) - 10
    lit = charts.hillshade(500.0 - 30.0 * np.hypot(row, col), 100.0)  # a cone
    assert lit[4, 4, 0] > 200  # row 0 is north, column 0 west
    assert lit[16, 16, 0] < 100
    holed = np.zeros((5, 5))
    holed[0, 0] = np.nan
    assert charts.hillshade(holed, 1.0)[0, 0, 1] == 0


def test_the_disc_has_north_up_and_east_right() -> None:
    disc = charts.SunDisc(np.array([0.0, 30.0, 60.0]), np.array([0.0, 90.0, 180.0, 270.0]))
    outline = re.search(r'id="s1-1" d="M([^A]*)A', disc.definitions())
    assert outline is not None
    x, y = (float(v) for v in outline[1].split())  # elevation 15, azimuth 45: up and right
    assert (x, y) == pytest.approx(
        (100 * 75 / 90 * np.sqrt(0.5), -100 * 75 / 90 * np.sqrt(0.5)), abs=0.06
    )
    share = np.full((3, 4), np.nan)
    share[1, 1] = 1.0
    drawn = disc.draw(share, "d")
    assert drawn.count("<use") == 1
    assert '<use href="#s1-1" class="c5">' in drawn


def test_a_map_puts_places_where_they_are() -> None:
    x = np.arange(-5, 6) * 100.0
    chart = charts.ReliefMap(np.zeros((11, 11)), x, x[::-1], MapPlane("orthographic", 0.0, 0.0))
    west, north = chart.pixel(-550.0, 550.0)
    east, south = chart.pixel(550.0, -550.0)
    assert (west, north) == pytest.approx((100.0, 14.0))
    assert east == pytest.approx(946.0)
    assert south > north


def test_the_names_of_meridians_lie_within_the_map() -> None:
    """Also that of one at the eastern edge, whose middle it would be."""
    x = np.linspace(-60.6e3, 60.6e3, 33)  # 2 deg at the equator
    chart = charts.ReliefMap(np.zeros((33, 33)), x, x[::-1], MapPlane("orthographic", 100.0, 0.0))
    names = re.findall(r'<text x="([0-9.]+)"[^>]*"middle">([0-9.]+° E)<', chart.draw([], "map"))
    assert names[-1][1] == "102° E"
    assert all(float(at) + 5.0 * len(name) <= charts.MAP_PX for at, name in names)


def test_histograms_count_everything() -> None:
    values = np.random.default_rng(2).normal(5.0, 2.0, 500)
    drawn = charts.distribution([*values, np.nan], "m", "h").chart
    parsed(drawn)
    assert sum(int(n) for n in re.findall(r": (\d+)</title>", drawn)) == 500
    same = charts.distribution([2.0, 2.0, 2.0], "m", "h")
    assert (same.chart, same.single, same.count) == (None, "2 m", 3)
    nothing = charts.distribution([np.nan], "m", "h")
    assert (nothing.chart, nothing.single, nothing.count) == (None, "", 0)


def test_low_suns_fill_the_disc() -> None:
    """At a pole the Sun reaches the lowest of three elevations; its cell ends at 2 deg of 3."""
    elevation, azimuth = np.array([1.0, 3.0, 45.0]), np.arange(0.0, 360.0, 90.0)
    suns = np.zeros((3, 4), np.bool_)
    suns[0] = True
    disc = charts.SunDisc.of(elevation, azimuth, suns)
    assert disc.top_deg == 3.0
    outline = re.search(r'id="s0-0" d="M[^"]*?L([^A]*)A', disc.definitions())
    assert outline is not None
    assert np.hypot(*map(float, outline[1].split())) == pytest.approx(100.0 / 3.0, abs=0.1)
    assert ">2°</text>" in disc.draw(np.where(suns, 1.0, np.nan), "d", large=True)
    assert charts.SunDisc.of(elevation, azimuth, ~suns).top_deg == 90.0
