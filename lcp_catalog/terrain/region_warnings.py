"""Warnings about a region that its DEM files do not fill or do not resolve, one line each."""

from __future__ import annotations

import logging

import numpy as np

from ..dem.mosaic import DemSet
from .area import Area
from .terrain import native_dem
from .useful_cell import finest_cell, resolves

log = logging.getLogger(__name__)

OFF_SHARE = 0.1
"""Greatest share of a stated region without DEM that causes no warning."""

_PLACES = 65


def warn_of_region(dems: DemSet, region: Area, gsd_m: float | None) -> None:
    """Log a warning for a stated region of which more than `OFF_SHARE` lies outside of all DEM files, and for
    stated cells that are finer than the DEM used at its centre resolves. Nothing for a region without
    any DEM, which is an error elsewhere.
    """
    off = float(np.mean(dems.product_at(*region.lattice(_PLACES)) < 0))
    if off == 1.0:
        return
    if off > OFF_SHARE:
        log.warning(
            "%.0f %% of the area lie outside of the DEM files (%s): nothing is computed there; move the area, or add files",
            100.0 * off,
            ", ".join(path.name for path in dems.files),
        )
    if gsd_m is None:
        return
    dem = native_dem(dems, region)
    if not resolves(dem, gsd_m):
        useful = finest_cell(dem)
        log.warning(
            "cells of %.4g m are finer than the DEM resolves: they hold no more of the ground than cells of %.4g m (%s)",
            gsd_m,
            useful.gsd_m,
            useful.reason,
        )
