"""Environment maps by formula: uniform and CIE skies, suns and lamps of known power."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from lcp_catalog.arrays import Array
from lcp_catalog.geometry.frames import direction_enu, direction_enu_rad
from lcp_catalog.light.environment_map import Panorama


@dataclass(frozen=True)
class Lamp:
    """A disc of uniform luminance in the sky: centre, radius (0: one pixel) and power, i.e. the
    irradiance of a surface perpendicular to it.
    """

    azimuth_deg: float
    elevation_deg: float
    power: float
    radius_deg: float = 0.0

    @property
    def direction(self) -> Array:
        return direction_enu(self.azimuth_deg, self.elevation_deg)


@dataclass(frozen=True)
class CieSky:
    """Coefficients of the CIE standard general sky (CIE S 011 / ISO 15469:2004): gradation a, b and
    indicatrix c, d, e.
    """

    a: float
    b: float
    c: float
    d: float
    e: float


CLEAR = CieSky(-1.0, -0.32, 10.0, -3.0, 0.45)
"""Type 12, clear, low turbidity."""
OVERCAST = CieSky(4.0, -0.70, 0.0, -1.0, 0.0)
"""Type 1, overcast: three times as bright in the zenith as at the horizon."""


def directions(rows: int) -> Array:
    """Unit ENU directions of the pixels' centres, (rows, 2 rows, 3), of a panorama whose middle is
    at north.
    """
    elevation = (math.pi / 2.0 - (np.arange(rows) + 0.5) * (math.pi / rows))[:, None]
    azimuth = (np.arange(2 * rows) + 0.5) * (math.pi / rows) - math.pi
    return direction_enu_rad(azimuth, elevation)


def uniform(rows: int = 64, luminance: float = 1.0, ground: float = 0.0) -> Panorama:
    """One luminance above the horizon, another below it."""
    light = np.full((rows, 2 * rows), ground, dtype=np.float64)
    light[: rows // 2] = luminance
    return Panorama(light, name="uniform")


def cie_sky(
    rows: int,
    sun_azimuth_deg: float,
    sun_elevation_deg: float,
    sky: CieSky = CLEAR,
    ground: float = 0.1,
) -> Panorama:
    """A CIE sky without its Sun, with luminance 1 in the zenith, over terrain of uniform luminance."""
    looking = directions(rows)
    zenith = np.arccos(np.clip(looking[: rows // 2, :, 2], 0.0, 1.0))
    sun = Lamp(sun_azimuth_deg, sun_elevation_deg, 1.0).direction
    away = np.arccos(np.clip(looking[: rows // 2] @ sun, -1.0, 1.0))
    sun_zenith = math.pi / 2.0 - math.radians(sun_elevation_deg)

    def gradation(angle: Array | float) -> Array:
        return np.asarray(1.0 + sky.a * np.exp(sky.b / np.maximum(np.cos(angle), 1e-9)))

    def indicatrix(angle: Array | float) -> Array:
        rise = np.exp(sky.d * np.asarray(angle)) - math.exp(sky.d * math.pi / 2.0)
        return np.asarray(1.0 + sky.c * rise + sky.e * np.cos(angle) ** 2)

    light = np.full((rows, 2 * rows), ground)
    light[: rows // 2] = gradation(zenith) * indicatrix(away)
    light[: rows // 2] /= gradation(0.0) * indicatrix(sun_zenith)
    return Panorama(light, name="CIE sky")


def recorded(
    elevation: float = 50.0, over: float = 6.0, cut_at: float = math.inf, rows: int = 512
) -> Panorama:
    """CIE clear sky with a Sun and its glare, 2 deg wide, of which a camera records luminances up
    to ``cut_at`` times the zenith's. The Sun gives ``over`` times the sky on a horizontal plane
    before it is cut off.
    """
    sky = cie_sky(rows, 120.0, elevation)
    looking = directions(rows) @ Lamp(120.0, elevation, 1.0).direction
    glare = np.exp(-0.5 * (np.degrees(np.arccos(np.clip(looking, -1, 1))) / 0.7) ** 2)
    one = Panorama(np.maximum(glare, 1e-300))
    power = over * sky.horizontal_irradiance / math.sin(math.radians(elevation))
    light = sky.luminance + glare * (power / one.power)
    return Panorama(np.minimum(light, cut_at))


def with_lamps(panorama: Panorama, lamps: Iterable[Lamp]) -> Panorama:
    """Add lamps to a panorama whose middle is at north; each has its stated power to rounding, in
    whole pixels.
    """
    return Panorama(_lit(panorama.luminance, lamps), name=f"{panorama.name} with lamps")


def room(rows: int, lamps: Iterable[Lamp], ambient: float = 0.0) -> Panorama:
    """Lamps in a room of uniform luminance."""
    return Panorama(_lit(np.full((rows, 2 * rows), ambient), lamps), name="room")


def _lit(luminance: Array, lamps: Iterable[Lamp]) -> Array:
    light, rows = luminance.copy(), len(luminance)
    looking = directions(rows)
    upper = math.pi / 2.0 - np.arange(rows) * (math.pi / rows)
    solid = (np.sin(upper) - np.sin(upper - math.pi / rows)) * (math.pi / rows)
    solid = np.broadcast_to(solid[:, None], light.shape)
    for lamp in lamps:
        near = looking @ lamp.direction
        inside = near >= min(math.cos(math.radians(lamp.radius_deg)), float(near.max()))
        light[inside] += lamp.power / float(solid[inside].sum())
    return light
