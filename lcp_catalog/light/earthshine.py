"""The Earth as a second light: where it stands in a place's sky, how large and how bright it is.

Position: ERFA's moon98 (Meeus 1998) turned into the Moon's frame by the rotation that `sun` uses. Light
time and aberration cancel but for the Moon's motion about the Earth while light is under way (1.3 s,
0.0002 deg), which is in it. Brightness: Mallama and Hilton 2018 ("Computing apparent planetary magnitudes for
The Astronomical Almanac", Astronomy and Computing 25): V = 5 log10(r d) - 3.99 - 1.060e-3 a + 2.054e-4 a^2
for phase angles a up to 170 deg, and the geometric albedo 0.434 that belongs to it. Clouds make the Earth
5 to 10 % brighter or dimmer from day to day; no season or place under the Moon is modelled.

The Earth is a disc of one brightness all over. A crescent's light comes from beside its middle: at half phase
from 0.4 deg off, at most from its limb, 0.95 deg.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import erfa
import numpy as np
from numpy.typing import ArrayLike

from ..arrays import Array
from ..constants import ASTRONOMICAL_UNIT_M
from ..geometry.direction import Direction
from ..geometry.frames import EnuFrame
from ..sun.ephemeris import apparent_sun, lunar_rotation
from ..sun.limb_darkening import LimbDarkening
from ..sun.times import Times, instants
from .solar_disc import SolarDisc
from .sources import Source

EARTH_RADIUS_M = 6_371_000.0
"""Mean radius (IUGG)."""

EARTH_ALBEDO = 0.434
"""Geometric albedo in V, Mallama and Hilton 2018; theirs is the Sun's V of -26.75 that makes V(1, 0) = -3.99 of it."""

MEAN_DISTANCE_M = 384_400e3
"""Between the centres of Earth and Moon, where no instant says it."""

LAST_PHASE_DEG = 170.0
"""Beyond, the phase function is not from data: it goes on as it does here."""

_J2000 = 2451545.0


@dataclass(frozen=True, eq=False)
class Earth:
    """Where the Earth and the Sun stand: MCMF positions (3,), metres; the Sun's may be a direction
    (``sun_distance_m`` inf).
    """

    position_mcmf_m: Array
    sun_direction_mcmf: Array
    sun_distance_m: float = math.inf

    def phase_rad(self, place_mcmf_m: ArrayLike = (0.0, 0.0, 0.0)) -> float:
        """Angle at the Earth between the Sun and a place on the Moon; 0: the Earth is full."""
        to_sun = self.sun_direction_mcmf
        if math.isfinite(self.sun_distance_m):
            to_sun = to_sun - self.position_mcmf_m / self.sun_distance_m
        to_place = np.asarray(place_mcmf_m) - self.position_mcmf_m
        across = float(np.linalg.norm(np.cross(to_sun, to_place)))
        return math.atan2(across, float(to_sun @ to_place))

    def source(self, frame: EnuFrame, as_disc: bool = False) -> Source:
        """The Earth in the sky of a frame's origin; irradiance relative to the Sun's there."""
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
        return Source(direction, ratio, disc if as_disc else None, "Earth")


def phase_function(phase_rad: float) -> float:
    """Brightness at a phase angle over that of the full Earth."""
    phase_deg = min(math.degrees(phase_rad), LAST_PHASE_DEG)
    fainter_mag = phase_deg * (-1.060e-3 + 2.054e-4 * phase_deg)
    beyond = math.degrees(phase_rad) - phase_deg
    slope = -1.060e-3 + 2.0 * 2.054e-4 * phase_deg
    return float(10.0 ** (-0.4 * (fainter_mag + slope * beyond)))


def earth_over_sun(phase_rad: float, distance_m: float) -> float:
    """Irradiance by the Earth over that by the Sun, of surfaces held square to each, where both are as far
    from the Sun: p phase(a) (R / d)^2.
    """
    return EARTH_ALBEDO * phase_function(phase_rad) * (EARTH_RADIUS_M / distance_m) ** 2


def earth_at(time: Times) -> Earth:
    """The Earth and the Sun at an instant; SunError for what is no time."""
    jd1, jd2 = instants(time).terrestrial()
    moon = erfa.moon98(jd1, jd2)
    delay_day = np.linalg.norm(moon["p"], axis=-1) * (erfa.AULT / erfa.DAYSEC)
    geocentric_au = moon["p"] - moon["v"] * delay_day[:, None]
    rotation = lunar_rotation((jd1 - _J2000) + jd2)
    earth_m = -ASTRONOMICAL_UNIT_M * np.einsum("nij,nj->ni", rotation, geocentric_au)
    direction, distance_au = apparent_sun(time)
    return Earth(earth_m[0], direction[0], float(distance_au[0]) * ASTRONOMICAL_UNIT_M)


def mean_earth(sun_direction_mcmf: ArrayLike) -> Earth:
    """The Earth without librations, over longitude 0, latitude 0 at its mean distance, with a Sun that is
    stated by its direction alone.
    """
    position = np.array([MEAN_DISTANCE_M, 0.0, 0.0])
    return Earth(position, np.asarray(sun_direction_mcmf, dtype=np.float64))
