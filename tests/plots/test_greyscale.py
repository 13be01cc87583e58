"""Greyscale images: area means, stretch by percentiles, gaps."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lcp_catalog.plots.pictures import DARK, LIGHT, PIXELS_MAX, SIDE_MAX, grey, shrunk


def by_area(values: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Twin of `shrunk`: every new pixel sums the covered parts of the old pixels, one by one."""
    out = np.full(shape, np.nan)
    (rows, cols), (high, wide) = (
        values.shape,
        (values.shape[0] / shape[0], values.shape[1] / shape[1]),
    )
    for i in range(shape[0]):
        for j in range(shape[1]):
            light = area = 0.0
            for r in range(rows):
                down = min(r + 1, (i + 1) * high) - max(r, i * high)
                for c in range(cols):
                    right = min(c + 1, (j + 1) * wide) - max(c, j * wide)
                    if down > 0 and right > 0 and np.isfinite(values[r, c]):
                        light += down * right * values[r, c]
                        area += down * right
            if area >= 0.5 * high * wide * (1 - 1e-9):
                out[i, j] = light / area
    return out


@given(
    st.integers(1, 13),
    st.integers(1, 13),
    st.integers(1, 120),
    st.floats(0.0, 0.6),
    st.integers(0, 99),
)
def test_shrunk_is_the_mean_by_area(
    rows: int, cols: int, most: int, holes: float, seed: int
) -> None:
    dice = np.random.default_rng(seed)
    values = dice.normal(size=(rows, cols))
    values[dice.random((rows, cols)) < holes] = np.nan
    found = shrunk(values, most)
    assert found.size <= max(most, rows, cols)
    if rows * cols <= most:
        np.testing.assert_array_equal(found, values)
    else:
        wanted = by_area(values, found.shape)
        np.testing.assert_allclose(found, wanted, atol=1e-9)


def test_shrunk_is_opencvs_area_interpolation() -> None:
    values = np.random.default_rng(3).normal(size=(700, 1300)).astype(np.float32)
    found = shrunk(values, 250_000)
    wanted = cv2.resize(values, found.shape[::-1], interpolation=cv2.INTER_AREA)
    assert found.shape == (366, 681)
    np.testing.assert_allclose(found, wanted, atol=2e-6)


def test_a_long_strip_keeps_its_form() -> None:
    found = shrunk(np.zeros((8000, 400), dtype=np.float32))
    assert found.shape == (SIDE_MAX, 150)
    assert shrunk(np.zeros((1600, 1600))).size <= PIXELS_MAX


def test_grey_runs_from_dark_to_light() -> None:
    values = np.linspace(-3.0, 5.0, 1001).reshape(1, -1)
    found = grey(values)
    assert found.shape == (1, 1001, 2)
    assert (found[..., 1] == 255).all()
    assert found[0, 10, 0] == DARK
    assert found[0, 990, 0] == pytest.approx(LIGHT, abs=1)
    assert (np.diff(found[0, :, 0].astype(int)) >= 0).all()
    assert found[0, 500, 0] == pytest.approx((DARK + LIGHT) / 2, abs=1)


@given(st.floats(0.01, 100.0), st.floats(-100.0, 100.0))
def test_gain_and_offset_make_no_difference(gain: float, offset: float) -> None:
    """Two images of the same terrain look the same, even if one has a bright edge."""
    dice = np.random.default_rng(5)
    image = dice.normal(size=(40, 40))
    other = gain * image + offset
    image[:, :20] = np.nan
    other[:, :20] = offset + 1e3 * gain
    a, b = grey(image, other), grey(other, image)
    assert np.abs(a[:, 20:, 0].astype(int) - b[:, 20:, 0]).max() <= 1
    assert (a[:, :20] == 0).all()
    assert (b[:, :20] == 255).all()


def test_pictures_of_nothing_and_of_one_value() -> None:
    assert (grey(np.full((3, 4), np.nan)) == 0).all()
    assert (grey(np.full((3, 4), 7.0))[..., 0] == DARK).all()
    apart = np.array([[1.0, np.nan], [2.0, np.nan]])
    assert grey(apart, apart[:, ::-1])[1, 0, 0] > grey(apart, apart[:, ::-1])[0, 0, 0]
