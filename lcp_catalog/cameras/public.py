"""A camera of a public function: an object, or a file."""

from __future__ import annotations

from pathlib import Path
from typing import TypeAlias

from .camera_file import read_camera, read_sensor
from .frame_camera import Camera
from .isd import AnySensor
from .sensor import Sensor

CameraOrPath: TypeAlias = Camera | Path | str
SensorOrPath: TypeAlias = Sensor | Path | str


def framing_camera(camera: CameraOrPath) -> Camera:
    """A framing camera, read if its file is given (`read_camera`)."""
    return read_camera(camera) if isinstance(camera, Path | str) else camera


def any_sensor(camera: Sensor | Path | str) -> Sensor:
    """A sensor, read if its file is given (`read_sensor`)."""
    return read_sensor(camera) if isinstance(camera, Path | str) else camera


def rendered_sensor(camera: AnySensor | Path | str) -> AnySensor:
    """A sensor whose image can be rendered, read if its file is given (`read_sensor`)."""
    return read_sensor(camera) if isinstance(camera, Path | str) else camera
