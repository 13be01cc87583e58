"""Interpolation between the viewpoints of a catalogue, a scattered set of directions."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import Array, Index

_TOUCHING = 1e-9
"""Slack, in degrees, for a place on the border of a triangle or a circle."""


def view_plane(off_nadir_deg: ArrayLike, azimuth_deg: ArrayLike) -> Array:
    """Places of directions in the azimuthal equidistant plane about the vertical, degrees, (..., 2):
    x east, y north.
    """
    off, azimuth = np.asarray(off_nadir_deg, np.float64), np.radians(azimuth_deg)
    return np.stack([off * np.sin(azimuth), off * np.cos(azimuth)], axis=-1)


@dataclass(frozen=True)
class ViewMesh:
    """Delaunay triangles of places (v, 2); for places on one line its segments, for one place that
    place alone.
    """

    places: Array
    simplices: Index  # (m, 3); a segment repeats its last corner, a single place is (0, 0, 0)

    @classmethod
    def of(cls, places: Array) -> ViewMesh:
        """The mesh of some ten places; the triples of places are all tried."""
        places = np.asarray(places, np.float64)
        found = [t for t in itertools.combinations(range(len(places)), 3) if _empty(places, t)]
        if not found and len(places) > 1:
            spread = np.ptp(places, axis=0)
            order = np.lexsort(
                (places[:, int(np.argmin(spread))], places[:, int(np.argmax(spread))])
            )
            found = [(int(a), int(b), int(b)) for a, b in itertools.pairwise(order)]
        return cls(places, np.array(found or [(0, 0, 0)], dtype=np.int64))

    def weights(self, at: Array) -> tuple[Index, Array, Array]:
        """Corners (n, 3) and their weights (n, 3), 0 or above with a sum of 1, at places (n, 2); and the
        distance of each place from the mesh (n,), 0 inside. Outside the weights are those of the
        nearest place of the mesh.
        """
        count = len(at)
        best = np.full(count, np.inf)
        corners = np.zeros((count, 3), np.int64)
        weights = np.tile([1.0, 0.0, 0.0], (count, 1))
        for simplex in self.simplices:
            share = _nearest(self.places[simplex], at)
            away = np.linalg.norm(share @ self.places[simplex] - at, axis=-1)
            better = away < best - _TOUCHING
            best[better], corners[better], weights[better] = away[better], simplex, share[better]
        return corners, weights, np.where(best <= _TOUCHING, 0.0, best)


def _empty(places: Array, triple: tuple[int, int, int]) -> bool:
    """True for a triangle whose circumcircle has no other place inside."""
    a, b, c = places[list(triple)]
    double = 2.0 * ((b - a)[0] * (c - a)[1] - (b - a)[1] * (c - a)[0])
    if abs(double) < 1e-6:
        return False
    p, q = (b - a) @ (b - a), (c - a) @ (c - a)
    centre = a + np.array(
        [(c - a)[1] * p - (b - a)[1] * q, (b - a)[0] * q - (c - a)[0] * p]
    ) / double  # fmt: skip
    radius = float(np.linalg.norm(centre - a))
    others = np.delete(places, list(triple), axis=0)
    return bool((np.linalg.norm(others - centre, axis=-1) >= radius - 1e-6).all())


def _nearest(corners: Array, at: Array) -> Array:
    """Barycentric weights (n, 3) of the place in a triangle (3, 2) nearest to each place (n, 2)."""
    inside = _barycentric(corners, at)
    within = (inside >= -_TOUCHING).all(axis=-1)
    best = np.full(len(at), np.inf)
    out = np.tile([1.0, 0.0, 0.0], (len(at), 1))
    for i, j in ((0, 1), (1, 2), (0, 2)):
        edge = corners[j] - corners[i]
        length = float(edge @ edge)
        along = (
            np.clip((at - corners[i]) @ edge / length, 0.0, 1.0) if length else np.zeros(len(at))
        )
        away = np.linalg.norm(corners[i] + along[:, None] * edge - at, axis=-1)
        better = away < best
        best[better] = away[better]
        share = np.zeros((len(at), 3))
        share[:, i], share[:, j] = 1.0 - along, along
        out[better] = share[better]
    out[within] = np.clip(inside[within], 0.0, 1.0)
    return out


def _barycentric(corners: Array, at: Array) -> Array:
    """Barycentric coordinates (n, 3); -1 for a triangle without area."""
    sides = np.stack([corners[1] - corners[0], corners[2] - corners[0]], axis=-1)
    if abs(np.linalg.det(sides)) < 1e-9:
        return np.full((len(at), 3), -1.0)
    two = np.linalg.solve(sides, (at - corners[0]).T).T
    return np.concatenate([1.0 - two.sum(axis=-1, keepdims=True), two], axis=-1)
