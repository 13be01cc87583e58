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
    own, changed = knobs.ratio_interval(even), knob_rows.changed_interval(even, 9999)
    assert own == pytest.approx(list(np.clip(expected, 0.0, 1.0)), rel=1e-3)
    assert own is not None
    assert changed is not None
    assert changed[0] == pytest.approx(own[0], rel=1e-3)
    # as far above in the logarithm as the other end was in the share itself
    mean = float(shares.mean())
    assert math.log(changed[1] / mean) == pytest.approx((expected[1] - mean) / mean, rel=1e-3)
    assert knob_rows.changed_interval(np.array([[9.0, 9.0], [0.0, 8.0]]), 9999) == [0.0, 1.0]
    low, high = knobs.ratio_interval(np.array([[30.0, 3000.0], [0.0, 10.0], [0.0, 10.0]])) or (
        1.0,
        0.0,
    )
    assert low <= 30.0 / 3020.0 <= high < 0.02
    assert knobs.ratio_interval(even[:1]) is knob_rows.changed_interval(even[:1], 1) is None


def test_intervals_hold_for_as_many_other_areas() -> None:
    """Of areas that are as different as those of three regions (1 sigma 0.75 of the mean), 9 in 10 groups are within."""
    rng = np.random.default_rng(4)
    inside, runs = 0, 600
    for _ in range(runs):
        judged = rng.integers(500, 1500, (2, 24)).astype(float)
        changed = judged * rng.gamma(1.0 / 0.75**2, 0.1 * 0.75**2, (2, 24))
        here = np.stack([changed[0], judged[0]], 1)
        low, high = knob_rows.changed_interval(here, 24, others=True) or (1.0, 0.0)
        inside += low <= changed[1].sum() / judged[1].sum() <= high
    assert 0.85 < inside / runs < 0.95


def test_intervals_hold_where_few_areas_change() -> None:
    """Of eight areas that differ by 1.3 times their mean, as at 78 N, 9 in 10 other groups are within, and 8 by the ratio."""
    rng = np.random.default_rng(7)
    inside, runs = np.zeros(2), 1500
    for _ in range(runs):
        judged = rng.integers(500, 1500, (2, 8)).astype(float)
        changed = judged * rng.gamma(1.0 / 1.3**2, 0.1 * 1.3**2, (2, 8))
        share = changed[1].sum() / judged[1].sum()
        here = np.stack([changed[0], judged[0]], 1)
        for k, interval in enumerate(
            (
                knob_rows.changed_interval(here, 24, others=True),
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
@pytest.mark.parametrize("others", [False, True])
def test_where_no_area_changes_few_may_unseen(areas: int, others: bool) -> None:
    """The greatest number, of 67 or of as many others, that the measured ones have none of in 1 of 20, each with a tenth."""
    none = np.stack([np.zeros(areas), np.arange(1.0, areas + 1.0)], 1)
    among, of = (2 * areas, areas) if others else (67, 67)
    unseen = max(k for k in range(among) if stats.hypergeom(among, k, areas).pmf(0) > 0.05)
    found = knob_rows.changed_interval(none, 67 - areas, others)
    assert found == [0.0, pytest.approx(0.1 * unseen / of)]
    # one condition of a thousand in one area is nearly none
    one = np.array([[1.0, 1000.0], *[[0.0, 1000.0]] * (areas - 1)])
    low, high = knob_rows.changed_interval(one, 67 - areas, others) or (1.0, 1.0)
    assert (low, high) == (0.0, pytest.approx(found[1], abs=1.01e-3 / areas))
    assert knob_rows.changed_interval(none[:1], 66) is None
    assert knob_rows.changed_interval(none[:0], 0) is None  # no area has a candidate


def test_all_areas_tell_their_share() -> None:
    every = np.array([[5.0, 100.0], [0.0, 100.0], [1.0, 100.0], [6.0, 100.0]])
    assert knob_rows.changed_interval(every, 0) == pytest.approx([0.03, 0.03])
    assert knob_rows.changed_interval(0.0 * every + [0.0, 1.0], 0) == [0.0, 0.0]


def _ground(kind: str, some: float, share: float, rng: np.random.Generator) -> np.ndarray:
    """Changed and judged conditions (67, 2) of areas of which ``some`` change, by ``share`` of their conditions, over areas that
    change by 0, or (``all``) by 0.1 % each; (``even``) all by the share, to within ``some`` of it."""
    judged = rng.integers(500, 1500, 67)

    def shares(mean: float, spread: float) -> np.ndarray:
        return rng.gamma(spread**-2.0, mean * spread**2.0, 67)

    if kind == "even":
        each = shares(share, some)
    else:
        few = rng.random(67) < some
        each = np.where(few, shares(share, 0.75), shares(0.001, 0.75) * (kind == "all"))
    return np.stack([rng.binomial(judged, np.minimum(each, 1.0)), judged], 1).astype(float)


@pytest.mark.parametrize(
    ("kind", "some", "share"),
    [
        *(("few", 0.05, 0.05), ("few", 0.2, 0.03), ("few", 0.1, 0.1)),
        *(("all", 0.05, 0.05), ("all", 0.1, 0.1), ("even", 0.5, 0.01), ("even", 1.3, 0.003)),
    ],
)
def test_intervals_hold_whatever_areas_are_like(kind: str, some: float, share: float) -> None:
    """Most areas unchanged and few much changed, all a little and few much, all a little: of 4, 14 and 32 areas of 67 the share of
    all, and of as many others, is inside in 0.86 of draws or more."""
    rng = np.random.default_rng(11)
    runs = 250
    for areas in (4, 14, 32):
        inside = np.zeros(2)
        for _ in range(runs):
            both = _ground(kind, some, share, rng)
            here, there = both[:areas], both[areas : 2 * areas]
            for k, others in enumerate((False, True)):
                true = np.divide(*(there if others else both).sum(0))
                low, high = knob_rows.changed_interval(here, 67 - areas, others) or (1.0, 0.0)
                inside[k] += low <= true <= high
        assert (inside >= 0.86 * runs).all(), (areas, inside / runs)
