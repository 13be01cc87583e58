"""Sum of the radiance of many parallel lights on nodes and on points between them."""

import numpy as np
from numba import prange

from ..cache import njit
from ..completion import all_done
from .images import add_light
from .laws import phase_terms, radiance_factor

_BAND_ROWS = 16


@njit(nogil=True, error_model="numpy")
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(nogil=True, error_model="numpy")
def _phases(directions, camera, code, law):
    """Cosine of the phase and the law's phase terms, (k, 3), of lights seen from one camera."""
    out = np.empty((directions.shape[0], 3))
    for k in range(directions.shape[0]):
        out[k, 0] = min(1.0, max(-1.0, _dot(directions[k], camera)))
        out[k, 1], out[k, 2] = phase_terms(code, law, out[k, 0])
    return out


@njit(nogil=True, error_model="numpy")
def _add_to_band(planes, camera, directions, dark, irradiance, code, law, out):
    weight = np.empty(out.shape, np.float32)
    for k in range(directions.shape[0]):
        for row in range(out.shape[0]):
            for col in range(out.shape[1]):
                weight[row, col] = np.float32(0.0) if dark[k, row, col] else irradiance
        add_light(out, planes, directions[k], camera, weight, code, law)


@njit(nogil=True, error_model="numpy", parallel=True)
def add_to_planes(planes, camera, directions, dark, irradiance, code, law, out):
    """`add_to_nodes` under one view, in single precision and several times as fast: planes
    (3, rows, cols) as in `images`, camera (3,), dark (k, rows, cols), out (rows, cols) float32.
    Nodes that face away from the camera or have no normal stay as they are.
    """
    rows = out.shape[0]
    bands = (rows + _BAND_ROWS - 1) // _BAND_ROWS
    done = 0
    for band in prange(bands):
        done += 1
        first, last = band * _BAND_ROWS, min(rows, band * _BAND_ROWS + _BAND_ROWS)
        _add_to_band(
            planes[:, first:last],
            camera,
            directions,
            dark[:, first:last],
            np.float32(irradiance),
            code,
            law,
            out[first:last],
        )
    all_done(done, bands)


@njit(nogil=True, error_model="numpy")
def _on_node(n, normal, camera, directions, phases, dark, code, law):
    """Sum of the radiance factors of node n under the lights that reach it."""
    total, mu = 0.0, _dot(normal, camera)
    for k in range(directions.shape[0]):
        mu0 = _dot(normal, directions[k])
        if dark[k, n] == 0 and mu0 > 0.0:
            terms = phases[k, 1], phases[k, 2]
            total += radiance_factor(code, law, terms, mu0, mu, phases[k, 0])
    return total


@njit(nogil=True, error_model="numpy", parallel=True)
def add_to_nodes(normals, cameras, directions, dark, irradiance, code, law, out):
    """Add to out (n,) the radiance under lights of one irradiance from ``directions`` (k, 3).

    normals (n, 3); cameras (1, 3) for all, or (n, 3); dark (k, n): 1 where terrain occludes a light
    from a node. A node without a normal becomes NaN.
    """
    shared = cameras.shape[0] == 1
    common = _phases(directions, cameras[0], code, law)
    done = 0
    for n in prange(out.size):
        done += 1
        camera = cameras[0] if shared else cameras[n]
        phases = common if shared else _phases(directions, camera, code, law)
        total = _on_node(n, normals[n], camera, directions, phases, dark, code, law)
        out[n] += irradiance * total + 0.0 * normals[n, 0]
    all_done(done, out.size)


@njit(nogil=True, error_model="numpy")
def _on_point(u, v, normal, camera, directions, dark, code, law):
    """The sum at a point at column u, row v, with the occlusion of the nodes of its triangle."""
    j = min(max(int(u), 0), dark.shape[2] - 2)
    i = min(max(int(v), 0), dark.shape[1] - 2)
    x, y = u - j, v - i
    i1, j1 = (i, j + 1) if x > y else (i + 1, j)
    near, beside, far = 1.0 - max(x, y), abs(x - y), min(x, y)
    phases = _phases(directions, camera, code, law)
    total, mu = 0.0, _dot(normal, camera)
    for k in range(directions.shape[0]):
        mu0 = _dot(normal, directions[k])
        if mu0 > 0.0:
            hidden = near * dark[k, i, j] + beside * dark[k, i1, j1] + far * dark[k, i + 1, j + 1]
            terms = phases[k, 1], phases[k, 2]
            total += (1.0 - hidden) * radiance_factor(code, law, terms, mu0, mu, phases[k, 0])
    return total


@njit(nogil=True, error_model="numpy", parallel=True)
def add_to_points(u, v, normals, cameras, directions, dark, irradiance, code, law, out):
    """`add_to_nodes` for points (n,) of cells, u columns and v rows from the first node of dark
    (k, rows, cols), each with its camera (n, 3); the visible share of a light is interpolated
    between the nodes of the point's triangle.
    """
    done = 0
    for n in prange(out.size):
        done += 1
        out[n] += irradiance * _on_point(
            u[n], v[n], normals[n], cameras[n], directions, dark, code, law
        )
    all_done(done, out.size)
