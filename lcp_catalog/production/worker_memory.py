"""Memory of a process that computes areas, and the division of a region into areas that keep a promise
about it.

The peak of a process follows from its largest area. The figures here were fitted to peaks of 23 areas of
16 to 1024 nodes, with 5 to 175 conditions, patches of 17 to 257 nodes and spacings of 4 to 136
nodes: the sum of the terms was at most 11 MB (3 %) below a measured peak and at most 6 MB above it.
`MARGIN_MB` is added.
"""

from __future__ import annotations

import logging
import math
from dataclasses import replace

import numpy as np

from ..choices import BOUNCES
from ..constants import MOON_RADIUS_M
from ..dem.block_cache import CACHES_BYTES
from ..errors import ConfigError
from ..landmarks.corners import GROUP_EXTRA
from ..terrain.area import Area, NodeWindow
from ..terrain.surroundings import most_nodes
from .area_job import conditions_at
from .areas import AreaGrid, AreaTask, plan_areas
from .config import BuildConfig
from .evaluation import _BATCH_NODES
from .model_config import AREA_NODES_MIN
from .sweep import lowest_off_nadir_deg

log = logging.getLogger(__name__)


START_MB = 284.0
"""The package with its kernels, and a small part of a DEM. 150 MB of it are mapped files of libraries. Linux
maps 80 to 106 MB more of files that have just been installed (until they leave the page cache); these pages, which
processes share and the system can evict, are not counted."""

MARGIN_MB = 40.0
"""More than any measured peak was above the sum of the terms, and what the plan leaves in a process that
computes areas itself (37 MB)."""

CACHES_MIN_MB = 32.0
"""Least memory for what is kept of the DEM's files (`dem.block_cache`)."""

CACHES_SHARE = 0.25
"""Share for them of what a promise leaves beside `START_MB`."""

_CORE_BYTES = 122.0
"""Of a node that is rendered: its normals, coordinates and slopes."""
_TERRAIN_BYTES = 12.3
"""Of a node of the terrain, with that around the area."""
_SUN_BYTES = 1.7
"""Of a rendered node for each Sun: its shadow, and that of the part around a group of candidates."""
_IMAGE_BYTES = 6.6
"""Of a node of the images that are evaluated together."""
_PATCH_BYTES = 19.6
"""Of a node of the patches that are evaluated together."""
_RESULT_BYTES = 4.1
"""For each byte of the results of candidates, which are merged and packed."""
_BOUNCE_BYTES = 150e6
"""Rays of light by way of other ground that are traced together: 83 MB were measured."""

_TURNED = 2.0
"""Factor of the core and its shadows where meridians converge: groups of candidates have their own."""


def caches_mb(memory_gb: float | None) -> float:
    """Memory for what a worker keeps of the DEM's files under a promise in GB, MB."""
    most = CACHES_BYTES / 1e6
    if memory_gb is None:
        return most
    return min(most, max(CACHES_MIN_MB, CACHES_SHARE * (memory_gb * 1e3 - START_MB)))


def area_mb(window: NodeWindow, lat_deg: float, config: BuildConfig) -> float:
    """Greatest memory of a process that computes an area of such a window, MB, without what it keeps of the
    DEM's files.
    """
    gsd_m = config.gsd_m
    core = window.grown(config.points.halo_nodes(gsd_m))
    lowest = math.tan(math.radians(min(config.sun.elevations_deg)))
    view = math.radians(90.0 - lowest_off_nadir_deg(config))
    around = math.inf if view >= math.pi / 2 else math.tan(view)
    limit_m = config.model.ring_max_km * 1e3
    nodes, terrain = math.prod(core.shape), most_nodes(core, gsd_m, lowest, around, limit_m)
    conditions = conditions_at(lat_deg, config)
    images = min(max(1, _BATCH_NODES // nodes), max(1, conditions.count))
    spacing = config.points.spacing_nodes(gsd_m)
    cells = math.prod(side // spacing + 2 for side in window.shape)
    found = (config.points.candidates_per_cell + GROUP_EXTRA) * cells
    scales = len(config.points.scales)
    results = found * int(np.prod(conditions.shape)) * (16 * scales + 21)
    turned = _TURNED if _turns(window, lat_deg, config) else 1.0
    size = (
        turned * nodes * (_CORE_BYTES + _SUN_BYTES * int(conditions.reachable.sum()))
        + _TERRAIN_BYTES * terrain
        + _IMAGE_BYTES * images * nodes
        + _PATCH_BYTES * images * found * config.points.patch_nodes**2
        + _RESULT_BYTES * results
        + (_BOUNCE_BYTES if config.model.bounce == BOUNCES[1] else 0.0)
    )
    return START_MB + MARGIN_MB + size / 1e6


def _turns(window: NodeWindow, lat_deg: float, config: BuildConfig) -> bool:
    """True if the north of a place of the window can differ from that of its centre by more than the
    direction tolerance.
    """
    away_m = max(-window.col0, window.col1, -window.row0, window.row1) * config.gsd_m
    highest = min(abs(math.radians(lat_deg)) + away_m / MOON_RADIUS_M, math.radians(89.9))
    turn_rad = away_m * math.tan(highest) / MOON_RADIUS_M
    return turn_rad > math.radians(config.model.direction_tolerance_deg)


def worker_mb(tasks: list[AreaTask], config: BuildConfig, memory_gb: float) -> float:
    """Greatest memory, MB, of a process that computes areas, with what it keeps of the DEM's files."""
    largest: dict[int, AreaTask] = {}
    for task in tasks:
        other = largest.setdefault(task.row, task)
        if math.prod(task.window.shape) > math.prod(other.window.shape):
            largest[task.row] = task
    areas = (area_mb(task.window, task.lat_deg, config) for task in largest.values())
    return caches_mb(memory_gb) + max(areas, default=START_MB)


def divided(
    region: Area, config: BuildConfig, memory_gb: float | None
) -> tuple[BuildConfig, AreaGrid, list[AreaTask]]:
    """The areas of a region, small enough that a process that computes them keeps within ``memory_gb`` (GB;
    None: no limit), with their grid and the configuration with the ``area_nodes_max`` that gives
    them.

    ConfigError, with the memory that the smallest areas need, if that is more.
    """
    gsd_m = config.gsd_m
    while True:
        grid = AreaGrid.for_cell(gsd_m, config.model)
        tasks = plan_areas(grid, region, gsd_m)
        if memory_gb is None or not tasks:
            return config, grid, tasks
        if worker_mb(tasks, config, memory_gb) <= memory_gb * 1e3:
            return config, grid, tasks
        lat_deg = max((task.lat_deg for task in tasks), key=abs)
        side = math.ceil(math.radians(grid.height_deg) * MOON_RADIUS_M / gsd_m)
        nodes = _most_nodes(side - 1, lat_deg, config, memory_gb)
        model = replace(config.model, area_nodes_max=nodes)
        config = replace(config, model=model)
        log.info("areas of at most %d nodes for %g GB a worker", nodes, memory_gb)


def _most_nodes(below: int, lat_deg: float, config: BuildConfig, memory_gb: float) -> int:
    """Greatest number of nodes along an area's side, at most ``below``, that keeps the promise."""
    room_mb = memory_gb * 1e3 - caches_mb(memory_gb)
    low, high = AREA_NODES_MIN, below
    least_mb = area_mb(_square(low), lat_deg, config)
    if high < low or least_mb > room_mb:
        need_gb = math.ceil((least_mb + _caches_beside(least_mb)) / 10.0) / 100.0
        raise ConfigError(
            f"a memory of {memory_gb:g} GB is too small: a worker needs {need_gb:.2f} GB for the smallest areas, "
            f"of {AREA_NODES_MIN} nodes; give at least that (`memory_gb`)"
        )
    while low < high:
        middle = (low + high + 1) // 2
        if area_mb(_square(middle), lat_deg, config) <= room_mb:
            low = middle
        else:
            high = middle - 1
    return low


def _caches_beside(area: float) -> float:
    """Memory of the caches, MB, under the least promise that leaves so much for an area."""
    share = CACHES_SHARE / (1.0 - CACHES_SHARE)
    return min(CACHES_BYTES / 1e6, max(CACHES_MIN_MB, share * (area - START_MB)))


def _square(nodes: int) -> NodeWindow:
    """The window of an area of so many nodes, with the margin of those at the region's border."""
    half = math.ceil(nodes * 25 / 48) + 2
    return NodeWindow(-half, half, -half, half)
