"""Closed forms of the grids against PROJ, round trips, and CRSs of many spellings."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyproj
import pytest
from helpers.products import EQC, label_text
from hypothesis import given
from hypothesis import strategies as st

from lcp_catalog.dem.grid import Grid
from lcp_catalog.errors import LabelError
from lcp_catalog.geometry.bounds import enclosing_arc
from lcp_catalog.pds.pds3 import parse_pds3

SPHERE = pyproj.CRS("+proj=longlat +R=1737400 +no_defs")
CYLINDER = Grid("equirectangular", 3600, 1800, 3000.0, -5.0e6, 2.7e6, 180.0, 0.0)
NARROW = Grid("equirectangular", 400, 300, 2.0, -4.4e6, 25e4, 180.0, 8.0)
SOUTH = Grid("polar-stereographic", 3000, 3000, 20.0, -29990.0, 29990.0, 0.0, -90.0)
NORTH_75 = Grid("polar-stereographic", 3000, 3000, 200.0, -3e5, 3e5, 30.0, 75.0)


def grid_of(name: str) -> Grid:
    return Grid.from_label(parse_pds3(label_text(name), Path(f"{name}.LBL")))


def crs_of(grid: Grid) -> pyproj.CRS:
    if grid.pole:
        text = f"+proj=stere +lat_0={90 * grid.pole} +lat_ts={grid.true_lat_deg}"
        text += f" +lon_0={grid.center_lon_deg}"
    else:
        text = f"+proj=eqc +lat_ts={grid.true_lat_deg} +lon_0={grid.center_lon_deg} +over"
    return pyproj.CRS(f"{text} +R=1737400 +units=m +no_defs")


@pytest.mark.parametrize(
    "grid", [CYLINDER, NARROW, SOUTH, NORTH_75], ids=["eqc", "eqc-lat_ts", "south", "north-lat_ts"]
)
def test_closed_forms_agree_with_proj(grid: Grid) -> None:
    column, row = np.meshgrid(
        np.linspace(-0.5, grid.width - 0.5, 37), np.linspace(-0.5, grid.height - 0.5, 31)
    )
    x, y = grid.x0_m + column * grid.pixel_m, grid.y0_m - row * grid.pixel_m
    want = pyproj.Transformer.from_crs(crs_of(grid), SPHERE, always_xy=True).transform(x, y)
    lon, lat = grid.lonlat(column, row)
    np.testing.assert_allclose(lat, want[1], atol=1e-9)
    np.testing.assert_allclose((lon - want[0] + 180.0) % 360.0 - 180.0, 0.0, atol=1e-9)
    back = grid.pixel(lon, lat)
    np.testing.assert_allclose(back[0], column, atol=1e-5)
    np.testing.assert_allclose(back[1], row, atol=1e-5)


@given(lon=st.floats(-180.0, 360.0), lat=st.floats(-89.999, 89.999))
def test_cylinder_round_trip(lon: float, lat: float) -> None:
    back = CYLINDER.lonlat(*CYLINDER.pixel(lon, lat))
    assert abs((back[0] - lon + 180.0) % 360.0 - 180.0) < 1e-9
    assert back[1] == pytest.approx(lat, abs=1e-9)


@given(lon=st.floats(-180.0, 360.0), lat=st.floats(-90.0, -30.0))
def test_polar_round_trip(lon: float, lat: float) -> None:
    back = SOUTH.lonlat(*SOUTH.pixel(lon, lat))
    assert back[1] == pytest.approx(lat, abs=1e-9)
    assert abs((back[0] - lon + 180.0) % 360.0 - 180.0) * np.cos(np.radians(lat)) < 1e-9


@pytest.mark.parametrize("name", ["LDEM_80S_20M", "LDEM_875S_5M"])
def test_the_pole_lands_in_the_middle_of_polar_labels(name: str) -> None:
    grid = grid_of(name)
    column, row = grid.pixel(123.0, -90.0)
    # between the two middle pixels: map coordinates (0, 0)
    assert (column, row) == pytest.approx((grid.width / 2 - 0.5, grid.height / 2 - 0.5), abs=1e-6)
    assert grid.pole == -1
    # longitude 0 is up in the south, 90 to the right
    assert grid.pixel(0.0, -89.9)[1] < row - 1
    assert grid.pixel(90.0, -89.9)[0] > column + 1


@pytest.mark.parametrize(
    ("name", "bounds"),
    [
        ("LDEM_16", (0.0, -90.0, 360.0, 90.0)),
        ("SLDEM2015_512_00N_30N_000_045_FLOAT", (0.0, 0.0, 45.0, 30.0)),
        ("WAC_GLD100_E300N0450_256P_from_readme", (0.0, 0.0, 90.0, 60.0)),
        (
            "NAC_DTM_APOLLO11",
            (23.3722758, 0.314609, 23.5115296, 1.2365388),
        ),  # the label's own bounds
    ],
)
def test_bounds_are_those_of_the_labels(name: str, bounds: tuple[float, ...]) -> None:
    grid = grid_of(name)
    assert tuple(grid.bounds) == pytest.approx(bounds, abs=2e-6)


def test_bounds_with_a_pole_inside_hold_all_longitudes() -> None:
    assert SOUTH.bounds[:1] + SOUTH.bounds[2:3] == (0.0, 360.0)
    assert SOUTH.bounds.south == -90.0
    corner = SOUTH.lonlat(-0.5, -0.5)[1]
    assert SOUTH.bounds.north == pytest.approx(corner)


def test_only_whole_turns_wrap() -> None:
    assert grid_of("LDEM_16").wraps
    tile = grid_of("SLDEM2015_512_00N_30N_000_045_FLOAT")
    assert not tile.wraps
    assert tile.period == 360 * 512
    assert not SOUTH.wraps


def test_cell_weights_are_ground_areas() -> None:
    # area of a pixel from its corners on the sphere: dlon * (sin north - sin south) * R^2
    row = np.array([0, 700, 1500])
    _, top = CYLINDER.lonlat(0.0, row - 0.5)
    _, bottom = CYLINDER.lonlat(0.0, row + 0.5)
    area = (np.sin(np.radians(top)) - np.sin(np.radians(bottom))) / np.radians(top - bottom)
    np.testing.assert_allclose(CYLINDER.cell_weight(np.zeros(3), row), area, rtol=1e-6)
    # k of a polar stereographic map true at the pole is 2 / (1 + sin |lat|), Snyder (1987) eq.
    # 21-33
    _, lat = SOUTH.lonlat(0.0, 0.0)
    assert SOUTH.cell_weight(0.0, 0.0) == pytest.approx(
        ((1.0 - np.sin(np.radians(lat))) / 2.0) ** 2
    )


@pytest.mark.parametrize(
    ("crs", "projection", "true_lat", "pixel_m"),
    [
        ("IAU_2015:30110", "equirectangular", 0.0, 10.0),
        ("IAU_2015:30135", "polar-stereographic", -90.0, 10.0),
        (EQC, "equirectangular", 0.0, 10.0),
        ("+proj=eqc +lat_ts=8 +lon_0=180 +R=1737400 +units=km", "equirectangular", 8.0, 10_000.0),
        ("+proj=stere +lat_0=90 +lat_ts=80 +R=1737400", "polar-stereographic", 80.0, 10.0),
        (
            "+proj=stere +lat_0=-90 +k=0.97 +a=1737400 +b=1737400",
            "polar-stereographic",
            -70.0515564,
            10.0,
        ),
        ("+proj=longlat +R=1737400", "equirectangular", 0.0, 10 * np.pi / 180 * 1737400),
    ],
)
def test_crs_by_meaning(crs: str, projection: str, true_lat: float, pixel_m: float) -> None:
    grid = Grid.from_wkt(pyproj.CRS(crs).to_wkt(), (10.0, 0.0, 0.0, 0.0, -10.0, 0.0), 4, 4)
    assert (grid.projection, grid.pixel_m) == (projection, pytest.approx(pixel_m))
    assert grid.true_lat_deg == pytest.approx(true_lat, abs=1e-6)


def test_false_origins_are_taken_off() -> None:
    crs = pyproj.CRS("+proj=stere +lat_0=-90 +x_0=1000 +y_0=-2000 +R=1737400").to_wkt()
    grid = Grid.from_wkt(crs, (10.0, 0.0, 900.0, 0.0, -10.0, -1900.0), 20, 20)
    assert grid.pixel(0.0, -90.0) == pytest.approx((9.5, 9.5))


@pytest.mark.parametrize(
    ("crs", "affine", "says"),
    [
        ("EPSG:4326", (1, 0, 0, 0, -1, 0), "radii 6378137"),
        ("+proj=eqc +R=1738000", (1, 0, 0, 0, -1, 0), "radii 1738000"),
        ("+proj=eqc +a=1737400 +b=1736000", (1, 0, 0, 0, -1, 0), "radii 1737400/1736000"),
        ("+proj=eqc +a=1738000 +b=1737400", (1, 0, 0, 0, -1, 0), "radii 1738000/1737400"),
        ("+proj=stere +lat_0=80 +R=1737400", (1, 0, 0, 0, -1, 0), "oblique"),
        ("+proj=ortho +lat_0=80 +R=1737400", (1, 0, 0, 0, -1, 0), "'Orthographic'"),
        (EQC, (1, 0.1, 0, 0, -1, 0), "rotated"),
        (EQC, (1, 0, 0, 0, 1, 0), "north up"),
        (EQC, (1, 0, 0, 0, -2, 0), "square"),
    ],
)
def test_what_is_refused(crs: str, affine: tuple[float, ...], says: str) -> None:
    with pytest.raises(LabelError, match=says):
        Grid.from_wkt(pyproj.CRS(crs).to_wkt(), affine, 4, 4)


@pytest.mark.parametrize(
    ("arcs", "hull"),
    [
        ([(0.0, 45.0), (45.0, 90.0)], (0.0, 90.0)),
        ([(315.0, 360.0), (0.0, 45.0)], (-45.0, 45.0)),
        ([(-30.0, 10.0), (170.0, 190.0)], (170.0, 370.0)),
        ([(0.0, 360.0), (20.0, 30.0)], (0.0, 360.0)),
        ([(0.0, 180.0), (180.0, 360.0)], (0.0, 360.0)),
    ],
)
def test_enclosing_arc(arcs: list[tuple[float, float]], hull: tuple[float, float]) -> None:
    west, east = enclosing_arc(*zip(*arcs, strict=True))
    assert east - west == pytest.approx(hull[1] - hull[0])
    assert (west - hull[0]) % 360.0 == pytest.approx(0.0)
