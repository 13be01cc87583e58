"""The request of a render: area, Sun, view, reflectance model, light, accuracy.

A render in front of a background, with the terrain's shadow on it.

Pixels of the camera that miss the terrain show the background: an image taken from the same position, or
the environment map. The terrain's shadow on a horizontal plane at a height of the area's ENU frame darkens
the background (Voloboy et al. 2006, section 2.2), by the ratio of the irradiance of the plane with and
without the terrain. The plane itself is transparent and casts no shadow.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..accuracy import TIERS, Accuracy
from ..arrays import Array
from ..cameras.frame_camera import Camera
from ..cameras.scanners import Scanner
from ..cameras.sensor import Sensor
from ..cameras.view import View, oblique_view, sensor_view, stated_direction
from ..choices import GSD_MAX_M, SURFACES
from ..constants import MOON_RADIUS_M
from ..dem.mosaic import DemSet
from ..errors import AreaError, CameraError, ConfigError, DemError, ImageError
from ..geometry.bounds import turned_deg
from ..geometry.frames import Direction, EnuFrame
from ..light.environment import Environment
from ..light.environment_map import LuminanceImage, Panorama, read_picture, resized
from ..light.sky_sampling import samples_of
from ..light.solar_disc import disc_directions
from ..light.sources import Lighting, earth_at, mean_earth
from ..light.sun_choice import SunChoice
from ..photometry.albedo_map import AlbedoMap, ColourMap
from ..photometry.laws import Reflectance
from ..stages import timed
from ..terrain.area import Area
from ..terrain.far_terrain import HorizonPoints
from ..terrain.terrain import Terrain
from .renderer import Rendering

WHITE_PERCENTILE = 99.5
"""Percentile of the lit radiance that is the white of an 8 or 16 bit background, as in a preview."""

_SHAPE = 0.01  # greatest relative difference between the aspect ratios of background and camera
_CHUNK = 1 << 18


@dataclass(frozen=True, eq=False)
class Backdrop:
    """The background of a render. ``catcher_m``: ENU z of the plane that receives shadows, None for no
    plane; ``picture``: None for the environment map; ``white``: radiance factor of the picture's value
    1, None for `white_of`; ``files``: files that were read.
    """

    catcher_m: float | None = None
    picture: LuminanceImage | None = None
    white: float | None = None
    files: tuple[Path, ...] = ()

    @classmethod
    def open(
        cls, catcher_m: float | None, path: Path | str | None, white: float | None
    ) -> Backdrop:
        """Read the picture, if there is one. ImageError if it cannot be read."""
        if path is None:
            return cls(catcher_m)
        return cls(catcher_m, read_picture(path), white, (Path(path),))

    def white_of(self, radiance: NDArray[np.floating]) -> float:
        """The radiance factor of the picture's value 1: as given; else 1 for linear pictures and the white of
        the render's preview for 8 and 16 bit pictures.
        """
        if self.white is not None:
            return self.white
        if self.picture is None or not self.picture.encoded:
            return 1.0
        lit = radiance[radiance > 0.0]
        return float(np.percentile(lit, WHITE_PERCENTILE)) if lit.size else 1.0

    def resolution(self, camera: Camera, panorama: Panorama | None) -> tuple[str, float]:
        """Name of the background and the width of its pixel at the middle of a camera's image, in
        pixels of the camera; ``panorama``: the background without a picture.
        """
        if self.picture is not None:
            return self.picture.name, camera.shape[1] / self.picture.luminance.shape[1]
        assert panorama is not None
        return panorama.name, panorama.pixel_rad * camera.focal_length_px


@timed("background")
def composite(
    photo: Rendering,
    terrain: Terrain,
    camera: Camera,
    light: Lighting,
    backdrop: Backdrop,
    panorama: Panorama | None,
    accuracy: Accuracy,
) -> Array:
    """The render where terrain is visible, the shaded background elsewhere; (rows, cols) of the camera.

    ``panorama``: the background without a picture, in radiance factors over pi. ImageError for a
    background with another aspect ratio, CameraError for a camera below the plane.
    """
    seen = np.asarray(photo.visible, dtype=np.bool_)
    origin, rays = camera.rays_enu(terrain.frame)
    if backdrop.picture is not None:
        _require_shape(backdrop.picture, camera)
        behind = resized(backdrop.picture.luminance, camera.shape)
        behind = behind * backdrop.white_of(photo.radiance)
    else:
        assert panorama is not None
        behind = math.pi * panorama.at(rays)
    out = np.where(seen, photo.radiance, behind)
    if backdrop.catcher_m is None:
        return out
    if origin[2] <= backdrop.catcher_m:
        raise CameraError(
            f"{camera.name}: the camera's height in the area's frame, {origin[2]:.6g} m, is not above the shadow "
            f"catcher at {backdrop.catcher_m:g} m"
        )
    missed = ~seen & (rays[..., 2] < 0.0)
    reach = (backdrop.catcher_m - origin[2]) / rays[missed][:, 2]
    points = origin + reach[:, None] * rays[missed]
    out[missed] *= shadow_factor(terrain, points, light, accuracy)
    return out


def shadow_factor(terrain: Terrain, points_m: Array, light: Lighting, accuracy: Accuracy) -> Array:
    """Ratio of the irradiance of horizontal surfaces at ENU points (n, 3) with and without the terrain,
    0..1; 1 where no light reaches them.
    """
    lights = [
        (direction, irradiance * direction[2])
        for direction, irradiance in _lights(light, accuracy)
        if direction[2] > 0.0 and irradiance > 0.0
    ]
    whole = math.fsum(level for _, level in lights)
    out = np.ones(len(points_m))
    if whole <= 0.0:
        return out
    for first in range(0, len(points_m), _CHUNK):
        part = HorizonPoints(terrain.field, points_m[first : first + _CHUNK], terrain.far)
        hidden = np.zeros(len(part))
        for direction, level in lights:
            hidden += level * part.occluded(direction)
        out[first : first + _CHUNK] = np.clip(1.0 - hidden / whole, 0.0, 1.0)
    return out


def _lights(light: Lighting, accuracy: Accuracy) -> Iterator[tuple[Array, float]]:
    """Directions and irradiances that sample all light; a disc by directions of equal flux."""
    for source in light.sources:
        if source.disc is None:
            yield source.direction.vector, source.irradiance
            continue
        directions = disc_directions(source.direction, source.disc, accuracy)
        for direction in directions:
            yield direction, source.irradiance / len(directions)
    if light.sky is not None:
        samples = samples_of(light.sky, accuracy)
        for azimuth in range(len(samples.azimuths)):
            for direction in samples.directions(azimuth):
                yield direction, samples.irradiance


def _require_shape(picture: LuminanceImage, camera: Camera) -> None:
    (rows, cols), (height, width) = picture.luminance.shape, camera.shape
    if abs(math.log(cols * height / (rows * width))) > _SHAPE and (rows, cols) != (height, width):
        raise ImageError(
            f"{picture.name}: the aspect ratio of {cols} x {rows} pixels differs from the camera's "
            f"{width} x {height}"
        )


@dataclass(frozen=True)
class ViewAngles:
    """A view by its angles at the area's centre, degrees; without an altitude from infinity. By default
    straight down.
    """

    off_nadir_deg: float = 0.0
    view_azimuth_deg: float = 0.0
    altitude_km: float | None = None

    @classmethod
    def stated(
        cls,
        camera: object,
        off_nadir_deg: float | None,
        view_azimuth_deg: float | None,
        altitude_km: float | None,
    ) -> ViewAngles:
        """The angles of a request. ConfigError for half of a direction, and for angles or an altitude beside a camera."""
        if camera is not None and {off_nadir_deg, view_azimuth_deg, altitude_km} != {None}:
            raise ConfigError(
                "`camera` excludes `off_nadir_deg`, `view_azimuth_deg` and `altitude_km`"
            )
        return cls(*stated_direction(off_nadir_deg, view_azimuth_deg), altitude_km)


@dataclass(frozen=True)
class ViewChoice:
    """The view of a request: a framing camera, another sensor, or angles."""

    seen_by: Sensor | ViewAngles = ViewAngles()

    @property
    def sensor(self) -> Sensor | None:
        """The framing camera or other sensor, if there is one."""
        return None if isinstance(self.seen_by, ViewAngles) else self.seen_by

    @property
    def camera(self) -> Camera | None:
        """The sensor, if it is a framing camera."""
        return self.seen_by if isinstance(self.seen_by, Camera) else None

    @property
    def scanner(self) -> Scanner | None:
        """The sensor, if it is a scanner."""
        return self.seen_by if isinstance(self.seen_by, Scanner) else None

    @property
    def plane(self) -> Camera | Scanner | None:
        """The camera or scanner whose pixels can be rendered."""
        return self.camera or self.scanner

    def view(self, frame: EnuFrame) -> View:
        """The view in the axes of an area's frame."""
        if not isinstance(self.seen_by, ViewAngles):
            return sensor_view(self.seen_by, frame)
        altitude_km = self.seen_by.altitude_km
        altitude_m = None if altitude_km is None else 1e3 * altitude_km
        return oblique_view(self.seen_by.off_nadir_deg, self.seen_by.view_azimuth_deg, altitude_m)


Extent = tuple[float, float, float, float]
"""Least x, greatest x, least y, greatest y in the plane of a frame, metres."""

SIZE_MAX_KM = 4 * MOON_RADIUS_M / 1e3
"""Greatest side of an area: twice the diameter of the Moon."""


@dataclass(frozen=True)
class SphereArea:
    """A rectangle of the tangent plane at a place, up to wider than the Moon; the counterpart of `Area`.
    ``size_km``: east-west, north-south.
    """

    lon_deg: float
    lat_deg: float
    size_km: tuple[float, float]

    def __post_init__(self) -> None:
        if not all(0.0 < side <= SIZE_MAX_KM for side in self.size_km):
            raise AreaError(
                f"a size of {self.size_km[0]:g} x {self.size_km[1]:g} km is not above 0 and at most "
                f"{SIZE_MAX_KM:.0f} km"
            )

    @property
    def frame(self) -> EnuFrame:
        """The frame at its centre, on the sphere."""
        return EnuFrame(turned_deg(self.lon_deg), self.lat_deg)

    @property
    def extent_m(self) -> Extent:
        """Least x, greatest x, least y, greatest y in its frame."""
        east, north = (500.0 * side for side in self.size_km)
        return -east, east, -north, north


@dataclass(frozen=True)
class AreaInView:
    """A square area of ``size_km`` around the place where the optical axis of the request's camera meets
    the surface (``axis``), or around the middle of the camera's footprint.
    """

    size_km: float
    axis: bool = False


@dataclass(frozen=True)
class Request:
    """The request of one image; `rendering.pipeline.render` renders it.

    dems: DEMs; none are needed for ``surface="sphere"``. area: None for what the camera sees,
    else the whole DEM. gsd_m: cell size; None for that of the DEM. sun: the Sun; by default the
    camera's own. in_camera_plane: True for the pixels of the camera, False for the nodes of the area.
    model: reflectance model; None to choose it by the scene's phase angles. disc: True for the Sun's
    disc, False for a point; None for the tier's default. surface: "auto", "heightfield" or "sphere".
    environment: an environment map in place of the Sun. earthshine: True to add the Earth's light.
    backdrop: a background behind the terrain.
    AreaError for a cell size that is not positive.
    """

    dems: DemSet | None = None
    area: Area | SphereArea | AreaInView | None = None
    gsd_m: float | None = None
    sun: SunChoice = SunChoice()  # noqa: RUF009  frozen, so it can be shared
    view: ViewChoice = ViewChoice()
    in_camera_plane: bool = False
    model: Reflectance | None = None
    accuracy: Accuracy = TIERS["standard"]
    disc: bool | None = None
    albedo: AlbedoMap | ColourMap | None = None
    surface: str = SURFACES[0]
    environment: Environment | None = None
    earthshine: bool = False
    backdrop: Backdrop | None = None
    bounce: str = "off"
    """Light that reaches ground by way of other ground: one of `choices.BOUNCES`."""

    def __post_init__(self) -> None:
        if self.gsd_m is not None and not 0.0 < self.gsd_m <= GSD_MAX_M:
            raise AreaError(
                f"invalid cell size {self.gsd_m:g} m: `gsd_m` must be above 0 and at most {GSD_MAX_M:g} m"
            )

    @property
    def ground(self) -> DemSet:
        """The DEMs. DemError if there are none."""
        if self.dems is None:
            raise DemError("no DEM was given")
        return self.dems

    def lighting(self, frame: EnuFrame) -> Lighting:
        """The light sources in a frame's axes: the environment map alone, or the Sun and, with
        ``earthshine``, the Earth.
        """
        if self.environment is not None:
            return self.environment.lighting
        camera = self.view.sensor
        to_sun = self.sun.direction_mcmf(frame, camera)
        self.sun.warn_of(frame, camera)
        disc = self.sun.disc(frame, camera) if self.sun_is_disc else False
        light = Lighting.of_sun(Direction.from_mcmf(to_sun, frame), disc)
        if not self.earthshine:
            return light
        time = self.sun.instant(camera)
        earth = mean_earth(to_sun) if time is None else earth_at(time)
        return light.with_source(earth.source(frame, self.sun_is_disc))

    @property
    def sun_is_disc(self) -> bool:
        """True if the Sun is a disc, False if it is a point."""
        return self.accuracy.disc if self.disc is None else self.disc
