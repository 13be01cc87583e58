"""Pixels of image files: samples of all types, bands, colours, palettes, display codes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers import image_files as files
from helpers.image_files import SHAPE, opened, refused, scene
from rasterio.enums import ColorInterp

from lcp_catalog.errors import ImageError
from lcp_catalog.images import pixels
from lcp_catalog.images.image_file import ImageOptions
from lcp_catalog.images.pixels import read_pixels


@pytest.mark.parametrize(
    "dtype", ["uint8", "int16", "uint16", "int32", "uint32", "float32", "float64"]
)
def test_a_geotiff_of_any_type(tmp_path: Path, dtype: str) -> None:
    samples = scene(dtype)
    found = opened(files.write_image(tmp_path / "a.tif", samples))
    np.testing.assert_array_equal(found.signal, samples.astype(np.float32))
    np.testing.assert_array_equal(found.weight, 1.0)
    assert (found.saturated_share, found.missing_share, found.name) == (0.0, 0.0, "a.tif")


@pytest.mark.parametrize("dtype", ["uint8", "uint16"])
def test_a_png(tmp_path: Path, dtype: str) -> None:
    samples = scene(dtype)
    found = opened(files.write_image(tmp_path / "a.png", samples, driver="PNG"))
    np.testing.assert_array_equal(found.signal, samples)


@pytest.mark.parametrize("dtype", ["uint8", "int16", "uint16", "float32"])
def test_a_cube_has_its_base_and_multiplier(tmp_path: Path, dtype: str) -> None:
    samples = scene(dtype)
    found = opened(files.write_cube(tmp_path / "a.cub", samples, base=-3.5, multiplier=0.25))
    np.testing.assert_allclose(found.signal, samples * 0.25 - 3.5, rtol=1e-6)


@pytest.mark.parametrize("dtype", ["uint8", "int16", "float32"])
@pytest.mark.parametrize("ending", [".img", ".IMG", ".lbl"])
def test_a_pds3_image_with_its_label_in_front(tmp_path: Path, dtype: str, ending: str) -> None:
    samples = scene(dtype)
    found = opened(files.write_pds3(tmp_path / f"a{ending}", samples))
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
    np.testing.assert_array_equal(opened(tmp_path / name).signal, samples.astype(np.float32))


def test_luminance_of_colours_is_that_of_rec_709(tmp_path: Path) -> None:
    planes = np.stack([scene(high=high) for high in (120.0, 180.0, 240.0)])
    found = opened(files.write_image(tmp_path / "a.png", planes, driver="PNG"))
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
    assert read_pixels(path).samples.dtype == dtype
    wanted = (255.0 - codes) * (1.0 if grey else 0.2126 + 0.7152)
    np.testing.assert_allclose(opened(path).signal, wanted, rtol=1e-5)


def srgb(code: float) -> float:
    """Linear value of a code of full scale 1, by IEC 61966-2-1."""
    return code / 12.92 if code <= 0.04045 else ((code + 0.055) / 1.055) ** 2.4


@pytest.mark.parametrize("dtype", ["uint8", "uint16"])
@pytest.mark.parametrize("colours", [1, 3])
def test_codes_of_a_display_are_decoded(tmp_path: Path, dtype: str, colours: int) -> None:
    """Grey images, also those stored as colours; the weights of colours apply to linear values."""
    full = np.iinfo(dtype).max
    samples = np.minimum(scene(dtype, 0.01 * full, 0.9 * full), np.array(0.6 * full, dtype=dtype))
    path = files.write_image(tmp_path / "a.png", [samples] * colours, driver="PNG")
    found = opened(path, ImageOptions(encoding="srgb"))
    bright = samples == samples.max()
    np.testing.assert_array_equal(found.weight, np.where(bright, 0.0, 1.0))
    wanted = np.vectorize(srgb)(samples / full)
    np.testing.assert_allclose(found.signal[~bright], wanted[~bright], rtol=1e-5)
    np.testing.assert_array_equal(opened(path).signal[~bright], samples[~bright])


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
    found = opened(path, ImageOptions(encoding="srgb"))
    light = [np.vectorize(srgb)(plane / 255) for plane in planes]
    wanted = 0.2126 * light[0] + 0.7152 * light[1] + 0.0722 * light[2]
    np.testing.assert_allclose(found.signal, wanted, rtol=1e-5)


def test_floats_are_no_codes_of_a_display(tmp_path: Path) -> None:
    options = ImageOptions(encoding="srgb")
    for name, bands in (
        ("a.tif", scene("float32")),
        ("b.tif", [scene("float32") * i for i in (1, 2, 3)]),
    ):
        kinds = [ColorInterp.red, ColorInterp.green, ColorInterp.blue] if name == "b.tif" else None
        path = files.write_image(tmp_path / name, bands, kinds=kinds)
        refused(
            "has float32 samples, which are not display codes: give `encoding` linear",
            path,
            files.camera_over(SHAPE),
            None,
            options,
        )
    with pytest.raises(ImageError, match="invalid encoding 'gamma'; available are linear, srgb"):
        ImageOptions(encoding="gamma")


def test_of_many_bands_the_first_or_the_one_that_is_asked_for(tmp_path: Path) -> None:
    planes = np.stack([scene("float32"), 2 * scene("float32"), 3 * scene("float32")])
    kinds = [ColorInterp.gray, ColorInterp.undefined, ColorInterp.undefined]
    path = files.write_image(tmp_path / "a.tif", planes, kinds=kinds)
    np.testing.assert_array_equal(opened(path).signal, planes[0])
    np.testing.assert_array_equal(opened(path, ImageOptions(band=3)).signal, planes[2])
    for band in (0, 4, -1):
        with pytest.raises(ImageError, match=rf"has no band {band}; its bands are 1 to 3"):
            opened(path, ImageOptions(band=band))
    cube = files.write_cube(tmp_path / "a.cub", planes)
    np.testing.assert_array_equal(opened(cube, ImageOptions(band=2)).signal, planes[1])


def test_a_band_that_is_asked_for_has_its_own_mask_and_is_no_luminance(tmp_path: Path) -> None:
    planes = np.stack([scene("float32", high=high) for high in (120.0, 180.0, 240.0)])
    planes[0, :5] = planes[2, -5:] = -1.0
    kinds = [ColorInterp.red, ColorInterp.green, ColorInterp.blue]
    path = files.write_image(tmp_path / "a.tif", planes, kinds=kinds, nodata=-1.0)
    found = opened(path, ImageOptions(band=3))
    assert not found.weight[-5:].any()
    assert found.weight[:-5].all()
    np.testing.assert_array_equal(found.signal[:-5], planes[2, :-5])


def test_images_that_are_too_large(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = files.write_image(tmp_path / "a.tif", scene())
    monkeypatch.setattr(pixels, "_MOST_PIXELS", 2400)
    opened(path)
    monkeypatch.setattr(pixels, "_MOST_PIXELS", 2399)
    refused("60 x 40 pixels, 1 bands; at most 0.002399 million", path, files.camera_over(SHAPE))


def cut(path: Path, share: float) -> Path:
    path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])
    return path


@pytest.mark.parametrize("share", [0.3, 0.9, 0.98])
@pytest.mark.parametrize("dtype", ["uint8", "uint16"])
def test_truncated_png(tmp_path: Path, dtype: str, share: float) -> None:
    """GDAL 3.10 returns the compressed bytes of an 8-bit PNG as samples, without an error."""
    path = files.write_image(tmp_path / "a.png", scene(dtype), driver="PNG")
    assert opened(path).signal.shape == SHAPE
    refused("truncated|not a readable", cut(path, share), files.camera_over(SHAPE))


@pytest.mark.parametrize("lost", [1, 60, 1200])
@pytest.mark.parametrize("kind", ["attached", "beside", "pds4"])
def test_truncated_uncompressed_files(tmp_path: Path, kind: str, lost: int) -> None:
    """The missing lines would be 0, which is shadow."""
    samples, path = scene(), tmp_path / "PHOTO.IMG"
    if kind == "pds4":
        times = "2010-01-01T00:00:00Z", "2010-01-01T00:00:01Z"
        path = files.write_pds4(tmp_path / "image.xml", samples, *times, "Moon").with_suffix(".img")
    else:
        files.write_pds3(path, samples)
    if kind == "beside":
        label = path.read_bytes()[:4096].replace(b"^IMAGE = 2", b'^IMAGE = ("PHOTO.IMG", 1)')
        (tmp_path / "PHOTO.LBL").write_bytes(
            label.replace(b"RECORD_BYTES = 4096", b"RECORD_BYTES = 60")
        )
        path.write_bytes(samples.tobytes())
    assert opened(path).signal.shape == SHAPE
    path.write_bytes(path.read_bytes()[:-lost])
    refused("is truncated", path, files.camera_over(SHAPE))
