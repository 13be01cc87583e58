"""Horizons of observers on a heightfield.

A plane is (du, dv, low, high): direction in cell units with max(|du|, |dv|) = 1, and the slopes, in
metres per unit of this direction, between which the horizon is searched for
(`kernels.rays.horizon`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array
from ..kernels.rays import horizon
from .far_terrain import FarTerrain
from .heightfield import Heightfield, Window


@dataclass(frozen=True, eq=False)
class Nodes:
    """Nodes (rows, cols) of a field, each int64 (n,), and the terrain beyond the field."""

    field: Heightfield
    rows: NDArray[np.int64]
    cols: NDArray[np.int64]
    far: FarTerrain | None = None

    def __len__(self) -> int:
        return self.rows.size

    def __getitem__(self, which: slice | NDArray[np.intp]) -> Nodes:
        return Nodes(self.field, self.rows[which], self.cols[which], self.far)

    @property
    def points_m(self) -> Array:
        """ENU positions (n, 3)."""
        return self.field.nodes_m(self.rows, self.cols)

    def horizons(self, planes: Array) -> Array:
        """Steepest slope in each plane (k, 4), clipped to low..high, float64 (n, k); low at nodata
        and where there is no terrain ahead.
        """
        out = np.empty((len(self), len(planes)))
        horizon.node_horizons(*self.field.traced, self.rows, self.cols, planes, out)
        return _with_far(self, planes, out)

    def occluded(self, direction: Array) -> NDArray[np.bool_]:
        """True where the surface rises above the ray in ``direction`` (3,), bool (n,)."""
        return _occluded(self, direction)


@dataclass(frozen=True, eq=False)
class HorizonPoints:
    """ENU points (n, 3) on or above a field, metres, and the terrain beyond the field; points
    within 1 mm of the surface are moved onto it.
    """

    field: Heightfield
    points_m: Array
    far: FarTerrain | None = None

    def __len__(self) -> int:
        return len(self.points_m)

    def __getitem__(self, which: slice | NDArray[np.intp]) -> HorizonPoints:
        return HorizonPoints(self.field, self.points_m[which], self.far)

    def horizons(self, planes: Array) -> Array:
        """As `Nodes.horizons`; low for NaN and off the raster, high under the surface."""
        out = np.empty((len(self), len(planes)))
        x, y, z = self.points_m.T
        u, v = self.field.uv(x, y)
        horizon.point_horizons(*self.field.traced, u, v, np.ascontiguousarray(z), planes, out)
        return _with_far(self, planes, out)

    def occluded(self, direction: Array) -> NDArray[np.bool_]:
        """As `Nodes.occluded`."""
        return _occluded(self, direction)


def _with_far(observers: Nodes | HorizonPoints, planes: Array, own: Array) -> Array:
    """The higher of a field's own horizons and those of the far terrain."""
    if observers.far is None or not len(observers):
        return own
    found = observers.far.horizons(observers.points_m, planes, observers.field.gsd_m)
    return np.maximum(own, found, out=own)


def _occluded(observers: Nodes | HorizonPoints, direction: Array) -> NDArray[np.bool_]:
    points = observers.points_m
    out = observers.field.occluded_points(points, direction)
    if observers.far is not None:
        out[~out] = observers.far.occluded(points[~out], direction)
    return out


def on_rim(field: Heightfield, window: Window) -> NDArray[np.bool_]:
    """True for nodes of the window beside nodata or the raster's border, where a horizon may be
    discontinuous in azimuth; bool (rows, cols).
    """
    row0, row1, col0, col1 = window
    out = np.zeros((row1 - row0, col1 - col0), dtype=np.bool_)
    if field.has_holes:
        horizon.rim_nodes(field.z_m, window, out)
    else:
        last_row, last_col = field.shape[0] - 1, field.shape[1] - 1
        out[[i - row0 for i in (0, last_row) if row0 <= i < row1]] = True
        out[:, [j - col0 for j in (0, last_col) if col0 <= j < col1]] = True
    return out
