"""The Sun of a request: angles, a time, or the subsolar point."""

from __future__ import annotations

import datetime as dt
import logging
import math
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from ..arrays import Array
from ..cameras.sensor import Sensor
from ..ephemeris import solar_position
from ..ephemeris.times import AstropyTime, Time, instants
from ..errors import ConfigError, SunError
from ..geometry.frames import EnuFrame
from .solar_disc import MEAN_SUN, SolarDisc, radius_at

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class SunChoice:
    """The Sun, stated by its angles at the area's centre, by a time, or by the subsolar point.
    Without any of them the camera file's Sun applies. SunError for one angle alone, and for a Sun that
    is stated twice.

    Examples
    --------
    >>> lcp.Sun.at("1971-07-31T01:25:52").time_utc
    '1971-07-31T01:25:52Z'
    >>> sun = lcp.SunChoice(azimuth_deg=96.5, elevation_deg=14.0)
    >>> lcp.open_image(folder / "AS15-M-0414.png", camera, sun).sun_direction_mcmf.shape
    (3,)
    """

    azimuth_deg: float | None = None
    elevation_deg: float | None = None
    time_utc: str | None = None  # given as any `times.Time`
    subsolar_deg: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        if (self.azimuth_deg is None) != (self.elevation_deg is None):
            raise SunError("`sun_azimuth_deg` and `sun_elevation_deg` go together")
        if self.time_utc is not None and not isinstance(self.time_utc, str):
            object.__setattr__(self, "time_utc", instants(self.time_utc).labels()[0])
        stated = (self.azimuth_deg, self.time_utc, self.subsolar_deg)
        if sum(value is not None for value in stated) > 1:
            raise SunError(
                "state the Sun once: `sun_azimuth_deg` and `sun_elevation_deg`, or `time_utc`, or `subsolar_deg`"
            )

    @classmethod
    def of(cls, sun: SunStated) -> SunChoice:
        """The Sun as a function was given it: azimuth and elevation in degrees, an instant, or a choice.
        SunError for anything else.

        Examples
        --------
        >>> lcp.SunChoice.of((96.5, 14.0)) == lcp.SunChoice(azimuth_deg=96.5, elevation_deg=14.0)
        True
        """
        if isinstance(sun, SunChoice):
            return sun
        if isinstance(sun, dt.datetime | np.datetime64 | AstropyTime):
            return cls.at(sun)
        if sun is None or isinstance(sun, str):
            return cls(time_utc=sun)
        if not isinstance(sun, tuple) or len(sun) != 2:
            raise SunError(
                f"`sun` is azimuth and elevation, an instant or a SunChoice, not {sun!r}"
            )
        return cls(float(sun[0]), float(sun[1]))

    @classmethod
    def at(cls, time: Time) -> SunChoice:
        """The Sun at an instant, UTC if it has no time zone: ISO text, datetime, datetime64 or astropy's. SunError
        for an invalid time, KindError for another type.
        """
        return cls(time_utc=instants(time).labels()[0])

    @property
    def is_stated(self) -> bool:
        """False if the camera file's Sun applies."""
        return self != SunChoice()

    def beside(self, environment: object, disc: bool | None, earthshine: bool = False) -> SunChoice:
        """The choice itself. ConfigError where the Sun, ``disc`` or ``earthshine`` is stated beside an environment map (None:
        there is none), which replaces it.
        """
        if environment is not None and (self.is_stated or disc is not None):
            raise ConfigError("`environment` replaces the Sun: it excludes `sun` and `disc`")
        if environment is not None and earthshine:
            raise ConfigError("`environment` excludes `earthshine`")
        return self

    def direction_mcmf(self, frame: EnuFrame, camera: Sensor | None) -> Array:
        """Unit MCMF vector (3,) from a frame's origin to the Sun; SunError if there is no Sun."""
        if self.azimuth_deg is not None and self.elevation_deg is not None:
            return solar_position.direction_from_angles(frame, self.azimuth_deg, self.elevation_deg)
        if self.time_utc is not None:
            return solar_position.sun_direction_at(self.time_utc)
        if self.subsolar_deg is not None:
            return solar_position.direction_from_subsolar(*self.subsolar_deg)
        if camera is not None and camera.sun_position_mcmf_m is not None:
            return solar_position.direction_from_position(frame, camera.sun_position_mcmf_m)
        if camera is not None and camera.time_utc is not None:
            return solar_position.sun_direction_at(camera.time_utc)
        of_file = (
            ""
            if camera is None
            else f"{camera.name}: has neither sun_position_mcmf_m nor time_utc: "
        )
        raise SunError(f"{of_file}no Sun: give `sun`, or a camera whose file has one")

    def warn_of(self, frame: EnuFrame, camera: Sensor | None) -> None:
        """Log a warning for a stated Sun that is not that of a camera's file, seen from a frame's origin."""
        if camera is None or not self.is_stated:
            return
        if camera.sun_position_mcmf_m is None and camera.time_utc is None:
            return
        its, stated = SunChoice().direction_mcmf(frame, camera), self.direction_mcmf(frame, None)
        apart = math.degrees(math.acos(min(1.0, float(its @ stated))))
        if apart > solar_position.SUNS_DIFFER_DEG:
            log.warning(
                "%s: the stated Sun is %.1f deg from the Sun of the camera's %s; the stated one is used",
                camera.name,
                apart,
                "time_utc" if camera.sun_position_mcmf_m is None else "sun_position_mcmf_m",
            )

    def instant(self, camera: Sensor | None) -> str | None:
        """Time of the Sun, UTC: the stated time, or the camera's time if no Sun is stated; else
        None.
        """
        if self.time_utc is not None or self._is_direction:
            return self.time_utc
        return None if camera is None else camera.time_utc

    def disc(self, frame: EnuFrame, camera: Sensor | None) -> SolarDisc:
        """Solar disc at the Sun's distance if a position or a time gives the distance; else the
        mean disc.
        """
        position = None if camera is None else camera.sun_position_mcmf_m
        if self.time_utc is None and not self._is_direction and position is not None:
            return SolarDisc(radius_at(float(np.linalg.norm(position - frame.origin_mcmf_m))))
        time = self.instant(camera)
        return (
            MEAN_SUN if time is None else SolarDisc(radius_at(solar_position.sun_distance_m(time)))
        )

    def drift_mcmf(self, camera: Sensor | None, seconds: float) -> Array | None:
        """Change (3,) of the unit MCMF vector to the Sun in ``seconds`` from its `instant`; None for a
        Sun without an instant, whose direction is stated.
        """
        time = self.instant(camera)
        if time is None:
            return None
        now = instants(time).civil
        then = now + np.timedelta64(round(1e6 * seconds), "us")
        directions, _ = solar_position.apparent_sun(np.concatenate([now, then]))
        return np.asarray(directions[1] - directions[0])

    @property
    def _is_direction(self) -> bool:
        return self.azimuth_deg is not None or self.subsolar_deg is not None


Sun = SunChoice
"""Short name for notebooks: `Sun.at`."""

SunStated: TypeAlias = SunChoice | tuple[float, float] | Time | None
"""A Sun as public functions take it: `SunChoice.of`."""
