"""Patches that are evaluated together: candidates in images."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from ..arrays import Array, Float32, Index
from ..landmarks.error_model import PatchErrors
from ..landmarks.patches import patches_of


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
    and the images (k, rows, cols): radiance, and its slope sensitivities.
    """

    items: Items
    seen: Float32
    alone: Float32
    level: Array
    shown: list[Float32]

    @property
    def size(self) -> int:
        """Nodes along a side."""
        return self.alone.shape[1]

    @property
    def errors(self) -> PatchErrors:
        """The patches' sources of error."""
        return PatchErrors(self.seen, *(self.items.of(slope) for slope in self.shown[1:]))

    def some(self, chosen: Index) -> Patches:
        """A selection of the patches."""
        parts = (self.seen[chosen], self.alone[chosen], self.level[chosen])
        return Patches(self.items.some(chosen), *parts, self.shown)
