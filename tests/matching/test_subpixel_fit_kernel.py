"""Sub-pixel fit, its covariance, and the backward search: compared with the formulas, and cases in
which they must fail.
"""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from helpers.twins_match import newey_west, way_back

from lcp_catalog.kernels.matching import point_spread, subpixel_fit
from lcp_catalog.kernels.matching.backward_search import find_backwards

SUB, SIGMA, LEAST = 4, 0.5, 0.95


def drawing(seed: int, rows: int = 22, cols: int = 26, smooth: float = 1.3) -> np.ndarray:
    """A drawing with texture and a missing corner."""
    rng = np.random.default_rng(seed)
    fine = cv2.GaussianBlur(rng.standard_normal((rows * SUB, cols * SUB)), (0, 0), smooth * SUB)
    fine = 2.0 + 0.2 * fine / fine.std()
    fine[: 6 * SUB, : 8 * SUB] = np.nan
    return fine.astype(np.float32)


def seen(fine: np.ndarray, right: float, down: float) -> np.ndarray:
    """Value, slopes right and down, and cover (4, rows, cols) of a shifted drawing."""
    margin = point_spread.margin_for(SUB, SIGMA, max(abs(right), abs(down)))
    light, known = point_spread.unpack_drawing(fine, SUB, margin)
    out = np.empty((4, fine.shape[0] // SUB, fine.shape[1] // SUB), np.float32)
    point_spread.blurred(light, known, margin, SUB, SIGMA, right, down, out)
    return out


def refined(fine, image, weight, place=(0, 0), start=(0.0, 0.0)) -> np.ndarray:
    out = np.full((1, subpixel_fit.NUMBERS), np.nan)
    subpixel_fit.refine(
        fine[None], SUB, SIGMA, LEAST, image.astype(np.float32), weight.astype(np.float32),
        np.array([place], np.int64), np.array([start]), True, out,
    )  # fmt: skip
    return out[0]


def wrong(kind: str, shape: tuple[int, int], seed: int) -> np.ndarray:
    """Disturbance of an image: white, smooth, smooth in one direction, or with neighbours that
    differ in sign: in both directions, from row to row or column to column only, and alike in one
    direction and different in the other.
    """
    noise = np.random.default_rng(seed).standard_normal(shape)
    if kind == "smooth":
        noise = cv2.GaussianBlur(noise, (0, 0), 1.5)
    elif kind == "oblique":
        noise = sum(np.roll(noise, (k, k), (0, 1)) for k in range(4))
    elif kind == "alternating":
        noise = noise - 0.9 * np.roll(noise, 1, 0) - 0.5 * np.roll(noise, 1, 1)
    elif kind in ("rows", "columns"):
        noise = noise - 0.9 * np.roll(noise, 1, 0 if kind == "rows" else 1)
    elif kind in ("woven down", "woven across"):
        axis = 0 if kind == "woven down" else 1
        noise = noise + 0.9 * np.roll(noise, 1, axis)
        noise = noise - 0.25 * np.roll(noise, 1, 1 - axis)
    return 0.04 * noise / noise.std()


def edge_weight(cover: np.ndarray) -> np.ndarray:
    """Weight of pixels with a cover: 0 at 2 LEAST - 1, 1 at 1, linear between."""
    return np.interp(cover, [2.0 * LEAST - 1.0, 1.0], [0.0, 1.0])


@pytest.mark.parametrize(
    "kind",
    ["white", "smooth", "oblique", "alternating", "rows", "columns", "woven down", "woven across"],
)
def test_the_covariance_is_the_formulas(kind: str) -> None:
    """At the solution, where the step is zero: by loops over pairs of pixels, with gaps and half
    weights.
    """
    for seed in range(5):
        fine = drawing(seed)
        image = seen(fine, 0.3, -0.2)[0]
        image = 5.0 + 0.7 * (image + wrong(kind, image.shape, seed))
        weight = np.ones(image.shape)
        weight[10:13, 12:18], weight[16] = 0.0, 0.5
        first = refined(fine, image, weight)
        found = refined(fine, image, weight, start=first[:2])
        assert found[:2] == pytest.approx(first[:2], abs=2e-3)
        drawn = seen(fine, *first[:2])
        counts = weight * edge_weight(drawn[3])
        wanted = newey_west(drawn[:3], image, counts)
        np.testing.assert_allclose(found[3:6], wanted.covariance, rtol=2e-3, atol=2e-3 * wanted.covariance[0])  # fmt: skip
        assert found[2] == pytest.approx(wanted.correlation, abs=1e-4)
        assert found[6] == pytest.approx(wanted.gain, rel=1e-3)
        assert found[7] == pytest.approx(wanted.noise, rel=1e-3)
        assert found[8] == (counts > 0.0).sum()
        assert found[9] == pytest.approx(wanted.likeness, abs=2e-3)
        if kind in ("alternating", "rows", "columns"):
            assert wanted.likeness < -0.1


def turned_square(seed: int, side: int = 26) -> np.ndarray:
    """A drawing with texture whose four edges cross the pixels at an angle."""
    fine = drawing(seed, side + 10, side + 10)
    fine[: 6 * SUB, : 8 * SUB] = 2.0
    place = (np.arange((side + 10) * SUB) + 0.5) / SUB - side / 2.0 - 5.0
    turn = np.random.default_rng(seed).uniform(0.1, 0.7)
    along = np.cos(turn) * place + np.sin(turn) * place[:, None]
    across = np.cos(turn) * place[:, None] - np.sin(turn) * place
    fine[np.maximum(np.abs(along), np.abs(across)) > side / 2.0] = np.nan
    return fine


def squared_difference(
    fine: np.ndarray, image: np.ndarray, weight: np.ndarray, shift: np.ndarray
) -> float:
    """Weighted sum of squares left by the best gain and offset for a shift."""
    basis = np.stack([seen(fine, *shift)[0].ravel(), np.ones(image.size)], axis=-1)
    root = np.sqrt(weight.ravel())
    left = np.linalg.lstsq(basis * root[:, None], image.ravel() * root, rcond=None)[1]
    return float(left[0])


@pytest.mark.slow
def test_the_fit_ends_at_the_least_squared_difference() -> None:
    """In smooth noise of 1.5 times the contrast of the texture, with edges that cross the pixels at
    an angle. Whole Gauss-Newton steps alternate between two places for ever in some of these images,
    and steps that stay short once they were halved end up to 0.03 px off. Reference: the lowest sum
    of squares, with the result's weights, on a grid of shifts around the result, 0.004 px apart in
    the end.
    """
    away = []
    for seed in range(24):
        fine = turned_square(seed)
        rng = np.random.default_rng(seed)
        noise = cv2.GaussianBlur(rng.standard_normal(fine[::SUB, ::SUB].shape), (0, 0), 4.0)
        there = seen(fine, *rng.uniform(-0.4, 0.4, 2))
        image = np.where(there[3] > 0.3, there[0], 2.0)
        image += 1.5 * image[there[3] > 0.9].std() * noise / noise.std()
        found = refined(fine, image, np.ones(image.shape))
        assert np.isfinite(found).all()
        best, weight = found[:2], edge_weight(seen(fine, *found[:2])[3])
        for step in (0.1, 0.02, 0.004):
            grid = [best + step * (np.array(k) - 3.0) for k in np.ndindex(7, 7)]
            best = min(grid, key=lambda shift: squared_difference(fine, image, weight, shift))
        away.append(np.hypot(*(best - found[:2])))
    assert np.max(away) < 0.01


def test_slopes_are_what_a_small_shift_does_at_the_edge_of_what_is_drawn_too() -> None:
    """Central differences over 0.04 pixels, at all pixels with a cover of at least a third."""
    fine, step = drawing(8), 0.02
    here = seen(fine, 0.2, -0.1)
    for k, (right, down) in enumerate(((step, 0.0), (0.0, step)), start=1):
        ahead, behind = (seen(fine, 0.2 + s * right, -0.1 + s * down)[0] for s in (1.0, -1.0))
        counts = here[3] > 0.33
        assert (counts & (here[3] < 0.9)).sum() > 20
        slope = (ahead - behind) / (2.0 * step)
        np.testing.assert_allclose(here[k][counts], slope[counts], atol=1.5e-3)


def test_it_comes_from_a_pixel_off_and_from_no_farther_than_it_says() -> None:
    """The search before it is right to a pixel; a drawing that moves farther has found another
    place.
    """
    fine = drawing(5, smooth=2.0)
    image, weight = seen(fine, 0.0, 0.0)[0], np.ones((40, 40))
    whole = np.full((40, 40), 2.0)
    whole[8:30, 7:33] = image
    for right, down in ((1, 0), (0, -1), (1, -1), (0, 0)):
        found = refined(fine, whole, weight, (7 + right, 8 + down))
        assert found[:2] == pytest.approx((-right, -down), abs=0.01)
    for right, down in ((2, 0), (0, 2), (-2, 1)):
        assert np.isnan(refined(fine, whole, weight, (7 + right, 8 + down))).all()


def test_what_tells_nothing_is_not_placed() -> None:
    """A negative; no contrast; fewer than twelve pixels."""
    fine = drawing(6)
    image, weight = seen(fine, 0.1, 0.1)[0], np.ones((22, 26))
    assert np.isfinite(refined(fine, image, weight)).all()
    assert np.isnan(refined(fine, 4.0 - image, weight)).all()
    assert np.isnan(refined(fine, np.ones_like(image), weight)).all()
    few = np.zeros_like(weight)
    few[12, 10:21] = 1.0
    assert np.isnan(refined(fine, image, few)).all()


def test_stripes_are_placed_across_and_not_along() -> None:
    """A wave in one direction: the shift along it is undetermined, and no covariance is given for
    it.
    """
    place = (np.arange(24 * SUB) + 0.5) / SUB
    across = np.broadcast_to(2.0 + 0.3 * np.sin(place / 1.5), (20 * SUB, 24 * SUB))
    fine = np.ascontiguousarray(across, dtype=np.float32)
    image = seen(fine, 0.2, 0.0)[0]
    found = refined(fine, image, np.ones(image.shape))
    assert np.isnan(found[3:6]).all() or np.isnan(found).all()


# -- the way back


@pytest.mark.parametrize("seed", range(10))
def test_the_way_back_is_a_loop_over_every_place(seed: int) -> None:
    """Ragged masks, missing pixels, places at which the inner part lies at the search's edge."""
    rng = np.random.default_rng(seed)
    high, wide = int(rng.integers(12, 20)), int(rng.integers(12, 20))
    image = cv2.GaussianBlur(rng.standard_normal((40, 44)), (0, 0), 1.5).astype(np.float32)
    weight = (rng.random(image.shape) < 0.95).astype(np.float32)
    row, col = (
        int(rng.integers(3, n - m - 3)) for n, m in zip(image.shape, (high, wide), strict=True)
    )
    values = 0.5 + 3.0 * image[row : row + high, col : col + wide]
    values += (0.5 * image.std() * rng.standard_normal(values.shape)).astype(np.float32)
    mask = rng.random(values.shape) < 0.93
    mask[:2], mask[:, -1] = False, False
    mask[5, : wide // 2], least = False, 0.7 if seed % 2 else 0.9
    for right, down in ((0, 0), (1, -1), (-2, 2), (3, 0), (0, -3), (-3, 0), (2, 3)):
        place, out = (col + right, row + down), np.full((1, 3), np.nan)
        find_backwards(
            values[None], mask[None], image, weight, np.array([place]), 0.6, 3, least, out
        )  # fmt: skip
        wanted = way_back(values, mask, image, weight, place, 0.6, 3, least)
        np.testing.assert_allclose(out[0], wanted, atol=2e-3)


def test_beyond_the_image_there_is_no_way_back() -> None:
    values, mask = np.random.default_rng(0).standard_normal((1, 10, 10)).astype(np.float32), np.ones((1, 10, 10), bool)  # fmt: skip
    image = np.random.default_rng(1).standard_normal((30, 30)).astype(np.float32)
    ones = np.ones(image.shape, np.float32)
    for place, inside in (
        ((-2, 5), True), ((-3, 5), False), ((5, -3), False), ((22, 5), True), ((23, 5), False), ((5, 23), False),
    ):  # fmt: skip
        out = np.full((1, 3), np.nan)
        find_backwards(values, mask, image, ones, np.array([place]), 0.6, 2, 0.8, out)
        assert np.isfinite(out[0, 2]) == inside  # of ten pixels the inner six, two from either side
