"""Where terrain hides nodes from a direction (the Sun, a camera at infinity), as exactly as a tier wants."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .accuracy import Accuracy
from .heightfield import Heightfield, Window

Mask = NDArray[np.bool_]


def occluded(
    field: Heightfield, direction: ArrayLike, accuracy: Accuracy, window: Window | None = None
) -> Mask:
    """For each node of the window, bool (rows, cols), whether the surface rises above the ray in
    ``direction`` (3,), a unit ENU vector; at most ``accuracy.node_error`` of them are wrong.
    """
    east, north, up = (float(v) for v in np.asarray(direction, dtype=np.float64))
    if accuracy.tier == "draft":
        elevation = math.atan2(up, math.hypot(east, north))
        return field.sweep_occluded(math.atan2(east, north), [elevation], window)[0].astype(
            np.bool_
        )
    return field.occluded_nodes(direction, window)


def occluded_sweep(
    field: Heightfield,
    azimuth_rad: float,
    elevations_rad: ArrayLike,
    accuracy: Accuracy,
    window: Window | None = None,
) -> NDArray[np.uint8]:
    """The same for several elevations of one azimuth, uint8 (elevations, rows, cols)."""
    elevations = np.atleast_1d(np.asarray(elevations_rad, dtype=np.float64))
    if accuracy.tier == "draft":
        return field.sweep_occluded(azimuth_rad, elevations, window)
    level = np.cos(elevations)
    directions = np.stack(
        [np.sin(azimuth_rad) * level, np.cos(azimuth_rad) * level, np.sin(elevations)], axis=-1
    )
    return np.stack([field.occluded_nodes(d, window) for d in directions]).view(np.uint8)
