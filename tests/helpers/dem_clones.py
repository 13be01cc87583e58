"""Clones of a DEM: its surface plus an error that its statistics allow, and ground of a brightness that no map holds.

Errors are Gaussian fields with the autocorrelation exp(-r^2 / 2 l^2), made on the DEM's own nodes, whose spacing differs along
meridians and parallels. Nothing here uses the library.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from .embree_mesh import RADIUS_M, Nodes

Array = NDArray[np.float64]

_DARKEST = 0.1


@dataclass(frozen=True)
class Errors:
    """1 sigma and correlation length of height errors, metres, and of relative brightness."""

    height_sigma_m: float
    height_length_m: float
    albedo_sigma: float
    albedo_length_m: float


def clone(nodes: Nodes, errors: Errors, dice: np.random.Generator) -> tuple[Nodes, Array]:
    """Nodes with height errors, and the brightness of each node; missing heights stay missing."""
    error = errors.height_sigma_m * field(nodes, errors.height_length_m, dice)
    shade = 1.0 + errors.albedo_sigma * field(nodes, errors.albedo_length_m, dice)
    return replace(nodes, height_m=nodes.height_m + error), np.maximum(shade, _DARKEST)


def field(nodes: Nodes, length_m: float, dice: np.random.Generator) -> Array:
    """Gaussian field of unit variance on the nodes: white noise through a Gaussian of length / sqrt 2. The spacing along
    parallels is that of the middle row.
    """
    rows, cols = nodes.height_m.shape
    middle = np.cos(np.radians(nodes.lat_deg[rows // 2, 0]))
    steps = np.radians(
        [nodes.lat_deg[0, 0] - nodes.lat_deg[1, 0], nodes.lon_deg[0, 1] - nodes.lon_deg[0, 0]]
    )
    spacing_m = RADIUS_M * np.abs(steps) * np.array([1.0, middle])
    smooth = gaussian_filter(
        dice.normal(size=(rows, cols)), length_m / np.sqrt(2.0) / spacing_m, mode="wrap"
    )
    return np.asarray(smooth / smooth.std())
