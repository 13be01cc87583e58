"""Cells of the coverage, and when a region is too large for a tangent plane."""

from __future__ import annotations

import numpy as np
import pytest

from lcp_catalog.constants import MOON_RADIUS_M
from lcp_catalog.geometry.frames import central_angle_deg
from lcp_catalog.landmarks.selection import Places, nearest
from lcp_catalog.production.region_maps import coverage_cells
from lcp_catalog.terrain.area import Area

MOON = (-180.0, -90.0, 180.0, 90.0)


@pytest.mark.parametrize(
    ("bounds", "step_m"),
    [
        (MOON, 100e3),
        ((-180.0, -60.0, 180.0, 60.0), 80e3),
        ((0.0, 60.0, 360.0, 90.0), 40e3),
        ((170.0, -20.0, 250.0, 30.0), 50e3),
    ],
)
def test_cells_of_a_large_region_are_of_nearly_equal_area(
    bounds: tuple[float, float, float, float], step_m: float
) -> None:
    region = Area.from_bounds(*bounds)
    lon, lat, step = coverage_cells(region, step_m, 10**9)
    assert step == step_m
    assert region.contains(lon, lat).all()
    west, south, east, north = bounds
    zone = np.sin(np.radians(north)) - np.sin(np.radians(south))
    area_m2 = MOON_RADIUS_M**2 * np.radians(east - west) * zone
    assert len(lon) * step_m**2 == pytest.approx(area_m2, rel=0.06)
    rng = np.random.default_rng(3)
    sines = rng.uniform(np.sin(np.radians(south)), np.sin(np.radians(north)), 4000)
    cell, away_m = nearest(
        Places(rng.uniform(west, east, 4000), np.degrees(np.arcsin(sines))), Places(lon, lat)
    )
    assert away_m.max() < 1.1 * step_m  # every place has a cell, those at the region's edge too
    share = np.bincount(cell, minlength=len(lon))
    assert share.std() < 1.5 * np.sqrt(share.mean())  # as for random places in equal cells


def test_the_cells_are_at_most_so_many_and_then_an_even_sample() -> None:
    lon, _, step_m = coverage_cells(Area.from_bounds(*MOON), 4e3, 5000)
    assert 4000 < len(lon) <= 5100
    assert step_m == pytest.approx(87e3, rel=0.01)


def test_cells_of_neighbouring_large_regions_lie_on_the_same_rings() -> None:
    whole = np.stack(coverage_cells(Area.from_bounds(*MOON), 90e3, 10**9)[:2])
    part = np.stack(coverage_cells(Area.from_bounds(-100, -60, 80, 60), 90e3, 10**9)[:2])
    assert {tuple(p) for p in part.T.round(9)} <= {tuple(p) for p in whole.T.round(9)}


@pytest.mark.parametrize(
    ("region", "local"),
    [
        (Area(3.5, 26.0, 30.0), True),
        (Area(3.5, 90.0, 800.0), True),
        (Area(3.5, 90.0, 1900.0), False),
        (Area.from_bounds(0.0, 0.0, 20.0, 20.0), True),
        (Area.from_bounds(0.0, 0.0, 60.0, 40.0), False),
        (Area.from_bounds(0.0, 88.0, 360.0, 90.0), False),
        (Area.from_bounds(*MOON), False),
    ],
)
def test_a_region_is_local_where_a_tangent_plane_shows_it(region: Area, local: bool) -> None:
    assert region.is_local is local


def test_the_lattice_of_the_whole_moon_reaches_its_far_side() -> None:
    lon, lat = Area.from_bounds(*MOON).lattice(33)
    away = central_angle_deg(0.0, 0.0, lon, lat)
    assert np.mean(away > 90.0) == pytest.approx(0.5, abs=0.05)
    assert np.mean(np.abs(lat) > 30.0) == pytest.approx(0.5, abs=0.05)
