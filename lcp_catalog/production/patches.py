"""Patches of images that are evaluated together, and their dependence on the terrain around them."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from ..arrays import Array, Bytes, Float32, Index, Mask
from ..landmarks.error_model import PatchErrors
from ..landmarks.patches import patches_of
from .sweep import Sweep


@dataclass(frozen=True)
class Items:
    """Patches of images: the candidate and the image (n,) of each, the row and column of its middle,
    and the nodes from there to its edge.
    """

    candidate: Index
    which: Index
    rows: Index
    cols: Index
    half: int

    @classmethod
    def all(cls, images: int, rows: Index, cols: Index, half: int) -> Items:
        """All candidates in all images, ordered by image."""
        count = len(rows)
        which = np.repeat(np.arange(images), count)
        candidate = np.tile(np.arange(count), images)
        return cls(candidate, which, rows[candidate], cols[candidate], half)

    def of(self, images: Float32) -> Float32:
        """The patches (n, p, p) of images (k, rows, cols)."""
        return patches_of(images, self.which, self.rows, self.cols, self.half)

    def some(self, chosen: Index) -> Items:
        """A selection of the items."""
        parts = (self.candidate, self.which, self.rows, self.cols)
        candidate, which, rows, cols = (part[chosen] for part in parts)
        return Items(candidate, which, rows, cols, self.half)

    def halved(self) -> Items:
        """The same places in images at half the resolution."""
        return dataclasses.replace(
            self, rows=self.rows // 2, cols=self.cols // 2, half=self.half // 2
        )


@dataclass(frozen=True)
class Patches:
    """Patches (n, p, p) in images and rendered from their own nodes alone, their mean lit level (n,),
    and the images (k, rows, cols): radiance, and its derivatives with respect to the slopes towards east
    and south.
    """

    items: Items
    seen: Float32
    alone: Float32
    level: Array
    radiance: Float32
    slopes: Float32  # (2, k, rows, cols)

    @property
    def size(self) -> int:
        """Nodes along a side."""
        return int(self.alone.shape[1])

    @property
    def errors(self) -> PatchErrors:
        """The patches' sources of error."""
        east, south = self.slopes
        return PatchErrors(self.seen, self.items.of(east), self.items.of(south))

    def some(self, chosen: Index) -> Patches:
        """A selection of the patches."""
        return dataclasses.replace(
            self,
            items=self.items.some(chosen),
            seen=self.seen[chosen],
            alone=self.alone[chosen],
            level=self.level[chosen],
        )


@dataclass(frozen=True)
class PatchLight:
    """The candidates' windows in the heightfield of a sweep, around nodes (rows, cols) of its core, and
    their dependence on terrain outside.
    """

    sweep: Sweep
    rows: Index
    cols: Index
    half: int

    @property
    def turn_deg(self) -> float:
        """Azimuth of the points' north in the area's frame."""
        return float(np.degrees(self.sweep.turn_rad))

    def shadow_dependence(self, elevation: int, azimuth: int) -> tuple[Float32, Mask]:
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
        centres = zip(self.rows.tolist(), self.cols.tolist(), strict=True)
        return np.array([self._hidden_from(view, camera, r, c) for r, c in centres], np.float32)

    def _hidden_from(self, view: int, camera: Array, row: int, col: int) -> float:
        """Share of the nodes of one patch that face a near camera (ENU, (3,)), and that only terrain
        outside the patch hides from it.
        """
        sweep, half = self.sweep, self.half
        part = np.s_[row - half : row + half + 1, col - half : col + half + 1]
        towards = sweep.towards_camera(view)
        assert towards is not None
        faces = np.sum(sweep.planes[:, *part] * towards[:, *part], axis=0) > 0.0
        top, left = sweep.window[0] + row - half, sweep.window[2] + col - half
        alone = sweep.field.part((top, top + 2 * half + 1, left, left + 2 * half + 1))
        cast = sweep.unseen(view)[part] & faces & ~alone.occluded_nodes_from(camera)
        return float(cast.mean())

    def _dependence(self, direction: Array, dark: Bytes) -> tuple[Float32, Mask]:
        sweep = self.sweep
        cast = sweep.field.shadowed_from_outside(
            dark[None],
            sweep.planes,
            sweep.window,
            (self.rows, self.cols),
            self.half,
            direction[None],
        )[0]
        return cast.mean(axis=(1, 2)).astype(np.float32), cast
