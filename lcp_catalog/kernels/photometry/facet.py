"""The two-component facet model of a measured rough surface (Labunets, Borzov, Akhmetov 2019).

L. V. Labunets, A. B. Borzov, I. M. Akhmetov, "Regularised parametric model of the indicatrix of the
brightness coefficient of a rough surface" (in Russian), Opticheskii Zhurnal 86 (10), 20-29, 2019;
equation numbers are theirs. Directions: the source at polar angle psi >= 0 and azimuth 0, the
receiver at theta, phi; theta = +psi, phi = 0 is back at the source, theta = -psi is specular.

A law is one array: `HEAD` constants, the nodes over cos(incidence), rising, then values and slopes
of the six parameters at the nodes, then two tables of `TABLE` entries over sqrt(1 - cos). All
results are finite for any directions above the surface.
"""

import math

import numpy as np

from ..cache import njit

NODES, INDEX_N, INDEX_K, AT_NORMAL = 0, 1, 2, 3
"""Number of nodes; complex refractive index; R(0)."""
POLAR_COS, POLAR_SIN = 4, 5
"""D_P cos(2 xi), D_P sin(2 xi)."""
SIGMA_C, SIGMA_P, U_P, V_P = 6, 7, 8, 9
COS_HELD = 10
"""Cosine of the emission angle beyond which the brightness is constant."""
HEAD = 11

TABLE = 361
"""Entries of a table over x = sqrt(1 - cos), x = 0 to 1: 0.23 deg near the normal, 0.32 at 90."""

W_B, SHIFT_B, SIGMA_B, W_D, SHIFT_D, SIGMA_D = range(6)
"""The parameters in their order; shifts in radians."""

CONE_SIN = math.sin(math.radians(5.0))
"""Angle from normal incidence within which the azimuth is averaged: see `facet_factor`."""

IN_PLANE = 1e-7
"""A half vector this close to the normal is taken to lie in the plane of incidence: its azimuth is
0/0, and at sin(phi) = 1e-8 it would be computed from rounding errors of 1e-16.
"""
LEAST = 1e-12
"""Least squared sine over grazing light; it keeps the model's only pole finite, where both
directions are grazing and the facet's profile is perpendicular to them.
"""


@njit(nogil=True, error_model="numpy")
def reflectivity(n, k, cos_gamma, polarisation):
    """Fresnel's R of a facet at incidence gamma (paper, section 2); polarisation is D_P cos 2(xi -
    beta), 0 for natural light, 1 for light in the plane of incidence.

    Computed without tan(gamma) and without differences of nearly equal numbers: accurate up to
    90 deg.
    """
    c = min(max(cos_gamma, 0.0), 1.0)
    s2 = 1.0 - c * c
    x = n * n - k * k - s2
    root = math.sqrt(x * x + 4.0 * n * n * k * k)
    if x >= 0.0:
        a = math.sqrt(0.5 * (root + x))
        b = n * k / a if a > 0.0 else 0.0
    else:
        b = math.sqrt(0.5 * (root - x))
        a = n * k / b
    below = (a + c) ** 2 + b * b
    if below <= 0.0:
        return 1.0  # equal media on both sides, at grazing incidence
    square = ((a - c) ** 2 + b * b) / below
    below = (a * c + s2) ** 2 + (b * c) ** 2
    parallel = square * ((a * c - s2) ** 2 + (b * c) ** 2) / below if below > 0.0 else square
    return 0.5 * (parallel + square) + 0.5 * polarisation * (parallel - square)


@njit(nogil=True, error_model="numpy")
def attenuation(law, cos_b, sin_b, cos_th, sin_th, cos_phi, sin_phi):
    """P(psi_B, theta, phi) / (cos psi_B cos theta), eq. (3): shadowing and masking of facets, over
    the cosines, so that it stays finite when either is 0; with it |s + v| = 2 cos gamma_B and the
    length of its level part, 2 cos gamma_B sin alpha_B.

    With a = P_S / cos^2 psi_B and b = P_M / cos^2 theta it is cos psi_B cos theta a b + C_SM
    sqrt(a b (1 - P_S)(1 - P_M)). A horizontal facet has no azimuth: its profile is taken in the
    plane of incidence, the limit of theta -> -psi_B at phi = 0.
    """
    along, across = sin_b + sin_th * cos_phi, sin_th * sin_phi
    level = math.sqrt(along * along + across * across)
    up = cos_b + cos_th
    length = math.sqrt(level * level + up * up)
    if level > IN_PLANE:
        to_source = along / level
        to_receiver = (sin_th + sin_b * cos_phi) / level
        # |tan gamma_P| = |cos psi_B - cos theta| / level
        together = level / (level + law[SIGMA_C] * abs(cos_b - cos_th))
    else:
        to_source = to_receiver = 1.0
        together = cos_b / (cos_b + law[SIGMA_C] * abs(sin_b)) if cos_b > 0.0 else 0.0
    tilt = level / (level + law[V_P] * up) if level > 0.0 else 0.0
    depth = law[SIGMA_P] * (1.0 + law[U_P] * tilt)
    shadow = depth * (to_source * sin_b) ** 2
    mask = depth * (to_receiver * sin_th) ** 2
    a = 1.0 / max(cos_b * cos_b + shadow, LEAST)
    b = 1.0 / max(cos_th * cos_th + mask, LEAST)
    apart = cos_b * cos_th * a * b
    return apart + together * math.sqrt(a * b * (shadow * a) * (mask * b)), length, level


@njit(nogil=True, error_model="numpy")
def directional(law, row, cos_psi, sin_psi, cos_th, sin_th, cos_phi, sin_phi):
    """The directional lobe of the brightness coefficient: first term of eq. (1), over cos theta.

    psi_B = psi + dpsi is an angle of incidence, 90 deg at most.
    """
    if row[W_B] <= 0.0:
        return 0.0
    cos_shift, sin_shift = math.cos(row[SHIFT_B]), math.sin(row[SHIFT_B])
    cos_b = cos_psi * cos_shift - sin_psi * sin_shift
    sin_b = sin_psi * cos_shift + cos_psi * sin_shift
    if cos_b <= 0.0:
        cos_b, sin_b = 0.0, math.copysign(1.0, sin_b)
    shaded, length, level = attenuation(law, cos_b, sin_b, cos_th, sin_th, cos_phi, sin_phi)
    if length <= 0.0:
        cos_a, sin_a, sin_beta = 1.0, 0.0, 0.0
    else:
        cos_a, sin_a = (cos_b + cos_th) / length, level / length
        sin_beta = sin_th * sin_phi / length
    scale = row[SIGMA_B] * row[SIGMA_B]
    lobe = scale * cos_a / (sin_a * sin_a + scale * cos_a * cos_a)
    cos_2beta = 1.0 - 2.0 * sin_beta * sin_beta
    sin_2beta = 2.0 * sin_beta * math.sqrt(max(1.0 - sin_beta * sin_beta, 0.0))
    polarisation = law[POLAR_COS] * cos_2beta + law[POLAR_SIN] * sin_2beta
    fresnel = reflectivity(law[INDEX_N], law[INDEX_K], 0.5 * length, polarisation)
    return row[W_B] * lobe * fresnel / law[AT_NORMAL] * shaded


@njit(nogil=True, error_model="numpy")
def diffuse(row, cos_th, sin_th, cos_phi, sin_phi):
    """The diffuse lobe of the intensity: w_D S_(+)(alpha_D, sigma_D), section 4.

    cos alpha_D = (cos^2 theta - sin^2 dtheta) / cos gamma_D, and cos gamma_D written as a length,
    are the paper's formulas without their doubled angles.
    """
    cos_shift, sin_shift = math.cos(row[SHIFT_D]), math.sin(row[SHIFT_D])
    above = cos_th * cos_th - sin_shift * sin_shift
    if above <= 0.0:
        return 0.0
    along = cos_shift * cos_th + sin_shift * sin_th * cos_phi
    across = sin_shift * sin_th * sin_phi
    cos_a = min(above / math.sqrt(along * along + across * across), 1.0)
    scale = row[SIGMA_D] * row[SIGMA_D]
    return row[W_D] * scale * cos_a / (1.0 + (scale - 1.0) * cos_a * cos_a)


@njit(nogil=True, error_model="numpy")
def parameters(law, cos_psi):
    """The six parameters at an incidence, a tuple: piecewise cubic Hermite over cos(incidence), eq.
    (5) (printed there with the nodes in place of the values); constant beyond the first and last
    node.
    """
    n = int(law[NODES])
    start = HEAD + n
    if n == 1:
        at = start
        return (law[at], law[at + 2], law[at + 4], law[at + 6], law[at + 8], law[at + 10])
    c = min(max(cos_psi, law[HEAD]), law[HEAD + n - 1])
    j = 0
    while j < n - 2 and c > law[HEAD + j + 1]:
        j += 1
    h = law[HEAD + j + 1] - law[HEAD + j]
    t = (c - law[HEAD + j]) / h
    rise = t * t * (3.0 - 2.0 * t)
    leave, arrive = h * t * (1.0 - t) ** 2, h * t * t * (t - 1.0)
    at = start + j
    return (
        _hermite(law, at, n, rise, leave, arrive),
        _hermite(law, at + 2 * n, n, rise, leave, arrive),
        _hermite(law, at + 4 * n, n, rise, leave, arrive),
        _hermite(law, at + 6 * n, n, rise, leave, arrive),
        _hermite(law, at + 8 * n, n, rise, leave, arrive),
        _hermite(law, at + 10 * n, n, rise, leave, arrive),
    )


@njit(nogil=True, inline="always")
def _hermite(law, at, n, rise, leave, arrive):
    value, after = law[at], law[at + 1]
    return value + rise * (after - value) + leave * law[at + n] + arrive * law[at + n + 1]


@njit(nogil=True, error_model="numpy")
def brightness(law, row, cos_psi, sin_psi, cos_th, sin_th, cos_phi, sin_phi):
    """Brightness coefficient r of eq. (2) at cos theta > 0, for given parameters."""
    lobe = directional(law, row, cos_psi, sin_psi, cos_th, sin_th, cos_phi, sin_phi)
    return lobe + diffuse(row, cos_th, sin_th, cos_phi, sin_phi) / cos_th


@njit(nogil=True, error_model="numpy")
def intensities(law, row, psi, theta, phi, out):
    """Write I_rel of eq. (1) into out (n,), for directions theta, phi (n,), radians, at one
    incidence psi with its six parameters.
    """
    cos_psi, sin_psi = math.cos(psi), math.sin(psi)
    for m in range(theta.shape[0]):
        cos_th, sin_th = max(math.cos(theta[m]), 0.0), math.sin(theta[m])
        cos_phi, sin_phi = math.cos(phi[m]), math.sin(phi[m])
        lobe = directional(law, row, cos_psi, sin_psi, cos_th, sin_th, cos_phi, sin_phi)
        out[m] = lobe * cos_th + diffuse(row, cos_th, sin_th, cos_phi, sin_phi)


@njit(nogil=True, error_model="numpy")
def misfit(law, row, psi, directions, data):
    """Relative error of I_rel, eq. (4), for directions (n, 4): cosine and sine of theta, then of
    phi, and the intensities measured there (n,).
    """
    cos_psi, sin_psi = math.cos(psi), math.sin(psi)
    missed = whole = 0.0
    for m in range(data.shape[0]):
        cos_th, sin_th = directions[m, 0], directions[m, 1]
        cos_phi, sin_phi = directions[m, 2], directions[m, 3]
        lobe = directional(law, row, cos_psi, sin_psi, cos_th, sin_th, cos_phi, sin_phi)
        value = lobe * cos_th + diffuse(row, cos_th, sin_th, cos_phi, sin_phi)
        missed += (value - data[m]) ** 2
        whole += data[m] ** 2
    return math.sqrt(missed / whole)


@njit(nogil=True, error_model="numpy")
def curve_length(x, y, intervals):
    """Length, eq. (6), over 0..1 of the shape-preserving cubic through (x, y), x rising within it,
    constant beyond the ends; by `intervals` chords.
    """
    slopes = pchip_slopes(x, y)
    length, before = 0.0, hermite(x, y, slopes, 0.0)
    for n in range(1, intervals + 1):
        value = hermite(x, y, slopes, n / intervals)
        length += math.sqrt((value - before) ** 2 + 1.0 / intervals**2)
        before = value
    return length


@njit(nogil=True, error_model="numpy")
def hermite(x, y, slopes, at):
    """Value of a piecewise cubic, eq. (5), constant beyond its ends."""
    n = x.shape[0]
    c = min(max(at, x[0]), x[n - 1])
    if n == 1:
        return y[0]
    j = 0
    while j < n - 2 and c > x[j + 1]:
        j += 1
    h = x[j + 1] - x[j]
    t = (c - x[j]) / h
    bend = h * t * (1.0 - t) * ((1.0 - t) * slopes[j] - t * slopes[j + 1])
    return y[j] + t * t * (3.0 - 2.0 * t) * (y[j + 1] - y[j]) + bend


@njit(nogil=True, error_model="numpy")
def pchip_slopes(x, y):
    """Slopes of the shape-preserving cubic through the points (n,), x rising: Fritsch and Butland's
    weighted harmonic mean (1984), which lies in Fritsch and Carlson's region of monotony (1980),
    and a three-point formula at the ends, limited to keep the shape.
    """
    n = x.shape[0]
    slopes = np.zeros(n)
    if n == 2:
        slopes[:] = (y[1] - y[0]) / (x[1] - x[0])
    if n < 3:
        return slopes
    for k in range(1, n - 1):
        h, h1 = x[k] - x[k - 1], x[k + 1] - x[k]
        rise, rise1 = (y[k] - y[k - 1]) / h, (y[k + 1] - y[k]) / h1
        if rise * rise1 > 0.0:
            a, b = 2.0 * h1 + h, h1 + 2.0 * h
            slopes[k] = (a + b) / (a / rise + b / rise1)
    slopes[0] = _end_slope(x[1] - x[0], x[2] - x[1], y[1] - y[0], y[2] - y[1])
    slopes[n - 1] = _end_slope(
        x[n - 1] - x[n - 2], x[n - 2] - x[n - 3], y[n - 1] - y[n - 2], y[n - 2] - y[n - 3]
    )
    return slopes


@njit(nogil=True, error_model="numpy")
def _end_slope(h0, h1, step0, step1):
    rise0, rise1 = step0 / h0, step1 / h1
    slope = ((2.0 * h0 + h1) * rise0 - h0 * rise1) / (h0 + h1)
    if slope * rise0 <= 0.0:
        return 0.0
    if rise0 * rise1 <= 0.0 and abs(slope) > 3.0 * abs(rise0):
        return 3.0 * rise0
    return slope


@njit(nogil=True, error_model="numpy")
def held_brightness(law, row, cos_psi, sin_psi, cos_th, cos_phi):
    """Brightness of unsigned directions, constant beyond the law's largest emission; for polarised
    light the mean of both sides of the plane of incidence.
    """
    cos_th = max(cos_th, law[COS_HELD])
    sin_th = math.sqrt(max(1.0 - cos_th * cos_th, 0.0))
    sin_phi = math.sqrt(max(1.0 - cos_phi * cos_phi, 0.0))
    one = brightness(law, row, cos_psi, sin_psi, cos_th, sin_th, cos_phi, sin_phi)
    if law[POLAR_SIN] == 0.0:
        return one
    return 0.5 * (one + brightness(law, row, cos_psi, sin_psi, cos_th, sin_th, cos_phi, -sin_phi))


@njit(nogil=True, error_model="numpy")
def hemisphere(law, cos_psi, mu, weight, azimuths):
    """1/pi times the integral of held brightness times cos theta over the hemisphere: 1 for r = 1.

    mu, weight (n,): nodes of a quadrature rule for the integral of 2 mu d mu over 0..1; azimuths:
    number over half a turn, at the middles of equal steps.
    """
    row = parameters(law, cos_psi)
    sin_psi = math.sqrt(max(1.0 - cos_psi * cos_psi, 0.0))
    total = 0.0
    for k in range(mu.shape[0]):
        total += weight[k] * _around(law, row, cos_psi, sin_psi, mu[k], azimuths)
    return total


@njit(nogil=True, error_model="numpy")
def around_normal(law, mu, azimuths, out):
    """Write the mean over azimuth of `held_brightness` at normal incidence into out (n,), for
    emissions mu.
    """
    row = parameters(law, 1.0)
    for k in range(mu.shape[0]):
        out[k] = _around(law, row, 1.0, 0.0, mu[k], azimuths)


@njit(nogil=True, error_model="numpy")
def _around(law, row, cos_psi, sin_psi, mu, azimuths):
    ring = 0.0
    for m in range(azimuths):
        ring += held_brightness(
            law, row, cos_psi, sin_psi, mu, math.cos((m + 0.5) * math.pi / azimuths)
        )
    return ring / azimuths


@njit(nogil=True, error_model="numpy")
def scale(law, cos_psi):
    """Factor of a law's brightness at an incidence."""
    return _looked_up(law, HEAD + 13 * int(law[NODES]), cos_psi)


@njit(nogil=True, error_model="numpy")
def _looked_up(law, start, cosine):
    """Value of a table at a cosine, linear between entries."""
    x = math.sqrt(max(1.0 - cosine, 0.0)) * (TABLE - 1)
    k = min(int(x), TABLE - 2)
    share = x - k
    return law[start + k] + share * (law[start + k + 1] - law[start + k])


@njit(nogil=True, error_model="numpy")
def facet_factor(law, mu0, mu, cos_g):
    """I/F of a lit facet: scale(incidence) x brightness x mu0; mu0, mu, cos_g are the cosines of
    incidence, emission and true phase.

    The azimuth follows from the three. At normal incidence it is undefined, and an isotropic
    surface does not depend on it: within 5 deg of the normal the model changes continuously to its
    mean over the azimuth at normal incidence. The scale and that mean are tables.
    """
    if mu0 <= 0.0:
        return 0.0
    mu0, mu = min(mu0, 1.0), min(max(mu, 0.0), 1.0)
    scales = HEAD + 13 * int(law[NODES])
    sin_i = math.sqrt(1.0 - mu0 * mu0)
    mean = 0.0
    share = 1.0
    if sin_i < CONE_SIN:
        share = (sin_i / CONE_SIN) ** 2 * (3.0 - 2.0 * sin_i / CONE_SIN)
        mean = _looked_up(law, scales + TABLE, max(mu, law[COS_HELD]))
        if share <= 0.0:
            return mu0 * mean
    both = sin_i * math.sqrt(1.0 - mu * mu)
    cos_phi = min(max((cos_g - mu0 * mu) / both, -1.0), 1.0) if both > 0.0 else 1.0
    row = parameters(law, mu0)
    own = _looked_up(law, scales, mu0) * held_brightness(law, row, mu0, sin_i, mu, cos_phi)
    return mu0 * (share * own + (1.0 - share) * mean)
