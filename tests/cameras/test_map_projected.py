"""Map-projected images: pixels compared with closed forms (Snyder 1987, sphere) and rasterio;
copies around the Moon, poles, rotated and south-up rasters, corrections.
"""

from __future__ import annotations

import math
import pickle
from itertools import product

import numpy as np
import pytest
import rasterio.warp
from helpers.snyder_maps import MAPS, R, geographic, image_of, places, projected
from hypothesis import given
from hypothesis import strategies as st
from rasterio.transform import Affine

from lcp_catalog.cameras.map_projected import ORIGIN_HEIGHT_M, MapImage
from lcp_catalog.cameras.sensor import ON_MAP, Reduced, pixel_size_m
from lcp_catalog.errors import ImageError
from lcp_catalog.geometry.frames import enu_rotation, lonlat_to_mcmf, mcmf_to_lonlat

# -- compared with closed forms and rasterio


@pytest.mark.parametrize("name", MAPS)
def test_pixels_by_affine_and_closed_form(name: str) -> None:
    """Corner coordinates minus half a pixel; heights have no influence."""
    lon, lat = places(name)
    x, y = MAPS[name][1](lon, lat)
    for turn_deg, height_m in product((0.0, 33.0, 180.0), (0.0, -4000.0, 9000.0)):
        image = image_of(name, turn_deg=turn_deg)
        col, row = ~Affine(*image.transform) * (x, y)
        pixels = image.project(lonlat_to_mcmf(lon, lat, height_m))
        np.testing.assert_allclose(pixels, np.stack([col, row], -1) - 0.5, rtol=0, atol=1e-5)


@pytest.mark.parametrize("name", MAPS)
def test_pixels_are_those_of_rasterio(name: str) -> None:
    image = image_of(name, turn_deg=10.0)
    lon, lat = places(name, 20)
    xs, ys = rasterio.warp.transform(
        rasterio.CRS.from_wkt(geographic()), rasterio.CRS.from_wkt(image.crs_wkt), lon, lat
    )
    rows, cols = rasterio.transform.rowcol(Affine(*image.transform), xs, ys, op=lambda v: v - 0.5)
    pixels = image.project(lonlat_to_mcmf(lon, lat))
    assert np.abs(pixels - np.stack([cols, rows], -1)).max() < 1e-5


@given(
    name=st.sampled_from(sorted(MAPS)), turn_deg=st.floats(-180, 180),
    col=st.floats(0.3, 0.7), row=st.floats(0.3, 0.7),
    east=st.floats(-5e3, 5e3), north=st.floats(-5e3, 5e3), depth=st.floats(0.0, 1.0),
)  # fmt: skip
def test_there_and_back(
    name: str, turn_deg: float, col: float, row: float, east: float, north: float, depth: float
) -> None:
    """Every point on the ray of a pixel projects to the pixel."""
    image = image_of(name, turn_deg=turn_deg).moved((east, north))
    pixel = np.array([col * image.shape[1], row * image.shape[0]])
    origin, direction = image.looks(pixel)
    point = origin + (ORIGIN_HEIGHT_M + 5e3) * depth * direction
    np.testing.assert_allclose(image.project(point), pixel, rtol=0, atol=1e-5)
    assert image.in_image(pixel)


@pytest.mark.parametrize("edge", range(4))
def test_an_image_reaches_half_a_pixel_beyond_its_centres(edge: int) -> None:
    """The lower edges belong to the image, the upper ones do not."""
    image = image_of("sinusoidal")
    rows, cols = image.shape
    inside = np.array(
        [[-0.5, 7.0], [cols - 0.5 - 1e-6, 7.0], [7.0, -0.5], [7.0, rows - 0.5 - 1e-6]]
    )
    outside = np.array(
        [[-0.5 - 1e-6, 7.0], [cols - 0.5, 7.0], [7.0, -0.5 - 1e-6], [7.0, rows - 0.5]]
    )
    for sensor in (
        image,
        Reduced(MapImage(image.crs_wkt, image.transform, (2 * rows, 2 * cols)), 2),
    ):
        assert sensor.in_image(inside[edge])
        assert not sensor.in_image(outside[edge])
        assert not sensor.in_image([np.nan, 3.0])


def test_looks_straight_down_from_above_all_ground() -> None:
    origin, direction = image_of("orthographic").looks([[0.0, 0.0], [250.0, 200.0]])
    lon, lat, height = mcmf_to_lonlat(origin)
    np.testing.assert_allclose(height, 100e3)
    for i in range(2):
        up = enu_rotation(float(lon[i]), float(lat[i]))[2]
        np.testing.assert_allclose(direction[i], -up, atol=1e-14)


@pytest.mark.parametrize("turn_deg", [0.0, 77.0])
def test_a_raster_with_its_south_up(turn_deg: float) -> None:
    usual = image_of("sinusoidal", turn_deg=turn_deg)
    rows = usual.shape[0]
    flipped = Affine(*usual.transform) * Affine.translation(0, rows) * Affine.scale(1, -1)
    south_up = MapImage(usual.crs_wkt, tuple(flipped)[:6], usual.shape)
    points = lonlat_to_mcmf(*places("sinusoidal"))
    a, b = usual.project(points), south_up.project(points)
    np.testing.assert_allclose(b, np.stack([a[:, 0], rows - 1 - a[:, 1]], -1), atol=1e-6)


def test_pixels_have_the_size_of_the_map() -> None:
    image = image_of("cylindrical, true at 8, centred at 180")
    lon, lat = np.array([40.0, 50.0]), np.array([6.0, 11.0])
    across, down = image.transform[0], -image.transform[4]
    stretch = np.cos(np.radians(lat)) / math.cos(math.radians(8.0))
    for height_m in (0.0, 3000.0):
        sizes = pixel_size_m(image, lonlat_to_mcmf(lon, lat, height_m))
        wanted = np.sqrt(across * down * stretch) * (1.0 + height_m / R)
        np.testing.assert_allclose(sizes, wanted, rtol=1e-6)


# -- around the Moon


def across_the_antimeridian(west_lon: float, lon0: float = 0.0) -> MapImage:
    """10 x 10 deg eastwards of a longitude, a tenth of a degree per pixel, in a cylindrical map
    centred at lon0.
    """
    metres = R * math.radians(0.1)
    wkt = projected("Equirectangular", standard_parallel_1=0, central_meridian=lon0)
    return MapImage(
        wkt, (metres, 0, 10 * (west_lon - lon0) * metres, 0, -metres, 50 * metres), (100, 100)
    )


@pytest.mark.parametrize("image", [
    across_the_antimeridian(175.0), across_the_antimeridian(-185.0), across_the_antimeridian(535.0),
    MapImage(geographic(), (0.1, 0, 175.0, 0, -0.1, 5.0), (100, 100)),
    MapImage(geographic(), (0.1, 0, -185.0, 0, -0.1, 5.0), (100, 100)),
])  # fmt: skip
def test_ground_on_both_sides_of_the_antimeridian(image: MapImage) -> None:
    points = lonlat_to_mcmf([175.05, 179.95, 180.05, 184.95], 4.95)
    wanted = [[0, 0], [49, 0], [50, 0], [99, 0]]
    np.testing.assert_allclose(image.project(points), wanted, atol=1e-6)
    lon, _, _ = mcmf_to_lonlat(image.looks(np.array(wanted))[0])
    np.testing.assert_allclose(lon, [175.05, 179.95, 180.05, 184.95], atol=1e-9)


def test_a_turned_raster_across_the_antimeridian() -> None:
    plain = across_the_antimeridian(175.0)
    turned = (
        Affine(*plain.transform)
        * Affine.translation(50, 50)
        * Affine.rotation(40)
        * Affine.translation(-50, -50)
    )
    image = MapImage(plain.crs_wkt, tuple(turned)[:6], plain.shape)
    points = lonlat_to_mcmf([176.0, 184.0], [1.0, -2.0])
    x = R * np.radians([176.0, 184.0])
    col, row = ~turned * (x, R * np.radians([1.0, -2.0]))
    np.testing.assert_allclose(image.project(points), np.stack([col, row], -1) - 0.5, atol=1e-6)


def test_the_whole_moon_has_every_place_once() -> None:
    image = MapImage(geographic(), (1, 0, 0, 0, -1, 90), (180, 360))
    lon, lat = np.meshgrid(np.arange(0.5, 360), np.arange(89.5, -90, -1))
    pixels = image.project(lonlat_to_mcmf(lon, lat))
    assert image.in_image(pixels).all()
    np.testing.assert_allclose(pixels[..., 0], lon - 0.5, atol=1e-9)


def test_the_pole_is_one_pixel() -> None:
    image = image_of("south polar")
    pole = image.project([0.0, 0.0, -R])
    np.testing.assert_allclose(
        image.project(lonlat_to_mcmf([0, 90, 200.0], -90.0)), [pole] * 3, atol=1e-6
    )
    np.testing.assert_allclose(pole, [249.5, 199.5], atol=1e-6)


def test_points_off_the_map_are_nan() -> None:
    behind = lonlat_to_mcmf(183.5, -26.0)
    image = image_of("orthographic")
    pixels = image.project(np.stack([behind, lonlat_to_mcmf(3.5, 26.0)]))
    assert np.isnan(pixels[0]).all()
    assert image.in_image(pixels).tolist() == [False, True]
    a, _, _, d, e, _ = image.transform
    beyond = MapImage(image.crs_wkt, (a, 0, 1.5 * R, d, e, 0), image.shape, "beyond")
    assert np.isnan(beyond.looks([0.0, 0.0])[0]).all()
    with pytest.raises(ImageError, match=r"beyond: the centre of the image is off its map"):
        _ = beyond.center_deg


# -- bodies and reference ellipsoids


def test_another_radius_keeps_longitude_and_latitude() -> None:
    wide = MapImage(
        projected("Sinusoidal", 1738000.0, longitude_of_center=0), (100, 0, 0, 0, -100, 0), (9, 9)
    )
    lon, lat = np.array([1.0, 2.0]), np.array([-3.0, -0.5])
    x, y = np.radians(lon) * np.cos(np.radians(lat)) * 1738000, np.radians(lat) * 1738000
    wanted = np.stack([x / 100, -y / 100], -1) - 0.5
    np.testing.assert_allclose(wide.project(lonlat_to_mcmf(lon, lat)), wanted, atol=1e-7)


@pytest.mark.parametrize(("change", "why"), [
    ({"transform": (1, 0, 0, 0, 0, 0)}, "maps all pixels to one line"),
    ({"transform": (1, 0, np.nan, 0, -1, 0)}, "must hold 6 finite numbers"),
    ({"off_nadir_deg": 90.0}, "90 deg from the vertical"),
    ({"off_nadir_deg": -1.0}, "-1 deg from the vertical"),
])  # fmt: skip
def test_maps_that_cannot_be_are_refused(change: dict[str, object], why: str) -> None:
    good: dict[str, object] = {"transform": (1, 0, 0, 0, -1, 0)}
    with pytest.raises(ImageError, match=why):
        MapImage(geographic(), image_shape=(10, 10), **(good | change))  # type: ignore[arg-type]


# -- viewing directions


def test_it_was_seen_from_above_unless_that_is_stated() -> None:
    points = lonlat_to_mcmf(*places("orthographic", 5), 500.0)
    image = image_of("orthographic")
    np.testing.assert_allclose(image.towards(points), points / (R + 500.0), atol=1e-14)


@pytest.mark.parametrize(
    ("azimuth_deg", "wanted"), [(0.0, [0, 0.5]), (90.0, [0.5, 0]), (225.0, [-0.5 / 2**0.5] * 2)]
)
def test_seen_at_an_angle(azimuth_deg: float, wanted: list[float]) -> None:
    plain = image_of("sinusoidal")
    image = MapImage(
        plain.crs_wkt,
        plain.transform,
        plain.shape,
        off_nadir_deg=30.0,
        view_azimuth_deg=azimuth_deg,
    )
    lon, lat = places("sinusoidal", 20)
    towards = image.towards(lonlat_to_mcmf(lon, lat, 1e3))
    for i in range(20):
        enu = enu_rotation(lon[i], lat[i]) @ towards[i]
        np.testing.assert_allclose(enu, [*wanted, math.cos(math.radians(30))], atol=1e-12)


def test_seen_from_a_position() -> None:
    plain = image_of("sinusoidal")
    at = lonlat_to_mcmf(-60.0, 0.0, 50e3)
    image = MapImage(plain.crs_wkt, plain.transform, plain.shape, seen_from_mcmf_m=at)
    points = lonlat_to_mcmf(*places("sinusoidal", 5))
    away = at - points
    np.testing.assert_allclose(image.towards(points), away / np.linalg.norm(away, axis=1)[:, None])


# -- corrections


@pytest.mark.parametrize(
    "name", ["cylindrical, true at 8, centred at 180", "orthographic", "north polar", "south polar"]
)
def test_corrections_shift_the_surface(name: str) -> None:
    """At the centre a shift of (300, -200) m moves the surface 300 m east and 200 m south."""
    image = image_of(name)
    assert image.corrections == ON_MAP
    rows, cols = image.shape
    middle = np.array([(cols - 1) / 2, (rows - 1) / 2])
    moved = image.moved((300.0, -200.0))
    before, after = (-i.looks(middle)[1] * R for i in (image, moved))
    enu = (after - before) @ enu_rotation(*image.center_deg).T
    np.testing.assert_allclose(enu, [300.0, -200.0, 0.0], atol=0.1)
    np.testing.assert_allclose(moved.project(after), middle, atol=1e-6)


@given(east=st.floats(-2e4, 2e4), north=st.floats(-2e4, 2e4))
def test_a_correction_keeps_distances(east: float, north: float) -> None:
    """Distances on the surface are kept: the correction is a rotation of the sphere by the given
    arc.
    """
    image = image_of("south polar")
    rng = np.random.default_rng(0)
    pixels = rng.uniform(0, 400, (6, 2))
    before, after = (-i.looks(pixels)[1] for i in (image, image.moved((east, north))))
    np.testing.assert_allclose(before @ before.T, after @ after.T, atol=1e-14)
    middle = np.array([249.5, 199.5])
    a, b = (-i.looks(middle)[1] for i in (image, image.moved((east, north))))
    assert math.atan2(np.linalg.norm(np.cross(a, b)), a @ b) * R == pytest.approx(
        math.hypot(east, north), abs=1e-6
    )


def test_corrections_add_up() -> None:
    image = image_of("orthographic")
    twice = image.moved((100.0, 50.0)).moved((-30.0, 20.0))
    assert twice.shift_m == (70.0, 70.0)
    assert twice.moved((-70.0, -70.0)).shift_m == (0.0, 0.0)
    point = lonlat_to_mcmf(3.0, 25.0)
    np.testing.assert_allclose(twice.moved((-70.0, -70.0)).project(point), image.project(point))


def test_it_is_sent_to_workers() -> None:
    image = image_of("transverse Mercator")
    points = lonlat_to_mcmf(*places("transverse Mercator", 3))
    pixels = image.project(points)
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(image)).project(points), pixels)
