"""Where the whole image lies: the offset that most points agree on, and how often chance would show one."""

from __future__ import annotations

from dataclasses import replace

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from match_frames import LAW, hadley_camera, hadley_catalog, hadley_photo

from lcp_catalog.coarse_match import _log10_gamma_tail, coarse_shift
from lcp_catalog.match import points_in_view

catalog = pytest.fixture(hadley_catalog, scope="module")
camera = pytest.fixture(hadley_camera, scope="module")
photo = pytest.fixture(hadley_photo, scope="module")


def test_the_coarse_offset_is_found_and_chance_is_not(catalog, camera, photo):
    moved = replace(
        camera,
        principal_point_px=(
            camera.principal_point_px[0] + 70.3,
            camera.principal_point_px[1] - 41.0,
        ),
    )
    wrong = photo.with_sensor(moved)
    rows = points_in_view(catalog, wrong)
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
    rows = points_in_view(catalog, photo)
    known = np.random.default_rng(1).integers(-9, 10, (len(catalog), 2)).astype(float)
    # a function of the rows; points sought where they are not agree on nothing
    apart = coarse_shift(catalog, photo, LAW, 30.0, points=rows, offset_px=lambda r: 3.0 * known[r])
    together = coarse_shift(catalog, photo, LAW, 30.0, points=rows, offset_px=(12.0, -7.0))
    assert together.offset_px == pytest.approx((-12.0, 7.0), abs=1.0)
    assert together.log10_false_alarms < apart.log10_false_alarms - 5


def test_slack_bears_points_that_do_not_lie_together(catalog, photo):
    rows = points_in_view(catalog, photo)
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
    rows = points_in_view(catalog, photo)
    assert coarse_shift(catalog, photo, LAW, 4.0, points=rows) is None
    assert coarse_shift(catalog, photo, LAW, 90.0, points=[]) is None


@settings(max_examples=30, deadline=None)
@given(n=st.integers(1, 400), share=st.floats(0.3, 8.0))
def test_the_tail_of_a_sum_of_votes(n, share):
    exact = mpmath.log10(mpmath.gammainc(n, n * share, mpmath.inf, regularized=True))
    assert _log10_gamma_tail(n, n * share) == pytest.approx(float(exact), rel=1e-6, abs=1e-9)
