"""Brightness that an albedo map lacks, where it goes with the slopes of the terrain: to a check of the Sun it is shading.

A map of a few kilometres a pixel lacks the finer brightness. Where the ground is brighter on slopes that face one way (the
mountains at the edge of a mare), the detail that is missing is so, too, as if the Sun were elsewhere. It is alike for all points of
a region: their scatter does not show it. How much is missing follows from what the map has. Squares of 56 pixels (150 km) of the
package's map within 35 deg of the equator, the rougher half of them, were cut into patches, and the log brightness of a patch less
its mean was regressed on its slopes of GLD100 less theirs. What a blur of 0.8 pixel (half of the resolution) takes away depends on
slopes as what it leaves, times 0.78, 0.44, 0.32, 0.26, 0.19 and 0.15 for patches of 2, 4, 6, 8, 12 and 16 pixels (correlations 0.74
to 0.91, rest 0.011 to 0.023 per unit of slope): `MISSING` (width in pixels)^-0.8.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..arrays import Array, Index
from ..catalog.catalogue import Catalog

MISSING = 1.36
"""1 sigma of what detail adds to the dependence of the map's brightness on slopes, as a share of it, for patches of one pixel."""
_PIXEL_M = 2665.0  # of the package's map, for catalogues that do not state that of theirs
_LEAST = 1e-4  # of the mean albedo, below which a logarithm is cut


@dataclass(frozen=True, eq=False)
class MapDetail:
    """Patches of n points, and how brightness that their map lacks may depend on their slopes."""

    catalog: Catalog  # of the n points alone
    across: Array  # (n, p, p) slopes across the Sun's azimuth at the point, without their patches' means
    sigma: Array  # (n,) of log brightness per unit of slope

    @classmethod
    def of(cls, catalog: Catalog, rows: Index, suns_mcmf: Array) -> MapDetail | None:
        """Rows (n,) of a catalogue under their Suns (n, 3), unit vectors; None without an albedo map."""
        if catalog.albedo is None or catalog.albedo_map is None:
            return None
        some = catalog.take(rows, np.zeros(0, np.int64))
        gsd = np.asarray(some.gsd, np.float64)
        rise = np.asarray(np.gradient(np.asarray(some.dem, np.float64), axis=(2, 1)))
        slopes = np.stack([_uneven(rise[0]), _uneven(-rise[1])]) / gsd[:, None, None]
        sun = np.einsum("nij,nj->ni", some.rotation_mcmf_to_enu, suns_mcmf)[:, :2]
        flat = np.maximum(np.linalg.norm(sun, axis=1, keepdims=True), 1e-12)  # 0 at the zenith
        to_east, to_north = (sun / flat).T[:, :, None, None]
        across = slopes[0] * to_north - slopes[1] * to_east
        along = slopes[0] * to_east + slopes[1] * to_north
        albedo = np.nan_to_num(np.asarray(some.albedo, np.float64), nan=1.0)
        bright = _uneven(np.log(np.maximum(albedo, _LEAST)))
        both = np.stack([across.ravel(), along.ravel()], axis=1)
        lean = np.linalg.lstsq(both, bright.ravel(), rcond=None)[0]
        pixel_m = catalog.albedo_map.get("pixel_m", _PIXEL_M)
        share = MISSING * (some.dem.shape[1] * gsd / pixel_m) ** -0.8
        return cls(some, across, np.minimum(share, 1.0) * float(np.hypot(*lean)))

    def altered(self, sigmas: float) -> Catalog:
        """The points with the brightness of slopes across the Sun changed by so many sigmas."""
        albedo = self.catalog.albedo
        assert albedo is not None
        changed = albedo * np.exp(sigmas * self.sigma[:, None, None] * self.across)
        return replace(self.catalog, albedo=changed.astype(albedo.dtype))


def of_contrasts(catalog: Catalog, rows: Index, powers: Sequence[float]) -> Iterator[Catalog]:
    """Rows (n,) of a catalogue, the brightness of its albedo map to each of some powers; none without a map."""
    if catalog.albedo is None:
        return
    some = catalog.take(rows, np.zeros(0, np.int64))
    for power in powers:
        yield replace(some, albedo=(np.asarray(some.albedo) ** power).astype(np.float32))


def _uneven(values: Array) -> Array:
    """Values (n, p, p) without the mean of each patch."""
    return np.asarray(values - values.mean(axis=(1, 2), keepdims=True))
