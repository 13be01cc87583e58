"""Thinning of points: a greedy choice in which no two points are closer than a distance."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from ..arrays import Array, Index

_CHUNK = 256
"""Places whose neighbours are searched together; bounds the memory where many places are close."""


def thinned(
    places: Array,
    order: Index,
    distance: float,
    *,
    norm: float = 2.0,
    labels: Index | None = None,
    kept: Sequence[int] | Index = (),
) -> Index:
    """Indices of the chosen places, first those in ``kept``, then the new ones in the given order.

    places (n, d) are taken in ``order`` (m,), indices of places; one that is closer than
    ``distance`` to a place chosen before is left out. ``norm`` is Minkowski's (2: Euclidean,
    infinity: the largest difference of coordinates). ``labels`` (n,): no label is chosen twice.
    """
    tree = cKDTree(places)
    below = np.nextafter(distance, -np.inf)
    labels = np.arange(len(places)) if labels is None else labels
    chosen = [int(k) for k in kept]
    used = set(labels[chosen].tolist())
    crowded = np.zeros(len(places), dtype=np.bool_)
    for near in tree.query_ball_point(places[chosen], below, p=norm):
        crowded[near] = True
    for start in range(0, len(order), _CHUNK):
        part = order[start : start + _CHUNK]
        part = part[~crowded[part]]
        around = tree.query_ball_point(places[part], below, p=norm)
        for k, label, near in zip(part.tolist(), labels[part].tolist(), around, strict=True):
            if not crowded[k] and label not in used:
                chosen.append(k)
                used.add(label)
                crowded[near] = True
    return np.array(chosen, dtype=np.int64)
