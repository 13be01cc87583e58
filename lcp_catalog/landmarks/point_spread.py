"""The point spread of images, also of those that are reduced for a search, and the pixels of a template."""

from __future__ import annotations

from statistics import NormalDist

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import Array, Float32

POINT_SPREAD_PX = 0.5
"""Default 1 sigma of an image's point spread, beside the pixel's own square."""

SHARPEST_PX = 0.125
"""Least point spread of a reduced image: with less, points are lost (224 -> 200 in a frame of Apollo 15)."""

LEAST_COVER = 0.95
"""Least share of a pixel's point spread that falls on a patch, for the pixel to be one of its template's."""

_TO_EDGE = NormalDist().inv_cdf(LEAST_COVER)
"""Least distance of such a pixel's middle from the patch's edges, 1 sigma of square and point spread."""

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


def border_px(factor: ArrayLike = 1) -> Array:
    """How many pixels narrower than its patch a template is, in images that were reduced ``factor`` times (n,): 1.9
    for a factor of 1. Square and point spread together count as a Gaussian; 7000 templates agree within 2 % of their pixels.
    """
    spread_px = np.maximum(POINT_SPREAD_PX / np.asarray(factor, np.float64), SHARPEST_PX)
    return np.asarray(2.0 * _TO_EDGE * np.sqrt(spread_px**2 + 1.0 / 12.0))


def template_pixels(nodes: int, cosine: Array) -> Array:
    """Pixels (n,) of the template of a patch of nodes x nodes, in an image whose pixels are as far apart and which is not
    reduced, seen at emission angles of the given ``cosine`` (n,); at least one row of them.
    """
    width = nodes - 1
    return np.asarray((width - border_px()) * np.maximum(width * cosine - border_px(), 1.0))


BORDER_NODES = 1
"""Nodes at each edge of a patch that claims leave out: so many whole nodes are nearest to `border_px`."""


def within_border(patches: Float32) -> Float32:
    """Patches (n, p, p) without the `BORDER_NODES` at their edges."""
    return patches[:, BORDER_NODES:-BORDER_NODES, BORDER_NODES:-BORDER_NODES]
