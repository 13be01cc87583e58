"""The fewest candidates that serve everything: against exact optima and linear programs of HiGHS."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import Bounds, LinearConstraint, linprog, milp
from scipy.sparse import csr_matrix

from lcp_catalog.approximations import APPROXIMATIONS
from lcp_catalog.landmarks import selection
from lcp_catalog.landmarks.selection import Cover, choose_cover, least_size


def instance(
    seed: int,
    n: int = 40,
    places: int = 5,
    conditions: int = 70,
    near: int = 2,
    most: int = 3,
    units: int = 1,
):
    """Random candidates near some places, worth up to so many units; what is wanted; and the same as a matrix (element,
    candidate).
    """
    rng = np.random.default_rng(seed)
    rows = [np.sort(rng.choice(places, near, replace=False)) for _ in range(n)]
    serves = rng.random((n, conditions)) < rng.uniform(0.0, 0.7, (n, 1))
    worth = (serves * rng.integers(1, units + 1, serves.shape)).astype(np.uint8)
    first = near * np.arange(n + 1)
    place = np.concatenate(rows).astype(np.int32)
    row = np.repeat(np.arange(n, dtype=np.int32), near)
    cover = Cover(first, place, row, worth, places)
    matrix = np.zeros((places, conditions, n))
    for k, row in enumerate(rows):
        matrix[row, :, k] = worth[k]
    wanted = np.minimum(matrix.sum(axis=2), most * units).astype(np.int16)
    return cover, wanted, matrix.reshape(-1, n)


def test_counts_are_those_of_the_matrix() -> None:
    cover, _, matrix = instance(1)
    rows = np.array([3, 7, 31])
    np.testing.assert_array_equal(cover.counts(rows).ravel(), matrix[:, rows].sum(axis=1))


@pytest.mark.parametrize("units", [1, 15])
@pytest.mark.parametrize("seed", range(8))
def test_the_choice_is_near_the_optimum(seed: int, units: int) -> None:
    """It serves all that is wanted, and is at most 1.15 times the exact optimum."""
    cover, wanted, matrix = instance(seed, units=units)
    choice = choose_cover(cover, wanted)
    assert (matrix[:, choice.chosen].sum(axis=1) >= wanted.ravel()).all()
    n = len(cover)
    exact = milp(
        np.ones(n),
        constraints=LinearConstraint(csr_matrix(matrix), wanted.ravel(), np.inf),
        integrality=np.ones(n),
        bounds=Bounds(0, 1),
    )
    assert exact.status == 0
    assert round(exact.fun) <= len(choice.chosen) <= 1.15 * exact.fun
    unneeded = [np.delete(choice.chosen, k) for k in range(len(choice.chosen))]
    assert not any((matrix[:, rest].sum(axis=1) >= wanted.ravel()).all() for rest in unneeded)


@pytest.mark.parametrize("units", [1, 15])
@pytest.mark.parametrize("seed", range(8))
def test_the_bound_is_that_of_the_linear_program(seed: int, units: int) -> None:
    """Never above the relaxed optimum, and less than 5 % below."""
    cover, wanted, matrix = instance(seed, n=60, places=7, near=3, units=units)
    size = len(choose_cover(cover, wanted).chosen)
    bounds = {"A_ub": -csr_matrix(matrix), "b_ub": -wanted.ravel(), "bounds": (0, 1)}
    relaxed = linprog(np.ones(len(cover)), method="highs", **bounds).fun
    assert 0.95 * relaxed <= least_size(cover, wanted, size) <= relaxed * (1.0 + 1e-9)


def test_the_bound_of_a_part_is_valid(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the work is limited to a sixth; it is that of the linear program of the part."""
    cover, wanted, matrix = instance(2, n=60, places=24, near=12)
    size = len(choose_cover(cover, wanted).chosen)
    monkeypatch.setattr(selection, "BOUND_WORK", selection._work(cover) * 150 // 6)
    elements = np.arange(24 * 70).reshape(24, 70)[::6].ravel()
    bounds = {"A_ub": -csr_matrix(matrix[elements]), "bounds": (0, 1)}
    relaxed = linprog(np.ones(60), b_ub=-wanted.ravel()[elements], method="highs", **bounds).fun
    assert 0.9 * relaxed <= least_size(cover, wanted, size) <= relaxed * (1.0 + 1e-9)


def test_what_exchanges_save_is_stated(monkeypatch: pytest.MonkeyPatch) -> None:
    """2000 candidates, each near 8 of 200 places in a row; above the limit none is exchanged, and all is served."""
    rng, count, near = np.random.default_rng(1), 2000, np.arange(8)
    place = np.sort((rng.integers(0, 200, count)[:, None] + near) % 200, axis=1).astype(np.int32)
    serves = rng.random((count, 40)) < rng.uniform(0.0, 0.7, (count, 1))
    worth = (serves * rng.integers(1, 16, serves.shape)).astype(np.uint8)
    row = np.repeat(np.arange(count, dtype=np.int32), 8)
    cover = Cover(8 * np.arange(count + 1), place.ravel(), row, worth, 200)
    wanted = np.minimum(cover.counts(np.arange(count)), 45).astype(np.int16)
    sizes = []
    for most in (count, count - 1):
        monkeypatch.setattr(selection, "EXCHANGE_MAX", most)
        chosen = choose_cover(cover, wanted).chosen
        assert (cover.counts(chosen) >= wanted).all()
        sizes.append(len(chosen))
    stated = next(one for one in APPROXIMATIONS if one.name == "exchanges of points").error
    assert 100.0 * (sizes[1] / sizes[0] - 1.0) == pytest.approx(stated.value, rel=0.02)


@pytest.mark.parametrize("units", [1, 15])
def test_a_limited_choice_is_the_greedy_start(units: int) -> None:
    """Each candidate in turn serves the most that still lacks; the curve counts what is served."""
    cover, wanted, matrix = instance(3, units=units)
    choice = choose_cover(cover, wanted, 6)
    lacking, taken = wanted.ravel().astype(int), []
    for met, served in zip(choice.met, choice.served, strict=True):
        gain = np.minimum(matrix, np.maximum(lacking, 0)[:, None]).sum(axis=0)
        gain[taken] = -1
        taken.append(int(gain.argmax()))
        lacking = np.maximum(lacking - matrix[:, taken[-1]].astype(int), 0)
        assert met == np.count_nonzero((lacking == 0) & (wanted.ravel() > 0))
        assert served == pytest.approx(1.0 - lacking.sum() / wanted.sum())
    assert choice.chosen.tolist() == sorted(taken)
    with pytest.raises(ValueError, match="at least 1"):
        choose_cover(cover, wanted, 0)


def test_nothing_wanted_needs_nobody() -> None:
    cover, wanted, _ = instance(4)
    assert not len(choose_cover(cover, np.zeros_like(wanted)).chosen)
    assert least_size(cover, np.zeros_like(wanted), 0) == 0.0
