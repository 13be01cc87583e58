"""Reflectance models (laws): radiance factors of facets and, with their photometric angles, of
points; NaN normals (nodata) give NaN. For images of nodes see `images`.

A law is a code and an array of numbers; `lcp_catalog.photometry.laws` defines them with their
sources.
"""

import math

import numpy as np

from ..cache import njit
from .facet import facet_factor
from .hapke import hapke_factor, hapke_terms

LOMMEL_SEELIGER = 0
LAMBERT = 1
LUNAR_LAMBERT = 2
MINNAERT = 3
HAPKE = 4
FACET = 5

DISC_NUMBERS = 14
"""Count of numbers of a Lommel-Seeliger law that has the phase function of a measured disc."""


@njit(nogil=True, error_model="numpy")
def phase_terms(code, law, cos_g):
    """The two terms of a law that depend on the phase alone; computed once for a scene with
    parallel light and view.

    Lommel-Seeliger, Lambert and their mixture: the factors of mu0 / (mu0 + mu) and of mu0.
    """
    if code == LAMBERT:
        return 0.0, law[0]
    if code == LUNAR_LAMBERT:
        share, f = mixture(cos_g), law[0] * two_lobes(law, cos_g)
        return 2.0 * share * f, (1.0 - share) * f
    if code == HAPKE:
        return hapke_terms(law, cos_g)
    if code == LOMMEL_SEELIGER and law.size == DISC_NUMBERS:
        return even_sphere(law, cos_g), 0.0
    return 0.25 * law[0], 0.0


@njit(nogil=True, inline="always", error_model="numpy")
def radiance_factor(code, law, terms, mu0, mu, cos_g):
    """I/F of a lit and visible facet; mu0, mu, cos_g are the cosines of incidence, emission and
    phase, law (n,) the law's numbers, terms its `phase_terms`.

    Finite everywhere: Lommel-Seeliger's 0/0 at mu0 = mu = 0 is taken as 0, the limit of its
    numerator (no light arrives); a facet seen from behind (mu < 0) counts as seen edge-on.
    """
    if mu0 <= 0.0:
        return 0.0
    if code <= LUNAR_LAMBERT:
        return terms[0] * (mu0 / (mu0 + max(mu, 0.0))) + terms[1] * mu0
    if code == MINNAERT:
        return law[0] * mu0 * (max(mu0, law[2]) * max(mu, law[2])) ** (law[1] - 1.0)
    if code == FACET:
        return facet_factor(law, mu0, mu, cos_g)
    return hapke_factor(law, terms, mu0, mu, cos_g)


@njit(nogil=True)
def mixture(cos_g):
    """Share of Lommel-Seeliger in the lunar-Lambert law (McEwen 1996): a cubic in degrees that
    falls from 1 at 0 to 0 at 104, and is 0 beyond.
    """
    g = math.degrees(math.acos(min(1.0, max(-1.0, cos_g))))
    return max(0.0, 1.0 + g * (-0.019 + g * (0.242e-3 - 1.46e-6 * g)))


@njit(nogil=True, error_model="numpy")
def two_lobes(law, cos_g):
    """Phase function of Yokota et al. (2011): (1 + B0 / (1 + tan(g/2) / h)) times a double
    Henyey-Greenstein function; law[1:5] is B0, h, c, asymmetry. As in their code, (1 - c)/2 is
    the weight of the backward lobe.
    """
    surge, width, c, b = law[1], law[2], law[3], law[4]
    above, below = math.sqrt(max(1.0 - cos_g, 0.0)), math.sqrt(max(1.0 + cos_g, 0.0))
    backward = 0.5 * (1.0 - c) / (1.0 + b * b - 2.0 * b * cos_g) ** 1.5
    forward = 0.5 * (1.0 + c) / (1.0 + b * b + 2.0 * b * cos_g) ** 1.5
    opposition = surge * width * below / (width * below + above)
    return (1.0 + opposition) * (1.0 - b * b) * (backward + forward)


@njit(nogil=True, error_model="numpy")
def even_sphere(law, cos_g):
    """Lommel-Seeliger's factor with which a sphere has the measured brightness of the Moon's disc.

    law: a0..a3, d1..d3, p1..p4 (phase in radians in a, in degrees elsewhere) of the disc's
    reflectance A (Kieffer & Stone 2005, eq. 10, without libration and lunation); the last measured
    phase (radians); the logarithm of the factor there, and its slope, for larger phases. The
    brightness of a sphere's disc is factor / 2 * (1 - sin(g/2) tan(g/2) ln cot(g/4)).
    """
    g = math.acos(min(1.0, max(-1.0, cos_g)))
    if g > law[11]:
        return math.exp(law[12] + law[13] * (g - law[11]))
    degrees = math.degrees(g)
    log_a = law[0] + g * (law[1] + g * (law[2] + g * law[3]))
    log_a += law[4] * math.exp(-degrees / law[7]) + law[5] * math.exp(-degrees / law[8])
    log_a += law[6] * math.cos((degrees - law[9]) / law[10])
    dimming = 0.0
    if g > 0.0:
        dimming = math.sin(0.5 * g) * math.tan(0.5 * g) * math.log(math.tan(0.25 * g))
    return 2.0 * math.exp(log_a) / (1.0 + dimming)


@njit(nogil=True)
def factors(mu0, mu, cos_g, code, law):
    """Radiance factors (n,) of facets from their cosines, each (n,)."""
    out = np.empty(mu0.size)
    for k in range(mu0.size):
        terms = phase_terms(code, law, cos_g[k])
        out[k] = radiance_factor(code, law, terms, mu0[k], mu[k], cos_g[k])
    return out


@njit(nogil=True)
def shade_points(normals, sun, cameras, lit, seen, code, law):
    """Radiance factor, incidence, emission and phase (radians), float64 (n,) each, of points with
    their own view.

    normals (n, 3); sun (3,); cameras (n, 3) or (1, 3) for all; lit, seen (n,) bool. The radiance is
    0 where visible but not lit, NaN where not visible; angles are given wherever a normal is.
    """
    n = normals.shape[0]
    shared = cameras.shape[0] == 1
    radiance, incidence, emission, phase = np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    for k in range(n):
        normal, camera = normals[k], cameras[0 if shared else k]
        if math.isnan(normal[0]):
            radiance[k] = incidence[k] = emission[k] = phase[k] = np.nan
            continue
        incidence[k] = _angle(normal, sun)
        emission[k] = _angle(normal, camera)
        phase[k] = _angle(sun, camera)
        if not seen[k]:
            radiance[k] = np.nan
        elif not lit[k]:
            radiance[k] = 0.0
        else:
            radiance[k] = _radiance(normal, sun, camera, code, law)
    return radiance, incidence, emission, phase


@njit(nogil=True)
def radiance_of_points(normals, sun, cameras, lit, code, law):
    """Radiance factor alone, float64 (n,), of visible points: 0 where not lit, NaN without a
    normal. Shapes as in `shade_points`.
    """
    shared = cameras.shape[0] == 1
    radiance = np.zeros(normals.shape[0])
    for k in range(normals.shape[0]):
        if math.isnan(normals[k, 0]):
            radiance[k] = np.nan
        elif lit[k]:
            radiance[k] = _radiance(normals[k], sun, cameras[0 if shared else k], code, law)
    return radiance


@njit(nogil=True, inline="always")
def _radiance(normal, sun, camera, code, law):
    cos_g = _cosine(sun, camera)
    terms = phase_terms(code, law, cos_g)
    return radiance_factor(code, law, terms, _dot(normal, sun), _dot(normal, camera), cos_g)


@njit(nogil=True, inline="always")
def _cosine(a, b):
    """Cosine of the angle between unit vectors, within -1 and 1."""
    return min(1.0, max(-1.0, _dot(a, b)))


@njit(nogil=True, inline="always")
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(nogil=True)
def _angle(a, b):
    """Angle between two vectors of any length, radians; accurate to the last bits at 0 and pi,
    unlike acos.
    """
    x = a[1] * b[2] - a[2] * b[1]
    y = a[2] * b[0] - a[0] * b[2]
    z = a[0] * b[1] - a[1] * b[0]
    return math.atan2(math.sqrt(x * x + y * y + z * z), _dot(a, b))
