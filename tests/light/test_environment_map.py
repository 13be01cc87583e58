"""Environment maps: pixel geometry compared with quadrature, files with bytes written here, and
invalid input.
"""

import math
import struct

import cv2
import numpy as np
import pytest
from helpers.environment_maps import (
    CLEAR,
    OVERCAST,
    Lamp,
    cie_sky,
    directions,
    room,
    uniform,
)
from hypothesis import given
from hypothesis import strategies as st

from lcp_catalog.errors import ImageError
from lcp_catalog.geometry.frames import direction_enu
from lcp_catalog.light.environment import Environment
from lcp_catalog.light.environment_map import Panorama, read_panorama, read_picture, resized

GAUSS = np.polynomial.legendre.leggauss(16)


def radiance_bytes(rgb):
    """A Radiance file without run-length coding, after Ward's description of the format."""
    rows, cols, _ = rgb.shape
    body = bytearray()
    for pixel in rgb.reshape(-1, 3):
        mantissa, exponent = math.frexp(max(pixel))
        if max(pixel) <= 0:
            body += b"\0\0\0\0"
            continue
        scale = mantissa * 256.0 / max(pixel)
        body += bytes(int(value * scale) for value in pixel) + struct.pack("B", exponent + 128)
    head = f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {rows} +X {cols}\n"
    return head.encode() + bytes(body)


def integrate(panorama, row, col, of):
    """Integral of a function of direction over a pixel, by Gauss quadrature in elevation and
    azimuth.
    """
    half = 0.5 * panorama.pixel_rad
    e = panorama.elevations[row] + half * GAUSS[0][:, None]
    a = panorama.azimuths[col] + half * GAUSS[0][None, :]
    weight = half * half * GAUSS[1][:, None] * GAUSS[1][None, :] * np.cos(e)
    east, north = np.cos(e) * np.sin(a), np.cos(e) * np.cos(a)
    return float((weight * of(east, north, np.broadcast_to(np.sin(e), east.shape))).sum())


@given(st.integers(2, 40), st.floats(-400, 400), st.data())
def test_a_pixels_integrals(rows, azimuth_deg, data):
    panorama = Panorama(np.ones((rows, 2 * rows)), azimuth_deg)
    row = data.draw(st.integers(0, rows - 1))
    col = data.draw(st.integers(0, 2 * rows - 1))
    solid = integrate(panorama, row, col, lambda east, north, up: np.ones_like(up))
    assert panorama.solid_angles[row] == pytest.approx(solid, rel=1e-12)
    moment = [integrate(panorama, row, col, of) for of in (lambda e, n, u: e, lambda e, n, u: n)]
    level = integrate(panorama, row, col, lambda east, north, up: up)
    found = panorama.moments(np.array([row]), np.array([col]))[0]
    assert found == pytest.approx([*moment, level], abs=1e-14)
    assert panorama.levels[row] == pytest.approx(level, abs=1e-14)


@pytest.mark.parametrize("rows", [2, 3, 32, 33, 256])
def test_the_whole_sphere(rows):
    one = Panorama(np.ones((rows, 2 * rows)))
    assert one.power == pytest.approx(4 * math.pi, rel=1e-13)
    assert one.power_above == pytest.approx(2 * math.pi, rel=1e-13)
    assert one.horizontal_irradiance == pytest.approx(math.pi, rel=1e-13)


def test_the_middle_looks_north_and_right_of_it_east():
    """The direction of a single bright pixel."""
    for col, azimuth in ((32, 0.0), (48, 90.0), (0, 180.0), (16, 270.0)):
        light = np.zeros((32, 64))
        light[8, col] = 1.0  # 45 deg down from the zenith, half a pixel more
        found = Panorama(light).middle_above
        expected = direction_enu(azimuth + 360 / 128, 45 - 180 / 64)
        assert math.degrees(math.acos(min(1.0, found @ expected))) < 0.05


@given(st.floats(-360, 360))
def test_turning_it(azimuth_deg):
    light = np.zeros((16, 32))
    light[3, 20] = 1.0
    here, there = (Panorama(light, turn).middle_above for turn in (0.0, azimuth_deg))
    c, s = math.cos(math.radians(azimuth_deg)), math.sin(math.radians(azimuth_deg))
    clockwise = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])  # north goes to (s, c)
    assert there == pytest.approx(clockwise @ here, abs=1e-12)


def test_lookups_agree_with_pixels_and_wrap():
    rng = np.random.default_rng(3)
    panorama = Panorama(rng.random((12, 24)), azimuth_deg=77.0)
    level = np.cos(panorama.elevations)[:, None]
    east, north = level * np.sin(panorama.azimuths), level * np.cos(panorama.azimuths)
    up = np.broadcast_to(np.sin(panorama.elevations)[:, None], east.shape)
    assert panorama.at(np.stack([east, north, up], -1)) == pytest.approx(panorama.luminance)
    edge = panorama.column_azimuth(0.0)  # between the last column and the first
    looking = np.array([math.sin(edge), math.cos(edge), math.tan(panorama.elevations[4])])
    mean = 0.5 * (panorama.luminance[4, 0] + panorama.luminance[4, -1])
    assert panorama.at(looking) == pytest.approx(mean)
    assert panorama.at([0.0, 0.0, 5.0]).shape == ()


def test_a_radiance_file(tmp_path):
    """A file written here is read with the Rec. 709 luminance of its pixels."""
    rng = np.random.default_rng(1)
    rgb = rng.integers(1, 256, (8, 16, 3)) * 2.0 ** rng.integers(-9, 9, (8, 16, 1))
    rgb[0, 0] = 0.0
    (tmp_path / "sky.hdr").write_bytes(radiance_bytes(rgb))
    found = read_panorama(tmp_path / "sky.hdr", 12.0)
    expected = 0.2126 * rgb[..., 0] + 0.7152 * rgb[..., 1] + 0.0722 * rgb[..., 2]
    assert found.luminance == pytest.approx(expected, rel=0.02, abs=1e-9)  # 8 bits of mantissa
    assert (found.azimuth_deg, found.name, found.encoded) == (12.0, "sky.hdr", False)


@pytest.mark.parametrize("ending", ["pfm", "tif"])
def test_float_files_are_linear(tmp_path, ending):
    grey = np.random.default_rng(2).random((6, 12)).astype(np.float32) * 1e4
    cv2.imwrite(str(tmp_path / f"a.{ending}"), grey)
    assert read_panorama(tmp_path / f"a.{ending}").luminance == pytest.approx(grey, rel=1e-6)


def test_a_display_image_is_decoded_with_a_warning(tmp_path, caplog):
    """sRGB: the 8-bit code 118 is 18 % grey, 188 half the light (IEC 61966-2-1 tables)."""
    codes = np.zeros((2, 4), np.uint8)
    codes[0] = 0, 118, 188, 255
    cv2.imwrite(str(tmp_path / "a.png"), codes)
    found = read_panorama(tmp_path / "a.png")
    assert found.luminance[0] == pytest.approx([0.0, 0.18116, 0.50289, 1.0], abs=1e-4)
    assert found.encoded
    assert "sRGB" in caplog.text


def test_sixteen_bits_are_of_the_same_curve(tmp_path):
    cv2.imwrite(str(tmp_path / "a.png"), np.full((2, 4), round(65535 * 118 / 255), np.uint16))
    assert read_picture(tmp_path / "a.png").luminance == pytest.approx(0.18116, abs=1e-4)


@pytest.mark.parametrize(
    ("image", "ending", "says"),
    [
        (np.ones((8, 8), np.float32), "tif", "twice as wide as high"),
        (np.ones((8, 17), np.float32), "tif", "17 x 8 pixels"),
        (np.zeros((8, 16), np.float32), "tif", "black"),
        (np.full((8, 16), -1, np.float32), "tif", "negative"),
        (np.full((8, 16), np.nan, np.float32), "tif", "not finite"),
        (np.full((8, 16), np.inf, np.float32), "tif", "not finite"),
        (np.ones((8, 16), np.int16), "tif", "int16"),
    ],
)
def test_refusals(tmp_path, image, ending, says):
    path = tmp_path / f"a.{ending}"
    cv2.imwrite(str(path), image)
    with pytest.raises(ImageError, match=says) as caught:
        read_panorama(path)
    assert "\n" not in str(caught.value)
    assert "a.tif" in str(caught.value)


def test_invalid_files(tmp_path, capfd):
    (tmp_path / "text.hdr").write_text("no picture")
    (tmp_path / "empty.hdr").write_bytes(b"")
    (tmp_path / "a.exr").write_bytes(b"\x76\x2f\x31\x01 and more")
    whole = radiance_bytes(np.ones((8, 16, 3)))
    (tmp_path / "short.hdr").write_bytes(whole[:-40])
    cv2.imwrite(str(tmp_path / "whole.jpg"), np.full((64, 128), 99, np.uint8))
    (tmp_path / "short.jpg").write_bytes((tmp_path / "whole.jpg").read_bytes()[:-9])
    names = ["text.hdr", "empty.hdr", "short.hdr", "short.jpg", "a.exr", "nowhere.hdr"]
    for name in names:
        with pytest.raises(ImageError, match=name):
            read_picture(tmp_path / name)
    with pytest.raises(ImageError, match="convert"):
        read_picture(tmp_path / "a.exr")
    assert capfd.readouterr().err == ""  # no message from OpenCV; the error has it


def test_other_sizes():
    """Area means for coarser rasters, linear interpolation for finer ones."""
    ramp = np.tile(np.arange(8.0), (4, 1))
    assert resized(ramp, (2, 4)) == pytest.approx(np.tile([0.5, 2.5, 4.5, 6.5], (2, 1)))
    finer = resized(ramp, (8, 16))
    assert finer[:, 1:-1] == pytest.approx(np.tile((np.arange(16) - 0.5)[1:-1] / 2, (8, 1)))
    assert resized(ramp, (4, 8)) is ramp


def test_cie_skies_by_their_published_ratios():
    """Overcast: three times as bright in the zenith as at the horizon. Clear: brightest at the Sun,
    where the standard's indicatrix is 11.4 (table 1: c = 10, d = -3, e = 0.45).
    """
    sky = cie_sky(512, 0.0, 40.0, OVERCAST).luminance
    assert sky[0].mean() / sky[255].mean() == pytest.approx(3.0, rel=0.02)
    clear = cie_sky(256, 210.0, 40.0)
    row, col = np.unravel_index(int(clear.luminance.argmax()), clear.luminance.shape)
    assert directions(256)[row, col] @ direction_enu(210.0, 40.0) > math.cos(math.radians(1.0))
    peak = 1 + CLEAR.c * (1 - math.exp(CLEAR.d * math.pi / 2)) + CLEAR.e
    gradation = [1 + CLEAR.a * math.exp(CLEAR.b / math.sin(math.radians(e))) for e in (40, 90)]
    angle = math.radians(50)
    zenith = 1 + CLEAR.c * (math.exp(CLEAR.d * angle) - math.exp(CLEAR.d * math.pi / 2))
    zenith += CLEAR.e * math.cos(angle) ** 2
    expected = peak * gradation[0] / (zenith * gradation[1])
    assert clear.luminance.max() == pytest.approx(expected, rel=0.03)


def test_dynamic_ranges():
    light = np.zeros((4, 8))
    light[0, 0], light[1, 3], light[3, 2] = 100.0, 0.5, 0.01
    panorama = Panorama(light)
    assert panorama.dynamic_range == pytest.approx(1e4)
    assert panorama.dynamic_range_above == pytest.approx(200.0)


@pytest.mark.slow
@pytest.mark.parametrize("rows", [64, 1100])  # the larger one is sampled
def test_one_wrong_pixel_does_not_decide_the_range(rows):
    light = cie_sky(rows, 120.0, 50.0).luminance.copy()
    whole = Panorama(light).dynamic_range
    light[rows // 4, ::100] = 1e-15  # noise of a camera
    wrong = Panorama(light)
    assert light.max() / light.min() > 1e15
    assert wrong.dynamic_range == pytest.approx(whole, rel=0.05)
    assert wrong.dynamic_range_above == pytest.approx(Panorama(light).dynamic_range_above)
    assert 3.0 < wrong.dynamic_range_above < 1e3


def test_the_report_of_an_environment(caplog):
    caplog.set_level("INFO")
    sky = room(64, [Lamp(30.0, 40.0, 2.0), Lamp(200.0, 20.0, 1.0)], ambient=0.01)
    found = Environment.of(sky).report
    assert [one["azimuth_deg"] for one in found["sources"]] == pytest.approx([30, 200], abs=2)
    shares = [one["power_share"] for one in found["sources"]]
    assert sum(shares) + found["remainder_share"] == pytest.approx(1.0, abs=1e-12)
    assert shares[0] / shares[1] == pytest.approx(2.0, rel=0.02)
    assert found["sun_sky_ratio"] == found["sun_sky_ratio_found"] > 0
    assert "2 sources" in caplog.text
    assert "dynamic range" in caplog.text
    scaled = Environment.of(sky, sun_sky_ratio=4.0)
    assert scaled.report["sun_sky_ratio"] == pytest.approx(4.0)
    assert "before it was scaled" in scaled.sentence


def test_a_uniform_sky_has_nothing_to_scale():
    with pytest.raises(ImageError, match="no bright source"):
        Environment.of(uniform(16), sun_sky_ratio=4.0)
