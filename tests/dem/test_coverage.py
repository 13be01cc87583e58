"""Coverage of a set of files: areas against closed forms and against random points projected by PROJ."""

from __future__ import annotations

import math

import numpy as np
import pyproj
import pytest
from helpers.bare_files import (
    NORTH,
    R_KM,
    corner,
    covered,
    cylinder,
    plane_rectangle,
    polar,
    rectangle,
)
from helpers.products import DEGREE_M, EQC
from hypothesis import given, settings
from hypothesis import strategies as st

from lcp_catalog.dem.coverage import MOON_KM2, POLAR_ERROR
from lcp_catalog.dem.dem import Dem


def test_the_reference_for_polar_rectangles() -> None:
    """The whole plane is the whole Moon, a small rectangle is flat, and Gauss-Legendre sums agree with the closed form."""
    assert 4.0 * corner(1e9, 1e9) == pytest.approx(MOON_KM2, rel=1e-8)
    assert plane_rectangle(0.0, 0.0, 1.0, 2.0) == pytest.approx(2.0, rel=1e-5)
    t, weight = np.polynomial.legendre.leggauss(30)
    x, y = np.meshgrid(0.15 * (t + 1.0), 0.35 * (t + 1.0))
    whole = 0.15 * 0.35 * weight @ (4.0 / (1.0 + x * x + y * y) ** 2) @ weight
    assert corner(0.3, 0.7) == pytest.approx(whole * R_KM**2, rel=1e-12)


@pytest.mark.parametrize(
    ("dem", "area_km2"),
    [
        (cylinder(10, 20, 30, 25), rectangle(10, 20, 30, 25)),
        (cylinder(350, -10, 372, 10), rectangle(350, -10, 372, 10)),  # over 0/360
        (cylinder(170, 55, 190, 65), rectangle(170, 55, 190, 65)),  # over 180 and a band's edge
        (cylinder(0, 75, 360, 90), 2.0 * math.pi * R_KM**2 * (1.0 - math.sin(math.radians(75.0)))),  # a cap
        (cylinder(-180, -90, 180, 90, 4), 4.0 * math.pi * R_KM**2),
        (polar(-300, -300, 600, 600), plane_rectangle(-300, -300, 300, 300)),  # a pole in its middle
        (polar(-300, -300, 600, 600, -1, 77.0), plane_rectangle(-300, -300, 300, 300)),
        (polar(0, 0, 400, 300), plane_rectangle(0, 0, 400, 300)),  # a pole at its corner
        (polar(100, -50, 200, 400, -1), plane_rectangle(100, -50, 300, 350)),
        (polar(-1, -1, 2, 2), plane_rectangle(-1, -1, 1, 1)),  # one kilometre around the pole
    ],
)  # fmt: skip
def test_areas_are_those_of_closed_forms(dem: Dem, area_km2: float) -> None:
    """A cylinder's to rounding, a polar map's within the stated bound."""
    found, rel = covered(dem), POLAR_ERROR if dem.grid.pole else 1e-9
    assert found.covered_km2 == pytest.approx(area_km2, rel=rel)
    assert found.file_km2 == pytest.approx((area_km2,), rel=rel)
    assert found.used_km2 == pytest.approx((area_km2,), rel=rel)
    assert sum(band.covered_km2 for band in found.bands) == pytest.approx(area_km2, rel=rel)
    assert found.covered_km2 + sum(band.gap_km2 for band in found.bands) == pytest.approx(
        found.box_km2, rel=1e-9
    )


def test_bands_split_at_the_tables_latitudes() -> None:
    found = covered(cylinder(0, -62, 90, 86))
    edges = [(85, 86), (80, 85), (75, 80), (60, 75), (0, 60), (-60, 0), (-62, -60)]
    assert [(b.south_deg, b.north_deg) for b in found.bands] == [
        (85, 90), (80, 85), (75, 80), (60, 75), (0, 60), (-60, 0), (-75, -60),
    ]  # fmt: skip
    assert [b.covered_km2 for b in found.bands] == pytest.approx(
        [rectangle(0, s, 90, n) for s, n in edges], rel=1e-9
    )
    assert [b.area_km2 for b in found.bands] == pytest.approx(
        [rectangle(0, b.south_deg, 360, b.north_deg) for b in found.bands]
    )


def test_used_is_the_product_that_the_table_says() -> None:
    low, high = (
        cylinder(10, 50, 20, 65, 512, "SLDEM2015_512"),
        cylinder(10, 55, 20, 70, 512, "LDEM_512"),
    )
    found = covered(high, low)
    assert [b.used_km2 for b in found.bands] == [
        {"LDEM_512": pytest.approx(rectangle(10, 60, 20, 70))},
        {"SLDEM2015_512": pytest.approx(rectangle(10, 50, 20, 60))},
    ]
    assert found.used_km2 == pytest.approx((rectangle(10, 60, 20, 70), rectangle(10, 50, 20, 60)))
    assert [b.overlap_km2 for b in found.bands] == pytest.approx(
        [rectangle(10, 60, 20, 65), rectangle(10, 55, 20, 60)]
    )


def test_overlaps_by_pair_and_no_slivers() -> None:
    a, b, c = cylinder(350, 0, 370, 10), cylinder(5, 4, 30, 8), polar(-2000, -2000, 4000, 4000)
    beside = cylinder(30, 4, 40, 8)  # touches b
    found = covered(a, b, c, beside)
    (one,) = found.overlaps
    assert (one.first, one.second) == (0, 1)
    assert one.area_km2 == pytest.approx(rectangle(5, 4, 10, 8), rel=1e-9)
    inside = covered(polar(-200, -200, 400, 400), polar(-50, 20, 30, 100), cylinder(0, 88, 360, 90))
    pairs = {(o.first, o.second): o.area_km2 for o in inside.overlaps}
    cap = 2.0 * math.pi * R_KM**2 * (1.0 - math.sin(math.radians(88.0)))
    assert pairs[0, 1] == pytest.approx(plane_rectangle(-50, 20, -20, 120), rel=POLAR_ERROR)
    assert pairs[0, 2] == pytest.approx(cap, rel=1e-9)
    assert [o.area_km2 for o in inside.overlaps] == sorted(pairs.values(), reverse=True)


def test_a_meridian_cuts_a_polar_map() -> None:
    """Longitudes 100 to 130 of a rectangle around the pole: the integral of 1 - cos(colatitude) along its edge x = d."""
    found = covered(polar(-300, -800, 600, 1600), cylinder(100, 60, 130, 90))
    d = 300.0 / (2.0 * R_KM)
    root = math.sqrt(1.0 + d * d)
    ends = [math.atan(d * math.tan(math.radians(angle)) / root) for angle in (10.0, 40.0)]
    (overlap,) = found.overlaps
    assert overlap.area_km2 == pytest.approx(
        2.0 * R_KM**2 * d / root * (ends[1] - ends[0]), rel=POLAR_ERROR
    )
    assert (overlap.bounds.west, overlap.bounds.east) == pytest.approx((100.0, 130.0))


@st.composite
def files(draw: st.DrawFn) -> list[tuple[Dem, str, tuple[float, float, float, float]]]:
    """One to four files, each with its CRS for PROJ and its edges in metres of that map: left, bottom, right, top."""
    found = []
    for _ in range(draw(st.integers(1, 4))):
        if draw(st.booleans()):
            west, south = draw(st.integers(-180, 300)), draw(st.integers(-30, 80))
            wide, high = draw(st.integers(1, 90)), draw(st.integers(1, 90 - south))
            middle = west + wide / 2.0  # so that PROJ does not wrap the tile
            crs = EQC.replace("lon_0=0", f"lon_0={middle}")
            edges = tuple(v * DEGREE_M for v in (-wide / 2.0, south, wide / 2.0, south + high))
            found.append((cylinder(west, south, west + wide, south + high, 4), crs, edges))
        else:
            lon = draw(st.sampled_from([0.0, 33.0, 180.0, 270.0]))
            left, bottom = draw(st.integers(-900, 600)), draw(st.integers(-900, 600))
            wide, high = draw(st.integers(30, 900)), draw(st.integers(30, 900))
            edges = tuple(1000.0 * v for v in (left, bottom, left + wide, bottom + high))
            found.append((polar(left, bottom, wide, high, 1, lon), NORTH.format(lon=lon), edges))
    return found


def agrees_with_points(
    some: list[tuple[Dem, str, tuple[float, float, float, float]]], seed: int
) -> None:
    """Points spread evenly over the box, put into each file's map by PROJ; within five sigma of the count."""
    found = covered(*(dem for dem, _, _ in some))
    box, count = found.bounds, 40_000
    rng = np.random.default_rng(seed)
    lon = rng.uniform(box.west, box.east, count)
    lat = np.degrees(np.arcsin(rng.uniform(*np.sin(np.radians([box.south, box.north])), count)))
    inside = []
    for _, crs, (left, bottom, right, top) in some:
        x, y = pyproj.Proj(crs)(lon, lat)
        inside.append((left <= x) & (x <= right) & (bottom <= y) & (y <= top))
    depth = np.sum(inside, axis=0)
    overlap = sum(band.overlap_km2 for band in found.bands)
    pairs = [(found.covered_km2, depth > 0), (overlap, depth > 1)]
    pairs += list(zip(found.file_km2, inside, strict=True))
    for area_km2, hit in pairs:
        share = area_km2 / found.box_km2
        sigma = math.sqrt(max(share * (1.0 - share), 1.0 / count) / count)
        assert abs(hit.mean() - share) <= 5.0 * sigma
    assert sum(found.used_km2) == pytest.approx(found.covered_km2, rel=1e-9)
    assert sum(band.gap_km2 for band in found.bands) == pytest.approx(
        found.box_km2 - found.covered_km2, rel=1e-9, abs=1e-3
    )


@pytest.mark.slow
@settings(deadline=None, max_examples=6)
@given(files(), st.integers(0, 2**32 - 1))
def test_areas_are_those_of_random_points(some: list, seed: int) -> None:
    agrees_with_points(some, seed)


@pytest.mark.slow
@settings(deadline=None, max_examples=60)
@given(files(), st.integers(0, 2**32 - 1))
def test_areas_are_those_of_random_points_for_many_files(some: list, seed: int) -> None:
    agrees_with_points(some, seed)


@pytest.mark.slow
def test_polar_areas_are_within_the_stated_error() -> None:
    """Rectangles of all shapes and places around the pole, narrow ones beside it and over it among them."""
    rng = np.random.default_rng(0)
    worst = 0.0
    for _ in range(60):
        left, bottom = (int(v) for v in rng.integers(-900, 600, 2))
        wide, high = (int(v) for v in rng.integers(30, 900, 2))
        found = covered(polar(left, bottom, wide, high, 1, float(rng.uniform(0.0, 360.0))))
        exact = plane_rectangle(left, bottom, left + wide, bottom + high)
        worst = max(worst, abs(found.file_km2[0] / exact - 1.0))
    assert 0.0 < worst <= POLAR_ERROR


@pytest.mark.slow
def test_many_maps_turned_against_each_other() -> None:
    """Maps each with a central meridian of its own, so that every edge crosses many cells."""
    some = []
    for k in range(6):
        left, bottom = -500 + 97 * (k % 3), -350 + 171 * (k // 3)
        edges = tuple(1000.0 * v for v in (left, bottom, left + 90, bottom + 170))
        some.append((polar(left, bottom, 90, 170, 1, 20.0 * k), NORTH.format(lon=20 * k), edges))
    agrees_with_points(some, 7)
    found = covered(*(dem for dem, _, _ in some))
    assert found.file_km2 == pytest.approx(
        [plane_rectangle(*(v / 1000.0 for v in edges)) for _, _, edges in some], rel=POLAR_ERROR
    )


@pytest.mark.parametrize(
    ("dems", "north", "south", "ring", "across"),
    [
        ([cylinder(170, 0, 190, 10)], False, False, False, True),
        ([cylinder(170, 0, 180, 10), cylinder(-180, 5, -170, 15)], False, False, False, True),
        ([cylinder(170, 0, 180, 10), cylinder(-180, 11, -170, 15)], False, False, False, False),
        ([cylinder(0, 0, 180, 10), cylinder(180, 5, 360, 15)], False, False, True, True),
        ([cylinder(0, 0, 180, 10), cylinder(180, 11, 360, 15)], False, False, False, False),
        ([cylinder(0, 80, 90, 90)], True, False, False, False),
        ([polar(-10, -10, 20, 20, -1)], False, True, True, True),
        ([polar(10, -10, 20, 20, -1)], False, False, False, False),
        ([polar(-10, 10, 20, 20, 1)], False, False, False, True),
        ([cylinder(0, -90, 360, 90, 4)], True, True, True, True),
    ],
)
def test_poles_ring_and_antimeridian(
    dems: list[Dem], north: bool, south: bool, ring: bool, across: bool
) -> None:
    found = covered(*dems)
    assert (found.has_north_pole, found.has_south_pole) == (north, south)
    assert (found.is_full_ring, found.crosses_antimeridian) == (ring, across)
