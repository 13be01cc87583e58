"""Pinhole cameras of the Ames Stereo Pipeline (ASP): .tsai text files.

Supported are versions 3 and 4, and the older version without a header, which has the TSAI lens
only. By the manual of ASP, chapter "Frame camera models": P = R Q + C takes camera axes to world
axes (body-fixed, metres). A pixel is the distorted f (x / z, y / z), plus the principal point,
divided by the pitch. Pixel centres are at whole numbers, as here.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import NoReturn

import numpy as np

from ..arrays import Array
from ..errors import CameraError
from .distortion import BrownConrady, Lens, NoLens, OpenCV, Photometrix, plane_of
from .frame_camera import Camera, fields_of_plane
from .json_fields import LARGEST

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
