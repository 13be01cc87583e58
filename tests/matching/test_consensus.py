"""Agreement among matches and its number of false alarms: compared with exact binomials, synthetic
matches, and thousands of false ones.
"""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from helpers.posed import HADLEY, PlainMap, camera, covariances, ground, noise
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import bdtrc, gammaln

from lcp_catalog.cameras.sensor import Sensor, Uncertainty
from lcp_catalog.landmarks.ground_votes import independent_share
from lcp_catalog.landmarks.located import GATE, SIGNIFICANT, log10_false_alarms
from lcp_catalog.matching.consensus import (
    Consensus,
    _is_new,
    _Linear,
    _subsets,
    agree,
    agreeing,
)
from lcp_catalog.matching.pose import position_error

UNCERTAIN = Uncertainty(3000.0, np.radians(0.3))
REACH = 40.0


class Matches:
    """``count`` points, ``wrong`` of them found anywhere in their search areas, the rest at their
    places, with noise.
    """

    def __init__(self, count: int, wrong: int, seed: int, known: Sensor | None = None) -> None:
        dice = np.random.default_rng(seed)
        self.known = camera(tilt=tuple(dice.uniform(-0.2, 0.2, 3))) if known is None else known
        self.points = ground(self.known, count, dice)
        self.covariance = covariances(count, dice)
        sigmas = UNCERTAIN.sigmas(self.known)
        self.prior = self.known.moved(sigmas * np.clip(dice.normal(size=len(sigmas)), -2, 2))
        self.found = self.known.project(self.points) + noise(self.covariance, dice)
        anywhere = self.prior.project(self.points) + dice.uniform(-REACH, REACH, (count, 2))
        self.wrong = np.arange(count) < wrong
        self.found = np.where(self.wrong[:, None], anywhere, self.found)

    def agree(self, **options: float) -> Consensus:
        return agree(
            self.prior, self.points, self.found, self.covariance, UNCERTAIN, REACH, **options
        )


# -- the number of false alarms


@pytest.mark.parametrize(("count", "agreeing"), [(10, 5), (40, 8), (100, 20), (300, 60)])
@pytest.mark.parametrize("chance", [0.001, 0.01, 0.05])
def test_it_bounds_the_binomial_and_not_by_far(count: int, agreeing: int, chance: float) -> None:
    """All p equal: the exact number is C(n, m) times the binomial's tail at k - m. Chernoff's bound
    exceeds it by a factor that grows only with the square root of k (Bahadur and Ranga Rao 1960);
    below 30 for k <= 60.
    """
    minimal = 3
    tests = gammaln(count + 1) - gammaln(minimal + 1) - gammaln(count - minimal + 1)
    exact = (tests + np.log(bdtrc(agreeing - minimal - 1, count, chance))) / np.log(10.0)
    agrees = np.arange(count) < agreeing
    bound = log10_false_alarms(np.full(count, chance), agrees, minimal)
    assert exact <= bound + 1e-9
    if agreeing - minimal > 2.0 * count * chance:
        assert bound < exact + np.log10(30.0)


def test_mixed_chances_are_bounded_too() -> None:
    """Sampled sums of -log p over random agreements exceed the evidence no more often than the
    bound says.
    """
    dice = np.random.default_rng(0)
    chance = np.exp(dice.uniform(np.log(0.01), np.log(0.7), 30))
    weights = -np.log(chance)
    draws = (dice.random((200_000, 30)) < chance) @ weights
    for share in (0.5, 0.9, 0.99, 0.999):
        evidence = np.quantile(draws, share)
        agrees = np.zeros(30, dtype=bool)
        order = np.argsort(chance)
        # a set of matches whose evidence is the largest below that quantile, taken greedily
        total = 0.0
        for row in order:
            if total + weights[row] <= evidence:
                agrees[row], total = True, total + weights[row]
        assert 10.0 ** log10_false_alarms(chance, agrees, 0) >= (draws >= total).mean()


def test_points_that_agree_with_anything_prove_nothing() -> None:
    agrees = np.arange(40) < 20
    chance = np.full(40, 0.01)
    plain = log10_false_alarms(chance, agrees, 3)
    wide = log10_false_alarms(np.r_[chance, np.ones(500)], np.r_[agrees, np.full(500, True)], 3)
    assert plain < SIGNIFICANT
    assert wide > plain
    assert log10_false_alarms(np.ones(40), agrees, 3) > 0.0


def test_what_shares_its_ground_counts_once() -> None:
    apart = np.array([[0.0, 0.0], [100.0, 0.0], [0.0, 100.0]])
    assert independent_share(apart, 40.0) == 1.0
    assert independent_share(np.zeros((5, 2)), 40.0) == pytest.approx(1.0 / 5.0)
    halves = np.array([[0.0, 0.0], [20.0, 0.0]])
    assert independent_share(halves, 40.0) == pytest.approx(2.0 / (2.0 * 1.5))
    assert independent_share(halves, 0.0) == 1.0


# -- agreement


def test_corrections_of_a_set_are_least_squares_with_the_prior() -> None:
    """Against numpy's least squares of the whitened matches and of the prior of one sigma; the gain of
    a correction is what its squared distances leave of the gate.
    """
    dice = np.random.default_rng(3)
    slope, offset = dice.normal(size=(40, 2, 4)), 3.0 * dice.normal(size=(40, 2))
    roots = np.linalg.cholesky(covariances(40, dice))
    inverse = np.linalg.inv(roots @ np.swapaxes(roots, 1, 2))
    linear, white = _Linear(slope, offset, inverse), np.linalg.inv(roots)
    sets = np.array([[0, 1], [3, 6]])
    found = linear.corrections(sets)
    for rows, correction in zip(sets, found, strict=True):
        left = np.concatenate([*(white[k] @ slope[k] for k in rows), np.eye(4)])
        right = np.concatenate([*(white[k] @ offset[k] for k in rows), np.zeros(4)])
        np.testing.assert_allclose(
            correction, np.linalg.lstsq(left, right, rcond=None)[0], rtol=1e-9
        )
    off = [[np.sum((white[k] @ (offset[k] - slope[k] @ c)) ** 2) for k in range(40)] for c in found]
    gains = [sum(max(0.0, GATE**2 - squared) for squared in row) for row in off]
    np.testing.assert_allclose(linear.gains(found), gains, rtol=1e-9)
    np.testing.assert_array_equal(linear.agreeing(found), np.array(off) <= GATE**2)
    assert np.histogram(off[0], [6.0, 9.0, 27.0])[0].all()


def test_sets_are_all_of_each_size_or_those_of_the_seed() -> None:
    for size, sets in enumerate(_subsets(6, 3, 0), start=1):
        expected = {frozenset(c) for c in itertools.combinations(range(6), size)}
        assert {frozenset(rows.tolist()) for rows in sets} == expected
        assert len(sets) == len(expected)
    first, again, other = (_subsets(40, 3, seed) for seed in (1, 1, 2))
    assert [len(sets) for sets in first] == [40, 780, 2000]
    assert all(len(set(rows)) == 3 for rows in first[2].tolist())
    np.testing.assert_array_equal(first[2], again[2])
    assert (first[2] != other[2]).any()


def test_corrections_far_beyond_the_prior_are_not_tried() -> None:
    """Every match lies some 40 px off, 100 sigmas of the sensor's."""
    matches = Matches(30, 0, seed=5)
    found = matches.known.project(matches.points) + 40.0
    uncertain = Uncertainty(0.0, 1e-3)
    result = agree(matches.known, matches.points, found, matches.covariance, uncertain, 60.0)
    assert result.pose is None
    assert (result.log10_false_alarms, result.significant) == (0.0, False)


def test_a_set_of_matches_is_new_if_at_most_half_of_it_is_known() -> None:
    some = np.arange(6) < 4
    for shared, new in ((2, True), (3, False)):
        other = (np.arange(6) < shared) | (np.arange(6) >= 4)
        assert _is_new(some, [other]) == _is_new(some, [~some, other]) == new


def test_an_attitude_alone_is_found() -> None:
    matches = Matches(40, 15, seed=8)
    uncertain = Uncertainty(0.0, np.radians(0.3))
    prior = matches.known.moved(np.array([0.0, 0.0, 0.0, 0.004, -0.003, 0.002]))
    found = agree(prior, matches.points, matches.found, matches.covariance, uncertain, 60.0)
    assert found.significant
    assert (found.pose.used & matches.wrong).sum() <= 1
    assert found.pose.used.sum() >= 22


def test_a_match_agrees_within_three_sigmas_of_its_own_covariance_and_the_tolerance() -> None:
    """Sigmas of 3 px along the columns and 1 px along the rows; a tolerance of 4 px widens the gate
    along the rows from 3 to 5 px.
    """
    sensor = camera()
    points = ground(sensor, 8, np.random.default_rng(2))
    off = np.array([[8.9, 0.0], [9.1, 0.0], [0.0, -2.9], [0.0, 3.1], [7.0, 2.5], [np.nan, 0.0], *np.zeros((2, 2))])  # fmt: skip
    covariance = np.tile(np.diag([9.0, 1.0]), (8, 1, 1))
    covariance[6] = np.nan
    found = sensor.project(points) + off
    seen = agreeing(sensor, points, found, covariance, 0.0)
    assert seen.tolist() == [True, False, True, False, False, False, False, True]
    seen = agreeing(
        sensor, points, found, covariance, np.r_[0.0, 0.0, 0.0, 4.0, 4.0, 4.0, 4.0, 4.0]
    )
    assert seen.tolist() == [True, False, True, True, True, False, False, True]


@given(st.integers(0, 2**32 - 1), st.integers(0, 75))
@settings(max_examples=15, deadline=None)
def test_the_right_ones_are_found_among_false_ones(seed: int, wrong: int) -> None:
    made = Matches(100, wrong, seed)
    answer = made.agree()
    assert answer.significant
    right = ~made.wrong
    assert (answer.pose.used & right).sum() >= 0.9 * right.sum()
    # a false one within a gate of about 1.5 px by luck: p = 0.1 %
    assert (answer.pose.used & made.wrong).sum() <= 4
    assert answer.pose is not None
    assert position_error(answer.pose, made.known).squared < 40.0


def test_a_match_agrees_by_chance_with_its_gate_over_its_search_area() -> None:
    """Exact matches with a sigma of 0.4 px and a tolerance of 1.2 px: gates of 3 sqrt(0.4^2 +
    0.4^2) px.
    """
    made = Matches(20, 0, 14)
    round_ones = np.tile(0.16 * np.eye(2), (20, 1, 1))
    exact = made.known.project(made.points)
    answer = agree(made.prior, made.points, exact, round_ones, UNCERTAIN, REACH, tolerance_px=1.2)
    chance = np.pi * 9.0 * (0.16 + 0.16) / (2.0 * REACH + 1.0) ** 2
    expected = log10_false_alarms(np.full(20, chance), np.full(20, True), 3)
    assert answer.pose.used.all()
    assert answer.log10_false_alarms == pytest.approx(expected, rel=1e-9)


def test_unknowns_that_are_held_take_smaller_sets() -> None:
    made = Matches(60, 45, 3)
    off = made.known.position_mcmf_m - made.prior.position_mcmf_m
    prior = made.known.moved([*-off, 0.0, 0.0, 0.0])
    answer = agree(prior, made.points, made.found, made.covariance, Uncertainty(3000.0), REACH)
    assert answer.significant
    assert (answer.pose.used & ~made.wrong).sum() >= 13
    assert answer.pose is not None
    assert (answer.pose.correction[3:] == 0.0).all()


def test_a_sensor_that_is_held_is_only_asked_who_agrees() -> None:
    made = Matches(40, 25, 13)
    exact = Uncertainty(0.0, 0.0)
    answer = agree(made.known, made.points, made.found, made.covariance, exact, REACH)
    assert answer.significant
    assert (answer.pose.used & ~made.wrong).sum() >= 14
    assert (answer.pose.correction == 0.0).all()
    assert not agree(made.prior, made.points, made.found, made.covariance, exact, REACH).significant


def test_a_map_is_shifted() -> None:
    known = PlainMap(HADLEY, 700.0, -300.0)
    made = Matches(50, 35, 4, known)
    answer = made.agree()
    assert answer.significant
    assert (answer.pose.used & ~made.wrong).sum() >= 14
    assert np.allclose(
        [answer.pose.sensor.east_m, answer.pose.sensor.north_m], [700, -300], atol=30
    )


def test_two_solutions_are_none() -> None:
    """A repeating pattern: half of the matches agree on one place, half on another."""
    made = Matches(80, 0, 5)
    other = made.prior.moved(UNCERTAIN.sigmas(made.prior) * [1.5, -1.0, 0.5, 0.5, 1.0, -0.5])
    made.found[::2] = other.project(made.points)[::2]
    answer = made.agree()
    assert answer.log10_false_alarms < SIGNIFICANT
    assert answer.rival_log10 < SIGNIFICANT
    assert not answer.significant


@pytest.mark.parametrize(
    ("own", "rival", "clear"),
    [(-40.0, -19.0, True), (-40.0, -21.0, False), (-8.0, -5.0, True), (-8.0, -6.5, False), (-5.9, 0.0, False),
     (-6.1, 0.0, True)],
)  # fmt: skip
def test_a_rival_may_be_half_as_meaningful_or_no_agreement_at_all(own, rival, clear) -> None:
    """In powers of ten; an agreement that is not significant alone is no rival."""
    assert Consensus(None, own, rival).significant is clear


def exact(count: int, seed: int) -> Matches:
    """All matches at their places, with round covariances of 0.4 px."""
    made = Matches(count, 0, seed)
    made.covariance = np.tile(0.16 * np.eye(2), (count, 1, 1))
    made.found = made.known.project(made.points)
    return made


def test_what_lies_just_beyond_its_gate_is_no_rival() -> None:
    """Gates of 3 sqrt(0.16 + 0.16) = 1.7 px: a third of the matches lies 2.5 px off, all alike. It
    takes no part and is no second place either.
    """
    made = exact(60, 15)
    made.found[::3] += [2.5, 0.0]
    answer = made.agree(tolerance_px=1.2)
    assert answer.pose.used.tolist() == [k % 3 != 0 for k in range(60)]
    assert answer.rival_log10 == 0.0
    assert answer.significant
    made.found[::3] += [7.5, 0.0]
    assert made.agree(tolerance_px=1.2).rival_log10 < SIGNIFICANT


def test_the_larger_of_two_agreements_is_the_answer() -> None:
    made = exact(80, 16)
    other = made.prior.moved(UNCERTAIN.sigmas(made.prior) * [1.5, -1.0, 0.5, 0.5, 1.0, -0.5])
    few = np.arange(80) % 8 < 3
    made.found[few] = other.project(made.points)[few]
    answer = made.agree()
    assert np.array_equal(answer.pose.used, ~few)
    assert answer.log10_false_alarms < answer.rival_log10 < SIGNIFICANT


def test_false_matches_on_one_spot_take_nothing_from_those_that_agree() -> None:
    """Shared terrain is counted among the agreeing matches only."""
    made = exact(50, 17)
    made.found[:20] = made.found[40] + np.random.default_rng(0).uniform(-3.0, 3.0, (20, 2))
    apart = np.abs(made.found[20:, None] - made.found[None, 20:]).max(-1)
    width = float(np.min(apart + 1e6 * np.eye(30)))
    assert width > 1.0
    plain, wide = (made.agree(width_px=w) for w in (0.0, width))
    assert np.array_equal(plain.pose.used, np.arange(50) >= 20)
    assert np.array_equal(wide.pose.used, plain.pose.used)
    assert wide.log10_false_alarms == pytest.approx(plain.log10_false_alarms, rel=1e-12)


@pytest.mark.parametrize("count", [4, 5, 6])
def test_one_more_than_a_minimal_set_can_agree(count: int) -> None:
    made = exact(count, 18)
    answer = made.agree()
    assert answer.pose.used.all()
    assert answer.pose is not None
    assert answer.log10_false_alarms < 0.0


def test_an_uncertainty_in_which_the_image_bends_is_searched_too() -> None:
    """Half are wrong; the sensor is up to 16 km and 2.5 deg off, so that offsets are not linear in
    the correction.
    """
    wide = Uncertainty(8e3, np.radians(1.2))
    for seed in range(4):
        dice = np.random.default_rng(seed)
        known = camera()
        points = ground(known, 60, dice)
        draw = np.clip(dice.normal(size=6), -2.0, 2.0)
        prior = known.moved(wide.sigmas(known) * draw)
        found = known.project(points)
        wrong = np.arange(60) % 2 == 0
        found[wrong] = prior.project(points)[wrong] + dice.uniform(-90.0, 90.0, (30, 2))
        covariance = np.tile(0.04 * np.eye(2), (60, 1, 1))
        answer = agree(prior, points, found, covariance, wide, 90.0)
        assert answer.significant
        assert (answer.pose.used & ~wrong).sum() >= 29


def test_one_false_match_seen_by_many_patches_is_no_proof() -> None:
    """Twelve patches that overlap almost completely, all found with the same offset: they see the
    same terrain.
    """
    made = Matches(60, 48, 6)
    middle = made.points[50]
    dice = np.random.default_rng(6)
    made.points[48:] = middle + dice.uniform(-600.0, 600.0, (12, 3))
    made.found[48:] = made.prior.project(made.points[48:]) + np.array([21.0, -13.0])
    assert made.agree().significant
    assert not made.agree(width_px=40.0).significant


def test_what_was_not_found_has_no_part() -> None:
    made = Matches(50, 10, 7)
    made.found[20:30] = np.nan
    made.points[35] = 2.0 * made.known.position_mcmf_m - made.points[35]
    answer = made.agree()
    assert not answer.pose.used[20:30].any()
    assert not answer.pose.used[35]
    assert answer.pose.used.sum() >= 27
    assert answer.pose.used.shape == (50,)


@pytest.mark.parametrize("count", [0, 1, 2, 3])
def test_too_few_are_no_agreement(count: int) -> None:
    answer = Matches(count, 0, 8).agree()
    assert answer.pose is None
    assert not answer.significant


def test_a_correction_beyond_the_prior_is_not_looked_at() -> None:
    made = Matches(40, 0, 9)
    far = made.known.moved([0.0, 25e3, 0.0, 0.0, 0.0, 0.0])
    answer = agree(far, made.points, made.found, made.covariance, Uncertainty(3000.0), 100.0)
    assert not answer.significant


def test_the_same_again_is_the_same() -> None:
    first, second = (Matches(60, 40, 10).agree() for _ in range(2))
    assert first.log10_false_alarms == second.log10_false_alarms
    assert np.array_equal(first.pose.correction, second.pose.correction)


# -- chance


def lowest_false_alarms(runs: int, count: int, first_seed: int) -> np.ndarray:
    """log10 of the false alarms of ``runs`` sets of matches that are all false."""
    return np.array(
        [Matches(count, count, first_seed + k).agree().log10_false_alarms for k in range(runs)]
    )


def test_false_matches_never_agree() -> None:
    scores = lowest_false_alarms(25, 60, 1000)
    assert scores.min() > -1.0


@pytest.mark.slow
@pytest.mark.parametrize("count", [8, 30, 120])
def test_hundreds_of_false_sets_never_agree(count: int) -> None:
    """The number of false alarms is an upper bound of their expectation: of N sets fewer than N x
    10^-s + 4 square roots of that lie below -s.
    """
    scores = lowest_false_alarms(120, count, 50_000)
    assert scores.min() > SIGNIFICANT
    for level in (-0.5, -1.0, -2.0):
        expected = len(scores) * 10.0**level
        assert (scores < level).sum() <= expected + 4.0 * np.sqrt(expected)
