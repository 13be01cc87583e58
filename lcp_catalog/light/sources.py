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

Bright sources of an environment map, replaced by parallel light of the same power.

After Voloboy, Galaktionov, Kopylov and Shapiro 2006 ("Calculation of sunlight set by an image of
high dynamic range", section 2.3): the sky is divided into segments of 45 x 45 deg, and three
coefficients define a source. The paper leaves some points open. Here, thresholds are multiples of a
segment's mean luminance. The means are computed again after each source is removed, so that a
strong source does not hide a weak one. A pixel within the radius of a source cannot start another
source, even in another segment, so that a source on a border is found once. The circle around a
source starts at its brightest pixel and moves to the centroid of the light inside it, until it
stops or would lose that pixel; for a source of uniform luminance, or a Sun cut off at white, the
brightest pixel is arbitrary.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator
from dataclasses import astuple, dataclass, replace
from itertools import pairwise
from typing import Any

import erfa
import numpy as np
from numpy.typing import ArrayLike

from ..arrays import AnyArray, Array, Mask
from ..constants import ASTRONOMICAL_UNIT_M
from ..ephemeris.limb_darkening import LimbDarkening
from ..ephemeris.solar_position import apparent_sun, lunar_rotation
from ..ephemeris.times import Times, instants
from ..errors import ImageError, SunError
from ..geometry.frames import Direction, EnuFrame, azimuth_elevation, direction_enu_rad
from ..terrain.relief_bounds import nodes_enu
from ..terrain.terrain import Terrain
from .environment_map import Panorama
from .solar_disc import MEAN_SUN, SolarDisc

log = logging.getLogger(__name__)

MOST_SOURCES = 32
"""Greatest number of sources, in order of luminance; other bright regions stay in the remainder."""

SEGMENT_DEG = 45.0

_SHIFTS = 20

_FLAT = 1e-3
_FLAT_PIXELS = 4


@dataclass(frozen=True)
class SourceSearch:
    """Coefficients of a source. ``threshold``: its brightest pixel exceeds this multiple of the
    segment's mean luminance. ``radius_deg``: greatest distance of its pixels from its centre.
    ``minimum``: its pixels exceed this multiple of that mean, and are reduced to it.

    For comparison: the CIE clear sky without its Sun stays below 4 (checked by a test); a lamp 15
    deg wide in a dark room has 9 times its segment's mean.
    """

    threshold: float = 6.0
    radius_deg: float = 5.0
    minimum: float = 2.0

    def __post_init__(self) -> None:
        numbers = self.threshold, self.radius_deg, self.minimum
        known = all(math.isfinite(number) for number in numbers)
        if not (known and 1.0 <= self.minimum <= self.threshold and 0.0 < self.radius_deg <= 45.0):
            raise ImageError(
                "sources of a panorama: T R M must satisfy 1 <= M <= T and 0 < R <= 45 deg, not "
                f"{self.threshold:g} {self.radius_deg:g} {self.minimum:g}"
            )


@dataclass(frozen=True, eq=False)
class BrightSource:
    """Parallel light in place of a bright region: unit ENU direction (3,) to the centroid of its
    power, and its power, i.e. the irradiance of a surface perpendicular to it.

    ``width_rad``: radius of a disc with the region's solid angle; ``pixels``: number of pixels of
    the region; ``peak_pixels``: number of pixels that have its greatest luminance, to 0.1 %, in
    ``bright_pixels`` above half of it; ``peak_rad``: radius of a disc with the solid angle of the
    former.
    """

    direction: Array
    power: float
    width_rad: float
    pixels: int
    peak_pixels: int = 1
    bright_pixels: int = 1
    peak_rad: float = 0.0

    @property
    def is_flat(self) -> bool:
        """True if most of the bright pixels have one luminance, as where a camera's range ends: a
        Sun whose luminance is cut off, or a lamp of uniform luminance. The image of a Sun with limb
        darkening is not flat.
        """
        return self.peak_pixels >= max(_FLAT_PIXELS, 0.5 * self.bright_pixels)

    @property
    def horizontal_irradiance(self) -> float:
        return self.power * float(self.direction[2])

    def describe(self, unit: float) -> dict[str, Any]:
        """Values for a report; the power as a share of ``unit``."""
        azimuth, elevation = azimuth_elevation(self.direction)
        return {
            "azimuth_deg": float(azimuth),
            "elevation_deg": float(elevation),
            "power_share": self.power / unit,
            "radius_deg": math.degrees(self.width_rad),
            "pixels": self.pixels,
        }


@dataclass(frozen=True, eq=False)
class SourceSplit:
    """Sources of an environment map, the most powerful first, and the remainder."""

    sources: tuple[BrightSource, ...]
    remainder: Panorama
    search: SourceSearch

    @property
    def power(self) -> float:
        """Power of the sources and the remainder over the whole sphere."""
        return self.remainder.power + math.fsum(source.power for source in self.sources)

    @property
    def power_above(self) -> float:
        """Power of the sources and the remainder above the horizontal plane."""
        return self.remainder.power_above + math.fsum(source.power for source in self.sources)

    @property
    def sun_sky_ratio(self) -> float:
        """Irradiance of a horizontal plane by the most powerful source, relative to that by the
        rest of the sky; 0 without sources.
        """
        if not self.sources:
            return 0.0
        levels = [source.horizontal_irradiance for source in self.sources]
        rest = self.remainder.horizontal_irradiance + math.fsum(levels[1:])
        return levels[0] / rest if rest > 0.0 else math.inf

    def with_ratio(self, ratio: float) -> SourceSplit:
        """The same with the most powerful source scaled to a `environment` (CIE clear sky: 4;
        section 4 of the paper). ImageError without a source or without a sky.
        """
        if not (math.isfinite(ratio) and ratio > 0.0):
            raise ImageError(f"the ratio of Sun to sky must be positive, not {ratio:g}")
        before = self.sun_sky_ratio
        if not 0.0 < before < math.inf:
            lacks = "no bright source was found" if before == 0.0 else "its sky is black"
            raise ImageError(f"{self.remainder.name}: {lacks}, so there is nothing to scale")
        sun = self.sources[0]
        scaled = replace(sun, power=sun.power * (ratio / before))
        return replace(self, sources=(scaled, *self.sources[1:]))


def report(panorama: Panorama, found: SourceSplit, used: SourceSplit) -> dict[str, Any]:
    """Values for a report: sources as found (``found``) and as they light the scene (``used``,
    after any scaling). Powers are shares of the power above the horizontal plane.
    """
    unit = used.power_above
    return {
        "panorama": panorama.name,
        "size": [panorama.cols, panorama.rows],
        "azimuth_deg": panorama.azimuth_deg,
        "display_encoded": panorama.encoded,
        "dynamic_range": panorama.dynamic_range,
        "dynamic_range_above_horizon": panorama.dynamic_range_above,
        "threshold_radius_minimum": astuple(found.search),
        "sources": [source.describe(unit) for source in used.sources],
        "remainder_share": used.remainder.power_above / unit,
        "sun_sky_ratio_found": found.sun_sky_ratio,
        "sun_sky_ratio": used.sun_sky_ratio,
    }


def split_sources(panorama: Panorama, search: SourceSearch | None = None) -> SourceSplit:
    """Sources of the panorama's upper half, and the remainder. The sum of their powers is the
    panorama's power, to rounding.
    """
    search = search or SourceSearch()
    work = _SourceSearch(panorama, search)
    found = list(work.run())
    found.sort(key=lambda source: -source.power)
    if len(found) == MOST_SOURCES:
        log.warning(
            "%s: more bright sources; only the brightest %d are used", panorama.name, MOST_SOURCES
        )
    return SourceSplit(tuple(found), work.remainder(), search)


class _SourceSearch:
    """State of the search: luminance of the upper half after each removal, the pixels that may not
    start a source, and each segment's mean and brightest free pixel.
    """

    def __init__(self, panorama: Panorama, search: SourceSearch) -> None:
        self.panorama, self.how = panorama, search
        self.light = panorama.luminance.copy()
        upper = panorama.rows // 2, panorama.cols
        self.solid = panorama.solid_angles[: upper[0], None]
        self.claimed, self.cut = np.zeros(upper, np.bool_), np.zeros(upper, np.bool_)
        self.segments = list(_segments(panorama))
        self.state = [self._look(part) for part in self.segments]

    def run(self) -> Iterator[BrightSource]:
        """Sources, in the order of their brightest pixels."""
        for _ in range(MOST_SOURCES):
            bright = [
                (peak, k)
                for k, (mean, peak, _) in enumerate(self.state)
                if peak > self.how.threshold * mean
            ]
            if not bright:
                return
            mean, _, (row, col) = self.state[max(bright)[1]]
            yield self._taken_out(row, col, self.how.minimum * mean)

    def remainder(self) -> Panorama:
        return replace(self.panorama, luminance=self.light)

    def _look(self, part: tuple[slice, slice]) -> tuple[float, float, tuple[int, int]]:
        """Mean luminance of a segment, its greatest luminance among the free pixels, and that
        pixel.
        """
        light = self.light[part]
        solid = self.solid[part[0]]
        mean = float((light * solid).sum() / (solid.sum() * light.shape[1]))
        free = np.where(self.claimed[part], -1.0, light)
        row, col = np.unravel_index(int(free.argmax()), free.shape)
        place = int(row) + part[0].start, int(col) + part[1].start
        return mean, float(free[row, col]), place

    def _taken_out(self, row: int, col: int, floor: float) -> BrightSource:
        """Remove the source around a pixel: reduce its pixels to a luminance."""
        panorama = self.panorama
        peak = direction_enu_rad(panorama.azimuths[col], panorama.elevations[row])
        centre, reach = peak, math.radians(self.how.radius_deg)
        for _ in range(_SHIFTS):
            band, near = self._near(centre)
            rows, cols = np.nonzero(near & ~self.cut[band] & (self.light[band] > floor))
            rows += band.start
            excess = self.light[rows, cols] - floor
            moment = excess @ panorama.moments(rows, cols)
            direction = moment / np.linalg.norm(moment)
            settled = direction @ centre > math.cos(0.1 * panorama.pixel_rad)
            if settled or direction @ peak < math.cos(reach):
                break
            centre = direction
        self.claimed[band] |= near
        self.light[rows, cols] = floor
        self.cut[rows, cols] = True
        for k, (down, across) in enumerate(self.segments):
            if down.start < band.stop and band.start < down.stop and near[:, across].any():
                self.state[k] = self._look((down, across))
        solid, light = panorama.solid_angles[rows], excess + floor
        flat, bright = light >= (1.0 - _FLAT) * light.max(), light > 0.5 * light.max()
        width, peak_rad = (math.sqrt(float(part.sum()) / math.pi) for part in (solid, solid[flat]))
        return BrightSource(
            direction,
            float(excess @ solid),
            width,
            pixels=len(rows),
            peak_pixels=int(flat.sum()),
            bright_pixels=int(bright.sum()),
            peak_rad=peak_rad,
        )

    def _near(self, centre: Array) -> tuple[slice, Mask]:
        """A range of rows, and a mask of their pixels within the radius of a direction."""
        panorama, reach = self.panorama, math.radians(self.how.radius_deg)
        elevation = math.asin(min(1.0, float(centre[2])))
        first = (0.5 * math.pi - elevation - reach) / panorama.pixel_rad
        last = (0.5 * math.pi - elevation + reach) / panorama.pixel_rad
        band = slice(max(0, math.floor(first)), min(len(self.cut), math.ceil(last) + 1))
        return band, _cosines(panorama, band, centre) >= math.cos(reach) - 1e-12


def _segments(panorama: Panorama) -> Iterator[tuple[slice, slice]]:
    """Rows and columns of each segment of 45 x 45 deg in the upper half, without empty segments; a
    pixel belongs to the segment of its centre.
    """
    upper, cols = panorama.rows // 2, panorama.cols
    middle = math.ceil(SEGMENT_DEG / 180.0 * panorama.rows - 0.5)
    across = [math.ceil(k * cols / 8.0 - 0.5) for k in range(9)]
    for top, bottom in ((0, middle), (middle, upper)):
        for left, right in pairwise(across):
            if top < bottom and left < right:
                yield slice(top, bottom), slice(left, right)


def _cosines(panorama: Panorama, band: slice, direction: Array) -> Array:
    """Cosines of the angles between a direction and the pixels of some rows, (rows, cols)."""
    elevation = panorama.elevations[band, None]
    along = direction[0] * np.sin(panorama.azimuths) + direction[1] * np.cos(panorama.azimuths)
    return np.asarray(np.cos(elevation) * along + np.sin(elevation) * direction[2])


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
