"""Image files as photos: which pixels count and for how much, what took them, where the Sun stood; and what is refused."""

from __future__ import annotations

import json
import logging
import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import photo_files as files
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rasterio.enums import ColorInterp
from rasterio.transform import Affine

from lcp_catalog import image_pixels
from lcp_catalog.camera_file import read_camera
from lcp_catalog.errors import ImageError
from lcp_catalog.image_pixels import read_image
from lcp_catalog.map_image import MapImage
from lcp_catalog.photo import Photo
from lcp_catalog.photo_file import PhotoOptions, center_of, open_photo
from lcp_catalog.request import SunChoice
from lcp_catalog.sphere import EnuFrame, enu_rotation, lonlat_to_mcmf
from lcp_catalog.sun import sun_direction_at

SHAPE = (40, 60)
NOON = SunChoice(subsolar_deg=(0.0, 0.0))
MAP = {"crs": files.MOON, "transform": Affine(0.1, 0, 10, 0, -0.1, 5)}


def scene(dtype: str = "uint8", low: float = 20.0, high: float = 220.0) -> np.ndarray:
    """A bell of brightness well within its scale, (rows, cols)."""
    rng = np.random.default_rng(3)
    bell = np.clip(rng.normal(0.5, 0.12, SHAPE), 0.0, 1.0)
    values = low + (high - low) * bell
    return np.round(values).astype(dtype) if np.dtype(dtype).kind in "ui" else values.astype(dtype)


def photo(path: Path, options: PhotoOptions | None = None, **change: object) -> Photo:
    return open_photo(path, files.camera_over(SHAPE), None, options, **change)


# -- signals of all kinds


@pytest.mark.parametrize(
    "dtype", ["uint8", "int16", "uint16", "int32", "uint32", "float32", "float64"]
)
def test_a_geotiff_of_any_type(tmp_path: Path, dtype: str) -> None:
    samples = scene(dtype)
    found = photo(files.write_image(tmp_path / "a.tif", samples))
    np.testing.assert_array_equal(found.signal, samples.astype(np.float32))
    np.testing.assert_array_equal(found.weight, 1.0)
    assert (found.saturated_share, found.missing_share, found.name) == (0.0, 0.0, "a.tif")


@pytest.mark.parametrize("dtype", ["uint8", "uint16"])
def test_a_png(tmp_path: Path, dtype: str) -> None:
    samples = scene(dtype)
    found = photo(files.write_image(tmp_path / "a.png", samples, driver="PNG"))
    np.testing.assert_array_equal(found.signal, samples)


@pytest.mark.parametrize("dtype", ["uint8", "int16", "uint16", "float32"])
def test_a_cube_has_its_base_and_multiplier(tmp_path: Path, dtype: str) -> None:
    samples = scene(dtype)
    found = photo(files.write_cube(tmp_path / "a.cub", samples, base=-3.5, multiplier=0.25))
    np.testing.assert_allclose(found.signal, samples * 0.25 - 3.5, rtol=1e-6)


@pytest.mark.parametrize("dtype", ["uint8", "int16", "float32"])
@pytest.mark.parametrize("ending", [".img", ".IMG", ".lbl"])
def test_a_pds3_image_with_its_label_in_front(tmp_path: Path, dtype: str, ending: str) -> None:
    samples = scene(dtype)
    found = photo(files.write_pds3(tmp_path / f"a{ending}", samples))
    np.testing.assert_array_equal(found.signal, samples.astype(np.float32))


@pytest.mark.parametrize("ending", ["img", "IMG"])
def test_bare_numbers_are_found_by_their_label(tmp_path: Path, ending: str) -> None:
    samples = scene()
    attached = files.write_pds3(tmp_path / "attached", samples).read_bytes()
    name = f"PHOTO.{ending}"
    label = attached[:4096].replace(b"^IMAGE = 2", b'^IMAGE = ("' + name.encode() + b'", 1)')
    (tmp_path / "PHOTO.LBL").write_bytes(
        label.replace(b"RECORD_BYTES = 4096", b"RECORD_BYTES = 60")
    )
    (tmp_path / name).write_bytes(samples.tobytes())
    np.testing.assert_array_equal(photo(tmp_path / name).signal, samples.astype(np.float32))


def test_luminance_of_colours_is_that_of_rec_709(tmp_path: Path) -> None:
    planes = np.stack([scene(high=high) for high in (120.0, 180.0, 240.0)])
    found = photo(files.write_image(tmp_path / "a.png", planes, driver="PNG"))
    wanted = 0.2126 * planes[0] + 0.7152 * planes[1] + 0.0722 * planes[2]
    np.testing.assert_allclose(found.signal, wanted, rtol=1e-5)


@pytest.mark.parametrize(("grey", "dtype"), [(True, "uint8"), (False, "float32")])
def test_a_palette_is_looked_up(tmp_path: Path, grey: bool, dtype: str) -> None:
    codes = scene()
    path = files.write_image(tmp_path / "a.tif", codes, photometric="palette")
    table = {i: (255 - i, 255 - i, 255 - i if grey else 0, 255) for i in range(256)}
    import rasterio

    with rasterio.open(path, "r+") as file:
        file.write_colormap(1, table)
    assert read_image(path).samples.dtype == dtype
    wanted = (255.0 - codes) * (1.0 if grey else 0.2126 + 0.7152)
    np.testing.assert_allclose(photo(path).signal, wanted, rtol=1e-5)


def srgb(code: float) -> float:
    """Light of a code of full scale 1, by IEC 61966-2-1."""
    return code / 12.92 if code <= 0.04045 else ((code + 0.055) / 1.055) ** 2.4


@pytest.mark.parametrize("dtype", ["uint8", "uint16"])
@pytest.mark.parametrize("colours", [1, 3])
def test_codes_of_a_display_are_decoded(tmp_path: Path, dtype: str, colours: int) -> None:
    """Greys, also those that are written as colours; weights are those of the codes."""
    full = np.iinfo(dtype).max
    samples = np.minimum(scene(dtype, 0.01 * full, 0.9 * full), np.array(0.6 * full, dtype=dtype))
    path = files.write_image(tmp_path / "a.png", [samples] * colours, driver="PNG")
    found = photo(path, PhotoOptions(encoding="srgb"))
    bright = samples == samples.max()
    np.testing.assert_array_equal(found.weight, np.where(bright, 0.0, 1.0))
    wanted = np.vectorize(srgb)(samples / full)
    np.testing.assert_allclose(found.signal[~bright], wanted[~bright], rtol=1e-5)
    np.testing.assert_array_equal(photo(path).signal[~bright], samples[~bright])


@pytest.mark.parametrize("how", ["bands", "palette"])
def test_colours_of_a_display_are_decoded_before_they_are_weighed(tmp_path: Path, how: str) -> None:
    codes = scene()
    planes = [codes, 255 - codes, codes // 2]
    if how == "bands":
        path = files.write_image(tmp_path / "a.png", planes, driver="PNG")
    else:
        path = files.write_image(tmp_path / "a.tif", codes, photometric="palette")
        import rasterio

        with rasterio.open(path, "r+") as file:
            file.write_colormap(1, {i: (i, 255 - i, i // 2, 255) for i in range(256)})
    found = photo(path, PhotoOptions(encoding="srgb"))
    light = [np.vectorize(srgb)(plane / 255) for plane in planes]
    wanted = 0.2126 * light[0] + 0.7152 * light[1] + 0.0722 * light[2]
    np.testing.assert_allclose(found.signal, wanted, rtol=1e-5)


def test_floats_are_no_codes_of_a_display(tmp_path: Path) -> None:
    options = PhotoOptions(encoding="srgb")
    for name, bands in (
        ("a.tif", scene("float32")),
        ("b.tif", [scene("float32") * i for i in (1, 2, 3)]),
    ):
        kinds = [ColorInterp.red, ColorInterp.green, ColorInterp.blue] if name == "b.tif" else None
        path = files.write_image(tmp_path / name, bands, kinds=kinds)
        refused(
            "holds float32, no codes of a display: --encoding linear",
            path,
            files.camera_over(SHAPE),
            None,
            options,
        )
    with pytest.raises(ImageError, match="no encoding 'gamma'; there are linear, srgb"):
        PhotoOptions(encoding="gamma")


def test_of_many_bands_the_first_or_the_one_that_is_asked_for(tmp_path: Path) -> None:
    planes = np.stack([scene("float32"), 2 * scene("float32"), 3 * scene("float32")])
    kinds = [ColorInterp.gray, ColorInterp.undefined, ColorInterp.undefined]
    path = files.write_image(tmp_path / "a.tif", planes, kinds=kinds)
    np.testing.assert_array_equal(photo(path).signal, planes[0])
    np.testing.assert_array_equal(photo(path, PhotoOptions(band=3)).signal, planes[2])
    for band in (0, 4, -1):
        with pytest.raises(ImageError, match=rf"has no band {band}; bands are 1 to 3"):
            photo(path, PhotoOptions(band=band))
    cube = files.write_cube(tmp_path / "a.cub", planes)
    np.testing.assert_array_equal(photo(cube, PhotoOptions(band=2)).signal, planes[1])


def test_a_band_that_is_asked_for_has_its_own_mask_and_is_no_luminance(tmp_path: Path) -> None:
    planes = np.stack([scene("float32", high=high) for high in (120.0, 180.0, 240.0)])
    planes[0, :5] = planes[2, -5:] = -1.0
    kinds = [ColorInterp.red, ColorInterp.green, ColorInterp.blue]
    path = files.write_image(tmp_path / "a.tif", planes, kinds=kinds, nodata=-1.0)
    found = photo(path, PhotoOptions(band=3))
    assert not found.weight[-5:].any()
    assert found.weight[:-5].all()
    np.testing.assert_array_equal(found.signal[:-5], planes[2, :-5])


def test_images_that_are_too_large(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = files.write_image(tmp_path / "a.tif", scene())
    monkeypatch.setattr(image_pixels, "_MOST_PIXELS", 2400)
    photo(path)
    monkeypatch.setattr(image_pixels, "_MOST_PIXELS", 2399)
    refused("60 x 40 pixels, 1 bands; at most 0.002399 million", path, files.camera_over(SHAPE))


# -- what is missing

HOLE = np.s_[10:20, 30:50]
HOLE_SHARE = 200 / 2400


def assert_hole(found: Photo, samples: np.ndarray) -> None:
    rest = np.ones(SHAPE, bool)
    rest[HOLE] = False
    assert np.isnan(found.signal[HOLE]).all()
    np.testing.assert_array_equal(found.weight, rest.astype(np.float32))
    np.testing.assert_array_equal(found.signal[rest], samples[rest].astype(np.float32))
    assert found.missing_share == pytest.approx(HOLE_SHARE)
    assert found.saturated_share == 0.0


@pytest.mark.parametrize("how", ["nodata", "alpha", "mask", "second band", "stated"])
def test_masks_of_geotiffs(tmp_path: Path, how: str) -> None:
    samples = scene()
    there = np.full(SHAPE, 255, np.uint8)
    there[HOLE] = 0
    path, options = tmp_path / "a.tif", None
    if how in ("nodata", "stated"):
        holed = np.where(there > 0, samples, 7).astype(np.uint8)
        files.write_image(path, holed, **({"nodata": 7} if how == "nodata" else {}))
        options = PhotoOptions(nodata=7) if how == "stated" else None
    elif how == "mask":
        files.write_image(path, samples, mask=there)
    else:
        kinds = [ColorInterp.gray, ColorInterp.alpha if how == "alpha" else ColorInterp.undefined]
        files.write_image(path, [samples, there], kinds=kinds)
    assert_hole(photo(path, options), samples)


def test_alpha_of_colours(tmp_path: Path) -> None:
    there = np.full(SHAPE, 255, np.uint8)
    there[HOLE] = 0
    found = photo(files.write_image(tmp_path / "a.png", [scene()] * 3 + [there], driver="PNG"))
    assert np.isnan(found.signal[HOLE]).all()
    assert found.missing_share == pytest.approx(HOLE_SHARE)


def test_a_second_band_of_brightness_is_no_mask(tmp_path: Path) -> None:
    second = scene()
    second[HOLE] = 0
    kinds = [ColorInterp.gray, ColorInterp.undefined]
    path = files.write_image(tmp_path / "a.tif", [scene(), second], kinds=kinds)
    assert photo(path).missing_share == 0.0


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_what_is_not_finite_is_missing(tmp_path: Path, dtype: str, value: float) -> None:
    samples = scene(dtype)
    samples[HOLE] = value
    assert_hole(photo(files.write_image(tmp_path / "a.tif", samples)), samples)


NULL = {"uint8": 0, "int16": -32768, "uint16": 0, "float32": -3.4028226550889045e38}
LOW = {
    "int16": (-32767, -32766),
    "uint16": (1, 2),
    "float32": (-3.4028228579130005e38, -3.4028230607370965e38),
}
HIGH = {"uint8": (255, 255), "int16": (-32765, -32764), "uint16": (65534, 65535),
        "float32": (-3.4028232635611926e38, -3.4028234663852886e38)}  # fmt: skip


@pytest.mark.parametrize("dtype", NULL)
def test_null_of_cubes(tmp_path: Path, dtype: str) -> None:
    samples = scene(
        dtype, 1000.0 if dtype == "uint16" else 20.0, 2000.0 if dtype == "uint16" else 220.0
    )
    samples[HOLE] = NULL[dtype]
    assert_hole(photo(files.write_cube(tmp_path / "a.cub", samples)), samples)


@pytest.mark.parametrize("dtype", LOW)
@pytest.mark.parametrize("which", [0, 1])
def test_too_dark_for_a_cube_is_as_dark_as_its_darkest(
    tmp_path: Path, dtype: str, which: int
) -> None:
    samples = scene(dtype)
    samples[HOLE] = np.array(LOW[dtype][which], dtype=dtype)
    found = photo(files.write_cube(tmp_path / "a.cub", samples, base=5.0, multiplier=2.0))
    rest = np.ones(SHAPE, bool)
    rest[HOLE] = False
    np.testing.assert_array_equal(found.signal[HOLE], found.signal[rest].min())
    np.testing.assert_array_equal(found.weight, 1.0)
    assert (found.missing_share, found.saturated_share) == (0.0, 0.0)


@pytest.mark.parametrize("dtype", HIGH)
@pytest.mark.parametrize("which", [0, 1])
def test_too_bright_for_a_cube_is_saturated(tmp_path: Path, dtype: str, which: int) -> None:
    samples = scene(dtype)
    samples[HOLE] = np.array(HIGH[dtype][which], dtype=dtype)
    found = photo(files.write_cube(tmp_path / "a.cub", samples))
    assert np.isnan(found.signal[HOLE]).all()
    assert not found.weight[HOLE].any()
    assert found.saturated_share == pytest.approx(HOLE_SHARE)
    assert found.missing_share == 0.0


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float32"])
def test_codes_of_cubes_are_brightness_elsewhere(tmp_path: Path, dtype: str) -> None:
    """In a GeoTIFF 0 and 255 are values like others, as long as no plateau stands there."""
    samples = scene(dtype)
    samples[5, 5:7] = 0, 255
    found = photo(files.write_image(tmp_path / "a.tif", samples))
    assert found.weight.all()
    np.testing.assert_array_equal(found.signal[5, 5:7], [0.0, 255.0])


PDS3_CODES = {
    "int16": "NULL = {0}\nLOW_REPR_SATURATION = {1}\nLOW_INSTR_SATURATION = {2}\n"
    "HIGH_INSTR_SATURATION = {3}\nHIGH_REPR_SATURATION = {4}",
    "float32": "CORE_NULL = {0}\nCORE_LOW_REPR_SATURATION = {1}\nCORE_LOW_INSTR_SATURATION = {2}\n"
    "CORE_HIGH_INSTR_SATURATION = {3}\nCORE_HIGH_REPR_SATURATION = {4}",
}


@pytest.mark.parametrize("how", ["16#", "number"])
@pytest.mark.parametrize("dtype", PDS3_CODES)
def test_codes_that_a_pds3_label_states(tmp_path: Path, dtype: str, how: str) -> None:
    """As LROC's labels have them: bits of floats as 16#FF7FFFFB# or 4286578683. Not the codes of ISIS here: others."""
    bits = (
        [0xC7000001 + i for i in range(5)] if dtype == "float32" else [-9995 + i for i in range(5)]
    )
    samples = scene(dtype)
    kind = np.uint32 if dtype == "float32" else np.int16
    samples.view(kind)[0, :5] = bits
    words = [f"16#{b:X}#" if how == "16#" and b > 0 else str(b) for b in bits]
    path = files.write_pds3(tmp_path / "a.img", samples, image=PDS3_CODES[dtype].format(*words))
    found = photo(path)
    np.testing.assert_array_equal(found.weight[0, :6], [0.0, 1.0, 1.0, 0.0, 0.0, 1.0])
    assert found.missing_share == pytest.approx(1 / 2400)
    assert found.saturated_share == pytest.approx(2 / 2400)
    assert found.signal[0, 1] == found.signal[1:].min()


def test_zeros_of_pds3_bytes_are_brightness(tmp_path: Path) -> None:
    """GDAL takes them for missing."""
    samples = scene()
    samples[5, 5] = 0
    found = photo(files.write_pds3(tmp_path / "a.img", samples))
    assert (found.weight[5, 5], found.signal[5, 5]) == (1.0, 0.0)


@pytest.mark.parametrize(
    ("statement", "missing"), [("", True), ("MISSING_CONSTANT = -9999", False)]
)
def test_the_lowest_of_16_bits_is_missing_unless_another_is(
    tmp_path: Path, statement: str, missing: bool
) -> None:
    samples = scene("int16")
    samples[5, 5:7] = -32768, -9999
    found = photo(files.write_pds3(tmp_path / "a.img", samples, image=statement))
    assert found.weight[5, 5:7].tolist() == ([0.0, 1.0] if missing else [1.0, 0.0])


# -- plateaus


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float32"])
def test_saturation_weighs_nothing(tmp_path: Path, dtype: str) -> None:
    samples = np.minimum(scene(dtype), np.array(140, dtype=dtype))
    found = photo(files.write_image(tmp_path / "a.tif", samples))
    bright = samples == 140
    assert bright.any()
    np.testing.assert_array_equal(found.weight, np.where(bright, 0.0, 1.0))
    np.testing.assert_array_equal(np.isnan(found.signal), bright)
    assert found.saturated_share == pytest.approx(bright.mean())


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float32"])
def test_clipped_shadows_count(tmp_path: Path, dtype: str) -> None:
    samples = np.maximum(scene(dtype), np.array(90, dtype=dtype))
    found = photo(files.write_image(tmp_path / "a.tif", samples))
    dark = samples == 90
    assert dark.any()
    np.testing.assert_array_equal(found.weight, 1.0)
    np.testing.assert_array_equal(found.signal, samples)
    assert (found.missing_share, found.saturated_share) == (0.0, 0.0)


def test_a_half_saturated_image(tmp_path: Path) -> None:
    samples = scene()
    samples[:, :30] = 255
    found = photo(files.write_image(tmp_path / "a.png", samples, driver="PNG"))
    assert found.saturated_share == 0.5
    assert not found.valid[:, :30].any()
    assert found.valid[:, 30:].all()


def margin(samples: np.ndarray) -> np.ndarray:
    """With a black frame around it, and a black shadow within."""
    framed = samples.copy()
    framed[:6] = framed[-6:] = 0
    framed[:, :6] = framed[:, -6:] = 0
    framed[20:28, 25:40] = 0
    return framed


@pytest.mark.parametrize("mask", [None, np.full(SHAPE, 255, np.uint8)])
def test_black_around_a_map_projected_image_is_missing(
    tmp_path: Path, mask: np.ndarray | None
) -> None:
    """Also where the file has a mask that masks nothing; a shadow within is a shadow."""
    path = files.write_image(tmp_path / "a.tif", margin(scene()), mask=mask, **MAP)
    found = open_photo(path, None, NOON)
    inside = np.zeros(SHAPE, bool)
    inside[6:-6, 6:-6] = True
    np.testing.assert_array_equal(found.weight == 0.0, ~inside)
    np.testing.assert_array_equal(found.weight[20:28, 25:40], 1.0)
    assert found.missing_share == pytest.approx((~inside).mean())


@pytest.mark.parametrize("kind", ["camera", "nodata"])
def test_black_at_the_edge_is_shadow_elsewhere(tmp_path: Path, kind: str) -> None:
    """A frame of a camera has no filler; a map that says what is missing has said it."""
    on_map = {} if kind == "camera" else {**MAP, "nodata": 255}
    path = files.write_image(tmp_path / "a.tif", margin(scene()), **on_map)
    found = photo(path) if kind == "camera" else open_photo(path, None, NOON)
    assert found.missing_share == 0.0
    assert found.weight.all()


# -- what took it


def test_a_map_projected_image_is_its_own_sensor(tmp_path: Path) -> None:
    path = files.write_image(tmp_path / "a.tif", scene(), **MAP)
    options = PhotoOptions(off_nadir_deg=20.0, view_azimuth_deg=90.0)
    found = open_photo(path, None, NOON, options)
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
    found = open_photo(path, None, NOON).sensor.project(lonlat_to_mcmf(170.0, 5.0))
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
    found = open_photo(path, None, NOON).sensor.project(lonlat_to_mcmf(40.0, -89.5))
    np.testing.assert_allclose(found, wanted, atol=1e-6)


def test_a_camera_goes_before_a_map(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = files.write_image(tmp_path / "a.tif", scene(), **MAP)
    camera = files.camera_over(SHAPE)
    assert open_photo(path, camera).sensor is camera
    assert "is on a map, which is left aside" in caplog.text


def test_the_middle_of_an_image() -> None:
    lon, lat = center_of(files.camera_over(SHAPE, 200.0, 70.0))
    assert (lon, lat) == (pytest.approx(200.0), pytest.approx(70.0))
    camera = files.camera_over(SHAPE)
    away = replace(
        camera, rotation_mcmf_to_camera=np.diag([-1.0, 1.0, -1.0]) @ camera.rotation_mcmf_to_camera
    )
    with pytest.raises(ImageError, match=r"its middle does not show the Moon"):
        center_of(away)
    globe = (
        f'PROJCS["x",{files.MOON},PROJECTION["Orthographic"],PARAMETER["latitude_of_origin",0],'
        'PARAMETER["central_meridian",0],UNIT["metre",1]]'
    )
    beside = MapImage(globe, (1e4, 0, 1.8e6, 0, -1e4, 0), SHAPE, "beside the disc")
    with pytest.raises(ImageError, match=r"beside the disc: its middle does not show the Moon"):
        center_of(beside)


# -- the Sun


def test_the_cameras_sun_and_its_time(tmp_path: Path) -> None:
    path = files.write_image(tmp_path / "a.tif", scene())
    camera = files.camera_over(SHAPE)
    np.testing.assert_array_equal(photo(path).sun_position_mcmf_m, camera.sun_position_mcmf_m)
    timed = replace(camera, sun_position_mcmf_m=None, time_utc="2024-01-01T00:00:00")
    found = open_photo(path, timed)
    np.testing.assert_array_equal(found.sun_direction_mcmf, sun_direction_at("2024-01-01T00:00:00"))
    assert found.sun_position_mcmf_m is None


@pytest.mark.parametrize("center", [None, (22.0, -9.0)])
def test_angles_are_those_at_the_middle_or_where_it_is_said(
    tmp_path: Path, center: tuple[float, float] | None
) -> None:
    path = files.write_image(tmp_path / "a.tif", scene())
    stated = SunChoice(azimuth_deg=80.0, elevation_deg=25.0)
    camera = files.camera_over(SHAPE, sun=False)
    found = open_photo(path, camera, stated, PhotoOptions(center_deg=center))
    enu = EnuFrame(*(center or (20.0, -10.0))).direction_from_mcmf(found.sun_direction_mcmf)
    level = math.cos(math.radians(25))
    wanted = [
        level * math.sin(math.radians(80)),
        level * math.cos(math.radians(80)),
        math.sin(math.radians(25)),
    ]
    np.testing.assert_allclose(enu, wanted, atol=1e-9)


@pytest.mark.parametrize("sun", [SunChoice(time_utc="2024-01-01T00:00:00"), NOON])
def test_a_stated_sun_goes_before_all_others_and_says_so(
    tmp_path: Path, sun: SunChoice, caplog: pytest.LogCaptureFixture
) -> None:
    tags = {"sun_direction_mcmf": json.dumps([0.0, -1.0, 0.0])}
    path = files.write_image(tmp_path / "a.tif", scene(), tags=tags)
    found = open_photo(path, files.camera_over(SHAPE), sun)
    wanted = sun.direction_mcmf(EnuFrame(0.0, 0.0), None)
    np.testing.assert_array_equal(found.sun_direction_mcmf, wanted)
    assert "the Sun as given stands" in caplog.text
    assert "from the Sun of its camera; the first counts" in caplog.text
    assert "from the Sun of its label; the first counts" in caplog.text


@pytest.mark.parametrize(("off_deg", "warned"), [(0.9, False), (1.1, True), (180.0, True)])
def test_small_differences_are_not_worth_a_word(
    tmp_path: Path, off_deg: float, warned: bool, caplog: pytest.LogCaptureFixture
) -> None:
    path = files.write_image(tmp_path / "a.tif", scene())
    camera = replace(files.camera_over(SHAPE), sun_position_mcmf_m=np.array([1.5e11, 0.0, 0.0]))
    with caplog.at_level(logging.WARNING):
        open_photo(path, camera, SunChoice(subsolar_deg=(off_deg, 0.0)))
    assert bool(caplog.records) == warned
    if warned:
        assert f"stands {off_deg:.1f} deg from" in caplog.text


def test_the_camera_goes_before_the_label(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    tags = {"sun_direction_mcmf": json.dumps([0.0, -1.0, 0.0])}
    path = files.write_image(tmp_path / "a.tif", scene(), tags=tags)
    camera = files.camera_over(SHAPE)
    np.testing.assert_array_equal(
        open_photo(path, camera).sun_position_mcmf_m, camera.sun_position_mcmf_m
    )
    assert "the Sun of its camera stands" in caplog.text
    found = open_photo(path, replace(camera, sun_position_mcmf_m=None))
    np.testing.assert_array_equal(found.sun_direction_mcmf, [0.0, -1.0, 0.0])


# -- refusals


def refused(why: str, path: Path, *arguments: object) -> None:
    with pytest.raises(ImageError, match=why) as caught:
        open_photo(path, *arguments)  # type: ignore[arg-type]
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_images_that_are_none(tmp_path: Path) -> None:
    camera = files.camera_over(SHAPE)
    refused("no such image file", tmp_path / "none.tif", camera)
    refused("no such image file", tmp_path, camera)
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
    refused("samples are complex64; give integers or floats", path, files.camera_over(SHAPE))


def test_an_image_of_another_size_than_its_cameras(tmp_path: Path) -> None:
    path = files.write_image(tmp_path / "a.tif", scene())
    refused(r"has 60 x 40 pixels, its camera camera has 40 x 60", path, files.camera_over((60, 40)))


def test_no_geometry_and_no_sun(tmp_path: Path) -> None:
    path = files.write_image(tmp_path / "a.png", scene(), driver="PNG")
    refused("missing geometry: it has no map; give --camera", path, None, NOON)
    refused("where the Sun stood is not known", path, files.camera_over(SHAPE, sun=False))
    on_map = files.write_image(tmp_path / "b.tif", scene(), **MAP)
    refused("where the Sun stood is not known: give --time, --subsolar, or", on_map)


def test_an_image_of_the_earth(tmp_path: Path) -> None:
    path = files.write_image(
        tmp_path / "a.tif", scene(), crs="EPSG:32633", transform=MAP["transform"]
    )
    refused(re.escape("6378137/"), path, None, NOON)


@pytest.mark.parametrize("value", [0, 100, 255])
def test_a_blank_image(tmp_path: Path, value: int) -> None:
    path = files.write_image(tmp_path / "a.tif", np.full(SHAPE, value, np.uint8))
    refused("is blank: all its valid pixels are the same", path, files.camera_over(SHAPE))
    refused(
        "is blank: all its valid pixels are the same",
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


# -- reduced photos


def blocks(found: Photo, factor: int) -> tuple[np.ndarray, np.ndarray]:
    """Block by block, pixel by pixel."""
    rows, cols = (n // factor for n in found.signal.shape)
    signal, weight = np.full((rows, cols), np.nan), np.zeros((rows, cols))
    for row in range(rows):
        for col in range(cols):
            total = light = 0.0
            for r in range(row * factor, (row + 1) * factor):
                for c in range(col * factor, (col + 1) * factor):
                    w = float(found.weight[r, c])
                    total += w
                    light += w * float(found.signal[r, c]) if w > 0 else 0.0
            weight[row, col] = total / factor**2
            signal[row, col] = light / total if total > 0 else math.nan
    return signal, weight


@given(
    shape=st.tuples(st.integers(7, 23), st.integers(7, 23)), factor=st.integers(1, 7),
    seed=st.integers(0, 2**32 - 1),
)  # fmt: skip
def test_reduced_photos_are_means_of_blocks(shape: tuple[int, int], factor: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    weight = rng.choice([0.0, 0.5, 1.0], shape).astype(np.float32)
    weight[: shape[0] // 2, : shape[1] // 2] = 0.0
    signal = np.where(weight > 0, rng.normal(100, 30, shape), np.nan).astype(np.float32)
    whole = Photo("x", signal, weight, files.camera_over(shape), np.array([1.5e11, 0, 0]))
    small = whole.reduced(factor)
    wanted = blocks(whole, factor)
    np.testing.assert_allclose(small.weight, wanted[1], rtol=1e-6)
    np.testing.assert_allclose(small.signal, wanted[0], rtol=1e-6)
    assert small.sensor.shape == small.signal.shape


@given(factor=st.integers(2, 6), seed=st.integers(0, 2**32 - 1))
def test_reduced_sensors_see_the_same_ground(factor: int, seed: int) -> None:
    """The middle of a block of pixels is the pixel of the reduced image: no half of one is lost."""
    camera = files.camera_over((50, 70))
    whole = Photo(
        "x", np.zeros((50, 70), np.float32), np.ones((50, 70), np.float32), camera, np.ones(3)
    )
    small = whole.reduced(factor).sensor
    rows, cols = small.shape
    pixel = np.random.default_rng(seed).integers(0, [cols, rows], (5, 2)).astype(float)
    middle = pixel * factor + (factor - 1) / 2
    for a, b in zip(small.looks(pixel), camera.looks(middle), strict=True):
        np.testing.assert_allclose(a, b)
    point = lonlat_to_mcmf(20.05, -10.05)
    np.testing.assert_allclose(
        camera.project(point), small.project(point) * factor + (factor - 1) / 2
    )


def test_reducing_twice_is_reducing_once(tmp_path: Path) -> None:
    samples = scene()
    samples[HOLE] = 255
    found = photo(files.write_image(tmp_path / "a.tif", samples))
    twice, once = found.reduced(2).reduced(2), found.reduced(4)
    np.testing.assert_allclose(twice.signal, once.signal, rtol=1e-5)
    np.testing.assert_allclose(twice.weight, once.weight)
    point = lonlat_to_mcmf(20.1, -10.1)
    np.testing.assert_allclose(twice.sensor.project(point), once.sensor.project(point))


# -- real files


def test_frames_of_apollo(shared_data: Path) -> None:
    """AS15-M-0414: 276 pixels at 255, where the codes below hold some 60 each; nothing is clipped below."""
    folder = shared_data / "images" / "apollo15-metric-hadley"
    camera = read_camera(folder / "AS15-M-0414_camera.json")
    found = open_photo(folder / "AS15-M-0414.png", camera)
    assert found.signal.shape == (404, 404)
    assert found.saturated_share == pytest.approx(276 / 404**2)
    assert found.missing_share == 0.0
    assert set(np.unique(found.weight).tolist()) == {0.0, 1.0}
    np.testing.assert_array_equal(found.sun_position_mcmf_m, camera.sun_position_mcmf_m)


def test_the_scanned_crop_has_a_palette_of_greys(shared_data: Path) -> None:
    folder = shared_data / "images" / "apollo15-metric-hadley"
    camera = read_camera(folder / "AS15-M-1134_sub4crop_256ppd_camera.json")
    found = open_photo(folder / "sub4-AS15-M-1134_crop.png", camera)
    assert found.saturated_share == pytest.approx(3201 / 640000)
    assert (found.signal == 1.0).sum() == 3273  # a plateau of shadow, which counts
    assert np.nanmax(found.signal) == 254.0


def test_map_projected_frames_of_apollo_16(shared_data: Path) -> None:
    """The corners of AS16-M-2804's map and the boom that its mask leaves out; geographic, 1280 m a pixel."""
    folder = shared_data / "images" / "apollo16-metric-series" / "DIM_input_1280mpp_masked"
    if not folder.is_dir():
        pytest.skip("the frames of the Apollo 16 series are not here")
    found = open_photo(folder / "AS16-M-2804.tif", None, NOON)
    assert found.missing_share == pytest.approx(0.2106, abs=2e-3)
    assert not found.weight[80, 130]  # the boom
    assert not found.weight[[0, 0, -1, -1], [0, -1, 0, -1]].any()
    assert found.weight[80, 60]
    center = found.sensor.project(lonlat_to_mcmf(*center_of(found.sensor)))
    np.testing.assert_allclose(center, [82.0, 81.5], atol=0.51)


def test_cubes_of_the_nac_and_of_apollo(shared_data: Path) -> None:
    """They are not on a map: their pixels are there for a camera of their size, with the Sun of their tables."""
    images = shared_data / "images"
    for path, size in (
        (images / "nac-m143947267l-spice" / "M143947267L.cal.echo.crop.cub", 400),
        (images / "apollo15-metric-farside" / "AS15-M-0299_crop.cub", 500),
    ):
        refused("missing geometry", path)
        found = open_photo(path, files.camera_over((size, size), sun=False))
        assert found.signal.shape == (size, size)
        assert found.missing_share == 0.0
        assert found.sun_position_mcmf_m is not None


def test_the_pit(shared_data: Path) -> None:
    """Its middle, as published, lies in the hole that the orthoimage has there."""
    path = shared_data / "images" / "nac-tranqpit1-pair" / "tranqpit1_ortho_M152662021_0p5m.tif"
    found = open_photo(path, None, NOON)
    assert found.missing_share == pytest.approx(0.0444, abs=1e-4)
    pixels = found.sensor.project(lonlat_to_mcmf(33.222, 8.335))
    col, row = np.round(pixels).astype(int)
    assert found.sensor.in_image(pixels)
    assert not found.weight[row, col]


def test_a_cube_is_the_right_way_up(shared_data: Path) -> None:
    """The cube of AS15-M-0299 is a window of the scan (its AlphaCube group: from sample 14396.5, line 4396.5 of
    22900 x 22900), where the whole frame's picture has the same ground.
    """
    folder = shared_data / "images" / "apollo15-metric-farside"
    cube = open_photo(folder / "AS15-M-0299_crop.cub", files.camera_over((500, 500), sun=False))
    whole = open_photo(folder / "AS15-M-0299_SML.png", files.camera_over((1012, 1012)))
    # one of the picture's pixels is 22.6 of the scan's, one of the cube's 16
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
