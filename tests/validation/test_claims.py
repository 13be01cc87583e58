"""Scores of claims: against loops over single trials, closed forms, and samples whose claims are true."""

from __future__ import annotations

import math
import statistics
from dataclasses import replace

import numpy as np
import pytest
from helpers import verdicts
from hypothesis import given
from hypothesis import strategies as st

from lcp_catalog.geometry.ellipses import ellipse_covariance
from lcp_catalog.validation.claims import (
    BINS,
    Claims,
    bins,
    score,
    squared_distance,
    wilson_interval,
)


def of(probability: list[float], found: list[int], usable: list[int] | None = None) -> Claims:
    """Claims that are all tried, without errors."""
    nothing = Claims.none(len(found))
    return replace(
        nothing,
        probability=np.array(probability, float),
        found=np.array(found, bool),
        usable=np.array(usable if usable else [0] * len(found), bool),
        tried=np.ones(len(found), bool),
    )


def test_scores_are_those_of_a_loop_over_trials() -> None:
    """Each figure by its definition, trial by trial, in plain Python."""
    claims = verdicts.claims(3000)
    found = score(claims)
    trials = []
    for i in range(len(claims)):
        if claims.tried[i] and not math.isnan(claims.probability[i]):
            trials.append(
                (float(claims.probability[i]), int(claims.found[i]), bool(claims.usable[i]), i)
            )
    n = len(trials)
    share = sum(o for _, o, _, _ in trials) / n
    usable = [o for _, o, u, _ in trials if u]
    others = [o for _, o, u, _ in trials if not u]
    called = [u for _, o, u, _ in trials if o]
    assert found.count == n < 3000
    assert found.unclaimed == 300
    assert found.usable == len(usable)
    assert found.found == len(called)
    assert found.brier == pytest.approx(sum((p - o) ** 2 for p, o, _, _ in trials) / n)
    assert found.brier_of_the_mean == pytest.approx(
        sum((share - o) ** 2 for _, o, _, _ in trials) / n
    )
    assert found.found_of_usable == pytest.approx(sum(usable) / len(usable))
    assert found.found_of_unusable == pytest.approx(sum(others) / len(others))
    assert found.usable_of_found == pytest.approx(sum(called) / len(called))
    squares = []
    for _, o, u, i in trials:
        if o and u:
            turn = math.radians(claims.angle_deg[i])
            east, north = claims.error_m[i]
            along = (east * math.sin(turn) + north * math.cos(turn)) / claims.sigma_m[i, 0]
            across = (east * math.cos(turn) - north * math.sin(turn)) / claims.sigma_m[i, 1]
            squares.append((along**2 + across**2) / 2.0)
    assert found.errors == len(squares) > 500
    assert found.normalised_squared_error == pytest.approx(sum(squares) / len(squares))
    median = statistics.median(squares) / math.log(2.0)
    assert found.normalised_squared_error_median == pytest.approx(median)
    off = 0.0
    for k, (low, high, count, predicted, observed) in enumerate(found.figures()["reliability"]):
        assert (low, high) == (k / 10, (k + 1) / 10)
        inside = [(p, o) for p, o, _, _ in trials if low <= p < high]
        assert count == len(inside)
        if inside:
            assert predicted == pytest.approx(sum(p for p, _ in inside) / count)
            assert observed == pytest.approx(sum(o for _, o in inside) / count)
            off += abs(sum(p for p, _ in inside) - sum(o for _, o in inside))
    assert found.expected_calibration_error == pytest.approx(off / n)


def test_true_claims_score_as_theory_says() -> None:
    """The expected Brier score of true probabilities is the mean of p (1 - p); squared errors of the
    stated covariances have expectation 1. Limits: 5 sigma of the sample.
    """
    claims = verdicts.claims(200_000)
    found = score(claims)
    p = claims.probability[claims.tried]
    assert found.brier == pytest.approx(np.mean(p * (1.0 - p)), abs=5 * 0.25 / math.sqrt(len(p)))
    assert found.expected_calibration_error < 0.01
    assert found.normalised_squared_error == pytest.approx(1.0, abs=5.0 / math.sqrt(found.errors))
    assert found.normalised_squared_error_median == pytest.approx(1.0, abs=0.02)
    assert found.brier < found.brier_of_the_mean
    small = replace(claims, sigma_m=claims.sigma_m / 3.0)
    assert score(small).normalised_squared_error == pytest.approx(
        9.0 * found.normalised_squared_error
    )


def test_errors_cut_off_at_three_sigma_have_a_known_mean() -> None:
    """Of chi-squared with two degrees of freedom below 9: 1 - 4.5 exp(-4.5) / (1 - exp(-4.5))."""
    claims = verdicts.claims(300_000, seed=3)
    near = claims.squared_distance <= 9.0
    found = score(replace(claims, found=claims.found & near))
    wanted = 1.0 - 4.5 * math.exp(-4.5) / (1.0 - math.exp(-4.5))
    assert wanted == pytest.approx(0.95, abs=0.001)
    assert found.normalised_squared_error == pytest.approx(
        wanted, abs=5.0 / math.sqrt(found.errors)
    )


def test_perfect_and_worst_claims() -> None:
    best, worst = score(of([1, 0, 1, 0], [1, 0, 1, 0], [1, 0, 1, 0])), score(of([1, 0], [0, 1]))
    assert (best.brier, best.brier_of_the_mean, best.expected_calibration_error) == (0.0, 0.25, 0.0)
    assert (best.found_of_usable, best.found_of_unusable, best.usable_of_found) == (1.0, 0.0, 1.0)
    assert (worst.brier, worst.expected_calibration_error) == (1.0, 1.0)
    constant = score(of([0.75] * 4, [1, 1, 0, 1]))
    assert constant.brier == constant.brier_of_the_mean == pytest.approx(0.1875)
    assert constant.expected_calibration_error == 0.0


COUNTED = ("count", "unclaimed", "unclaimed_by_cause", "usable", "found", "errors")


def test_unclaimed_points_are_counted_by_cause() -> None:
    """Also of several images together; points with a claim have no cause that counts."""
    few = replace(
        Claims.none(4),
        probability=np.array([np.nan, 0.5, np.nan, np.nan]),
        cause=np.array([2, 7, 2, 1]),
    )
    assert score(few).unclaimed_by_cause == {"sun": 1, "view": 2}
    both = score(Claims.pooled([few, few, Claims.none(1)]))
    assert both.unclaimed_by_cause == {"sun": 2, "view": 4, "not evaluated": 1}
    assert sum(both.unclaimed_by_cause.values()) == both.unclaimed


def test_what_was_not_measured_is_nan_and_null() -> None:
    nothing = score(Claims.none(5, "no camera"))
    figures = nothing.figures()
    assert (nothing.count, nothing.unclaimed, nothing.errors) == (0, 5, 0)
    assert nothing.unclaimed_by_cause == {"not evaluated": 5}
    for name, value in figures.items():
        if name not in (*COUNTED, "reliability", "reason"):
            assert math.isnan(value), name
    assert figures["reason"] == "no camera"
    assert [row[2] for row in figures["reliability"]] == [0] * BINS
    found = score(of([0.2, 0.3], [0, 0], [0, 0]))
    assert math.isnan(found.found_of_usable)
    assert math.isnan(found.usable_of_found)
    assert found.found_of_unusable == 0.0
    assert math.isnan(found.normalised_squared_error)


def test_points_without_a_trial_or_a_claim_do_not_count() -> None:
    claims = of([0.9, 0.8, math.nan, 0.1], [1, 1, 1, 0], [1, 1, 0, 0])
    claims = replace(claims, tried=np.array([True, False, True, True]))
    found = score(claims)
    assert (found.count, found.unclaimed, found.usable, found.found) == (2, 1, 1, 1)
    assert found.brier == pytest.approx((0.1**2 + 0.1**2) / 2.0)


def test_unknown_and_infinite_sigmas_are_left_out() -> None:
    claims = verdicts.claims(40)
    use = np.flatnonzero(claims.usable & claims.found)
    assert len(use) > 4
    sigma = claims.sigma_m.copy()
    sigma[use[0]], sigma[use[1]], sigma[use[2]] = math.nan, math.inf, 0.0
    found = score(replace(claims, sigma_m=sigma))
    assert found.errors == len(use) - 3
    assert math.isfinite(found.normalised_squared_error)


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_packed_probabilities_fall_into_the_bin_above_a_limit(kind: type) -> None:
    """Multiples of 1/250, as they are stored, in both precisions."""
    codes = np.arange(251)
    p = codes.astype(kind) * kind(1 / 250)
    for k, b in enumerate(bins(p, np.ones(251, bool))):
        assert b.count == (26 if k == BINS - 1 else 25)
        assert b.predicted == pytest.approx(codes[25 * k : 25 * k + b.count].mean() / 250)


def test_images_are_pooled_point_by_point() -> None:
    parts = [verdicts.claims(60), Claims.none(7, "not located"), verdicts.claims(900, seed=1)]
    whole = score(Claims.pooled(parts))
    one, two = score(parts[0]), score(parts[2])
    assert whole.count == one.count + two.count
    assert whole.unclaimed == one.unclaimed + two.unclaimed + 7
    mean = (one.count * one.brier + two.count * two.brier) / whole.count
    assert whole.brier == pytest.approx(mean)
    assert whole.reason == ""
    none = Claims.pooled([Claims.none(2, "a"), Claims.none(1, "b"), Claims.none(1, "a")])
    assert (len(none), none.reason) == (4, "a; b")
    assert score(Claims.pooled([])).count == 0


@given(st.floats(1.0, 500.0), st.floats(0.05, 1.0), st.floats(0.0, 180.0))
def test_an_ellipse_points_clockwise_from_north(major: float, ratio: float, angle: float) -> None:
    """The variance along and across the stated azimuth, by projection; 0 between the two."""
    minor, turn = major * ratio, math.radians(angle)
    (found,) = ellipse_covariance([[major, minor]], [angle])
    along = np.array([math.sin(turn), math.cos(turn)])
    across = np.array([math.cos(turn), -math.sin(turn)])
    assert along @ found @ along == pytest.approx(major**2)
    assert across @ found @ across == pytest.approx(minor**2)
    assert abs(along @ found @ across) < 1e-9 * major**2


def test_an_ellipse_to_the_north_east_has_a_positive_covariance() -> None:
    (found,) = ellipse_covariance([[3.0, 1.0]], [45.0])
    np.testing.assert_allclose(found, [[5.0, 4.0], [4.0, 5.0]])
    (north,) = ellipse_covariance([[3.0, 1.0]], [0.0])
    np.testing.assert_allclose(north, [[1.0, 0.0], [0.0, 9.0]])


def test_squared_distances_are_those_of_the_inverse() -> None:
    dice = np.random.default_rng(2)
    root, error = dice.normal(size=(50, 2, 2)), dice.normal(size=(50, 2))
    covariance = root @ root.transpose(0, 2, 1)
    wanted = [e @ np.linalg.inv(c) @ e for e, c in zip(error, covariance, strict=True)]
    np.testing.assert_allclose(squared_distance(error, covariance), wanted, rtol=1e-6)
    singular = np.array([[[1.0, 1.0], [1.0, 1.0]]])
    assert np.isnan(squared_distance(np.array([[1.0, 0.0]]), singular)).all()


@pytest.mark.parametrize(("found", "count"), [(0, 1), (1, 1), (3, 10), (50, 50), (940, 1000)])
def test_confidence_limits_solve_wilsons_equation(found: int, count: int) -> None:
    """At a limit q the observed share lies 1.96 sigma of q away: (share - q)^2 = z^2 q (1 - q) / n."""
    for limit in wilson_interval(found, count):
        if 0.0 < limit < 1.0:
            off = (found / count - limit) ** 2
            assert off == pytest.approx(1.959964**2 * limit * (1.0 - limit) / count)
    low, high = wilson_interval(found, count)
    assert 0.0 <= low <= found / count <= high <= 1.0
    assert low < high
    assert wilson_interval(0, 0) == (0.0, 1.0)
