"""The photometric models against the textbook's formulae."""

import numpy as np
import pytest

from lcp_catalog.errors import ConfigError
from lcp_catalog.kernels.reflectance import radiance_factor, shade_nodes
from lcp_catalog.reflectance import MODELS, model_code, photometry
from lcp_catalog.sphere import direction_enu

UP = np.array([0.0, 0.0, 1.0])


def shade(normals, sun, camera, model="lommel-seeliger", lit=True, seen=True):
    normals = np.atleast_2d(np.asarray(normals, float))
    flags = [np.full(len(normals), flag) for flag in (lit, seen)]
    return photometry(normals, np.asarray(sun, float), np.asarray(camera, float), *flags, model)


@pytest.mark.parametrize("elevation", [90.0, 60.0, 14.0, 0.5])
def test_level_ground_straight_down(elevation):
    mu0 = np.sin(np.radians(elevation))
    sun = direction_enu(77.0, elevation)
    ls = shade(UP, sun, UP)
    assert ls.radiance == pytest.approx(0.21 / 4 * mu0 / (mu0 + 1))
    assert shade(UP, sun, UP, "lambert").radiance == pytest.approx(0.12 * mu0)
    assert np.degrees(ls.incidence) == pytest.approx(90 - elevation)
    assert np.degrees(ls.emission) == pytest.approx(0.0, abs=1e-12)
    assert np.degrees(ls.phase) == pytest.approx(90 - elevation, abs=1e-12)


def test_phase_is_an_angle_not_a_sum():
    """Sun and camera on the same side: the phase is the difference of incidence and emission, on
    other sides their sum.
    """
    sun = direction_enu(90.0, 30.0)
    same = shade(UP, sun, direction_enu(90.0, 50.0))
    other = shade(UP, sun, direction_enu(270.0, 50.0))
    across = shade(UP, sun, direction_enu(0.0, 50.0))
    assert np.degrees(same.phase) == pytest.approx(60 - 40)
    assert np.degrees(other.phase) == pytest.approx(60 + 40)
    # spherical law of cosines, azimuths 90 deg apart
    cosine = np.cos(np.radians(60)) * np.cos(np.radians(40))
    assert np.degrees(across.phase) == pytest.approx(np.degrees(np.arccos(cosine)))


def test_twin_in_plain_numpy():
    rng = np.random.default_rng(3)
    normals = rng.normal((0, 0, 3), 1, size=(500, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    cameras = rng.normal(size=(500, 3)) * 0.2 + [0, 0, 1]
    cameras /= np.linalg.norm(cameras, axis=1)[:, None]
    sun = direction_enu(200.0, 35.0)
    lit, seen = rng.random(500) < 0.8, rng.random(500) < 0.8
    result = photometry(normals, sun, cameras, lit, seen)
    mu0, mu = normals @ sun, np.sum(normals * cameras, axis=1)
    twin = 0.21 / 4 * np.maximum(mu0, 0) / (np.maximum(mu0, 0) + np.maximum(mu, 0))
    twin = np.where(seen, np.where(lit, twin, 0.0), np.nan)
    assert np.allclose(result.radiance, twin, equal_nan=True, rtol=1e-12)
    assert np.allclose(result.incidence, np.arccos(mu0))
    assert np.allclose(result.emission, np.arccos(mu))
    assert np.allclose(result.phase, np.arccos(cameras @ sun))


def test_finite_where_nothing_divides():
    horizon = np.array([1.0, 0.0, 0.0])
    for model in MODELS:
        assert shade(UP, horizon, horizon, model).radiance == 0.0
        assert shade(UP, horizon, -horizon, model).radiance == 0.0
        assert shade(UP, [0.6, 0, -0.8], UP, model).radiance == 0.0
    for mu0 in (5e-324, 1e-300, 1e-8, 1.0):
        for mu in (-1.0, 0.0, 1e-300, 1.0):
            assert 0 <= radiance_factor(0, mu0, mu) <= 0.21 / 4


def test_nodata_and_the_unseen_are_nan():
    result = shade([[np.nan] * 3], UP, UP)
    assert all(np.isnan(band).all() for band in result)
    hidden = shade(UP, UP, UP, seen=False)
    assert np.isnan(hidden.radiance)
    assert hidden.incidence == 0.0


def test_nodes_of_a_sweep_shade_like_points():
    rng = np.random.default_rng(5)
    normals = rng.normal((0, 0, 2), 1, size=(20, 30, 3))
    normals = (normals / np.linalg.norm(normals, axis=-1, keepdims=True)).astype(np.float32)
    normals[3, 4] = np.nan
    dark, unseen = rng.random((2, 20, 30)) < 0.2
    sun, camera = direction_enu(30.0, 20.0), direction_enu(120.0, 60.0)
    image = shade_nodes(normals, sun, camera, dark, unseen, model_code("lommel-seeliger"))
    seen = ~unseen & (normals @ camera > 0)
    points = photometry(normals, sun, camera, ~dark, seen).radiance
    assert image.dtype == np.float32
    assert np.allclose(image, points, equal_nan=True, rtol=1e-5, atol=1e-9)


def test_unknown_model():
    with pytest.raises(ConfigError, match=r"hapkee.*lommel-seeliger, lambert"):
        model_code("hapkee")
