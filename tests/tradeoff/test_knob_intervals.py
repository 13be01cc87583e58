"""Intervals of the rows of all approximations: what some areas tell of all of a region, and of as many others."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from lcp_catalog.tradeoff import knob_rows, knobs


def test_an_interval_is_that_of_the_share_of_all_areas() -> None:
    even = np.array([[5.0, 100.0], [9.0, 100.0], [1.0, 100.0], [6.0, 100.0]])
    shares = even[:, 0] / 100.0
    expected = stats.t.interval(0.9, 3, shares.mean(), stats.sem(shares))
    own, changed = knobs.ratio_interval(even), knob_rows.changed_interval(even)
    assert own == pytest.approx(list(np.clip(expected, 0.0, 1.0)), rel=1e-3)
    assert own is not None
    assert changed is not None
    assert changed[0] == own[0]
    # as far above in the logarithm as the other end was in the share itself
    mean = float(shares.mean())
    assert math.log(changed[1] / mean) == pytest.approx((expected[1] - mean) / mean, rel=1e-3)
    assert knob_rows.changed_interval(np.array([[9.0, 9.0], [0.0, 8.0]])) == [0.0, 1.0]
    low, high = knobs.ratio_interval(np.array([[30.0, 3000.0], [0.0, 10.0], [0.0, 10.0]])) or (
        1.0,
        0.0,
    )
    assert low <= 30.0 / 3020.0 <= high < 0.02
    assert knobs.ratio_interval(even[:1]) is knob_rows.changed_interval(even[:1]) is None


def test_intervals_hold_for_as_many_other_areas() -> None:
    """Of areas that are as different as those of three regions (1 sigma 0.75 of the mean), 9 in 10 groups are within."""
    rng = np.random.default_rng(4)
    inside, runs = 0, 600
    for _ in range(runs):
        judged = rng.integers(500, 1500, (2, 24)).astype(float)
        changed = judged * rng.gamma(1.0 / 0.75**2, 0.02 * 0.75**2, (2, 24))
        here = np.stack([changed[0], judged[0]], 1)
        low, high = knob_rows.changed_interval(here, others=True) or (1.0, 0.0)
        inside += low <= changed[1].sum() / judged[1].sum() <= high
    assert 0.85 < inside / runs < 0.95


def test_intervals_hold_where_few_areas_change() -> None:
    """Of eight areas that differ by 1.3 times their mean, as at 78 N, 9 in 10 other groups are within, and 8 by the ratio."""
    rng = np.random.default_rng(7)
    inside, runs = np.zeros(2), 1500
    for _ in range(runs):
        judged = rng.integers(500, 1500, (2, 8)).astype(float)
        changed = judged * rng.gamma(1.0 / 1.3**2, 0.02 * 1.3**2, (2, 8))
        share = changed[1].sum() / judged[1].sum()
        here = np.stack([changed[0], judged[0]], 1)
        for k, interval in enumerate(
            (
                knob_rows.changed_interval(here, others=True),
                knobs.ratio_interval(here, math.sqrt(2.0)),
            )
        ):
            low, high = interval or (1.0, 0.0)
            inside[k] += low <= share <= high
    assert 0.87 < inside[0] / runs < 0.95
    assert inside[1] / runs < 0.85


def test_the_interval_of_worth_allows_for_changes_that_no_area_shows() -> None:
    """Of 4 or 14 areas of two points each, of which one in ten loses or gains one, the mean is inside in at least 9 of 10 draws; by
    the areas' scatter alone in fewer than 8, as most often none changes. Where none does it is the limit of no event."""
    rng = np.random.default_rng(5)
    for areas in (4, 14):
        inside, alone, runs = 0, 0, 600
        for _ in range(runs):
            usual = np.full(areas, 2.0)
            lost, gained = rng.random((2, areas)) < [[0.06], [0.04]]
            both = np.stack([usual - lost + gained, usual], 1)
            (low, high), (below, above) = (
                knob_rows.worth_interval(both, 2 * areas) or (1.0, 0.0),
                knobs.ratio_interval(both) or (1.0, 0.0),
            )
            assert low <= below
            assert high >= above
            inside += low <= 0.99 <= high
            alone += below <= 0.99 <= above
        assert alone < 0.8 * runs < 0.9 * runs <= inside
        same = np.stack([usual, usual], 1)
        limit = stats.binomtest(0, areas).proportion_ci(0.9, "exact").high
        half = limit / 2.0  # a point of two
        assert knob_rows.worth_interval(same, 2 * areas) == pytest.approx([1.0 - half, 1.0 + half])
    assert knob_rows.worth_interval(same[:1], 2) is None


@pytest.mark.parametrize("areas", [2, 4, 9, 32])
def test_where_no_area_changes_few_may_unseen(areas: int) -> None:
    """Of all areas the limit of no event; of as many others the greatest number that one half of both has alone in 1 of 20."""
    none = np.stack([np.zeros(areas), np.arange(1.0, areas + 1.0)], 1)
    limit = stats.binomtest(0, areas).proportion_ci(0.9, "exact").high
    assert knob_rows.changed_interval(none) == [0.0, pytest.approx(limit)]
    unseen = [k for k in range(1, areas + 1) if stats.hypergeom(2 * areas, k, areas).pmf(0) > 0.05]
    assert knob_rows.changed_interval(none, others=True) == [0.0, max(unseen) / areas]
    assert knob_rows.changed_interval(none[:1]) is None


def test_intervals_hold_where_most_areas_do_not_change() -> None:
    """Of 4 or 14 areas of 67 of which one in 20 changes, by 5 % of its conditions: the share of all, and of as many others, is
    inside in 9 of 10 draws; in fewer than 6, and 9, by intervals that end at 0 where none changes."""
    rng = np.random.default_rng(11)
    for areas in (4, 14):
        inside, alone, runs = np.zeros(2), np.zeros(2), 400
        for _ in range(runs):
            judged = rng.integers(500, 1500, 67).astype(float)
            size = rng.gamma(1.8, 0.05 / 1.8, 67) * (rng.random(67) < 0.05)
            both = np.stack([np.round(judged * size), judged], 1)
            here, there = both[:areas], both[areas : 2 * areas]
            for k, others in enumerate((False, True)):
                share = np.divide(*(there if others else both).sum(0))
                low, high = knob_rows.changed_interval(here, others) or (1.0, 0.0)
                inside[k] += low <= share <= high
                alone[k] += low <= share <= high * here[:, 0].any()
        assert (inside > 0.9 * runs).all()
        assert alone[0] < 0.6 * runs
        assert alone[1] < 0.9 * runs
