"""The choice among points on the sphere and the conditions of cells, against loops over all pairs."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from lcp_catalog.kernels.points import mark, thinned


@given(
    st.integers(0, 10_000),
    st.floats(0.001, 0.6) | st.floats(0.6, 3.0),
    st.sampled_from([1e-3, 0.3, 1.0]),
)
@settings(deadline=None)  # the first example may compile
def test_thinning_is_greedy_in_the_given_order(seed: int, distance: float, spread: float) -> None:
    """With labels, and places that were chosen before."""
    rng = np.random.default_rng(seed)
    places = rng.normal(size=(60, 3)) * spread + [0.0, 0.0, 1.0 / spread]
    places /= np.linalg.norm(places, axis=1, keepdims=True)
    labels, kept = rng.integers(0, 40, 60), np.array([3, 7])
    order = np.setdiff1d(rng.permutation(60)[:50], kept)
    rng.shuffle(order)
    chosen = kept.tolist()
    for k in order:
        away = np.linalg.norm(places[k] - places[chosen], axis=1)
        if away.min() > distance and labels[k] not in labels[chosen]:
            chosen.append(int(k))
    assert thinned(places, order, distance, labels, kept).tolist() == chosen
    assert thinned(places, order[:0], distance, labels, kept[:0]).size == 0


def test_a_place_at_exactly_the_distance_is_near() -> None:
    """On both sides of boxes' edges, along each axis."""
    for axis in range(3):
        places = np.zeros((5, 3))
        places[:, axis] = [-0.5, -0.25, 0.0, 0.25, 0.5]
        found = thinned(places, np.arange(5), 0.25, np.arange(5), np.zeros(0, np.int64))
        assert found.tolist() == [0, 2, 4]
        below = np.nextafter(0.25, 0.0)
        assert thinned(places, np.arange(5), below, np.arange(5), np.zeros(0, np.int64)).size == 5


def test_conditions_are_marked_where_a_point_of_the_pair_has_all_flags() -> None:
    rng = np.random.default_rng(2)
    flags = rng.choice(np.array([0, 1, 15, 31], np.uint8), (30, 7))
    cells, points = rng.integers(0, 10, 40), rng.integers(0, 30, 40)
    found = np.zeros((10, 7), np.uint8)
    mark(found, cells, points, flags, 31)
    for cell in range(10):
        own = flags[points[cells == cell]]
        assert found[cell].tolist() == [int((column == 31).any()) for column in own.T]
