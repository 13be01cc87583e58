"""Maps of a build's region: the status of its spacing cells, and an overview of its heights."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array
from ..catalog.coverage import usable_nearby
from ..catalog.hdf5 import Coverage, Overview
from ..constants import MOON_RADIUS_M
from ..dem.mosaic import DemSet
from ..geometry.frames import mcmf_to_lonlat
from ..landmarks.selection import Places, coverage
from ..terrain.area import Area, NodeWindow
from ..terrain.terrain import build_terrain

OVERVIEW_NODES = 480
"""Longer side of the overview raster."""


def region_coverage(
    dems: DemSet,
    region: Area,
    candidates: Places,
    stages: NDArray[np.int64],
    points: Places,
    condition: NDArray[np.uint8],
    spacing_m: float,
) -> Coverage:
    """Status of the region's spacing cells, a lattice in its plane, and their coverage by condition.

    ``candidates``, ``points``: (longitudes, latitudes) in degrees; ``stages``: result for each candidate
    (`landmarks.selection.coverage`); ``condition``: flags of the points, uint8 (point, view,
    sun_elevation, sun_azimuth).
    """
    x0, x1, y0, y1 = region.extent_m
    x, y = np.meshgrid(_middles(x0, x1, spacing_m), _middles(y0, y1, spacing_m)[::-1])
    flat = np.stack([x, y, -(x**2 + y**2) / (2.0 * MOON_RADIUS_M)], axis=-1).reshape(-1, 3)
    lon, lat, _ = mcmf_to_lonlat(region.frame.to_mcmf(flat))
    inside = region.contains(lon, lat)
    cells = lon[inside], lat[inside]
    heights, _ = dems.heights(*cells, spacing_m / 8.0)
    status = coverage(cells, np.isfinite(heights), candidates, stages, points, spacing_m)
    nearby = usable_nearby(cells, points, condition, spacing_m)
    return Coverage(*cells, status=status, spacing_m=spacing_m, usable=nearby)


def _middles(low: float, high: float, step: float) -> Array:
    """Centres of cells of width ``step``, centred on a span."""
    count = max(1, round((high - low) / step))
    return np.asarray((low + high) / 2.0 + (np.arange(count) - (count - 1) / 2.0) * step)


def region_overview(dems: DemSet, region: Area, gsd_m: float) -> Overview:
    """A coarse raster of the region in the frame of its centre: heights above the reference sphere."""
    x0, x1, y0, y1 = region.extent_m
    step = max(gsd_m, max(x1 - x0, y1 - y0) / OVERVIEW_NODES)
    window = NodeWindow.covering(region.extent_m, step)
    field = build_terrain(dems, region.frame, window, step).field
    x = field.x0_m + np.arange(field.shape[1]) * step
    y = field.y0_m - np.arange(field.shape[0]) * step
    xx, yy = np.meshgrid(x, y)
    _, _, height = mcmf_to_lonlat(region.frame.to_mcmf(np.stack([xx, yy, field.z_m], axis=-1)))
    return Overview(
        height=height.astype(np.float32),
        x=x,
        y=y,
        center_lon=region.frame.lon_deg,
        center_lat=region.frame.lat_deg,
    )
