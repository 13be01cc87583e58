"""Hapke's model: comparison with the textbook in 60 digits, with another implementation, and with
its limits.
"""

from __future__ import annotations

import math

import mpmath
import numpy as np
import pytest
from helpers import twins_reflectance as twin
from hypothesis import given, settings
from hypothesis import strategies as st

from lcp_catalog.errors import ConfigError
from lcp_catalog.kernels.photometry.hapke import h_function, hapke_factor, hapke_terms
from lcp_catalog.photometry.hapke_sets import DEFAULT_SET, SETS, HapkeSet, backward_share, hapke_set
from lcp_catalog.photometry.laws import radiance_factor, reflectance_model

FULL = HapkeSet("all effects", 0.5, 0.3, 0.2, 1.2, 0.08, 0.6, 0.02, 0.3, 25.0)
SMOOTH = HapkeSet("smooth", 0.3854, 0.2375, 0.3253, 1.686, 0.0672, theta_bar_deg=0.0)
ROUGH = HapkeSet("rough", 0.95, 0.4, -0.1, 0.5, 0.1, 0.4, 0.1, 0.5, 50.0)
LAWS = [*SETS.values(), FULL, SMOOTH, ROUGH]
EACH = pytest.mark.parametrize("parameters", LAWS, ids=lambda p: p.name)


def factor(parameters: HapkeSet, mu0: float, mu: float, cos_g: float) -> float:
    law = np.array(parameters.law)
    return hapke_factor(law, hapke_terms(law, cos_g), mu0, mu, cos_g)


def of_angles(parameters: HapkeSet, incidence, emission, azimuth):
    """I/F of a level surface by incidence, emission and azimuth, degrees."""
    i, e, psi = (np.radians(np.asarray(a, float)) for a in (incidence, emission, azimuth))
    return radiance_factor(twin.of_hapke(parameters), i, e, twin.phase_angle(i, e, psi))


# incidence, emission, azimuth: I/F under wac-643 and wac-643-mare.
# peer_reflectance.py of c896266: theirs(), eradiate-mitsuba 0.5.0, variant scalar_mono_double
PEER = {
    (30, 0, 0): (0.09782742576092704, 0.050321200112225774),
    (60, 0, 0): (0.04582258422867649, 0.02279704993836425),
    (0, 50, 0): (0.09764898947061838, 0.048931691236665416),
    (60, 60, 0): (0.21782621522534035, 0.12904438460128034),
    (60, 60, 180): (0.03411913324480127, 0.018396930022313313),
    (45, 20, 90): (0.07122540006089983, 0.03576668045491926),
    (20, 45, 90): (0.09465328947551754, 0.04753127333483789),
    (80, 70, 30): (0.04586989966768707, 0.02392443070623104),
    (70, 80, 150): (0.018968018433970595, 0.010991949202176074),
    (89, 10, 60): (0.001530824041124692, 0.0007667568038397574),
    (10, 89, 60): (0.08638163393768192, 0.04326670065871921),
    (89, 88, 170): (0.00024087641890280885, 0.0001567015061961741),
}


@pytest.mark.parametrize("column", [0, 1])
def test_an_implementation_of_others(column):
    angles = np.array(list(PEER), dtype=float).T
    expected = np.array([values[column] for values in PEER.values()])
    name = ("wac-643", "wac-643-mare")[column]
    assert of_angles(SETS[name], *angles) == pytest.approx(expected, rel=1e-11)


def bracket(
    parameters: HapkeSet, mu0: float, mu: float, cos_g: float, off: float
) -> tuple[float, float]:
    """Values of the model in 60 digits for these cosines, and for a phase whose cosine is ``off``
    to either side.
    """
    with mpmath.workdps(twin.DIGITS):
        near = {mpmath.mpf(cos_g) + k * mpmath.mpf(off) for k in (-1, 0, 1)}
        values = [float(twin.hapke(parameters, mu0, mu, min(1, max(-1, c)))) for c in near]
    return min(values), max(values)


def cosine_of_phase(mu0, mu, azimuth):
    cos_g = mu0 * mu + math.sqrt((1 - mu0) * (1 + mu0) * (1 - mu) * (1 + mu)) * math.cos(azimuth)
    return min(1.0, max(-1.0, cos_g))


def agrees(parameters, mu0, mu, azimuth):
    """Agreement to 1e-11. Near the principal plane, and near grazing or vertical views, three
    cosines determine the azimuth only to an error of 4e-16 in the cosine of the phase.
    """
    cos_g = cosine_of_phase(mu0, mu, azimuth)
    ours = factor(parameters, mu0, mu, cos_g)
    for off in (0.0, 4e-16):
        low, high = bracket(parameters, mu0, mu, cos_g, off)
        if low * (1 - 1e-11) - 1e-300 <= ours <= high * (1 + 1e-11):
            return
    raise AssertionError(f"{ours} of {low} to {high}: {parameters.name}, {mu0}, {mu}, {azimuth}")


@pytest.mark.slow
@settings(deadline=None, max_examples=120)
@given(
    st.sampled_from(LAWS),
    st.floats(1e-9, 1.0),
    st.floats(1e-9, 1.0),
    st.floats(0.0, math.pi),
)
def test_the_textbook_in_sixty_digits(parameters, mu0, mu, azimuth):
    agrees(parameters, mu0, mu, azimuth)


TINY = (1e-12, 1e-9, 1e-6, 1e-3, 0.02)


@pytest.mark.slow
@pytest.mark.parametrize("parameters", [SETS["wac-643"], FULL, SMOOTH, ROUGH], ids=lambda p: p.name)
@pytest.mark.parametrize("azimuth", [0.0, 1e-6, 1.0, math.pi - 1e-6, math.pi])
def test_corners_have_their_limits(parameters, azimuth):
    """Both directions near the vertical, near grazing, and one of each; opposition, and its
    opposite.
    """
    ends = (*TINY, *(1.0 - t for t in TINY[1:]), 1.0)
    for mu0 in ends:
        for mu in ends:
            agrees(parameters, mu0, mu, azimuth)


@EACH
def test_grazing_light_goes_to_zero(parameters):
    """mu0 -> 0 at any emission: linearly to 0; finite at grazing emission."""
    for mu in (0.0, 1e-12, 0.3, 1.0):
        for cos_g in (-1.0, -0.3, 0.0, math.sqrt(1 - mu**2)):
            assert factor(parameters, 5e-324, mu, cos_g) < 1e-10
            tiny, half = factor(parameters, 1e-9, mu, cos_g), factor(parameters, 5e-10, mu, cos_g)
            if mu > 0.1:
                assert tiny == pytest.approx(2 * half, rel=1e-6)
    edge = [factor(parameters, 0.5, mu, 0.3) for mu in (1e-12, 0.0, -0.0, -0.4)]
    assert edge == pytest.approx([edge[0]] * 4, rel=1e-9)


@EACH
def test_reciprocity_to_the_last_bit(parameters):
    rng = np.random.default_rng(2)
    for _ in range(300):
        mu0, mu, azimuth = rng.uniform(1e-6, 1), rng.uniform(1e-6, 1), rng.uniform(0, math.pi)
        cos_g = mu0 * mu + math.sqrt((1 - mu0**2) * (1 - mu**2)) * math.cos(azimuth)
        there, back = factor(parameters, mu0, mu, cos_g), factor(parameters, mu, mu0, cos_g)
        assert there / mu0 == pytest.approx(back / mu, rel=1e-15)


def test_no_roughness_is_the_limit_of_small_roughness():
    """First order in tan(theta): a hundredth of the slope leaves a hundredth of the difference,
    down to no roughness.
    """
    angles = np.array([(30, 20, 40), (60, 10, 170), (10, 60, 90), (70, 70, 5)]).T
    bare = of_angles(SMOOTH, *angles)
    left = []
    for theta in (1.0, 1e-2, 1e-4, 1e-9, 1e-20):
        slight = HapkeSet(
            "slight", *(SMOOTH.w, SMOOTH.b, SMOOTH.c, SMOOTH.b_s0, SMOOTH.h_s), theta_bar_deg=theta
        )
        left.append(np.abs(of_angles(slight, *angles) / bare - 1).max())
    assert left[0] < 2e-2
    assert left[1] < 2e-5
    assert left[2:] == pytest.approx([0, 0, 0], abs=1e-8)


def test_without_roughness_it_is_the_plain_formula():
    """Hapke 2012, eq. 8.89: w/4 mu0/(mu0 + mu) ((1 + B) p + H H - 1)."""
    i, e, psi = np.radians([35.0, 50.0, 110.0])
    g = float(twin.phase_angle(i, e, psi))
    w, mu0, mu = SMOOTH.w, math.cos(i), math.cos(e)
    surge = 1 + SMOOTH.b_s0 / (1 + math.tan(g / 2) / SMOOTH.h_s)
    h = float(twin.h_function(mu0, mpmath.mpf(w)) * twin.h_function(mu, mpmath.mpf(w)))
    expected = w / 4 * mu0 / (mu0 + mu) * (surge * SMOOTH.phase(math.cos(g)) + h - 1)
    assert of_angles(SMOOTH, 35.0, 50.0, 110.0) == pytest.approx(expected, rel=1e-13)


# -- the pieces


@pytest.mark.parametrize(("b", "c"), [(0.0, 0.0), (0.2375, 0.3253), (0.5, -0.4), (0.3, 1.0)])
def test_the_phase_function_scatters_all_there_is(b, c):
    parameters = HapkeSet("p", 0.3, b, c, 0.0, 0.0)
    nodes, weights = np.polynomial.legendre.leggauss(60)
    assert weights @ [parameters.phase(x) for x in nodes] / 2 == pytest.approx(1.0, rel=1e-12)
    law = np.array(parameters.law)
    for x in (-1.0, -0.2, 1.0):
        assert hapke_terms(law, x)[0] == pytest.approx(parameters.phase(x), rel=1e-14)
        assert float(twin.phase_function(parameters, mpmath.mpf(x))) == pytest.approx(
            parameters.phase(x), rel=1e-14
        )


def test_the_surges_are_full_at_opposition_and_gone_opposite():
    shadow = HapkeSet("s", 0.5, 0.0, 0.0, 1.7, 0.05)
    coherent = HapkeSet("c", 0.5, 0.0, 0.0, 0.0, 0.0, 0.9, 0.03)

    def at(parameters, g):
        return np.array(hapke_terms(np.array(parameters.law), math.cos(g)))

    assert at(shadow, 0.0) == pytest.approx([2.7, 0.125], rel=1e-15)
    assert at(shadow, math.pi) == pytest.approx([1.0, 0.125], rel=1e-12)
    assert at(shadow, 2 * math.atan(0.05))[0] == pytest.approx(1 + 1.7 / 2, rel=1e-12)
    assert at(coherent, 0.0) == pytest.approx([1.0, 0.125 * 1.9], rel=1e-15)
    assert at(coherent, math.pi) == pytest.approx([1.0, 0.125], rel=1e-12)
    # x = 1: (1 + (1 - 1/e)) / (2 * 4)
    assert at(coherent, 2 * math.atan(0.03))[1] == pytest.approx(
        0.125 * (1 + 0.9 * (2 - math.exp(-1)) / 8)
    )
    narrow = [at(coherent, g)[1] for g in (0.0, 1e-12, 1e-9, 1e-7)]
    assert narrow == pytest.approx([narrow[0]] * 4, rel=2e-5)
    for parameters in (shadow, coherent):
        curve = np.array([at(parameters, g).prod() for g in np.linspace(0, math.pi, 721)])
        assert (np.diff(curve) <= 1e-15).all()


# Chandrasekhar, Radiative Transfer, table XI, as quoted in other tests: H(1) = 2.9078 at w = 1
def test_the_h_function_of_all_light():
    assert h_function(1.0, 1.0, 1.0) == pytest.approx(2.9078, rel=0.01)


@pytest.mark.parametrize("w", [0.1, 0.3854, 0.9])
def test_the_h_function_is_chandrasekhars_within_a_percent(w):
    r0 = (1 - math.sqrt(1 - w)) / (1 + math.sqrt(1 - w))
    nodes, weights = np.polynomial.legendre.leggauss(80)
    x, weights = (nodes + 1) / 2, weights / 2
    h = np.ones(80)
    for _ in range(400):  # 1/H = sqrt(1 - w) + w/2 int y H(y) / (x + y) dy
        h = 1 / (math.sqrt(1 - w) + w / 2 * ((weights * x * h) / (x[:, None] + x)).sum(axis=1))
    ours = np.array([h_function(v, w, r0) for v in x])
    assert ours == pytest.approx(h, rel=0.01)
    assert [h_function(v, w, r0) for v in (1e-300, 1e-12)] == pytest.approx([1, 1], abs=1e-10)


def test_porosity():
    """K is 1 for loose soil, increases with filling, and has its pole at 0.752."""
    loose, packed = HapkeSet("l", 0.3, 0, 0, 0, 0), HapkeSet("p", 0.3, 0, 0, 0, 0, filling=0.41)
    assert loose.porosity == 1.0
    assert HapkeSet("s", 0.3, 0, 0, 0, 0, filling=1e-9).porosity == pytest.approx(1.0, abs=1e-6)
    # -ln(1 - 0.6673) / 0.6673, by hand: 0.41^(2/3) = 0.55190
    assert packed.porosity == pytest.approx(1.6495, rel=1e-3)
    with pytest.raises(ConfigError, match="filling"):
        HapkeSet("full", 0.3, 0, 0, 0, 0, filling=0.7525)


# -- the sets


def test_the_sets_are_the_published_ones():
    """Values of Sato et al. (2014) and their product, as quoted in the sources named in
    `hapke_sets`.
    """
    typical = hapke_set(DEFAULT_SET)
    assert (typical.c, typical.b_s0) == pytest.approx((0.3253, 1.686), rel=2e-3)
    assert backward_share(0.26) == pytest.approx(0.107, abs=1e-3)
    for found in SETS.values():
        assert found.theta_bar_deg == 23.657
        assert (found.b_c0, found.porosity) == (0.0, 1.0)
    # the maria are darker and scatter less of it back, the highlands the other way
    mare, high = SETS["wac-643-mare"], SETS["wac-643-highland"]
    assert mare.w < typical.w < high.w
    assert mare.c < typical.c < high.c
    assert SETS["wac-566-mare"].w < mare.w


def test_the_brightness_of_the_typical_moon():
    """I/F 0.05 at incidence and phase 60 deg, emission 0, for median parameters at 643 nm: the
    value of an independent program that reads the product itself.
    """
    assert of_angles(SETS["wac-643"], 60.0, 0.0, 0.0) == pytest.approx(0.05, rel=0.1)


def test_the_brightness_of_the_mare_in_nac_images():
    """LROC NAC, 760 000 tiles, 600 nm: exp(-2.9811422 - 0.0112862 g - 0.8084603 mu + 1.3248888
    mu0), g in degrees (abstract 2826 of LPSC 2014, coefficients of ISIS's lronacpho): another
    camera, another model, another fit.
    """
    for incidence in (30.0, 40.0, 50.0, 60.0, 70.0):
        mu0 = math.cos(math.radians(incidence))
        seen = math.exp(-2.9811422 - 0.0112862 * incidence - 0.8084603 + 1.3248888 * mu0)
        assert of_angles(SETS["wac-643-mare"], incidence, 0.0, 0.0) == pytest.approx(seen, rel=0.12)


@pytest.mark.parametrize(
    ("wrong", "named"),
    [
        ({"w": 0.0}, "w"),
        ({"w": 1.01}, "w"),
        ({"b": 1.0}, "b"),
        ({"c": 9.0}, "c"),
        ({"c": math.nan}, "c"),
        ({"h_s": -0.1}, "h_s"),
        ({"b_c0": -1.0}, "b_c0"),
        ({"theta_bar_deg": 61.0}, "theta_bar_deg"),
        ({"w": math.nan}, "w"),
    ],
)
def test_parameters_outside_the_model(wrong, named):
    right = {"name": "x", "w": 0.3, "b": 0.2, "c": 0.1, "b_s0": 1.0, "h_s": 0.1}
    with pytest.raises(ConfigError, match=named):
        HapkeSet(**(right | wrong))


def test_unknown_sets():
    with pytest.raises(ConfigError, match=r"'moon'.*wac-643, wac-643-mare"):
        hapke_set("moon")
    with pytest.raises(ConfigError, match="no parameter set after"):
        reflectance_model("hapke:")
    assert reflectance_model("hapke").law == reflectance_model("hapke:wac-643").law
