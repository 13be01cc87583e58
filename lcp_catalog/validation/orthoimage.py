"""Orthoimage: an image resampled to the nodes of a terrain.

The footprint of a cell in the image is a parallelogram, given by the projections of its neighbours.
If the image is finer than the terrain, the signal is the mean over that parallelogram
(`kernels.resampling.area_means`), without aliasing; if it is coarser, it is interpolated by cubic
convolution. Missing and saturated pixels have no weight; nodes hidden from the camera are left out.
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
"""If the narrowest footprints are wider than twice this, pixels, the image is reduced first. The
edges of a footprint are then wrong by at most an eighth of its width.
"""


@dataclass(frozen=True, eq=False)
class Ortho:
    """An image at terrain nodes (rows, cols): ``signal``, NaN where ``weight`` is 0; ``weight``
    0..1; ``pixels`` (rows, cols, 2), the projections of the nodes, NaN where there is none;
    ``footprint_px``, the longer side of the typical footprint, above 1 if the image is finer than
    the terrain.
    """

    signal: Array
    weight: Array
    pixels: Array
    footprint_px: float


def terrain_nodes(terrain: Terrain) -> Array:
    """MCMF positions (rows, cols, 3) of the nodes of a terrain's core, metres; NaN without a
    height.
    """
    return terrain.frame.to_mcmf(nodes_enu(terrain.field, terrain.core))


def orthorectify(image: Image, nodes_mcmf_m: ArrayLike, visible: ArrayLike | None = None) -> Ortho:
    """Mean of the image over the cell of each node of a terrain grid, MCMF metres (rows, cols, 3).

    ``visible`` (rows, cols): True for nodes visible to the camera, as from a render; default: all
    nodes that project into the image. At the edges of the grid and of its heights, footprints are
    from one-sided differences. ValueError for a grid of fewer than 2 x 2 nodes.
    """
    nodes = np.asarray(nodes_mcmf_m, dtype=np.float64)
    if nodes.ndim != 3 or nodes.shape[2] != 3 or min(nodes.shape[:2]) < 2:
        raise ValueError(
            f"nodes must be (rows, cols, 3) with two or more a side, not {nodes.shape}"
        )
    pixels = image.sensor.project(nodes)
    seen = image.sensor.in_image(pixels)
    if visible is not None:
        seen &= np.asarray(visible, dtype=np.bool_)
    down, right = (_steps(pixels, axis) for axis in (0, 1))
    seen &= np.isfinite(down[..., 0]) & np.isfinite(right[..., 0])
    narrow, wide = _footprints_px(down, right, seen)
    factor = max(1, math.floor(narrow / _FINE_PX))
    at, down, right = (pixels + 0.5) / factor - 0.5, down / factor, right / factor
    signal, weight = _means(image.reduced(factor), seen, at, down, right)
    return Ortho(signal, weight, pixels, wide)


def _steps(pixels: Array, axis: int) -> Array:
    """Pixel steps from node to node along an axis: central differences, one-sided beside missing
    nodes, NaN between two missing nodes.
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
    """5th percentile and median of the longer sides of the footprints, pixels; 0 without visible
    nodes.
    """
    longer = np.maximum(np.linalg.norm(down, axis=-1), np.linalg.norm(right, axis=-1))[seen]
    narrow, wide = np.percentile(longer, [5, 50]) if longer.size else (0.0, 0.0)
    return float(narrow), float(wide)


def _means(image: Image, seen: Mask, at: Array, down: Array, right: Array) -> tuple[Array, Array]:
    """Means over the visible footprints, and their weights, (rows, cols)."""
    weight = np.where(image.valid, image.weight, 0.0).astype(np.float32)
    light = np.where(weight > 0.0, image.signal, 0.0).astype(np.float32)
    signal, mass = np.empty(int(seen.sum())), np.empty(int(seen.sum()))
    area_means.means(light, weight, at[seen], down[seen], right[seen], signal, mass)
    whole = np.full(seen.shape, np.nan), np.zeros(seen.shape)
    for out, values in zip(whole, (signal, mass), strict=True):
        out[seen] = values
    return whole
