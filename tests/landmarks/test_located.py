"""Units of points: against the joint probability of all points of a set, each with its own claim."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pytest

from lcp_catalog.approximations import APPROXIMATIONS
from lcp_catalog.landmarks import located
from lcp_catalog.landmarks.located import (
    MOST_UNITS,
    UNITS_MAX,
    Units,
    chance_of,
    equal_points,
    log10_false_alarms,
)
from lcp_catalog.matching.joint_detection import at_least_found


def needed(probability: np.ndarray, chance: float) -> int:
    """Fewest matches that agree significantly, beside wrong ones, counted upwards."""
    wrong = round(0.05 * float((1.0 - probability).sum()))
    k = 4
    while True:
        agrees = np.arange(k + wrong) < k
        if log10_false_alarms(np.full(k + wrong, chance), agrees, 3) < -6.0:
            return k
        k += 1


def located_by(claims: np.ndarray, chance: float) -> float:
    """Probability that a frame is located by points that are found with these probabilities."""
    k = needed(claims, chance)
    return float(at_least_found(claims)[k]) if k <= len(claims) else 0.0


def test_chances_beyond_their_range_count_as_its_ends() -> None:
    """A chance of 0 is the least that counts, one above 1 says nothing; a list of 0 and 1 says who agrees."""
    chances, agrees = [0.0, 1e-2, 1e-3, 1e-2, 3.0], [1, 1, 1, 1, 0]
    least = [1e-300, 1e-2, 1e-3, 1e-2, 1.0]
    found = log10_false_alarms(chances, agrees, 3)
    assert found == log10_false_alarms(least, np.array(agrees, bool), 3)
    assert -300.0 < found < log10_false_alarms(chances, [0, 1, 1, 1, 1], 3)


@pytest.mark.parametrize("count", [8, 12, 40])
@pytest.mark.parametrize("probability", [0.2, 0.6, 0.97])
def test_equal_points_are_as_points_with_claims(count: int, probability: float) -> None:
    """The binomial sum is the Poisson binomial one."""
    chance, claims = 0.0094, np.full(count, probability)
    k = needed(claims, chance)
    expected = at_least_found(claims)[k] if k <= count else 0.0
    assert equal_points(count, probability, chance) == pytest.approx(expected, abs=1e-9)


def _enough(units: Units) -> Iterator[tuple[np.ndarray, np.ndarray, int]]:
    """Random sets of points of very different claims: those claims that are worth something, their units, and how many of
    them suffice.
    """
    rng = np.random.default_rng(3)
    for _ in range(60):
        claims = rng.beta(*rng.uniform(0.3, 3.0, 2), 600)
        worth = np.searchsorted(units.least, claims, "right")
        claims, worth = claims[worth > 0], worth[worth > 0]
        count = int(np.searchsorted(np.cumsum(worth), units.demand)) + 1
        if count <= len(claims):
            yield claims, worth, count


@pytest.mark.parametrize("gsd_m", [5.0, 59.0, 474.0])
@pytest.mark.parametrize("wanted", [0.9, 0.99])
def test_any_set_with_as_many_units_as_wanted_is_enough(gsd_m: float, wanted: float) -> None:
    """Random sets of points of very different claims, which stop when their units suffice: located at least as
    probably as wanted, and as the table says at each number of units.
    """
    units, chance = Units.of_located(wanted, gsd_m), chance_of(gsd_m)
    sizes = []
    for claims, worth, count in _enough(units):
        sizes.append(count)
        for some in (count, count // 2, count - 1):
            own = claims[:some]
            there = located_by(own, chance)
            assert there >= units.located[int(worth[:some].sum())] - 0.01
        assert located_by(claims[:count], chance) >= wanted
    assert len(sizes) > 40
    assert max(sizes) > 3 * min(sizes)


def test_the_points_that_units_cost_are_stated() -> None:
    """Random sets as above: points until their units suffice, over the fewest whose joint probability does."""
    units, chance = Units.of_located(0.99, 5.0), chance_of(5.0)
    more = []
    for claims, _, count in _enough(units):
        exact = count
        while located_by(claims[: exact - 1], chance) >= 0.99:
            exact -= 1
        more.append(count / exact - 1.0)
    stated = next(one for one in APPROXIMATIONS if one.name == "units of a promise").error
    assert len(more) > 40
    assert 100.0 * np.mean(more) == pytest.approx(stated.value, rel=0.05)


@pytest.mark.parametrize(
    ("name", "constant", "values"),
    [
        ("failures in common", "COMMON_VARIANCE", (0.08, 0.13)),
        ("wrong matches", "WRONG", (0.0, 0.1)),
        ("matches that agree by accident", "_SIGMA_PX", (0.25, 1.0)),
    ],
)
def test_what_constants_of_frames_change_is_stated(
    monkeypatch: pytest.MonkeyPatch, name: str, constant: str, values: tuple[float, float]
) -> None:
    """Probability to be located with each end of what frames allow, over numbers of points, claims and cells."""

    def table() -> np.ndarray:
        claims, chances = (
            (0.1, 0.2, 0.3, 0.5, 0.7, 0.9),
            [chance_of(m) for m in (10.0, 50.0, 118.0, 474.0)],
        )
        numbers = range(4, 121)
        return np.array(
            [[[equal_points(n, p, c) for n in numbers] for p in claims] for c in chances]
        )

    usual, moved = table(), []
    for value in values:
        monkeypatch.setattr(located, constant, value)
        moved.append(np.abs(table() - usual).max())
    stated = next(one for one in APPROXIMATIONS if one.name == name).error
    assert max(moved) == pytest.approx(stated.value, rel=0.02)


@pytest.mark.parametrize("agreeing", [0, 3, 20])
def test_false_alarms_are_never_more_than_the_minimal_sets(agreeing: int) -> None:
    """Matches that agree less often than by accident are no evidence for more: log10 C(n, 3)."""
    found = log10_false_alarms(np.full(200, 0.3), np.arange(200) < agreeing, 3)
    assert found == pytest.approx(math.log10(math.comb(200, 3)))


@pytest.mark.parametrize("wanted", [0.9, 0.99])
@pytest.mark.parametrize("probability", [0.2, 0.35, 0.5, 0.7, 0.9, 0.98])
def test_one_point_fewer_than_the_least_number_is_not_enough(
    probability: float, wanted: float
) -> None:
    for chance in map(chance_of, (5.0, 59.0, 474.0)):
        least = located._least_number(probability, wanted, chance)
        before, there = (equal_points(n, probability, chance) for n in (least - 1, least))
        assert before < wanted <= there
        assert located._least_number(1e-3, wanted, chance) == MOST_UNITS * UNITS_MAX


def test_units_rise_with_the_probability() -> None:
    units = Units.of_located(0.99, 474.0)
    assert len(units.least) == MOST_UNITS
    assert (np.diff(units.least) >= 0.0).all()
    assert units.least[0] < 0.3
    assert units.least[-1] > 0.9
    assert (np.diff(units.located) >= 0.0).all()
    assert len(units.located) == UNITS_MAX + 1
    assert units.located[units.demand] >= 0.99 > units.located[units.demand - MOST_UNITS]
    usable = Units.of_usable(8, 0.9, 474.0)
    assert (usable.least, usable.demand) == ((0.9,), 8)
    assert usable.located[40] > 0.99 > usable.located[9] > usable.located[8] == 0.0


def test_more_than_can_be_stated_is_refused() -> None:
    with pytest.raises(ValueError, match="needs"):
        Units.of_located(0.999999999, 474.0)
