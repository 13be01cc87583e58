"""Images of nodes under one parallel light and one parallel view, in single precision, vectorised:
simple laws in one pass over a row; for Hapke's law a run of a row is reduced to the nodes that are
lit and visible, and these are shaded without branches.

planes (3, rows, cols) float32: components of the nodes' normals, each a raster, so that they are
read in order. sun, camera (3,): unit vectors from the surface. Cosines are double precision.
"""

import math

import numpy as np

from ..cache import njit
from ..elementary import exp_lane, log_lane
from .hapke_simd import hapke_lanes
from .laws import HAPKE, LUNAR_LAMBERT, MINNAERT, phase_terms, radiance_factor

_RUN = 512
"""Nodes shaded at once; their data fit into the first-level cache."""

_F = np.float32
_ZERO, _ONE, _NAN, _INF = _F(0.0), _F(1.0), _F(np.nan), _F(np.inf)

# atan(t) / t on [0, 1] in t^2: Abramowitz and Stegun, 4.4.49, 2e-8
_ATAN = (
    1.0,
    -0.3333314528,
    0.1999355085,
    -0.1420889944,
    0.1065626393,
    -0.0752896400,
    0.0429096138,
    -0.0161657367,
    0.0028662257,
)


@njit(nogil=True, error_model="numpy")
def shade_nodes(planes, sun, camera, dark, unseen, code, law):
    """Radiance factor, float32 (rows, cols).

    dark, unseen (rows, cols): nodes that terrain occludes from the Sun or the camera. 0 where
    visible but not lit, NaN where not visible (occluded, facing away, or without a normal).
    """
    _, rows, cols = planes.shape
    out = np.empty((rows, cols), np.float32)
    cos_g = _phase(sun, camera)
    terms = phase_terms(code, law, cos_g)
    if code <= LUNAR_LAMBERT:
        _mixture_image(planes, sun, camera, dark, unseen, terms, out)
        return out
    mu0, mu, wanted, scratch = _scratch()
    for row in range(rows):
        for start in range(0, cols, _RUN):
            n = min(_RUN, cols - start)
            run = out[row, start : start + n]
            shadow, hidden = dark[row, start : start + n], unseen[row, start : start + n]
            _dots(planes, row, start, n, sun, camera, mu0, mu)
            for k in range(n):
                wanted[k] = (mu0[k] > 0.0) & (mu[k] > 0.0) & (not shadow[k]) & (not hidden[k])
            _shade(code, law, terms, cos_g, mu0, mu, wanted, n, scratch, run)
            for k in range(n):
                run[k] = run[k] if (mu[k] > 0.0) & (not hidden[k]) else _NAN
    return out


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def differences(radiance, east, south, inverse, factors, out):
    """Write radiance (rows, cols), and the differences of east and south from it times ``inverse``, all
    times factors (rows, cols), or (1, 1) of 1, into out (3, rows, cols). Differences are 0 where a
    radiance is missing. Return True if none is.
    """
    rows, cols = radiance.shape
    whole, missing = factors.shape[0] == rows and factors.shape[1] == cols, _ZERO
    one = np.ones(cols, np.float32)
    for row in range(rows):
        base, across, down = radiance[row], east[row], south[row]
        factor = factors[row] if whole else one
        level, x, y = out[0, row], out[1, row], out[2, row]
        lost = _ZERO
        for k in range(cols):
            level[k] = base[k] * factor[k]
            u, v = (across[k] - base[k]) * inverse, (down[k] - base[k]) * inverse
            lost += _ZERO * (u + v)  # NaN if one is missing
            x[k] = u * factor[k] if abs(u) < _INF else _ZERO
            y[k] = v * factor[k] if abs(v) < _INF else _ZERO
        missing += lost
    return missing == _ZERO


@njit(nogil=True, error_model="numpy")
def terms_of_nodes(sun, cameras, code, law):
    """`phase_terms` float32 (2, rows, cols) of nodes with their own directions to the camera, float32
    (3, rows, cols), for the laws up to LUNAR_LAMBERT.
    """
    _, rows, cols = cameras.shape
    out = np.empty((2, rows, cols), np.float32)
    for row in range(rows):
        x, y, z = cameras[0, row], cameras[1, row], cameras[2, row]
        for k in range(cols):
            # by the chord: near opposition the rounding of the directions would change their product
            dx, dy, dz = sun[0] - x[k], sun[1] - y[k], sun[2] - z[k]
            cos_g = max(-1.0, 1.0 - 0.5 * (dx * dx + dy * dy + dz * dz))
            out[0, row, k], out[1, row, k] = phase_terms(code, law, cos_g)
    return out


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def shade_nodes_from(planes, sun, cameras, dark, unseen, terms):
    """`shade_nodes` of nodes with their own directions to the camera, float32 (3, rows, cols), and
    their own ``terms`` (`terms_of_nodes`).
    """
    _, rows, cols = planes.shape
    out = np.empty((rows, cols), np.float32)
    sx, sy, sz = sun[0], sun[1], sun[2]
    for row in range(rows):
        x, y, z = planes[0, row], planes[1, row], planes[2, row]
        cx, cy, cz = cameras[0, row], cameras[1, row], cameras[2, row]
        seeliger, lambert = terms[0, row], terms[1, row]
        shadow, hidden, run = dark[row], unseen[row], out[row]
        for k in range(cols):
            mu0 = _F(x[k] * sx + y[k] * sy + z[k] * sz)
            mu = x[k] * cx[k] + y[k] * cy[k] + z[k] * cz[k]
            lit = seeliger[k] * (mu0 / (mu0 + mu)) + lambert[k] * mu0
            lit = lit if (mu0 > _ZERO) & (not shadow[k]) else _ZERO
            run[k] = lit if (mu > _ZERO) & (not hidden[k]) else _NAN
    return out


@njit(nogil=True, error_model="numpy")
def add_light(radiance, planes, sun, camera, weight, code, law):
    """Add to radiance (rows, cols) float32 the radiance factor times weight (rows, cols) float32:
    the light's irradiance, and the share of it that arrives. Nodes that face away from the light or
    the camera, or have no normal, stay as they are.
    """
    _, rows, cols = planes.shape
    cos_g = _phase(sun, camera)
    terms = phase_terms(code, law, cos_g)
    mu0, mu, wanted, scratch = _scratch()
    factor = np.empty(_RUN, np.float32)
    for row in range(rows):
        for start in range(0, cols, _RUN):
            n = min(_RUN, cols - start)
            share, run = weight[row, start : start + n], radiance[row, start : start + n]
            _dots(planes, row, start, n, sun, camera, mu0, mu)
            for k in range(n):
                wanted[k] = (mu0[k] > 0.0) & (mu[k] > 0.0) & (share[k] > _ZERO)
            _shade(code, law, terms, cos_g, mu0, mu, wanted, n, scratch, factor)
            for k in range(n):
                run[k] += share[k] * factor[k] if wanted[k] else _ZERO


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def angles_deg(planes, direction, out, faces):
    """Write the angle between the nodes' normals and a unit vector (3,), degrees, into out (rows,
    cols) float32, and True where it is below 90 deg into faces; NaN and False without a normal.
    Accurate to 2e-6 deg and the rounding of float32.

    Computed from the tangent of two lengths, so that the rounding of the normals does not matter
    near 0.
    """
    dx, dy, dz = direction[0], direction[1], direction[2]
    for row in range(out.shape[0]):
        x, y, z = planes[0, row], planes[1, row], planes[2, row]
        run, face = out[row], faces[row]
        for k in range(run.size):
            nx, ny, nz = np.float64(x[k]), np.float64(y[k]), np.float64(z[k])
            u, v, w = ny * dz - nz * dy, nz * dx - nx * dz, nx * dy - ny * dx
            aside, along = math.sqrt(u * u + v * v + w * w), nx * dx + ny * dy + nz * dz
            size = abs(along)
            t = aside / size if aside < size else size / aside
            q = t * t
            p = ((_ATAN[8] * q + _ATAN[7]) * q + _ATAN[6]) * q + _ATAN[5]
            p = (((p * q + _ATAN[4]) * q + _ATAN[3]) * q + _ATAN[2]) * q + _ATAN[1]
            p = (p * q + _ATAN[0]) * t
            p = p if aside < size else 0.5 * math.pi - p
            p = p if along > 0.0 else math.pi - p
            run[k] = p * (180.0 / math.pi) + 0.0 * nx
            face[k] = along > 0.0


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _mixture_image(planes, sun, camera, dark, unseen, terms, out):
    """`shade_nodes` for Lommel-Seeliger, Lambert and their mixtures."""
    seeliger, lambert = _F(terms[0]), _F(terms[1])
    sx, sy, sz = sun[0], sun[1], sun[2]
    cx, cy, cz = camera[0], camera[1], camera[2]
    for row in range(out.shape[0]):
        x, y, z = planes[0, row], planes[1, row], planes[2, row]
        shadow, hidden, run = dark[row], unseen[row], out[row]
        for k in range(run.size):
            nx, ny, nz = x[k], y[k], z[k]
            mu0, mu = nx * sx + ny * sy + nz * sz, nx * cx + ny * cy + nz * cz
            a, b = _F(mu0), _F(mu)
            lit = seeliger * (a / (a + b)) + lambert * a
            lit = lit if (mu0 > 0.0) & (not shadow[k]) else _ZERO
            run[k] = lit if (mu > 0.0) & (not hidden[k]) else _NAN


@njit(nogil=True, error_model="numpy")
def _phase(sun, camera):
    """Cosine of the phase angle."""
    return min(1.0, max(-1.0, sun[0] * camera[0] + sun[1] * camera[1] + sun[2] * camera[2]))


@njit(nogil=True, error_model="numpy")
def _scratch():
    """Work arrays of a run: cosines, mask of the nodes to be shaded, and for Hapke's law: packed
    cosines, their indices, six rows of numbers, the factors.
    """
    packed, places = np.empty((2, _RUN)), np.empty(_RUN, np.int32)
    work, factor = np.empty((6, _RUN), np.float32), np.empty(_RUN, np.float32)
    return np.empty(_RUN), np.empty(_RUN), np.empty(_RUN, np.bool_), (packed, places, work, factor)


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _dots(planes, row, start, n, sun, camera, mu0, mu):
    """Write the cosines of incidence and emission of a run into mu0 and mu."""
    x, y, z = planes[0, row], planes[1, row], planes[2, row]
    sx, sy, sz = sun[0], sun[1], sun[2]
    cx, cy, cz = camera[0], camera[1], camera[2]
    for k in range(n):
        nx, ny, nz = x[start + k], y[start + k], z[start + k]
        mu0[k] = nx * sx + ny * sy + nz * sz
        mu[k] = nx * cx + ny * cy + nz * cz


@njit(nogil=True, error_model="numpy")
def _shade(code, law, terms, cos_g, mu0, mu, wanted, n, scratch, out):
    """Write the radiance factors of a run into out; 0 where not ``wanted``."""
    if code <= LUNAR_LAMBERT:
        _shade_mixture(terms, mu0, mu, wanted, n, out)
    elif code == MINNAERT:
        _shade_minnaert(law, mu0, mu, wanted, n, out)
    elif code == HAPKE:
        _shade_hapke(law, terms, cos_g, mu0, mu, wanted, n, scratch, out)
    else:
        for k in range(n):
            out[k] = _ZERO
            if wanted[k]:
                out[k] = radiance_factor(code, law, terms, mu0[k], mu[k], cos_g)


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _shade_mixture(terms, mu0, mu, wanted, n, out):
    seeliger, lambert = _F(terms[0]), _F(terms[1])
    for k in range(n):
        a, b = _F(mu0[k]), _F(mu[k])
        out[k] = seeliger * (a / (a + b)) + lambert * a if wanted[k] else _ZERO


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _shade_minnaert(law, mu0, mu, wanted, n, out):
    albedo, power, floor = _F(law[0]), _F(1.0 - law[1]), _F(law[2])
    for k in range(n):
        a, b = _F(mu0[k]), _F(mu[k])
        both = log_lane(max(floor, min(_ONE, a)) * max(floor, min(_ONE, b)))
        out[k] = albedo * a / exp_lane(power * both) if wanted[k] else _ZERO


@njit(nogil=True, error_model="numpy")
def _shade_hapke(law, terms, cos_g, mu0, mu, wanted, n, scratch, out):
    packed, places, work, factor = scratch
    count = 0
    for k in range(n):  # without a branch: unwanted values are overwritten
        packed[0, count], packed[1, count], places[count] = mu0[k], mu[k], k
        count += wanted[k]
    hapke_lanes(law, terms, packed[0], packed[1], count, cos_g, work, factor)
    for k in range(n):
        out[k] = _ZERO
    for k in range(count):
        out[places[k]] = factor[k]
