"""Sensors from camera files: CAMERA.json, USGS ISD JSON, or .tsai of the Ames Stereo Pipeline,
recognised by content.

Pinhole cameras of the Ames Stereo Pipeline (ASP): .tsai text files.

Supported are versions 3 and 4, and the older version without a header, which has the TSAI lens
only. By the manual of ASP, chapter "Frame camera models": P = R Q + C takes camera axes to world
axes (body-fixed, metres). A pixel is the distorted f (x / z, y / z), plus the principal point,
divided by the pitch. Pixel centres are at whole numbers, as here.
"""

from __future__ import annotations

import logging
import re
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import numpy as np

from ..arrays import Array
from ..errors import CameraError, not_a
from ..file_kinds import other_kind
from .distortion import BrownConrady, Lens, NoLens, OpenCV, Photometrix, plane_of
from .frame_camera import Camera, camera_from_json, fields_of_plane
from .isd import AnySensor, is_isd, sensor_from_isd
from .json_fields import LARGEST, parsed
from .mistakes import Sees, blindness, doubts, if_looking_down, sees_moon

_VALUE = re.compile(r"\s*([A-Za-z_]\w*)\s*=\s*(.*?)\s*$")
_UNREAD = ("ADJUSTABLETSAI", "FISHEYE", "FOV", "RPC")
_TOLERANCE = 1e-4
"""Largest deviation of R and of the directions from a rotation; they are often written with six
digits.
"""


def is_tsai(text: str) -> bool:
    """True if a text is a .tsai file."""
    names = [match[1] for match in map(_VALUE.match, text.splitlines()) if match]
    return text.lstrip().startswith("VERSION_") or names[:2] == ["fu", "fv"]


def camera_from_tsai(text: str, name: str, shape: tuple[int, int] | None = None) -> Camera:
    """The camera in a .tsai file's text; CameraError names the file and the invalid value.

    ``shape``: rows and columns of the image. The format does not contain them; a line ``image_size
    = WIDTH HEIGHT`` is read if ``shape`` is None.
    """
    return _Tsai.parsed(text, name).camera(shape)


@dataclass(frozen=True)
class _Tsai:
    """Values of the file by name, and its lines without a value."""

    name: str
    values: dict[str, str]
    words: tuple[str, ...]

    @classmethod
    def parsed(cls, text: str, name: str) -> _Tsai:
        values, words = {}, []
        for line in text.splitlines():
            match = _VALUE.match(line)
            if match:
                values[match[1]] = match[2]
            elif line.strip():
                words.append(line.strip().upper())
        return cls(name, values, tuple(words))

    def refuse(self, key: str, why: str) -> NoReturn:
        raise CameraError(f"{self.name}: {key} {why}")

    def numbers(self, key: str, count: int, default: list[float] | None = None) -> Array:
        """``count`` finite numbers."""
        if key not in self.values:
            if default is None:
                raise CameraError(f"{self.name}: lacks {key}")
            return np.array(default)
        try:
            numbers = np.array(self.values[key].split(), dtype=np.float64)
        except ValueError:
            self.refuse(key, f"is {self.values[key]!r}, which are not numbers")
        if len(numbers) != count or not (np.abs(numbers) <= LARGEST).all():
            self.refuse(key, f"must hold {count} finite number{'s' * (count > 1)}")
        return numbers

    def number(self, key: str, default: float | None = None) -> float:
        return float(self.numbers(key, 1, None if default is None else [default])[0])

    def camera(self, shape: tuple[int, int] | None) -> Camera:
        focal = np.array([self.number("fu"), self.number("fv")])
        pitch = self.number("pitch", 1.0)
        for key, value in zip(("fu", "fv", "pitch"), (*focal, pitch), strict=True):
            if not value >= 1.0 / LARGEST:
                self.refuse(key, f"must be at least {1.0 / LARGEST:g}, is {value:g}")
        lens, unit = self._lens(focal)
        axes, mirrored = self._axes()
        plane, turn = plane_of(
            lens,
            unit,
            np.diag(focal / unit) / pitch,
            (self.number("cu") / pitch, self.number("cv") / pitch),
            flipped=mirrored,
        )
        return Camera(
            position_mcmf_m=self.numbers("C", 3),
            rotation_mcmf_to_camera=turn @ axes,
            name=self.name,
            **(fields_of_plane(plane) | {"image_size_px": self._size(shape)}),
        )

    def _size(self, shape: tuple[int, int] | None) -> tuple[float, float]:
        if shape is not None:
            return shape[1], shape[0]
        if "image_size" not in self.values:
            raise CameraError(
                f"{self.name}: a .tsai file does not give the image size: add a line "
                "image_size = WIDTH HEIGHT"
            )
        width, height = self.numbers("image_size", 2)
        return float(width), float(height)

    def _axes(self) -> tuple[Array, bool]:
        """Rotation (3, 3) from MCMF to camera axes, and True if the camera's y is reversed: for
        directions that form a left-handed set.
        """
        u, v, w = (
            self.numbers(f"{axis}_direction", 3, np.eye(3)[i].tolist())
            for i, axis in enumerate("uvw")
        )
        directions = _nearest(np.stack([u, v, w]))
        rotation = _nearest(self.numbers("R", 9).reshape(3, 3))
        if directions is None:
            self.refuse("u_direction,", "v_direction and w_direction are not orthonormal")
        if rotation is None or np.linalg.det(rotation) < 0:
            self.refuse("R", "is not a rotation")
        axes = directions @ rotation.T
        mirrored = bool(np.linalg.det(axes) < 0)
        return np.diag([1.0, -1.0 if mirrored else 1.0, 1.0]) @ axes, mirrored

    def _lens(self, focal: Array) -> tuple[Lens, float]:
        """The lens and its focal length in its own units."""
        kinds = [word for word in self.words if not word.startswith(("VERSION_", "PINHOLE"))]
        kind = kinds[0] if kinds else "TSAI" if "k1" in self.values else "NULL"
        if kind == "NULL":
            return NoLens(), 1.0
        if kind == "TSAI":
            k1, k2, p1, p2 = (self.number(key) for key in ("k1", "k2", "p1", "p2"))
            return OpenCV(k1, k2, p1, p2, self.number("k3", 0.0)), 1.0
        if kind not in ("PHOTOMETRIX", "BROWNCONRADY"):
            known = "not supported" if kind in _UNREAD else "unknown"
            self.refuse(
                kind,
                f"is a lens that is {known}; supported are NULL, TSAI, BrownConrady, Photometrix",
            )
        if abs(focal[0] - focal[1]) > 1e-9 * focal[0]:
            self.refuse("fv", f"must be fu for the lens {kind}")
        xp, yp, k1, k2, k3, p1, p2 = map(self.number, ("xp", "yp", "k1", "k2", "k3", "p1", "p2"))
        if kind == "PHOTOMETRIX":
            return Photometrix(xp, yp, k1, k2, k3, p1, p2), float(focal[0])
        return BrownConrady(xp, yp, k1, k2, k3, p1, p2, self.number("phi")), float(focal[0])


def _nearest(matrix: Array) -> Array | None:
    """The orthonormal matrix nearest to an almost orthonormal one; None for any other."""
    if np.abs(matrix @ matrix.T - np.eye(3)).max() > _TOLERANCE:
        return None
    left, _, right = np.linalg.svd(matrix)
    return np.asarray(left @ right)


log = logging.getLogger(__name__)

FRAME_PIXELS_MAX = 100_000_000
"""Most pixels of an image that is rendered."""


def read_sensor(
    path: Path | str, shape: tuple[int, int] | None = None, sees: Sees = sees_moon
) -> AnySensor:
    """The sensor that a camera file describes: a framing camera, line scanner or push-frame camera.

    Parameters
    ----------
    path:
        A CAMERA.json, an ISD of USGS CSM/ALE, or a .tsai file.
    shape:
        Rows and columns of its image, if known; required for a .tsai file, which does not state them.
    sees:
        True for a camera that sees what it should, like a catalogue: mistakes are named only if the camera does without
        them.

    Raises
    ------
    CameraError
        Names the file and the invalid field; also for a file of an image of another shape, and for a framing camera that
        does not see the Moon because of a mistake that `mistakes` recognises. Doubts are logged as warnings.

    Examples
    --------
    >>> lcp.read_sensor(folder / "AS15-M-0414_camera.json").kind
    'framing camera'
    """
    sensor = unjudged_sensor(path, shape)
    if isinstance(sensor, Camera):
        _refuse_mistakes(sensor, path, sees)
    return sensor


def unjudged_sensor(path: Path | str, shape: tuple[int, int] | None = None) -> AnySensor:
    """`read_sensor` without a judgement of what the camera sees."""
    if not isinstance(path, Path | str):
        raise not_a(path, "path", "the path of a camera file")
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
            f"not of {shape[1]} x {shape[0]}: give the camera of this image"
        )
    return sensor


def _refuse_mistakes(camera: Camera, path: Path | str, sees: Sees) -> None:
    """CameraError for a camera that sees nothing of the Moon by a mistake; a warning for one that looks
    down if the mistake is undone, which an oblique view can do by chance.
    """
    if why := blindness(camera, sees):
        raise CameraError(f"{path}: {why}")
    for doubt in filter(None, [*doubts(camera), if_looking_down(camera, sees)]):
        log.warning("%s: %s", path, doubt)


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
    except FileNotFoundError as error:
        raise CameraError(f"{path}: there is no such file") from error
    except OSError as error:
        raise CameraError(f"{path}: cannot be read: {error.strerror or error}") from error
    except ValueError as error:
        found = other_kind(path, "a camera file (CAMERA.json, USGS ISD or .tsai)")
        raise CameraError(f"{path}: {found or f'is not JSON: {error}'}") from error
