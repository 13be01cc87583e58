"""Maps of a build's region: the status of its spacing cells, and an overview of its heights.

A region that a tangent plane shows has both in the plane of its centre. A larger one has cells on
latitude rings that are fixed on the Moon, and an overview in an equirectangular or polar map.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array, Int16, Mask
from ..catalog.maps import usable_nearby
from ..catalog.model import Coverage, Overview
from ..constants import MOON_RADIUS_M
from ..dem.mosaic import DemSet, nearest_heights
from ..geometry.bounds import turned_deg
from ..geometry.frames import mcmf_to_lonlat
from ..geometry.map_plane import MapPlane
from ..landmarks.selection import Places, Status, coverage
from ..terrain.area import Area, NodeWindow
from ..terrain.terrain import build_terrain

OVERVIEW_NODES = 480
"""Longer side of the overview raster of a region that a tangent plane shows."""

LARGE_NODES = 1920
"""Longer side of that of a larger region, whose coarser levels stand beside it."""

COVERAGE_CELLS = 100_000
COVERAGE_BYTES = 64_000_000
"""Most cells of a coverage, and its largest size by condition: a region with more has a sample."""

_READ_AT_ONCE = 20_000
"""Places whose heights are read together."""


def region_coverage(
    dems: DemSet,
    region: Area,
    candidates: Places,
    stages: NDArray[np.int64],
    points: Places,
    condition: NDArray[np.uint8],
    spacing_m: float,
    sources: Sequence[int],
) -> Coverage:
    """Status of the region's spacing cells and their coverage by condition. A cell whose height comes from
    none of the DEMs ``sources`` (indices) counts as one without heights.

    ``candidates``, ``points``: (longitudes, latitudes) in degrees; ``stages``: result for each candidate
    (`landmarks.selection.coverage`); ``condition``: flags of the points, uint8 (point, view,
    sun_elevation, sun_azimuth), an array or a dataset, which is read in blocks.
    """
    most = min(COVERAGE_CELLS, COVERAGE_BYTES // max(1, math.prod(condition.shape[1:])))
    lon, lat, step_m = coverage_cells(region, spacing_m, most)
    cell_m = spacing_m / 8.0 if step_m is None else 0.0
    status = coverage(
        Places(lon, lat), np.zeros(len(lon), bool), candidates, stages, points, spacing_m
    )
    bare = np.flatnonzero(status == Status.NODATA)  # nothing near: heights tell why
    held = np.isin(_read(dems, lon[bare], lat[bare], cell_m)[1], sources)
    status[bare[held]] = Status.FEATURELESS
    nearby = usable_nearby(Places(lon, lat), points, condition, spacing_m)
    return Coverage(lon, lat, status, spacing_m, nearby, step_m)


def coverage_cells(region: Area, spacing_m: float, most: int) -> tuple[Array, Array, float | None]:
    """Longitudes and latitudes of the centres of a region's spacing cells, and their distance on
    latitude rings, metres.

    In a region that a tangent plane shows, cells of ``spacing_m`` in that plane (distance None); else,
    and if there are more than ``most``, rings at the spacing or, so that there are no more, further
    apart: then the cells are an even sample.
    """
    if region.is_local:
        x0, x1, y0, y1 = region.extent_m
        if (x1 - x0) * (y1 - y0) <= most * spacing_m**2:
            return *_plane_cells(region, spacing_m), None
    lon, lat, step_m = ring_cells([region], spacing_m, most)
    if not len(lon):  # narrower than a cell
        return *_plane_cells(region, spacing_m), None
    return lon, lat, step_m


def ring_cells(regions: Sequence[Area], spacing_m: float, most: int) -> tuple[Array, Array, float]:
    """Longitudes and latitudes of the centres of the cells on latitude rings that lie in any of some
    regions, and their distance, metres: ``spacing_m`` or, so that there are not many more than
    ``most``, greater. A region that is narrower than a cell may have none.
    """
    step_m = max(spacing_m, math.sqrt(sum(_zone_m2(region) for region in regions) / most))
    cells = [np.zeros((0, 2))]
    for region in regions:
        lon, lat = _rings(region.bounds, step_m)
        cells.append(np.stack([lon, lat], axis=1)[region.contains(lon, lat)])
    places = np.concatenate(cells)
    _, first = np.unique(np.round(places, 9), axis=0, return_index=True)
    lon, lat = places[np.sort(first)].T
    return lon, lat, step_m


def _zone_m2(region: Area) -> float:
    """Surface of the box around a region."""
    west, south, east, north = region.bounds
    zone = math.sin(math.radians(north)) - math.sin(math.radians(south))
    return MOON_RADIUS_M**2 * math.radians(east - west) * zone


def _plane_cells(region: Area, spacing_m: float) -> tuple[Array, Array]:
    x0, x1, y0, y1 = region.extent_m
    x, y = np.meshgrid(middles(x0, x1, spacing_m), middles(y0, y1, spacing_m)[::-1])
    flat = np.stack([x, y, -(x**2 + y**2) / (2.0 * MOON_RADIUS_M)], axis=-1).reshape(-1, 3)
    lon, lat, _ = mcmf_to_lonlat(region.frame.to_mcmf(flat))
    inside = region.contains(lon, lat)
    return lon[inside], lat[inside]


def middles(low: float, high: float, step: float) -> Array:
    """Centres of cells of width ``step``, centred on a span."""
    count = max(1, round((high - low) / step))
    return np.asarray((low + high) / 2.0 + (np.arange(count) - (count - 1) / 2.0) * step)


def _rings(box: tuple[float, float, float, float], step_m: float) -> tuple[Array, Array]:
    """Centres of cells of nearly equal area on latitude rings, in a box of longitudes and latitudes:
    the rings are fixed on the Moon, and the cells of a ring begin at longitude 0.
    """
    west, south, east, north = box
    rings = max(1, math.ceil(math.pi * MOON_RADIUS_M / step_m))
    height = 180.0 / rings
    lons: list[Array] = [np.zeros(0)]
    lats: list[Array] = [np.zeros(0)]
    for ring in range(math.floor((south + 90.0) / height), math.ceil((north + 90.0) / height)):
        lat = -90.0 + (ring + 0.5) * height
        count = max(1, round(360.0 * math.cos(math.radians(lat)) / height))
        width = 360.0 / count
        first, last = math.floor(west / width), math.ceil(east / width)
        lon = (np.arange(first, min(last, first + count)) + 0.5) * width
        lons.append(turned_deg(np.asarray(lon, np.float64)))
        lats.append(np.full(len(lon), lat))
    return np.concatenate(lons), np.concatenate(lats)


def has_heights(dems: DemSet, lon_deg: Array, lat_deg: Array, sources: Sequence[int]) -> Mask:
    """True for places (n,) that have a height from one of the DEMs ``sources`` (indices)."""
    return np.isin(_read(dems, lon_deg, lat_deg, 0.0)[1], sources)


def _read(dems: DemSet, lon_deg: Array, lat_deg: Array, gsd_m: float) -> tuple[Array, Int16]:
    """Heights at places (n,), metres, and the index of each one's DEM (-1: none), some at a time."""
    height, index = np.full(len(lon_deg), np.nan), np.full(len(lon_deg), -1, np.int16)
    for start in range(0, len(height), _READ_AT_ONCE):
        part = slice(start, start + _READ_AT_ONCE)
        height[part], index[part] = dems.heights(lon_deg[part], lat_deg[part], gsd_m)
    return height, index


def overview_bytes(region: Area, gsd_m: float) -> float:
    """Bytes of the heights of a region's overview and its levels, which hardly compress."""
    nodes, levels = (OVERVIEW_NODES, 1.0) if region.is_local else (LARGE_NODES, 4.0 / 3.0)
    x0, x1, y0, y1 = region.extent_m
    step_m = max(gsd_m, max(x1 - x0, y1 - y0) / nodes)
    return 4.0 * levels * (x1 - x0) * (y1 - y0) / step_m**2


def region_overview(dems: DemSet, region: Area, gsd_m: float) -> Overview:
    """A coarse raster of the region: heights above the reference sphere. Those of a region that no
    tangent plane shows are of single pixels, of the coarsest product whose pixels are not wider than
    the nodes' distance: means would need every pixel of the DEM.
    """
    if region.is_local:
        return _local_overview(dems, region, gsd_m)
    plane = MapPlane.showing(region.bounds)
    x0, x1, y0, y1 = plane.extent_m(region.bounds)
    step = max(gsd_m, max(x1 - x0, y1 - y0) / LARGE_NODES)
    x, y = middles(x0, x1, step), middles(y0, y1, step)[::-1]
    lon, lat = plane.lonlat(*np.meshgrid(x, y))
    inside = np.isfinite(lon)
    inside[inside] = region.contains(lon[inside], lat[inside])
    height = np.full(lon.shape, np.nan, np.float32)
    height[inside] = nearest_heights(dems.for_cells(step), lon[inside], lat[inside])
    return Overview(height, x, y, plane.center_lon, plane.center_lat, plane.projection)


def _local_overview(dems: DemSet, region: Area, gsd_m: float) -> Overview:
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
