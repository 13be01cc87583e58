"""Radiance factors and photometric angles of nodes, in one pass; NaN normals (nodata) give NaN."""

import math

import numpy as np
from numba import njit

LOMMEL_SEELIGER = 0
LAMBERT = 1
LUNAR_LAMBERT = 2
MINNAERT = 3
HAPKE = 4
FACET = 5


@njit(cache=True, nogil=True, inline="always")
def phase_terms(code, law, cos_g):
    """Two numbers that hold all of a law that depends on the phase alone: computed once a scene
    where light and view are parallel.
    """
    return 1.0, 1.0


@njit(cache=True, nogil=True, inline="always")
def radiance_factor(code, law, terms, mu0, mu, cos_g):
    """I/F of a lit and seen facet; mu0, mu, cos_g are the cosines of incidence, emission and phase,
    law (n,) the law's numbers, terms its `phase_terms`.

    Finite everywhere: Lommel-Seeliger's 0/0 at mu0 = mu = 0 is taken as 0, the limit of its
    numerator (no light arrives), and a facet seen from behind (mu < 0) counts as seen edge-on.
    """
    if mu0 <= 0.0:
        return 0.0
    if code == LAMBERT:
        return law[0] * mu0
    return 0.25 * law[0] * mu0 / (mu0 + max(mu, 0.0))


@njit(cache=True, nogil=True)
def shade_nodes(normals, sun, camera, dark, unseen, code, law):
    """Radiance factor, float32 (rows, cols), under one Sun and one camera at infinity.

    normals (rows, cols, 3); sun, camera (3,): unit vectors from the surface; dark, unseen (rows,
    cols): what terrain keeps from the Sun or the camera. 0 where seen but not lit, NaN where not
    seen.
    """
    rows, cols = dark.shape
    cos_g = _cosine(sun, camera)
    terms = phase_terms(code, law, cos_g)
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
                radiance[row, col] = radiance_factor(code, law, terms, mu0, mu, cos_g)
    return radiance


@njit(cache=True, nogil=True)
def shade_points(normals, sun, cameras, lit, seen, code, law):
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
            radiance[k] = _radiance(normal, sun, camera, code, law)
    return radiance, incidence, emission, phase


@njit(cache=True, nogil=True)
def radiance_of_points(normals, sun, cameras, lit, code, law):
    """Radiance factor alone, float64 (n,), of points that are seen: 0 where not lit, NaN without a
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


@njit(cache=True, nogil=True, inline="always")
def _radiance(normal, sun, camera, code, law):
    cos_g = _cosine(sun, camera)
    terms = phase_terms(code, law, cos_g)
    return radiance_factor(code, law, terms, _dot(normal, sun), _dot(normal, camera), cos_g)


@njit(cache=True, nogil=True, inline="always")
def _cosine(a, b):
    """Cosine of the angle between unit vectors, within -1 and 1."""
    return min(1.0, max(-1.0, _dot(a, b)))


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
