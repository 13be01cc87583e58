"""Images from files: sensor, Sun, refused files, and real files."""

from __future__ import annotations

import json
import logging
import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import image_files as files
from helpers.image_files import MAP, NOON, SHAPE, opened, refused, scene

from lcp_catalog.cameras.camera_file import read_camera
from lcp_catalog.cameras.map_projected import MapImage
from lcp_catalog.cameras.view import center_of
from lcp_catalog.ephemeris.solar_position import sun_direction_at
from lcp_catalog.errors import ImageError
from lcp_catalog.geometry.frames import EnuFrame, enu_rotation, lonlat_to_mcmf
from lcp_catalog.images.image_file import ImageOptions, open_image
from lcp_catalog.light.sun_choice import SunChoice

# -- sensors


def test_a_map_projected_image_is_its_own_sensor(tmp_path: Path) -> None:
    path = files.write_image(tmp_path / "a.tif", scene(), **MAP)
    options = ImageOptions(off_nadir_deg=20.0, view_azimuth_deg=90.0)
    found = open_image(path, None, NOON, options)
    assert isinstance(found.sensor, MapImage)
    np.testing.assert_allclose(found.sensor.project(lonlat_to_mcmf(10.05, 4.95)), [0, 0], atol=1e-9)
    point = lonlat_to_mcmf(12.0, 3.0)
    enu = enu_rotation(12.0, 3.0) @ found.sensor.towards(point)
    np.testing.assert_allclose(
        enu, [math.sin(math.radians(20)), 0, math.cos(math.radians(20))], atol=1e-12
    )


MAPPING = """Group = Mapping
  ProjectionName = {name}
  {center}
  TargetName = Moon
  EquatorialRadius = 1737400.0 <meters>
  PolarRadius = 1737400.0 <meters>
  LatitudeType = Planetocentric
  LongitudeDirection = PositiveEast
  LongitudeDomain = 360
  UpperLeftCornerX = {x} <meters>
  UpperLeftCornerY = {y} <meters>
  PixelResolution = 1000.0 <meters/pixel>
  Scale = 30.323350424149 <pixels/degree>
End_Group
"""


def test_a_cube_on_a_map(tmp_path: Path) -> None:
    """ISIS's Mapping group: the upper left corner in metres."""
    groups = MAPPING.format(
        name="SimpleCylindrical", center="CenterLongitude = 180.0", x=-600000.0, y=300000.0
    )
    path = files.write_cube(tmp_path / "a.cub", scene("int16"), groups=groups)
    degree = math.pi * 1737.4 / 180.0
    wanted = [600.0 - 10 * degree - 0.5, 300.0 - 5 * degree - 0.5]
    found = open_image(path, None, NOON).sensor.project(lonlat_to_mcmf(170.0, 5.0))
    np.testing.assert_allclose(found, wanted, atol=1e-6)


def test_a_cube_on_a_polar_map(tmp_path: Path) -> None:
    """South: x = rho sin(lon), y = rho cos(lon), rho = 2 R tan(half the colatitude)."""
    center = "CenterLongitude = 0.0\n  CenterLatitude = -90.0"
    groups = MAPPING.format(name="PolarStereographic", center=center, x=-30000.0, y=20000.0)
    path = files.write_cube(tmp_path / "a.cub", scene("int16"), groups=groups)
    rho = 2 * 1737.4 * math.tan(math.radians(0.25))
    wanted = [
        30.0 + rho * math.sin(math.radians(40)) - 0.5,
        20.0 - rho * math.cos(math.radians(40)) - 0.5,
    ]
    found = open_image(path, None, NOON).sensor.project(lonlat_to_mcmf(40.0, -89.5))
    np.testing.assert_allclose(found, wanted, atol=1e-6)


def test_a_camera_goes_before_a_map(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = files.write_image(tmp_path / "a.tif", scene(), **MAP)
    camera = files.camera_over(SHAPE)
    assert open_image(path, camera).sensor is camera
    assert "is map-projected; the map is ignored" in caplog.text


def test_the_middle_of_an_image() -> None:
    lon, lat = center_of(files.camera_over(SHAPE, 200.0, 70.0))
    assert (lon, lat) == (pytest.approx(200.0), pytest.approx(70.0))
    camera = files.camera_over(SHAPE)
    away = replace(
        camera, rotation_mcmf_to_camera=np.diag([-1.0, 1.0, -1.0]) @ camera.rotation_mcmf_to_camera
    )
    with pytest.raises(ImageError, match=r"its centre does not show the Moon"):
        center_of(away)
    globe = (
        f'PROJCS["x",{files.MOON},PROJECTION["Orthographic"],PARAMETER["latitude_of_origin",0],'
        'PARAMETER["central_meridian",0],UNIT["metre",1]]'
    )
    beside = MapImage(globe, (1e4, 0, 1.8e6, 0, -1e4, 0), SHAPE, "beside the disc")
    with pytest.raises(ImageError, match=r"beside the disc: its centre does not show the Moon"):
        center_of(beside)


# -- the Sun


def test_the_cameras_sun_and_its_time(tmp_path: Path) -> None:
    path = files.write_image(tmp_path / "a.tif", scene())
    camera = files.camera_over(SHAPE)
    np.testing.assert_array_equal(opened(path).sun_position_mcmf_m, camera.sun_position_mcmf_m)
    timed = replace(camera, sun_position_mcmf_m=None, time_utc="2024-01-01T00:00:00")
    found = open_image(path, timed)
    np.testing.assert_array_equal(found.sun_direction_mcmf, sun_direction_at("2024-01-01T00:00:00"))
    assert found.sun_position_mcmf_m is None


@pytest.mark.parametrize("center", [None, (22.0, -9.0)])
def test_sun_angles_hold_at_the_centre_or_a_given_place(
    tmp_path: Path, center: tuple[float, float] | None
) -> None:
    path = files.write_image(tmp_path / "a.tif", scene())
    stated = SunChoice(azimuth_deg=80.0, elevation_deg=25.0)
    camera = files.camera_over(SHAPE, sun=False)
    found = open_image(path, camera, stated, ImageOptions(center_deg=center))
    enu = EnuFrame(*(center or (20.0, -10.0))).direction_from_mcmf(found.sun_direction_mcmf)
    level = math.cos(math.radians(25))
    wanted = [
        level * math.sin(math.radians(80)),
        level * math.cos(math.radians(80)),
        math.sin(math.radians(25)),
    ]
    np.testing.assert_allclose(enu, wanted, atol=1e-9)


@pytest.mark.parametrize("sun", [SunChoice(time_utc="2024-01-01T00:00:00"), NOON])
def test_a_given_sun_is_used_first_with_a_warning(
    tmp_path: Path, sun: SunChoice, caplog: pytest.LogCaptureFixture
) -> None:
    tags = {"sun_direction_mcmf": json.dumps([0.0, -1.0, 0.0])}
    path = files.write_image(tmp_path / "a.tif", scene(), tags=tags)
    found = open_image(path, files.camera_over(SHAPE), sun)
    wanted = sun.direction_mcmf(EnuFrame(0.0, 0.0), None)
    np.testing.assert_array_equal(found.sun_direction_mcmf, wanted)
    assert "the given Sun is" in caplog.text
    assert "from the Sun of the camera; the first is used" in caplog.text
    assert "from the Sun of the label; the first is used" in caplog.text


@pytest.mark.parametrize(("off_deg", "warned"), [(0.9, False), (1.1, True), (180.0, True)])
def test_small_differences_are_not_worth_a_word(
    tmp_path: Path, off_deg: float, warned: bool, caplog: pytest.LogCaptureFixture
) -> None:
    path = files.write_image(tmp_path / "a.tif", scene())
    camera = replace(files.camera_over(SHAPE), sun_position_mcmf_m=np.array([1.5e11, 0.0, 0.0]))
    with caplog.at_level(logging.WARNING):
        open_image(path, camera, SunChoice(subsolar_deg=(off_deg, 0.0)))
    assert bool(caplog.records) == warned
    if warned:
        assert f"is {off_deg:.1f} deg from" in caplog.text


def test_the_camera_goes_before_the_label(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    tags = {"sun_direction_mcmf": json.dumps([0.0, -1.0, 0.0])}
    path = files.write_image(tmp_path / "a.tif", scene(), tags=tags)
    camera = files.camera_over(SHAPE)
    np.testing.assert_array_equal(
        open_image(path, camera).sun_position_mcmf_m, camera.sun_position_mcmf_m
    )
    assert "the Sun of the camera is" in caplog.text
    found = open_image(path, replace(camera, sun_position_mcmf_m=None))
    np.testing.assert_array_equal(found.sun_direction_mcmf, [0.0, -1.0, 0.0])


# -- refusals


def test_files_that_are_not_images(tmp_path: Path) -> None:
    camera = files.camera_over(SHAPE)
    refused("there is no such file", tmp_path / "none.tif", camera)
    refused("is a folder, not an image", tmp_path, camera)
    text = tmp_path / "a.txt"
    text.write_text("not an image")
    refused("not an image that can be read here", text, camera)
    bare = tmp_path / "b.img"
    bare.write_bytes(bytes(2400))
    refused("not an image that can be read here", bare, camera)
    empty = tmp_path / "c.png"
    empty.write_bytes(b"")
    refused("not an image that can be read here", empty, camera)


def test_an_image_that_is_cut_short(tmp_path: Path) -> None:
    path = files.write_image(tmp_path / "a.tif", scene("float32"), compress="deflate")
    path.write_bytes(path.read_bytes()[:3000])
    refused("not an image that can be read here", path, files.camera_over(SHAPE))


def test_complex_samples(tmp_path: Path) -> None:
    path = files.write_image(tmp_path / "a.tif", scene("float32").astype(np.complex64))
    refused(
        "samples are complex64; supported are integers and floats", path, files.camera_over(SHAPE)
    )


def test_an_image_of_another_size_than_its_cameras(tmp_path: Path) -> None:
    path = files.write_image(tmp_path / "a.tif", scene())
    refused(
        r"has 60 x 40 pixels, but its camera camera has 40 x 60", path, files.camera_over((60, 40))
    )


def test_no_geometry_and_no_sun(tmp_path: Path) -> None:
    path = files.write_image(tmp_path / "a.png", scene(), driver="PNG")
    refused("missing geometry: the image is not map-projected; give its `camera`", path, None, NOON)
    refused("the Sun is unknown", path, files.camera_over(SHAPE, sun=False))
    on_map = files.write_image(tmp_path / "b.tif", scene(), **MAP)
    refused("the Sun is unknown: give `sun`, or a camera", on_map)


def test_an_image_of_the_earth(tmp_path: Path) -> None:
    path = files.write_image(
        tmp_path / "a.tif", scene(), crs="EPSG:32633", transform=MAP["transform"]
    )
    refused(re.escape("6378137/"), path, None, NOON)


@pytest.mark.parametrize("value", [0, 100, 255])
def test_a_blank_image(tmp_path: Path, value: int) -> None:
    path = files.write_image(tmp_path / "a.tif", np.full(SHAPE, value, np.uint8))
    refused("is blank: all its valid pixels are equal", path, files.camera_over(SHAPE))
    refused(
        "is blank: all its valid pixels are equal",
        files.write_image(path, np.full(SHAPE, value, np.uint8), **MAP),
    )


def test_an_image_with_nothing_valid(tmp_path: Path) -> None:
    camera = files.camera_over(SHAPE)
    refused(
        "has no valid pixel",
        files.write_image(tmp_path / "a.tif", np.full(SHAPE, np.nan, np.float32)),
        camera,
    )
    zeros = np.zeros(SHAPE, np.uint8)
    refused("has no valid pixel", files.write_image(tmp_path / "b.tif", zeros, nodata=0), camera)
    nulls = np.full(SHAPE, -32768, np.int16)
    refused("has no valid pixel", files.write_cube(tmp_path / "c.cub", nulls), camera)
    bright = np.full(SHAPE, -32764, np.int16)
    refused("has no valid pixel", files.write_cube(tmp_path / "d.cub", bright), camera)


# -- real files


def test_frames_of_apollo(shared_data: Path) -> None:
    """AS15-M-0414: 276 pixels at 255, where the codes below have about 60 each; no clipping at the
    low end.
    """
    folder = shared_data / "images" / "apollo15-metric-hadley"
    camera = read_camera(folder / "AS15-M-0414_camera.json")
    found = open_image(folder / "AS15-M-0414.png", camera)
    assert found.signal.shape == (404, 404)
    assert found.saturated_share == pytest.approx(276 / 404**2)
    assert found.missing_share == 0.0
    assert set(np.unique(found.weight).tolist()) == {0.0, 1.0}
    np.testing.assert_array_equal(found.sun_position_mcmf_m, camera.sun_position_mcmf_m)


def test_the_scanned_crop_has_a_palette_of_greys(shared_data: Path) -> None:
    folder = shared_data / "images" / "apollo15-metric-hadley"
    camera = read_camera(folder / "AS15-M-1134_sub4crop_256ppd_camera.json")
    found = open_image(folder / "sub4-AS15-M-1134_crop.png", camera)
    assert found.saturated_share == pytest.approx(3201 / 640000)
    assert (found.signal == 1.0).sum() == 3273  # a plateau of shadow, which has full weight
    assert np.nanmax(found.signal) == 254.0


def test_map_projected_frames_of_apollo_16(shared_data: Path) -> None:
    """The corners of AS16-M-2804's map and the boom that its mask excludes; geographic, 1280 m per
    pixel.
    """
    folder = shared_data / "images" / "apollo16-metric-series" / "DIM_input_1280mpp_masked"
    found = open_image(folder / "AS16-M-2804.tif", None, NOON)
    assert found.missing_share == pytest.approx(0.2106, abs=2e-3)
    assert not found.weight[80, 130]  # the boom
    assert not found.weight[[0, 0, -1, -1], [0, -1, 0, -1]].any()
    assert found.weight[80, 60]
    center = found.sensor.project(lonlat_to_mcmf(*center_of(found.sensor)))
    np.testing.assert_allclose(center, [82.0, 81.5], atol=0.51)


def test_cubes_of_the_nac_and_of_apollo(shared_data: Path) -> None:
    """They are not map-projected: they open with a camera of their size, with the Sun of their
    tables.
    """
    images = shared_data / "images"
    for path, size in (
        (images / "nac-m143947267l-spice" / "M143947267L.cal.echo.crop.cub", 400),
        (images / "apollo15-metric-farside" / "AS15-M-0299_crop.cub", 500),
    ):
        refused("missing geometry", path)
        found = open_image(path, files.camera_over((size, size), sun=False))
        assert found.signal.shape == (size, size)
        assert found.missing_share == 0.0
        assert found.sun_position_mcmf_m is not None


def test_the_pit(shared_data: Path) -> None:
    """Its published centre is in the hole of the orthoimage."""
    path = shared_data / "images" / "nac-tranqpit1-pair" / "tranqpit1_ortho_M152662021_0p5m.tif"
    found = open_image(path, None, NOON)
    assert found.missing_share == pytest.approx(0.0444, abs=1e-4)
    pixels = found.sensor.project(lonlat_to_mcmf(33.222, 8.335))
    col, row = np.round(pixels).astype(int)
    assert found.sensor.in_image(pixels)
    assert not found.weight[row, col]


def test_a_cube_is_the_right_way_up(shared_data: Path) -> None:
    """The cube of AS15-M-0299 is a window of the scan (its AlphaCube group: from sample 14396.5,
    line 4396.5 of 22900 x 22900); the image of the whole frame shows the same terrain there.
    """
    folder = shared_data / "images" / "apollo15-metric-farside"
    cube = open_image(folder / "AS15-M-0299_crop.cub", files.camera_over((500, 500), sun=False))
    whole = open_image(folder / "AS15-M-0299_SML.png", files.camera_over((1012, 1012)))
    # a pixel of the image is 22.6 pixels of the scan, one of the cube 16
    row, col = (np.arange(353) + 0.5) * 22900 / 1012 / 15.976 - 0.5, 636.0
    there = np.round(row).astype(int).clip(0, 499)
    small = cube.signal[np.ix_(there, there)]
    same = whole.signal[194 : 194 + 353, int(col) : int(col) + 353]
    both = np.isfinite(same)

    def likeness(values: np.ndarray) -> float:
        return float(np.corrcoef(values[both], same[both])[0, 1])

    assert likeness(small) > 0.9
    for other in (small[::-1], small[:, ::-1], small.T):
        assert likeness(other) < 0.3
