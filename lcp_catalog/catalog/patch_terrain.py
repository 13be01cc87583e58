"""Patches of a catalogue as terrain: each from its own nodes alone, in its own frame."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import AnyArray, Array
from ..geometry.frames import EnuFrame
from ..terrain.area import NodeWindow
from ..terrain.heightfield import Heightfield
from ..terrain.terrain import Terrain
from .catalogue import Catalog


def patch_terrain(catalog: Catalog, row: int) -> Terrain:
    """The patch of one point (a row of the catalogue) as a terrain in the point's ENU frame; its core is the whole patch."""
    half = 0.5 * (catalog.patch_nodes - 1)
    gsd_m = float(catalog.gsd[row])
    field = Heightfield(catalog.dem[row], gsd_m, -half * gsd_m, half * gsd_m)
    frame = EnuFrame(
        float(catalog.longitude[row]), float(catalog.latitude[row]), float(catalog.elevation[row])
    )
    edge = math.floor(half)
    window = NodeWindow(-edge, catalog.patch_nodes - edge, -edge, catalog.patch_nodes - edge)
    product = np.zeros(field.shape, np.int16)
    return Terrain(field, frame, field.whole, window, product, (str(catalog.dem_product[row]),))


def nodes_mcmf(catalog: Catalog, index: ArrayLike) -> Array:
    """MCMF positions (n, p, p, 3), metres, of the nodes of many points' patches (rows ``index`` (n,) of the catalogue)."""
    rows = np.asarray(index, dtype=np.int64)
    return patch_nodes(
        catalog.dem[rows],
        catalog.gsd[rows],
        catalog.position_mcmf[rows],
        catalog.rotation_mcmf_to_enu[rows],
    )


def patch_nodes(dem: AnyArray, gsd_m: Array, position_m: Array, rotation: Array) -> Array:
    """Positions (n, p, p, 3), metres, of the nodes of patches: heights ``dem`` (n, p, p) over the plane
    of the centres ``position_m`` (n, 3), with the axes ``rotation`` (n, 3, 3).
    """
    step = np.arange(dem.shape[1]) - 0.5 * (dem.shape[1] - 1)
    gsd = gsd_m[:, None]
    east, north, up = np.moveaxis(rotation, 1, 0)
    flat = (step * gsd)[:, None, :, None] * east[:, None, None, :]
    flat = flat - (step * gsd)[:, :, None, None] * north[:, None, None, :]
    flat += position_m[:, None, None, :]
    flat += dem.astype(np.float64)[..., None] * up[:, None, None, :]
    return np.asarray(flat)
