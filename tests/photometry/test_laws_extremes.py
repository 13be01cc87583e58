"""Photometry at incidence, emission and phase of 0, 90 and 180 degrees and very close to them,
compared with textbook formulas in 40 digits for the same vectors.
"""

from __future__ import annotations

import itertools
import math

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lcp_catalog.choices import REFLECTANCE_MODELS
from lcp_catalog.kernels.photometry.images import shade_nodes
from lcp_catalog.photometry.laws import photometry, reflectance_model

mpmath.mp.dps = 40

TINY_DEG = [1e-12, 1e-6, 0.1]
EXTREMES_DEG = sorted(
    {0.0, 30.0, 90.0, 180.0}
    | {90.0 + sign * tiny for tiny in TINY_DEG for sign in (-1, 1)}
    | set(TINY_DEG)
    | {180.0 - tiny for tiny in TINY_DEG}
)
UP = np.array([0.0, 0.0, 1.0])
BRIGHTEST = 0.12 * (1 + 1e-15)
"""Lambert under the zenith; a unit vector's length is 1 to the last bits."""
SCALES = {
    "lommel-seeliger": lambda mu0, mu: mpmath.mpf("0.21") / 4 * mu0 / (mu0 + mu),
    "lambert": lambda mu0, mu: mpmath.mpf("0.12") * mu0,
}
KNOWN = pytest.mark.parametrize("model", SCALES)


def tilted(angle_deg: float, azimuth_deg: float = 0.0) -> np.ndarray:
    """Unit vector at an angle from the zenith; exact at 90 and 180 degrees."""
    a, z = math.radians(azimuth_deg), math.radians(angle_deg)
    level, up = {0.0: (0.0, 1.0), 90.0: (1.0, 0.0), 180.0: (0.0, -1.0)}.get(
        angle_deg, (math.sin(z), math.cos(z))
    )
    return np.array([level * math.sin(a), level * math.cos(a), up])


def exact_angle(a, b):
    """Angle between two float vectors in extended precision."""
    a, b = mpmath.matrix(list(map(float, a))), mpmath.matrix(list(map(float, b)))
    dot = sum(x * y for x, y in zip(a, b, strict=True))
    cross = [a[(k + 1) % 3] * b[(k + 2) % 3] - a[(k + 2) % 3] * b[(k + 1) % 3] for k in range(3)]
    return mpmath.atan2(mpmath.sqrt(sum(c * c for c in cross)), dot), dot


def exact_radiance(model, normal, sun, camera):
    """I/F by the formula; 0 on a face that the Sun does not reach; a face seen from behind counts
    as seen edge-on.
    """
    mu0, mu = exact_angle(normal, sun)[1], max(exact_angle(normal, camera)[1], mpmath.mpf(0))
    return SCALES[model](mu0, mu) if mu0 > 0 else mpmath.mpf(0)


def shade(normal, sun, camera, model, lit=True, seen=True):
    flags = np.array([lit]), np.array([seen])
    return [
        float(band[0])
        for band in photometry(normal[None], sun, camera, *flags, reflectance_model(model))
    ]


def agree(result, normal, sun, camera, model):
    radiance, *angles = result
    for got, (a, b) in zip(angles, ((normal, sun), (normal, camera), (sun, camera)), strict=True):
        assert got == pytest.approx(float(exact_angle(a, b)[0]), rel=4e-16, abs=4e-16)
    want = float(exact_radiance(model, normal, sun, camera))
    mu0, mu = float(normal @ sun), max(float(normal @ camera), 0.0)
    # a cosine near 0 is a difference of products with an absolute error of 2e-16; the error of a
    # ratio of two such cosines is relative to their sum
    slack = 1e-15 if model == "lambert" else 1e-15 / max(abs(mu0) + mu, 1e-15)
    assert radiance == pytest.approx(want, rel=1e-14, abs=0.0525 * slack)
    assert 0.0 <= radiance <= BRIGHTEST


@pytest.mark.slow
@KNOWN
def test_level_ground(model):
    azimuths = (0.0, 45.0, 90.0, 180.0)
    for incidence, emission, azimuth in itertools.product(EXTREMES_DEG, EXTREMES_DEG, azimuths):
        sun, camera = tilted(incidence), tilted(emission, azimuth)
        agree(shade(UP, sun, camera, model), UP, sun, camera, model)


@KNOWN
def test_phase_on_slopes(model):
    """Sun and camera in one direction, perpendicular, opposite, and close to these, on random slopes."""
    rng = np.random.default_rng(11)
    for phase in np.repeat(EXTREMES_DEG, 12):
        normal = rng.normal(size=3)
        normal /= np.linalg.norm(normal)
        sun = rng.normal(size=3)
        sun /= np.linalg.norm(sun)
        aside = np.cross(sun, normal)
        aside /= np.linalg.norm(aside)
        camera = math.cos(math.radians(phase)) * sun + math.sin(math.radians(phase)) * aside
        agree(shade(normal, sun, camera, model), normal, sun, camera, model)


@settings(deadline=None, max_examples=200)
@given(
    vectors=st.lists(
        st.tuples(*[st.sampled_from([0.0, 1.0, -1.0, 1e-9, -1e-17, 1e-160, 0.6, 0.8])] * 3).filter(
            lambda v: max(map(abs, v)) > 1e-10
        ),
        min_size=3,
        max_size=3,
    ),
    model=st.sampled_from(sorted(SCALES)),
    lit=st.booleans(),
    seen=st.booleans(),
)
def test_never_nan_where_seen(vectors, model, lit, seen):
    normal, sun, camera = (np.array(v) / np.linalg.norm(v) for v in vectors)
    radiance, *angles = shade(normal, sun, camera, model, lit, seen)
    assert all(0.0 <= angle <= math.pi for angle in angles)
    if not seen:
        assert math.isnan(radiance)
    elif not lit:
        assert radiance == 0.0
    else:
        assert 0.0 <= radiance <= BRIGHTEST
        agree([radiance, *angles], normal, sun, camera, model)


@KNOWN
def test_the_brightness_of_the_limb(model):
    """Full Moon: Lommel-Seeliger's disc is uniform to its edge, Lambert's falls to 0 there."""
    for incidence in (0.0, 60.0, 89.999999, 90.0 - 1e-12):
        radiance = shade(UP, tilted(incidence), tilted(incidence), model)[0]
        even = 0.21 / 8 if model == "lommel-seeliger" else 0.12 * math.cos(math.radians(incidence))
        assert radiance == pytest.approx(even, rel=1e-3 if incidence > 89.99999 else 1e-12)
    assert shade(UP, tilted(90.0), tilted(90.0), model)[0] == 0.0
    assert shade(UP, tilted(90.0), UP, model)[0] == 0.0
    graze = shade(UP, UP, tilted(90.0), model)[0]
    assert graze == pytest.approx(0.21 / 4 if model == "lommel-seeliger" else 0.12)


@KNOWN
def test_nodes_of_a_sweep_stay_finite_where_seen(model):
    """float32 normals in the sweep's kernel, for every pair of extremes."""
    sides = [tilted(angle, azimuth) for angle in EXTREMES_DEG for azimuth in (0.0, 90.0, 200.0)]
    normals = np.array(sides, dtype=np.float32)[None]
    planes = np.ascontiguousarray(np.moveaxis(normals, -1, 0))
    law = reflectance_model(model)
    for sun in sides[::2]:
        for camera in sides[1::3]:
            dark = np.zeros(normals.shape[:2], dtype=bool)
            image = shade_nodes(
                planes, sun, camera, dark.view(np.uint8), dark, law.code, law.numbers
            )
            mu0, mu = normals.astype(float) @ sun, normals.astype(float) @ camera
            assert (np.isnan(image) == ~(mu > 0)).all()
            assert (image[(mu > 0) & (mu0 <= 0)] == 0).all()
            assert np.nanmax(image, initial=0.0) <= BRIGHTEST
            assert np.nanmin(image, initial=0.0) >= 0.0
            black = shade_nodes(
                planes, sun, camera, (~dark).view(np.uint8), dark, law.code, law.numbers
            )
            assert (black[mu > 0] == 0).all()


def test_every_model_is_finite_at_the_extremes():
    """Finite and not negative for every model of the library, including later ones."""
    assert set(REFLECTANCE_MODELS) >= set(SCALES)
    for model in REFLECTANCE_MODELS:
        for incidence in EXTREMES_DEG:
            for emission in EXTREMES_DEG:
                radiance = shade(UP, tilted(incidence), tilted(emission, 90.0), model)[0]
                assert math.isfinite(radiance)
                assert radiance >= 0.0
                assert radiance == 0.0 or incidence < 90.0
