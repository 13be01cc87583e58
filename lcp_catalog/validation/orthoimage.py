"""An image on the ground's grid: what it shows of each cell of a terrain.

Every cell's footprint in the image is a parallelogram, from where its neighbours project. Where the image is finer than
the ground the signal is the mean over that parallelogram (`kernels.footprint`), so that nothing aliases and
nothing is lost; where it is coarser it is interpolated by cubic convolution. Missing and saturated pixels
weigh nothing; ground that the camera does not see is left out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import Array, Mask
from ..images.image import Image
from ..kernels.resampling import area_means
from ..terrain.relief_bounds import nodes_enu
from ..terrain.terrain import Terrain

_FINE_PX = 4.0
"""Where the narrowest footprints are wider than twice this, the image is reduced until they are not: a footprint's
border then lies wrong by an eighth of its width at most.
"""


@dataclass(frozen=True, eq=False)
class Ortho:
    """An image at ground nodes (rows, cols): ``signal``, NaN where ``weight`` is 0; ``weight`` 0..1; ``pixels`` (rows, cols,
    2) where each node lies in the image, NaN where it cannot; ``footprint_px``, the typical footprint's longer
    side: above 1 the image is finer than the ground.
    """

    signal: Array
    weight: Array
    pixels: Array
    footprint_px: float


def terrain_nodes(terrain: Terrain) -> Array:
    """MCMF positions (rows, cols, 3) of a terrain's core, metres; NaN without a height."""
    return terrain.frame.to_mcmf(nodes_enu(terrain.field, terrain.core))


def orthorectify(photo: Image, nodes_mcmf_m: ArrayLike, visible: ArrayLike | None = None) -> Ortho:
    """The image at the nodes (rows, cols, 3) of a grid of the ground, each the mean over its cell.

    ``visible`` (rows, cols): which nodes the camera sees (a render says that); none: all that project into
    the image. At the border of the grid, or of its heights, a footprint is that of one-sided differences.
    ValueError for anything but a grid of at least 2 x 2 nodes.
    """
    nodes = np.asarray(nodes_mcmf_m, dtype=np.float64)
    if nodes.ndim != 3 or nodes.shape[2] != 3 or min(nodes.shape[:2]) < 2:
        raise ValueError(f"nodes are (rows, cols, 3), two or more a side, not {nodes.shape}")
    pixels = photo.sensor.project(nodes)
    seen = photo.sensor.in_image(pixels)
    if visible is not None:
        seen &= np.asarray(visible, dtype=np.bool_)
    down, right = (_steps(pixels, axis) for axis in (0, 1))
    seen &= np.isfinite(down[..., 0]) & np.isfinite(right[..., 0])
    narrow, wide = _footprints_px(down, right, seen)
    factor = max(1, math.floor(narrow / _FINE_PX))
    at, down, right = (pixels + 0.5) / factor - 0.5, down / factor, right / factor
    signal, weight = _means(photo.reduced(factor), seen, at, down, right)
    return Ortho(signal, weight, pixels, wide)


def _steps(pixels: Array, axis: int) -> Array:
    """By how much the pixel moves from a node to the next along an axis: central differences, one-sided ones beside
    what has none, NaN where neither neighbour has.
    """
    along = np.moveaxis(pixels, axis, 0)
    nothing = np.full((1, *along.shape[1:]), np.nan)
    ahead = np.concatenate([along[1:] - along[:-1], nothing])
    behind = np.concatenate([nothing, along[1:] - along[:-1]])
    both = np.where(
        np.isnan(ahead), behind, np.where(np.isnan(behind), ahead, 0.5 * (ahead + behind))
    )
    return np.moveaxis(both, 0, axis)


def _footprints_px(down: Array, right: Array, seen: Mask) -> tuple[float, float]:
    """The longer side of footprints: of the narrowest twentieth, and of the middle one; 0 where nothing is seen."""
    longer = np.maximum(np.linalg.norm(down, axis=-1), np.linalg.norm(right, axis=-1))[seen]
    narrow, wide = np.percentile(longer, [5, 50]) if longer.size else (0.0, 0.0)
    return float(narrow), float(wide)


def _means(photo: Image, seen: Mask, at: Array, down: Array, right: Array) -> tuple[Array, Array]:
    """Means over the footprints that are seen, and their weights, (rows, cols)."""
    weight = np.where(photo.valid, photo.weight, 0.0).astype(np.float32)
    light = np.where(weight > 0.0, photo.signal, 0.0).astype(np.float32)
    signal, mass = np.empty(int(seen.sum())), np.empty(int(seen.sum()))
    area_means.means(light, weight, at[seen], down[seen], right[seen], signal, mass)
    whole = np.full(seen.shape, np.nan), np.zeros(seen.shape)
    for out, values in zip(whole, (signal, mass), strict=True):
        out[seen] = values
    return whole
