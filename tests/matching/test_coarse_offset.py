"""Offset of a whole image: the offset with the largest agreement of the points, and its expected
number by chance.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import mpmath
import numpy as np
import pytest
from helpers.match_frames import LAW, hadley_camera, hadley_catalog, hadley_photo
from hypothesis import given, settings
from hypothesis import strategies as st

from lcp_catalog.cameras.sensor import Reduced
from lcp_catalog.matching import search_area
from lcp_catalog.matching.point_choice import points_in_view
from lcp_catalog.matching.search_area import (
    CoarseShift,
    _log10_gamma_tail,
    _peak,
    _scale,
    _vote,
    coarse_shift,
)
from lcp_catalog.matching.templates import render_patches

catalog = pytest.fixture(hadley_catalog, scope="module")
camera = pytest.fixture(hadley_camera, scope="module")
photo = pytest.fixture(hadley_photo, scope="module")


@pytest.mark.slow
def test_the_coarse_offset_is_found_and_chance_is_not(catalog, camera, photo):
    moved = replace(
        camera,
        principal_point_px=(
            camera.principal_point_px[0] + 70.3,
            camera.principal_point_px[1] - 41.0,
        ),
    )
    wrong = photo.with_sensor(moved)
    rows = points_in_view(catalog, wrong.sensor)
    for reach, grid in ((90.0, 128), (160.0, 64)):
        shift = coarse_shift(catalog, wrong, LAW, reach, points=rows, grid_px=grid)
        assert (
            np.hypot(shift.offset_px[0] + 70.3, shift.offset_px[1] - 41.0)
            <= 1.5 * shift.precision_px
        )
        assert shift.log10_false_alarms < -8
        assert shift.rival_log10 > -3
    for turned in (photo.signal[::-1], photo.signal[:, ::-1], np.rot90(photo.signal)):
        other = replace(wrong, signal=np.ascontiguousarray(turned))
        assert (
            coarse_shift(catalog, other, LAW, 90.0, points=rows, grid_px=128).log10_false_alarms
            > -3
        )


def test_an_offset_of_each_point_is_added_before(catalog, camera, photo):
    rows = points_in_view(catalog, photo.sensor)
    known = np.random.default_rng(1).integers(-9, 10, (len(catalog), 2)).astype(float)
    # a function of the rows; points sought where they are not agree on nothing
    apart = coarse_shift(catalog, photo, LAW, 30.0, points=rows, offset_px=lambda r: 3.0 * known[r])
    together = coarse_shift(catalog, photo, LAW, 30.0, points=rows, offset_px=(12.0, -7.0))
    assert together.offset_px == pytest.approx((-12.0, 7.0), abs=1.0)
    assert together.log10_false_alarms < apart.log10_false_alarms - 5


def test_slack_bears_points_that_do_not_lie_together(catalog, photo):
    rows = points_in_view(catalog, photo.sensor)
    rng = np.random.default_rng(6)
    apart = rng.integers(-8, 9, (len(catalog), 2)).astype(float)
    without, with_slack = (
        coarse_shift(
            catalog, photo, LAW, 40.0, points=rows, offset_px=lambda r: apart[r], slack_px=s
        )
        for s in (0.0, 8.0)
    )
    assert with_slack.log10_false_alarms < -6
    assert np.hypot(*with_slack.offset_px) < 1.5
    assert np.hypot(*without.offset_px) > 2.0
    assert with_slack.precision_px == 9.0


def test_with_nothing_around_the_peak_nothing_is_said(catalog, photo):
    rows = points_in_view(catalog, photo.sensor)
    assert coarse_shift(catalog, photo, LAW, 4.0, points=rows) is None
    assert coarse_shift(catalog, photo, LAW, 90.0, points=[]) is None


@settings(max_examples=30, deadline=None)
@given(n=st.integers(1, 400), share=st.floats(0.3, 8.0))
def test_the_tail_of_a_sum_of_votes(n, share):
    exact = mpmath.log10(mpmath.gammainc(n, n * share, mpmath.inf, regularized=True))
    assert _log10_gamma_tail(n, n * share) == pytest.approx(float(exact), rel=1e-6, abs=1e-9)


@pytest.mark.parametrize(("count", "slack", "reach"), [(12, 0, 40), (12, 4, 40), (60, 4, 40)])
def test_what_a_quarter_of_the_points_could_show(count: int, slack: int, reach: int) -> None:
    """Every fourth of the maps has its peak in the middle: no offset of it exceeds what is stated."""
    dice, side = np.random.default_rng(count + slack), 2 * reach + 1
    known, votes = np.ones((side, side), bool), np.zeros((side, side))
    for k in range(count):
        score = dice.uniform(-0.4, 0.4, (side, side)).astype(np.float32)
        if k % 4 == 0:
            score[reach, reach] = 0.9
        votes += _vote(score, known, slack)
    middle = votes[reach, reach]
    found = _peak(votes, count * known, 1, slack, 8.0 + 2 * slack, 1.0)
    mean = (middle - count // 4 * np.log(side**2 / (2 * slack + 1) ** 2)) / (count - count // 4)
    exact = mpmath.gammainc(count, middle + (1.0 - mean) * (count - count // 4), mpmath.inf, regularized=True)  # fmt: skip
    assert found.if_here_log10 == pytest.approx(float(mpmath.log10(side**2 * exact)), abs=0.05)


# -- in which pixels


def test_a_reduced_photo_answers_as_one_that_came_so(catalog, camera, photo, monkeypatch):
    """The same pixels as a reduced image and with a camera of their own: offsets, reaches, slacks and
    the point spread differ by a factor of 2, probabilities are the same.
    """
    middle = tuple((c + 0.5) * 2.0 - 0.5 for c in camera.principal_point_px)
    fine = replace(
        camera,
        focal_length_px=2.0 * camera.focal_length_px,
        principal_point_px=middle,
        image_size_px=(640, 640),
    )
    rows = points_in_view(catalog, photo.sensor)
    how = {"points": rows, "grid_px": 64}
    native = coarse_shift(catalog, photo, LAW, 90.0, offset_px=(20.0, -8.0), slack_px=4.0, **how)
    monkeypatch.setattr(search_area, "render_patches", partial(render_patches, psf_sigma_px=1.0))
    found = coarse_shift(
        catalog, replace(photo, sensor=Reduced(fine, 2)), LAW, 180.0, offset_px=(40.0, -16.0), slack_px=8.0, **how,
    )  # fmt: skip
    assert native.precision_px == 2.0 * (1.0 + 2.0)  # 90 px on a grid of 64: reduced by 2
    assert np.hypot(native.offset_px[0] + 20.0, native.offset_px[1] - 8.0) < 3.0
    assert found.offset_px == pytest.approx([2.0 * v for v in native.offset_px], abs=1e-9)
    assert found.precision_px == 2.0 * native.precision_px
    assert found.log10_false_alarms == pytest.approx(native.log10_false_alarms, abs=1e-3)
    assert found.rival_log10 == pytest.approx(native.rival_log10, abs=1e-3)


@pytest.mark.parametrize(
    ("reach", "grid", "factor"),
    [(40.0, 64, 1), (64.0, 64, 1), (65.0, 64, 2), (128.0, 64, 2), (129.0, 64, 3), (900.0, 64, 4), (40.0, 10, 4)],
)  # fmt: skip
def test_the_photo_is_reduced_so_that_the_grid_holds_the_reach(catalog, photo, reach, grid, factor):
    """By 4 at most, when patches of 33 nodes of one pixel each are 8 pixels wide."""
    found, size = _scale(catalog, photo, points_in_view(catalog, photo.sensor), reach, grid)
    assert found == factor
    assert size == pytest.approx(33.0 / factor, rel=0.02)


# -- the peak of the votes


def chance_votes(voters, seed=0):
    """Sums of exponential votes, one for each voter."""
    return np.random.default_rng(seed).gamma(np.maximum(voters, 1e-9))


def log10_tail(n, total):
    return float(mpmath.log10(mpmath.gammainc(n, total, mpmath.inf, regularized=True)))


def test_a_peak_is_judged_by_how_many_vote_there():
    """An agreement counts where four in ten points can be compared, but not where one in five can;
    more voters alone are no peak.
    """
    voters = np.full((41, 41), 40)
    voters[:, 21:] = 100
    voters[5:8, 5:8] = 20
    votes = chance_votes(voters)
    votes[30, 10], votes[6, 6], votes[10, 35] = 120.0, 120.0, 170.0
    found = _peak(votes, voters, 3, 0, 4.0, 1.0)
    assert found.offset_px == (3.0 * (10 - 20), 3.0 * (30 - 20))
    known = (voters > 20).sum()
    assert found.log10_false_alarms == pytest.approx(np.log10(known) + log10_tail(40, 120.0))
    assert found.rival_log10 == pytest.approx(np.log10(known) + log10_tail(100, 170.0))
    assert (found.precision_px, found.points) == (3.0, 100)


@pytest.mark.parametrize(("away", "counts"), [((0, 5), False), ((4, 4), True), ((5, 1), True)])
def test_a_rival_peak_lies_beyond_the_zone(away, counts):
    voters = np.full((31, 31), 50)
    votes = chance_votes(voters, 1)
    votes[15, 12] = 150.0
    votes[15 + away[0], 12 + away[1]] = 130.0
    found = _peak(votes, voters, 1, 0, 5.0, 1.0)
    rival = np.log10(voters.size) + log10_tail(50, 130.0)
    assert found.offset_px == (-3.0, 0.0)
    assert (found.rival_log10 == pytest.approx(rival)) == counts


def test_a_plateau_is_taken_in_its_middle():
    """A slack of 2: 5 x 5 offsets share the peak to within a twentieth; lower values beside it have
    no effect.
    """
    voters = np.full((41, 41), 60)
    votes = 0.5 * chance_votes(voters, 2)
    votes[18:23, 24:29] = 199.0
    votes[18, 24] = 200.0
    votes[18:23, 29:31] = 185.0
    found = _peak(votes, voters, 2, 2, 9.0, 1.0)
    assert found.offset_px == (2.0 * (26 - 20), 0.0)
    assert found.precision_px == 6.0


def test_with_few_offsets_outside_of_the_peak_nothing_is_said():
    voters = np.full((21, 21), 30)
    votes = chance_votes(voters, 3)
    votes[10, 10] = 120.0
    near = np.hypot(*np.meshgrid(np.arange(-10, 11), np.arange(-10, 11)))
    for zone in (8.0, 9.0, 10.0, 11.0):
        assert (_peak(votes, voters, 1, 0, zone, 1.0) is None) == ((near > zone).sum() < 100)


@pytest.mark.parametrize("slack", [0, 2])
def test_a_vote_is_how_rare_so_high_a_correlation_is(slack):
    """Minus the logarithm of the share of a map's offsets with a correlation at least as high, by
    counting.
    """
    score = np.random.default_rng(4).uniform(-0.9, 0.9, (13, 15)).astype(np.float32)
    score[3:6, 2] = np.nan
    known = np.isfinite(score)
    around = np.pad(np.nan_to_num(score, nan=-1.0), slack, constant_values=-1.0)
    side = 2 * slack + 1
    highest = np.lib.stride_tricks.sliding_window_view(around, (side, side)).max(axis=(2, 3))
    wanted = [
        [-np.log((highest[known] >= h).mean()) if k else 0.0 for h, k in zip(hs, ks, strict=True)]
        for hs, ks in zip(highest, known, strict=True)
    ]
    # levels are a two-thousandth wide: few of 192 offsets share one
    found = _vote(score, known, slack)
    assert np.median(np.abs(found - wanted)) < 1e-9
    assert np.abs(np.exp(-found) - np.exp(-np.array(wanted))).max() < 2.5 / known.sum() * side**2
    assert isinstance(_peak(found, known.astype(np.int64), 1, slack, 2.0, 1.0), CoarseShift)
