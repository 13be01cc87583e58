"""Joint detection of the points of a frame: against all outcomes and an adaptive integral, and against the agreement
that `locate` asks for.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from helpers.navigable import everywhere_usable
from helpers.posed import camera
from scipy.integrate import quad
from scipy.stats import norm, poisson

from lcp_catalog.approximations import APPROXIMATIONS
from lcp_catalog.cameras.sensor import Uncertainty
from lcp_catalog.landmarks import ground_votes
from lcp_catalog.landmarks.ground_votes import RIVAL_Z, VoteTable, ground_shows, offsets_of
from lcp_catalog.light.sun_choice import SunChoice
from lcp_catalog.matching.consensus import agree
from lcp_catalog.matching.joint_detection import (
    JointDetection,
    at_least_found,
    joint_detection,
)
from lcp_catalog.matching.options import USUAL, Options
from lcp_catalog.navigation.documents import document
from lcp_catalog.navigation.expected_position import Query, answers
from lcp_catalog.navigation.frame_points import PlannedImage

CLAIMS = np.array([0.97, 0.9, 0.75, 0.4, 0.12, 0.02])


def by_outcomes(p: np.ndarray, least: int, common: float) -> float:
    """P(at least so many) by all outcomes, integrated over the common factor."""

    def given(u: float) -> float:
        chance = norm.cdf((norm.ppf(p) + math.sqrt(common) * u) / math.sqrt(1.0 - common))
        total = 0.0
        for outcome in itertools.product((0, 1), repeat=len(p)):
            hit = np.array(outcome, bool)
            if hit.sum() >= least:
                total += float(np.prod(np.where(hit, chance, 1.0 - chance)))
        return total * float(norm.pdf(u))

    return float(quad(given, -8.0, 8.0, epsabs=1e-10)[0])


@pytest.mark.slow
@pytest.mark.parametrize("common", [0.0, 0.1, 0.3])
def test_it_is_the_sum_over_all_outcomes(common: float) -> None:
    found = at_least_found(CLAIMS, common)
    expected = [by_outcomes(CLAIMS, k, common) for k in range(len(CLAIMS) + 1)]
    np.testing.assert_allclose(found, expected, atol=2e-4 if common > 0.1 else 2e-6)


def test_the_mean_number_is_the_sum_of_the_claims() -> None:
    assert at_least_found(CLAIMS)[1:].sum() == pytest.approx(CLAIMS.sum(), abs=1e-6)


def test_common_failures_make_all_and_none_likelier() -> None:
    p = np.full(20, 0.7)
    alone, together = at_least_found(p, 0.0), at_least_found(p, 0.2)
    assert together[20] > 2.0 * alone[20]
    assert 1.0 - together[8] > 5.0 * (1.0 - alone[8])


def test_no_points() -> None:
    assert at_least_found([]).tolist() == [1.0]
    assert JointDetection(np.zeros(0)).of_numbers(3) == {}


@pytest.mark.parametrize("most", [1, 5, len(CLAIMS), 100])
def test_a_few_numbers_are_those_of_all(most: int) -> None:
    every = at_least_found(CLAIMS)[1 : most + 1]
    told = JointDetection(CLAIMS).of_numbers(most)
    assert list(told) == [str(k + 1) for k in range(len(every))]
    np.testing.assert_allclose(list(told.values()), every, atol=1e-12)


def test_a_claim_that_is_no_number_is_refused() -> None:
    with pytest.raises(ValueError, match="not a number"):
        at_least_found([0.5, math.nan])


def test_so_many_matches_are_accepted_and_one_less_is_not() -> None:
    """`needed` is the rule of `consensus.agree`: that many right matches are significant, among one wrong one for every 20
    points that are not found.
    """
    catalog = everywhere_usable()
    taken = camera()
    image = PlannedImage.lit(taken, SunChoice(100.0, 17.0))
    (answer,) = answers(catalog, [image], Query())
    rows, options = answer.rows, Options()
    assert len(rows) >= 12
    covariance = np.tile(0.04 * np.eye(2), (len(rows), 1, 1))
    joint = joint_detection(catalog, rows, taken, answer.probability, covariance)
    places = catalog.position_mcmf[rows]
    true = taken.project(places)
    dice = np.random.default_rng(3)
    significant = {}
    for count in (joint.needed - 1, joint.needed + 1):
        found = np.full(true.shape, np.nan)
        right = np.linspace(0, len(rows) - 1, count).astype(int)
        found[right] = true[right]
        wrong = np.setdiff1d(np.arange(len(rows)), right)[
            : round(0.05 * (1.0 - answer.probability).sum())
        ]
        found[wrong] = true[wrong] + dice.uniform(-16.0, 16.0, (len(wrong), 2))
        result = agree(taken, places, found, covariance, USUAL, options.least_reach_px)
        significant[count - joint.needed] = result.log10_false_alarms < -6.0
    assert significant == {-1: False, 1: True}


def test_fewer_unknowns_need_fewer_matches() -> None:
    catalog, taken = everywhere_usable(), camera()
    (answer,) = answers(catalog, [PlannedImage.lit(taken, SunChoice(100.0, 17.0))], Query())
    covariance = np.tile(0.04 * np.eye(2), (len(answer.rows), 1, 1))
    needed = [
        joint_detection(
            catalog, answer.rows, taken, answer.probability, covariance, uncertainty
        ).needed
        for uncertainty in (USUAL, replace(USUAL, attitude_rad=0.0), Uncertainty(0.0, 0.0))
    ]
    assert needed[0] > needed[1] > needed[2]


@pytest.mark.parametrize("claim", [0.05, 0.2, 0.45])
def test_the_ground_shows_as_often_as_votes_that_are_drawn(claim: float) -> None:
    """Maps of normal noise: the votes by rank of points whose true places are as high as their claims say, against the sum
    that one of as many offsets exceeds in a millionth of all maps (a Poisson sum).
    """
    claims, offsets, frames = np.linspace(0.5, 1.5, 16) * claim, 1225, 1000
    dice = np.random.default_rng(2)
    common, own = dice.normal(size=(frames, 1)), dice.normal(size=(frames, len(claims)))
    high = RIVAL_Z + norm.ppf(claims) + math.sqrt(0.1) * common + math.sqrt(0.9) * own
    total = np.zeros(frames)
    for point in high.T:
        noise = dice.normal(size=(frames, offsets - 1))
        total += np.log(offsets / (1 + (noise > point[:, None]).sum(axis=1)))
    significant = poisson.cdf(len(claims) - 1, total) * offsets < 1e-6
    _, weights = np.polynomial.hermite_e.hermegauss(15)
    stated = float(weights @ ground_shows(claims, offsets) / weights.sum())
    assert 0.01 < stated < 0.99
    assert stated == pytest.approx(significant.mean(), abs=0.05)
    assert weights @ ground_shows(claims, offsets, 0.5) / weights.sum() < stated


def test_ground_that_points_show_only_together_counts() -> None:
    """30 points claimed at 0.3: by themselves seldom enough; not for too few points, and not where the image may be turned."""
    catalog, taken = everywhere_usable(), camera()
    (answer,) = answers(catalog, [PlannedImage.lit(taken, SunChoice(100.0, 17.0))], Query())
    rows = answer.rows[:30]

    def joint(count: int, uncertainty: Uncertainty) -> JointDetection:
        covariance = np.tile(0.04 * np.eye(2), (count, 1, 1))
        claims = np.full(count, 0.3)
        return joint_detection(catalog, rows[:count], taken, claims, covariance, uncertainty)

    known, turned = Uncertainty(300.0, 0.0), Uncertainty(300.0, 0.1)
    assert joint(len(rows), known).located > joint(len(rows), known).located_by_points + 0.05
    assert joint(9, known).located == pytest.approx(joint(9, known).located_by_points)
    assert joint(len(rows), turned).located == pytest.approx(
        joint(len(rows), turned).located_by_points
    )


def test_a_query_states_it() -> None:
    catalog = everywhere_usable()
    (answer,) = answers(catalog, [PlannedImage.lit(camera(), SunChoice(100.0, 17.0))], Query())
    said = document(answer, catalog)
    assert said["expected_found"] == pytest.approx(answer.joint.expected, abs=1e-3)
    assert said["located_probability"] == round(answer.joint.located, 4)
    chances = list(said["probability_at_least"].values())
    assert answer.joint.located_by_points == pytest.approx(chances[answer.joint.needed - 1])
    assert answer.joint.located >= answer.joint.located_by_points
    assert chances == sorted(chances, reverse=True)
    assert list(said["probability_at_least"])[:2] == ["1", "2"]


def test_what_the_level_of_rivals_changes_is_stated(monkeypatch):
    """Probability that the votes of 10 to 200 equal points are significant, with each level that frames made likeliest,
    and with levels of a vote 0.01 apart.
    """

    def table():
        numbers = np.arange(10, 201, 5)[:, None]
        claims = (0.01, 0.02, 0.05, 0.1, 0.2, 0.3, 0.5, 0.7)
        shown = [
            VoteTable((p,), offsets_of(64)).shows(numbers, np.ones(len(numbers))) for p in claims
        ]
        return np.array(shown) @ ground_votes.WEIGHTS

    usual, moved = table(), []
    for level in (2.72, 2.74):
        with monkeypatch.context() as other:
            other.setattr(ground_votes, "RIVAL_Z", level)
            moved.append(np.abs(table() - usual).max())
    stated = next(one for one in APPROXIMATIONS if one.name == "votes of all points").error
    assert max(moved) == pytest.approx(stated.value, rel=0.02)
    monkeypatch.setattr(ground_votes, "_Z", np.linspace(-8.0, 20.0, 2801))
    assert np.abs(table() - usual).max() == pytest.approx(0.006, abs=0.0005)
