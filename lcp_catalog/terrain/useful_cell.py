"""Finest useful cell of an area: what its DEM resolves, not the posting of its file."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ..dem.mosaic import DemSet
from .area import Area
from .terrain import native_dem

CELL_PER_RESOLUTION = 0.5
"""Useful cell over the effective resolution. Finer cells hold nodes that depend on each other and
errors that hang together, and no detail of the ground.
"""


@dataclass(frozen=True)
class Cell:
    """Cell size of an area's patches, metres, and the reason for it."""

    gsd_m: float
    reason: str


def useful_cell(dems: DemSet, area: Area) -> Cell:
    """Cell for the patches of an area: at most about half of the effective resolution of the DEM
    that is used at its centre, as its posting times a power of 2, at least the posting.

    AreaError if the area has no height.
    """
    dem = native_dem(dems, area)
    posting = f"posting of {dem.path.name}"
    resolution = dem.resolution_m
    if resolution is None:
        return Cell(dem.gsd_m, f"the {posting}: too few heights to estimate what they resolve")
    cell_m = cell_for(dem.gsd_m, resolution)
    times = round(cell_m / dem.gsd_m)
    how = "by its heights" if dem.effective_resolution.is_measured else "as published"
    what = f"{times} times the {posting}" if times > 1 else f"the {posting}"
    return Cell(cell_m, f"{what}, which resolves {resolution:.0f} m {how}")


def cell_for(posting_m: float, resolution_m: float) -> float:
    """Posting times the greatest power of 2 that is at most `CELL_PER_RESOLUTION` of the resolution
    (or up to 7 % above it); at least the posting.
    """
    octaves = math.log2(CELL_PER_RESOLUTION * resolution_m / posting_m)
    return posting_m * 2.0 ** max(0, math.floor(octaves + 0.1))
