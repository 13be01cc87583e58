"""View direction or position of an area, and the footprint of a sensor."""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import Array
from ..constants import MOON_RADIUS_M
from ..errors import CameraError, ConfigError, ImageError
from ..geometry import sphere_intersection
from ..geometry.bounds import Bounds, enclosing_arc
from ..geometry.frames import EnuFrame, direction_enu, mcmf_to_lonlat
from .frame_camera import FARTHEST_M, Camera
from .scanners import Scanner
from .sensor import Sensor, middle_ray, pixel_size_m

log = logging.getLogger(__name__)

_UP = np.array([0.0, 0.0, 1.0])


class _ThroughImage:
    """Base of views: the image that limits the visible terrain."""

    camera: Camera | None = None

    @property
    def sensor(self) -> Camera | Scanner | None:
        """The framing camera or scanner whose image limits the visible terrain."""
        return self.camera


@dataclass(frozen=True, eq=False)
class ParallelView(_ThroughImage):
    """The view of an area from infinity, in a direction (3,) of its ENU frame. ``camera`` limits the
    visible terrain to its image. CameraError for a direction that is not finite.
    """

    direction: Array
    camera: Camera | None = None

    def __post_init__(self) -> None:
        _require_finite(self.direction)

    def directions(self, points_m: Array) -> Array:
        """The direction for ENU points (..., 3)."""
        return np.broadcast_to(self.direction, points_m.shape)

    def describe(self) -> dict[str, Any]:
        """JSON description: the camera file's content, or the ENU direction."""
        return self.camera.to_json() if self.camera else {"direction_enu": self.direction.tolist()}


@dataclass(frozen=True, eq=False)
class CameraView(_ThroughImage):
    """The view of an area from a position (3,) in its ENU frame, metres. ``camera`` limits the visible
    terrain to its image. CameraError for a position that is not finite.
    """

    position_m: Array
    camera: Camera | None = None

    def __post_init__(self) -> None:
        _require_finite(self.position_m)

    def directions(self, points_m: Array) -> Array:
        """Unit directions (..., 3) from ENU points (..., 3) to the camera; up at the position of the
        camera itself.
        """
        towards = self.position_m - points_m
        distance = np.linalg.norm(towards, axis=-1, keepdims=True)
        here = distance == 0.0
        return np.where(here, _UP, towards / np.where(here, 1.0, distance))

    def describe(self) -> dict[str, Any]:
        """JSON description: the camera file's content, or the ENU position."""
        if self.camera is not None:
            return self.camera.to_json()
        return {"position_enu_m": self.position_m.tolist()}


@dataclass(frozen=True, eq=False)
class MovingView(_ThroughImage):
    """The view of a sensor that moves during the exposure and whose image limits nothing, such as a map.

    ``direction`` (3,), that at the frame's origin, sets what is hidden; each point's own sets the
    brightness. CameraError if the sensor does not see the frame's origin.
    """

    moving: Sensor
    frame: EnuFrame

    @cached_property
    def direction(self) -> Array:
        """Direction at the frame's origin."""
        return self.directions(np.zeros(3))

    def __post_init__(self) -> None:
        if not np.isfinite(self.direction).all():
            raise CameraError(f"{self.moving.name}: does not see the centre of the area")

    def directions(self, points_m: Array) -> Array:
        """Unit directions (..., 3) from ENU points (..., 3) to the sensor."""
        return self.frame.direction_from_mcmf(self.moving.towards(self.frame.to_mcmf(points_m)))

    def describe(self) -> dict[str, Any]:
        """JSON description: the direction at the frame's origin."""
        return {"direction_enu": self.direction.tolist()}


@dataclass(frozen=True, eq=False)
class ScannerView(_ThroughImage):
    """The view of a scanner, which sees every line from another position: each point has its own
    direction, for its brightness and for what is hidden. The image limits the visible terrain.
    """

    scanner: Scanner
    frame: EnuFrame

    @property
    def sensor(self) -> Scanner:
        """The scanner."""
        return self.scanner

    @cached_property
    def direction(self) -> Array:
        """Direction (3,) to the scanner from what the middle of its image shows."""
        return np.asarray(-self.frame.direction_from_mcmf(middle_ray(self.scanner)[1]))

    @cached_property
    def lowest_tangent(self) -> float:
        """Tangent of the scanner's least elevation as seen from any point of its image."""
        _, looking = self.scanner.looks(border_and_inside(self.scanner.shape, 65))
        east, north, up = np.moveaxis(self.frame.direction_from_mcmf(looking), -1, 0)
        level = np.hypot(east, north)
        tangents = np.where(level > 0.0, -up / np.where(level > 0.0, level, 1.0), np.inf)
        return float(np.nanmin(tangents))

    def directions(self, points_m: Array) -> Array:
        """Unit directions (..., 3) from ENU points (..., 3) to the scanner."""
        return self.frame.direction_from_mcmf(self.scanner.towards(self.frame.to_mcmf(points_m)))

    def describe(self) -> dict[str, Any]:
        """JSON description: name, kind and size of the scanner."""
        rows, cols = self.scanner.shape
        name = Path(self.scanner.name).name
        return {"file": name, "kind": self.scanner.kind, "image_size_px": [cols, rows]}


View: TypeAlias = ParallelView | CameraView | MovingView | ScannerView
"""A view of an area, in its ENU frame."""


def _require_finite(where: Array) -> None:
    if not np.isfinite(where).all():
        raise CameraError(f"invalid view: {np.asarray(where).tolist()} is not finite")


def camera_view(camera: Camera, frame: EnuFrame) -> CameraView:
    """The view of a camera on an area."""
    return CameraView(frame.from_mcmf(camera.position_mcmf_m), camera)


def sensor_view(sensor: Sensor, frame: EnuFrame) -> View:
    """The view of any sensor on an area. CameraError for a sensor other than a framing camera or a
    scanner that does not see the frame's origin.
    """
    if isinstance(sensor, Camera):
        return camera_view(sensor, frame)
    return ScannerView(sensor, frame) if isinstance(sensor, Scanner) else MovingView(sensor, frame)


def finest_pixel_m(sensor: Sensor) -> float:
    """Least size of a pixel on the reference sphere, metres, at 9 x 9 pixels of the image; inf if it
    shows none of the sphere.
    """
    steps = (np.arange(9) + 0.5) / 9.0
    share = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    points = _on_sphere(*sensor.looks(share * sensor.shape[::-1] - 0.5))
    sizes = pixel_size_m(sensor, points)
    return float(sizes[np.isfinite(sizes)].min(initial=math.inf))


def stated_direction(
    off_nadir_deg: float | None, view_azimuth_deg: float | None
) -> tuple[float, float]:
    """The angles of a direction to the camera, degrees, straight down where None is stated. ConfigError for half of a direction."""
    if off_nadir_deg != 0.0 and (off_nadir_deg is None) != (view_azimuth_deg is None):
        raise ConfigError("`off_nadir_deg` and `view_azimuth_deg` go together")
    return off_nadir_deg or 0.0, view_azimuth_deg or 0.0


def oblique_view(
    off_nadir_deg: float, view_azimuth_deg: float, altitude_m: float | None = None
) -> ParallelView | CameraView:
    """View of the frame's origin from an azimuth, ``off_nadir_deg`` from the vertical at the
    origin.

    Without an altitude (above the reference sphere) the camera is at infinity. CameraError for
    angles outside 0..90 (excluded), and for an altitude that is not positive or beyond
    `frame_camera.FARTHEST_M`.
    """
    if not 0.0 <= off_nadir_deg < 90.0 or not math.isfinite(view_azimuth_deg):
        raise CameraError(f"invalid view: {off_nadir_deg} deg off nadir is not within 0..90")
    direction = direction_enu(view_azimuth_deg, 90.0 - off_nadir_deg)
    if off_nadir_deg == 0.0:
        direction = _UP.copy()  # exact: from above, no terrain is hidden
    if altitude_m is None:
        return ParallelView(direction)
    if not (math.isfinite(altitude_m) and altitude_m > 0):
        raise CameraError(f"invalid view: the altitude {altitude_m} m is not positive")
    if altitude_m > FARTHEST_M:
        raise CameraError(
            f"invalid view: the altitude is above {FARTHEST_M / 1e3:g} km; "
            "leave it out for a camera at infinity"
        )
    return CameraView(slant_range_m(off_nadir_deg, altitude_m) * direction)


def slant_range_m(off_nadir_deg: float, altitude_m: float) -> float:
    """Distance from a point of the sphere to a camera at an altitude, seen ``off_nadir_deg`` from
    the vertical at the point.
    """
    rise = MOON_RADIUS_M * math.cos(math.radians(off_nadir_deg))
    climb = altitude_m * (2 * MOON_RADIUS_M + altitude_m)
    return climb / (rise + math.sqrt(rise * rise + climb))


def looking_camera(
    frame: EnuFrame, position_m: ArrayLike, gsd_m: float, size_m: tuple[float, float]
) -> Camera:
    """A camera at an ENU position that looks at the frame's origin, with north up in the image.

    If it looks along north, up is away from the camera's nadir. ``gsd_m``: size of a pixel at the
    origin; ``size_m``: width and height of the image across the line of sight.
    """
    position = np.asarray(position_m, dtype=np.float64)
    distance = float(np.linalg.norm(position))
    optical = -position / distance
    right = np.cross(optical, [0.0, 1.0, 0.0])
    if np.linalg.norm(right) < 1e-9:
        right = np.cross(optical, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(optical, right), optical])
    width, height = (max(1, round(extent / gsd_m)) for extent in size_m)
    return Camera(
        position_mcmf_m=frame.to_mcmf(position),
        rotation_mcmf_to_camera=rotation @ frame.rotation,
        focal_length_px=distance / gsd_m,
        principal_point_px=((width - 1) / 2, (height - 1) / 2),
        image_size_px=(width, height),
        name="view",
    )


def pointed_camera(
    place_deg: tuple[float, float],
    altitude_m: float,
    look_deg: tuple[float, float],
    fov_deg: float,
    image_size_px: tuple[int, int],
) -> Camera:
    """A camera above a place (longitude, latitude), ``altitude_m`` above the reference sphere.

    ``look_deg``: azimuth of the optical axis, clockwise from north, and its elevation above the
    horizontal at the place; -90 is straight down. The image's rows are level, and its upper edge is
    up; straight down, the azimuth is that of the upper edge. ``fov_deg``: angle between the left and
    the right edge of the image, in its middle row. Pixels are square, the optical axis is in the
    image's middle. CameraError for a field of view outside 0..180 deg (excluded), an elevation outside
    -90..90 deg, and an altitude that is not positive or beyond `frame_camera.FARTHEST_M`.
    """
    azimuth_deg, elevation_deg = look_deg
    name = (
        f"camera {1e-3 * altitude_m:g} km above {place_deg[0]:g}, {place_deg[1]:g}, looking to azimuth "
        f"{azimuth_deg:g}, elevation {elevation_deg:g} deg"
    )
    if not 0.0 < fov_deg < 180.0:
        raise CameraError(f"{name}: a field of view of {fov_deg:g} deg is not within 0..180")
    if not (-90.0 <= elevation_deg <= 90.0 and math.isfinite(azimuth_deg)):
        raise CameraError(f"{name}: the elevation is not within -90..90, or no number")
    if not 0.0 < altitude_m <= FARTHEST_M:
        raise CameraError(f"{name}: the altitude is not within 0..{FARTHEST_M / 1e3:g} km")
    _warn_of_radians(name, altitude_m, azimuth_deg, elevation_deg)
    frame = EnuFrame(place_deg[0], place_deg[1])
    ahead = direction_enu(azimuth_deg, elevation_deg)
    right = direction_enu(azimuth_deg + 90.0, 0.0)
    rotation = np.stack([right, np.cross(ahead, right), ahead])
    width, height = image_size_px
    return Camera(
        position_mcmf_m=frame.to_mcmf([0.0, 0.0, altitude_m]),
        rotation_mcmf_to_camera=rotation @ frame.rotation,
        focal_length_px=0.5 * width / math.tan(math.radians(0.5 * fov_deg)),
        principal_point_px=((width - 1) / 2, (height - 1) / 2),
        image_size_px=(width, height),
        name=name,
    )


def optical_axis(sensor: Sensor) -> tuple[Array, Array]:
    """Origin and unit direction (3,), MCMF, of the optical axis of a framing camera; of another sensor
    the ray of the image's middle.
    """
    if isinstance(sensor, Camera):
        return sensor.position_mcmf_m, sensor.rotation_mcmf_to_camera[2]
    return middle_ray(sensor)


def center_of(sensor: Sensor, path: Path | str = "") -> tuple[float, float]:
    """Longitude and latitude, degrees, of the point of the sphere at the image's centre; ImageError
    where the centre shows sky.
    """
    origin, direction = middle_ray(sensor)
    nearest = -float(origin @ direction)
    half_chord = nearest**2 - float(origin @ origin) + MOON_RADIUS_M**2
    distance = nearest - math.sqrt(half_chord) if half_chord >= 0.0 else -math.inf
    if not distance >= 0.0:
        raise ImageError(
            f"{path or sensor.name}: {below_sphere(sensor) or 'its centre does not show the Moon'}, so that angles of the Sun "
            "have no reference place: give `time_utc` or `subsolar_deg`"
        )
    lon, lat, _ = mcmf_to_lonlat(origin + distance * direction)
    return float(lon), float(lat)


def footprint(sensor: Sensor, samples: int = 129) -> Bounds:
    """Bounds of what a sensor sees of the reference sphere; CameraError if it sees none of it or is
    below it.

    The image's border (4 x ``samples`` rays), its inside (about a quarter as dense), the limb (for
    a sensor with one position) and the poles are sampled; between samples the bounds fall short by
    at most the sagitta of the border.
    """
    positions, directions = sensor.looks(border_and_inside(sensor.shape, samples))
    if (np.linalg.norm(positions, axis=-1) <= MOON_RADIUS_M).any():
        raise CameraError(
            f"{sensor.name}: {below_sphere(sensor) or 'the camera is below the reference sphere'}, where its "
            "footprint is not computed: give `bounds`, or `center` and `size_km`"
        )
    seen = [_on_sphere(positions, directions)]
    if (positions == positions[0]).all():
        seen.append(_limb(sensor, positions[0], 8 * samples))
    poles = np.array([[0.0, 0.0, MOON_RADIUS_M], [0.0, 0.0, -MOON_RADIUS_M]])
    above = np.einsum("ij,ij->i", sensor.towards(poles), poles) > 0.0
    pole_seen = sensor.in_image(sensor.project(poles)) & above
    points = np.concatenate([*seen, poles[pole_seen]])
    if not len(points):
        raise sees_nothing(sensor)
    lon, lat, _ = mcmf_to_lonlat(points)
    if pole_seen.any():
        return Bounds(-180.0, float(lat.min()), 180.0, float(lat.max()))
    west, east = enclosing_arc(lon, lon)
    west, east = (west + 360.0, east + 360.0) if west < 0.0 else (west, east)
    return Bounds(west, float(lat.min()), east, float(lat.max()))


def below_sphere(sensor: Sensor) -> str:
    """That a sensor (its position in the image's middle) is below the reference sphere, by how much; empty if it is not."""
    depth_m = MOON_RADIUS_M - float(np.linalg.norm(optical_axis(sensor)[0]))
    if not depth_m >= 0.0:  # NaN: a map beside the Moon
        return ""
    radius = f"(radius {MOON_RADIUS_M / 1e3:g} km)"
    return f"the camera is {depth_m / 1e3:.2f} km below the reference sphere {radius}"


def sees_nothing(sensor: Sensor) -> CameraError:
    """The error for a sensor that sees none of the Moon; for a camera above the sphere it states where
    the horizon is.
    """
    where = ""
    if isinstance(sensor, Camera):
        away_m = float(np.linalg.norm(sensor.position_mcmf_m))
        if away_m > MOON_RADIUS_M:
            dip_deg = math.degrees(math.acos(MOON_RADIUS_M / away_m))
            where = f": from its height the Moon's limb is {dip_deg:.4g} deg below the horizontal"
    return CameraError(f"{sensor.name}: the camera does not see the Moon{where}")


def border_and_inside(shape: tuple[int, int], samples: int) -> Array:
    """Pixels (n, 2) along the border of an image of ``shape`` (rows, columns), ``samples`` on each side,
    and on a grid in it.
    """
    height, width = shape
    along = np.linspace(0.0, 1.0, samples)
    inner = np.linspace(0.0, 1.0, max(9, samples // 4))
    a, b = (grid.ravel() for grid in np.meshgrid(inner, inner))
    ends = np.concatenate([np.zeros_like(along), np.ones_like(along)])
    both = np.concatenate([along, along])
    share = np.concatenate(
        [np.stack([both, ends], -1), np.stack([ends, both], -1), np.stack([a, b], -1)]
    )
    return share * [width, height] - 0.5


def _on_sphere(positions: Array, directions: Array) -> Array:
    """First intersections of rays (n, 3) with the reference sphere, MCMF (m, 3), without rays that
    miss it and pixels that see nothing.
    """
    looking = np.isfinite(directions).all(axis=-1)
    distance, points = sphere_intersection.hits(positions[looking], directions[looking])
    return np.asarray(points[np.isfinite(distance)])


def _limb(sensor: Sensor, position: Array, samples: int) -> Array:
    """Points of the sphere's limb, seen from a position, that fall into the image, MCMF (n, 3)."""
    distance = np.linalg.norm(position)
    axis = position / distance
    first = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    first /= np.linalg.norm(first)
    second = np.cross(axis, first)
    turn = np.linspace(0.0, 2 * np.pi, samples, endpoint=False)[:, None]
    level = MOON_RADIUS_M / distance
    ring = math.sqrt(1 - level**2) * (np.cos(turn) * first + np.sin(turn) * second)
    limb = MOON_RADIUS_M * (level * axis + ring)
    return np.asarray(limb[sensor.in_image(sensor.project(limb))])


def _warn_of_radians(
    name: str, altitude_m: float, azimuth_deg: float, elevation_deg: float
) -> None:
    """Log a warning of a direction above the limb whose numbers are those of one towards the ground in radians."""
    limb_deg = -math.degrees(math.acos(MOON_RADIUS_M / (MOON_RADIUS_M + altitude_m)))
    meant = math.degrees(azimuth_deg), math.degrees(elevation_deg)
    if limb_deg < elevation_deg and -90.5 < meant[1] < limb_deg and abs(meant[0]) < 360.5:
        log.warning(
            "%s: that is above the limb (%.2f deg); in radians these numbers were azimuth %.4g, elevation %.4g deg: give degrees",
            *(name, limb_deg, *meant),
        )
