"""Valid pixels of an image file: masks, special codes, plateaus of saturation, black margins."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers import image_files as files
from helpers.image_files import HOLE, MAP, NOON, SHAPE, opened, scene
from rasterio.enums import ColorInterp

from lcp_catalog.images.image import Image
from lcp_catalog.images.image_file import ImageOptions, open_image

HOLE_SHARE = 200 / 2400

# -- missing samples


def assert_hole(found: Image, samples: np.ndarray) -> None:
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
        options = ImageOptions(nodata=7) if how == "stated" else None
    elif how == "mask":
        files.write_image(path, samples, mask=there)
    else:
        kinds = [ColorInterp.gray, ColorInterp.alpha if how == "alpha" else ColorInterp.undefined]
        files.write_image(path, [samples, there], kinds=kinds)
    assert_hole(opened(path, options), samples)


def test_alpha_of_colours(tmp_path: Path) -> None:
    there = np.full(SHAPE, 255, np.uint8)
    there[HOLE] = 0
    found = opened(files.write_image(tmp_path / "a.png", [scene()] * 3 + [there], driver="PNG"))
    assert np.isnan(found.signal[HOLE]).all()
    assert found.missing_share == pytest.approx(HOLE_SHARE)


def test_a_second_band_of_brightness_is_no_mask(tmp_path: Path) -> None:
    second = scene()
    second[HOLE] = 0
    kinds = [ColorInterp.gray, ColorInterp.undefined]
    path = files.write_image(tmp_path / "a.tif", [scene(), second], kinds=kinds)
    assert opened(path).missing_share == 0.0


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_samples_that_are_not_finite_are_missing(tmp_path: Path, dtype: str, value: float) -> None:
    samples = scene(dtype)
    samples[HOLE] = value
    assert_hole(opened(files.write_image(tmp_path / "a.tif", samples)), samples)


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
    assert_hole(opened(files.write_cube(tmp_path / "a.cub", samples)), samples)


@pytest.mark.parametrize("dtype", LOW)
@pytest.mark.parametrize("which", [0, 1])
def test_too_dark_for_a_cube_is_as_dark_as_its_darkest(
    tmp_path: Path, dtype: str, which: int
) -> None:
    samples = scene(dtype)
    samples[HOLE] = np.array(LOW[dtype][which], dtype=dtype)
    found = opened(files.write_cube(tmp_path / "a.cub", samples, base=5.0, multiplier=2.0))
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
    found = opened(files.write_cube(tmp_path / "a.cub", samples))
    assert np.isnan(found.signal[HOLE]).all()
    assert not found.weight[HOLE].any()
    assert found.saturated_share == pytest.approx(HOLE_SHARE)
    assert found.missing_share == 0.0


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float32"])
def test_codes_of_cubes_are_brightness_elsewhere(tmp_path: Path, dtype: str) -> None:
    """In a GeoTIFF 0 and 255 are ordinary values unless they form a plateau."""
    samples = scene(dtype)
    samples[5, 5:7] = 0, 255
    found = opened(files.write_image(tmp_path / "a.tif", samples))
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
    """As in labels of LROC: bits of floats as 16#FF7FFFFB# or 4286578683; here other codes than
    those of ISIS.
    """
    bits = (
        [0xC7000001 + i for i in range(5)] if dtype == "float32" else [-9995 + i for i in range(5)]
    )
    samples = scene(dtype)
    kind = np.uint32 if dtype == "float32" else np.int16
    samples.view(kind)[0, :5] = bits
    words = [f"16#{b:X}#" if how == "16#" and b > 0 else str(b) for b in bits]
    path = files.write_pds3(tmp_path / "a.img", samples, image=PDS3_CODES[dtype].format(*words))
    found = opened(path)
    np.testing.assert_array_equal(found.weight[0, :6], [0.0, 1.0, 1.0, 0.0, 0.0, 1.0])
    assert found.missing_share == pytest.approx(1 / 2400)
    assert found.saturated_share == pytest.approx(2 / 2400)
    assert found.signal[0, 1] == found.signal[1:].min()


def test_zeros_of_pds3_bytes_are_brightness(tmp_path: Path) -> None:
    """GDAL takes them as missing."""
    samples = scene()
    samples[5, 5] = 0
    found = opened(files.write_pds3(tmp_path / "a.img", samples))
    assert (found.weight[5, 5], found.signal[5, 5]) == (1.0, 0.0)


@pytest.mark.parametrize(
    ("statement", "missing"), [("", True), ("MISSING_CONSTANT = -9999", False)]
)
def test_the_lowest_of_16_bits_is_missing_unless_another_is(
    tmp_path: Path, statement: str, missing: bool
) -> None:
    samples = scene("int16")
    samples[5, 5:7] = -32768, -9999
    found = opened(files.write_pds3(tmp_path / "a.img", samples, image=statement))
    assert found.weight[5, 5:7].tolist() == ([0.0, 1.0] if missing else [1.0, 0.0])


# -- plateaus


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float32"])
def test_saturation_weighs_nothing(tmp_path: Path, dtype: str) -> None:
    samples = np.minimum(scene(dtype), np.array(140, dtype=dtype))
    found = opened(files.write_image(tmp_path / "a.tif", samples))
    bright = samples == 140
    assert bright.any()
    np.testing.assert_array_equal(found.weight, np.where(bright, 0.0, 1.0))
    np.testing.assert_array_equal(np.isnan(found.signal), bright)
    assert found.saturated_share == pytest.approx(bright.mean())


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float32"])
def test_clipped_shadows_count(tmp_path: Path, dtype: str) -> None:
    samples = np.maximum(scene(dtype), np.array(90, dtype=dtype))
    found = opened(files.write_image(tmp_path / "a.tif", samples))
    dark = samples == 90
    assert dark.any()
    np.testing.assert_array_equal(found.weight, 1.0)
    np.testing.assert_array_equal(found.signal, samples)
    assert (found.missing_share, found.saturated_share) == (0.0, 0.0)


def test_a_half_saturated_image(tmp_path: Path) -> None:
    samples = scene()
    samples[:, :30] = 255
    found = opened(files.write_image(tmp_path / "a.png", samples, driver="PNG"))
    assert found.saturated_share == 0.5
    assert not found.valid[:, :30].any()
    assert found.valid[:, 30:].all()


def margin(samples: np.ndarray) -> np.ndarray:
    """The image with a black margin around it and a black shadow inside."""
    framed = samples.copy()
    framed[:6] = framed[-6:] = 0
    framed[:, :6] = framed[:, -6:] = 0
    framed[20:28, 25:40] = 0
    return framed


@pytest.mark.parametrize("mask", [None, np.full(SHAPE, 255, np.uint8)])
def test_black_around_a_map_projected_image_is_missing(
    tmp_path: Path, mask: np.ndarray | None
) -> None:
    """The same for a file with an empty mask; a shadow inside the image is a shadow."""
    path = files.write_image(tmp_path / "a.tif", margin(scene()), mask=mask, **MAP)
    found = open_image(path, None, NOON)
    inside = np.zeros(SHAPE, bool)
    inside[6:-6, 6:-6] = True
    np.testing.assert_array_equal(found.weight == 0.0, ~inside)
    np.testing.assert_array_equal(found.weight[20:28, 25:40], 1.0)
    assert found.missing_share == pytest.approx((~inside).mean())


@pytest.mark.parametrize("kind", ["camera", "nodata"])
def test_black_at_the_edge_is_shadow_elsewhere(tmp_path: Path, kind: str) -> None:
    """A camera frame has no filler; a map with a declared nodata value has no other filler."""
    on_map = {} if kind == "camera" else {**MAP, "nodata": 255}
    path = files.write_image(tmp_path / "a.tif", margin(scene()), **on_map)
    found = opened(path) if kind == "camera" else open_image(path, None, NOON)
    assert found.missing_share == 0.0
    assert found.weight.all()
