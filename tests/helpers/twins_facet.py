"""Reference computations for the facet model: the paper's formulas as printed, in mpmath; Fresnel's
complex amplitudes; and shadows counted on a Gaussian profile.
"""

from __future__ import annotations

import mpmath
import numpy as np
from mpmath import mpf

# -- the paper, literally; degrees in, 40 digits


def _deg(value):
    return mpf(value) * mpmath.pi / 180


def fresnel_squares(n, k, gamma):
    """|r_P|^2 and |r_S|^2 from the complex amplitudes and Snell's law (Born & Wolf, sections 1.5 and 14.2)."""
    index = mpmath.mpc(n, k)
    inside = mpmath.sqrt(1 - (mpmath.sin(gamma) / index) ** 2)
    outside = mpmath.cos(gamma)
    r_s = (outside - index * inside) / (outside + index * inside)
    r_p = (index * outside - inside) / (index * outside + inside)
    return abs(r_p) ** 2, abs(r_s) ** 2


def reflectivity(n, k, gamma, degree=0, twice_angle=0):
    """R(gamma): the paper's first formula of section 2; twice_angle is 2 (xi - beta), radians."""
    p, s = fresnel_squares(n, k, gamma)
    return (p + s) / 2 + mpf(degree) / 2 * (p - s) * mpmath.cos(twice_angle)


def lobe(alpha_cosine, sigma):
    return sigma**2 * alpha_cosine / (1 + (sigma**2 - 1) * alpha_cosine**2)


def shadowing(psi_b, theta, phi, constants):
    """P of eq. (3), with its tangents; radians. Not for level facets, whose profile plane is 0/0."""
    sigma_c, sigma_p, u_p, v_p = (mpf(c) for c in constants)
    cos_a, cos_g = half_vector(psi_b, theta, phi)
    sin_a = mpmath.sqrt(1 - cos_a**2)
    base = 2 * sin_a * cos_g
    tan_g = abs(mpmath.cos(psi_b) - mpmath.cos(theta)) / base
    tan_psi = (mpmath.sin(psi_b) + mpmath.sin(theta) * mpmath.cos(phi)) / base * mpmath.tan(psi_b)
    tan_th = (mpmath.sin(theta) + mpmath.sin(psi_b) * mpmath.cos(phi)) / base * mpmath.tan(theta)
    depth = sigma_p * (1 + u_p * sin_a / (sin_a + v_p * cos_a))
    seen_by_source = 1 / (1 + depth * tan_psi**2)
    seen_by_receiver = 1 / (1 + depth * tan_th**2)
    correlation = 1 / (1 + sigma_c * tan_g)
    both = seen_by_source * seen_by_receiver
    return both + correlation * mpmath.sqrt(both * (1 - seen_by_source) * (1 - seen_by_receiver))


def half_vector(psi, theta, phi):
    """cos alpha and cos gamma (section 1)."""
    cos_2g = mpmath.cos(psi) * mpmath.cos(theta) + mpmath.sin(psi) * mpmath.sin(theta) * mpmath.cos(
        phi
    )
    cos_g = mpmath.sqrt((1 + cos_2g) / 2)
    return (mpmath.cos(psi) + mpmath.cos(theta)) / (2 * cos_g), cos_g


def intensity(row, psi_deg, theta_deg, phi_deg, n, k, constants, degree=0, xi_deg=0):
    """I_rel of eq. (1); row: w_B, dpsi (deg), sigma_B, w_D, dtheta (deg), sigma_D."""
    w_b, shift_b, sigma_b, w_d, shift_d, sigma_d = (mpf(v) for v in row)
    psi_b, theta, phi = _deg(psi_deg) + _deg(shift_b), _deg(theta_deg), _deg(phi_deg)
    cos_a, cos_g = half_vector(psi_b, theta, phi)
    # the facet's normal leans out of the plane of incidence by beta
    beta = mpmath.asin(mpmath.sin(theta) * mpmath.sin(phi) / (2 * cos_g))
    fresnel = reflectivity(n, k, mpmath.acos(cos_g), degree, 2 * (_deg(xi_deg) - beta))
    part = w_b * lobe(cos_a, sigma_b) * fresnel / reflectivity(n, k, mpf(0))
    part *= shadowing(psi_b, theta, phi, constants) / mpmath.cos(psi_b)
    cos_d, _ = half_vector(2 * _deg(shift_d), 2 * theta, phi)
    return part + w_d * max(lobe(cos_d, sigma_d), 0)


# -- a Gaussian profile, its shadows counted


def gaussian_profile(nodes, per_length, rng):
    """Heights and slopes (nodes,) of a periodic Gaussian profile with correlation exp(-x^2), rms slope 1, and
    per_length nodes to the correlation length.
    """
    wave = 2 * np.pi * np.fft.rfftfreq(nodes, 1 / per_length)
    waves = np.exp(-(wave**2) / 8) * np.fft.rfft(rng.standard_normal(nodes))
    height, slope = np.fft.irfft(waves, nodes), np.fft.irfft(1j * wave * waves, nodes)
    return height / slope.std(), slope / slope.std()


def horizons(height, per_length, lengths=20):
    """Steepest slope from every node to any node on the right, and on the left."""
    right = np.full(height.shape, -np.inf)
    left = right.copy()
    for step in range(1, lengths * per_length + 1):
        slope = (np.roll(height, -step) - height) * (per_length / step)
        np.maximum(right, slope, out=right)
        np.maximum(left, np.roll(-slope, step), out=left)
    return right, left


def shadow_shares(rms_slope, nodes, seeds, per_length=32):
    """Columns psi, tilt, theta (deg), unshadowed share, unmasked share, share of both, number of
    facets. Facets are binned by 5 deg of tilt; psi is 0 to 80 deg in steps of 5; the receiver is in
    each facet's mirror direction, theta = 2 tilt - psi, up to 85 deg.
    """
    drawn = [gaussian_profile(nodes, per_length, np.random.default_rng(seed)) for seed in seeds]
    sides = [horizons(height, per_length) for height, _ in drawn]
    right, left = (rms_slope * np.concatenate(side) for side in zip(*sides, strict=True))
    tilt = np.degrees(np.arctan(-rms_slope * np.concatenate([slope for _, slope in drawn])))
    edges = np.arange(-32.5, 33, 5.0)
    found = []
    for psi in range(0, 85, 5):
        unshadowed = right * np.tan(np.radians(psi)) < 1
        for low in edges[:-1]:
            facets = (tilt >= low) & (tilt < low + 5.0)
            theta = low + 2.5 + low + 2.5 - psi
            if facets.sum() < 300 or abs(theta) > 85:
                continue
            tangent = np.tan(np.radians(2 * tilt[facets] - psi))
            unmasked = np.where(
                tangent >= 0, right[facets] * tangent < 1, -left[facets] * tangent < 1
            )
            lit = unshadowed[facets]
            shares = lit.mean(), unmasked.mean(), (lit & unmasked).mean()
            found.append((psi, low + 2.5, theta, *shares, facets.sum()))
    return np.array(found)


def shadow_model(constants, shares):
    """P_S, P_M and P of eq. (3) in the profile's plane, for the rows of `shadow_shares`."""
    sigma_c, sigma_p, u_p, v_p = constants
    psi, tilt, theta = np.radians(shares[:, :3]).T
    sine, cosine = np.sin(np.abs(tilt)), np.cos(tilt)
    depth = sigma_p * (1 + u_p * sine / (sine + v_p * cosine))
    lit, seen = 1 / (1 + depth * np.tan(psi) ** 2), 1 / (1 + depth * np.tan(theta) ** 2)
    correlation = 1 / (1 + sigma_c * np.tan(np.abs(psi - theta) / 2))
    both = lit * seen
    return lit, seen, both + correlation * np.sqrt(both * (1 - lit) * (1 - seen))


def shadow_residuals(constants, shares):
    """Differences between `shadow_model` and the shares, weighted so that the squares sum to three
    mean squares.
    """
    weight = np.sqrt(shares[:, 6] / shares[:, 6].sum())
    model = shadow_model(constants, shares)
    return np.concatenate([(m - s) * weight for m, s in zip(model, shares[:, 3:6].T, strict=True)])
