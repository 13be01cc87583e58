"""Light on the candidates' patches: their dependence on the terrain around them, and their radiance
without cast shadows.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array, Float32, Mask
from ..landmarks.patches import gather_patches
from .sweep import RenderedImage, Sweep


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

    def unshadowed(self, some: NDArray[np.int64], image: RenderedImage) -> Float32:
        """Radiance (m, p, p) of some patches without cast shadows; NaN where not visible."""
        size = 2 * self.where[2] + 1
        radiance = self.sweep.shaded(
            self._planes[:, some].reshape(3, -1, size),
            (image.view, image.elevation, image.azimuth),
            np.zeros((len(some) * size, size), np.uint8),
            self._unseen[image.view, some].reshape(-1, size),
        ).reshape(-1, size, size)
        return radiance if self._factors is None else radiance * self._factors[some]

    @cached_property
    def _planes(self) -> Float32:
        """The normals' components at the patches, (3, n, p, p)."""
        return np.stack([gather_patches(plane, *self.where) for plane in self.sweep.planes])

    @cached_property
    def _unseen(self) -> Mask:
        """True where terrain hides a node of a patch in a view, (view, n, p, p)."""
        return np.stack([gather_patches(hidden, *self.where) for hidden in self.sweep.unseen])

    @cached_property
    def _factors(self) -> Float32 | None:
        """Albedo factors of the patches, (n, p, p)."""
        factors = self.sweep.factors
        return None if factors is None else gather_patches(factors, *self.where)

    def _dependence(
        self, direction: Array, dark: NDArray[np.uint8]
    ) -> tuple[Float32, NDArray[np.bool_]]:
        sweep, (rows, cols, half) = self.sweep, self.where
        cast = sweep.field.shadowed_from_outside(
            dark[None], sweep.planes, sweep.window, (rows, cols), half, direction[None]
        )[0]
        return cast.mean(axis=(1, 2)).astype(np.float32), cast
