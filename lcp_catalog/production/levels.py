"""Levels: several cell sizes in one catalogue, each from the DEMs that resolve it."""

from __future__ import annotations

import logging
from collections.abc import Sequence

from ..dem.mosaic import DemSet
from ..errors import AreaError
from ..geometry.bounds import Bounds
from ..terrain.area import Area
from ..terrain.useful_cell import Cell, finest_cell, resolves
from .areas import AreaGrid, AreaTask, sample_places
from .config import BuildConfig

log = logging.getLogger(__name__)


def level_cells(config: BuildConfig, dems: DemSet, region: Area) -> list[Cell]:
    """The cells of the levels, from fine to coarse; empty for a configuration without levels.

    Cells that no DEM of the region resolves are left out with a warning if they were derived from
    altitudes; AreaError for a given one, and if none is left.
    """
    area = config.area
    wanted = area.derived_levels_m if area.altitudes_km else area.levels_m
    if not wanted:
        return []
    near = [dem for dem in dems.dems if dem.grid.bounds.meets(region.bounds)]
    if not near:
        raise AreaError(f"no DEM covers the region ({region.bounds})")
    found = [cell_m for cell_m in wanted if any(resolves(dem, cell_m) for dem in near)]
    lost = [cell_m for cell_m in wanted if cell_m not in found]
    if lost:
        finest = min((finest_cell(dem) for dem in near), key=lambda c: c.gsd_m)
        text = f"{_listed(lost)}: no DEM of the region resolves such cells; the finest are {finest.gsd_m:.5g} m, {finest.reason}"
        if area.levels_m or not found:
            raise AreaError(f"levels of {text}")
        log.warning("levels left out: %s", text)
    reason = "by altitude and pixel" if area.altitudes_km else "as configured"
    return [Cell(cell_m, reason) for cell_m in found]


def sources(config: BuildConfig, dems: DemSet, gsd_m: float) -> tuple[int, ...]:
    """Indices of the DEMs that a build takes points from: all, or those that resolve its cells."""
    every = range(len(dems.dems))
    if not config.dem.only_resolving:
        return tuple(every)
    return tuple(i for i in every if resolves(dems.dems[i], gsd_m))


def with_sources(
    tasks: Sequence[AreaTask], grid: AreaGrid, dems: DemSet, own: Sequence[int]
) -> list[AreaTask]:
    """The areas that one of the DEMs ``own`` (indices) reaches into. No pixel is read."""
    if len(own) == len(dems.dems):
        return list(tasks)
    boxes = [dems.dems[i].grid.bounds for i in own]
    return [
        task
        for task in tasks
        if any(box.meets(Bounds(*grid.box(task.row, task.column))) for box in boxes)
        and dems.candidates_at(*sample_places(grid, task.row, task.column))[list(own)].any()
    ]


def _listed(cells_m: Sequence[float]) -> str:
    return ", ".join(f"{cell:.5g}" for cell in cells_m) + " m"
