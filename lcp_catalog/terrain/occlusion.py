"""Occlusion of nodes by terrain in a direction (the Sun, a camera at infinity), by accuracy tier.

- draft: two lines per column and a stencil of the nearest cells (`kernels.shadows.draft`). Measured:
  at most 0.5 % of the nodes are wrong, 95 % of these within two nodes of a shadow's edge.
- standard: a proved upper bound gives lit nodes; a node is dark if the two lines beside it are
  dark; all others are traced (`kernels.shadows.proved_bounds`). Measured: at most 0.02 % are wrong
  (dark instead of lit, where light passes between two lines).
- high: proved bounds on both sides; nodes that they leave undecided are traced. No node is wrong.
- reference: every node is traced.

Terrain beyond the field (`far_terrain`) is tested for the nodes that the field itself leaves lit.
In draft and standard the heights of its shadows at every eighth node are used where these are
clear; otherwise, and in high and reference, rays are traced.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..accuracy import Accuracy
from ..arrays import Mask
from ..geometry.frames import Direction, direction_enu_rad
from .far_terrain import FarTerrain
from .heightfield import Heightfield, Window
from .occlusion_scan import LIKELY, PROVED, draft_occluded, hybrid_occluded


def occluded(
    field: Heightfield,
    direction: ArrayLike,
    accuracy: Accuracy,
    window: Window | None = None,
    far: FarTerrain | None = None,
) -> Mask:
    """True for nodes of the window, bool (rows, cols), where the surface rises above the ray in
    ``direction`` (3,), an ENU vector; at most a share ``accuracy.node_error`` of them is wrong.

    ``far``: terrain beyond the field. Nodata is not occluded. ValueError for an invalid direction
    or a window outside the raster.
    """
    out = _occluded(field, direction, accuracy, window)
    if far is not None:
        towards = np.asarray(direction, dtype=np.float64)
        far.shadowed(field, towards, accuracy, field.checked_window(window), out)
    return out


def _occluded(
    field: Heightfield, direction: ArrayLike, accuracy: Accuracy, window: Window | None
) -> Mask:
    """Occlusion by the field alone."""
    ray = field.ray_in_cells(direction)
    if accuracy.shadows == "rays" or ray[:2] == (0.0, 0.0):
        return field.occluded_nodes(direction, window)
    inside = field.checked_window(window)
    if accuracy.shadows == "lines":
        towards = Direction.of(direction)
        elevations = np.array([towards.elevation_rad])
        masks = draft_occluded(field, towards.azimuth_rad, elevations, inside)
        return np.asarray(masks[0].view(np.bool_))
    effort = PROVED if accuracy.shadows == "proved" else LIKELY
    return hybrid_occluded(field, ray, inside, effort)[0]


def occluded_sweep(
    field: Heightfield,
    azimuth_rad: float,
    elevations_rad: ArrayLike,
    accuracy: Accuracy,
    window: Window | None = None,
    far: FarTerrain | None = None,
) -> NDArray[np.uint8]:
    """Occlusion for several elevations at one azimuth, uint8 (elevations, rows, cols): 1 where
    dark.

    ValueError unless elevations lie between -90 (excluded) and 90 degrees and the azimuth is
    finite.
    """
    elevations = np.atleast_1d(np.asarray(elevations_rad, dtype=np.float64))
    if not ((elevations > -math.pi / 2) & (elevations <= math.pi / 2 + 1e-12)).all():
        raise ValueError("elevations must lie above -90 and up to 90 degrees")
    if not math.isfinite(azimuth_rad):
        raise ValueError(f"invalid azimuth {azimuth_rad}")
    inside = field.checked_window(window)
    directions = direction_enu_rad(azimuth_rad, elevations)
    if accuracy.shadows == "lines":
        masks_ = draft_occluded(field, azimuth_rad, elevations, inside)
        if far is not None:
            for mask, direction in zip(masks_, directions, strict=True):
                far.shadowed(field, direction, accuracy, inside, mask.view(np.bool_))
        return masks_
    masks = [occluded(field, direction, accuracy, inside, far) for direction in directions]
    rows, cols = inside[1] - inside[0], inside[3] - inside[2]
    return np.array(masks, dtype=np.uint8).reshape(len(masks), rows, cols)
