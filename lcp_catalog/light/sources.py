"""Light on a scene: one or more sources (points at infinity or discs) and a sky, all as directions
in the frame of the terrain.

Light sources above the horizon of a terrain.

Points of the surface whose radiance is asked for.

The Earth as a light source: its direction, its size and its brightness.

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
from dataclasses import dataclass, replace
from typing import Any

import erfa
import numpy as np
from numpy.typing import ArrayLike

from ..arrays import AnyArray, Array
from ..constants import ASTRONOMICAL_UNIT_M
from ..ephemeris.limb_darkening import LimbDarkening
from ..ephemeris.solar_position import apparent_sun, lunar_rotation
from ..ephemeris.times import Times, instants
from ..errors import SunError
from ..geometry.frames import Direction, EnuFrame
from ..terrain.relief_bounds import nodes_enu
from ..terrain.terrain import Terrain
from .environment_map import Panorama
from .environment_sources import SourceSplit
from .solar_disc import MEAN_SUN, SolarDisc


@dataclass(frozen=True, eq=False)
class SurfacePoints:
    """ENU points (n, 3) of the surface, their normals (n, 3), and the directions in which they are
    seen, (3,) or (n, 3).
    """

    points_m: Array
    normals: Array
    towards: Array

    def __len__(self) -> int:
        return len(self.points_m)

    def some(self, which: AnyArray | slice) -> SurfacePoints:
        """The points of indices, a mask or a slice."""
        towards = np.broadcast_to(self.towards, self.points_m.shape)
        return SurfacePoints(self.points_m[which], self.normals[which], towards[which])


_NEVER_UP_RAD = math.radians(9.0)
"""Greatest depression of a visible source. The horizon of the Moon's highest terrain (10.8 km) over
a sphere of its lowest (-9.1 km) dips by 8.7 deg."""


@dataclass(frozen=True, eq=False)
class LightSource:
    """Parallel light, or a distant disc.

    direction: from the surface to the disc's centre. irradiance: of a surface perpendicular to it,
    relative to the unit of its `Lighting`. disc: size and limb darkening; None: a point.
    """

    direction: Direction
    irradiance: float = 1.0
    disc: SolarDisc | None = None
    name: str = "Sun"

    def __post_init__(self) -> None:
        object.__setattr__(self, "direction", Direction.of(self.direction))

    @property
    def radius_rad(self) -> float:
        """Angular radius of the disc; 0 for a point."""
        return 0.0 if self.disc is None else self.disc.radius_rad

    def describe(self) -> dict[str, Any]:
        """Values for tags and the explained plan; angles in the terrain's frame."""
        found: dict[str, Any] = {
            "name": self.name,
            "azimuth_deg": self.direction.azimuth_deg,
            "elevation_deg": self.direction.elevation_deg,
            "irradiance": self.irradiance,
        }
        return found | ({"radius_deg": math.degrees(self.radius_rad)} if self.disc else {})


@dataclass(frozen=True, eq=False)
class Lighting:
    """Sources and sky of a scene. The bands ``sunlit``, ``incidence`` and ``phase`` refer to the
    first source. ``sky``: luminance in the unit of the sources' irradiance.
    """

    sources: tuple[LightSource, ...]
    sky: Panorama | None = None

    @classmethod
    def of_sun(cls, direction: Direction | ArrayLike, disc: SolarDisc | bool = False) -> Lighting:
        """The Sun alone with irradiance 1: a point, the mean disc (True), or a given disc."""
        size = disc if isinstance(disc, SolarDisc) else MEAN_SUN if disc else None
        return cls((LightSource(Direction.of(direction), disc=size),))

    @classmethod
    def of_panorama(cls, split: SourceSplit) -> Lighting:
        """Sources and sky of an environment map. The unit is the integral of its luminance over the
        sphere above the horizontal plane.

        If no source was found, the first source has irradiance 0 and lies at the centroid of the
        sky's light, so that bands of the first source are defined.
        """
        unit = split.power_above
        sources = [
            LightSource(Direction(bright.direction), bright.power / unit, name=f"source {number}")
            for number, bright in enumerate(split.sources, start=1)
        ]
        if not sources:
            sources = [
                LightSource(Direction(split.remainder.middle_above), 0.0, name="sky's middle")
            ]
        return cls(tuple(sources), split.remainder.times(1.0 / unit))

    @property
    def first(self) -> LightSource:
        """Source that the bands refer to."""
        return self.sources[0]

    @property
    def others(self) -> tuple[LightSource, ...]:
        """All sources but the first."""
        return self.sources[1:]

    @property
    def lowest_tangent(self) -> float:
        """Tangent of the lowest elevation of a limb, over the sources that may be above the horizon
        (over all sources if none may be).
        """
        limbs = [source.direction.elevation_rad - source.radius_rad for source in self.sources]
        tops = [source.direction.elevation_rad + source.radius_rad for source in self.sources]
        up = [limb for limb, top in zip(limbs, tops, strict=True) if top > -_NEVER_UP_RAD]
        return math.tan(max(min(up or limbs), -math.pi / 2.0))

    def with_source(self, source: LightSource) -> Lighting:
        """The same with one more source at the end."""
        return replace(self, sources=(*self.sources, source))

    def describe(self) -> dict[str, Any]:
        """Values for tags and the explained plan."""
        found: dict[str, Any] = {"sources": [source.describe() for source in self.sources]}
        return found | ({"sky_irradiance": self.sky.power_above} if self.sky else {})


_ROUNDING_DEG = 1e-9  # tolerance in elevation: a source on the horizon counts as above it


def light_above_horizon(terrain: Terrain, light: Lighting) -> Lighting:
    """Return the light with irradiance 0 for every source that is below the horizon of all nodes of
    the area; a disc is below with its upper limb. SunError if no source is left and there is no
    sky.

    The horizon is that of a sphere through the lowest surrounding terrain: from a height h above
    it, the horizon dips by acos(R / (R + h)). The terrain ends at its border; without this test a
    source below the horizon would illuminate the border from below.
    """
    step = max(1, max(terrain.field.shape) // 256)
    lowest_m = _lowest_m(terrain, step)
    sources = [
        replace(source, irradiance=0.0) if _is_set(terrain, source, lowest_m, step) else source
        for source in light.sources
    ]
    if light.sky is None and all(source.irradiance == 0.0 for source in sources):
        first = light.first
        raise SunError(
            f"the {first.name} is {-_above_deg(terrain, first, lowest_m, 1):.2f} deg below the horizon of "
            f"the area's highest terrain, so nothing is lit; state another {first.name}"
        )
    return replace(light, sources=tuple(sources))


def _is_set(terrain: Terrain, source: LightSource, lowest_m: float, step: int) -> bool:
    """True if a source is below every horizon; a coarse sample of nodes is tested first."""
    return all(_above_deg(terrain, source, lowest_m, every) < 0 for every in (step, 1))


def _lowest_m(terrain: Terrain, step: int) -> float:
    """Least distance of the terrain's nodes from the Moon's centre, metres."""
    all_around = terrain.frame.to_mcmf(nodes_enu(terrain.field, terrain.field.whole, step))
    radius = np.linalg.norm(all_around, axis=-1)
    lowest_m = float(np.nanmin(radius)) if np.isfinite(radius).any() else np.nan
    for level in terrain.far.levels if terrain.far else ():
        beyond = np.linalg.norm(terrain.frame.to_mcmf(nodes_enu(level, level.whole, 4)), axis=-1)
        lowest_m = float(np.nanmin(beyond, initial=lowest_m))
    return lowest_m


def _above_deg(terrain: Terrain, source: LightSource, lowest_m: float, step: int) -> float:
    """Greatest elevation of a source's upper limb above the horizon of the core's nodes, deg; NaN
    without heights.
    """
    limb = (math.degrees(source.disc.radius_rad) if source.disc else 0.0) + _ROUNDING_DEG
    return _sun_above_horizon_deg(terrain, source.direction, lowest_m, step) + limb


def _sun_above_horizon_deg(terrain: Terrain, sun: Direction, lowest_m: float, step: int) -> float:
    """Greatest elevation of a direction above the horizon of the core's nodes, deg; NaN without
    heights.
    """
    places = terrain.frame.to_mcmf(nodes_enu(terrain.field, terrain.core, step))
    places = places[np.isfinite(places[..., 2])]
    if not len(places):
        return float("nan")
    radius = np.linalg.norm(places, axis=-1)
    sine = np.clip(places @ terrain.frame.direction_to_mcmf(sun) / radius, -1.0, 1.0)
    elevation = np.arcsin(sine)
    dip = np.arccos(np.clip(lowest_m / radius, -1.0, 1.0))
    return float(np.degrees((elevation + dip).max()))


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
