"""Points of the surface whose radiance is asked for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import AnyArray, Array


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
