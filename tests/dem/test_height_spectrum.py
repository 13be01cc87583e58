"""Parts of the resolution estimate: spectrum, bins, fit and interval, compared with closed forms
and lstsq.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from lcp_catalog.dem import effective_resolution
from lcp_catalog.dem.effective_resolution import Heights

K = np.geomspace(1e-4, 4.5e-3, 33)
"""Wavenumbers of 5.5 octaves."""


def law(k, amplitude=5.6e-5, exponent=4.0, cut=math.inf, shape=0, noise=0.0):
    """P(k) of the module's docstring."""
    passed = (1.0 / (1.0 + 3.0 * (k / cut) ** 4), np.exp(-math.log(4.0) * (k / cut) ** 2))[shape]
    return amplitude * k**-exponent * passed + noise


def spectrum(power, waves=1e6, k=K):
    return effective_resolution.Spectrum(k, np.asarray(power), np.broadcast_to(waves, k.shape))


def one_window(z, steps):
    return effective_resolution.spectrum_of([Heights(z, steps)])


def tiles_of(z, side):
    found = effective_resolution._tiles([z], side)
    return found[0] if found else []


# -- the spectrum


def test_white_heights_have_the_power_of_their_variance_and_a_plane_has_none():
    rng = np.random.default_rng(0)
    power = np.mean(
        [effective_resolution._power(rng.normal(scale=3.0, size=(64, 64))) for _ in range(40)],
        axis=0,
    )
    assert power[5:-5, 5:-5].mean() == pytest.approx(9.0, rel=0.02)
    y, x = np.mgrid[:64, :64]
    assert effective_resolution._power(700.0 + 3.0 * x - 20.0 * y).max() < 1e-12 * 20.0**2


def test_what_leaks_from_a_wave_falls_with_its_tenth_power():
    """A squared Hann window: 10 octaves of power per octave, steeper than the spectrum of any DEM."""
    tile = np.broadcast_to(np.cos(2.0 * np.pi * 20.5 * np.arange(256) / 256), (256, 256))
    power = effective_resolution._power(tile)[0]
    for away in (10, 20, 40):
        near, far = (power[20 + s * away : 20 + s * away + 4].mean() for s in (1, 2))
        assert math.log2(near / far) == pytest.approx(10.0, abs=1.2)


@pytest.mark.parametrize("tiles", [1.0, 2.0, 5.0, 20.0])
def test_a_bin_is_the_mean_of_noisy_powers(tiles):
    """The powers of n tiles are Gamma(n) / n about their mean: the geometric mean is below it by n
    / exp(digamma(n)).
    """
    rng = np.random.default_rng(1)
    k = rng.uniform(1.0, 8.0, 60_000)
    power = k**-3.0 * rng.gamma(tiles, 1.0 / tiles, k.size)
    found = effective_resolution._binned(k, power, np.geomspace(1.0, 8.0, 4), tiles)
    np.testing.assert_allclose(found.power * found.wavenumber**3, 1.0, rtol=0.02)
    inside = [((k >= a) & (k < 2.0 * a)).sum() for a in (1.0, 2.0, 4.0)]
    np.testing.assert_allclose(found.waves, np.array(inside) * tiles)


@pytest.mark.parametrize(("shape", "side", "tiles"), [((64, 64), 64, 1), ((64, 96), 64, 2), ((130, 70), 64, 3)])  # fmt: skip
def test_waves_are_counted_once_within_the_tiles_bounds(shape, side, tiles):
    """From three waves per tile to 0.95 of Nyquist; a wave and its negative count once;
    half-overlapping tiles count half each.
    """
    step = 100.0
    found = one_window(np.random.default_rng(2).normal(size=shape), (step, step))
    f = np.fft.fftfreq(side, step)
    k = np.hypot(*np.meshgrid(f, f))
    within = (k >= 3.0 / (side * step)) & (k < 0.95 * 0.5 / step)
    # waves at Nyquist's own wavenumber have no negative in a discrete spectrum; none is within
    assert found.waves.sum() == pytest.approx(0.5 * within.sum() * 0.5 * (tiles + 1), rel=0.02)
    assert 3.0 / (side * step) <= found.wavenumber[0] < 3.6 / (side * step)
    assert 0.85 * 0.5 / step < found.wavenumber[-1] <= 0.95 * 0.5 / step
    # white heights of variance 1: power is the cell's area; tiles that overlap by half are taken for less independent than they
    # are, which raises all bins alike and decides nothing
    level = np.exp(np.average(np.log(found.power), weights=found.waves))
    assert level == pytest.approx(step * step, rel=0.08 if tiles == 1 else 0.2)


def test_waves_longer_than_thirty_kilometres_are_left_out():
    """Waves beyond `LAW_LONGEST_M` are not used; without a factor of 2.5 between the longest and
    the shortest wave there is no estimate.
    """
    rng = np.random.default_rng(3)
    z = rng.normal(size=(64, 64))
    assert one_window(z, (3000.0, 3000.0)).wavenumber[0] >= 1.0 / 30e3
    widest = 0.95 * 0.5 * 30e3 / 2.5
    assert one_window(z, (0.99 * widest, 0.99 * widest)) is not None
    assert one_window(z, (1.01 * widest, 1.01 * widest)) is None


def test_tiles_are_whole_and_hold_half_of_the_heights():
    z = np.ones((96, 128))
    assert [len(tiles_of(z, side)) for side in (128, 64, 32)] == [0, 6, 35]
    z[40, ::40] = np.nan  # every tile of 64 rows from row 0 or 32 meets one
    assert tiles_of(z, 64) == []
    whole = [np.isfinite(z[i : i + 32, j : j + 32]).all() for i in range(0, 65, 16) for j in range(0, 97, 16)]  # fmt: skip
    assert len(tiles_of(z, 32)) == sum(whole) > 10
    z[:33] = np.nan  # of what is left 55 rows of 63 lie in whole tiles: rows 48 to 95
    assert len(tiles_of(z, 32)) == 2 * 7
    z[80] = np.nan  # now rows 48 to 79 alone, 32 of 62
    assert len(tiles_of(z, 32)) == 7
    z[79] = np.nan
    assert tiles_of(z, 32) == []


# -- the fit


@pytest.mark.parametrize("shape", [0, 1])
@pytest.mark.parametrize("noise", [0.0, 2e4])
@pytest.mark.parametrize("waves", [1e6, 30.0])
def test_every_cut_is_fitted_by_least_squares(shape, noise, waves):
    """By lstsq, with the prior of the exponent, 4 +- 0.3, as one more measurement and a model error
    of a tenth; for a short spectrum, whose exponent depends on the prior, and a long one.
    """
    rng = np.random.default_rng(4)
    for k in (K, K[18:]):
        power = law(k, cut=9e-4, exponent=4.6, shape=shape, noise=1.4 * noise)
        power = power * np.exp(0.15 * rng.normal(size=k.size))
        name = list(effective_resolution.SHAPES)[shape]
        fit = effective_resolution._fit(spectrum(power, waves, k), name, noise)
        sigma = np.sqrt(1.0 / waves + 0.1**2)
        clear = power - noise
        by = sigma * power / clear
        profile, numbers = [], []
        for cut in fit.cuts:
            fall = (-np.log(1.0 + 3.0 * (k / cut) ** 4), -math.log(4.0) * (k / cut) ** 2)[shape]
            design = np.stack([1.0 / by, -np.log(k) / by], axis=-1)
            rows = np.vstack([design, [0.0, 1.0 / 0.3]])
            right = np.append((np.log(clear) - fall) / by, 4.0 / 0.3)
            level, exponent = np.linalg.lstsq(rows, right, rcond=None)[0]
            model = level - exponent * np.log(k) + fall
            model = np.logaddexp(model, np.log(noise)) if noise else model
            off = (np.log(power) - model) / sigma
            profile.append(off @ off + ((exponent - 4.0) / 0.3) ** 2)
            numbers.append((level, exponent))
        np.testing.assert_allclose(fit.profile, profile, rtol=1e-6)
        best = int(np.argmin(profile))
        assert (fit.cut, fit.chi2) == (fit.cuts[best], pytest.approx(profile[best]))
        assert (np.log(fit.amplitude), fit.exponent) == pytest.approx(numbers[best])


@pytest.mark.parametrize("shape", [0, 1])
@pytest.mark.parametrize("exponent", [3.6, 4.0, 4.4])
@pytest.mark.parametrize("cut", [5e-4, 1.5e-3])
def test_a_law_comes_back(shape, exponent, cut):
    """Without noise: the cut to one step of the table, 2.2 %, and to the effect of the exponent's
    prior.
    """
    posting = 0.5 / 4.5e-3
    found = effective_resolution._fitted(
        spectrum(law(K, exponent=exponent, cut=cut, shape=shape)), posting
    )
    assert found.resolution_m == pytest.approx(0.5 / cut, rel=0.04)
    assert found.exponent == pytest.approx(exponent, abs=0.08)
    assert list(effective_resolution.SHAPES)[shape] in found.how
    # the Gaussian that halves that wave: exp(-2 (pi s k)^2) = 1/2
    s = found.point_spread_m / math.sqrt(8.0 * math.log(2.0))
    assert math.exp(-2.0 * (math.pi * s * 0.5 / found.resolution_m) ** 2) == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("times", "sharp"), [(0.7, False), (0.93, False), (1.1, True), (1.6, True)]
)
def test_a_cut_beyond_nyquist_is_no_point_spread(times, sharp):
    posting = 110.0
    cut = times * 0.5 / posting
    found = effective_resolution._fitted(spectrum(law(K, cut=cut)), posting)
    assert (found.point_spread_m == 0.0) == sharp == (found.resolution_m == posting)


def test_noise_is_what_is_flat_and_counts_where_it_outweighs_the_rest():
    """A k^-4 = N at k = (A / N)^(1/4)."""
    level = 5.6e-5 / 2e-3**4
    noisy = spectrum(law(K, noise=level))
    found = effective_resolution._fitted(noisy, 100.0)
    assert found.resolution_m == pytest.approx(0.5 / 2e-3, rel=0.05)
    assert effective_resolution._best(noisy).noise == pytest.approx(level, rel=0.12)
    assert "noise exceeds" in found.how
    # an edge that noise makes is as sure as areas differ, a quarter in the logarithm, and no surer
    for side in (found.high_m / found.resolution_m, found.resolution_m / found.low_m):
        assert math.log(side) == pytest.approx(0.25)
    fit = effective_resolution._Fit("a Gaussian point spread", 1.0, 5.6e-5, 4.0, level, 1.0, K, K)
    assert effective_resolution._outweighed(fit, 5e-3) == pytest.approx(2e-3, rel=0.01)
    assert effective_resolution._outweighed(fit, 2.6e-3) == pytest.approx(2e-3, rel=0.01)
    assert effective_resolution._outweighed(fit, 2.4e-3) == math.inf  # beyond 0.8 of Nyquist's


def test_the_interval_is_where_the_misfit_is_one_more():
    """Or larger by the factor by which chi^2 of the best fit exceeds its degrees of freedom."""
    cuts = np.geomspace(1e-4, 1e-2, 300)
    away = np.log(cuts / 1e-3)
    profile = (away / np.where(away < 0.0, 0.2, 0.5)) ** 2
    for least, count, scale in ((3.0, 20, 1.0), (64.0, 20, 4.0), (9.0, 5, 9.0), (9.0, 3, 9.0)):
        fit = effective_resolution._Fit("", 1e-3, 1.0, 4.0, 0.0, least, cuts, least + profile)
        low, high = effective_resolution._interval(fit, count)
        assert math.log(1e-3 / low) == pytest.approx(0.2 * math.sqrt(scale), abs=0.02)
        assert math.log(high / 1e-3) == pytest.approx(0.5 * math.sqrt(scale), abs=0.02)


def test_a_resolution_is_as_sure_as_its_fit_and_as_areas_differ():
    """The finest resolution of the interval belongs to the highest cut; both sides are widened by a
    quarter, in quadrature.
    """
    rng = np.random.default_rng(6)
    power = law(K, cut=1.6e-3, shape=0) * np.exp(0.3 * rng.normal(size=K.size))
    made = spectrum(power, 40.0)
    posting = 90.0
    found = effective_resolution._fitted(made, posting)
    near = np.less_equal(K, 2.5 * effective_resolution._best(made).cut)
    kept = effective_resolution.Spectrum(made.wavenumber[near], made.power[near], made.waves[near])
    fit = effective_resolution._best(kept)
    low, high = effective_resolution._interval(fit, len(kept.power))
    assert found.resolution_m == pytest.approx(0.5 / fit.cut)
    finer, coarser = np.hypot([math.log(high / fit.cut), math.log(fit.cut / low)], 0.25)
    assert abs(finer - coarser) > 0.005
    assert found.low_m == pytest.approx(max(posting, 0.5 / fit.cut * math.exp(-finer)))
    assert found.high_m == pytest.approx(0.5 / fit.cut * math.exp(coarser))


def test_what_lies_far_beyond_the_cut_has_no_say():
    """The filters of a DEM appear there, from four times the cut on."""
    cut, posting = 3e-4, 0.5 / 4.5e-3
    power = law(K, cut=cut, shape=0)
    plain = effective_resolution._fitted(spectrum(power), posting)
    odd = power * np.maximum(K / (4.0 * cut), 1.0) ** 1.5
    found = effective_resolution._fitted(spectrum(odd), posting)
    assert found.resolution_m == pytest.approx(plain.resolution_m, rel=0.03)


def test_a_parallels_steps_are_as_wide_as_the_wider():
    """Steps of 100 m down and 50 m across: no wave is shorter than twice 100 m."""
    z = np.random.default_rng(7).normal(size=(64, 64))
    found = one_window(z, (100.0, 50.0))
    assert found.wavenumber[-1] <= 0.95 * 0.5 / 100.0
    assert found.wavenumber[0] >= 3.0 / (64 * 100.0)
