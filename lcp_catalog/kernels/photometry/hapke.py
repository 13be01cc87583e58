"""Hapke's bidirectional reflectance, the form of 2012: isotropic multiple scattering, both
opposition effects, porosity, macroscopic roughness.

B. Hapke, *Theory of Reflectance and Emittance Spectroscopy*, 2nd ed., Cambridge 2012, ch. 8 to 12;
the H function in Hapke, Icarus 157 (2002) 523; roughness in Hapke, Icarus 59 (1984) 41. A law is
twelve numbers, in the order of the constants below. mu0, mu, cos_g: cosines of incidence, emission
and phase.
"""

import math

from ..cache import njit

W, B, C, B_S0, H_S, B_C0, H_C, POROSITY, COT, CHI, R0, SCALE = range(12)
"""Indices in a law: single-scattering albedo; the two of the Henyey-Greenstein function; amplitude
and width of shadow hiding, of coherent backscatter; the porosity factor K; cotangent of the
roughness, chi of the roughness; diffusive reflectance of w; a factor of the whole.
"""

COT_SMOOTH = 1e150
"""Cotangent for a surface without roughness; its square is finite."""

_TINY = 1e-30  # lower limit of cosines and sines, so that quotients have their limits
_GONE = 700.0  # exp(-700) is negligible


@njit(nogil=True, error_model="numpy")
def hapke_terms(law, cos_g):
    """The terms that depend on the phase alone: p(g) (1 + B_S(g)), and K w/4 (1 + B_C(g))
    times the factor of the whole.

    Double Henyey-Greenstein function, the lobe of (1 + c)/2 backward (Hapke 2012, eq. 6.7a); with t
    = tan(g/2), B_S = B_S0 / (1 + t/h_S) (eq. 9.22) and B_C = B_C0 (1 + (1 - exp(-t/h_C)) / (t/h_C))
    / (2 (1 + t/h_C)^2) (Hapke 2002, eq. 32).
    """
    b = law[B]
    narrow = 1.0 - b * b
    ahead, behind = 1.0 + b * b + 2.0 * b * cos_g, 1.0 + b * b - 2.0 * b * cos_g
    lobes = 0.5 * (1.0 + law[C]) * narrow / (behind * math.sqrt(behind))
    lobes += 0.5 * (1.0 - law[C]) * narrow / (ahead * math.sqrt(ahead))
    above, below = math.sqrt(max(1.0 - cos_g, 0.0)), math.sqrt(max(1.0 + cos_g, 0.0))
    hiding = 0.0  # tan(g/2) is above / below, infinite at g = pi
    if law[B_S0] > 0.0 and law[H_S] > 0.0:
        hiding = law[B_S0] * law[H_S] * below / (law[H_S] * below + above)
    coherent = 0.0
    if law[B_C0] > 0.0 and law[H_C] > 0.0:
        x = min(above / max(law[H_C] * below, _TINY), 1e100)
        mean = 1.0 if x < 1e-12 else -math.expm1(-x) / x
        coherent = law[B_C0] * 0.5 * (1.0 + mean) / ((1.0 + x) * (1.0 + x))
    return lobes * (1.0 + hiding), 0.25 * law[POROSITY] * law[W] * (1.0 + coherent) * law[SCALE]


@njit(nogil=True, error_model="numpy")
def hapke_factor(law, terms, mu0, mu, cos_g):
    """I/F of a facet with mu0 > 0; a facet seen from behind counts as seen edge-on.

    The two branches of the roughness (i <= e and i > e) are combined: a is the smaller of the two
    angles, b the larger, and the result without the factor mu0 is symmetric in them, so that
    reciprocity is exact. Differences of nearly equal numbers are written in forms that have the
    correct limits at grazing angles.
    """
    steep, flat = max(mu0, mu, _TINY), max(min(mu0, mu), _TINY)
    cot, chi = law[COT], law[CHI]
    sin_a, sin_b = _sine(steep), _sine(flat)
    both = sin_a * sin_b
    cos_psi = 1.0
    if both > 0.0:
        cos_psi = min(1.0, max(-1.0, (cos_g - steep * flat) / both))
    up, down = 0.5 * (1.0 - cos_psi), 0.5 * (1.0 + cos_psi)  # sin^2, cos^2 of half the azimuth
    near, far = cot * steep / max(sin_a, _TINY), cot * flat / max(sin_b, _TINY)
    square_a = min(near * min(near, _GONE) / math.pi, _GONE)
    square_b = min(far * min(far, _GONE) / math.pi, _GONE)
    gap_a = -math.expm1(-min(2.0 / math.pi * near, _GONE))  # 1 - E1
    gap_b = -math.expm1(-min(2.0 / math.pi * far, _GONE))
    e2_a, e2_b = math.exp(-square_a), math.exp(-square_b)
    rise = -e2_b * math.expm1(square_b - square_a)  # E2(b) - E2(a)
    back = 2.0 * math.atan2(math.sqrt(down), math.sqrt(up)) / math.pi  # 1 - psi/pi
    share = 1.0 / (cot * max(gap_b + gap_a + back * (1.0 - gap_a), _TINY))
    mu_a = chi * (steep + sin_a * share * (down * e2_b - up * rise))
    mu_b = chi * (flat + sin_b * share * (rise + down * e2_a))
    mu_a, mu_b = max(mu_a, _TINY), max(mu_b, _TINY)
    eta_a = chi * (steep + sin_a * e2_a / (cot * (1.0 + gap_a)))
    eta_b = chi * (flat + sin_b * e2_b / (cot * (1.0 + gap_b)))
    f = math.exp(-2.0 * math.sqrt(up / max(down, _TINY)))
    seen = chi / (eta_a * eta_b * (1.0 - f + f * chi * steep / eta_a))
    k, w, r0 = law[POROSITY], law[W], law[R0]
    multiple = h_function(mu_a / k, w, r0) * h_function(mu_b / k, w, r0) - 1.0
    return terms[1] * (terms[0] + multiple) * mu0 * seen * mu_a * mu_b / (mu_a + mu_b)


@njit(nogil=True, inline="always", error_model="numpy")
def h_function(x, w, r0):
    """Chandrasekhar's H for isotropic scatterers, Hapke's second approximation (2002, eq. 13),
    within 1 %; x > 0.
    """
    return 1.0 / (1.0 - w * x * (r0 + (0.5 - r0 * x) * math.log1p(1.0 / x)))


@njit(nogil=True, inline="always", error_model="numpy")
def _sine(cosine):
    return math.sqrt(max((1.0 - cosine) * (1.0 + cosine), 0.0))
