"""Shift of places in an image by shadows that a catalogue's cells do not resolve.

Relief below a cell darkens the ground beyond crests, which a render from the cells' mean heights does
not show; such a render is found away from the Sun. All points of a level err alike. The error falls
with the Sun's elevation h as 1 - (h / `HIGHEST_RAD`)^2, as in renders of made relief that were averaged
to cells (`shadow_shift.py` of c896266); its size at grazing light, in cells, is `errors.shadow_shift`
of the build. How rough the ground is below a cell is not known, so it is an error and not a correction.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import Array, Index
from ..cameras.sensor import Sensor, ground_slopes
from ..catalog.catalogue import Catalog

HIGHEST_RAD = math.radians(35.0)
"""Elevation of the Sun from which on shadows below a cell shift nothing."""


def shadow_shift_m(catalog: Catalog, rows: Index, sun_enu: ArrayLike) -> Array:
    """1 sigma shifts (n, 2) east and north, metres, of points (rows (n,)) under Suns (n, 3), unit vectors
    in the points' ENU frames. They are of one error: with that error all points move by their shift
    times the same number.
    """
    sun = np.asarray(sun_enu, np.float64)
    size = float(catalog.errors.get("shadow_shift", 0.0))
    level = np.linalg.norm(sun[:, :2], axis=-1)
    elevation = np.clip(np.arctan2(sun[:, 2], level), 0.0, HIGHEST_RAD)
    cells = size * (1.0 - (elevation / HIGHEST_RAD) ** 2)
    away = -sun[:, :2] / np.maximum(level, 1e-12)[:, None]
    return np.asarray((cells * catalog.gsd[rows])[:, None] * away)


def shadow_shift_px(catalog: Catalog, rows: Index, sensor: Sensor, suns: ArrayLike) -> Array:
    """`shadow_shift_m` in the image (n, 2) of a sensor, pixels; ``suns`` (n, 3): unit MCMF vectors."""
    rotation = catalog.rotation_mcmf_to_enu[rows]
    shift = shadow_shift_m(catalog, rows, np.einsum("nij,nj->ni", rotation, np.asarray(suns)))
    slope = ground_slopes(sensor, catalog.position_mcmf[rows], rotation)
    return np.asarray(np.einsum("nij,nj->ni", slope, shift))
