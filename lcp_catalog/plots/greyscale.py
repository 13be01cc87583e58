"""Pictures for a page: values with holes become grey pixels, no more of them than a page can carry."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..arrays import Array

PIXELS_MAX = 640_000
"""Most pixels of a picture: about half a megabyte as PNG."""

SIDE_MAX = 3000
"""Longest side of a picture, pixels: strips of scanners are long."""

DARK, LIGHT = 8, 247
"""Grey of the 1st and the 99th percentile."""


def shrunk(values: ArrayLike, pixels_max: int = PIXELS_MAX, side_max: int = SIDE_MAX) -> Array:
    """Values (rows, cols) with NaN as a smaller picture of the same extent: each new pixel is the mean, by area, of the known ones
    below it, NaN where less than half of it is known. What is small enough stays as it is.
    """
    picture = np.asarray(values)
    rows, cols = picture.shape
    scale = min(1.0, math.sqrt(pixels_max / max(rows * cols, 1)), side_max / max(rows, cols, 1))
    if scale == 1.0:
        return picture.astype(np.float64)
    shape = max(1, int(rows * scale)), max(1, int(cols * scale))
    known = np.isfinite(picture)
    light = _area_means(np.where(known, picture, 0.0), shape)
    share = _area_means(known, shape)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(share >= 0.5 - 1e-9, light / share, np.nan)


def _area_means(values: NDArray[np.generic], shape: tuple[int, int]) -> Array:
    """Means over equal boxes whose borders may cut pixels, down and then across."""
    half = _along_rows(values, shape[0])
    return _along_rows(half.T, shape[1]).T


def _along_rows(values: NDArray[np.generic], count: int) -> Array:
    """Means of ``count`` equal stretches of rows, no more than there are: whole rows, and parts of the ones that borders cut."""
    rows = len(values)
    edges = np.linspace(0.0, rows, count + 1)
    first = edges[:-1].astype(np.int64)
    total = np.add.reduceat(values, first, axis=0, dtype=np.float64)
    before = np.asarray(values[first], dtype=np.float64) * (edges[:-1] - first)[:, None]
    total -= before
    total[:-1] += before[1:]
    return total * (count / rows)


def grey(values: ArrayLike, like: ArrayLike | None = None) -> NDArray[np.uint8]:
    """Values (rows, cols) as grey and alpha (rows, cols, 2): the 1st to the 99th percentile from `DARK` to `LIGHT`; NaN is
    transparent. With ``like``, another picture of the same ground, percentiles are taken where both are known, so that
    two pictures that differ by gain and offset look the same.
    """
    picture = np.asarray(values, dtype=np.float64)
    known = np.isfinite(picture)
    both = known if like is None else known & np.isfinite(np.asarray(like))
    pixels = np.zeros((*picture.shape, 2), dtype=np.uint8)
    if known.any():
        low, high = np.percentile(picture[both if both.any() else known], [1.0, 99.0])
        stretched = DARK + (LIGHT - DARK) * (picture[known] - low) / (
            high - low if high > low else 1.0
        )
        pixels[known, 0] = np.clip(stretched, 0, 255).astype(np.uint8)
        pixels[known, 1] = 255
    return pixels


@dataclass(frozen=True, eq=False)
class Pictures:
    """What is shown of an image; None for what there is not. Values may have any gain and offset, NaN where there are none.

    ``photo`` (rows, cols) has blocks of ``photo_factor`` x ``photo_factor`` pixels of the image as it came; ``ground_image`` and
    ``ground_render`` (rows, cols) are on the grid of the windows; where patches were compared they are (k, rows, cols), and
    the windows say which.
    """

    photo: NDArray[Any] | None = None
    photo_factor: int = 1
    ground_image: NDArray[Any] | None = None
    ground_render: NDArray[Any] | None = None
