"""Sensors from camera files: CAMERA.json, USGS ISD JSON, or .tsai of the Ames Stereo Pipeline,
recognised by content.
"""

from __future__ import annotations

import logging
from pathlib import Path

from ..errors import CameraError
from .frame_camera import Camera, camera_from_json
from .isd import AnySensor, is_isd, sensor_from_isd
from .json_fields import parsed
from .mistakes import likely_mistake, looks_down, sees_moon
from .tsai import camera_from_tsai, is_tsai

log = logging.getLogger(__name__)

FRAME_PIXELS_MAX = 100_000_000
"""Most pixels of an image that is rendered."""


def read_sensor(path: Path | str, shape: tuple[int, int] | None = None) -> AnySensor:
    """The sensor that a camera file describes; CameraError names the file and the invalid field.

    ``shape``: rows and columns of the image, if known; required for a .tsai file, which does not
    give them. CameraError for a file of an image of another shape, and for a framing camera that does
    not see the Moon because of a mistake that `mistakes` recognises.
    """
    path = Path(path)
    text = _text(path)
    if is_tsai(text):
        return camera_from_tsai(text, str(path), shape)
    fields = parsed(text, str(path))
    sensor = (
        sensor_from_isd(fields) if is_isd(fields) else camera_from_json(fields.document, str(path))
    )
    if shape is not None and sensor.shape != tuple(shape):
        raise CameraError(
            f"{path}: is the camera of an image of {sensor.shape[1]} x {sensor.shape[0]} pixels, "
            f"not of {shape[1]} x {shape[0]}"
        )
    if isinstance(sensor, Camera):
        _refuse_mistakes(sensor, path)
    return sensor


def _refuse_mistakes(camera: Camera, path: Path) -> None:
    """CameraError for a camera that sees nothing of the Moon by a mistake; a warning for one that looks
    down if the mistake is undone, which an oblique view can do by chance.
    """
    if mistake := likely_mistake(camera, sees_moon):
        raise CameraError(f"{path}: {mistake}")
    if mistake := likely_mistake(camera, looks_down):
        log.warning("%s: if the camera is to look down: %s", path, mistake)


def read_camera(path: Path | str, shape: tuple[int, int] | None = None) -> Camera:
    """The framing camera that a camera file describes.

    Parameters
    ----------
    path:
        A CAMERA.json, an ISD of USGS CSM/ALE, or a .tsai file.
    shape:
        Rows and columns of its image; required for a .tsai file, which does not state them.

    Raises
    ------
    CameraError
        For scanners, for an image that is too large to be rendered, for invalid files; the message
        names the file and the field.

    Examples
    --------
    >>> lcp.read_camera(folder / "AS15-M-0414_camera.json").shape
    (404, 404)
    """
    sensor = read_sensor(path, shape)
    if not isinstance(sensor, Camera):
        raise CameraError(f"{path}: is a {sensor.kind}; give a framing camera: a CAMERA.json")
    require_pixels(sensor)
    return sensor


def require_pixels(sensor: AnySensor) -> None:
    """CameraError for an image with more pixels than are rendered."""
    rows, cols = sensor.shape
    if rows * cols > FRAME_PIXELS_MAX:
        raise CameraError(
            f"{sensor.name}: image_size_px of {cols} x {rows}: at most {FRAME_PIXELS_MAX / 1e6:g} million pixels "
            "are rendered; use the camera of a part of the image, or of one with larger pixels"
        )


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise CameraError(f"{path}: cannot be read: {error.strerror or error}") from error
    except ValueError as error:
        raise CameraError(f"{path}: is not JSON: {error}") from error
