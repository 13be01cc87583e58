"""The facet model: comparison with the paper's formulas in 40 digits, special cases, and energy."""

from __future__ import annotations

import math

import mpmath
import numpy as np
import pytest
from helpers import twins_facet as twin
from hypothesis import given, settings
from hypothesis import strategies as st

from lcp_catalog.kernels.photometry import facet as kernel
from lcp_catalog.photometry.facet_model import (
    LIMITS,
    NAMED,
    FacetModel,
    Node,
    Optics,
    Shadowing,
    constants,
    lobes,
    named_model,
)
from lcp_catalog.photometry.laws import radiance_factor, reflectance_model

mpmath.mp.dps = 40

OURS = (0.43, 0.0080, -0.80, 0.45)
OTHERS = (0.7, 0.3, 1.5, 0.2)
GLOSSY = Node(50, 0.4, 6, 0.15, 0.9, -4, 0.85)
LAMBERT = Node(0, 0, 0, 1, 1, 0, 1)
LAMBERTS = [FacetModel("lambert", (LAMBERT,), albedo=albedo) for albedo in (0.01, 0.12, 1.0)]


def factor(model, i_deg, e_deg, phi_deg):
    """I/F of a model; directions as in the paper: phi = 0 is the side of the source."""
    i, e, phi = np.radians(np.broadcast_arrays(i_deg, e_deg, phi_deg))
    cosine = np.cos(i) * np.cos(e) + np.sin(i) * np.sin(e) * np.cos(phi)
    law = model.law
    found = [
        kernel.facet_factor(law, *three)
        for three in zip(np.cos(i).flat, np.cos(e).flat, cosine.flat, strict=True)
    ]
    return np.reshape(found, np.shape(i))


# -- formulas


@pytest.mark.parametrize("shadow", [OURS, OTHERS])
@pytest.mark.parametrize(
    ("n", "k", "degree", "xi"),
    [(1.5, 0, 0, 0), (2.4, 3.1, 0, 0), (0.6, 0, 0.5, 20), (1.3, 0.2, 1, 75)],
)
def test_the_papers_formulas(n, k, degree, xi, shadow):
    """Eq. (1) to (3) with sections 1 to 4, as printed, compared with the kernel's rearranged ones."""
    rng = np.random.default_rng(5)
    head = constants(Optics(n, k, degree, xi), Shadowing(*shadow))
    for _ in range(40):
        row = (rng.uniform(0, 3), rng.uniform(-20, 30), rng.uniform(0.05, 3), rng.uniform(0, 2))
        row += (rng.uniform(-10, 10), rng.uniform(0.5, 2))
        psi, theta, phi = rng.uniform(0, 59), rng.uniform(-89, 89), rng.uniform(-90, 90)
        found = float(lobes(Node(psi, *row), head, theta, phi))
        wanted = twin.intensity(row, psi, theta, phi, n, k, shadow, degree, xi)
        assert found == pytest.approx(float(wanted), rel=1e-11, abs=1e-13)


def test_in_the_plane_of_incidence():
    """alpha_B = (psi_B + theta) / 2, alpha_D = theta + dtheta, mirror direction theta = -psi_B: the
    paper's reductions.
    """
    psi, theta = math.radians(50), math.radians(-35)
    cos_a, cos_g = twin.half_vector(psi, theta, 0)
    assert float(cos_a) == pytest.approx(math.cos((psi + theta) / 2))
    assert float(cos_g) == pytest.approx(math.cos((psi - theta) / 2))
    angles = np.arange(-80.0, 75.0, 5.0)
    glow = lobes(Node(30, 0, 0, 1, 1, -9, 1), constants(Optics(), Shadowing()), angles)
    assert glow == pytest.approx(np.maximum(np.cos(np.radians(angles - 9)), 0), abs=1e-14)


@pytest.mark.parametrize(
    ("n", "k"), [(1.5, 0.0), (1.33, 0.01), (0.2, 3.4), (2.9, 3.0), (0.7, 0.0), (50.0, 50.0)]
)
def test_fresnel(n, k):
    """Closed forms at 0 and 90 deg, and complex amplitudes in between."""
    normal = ((n - 1) ** 2 + k**2) / ((n + 1) ** 2 + k**2)
    for polarisation in (-1.0, 0.0, 1.0):
        assert kernel.reflectivity(n, k, 1.0, polarisation) == pytest.approx(normal, rel=1e-14)
        assert kernel.reflectivity(n, k, 0.0, polarisation) == pytest.approx(1.0, rel=1e-15)
    for gamma in (1e-6, 10, 40, 44.4270040008, 45, 60, 80, 89, 89.999999):
        p, s = twin.fresnel_squares(n, k, mpmath.mpf(gamma) * mpmath.pi / 180)
        cosine = math.cos(math.radians(gamma))
        assert kernel.reflectivity(n, k, cosine, 1.0) == pytest.approx(
            float(p), rel=1e-6, abs=1e-12
        )
        assert kernel.reflectivity(n, k, cosine, -1.0) == pytest.approx(
            float(s), rel=1e-6, abs=1e-12
        )
        assert kernel.reflectivity(n, k, cosine, 0.0) == pytest.approx(float(p + s) / 2, rel=1e-6)


def test_brewster_and_total_reflection():
    brewster = math.cos(math.atan(1.5))
    assert kernel.reflectivity(1.5, 0.0, brewster, 1.0) == pytest.approx(0.0, abs=1e-30)
    assert kernel.reflectivity(1.5, 0.0, brewster, -1.0) == pytest.approx((1.25 / 3.25) ** 2)
    assert kernel.reflectivity(0.5, 0.0, math.cos(math.radians(31)), 0.3) == pytest.approx(1.0)
    assert kernel.reflectivity(1.0, 0.0, 0.0, 0.0) == 1.0


@pytest.mark.slow
def test_polarised_light_is_the_mean_of_both_sides_where_they_look_alike():
    """Incidence, emission and phase do not distinguish the sides of the plane of incidence; the
    angles do.
    """
    optics = Optics(1.5, 0.0, 1.0, 30.0)
    node = Node(40, 1, 0, 0.5, 0, 0, 1)
    model = FacetModel("p", (node,), optics)
    left, right = (float(model.brightness(40, 50, phi)) for phi in (-60, 60))
    assert abs(left - right) > 0.05 * left
    scale = kernel.scale(model.law, math.cos(math.radians(40)))
    wanted = scale * (left + right) / 2 * math.cos(math.radians(40))
    assert factor(model, 40, 50, 60) == pytest.approx(wanted, rel=1e-12)


@pytest.mark.parametrize("shadow", [OURS, OTHERS])
def test_the_limit_at_grazing_angles(shadow):
    """P / (cos psi cos theta) stays finite: at 90 deg the kernel gives the limit computed in 60
    digits.
    """
    head = constants(Optics(), Shadowing(*shadow))

    def over_cosines(psi, theta, phi):
        given = math.cos(psi), math.sin(psi), math.cos(theta), math.sin(theta)
        sure = tuple(0.0 if abs(c) < 1e-15 else c for c in given)
        return kernel.attenuation(head, *sure, math.cos(phi), math.sin(phi))[0]

    near = mpmath.pi / 2 - mpmath.mpf(10) ** -25
    for psi, theta, phi in [
        (1.2, None, 0.0),
        (1.2, None, 2.0),
        (None, 0.7, 0.3),
        (None, -0.4, 1.0),
        (None, None, 0.5),
    ]:
        a, b = (near if angle is None else mpmath.mpf(angle) for angle in (psi, theta))
        with mpmath.workdps(60):
            wanted = twin.shadowing(a, b, phi, shadow) / (mpmath.cos(a) * mpmath.cos(b))
        half = math.pi / 2
        found = over_cosines(half if psi is None else psi, half if theta is None else theta, phi)
        assert found == pytest.approx(float(wanted), rel=1e-9)


def test_a_level_facet_lies_in_the_plane_of_incidence():
    """At theta = -psi_B the profile's azimuth is 0/0; the value is the limit along phi = 0."""
    head = constants(Optics(), Shadowing(*OTHERS))
    for psi in (0.3, 1.0, 1.4):
        with mpmath.workdps(60):
            limit = twin.shadowing(
                mpmath.mpf(psi), -mpmath.mpf(psi) * (1 + mpmath.mpf(10) ** -20), 0, OTHERS
            )
        cosine, sine = math.cos(psi), math.sin(psi)
        for sides in ((cosine, -sine, 1.0, 0.0), (cosine, sine, -1.0, 1.5e-8)):
            found = kernel.attenuation(head, cosine, sine, *sides)[0] * cosine**2
            assert found == pytest.approx(float(limit), rel=1e-6)


def test_seen_from_behind_counts_as_edge_on():
    law = named_model("labunets-2019-table-3").law
    assert kernel.facet_factor(law, 0.5, -0.3, 0.2) == kernel.facet_factor(law, 0.5, 0.0, 0.2)
    assert kernel.facet_factor(law, -0.5, 0.3, 0.2) == 0.0


# -- special cases


@settings(max_examples=100, deadline=None)
@given(*[st.floats(0, 1)] * 2, st.floats(-1, 1), st.sampled_from(LAMBERTS))
def test_lambert_is_a_special_case(mu0, mu, cos_g, model):
    """sigma_D = 1, dtheta = 0, no directional lobe: A cos i for any camera direction."""
    found = kernel.facet_factor(model.law, mu0, mu, cos_g)
    assert found == pytest.approx(model.albedo * mu0, rel=1e-13)


def test_shifts_move_the_lobes_as_in_the_paper():
    angles = np.arange(-89.0, 89.5, 0.5)
    head = constants(Optics(1.0, 40.0), Shadowing(sigma_p=0.0))  # a mirror's facets, no shadows

    def summit(*row):
        return angles[lobes(Node(40, *row), head, angles).argmax()]

    assert summit(0, 0, 1, 1, -9, 1) == 9.0
    assert summit(0, 0, 1, 1, 9, 1) == -9.0
    assert summit(1, 0, 0.02, 0, 0, 1) == pytest.approx(-40.0, abs=0.5)
    assert summit(1, 12, 0.02, 0, 0, 1) == pytest.approx(-52.0, abs=0.5)
    assert summit(1, 0, 10, 0, 0, 1) > 40.0  # sigma_B >> 1: back at the source


def test_the_azimuth_does_not_matter_at_normal_incidence():
    """An isotropic surface: the model's variation of 40 % with azimuth is averaged, without a step."""
    model = named_model("labunets-2019-table-3")
    around = np.linspace(0, 180, 37)
    raw = model.brightness(0.0, 40.0, around)
    assert np.ptp(raw) / raw.mean() > 0.1
    scale = kernel.scale(model.law, 1.0)
    for theta in (0.0, 20.0, 40.0, 75.0):
        ring = factor(model, 0.0, theta, around)
        assert np.ptp(ring) <= 1e-12
        mean = model.brightness(0.0, theta, np.linspace(1, 179, 90)).mean()
        assert ring[0] == pytest.approx(scale * mean, rel=1e-3)
    for i in (1e-9, 1e-5, 0.01, 0.1):
        ring = factor(model, i, 40.0, around)
        assert np.ptp(ring) / ring.mean() < 1e-3
    steps = factor(model, np.linspace(0, 8, 801), 40.0, 60.0)
    assert np.abs(np.diff(steps)).max() < 2e-3 * steps.mean()


def test_constant_beyond_the_measurements():
    model = FacetModel(
        "m", (Node(10, *GLOSSY[1:]), Node(60, 0.2, 3, 0.3, 1, 5, 0.9)), largest_emission_deg=70
    )
    assert model.parameters(75)[1:] == pytest.approx(model.parameters(60)[1:], rel=1e-14)
    assert model.parameters(2)[1:] == pytest.approx(model.parameters(10)[1:], rel=1e-14)
    beyond = factor(model, 60, np.array([70.0, 75, 85, 90]), 120)
    assert beyond == pytest.approx(np.full(4, beyond[0]), rel=1e-12)
    assert factor(model, 60, 69, 120) != pytest.approx(beyond[0], rel=1e-4)


def test_measured_levels_are_kept():
    """Brightness 1 of the model is the level of its node; between nodes a curve; the reflectance is
    at most 1.
    """
    nodes = (Node(0, *LAMBERT[1:]), Node(40, *LAMBERT[1:]), Node(80, *LAMBERT[1:]))
    model = FacetModel("m", nodes, levels=(0.3, 0.2, 0.5))
    angles = np.array([0.0, 40, 80, 89])
    found = factor(model, angles, 30, 90) / np.cos(np.radians(angles))
    assert found == pytest.approx([0.3, 0.2, 0.5, 0.5], rel=3e-3)
    bright = FacetModel("m", nodes, levels=(3.0, 3.0, 3.0))
    assert bright.reflectance([0, 50]) == pytest.approx([1.0, 1.0])


# -- anywhere


def nodes():
    def inside(name, low=None, high=None):
        least, most = LIMITS[name]
        return st.floats(least if low is None else low, most if high is None else high)

    rows = st.tuples(
        inside("w_b", high=1e3),
        inside("shift_b_deg"),
        inside("sigma_b", low=0.3),
        inside("w_d", low=1e-3, high=1e3),
        inside("shift_d_deg"),
        inside("sigma_d"),
    )
    angles = st.lists(st.integers(0, 89), min_size=1, max_size=4, unique=True)
    return angles.flatmap(
        lambda found: st.tuples(*[rows] * len(found)).map(
            lambda many: tuple(
                Node(float(a), *row) for a, row in zip(sorted(found), many, strict=True)
            )
        )
    )


EDGES = [0.0, 1.0, 1e-300, 1e-17, 1e-9, 1e-4, 1 - 1e-16, 1 - 1e-9, 0.5]


@pytest.mark.slow
@settings(max_examples=8, deadline=None)  # a model's table takes 0.1 s
@given(nodes(), st.sampled_from([5.0, 60.0, 80.0, 89.0]), st.data())
def test_finite_and_not_negative_anywhere(many, held, data):
    optics = data.draw(st.sampled_from([Optics(), Optics(0.5), Optics(0.2, 4.0, 1.0, 45.0)]))
    shadow = data.draw(
        st.sampled_from([Shadowing(), Shadowing(sigma_p=0.0), Shadowing(9, 9, -1, 9)])
    )
    model = FacetModel("any", many, optics, shadow, held)
    law = model.law
    assert np.isfinite(law).all()
    cosine = st.sampled_from(EDGES) | st.floats(0, 1)
    for _ in range(75):
        mu0, mu = data.draw(cosine), data.draw(cosine) * data.draw(st.sampled_from([1, 1, -1]))
        value = kernel.facet_factor(
            law, mu0, mu, data.draw(st.floats(-1, 1) | st.sampled_from([-1.0, 1.0]))
        )
        assert math.isfinite(value)
        assert value >= 0.0


def test_nothing_shadowed_at_grazing_light():
    """psi_B = 90 deg and sigma_P = 0: eq. (1) has no limit, but the value is finite."""
    model = FacetModel("m", (GLOSSY,), shadowing=Shadowing(sigma_p=0.0))
    assert np.isfinite(factor(model, np.array([84.0, 86, 89, 90]), 30.0, 180.0)).all()


@settings(max_examples=100, deadline=None)
@given(
    st.floats(-90, 90),
    st.floats(-90, 90),
    st.floats(-180, 180),
    st.floats(-60, 60),
    st.sampled_from([0.0, 40.0, 90.0]),
)
def test_the_bare_intensity_is_finite_too(theta, theta_d, phi, shift, psi):
    node = Node(min(psi, 89.9), 1, shift, 0.1, 1, theta_d / 2.5, 0.9)
    value = lobes(node, constants(Optics(), Shadowing()), theta, phi)
    assert np.isfinite(value)
    assert value >= 0.0


@pytest.mark.parametrize("name", NAMED)
def test_energy(name):
    """The light reflected into the hemisphere is the albedo at every incidence, by a plain sum over
    directions.
    """
    model = named_model(name)
    theta = np.radians(np.arange(0.5, 90, 1.0))
    phi = np.radians(np.arange(1.5, 180, 3.0))
    weight = np.sin(2 * theta) * np.radians(1.0)
    for i in (0.0, 3.0, 10.0, 27.0, 45.0, 60.0, 70.0, 82.0):
        psi = math.radians(i)
        cosine = math.cos(psi) * np.cos(theta[:, None]) + math.sin(psi) * np.sin(
            theta[:, None]
        ) * np.cos(phi)
        values = radiance_factor(
            reflectance_model(f"facet:{name}"), psi, theta[:, None], np.arccos(cosine)
        )
        whole = (values.mean(axis=1) * weight).sum() / math.cos(psi)
        assert whole == pytest.approx(model.albedo, rel=5e-3)
    assert model.reflectance([0, 33, 77, 89]) == pytest.approx(np.full(4, model.albedo), rel=5e-3)


def shadowing_share(shadowing, incidence_deg, theta_deg):
    """P of eq. (3) in the plane of incidence: share of the facets in specular position that are
    neither shadowed nor masked.
    """
    head = constants(Optics(), shadowing)
    psi, angles = math.radians(incidence_deg), np.radians(theta_deg)
    cosine = math.cos(psi)
    found = [
        kernel.attenuation(head, cosine, math.sin(psi), math.cos(t), math.sin(t), 1.0, 0.0)[0]
        * (cosine * math.cos(t))
        for t in angles.ravel()
    ]
    return np.array(found).reshape(angles.shape)


def test_shadowing_share():
    theta = np.array([-89.9, -60, -30, 0.0, 30, 60, 89.9])
    share = shadowing_share(Shadowing(), 30, theta)
    assert (share > 0).all()
    assert (share <= 1).all()
    assert share[[0, -1]].max() < 0.1
    assert share[3] > 0.98
    assert shadowing_share(Shadowing(sigma_p=0.0), 30, theta) == pytest.approx(np.ones(7))
