"""The Earth as a light source: its direction, its size and its brightness.

Position: ERFA's moon98 (Meeus 1998), rotated into the Moon's frame by `ephemeris.solar_position`. Light time
and aberration cancel except for the Moon's motion about the Earth during the light time (1.3 s,
0.0002 deg), which is included.

Brightness: Mallama and Hilton 2018 ("Computing apparent planetary magnitudes for The Astronomical
Almanac", Astronomy and Computing 25): V = 5 log10(r d) - 3.99 - 1.060e-3 a + 2.054e-4 a^2 for phase
angles a up to 170 deg, and the corresponding geometric albedo 0.434. Clouds change the Earth's
brightness by 5 to 10 % from day to day; seasons and the visible hemisphere are not modelled.

The Earth is a disc of uniform brightness. The light of a crescent comes from beside the disc's
centre: 0.4 deg from it at half phase, at most 0.95 deg (the limb).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import erfa
import numpy as np
from numpy.typing import ArrayLike

from ..arrays import Array
from ..constants import ASTRONOMICAL_UNIT_M
from ..ephemeris.limb_darkening import LimbDarkening
from ..ephemeris.solar_position import apparent_sun, lunar_rotation
from ..ephemeris.times import Times, instants
from ..geometry.frames import Direction, EnuFrame
from .solar_disc import SolarDisc
from .sources import LightSource

EARTH_RADIUS_M = 6_371_000.0
"""Mean radius (IUGG)."""

EARTH_ALBEDO = 0.434
"""Geometric albedo in V, Mallama and Hilton 2018; with their V of the Sun, -26.75, it gives V(1, 0)
= -3.99."""

MEAN_DISTANCE_M = 384_400e3
"""Distance between the centres of Earth and Moon if no time is stated."""

LAST_PHASE_DEG = 170.0
"""Greatest phase angle of the measured phase function; beyond, it is extrapolated with its last
slope."""

_J2000 = 2451545.0


@dataclass(frozen=True, eq=False)
class Earth:
    """MCMF position of the Earth (3,), metres, and the direction and distance of the Sun;
    ``sun_distance_m`` is inf if only the direction is known.
    """

    position_mcmf_m: Array
    sun_direction_mcmf: Array
    sun_distance_m: float = math.inf

    def phase_rad(self, place_mcmf_m: ArrayLike = (0.0, 0.0, 0.0)) -> float:
        """Angle at the Earth between the Sun and a place on the Moon; 0 for a full Earth."""
        to_sun = self.sun_direction_mcmf
        if math.isfinite(self.sun_distance_m):
            to_sun = to_sun - self.position_mcmf_m / self.sun_distance_m
        to_place = np.asarray(place_mcmf_m) - self.position_mcmf_m
        across = float(np.linalg.norm(np.cross(to_sun, to_place)))
        return math.atan2(across, float(to_sun @ to_place))

    def source(self, frame: EnuFrame, as_disc: bool = False) -> LightSource:
        """The Earth as seen from a frame's origin; irradiance relative to the Sun's there."""
        place = frame.origin_mcmf_m
        towards = self.position_mcmf_m - place
        distance_m = float(np.linalg.norm(towards))
        ratio = earth_over_sun(self.phase_rad(place), distance_m)
        if math.isfinite(self.sun_distance_m):
            sun = self.sun_direction_mcmf * self.sun_distance_m
            nearer = np.linalg.norm(sun - place) / np.linalg.norm(sun - self.position_mcmf_m)
            ratio *= float(nearer) ** 2
        disc = SolarDisc(math.asin(EARTH_RADIUS_M / distance_m), LimbDarkening(1.0, 0.0, 0.0))
        direction = Direction.from_mcmf(towards / distance_m, frame)
        return LightSource(direction, ratio, disc if as_disc else None, "Earth")


def phase_function(phase_rad: float) -> float:
    """Brightness at a phase angle relative to the full Earth."""
    phase_deg = min(math.degrees(phase_rad), LAST_PHASE_DEG)
    fainter_mag = phase_deg * (-1.060e-3 + 2.054e-4 * phase_deg)
    beyond = math.degrees(phase_rad) - phase_deg
    slope = -1.060e-3 + 2.0 * 2.054e-4 * phase_deg
    return float(10.0 ** (-0.4 * (fainter_mag + slope * beyond)))


def earth_over_sun(phase_rad: float, distance_m: float) -> float:
    """Irradiance by the Earth relative to that by the Sun, of surfaces perpendicular to each, if
    both are equally far from the Sun: p phase(a) (R / d)^2.
    """
    return EARTH_ALBEDO * phase_function(phase_rad) * (EARTH_RADIUS_M / distance_m) ** 2


def earth_at(time: Times) -> Earth:
    """The Earth and the Sun at a time; SunError for an invalid time."""
    jd1, jd2 = instants(time).terrestrial()
    moon = erfa.moon98(jd1, jd2)
    delay_day = np.linalg.norm(moon["p"], axis=-1) * (erfa.AULT / erfa.DAYSEC)
    geocentric_au = moon["p"] - moon["v"] * delay_day[:, None]
    rotation = lunar_rotation((jd1 - _J2000) + jd2)
    earth_m = -ASTRONOMICAL_UNIT_M * np.einsum("nij,nj->ni", rotation, geocentric_au)
    direction, distance_au = apparent_sun(time)
    return Earth(earth_m[0], direction[0], float(distance_au[0]) * ASTRONOMICAL_UNIT_M)


def mean_earth(sun_direction_mcmf: ArrayLike) -> Earth:
    """The Earth without librations, at its mean distance above longitude 0, latitude 0, with a Sun
    given by its direction alone.
    """
    position = np.array([MEAN_DISTANCE_M, 0.0, 0.0])
    return Earth(position, np.asarray(sun_direction_mcmf, dtype=np.float64))
