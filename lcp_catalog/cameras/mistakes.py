"""Frequent mistakes in a camera file, recognised by undoing them: other axes, a transposed rotation, angles in
degrees that were taken as radians, longitude and latitude exchanged; and numbers that are hardly those of a camera.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import Array
from ..constants import MOON_RADIUS_M
from ..ephemeris.solar_position import SUNS_DIFFER_DEG, sun_direction_at
from ..geometry.bounds import turned_deg, wrapped_deg
from ..geometry.frames import enu_rotation, lonlat_to_mcmf, mcmf_to_lonlat
from ..geometry.sphere_intersection import hits
from .frame_camera import Camera
from .sensor import Sensor
from .view import border_and_inside

_ALIKE_DEG = 5.0
"""Directions that are no further apart count as the same. Two random ones are with a probability of 0.2 %."""

_DOWN_DEG = 10.0
"""Greatest angle off nadir of a camera that looks down. A random one does so with a probability of 0.8 %."""

_GRID = 17
"""Rays along each side of an image that are tried, and along its inside."""

_MOST = 3
"""Most candidates that are named."""

_WIDEST_DEG = 120.0
"""Widest field of view that is not doubted; wider ones are rather a focal length in millimetres."""

_OFF_CENTRE = 0.2
"""Greatest distance of a principal point from the image's centre that is not doubted, in widths and heights."""

_DEEPEST_M = 20e3
"""Greatest depth of a camera below the reference sphere; the deepest ground of the Moon lies 9.1 km below it."""

_OPENGL = "the axes of OpenGL or Blender (right, up, backwards)"
_AXES = {
    _OPENGL: [[1, 0, 0], [0, -1, 0], [0, 0, -1]],
    "the axes of a body (ahead, left, up)": [[0, -1, 0], [0, 0, -1], [1, 0, 0]],
    "the axes of a body (ahead, right, down)": [[0, 1, 0], [0, 0, 1], [1, 0, 0]],
}
"""Rotations from other axes to right, down, ahead, whole numbers."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """A camera without a mistake that its file may have: the ``mistake`` as a phrase with what undoes it."""

    mistake: str
    camera: Camera

    @cached_property
    def off_nadir_deg(self) -> float:
        """Angle between the optical axis and the vertical below the camera."""
        return off_nadir_deg(self.camera)

    @cached_property
    def place(self) -> Array:
        """Where the optical axis meets the reference sphere, MCMF (3,); NaN for sky."""
        return hits(self.camera.position_mcmf_m, self.camera.rotation_mcmf_to_camera[2])[1]

    @property
    def looks_at_ground(self) -> bool:
        """True if the optical axis meets the reference sphere."""
        return bool(np.isfinite(self.place).all())

    def __str__(self) -> str:
        """The mistake, and where the camera then looks."""
        at = place_text(self.place)
        return f"{self.mistake} (then it looks at {at}, {self.off_nadir_deg:.0f} deg off nadir)"


def place_text(position_m: ArrayLike) -> str:
    """Longitude and latitude of a place (3,), MCMF."""
    lon, lat, _ = mcmf_to_lonlat(position_m)
    return f"longitude {lon:.2f}, latitude {lat:.2f}"


Sees = Callable[[Camera], bool]
"""True for a camera that sees what it should."""


def likely_mistake(camera: Sensor, sees: Sees, also: Sees | None = None) -> str:
    """The mistakes that explain why a camera does not see what it should, each with what undoes it and where the
    camera then looks; empty for one that does, for a scanner, and if none of the known ones explains it. At most
    `_MOST` are named: those after which the camera looks down, or else those after which its axis meets the ground
    and its image's middle sees what it should, which a wide image does by chance at its edge. ``sees``: True for a
    camera that does, like `sees_moon`; ``also``: what one without the mistake must see, too, like a catalogue.
    """
    if not isinstance(camera, Camera) or sees(camera):
        return ""
    found = [
        one
        for one in candidates(camera)
        if one.looks_at_ground and sees(one.camera) and (also is None or also(one.camera))
    ]
    likely = [one for one in found if looks_down(one.camera)]
    likely = likely or [one for one in found if sees(_middle(one.camera))]
    likely.sort(key=lambda one: one.off_nadir_deg)
    return "; or ".join(map(str, likely[:_MOST]))


def blindness(camera: Camera, also: Sees | None = None) -> str:
    """Why a camera sees nothing of the Moon, and what would help; empty for one that sees some of it, and for one
    that looks away without a known mistake (`likely_mistake`).
    """
    depth_m = MOON_RADIUS_M - float(np.linalg.norm(camera.position_mcmf_m))
    if depth_m > _DEEPEST_M:
        return (
            f"position_mcmf_m lies {1e-3 * depth_m:.1f} km below the reference sphere of {MOON_RADIUS_M / 1e3:g} km, "
            "deeper than any ground: give the distance from the Moon's centre, not a height"
        )
    mistake = likely_mistake(camera, sees_moon, also)
    return f"the camera sees nothing of the Moon: {mistake}" if mistake else ""


def if_looking_down(camera: Camera, also: Sees | None = None) -> str:
    """The mistakes without which a camera looks down, which one that is to look aside does by chance; empty for one
    that looks down (`likely_mistake`).
    """
    mistake = likely_mistake(camera, looks_down, also)
    return f"if the camera is to look down: {mistake}" if mistake else ""


def two_suns(camera: Sensor) -> str:
    """That the Sun's place in a camera file is far from that of its time; empty if not, or if one is lacking."""
    place, time = camera.sun_position_mcmf_m, camera.time_utc
    if place is None or time is None:
        return ""
    apart = math.degrees(math.acos(min(1.0, float(_unit(place) @ sun_direction_at(time)))))
    if apart <= SUNS_DIFFER_DEG:
        return ""
    return (
        f"sun_position_mcmf_m is {apart:.1f} deg from the Sun at time_utc {time}; the position is used: correct one of "
        "them, or leave it out"
    )


def doubts(camera: Camera) -> list[str]:
    """What is hardly so in a camera, as phrases about its fields: two Suns, a focal length in millimetres, a principal point
    or an image size of another convention.
    """
    found = [text] if (text := two_suns(camera)) else []
    focal, (width, height) = camera.focal_length_px, camera.image_size_px
    widest = 2.0 * math.degrees(math.atan(0.5 * max(width, height) / focal))
    if widest > _WIDEST_DEG:
        found.append(
            f"focal_length_px {focal:g} makes a field of view of {widest:.0f} deg over {max(width, height)} pixels: "
            "is it in millimetres? divide it by the pixel's size in millimetres"
        )
    point, size = np.array(camera.principal_point_px), np.array([width, height])
    middle = 0.5 * (size - 1)
    if (np.abs(point - middle) > _OFF_CENTRE * size).any():
        turned = (np.abs(point - middle[::-1]) <= _OFF_CENTRE * size[::-1]).all()
        asked = (
            "are width and height exchanged in image_size_px?"
            if turned
            else "is it an offset from the centre (add the centre), or image_size_px that of another image?"
        )
        found.append(
            f"principal_point_px [{point[0]:g}, {point[1]:g}] is {np.linalg.norm(point - middle):.0f} pixels from the "
            f"image's centre [{middle[0]:g}, {middle[1]:g}]: {asked}"
        )
    return found


def sees_moon(camera: Camera) -> bool:
    """True if a ray of a grid over the image, without the lens's distortion, meets the reference sphere; also
    for a camera below it.
    """
    if np.linalg.norm(camera.position_mcmf_m) <= MOON_RADIUS_M:
        return True
    pinhole = replace(camera, distortion=np.zeros(5), lens=None)
    pixels = border_and_inside(camera.shape, _GRID)
    return bool(np.isfinite(hits(*pinhole.looks(pixels))[0]).any())


def looks_down(camera: Camera) -> bool:
    """True if the optical axis is within `_DOWN_DEG` of the vertical below the camera."""
    return off_nadir_deg(camera) < _DOWN_DEG


def _middle(camera: Camera) -> Camera:
    """The camera with no more of its image than `_DOWN_DEG` about the middle."""
    whole = np.array(camera.image_size_px)
    reach = math.ceil(2.0 * camera.focal_length_px * math.tan(math.radians(_DOWN_DEG)))
    size = np.minimum(whole, reach)
    point = camera.principal_point_px - 0.5 * (whole - size)
    return replace(camera, image_size_px=tuple(size), principal_point_px=tuple(point))


def off_nadir_deg(camera: Camera) -> float:
    """Angle between the optical axis and the vertical below the camera, degrees."""
    cosine = -_unit(camera.position_mcmf_m) @ camera.rotation_mcmf_to_camera[2]
    return math.degrees(math.acos(min(1.0, max(-1.0, float(cosine)))))


def candidates(camera: Camera) -> Iterator[Candidate]:
    """The camera after each of the known mistakes is undone."""
    yield from _by_angles(camera)
    given = camera.rotation_mcmf_to_camera
    yield _turned(camera, given.T, "seems to take camera axes to MCMF: give its transpose")
    tried = [(given, "it", axes) for axes in _AXES] + [(given.T, "its transpose", _OPENGL)]
    for rotation, how, axes in tried:
        text = f"seems to have {axes}: multiply {how} from the left by {_AXES[axes]}"
        yield _turned(camera, np.array(_AXES[axes], np.float64) @ rotation, text)


def _turned(camera: Camera, rotation: Array, text: str) -> Candidate:
    return Candidate(
        f"rotation_mcmf_to_camera {text}", replace(camera, rotation_mcmf_to_camera=rotation)
    )


def _by_angles(camera: Camera) -> Iterator[Candidate]:
    """The camera after a mistake in a longitude and a latitude is undone."""
    up, ahead = _unit(camera.position_mcmf_m), camera.rotation_mcmf_to_camera[2]
    distance = float(np.linalg.norm(camera.position_mcmf_m))
    if _alike(ahead, wrong := -_by_degrees_as_radians(up)):
        taken = -wrong[np.argmax(wrong @ ahead)]
        yield _turned(
            camera,
            _carried(camera.rotation_mcmf_to_camera, taken, up),
            "looks down at the place whose longitude and latitude are those below the camera in degrees, taken as "
            "radians: convert the angles to radians",
        )
    if _alike(up, _by_degrees_as_radians(-ahead)):
        yield Candidate(
            "position_mcmf_m lies above the place whose longitude and latitude are those that the rotation looks "
            "down at in degrees, taken as radians: convert the angles to radians",
            replace(camera, position_mcmf_m=-distance * ahead),
        )
    lon, lat, _ = mcmf_to_lonlat(camera.position_mcmf_m)
    if abs(wrapped_deg(float(lon))) <= 90.0:
        other = lonlat_to_mcmf(lat, wrapped_deg(float(lon))) / MOON_RADIUS_M
        moved = replace(camera, position_mcmf_m=distance * other)
        says = f"lies above {place_text(up)}: exchange the two"
        yield Candidate(f"position_mcmf_m {says}", moved)
        carried = _carried(camera.rotation_mcmf_to_camera, up, other)
        yield Candidate(
            f"position_mcmf_m {says}, for rotation_mcmf_to_camera, too",
            replace(moved, rotation_mcmf_to_camera=carried),
        )


def _carried(rotation: Array, here: Array, there: Array) -> Array:
    """A rotation from MCMF (3, 3) after the east-north-up axes of a place, a direction (3,), are replaced by those
    of another.
    """
    old, new = (enu_rotation(*mcmf_to_lonlat(one)[:2]) for one in (here, there))
    return np.asarray(rotation @ old.T @ new)


def _by_degrees_as_radians(up: Array) -> Array:
    """Directions (2, 3) that a program gets for the longitude and latitude of a direction, in degrees, if it
    takes them as radians: for a longitude within -180..180 and within 0..360.
    """
    lon, lat, _ = mcmf_to_lonlat(MOON_RADIUS_M * up)
    longitudes = np.degrees([wrapped_deg(lon), turned_deg(lon)])
    return _unit(lonlat_to_mcmf(longitudes, np.degrees([lat, lat])))


def _unit(vectors: ArrayLike) -> Array:
    given = np.asarray(vectors, dtype=np.float64)
    return np.asarray(given / np.linalg.norm(given, axis=-1, keepdims=True))


def _alike(direction: Array, others: Array) -> bool:
    """True if a unit direction (3,) is within `_ALIKE_DEG` of one of the others; (3,) or (n, 3)."""
    return bool((others @ direction > np.cos(np.radians(_ALIKE_DEG))).any())
