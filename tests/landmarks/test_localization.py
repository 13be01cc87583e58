"""Localisation: the stated covariance against registrations of noisy images, and patches that
cannot be located.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lcp_catalog.landmarks.localization import coarsest_scale, decimate, lit_share, localization

P = 33


class Texture:
    """A smooth field, defined everywhere: a sum of waves, optionally stretched along a direction."""

    def __init__(self, seed, stretch=1.0, angle=0.0, waves=40, contrast=0.1):
        rng = np.random.default_rng(seed)
        k = rng.normal(size=(waves, 2)) * 0.35
        k[:, 0] /= stretch  # slow along the first axis
        turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        self.k, self.phase = k @ turn, rng.uniform(0, 2 * np.pi, waves)
        self.amplitude = contrast * np.sqrt(2.0 / waves)

    def __call__(self, dx=0.0, dy=0.0, size=P):
        y, x = np.mgrid[0:size, 0:size].astype(float)
        at = np.multiply.outer(x + dx, self.k[:, 0]) + np.multiply.outer(y + dy, self.k[:, 1])
        return 1.0 + self.amplitude * np.cos(at + self.phase).sum(axis=-1)


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


@pytest.mark.parametrize(
    ("stretch", "angle"),
    [(1.0, 0.0), (6.0, 0.0), (6.0, 0.6)],
    ids=["even", "ridge", "turned ridge"],
)
def test_the_stated_ellipse_is_that_of_real_registrations(stretch, angle):
    texture, sigma = Texture(5, stretch, angle), 0.02
    clean = texture()
    rng = np.random.default_rng(0)
    relative = sigma * clean.mean()
    shifts = register(
        texture, [clean + relative * rng.normal(size=clean.shape) for _ in range(250)]
    )
    values, axes = np.linalg.eigh(np.cov(shifts.T))
    stated = localization(clean[None].astype(np.float32), sigma)
    assert stated.sigma_major_px[0] == pytest.approx(np.sqrt(values[1]), rel=0.15)
    assert stated.sigma_minor_px[0] == pytest.approx(np.sqrt(values[0]), rel=0.15)
    if stretch > 1.0:
        assert stated.sigma_major_px[0] > 3.0 * stated.sigma_minor_px[0]
        off = stated.axis_angle_rad[0] - np.arctan2(axes[1, 1], axes[0, 1])
        assert abs((off + np.pi / 2) % np.pi - np.pi / 2) < 0.1


def test_a_ridge_lies_along_its_own_axis():
    row, col = np.mgrid[0:P, 0:P] - 16.0
    along = 1.0 + 0.2 * np.exp(-(row**2) / 18.0) + 0.02 * np.exp(-(col**2) / 18.0)  # runs east-west
    found = localization(np.stack([along, along.T]).astype(np.float32), 0.01)
    assert found.axis_angle_rad[0] == pytest.approx(0.0, abs=0.05)
    assert abs(found.axis_angle_rad[1]) == pytest.approx(np.pi / 2, abs=0.05)
    assert (found.sigma_major_px > 5.0 * found.sigma_minor_px).all()


def test_patches_that_cannot_be_located():
    row, col = np.mgrid[0:P, 0:P].astype(np.float32)
    gap = Texture(1)().astype(np.float32)
    gap[3, 3] = np.nan
    bad = {
        "flat": np.ones((P, P)),
        "dark": np.zeros((P, P)),
        "gap": gap,
        "pure ridge": 1.0 + 0.2 * np.sin(row / 3.0),
        "even slope": 1.0 + 0.01 * row,
        "slope across a ridge": 1.0
        + 0.2 * np.sin(row / 3.0)
        + 0.01 * col,  # a shift along the slope is an offset
    }
    found = localization(np.stack(list(bad.values())).astype(np.float32), 0.01)
    assert dict(zip(bad, found.localizable(100.0).tolist(), strict=True)) == dict.fromkeys(
        bad, False
    )
    assert np.isinf(found.sigma_major_px[:4]).all()
    assert np.isnan(found.axis_angle_rad[:4]).all()
    assert localization(np.zeros((0, P, P), np.float32), 0.01).sigma_major_px.shape == (0,)


@given(st.floats(1e-3, 1e3), st.floats(1e-3, 0.3))
def test_sigma_grows_with_noise_and_does_not_depend_on_brightness(gain, noise):
    patch = Texture(2)()[None].astype(np.float32)
    one, other = localization(patch, 0.01), localization((patch * gain).astype(np.float32), noise)
    np.testing.assert_allclose(other.sigma_major_px, one.sigma_major_px * noise / 0.01, rtol=1e-4)
    np.testing.assert_allclose(other.harris, one.harris, rtol=1e-3)


@pytest.mark.parametrize("seed", range(3))
def test_mirrored_and_turned_patches(seed):
    patch = Texture(seed, 4.0, 0.4)().astype(np.float32)
    found = localization(np.stack([patch, patch[::-1], patch[:, ::-1], patch.T]), 0.01)
    np.testing.assert_allclose(found.sigma_major_px, found.sigma_major_px[0], rtol=1e-5)
    np.testing.assert_allclose(found.harris, found.harris[0], rtol=1e-5)
    angle = found.axis_angle_rad.astype(float)
    np.testing.assert_allclose(np.tan(angle[1:3]), -np.tan(angle[0]), rtol=1e-3)
    np.testing.assert_allclose(np.tan(angle[3]), 1.0 / np.tan(angle[0]), rtol=1e-3)


def test_harris_is_that_of_the_plain_tensor():
    patch = Texture(3)()
    g = patch / patch.mean()
    gy, gx = np.gradient(g)
    m = np.array([[(gx * gx).sum(), (gx * gy).sum()], [(gx * gy).sum(), (gy * gy).sum()]])
    expected = (np.linalg.det(m) - 0.04 * np.trace(m) ** 2) / P**4
    assert localization(patch[None].astype(np.float32), 0.01).harris[0] == pytest.approx(
        expected, rel=1e-4
    )


def test_many_patches_give_the_results_of_each_alone():
    patches = np.stack([Texture(s, waves=5)() for s in range(300)]).astype(np.float32)
    whole = localization(patches, 0.02)
    for i in (0, 255, 256, 299):
        alone = localization(patches[i : i + 1], 0.02)
        assert whole.sigma_major_px[i] == pytest.approx(alone.sigma_major_px[0], rel=1e-6)


def test_the_lit_share_counts_neither_shadow_nor_gaps():
    patch = np.ones((1, 4, 5), np.float32)
    patch[0, 0] = 0.0
    patch[0, 1, 0] = np.nan
    assert lit_share(patch) == pytest.approx([14 / 20])


@pytest.mark.parametrize("scale", [1.0, 1.3, 1.5, 2.0**0.5, 2.5, 4.0, 5.9])
def test_decimation_is_the_mean_over_the_area_of_a_coarse_pixel(scale):
    patch, fine = np.random.default_rng(1).random((P, P)), 200
    repeated = np.repeat(patch[16], fine)  # one row suffices: rows and columns are treated equally
    m = int(P / scale + 1e-9)
    edges = np.rint(((P - m * scale) / 2.0 + scale * np.arange(m + 1)) * fine).astype(int)
    expected = [repeated[a:b].mean() for a, b in pairwise(edges)]
    same_rows = np.broadcast_to(patch[16], (P, P)).astype(np.float32)
    found = decimate(np.stack([same_rows, same_rows.T]), scale)
    assert found.shape == (2, m, m)
    np.testing.assert_allclose(found[0], np.broadcast_to(expected, (m, m)), atol=0.01)
    np.testing.assert_allclose(found[1], found[0].T, rtol=1e-6)


def test_decimation_by_whole_numbers_is_block_means():
    patch = np.random.default_rng(0).random((2, 33, 33)).astype(np.float32)
    blocks = patch.reshape(2, 11, 3, 11, 3).mean(axis=(2, 4))
    np.testing.assert_allclose(decimate(patch, 3.0), blocks, rtol=1e-5)
    np.testing.assert_allclose(decimate(patch, 1.0), patch, rtol=1e-6)


def test_the_coarsest_scale_is_the_last_before_the_first_that_fails():
    patches = np.stack([Texture(1)(), 1.0 + 0.25 * (Texture(1)() - 1.0), np.ones((P, P))]).astype(
        np.float32
    )
    scales, noise = (1.0, 2.0**0.5, 2.0, 2.0**1.5, 4.0), 0.02
    limits = (0.05, 0.1, 0.02)
    for limit in limits:
        fine = np.array(
            [localization(decimate(patches, s), noise).sigma_major_px <= limit for s in scales]
        )
        climb = np.cumprod(fine, axis=0).sum(axis=0)
        expected = [scales[n - 1] if n else np.nan for n in climb]
        np.testing.assert_allclose(
            coarsest_scale(patches, noise, scales, limit), expected, rtol=1e-6
        )
    found = coarsest_scale(patches, noise, scales, 0.1)
    assert found[0] > 1.0
    assert np.isnan(found[2])
    assert np.isnan(coarsest_scale(patches, noise, scales, 0.1, min_lit=1.1)).all()
    assert (
        coarsest_scale(patches, 1e-6, (1.0, 4.0, 5.0), 0.1)[0] == 4.0
    )  # at scale 5 six pixels remain


def test_a_shift_that_is_a_gain_is_no_shift():
    row, col = np.mgrid[0:P, 0:P].astype(np.float64)
    ridge = 1.0 + 0.2 * np.sin(row / 3.0)
    grows, slopes = np.exp(0.03 * col) * ridge, Texture(1)() * ridge
    found = localization(np.stack([grows, slopes]).astype(np.float32), 0.01)
    assert found.sigma_major_px[0] > 1.0  # the plain tensor would give noise / (0.03 * 33) = 0.01
    assert found.sigma_major_px[1] < 0.1
