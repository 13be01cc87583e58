"""The point spread of images, also of those that are reduced for a search."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import Array

POINT_SPREAD_PX = 0.5
"""Default 1 sigma of an image's point spread, beside the pixel's own square."""

SHARPEST_PX = 0.125
"""Least point spread of a reduced image: with less, points are lost (224 -> 200 in a frame of Apollo 15)."""

_GAIN = 0.07
"""Share by which errors of matches fall with each halving of the point spread, in photographs reduced 2 and 4 times."""


def reduced_spread_px(full_px: float, factor: int) -> float:
    """1 sigma of the point spread, in its own pixels, of an image that was reduced ``factor`` times by area means from
    one with a point spread of ``full_px`` pixels; at least `SHARPEST_PX`, or ``full_px``.
    """
    return max(full_px / factor, min(full_px, SHARPEST_PX))


def sharper_sigma(factor: ArrayLike) -> Array:
    """1 sigma of matches in images that were reduced ``factor`` times (n,), over that which a catalogue states: for
    images whose own pixels have the point spread `POINT_SPREAD_PX`. Exactly 1 for a factor of 1.
    """
    most = POINT_SPREAD_PX / SHARPEST_PX
    return np.asarray(1.0 - _GAIN * np.log2(np.minimum(factor, most)))
