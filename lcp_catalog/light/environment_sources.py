"""Bright sources of an environment map, replaced by parallel light of the same power.

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

import numpy as np

from ..arrays import Array, Mask
from ..errors import ImageError
from ..geometry.frames import azimuth_elevation, direction_enu_rad
from .environment_map import Panorama

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
        panorama, peak = self.panorama, _direction(self.panorama, row, col)
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


def _direction(panorama: Panorama, row: int, col: int) -> Array:
    elevation, azimuth = panorama.elevations[row], panorama.azimuths[col]
    return direction_enu_rad(azimuth, elevation)


def _cosines(panorama: Panorama, band: slice, direction: Array) -> Array:
    """Cosines of the angles between a direction and the pixels of some rows, (rows, cols)."""
    elevation = panorama.elevations[band, None]
    along = direction[0] * np.sin(panorama.azimuths) + direction[1] * np.cos(panorama.azimuths)
    return np.asarray(np.cos(elevation) * along + np.sin(elevation) * direction[2])
