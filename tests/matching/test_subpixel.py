"""Shifts of grids: places of peaks by closed forms, and windows' best places by a loop over every
shift.
"""

from __future__ import annotations

import numpy as np
import pytest

from lcp_catalog.matching.subpixel import moved, peaks, undone
from lcp_catalog.validation.ground_comparison import common_shift, compare


def bowl(reach, summit, bend=(-1.0, -0.5, 0.3)):
    """Scores (m, m, 1) of a quadratic with its maximum at ``summit`` (column, row) and curvatures
    xx, yy and xy.
    """
    away = np.arange(-reach, reach + 1.0)
    x, y = np.meshgrid(away - summit[0], away - summit[1])
    return (5.0 + bend[0] * x**2 + bend[1] * y**2 + bend[2] * x * y)[:, :, None]


@pytest.mark.parametrize("summit", [(0.0, 0.0), (0.3, -0.4), (-1.2, 1.45), (2.0, -2.0)])
def test_the_summit_of_a_quadratic_is_exact(summit):
    column, row, height = peaks(bowl(4, summit))
    assert (column[0], row[0]) == pytest.approx(summit, abs=1e-9)
    assert height[0] == bowl(4, summit).max() <= 5.0


@pytest.mark.parametrize("summit", [(-1.2, 0.9), (1.1, -1.3), (0.8, 1.2)])
def test_a_summit_beside_the_tables_edge_is_exact_however_flat(summit):
    """The highest value is the last but one of the table; scores are correlations, whose curvature is slight."""
    column, row, height = peaks(0.1 * bowl(2, summit))
    assert (column[0], row[0]) == pytest.approx(summit, abs=1e-9)
    assert height[0] == 0.1 * bowl(2, summit).max()


@pytest.mark.parametrize("turned", [False, True])
def test_a_summit_more_than_a_step_from_the_highest_of_a_slanted_ridge_is_none(turned):
    scores = bowl(2, (0.4, 1.1), (-1.0, -0.2, 0.723))
    column, row, _ = peaks(scores.swapaxes(0, 1) if turned else scores)
    assert (column[0], row[0]) == (0.0, 0.0)


@pytest.mark.parametrize("edge", [(-3.0, 0.0), (3.0, 0.0), (0.0, -3.0), (0.0, 3.0), (3.0, 3.0), (-4.0, 1.0)])  # fmt: skip
def test_a_peak_at_the_tables_edge_is_no_place(edge):
    column, row, height = peaks(bowl(3, edge))
    assert np.isnan(column[0])
    assert np.isnan(row[0])
    assert np.isfinite(height[0])
    inner = peaks(bowl(3, np.clip(edge, -2.0, 2.0)))
    assert np.isfinite(inner[0][0])


def test_a_summit_more_than_a_step_away_is_left_where_the_highest_is():
    """A saddle, a ridge without an end, and a curvature so slight that the quadratic's maximum lies
    five steps off.
    """
    saddle = bowl(2, (0.0, 0.0), (-1.0, -1.0, 0.0))
    saddle[1, 1] = saddle[3, 3] = 4.99
    ridge = bowl(2, (0.0, 0.0), (-1.0, 0.0, 0.0))
    ridge[2, 2] += 1e-9
    slight = np.zeros((5, 5, 1))
    slight[2, 1:4, 0], slight[1:4, 2, 0] = (0.0, 1.0, 1.0 - 1e-3), (0.9, 1.0, 0.9)
    slight[1, 3, 0], slight[3, 1, 0] = 0.99, 0.99
    for scores in (saddle, ridge, slight):
        column, row, _ = peaks(scores)
        assert max(abs(column[0]), abs(row[0])) <= 1.0
    column, row, _ = peaks(slight)
    assert (column[0], row[0]) == (0.0, 0.0)


@pytest.mark.parametrize("shift", [(0, 0), (2, 0), (-1, 3), (-4, -2)])
def test_cells_are_brought_over_the_renders(shift):
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(2, 9, 11))
    w = np.where(rng.random(a.shape) < 0.3, 0.0, rng.random(a.shape))
    image, render, weight = moved(a, b, w, shift)
    np.testing.assert_array_equal(render, b)
    for row, col in np.ndindex(a.shape):
        r, c = row + shift[1], col + shift[0]
        there = 0 <= r < 9 and 0 <= c < 11
        assert image[row, col] == (a[r, c] if there else 0.0)
        # what lacks at the render's place or at the image's counts nothing
        assert weight[row, col] == (w[r, c] if there and w[row, col] > 0.0 else 0.0)


def test_a_whole_shift_takes_cells_as_they_are():
    """Only the missing cell itself becomes invalid."""
    rng = np.random.default_rng(1)
    image, weight = rng.normal(size=(12, 14)), rng.uniform(0.2, 1.0, (12, 14))
    weight[5, 6] = 0.0
    back, left = undone(image, weight, (-2.0, 1.0))
    np.testing.assert_array_equal(np.argwhere(left[:11, 2:] == 0.0), [[4, 6]])
    sure = left > 0.0
    wanted = np.roll(image, (-1, 2), (0, 1))
    np.testing.assert_allclose(back[sure], wanted[sure], atol=1e-12)
    np.testing.assert_allclose(left[sure], np.roll(weight, (-1, 2), (0, 1))[sure], atol=1e-12)


def keys(away):
    """The kernel of cubic convolution by the distance of a value (Keys 1981, eq. 15, a = -1/2)."""
    s = abs(away)
    if s <= 1.0:
        return 1.5 * s**3 - 2.5 * s**2 + 1.0
    return -0.5 * s**3 + 2.5 * s**2 - 4.0 * s + 2.0 if s < 2.0 else 0.0


@pytest.mark.parametrize("shift", [(0.3, -1.6), (-2.25, 0.75), (0.5, -0.5), (-0.9, -0.1)])
def test_a_shift_by_parts_of_cells_is_undone_by_cubic_convolution(shift):
    """Against the sum over all values by their distances, the image extended by its border values. Weights are linear between
    cells; a missing cell, of the weight 0, spoils all that it has a part in. What lies more than half a cell outside weighs
    nothing.
    """
    rng = np.random.default_rng(6)
    image, weight = rng.normal(size=(13, 15)), rng.uniform(0.2, 1.0, (13, 15))
    image[6, 7], weight[6, 7] = 1e6, 0.0
    back, left = undone(image, weight, shift)
    wide, heavy = np.pad(image, 3, "edge"), np.pad(weight, 3, "edge")
    for place in np.ndindex(image.shape):
        at = np.array(place) + shift[::-1]
        if (at < -0.5).any() or (at > np.array(image.shape) - 0.5).any():
            assert left[place] == 0.0
            continue
        away = [at[axis] - np.arange(-3, n + 3) for axis, n in enumerate(image.shape)]
        rows, columns = (np.array([keys(one) for one in some]) for some in away)
        if rows[9] and columns[10]:
            assert left[place] == 0.0
            continue
        assert back[place] == pytest.approx(rows @ wide @ columns, abs=1e-8)
        rows, columns = (np.maximum(0.0, 1.0 - np.abs(some)) for some in away)
        assert left[place] == pytest.approx(rows @ heavy @ columns, abs=1e-12)
    assert (left > 0.0).sum() > 100


# -- windows


def weighted(a, b, w):
    a, b = (x - np.average(x, weights=w) for x in (a, b))
    return (w * a * b).sum() / np.sqrt((w * a * a).sum() * (w * b * b).sum())


def best_of(image, render, weight, row, col, size, reach):
    """The highest correlation of one window over whole shifts at which half of its weight is valid,
    and its shift.
    """
    found = {}
    for down in range(-reach, reach + 1):
        for right in range(-reach, reach + 1):
            rows = [r for r in range(row, row + size) if 0 <= r + down < image.shape[0]]
            cols = [c for c in range(col, col + size) if 0 <= c + right < image.shape[1]]
            here = np.ix_(rows, cols)
            there = np.ix_([r + down for r in rows], [c + right for c in cols])
            w = np.where(weight[here] > 0.0, weight[there], 0.0)
            if w.sum() >= 0.5 * size**2:
                found[(right, down)] = weighted(image[there], render[here], w)
    return max(found.items(), key=lambda pair: pair[1])


@pytest.mark.parametrize("seed", range(4))
def test_each_windows_best_place_is_the_best_of_every_shift(seed):
    """Overlapping windows and gaps of half a window: a correlation of too few cells does not count."""
    rng = np.random.default_rng(seed)
    image, render = rng.normal(size=(2, 26, 31)).cumsum(axis=2)
    weight = rng.uniform(0.8, 1.0, image.shape)
    weight[:, 9:13], weight[12:15] = 0.0, 0.0
    found = compare(image, render, weight, gsd_m=1.0, size=8, step=5, least_valid=0.1, search_px=2)
    assert found.count > 10
    edges = 0
    for k in range(found.count):
        shifts = best_of(image, render, weight, found.row[k], found.col[k], 8, 2) if found.valid[k] > 0.5 else None  # fmt: skip
        if shifts is None:
            continue
        (right, down), highest = shifts
        assert found.peak[k] == pytest.approx(highest, abs=1e-9)
        if max(abs(right), abs(down)) == 2:
            edges += 1
            assert np.isnan(found.offset_px[k]).all()
        else:
            assert np.abs(found.offset_px[k] - (right, down)).max() <= 1.0
    assert edges > 0


def test_a_common_shift_is_found_though_cells_are_missing_everywhere():
    rng = np.random.default_rng(2)
    wave = np.hypot(*np.meshgrid(np.fft.fftfreq(80), np.fft.fftfreq(80)))
    spectrum = np.fft.fft2(rng.normal(size=(80, 80))) * np.exp(-((14.0 * wave) ** 2))
    smooth = np.fft.ifft2(spectrum).real
    image, render = smooth[8:72, 8:72], smooth[8 - 1 : 72 - 1, 8 + 2 : 72 + 2]
    weight = (rng.random(image.shape) > 0.2).astype(float)
    assert common_shift(image, render, weight) == pytest.approx((2.0, -1.0), abs=0.05)
    assert common_shift(image, render, 0.4 * np.ones(image.shape)) == (0.0, 0.0)


def test_how_large_weights_are_does_not_matter():
    """Correlations and contrasts depend on relative weights only."""
    rng = np.random.default_rng(3)
    image, render = rng.normal(size=(2, 32, 32))
    weight = rng.random(image.shape)
    plain, light = (
        compare(image, render, w, gsd_m=1.0, least_valid=0.0) for w in (weight, 1e-4 * weight)
    )
    np.testing.assert_allclose(light.correlation, plain.correlation, rtol=1e-9)
    np.testing.assert_allclose(light.contrast, plain.contrast, rtol=1e-9)


def test_the_textured_half_is_a_half_however_contrasts_are_spread():
    rng = np.random.default_rng(4)
    image, render = rng.normal(size=(2, 16, 96))
    render *= np.repeat([1.0, 2.0, 3.0, 4.0, 5.0, 900.0], 16)
    found = compare(image, render, gsd_m=1.0)
    np.testing.assert_array_equal(found.textured.col, [48, 64, 80])
