"""Wrong camera files: each mistake is made in a good file, and named when it is read."""

import json
import math

import numpy as np
import pytest
from helpers.renders import camera_file

from lcp_catalog.cameras.camera_file import likely_mistake, read_sensor
from lcp_catalog.cameras.frame_camera import camera_from_json
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


MISTAKES = {
    "kilometres": r"position_mcmf_m lies deep inside the Moon \(are these kilometres, 900 km above",
    "transposed": r"rotation_mcmf_to_camera looks elsewhere.*give its transpose",
    "rotation": r"rotation_mcmf_to_camera looks down .* degrees, taken as radians",
    "position": r"position_mcmf_m lies above .* degrees, taken as radians",
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


def test_a_camera_of_the_sky_is_read(tmp_path, caplog):
    """Neither its transpose nor its angles explain why it looks up."""
    path = tmp_path / "c.json"
    document = good_file(path, 30.5, 10.5, 900e3)
    up = np.diag([1.0, -1.0, -1.0]) @ np.array(document["rotation_mcmf_to_camera"])
    path.write_text(json.dumps(document | {"rotation_mcmf_to_camera": up.tolist()}))
    read_sensor(path)
    assert not caplog.records
