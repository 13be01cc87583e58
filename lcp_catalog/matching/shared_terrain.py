"""Terrain that the patches of neighbouring points share, and with it the errors of their matches.

A match errs because the DEM and the brightness of its patch are not quite those of the ground. Two
patches that overlap have part of these errors in common. Measured in simulated frames by an
independent renderer (``benchmarks/claims.py positions``): the correlation of the errors, in sigmas,
is 0.8 to 1 times the share of the terrain that they have in common.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ..arrays import Array, Index
from ..catalog.catalogue import Catalog


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
