"""Errors that the matches of several points have in common: by terrain that neighbouring patches share,
by shadows below a cell, and by the place of the map.

A match errs because the DEM and the brightness of its patch are not quite those of the ground. Two
patches that overlap have part of these errors in common. Measured in simulated frames by an
independent renderer (``benchmarks/evidence``): the correlation of the errors, in sigmas,
is 0.8 to 1 times the share of the terrain that they have in common.

Relief below a cell darkens the ground beyond crests, which a render from the cells' mean heights does
not show; such a render is found away from the Sun. All points of a level err alike. The error falls
with the Sun's elevation h as 1 - (h / `HIGHEST_RAD`)^2, as in renders of made relief that were averaged
to cells (`shadow_shift.py` of c896266); its size at grazing light, in cells, is `errors.shadow_shift`
of the build. How rough the ground is below a cell is not known, so it is an error and not a correction.

A map lies in the Moon's frame as well as it was tied to it (`dem.products`): a position moves with it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from ..arrays import Array, Index
from ..cameras.sensor import Sensor, ground_slopes
from ..catalog.catalogue import Catalog
from ..dem.products import tie_of


@dataclass(frozen=True, eq=False)
class SharedTerrain:
    """Pairs of n points whose patches overlap: rows (m,) of both, and the shared area over the mean
    (geometric) of their areas, (m,).
    """

    first: Index
    second: Index
    share: Array
    count: int

    @classmethod
    def of(
        cls, catalog: Catalog, rows: Index, places_mcmf_m: Array, rotation: Array
    ) -> SharedTerrain:
        """Of points (rows (n,) of a catalogue) at MCMF places (n, 3) with the rotations (n, 3, 3) to
        their ENU frames.
        """
        width = catalog.gsd[rows] * (catalog.patch_nodes - 1)
        found = [np.zeros((0, 2), np.int64)]
        for level in np.unique(width):  # a level's patches have neighbours of their size or wider
            own, wider = np.flatnonzero(width == level), np.flatnonzero(width >= level)
            reach = np.sqrt(2.0) * 0.5 * (level + width[wider].max())
            found.append(_pairs(places_mcmf_m, own, wider, reach))
        first, second = np.concatenate(found).T
        away = np.einsum(
            "mij,mj->mi", rotation[first, :2], places_mcmf_m[second] - places_mcmf_m[first]
        )
        one, other = width[first][:, None], width[second][:, None]
        common = np.minimum(np.minimum(one, other), 0.5 * (one + other) - np.abs(away))
        share = np.clip(common, 0.0, None).prod(axis=1) / (one * other)[:, 0]
        apart = share > 0.0
        return cls(first[apart], second[apart], share[apart], len(rows))

    def some(self, which: Index) -> SharedTerrain:
        """The pairs among some of the points."""
        place = np.full(self.count, -1)
        place[which] = np.arange(len(which))
        first, second = place[self.first], place[self.second]
        kept = (first >= 0) & (second >= 0)
        return SharedTerrain(first[kept], second[kept], self.share[kept], len(which))

    def cross(self, rows: Array) -> Array:
        """Sum over the pairs, both ways, of share times a_i^T a_j, (k, k), for the derivatives a (n, 2, k)
        of the points' places in sigmas of their errors: what the common errors add to the covariance
        of the sum of a_i^T e_i.
        """
        half = np.einsum(
            "m,mia,mib->ab", self.share, rows[self.first], rows[self.second], optimize=True
        )
        return np.asarray(half + half.T)


def _pairs(places: Array, own: Index, wider: Index, reach: float) -> Index:
    """Pairs (m, 2) of one of ``own`` and one of ``wider`` within a distance, each pair once."""
    tree = cKDTree(places[wider])
    lists = tree.query_ball_point(places[own], reach)
    first = np.repeat(own, [len(one) for one in lists])
    second = wider[np.concatenate([np.array(one, np.int64) for one in lists])]
    new = (first < second) | ~np.isin(second, own)
    return np.stack([first[new], second[new]], axis=1)


HIGHEST_RAD = math.radians(35.0)
"""Elevation of the Sun from which on shadows below a cell shift nothing."""


def shadow_shift_m(catalog: Catalog, rows: Index, sun_enu: ArrayLike) -> Array:
    """1 sigma shifts (n, 2) east and north, metres, of points (rows (n,)) under Suns (n, 3), unit vectors
    in the points' ENU frames. They are of one error: with that error all points move by their shift
    times the same number.
    """
    sun = np.asarray(sun_enu, np.float64)
    size = float(catalog.errors.get("shadow_shift", 0.0))
    level = np.linalg.norm(sun[:, :2], axis=-1)
    elevation = np.clip(np.arctan2(sun[:, 2], level), 0.0, HIGHEST_RAD)
    cells = size * (1.0 - (elevation / HIGHEST_RAD) ** 2)
    away = -sun[:, :2] / np.maximum(level, 1e-12)[:, None]
    return np.asarray((cells * catalog.gsd[rows])[:, None] * away)


def shadow_shift_px(catalog: Catalog, rows: Index, sensor: Sensor, suns: ArrayLike) -> Array:
    """`shadow_shift_m` in the image (n, 2) of a sensor, pixels; ``suns`` (n, 3): unit MCMF vectors."""
    rotation = catalog.rotation_mcmf_to_enu[rows]
    shift = shadow_shift_m(catalog, rows, np.einsum("nij,nj->ni", rotation, np.asarray(suns)))
    slope = ground_slopes(sensor, catalog.position_mcmf[rows], rotation)
    return np.asarray(np.einsum("nij,nj->ni", slope, shift))


def map_sigma_m(catalog: Catalog, rows: Index) -> float:
    """1 sigma, each axis, metres, of the place of the map that points (rows (n,)) were cut from: the largest of its
    products, 0 where none is published.
    """
    ties = [tie_of(name) for name in _products(catalog, rows)]
    return max((tie[0] for tie in ties if tie), default=0.0)


def untied(catalog: Catalog, rows: Index) -> tuple[str, ...]:
    """Products of points (rows (n,)) whose map's place has no published error: it is not counted."""
    return tuple(name for name in _products(catalog, rows) if tie_of(name) is None)


def _products(catalog: Catalog, rows: Index) -> list[str]:
    return sorted(set(catalog.part("dem_product", rows).tolist()))
