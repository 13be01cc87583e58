"""Light on the candidates' patches: their dependence on the terrain around them, and their radiance
without cast shadows.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..accuracy import TIERS
from ..arrays import Float32
from ..landmarks.independence import dependence
from ..landmarks.patches import gather_patches
from ..terrain.far_terrain import FarTerrain
from ..terrain.occlusion import occluded
from .sweep import RenderedImage, Sweep


class PatchLight:
    """The candidates' windows in the heightfield, and their dependence on terrain outside."""

    def __init__(
        self, sweep: Sweep, rows: NDArray[np.int64], cols: NDArray[np.int64], half: int
    ) -> None:
        self.sweep, self.where = sweep, (rows, cols, half)
        self._field_rows, self._field_cols = rows + sweep.window[0], cols + sweep.window[2]

    @property
    def turn_deg(self) -> float:
        """Azimuth of the points' north in the area's frame."""
        return float(np.degrees(self.sweep.turn_rad))

    def shadow_dependence(self, elevation: int, azimuth: int) -> tuple[Float32, NDArray[np.bool_]]:
        """Share of each patch's nodes that only terrain outside the patch shadows, (n,), and these
        nodes, (n, p, p).
        """
        direction = self.sweep.conditions.sun_direction(elevation, azimuth, self.sweep.turn_rad)
        return self._dependence(direction, self.sweep.far)

    def occlusion_dependence(self, view: int) -> Float32:
        """Share of each patch's nodes that only terrain outside the patch hides from the camera."""
        direction = self.sweep.conditions.view_direction(view, self.sweep.turn_rad)
        return self._dependence(direction, None)[0]

    def unshadowed(self, some: NDArray[np.int64], image: RenderedImage) -> Float32:
        """Radiance (m, p, p) of some patches without cast shadows; NaN where not visible."""
        rows, cols, half = self.where
        rows, cols = rows[some], cols[some]
        planes = np.stack([gather_patches(plane, rows, cols, half) for plane in self.sweep.planes])
        size = 2 * half + 1
        hidden = gather_patches(self.sweep.unseen[image.view], rows, cols, half)
        radiance = self.sweep.shaded(
            planes.reshape(3, -1, size),
            (image.view, image.elevation, image.azimuth),
            np.zeros((len(rows) * size, size), np.uint8),
            np.ascontiguousarray(hidden.reshape(-1, size)),
        ).reshape(-1, size, size)
        if self.sweep.factors is not None:
            radiance = radiance * gather_patches(self.sweep.factors, rows, cols, half)
        return radiance

    def _dependence(
        self, direction: NDArray[np.float64], far: FarTerrain | None
    ) -> tuple[Float32, NDArray[np.bool_]]:
        field, (rows, cols, half) = self.sweep.field, self.where
        if far is not None and not far.matters(field, direction, self.sweep.window):
            far = None  # tested once for all patches
        normals = self.sweep.normals @ direction.astype(np.float32)
        faces = gather_patches(normals > 0.0, rows, cols, half)
        alone = ~field.occluded_alone(self._field_rows, self._field_cols, half, direction)
        exact = TIERS["reference"]
        full = np.stack(
            [
                ~occluded(
                    field, direction, exact, (r - half, r + half + 1, c - half, c + half + 1), far
                )
                for r, c in zip(self._field_rows, self._field_cols, strict=True)
            ]
        )
        share = dependence(alone & faces, full & faces).astype(np.float32)
        return share, alone & ~full & faces
