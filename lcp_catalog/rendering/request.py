"""The request of a render: area, Sun, view, reflectance model, light, accuracy."""

from __future__ import annotations

from dataclasses import dataclass

from ..accuracy import TIERS, Accuracy
from ..cameras.frame_camera import Camera
from ..cameras.scanners import Scanner
from ..cameras.sensor import Sensor
from ..cameras.view import View, oblique_view, sensor_view
from ..choices import GSD_MAX_M, SURFACES
from ..constants import MOON_RADIUS_M
from ..dem.mosaic import DemSet
from ..errors import AreaError, DemError
from ..geometry.bounds import turned_deg
from ..geometry.frames import Direction, EnuFrame
from ..light.environment import Environment
from ..light.sources import Lighting, earth_at, mean_earth
from ..light.sun_choice import SunChoice
from ..photometry.albedo_map import AlbedoMap, ColourMap
from ..photometry.laws import Reflectance
from ..terrain.area import Area
from .compositing import Backdrop


@dataclass(frozen=True)
class ViewAngles:
    """A view by its angles at the area's centre, degrees; without an altitude from infinity. By default
    straight down.
    """

    off_nadir_deg: float = 0.0
    view_azimuth_deg: float = 0.0
    altitude_km: float | None = None


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
