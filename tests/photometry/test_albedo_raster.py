"""Pixels of albedo maps: missing values, scales, encodings, and files that are refused."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
import rasterio.warp
from helpers.products import DEGREE_M, EQC, geotiff
from hypothesis import given
from hypothesis import strategies as st
from rasterio.enums import ColorInterp

from lcp_catalog.errors import AlbedoError
from lcp_catalog.photometry.albedo_map import AlbedoMap, neutral
from lcp_catalog.photometry.srgb import decode_srgb


class TestMissing:
    def test_nodata_is_missing(self, tmp_path: Path) -> None:
        values = np.full((40, 40), 500, np.int16)
        values[10:20, 10:20] = -32768
        path = geotiff(tmp_path / "m.tif", values, 0, 20 * DEGREE_M, DEGREE_M / 2, nodata=-32768)
        found = AlbedoMap.open(path)
        assert found.reference == 500.0
        assert np.isnan(found.at(7.5, 12.5, 100.0))
        assert found.at([2.5, 4.9, 10.1], 12.5, 100.0).tolist() == [1.0, 1.0, 1.0]
        assert np.isnan(found.at([-0.1, 5.0, 5.0], [5.0, 20.1, -0.1], 100.0)).all()
        assert neutral(found.at([2.5, 7.5], 12.5, 100.0)).tolist() == [1.0, 1.0]

    def test_an_alpha_band_marks_missing_pixels(self, tmp_path: Path) -> None:
        path = tmp_path / "alpha.tif"
        kind = {"driver": "GTiff", "height": 20, "width": 20, "count": 2, "dtype": "uint16"}
        where = rasterio.transform.from_origin(0, 20 * DEGREE_M, DEGREE_M, DEGREE_M)
        with rasterio.open(path, "w", **kind, crs=EQC, transform=where) as file:
            alpha = np.full((20, 20), 65535, np.uint16)
            alpha[:, :10] = 0
            file.write(np.where(alpha > 0, 8, 40000).astype(np.uint16), 1)
            file.write(alpha, 2)
            file.colorinterp = (ColorInterp.gray, ColorInterp.alpha)
        found = AlbedoMap.open(path)
        assert found.reference == 8.0
        assert np.isnan(found.at(5.0, 5.0, 100.0))
        assert found.at(15.0, 5.0, 100.0) == 1.0

    def test_scale_and_offset_are_the_files(self, tmp_path: Path) -> None:
        values = np.array([[10, 30], [10, 30]], np.int16)
        path = geotiff(tmp_path / "m.tif", values, 0, DEGREE_M, DEGREE_M, scale=0.01, offset=0.1)
        assert AlbedoMap.open(path, reference=0.1).at([0.5, 1.5], 0.5, 1.0) == pytest.approx([2, 4])

    def test_no_factor_is_negative(self, tmp_path: Path) -> None:
        """Cubic convolution dips below 0 beside bright terrain."""
        values = np.zeros((20, 20))
        values[:, 10] = 1.0
        path = geotiff(tmp_path / "m.tif", values, 0, 20 * DEGREE_M, DEGREE_M)
        lon = np.linspace(1.0, 19.0, 400)
        assert AlbedoMap.open(path).at(lon, 10.0, 100.0).min() == 0.0

    def test_cached_means_depend_on_the_decoding(self, tmp_path: Path) -> None:
        """Block means are cached by file, encoding and reference."""
        codes = np.full((360, 720), 128, np.uint8)
        path = geotiff(tmp_path / "m.tif", codes, -180 * DEGREE_M, 90 * DEGREE_M, DEGREE_M / 2)
        asked = (("linear", 128.0), ("srgb", 128.0), ("linear", 64.0), ("srgb", 0.2158605))
        got = [float(AlbedoMap.open(path, e, r).at(0.5, 0.5, 4 * DEGREE_M)) for e, r in asked]
        assert got == pytest.approx([1.0, 0.2158605 / 128.0, 2.0, 1.0], rel=1e-6)


class TestEncoding:
    @pytest.mark.parametrize(
        ("code", "linear"),
        [  # IEC 61966-2-1:1999: 8-bit codes, rounded to 7 figures
            (0, 0.0),
            (1, 0.0003035270),
            (10, 0.003035270),
            (11, 0.003346536),
            (128, 0.2158605),
            (188, 0.5028865),
            (255, 1.0),
        ],
    )
    def test_codes_of_the_standard(self, code: int, linear: float) -> None:
        assert decode_srgb(np.array([code / 255.0]))[0] == pytest.approx(linear, rel=2e-7)

    @given(st.floats(0.0, 1.0))
    def test_it_undoes_the_standards_encoding(self, light: float) -> None:
        code = 12.92 * light if light <= 0.0031308 else 1.055 * light ** (1.0 / 2.4) - 0.055
        assert decode_srgb(np.array([code]))[0] == pytest.approx(light, rel=1e-6, abs=1e-9)

    @pytest.mark.parametrize(("kind", "full"), [("uint8", 255), ("uint16", 65535), ("float32", 1)])
    def test_light_is_averaged_not_codes(self, tmp_path: Path, kind: str, full: int) -> None:
        """A chequerboard of black and white is half as bright as white, whatever the mean of its
        codes.
        """
        board = np.add.outer(np.arange(360), np.arange(720)) % 2 * full
        path = geotiff(tmp_path / "m.tif", board.astype(kind), -180 * DEGREE_M, 90 * DEGREE_M, DEGREE_M / 2)  # fmt: skip
        found = AlbedoMap.open(path, "srgb", reference=1.0)
        assert found.at(1.0, 1.0, 6 * DEGREE_M) == pytest.approx(0.5, abs=1e-6)
        assert found.encoding == "srgb"
        assert AlbedoMap.open(path, "srgb").reference == pytest.approx(0.5, abs=1e-12)

    @pytest.mark.parametrize(
        ("kind", "encoding", "scale", "warned"),
        [
            ("uint8", None, 1.0, True),
            ("uint8", "linear", 1.0, False),
            ("uint8", "srgb", 1.0, False),
            ("uint8", None, 0.002, False),
            ("uint16", None, 1.0, False),
        ],
    )
    def test_a_warning_for_8_bit_samples_read_as_linear(
        self,
        tmp_path: Path,
        caplog: pytest.LogCaptureFixture,
        kind: str,
        encoding: str | None,
        scale: float,
        warned: bool,
    ) -> None:
        path = geotiff(tmp_path / "m.tif", np.full((9, 9), 90, kind), 0, 9e4, 1e4, scale=scale)
        with caplog.at_level(logging.WARNING):
            assert AlbedoMap.open(path, encoding).encoding == (encoding or "linear")
        assert ("`albedo_encoding` srgb" in caplog.text) == warned


def _plain(path: Path, values: np.ndarray, **more: Any) -> Path:
    return geotiff(path, values, 0, 9e4, 1e4, **more)


def _colours(path: Path, count: int, palette: bool = False) -> Path:
    kind = {"driver": "GTiff", "height": 9, "width": 9, "count": count, "dtype": "uint8"}
    where = rasterio.transform.from_origin(0, 9e4, 1e4, 1e4)
    with rasterio.open(path, "w", **kind, crs=EQC, transform=where) as file:
        file.write(np.full((count, 9, 9), 7, np.uint8))
        if palette:
            file.write_colormap(1, {7: (1, 2, 3, 255)})
    return path


ONES = np.ones((9, 9))
REFUSED: dict[str, tuple[Callable[[Path], Path], dict[str, Any], str]] = {
    "nothing there": (lambda p: p, {}, "no such file"),
    "a folder": (lambda p: p.mkdir() or p, {}, "is a folder, not an albedo map"),
    "text": (lambda p: p.write_text("hello") and p, {}, "not an albedo map that can be read"),
    "heights": (lambda p: _plain(p, ONES * -2300.0), {}, "has the value -2300.*this is a DEM"),
    "undeclared missing": (lambda p: _plain(p, ONES * -3.4e38), {}, "a_nodata"),
    "a DEM by its unit": (lambda p: _metres(_plain(p, ONES)), {}, "contains heights"),
    "a DEM by its name": (
        lambda p: _plain(p.with_name("LDEM_64.tif"), ONES),
        {},
        "contains heights",
    ),
    "a LOLA product by its offset": (
        lambda p: _plain(p, ONES, offset=1737400.0),
        {},
        "contains heights",
    ),
    "black": (lambda p: _plain(p, ONES * 0.0), {}, "every value is 0"),
    "empty": (lambda p: _plain(p, ONES, nodata=1.0), {}, "every pixel is missing"),
    "colours": (lambda p: _colours(p, 3), {}, r"colour image \(red, green, blue\).*-b 1"),
    "a palette": (lambda p: _colours(p, 1, True), {}, r"colour image \(palette\).*-expand gray"),
    "no map": (lambda p: _plain(p, ONES, crs=None), {}, "no map projection"),
    "Mars": (lambda p: _plain(p, ONES, crs="+proj=eqc +R=3396190"), {}, "not the Moon's"),
    "a sinusoid": (lambda p: _plain(p, ONES, crs="+proj=sinu +R=1737400"), {}, "not supported"),
    "codes over 1": (lambda p: _plain(p, ONES * 1.5), {"encoding": "srgb"}, "end at 1; use"),
    "scaled codes": (lambda p: _plain(p, ONES, scale=2.0), {"encoding": "srgb"}, "scale and an"),
    "another encoding": (lambda p: _plain(p, ONES), {"encoding": "gamma"}, "linear, srgb"),
    "no reference": (lambda p: _plain(p, ONES), {"reference": 0.0}, "must be above 0"),
}


def _metres(path: Path) -> Path:
    with rasterio.open(path, "r+") as file:
        file.units = ("metre",)
    return path


@pytest.mark.parametrize("case", REFUSED)
def test_invalid_albedo_maps_are_refused_in_one_line(tmp_path: Path, case: str) -> None:
    make, how, says = REFUSED[case]
    path = make(tmp_path / "map.tif")
    with pytest.raises(AlbedoError, match=says) as found:
        AlbedoMap.open(path, **how)
    assert "\n" not in str(found.value)
    if case not in ("another encoding", "no reference"):
        assert str(path) in str(found.value)


def test_the_first_of_several_bands_with_a_warning(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    kind = {"driver": "GTiff", "height": 9, "width": 9, "count": 7, "dtype": "float32"}
    where = rasterio.transform.from_origin(0, 9e4, 1e4, 1e4)
    with rasterio.open(tmp_path / "wac.tif", "w", **kind, crs=EQC, transform=where) as file:
        file.write(np.arange(1, 8, dtype=np.float32)[:, None, None] * np.ones((7, 9, 9), "f4"))
    assert AlbedoMap.open(tmp_path / "wac.tif").reference == 1.0
    assert "has 7 bands; the first is used" in caplog.text
