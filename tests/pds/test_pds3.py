"""PDS3 labels: content of the archive's labels, and known errors in them."""

from __future__ import annotations

import logging
import shutil
from pathlib import Path

import numpy as np
import pytest
from helpers.products import cut, label_text

from lcp_catalog.errors import LabelError
from lcp_catalog.pds.label import Label
from lcp_catalog.pds.label_files import find_image, find_label
from lcp_catalog.pds.pds3 import parse_pds3, read_pds3


def read(text: str) -> Label:
    return parse_pds3(text, Path("folder/X.LBL"))


@pytest.mark.parametrize(
    ("name", "pixel_m", "scale_m", "dtype", "size"),
    [
        # 2 pi 1737400 / 360 / (pixels a degree); scale from UNIT and SCALING_FACTOR of the texts
        ("LDEM_16", 1895.2094015, 0.5, "<i2", (2880, 5760)),
        ("LDEM_128", 236.90117519, 0.5, "<i2", (23040, 46080)),
        ("SLDEM2015_512_00N_30N_000_045_FLOAT", 59.225293797, 1000.0, "<f4", (15360, 23040)),
        ("SLDEM2015_128_60S_60N_000_360_FLOAT", 236.90117519, 1000.0, "<f4", (15360, 46080)),
        ("LDEM_80S_20M", 20.0, 0.5, "<i2", (30400, 30400)),
        ("LDEM_875S_5M", 5.0, 0.5, "<i2", (30336, 30336)),
        ("WAC_GLD100_E000N1800_016P_attached", 1895.2094015, 1.0, "<i2", (2880, 5760)),
        ("WAC_GLD100_E300N0450_256P_from_readme", 118.45058759, 1.0, "<i2", (15360, 23040)),
        ("NAC_DTM_APOLLO11", 2.0, 1.0, "<f4", (13978, 2111)),
    ],
)
def test_exact_texts(
    name: str, pixel_m: float, scale_m: float, dtype: str, size: tuple[int, int]
) -> None:
    label = read(label_text(name))
    assert label.pixel_m == pytest.approx(pixel_m, rel=1e-10)
    assert label.height_scale_m == scale_m
    assert label.sample_dtype == dtype
    assert (label.lines, label.line_samples) == size


def test_polar_labels_keep_their_exact_map_scale() -> None:
    label = read(label_text("LDEM_80S_20M"))  # MAP_RESOLUTION = 1516.17 would give 19.99997 m
    assert (label.projection, label.pixel_m, label.center_lat_deg) == (
        "polar-stereographic",
        20.0,
        -90.0,
    )
    assert label.product_id == "LDEM_80S_20M"  # the label has no PRODUCT_ID


def test_jp2_label_takes_the_compressed_file(ldem_4: Path) -> None:
    label = read_pds3(ldem_4 / "LDEM_4_JP2.LBL")  # holds COMPRESSED_FILE and UNCOMPRESSED_FILE
    assert label.image_name == "LDEM_4.JP2"
    assert label.compressed
    assert label.height_scale_m == 0.5
    assert label.center_lon_deg == 0.0  # its .IMG brother lies on a grid around 180 deg


def test_a_jp2_label_without_scale_means_half_metres_and_says_so(
    caplog: pytest.LogCaptureFixture,
) -> None:
    label = read(label_text("SLDEM2015_512_00N_30N_000_045_JP2"))
    assert label.height_scale_m == 0.5
    assert "0.5 m are assumed" in caplog.text


@pytest.mark.parametrize(
    ("constant", "missing"),
    [("", ()), ("'N/A'", ()), ('"UNK"', ()), ("-32768", (-32768.0,)), ("16#8000#", (-32768.0,))],
)
def test_missing_constant_is_what_the_label_says_and_nothing_else(
    constant: str, missing: tuple[float, ...]
) -> None:
    text = label_text("LDEM_16")
    if constant:
        text = text.replace("    UNIT  ", f"    MISSING_CONSTANT = {constant}\r\n    UNIT  ")
    assert read(text).missing == missing


def test_missing_constant_by_the_bits_of_a_float() -> None:
    text = label_text("SLDEM2015_512_00N_30N_000_045_FLOAT")
    text = text.replace("    UNIT  ", "    MISSING_CONSTANT = 16#FF7FFFFB#\r\n    UNIT  ")
    assert read(text).missing == (float(np.frombuffer(b"\xff\x7f\xff\xfb", ">f4")[0]),)


def test_isis_special_pixels_are_missing() -> None:
    assert set(read(label_text("WAC_GLD100_E000N1800_016P_attached")).missing) == set(
        range(-32768, -32763)
    )


def test_rounded_map_scale_is_rebuilt_and_said(caplog: pytest.LogCaptureFixture) -> None:
    text = cut(
        label_text("SLDEM2015_512_00N_30N_000_045_FLOAT"), MAP_SCALE="0.059225"
    )  # 5e-6: 0.11 pixel at the far edge
    with caplog.at_level(logging.WARNING):
        assert read(text).pixel_m == pytest.approx(59.225293797, rel=1e-10)
    assert "MAP_SCALE" in caplog.text


def test_a_harmlessly_rounded_map_scale_is_not_worth_a_word(
    caplog: pytest.LogCaptureFixture, ldem_4: Path
) -> None:
    read_pds3(ldem_4 / "LDEM_4.LBL")  # 7580.84 for 7580.8376: 0.0005 pixel
    assert not caplog.records


@pytest.mark.parametrize("scale", ["1895.21", "1.89521"])
def test_map_scale_without_a_unit_is_decided_by_the_resolution(scale: str) -> None:
    text = cut(label_text("LDEM_16"), MAP_SCALE=scale).replace(f"{scale} <m/pix>", scale)
    assert "<m/pix>" not in text
    assert read(text).pixel_m == pytest.approx(1895.2094015, rel=1e-9)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"A_AXIS_RADIUS": "1738.0"}, "1738000 m"),
        ({"OFFSET": "3396000."}, "OFFSET is 3396000 m"),
        ({"MAP_PROJECTION_ROTATION": "90.0"}, "rotated by 90 deg"),
        ({"MAP_PROJECTION_TYPE": '"SINUSOIDAL"'}, "SINUSOIDAL is not supported"),
        ({"TARGET_NAME": "MARS"}, "target is MARS"),
        ({"POSITIVE_LONGITUDE_DIRECTION": '"WEST"'}, "west-positive longitudes"),
        ({"MAP_SCALE": "2000"}, "one of them is wrong"),
        ({"SAMPLE_BITS": "8"}, "8 bits are not supported"),
        ({"UNIT": "FATHOM"}, "FATHOM"),
        ({"LINE_PROJECTION_OFFSET": "-1439.5"}, "MAXIMUM_LATITUDE"),
        ({"SAMPLE_PROJECTION_OFFSET": "-2879.5"}, "WESTERNMOST_LONGITUDE at 0"),
        ({"CENTER_LONGITUDE": "'N/A'"}, "CENTER_LONGITUDE"),
        ({"LINES": "0"}, "pixels"),
    ],
)
def test_refusals(change: dict[str, str], says: str) -> None:
    text = label_text("LDEM_16")
    if change == {"SAMPLE_PROJECTION_OFFSET": "-2879.5"}:
        change = {"SAMPLE_PROJECTION_OFFSET": "-1439.5"}
    with pytest.raises(LabelError, match=says) as caught:
        read(cut(text, **change))
    assert str(caught.value).startswith("folder/X.LBL: ")
    assert "\n" not in str(caught.value)


def test_oblique_maps_are_refused() -> None:
    text = label_text("LDEM_16")
    oblique = text.replace(
        " MAP_PROJECTION_ROTATION",
        " OBLIQUE_PROJ_POLE_LATITUDE = 40.0 <deg>\r\n MAP_PROJECTION_ROTATION",
    )
    with pytest.raises(LabelError, match="oblique"):
        read(oblique)
    with pytest.raises(LabelError, match="oblique stereographic"):
        read(cut(label_text("LDEM_80S_20M"), CENTER_LATITUDE="-60"))


def test_an_image_without_a_map_is_refused() -> None:
    with pytest.raises(LabelError, match="IMAGE_MAP_PROJECTION"):
        read(label_text("NAC_EDR_M103595705LE"))


class TestFinding:
    def test_each_image_has_its_own_label(self, ldem_4: Path) -> None:
        assert find_label(ldem_4 / "LDEM_4.IMG").name == "LDEM_4.LBL"
        assert find_label(ldem_4 / "LDEM_4.JP2").name == "LDEM_4_JP2.LBL"
        assert find_image(read_pds3(ldem_4 / "LDEM_4_JP2.LBL")).name == "LDEM_4.JP2"

    def test_the_img_label_is_not_taken_for_a_jp2(self, ldem_4: Path, tmp_path: Path) -> None:
        for name in ("LDEM_4.JP2", "LDEM_4.LBL"):
            shutil.copy(ldem_4 / name, tmp_path)
        with pytest.raises(LabelError, match=r"LDEM_4_JP2\.LBL is missing"):
            find_label(tmp_path / "LDEM_4.JP2")

    def test_lower_case_names(self, ldem_4: Path, tmp_path: Path) -> None:
        shutil.copy(ldem_4 / "LDEM_4.LBL", tmp_path / "ldem_4.lbl")
        shutil.copy(ldem_4 / "LDEM_4.IMG", tmp_path / "ldem_4.img")
        assert find_label(tmp_path / "ldem_4.img").name == "ldem_4.lbl"
        assert find_image(read_pds3(tmp_path / "ldem_4.lbl")).name == "ldem_4.img"

    def test_a_missing_partner_is_named(self, ldem_4: Path, tmp_path: Path) -> None:
        shutil.copy(ldem_4 / "LDEM_4.LBL", tmp_path)
        with pytest.raises(LabelError, match=r"LDEM_4\.IMG, is not beside it"):
            find_image(read_pds3(tmp_path / "LDEM_4.LBL"))
        (tmp_path / "LDEM_4.LBL").rename(tmp_path / "OTHER.LBL")
        (tmp_path / "LDEM_4.IMG").write_bytes(b"\0" * 16)
        with pytest.raises(LabelError, match=r"LDEM_4\.LBL is missing"):
            find_label(tmp_path / "LDEM_4.IMG")
