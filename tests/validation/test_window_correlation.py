"""Window correlations compared with a plain loop, closed forms and known shifts."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lcp_catalog.matching.subpixel import undone
from lcp_catalog.validation.ground_comparison import compare, of_patches


def rough(x, y, seed=0, longest=40.0):
    """A band-limited surface (waves of 6 to 40 cells), defined between its nodes."""
    rng = np.random.default_rng(seed)
    total = np.zeros(np.broadcast(x, y).shape)
    for _ in range(60):
        k = 2.0 * np.pi / rng.uniform(6.0, longest)
        angle, phase = rng.uniform(0.0, 2.0 * np.pi, 2)
        total += np.cos(k * (np.cos(angle) * x + np.sin(angle) * y) + phase) / k
    return total


def grid(rows=96, cols=128):
    return np.meshgrid(np.arange(cols, dtype=float), np.arange(rows, dtype=float))


def loop(image, render, weight, size, step, least):
    """Twin: the definition, window by window, with NumPy's weighted covariance."""
    found = []
    for row in range(0, image.shape[0] - size + 1, step):
        for col in range(0, image.shape[1] - size + 1, step):
            here = np.s_[row : row + size, col : col + size]
            w = np.where(np.isfinite(image[here] + render[here]), weight[here], 0.0).ravel()
            if w.sum() / size**2 < least - 1e-9:
                continue
            there = w > 0
            pair = np.stack([image[here].ravel()[there], render[here].ravel()[there]])
            (aa, ab), (_, bb) = np.cov(pair, aweights=w[there], ddof=0)
            found.append((row, col, ab / np.sqrt(aa * bb), np.sqrt(bb), w.sum() / size**2))
    return np.array(found).reshape(-1, 5)


@settings(deadline=None, max_examples=50)
@given(
    st.integers(0, 10_000), st.integers(3, 9), st.integers(1, 9), st.sampled_from([0.3, 0.7, 1.0])
)
def test_every_window_is_the_definition(seed, size, step, least):
    rng = np.random.default_rng(seed)
    shape = tuple(rng.integers(size, 30, 2))
    image, render = rng.normal(size=shape) + 40.0, 1e-3 * rng.normal(size=shape)
    weight = np.where(rng.random(shape) < 0.2, 0.0, rng.random(shape))
    image[rng.random(shape) < 0.05] = np.nan
    render[rng.random(shape) < 0.05] = np.nan
    if least == 1.0:
        weight[:] = 1.0
    twin = loop(image, render, weight, size, step, least)
    found = compare(image, render, weight, gsd_m=1.0, size=size, step=step, least_valid=least)
    ours = np.stack([found.row, found.col, found.correlation, found.contrast, found.valid], axis=1)
    np.testing.assert_allclose(ours, twin, rtol=1e-9, atol=1e-9)


@settings(deadline=None, max_examples=40)
@given(st.floats(-1e4, 1e4), st.floats(1e-3, 1e3), st.booleans())
def test_gain_and_offset_drop_out(offset, gain, inverted):
    x, y = grid(32, 48)
    image = rough(x, y)
    found = compare((-gain if inverted else gain) * image + offset, image, gsd_m=1.0)
    np.testing.assert_allclose(found.correlation, -1.0 if inverted else 1.0, atol=1e-6)


def test_no_window_is_left_out():
    image = np.random.default_rng(0).normal(size=(67, 90))
    for size, step in ((16, 16), (16, 5), (8, 3), (67, 1)):
        found = compare(image, image, gsd_m=1.0, size=size, step=step)
        assert found.count == ((67 - size) // step + 1) * ((90 - size) // step + 1)


def test_a_flat_window_counts_and_does_not_correlate():
    image, render = np.random.default_rng(0).normal(size=(2, 16, 48))
    render[:, 16:32] = 7.0
    image[:, 32:] = 3.0
    found = compare(image, render, gsd_m=1.0)
    assert found.count == 3
    np.testing.assert_array_equal(found.correlation[1:], 0.0)
    assert found.correlation[0] != 0.0


def test_the_least_share_decides_which_windows_count():
    image, render = np.random.default_rng(0).normal(size=(2, 16, 32))
    weight = np.ones(image.shape)
    weight[:4, :16] = 0.0  # a quarter of the first window is missing
    assert compare(image, render, weight, gsd_m=1.0).count == 1
    found = compare(image, render, weight, gsd_m=1.0, least_valid=0.75)
    assert found.count == 2
    np.testing.assert_allclose(found.valid, [0.75, 1.0])
    inside = np.corrcoef(image[4:, :16].ravel(), render[4:, :16].ravel())[0, 1]
    assert found.correlation[0] == pytest.approx(inside)


# -- figures


def with_correlations(values):
    """A comparison with given correlations: a mixture of two orthogonal patterns."""
    a = np.tile([1.0, -1.0], (16, 8))
    mixed = [c * a + np.sqrt(1.0 - c * c) * a.T for c in values]
    contrast = 1.0 + np.arange(len(values))
    return compare(np.hstack(mixed), np.hstack([k * a for k in contrast]), gsd_m=1.0)


def test_shares_median_and_mode():
    found = with_correlations([0.2, 0.95, 0.9827, 0.9841, 0.9849, 0.99, 0.5, 0.71])
    assert found.share_above(0.9) == 5 / 8
    assert found.share_above(0.7) == 6 / 8
    assert found.median == pytest.approx(0.96635)
    assert found.mode == pytest.approx(0.985)  # the bin 0.98..0.99 holds three


def test_a_share_is_of_what_is_above_and_not_at_the_bound():
    found = with_correlations([1.0, 1.0, 0.0])
    assert found.share_above(found.correlation.max()) == 0.0


def test_of_several_fullest_bins_the_mode_is_the_highest():
    assert with_correlations([0.3012, 0.9012]).mode == pytest.approx(0.905)


def test_the_histogram_counts_every_window():
    counts, edges = with_correlations([-1.0, 1.0, 1.0, 0.004]).histogram(0.01)
    assert (counts.sum(), counts[0], counts[-1]) == (4, 1, 2)
    assert len(edges) == 201


def test_the_textured_half_has_the_contrast_of_the_render():
    found = with_correlations([0.1, 0.2, 0.8, 0.9])
    np.testing.assert_allclose(found.textured.correlation, [0.8, 0.9])
    assert found.count == 4


def test_no_window_gives_no_figure():
    image = np.full((16, 16), np.nan)
    found = compare(image, image, gsd_m=1.0)
    assert found.count == 0
    assert np.isnan([found.median, found.mode, found.share_above(0.9)]).all()
    assert found.textured.count == 0


def test_the_map_shows_where_windows_lie():
    image, render = np.random.default_rng(0).normal(size=(2, 32, 48))
    weight = np.ones(image.shape)
    weight[16:, 16:32] = 0.0
    found = compare(image, render, weight, gsd_m=1.0)
    drawn = found.map(image.shape)
    assert np.isnan(drawn[16:, 16:32]).all()
    assert drawn[20, 40] == found.correlation[(found.row == 16) & (found.col == 32)]


# -- shifts


@pytest.mark.parametrize(("col", "row"), [(0.0, 0.0), (0.6, -0.3), (-1.45, 2.2), (2.75, 0.4)])
def test_a_common_shift_is_found_and_undone(col, row):
    x, y = grid()
    render, image = rough(x, y), 3.0 * rough(x - col, y - row) + 1.0
    kept = compare(image, render, gsd_m=1.0)
    assert (kept.offset, kept.shift_px) == ("kept", (0.0, 0.0))
    removed = compare(image, render, gsd_m=1.0, offset="removed")
    assert removed.offset == "removed"
    np.testing.assert_allclose(removed.shift_px, (col, row), atol=0.05)
    assert removed.median > 0.999
    if col or row:
        assert removed.median > kept.median


def test_undoing_a_shift_spoils_what_takes_part_in_a_gap():
    x, y = grid(40, 40)
    truth, image = (np.sin(u / 3.0) + np.cos(y / 4.0) for u in (x, x - 0.5))
    weight = np.ones(x.shape)
    weight[20, 20], image[20, 20] = 0.0, 1e6
    back, left = undone(image, weight, (0.5, 0.0))
    sure = left > 0.0
    assert not sure[20, 19:21].any()
    assert sure[20, 25]
    assert sure[5, 5]
    sure[:, :3] = sure[:, -3:] = False
    assert np.abs(back - truth)[sure].max() < 0.01


def test_what_comes_from_beyond_the_border_weighs_nothing():
    image = np.random.default_rng(0).normal(size=(12, 15))
    back, left = undone(image, np.ones(image.shape), (2.0, -3.0))
    assert (left[:3] == 0.0).all()
    assert (left[:, -2:] == 0.0).all()
    assert (left[4:, :12] == 1.0).all()
    np.testing.assert_allclose(back[3:, :13], image[:9, 2:])


def test_each_window_has_its_own_best_place():
    x, y = grid(32, 96)
    render = rough(x, y, longest=12.0)
    west, east = rough(x - 1.3, y + 0.6, longest=12.0), rough(x + 0.8, y, longest=12.0)
    image = np.where(x < 48, west, east)
    found = compare(image, render, gsd_m=1.0, search_px=3)
    west, east = found.col < 32, found.col >= 48
    for side, wanted in ((west, (1.3, -0.6)), (east, (-0.8, 0.0))):
        off = np.abs(found.offset_px[side] - wanted).max(axis=1)
        assert np.median(off) < 0.1
        assert off.max() < 0.5  # a window moved by a cell shows other ground at its border
    assert (found.peak >= found.correlation - 1e-12).all()


def test_looking_for_offsets_changes_no_correlation():
    image, render = np.random.default_rng(0).normal(size=(2, 48, 48))
    plain, looked = (compare(image, render, gsd_m=1.0, search_px=s) for s in (0, 3))
    np.testing.assert_array_equal(plain.correlation, looked.correlation)
    assert plain.offset_px is None


def test_a_best_place_at_the_edge_of_the_search_is_none():
    x, y = grid(48, 48)
    found = compare(rough(x - 5.0, y), rough(x, y), gsd_m=1.0, search_px=1)
    assert np.isnan(found.offset_px).any()


# -- patches


def test_patches_are_compared_each_for_itself():
    rng = np.random.default_rng(0)
    images, renders = rng.normal(size=(2, 5, 33, 33))
    weights = np.ones(images.shape)
    weights[3] = 0.0
    found = of_patches(images, renders, weights, gsd_m=118.0)
    assert found.count == 4 * 4
    np.testing.assert_array_equal(np.unique(found.patch), [0, 1, 2, 4])
    for number in (0, 4):
        alone = compare(images[number], renders[number], gsd_m=118.0)
        mine = found.where(found.patch == number)
        np.testing.assert_array_equal(mine.correlation, alone.correlation)
        np.testing.assert_array_equal(mine.row, alone.row)


def test_a_patch_smaller_than_a_window_is_one():
    images = np.random.default_rng(0).normal(size=(3, 11, 13))
    found = of_patches(images, images, gsd_m=118.0)
    assert (found.count, found.size) == (3, 11)


@pytest.mark.parametrize(
    "call",
    [
        lambda a: compare(a, a[:, 1:], gsd_m=1.0),
        lambda a: compare(a, a, a[1:], gsd_m=1.0),
        lambda a: compare(a[:8], a[:8], gsd_m=1.0),
        lambda a: compare(a, a, gsd_m=1.0, size=1),
        lambda a: compare(a, a, gsd_m=1.0, step=0),
        lambda a: compare(a, a, gsd_m=1.0, offset="away"),
        lambda a: of_patches(a, a, gsd_m=1.0),
        lambda a: of_patches(a[None][:0], a[None][:0], gsd_m=1.0),
    ],
)
def test_what_does_not_fit_is_refused(call):
    with pytest.raises(ValueError, match=r"shape|window|offset|patch"):
        call(np.random.default_rng(0).normal(size=(32, 32)))
