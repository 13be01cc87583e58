"""What a set of files covers: areas against closed forms, random points put through PROJ and flood fill; the map's pixels."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pyproj
import pytest
import rasterio
from hypothesis import given, settings
from hypothesis import strategies as st
from products import DEGREE_M, EQC, RADIUS_M, geotiff

from lcp_catalog import bitmap_font, parallels
from lcp_catalog.dem import Dem
from lcp_catalog.dem_survey import pixel_km2, survey
from lcp_catalog.demset import DemSet
from lcp_catalog.grid import Grid
from lcp_catalog.map_views import view_of
from lcp_catalog.raster import Raster
from lcp_catalog.regions import around
from lcp_catalog.set_coverage import MOON_KM2, _follow, set_coverage
from lcp_catalog.set_map import GAP, HOLE, PRODUCT_COLOURS, set_map

R_KM = RADIUS_M / 1000.0
NORTH = "+proj=stere +lat_0=90 +lat_ts=90 +lon_0={lon} +R=1737400 +units=m +no_defs"
SOUTH = NORTH.replace("+lat_0=90 +lat_ts=90", "+lat_0=-90 +lat_ts=-90")


# -- files without pixels: their footprints alone


def made(product: str, grid: Grid) -> Dem:
    path = Path(f"{product}.tif")
    return Dem(path, product, grid, Raster(path, grid.width, grid.height), (path,))


def cylinder(
    west: float, south: float, east: float, north: float, ppd: int = 16, product: str = "LDEM_16"
) -> Dem:
    """A tile in whole pixels; its origin is counted from longitude 0, east of -180."""
    width, height, pixel = round((east - west) * ppd), round((north - south) * ppd), DEGREE_M / ppd
    return made(
        product,
        Grid(
            "equirectangular",
            width,
            height,
            pixel,
            (west * ppd + 0.5) * pixel,
            (north * ppd - 0.5) * pixel,
        ),
    )


def polar(
    left_km: float,
    bottom_km: float,
    width: int,
    height: int,
    pole: int = 1,
    lon: float = 0.0,
    product: str = "POLAR",
) -> Dem:
    """Pixels of 1 km around a pole; ``lon`` is the map's central meridian."""
    return made(
        product,
        Grid(
            "polar-stereographic", width, height, 1000.0, 1000.0 * left_km + 500.0, 1000.0 * (bottom_km + height) - 500.0, lon,
            90.0 * pole,
        ),
    )  # fmt: skip


def rectangle(west: float, south: float, east: float, north: float) -> float:
    """Archimedes: the zone's height times the circumference's share."""
    return (
        R_KM**2
        * math.radians(east - west)
        * (math.sin(math.radians(north)) - math.sin(math.radians(south)))
    )


def corner(a: float, b: float) -> float:
    """Ground of the stereographic rectangle 0..a x 0..b (units of 2 R): the integral of 4 / (1 + x^2 + y^2)^2."""
    p, q = math.sqrt(1.0 + a * a), math.sqrt(1.0 + b * b)
    return 2.0 * R_KM**2 * (a / p * math.atan(b / p) + b / q * math.atan(a / q))


def plane_rectangle(x0: float, y0: float, x1: float, y1: float) -> float:
    """Ground of a rectangle of a polar map, kilometres at the pole."""
    x0, y0, x1, y1 = (v / (2.0 * R_KM) for v in (x0, y0, x1, y1))
    return corner(x1, y1) - corner(x0, y1) - corner(x1, y0) + corner(x0, y0)


def covered(*dems: Dem):
    return set_coverage(DemSet(dems))


def test_the_judge_of_polar_rectangles() -> None:
    """An endless plane is the whole Moon, a small rectangle is flat, and mpmath's quadrature agrees with the closed form."""
    mpmath = pytest.importorskip("mpmath")
    assert 4.0 * corner(1e9, 1e9) == pytest.approx(MOON_KM2, rel=1e-8)
    assert plane_rectangle(0.0, 0.0, 1.0, 2.0) == pytest.approx(2.0, rel=1e-5)
    whole = mpmath.quad(lambda x, y: 4 / (1 + x * x + y * y) ** 2, [0, 0.3], [0, 0.7])
    assert corner(0.3, 0.7) == pytest.approx(float(whole) * R_KM**2, rel=1e-12)


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
    found = covered(dem)
    assert found.covered_km2 == pytest.approx(area_km2, rel=1e-7)
    assert found.file_km2 == pytest.approx((area_km2,), rel=1e-7)
    assert found.used_km2 == pytest.approx((area_km2,), rel=1e-7)
    assert sum(band.covered_km2 for band in found.bands) == pytest.approx(area_km2, rel=1e-7)
    assert found.covered_km2 + found.gap_km2 == pytest.approx(found.box_km2, rel=1e-9)


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
    assert pairs[0, 1] == pytest.approx(plane_rectangle(-50, 20, -20, 120), rel=1e-7)
    assert pairs[0, 2] == pytest.approx(cap, rel=1e-7)
    assert [o.area_km2 for o in inside.overlaps] == sorted(pairs.values(), reverse=True)


def test_a_meridian_cuts_a_polar_map_exactly() -> None:
    """Longitudes 100 to 130 of a rectangle around the pole: the integral of 1 - cos(colatitude) along its edge x = d."""
    found = covered(polar(-300, -800, 600, 1600), cylinder(100, 60, 130, 90))
    d = 300.0 / (2.0 * R_KM)
    root = math.sqrt(1.0 + d * d)
    ends = [math.atan(d * math.tan(math.radians(angle)) / root) for angle in (10.0, 40.0)]
    (overlap,) = found.overlaps
    assert overlap.area_km2 == pytest.approx(
        2.0 * R_KM**2 * d / root * (ends[1] - ends[0]), rel=1e-9
    )
    assert (overlap.bounds.west, overlap.bounds.east) == pytest.approx((100.0, 130.0))


# -- random points through PROJ


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
    assert found.gap_km2 == pytest.approx(found.box_km2 - found.covered_km2, rel=1e-9, abs=1e-3)


@settings(deadline=None, max_examples=30)
@given(files(), st.integers(0, 2**32 - 1))
def test_areas_are_those_of_random_points(some: list, seed: int) -> None:
    agrees_with_points(some, seed)


def test_many_maps_turned_against_each_other(monkeypatch: pytest.MonkeyPatch) -> None:
    """So many crossings of edges that they are thinned out: maps each with a central meridian of its own."""
    monkeypatch.setattr(parallels, "_CROSSINGS", 60)
    some = []
    for k in range(10):
        left, bottom = -500 + 97 * (k % 5), -350 + 171 * (k // 5)
        edges = tuple(1000.0 * v for v in (left, bottom, left + 90, bottom + 170))
        some.append((polar(left, bottom, 90, 170, 1, 20.0 * k), NORTH.format(lon=20 * k), edges))
    agrees_with_points(some, 7)
    found = covered(*(dem for dem, _, _ in some))
    assert found.file_km2 == pytest.approx(
        [plane_rectangle(*(v / 1000.0 for v in edges)) for _, _, edges in some], rel=1e-5
    )


# -- gaps


@settings(deadline=None, max_examples=40)
@given(st.lists(st.booleans(), min_size=24, max_size=24))
def test_gaps_are_those_of_flood_fill(present: list[bool]) -> None:
    """Tiles of 45 x 15 degrees all around the Moon, the lowest row whole; gaps by flood fill over the tiles."""
    there = np.vstack([np.reshape(present, (3, 8)), np.ones((1, 8), bool)])  # north to south
    tiles = [(row, col) for row in range(4) for col in range(8) if there[row, col]]
    dems = [cylinder(45 * c + 7, 45 - 15 * r, 45 * c + 52, 60 - 15 * r, 4) for r, c in tiles]
    found = covered(*dems)
    assert found.is_full_ring
    first = int(np.flatnonzero(there.any(axis=1))[0])
    left = {(r, c) for r in range(first, 4) for c in range(8) if not there[r, c]}
    expected = []
    while left:
        todo, piece = [left.pop()], []
        while todo:
            r, c = todo.pop()
            piece.append((r, c))
            near = {(r - 1, c), (r + 1, c), (r, (c + 1) % 8), (r, (c - 1) % 8)} & left
            left -= near
            todo += near
        expected.append(
            (
                sum(rectangle(0, 45 - 15 * r, 45, 60 - 15 * r) for r, _ in piece),
                any(r == first for r, _ in piece),
            )
        )
    assert [gap.area_km2 for gap in found.gaps] == pytest.approx(
        sorted((a for a, _ in expected), reverse=True), rel=1e-9
    )
    key = [(round(a), edge) for a, edge in expected]
    assert sorted((round(gap.area_km2), gap.at_edge) for gap in found.gaps) == sorted(key)


def test_a_gap_over_the_meridian_of_the_box_is_one_piece() -> None:
    ring = [cylinder(0, -20, 360, -10), cylinder(0, 10, 360, 20), cylinder(20, -10, 340, 10)]
    (gap,) = covered(*ring).gaps
    assert tuple(gap.bounds) == pytest.approx((-20, -10, 20, 10))
    assert gap.area_km2 == pytest.approx(rectangle(-20, -10, 20, 10), rel=1e-9)
    assert not gap.at_edge


def test_a_narrow_gap_that_runs_aslant_is_one_piece() -> None:
    """A strip of 2 x 200 km beside the pole between two polar maps: its longitudes change by 53 degrees."""
    found = covered(
        polar(-149, -100, 198, 200),
        polar(51, -100, 49, 200),
        polar(-149, -150, 249, 50),
        polar(-149, 100, 249, 50),
    )
    (gap,) = [gap for gap in found.gaps if not gap.at_edge]
    assert gap.area_km2 == pytest.approx(plane_rectangle(49, -100, 51, 100), rel=1e-6)
    away = math.degrees(math.atan2(49, 100))
    assert (gap.bounds.west, gap.bounds.east) == pytest.approx((away, 180.0 - away), abs=0.2)
    assert gap.bounds.north == pytest.approx(
        90.0 - 2.0 * math.degrees(math.atan(49 / 2 / R_KM)), abs=1e-6
    )


def test_a_gap_that_holds_the_pole_is_not_at_the_edge() -> None:
    (gap,) = covered(cylinder(0, 60, 360, 70), cylinder(0, 60, 90, 90)).gaps
    assert gap.area_km2 == pytest.approx(rectangle(90, 70, 360, 90), rel=1e-9)
    assert tuple(gap.bounds) == pytest.approx((90, 70, 360, 90))
    assert not gap.at_edge


def test_the_box_around_arcs_knows_those_that_come_round() -> None:
    """300..500 covers 300..360 and 0..140, so that nothing is free between 101 and 140."""
    box = around(np.array([300.0, 155.0, 100.0]), np.array([500.0, 290.0, 101.0]), -1.0, 1.0)
    assert tuple(box) == (155.0, -1.0, 500.0, 1.0)
    assert tuple(around(np.array([350.0, 0.0]), np.array([360.0, 5.0]), -1.0, 1.0)) == (
        -10.0,
        -1.0,
        5.0,
        1.0,
    )
    assert tuple(around(np.array([10.0, 200.0]), np.array([210.0, 370.0]), -1.0, 1.0)) == (
        0.0,
        -1.0,
        360.0,
        1.0,
    )


def test_rows_of_one_segment_with_other_counts_are_not_followed() -> None:
    """Where crossings were thinned out, a row may have fewer arcs than the one below it: nothing is said to go on then."""
    row, segment = np.array([0, 0, 0, 1]), np.zeros(4, np.int64)
    arcs = parallels.Arcs(row, segment, *(np.zeros(4) for _ in range(6)))
    assert _follow(arcs, np.ones(4, bool)).shape == (0, 2)
    alike = parallels.Arcs(np.array([0, 0, 1, 1]), segment, *(np.zeros(4) for _ in range(6)))
    assert _follow(alike, np.array([False, True, True, True])).tolist() == [[0, 2]]


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


# -- missing pixels


def holed(
    path: Path,
    shape: tuple[int, int],
    holes: list[tuple[slice, slice]],
    west_m: float,
    north_m: float,
    pixel_m: float,
    **k,
) -> Dem:
    heights = np.random.default_rng(5).uniform(-900.0, 900.0, shape).astype(np.float32)
    for hole in holes:
        heights[hole] = -32768.0
    return Dem.open(geotiff(path, heights, west_m, north_m, pixel_m, nodata=-32768.0, **k))


def test_a_survey_counts_what_numpy_counts(tmp_path: Path) -> None:
    """1500 x 2600 pixels: blocks of three, the last ones cut; holes of any shape."""
    lost = np.random.default_rng(1).random((1500, 2600)) < 1e-3
    heights = np.where(
        lost, np.nan, np.random.default_rng(2).uniform(-5e3, 5e3, lost.shape)
    ).astype(np.float32)
    dem = Dem.open(geotiff(tmp_path / "a.tif", heights, 0.0, 15 * DEGREE_M, DEGREE_M / 100))
    found = survey(dem)
    assert found.block == 3
    assert found.missing.shape == (500, 867)
    padded = np.zeros((1500, 2601), bool)
    padded[:, :2600] = lost
    assert np.array_equal(found.missing, padded.reshape(500, 3, 867, 3).sum(axis=(1, 3)))
    assert (found.statistics.min_m, found.statistics.max_m) == (
        np.nanmin(heights),
        np.nanmax(heights),
    )
    assert found.statistics.nodata_share == lost.mean()


def test_holes_are_pieces_of_ground(tmp_path: Path) -> None:
    """A global file of one degree: a hole over its seam is one piece, the largest comes first."""
    holes = [np.s_[80:100, :10], np.s_[80:100, 350:], np.s_[10:20, 100:110]]
    found = survey(
        holed(tmp_path / "a.tif", (180, 360), holes, -180 * DEGREE_M, 90 * DEGREE_M, DEGREE_M)
    )
    first, second = found.holes()
    assert tuple(first.bounds) == pytest.approx((170, -10, 190, 10))
    assert first.area_km2 == pytest.approx(
        rectangle(170, -10, 190, 10), rel=2e-5
    )  # pixels' centres
    assert tuple(second.bounds) == pytest.approx((-80 % 360, 70, -70 % 360, 80))
    assert second.area_km2 == pytest.approx(rectangle(0, 70, 10, 80), rel=2e-5)
    assert found.hole_km2() == pytest.approx(first.area_km2 + second.area_km2)
    lon, lat = [175.0, -175.0, 185.0, 165.0, -75.0, -75.0], [0.0, 0.0, 9.0, 0.0, 75.0, 65.0]
    assert found.absent(lon, lat).tolist() == [True, True, True, False, True, False]


def test_a_hole_over_the_pole(tmp_path: Path) -> None:
    crs = NORTH.format(lon=0)
    found = survey(
        holed(tmp_path / "a.tif", (100, 100), [np.s_[40:60, 40:60]], -5e4, 5e4, 1000.0, crs=crs)
    )
    (hole,) = found.holes()
    assert (hole.bounds.west, hole.bounds.east, hole.bounds.north) == (0.0, 360.0, 90.0)
    assert hole.bounds.south == pytest.approx(
        90.0 - 2.0 * math.degrees(math.atan(math.hypot(10, 10) / 2 / R_KM))
    )
    assert hole.area_km2 == pytest.approx(plane_rectangle(-10, -10, 10, 10), rel=1e-6)


def test_a_hole_beside_the_pole(tmp_path: Path) -> None:
    """Columns 70..79, rows 45..54 of the north polar map: around longitude 90 E."""
    crs = NORTH.format(lon=0)
    found = survey(
        holed(tmp_path / "a.tif", (100, 100), [np.s_[45:55, 70:80]], -5e4, 5e4, 1000.0, crs=crs)
    )
    (hole,) = found.holes()
    half = math.degrees(math.atan(5 / 20))
    assert (hole.bounds.west, hole.bounds.east) == pytest.approx((90.0 - half, 90.0 + half))
    assert not found.absent(
        [90.0, 90.0], [90.0 - math.degrees(v / R_KM) for v in (19.0, 31.0)]
    ).any()
    assert found.absent(90.0, 90.0 - math.degrees(25.0 / R_KM))


@pytest.mark.parametrize("true_lat", [0.0, 30.0, -55.0])
def test_pixels_of_a_cylinder_add_up_to_its_ground(true_lat: float) -> None:
    """True to scale away from the equator: a pixel's ground is not its square at the equator."""
    squeeze = math.cos(math.radians(true_lat))
    pixel_m = DEGREE_M / 10
    grid = Grid("equirectangular", 200, 300, pixel_m, 0.5 * pixel_m, 399.5 * pixel_m, 0.0, true_lat)
    total = pixel_km2(grid, 0.0, np.arange(300)).sum() * 200
    assert total == pytest.approx(rectangle(0.0, 10.0, 20.0 / squeeze, 40.0), rel=1e-5)


def test_pixels_of_a_polar_map_add_up_to_its_ground() -> None:
    grid = Grid("polar-stereographic", 400, 400, 1000.0, -199_500.0, 199_500.0, 0.0, -80.0)
    column, row = np.meshgrid(np.arange(400), np.arange(400))
    scale = (1.0 + math.sin(math.radians(80.0))) / 2.0  # the plane's kilometres are true at 80 S
    assert pixel_km2(grid, column, row).sum() == pytest.approx(
        plane_rectangle(*(v / scale for v in (-200, -200, 200, 200))), rel=1e-6
    )


# -- the map


def picture(dems: list[Dem], missing: bool = False) -> np.ndarray:
    """Rows, columns, RGB of the PNG, decoded by GDAL."""
    surveys = [survey(dem) for dem in dems] if missing else None
    with (
        rasterio.MemoryFile(set_map(DemSet(tuple(dems)), surveys)) as memory,
        memory.open() as file,
    ):
        return np.moveaxis(file.read(), 0, -1)


def middle(image: np.ndarray, colour: tuple[int, int, int]) -> np.ndarray:
    """x (right), y (up) of the mean of a colour's pixels, but for the legend below."""
    rows, columns = np.nonzero((image == np.array(colour, np.uint8)).all(axis=-1)[:-60])
    assert rows.size > 50
    return np.array([columns.mean(), -rows.mean()])


@pytest.mark.parametrize(
    ("pole", "lon", "direction"),
    [  # the LOLA convention: 90 E on the right; 0 below the north pole, above the south pole
        (1, 90.0, (1, 0)), (1, 0.0, (0, -1)), (1, 180.0, (0, 1)), (1, 270.0, (-1, 0)),
        (-1, 90.0, (1, 0)), (-1, 0.0, (0, 1)), (-1, 180.0, (0, -1)), (-1, -90.0, (-1, 0)),
    ],
)  # fmt: skip
def test_a_polar_map_has_the_orientation_of_lola(
    pole: int, lon: float, direction: tuple[int, int]
) -> None:
    """A tile of 8 degrees around 81 deg on a ring from 75 to the pole: its direction and distance from the ring's middle."""
    low, high = sorted((75 * pole, 90 * pole))
    tile = cylinder(
        lon - 4, min(79 * pole, 83 * pole), lon + 4, max(79 * pole, 83 * pole), 16, "TILE"
    )
    image = picture([tile, cylinder(0, low, 360, high, 4, "RING")])
    blue, orange = PRODUCT_COLOURS[:2]
    stripe = tuple(int(v) + (255 - int(v)) * 55 // 100 for v in blue)
    away = 0.5 * (middle(image, blue) + middle(image, stripe)) - middle(image, orange)
    ring = (image == np.array(orange, np.uint8)).all(axis=-1)[:-60]
    radius = np.ptp(np.nonzero(ring)[1]) / 2.0
    expected = radius * math.tan(math.radians(9.0) / 2.0) / math.tan(math.radians(15.0) / 2.0)
    assert away == pytest.approx(expected * np.array(direction), abs=5.0)


def at(image: np.ndarray, lon: float, lat: float) -> tuple[int, ...]:
    """Colour of the global map, 720 x 360 pixels right of 46 and below 20, at a place."""
    return tuple(int(v) for v in image[20 + int((90.0 - lat) * 2.0), 46 + int((lon + 180.0) * 2.0)])


@pytest.mark.parametrize(
    "dem", [polar(-90, 20, 300, 200, -1), polar(-90, 20, 300, 200), cylinder(350, 10, 370, 50)]
)
def test_a_view_finds_its_pixels_again(dem: Dem) -> None:
    view = view_of([dem.grid], dem.grid.bounds)
    x, y = np.meshgrid(np.arange(0, view.width, 7), np.arange(0, view.height, 7))
    back = view.pixel(*view.lonlat(x, y))
    assert np.allclose(back[0], x, atol=1e-6)
    assert np.allclose(back[1], y, atol=1e-6)


def test_a_global_map(tmp_path: Path) -> None:
    heights = np.zeros((180, 360), np.float32)
    heights[20:40, 40:60] = -32768.0  # 50..70 N, 140..120 W
    whole = Dem.open(
        geotiff(
            tmp_path / "whole.tif",
            heights,
            -180 * DEGREE_M,
            90 * DEGREE_M,
            DEGREE_M,
            nodata=-32768.0,
        )
    )
    other = np.zeros((80, 160), np.float32)
    tile = Dem.open(
        geotiff(tmp_path / "tile.tif", other, 100 * DEGREE_M, -20 * DEGREE_M, DEGREE_M / 4)
    )
    image = picture([whole, tile], missing=True)
    blue, orange = PRODUCT_COLOURS[:2]
    light = tuple(v + (255 - v) * 55 // 100 for v in orange)
    assert at(image, 3.3, 3.3) == at(image, -176.7, -86.7) == at(image, 176.7, 86.7) == blue
    assert at(image, -131.7, 61.7) == HOLE
    assert at(image, -131.7, 48.3) == at(image, -118.3, 61.7) == blue
    found = {at(image, lon, -27.7) for lon in np.arange(101.0, 119.0, 0.5)}
    assert found == {orange, light}
    assert at(image, 141.7, -27.7) == at(image, 111.7, -42.7) == blue
    assert {at(image, -0.3, 33.3), at(image, 0.3, 33.3)} != {
        blue
    }  # a meridian lets it show through


def test_a_regional_map_is_zoomed() -> None:
    """Two tiles, north-west and south-east of each other: most of the picture is their box, grey between."""
    image = picture([cylinder(350, 10, 360, 20, 16, "WEST"), cylinder(0, 0, 10, 10, 16, "EAST")])
    blue, orange = PRODUCT_COLOURS[:2]
    step = middle(image, orange) - middle(image, blue)
    assert step[0] > 150
    assert step[1] < -150
    assert step[0] == pytest.approx(-step[1], rel=0.03)  # near the equator: degrees are alike
    grey = (image == np.array(GAP, np.uint8)).all(axis=-1)[:-60].mean()
    assert 0.25 < grey < 0.6


def test_a_hole_is_filled_by_another_file(tmp_path: Path) -> None:
    args = ((160, 160), 10 * DEGREE_M, 20 * DEGREE_M, DEGREE_M / 16)
    fine = holed(tmp_path / "FINE.tif", args[0], [np.s_[20:60, 20:60]], *args[1:])
    coarse = holed(
        tmp_path / "COARSE.tif", (80, 80), [np.s_[10:20, 10:20]], *args[1:3], DEGREE_M / 8
    )
    image = picture([fine, coarse], missing=True)
    blue, orange = PRODUCT_COLOURS[:2]

    def extent(colour: tuple[int, int, int]) -> np.ndarray:
        """First and last row of a colour in the map, as shares of the fine file's 10 degrees."""
        rows = np.nonzero((image == np.array(colour, np.uint8)).all(axis=-1)[:-60])[0]
        return np.array([rows.min(), rows.max() + 1.0])

    top, bottom = extent(blue)
    assert (extent(HOLE) - top) / (bottom - top) == pytest.approx([0.125, 0.25], abs=0.01)
    assert (extent(orange) - top) / (bottom - top) == pytest.approx([0.125, 0.375], abs=0.01)


def test_labels_stand_at_their_lines() -> None:
    """Words are found by their own pixels: 60N beside its row, 90E below its column."""
    image = picture([cylinder(-180, -90, 180, 90, 4)])
    ink = (image < 100).all(axis=-1)

    def found(text: str) -> list[tuple[int, int]]:
        word = bitmap_font.mask(text)
        windows = np.lib.stride_tricks.sliding_window_view(ink, word.shape)
        hits = np.argwhere((windows == word).all(axis=(2, 3)))
        return [(int(r) + word.shape[0] // 2, int(c) + word.shape[1] // 2) for r, c in hits]

    (row, column), (_, across) = found("60°N")[0], found("90°E")[0]
    assert abs(row - (20 + 60)) <= 2
    assert column < 46
    assert abs(across - (46 + 540)) <= 2
    assert found("60°S")
    assert found("LDEM_16")  # the legend
    assert not found("LDEM_17")


def test_letters_are_whole_and_tell_apart() -> None:
    wanted = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789.,:-_+/()%°'=<>?"
    shapes = {}
    for character in wanted:
        glyph = bitmap_font.mask(character)
        assert glyph.shape == (9, 5)
        assert glyph.any()
        shapes[glyph.tobytes()] = character
    assert len(shapes) == len(wanted)
    assert np.array_equal(bitmap_font.mask("§"), bitmap_font.mask("?"))
    assert not bitmap_font.mask(" ").any()


def test_the_same_set_gives_the_same_bytes() -> None:
    dems = DemSet((cylinder(0, 75, 360, 90, 4), polar(-100, -100, 50, 50)))
    assert set_map(dems) == set_map(dems)
