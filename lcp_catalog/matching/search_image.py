"""An image prepared for the search: without gaps, with weights, and at half resolution as well."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array, Float32, Index, Mask
from ..images.image import Image
from ..landmarks.corners import fill_missing
from ..landmarks.correlation import moments
from ..landmarks.patches import halved

_FILL_PX = 33
"""Width of the first window whose mean of valid pixels fills missing ones."""


LEAST_LIKENESS = 0.3
"""Least correlation of neighbouring pixels of an image of anything; that of plain noise is below.
"""


@dataclass(frozen=True, eq=False)
class SearchImage:
    """``fine`` (rows, cols): the signal less its mean, gaps filled; ``weight`` (rows, cols) 0..1;
    ``factor``: side of one of its pixels in pixels of the full-resolution image.
    """

    source: Image
    fine: Float32
    weight: Float32
    factor: int

    @classmethod
    def of(cls, image: Image) -> SearchImage:
        """Prepare an image. ValueError if it has no valid pixel."""
        valid = image.valid
        if not valid.any():
            raise ValueError(f"{image.name}: no pixel of it is valid")
        signal = np.where(valid, image.signal, np.float32(np.nan)).astype(np.float32)
        signal -= np.float32(np.nanmean(signal, dtype=np.float64))
        if not valid.all():
            signal = fill_missing(signal, _FILL_PX)
        weight = np.where(valid, image.weight, 0.0).astype(np.float32)
        return cls(image, np.ascontiguousarray(signal), weight, image.sensor.factor)

    @cached_property
    def half(self) -> Float32:
        """Means of 2 x 2 pixels, without an odd last row or column."""
        return halved(self.fine)

    @cached_property
    def half_weight(self) -> Float32:
        return halved(self.weight)

    def is_saturated(self, middle: Index, shape: tuple[int, int]) -> NDArray[np.bool_]:
        """True for the pixels (n, 2) around which most of the invalid pixels are saturated, not
        missing.
        """
        high, wide = (n // 2 for n in shape)
        lost = self.weight <= 0.0
        bright = lost & np.isfinite(self.source.signal)
        out = np.zeros(len(middle), dtype=np.bool_)
        for k, (col, row) in enumerate(middle):
            box = np.s_[max(row - high, 0) : row + high + 1, max(col - wide, 0) : col + wide + 1]
            out[k] = bright[box].sum() > 0.5 * lost[box].sum()
        return out


def full_pixels(pixels: Array, factor: int) -> Array:
    """Pixels of a reduced image in pixels of the full-resolution image."""
    return (pixels + 0.5) * factor - 0.5


def nothing_in(image: Image) -> str | None:
    """The reason why nothing can be found in an image; None if there is none."""
    valid = image.valid
    if not valid.any():
        return "the image has no valid pixel"
    signal = image.signal
    likeness = max(
        _correlation(signal[:, :-1], signal[:, 1:], valid[:, :-1] & valid[:, 1:]),
        _correlation(signal[:-1], signal[1:], valid[:-1] & valid[1:]),
    )
    if not likeness > LEAST_LIKENESS:
        return (
            "the image is blank or nothing but noise: "
            f"neighbouring pixels correlate by {likeness:.2f}"
        )
    return None


def _correlation(a: Float32, b: Float32, both: Mask) -> float:
    """Correlation of the pixels that are valid in both; 0 where there are none or one of the two is constant."""
    return float(moments(a[both], b[both]).correlation)
