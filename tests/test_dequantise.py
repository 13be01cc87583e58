"""Surfaces out of their own steps: never further than half a step away, and the one that bends least (by scipy's
bounded least squares).
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

from benchmarks.evidence.dequantise import smooth_terraces


def differences(there: np.ndarray) -> np.ndarray:
    """Every second difference as a row over the nodes (rows * cols), written out one by one."""
    rows, cols = there.shape
    found = []

    def add(weight: float, *terms: tuple[int, int, float]) -> None:
        if all(there[r, c] for r, c, _ in terms):
            row = np.zeros((rows, cols))
            for r, c, factor in terms:
                row[r, c] += weight * factor
            found.append(row.ravel())

    for r in range(rows):
        for c in range(cols):
            if c + 2 < cols:
                add(1.0, (r, c, 1), (r, c + 1, -2), (r, c + 2, 1))
            if r + 2 < rows:
                add(1.0, (r, c, 1), (r + 1, c, -2), (r + 2, c, 1))
            if r + 1 < rows and c + 1 < cols:
                add(2.0**0.5, (r, c, 1), (r, c + 1, -1), (r + 1, c, -1), (r + 1, c + 1, 1))
    return np.array(found)


def bending(heights_m: np.ndarray) -> float:
    """Sum of z_xx^2 + 2 z_xy^2 + z_yy^2 by second differences between neighbours that are all there."""
    z = heights_m
    parts = z[:, :-2] - 2 * z[:, 1:-1] + z[:, 2:], z[:-2] - 2 * z[1:-1] + z[2:]
    twist = z[:-1, :-1] - z[:-1, 1:] - z[1:, :-1] + z[1:, 1:]
    return float(sum(np.nansum(part**2) for part in parts) + 2 * np.nansum(twist**2))


def hills(shape: tuple[int, int], seed: int, height_m: float = 4.0) -> np.ndarray:
    """A few waves, no shorter than the grid's third."""
    rng = np.random.default_rng(seed)
    row, col = np.mgrid[: shape[0], : shape[1]] / max(shape)
    waves = rng.uniform(-3, 3, (6, 2))
    return (
        height_m
        * sum(np.sin(2 * np.pi * (row * a + col * b) + i) for i, (a, b) in enumerate(waves))
        / 3
    )


@given(
    seed=st.integers(0, 2**32 - 1), step_m=st.floats(0.01, 50.0), hole=st.booleans(),
    shape=st.tuples(st.integers(1, 14), st.integers(1, 14)),
)  # fmt: skip
@settings(deadline=None)
def test_no_height_moves_by_more_than_half_a_step(
    seed: int, step_m: float, hole: bool, shape: tuple[int, int]
) -> None:
    stepped = step_m * np.round(hills(shape, seed) / step_m) + 1700.0
    if hole:
        stepped[shape[0] // 3 : shape[0] // 2, shape[1] // 4 :] = np.nan
    found = smooth_terraces(stepped, step_m)
    np.testing.assert_array_equal(np.isnan(found.heights_m), np.isnan(stepped))
    moved = np.abs(found.heights_m - stepped)
    assert np.nanmax(moved, initial=0.0) <= step_m / 2 * (1 + 1e-9) + 1e-9
    assert bending(found.heights_m) <= bending(stepped) * (1 + 1e-9) + 1e-9


@pytest.mark.parametrize("hole", [False, True])
def test_it_is_the_surface_that_bends_least(hole: bool) -> None:
    """scipy's bounded least squares on every second difference written out."""
    step_m = 1.5
    stepped = step_m * np.round(hills((11, 13), 5) / step_m)
    if hole:
        stepped[4:7, 5:9] = np.nan
    there = np.isfinite(stepped)
    rows = differences(there)
    known = there.ravel()
    values = stepped.ravel()[known]
    best = lsq_linear(
        rows[:, known], np.zeros(len(rows)), (values - step_m / 2, values + step_m / 2),
        tol=1e-14, method="bvls",
    )  # fmt: skip
    assert bending(stepped) == pytest.approx(float(np.sum((rows[:, known] @ values) ** 2)))
    found = smooth_terraces(stepped, step_m, tolerance=1e-9, most_rounds=50000)
    assert bending(found.heights_m) == pytest.approx(2 * best.cost, rel=1e-6)
    np.testing.assert_allclose(found.heights_m.ravel()[known], best.x, atol=1e-3 * step_m)


def test_a_plane_comes_back_as_a_plane() -> None:
    row, col = np.mgrid[:60, :70]
    plane = 0.043 * col - 0.021 * row
    found = smooth_terraces(np.round(plane), 1.0, tolerance=1e-6).heights_m
    assert bending(np.round(plane)) > 50.0
    assert bending(found) < 1e-4
    slopes = np.gradient(found)
    assert abs(slopes[1].mean() - 0.043) < 0.01
    assert abs(slopes[0].mean() + 0.021) < 0.01


@pytest.mark.parametrize("seed", range(4))
def test_slopes_come_back(seed: int) -> None:
    """Hills of 40 cells in steps of a fifth of their height: slopes are wrong by a fifth of what the steps made of them."""
    true = hills((90, 90), seed)
    step_m = 0.8
    stepped = step_m * np.round(true / step_m)
    found = smooth_terraces(stepped, step_m).heights_m
    inside = np.s_[3:-3, 3:-3]

    def slope_error(heights: np.ndarray) -> float:
        return float(
            np.sqrt(
                sum(
                    np.mean((a - b)[inside] ** 2)
                    for a, b in zip(np.gradient(heights), np.gradient(true), strict=True)
                )
            )
        )

    assert slope_error(found) < 0.2 * slope_error(stepped)
    assert np.sqrt(np.mean((found - true) ** 2)) < np.sqrt(np.mean((stepped - true) ** 2))


def test_level_ground_stays_level() -> None:
    found = smooth_terraces(np.full((20, 20), 1234.0), 1.0)
    np.testing.assert_array_equal(found.heights_m, 1234.0)


def test_nothing_but_holes() -> None:
    assert np.isnan(smooth_terraces(np.full((5, 5), np.nan), 1.0).heights_m).all()


@pytest.mark.parametrize("step_m", [0.0, -1.0, np.nan, np.inf])
def test_steps_that_are_none(step_m: float) -> None:
    with pytest.raises(ValueError, match="it must be positive"):
        smooth_terraces(np.zeros((5, 5)), step_m)


def test_it_says_how_far_it_came() -> None:
    stepped = np.round(hills((40, 40), 1))
    rough = smooth_terraces(stepped, 1.0, most_rounds=3)
    assert rough.rounds == 3
    fine = smooth_terraces(stepped, 1.0, tolerance=1e-6)
    assert fine.last_move_m <= 1e-6 < rough.last_move_m
    assert bending(fine.heights_m) < bending(rough.heights_m)
    thrice = smooth_terraces(3.0 * stepped, 3.0, most_rounds=3)
    assert thrice.last_move_m == pytest.approx(3.0 * rough.last_move_m)
