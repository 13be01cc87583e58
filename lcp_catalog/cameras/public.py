"""A camera of a public function: an object, or a file."""

from __future__ import annotations

from pathlib import Path
from typing import TypeAlias

from ..errors import not_a
from .camera_file import read_camera, read_sensor
from .frame_camera import Camera
from .isd import AnySensor
from .mistakes import Sees, sees_moon
from .sensor import Sensor

CameraOrPath: TypeAlias = Camera | Path | str
SensorOrPath: TypeAlias = Sensor | Path | str


def framing_camera(camera: CameraOrPath) -> Camera:
    """A framing camera, read if its file is given (`read_camera`); KindError for anything else."""
    found = read_camera(camera) if isinstance(camera, Path | str) else camera
    if not isinstance(found, Camera):
        raise not_a(camera, "camera", "a Camera or the path of its file")
    return found


def any_sensor(camera: Sensor | Path | str, sees: Sees = sees_moon) -> Sensor:
    """A sensor, read if its file is given (`read_sensor`); KindError for anything else."""
    if isinstance(camera, Path | str):
        return read_sensor(camera, sees=sees)
    if not hasattr(camera, "looks"):
        raise not_a(camera, "camera", "a Camera, another sensor, or the path of its file")
    return camera


def rendered_sensor(camera: AnySensor | Path | str) -> AnySensor:
    """A sensor whose image can be rendered, read if its file is given; KindError for anything else."""
    found: AnySensor = any_sensor(camera)  # type: ignore[assignment]  # files hold no others
    return found
