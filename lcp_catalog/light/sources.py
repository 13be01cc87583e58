"""Light on a scene: one or more sources (points at infinity or discs) and a sky, all as directions
in the frame of the terrain.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

from numpy.typing import ArrayLike

from ..geometry.direction import Direction
from .environment_map import Panorama
from .environment_sources import SourceSplit
from .solar_disc import MEAN_SUN, SolarDisc

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
