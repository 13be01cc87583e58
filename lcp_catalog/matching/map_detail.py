"""Brightness that an albedo map lacks, where it goes with the slopes of the terrain: to a check of the Sun it is shading.

A map of a few kilometres a pixel lacks the finer brightness. Where the ground is brighter on slopes that face one way (the
mountains at the edge of a mare), the detail that is missing is so, too, as if the Sun were elsewhere. It is alike for all points of
a region: their scatter does not show it. How much is missing follows from what the map has: log brightness of the package's map was
regressed on the slopes of GLD100, over squares of 150 km within 35 deg of the equator. What a blur of the map by 0.8 and 1.2 pixel
takes away depends on slopes as what it leaves, times 0.29 and 0.59 (correlations 0.89, 0.87; rest 0.011, 0.020 per unit of slope).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from ..arrays import Array, Index
from ..catalog.catalogue import Catalog

MISSING = 0.3
"""1 sigma of what detail adds to the dependence of the map's brightness on slopes, as a share of it: what a blur of 0.8 pixel (half
of the resolution) takes away.
"""
_LEAST = 1e-4  # of the mean albedo, below which a logarithm is cut


@dataclass(frozen=True, eq=False)
class MapDetail:
    """Patches of n points, and how brightness that their map lacks may depend on their slopes."""

    catalog: Catalog  # of the n points alone
    across: Array  # (n, p, p) slopes across the Sun's azimuth, without their patches' means
    sigma: float  # of log brightness per unit of slope

    @classmethod
    def of(cls, catalog: Catalog, rows: Index, azimuth_rad: float) -> MapDetail | None:
        """Rows (n,) of a catalogue under a Sun at an azimuth, clockwise from north; None without an albedo map."""
        if catalog.albedo is None:
            return None
        some = catalog.take(rows)
        gsd = np.asarray(some.gsd, np.float64)[:, None, None]
        south, east = np.gradient(np.asarray(some.dem, np.float64), axis=(1, 2)) / gsd
        albedo = np.nan_to_num(np.asarray(some.albedo, np.float64), nan=1.0)
        bright = _uneven(np.log(np.maximum(albedo, _LEAST)))
        slopes = np.stack([_uneven(east), _uneven(-south)])
        lean = np.linalg.lstsq(slopes.reshape(2, -1).T, bright.ravel(), rcond=None)[0]
        across = slopes[0] * math.cos(azimuth_rad) - slopes[1] * math.sin(azimuth_rad)
        return cls(some, across, MISSING * float(np.hypot(*lean)))

    def altered(self, sigmas: float) -> Catalog:
        """The points with the brightness of slopes across the Sun changed by so many sigmas."""
        albedo = self.catalog.albedo
        assert albedo is not None
        changed = albedo * np.exp(sigmas * self.sigma * self.across)
        return replace(self.catalog, albedo=changed.astype(albedo.dtype))


def _uneven(values: Array) -> Array:
    """Values (n, p, p) without the mean of each patch."""
    return np.asarray(values - values.mean(axis=(1, 2), keepdims=True))
