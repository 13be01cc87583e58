"""Pinhole cameras of the Ames Stereo Pipeline (ASP): .tsai text files.

Read are the versions 3 and 4, and the older one without a header, which knows the TSAI lens alone. After the manual of ASP,
chapter "Frame camera models": P = R Q + C takes camera axes to world axes (body-fixed, metres); what a lens makes of
f (x / z, y / z), plus the principal point, over the pitch, is the pixel. Pixel centres are at whole numbers there too.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import NoReturn

import numpy as np

from ..arrays import Array
from ..errors import CameraError
from .distortion import BrownConrady, Lens, NoLens, OpenCV, Photometrix
from .focal_plane import plane_of
from .frame_camera import Camera, camera_on
from .json_fields import LARGEST

_VALUE = re.compile(r"\s*([A-Za-z_]\w*)\s*=\s*(.*?)\s*$")
_UNREAD = ("ADJUSTABLETSAI", "FISHEYE", "FOV", "RPC")
_TOLERANCE = 1e-4
"""R and the directions may be off a rotation by this: they are often written with six digits."""


def is_tsai(text: str) -> bool:
    """Whether a text is such a file."""
    names = [match[1] for match in map(_VALUE.match, text.splitlines()) if match]
    return text.lstrip().startswith("VERSION_") or names[:2] == ["fu", "fv"]


def camera_from_tsai(text: str, name: str, shape: tuple[int, int] | None = None) -> Camera:
    """The camera in a .tsai file's text; CameraError names the file and the value that is wrong.

    ``shape``: rows and columns of its image. The format does not hold them; a line ``image_size = WIDTH HEIGHT`` is read
    where the caller does not know.
    """
    return _Tsai.parsed(text, name).camera(shape)


@dataclass(frozen=True)
class _Tsai:
    """The file's values by their names, and its lines that are none."""

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
        """So many finite numbers."""
        if key not in self.values:
            if default is None:
                raise CameraError(f"{self.name}: lacks {key}")
            return np.array(default)
        try:
            numbers = np.array(self.values[key].split(), dtype=np.float64)
        except ValueError:
            self.refuse(key, f"is {self.values[key]!r}: not made of numbers")
        if len(numbers) != count or not (np.abs(numbers) <= LARGEST).all():
            self.refuse(key, f"must hold {count} finite number{'s' * (count > 1)}")
        return numbers

    def number(self, key: str, default: float | None = None) -> float:
        return float(self.numbers(key, 1, None if default is None else [default])[0])

    def camera(self, shape: tuple[int, int] | None) -> Camera:
        focal = np.array([self.number("fu"), self.number("fv")])
        pitch = self.number("pitch", 1.0)
        for key, value in zip(("fu", "fv", "pitch"), (*focal, pitch), strict=True):
            if not value > 0.0:
                self.refuse(key, f"must be positive, is {value:g}")
        lens, unit = self._lens(focal)
        axes, mirrored = self._axes()
        plane, turn = plane_of(
            lens,
            unit,
            np.diag(focal / unit) / pitch,
            (self.number("cu") / pitch, self.number("cv") / pitch),
            flipped=mirrored,
        )
        return camera_on(
            plane,
            position_mcmf_m=self.numbers("C", 3),
            rotation_mcmf_to_camera=turn @ axes,
            image_size_px=self._size(shape),
            name=self.name,
        )

    def _size(self, shape: tuple[int, int] | None) -> tuple[float, float]:
        if shape is not None:
            return shape[1], shape[0]
        if "image_size" not in self.values:
            raise CameraError(
                f"{self.name}: a .tsai does not say how large its image is: add a line "
                "image_size = WIDTH HEIGHT"
            )
        width, height = self.numbers("image_size", 2)
        return float(width), float(height)

    def _axes(self) -> tuple[Array, bool]:
        """The rotation (3, 3) from MCMF to camera axes, and whether the camera's y is its negative: for directions that
        make a left-handed set.
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
        """The lens, and its focal length in its own units."""
        kinds = [word for word in self.words if not word.startswith(("VERSION_", "PINHOLE"))]
        kind = kinds[0] if kinds else "TSAI" if "k1" in self.values else "NULL"
        if kind == "NULL":
            return NoLens(), 1.0
        if kind == "TSAI":
            k1, k2, p1, p2 = (self.number(key) for key in ("k1", "k2", "p1", "p2"))
            return OpenCV(k1, k2, p1, p2, self.number("k3", 0.0)), 1.0
        if kind not in ("PHOTOMETRIX", "BROWNCONRADY"):
            known = "not read" if kind in _UNREAD else "unknown"
            self.refuse(
                kind, f"is a lens that is {known}; read are NULL, TSAI, BrownConrady, Photometrix"
            )
        if abs(focal[0] - focal[1]) > 1e-9 * focal[0]:
            self.refuse("fv", f"must be fu for the lens {kind}")
        numbers = {key: self.number(key) for key in ("xp", "yp", "k1", "k2", "k3", "p1", "p2")}
        if kind == "PHOTOMETRIX":
            return Photometrix(**numbers), float(focal[0])
        return BrownConrady(**numbers, phi=self.number("phi")), float(focal[0])


def _nearest(matrix: Array) -> Array | None:
    """The orthonormal matrix nearest to one that is nearly so; None for one that is not."""
    if np.abs(matrix @ matrix.T - np.eye(3)).max() > _TOLERANCE:
        return None
    left, _, right = np.linalg.svd(matrix)
    return np.asarray(left @ right)
