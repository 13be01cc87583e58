"""Window correlations of two images, compared with NumPy's own correlation."""

import numpy as np
import pytest

from lcp_catalog.choices import LAWS_BY_COST, REFLECTANCE_MODELS
from lcp_catalog.tradeoff.image_errors import PHASES_DEG, WINDOW, ModelChanges, window_correlations


def pictures(seed=0, shape=(100, 70)):
    rng = np.random.default_rng(seed)
    theirs = rng.random(shape) + 0.5
    return theirs + rng.normal(0.0, 0.3, shape), theirs


def test_windows_are_correlated_as_numpy_does():
    ours, theirs = pictures()
    found = window_correlations(ours, theirs)
    wanted = [
        np.corrcoef(
            ours[r : r + WINDOW, c : c + WINDOW].ravel(),
            theirs[r : r + WINDOW, c : c + WINDOW].ravel(),
        )[0, 1]
        for r in (0, 32, 64)
        for c in (0, 32)
    ]
    assert found == pytest.approx(wanted)
    assert window_correlations(3.0 * theirs + 7.0, theirs) == pytest.approx(np.ones(6))
    assert window_correlations(-theirs, theirs) == pytest.approx(-np.ones(6))


def test_what_is_not_seen_whole_or_shows_nothing_is_left_out():
    ours, theirs = pictures()
    ours[5, 5] = np.nan  # hidden in one image alone
    theirs[40:60, 5] = 0.9
    theirs[32:64, 32:64] = 0.7
    assert len(window_correlations(ours, theirs)) == 4
    flat = np.full_like(theirs, 2.0)
    ours, theirs = pictures()
    assert (window_correlations(flat, theirs) == 0.0).all()
    assert window_correlations(ours[:20], theirs[:20]).size == 0


def test_areas_add_up():
    one, two = ModelChanges(), ModelChanges()
    for found, values in ((one, [0.5, 0.7]), (two, [0.99])):
        found.correlations[LAWS_BY_COST[0], 2] = [np.array(values)]
        found.images[2] = 3
        took = 1.0 if found is one else 3.0
        found.seconds[LAWS_BY_COST[0]], found.seconds[LAWS_BY_COST[-1]] = [took], [2.0 * took + 0.5]
    one.add(two)
    (row,) = one.rows()
    assert row["windows"] == 3
    assert row["images"] == 6
    assert row["correlation_median"] == 0.7
    assert row["phase_deg"] == list(PHASES_DEG[2:4])
    assert row["share_above_0_9"] == pytest.approx(1 / 3)
    assert one.times()[LAWS_BY_COST[0]] == pytest.approx((4.0 / 9.0, 1.0 / 2.5, 3.0 / 6.5))
    assert one.times()[LAWS_BY_COST[-1]] == (1.0, 1.0, 1.0)
    assert ModelChanges().times()[LAWS_BY_COST[0]][0] == 0.0


def test_the_laws_exist():
    assert {law.partition(":")[0] for law in LAWS_BY_COST} <= set(REFLECTANCE_MODELS)
