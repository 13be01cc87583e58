"""A camera from points alone, and from there to what least squares without a prior makes of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.posed import camera, ground, noise
from hypothesis import given, settings
from hypothesis import strategies as st

from lcp_catalog.cameras.frame_camera import Camera
from lcp_catalog.cameras.sensor import Uncertainty
from lcp_catalog.errors import PoseError
from lcp_catalog.matching.pnp import initial
from lcp_catalog.matching.pose import position_error, solve

NO_PRIOR = Uncertainty(np.inf, np.inf)


def lost(known: Camera) -> Camera:
    """The same optics, somewhere else altogether."""
    turned = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    return replace(known, position_mcmf_m=np.array([0.0, 0.0, 2e6]), rotation_mcmf_to_camera=turned)


@given(st.integers(0, 2**32 - 1), st.floats(-0.6, 0.6), st.floats(-np.pi, np.pi), st.booleans())
@settings(max_examples=20, deadline=None)
def test_it_starts_where_least_squares_ends(
    seed: int, down: float, roll: float, distorted: bool
) -> None:
    """A third of the points are seen anywhere; attitude and position unknown."""
    dice = np.random.default_rng(seed)
    known = camera(tilt=(0.1, down, roll))
    if distorted:
        known = replace(known, distortion=[-0.05, 0.01, 1e-3, -5e-4, 0.0])
    points = ground(known, 45, dice)
    covariance = np.tile(0.09 * np.eye(2), (45, 1, 1))
    found = known.project(points) + noise(covariance, dice)
    wrong = np.arange(45) % 3 == 0
    found[wrong] = dice.uniform(0.0, 403.0, (15, 2))
    start, agrees = initial(lost(known), points, found)
    assert (agrees & ~wrong).sum() >= 27
    assert (agrees & wrong).sum() <= 1
    pose = solve(start, points, found, covariance, NO_PRIOR, agrees & ~wrong)
    assert position_error(pose, known).squared < 35.0
    assert (np.abs(pose.correction) < 20.0 * pose.sigma).all()


def test_what_was_not_found_is_left_out() -> None:
    dice = np.random.default_rng(0)
    known = camera()
    points = ground(known, 10, dice)
    found = known.project(points)
    found[3] = np.nan
    placed, agrees = initial(lost(known), points, found)
    assert agrees.tolist() == [k != 3 for k in range(10)]
    assert np.abs(placed.position_mcmf_m - known.position_mcmf_m).max() < 0.1
    assert np.abs(placed.rotation_mcmf_to_camera - known.rotation_mcmf_to_camera).max() < 1e-6


def test_too_few_or_no_agreement_is_refused() -> None:
    dice = np.random.default_rng(1)
    known = camera()
    points = ground(known, 12, dice)
    with pytest.raises(PoseError, match="3 points do not decide"):
        initial(known, points[:3], known.project(points[:3]))
    with pytest.raises(PoseError, match="no place of it agrees"):
        initial(known, points, dice.uniform(0.0, 403.0, (12, 2)), tolerance_px=0.01)


@pytest.mark.parametrize("count", [4, 5])
def test_four_points_are_enough(count: int) -> None:
    known = camera(tilt=(0.2, -0.1, 0.8))
    points = ground(known, count, np.random.default_rng(2))
    placed, agrees = initial(lost(known), points, known.project(points))
    assert agrees.all()
    assert np.abs(placed.position_mcmf_m - known.position_mcmf_m).max() < 0.1


def test_how_far_off_a_point_may_be_is_as_stated() -> None:
    """Of 30 exact points three are seen 3 px off: within 4 px they agree, within 2 they do not."""
    known = camera()
    points = ground(known, 30, np.random.default_rng(3))
    found = known.project(points)
    found[:3] += [[3.0, 0.0], [0.0, -3.0], [-2.1, 2.1]]
    for tolerance, count in ((2.0, 27), (4.0, 30)):
        _, agrees = initial(lost(known), points, found, tolerance)
        assert agrees.sum() == count
        assert agrees[3:].all()
