"""The ground of an area, kept from the first pass of a build of two to the second: its terrain, its scene plan, the brightness
of its nodes and the shadows of its Suns.

The bytes hold the arrays themselves, so what is made of them is the same bit for bit. They go with results and jobs, so it does not
matter which process or machine makes an area.
"""

from __future__ import annotations

import math
import pickle
from dataclasses import dataclass, field

import numpy as np

from ..arrays import Bytes, Float32
from ..rendering.plan import ScenePlan
from ..terrain.terrain import Terrain
from .sweep import Sweep

KEPT_MB = 128.0
"""Most memory for the grounds of a build, of 0.8 to 1.5 MB an area on the sample."""

KEPT_AREAS = 1000
"""Of builds of more areas none is kept: most would not fit."""


AreaGround = tuple[Terrain, ScenePlan, Float32 | None, dict[int, Bytes]]
"""Terrain, plan, brightness and shadows of an area's sweep."""


def packed(sweep: Sweep) -> bytes:
    """The ground of an area's sweep, as `unpacked` takes it."""
    shadows = {azimuth: (dark.shape, np.packbits(dark)) for azimuth, dark in sweep.shadows.items()}
    return pickle.dumps((sweep.terrain, sweep.plan, sweep.brightness, shadows), protocol=5)


def unpacked(ground: bytes) -> AreaGround:
    """The ground of `packed`."""
    terrain, plan, brightness, shadows = pickle.loads(ground)
    masks = {
        azimuth: np.unpackbits(bits, count=math.prod(shape)).reshape(shape)
        for azimuth, (shape, bits) in shadows.items()
    }
    return terrain, plan, brightness, masks


@dataclass
class KeptGrounds:
    """The grounds of areas, by name, up to ``most_mb``."""

    most_mb: float = KEPT_MB
    _grounds: dict[str, bytes] = field(default_factory=dict)
    _held: int = 0

    def keep(self, name: str, ground: bytes) -> None:
        """Keep the ground of an area if there is room."""
        if self._held + len(ground) <= 1e6 * self.most_mb:
            self._grounds[name] = ground
            self._held += len(ground)

    def of(self, name: str) -> bytes | None:
        """The ground of an area; None where it was not kept."""
        return self._grounds.get(name)
