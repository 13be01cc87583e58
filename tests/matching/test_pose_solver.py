"""Convergence of the solver: from far off, after steps that are too long, and with Huber's loss;
compared with scipy and closed forms.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.posed import HADLEY, PlainMap, camera, covariances, ground, noise
from scipy.optimize import minimize

from lcp_catalog.cameras.sensor import Uncertainty
from lcp_catalog.matching.pose import HUBER, Pose, jacobian, residuals_px, solve

NO_PRIOR = Uncertainty(np.inf, np.inf)


def rounds(count: int) -> np.ndarray:
    return np.tile(np.eye(2), (count, 1, 1))


@pytest.mark.parametrize("times", [1.5, 2.5, 6.0, 20.0])
def test_a_camera_that_is_thought_much_too_high_comes_down(times: float) -> None:
    """Pixels are proportional to 1 / height: from more than twice the height a full step would end
    below the surface.
    """
    known = camera()
    points = ground(known, 20, np.random.default_rng(0), relief_m=100.0)
    rise = (times - 1.0) * 110e3 * HADLEY.rotation[2]
    prior = known.moved([*rise, 0.0, 0.0, 0.0])
    pose = solve(prior, points, known.project(points), rounds(20), Uncertainty(np.inf), np.full(20, True))  # fmt: skip
    assert np.abs(pose.sensor.position_mcmf_m - known.position_mcmf_m).max() < 0.5
    assert np.abs(residuals_px(pose.sensor, points, known.project(points))).max() < 1e-4


def test_it_goes_on_until_every_unknown_stands() -> None:
    """Turned by 60 deg about its own axis over points evenly around it: two of three unknowns
    converge at once.
    """
    known = camera()
    angle = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)
    pixels = known.principal_point_px + 120.0 * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    origin, looks = known.looks(pixels)
    prior = known.moved([0.0, 0.0, 0.0, 0.0, 0.0, np.radians(60.0)])
    pose = solve(prior, origin + 110e3 * looks, pixels, rounds(12), Uncertainty(0.0, np.inf), np.full(12, True))  # fmt: skip
    assert np.abs(residuals_px(pose.sensor, origin + 110e3 * looks, pixels)).max() < 1e-5
    assert pose.correction[5] == pytest.approx(-np.radians(60.0), abs=1e-7)


def test_a_long_lens_is_solved_though_place_and_attitude_look_alike() -> None:
    """A field of 1.5 deg without a prior: the effects of shifts and turns differ by little."""
    known = camera(focal_px=15e3)
    points = ground(known, 60, np.random.default_rng(1), relief_m=3e3)
    prior = known.moved([40.0, -30.0, 20.0, 2e-4, -1e-4, 3e-4])
    pose = solve(prior, points, known.project(points), rounds(60), NO_PRIOR, np.full(60, True))
    assert np.abs(residuals_px(pose.sensor, points, known.project(points))).max() < 1e-3
    off = pose.sensor.position_mcmf_m - known.position_mcmf_m
    assert np.linalg.norm(off) < 0.01 * pose.position_sigma_m


def huber_map(
    found: np.ndarray, points: np.ndarray, covariance: np.ndarray, sigma: float
) -> np.ndarray:
    """Shift (east, north) of a plain map at the minimum of Huber's loss of whitened distances and
    the prior, by Nelder and Mead.
    """
    whiten = np.linalg.inv(np.linalg.cholesky(covariance))
    off = found - PlainMap().project(points)

    def cost(shift: np.ndarray) -> float:
        far = np.linalg.norm(np.einsum("nij,nj->ni", whiten, off - shift * [-0.01, 0.01]), axis=-1)
        loss = np.where(far <= HUBER, far**2, 2.0 * HUBER * far - HUBER**2)
        return float(loss.sum() + ((shift / sigma) ** 2).sum())

    options = {"xatol": 1e-7, "fatol": 1e-12, "maxiter": 4000}
    return minimize(cost, np.zeros(2), method="Nelder-Mead", options=options).x


@pytest.mark.parametrize("share", [0.1, 0.4])
def test_without_inliers_it_is_hubers_minimum(share: float) -> None:
    dice = np.random.default_rng(2)
    flat = dice.uniform(-4e4, 4e4, (40, 2))
    points = HADLEY.to_mcmf(np.column_stack([flat, np.zeros(40)]))
    covariance = covariances(40, dice)
    true = PlainMap().moved([120.0, -80.0])
    found = true.project(points) + noise(covariance, dice)
    far = np.arange(40) < share * 40
    found[far] += dice.uniform(0.5, 6.0, (int(far.sum()), 2))
    pose = solve(PlainMap(), points, found, covariance, Uncertainty(500.0))
    wanted = huber_map(found, points, covariance, 500.0)
    # residuals beyond the stated covariances make the solver trust all of them less: Huber's bound is then wider
    scaled = huber_map(found, points, covariance * pose.scale, 500.0)
    assert np.abs(pose.correction - scaled).max() < 1e-2
    assert share < 0.3 or np.abs(wanted - scaled).max() > 0.1


def test_an_error_that_all_share_is_reckoned_where_the_camera_is_found() -> None:
    """The given camera is turned by 40 deg: the effect of a common shift there differs from that at
    the solution.
    """
    dice = np.random.default_rng(21)
    known = camera(tilt=(0.2, 0.0, 0.5))
    points = ground(known, 60, dice)
    covariance = covariances(60, dice)
    found, agrees = known.project(points), np.full(60, True)
    prior = known.moved([2e3, -3e3, 1e3, 0.05, -0.04, np.radians(40.0)])
    wide = Uncertainty(5000.0, 1.0)
    plain = solve(prior, points, found, covariance, wide, agrees)
    shared = solve(prior, points, found, covariance, wide, agrees, common_px=0.05)
    moves = [
        solve(prior, points, found + step, covariance, wide, agrees).correction - plain.correction
        for step in ([0.05, 0.0], [0.0, 0.05])
    ]
    added = sum(np.outer(move, move) for move in moves)
    unit = np.outer(shared.sigma, shared.sigma)
    assert np.abs((shared.covariance - plain.covariance - added) / unit).max() < 5e-3


@pytest.mark.parametrize("prior_m", [20.0, 5000.0])
def test_a_position_moves_with_the_map(prior_m: float) -> None:
    """Against solutions by ground that is moved 30 m along each axis; a position that is known well moves less."""
    dice = np.random.default_rng(22)
    known = camera(tilt=(0.2, 0.0, 0.5))
    points = ground(known, 60, dice)
    covariance = covariances(60, dice)
    found, agrees, prior = known.project(points), np.full(60, True), Uncertainty(prior_m, 0.01)
    plain = solve(known, points, found, covariance, prior, agrees)
    tied = solve(known, points, found, covariance, prior, agrees, map_m=30.0)
    moves = [
        solve(known, points + 30.0 * axis, found, covariance, prior, agrees).correction
        for axis in np.eye(3)
    ]
    added = sum(np.outer(move, move) for move in moves)
    unit = np.outer(tied.sigma, tied.sigma)
    assert np.abs((tied.covariance - plain.covariance - added) / unit).max() < 5e-3
    whole = np.trace(added[:3, :3]) / (3 * 30.0**2)
    assert whole == pytest.approx(1.0, abs=0.02) if prior_m > 1000.0 else whole < 0.8


def test_a_maps_shift_has_the_error_of_the_other_map() -> None:
    points = HADLEY.to_mcmf([[0.0, 0.0, 0.0], [4e3, 2e3, 0.0]])
    found = PlainMap().project(points)
    one, tied = (
        solve(PlainMap(), points, found, rounds(2), Uncertainty(1e4), [True] * 2, map_m=m)
        for m in (0.0, 30.0)
    )
    np.testing.assert_allclose(tied.covariance - one.covariance, 900.0 * np.eye(2), atol=5.0)


def judged(chi2: float, dof: float) -> Pose:
    """A pose with figures only."""
    pose = solve(PlainMap(), HADLEY.to_mcmf([[0.0, 0.0, 0.0]]), [[499.5, 499.5]], rounds(1), Uncertainty(1.0))  # fmt: skip
    return replace(pose, chi2=chi2, dof=dof)


@pytest.mark.parametrize("dof", [1.0, 5.0, 28.0, 400.0])
def test_residuals_are_held_against_what_they_should_be(dof: float) -> None:
    assert judged(3.0 * dof, dof).normalised_error == pytest.approx(3.0)
    assert judged(3.0 * dof, dof).scale == pytest.approx(3.0)
    assert judged(0.5 * dof, dof).normalised_error == pytest.approx(0.5)
    assert judged(0.5 * dof, dof).scale == 1.0
    assert np.isnan(judged(9.0, 0.9).normalised_error)
    assert judged(9.0, 0.9).scale == 1.0


def test_a_jacobian_is_the_same_at_any_height() -> None:
    """Steps follow the pixel size on the surface: 50 m to 5 km, by the closed form for a point
    below the camera.
    """
    for height in (2e4, 2e5, 2e6):
        known = camera(altitude_m=height)
        slope = jacobian(known, HADLEY.origin_mcmf_m[None])[0]
        f = known.focal_length_px
        down = DOWN_AT_HADLEY @ np.eye(3)
        np.testing.assert_allclose(slope[:, :3], -f / height * down[:2], atol=1e-6 * f / height)
        np.testing.assert_allclose(slope[:, 3:], [[0.0, f, 0.0], [-f, 0.0, 0.0]], atol=1e-6 * f)


DOWN_AT_HADLEY = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]]) @ HADLEY.rotation
