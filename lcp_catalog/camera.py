"""Framing cameras: read, checked, points to pixels and pixels to rays.

Camera axes are OpenCV's: X along rows (right), Y along columns (down), Z along the optical axis
towards the scene. Pixel centres are at whole numbers, so an image of width w reaches from -0.5 to w
- 0.5. Distortion is OpenCV's [k1, k2, p1, p2, k3].
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .constants import MOON_RADIUS_M
from .errors import CameraError
from .sphere import EnuFrame

Array = NDArray[np.float64]

FARTHEST_M = 1e11
"""No camera is further away: from there a float64 still tells where a ray meets the ground to 0.1 mm."""

_ROTATION_TOLERANCE = 1e-5
_UNDISTORT_STEPS = 50


@dataclass(frozen=True, eq=False)
class Camera:
    """A framing camera at a place; raises CameraError for one that cannot be.

    ``rotation_mcmf_to_camera`` turns MCMF axes into camera axes; a rotation that is off by rounding
    (up to 1e-5) is made orthonormal.
    """

    position_mcmf_m: Array
    rotation_mcmf_to_camera: Array
    focal_length_px: float
    principal_point_px: tuple[float, float]
    image_size_px: tuple[int, int]
    distortion: Array = field(default_factory=lambda: np.zeros(5))
    sun_position_mcmf_m: Array | None = None
    time_utc: str | None = None
    name: str = "camera"

    def __post_init__(self) -> None:
        put = lambda key, value: object.__setattr__(self, key, value)  # noqa: E731
        position = self._numbers("position_mcmf_m", (3,))
        if np.linalg.norm(position) < 0.5 * MOON_RADIUS_M:
            self._refuse("position_mcmf_m", "lies deep inside the Moon (are these metres?)")
        if np.linalg.norm(position) > 1.1 * FARTHEST_M:
            self._refuse("position_mcmf_m", f"lies beyond {FARTHEST_M / 1e3:g} km")
        put("position_mcmf_m", position)
        put("rotation_mcmf_to_camera", self._rotation())
        put("focal_length_px", float(self._numbers("focal_length_px", ())))
        if not self.focal_length_px > 0:
            self._refuse("focal_length_px", "must be positive")
        put("principal_point_px", tuple(self._numbers("principal_point_px", (2,)).tolist()))
        size = self._numbers("image_size_px", (2,))
        if (size < 1).any() or (size > 1_000_000).any() or (size != np.round(size)).any():
            self._refuse("image_size_px", "must be two whole numbers, width and height")
        put("image_size_px", (int(size[0]), int(size[1])))
        put("distortion", self._numbers("distortion", (5,)))
        if self.sun_position_mcmf_m is not None:
            put("sun_position_mcmf_m", self._numbers("sun_position_mcmf_m", (3,)))
        if self.time_utc is not None and not isinstance(self.time_utc, str):
            self._refuse("time_utc", "must be text like 2024-01-01T00:00:00")

    def _refuse(self, key: str, why: str) -> NoReturn:
        raise CameraError(f"{self.name}: {key} {why}")

    def _numbers(self, key: str, shape: tuple[int, ...]) -> Array:
        try:
            values = np.array(getattr(self, key), dtype=np.float64)
        except (TypeError, ValueError):
            self._refuse(key, "is not made of numbers")
        if values.shape != shape or not np.isfinite(values).all():
            wanted = "x".join(map(str, shape)) if shape else "one"
            self._refuse(key, f"must hold {wanted} finite number{'s' if shape else ''}")
        values.flags.writeable = False
        return values

    def _rotation(self) -> Array:
        given = self._numbers("rotation_mcmf_to_camera", (3, 3))
        error = np.abs(given @ given.T - np.eye(3)).max()
        if error > _ROTATION_TOLERANCE:
            self._refuse(
                "rotation_mcmf_to_camera", "is not a rotation: its rows are not orthonormal"
            )
        if np.linalg.det(given) < 0:
            self._refuse("rotation_mcmf_to_camera", "is left-handed: it mirrors the scene")
        if error < 1e-12:
            return given
        left, _, right = np.linalg.svd(given)
        rotation: Array = left @ right
        rotation.flags.writeable = False
        return rotation

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the image."""
        return self.image_size_px[1], self.image_size_px[0]

    @property
    def has_sun(self) -> bool:
        """Whether the camera states a Sun of its own, by position or by time."""
        return self.sun_position_mcmf_m is not None or self.time_utc is not None

    def to_json(self) -> dict[str, Any]:
        """What CAMERA.json holds."""
        document: dict[str, Any] = {
            "position_mcmf_m": self.position_mcmf_m.tolist(),
            "rotation_mcmf_to_camera": self.rotation_mcmf_to_camera.tolist(),
            "focal_length_px": self.focal_length_px,
            "principal_point_px": list(self.principal_point_px),
            "image_size_px": list(self.image_size_px),
            "distortion": self.distortion.tolist(),
        }
        if self.sun_position_mcmf_m is not None:
            document["sun_position_mcmf_m"] = self.sun_position_mcmf_m.tolist()
        if self.time_utc is not None:
            document["time_utc"] = self.time_utc
        return document

    def project(self, points_mcmf_m: ArrayLike) -> Array:
        """Pixels (..., 2), column then row, of MCMF points (..., 3); NaN for what is not in front
        of the camera.

        Far outside the image a distortion polynomial can fold back: such points get NaN as well
        (see `in_image`).
        """
        points = np.asarray(points_mcmf_m, dtype=np.float64)
        x, y, depth = np.moveaxis(
            (points - self.position_mcmf_m) @ self.rotation_mcmf_to_camera.T, -1, 0
        )
        ahead = depth > 0
        safe = np.where(ahead, depth, 1.0)
        x, y = x / safe, y / safe
        ahead &= x * x + y * y <= self._fold_radius2
        x, y = distort(np.where(ahead, x, 0.0), np.where(ahead, y, 0.0), self.distortion)
        cx, cy = self.principal_point_px
        pixels = np.stack([cx + self.focal_length_px * x, cy + self.focal_length_px * y], axis=-1)
        return np.where(ahead[..., None], pixels, np.nan)

    def in_image(self, pixels: ArrayLike) -> NDArray[np.bool_]:
        """Whether pixels (..., 2) lie within the image; False for NaN."""
        column, row = np.moveaxis(np.asarray(pixels, dtype=np.float64), -1, 0)
        width, height = self.image_size_px
        inside = (column >= -0.5) & (column < width - 0.5) & (row >= -0.5) & (row < height - 0.5)
        return np.asarray(inside)

    def rays(self, pixels: ArrayLike) -> Array:
        """Unit MCMF directions (..., 3) in which pixels (..., 2) look.

        Raises CameraError where the distortion cannot be undone within the image.
        """
        column, row = np.moveaxis(np.asarray(pixels, dtype=np.float64), -1, 0)
        cx, cy = self.principal_point_px
        u, v = (column - cx) / self.focal_length_px, (row - cy) / self.focal_length_px
        x, y = undistort(u, v, self.distortion)
        if self.distortion.any():
            with np.errstate(all="ignore"):
                back = distort(x, y, self.distortion)
                off_px = np.hypot(back[0] - u, back[1] - v) * self.focal_length_px
                undone = (off_px < 1e-6) & (x * x + y * y <= self._fold_radius2)
            if not undone.all():
                self._refuse("distortion", "cannot be undone within the image")
        looking = np.stack([x, y, np.ones_like(x)], axis=-1)
        looking /= np.linalg.norm(looking, axis=-1, keepdims=True)
        return looking @ self.rotation_mcmf_to_camera

    def rays_enu(self, frame: EnuFrame) -> tuple[Array, Array]:
        """The camera's position (3,) and every pixel's unit direction (rows, columns, 3) in an ENU
        frame.
        """
        rows, columns = self.shape
        row, column = np.mgrid[0:rows, 0:columns].astype(np.float64)
        directions = frame.direction_from_mcmf(self.rays(np.stack([column, row], axis=-1)))
        return frame.from_mcmf(self.position_mcmf_m), directions

    @property
    def _fold_radius2(self) -> float:
        """Squared undistorted radius up to which the radial polynomial grows; infinite where it
        always does.
        """
        k1, k2, _, _, k3 = self.distortion
        turns = np.roots(
            [7 * k3, 5 * k2, 3 * k1, 1.0]
        )  # d/dr (r + k1 r^3 + k2 r^5 + k3 r^7), in r^2
        real = turns[(np.abs(turns.imag) < 1e-12) & (turns.real > 0)].real if turns.size else turns
        return float(real.min()) if real.size else math.inf


def read_camera(path: Path | str) -> Camera:
    """The camera in a CAMERA.json; CameraError names the file and the field that is wrong."""
    path = Path(path)
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise CameraError(f"{path}: cannot be read: {error.strerror or error}") from error
    except ValueError as error:
        raise CameraError(f"{path}: is not JSON: {error}") from error
    return camera_from_json(document, str(path))


def camera_from_json(document: Any, name: str = "camera") -> Camera:
    """The camera in a CAMERA.json's content; fields that are not known are left alone."""
    if not isinstance(document, Mapping):
        raise CameraError(f"{name}: a camera file holds one JSON object")
    needed = (
        "position_mcmf_m",
        "rotation_mcmf_to_camera",
        "focal_length_px",
        "principal_point_px",
        "image_size_px",
    )
    if "name_model" in document:
        raise CameraError(f"{name}: is a USGS ISD; only CAMERA.json is read so far")
    missing = [key for key in needed if key not in document]
    if missing:
        raise CameraError(f"{name}: lacks {', '.join(missing)}")
    known = {key: document[key] for key in needed}
    optional = ("distortion", "sun_position_mcmf_m", "time_utc")
    known |= {key: document[key] for key in optional if document.get(key) is not None}
    return Camera(**known, name=name)


def distort(x: Array, y: Array, distortion: ArrayLike) -> tuple[Array, Array]:
    """Where ideal normalised image coordinates land through the lens (OpenCV's five numbers)."""
    k1, k2, p1, p2, k3 = np.asarray(distortion, dtype=np.float64)
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    return (
        x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
        y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
    )


def undistort(u: Array, v: Array, distortion: ArrayLike) -> tuple[Array, Array]:
    """The ideal coordinates that `distort` takes to (u, v): Newton's method, from (u, v) itself."""
    coefficients = np.asarray(distortion, dtype=np.float64)
    x, y = np.array(u, dtype=np.float64), np.array(v, dtype=np.float64)
    if not coefficients.any():
        return x, y
    with np.errstate(all="ignore"):  # what diverges ends as NaN; the caller looks
        for _ in range(_UNDISTORT_STEPS):
            step_x, step_y = _newton_step(x, y, u, v, coefficients)
            x, y = x - step_x, y - step_y
            if not np.hypot(step_x, step_y).max(initial=0.0) > 1e-14:
                break
    return x, y


def _newton_step(x: Array, y: Array, u: Array, v: Array, distortion: Array) -> tuple[Array, Array]:
    k1, k2, p1, p2, k3 = distortion
    du, dv = distort(x, y, distortion)
    du, dv = du - u, dv - v
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = 2 * (k1 + r2 * (2 * k2 + r2 * 3 * k3))
    uu = radial + slope * x * x + 2 * p1 * y + 6 * p2 * x
    vv = radial + slope * y * y + 6 * p1 * y + 2 * p2 * x
    uv = slope * x * y + 2 * p1 * x + 2 * p2 * y
    determinant = uu * vv - uv * uv
    return (vv * du - uv * dv) / determinant, (uu * dv - uv * du) / determinant
