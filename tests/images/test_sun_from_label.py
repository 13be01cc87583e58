"""The Sun of an image from its label: tables of cubes with a known Sun and rotation; real labels,
compared with NAIF's kernels.
"""

from __future__ import annotations

import json
import logging
import math
from pathlib import Path

import numpy as np
import pytest
from helpers import image_files as files

from lcp_catalog.ephemeris.solar_position import sun_direction_at
from lcp_catalog.errors import ImageError
from lcp_catalog.geometry.frames import lonlat_to_mcmf, mcmf_to_lonlat
from lcp_catalog.images.image_file import ImageLabel, read_image_label
from lcp_catalog.images.pixels import read_pixels

SAMPLES = np.arange(600, dtype=np.float32).reshape(20, 30)
INSTRUMENT = """Group = Instrument
  TargetName = {target}
  StartTime = {start}
  StopTime = {stop}
End_Group
"""


def label_of(path: Path) -> ImageLabel:
    return read_image_label(read_pixels(path))


def apart_deg(a: np.ndarray, b: np.ndarray) -> float:
    return math.degrees(math.atan2(np.linalg.norm(np.cross(a, b)), float(a @ b)))


def quaternion(axis: np.ndarray, angle: float) -> np.ndarray:
    """Scalar first, of the matrix that turns coordinates from J2000 to the frame (NAIF's m2q)."""
    return np.array([math.cos(angle / 2), *(math.sin(angle / 2) * axis)])


def rodrigues(axis: np.ndarray, angle: float) -> np.ndarray:
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross


def tables(
    j2000_km: np.ndarray, turns: list[np.ndarray], constant: np.ndarray | None = None
) -> list[files.Table]:
    sun = dict(zip(("J2000X", "J2000Y", "J2000Z"), ([v, v] for v in j2000_km), strict=True))
    rotation = {f"J2000Q{i}": [turn[i] for turn in turns] for i in range(4)}
    extra = ""
    if constant is not None:
        extra = f"  ConstantRotation = ({', '.join(map(repr, constant.ravel().tolist()))})\n"
    return [
        files.Table("SunPosition", {**sun, "J2000XV": [0, 0], "ET": [0, 1]}),
        files.Table("BodyRotation", {**rotation, "AV1": [0] * len(turns), "ET": range(len(turns))}, extra),
    ]  # fmt: skip


# -- cubes


def test_the_sun_in_a_cubes_tables(tmp_path: Path) -> None:
    """Body-fixed = constant rotation x rotation of the quaternion x J2000."""
    axis = np.array([0.36, -0.48, 0.8])
    constant = rodrigues(np.array([0.0, 0.6, 0.8]), 0.4)
    j2000 = 1.49e8 * np.array([0.6, -0.64, 0.48])
    path = files.write_cube(
        tmp_path / "a.cub", SAMPLES, tables=tables(j2000, [quaternion(axis, 2.2)], constant)
    )
    found = label_of(path)
    wanted = 1e3 * constant @ rodrigues(axis, 2.2) @ j2000
    np.testing.assert_allclose(found.sun_position_mcmf_m, wanted, rtol=1e-12)
    np.testing.assert_allclose(found.direction(), wanted / np.linalg.norm(wanted), rtol=1e-12)
    assert found.source == "the label's SunPosition table"


def test_a_cubes_sun_is_that_of_the_middle_of_its_exposure(tmp_path: Path) -> None:
    axis = np.array([0.0, 0.0, 1.0])
    turns = [quaternion(axis, 1.0 + step) for step in (-1e-4, 1e-4)]
    path = files.write_cube(
        tmp_path / "a.cub", SAMPLES, tables=tables(np.array([1.5e8, 0, 0]), turns)
    )
    middle = 1.5e11 * np.array([math.cos(1.0), math.sin(1.0), 0.0])
    np.testing.assert_allclose(label_of(path).sun_position_mcmf_m, middle, atol=1.5e11 * 1e-8)


@pytest.mark.parametrize("damage", ["cut short", "not a number", "too near"])
def test_damaged_tables_are_ignored(
    tmp_path: Path, damage: str, caplog: pytest.LogCaptureFixture
) -> None:
    sun = np.array([1.5e8, 0, 0]) * {"too near": 1e-3}.get(damage, 1.0)
    turn = quaternion(np.array([0, 0, 1.0]), math.nan if damage == "not a number" else 0.1)
    groups = INSTRUMENT.format(
        target="Moon", start="2010-11-09T13:06:40", stop="2010-11-09T13:06:42"
    )
    path = files.write_cube(tmp_path / "a.cub", SAMPLES, groups=groups, tables=tables(sun, [turn]))
    if damage == "cut short":
        path.write_bytes(path.read_bytes()[:-20])
    with caplog.at_level(logging.WARNING):
        found = label_of(path)
    assert found.sun_position_mcmf_m is None
    assert found.time_utc == "2010-11-09T13:06:41Z"
    assert found.source == "the label's time"
    assert "the Sun in its tables" in caplog.text


def test_a_cubes_time_and_no_tables(tmp_path: Path) -> None:
    groups = INSTRUMENT.format(
        target="MOON", start="1971-07-31T01:25:52.6", stop="1971-07-31T01:25:53.0"
    )
    found = label_of(files.write_cube(tmp_path / "a.cub", SAMPLES, groups=groups))
    assert found.time_utc == "1971-07-31T01:25:52.800000Z"
    np.testing.assert_array_equal(found.direction(), sun_direction_at("1971-07-31T01:25:52.8"))


def test_a_subsolar_point_in_a_cubes_label(tmp_path: Path) -> None:
    groups = (
        "Group = Geometry\n  SubSolarLatitude = -1.2 <deg>\n  SubSolarLongitude = 143.6\nEnd_Group"
    )
    found = label_of(files.write_cube(tmp_path / "a.cub", SAMPLES, groups=groups))
    wanted = lonlat_to_mcmf(143.6, -1.2)
    np.testing.assert_allclose(found.direction(), wanted / np.linalg.norm(wanted), rtol=1e-12)


# -- PDS3, PDS4, renders


@pytest.mark.parametrize(("start", "stop", "wanted"), [
    ("2009-07-30T12:20:38.185", "2009-07-30T12:21:32.155", "2009-07-30T12:21:05.170000Z"),
    ("2009-211T12:20:38", "2009-211T12:20:40", "2009-07-30T12:20:39Z"),
    ("2008-366T23:59:58Z", "2009-001T00:00:02Z", "2009-01-01T00:00:00Z"),
    ("2009-07-30T12:20:38", '"N/A"', "2009-07-30T12:20:38Z"),
    ('"UNK"', "2009-07-30T12:20:38", "2009-07-30T12:20:38Z"),
    ('"N/A"', '"N/A"', None),
    ("2009-07-13T17:33:17", "2016-11-29T05:48:19", None),  # a mosaic
    ("2009-07-30T10:00:00", "2009-07-30T12:00:00", "2009-07-30T11:00:00Z"),  # the longest span
    ("2009-07-30T10:00:00", "2009-07-30T12:00:01", None),
    ("yesterday", "2009-07-30T10:00:00", None),
    ("2009-02-30T10:00:00", '"N/A"', None),
])  # fmt: skip
def test_times_of_pds3_labels(tmp_path: Path, start: str, stop: str, wanted: str | None) -> None:
    text = f"START_TIME = {start}\nSTOP_TIME = {stop}\nTARGET_NAME = MOON"
    found = label_of(files.write_pds3(tmp_path / "a.img", SAMPLES.astype(np.uint8), text))
    assert found.time_utc == wanted
    assert found.source == ("the label's time" if wanted else "")
    assert (found.direction() is None) == (wanted is None)


def test_a_subsolar_point_goes_before_a_time(tmp_path: Path) -> None:
    text = "SUB_SOLAR_LATITUDE = 0.5 <DEG>\nSUB_SOLAR_LONGITUDE = -20.0 <DEG>\nSTART_TIME = 2009-07-30T12:20:38"
    found = label_of(files.write_pds3(tmp_path / "a.img", SAMPLES.astype(np.uint8), text))
    lon, lat, _ = mcmf_to_lonlat(found.direction())
    assert (lon, lat) == (pytest.approx(340.0), pytest.approx(0.5))
    assert found.time_utc == "2009-07-30T12:20:38Z"
    assert found.source == "the label's subsolar point"


def test_an_impossible_subsolar_point_is_left_aside(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    text = "SUB_SOLAR_LATITUDE = 95\nSUB_SOLAR_LONGITUDE = 1"
    found = label_of(files.write_pds3(tmp_path / "a.img", SAMPLES.astype(np.uint8), text))
    assert found.direction() is None
    assert "subsolar point is ignored" in caplog.text


@pytest.mark.parametrize("ending", [".xml", ".img"])
@pytest.mark.parametrize("target", ["Moon", "${TARGET}"])
def test_times_of_pds4_labels(tmp_path: Path, ending: str, target: str) -> None:
    times = "2009-07-19T00:00:26.423000Z", "2009-07-19T00:01:17.707000Z"  # of M102600893LE
    image = read_pixels(files.write_pds4(tmp_path / f"a{ending}", SAMPLES, *times, target))
    np.testing.assert_array_equal(image.samples, SAMPLES)
    assert read_image_label(image).time_utc == "2009-07-19T00:00:52.065000Z"


def test_a_damaged_pds4_label_is_no_image(tmp_path: Path) -> None:
    path = files.write_pds4(tmp_path / "a.xml", SAMPLES, "N/A", "N/A", "Moon")
    path.write_text(path.read_text()[:900])
    with pytest.raises(ImageError, match="not an image that can be read here"):
        read_pixels(path)


def test_a_label_beside_the_image(tmp_path: Path) -> None:
    image = files.write_image(tmp_path / "ORTHO.TIF", SAMPLES)
    (tmp_path / "ORTHO.LBL").write_text(
        "PDS_VERSION_ID = PDS3\nSTART_TIME = 2009-07-30T12:20:38\nEND\n"
    )
    assert label_of(image).time_utc == "2009-07-30T12:20:38Z"


def test_tags_of_a_render(tmp_path: Path) -> None:
    tags = {"sun_direction_mcmf": json.dumps([0.6, 0.0, 0.8])}
    found = label_of(files.write_image(tmp_path / "a.tif", SAMPLES, tags=tags))
    np.testing.assert_allclose(found.direction(), [0.6, 0.0, 0.8])
    assert found.source == "the render's tags"


@pytest.mark.parametrize(
    "text", ["[1, 2]", "[0, 0, 0]", "[0, 0, 2]", "north", "{}", '["a", 1, 2]', "[NaN, 0, 1]"]
)
def test_tags_that_are_no_direction_are_left_aside(tmp_path: Path, text: str) -> None:
    path = files.write_image(tmp_path / "a.tif", SAMPLES, tags={"sun_direction_mcmf": text})
    assert label_of(path).direction() is None


def test_an_image_without_a_label_has_no_sun(tmp_path: Path) -> None:
    found = label_of(files.write_image(tmp_path / "a.png", SAMPLES.astype(np.uint8), driver="PNG"))
    assert (found.source, found.time_utc, found.direction()) == ("", None, None)


@pytest.mark.parametrize("kind", ["cube", "pds3", "pds4"])
def test_an_image_of_another_body_is_refused(tmp_path: Path, kind: str) -> None:
    if kind == "cube":
        groups = INSTRUMENT.format(target="Mars", start="Null", stop="Null")
        path = files.write_cube(tmp_path / "a.cub", SAMPLES, groups=groups)
    elif kind == "pds4":
        path = files.write_pds4(tmp_path / "a.img", SAMPLES, "N/A", "N/A", "Mars")
    else:
        path = files.write_pds3(
            tmp_path / "a.img", SAMPLES.astype(np.uint8), 'TARGET_NAME = "MARS"'
        )
    with pytest.raises(ImageError, match=r"names MARS, not the Moon"):
        label_of(path)


# -- real labels


# file: the middle of its START_TIME and STOP_TIME, by hand
REAL = {
    "NAC_EDR_M103595705LE.LBL": "2009-07-30T12:21:05.170000Z",
    "NAC_EDR_M114145549LE_attached.LBL": "2009-11-29T14:51:30.783500Z",
    "WAC_EDR_wac0000a1c4_attached.LBL": "2009-09-15T07:29:04.386000Z",
    "KAGUYA_TC1S2B0_01_06691S820E0465.LBL": "2009-04-05T20:10:08.739554Z",
}


@pytest.mark.parametrize("name", REAL)
def test_times_of_real_labels(tmp_path: Path, shared_data: Path, name: str) -> None:
    label = shared_data / "labels" / name
    image = files.write_image(tmp_path / (label.stem + ".tif"), SAMPLES)
    (tmp_path / (label.stem + ".LBL")).write_bytes(label.read_bytes())
    assert label_of(image).time_utc == REAL[name]


@pytest.mark.parametrize("name", ["LDEM_128.LBL", "WAC_GLD100_E000N1800_016P_attached.LBL"])
def test_real_mosaics_have_no_sun(tmp_path: Path, shared_data: Path, name: str) -> None:
    label = shared_data / "labels" / name
    image = files.write_image(tmp_path / (label.stem + ".tif"), SAMPLES)
    (tmp_path / (label.stem + ".LBL")).write_bytes(label.read_bytes())
    assert label_of(image).direction() is None


def test_the_sun_of_the_nac_cube(shared_data: Path) -> None:
    """By its tables the subsolar point agrees with an independent evaluation of the same tables
    (middle line of the image), and within 0.003 deg with the product's own Sun at the middle of the
    whole strip.
    """
    folder = shared_data / "images" / "nac-m143947267l-spice"
    found = label_of(folder / "M143947267L.cal.echo.crop.cub")
    lat, lon = json.loads((folder / "geometry_computed.json").read_text())["C"]["subsolar"]
    wanted = lonlat_to_mcmf(lon, lat) / np.linalg.norm(lonlat_to_mcmf(lon, lat))
    assert apart_deg(found.direction(), wanted) < 1e-4
    assert found.time_utc == "2010-11-09T13:06:49.882500Z"
    assert apart_deg(found.direction(), sun_direction_at(found.time_utc)) < 0.003


def test_the_sun_of_the_apollo_cube(shared_data: Path) -> None:
    """The position agrees with the frame's camera file, from the same mission's tables, to 200 km
    in 150 million km.
    """
    folder = shared_data / "images" / "apollo15-metric-farside"
    found = label_of(folder / "AS15-M-0299_crop.cub")
    given = json.loads((folder / "AS15-M-0299_camera.json").read_text())["sun_position_mcmf_m"]
    np.testing.assert_allclose(found.sun_position_mcmf_m, given, atol=2e5)
    assert apart_deg(found.direction(), sun_direction_at(found.time_utc)) < 0.005


def test_the_sun_of_the_pit(shared_data: Path) -> None:
    """By its time the direction of the Sun is that of NAIF's kernels."""
    path = shared_data / "images" / "nac-tranqpit1-pair" / "sun_geometry_computed.json"
    given = json.loads(path.read_text())
    lon, lat, _ = mcmf_to_lonlat(ImageLabel(time_utc=given["utc"]).direction())
    assert lon == pytest.approx(given["subsolar_lon"], abs=0.005)
    assert lat == pytest.approx(given["subsolar_lat"], abs=0.005)
