"""Light on the candidates' patches: their dependence on the terrain around them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array, Float32
from .sweep import Sweep


class PatchLight:
    """The candidates' windows in the heightfield, and their dependence on terrain outside."""

    def __init__(
        self, sweep: Sweep, rows: NDArray[np.int64], cols: NDArray[np.int64], half: int
    ) -> None:
        self.sweep, self.where = sweep, (rows, cols, half)

    @property
    def turn_deg(self) -> float:
        """Azimuth of the points' north in the area's frame."""
        return float(np.degrees(self.sweep.turn_rad))

    def shadow_dependence(self, elevation: int, azimuth: int) -> tuple[Float32, NDArray[np.bool_]]:
        """Share of each patch's nodes that only terrain outside the patch shadows, (n,), and these
        nodes, (n, p, p).
        """
        sun = self.sweep.sun_directions[elevation, azimuth]
        before = int(self.sweep.conditions.reachable[:elevation, azimuth].sum())
        return self._dependence(sun, self.sweep.dark(azimuth)[before])

    def occlusion_dependence(self, view: int) -> Float32:
        """Share of each patch's nodes that only terrain outside the patch hides from the camera."""
        hidden = self.sweep.unseen[view].view(np.uint8)
        return self._dependence(self.sweep.view_directions[view], hidden)[0]

    def _dependence(
        self, direction: Array, dark: NDArray[np.uint8]
    ) -> tuple[Float32, NDArray[np.bool_]]:
        sweep, (rows, cols, half) = self.sweep, self.where
        cast = sweep.field.shadowed_from_outside(
            dark[None], sweep.planes, sweep.window, (rows, cols), half, direction[None]
        )[0]
        return cast.mean(axis=(1, 2)).astype(np.float32), cast
