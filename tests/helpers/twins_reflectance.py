"""Slow reference computations of the reflectance models: textbook formulas in many digits, and
plain integrals.
"""

from __future__ import annotations

import math

import mpmath
import numpy as np
from mpmath import mpf

from lcp_catalog.kernels.photometry.laws import HAPKE
from lcp_catalog.photometry.hapke_sets import SETS, HapkeSet
from lcp_catalog.photometry.laws import SURFACES, Reflectance, radiance_factor

DIGITS = 60

SPECS = [
    "lommel-seeliger",
    "lommel-seeliger:rolo",
    "lambert",
    *(f"lunar-lambert:{name}" for name in SURFACES),
    "minnaert",
    "minnaert:0.8",
    *(f"hapke:{name}" for name in SETS),
]
"""Every model by name, with every published set."""


def of_hapke(p: HapkeSet) -> Reflectance:
    """The model of given parameters."""
    return Reflectance(f"hapke:{p.name}", HAPKE, p.law)


def phase_function(p: HapkeSet, cos_g):
    """Double Henyey-Greenstein, Hapke 2012, eq. 6.7a."""
    b, c = mpf(p.b), mpf(p.c)
    behind = (1 - 2 * b * cos_g + b**2) ** mpf("1.5")
    ahead = (1 + 2 * b * cos_g + b**2) ** mpf("1.5")
    return (1 + c) / 2 * (1 - b**2) / behind + (1 - c) / 2 * (1 - b**2) / ahead


def surges(p: HapkeSet, g):
    """1 + B_S and 1 + B_C; g in (0, pi), Hapke 2012, eq. 9.22, and 2002, eq. 32; 0 and pi as limits."""
    if g == mpmath.pi:
        return mpf(1), mpf(1)
    tan = mpmath.tan(g / 2)
    hiding = mpf(p.b_s0) / (1 + tan / mpf(p.h_s)) if p.b_s0 and p.h_s else mpf(0)
    coherent = mpf(0)
    if p.b_c0 and p.h_c:
        x = tan / mpf(p.h_c)
        mean = (1 - mpmath.exp(-x)) / x if x > mpf(10) ** -30 else 1 - x / 2
        coherent = mpf(p.b_c0) * (1 + mean) / (2 * (1 + x) ** 2)
    return 1 + hiding, 1 + coherent


def h_function(x, w):
    """Hapke 2002, eq. 13."""
    gamma = mpmath.sqrt(1 - w)
    r0 = (1 - gamma) / (1 + gamma)
    return 1 / (1 - w * x * (r0 + (1 - 2 * r0 * x) / 2 * mpmath.log((1 + x) / x)))


def roughness(theta, mu0, mu, cos_g):
    """mu0e, mue, S of Hapke 1984, both branches as printed; angles in radians, a cosine of 1 is
    vertical.
    """
    if theta == 0:
        return mu0, mu, mpf(1)
    tan, pi = mpmath.tan(theta), mpmath.pi
    chi = 1 / mpmath.sqrt(1 + pi * tan**2)
    sin_i, sin_e = mpmath.sqrt(1 - mu0**2), mpmath.sqrt(1 - mu**2)
    cos_psi = (cos_g - mu0 * mu) / (sin_i * sin_e) if sin_i * sin_e > 0 else mpf(1)
    cos_psi = min(mpf(1), max(mpf(-1), cos_psi))
    psi = mpmath.acos(cos_psi)
    half = (1 - cos_psi) / 2  # sin^2(psi / 2)

    def e1(cosine, sine):
        return mpmath.exp(-2 / pi / tan * cosine / sine) if sine > 0 else mpf(0)

    def e2(cosine, sine):
        return mpmath.exp(-1 / pi / tan**2 * (cosine / sine) ** 2) if sine > 0 else mpf(0)

    def eta(cosine, sine):
        return chi * (cosine + sine * tan * e2(cosine, sine) / (2 - e1(cosine, sine)))

    i, e = (mu0, sin_i), (mu, sin_e)
    f = mpmath.exp(-2 * mpmath.tan(psi / 2)) if cos_psi > -1 else mpf(0)
    if mu0 >= mu:  # i <= e
        below = 2 - e1(*e) - psi / pi * e1(*i)
        mu0e = chi * (mu0 + sin_i * tan * (cos_psi * e2(*e) + half * e2(*i)) / below)
        mue = chi * (mu + sin_e * tan * (e2(*e) - half * e2(*i)) / below)
        own = mu0 / eta(*i)
    else:
        below = 2 - e1(*i) - psi / pi * e1(*e)
        mu0e = chi * (mu0 + sin_i * tan * (e2(*i) - half * e2(*e)) / below)
        mue = chi * (mu + sin_e * tan * (cos_psi * e2(*i) + half * e2(*e)) / below)
        own = mu / eta(*e)
    s = mue / eta(*e) * mu0 / eta(*i) * chi / (1 - f + f * chi * own)
    return mu0e, mue, s


def hapke(p: HapkeSet, mu0: float, mu: float, cos_g: float):
    """I/F for exactly these cosines, mu0 and mu above 0, with `DIGITS` digits."""
    with mpmath.workdps(DIGITS):
        mu0, mu, cos_g = mpf(mu0), mpf(mu), mpf(cos_g)
        theta = mpmath.radians(mpf(p.theta_bar_deg))
        hiding, coherent = surges(p, mpmath.acos(cos_g))
        mu0e, mue, s = roughness(theta, mu0, mu, cos_g)
        k = mpf(1)
        if p.filling:
            x = mpf("1.209") * mpf(p.filling) ** (mpf(2) / 3)
            k = -mpmath.log(1 - x) / x
        w = mpf(p.w)
        multiple = h_function(mu0e / k, w) * h_function(mue / k, w) - 1
        single = phase_function(p, cos_g) * hiding
        return k * w / 4 * mu0e / (mu0e + mue) * (single + multiple) * coherent * s


def phase_angle(incidence, emission, azimuth):
    """Phase between directions above a level surface, from chords: accurate near 0 and pi."""
    sun = np.stack([np.sin(incidence), np.zeros_like(incidence), np.cos(incidence)], axis=-1)
    sine = np.sin(emission)
    camera = np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), np.cos(emission)], axis=-1)
    apart, together = (np.linalg.norm(sun + sign * camera, axis=-1) for sign in (-1, 1))
    return 2.0 * np.arctan2(apart, together)


def disc_albedo(model: Reflectance, phase_deg: float, count: int = 100) -> float:
    """Brightness of a sphere's disc at a phase, relative to a white Lambert disc perpendicular to
    the light; at 0 the geometric albedo. Gauss-Legendre quadrature over the photometric latitude
    and longitude of the lit and visible crescent.
    """
    g = math.radians(phase_deg)
    nodes, weights = np.polynomial.legendre.leggauss(count)
    low, high = g - math.pi / 2, math.pi / 2
    lon = (low + high) / 2 + (high - low) / 2 * nodes
    lat = math.pi / 2 * nodes
    lon, lat = np.meshgrid(lon, lat)
    mu0, mu = np.cos(lat) * np.cos(lon - g), np.cos(lat) * np.cos(lon)
    value = radiance_factor(model, np.arccos(mu0), np.arccos(mu), g) * mu * np.cos(lat)
    return float(weights @ value @ weights * (high - low) / 2 * math.pi / 2 / math.pi)


def hemispherical_albedo(model: Reflectance, incidence: float, count: int = 96) -> float:
    """Share of parallel light that a level surface reflects into all directions together."""
    nodes, weights = np.polynomial.legendre.leggauss(count)
    emission, azimuth = np.meshgrid(math.pi / 4 * (nodes + 1), math.pi / 2 * (nodes + 1))
    at = np.full_like(emission, incidence)
    phase = phase_angle(at, emission, azimuth)
    factor = radiance_factor(model, at, emission, phase) / math.cos(incidence)
    value = factor / math.pi * np.cos(emission) * np.sin(emission) * 2.0  # both halves of azimuth
    return float(weights @ value @ weights * math.pi / 4 * math.pi / 2)
