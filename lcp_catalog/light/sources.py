"""What lights a scene: one source or several, each a point far away or a disc, and a sky between
them, all as directions in the frame of the terrain.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

from numpy.typing import ArrayLike

from ..geometry.direction import Direction
from .environment_map import Panorama
from .environment_sources import Split
from .solar_disc import MEAN_SUN, SolarDisc

_NEVER_UP_RAD = math.radians(9.0)
"""The horizon of the Moon's highest ground (10.8 km) over a sphere of its lowest (-9.1 km) dips by 8.7 deg."""


@dataclass(frozen=True, eq=False)
class Source:
    """Parallel light, or a disc of it far away.

    direction (3,): unit ENU vector from the surface to its middle. irradiance: of a surface held
    square to it, relative to what `Lighting` calls one. disc: its size and limb darkening; None is
    a point.
    """

    direction: Direction
    irradiance: float = 1.0
    disc: SolarDisc | None = None
    name: str = "Sun"

    def __post_init__(self) -> None:
        object.__setattr__(self, "direction", Direction.of(self.direction))

    @property
    def radius_rad(self) -> float:
        """Of its disc; 0 of a point."""
        return 0.0 if self.disc is None else self.disc.radius_rad

    def describe(self) -> dict[str, Any]:
        """For tags and ``--explain``; angles in the terrain's frame."""
        found: dict[str, Any] = {
            "name": self.name,
            "azimuth_deg": self.direction.azimuth_deg,
            "elevation_deg": self.direction.elevation_deg,
            "irradiance": self.irradiance,
        }
        return found | ({"radius_deg": math.degrees(self.radius_rad)} if self.disc else {})


@dataclass(frozen=True, eq=False)
class Lighting:
    """All that lights a scene. The bands that speak of one light (sunlit, incidence, phase) speak
    of the first source. ``sky``: luminance, of a unit in which irradiance is that of the sources.
    """

    sources: tuple[Source, ...]
    sky: Panorama | None = None

    @classmethod
    def of_sun(cls, direction: Direction | ArrayLike, disc: SolarDisc | bool = False) -> Lighting:
        """A lone Sun of irradiance one: a point, the mean disc (True), or a stated one."""
        size = disc if isinstance(disc, SolarDisc) else MEAN_SUN if disc else None
        return cls((Source(Direction.of(direction), disc=size),))

    @classmethod
    def of_panorama(cls, split: Split) -> Lighting:
        """Sources and sky of a panorama; one is the integral of its luminance over the sphere above
        the horizontal plane.

        Where no source was found the first is one without irradiance, in the middle of the sky's
        light: bands that speak of one light have something to speak of.
        """
        unit = split.power_above
        sources = [
            Source(Direction(bright.direction), bright.power / unit, name=f"source {number}")
            for number, bright in enumerate(split.sources, start=1)
        ]
        if not sources:
            sources = [Source(Direction(split.remainder.middle_above), 0.0, name="sky's middle")]
        return cls(tuple(sources), split.remainder.times(1.0 / unit))

    @property
    def first(self) -> Source:
        """The source that the bands speak of."""
        return self.sources[0]

    @property
    def others(self) -> tuple[Source, ...]:
        """All but the first."""
        return self.sources[1:]

    @property
    def lowest_tangent(self) -> float:
        """Tangent of the elevation of the lowest limb of all sources; of those that may be up, where
        any may.
        """
        limbs = [source.direction.elevation_rad - source.radius_rad for source in self.sources]
        tops = [source.direction.elevation_rad + source.radius_rad for source in self.sources]
        up = [limb for limb, top in zip(limbs, tops, strict=True) if top > -_NEVER_UP_RAD]
        return math.tan(max(min(up or limbs), -math.pi / 2.0))

    def with_source(self, source: Source) -> Lighting:
        """One more, after the others."""
        return replace(self, sources=(*self.sources, source))

    def describe(self) -> dict[str, Any]:
        """For tags and ``--explain``."""
        found: dict[str, Any] = {"sources": [source.describe() for source in self.sources]}
        return found | ({"sky_irradiance": self.sky.power_above} if self.sky else {})
