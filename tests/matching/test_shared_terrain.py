"""Terrain that patches share, against a count of grid nodes; and the covariance with common errors
against positions solved from noise that neighbours share.
"""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from helpers import catalogs
from helpers.posed import camera, covariances, ground

from lcp_catalog.cameras.sensor import Uncertainty
from lcp_catalog.matching.common_errors import SharedTerrain, map_sigma_m, untied
from lcp_catalog.matching.pose import solve

UNCERTAIN = Uncertainty(5000.0, np.radians(0.5))


def counted(places: np.ndarray, width: np.ndarray, step: float = 4.0) -> np.ndarray:
    """Shared area over the geometric mean of the areas, (n, n), by nodes of a grid inside both squares."""
    x = np.arange(places[:, 0].min() - width.max(), places[:, 0].max() + width.max(), step)
    y = np.arange(places[:, 1].min() - width.max(), places[:, 1].max() + width.max(), step)
    half = width[:, None] / 2
    columns = (abs(x - places[:, :1]) < half).astype(np.float64)
    rows = (abs(y - places[:, 1:2]) < half).astype(np.float64)
    count = (columns @ columns.T) * (rows @ rows.T)  # nodes in both squares
    own = np.diag(count)
    return count / np.sqrt(np.outer(own, own))


@pytest.mark.parametrize("cells", [(20.0,), (20.0, 40.0), (10.0, 20.0, 40.0)])
def test_the_share_is_that_of_counted_nodes(cells: tuple[float, ...]) -> None:
    """Points of one, two and three levels on a plane, with patches of 17 nodes, at random rows."""
    dice = np.random.default_rng(3)
    places = np.column_stack([dice.uniform(0.0, 1500.0, (40, 2)), np.zeros(40)])
    gsd = dice.choice(cells, 60)
    catalog = SimpleNamespace(gsd=gsd, patch_nodes=17)
    rows = dice.permutation(60)[:40]
    found = SharedTerrain.of(catalog, rows, places, np.tile(np.eye(3), (40, 1, 1)))
    expected = counted(places, gsd[rows] * 16)
    matrix = np.eye(40)
    matrix[found.first, found.second] = matrix[found.second, found.first] = found.share
    np.testing.assert_allclose(matrix, expected, atol=0.06)
    assert len(found.share) == (np.triu(matrix, 1) > 0.0).sum()  # each pair once
    apart = abs(places[:, None] - places).max(axis=-1)
    assert np.array_equal(matrix > 0.0, apart < 8.0 * (gsd[rows, None] + gsd[rows]))
    assert ((expected > 0.02) & ~np.eye(40, dtype=bool)).sum() > 40
    for first in range(7):  # each of them is the first of the part once
        some = np.roll([31, 3, 17, 8, 22, 5, 11], first)
        part = found.some(some)
        assert part.count == 7
        smaller = np.eye(7)
        smaller[part.first, part.second] = smaller[part.second, part.first] = part.share
        np.testing.assert_array_equal(smaller, matrix[np.ix_(some, some)])


def test_the_squares_have_the_axes_of_the_points() -> None:
    """Two squares of 160 m, 100 m apart along a direction 30 deg from their rows."""
    turn = np.radians(30.0)
    axes = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    places = np.array([[0.0, 0.0, 0.0], [100.0, 0.0, 0.0]])
    catalog = SimpleNamespace(gsd=np.full(2, 10.0), patch_nodes=17)
    found = SharedTerrain.of(catalog, np.arange(2), places, np.tile(axes, (2, 1, 1)))
    sides = 160.0 - 100.0 * np.abs([np.cos(turn), np.sin(turn)])
    np.testing.assert_allclose(found.share, [sides.prod() / 160.0**2])


def test_the_map_is_that_of_the_points_that_are_asked_for() -> None:
    """The places of three products: 30 m (GLD100), not published, 10 m (SLDEM2015)."""
    names = np.array(["GLD100_256", "made_59m", "SLDEM2015_512"], object)
    catalog = replace(catalogs.catalog(3), dem_product=names)
    sigmas = [map_sigma_m(catalog, np.array(rows)) for rows in ([0, 1, 2], [1, 2], [1])]
    assert sigmas == [30.0, 10.0, 0.0]
    assert untied(catalog, np.array([0, 1])) == ("made_59m",)
    assert untied(catalog, np.array([0, 2])) == ()


@pytest.mark.slow
def test_common_errors_widen_the_covariance_as_they_do_in_solved_positions() -> None:
    """40 points in 10 groups of four whose errors, in sigmas, have a correlation of 0.4: 100 solutions."""
    dice = np.random.default_rng(22)
    known = camera()
    places = ground(known, 10, dice)
    points = np.repeat(places, 4, axis=0) + dice.normal(0.0, 300.0, (40, 3))
    covariance, pixels = covariances(40, dice), known.project(points)
    groups = np.repeat(np.arange(10), 4)
    first, second = np.nonzero(np.triu(groups[:, None] == groups, 1))
    shared = SharedTerrain(first, second, np.full(len(first), 0.4), 40)
    agrees = np.full(40, True)
    wide = solve(known, points, pixels, covariance, UNCERTAIN, agrees, shared)
    plain = solve(known, points, pixels, covariance, UNCERTAIN, agrees)
    assert np.array_equal(wide.correction, plain.correction)
    assert (wide.sigma > 1.1 * plain.sigma).all()
    roots, squared, narrow = np.linalg.cholesky(covariance), [], []
    for _ in range(100):
        own, common = dice.normal(size=(40, 2)), dice.normal(size=(10, 2))[groups]
        off = np.einsum("nij,nj->ni", roots, np.sqrt(0.6) * own + np.sqrt(0.4) * common)
        start = known.moved(UNCERTAIN.sigmas(known) * dice.normal(size=6))
        pose = solve(start, points, pixels + off, covariance, UNCERTAIN, agrees, shared)
        error = pose.position_mcmf_m - known.position_mcmf_m
        squared.append(error @ np.linalg.solve(pose.position_covariance_m2 / pose.scale, error) / 3)
        narrow.append(error @ np.linalg.solve(plain.position_covariance_m2, error) / 3)
    # mean of 100 chi-square numbers of 3 degrees over 3: 1 sigma is 0.08
    assert abs(np.mean(squared) - 1.0) < 0.15
    assert np.mean(narrow) > 1.4
