"""Registration: covariance and noise figures against simulated images, and patches that cannot be
located.
"""

from __future__ import annotations

import numpy as np
import pytest
from helpers import twins_registration as twin
from hypothesis import given
from hypothesis import strategies as st

from lcp_catalog.kernels.matching import registration as kernel
from lcp_catalog.kernels.vectors import LANES
from lcp_catalog.landmarks.error_model import ErrorModel, NoiseTerms, PatchErrors
from lcp_catalog.landmarks.localization import (
    harris_response,
    light_of,
    registration,
)

P = 33
CELL_M = 100.0
WHITE = ErrorModel(sensor_noise=0.02, height_sigma_m=0.0, albedo_sigma=0.0)


def slopes_of(patch):
    """Derivatives of a patch (p, p) along its columns and rows, (p, p) each, by the kernel: of eight
    patches that are computed together, those of the third.
    """
    p = len(patch)
    stack = np.random.default_rng(5).normal(size=(LANES, p, p)).astype(np.float32)
    stack[2] = patch
    beside, across, down = np.full((3, p * p * LANES), np.nan, np.float32)
    kernel.side_by_side(stack, 0, np.ones(LANES, np.float32), beside)
    kernel.differentiate(p, beside, across, down, np.empty((kernel._SUMS, LANES), np.float32))
    return [part.reshape(p, p, LANES)[..., 2] for part in (across, down)]


class Texture:
    """A smooth field, defined everywhere: a sum of waves, optionally stretched along a direction."""

    def __init__(self, seed, stretch=1.0, angle=0.0, waves=40, contrast=0.1, fast=0.35):
        rng = np.random.default_rng(seed)
        k = rng.normal(size=(waves, 2)) * fast
        k[:, 0] /= stretch  # slow along the first axis
        turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        self.k, self.phase = k @ turn, rng.uniform(0, 2 * np.pi, waves)
        self.amplitude = contrast * np.sqrt(2.0 / waves)

    def __call__(self, dx=0.0, dy=0.0, size=P):
        at = np.arange(float(size))[:, None]
        across = np.exp(1j * ((at + dx) * self.k[:, 0] + self.phase))
        down = np.exp(1j * (at + dy) * self.k[:, 1])
        return 1.0 + self.amplitude * (down @ across.T).real


def register(texture, images):
    """Shifts (n, 2) of least squares between noisy images and texture(shift), with gain and offset:
    Gauss-Newton.
    """
    found, e = [], 1e-4
    gx = (texture(e, 0.0) - texture(-e, 0.0)) / (2 * e)
    gy = (texture(0.0, e) - texture(0.0, -e)) / (2 * e)
    for image in images:
        d = np.zeros(2)
        for _ in range(4):
            model = texture(*d)
            design = np.stack([gx, gy, model, np.ones_like(model)], axis=-1).reshape(-1, 4)
            answer = np.linalg.lstsq(design, image.ravel(), rcond=None)[0]
            d = d + answer[:2] / answer[2]
        found.append(d)
    return np.array(found)


def even(patches):
    """Sources of error of ground whose brightness does not depend on its slope."""
    ones = np.ones(np.shape(patches), np.float32)
    return PatchErrors(ones, 0.0 * ones, 0.0 * ones)


def match(patches, model=WHITE, errors=None):
    patches = np.asarray(patches)
    return registration(patches, errors or even(patches), model, CELL_M)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("stretch", "angle"),
    [(1.0, 0.0), (6.0, 0.0), (6.0, 0.6)],
    ids=["even", "ridge", "turned ridge"],
)
def test_the_stated_covariance_is_that_of_real_registrations(stretch, angle):
    """White noise; within 3 standard errors of 250 fits."""
    texture = Texture(5, stretch, angle)
    clean = texture()
    rng = np.random.default_rng(0)
    shifts = register(texture, [clean + 0.02 * rng.normal(size=clean.shape) for _ in range(250)])
    stated = match(clean[None]).covariance_px2[0]
    whitened = shifts @ np.linalg.inv(np.linalg.cholesky(stated)).T
    np.testing.assert_allclose(np.cov(whitened.T), np.eye(2), atol=0.27)
    values = np.linalg.eigvalsh(stated)
    assert (values[1] > 9.0 * values[0]) == (stretch > 1.0)


def made_slopes(rng, size, length):
    """Slopes east and south, and brightness, of random fields with the Gaussian autocorrelation of a
    length in nodes and unit variance: exact derivatives by Fourier transforms.
    """
    k = 2.0 * np.pi * np.fft.fftfreq(size)
    power = np.exp(-0.5 * length**2 * (k[:, None] ** 2 + k**2))
    shape = np.sqrt(power / power.mean())
    heights, other = (shape * np.fft.fft2(rng.normal(size=(size, size))) for _ in range(2))
    fields = 1j * k * heights, 1j * k[:, None] * heights, other
    return [np.fft.ifft2(field).real[:P, :P] for field in fields]


@pytest.mark.slow
def test_covariance_and_noise_in_errors_of_a_dem_and_of_brightness():
    """Sensitivities that differ from node to node; 400 fits, within 4 standard errors."""
    texture = Texture(7)
    clean = texture()
    sources = [
        Texture(seed, contrast=0.3)() + level for seed, level in ((8, 0), (9, -1.4), (10, 0.5))
    ]
    errors = PatchErrors(*(a[None].astype(np.float32) for a in sources))
    length, inner = 2.0, np.sqrt(4.0 - 1.0 / 6.0)  # a pixel of the model is a mean, here a point
    sigma = 0.02 * length / inner * CELL_M
    model = ErrorModel(
        sensor_noise=0.01, height_sigma_m=sigma, height_length_m=inner * CELL_M,
        albedo_sigma=0.02 * length / inner, albedo_length_m=inner * CELL_M,
    )  # fmt: skip
    rng = np.random.default_rng(1)
    noise = []
    for _ in range(400):
        p, q, a = made_slopes(rng, 80, length)
        one = 0.02 * (sources[1] * p + sources[2] * q + sources[0] * a)
        noise.append(one + 0.01 * rng.normal(size=clean.shape))
    noise = np.array(noise)
    stated = match(clean[None], model, errors)
    whitened = register(texture, clean + noise) @ np.linalg.inv(
        np.linalg.cholesky(stated.covariance_px2[0])
    ).T  # fmt: skip
    np.testing.assert_allclose(np.cov(whitened.T), np.eye(2), atol=0.28)
    unit = (clean - clean.mean()) / np.linalg.norm(clean - clean.mean())
    assert (noise * unit).sum(axis=(1, 2)).var() == pytest.approx(stated.along[0], rel=0.28)
    within = (noise - noise.mean(axis=(1, 2), keepdims=True)).var(axis=(1, 2)).mean()
    assert within == pytest.approx(stated.noise_variance[0], rel=0.05)
    assert stated.contrast[0] == pytest.approx(clean.std(), rel=1e-6)
    assert (stated.pixels == P * P).all()


def test_brightness_common_to_a_patch_is_no_noise():
    """The mean over the patch is an offset: of white noise 1 / N is lost, of a slow field nearly all."""
    patch = Texture(1)()[None]
    white = match(patch).noise_variance[0]
    assert white == pytest.approx(0.02**2 * (1.0 - 1.0 / P**2), rel=1e-5)
    slow = ErrorModel(0.0, 0.0, 500.0, 0.02, 20.0 * P * CELL_M)
    assert match(patch, slow).noise_variance[0] < 1e-3 * 0.02**2


def test_places_between_pixels_lose_the_stated_correlation():
    """Mean over 200 places within half a pixel; the loss is a square only for small shifts."""
    rng = np.random.default_rng(2)
    for seed in range(3):
        texture = Texture(seed)
        clean = texture()
        shifts = rng.uniform(-0.5, 0.5, size=(200, 2))
        rho = [np.corrcoef(clean.ravel(), texture(*d).ravel())[0, 1] for d in shifts]
        assert match(clean[None]).shift_loss[0] == pytest.approx(1.0 - np.mean(rho), rel=0.2)


def test_a_spread_of_the_noise_widens_the_mean_covariance_alone():
    """exp(2 s^2) is the mean square of exp(s x)."""
    patches = Texture(1)()[None]
    spread = 0.4
    one, other = (
        match(patches),
        match(patches, ErrorModel(**(WHITE.to_dict() | {"spread": spread}))),
    )
    x = np.random.default_rng(0).normal(size=400_000)
    np.testing.assert_allclose(
        other.covariance_px2 / one.covariance_px2, np.mean(np.exp(2.0 * spread * x)), rtol=0.02
    )
    assert other.spread == spread
    for name in ("contrast", "noise_variance", "along", "shift_loss"):
        assert getattr(other, name) == getattr(one, name)


def test_patches_that_cannot_be_located():
    row, col = np.mgrid[0:P, 0:P].astype(np.float32)
    ridge = 1.0 + 0.2 * np.sin(row / 3.0)
    bad = {
        "flat": np.ones((P, P)),
        "pure ridge": ridge,
        "even slope": 1.0 + 0.01 * row,  # a shift along the slope is an offset
        "slope across a ridge": 1.0 + 0.2 * np.sin(row / 3.0) + 0.01 * col,
    }
    found = match(list(bad.values()))
    sigma = np.sqrt(np.trace(found.covariance_px2, axis1=1, axis2=2))
    assert (sigma > 100.0).all(), dict(zip(bad, sigma, strict=True))
    assert np.isinf(sigma[:3]).all()
    assert not np.isnan(found.covariance_px2).any()
    assert np.isinf(found.along[0])
    assert found.contrast[0] == 0.0
    assert match(np.zeros((0, P, P))).covariance_px2.shape == (0, 2, 2)


def test_without_noise_the_match_is_exact():
    found = match(Texture(1)()[None], ErrorModel(0.0, 0.0, 500.0, 0.0, 500.0))
    assert (found.covariance_px2 == 0.0).all()
    assert found.noise_variance[0] == found.along[0] == 0.0


def test_a_shift_that_is_a_gain_is_no_shift():
    row, col = np.mgrid[0:P, 0:P].astype(np.float64)
    ridge = 1.0 + 0.2 * np.sin(row / 3.0)
    grows, slopes = np.exp(0.03 * col) * ridge, Texture(1)() * ridge
    sigma = np.sqrt([np.linalg.eigvalsh(c)[1] for c in match([grows, slopes]).covariance_px2])
    assert sigma[0] > 1.0  # the plain tensor would give noise / (0.03 * 33) = 0.02
    assert sigma[1] < 0.1


@given(st.floats(1e-3, 0.5))
def test_covariance_grows_with_the_square_of_the_noise(noise):
    patch = Texture(2)()[None]
    one, other = match(patch), match(patch, ErrorModel(noise, 0.0, 500.0, 0.0))
    np.testing.assert_allclose(
        other.covariance_px2, one.covariance_px2 * (noise / 0.02) ** 2, rtol=1e-4
    )


@pytest.mark.parametrize("seed", range(3))
def test_mirrored_and_turned_patches(seed):
    """Columns first, rows downwards; a mirrored axis changes the sign of the correlation."""
    patch = Texture(seed, 4.0, 0.4)()
    turned = [patch, patch[::-1], patch[:, ::-1], patch.T]
    found = match(turned)
    one = found.covariance_px2[0]
    across = one * [[1, -1], [-1, 1]]
    expected = [one, across, across, one[::-1, ::-1]]
    np.testing.assert_allclose(found.covariance_px2, expected, rtol=1e-5)
    harris = harris_response(np.array(turned, np.float32))
    np.testing.assert_allclose(harris, harris[0], rtol=1e-4)


def test_harris_is_that_of_the_plain_tensor():
    patch = Texture(3)()
    g = patch / patch.mean()
    gy, gx = np.gradient(g)
    m = np.array([[(gx * gx).sum(), (gx * gy).sum()], [(gx * gy).sum(), (gy * gy).sum()]])
    expected = (np.linalg.det(m) - 0.04 * np.trace(m) ** 2) / P**4
    patches = np.stack([patch, 7.0 * patch, np.zeros((P, P)), np.where(patch < 0.8, np.nan, patch)])
    found = harris_response(patches.astype(np.float32))
    np.testing.assert_allclose(found[:2], expected, rtol=1e-4)
    assert np.isnan(found[2:]).all()
    assert found.dtype == np.float32
    twice = harris_response(patches[:1].astype(np.float32), np.array([2.0 * patch.mean()]))
    np.testing.assert_allclose(twice, expected / 2.0**4, rtol=1e-4)  # by the level that is given


def test_many_patches_give_the_results_of_each_alone():
    patches = np.stack([Texture(s, waves=5)() for s in range(40)])
    model = ErrorModel()
    errors = PatchErrors(*(patches.astype(np.float32) for _ in range(3)))
    whole = match(patches, model, errors)
    for i in (0, 17, 39):
        alone = match(patches[i : i + 1], model, errors.rows(slice(i, i + 1)))
        for name in ("contrast", "noise_variance", "along", "shift_loss", "covariance_px2"):
            np.testing.assert_allclose(getattr(whole, name)[i], getattr(alone, name)[0], rtol=1e-5)


@pytest.mark.parametrize("length_m", [50.0, 400.0])
def test_a_dark_half_is_a_source_of_no_error(length_m):
    """A slope error changes no node in shadow: products are those of the fields' lit part alone, with
    sources everywhere.
    """
    rng = np.random.default_rng(3)
    patches = Texture(4)()[None]
    level, east, south = rng.normal(size=(3, 1, P, P)).astype(np.float32)
    dark = np.ones((1, P, P), np.float32)
    dark[:, :, P // 2 :] = 0.0
    model = ErrorModel(sensor_noise=0.0, height_length_m=length_m, albedo_length_m=3 * length_m)
    assert (NoiseTerms.of(model, P, CELL_M).taps.shape[1] > 0) == (length_m < 100.0)
    found = match(patches, model, PatchErrors(level * dark, east * dark, south * dark))
    fields, _ = twin.fields_of(patches)
    lit, _ = twin.noise_products(fields * dark[:, None], (level, east, south), model, CELL_M)
    whole, _ = twin.noise_products(fields, (level, east, south), model, CELL_M)
    power = P * P * patches.var()
    np.testing.assert_allclose(found.slope_noise * power, lit[:, :2, :2], rtol=1e-4)
    np.testing.assert_allclose(found.along, lit[:, 2, 2], rtol=1e-4)
    assert found.along[0] < 0.8 * whole[0, 2, 2]


def test_levels_divide_patches_and_sources():
    """Each patch by its own; the unit of brightness does not matter."""
    patches = np.stack([Texture(seed)() for seed in range(3)])
    errors = PatchErrors(*(patches.astype(np.float32) for _ in range(3)))
    one = registration(patches, errors, ErrorModel(), CELL_M)
    level = np.array([0.02, 1.0, 900.0])
    by = level[:, None, None].astype(np.float32)
    other = registration(
        patches * by, PatchErrors(*(patches.astype(np.float32) * by for _ in range(3))),
        ErrorModel(), CELL_M, level,
    )  # fmt: skip
    for name in ("contrast", "noise_variance", "along", "shift_loss", "covariance_px2", "own"):
        np.testing.assert_allclose(getattr(other, name), getattr(one, name), rtol=2e-5)


def test_the_pixels_that_a_search_compares_are_those_given():
    patches = np.stack([Texture(seed)() for seed in range(2)])
    given = np.array([40.0, 12.0])
    found = registration(patches, even(patches), WHITE, CELL_M, pixels=given)
    np.testing.assert_array_equal(found.pixels, given)
    assert found.bias.shape == (2, 2)


def test_a_selection_of_patches_is_that_of_all_figures():
    patches = np.stack([Texture(seed)() for seed in range(4)])
    whole = match(patches)
    some = whole.rows(np.array([3, 1]))
    assert some.spread == whole.spread
    for name in ("contrast", "covariance_px2", "slope_noise", "bias", "own", "along", "pixels"):
        np.testing.assert_array_equal(getattr(some, name), getattr(whole, name)[[3, 1]])


@pytest.mark.slow
@pytest.mark.parametrize("axis", [1, 2])
def test_slopes_of_a_sine(axis):
    """Within 3 % of the derivative for a wave of five nodes, inside; central differences give 76 %."""
    x = np.arange(17.0)
    wave = np.sin(2.0 * np.pi * x / 5.0)
    patch = np.ascontiguousarray(np.broadcast_to(wave[:, None] if axis == 1 else wave, (17, 17)))
    across, down = slopes_of(patch)
    along, other = (down.T, across) if axis == 1 else (across, down)
    true = 2.0 * np.pi / 5.0 * np.cos(2.0 * np.pi * x / 5.0)[3:-3]
    np.testing.assert_allclose(along[:, 3:-3], np.broadcast_to(true, (17, 11)), rtol=0.03)
    np.testing.assert_allclose(other, 0.0, atol=1e-6)


@pytest.mark.parametrize("size", [3, 4, 5, 6, 7, 8, 17])
def test_slopes_at_the_border_have_lower_orders(size):
    """Against NumPy; small patches have no node away from the border."""
    patch = np.random.default_rng(size).normal(size=(size, size)).astype(np.float32)
    for axis, found in zip((2, 1), slopes_of(patch), strict=True):
        expected = twin.node_slopes(patch[None].astype(np.float64), axis)[0]
        np.testing.assert_allclose(found, expected, atol=1e-6)


@pytest.mark.parametrize("cell_m", [40.0, 900.0])
def test_each_patch_has_its_own_statistics(cell_m):
    """Patches are computed eight at a time; of 11 each is as it is alone, in both forms of the noise."""
    rng = np.random.default_rng(3)
    patches, level, east, south = rng.normal(1.0, 0.1, (4, 11, 9, 9)).astype(np.float32)
    model, errors = ErrorModel(), PatchErrors(level, east, south)
    assert bool(NoiseTerms.of(model, 9, cell_m).taps.size) == (cell_m > 100.0)
    together = registration(patches, errors, model, cell_m)
    for k in range(11):
        one = registration(patches[k : k + 1], errors.rows([k]), model, cell_m)
        for name in ("contrast", "noise_variance", "along", "covariance_px2", "bias", "own"):
            np.testing.assert_array_equal(getattr(one, name)[0], getattr(together, name)[k])


def test_levels_and_lit_shares_count_neither_shadow_nor_gaps():
    patch = np.ones((2, 4, 5), np.float32)
    patch[0, 0] = 0.0
    patch[1, 1] = 3.0
    patch[1, 2] = 0.0
    assert light_of(patch)[1] == pytest.approx([1.0, 25 / 15])
    patch[0, 1, 0] = np.nan
    assert light_of(patch)[0] == pytest.approx([14 / 20, 15 / 20])
    assert np.isnan(light_of(patch)[1][0])
    assert np.isnan(light_of(np.zeros((1, 4, 5), np.float32))[1])[0]


def test_light_and_harris_are_those_of_numpy():
    """Patches of any shape with shadows and gaps."""
    rng = np.random.default_rng(0)
    for shape in ((9, 9), (2, 2), (17, 12)):
        patches = rng.normal(0.4, 1.0, size=(12, *shape)).astype(np.float32)
        patches[3, 0, 1], patches[5] = np.nan, -1.0
        share, level = twin.light_of(patches)
        np.testing.assert_allclose(light_of(patches)[0], share, rtol=1e-12)
        np.testing.assert_allclose(light_of(patches)[1], level, rtol=1e-6)
        assert np.flatnonzero(np.isnan(level)).tolist() == [3, 5]
        expected = twin.harris_response(patches)
        worst = 1e-5 * np.nanmax(np.abs(expected))
        np.testing.assert_allclose(harris_response(patches), expected, rtol=1e-4, atol=worst)
