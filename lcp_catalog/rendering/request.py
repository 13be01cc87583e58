"""What a render is asked for: area, Sun, view, law, light, accuracy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ..accuracy import TIERS, Accuracy
from ..cameras.frame_camera import Camera
from ..cameras.sensor import Sensor
from ..cameras.view import View, camera_view, oblique_view, sensor_view
from ..choices import SURFACES
from ..geometry.direction import Direction
from ..geometry.frames import EnuFrame
from ..light.earthshine import earth_at, mean_earth
from ..light.environment import Environment
from ..light.sources import Lighting
from ..light.sun_choice import SunChoice
from ..photometry.albedo_map import AlbedoMap
from ..photometry.laws import Reflectance
from ..terrain.area import Area
from .compositing import Backdrop
from .sphere_extent import Cap


@dataclass(frozen=True)
class ViewChoice:
    """From where: a camera, or angles at the area's centre (without an altitude from infinity);
    nothing: straight down. ``sensor``: one that is no camera (`view.sensor_view`).
    """

    camera: Camera | None = None
    off_nadir_deg: float = 0.0
    view_azimuth_deg: float = 0.0
    altitude_km: float | None = None
    sensor: Sensor | None = None

    def view(self, frame: EnuFrame) -> View:
        if self.sensor is not None:
            return sensor_view(self.sensor, frame)
        if self.camera is not None:
            return camera_view(self.camera, frame)
        altitude_m = None if self.altitude_km is None else 1e3 * self.altitude_km
        return oblique_view(self.off_nadir_deg, self.view_azimuth_deg, altitude_m)


@dataclass(frozen=True)
class Request:
    """What one render is to show. ``area`` None: what the camera sees, else the whole DEM;
    ``gsd_m`` None: the DEM's own; ``model`` None: as the scene wants; ``disc``, whether the Sun is one, None: as the accuracy says.
    """

    dem_paths: Sequence[Path | str]
    area: Area | Cap | None = None
    gsd_m: float | None = None
    sun: SunChoice = SunChoice()  # noqa: RUF009
    view: ViewChoice = ViewChoice()
    in_camera_plane: bool = False
    model: Reflectance | None = None
    accuracy: Accuracy = TIERS["standard"]
    disc: bool | None = None
    product_order: tuple[str, ...] = ()
    albedo: AlbedoMap | None = None
    surface: str = SURFACES[0]
    environment: Environment | None = None
    earthshine: bool = False
    backdrop: Backdrop | None = None

    def lighting(self, frame: EnuFrame) -> Lighting:
        """What lights the scene, in a frame's axes: the panorama alone; or the Sun, and the Earth
        where it is asked for.
        """
        if self.environment is not None:
            return self.environment.lighting
        camera = self.view.camera
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
        """Whether the Sun is a disc, or a point."""
        return self.accuracy.disc if self.disc is None else self.disc
