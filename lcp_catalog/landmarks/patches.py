"""Patches of an image, the image at half resolution, and as a camera shows it."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from ..arrays import Float32, Index
from ..kernels.matching import patches as kernels
from .point_spread import POINT_SPREAD_PX


def through_optics(
    images: Float32, scale: int, point_spread_px: float = POINT_SPREAD_PX
) -> Float32:
    """Images (k, rows, cols) without NaN through a pixel's square and a Gaussian of
    ``point_spread_px`` pixels; their borders are extended.

    ``scale``: nodes along a pixel of the image, which is the mean over that many nodes. The square
    of a pixel has the variance 1/12 px^2, of which the mean over nodes has taken (1 - 1/scale^2)/12;
    the rest is added to the Gaussian's.
    """
    out = np.empty_like(images)
    kernels.blurred(images, _spread(point_spread_px**2 + 1.0 / (12.0 * scale**2)), out)
    return out


@lru_cache
def _spread(variance: float) -> Float32:
    """A Gaussian at whole pixels (7,) with the given variance there, px^2, at most 1."""
    at = np.arange(-3.0, 4.0)
    low, high = 0.1, 2.0
    for _ in range(40):
        sigma = 0.5 * (low + high)
        kernel = np.exp(-0.5 * (at / sigma) ** 2)
        kernel /= kernel.sum()
        low, high = (sigma, high) if kernel @ at**2 < variance else (low, sigma)
    return kernel.astype(np.float32)


def patches_of(images: Float32, which: Index, rows: Index, cols: Index, half: int) -> Float32:
    """The (2 half + 1)^2 nodes around each (row, col) of image ``which`` (n,) of images (k, rows,
    cols), shape (n, 2 half + 1, 2 half + 1); NaN for nodes outside the image.
    """
    size = 2 * half + 1
    out = np.empty((len(which), size, size), np.float32)
    kernels.gather(images, which, rows, cols, half, out)
    return out


def halved(images: Float32) -> Float32:
    """Means of 2 x 2 pixels of images (..., rows, cols), (..., rows // 2, cols // 2); an odd last row
    or column is left out.
    """
    whole = np.ascontiguousarray(images, dtype=np.float32).reshape(-1, *images.shape[-2:])
    out = np.empty((len(whole), whole.shape[1] // 2, whole.shape[2] // 2), np.float32)
    kernels.halved(whole, out)
    return out.reshape(*images.shape[:-2], *out.shape[1:])


def halved_changes(changes: Float32, rows: Index, cols: Index) -> Float32:
    """Differences (n, p, p) from an image at the patches around (rows, cols), at half their
    resolution, on the pixels of the image at half its resolution (`halved`), (n, q, q) with q = 2
    (p // 4) + 1; 0 beyond the patches.
    """
    size = 2 * (changes.shape[1] // 4) + 1
    out = np.empty((len(changes), size, size), np.float32)
    kernels.halved_changes(changes, rows, cols, out)
    return out
