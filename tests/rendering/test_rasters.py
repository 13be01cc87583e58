"""The GeoTIFF of a render as a cloud-optimised one: the order of its parts, its overviews and statistics."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
import rasterio

from lcp_catalog.geometry.frames import EnuFrame
from lcp_catalog.rendering import public
from lcp_catalog.rendering.public import geotiff, node_transform, orthographic_crs

ROWS, COLUMNS = 700, 600


@pytest.fixture(scope="module")
def band() -> np.ndarray:
    values = np.random.default_rng(3).normal(5.0, 1.0, (ROWS, COLUMNS)).astype(np.float32)
    values[:90, :70] = np.nan
    return values


@pytest.fixture(scope="module")
def path(band: np.ndarray, tmp_path_factory: pytest.TempPathFactory) -> Path:
    found = tmp_path_factory.mktemp("cog") / "render.tif"
    empty = np.full_like(band, np.nan)
    how = (orthographic_crs(EnuFrame(3.5, 26.0)), node_transform(-6e3, 7e3, 20.0))
    content = geotiff({"radiance": band, "empty": empty}, "float32", {"body": "MOON"}, *how)
    found.write_bytes(content)
    return found


def directories(data: bytes) -> list[tuple[int, dict[int, tuple[int, ...]]]]:
    """Place and entries of each image directory of a classic little-endian TIFF, by its specification."""
    assert data[:4] == b"II*\0"
    sizes = {1: "B", 2: "B", 3: "H", 4: "I", 12: "d"}
    found, [place] = [], struct.unpack_from("<I", data, 4)
    while place:
        [count] = struct.unpack_from("<H", data, place)
        entries = {}
        for k in range(count):
            at = place + 2 + 12 * k
            tag, kind, length = struct.unpack_from("<HHI", data, at)
            if kind not in sizes:
                continue
            form = f"<{length}{sizes[kind]}"
            if struct.calcsize(form) > 4:
                [start] = struct.unpack_from("<I", data, at + 8)
                entries[tag] = struct.unpack_from(form, data, start)
            else:
                entries[tag] = struct.unpack_from(form, data, at + 8)
        found.append((place, entries))
        [place] = struct.unpack_from("<I", data, place + 2 + 12 * count)
    return found


def test_directories_come_before_all_tiles_and_small_overviews_first(path: Path) -> None:
    width, height, tile_width, offsets = 256, 257, 322, 324
    found = directories(path.read_bytes())
    sizes = [(entries[height][0], entries[width][0]) for _, entries in found]
    assert sizes == [(ROWS, COLUMNS), (ROWS // 2, COLUMNS // 2), (ROWS // 4, COLUMNS // 4)]
    places = [place for place, _ in found]
    tiles = [[at for at in entries[offsets] if at] for _, entries in found]
    assert places == sorted(places)
    assert max(places) < min(min(own) for own in tiles)
    assert max(tiles[2]) < min(tiles[1])
    assert max(tiles[1]) < min(tiles[0])
    assert {entries[tile_width][0] for _, entries in found} == {256}


def test_gdal_says_so_and_finds_the_pixels(path: Path, band: np.ndarray) -> None:
    with rasterio.open(path) as file:
        assert file.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
        assert file.descriptions == ("radiance", "empty")
        assert file.tags()["body"] == "MOON"
        np.testing.assert_array_equal(file.read(1), band)
        assert file.transform @ (0.5, 0.5) == (-6e3, 7e3)  # a pixel's centre is its node
        says = {name: float(value) for name, value in file.tags(1).items()}
    assert says["STATISTICS_MEAN"] == pytest.approx(np.nanmean(band), rel=1e-5)
    assert says["STATISTICS_MAXIMUM"] == pytest.approx(np.nanmax(band))
    assert says["STATISTICS_VALID_PERCENT"] == pytest.approx(98.5)


def test_overviews_are_means_of_the_pixels_that_are_known(path: Path, band: np.ndarray) -> None:
    with rasterio.open(path, overview_level=0) as file:
        small = file.read(1)
    quads = band.reshape(ROWS // 2, 2, COLUMNS // 2, 2)
    expected = quads.mean(axis=(1, 3))
    np.testing.assert_allclose(small[45:, 35:], expected[45:, 35:], rtol=1e-5)
    assert np.isnan(small[:45, :35]).all()


def test_equal_bands_give_equal_bytes(band: np.ndarray) -> None:
    first, second = (geotiff({"radiance": band}, "float32", {}) for _ in range(2))
    assert first == second


def test_a_raster_without_its_statistics_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    """GDAL writes one where it has no memory for them, or for a text, and says nothing."""
    bands = {"a": np.ones((2, 2)), "nothing": np.full((2, 2), np.nan)}
    assert geotiff(bands, "float32", {"made": "here"})
    monkeypatch.setattr(public, "_STATISTICS", {"STATISTICS_LOST"})
    with pytest.raises(MemoryError):
        geotiff(bands, "float32", {})


def test_a_raster_that_gdal_cannot_make_lacks_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    """GDAL's own error of a copy into a file system that it does not have."""
    copy = public.shutil.copy
    monkeypatch.setattr(public.shutil, "copy", lambda a, b, **how: copy(a, "/vsinone/a.tif", **how))
    with pytest.raises(MemoryError):
        geotiff({"a": np.ones((2, 2))}, "float32", {})
