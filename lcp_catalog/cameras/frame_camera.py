"""Framing cameras: reading and checks, points to pixels and pixels to rays.

Camera axes are those of OpenCV: X along rows (right), Y along columns (down), Z along the optical
axis towards the scene. Pixel centres are at whole numbers: an image of width w covers -0.5 to w -
0.5. The lens is [k1, k2, p1, p2, k3] of OpenCV, or any other lens of `distortion`.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, NoReturn

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import Array
from ..choices import SCHEMA
from ..constants import MOON_RADIUS_M
from ..ephemeris.times import Time, instants
from ..errors import CameraError, KindError, SunError, unknown_keys
from ..geometry.frames import EnuFrame
from ..geometry.rotations import by_vector
from .distortion import FocalPlane, Lens, NoLens, OpenCV, lens_from_json
from .json_fields import LARGEST, numbers
from .sensor import POSE, FullSensor

FARTHEST_M = 1e11
"""Largest distance of a camera; at that distance float64 still resolves 0.1 mm on the surface."""

SUN_NEAREST_M = 1e9
"""Least distance of a Sun position; a smaller one is in kilometres or a direction."""

_SUN_M = (1.3e11, 1.7e11)
"""Least and greatest distance of the Sun, with some room."""

_ROTATION_TOLERANCE = 1e-5


@dataclass(frozen=True, eq=False)
class Camera(FullSensor):
    """A framing camera; CameraError for invalid fields.

    ``rotation_mcmf_to_camera`` takes MCMF axes to camera axes; a rotation with rounding errors (up
    to 1e-5) is made orthonormal. ``distortion``: [k1, k2, p1, p2, k3] of OpenCV. ``lens``: any
    other lens, in units of the focal length; at most one of the two is given. Positions are in
    metres, pixels (column, row) with centres at whole numbers. The lens model is that of OpenCV
    (Brown, 1971).

    Examples
    --------
    >>> rotation = [[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]]
    >>> camera = lcp.Camera([1837.4e3, 0.0, 0.0], rotation, 1000.0, (255.5, 255.5), (512, 512))
    >>> camera.project([1737.4e3, 0.0, 0.0]).tolist()
    [255.5, 255.5]
    """

    kind: ClassVar[str] = "framing camera"
    corrections: ClassVar[tuple[str, ...]] = POSE

    position_mcmf_m: Array
    rotation_mcmf_to_camera: Array
    focal_length_px: float
    principal_point_px: tuple[float, float]
    image_size_px: tuple[int, int]
    distortion: Array = field(default_factory=lambda: np.zeros(5))
    sun_position_mcmf_m: Array | None = None
    time_utc: str | None = None
    name: str = "camera"
    lens: Lens | None = None

    @classmethod
    def from_spice(
        cls,
        observer: str,
        instrument: str,
        time: Time,
        kernels: Path | str | Sequence[Path | str] = (),
        ik: Mapping[str, float | Sequence[float]] | None = None,
        body_frame: str | None = None,
    ) -> Camera:
        """The camera of an instrument at an instant, from SPICE kernels: `SpiceCamera`, which has the parameters,
        the errors and whole trajectories.
        """
        from .spice import SpiceCamera

        return SpiceCamera(observer, instrument, kernels, ik or {}, body_frame).at(time)

    def __post_init__(self) -> None:
        position = self._numbers("position_mcmf_m", (3,))
        if (distance := float(np.linalg.norm(position))) < 0.5 * MOON_RADIUS_M:
            height_km = distance - MOON_RADIUS_M / 1e3
            says = f"are these kilometres, {height_km:.0f} km above the Moon? give metres"
            self._refuse(
                "position_mcmf_m",
                f"lies deep inside the Moon ({says if height_km > 0.0 else 'are these metres?'})",
            )
        if np.linalg.norm(position) > 1.1 * FARTHEST_M:
            self._refuse("position_mcmf_m", f"lies beyond {FARTHEST_M / 1e3:g} km")
        self._put("position_mcmf_m", position)
        self._put("rotation_mcmf_to_camera", self._rotation())
        self._put("focal_length_px", float(self._numbers("focal_length_px", ())))
        if not self.focal_length_px > 0:
            self._refuse("focal_length_px", f"must be positive, not {self.focal_length_px:g}")
        self._put("principal_point_px", tuple(self._numbers("principal_point_px", (2,)).tolist()))
        size = self._numbers("image_size_px", (2,))
        if (size < 1).any() or (size > 1_000_000).any() or (size != np.round(size)).any():
            self._refuse(
                "image_size_px", f"must be two whole numbers, width and height, not {size.tolist()}"
            )
        self._put("image_size_px", (int(size[0]), int(size[1])))
        self._put("distortion", self._numbers("distortion", (5,)))
        if self.lens is not None and self.distortion.any():
            self._refuse("distortion", "and a lens are given: give one of them")
        if self.sun_position_mcmf_m is not None:
            sun = self._numbers("sun_position_mcmf_m", (3,))
            if (away := float(np.linalg.norm(sun))) < SUN_NEAREST_M:
                self._refuse("sun_position_mcmf_m", _too_near(away, sun, position))
            self._put("sun_position_mcmf_m", sun)
        if self.time_utc is not None:
            self._require_time()

    def _require_time(self) -> None:
        try:
            assert self.time_utc is not None
            labels = instants(self.time_utc).labels()
            if not isinstance(self.time_utc, str):
                self._put("time_utc", labels[0])
        except KindError:
            self._refuse("time_utc", "must be text like 2024-01-01T00:00:00")
        except SunError as error:
            raise CameraError(f"{self.name}: time_utc: {error}") from error

    def _put(self, key: str, value: Any) -> None:
        object.__setattr__(self, key, value)

    def _refuse(self, key: str, why: str) -> NoReturn:
        raise CameraError(f"{self.name}: {key} {why}")

    def _numbers(self, key: str, shape: tuple[int, ...]) -> Array:
        try:
            values = numbers(getattr(self, key))
        except (TypeError, ValueError, OverflowError):
            self._refuse(key, f"does not consist of numbers, but is {_shown(getattr(self, key))}")
        if values.shape != shape or not (np.abs(values) <= LARGEST).all():
            wanted = "x".join(map(str, shape)) if shape else "one"
            self._refuse(
                key,
                f"must hold {wanted} finite number{'s' if shape else ''}, not {_shown(getattr(self, key))}",
            )
        values.flags.writeable = False
        return values

    def _rotation(self) -> Array:
        given = self._numbers("rotation_mcmf_to_camera", (3, 3))
        error = np.abs(given @ given.T - np.eye(3)).max()
        if error > _ROTATION_TOLERANCE:
            self._refuse("rotation_mcmf_to_camera", _no_rotation(given))
        if np.linalg.det(given) < 0:
            self._refuse(
                "rotation_mcmf_to_camera",
                "is left-handed (its determinant is -1): it mirrors the scene; change the sign of the axis that is not "
                "right, down or ahead",
            )
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

    def to_json(self) -> dict[str, Any]:
        """Content of CAMERA.json."""
        document: dict[str, Any] = {
            "position_mcmf_m": self.position_mcmf_m.tolist(),
            "rotation_mcmf_to_camera": self.rotation_mcmf_to_camera.tolist(),
            "focal_length_px": self.focal_length_px,
            "principal_point_px": list(self.principal_point_px),
            "image_size_px": list(self.image_size_px),
        }
        if self.lens is None:
            document["distortion"] = self.distortion.tolist()
        else:
            document["lens"] = self.lens.to_json()
        if self.sun_position_mcmf_m is not None:
            document["sun_position_mcmf_m"] = self.sun_position_mcmf_m.tolist()
        if self.time_utc is not None:
            document["time_utc"] = self.time_utc
        return document

    @cached_property
    def focal_plane(self) -> FocalPlane:
        """Projection from directions in camera axes to pixels, and back."""
        bent = OpenCV(*self.distortion.tolist()) if self.distortion.any() else NoLens()
        return FocalPlane(
            self.focal_length_px, self.principal_point_px, bent if self.lens is None else self.lens
        )

    def moved(self, correction: ArrayLike) -> Camera:
        """The camera shifted by three metres MCMF and rotated about its own axes by a vector of
        three radians.
        """
        six = np.asarray(correction, dtype=np.float64)
        return replace(
            self,
            position_mcmf_m=self.position_mcmf_m + six[:3],
            rotation_mcmf_to_camera=by_vector(six[3:]) @ self.rotation_mcmf_to_camera,
        )

    def project(self, points_mcmf_m: ArrayLike) -> Array:
        """Pixels (..., 2), column and row, of MCMF points (..., 3); NaN for points that are not in
        front of the camera.

        Far outside the image a distortion polynomial can fold back: such points are NaN as well
        (see `in_image`).
        """
        points = np.asarray(points_mcmf_m, dtype=np.float64)
        return self.focal_plane.pixels(
            (points - self.position_mcmf_m) @ self.rotation_mcmf_to_camera.T
        )

    def towards(self, points_mcmf_m: ArrayLike) -> Array:
        """Unit directions (..., 3) from points (..., 3) to the camera."""
        away = self.position_mcmf_m - np.asarray(points_mcmf_m, dtype=np.float64)
        return np.asarray(away / np.linalg.norm(away, axis=-1, keepdims=True))

    def rays(self, pixels: ArrayLike) -> Array:
        """Unit MCMF directions (..., 3) of the rays of pixels (..., 2).

        CameraError where the distortion has no inverse within the image.
        """
        given = np.asarray(pixels, dtype=np.float64)
        looking = self.focal_plane.directions(given)
        if (np.isnan(looking).any(axis=-1) & np.isfinite(given).all(axis=-1)).any():
            self._refuse("distortion", "has no inverse within the image")
        return looking @ self.rotation_mcmf_to_camera

    def looks(self, pixels: ArrayLike) -> tuple[Array, Array]:
        """Origins and unit directions of the rays of pixels (..., 2), both (..., 3), MCMF."""
        directions = self.rays(pixels)
        return np.broadcast_to(self.position_mcmf_m, directions.shape), directions

    def rays_enu(self, frame: EnuFrame) -> tuple[Array, Array]:
        """Position of the camera (3,) and unit direction of every pixel (rows, columns, 3) in an
        ENU frame.
        """
        rows, columns = self.shape
        row, column = np.mgrid[0:rows, 0:columns].astype(np.float64)
        directions = frame.direction_from_mcmf(self.rays(np.stack([column, row], axis=-1)))
        return frame.from_mcmf(self.position_mcmf_m), directions


def _too_near(away_m: float, sun: Array, position: Array) -> str:
    """What is wrong with a position of the Sun at a distance."""
    if np.linalg.norm(sun - position) < 0.1 * np.linalg.norm(position):
        why = "it is the camera's own place"
    elif _SUN_M[0] < 1e3 * away_m < _SUN_M[1]:
        why = "these are kilometres; give metres"
    elif abs(away_m - 1.0) < 1e-3:
        why = "this is a direction; multiply it by 1.5e11"
    else:
        why = "it must be in metres from the Moon's centre"
    return f"is too near for the Sun, which is 1.5e11 m away: {why}"


def _no_rotation(given: Array) -> str:
    """What is wrong with a matrix (3, 3) that is not orthonormal."""
    lengths = np.linalg.norm(given, axis=1)
    found = "is not a rotation: its rows are not orthonormal"
    if (np.abs(lengths - 1.0) > _ROTATION_TOLERANCE).any():
        return f"{found}: they have lengths {', '.join(f'{one:.6g}' for one in lengths)}, not 1 (unit rows: right, down, ahead)"
    angles = [
        math.degrees(math.acos(np.clip(given[i] @ given[k], -1.0, 1.0)))
        for i, k in ((0, 1), (0, 2), (1, 2))
    ]
    return f"{found}: they are {', '.join(f'{one:.4g}' for one in angles)} deg apart, not 90"


def _shown(value: Any) -> str:
    """A value of a file as JSON, shortened."""
    text = json.dumps(value.tolist() if isinstance(value, np.ndarray) else value, default=repr)
    return text if len(text) <= 40 else f"{text[:36]} ..."


_NEEDED = (
    "position_mcmf_m", "rotation_mcmf_to_camera", "focal_length_px", "principal_point_px", "image_size_px",
)  # fmt: skip
_OPTIONAL = ("distortion", "sun_position_mcmf_m", "time_utc", "lens")
_NOTE = "simulated"
"""Key of a simulated frame's camera that says how the frame was made; not read."""


def camera_from_json(document: Any, name: str = "camera") -> Camera:
    """The camera of the content of a CAMERA.json. CameraError for unknown keys, too, with the key that is alike."""
    if not isinstance(document, Mapping):
        raise CameraError(f"{name}: a camera file holds one JSON object")
    if document.keys().isdisjoint(_NEEDED):
        has = f"the keys {_shown([*document])}" if document else "no key"
        raise CameraError(
            f"{name}: is no camera: has {has}, a camera has {', '.join(_NEEDED)}; give a CAMERA.json, a USGS ISD or a .tsai file"
        )
    if unknown := unknown_keys(document.keys() - {SCHEMA}, (*_NEEDED, *_OPTIONAL, _NOTE)):
        raise CameraError(f"{name}: has {unknown}")
    missing = [key for key in _NEEDED if key not in document]
    if missing:
        raise CameraError(f"{name}: lacks {', '.join(missing)}")
    found = {key: document[key] for key in _NEEDED}
    found |= {key: document[key] for key in _OPTIONAL if document.get(key) is not None}
    if "lens" in found:
        try:
            found["lens"] = lens_from_json(found["lens"])
        except ValueError as error:
            raise CameraError(f"{name}: lens {error}") from error
    # the document's keys are the fields of a camera, checked above
    return Camera(**found, name=name)


def fields_of_plane(plane: FocalPlane) -> dict[str, Any]:
    """The fields of the `Camera` that has a focal plane."""
    lens = plane.lens
    found: dict[str, Any] = {
        "focal_length_px": plane.focal_length_px,
        "principal_point_px": plane.principal_point_px,
    }
    if isinstance(lens, NoLens | OpenCV):
        numbers = lens if isinstance(lens, OpenCV) else OpenCV()
        return found | {"distortion": [numbers.k1, numbers.k2, numbers.p1, numbers.p2, numbers.k3]}
    return found | {"lens": lens}
