"""Finest useful cell of an area: what its DEM resolves, not the posting of its file.

Warnings about a region that its DEM files do not fill or do not resolve, one line each.
"""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass

import numpy as np

from ..dem.dem import Dem
from ..dem.mosaic import DemSet
from .area import Area
from .terrain import native_dem

log = logging.getLogger(__name__)


CELL_PER_RESOLUTION = 0.5
"""Useful cell over the effective resolution. Finer cells hold nodes that depend on each other and
errors that hang together, and no detail of the ground.
"""


@dataclass(frozen=True)
class Cell:
    """Cell size of an area's patches, metres, and the reason for it."""

    gsd_m: float
    reason: str


_SLACK_OCTAVES = 0.1
"""By how much a cell may miss the rule: 7 %."""


def useful_cell(dems: DemSet, area: Area) -> Cell:
    """`finest_cell` of the DEM that is used at an area's centre. AreaError if the area has no height."""
    return finest_cell(native_dem(dems, area))


def finest_cell(dem: Dem) -> Cell:
    """Finest useful cell of a DEM: at most about half of its effective resolution, as its posting times
    a power of 2, at least the posting.
    """
    posting = f"posting of {dem.path.name}"
    resolution = dem.resolution_m
    if resolution is None:
        return Cell(dem.gsd_m, f"the {posting}: too few heights to estimate what they resolve")
    cell_m = cell_for(dem.gsd_m, resolution)
    times = round(cell_m / dem.gsd_m)
    how = "by its heights" if dem.effective_resolution.is_measured else "as published"
    what = f"{times} times the {posting}" if times > 1 else f"the {posting}"
    return Cell(cell_m, f"{what}, which resolves {resolution:.0f} m {how}")


def resolves(dem: Dem, cell_m: float) -> bool:
    """True if a cell is not finer than the `finest_cell` of a DEM by more than 7 %."""
    return math.log2(cell_m / finest_cell(dem).gsd_m) >= -_SLACK_OCTAVES


def cell_for(posting_m: float, resolution_m: float) -> float:
    """Posting times the greatest power of 2 that is at most `CELL_PER_RESOLUTION` of the resolution
    (or up to 7 % above it); at least the posting.
    """
    octaves = math.log2(CELL_PER_RESOLUTION * resolution_m / posting_m)
    return posting_m * 2.0 ** max(0, math.floor(octaves + _SLACK_OCTAVES))


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
