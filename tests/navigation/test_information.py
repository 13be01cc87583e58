"""Covariance of a position with errors that points share, against the whole covariance matrix of all
places.
"""

from __future__ import annotations

import numpy as np
import pytest

from lcp_catalog.matching.common_errors import SharedTerrain
from lcp_catalog.navigation.information import Information

COUNT = 12


def made(attitude_rad: float, shared: bool = True) -> tuple[Information, np.ndarray]:
    """Points, and the correlations (n, n) of their errors in sigmas."""
    dice = np.random.default_rng(5)
    slopes = dice.normal(size=(COUNT, 2, 6)) * np.repeat([1e-3, 1e3], 3)
    roots = np.tril(dice.normal(size=(COUNT, 2, 2))) + np.eye(2)
    correlation = np.eye(COUNT)
    first, second = np.array([0, 1, 4, 7]), np.array([1, 2, 9, 3])
    share = np.array([0.5, 0.2, 0.4, 0.1])
    correlation[first, second] = correlation[second, first] = share
    pairs = SharedTerrain(first, second, share, COUNT) if shared else None
    covariance = roots @ np.swapaxes(roots, -1, -2)
    shift = dice.normal(size=(COUNT, 2)) if shared else None
    return Information(slopes, covariance, np.ones(COUNT), attitude_rad, pairs, shift), correlation


@pytest.mark.parametrize("attitude_rad", [np.inf, 1e-4, 0.0])
def test_it_is_that_of_weighted_least_squares(attitude_rad: float) -> None:
    """Weights are the points' own; the errors' covariance has the blocks r_ij L_i L_j^T + d_i d_j^T."""
    information, correlation = made(attitude_rad)
    assert information.shift_px is not None
    shift = information.shift_px.ravel()
    roots = np.linalg.cholesky(information.covariance_px2)
    errors = np.einsum("ij,iab,jcb->iajc", correlation, roots, roots).reshape(2 * COUNT, -1)
    weight = np.linalg.inv(errors * np.kron(np.eye(COUNT), np.ones((2, 2))))
    errors = errors + np.outer(shift, shift)
    free = 3 if attitude_rad == 0.0 else 6
    rows = information.slopes.reshape(-1, 6)[:, :free]
    prior = np.zeros((free, free))
    if np.isfinite(attitude_rad) and attitude_rad:
        prior[3:, 3:] = np.eye(3) / attitude_rad**2
    gain = np.linalg.inv(rows.T @ weight @ rows + prior)
    expected = gain @ (rows.T @ weight @ errors @ weight @ rows + prior) @ gain
    found = information.covariance()
    assert found is not None
    unit = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(found[:free, :free] / np.outer(unit, unit), expected / np.outer(unit, unit), atol=1e-6)  # fmt: skip
    alone = made(attitude_rad, shared=False)[0].covariance()
    assert alone is not None
    assert abs(np.trace(found[:3, :3]) / np.trace(alone[:3, :3]) - 1.0) > 0.01
    added = information.terrain_part() + information.shift_part()
    np.testing.assert_allclose(found - alone, added, atol=1e-6 * np.abs(found).max())
    if attitude_rad == 0.0:
        np.testing.assert_allclose(information.covariance_known_attitude(), expected, rtol=1e-6)


def test_a_pair_counts_if_both_points_are_found() -> None:
    """Mean over all cases of two points that are found with given probabilities: only the pair's term."""
    information, _ = made(np.inf)
    both = information.some(np.array([0, 1]))
    p = np.array([0.3, 0.8])
    likely = Information(both.slopes, both.covariance_px2, p, np.inf, both.shared)
    np.testing.assert_allclose(likely.common_terrain, p.prod() * both.common_terrain, rtol=1e-9)
