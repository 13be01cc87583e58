"""Solution for a sensor's position: compared with scipy and OpenCV, closed forms, and many draws."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from helpers.posed import HADLEY, PlainMap, camera, covariances, ground, noise, spread_px2, turned
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares
from scipy.special import chdtri

from lcp_catalog.cameras.frame_camera import Camera
from lcp_catalog.cameras.sensor import Reduced, Uncertainty
from lcp_catalog.errors import PoseError
from lcp_catalog.matching.pose import jacobian, position_error, residuals_px, solve

UNCERTAIN = Uncertainty(5000.0, np.radians(0.5))
NO_PRIOR = Uncertainty(np.inf, np.inf)


@pytest.mark.parametrize(
    "wrong", [(-1.0, 0.0), (np.nan, 0.0), (1.0, -0.1), (1.0, 30.0), (1.0, np.nan)]
)
def test_a_sigma_that_is_none_is_refused(wrong: tuple[float, float]) -> None:
    """30 deg taken as radians: `locate` searched all of a photograph for every point and did not come back for minutes."""
    with pytest.raises(
        PoseError, match=r"Uncertainty\(.*: a sigma is 0 or more, that of an attitude in radians"
    ):
        Uncertainty(*wrong)


def pinhole(camera: Camera, correction: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Pixels of points in a moved camera, by hand."""
    rotation = turned(correction[3:]) @ camera.rotation_mcmf_to_camera
    x, y, z = rotation @ (points - camera.position_mcmf_m - correction[:3]).T
    cx, cy = camera.principal_point_px
    return np.stack([cx + camera.focal_length_px * x / z, cy + camera.focal_length_px * y / z], -1)


def by_scipy(
    prior: Camera, points: np.ndarray, found: np.ndarray, covariance: np.ndarray, sigmas: np.ndarray
):
    """Least squares of the same sum by MINPACK: the correction, its covariance, and chi2 of the
    points.
    """
    whiten = np.linalg.inv(np.linalg.cholesky(covariance))

    def residual(unit: np.ndarray) -> np.ndarray:
        off = found - pinhole(prior, unit * sigmas, points)
        return np.concatenate([np.einsum("nij,nj->ni", whiten, off).ravel(), unit])

    fit = least_squares(residual, np.zeros(6), jac="3-point", xtol=1e-15, ftol=1e-15, gtol=1e-15)
    inverse = np.linalg.inv(fit.jac.T @ fit.jac)
    return fit.x * sigmas, inverse * np.outer(sigmas, sigmas), float((fit.fun[:-6] ** 2).sum())


@pytest.mark.parametrize("seed", range(6))
def test_it_is_what_scipy_finds(seed: int) -> None:
    dice = np.random.default_rng(seed)
    known = camera(tilt=tuple(dice.uniform(-0.5, 0.5, 3)))
    points = ground(known, 60, dice)
    covariance = covariances(60, dice)
    found = known.project(points) + noise(covariance, dice)
    sigmas = UNCERTAIN.sigmas(known)
    prior = known.moved(sigmas * dice.normal(size=6))
    pose = solve(prior, points, found, covariance * 4.0, UNCERTAIN, np.ones(60, dtype=bool))
    correction, inverse, total = by_scipy(prior, points, found, covariance * 4.0, sigmas)
    assert pose.scale == 1.0
    assert np.abs((pose.correction - correction) / pose.sigma).max() < 1e-4
    unit = np.outer(pose.sigma, pose.sigma)
    assert np.abs((pose.covariance - inverse) / unit).max() < 1e-4
    assert pose.chi2 == pytest.approx(total, rel=1e-6)


@given(
    st.integers(0, 2**32 - 1), st.floats(-0.6, 0.6), st.floats(-0.6, 0.6), st.floats(-np.pi, np.pi)
)
@settings(max_examples=25, deadline=None)
def test_without_noise_and_without_a_prior_it_comes_back_exactly(
    seed: int, right: float, down: float, roll: float
) -> None:
    dice = np.random.default_rng(seed)
    known = camera(tilt=(right, down, roll))
    points = ground(known, 12, dice)
    pixels = known.project(points)
    assume(np.isfinite(pixels).all())  # no corner looks above the horizon
    prior = known.moved(UNCERTAIN.sigmas(known) * dice.normal(size=6))
    pose = solve(prior, points, pixels, np.tile(np.eye(2), (12, 1, 1)), NO_PRIOR)
    assert np.abs(pose.sensor.position_mcmf_m - known.position_mcmf_m).max() < 0.5
    assert np.abs(residuals_px(pose.sensor, points, pixels)).max() < 1e-4


def test_without_a_prior_it_is_what_opencv_finds() -> None:
    dice = np.random.default_rng(3)
    known = camera(tilt=(0.3, -0.2, 1.0))
    points = ground(known, 40, dice)
    found = known.project(points) + dice.normal(0.0, 0.5, (40, 2))
    prior = known.moved([3e3, -2e3, 1e3, 0.004, 0.01, -0.005])
    pose = solve(prior, points, found, np.tile(np.eye(2), (40, 1, 1)), NO_PRIOR, np.full(40, True))
    f, (cx, cy) = known.focal_length_px, known.principal_point_px
    matrix = np.array([[f, 0.0, cx], [0.0, f, cy], [0.0, 0.0, 1.0]])
    middle = points.mean(0)
    flags = cv2.SOLVEPNP_ITERATIVE
    _, turn, shift = cv2.solvePnP(points - middle, found, matrix, np.zeros(5), flags=flags)
    turn, shift = cv2.solvePnPRefineLM(
        points - middle, found, matrix, np.zeros(5), turn, shift, (3, 200, 1e-14)
    )
    position = middle - cv2.Rodrigues(turn)[0].T @ shift[:, 0]
    assert np.abs(pose.sensor.position_mcmf_m - position).max() < 0.01 * pose.position_sigma_m


@pytest.mark.slow
@pytest.mark.parametrize(
    "uncertainty", [UNCERTAIN, Uncertainty(5000.0), Uncertainty(300.0, 1e-3)], ids=str
)
def test_errors_agree_with_the_covariance(uncertainty: Uncertainty) -> None:
    """60 draws of noise and prior: the mean squared error in units of the covariance is the number
    of unknowns, and chi2 its expectation, each within 4 standard errors.
    """
    dice = np.random.default_rng(11)
    known = camera(tilt=(0.2, 0.1, 0.7))
    points = ground(known, 15, dice)
    covariance = covariances(15, dice)
    sigmas = uncertainty.sigmas(known)
    free = sigmas > 0.0
    squared, excess = [], []
    for _ in range(60):
        off = sigmas * dice.normal(size=6)
        prior = known.moved(off)
        found = known.project(points) + noise(covariance, dice)
        pose = solve(prior, points, found, covariance, uncertainty, np.full(15, True))
        formal = pose.covariance[np.ix_(free, free)] / pose.scale
        # back to the true camera: the inverse of the draw, to first order
        error = (pose.correction + off)[free]
        squared.append(error @ np.linalg.solve(formal, error))
        excess.append(pose.chi2 - pose.dof)
    count = free.sum()
    assert abs(np.mean(squared) - count) < 4.0 * np.sqrt(2.0 * count / 60.0) + 0.02 * count
    assert abs(np.mean(excess)) < 4.0 * np.std(excess) / np.sqrt(60.0)


def test_covariances_that_are_too_small_are_found_out() -> None:
    """Residuals three times as large as stated: the normalised error is 9, and the pose's
    covariance grows by that factor.
    """
    dice = np.random.default_rng(5)
    known = camera()
    points = ground(known, 400, dice)
    covariance = covariances(400, dice)
    found = known.project(points) + 3.0 * noise(covariance, dice)
    agrees = np.full(400, True)
    pose = solve(known, points, found, covariance, UNCERTAIN, agrees)
    right = solve(known, points, found, 9.0 * covariance, UNCERTAIN, agrees)
    assert pose.normalised_error == pytest.approx(9.0, rel=4.0 * np.sqrt(2.0 / 800.0))
    assert pose.scale == pose.normalised_error
    assert np.allclose(pose.covariance, right.covariance, rtol=0.25, atol=0.0)
    assert right.scale == pytest.approx(1.0, abs=0.2)


def test_covariances_that_are_too_large_make_nothing_better() -> None:
    dice = np.random.default_rng(6)
    known = camera()
    points = ground(known, 100, dice)
    covariance = covariances(100, dice)
    exact = known.project(points)
    pose = solve(known, points, exact, covariance, UNCERTAIN, np.full(100, True))
    assert pose.scale == 1.0
    slope = jacobian(known, points)
    normal = np.einsum("nia,nij,njb->ab", slope, np.linalg.inv(covariance), slope)
    formal = np.linalg.inv(normal + np.diag(UNCERTAIN.sigmas(known) ** -2))
    assert np.allclose(pose.covariance, formal, rtol=1e-4, atol=0.0)


def test_what_has_a_sigma_of_nothing_is_held() -> None:
    dice = np.random.default_rng(7)
    known = camera()
    points = ground(known, 20, dice)
    prior = known.moved([800.0, -500.0, 300.0, 0.0, 0.0, 0.0])
    covariance = covariances(20, dice)
    found = known.project(points) + noise(covariance, dice)
    pose = solve(prior, points, found, covariance, Uncertainty(2000.0))
    assert pose.solved.tolist() == [True] * 3 + [False] * 3
    assert (pose.correction[3:] == 0.0).all()
    assert (pose.covariance[3:] == 0.0).all()
    assert (pose.covariance[:, 3:] == 0.0).all()
    assert np.array_equal(pose.sensor.rotation_mcmf_to_camera, prior.rotation_mcmf_to_camera)
    error = position_error(pose, known)
    assert error.squared < chdtri(3, 1e-4)
    nothing = solve(prior, points, found, covariance, Uncertainty(0.0))
    assert (nothing.correction == 0.0).all()
    assert np.allclose(nothing.sensor.project(points), prior.project(points))


def test_the_attitude_alone() -> None:
    dice = np.random.default_rng(23)
    known = camera()
    points = ground(known, 20, dice)
    prior = known.moved([0.0, 0.0, 0.0, 0.004, -0.006, 0.01])
    covariance = covariances(20, dice)
    pose = solve(prior, points, known.project(points), covariance, Uncertainty(0.0, 0.01))
    assert pose.solved.tolist() == [False] * 3 + [True] * 3
    assert np.array_equal(pose.sensor.position_mcmf_m, prior.position_mcmf_m)
    turn = pose.sensor.rotation_mcmf_to_camera @ known.rotation_mcmf_to_camera.T
    assert np.abs(turn - np.eye(3)).max() < 0.05 * pose.sigma[3:].max()
    assert (pose.sigma[3:] > 0.0).all()
    assert pose.position_sigma_m == 0.0


def test_huber_holds_against_a_tenth_that_is_wrong() -> None:
    dice = np.random.default_rng(8)
    known = camera()
    points = ground(known, 200, dice)
    covariance = covariances(200, dice)
    found = known.project(points) + noise(covariance, dice)
    found[::10] += dice.uniform(5.0, 30.0, (20, 2))
    plain, robust = (
        position_error(
            solve(known, points, found, covariance, UNCERTAIN, inliers), known
        ).error.whole_m
        for inliers in (np.full(200, True), None)
    )
    clean = np.arange(200) % 10 > 0
    best = position_error(solve(known, points, found, covariance, UNCERTAIN, clean), known)
    assert plain > 10.0 * best.sigma.whole_m
    assert robust < 5.0 * best.sigma.whole_m


def test_only_the_inliers_count() -> None:
    dice = np.random.default_rng(9)
    known = camera()
    points = ground(known, 30, dice)
    found = known.project(points)
    agrees = np.arange(30) % 3 > 0
    found[~agrees] += 50.0
    found[1] = np.nan
    pose = solve(known, points, found, covariances(30, dice), UNCERTAIN, agrees)
    assert pose.used.tolist() == [bool(a) and k != 1 for k, a in enumerate(agrees)]
    assert np.abs(pose.correction / UNCERTAIN.sigmas(known)).max() < 1e-6
    residual_px = residuals_px(pose.sensor, points, found)
    assert np.allclose(residual_px[~agrees], 50.0, atol=1e-3)
    assert np.isnan(residual_px[1]).all()


def test_a_map_is_moved_by_the_weighted_mean() -> None:
    """Two unknowns and a linear sensor: the closed form is the mean of the offsets, weighted by
    inverse covariance.
    """
    dice = np.random.default_rng(10)
    sheet = PlainMap()
    east_north = dice.uniform(-4e4, 4e4, (25, 2))
    points = HADLEY.to_mcmf(np.column_stack([east_north, dice.uniform(0.0, 3e3, 25)]))
    covariance = covariances(25, dice)
    found = sheet.moved([350.0, -220.0]).project(points) + noise(covariance, dice)
    pose = solve(sheet, points, found, covariance, Uncertainty(np.inf), np.full(25, True))
    inverse = np.linalg.inv(covariance)
    total = np.linalg.inv(inverse.sum(0))
    mean = total @ np.einsum("nij,nj->i", inverse, found - sheet.project(points))
    assert np.allclose(pose.correction, mean * [-100.0, 100.0], atol=1e-4)
    flip = np.diag([-100.0, 100.0])
    assert np.allclose(pose.covariance, pose.scale * flip @ total @ flip, rtol=1e-6)
    assert pose.dof == pytest.approx(48.0)
    assert np.allclose(jacobian(sheet, points), [[-0.01, 0.0], [0.0, 0.01]], atol=1e-9)
    with pytest.raises(ValueError, match="no position"):
        position_error(pose, sheet)


def test_a_reduced_sensor_is_corrected_by_the_same() -> None:
    dice = np.random.default_rng(12)
    known = camera()
    points = ground(known, 40, dice)
    covariance = covariances(40, dice)
    found = known.project(points) + noise(covariance, dice)
    agrees = np.full(40, True)
    whole = solve(known, points, found, covariance, UNCERTAIN, agrees)
    half = solve(
        Reduced(known, 2), points, (found + 0.5) / 2.0 - 0.5, covariance / 4.0, UNCERTAIN, agrees
    )
    assert np.allclose(half.correction, whole.correction, rtol=0.0, atol=1e-3 * whole.sigma)
    assert np.allclose(half.covariance, whole.covariance, rtol=1e-4, atol=0.0)


def test_the_jacobian_of_a_pinhole() -> None:
    """By hand: with p = R (X - C), d(pixel)/dp = f/z [[1, 0, -x/z], [0, 1, -y/z]], dp/dC = -R, dp/dturn = -[p]x."""
    dice = np.random.default_rng(13)
    known = camera(tilt=(0.4, -0.3, 2.0))
    points = ground(known, 10, dice)
    rotation = known.rotation_mcmf_to_camera
    for point, slope in zip(points, jacobian(known, points), strict=True):
        x, y, z = p = rotation @ (point - known.position_mcmf_m)
        to_pixel = known.focal_length_px / z * np.array([[1.0, 0.0, -x / z], [0.0, 1.0, -y / z]])
        cross = np.array([[0.0, -p[2], p[1]], [p[2], 0.0, -p[0]], [-p[1], p[0], 0.0]])
        exact = to_pixel @ np.hstack([-rotation, -cross])
        assert np.allclose(slope, exact, rtol=1e-6, atol=1e-6 * np.abs(exact).max())


class Framelets(Reduced):
    """A camera whose image consists of strips: pixels jump by 3 rows every 16."""

    def project(self, points_mcmf_m):
        pixels = self.full.project(points_mcmf_m)
        return pixels + [0.0, 3.0] * np.floor(pixels[..., 1:] / 16.0)

    def moved(self, correction):
        return Framelets(self.full.moved(correction), 1)


def test_a_jump_to_the_next_framelet_is_no_slope() -> None:
    """Points within a tenth of a pixel of a strip's edge, on either side of it."""
    whole = camera()
    rows = 16.0 * np.arange(4, 12)[:, None] + [-0.04, 0.0, 0.03]
    pixels = np.stack([np.full(rows.size, 120.0), rows.ravel()], axis=-1)
    origins, rays = whole.looks(pixels)
    points = origins + 100e3 * rays
    found, right = jacobian(Framelets(whole, 1), points), jacobian(whole, points)
    size = np.abs(right).max(
        axis=(0, 1)
    )  # a step of 0.1 px to one side is off by 0.1 px / f = 4e-4
    assert (np.abs(found - right) < 1e-3 * size).all()


def test_an_error_that_all_share_adds_to_the_covariance() -> None:
    """By the closed form, a shift of all places by the same pixels moves the solution by C J^T W;
    and by trial.
    """
    dice = np.random.default_rng(21)
    known = camera(tilt=(0.2, 0.0, 0.5))
    points = ground(known, 60, dice)
    covariance = covariances(60, dice)
    found, agrees = known.project(points), np.full(60, True)
    plain = solve(known, points, found, covariance, UNCERTAIN, agrees)
    shared = solve(known, points, found, covariance, UNCERTAIN, agrees, common_px=0.05)
    assert np.array_equal(shared.correction, plain.correction)
    moves = [
        solve(known, points, found + step, covariance, UNCERTAIN, agrees).correction
        for step in ([0.05, 0.0], [0.0, 0.05])
    ]
    added = sum(np.outer(move, move) for move in moves)
    unit = np.outer(shared.sigma, shared.sigma)
    assert np.abs((shared.covariance - plain.covariance - added) / unit).max() < 2e-3


def test_an_error_that_moves_each_place_by_its_own_shift_adds_to_the_covariance() -> None:
    """By trial: all places moved by their shifts. A quarter of the points is not used."""
    dice = np.random.default_rng(23)
    known = camera(tilt=(0.2, 0.0, 0.5))
    points = ground(known, 60, dice)
    covariance, shift = covariances(60, dice), dice.normal(0.005, 0.005, (60, 2))
    found, agrees = known.project(points), np.arange(60) % 4 > 0
    plain = solve(known, points, found, covariance, UNCERTAIN, agrees)
    common = solve(known, points, found, covariance, UNCERTAIN, agrees, shift_px=shift)
    assert np.array_equal(common.correction, plain.correction)
    move = solve(known, points, found + shift, covariance, UNCERTAIN, agrees).correction
    unit = np.outer(common.sigma, common.sigma)
    added = (common.covariance - plain.covariance) / unit
    wanted = np.outer(move, move) / unit
    assert np.abs(added - wanted).max() < 5e-3 * np.abs(wanted).max()


@pytest.mark.slow
def test_how_far_places_may_be_off() -> None:
    dice = np.random.default_rng(14)
    known = camera()
    points = ground(known, 5, dice)
    sigmas = Uncertainty(200.0, 1e-3).sigmas(known)
    spread = spread_px2(known, points, np.diag(sigmas**2))
    drawn = np.stack(
        [known.moved(sigmas * dice.normal(size=6)).project(points) for _ in range(4000)]
    )
    for k in range(5):
        assert np.allclose(np.cov(drawn[:, k].T), spread[k], atol=0.1 * np.trace(spread[k]))


def test_an_error_is_split_along_the_line_of_sight() -> None:
    known = camera()
    dice = np.random.default_rng(15)
    points = ground(known, 20, dice)
    pose = solve(known, points, known.project(points), covariances(20, dice), UNCERTAIN)
    up, east = HADLEY.rotation[2], HADLEY.rotation[0]
    error = position_error(pose, known.moved([*(300.0 * up + 40.0 * east), 0.0, 0.0, 0.0]))
    assert error.error.along_m == pytest.approx(300.0, abs=1e-2)
    assert error.error.across_m == pytest.approx(40.0, abs=1e-2)
    assert error.error.whole_m == pytest.approx(np.hypot(300.0, 40.0), abs=1e-2)
    covariance = pose.covariance[:3, :3]
    assert error.sigma.whole_m == pytest.approx(np.sqrt(np.trace(covariance)))
    assert error.sigma.along_m == pytest.approx(np.sqrt(up @ covariance @ up))
    assert np.hypot(error.sigma.along_m, error.sigma.across_m) == pytest.approx(error.sigma.whole_m)
    off = 300.0 * up + 40.0 * east
    assert error.squared == pytest.approx(off @ np.linalg.inv(covariance) @ off, rel=1e-3)


def test_what_cannot_be_solved_is_refused() -> None:
    known = camera()
    points = ground(known, 10, np.random.default_rng(16))
    unit = np.tile(np.eye(2), (10, 1, 1))
    with pytest.raises(PoseError, match="no point was found"):
        solve(known, points, np.full((10, 2), np.nan), unit, UNCERTAIN)
    behind = 2.0 * known.position_mcmf_m - points
    with pytest.raises(PoseError, match="camera"):
        solve(known, behind, known.project(points), unit, UNCERTAIN)
    two = np.arange(10) < 2
    with pytest.raises(PoseError, match="2 points do not determine"):
        solve(known, points, known.project(points), unit, NO_PRIOR, two)
