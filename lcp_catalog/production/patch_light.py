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
        camera, hidden = self.sweep.camera_m(view), self.sweep.unseen(view)
        if camera is None:
            return self._dependence(self.sweep.view_directions[view], hidden.view(np.uint8))[0]
        return np.array([self._hidden_from(view, camera, *at) for at in self._centres], np.float32)

    @property
    def _centres(self) -> zip[tuple[int, int]]:
        rows, cols, _ = self.where
        return zip(rows.tolist(), cols.tolist(), strict=True)

    def _hidden_from(self, view: int, camera: Array, row: int, col: int) -> float:
        """Share of the nodes of one patch that face a near camera (ENU, (3,)), and that only terrain
        outside the patch hides from it.
        """
        sweep, half = self.sweep, self.where[2]
        part = np.s_[row - half : row + half + 1, col - half : col + half + 1]
        towards = sweep.towards_camera(view)
        assert towards is not None
        faces = np.sum(sweep.planes[:, *part] * towards[:, *part], axis=0) > 0.0
        top, left = sweep.window[0] + row - half, sweep.window[2] + col - half
        alone = sweep.field.part((top, top + 2 * half + 1, left, left + 2 * half + 1))
        cast = sweep.unseen(view)[part] & faces & ~alone.occluded_nodes_from(camera)
        return float(cast.mean())

    def _dependence(
        self, direction: Array, dark: NDArray[np.uint8]
    ) -> tuple[Float32, NDArray[np.bool_]]:
        sweep, (rows, cols, half) = self.sweep, self.where
        cast = sweep.field.shadowed_from_outside(
            dark[None], sweep.planes, sweep.window, (rows, cols), half, direction[None]
        )[0]
        return cast.mean(axis=(1, 2)).astype(np.float32), cast
