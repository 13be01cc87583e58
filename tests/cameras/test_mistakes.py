"""Wrong camera files: each mistake is made in a good file, and named when it is read."""

import json
import math
import re

import numpy as np
import pytest
from helpers.renders import camera_file

from lcp_catalog.cameras.camera_file import read_sensor
from lcp_catalog.cameras.frame_camera import camera_from_json
from lcp_catalog.cameras.mistakes import likely_mistake
from lcp_catalog.ephemeris.solar_position import sun_direction_at
from lcp_catalog.errors import CameraError
from lcp_catalog.geometry.frames import EnuFrame

DOWN = np.diag([1.0, -1.0, -1.0])


def good_file(path, lon, lat, height_m):
    frame = EnuFrame(lon, lat)
    changes = {
        "position_mcmf_m": frame.to_mcmf([0.0, 0.0, height_m]).tolist(),
        "rotation_mcmf_to_camera": (DOWN @ frame.rotation).tolist(),
    }
    camera_file(path, **changes)
    return json.loads(path.read_text())


def spoilt(document, how, lon, lat):
    """The document after a mistake; sines and cosines of degrees taken as radians, by hand."""
    position = np.array(document["position_mcmf_m"])
    rotation = np.array(document["rotation_mcmf_to_camera"])
    up = np.array([math.cos(lat) * math.cos(lon), math.cos(lat) * math.sin(lon), math.sin(lat)])
    east = np.array([-math.sin(lon), math.cos(lon), 0.0])
    turned = DOWN @ np.array([east, np.cross(up, east), up])
    return (
        document
        | {
            "kilometres": {"position_mcmf_m": (position / 1e3).tolist()},
            "transposed": {"rotation_mcmf_to_camera": rotation.T.tolist()},
            "rotation": {"rotation_mcmf_to_camera": turned.tolist()},
            "position": {"position_mcmf_m": (np.linalg.norm(position) * up).tolist()},
        }[how]
    )


SKY = "the camera sees nothing of the Moon: "
MISTAKES = {
    "kilometres": r"position_mcmf_m lies deep inside the Moon \(are these kilometres, 900 km above",
    "transposed": SKY
    + r"rotation_mcmf_to_camera seems to take camera axes to MCMF: give its transpose \(then it looks at",
    "rotation": SKY + r"rotation_mcmf_to_camera looks down .* degrees, taken as radians",
    "position": SKY + r"position_mcmf_m lies above .* degrees, taken as radians",
}


@pytest.mark.parametrize("how", MISTAKES)
@pytest.mark.parametrize(("lon", "lat"), [(-60.0, 10.0), (300.0, 10.0)])
def test_a_mistake_is_named(tmp_path, how, lon, lat):
    path = tmp_path / "c.json"
    document = good_file(path, lon, lat, 900e3)
    read_sensor(path)
    path.write_text(json.dumps(spoilt(document, how, lon, lat)))
    with pytest.raises(CameraError, match=rf"c\.json: {MISTAKES[how]}") as said:
        read_sensor(path)
    assert "\n" not in str(said.value)


def test_a_low_camera_is_warned_of(tmp_path, caplog):
    """From 50 km the transpose of a camera that looks down sees the Moon, too, far off nadir."""
    path = tmp_path / "c.json"
    document = good_file(path, 30.5, 10.5, 50e3)
    read_sensor(path)
    assert not caplog.records
    path.write_text(json.dumps(spoilt(document, "transposed", 30.5, 10.5)))
    read_sensor(path)
    (record,) = caplog.records
    assert "c.json: if the camera is to look down: rotation_mcmf_to_camera" in record.getMessage()


def test_a_camera_that_sees_what_it_should_has_no_mistake(tmp_path):
    document = good_file(tmp_path / "c.json", 30.5, 10.5, 50e3)
    camera = camera_from_json(spoilt(document, "transposed", 30.5, 10.5))
    assert likely_mistake(camera, lambda seen: True) == ""
    assert likely_mistake(camera, lambda seen: False) == ""
    assert "transpose" in likely_mistake(camera, lambda seen: seen is not camera)


def test_a_camera_of_the_sky_has_other_axes(tmp_path):
    """Its axes are those of OpenGL; the transpose would look at the ground, too, far off nadir, and is not named."""
    path = tmp_path / "c.json"
    document = good_file(path, 30.5, 10.5, 900e3)
    up = np.diag([1.0, -1.0, -1.0]) @ np.array(document["rotation_mcmf_to_camera"])
    path.write_text(json.dumps(document | {"rotation_mcmf_to_camera": up.tolist()}))
    with pytest.raises(
        CameraError, match=r"OpenGL or Blender.*multiply it from the left by"
    ) as said:
        read_sensor(path)
    assert "transpose" not in str(said.value)


def test_a_mistake_is_named_only_if_the_camera_then_sees_what_it_should(tmp_path):
    """The transpose looks at the ground, but not at the catalogue; nor is it named of a camera that looks aside."""
    path = tmp_path / "c.json"
    for height in (900e3, 50e3):
        document = good_file(path, -60.0, 10.0, height)
        path.write_text(json.dumps(spoilt(document, "transposed", -60.0, 10.0)))
        asked = []

        def sees(camera, asked=asked):
            asked.append(camera)
            return False

        read_sensor(path, sees=sees)
        assert asked
    good = good_file(path, -60.0, 10.0, 900e3)
    path.write_text(json.dumps(spoilt(good, "transposed", -60.0, 10.0)))
    with pytest.raises(CameraError, match="give its transpose"):
        read_sensor(path, sees=lambda camera: True)


def test_two_suns_of_one_file_are_said(tmp_path, caplog):
    """The place of the Sun and the time; of a file with one of them, or with both alike, nothing."""
    path = tmp_path / "c.json"
    document = good_file(path, 3.5, 26.0, 100e3)
    document.pop("sun_position_mcmf_m", None)
    sun = (1.5e11 * sun_direction_at("1971-07-31T01:25:52")).tolist()
    alike = {"sun_position_mcmf_m": sun, "time_utc": "1971-07-31T01:25:52"}
    for fields in ({"time_utc": alike["time_utc"]}, {"sun_position_mcmf_m": sun}, alike):
        path.write_text(json.dumps(document | fields))
        read_sensor(path)
        assert not caplog.records
    path.write_text(json.dumps(document | alike | {"time_utc": "1971-08-07T01:25:52"}))
    read_sensor(path)
    (record,) = caplog.records
    degrees = float(
        re.search(
            r"sun_position_mcmf_m is (\S+) deg from the Sun at time_utc", record.getMessage()
        )[1]
    )
    assert degrees == pytest.approx(7 * 360 / 29.53, abs=3.0)


def test_a_camera_that_looks_away_without_a_known_mistake_is_read(tmp_path, caplog):
    """A star tracker, 60 deg off nadir at 900 km: the limb is 41 deg off."""
    path = tmp_path / "c.json"
    document = good_file(path, 100.0, 40.0, 900e3)
    frame = EnuFrame(100.0, 40.0)
    turn = math.radians(75.0)
    aside = np.array(
        [[1, 0, 0], [0, math.cos(turn), -math.sin(turn)], [0, math.sin(turn), math.cos(turn)]]
    )
    away = aside @ DOWN @ frame.rotation
    path.write_text(
        json.dumps(document | {"rotation_mcmf_to_camera": away.tolist(), "focal_length_px": 1e4})
    )
    read_sensor(path)
    assert not caplog.records


def test_exchanged_longitude_and_latitude(tmp_path):
    path = tmp_path / "c.json"
    document = good_file(path, 60.0, 5.0, 900e3)
    there = EnuFrame(5.0, 60.0).to_mcmf([0.0, 0.0, 900e3])
    path.write_text(json.dumps(document | {"position_mcmf_m": there.tolist()}))
    with pytest.raises(CameraError, match=r"longitude 5\.00, latitude 60\.00: exchange the two"):
        read_sensor(path)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"focal_length_px": 10.0}, r"field of view of 157 deg over 100 pixels: is it in millimetres"),
        ({"principal_point_px": [0, 0]}, r"\[0, 0\] is 63 pixels from the image's centre \[49.5, 39.5\]: is it an offset"),
        ({"image_size_px": [30, 100], "principal_point_px": [49.5, 14.5]}, r"are width and height exchanged"),
    ],
)  # fmt: skip
def test_what_is_hardly_so_is_warned_of(tmp_path, caplog, change, says):
    path = tmp_path / "c.json"
    document = good_file(path, 30.5, 10.5, 50e3)
    path.write_text(json.dumps(document | change))
    read_sensor(path)
    assert re.search(says, caplog.records[0].getMessage())


@pytest.mark.parametrize(
    ("key", "value", "says"),
    [
        ("distorsion", [0, 0, 0, 0, 0], r"has no key distorsion \(distortion is meant\?\)"),
        ("position_mcmf_m", [1.0e6, 0, 0], r"737\.4 km below the reference sphere"),
        ("focal_length_px", True, "does not consist of numbers, but is true"),
        ("focal_length_px", "1024", 'does not consist of numbers, but is "1024"'),
        ("focal_length_px", None, "one finite number, not null"),
        ("rotation_mcmf_to_camera", (57.3 * np.eye(3)).tolist(), r"lengths 57\.3, 57\.3, 57\.3, not 1"),
        ("rotation_mcmf_to_camera", [[1, 0, 0], [0.6, 0.8, 0], [0, 0, 1]], r"they are 53\.13, 90, 90 deg apart"),
        ("rotation_mcmf_to_camera", (-np.eye(3)).tolist(), r"left-handed \(its determinant is -1\)"),
        ("sun_position_mcmf_m", [1.5e8, 0, 0], "these are kilometres"),
        ("sun_position_mcmf_m", [0, 0, 1], "this is a direction"),
        ("time_utc", "31/07/1971", r"time_utc: invalid time: '31/07/1971' \(like 2024-01-01T00:00:00\)$"),
    ],
)  # fmt: skip
def test_invalid_fields_are_named_with_their_values(tmp_path, key, value, says):
    path = tmp_path / "c.json"
    document = good_file(path, 30.5, 10.5, 50e3)
    path.write_text(json.dumps(document | {key: value}))
    with pytest.raises(CameraError, match=rf"c\.json: .*{says}"):
        read_sensor(path)
