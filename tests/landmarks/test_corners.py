"""Corners: independence of contrast, gaps, persistence under moving shadows, and the spread of
candidates.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lcp_catalog.landmarks.corners import (
    GROUP_EXTRA,
    GROUP_GAIN,
    MissingNodes,
    Persistence,
    _percentiles,
    candidates,
    candidates_of_groups,
    fill_missing,
    harris,
    relative_response,
    robust_contrast,
)


def bumps(centres, shape=(96, 96), sigma=3.0, level=1.0):
    row, col = np.mgrid[0 : shape[0], 0 : shape[1]]
    image = np.full(shape, level)
    for r, c in centres:
        image += 0.5 * np.exp(-((row - r) ** 2 + (col - c) ** 2) / (2 * sigma**2))
    return image.astype(np.float32)


def noise(seed, shape=(96, 96)):
    return (1.0 + 0.1 * np.random.default_rng(seed).normal(size=shape)).astype(np.float32)


def naive_harris(image, block, k):
    """Sums of Sobel gradients in plain NumPy with cv2's scale, 1 / (4 block); inner nodes only."""
    z = np.pad(image.astype(float), 1, mode="reflect")
    gx = (z[:-2, 2:] + 2 * z[1:-1, 2:] + z[2:, 2:]) - (z[:-2, :-2] + 2 * z[1:-1, :-2] + z[2:, :-2])
    gy = (z[2:, :-2] + 2 * z[2:, 1:-1] + z[2:, 2:]) - (z[:-2, :-2] + 2 * z[:-2, 1:-1] + z[:-2, 2:])
    window = np.lib.stride_tricks.sliding_window_view
    xx, yy, xy = (window(g, (block, block)).sum(axis=(2, 3)) for g in (gx * gx, gy * gy, gx * gy))
    xx, yy, xy = (m / (4.0 * block) ** 2 for m in (xx, yy, xy))
    return xx * yy - xy**2 - k * (xx + yy) ** 2


def test_the_response_is_that_of_harris_and_stephens():
    image = noise(1, (40, 50))
    low, high = np.percentile(image, [15.865, 84.135])
    expected = naive_harris(image / ((high - low) / 2.0), 7, 0.04)
    found = harris(image)[3:-3, 3:-3]
    inner = np.isfinite(found)
    assert inner.sum() == (40 - 8) * (50 - 8)
    np.testing.assert_allclose(found[inner], expected[inner], rtol=2e-3, atol=1e-4 * expected.max())


@given(st.floats(1e-3, 1e3))
def test_brightness_does_not_matter(factor):
    image = noise(2, (48, 48))
    scaled = (image * factor).astype(np.float32)
    np.testing.assert_allclose(relative_response(scaled), relative_response(image), atol=2e-3)


def test_a_shifted_image_has_shifted_corners():
    image = noise(3)
    whole, part = harris(image), harris(np.ascontiguousarray(image[8:, 5:]))
    ratio = whole[8:, 5:] / part  # the contrast of the part differs a little
    known = np.isfinite(ratio)
    assert np.ptp(ratio[known & (np.abs(part) > 1e-3 * np.nanmax(part))]) < 1e-2


@pytest.mark.parametrize("flip", [np.flipud, np.fliplr, np.transpose])
def test_a_mirrored_image_has_mirrored_corners(flip):
    image = bumps([(30, 40), (60, 25), (50, 70)]) + noise(4) * 0.01
    mirrored = relative_response(np.ascontiguousarray(flip(image)))
    np.testing.assert_allclose(mirrored, flip(relative_response(image)), atol=1e-4)


def test_a_gap_has_no_response_and_makes_no_corner_beside_it():
    image = bumps([(30, 30)])
    image[60:70, 60:70] = np.nan
    response = harris(image)
    assert np.isnan(response[56:74, 56:74]).all()  # a window of 7 and a Sobel of 3 reach 4 nodes
    assert np.isfinite(response[:50, :50][4:, 4:]).all()
    assert np.unravel_index(np.nanargmax(response), response.shape)[0] < 45


def test_an_image_without_light_or_contrast_has_no_corners():
    for image in (np.zeros((30, 30)), np.ones((30, 30)), np.full((30, 30), np.nan)):
        assert (np.nan_to_num(relative_response(image.astype(np.float32))) == 0.0).all()


def test_the_contrast_may_be_given_and_is_nothing_in_the_dark():
    image = noise(3)
    given, own = harris(image, 0.5), harris(image)
    np.testing.assert_allclose(
        given * (0.5 / robust_contrast(image)) ** 4, own, rtol=1e-3, atol=1e-4
    )
    assert robust_contrast(np.zeros((9, 9), np.float32)) == 0.0


def test_a_straight_edge_alone_has_no_relative_response():
    """Its response is below 0 (Harris and Stephens 1988)."""
    image = np.full((64, 64), 0.2, np.float32)
    image[:, 32:] = 0.6
    assert np.nanmin(harris(image, 0.2)) < 0.0
    response = relative_response(image)
    assert (response[np.isfinite(response)] == 0.0).all()


def test_one_known_node_in_the_box_fills_the_others():
    image = np.full((9, 9), np.nan, np.float32)
    image[2, 2], image[8, 8] = 0.75, 0.25
    filled = fill_missing(image, 3)
    np.testing.assert_array_equal(filled[1:4, 1:4], 0.75)
    assert filled[5, 5] == 0.5  # nothing is known around it: the mean of the whole
    image[0, 0], image[0, 1], image[1, 0], image[1, 1] = np.nan, 1.0, 1.0, 4.0
    assert fill_missing(image, 3)[0, 0] == 2.0  # nothing beyond the image's border counts


def test_missing_nodes_are_filled_with_what_is_around_them():
    image = np.ones((20, 20), np.float32)
    image[:, 10:] = 3.0
    image[2, 2] = image[15, 17] = np.nan
    filled = fill_missing(image, 5)
    assert filled[2, 2] == pytest.approx(1.0)
    assert filled[15, 17] == pytest.approx(3.0)
    assert np.isnan(image[2, 2])  # the caller's array is not changed
    far = np.full((20, 20), np.nan, np.float32)
    far[0, 0], far[0, 1] = 1.0, 2.0
    assert fill_missing(far, 3)[19, 19] == pytest.approx(1.5)


@pytest.mark.parametrize("size", [3, 4, 15])
@pytest.mark.parametrize("gaps", [1, 200, 1500])
def test_missing_nodes_have_the_mean_of_their_box(size: int, gaps: int):
    rng = np.random.default_rng(gaps)
    image = rng.random((50, 61)).astype(np.float32)
    image.flat[rng.choice(image.size, gaps, replace=False)] = np.nan
    filled = fill_missing(image, size)
    for r, c in np.argwhere(np.isnan(image))[:: max(1, gaps // 50)]:
        top, left = max(r - size // 2, 0), max(c - size // 2, 0)
        box = image[top : r - size // 2 + size, left : c - size // 2 + size]
        known = box if np.isfinite(box).any() else image
        assert filled[r, c] == pytest.approx(np.nanmean(known, dtype=np.float64), rel=1e-6)
    assert np.array_equal(filled[np.isfinite(image)], image[np.isfinite(image)])
    known = MissingNodes(np.isnan(image), size)
    for factor in (1.0, 0.5):  # other images with the same gaps
        again = image * np.float32(factor)
        known.fill(again)
        assert np.array_equal(again, filled * np.float32(factor))


def moving_shadow(step):
    """Three bumps, and the corner of a shadow that lies elsewhere under every Sun."""
    image = bumps([(30, 30), (70, 34), (40, 74)])
    image[10 + 6 * step : 22 + 6 * step, 52:64] = 0.0
    return image


def test_persistence_keeps_terrain_and_drops_shadow_edges():
    one = relative_response(moving_shadow(4))
    shadow, ground = np.s_[30:50, 47:69], np.s_[24:37, 24:37]
    assert np.nanmax(one[shadow]) > 1.5 * np.nanmax(
        one[ground]
    )  # in a single image the shadow is stronger
    persistence = Persistence((96, 96))
    for step in range(12):
        persistence.add(moving_shadow(step))
    score = persistence.score()
    assert score[ground].max() > 1.25 * score[:, 46:70].max()
    assert persistence.conditions == 12


def test_the_score_is_a_mean_over_all_conditions():
    image, dark = noise(5), np.zeros((96, 96), np.float32)
    once, half = Persistence((96, 96)), Persistence((96, 96))
    assert (once.score() == 0.0).all()
    once.add(image)
    half.add(image)
    half.add(dark)
    np.testing.assert_allclose(half.score(), once.score() / 2.0)
    assert 0.0 <= once.score().min() <= once.score().max() <= 1.0


def test_the_score_of_a_part_is_that_of_the_whole_there():
    whole, part = Persistence((96, 96)), Persistence((96, 96), np.s_[20:60, 30:80])
    for seed in (5, 6):
        one = Persistence((96, 96), part.part)
        one.add(noise(seed))
        part.include(one)
        whole.add(noise(seed))
    outside = np.ones((96, 96), bool)
    outside[20:60, 30:80] = False
    np.testing.assert_array_equal(part.score(), np.where(outside, 0.0, whole.score()))
    assert part.conditions == 2
    assert part.score().max() > 0.1


def test_candidates_are_found_where_they_are():
    score = bumps([(30, 40), (60, 25)], level=0.0)
    rows, cols = candidates(score, spacing_px=32, per_cell=1, border=8)
    assert {(30, 40), (60, 25)} <= set(zip(rows.tolist(), cols.tolist(), strict=True))


@given(st.integers(0, 10_000), st.integers(6, 30), st.integers(1, 4), st.integers(0, 12))
def test_no_cell_has_too_many_and_no_two_are_neighbours(seed, spacing, per_cell, border):
    score = np.abs(noise(seed, (60, 70)))
    rows, cols = candidates(score, spacing, per_cell, border, radius=3)
    assert (rows >= border).all()
    assert (rows < 60 - border).all()
    assert (cols >= border).all()
    assert (cols < 70 - border).all()
    _, counts = np.unique(np.stack([rows // spacing, cols // spacing]), axis=1, return_counts=True)
    assert counts.max(initial=0) <= per_cell
    apart = np.maximum(np.abs(rows[:, None] - rows), np.abs(cols[:, None] - cols))
    assert (apart[~np.eye(len(rows), dtype=bool)] > 3).all()
    for r, c in zip(rows, cols, strict=True):
        block = np.s_[
            max(border, r - 3) : min(60 - border, r + 4),
            max(border, c - 3) : min(70 - border, c + 4),
        ]
        assert score[r, c] == score[block].max()


def test_the_best_of_a_cell_are_kept():
    score = np.zeros((40, 40), np.float32)
    for value, row in ((0.3, 5), (0.9, 15), (0.6, 25)):
        score[row, 20] = value
    rows, _ = candidates(score, spacing_px=40, per_cell=2, border=2, radius=3)
    assert rows.tolist() == [15, 25]


def test_equals_are_decided_by_row_and_column():
    score = np.ones((30, 30), np.float32)
    rows, cols = candidates(score, spacing_px=30, per_cell=1, border=3, radius=4)
    assert (rows.tolist(), cols.tolist()) == ([3], [3])


def test_only_valid_nodes_with_a_positive_score():
    score = bumps([(30, 40)], level=0.0)
    valid = np.ones_like(score, dtype=bool)
    valid[25:36, 35:46] = False
    rows, cols = candidates(score, 96, 9, 8, valid=valid)
    assert valid[rows, cols].all()
    assert candidates(np.zeros((50, 50), np.float32), 10, 3, 2)[0].size == 0
    assert candidates(score, 10, 3, 60)[0].size == 0


def test_cells_are_fixed_on_the_grid_and_not_on_the_array():
    score = np.abs(noise(7, (128, 128)))
    rows, cols = candidates(score, 16, 1, 8, origin=(1000, -500))
    part = np.ascontiguousarray(score[37:, 21:])
    again = candidates(part, 16, 1, 8, origin=(1037, -479))
    inside = (rows >= 37 + 24) & (cols >= 21 + 24)
    whole = set(zip(rows[inside].tolist(), cols[inside].tolist(), strict=True))
    moved = set(zip((again[0] + 37).tolist(), (again[1] + 21).tolist(), strict=True))
    assert whole <= moved
    assert len(whole) > 20


def test_equals_on_both_sides_of_a_cell_edge_are_one_candidate():
    score = np.zeros((40, 40), np.float32)
    score[20, 18] = score[20, 21] = 0.5
    rows, cols = candidates(score, spacing_px=20, per_cell=1, border=2, radius=4)
    assert (rows.tolist(), cols.tolist()) == ([20], [18])


@pytest.mark.parametrize("count", [1, 2, 3, 10, 4001])
def test_percentiles_are_numpys(count):
    values = np.random.default_rng(count).normal(size=count).astype(np.float32)
    percents = (0.0, 15.865, 50.0, 84.135, 99.0, 100.0)
    expected = np.percentile(values.astype(np.float64), percents)
    np.testing.assert_allclose(_percentiles(values, *percents), expected, rtol=1e-12, atol=1e-12)


def test_relative_response_is_the_fourth_root_of_the_share_of_the_99th_percentile():
    image = np.random.default_rng(3).gamma(2.0, size=(60, 70)).astype(np.float32)
    image[10:20] = 0.0  # in shadow
    image[40, 40:50] = np.nan
    response = harris(image)
    lit = np.isfinite(response) & (np.nan_to_num(image) > 0.0)
    high = np.percentile(response[lit & (response > 0.0)], 99.0)
    expected = np.where(lit, np.clip(response / high, 0.0, 1.0) ** 0.25, 0.0)
    expected[np.isnan(response)] = np.nan
    np.testing.assert_allclose(relative_response(image), expected, atol=1e-6)


def test_what_stands_out_in_a_group_is_a_candidate_besides():
    """Two of the mean in the only cell; one of the first group, far better there; none of the second,
    whose best is hardly better than what is there, and none of the third, whose best is taken.
    """
    mean, *groups = np.zeros((4, 60, 60), np.float32)
    mean[20, 20], mean[40, 40], mean[30, 30] = 0.6, 0.5, 0.2
    groups[0][20, 20], groups[0][30, 30] = 0.3, 0.8
    groups[1][40, 40], groups[1][25, 45] = 0.5, 0.5 * GROUP_GAIN - 0.01
    groups[2][30, 30] = 0.4
    found = np.stack(candidates_of_groups(mean, groups, 60, 2, 5), axis=1)
    assert found.tolist() == [[20, 20], [30, 30], [40, 40]]
    alone = np.stack(candidates(mean, 60, 2, 5), axis=1)
    assert alone.tolist() == [[20, 20], [40, 40]]


@pytest.mark.parametrize(
    ("spacing", "radius"), [(7, 1), (8, 1), (15, 1), (16, 2), (71, 8), (72, 9)]
)
def test_maxima_are_an_eighth_of_the_spacing_apart(spacing, radius):
    for apart, count in ((radius, 1), (radius + 1, 2)):
        for row, col in ((0, apart), (0, -apart), (apart, 0), (-apart, 0)):
            score = np.zeros((60, 60), np.float32)
            score[30, 30], score[30 + row, 30 + col] = 0.6, 0.5
            assert len(candidates(score, spacing, 2, 5)[0]) == count


def test_of_equals_within_the_radius_the_first_counts():
    for row, col, count in ((4, 0, 1), (5, 0, 2), (0, 4, 1), (0, 5, 2), (4, -4, 1), (4, -5, 2)):
        score = np.zeros((40, 40), np.float32)
        score[20, 20] = score[20 + row, 20 + col] = 0.5
        rows, cols = candidates(score, 40, 2, 2, radius=4)
        assert (len(rows), rows[0], cols[0]) == (count, 20, 20)
    score[:] = 0.0
    score[20, 4] = score[22, 0] = 0.5
    assert np.stack(candidates(score, 40, 2, 0, radius=4), axis=1).tolist() == [[20, 4]]


def test_the_border_holds_where_all_is_valid():
    score = np.zeros((40, 40), np.float32)
    score[3, 20], score[20, 36] = 0.5, np.nan
    assert candidates(score, 20, 2, 5, valid=np.ones((40, 40), bool))[0].size == 0


def test_a_neighbour_of_a_candidate_is_none_of_a_group():
    """Neighbours: within an eighth of the spacing, 7 nodes, in both axes."""
    mean, group = np.zeros((2, 60, 60), np.float32)
    mean[20, 20] = 0.5
    outside = [(20, 28), (20, 12), (28, 20), (12, 20)]
    for place, taken in [*((p, True) for p in outside), ((27, 13), False), ((13, 27), False)]:
        group[:] = 0.0
        group[place] = 0.9
        found = np.stack(candidates_of_groups(mean, [group], 60, 1, 5), axis=1).tolist()
        assert ([*place] in found) == taken
    group[:] = 0.0
    group[45, 20], group[45, 45] = 0.8, 0.7  # the second best of the group in the cell is left out
    found = np.stack(candidates_of_groups(mean, [group], 60, 1, 5), axis=1)
    assert found.tolist() == [[20, 20], [45, 20]]


def test_a_cell_has_no_more_candidates_than_its_limit():
    """Each group has a place of its own in every cell of 20 nodes; cells are counted from the origin."""
    mean = np.zeros((60, 60), np.float32)
    mean[10::20, 10::20] = 0.1
    groups = []
    for k in range(GROUP_EXTRA + 3):
        group = np.zeros_like(mean)
        group[3 * k + 1 :: 20, 3::20] = 0.5
        groups.append(group)
    rows, cols = candidates_of_groups(mean, groups, 20, 1, 0, origin=(40, -20))
    assert (
        np.histogram2d(rows, cols, bins=3, range=[[0, 60], [0, 60]])[0] == 1 + GROUP_EXTRA
    ).all()
    assert len(set(zip(rows.tolist(), cols.tolist(), strict=True))) == len(rows)
    assert (np.diff(rows * 60 + cols) > 0).all()
    few = candidates_of_groups(mean, groups[:2], 20, 1, 0)
    assert len(few[0]) == 9 * 3


def test_groups_without_places_of_their_own_change_nothing():
    score = np.random.default_rng(3).random((80, 80)).astype(np.float32)
    plain = candidates(score, 16, 2, 4)
    np.testing.assert_array_equal(candidates_of_groups(score, [score, score], 16, 2, 4), plain)


def test_groups_are_of_valid_nodes_and_of_the_cells_of_the_fixed_grid():
    """The same in a cut of the images, where cells are counted from the whole one's origin."""
    dice = np.random.default_rng(4)
    mean, *groups = dice.random((3, 120, 120)).astype(np.float32)
    valid = dice.random((120, 120)) < 0.5
    rows, cols = candidates_of_groups(mean, groups, 16, 1, 8, valid)
    assert valid[rows, cols].all()
    part = np.s_[13:, 21:]
    cut = candidates_of_groups(
        mean[part], [g[part] for g in groups], 16, 1, 8, valid[part], (13, 21)
    )
    inner = (rows >= 48) & (cols >= 48)  # cells that lie in the cut
    own = (cut[0] + 13 >= 48) & (cut[1] + 21 >= 48)
    np.testing.assert_array_equal(cut[0][own] + 13, rows[inner])
    np.testing.assert_array_equal(cut[1][own] + 21, cols[inner])
    plain = candidates(mean, 16, 1, 8, valid)
    assert len(rows) > len(plain[0])
