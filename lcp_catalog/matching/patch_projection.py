"""Projection of the nodes of patches: by the sensor itself, or, for a slow sensor, by a polynomial
per patch that is checked against it.

A scanner solves for the image line of every point. Over one patch its pixels are a smooth function
of position: all terms up to the third order in east, north and up, fitted to 4 x 4 x 3 exact
points, leave less than `TOLERANCE_PX`, unless the patch's width is a good part of its distance to
the sensor, or the projection jumps (push-frames). Residuals at those points and at 9 nodes detect
this, and such patches are projected node by node.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array, Index
from ..cameras.frame_camera import Camera
from ..cameras.sensor import Sensor
from ..catalog.catalogue import Catalog

TOLERANCE_PX = 0.002
"""Largest accepted difference between polynomial and sensor where it is checked."""

_ORDER = 3
_ACROSS = np.array([-1.0, -0.5, 0.5, 1.0])
_UP = np.array([-1.0, 0.0, 1.0])
_TERMS = [
    (a, b, c)
    for a in range(_ORDER + 1)
    for b in range(_ORDER + 1 - a)
    for c in range(min(len(_UP), _ORDER + 1 - a - b))
]
"""Powers of east, south and up."""


def node_pixels(catalog: Catalog, rows: Index, nodes_mcmf: Array, sensor: Sensor) -> Array:
    """Pixels (n, p, p, 2) of the nodes (n, p, p, 3) of the patches ``rows``; NaN for nodes that the
    sensor cannot see.
    """
    if _is_quick(sensor) or not len(rows):
        return sensor.project(nodes_mcmf)
    pixels, good = _interpolated(catalog, rows, nodes_mcmf, sensor)
    if not good.all():
        pixels[~good] = sensor.project(nodes_mcmf[~good])
    return pixels


def _is_quick(sensor: Sensor) -> bool:
    """True if the sensor projects by a closed form."""
    return isinstance(sensor.full, Camera)


def _interpolated(
    catalog: Catalog, rows: Index, nodes_mcmf: Array, sensor: Sensor
) -> tuple[Array, NDArray[np.bool_]]:
    """Pixels by the polynomials, and True for the patches for which they are accurate."""
    half = 0.5 * (catalog.patch_nodes - 1)
    z = catalog.dem[rows].astype(np.float64)
    middle = 0.5 * (z.max(axis=(1, 2)) + z.min(axis=(1, 2)))
    rise = np.maximum(0.5 * np.ptp(z, axis=(1, 2)), 1e-3 * catalog.gsd[rows])
    east, south, up = (a.ravel() for a in np.meshgrid(_ACROSS, _ACROSS, _UP, indexing="ij"))
    across = (half * catalog.gsd[rows])[:, None]
    enu = np.stack([across * east, -across * south, middle[:, None] + rise[:, None] * up], axis=-1)
    places = catalog.position_mcmf[rows][:, None, :] + enu @ catalog.rotation_mcmf_to_enu[rows]
    exact = sensor.project(places)
    terms, solve = _design()
    factors = np.einsum("tk,nkc->ntc", solve, exact)
    worst = np.abs(np.einsum("kt,ntc->nkc", terms, factors) - exact).max(axis=(1, 2))
    height: Array = (z - middle[:, None, None]) / rise[:, None, None]
    step = np.linspace(-1.0, 1.0, catalog.patch_nodes)
    pixels = _evaluated(factors, step, height)
    some = np.unique(np.round(np.array([1 / 6, 1 / 2, 5 / 6]) * 2 * half).astype(np.int64))
    checked = np.ix_(np.arange(len(rows)), some, some)
    off = np.abs(pixels[checked] - sensor.project(nodes_mcmf[checked])).max(axis=(1, 2, 3))
    with np.errstate(invalid="ignore"):
        return pixels, np.asarray((worst < TOLERANCE_PX) & (off < TOLERANCE_PX))


@cache
def _design() -> tuple[Array, Array]:
    """The terms at the fitted points (k, t), and their pseudo-inverse (t, k)."""
    east, south, up = (a.ravel() for a in np.meshgrid(_ACROSS, _ACROSS, _UP, indexing="ij"))
    terms = np.stack([east**a * south**b * up**c for a, b, c in _TERMS], axis=-1)
    return terms, np.linalg.pinv(terms)


def _evaluated(factors: Array, step: Array, height: Array) -> Array:
    """The polynomials (n, t, 2) at nodes with places east and south ``step`` (p,) and heights (n,
    p, p).
    """
    powers = step[:, None] ** np.arange(_ORDER + 1)
    out = np.zeros((*height.shape, 2))
    for c in range(len(_UP)):
        square = np.zeros((len(factors), _ORDER + 1, _ORDER + 1, 2))
        for k, (a, b, up) in enumerate(_TERMS):
            if up == c:
                square[:, b, a] = factors[:, k]
        level = np.einsum("ib,nbac,ja->nijc", powers, square, powers, optimize=True)
        out += level * (height**c)[..., None]
    return out
