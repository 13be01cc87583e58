"""Radiance factors and photometric angles of nodes, in one pass; NaN normals (nodata) give NaN."""

import math

import numpy as np
from numba import njit

LOMMEL_SEELIGER = 0
LAMBERT = 1

SINGLE_SCATTERING_ALBEDO = 0.21
LAMBERT_ALBEDO = 0.12


@njit(cache=True, nogil=True, inline="always")
def radiance_factor(code, mu0, mu):
    """I/F of a lit and seen facet; mu0, mu are the cosines of incidence and emission.

    Finite everywhere: Lommel-Seeliger's 0/0 at mu0 = mu = 0 is taken as 0, the limit of its
    numerator (no light arrives), and a facet seen from behind (mu < 0) counts as seen edge-on.
    """
    if mu0 <= 0.0:
        return 0.0
    if code == LAMBERT:
        return LAMBERT_ALBEDO * mu0
    return 0.25 * SINGLE_SCATTERING_ALBEDO * mu0 / (mu0 + max(mu, 0.0))


@njit(cache=True, nogil=True)
def shade_nodes(normals, sun, camera, dark, unseen, code):
    """Radiance factor, float32 (rows, cols), under one Sun and one camera at infinity.

    normals (rows, cols, 3); sun, camera (3,): unit vectors from the surface; dark, unseen (rows,
    cols): what terrain keeps from the Sun or the camera. 0 where seen but not lit, NaN where not
    seen.
    """
    rows, cols = dark.shape
    radiance = np.empty((rows, cols), np.float32)
    for row in range(rows):
        for col in range(cols):
            nx, ny, nz = normals[row, col, 0], normals[row, col, 1], normals[row, col, 2]
            mu = nx * camera[0] + ny * camera[1] + nz * camera[2]
            if unseen[row, col] or not mu > 0.0:
                radiance[row, col] = np.nan
            elif dark[row, col]:
                radiance[row, col] = 0.0
            else:
                mu0 = nx * sun[0] + ny * sun[1] + nz * sun[2]
                radiance[row, col] = radiance_factor(code, mu0, mu)
    return radiance


@njit(cache=True, nogil=True)
def shade_points(normals, sun, cameras, lit, seen, code):
    """Radiance factor, incidence, emission and phase (radians), float64 (n,) each, of points with
    their own view.

    normals (n, 3); sun (3,); cameras (n, 3) or (1, 3) for all; lit, seen (n,) bool. The radiance is
    0 where seen but not lit, NaN where not seen; the angles are there wherever the normal is.
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
            radiance[k] = radiance_factor(code, _dot(normal, sun), _dot(normal, camera))
    return radiance, incidence, emission, phase


@njit(cache=True, nogil=True, inline="always")
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(cache=True, nogil=True)
def _angle(a, b):
    """Angle between two vectors of any length, radians; good to the last bits at 0 and pi, where
    acos is not.
    """
    x = a[1] * b[2] - a[2] * b[1]
    y = a[2] * b[0] - a[0] * b[2]
    z = a[0] * b[1] - a[1] * b[0]
    return math.atan2(math.sqrt(x * x + y * y + z * z), _dot(a, b))
