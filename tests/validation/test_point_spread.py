"""Point spreads compared with closed forms: waves through a Gaussian, gradients between nodes,
gaps, and equal sharpness.
"""

from __future__ import annotations

import numpy as np
import pytest
from affine import Affine
from hypothesis import given, settings
from hypothesis import strategies as st
from rasterio.warp import Resampling, reproject

from lcp_catalog.constants import SIGMA_PER_FWHM
from lcp_catalog.validation.orthoimage import CoarseGrid, area_paired, paired, spread


def grid(rows: int = 80, cols: int = 100) -> tuple[np.ndarray, np.ndarray]:
    y, x = np.mgrid[:rows, :cols].astype(float)
    return x, y


def middles(of: CoarseGrid) -> tuple[np.ndarray, np.ndarray]:
    """Columns and rows of a grid's nodes in coordinates of the finer grid."""
    i, j = np.mgrid[: of.shape[0], : of.shape[1]].astype(float)
    return of.start_px + of.ratio * j, of.start_px + of.ratio * i


def test_the_width_of_a_gaussian_is_where_it_has_half_its_height():
    assert np.exp(-0.5 * (0.5 / SIGMA_PER_FWHM) ** 2) == pytest.approx(0.5)


@settings(deadline=None, max_examples=40)
@given(st.floats(1.6, 9.0), st.floats(8.0, 40.0), st.floats(0.0, 6.28), st.floats(1.0, 4.7))
def test_a_wave_keeps_what_a_gaussian_lets_through(fwhm, wave, phase, ratio):
    """The amplitude is exp(-2 (pi sigma / wave)^2), without a shift, for any ratio of the grids."""
    x, y = grid()
    k = 2.0 * np.pi / wave
    values = np.cos(k * (0.8 * x + 0.6 * y) + phase)
    coarse = CoarseGrid.over(values.shape, ratio)
    found, mass = spread(values, np.ones(values.shape), fwhm, coarse)
    column, row = middles(coarse)
    left = np.exp(-2.0 * (np.pi * fwhm * SIGMA_PER_FWHM / wave) ** 2)
    wanted = left * np.cos(k * (0.8 * column + 0.6 * row) + phase)
    inner = mass > 1.0 - 1e-9
    assert inner.any()
    np.testing.assert_allclose(found[inner], wanted[inner], atol=1e-3)


@settings(deadline=None, max_examples=40)
@given(st.floats(2.0, 8.0), st.floats(1.0, 5.0), st.floats(-3.0, 3.0), st.floats(-3.0, 3.0))
def test_a_slope_is_left_as_it_is(fwhm, ratio, gx, gy):
    x, y = grid(60, 70)
    coarse = CoarseGrid.over(x.shape, ratio)
    found, mass = spread(gx * x + gy * y, np.ones(x.shape), fwhm, coarse)
    column, row = middles(coarse)
    inner = mass > 1.0 - 1e-9
    np.testing.assert_allclose(found[inner], (gx * column + gy * row)[inner], atol=1e-3)


@pytest.mark.parametrize(("fwhm", "kept"), [(1.0, 0.785), (1.5, 0.994), (3.0, 1.0)])
def test_a_narrow_gaussian_loses_what_the_docstring_says(fwhm, kept):
    """Second moment of the sampled kernel."""
    x, _ = grid(20, 41)
    spot = (x == 20.0).astype(float)
    found, _ = spread(spot, np.ones(x.shape), fwhm)
    moment = np.sqrt(np.sum(found[10] * (x[10] - 20.0) ** 2))
    assert moment / (fwhm * SIGMA_PER_FWHM) == pytest.approx(kept, abs=0.002)
    assert found[10].sum() == pytest.approx(1.0)


def test_no_width_takes_the_nearest_node():
    x, y = grid(9, 12)
    found, mass = spread(x + 100.0 * y, np.ones(x.shape), 0.0, CoarseGrid.over(x.shape, 3.0))
    np.testing.assert_array_equal(found, [[101.0, 104.0, 107.0, 110.0]] + 300.0 * np.c_[:3])
    assert (mass == 1.0).all()


def test_no_width_takes_the_nearest_of_nodes_that_lie_between():
    """Nodes at a spacing of 1.5 from 0.25: 0.25, 1.75, 3.25, 4.75 are nearest to 0, 2, 3, 5."""
    x, y = grid(6, 6)
    found, _ = spread(x + 100.0 * y, np.ones(x.shape), 0.0, CoarseGrid.over(x.shape, 1.5))
    near = np.array([0.0, 2.0, 3.0, 5.0])
    np.testing.assert_array_equal(found, near + 100.0 * near[:, None])


@pytest.mark.parametrize(
    ("shape", "ratio", "fwhm"),
    [((23, 31), 1.0, 2.5), ((23, 31), 3.0, 7.0), ((40, 29), 2.2, 4.4), ((700, 5), 1.0, 6.0), ((900, 4), 2.5, 5.0)],
)  # fmt: skip
def test_means_are_sums_over_every_cell(shape, ratio, fwhm):
    """A Gaussian to 5 sigma, normalised over an unlimited grid; weights; grids with more nodes than
    one block.
    """
    rng = np.random.default_rng(0)
    values, weight = rng.normal(size=shape), rng.random(shape)
    coarse = CoarseGrid.over(shape, ratio)
    sigma = fwhm * SIGMA_PER_FWHM
    sides = []
    for count, of in zip(coarse.shape, shape, strict=True):
        away = np.arange(-60, of + 60)[None] - (coarse.start_px + ratio * np.arange(count))[:, None]
        near = np.where(np.abs(away) <= 5.0 * sigma, np.exp(-0.5 * (away / sigma) ** 2), 0.0)
        sides.append((near / near.sum(axis=1, keepdims=True))[:, 60 : of + 60])
    light, mass = (sides[0] @ a @ sides[1].T for a in (values * weight, weight))
    found, share = spread(values, weight, fwhm, coarse)
    np.testing.assert_allclose(share, mass, rtol=1e-9)
    np.testing.assert_allclose(found, light / mass, rtol=1e-8, atol=1e-12)


def test_missing_cells_weigh_nothing():
    rng = np.random.default_rng(0)
    x, _ = grid()
    weight = rng.random(x.shape)
    weight[25:45, 30:60] = 0.0
    values = np.where(weight > 0.0, 4.0, 1e9)
    values[10, 10] = np.nan
    found, mass = spread(values, weight, 3.0)
    there = mass > 0.0
    np.testing.assert_allclose(found[there], 4.0, rtol=1e-9)
    assert np.isnan(found[~there]).all()
    assert mass[35, 45] == 0.0
    assert 0.3 < mass[60, 60] < 0.7  # random weights have a mean of a half


def test_weights_pull_by_their_size():
    values, weight = np.zeros((31, 31)), np.ones((31, 31))
    values[:, 16:], weight[:, 16:] = 1.0, 3.0
    found, _ = spread(values, weight, 60.0)
    assert found[15, 15] == pytest.approx(
        0.75, abs=0.02
    )  # half the Gaussian each, three times as heavy


def test_the_border_is_an_end_and_not_a_mirror():
    found, mass = spread(np.ones((40, 40)), np.ones((40, 40)), 6.0)
    assert mass[20, 20] == pytest.approx(1.0)
    assert mass[20, 0] == pytest.approx(0.5 + 0.5 / (6.0 * SIGMA_PER_FWHM * np.sqrt(2 * np.pi)), abs=5e-3)  # fmt: skip
    np.testing.assert_allclose(found, 1.0)


@given(st.integers(1, 60), st.integers(1, 60), st.floats(1.0, 9.0))
def test_coarse_cells_lie_within_the_fine_ones(rows, cols, ratio):
    if min(rows, cols) + 1e-9 < ratio:
        with pytest.raises(ValueError, match="are too few"):
            CoarseGrid.over((rows, cols), ratio)
        return
    coarse = CoarseGrid.over((rows, cols), ratio)
    for count, of in zip(coarse.shape, (rows, cols), strict=True):
        first, last = coarse.start_px, coarse.start_px + (count - 1) * ratio
        assert first - ratio / 2.0 == pytest.approx(-0.5)
        assert last + ratio / 2.0 <= of - 0.5 + 1e-6
        assert last + 1.5 * ratio > of - 0.5 - 1e-6  # no other would fit


def test_image_and_render_become_equally_sharp():
    """Terrain whose render lacks the detail that the DEM's Gaussian removes, and an image with all
    detail.
    """
    rng = np.random.default_rng(0)
    k = np.hypot(*np.meshgrid(np.fft.fftfreq(200), np.fft.fftfreq(200)))
    k[0, 0] = 1.0
    noise = np.fft.fft2(rng.normal(size=(200, 200))) / k
    dem_fwhm = 7.5
    passed = np.exp(-2.0 * (np.pi * dem_fwhm * SIGMA_PER_FWHM * np.where(k == 1.0, 0.0, k)) ** 2)
    image, render = (np.fft.ifft2(noise * h).real for h in (1.0, passed))
    for target_m in (118.0, 474.0, 1000.0):
        pair = paired(
            image, render, np.ones(image.shape), gsd_m=118.0, target_m=target_m, dem_fwhm_m=118.0 * dem_fwhm
        )  # fmt: skip
        inner = pair.weight > 1.0 - 1e-9
        off = np.abs(pair.image - pair.render)[inner].max() / pair.render[inner].std()
        assert off < 2e-3
        assert pair.gsd_m == target_m
        blunt = paired(image, render, np.ones(image.shape), gsd_m=118.0, target_m=target_m)
        assert np.abs(blunt.image - blunt.render)[inner].max() > 20 * off * pair.render[inner].std()


@pytest.mark.parametrize("cell_fwhm", [1.5, 2.0])
def test_both_get_the_point_spread_of_the_target_cells(cell_fwhm):
    """Cells of 3: a Gaussian in units of these, and for the image also that of the DEM; squares of
    the widths add.
    """
    x, _ = grid(150, 160)
    wave, ratio, dem = 40.0, 3.0, 6.0
    values = np.cos(2.0 * np.pi * x / wave)
    how = {"gsd_m": 10.0, "target_m": 30.0, "dem_fwhm_m": 60.0, "cell_fwhm": cell_fwhm}
    pair = paired(values, values, np.ones(values.shape), **how)
    column, _ = middles(pair.grid)
    wanted = np.cos(2.0 * np.pi * column / wave)
    inner = pair.weight > 1.0 - 1e-9
    for found, width2 in (
        (pair.render, (cell_fwhm * ratio) ** 2),
        (pair.image, (cell_fwhm * ratio) ** 2 + dem**2),
    ):
        left = np.exp(-2.0 * np.pi**2 * width2 * SIGMA_PER_FWHM**2 / wave**2)
        np.testing.assert_allclose(found[inner], left * wanted[inner], atol=1e-4)


def test_what_one_of_the_two_lacks_counts_in_neither():
    image, render = np.ones((40, 40)), np.ones((40, 40))
    image[5, 5], render[20:30, 20:30] = np.nan, np.nan
    image[22:28, 22:28] = 1e9  # where there is no render
    pair = paired(image, render, np.ones(image.shape), gsd_m=1.0, target_m=1.0)
    assert pair.weight[25, 25] < 0.01
    assert 0.5 < pair.weight[5, 5] < 1.0
    np.testing.assert_allclose(pair.image[np.isfinite(pair.image)], 1.0)


def test_a_pair_is_as_sure_as_the_less_sure_of_the_two():
    """A small gap: the narrower point spread, that of the render, is affected more."""
    weight = np.ones((40, 40))
    weight[19:22, 19:22] = 0.0
    pair = paired(weight, weight, weight, gsd_m=1.0, target_m=1.0, dem_fwhm_m=9.0)
    _, narrow = spread(weight, weight, 2.0)
    assert pair.weight[20, 20] == pytest.approx(narrow[20, 20])
    assert pair.weight[20, 20] < 0.3


def test_cells_that_are_finer_by_rounding_are_the_same():
    values = np.random.default_rng(0).normal(size=(9, 9))
    pair = paired(values, values, np.ones((9, 9)), gsd_m=118.45, target_m=118.45 * (1.0 - 5e-7))
    assert pair.image.shape == (9, 9)


def test_finer_cells_are_refused():
    with pytest.raises(ValueError, match="not coarser"):
        paired(np.ones((9, 9)), np.ones((9, 9)), np.ones((9, 9)), gsd_m=100.0, target_m=90.0)
    with pytest.raises(ValueError, match="shapes"):
        spread(np.ones((3, 3)), np.ones((3, 4)), 1.0)


@pytest.mark.parametrize("ratio", [1.0, 2.0, 2.5, 3.7])
def test_plain_means_are_those_of_gdal(ratio):
    """Means over the area of each coarse cell, cells without data left out: GDAL's ``average``."""
    dice = np.random.default_rng(5)
    image, render = dice.uniform(0.5, 1.0, (2, 60, 71))
    image[20:31, 10:14] = np.nan
    render[50:, 60:] = np.nan
    ones = np.ones(image.shape)
    found = area_paired(image, render, ones, gsd_m=100.0, target_m=100.0 * ratio)
    gap = np.isnan(image + render)
    corner, plane = Affine.translation(1e3, 1e3), "+proj=eqc +R=1737400 +units=m"
    for name, values in (("image", image), ("render", render)):
        wanted = np.full(found.grid.shape, np.nan)
        reproject(
            np.where(gap, np.nan, values), wanted, src_transform=corner * Affine.scale(1.0, -1.0),
            dst_transform=corner * Affine.scale(ratio, -ratio), src_crs=plane, dst_crs=plane,
            src_nodata=np.nan, dst_nodata=np.nan, resampling=Resampling.average,
        )  # fmt: skip
        np.testing.assert_allclose(getattr(found, name), wanted, atol=1e-6)
    whole = area_paired(ones, ones, np.where(gap, 0.0, 1.0), gsd_m=100.0, target_m=100.0 * ratio)
    assert found.weight == pytest.approx(whole.weight)
    assert found.weight.max() == pytest.approx(1.0)
