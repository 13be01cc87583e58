"""What lights a scene: one source or several, each a point far away or a disc, all as directions in
the frame of the terrain.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .solar_disc import MEAN_SUN, SolarDisc

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Source:
    """Parallel light, or a disc of it far away.

    direction (3,): unit ENU vector from the surface to its middle. irradiance: of a surface held
    square to it, relative to what `Lighting` calls one. disc: its size and limb darkening; None is
    a point.
    """

    direction: Array
    irradiance: float = 1.0
    disc: SolarDisc | None = None
    name: str = "Sun"


@dataclass(frozen=True, eq=False)
class Lighting:
    """All that lights a scene. The bands that speak of one light (sunlit, incidence, phase) speak
    of the first source.
    """

    sources: tuple[Source, ...]

    @classmethod
    def of_sun(cls, direction: Array, disc: SolarDisc | bool = False) -> Lighting:
        """A lone Sun of irradiance one: a point, the mean disc (True), or a stated one."""
        size = disc if isinstance(disc, SolarDisc) else MEAN_SUN if disc else None
        return cls((Source(np.asarray(direction, dtype=np.float64), disc=size),))

    @property
    def first(self) -> Source:
        """The source that the bands speak of."""
        return self.sources[0]

    @property
    def others(self) -> tuple[Source, ...]:
        """All but the first."""
        return self.sources[1:]
