"""Maps of a build's region: the status of its spacing cells, and an overview of its heights.

A region that a tangent plane shows has both in the plane of its centre. A larger one has cells on
latitude rings that are fixed on the Moon, and an overview in an equirectangular or polar map.

The areas of a build.

Areas lie on a grid that is fixed on the Moon: rows of equal latitude, each divided into equal
longitudes. It depends only on the cell size and the direction tolerance, so a place has the same nodes
and a point the same id in every build.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array, Int16, Mask
from ..catalog.maps import usable_nearby
from ..catalog.model import Coverage, Overview
from ..constants import MOON_RADIUS_M
from ..dem.mosaic import DemSet, nearest_heights
from ..errors import AreaError
from ..geometry.bounds import Bounds, turned_deg
from ..geometry.frames import EnuFrame, lonlat_to_mcmf, mcmf_to_lonlat
from ..geometry.map_plane import MapPlane
from ..landmarks.selection import Places, Status, coverage
from ..terrain.area import Area, NodeWindow
from ..terrain.terrain import build_terrain
from .config import ModelConfig

AREAS_MAX = 500_000
"""Most areas of a build: twice the whole Moon in cells of 24 m. A planned area takes 1.5 kB."""

_SAMPLES = 49
"""Sample points per side at which an area's box is compared with the region."""


@dataclass(frozen=True)
class AreaGrid:
    """Rows of equal latitude. At the edge nearer the equator, columns are at most as wide as the row is high."""

    rows: int

    @classmethod
    def for_cell(cls, gsd_m: float, model: ModelConfig) -> AreaGrid:
        """The coarsest grid with half a diagonal below the direction tolerance and a side below the node limit."""
        by_direction = math.sqrt(2.0) * model.direction_tolerance_deg
        by_nodes = math.degrees(model.area_nodes_max * gsd_m / MOON_RADIUS_M)
        return cls(rows=math.ceil(180.0 / min(by_direction, by_nodes)))

    @property
    def height_deg(self) -> float:
        return 180.0 / self.rows

    def columns(self, row: int) -> int:
        """Number of areas in a row; rows are counted from the south pole."""
        south, north = self.latitudes(row)
        nearest = 0.0 if south < 0.0 < north else min(abs(south), abs(north))
        return max(1, math.ceil(360.0 * math.cos(math.radians(nearest)) / self.height_deg))

    def latitudes(self, row: int) -> tuple[float, float]:
        return -90.0 + row * self.height_deg, -90.0 + (row + 1) * self.height_deg

    def box(self, row: int, column: int) -> Bounds:
        """The box of an area; longitudes 0..360."""
        south, north = self.latitudes(row)
        width = 360.0 / self.columns(row)
        return Bounds(column * width, south, (column + 1) * width, north)

    def middle(self, row: int, column: int) -> tuple[float, float]:
        """Longitude and latitude of the centre of an area, degrees."""
        west, south, east, north = self.box(row, column)
        return (west + east) / 2.0, (south + north) / 2.0

    def owner(self, lon_deg: Array, lat_deg: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Row and column of the area that contains each place; every place belongs to exactly one area."""
        row = np.clip(
            np.floor((np.asarray(lat_deg) + 90.0) / self.height_deg).astype(np.int64),
            0,
            self.rows - 1,
        )
        first, last = int(row.min(initial=self.rows - 1)), int(row.max(initial=0))
        counts = [self.columns(r) for r in range(first, last + 1)]
        columns = np.array(counts, dtype=np.int64)[row - first]
        column = np.floor((np.asarray(lon_deg) % 360.0) / 360.0 * columns).astype(np.int64)
        return row, np.minimum(column, columns - 1)


@dataclass(frozen=True)
class AreaTask:
    """One area of a build: its place in the grid, its frame's centre, and the window of nodes that the region
    needs of it. ``level``: number of its cell size in a build of several.
    """

    row: int
    column: int
    lon_deg: float
    lat_deg: float
    window: NodeWindow
    level: int | None = None

    @property
    def name(self) -> str:
        level = "" if self.level is None else f"l{self.level:02d}"
        return f"{level}r{self.row:05d}c{self.column:05d}"

    @property
    def frame(self) -> EnuFrame:
        return EnuFrame(self.lon_deg, self.lat_deg)


def plan_areas(grid: AreaGrid, region: Area, gsd_m: float) -> list[AreaTask]:
    """The areas that intersect the region, from south to north and west to east.

    An area's part of the region is found from sample points in its box and on the region's outline (a
    narrow part can lie between the points of the box). All areas of a row that lie wholly in the
    region have the same window, which is computed once. AreaError for more than `AREAS_MAX`.
    """
    _require_few(grid, region, gsd_m)
    outline = _outline_by_area(grid, region)
    nothing = np.zeros(0), np.zeros(0)
    touched: dict[int, Iterable[int]] = dict(_touched(grid, region))
    for row, column in outline:
        if column not in touched.get(row, ()):
            touched[row] = sorted({*touched.get(row, ()), column})
    tasks = []
    for row in sorted(touched):
        columns = np.array(touched[row])
        whole = _wholly_inside(grid, row, columns, region)
        full = _window(grid, row, 0, sample_places(grid, row, 0), True, gsd_m)
        for column, inside in zip(columns.tolist(), whole.tolist(), strict=True):
            window = full
            if not inside:
                lon, lat = sample_places(grid, row, column)
                mine = region.contains(lon, lat)
                edge = outline.get((row, column), nothing)
                places = np.concatenate([lon[mine], edge[0]]), np.concatenate([lat[mine], edge[1]])
                if not places[0].size:
                    continue
                window = _window(grid, row, column, places, False, gsd_m)
            tasks.append(AreaTask(row, column, *grid.middle(row, column), window))
    return tasks


def _require_few(grid: AreaGrid, region: Area, gsd_m: float) -> None:
    """AreaError if the region's bounds hold more than `AREAS_MAX` areas; nothing is listed for that."""
    count = region.bounds_m2 / (math.radians(grid.height_deg) * MOON_RADIUS_M) ** 2
    if count > AREAS_MAX:
        raise AreaError(
            f"cells of {gsd_m:g} m divide the region into some {count:.2g} areas, at most {AREAS_MAX:,} "
            "can be built; take a coarser `area.gsd_m` or a smaller region"
        )


def _outline_by_area(grid: AreaGrid, region: Area) -> dict[tuple[int, int], tuple[Array, Array]]:
    """Longitudes and latitudes along the region's outline, by the row and column of their area."""
    lon, lat = _outline(grid, region)
    row, column = grid.owner(lon, lat)
    order = np.lexsort((column, row))
    first = np.flatnonzero(np.diff(row[order], prepend=-1) | np.diff(column[order], prepend=-1))
    return {
        (int(row[part[0]]), int(column[part[0]])): (lon[part], lat[part])
        for part in np.split(order, first[1:])
    }


def _outline(grid: AreaGrid, region: Area) -> tuple[Array, Array]:
    """Longitudes and latitudes along the region's outline, as dense as the sample points of a box."""
    step_deg = grid.height_deg / (_SAMPLES - 1)
    if region.box is not None:
        west, south, box_east, box_north = region.box
        east, north = _sides(max(box_east - west, box_north - south) / step_deg)
        return west + east * (box_east - west), south + north * (box_north - south)
    x0, x1, y0, y1 = region.extent_m
    east, north = _sides(max(x1 - x0, y1 - y0) / (math.radians(step_deg) * MOON_RADIUS_M))
    x, y = x0 + east * (x1 - x0), y0 + north * (y1 - y0)
    z = np.sqrt(MOON_RADIUS_M**2 - x**2 - y**2) - MOON_RADIUS_M
    lon, lat, _ = mcmf_to_lonlat(region.frame.to_mcmf(np.stack([x, y, z], axis=-1)))
    return lon, lat


def _sides(steps: float) -> tuple[Array, Array]:
    """The four sides of the unit square, each in at least so many steps: x and y."""
    along = np.linspace(0.0, 1.0, math.ceil(steps) + 2)
    low, high = np.zeros_like(along), np.ones_like(along)
    return np.concatenate([along, along, low, high]), np.concatenate([low, high, along, along])


def _touched(grid: AreaGrid, region: Area) -> Iterator[tuple[int, Sequence[int]]]:
    """Rows and their columns whose boxes can intersect the region's bounds, with a margin of one area."""
    west, south, east, north = region.bounds
    first = max(0, int((south + 90.0) / grid.height_deg) - 1)
    last = min(grid.rows - 1, int((north + 90.0) / grid.height_deg) + 1)
    for row in range(first, last + 1):
        columns = grid.columns(row)
        width = 360.0 / columns
        start, stop = math.floor(west / width) - 1, math.floor(east / width) + 1
        everything = stop - start + 1 >= columns
        wanted = {c % columns for c in range(start, stop + 1)}
        yield row, range(columns) if everything else sorted(wanted)


def _wholly_inside(
    grid: AreaGrid, row: int, columns: NDArray[np.int64], region: Area
) -> NDArray[np.bool_]:
    """True for columns whose sample points all lie in the region: those on the border of the box do,
    and a region has no hole as small as an area.
    """
    x, y = _sides(_SAMPLES - 2)
    width = 360.0 / grid.columns(row)
    south, north = grid.latitudes(row)
    lon = (columns[:, None] * width) * (1.0 - x) + ((columns[:, None] + 1) * width) * x
    lat = np.broadcast_to(south * (1.0 - y) + north * y, lon.shape)
    return np.asarray(region.contains(lon, lat).all(axis=1))


def sample_places(grid: AreaGrid, row: int, column: int) -> tuple[Array, Array]:
    """Longitudes and latitudes of the sample points in an area's box."""
    west, south, east, north = grid.box(row, column)
    lon, lat = np.meshgrid(np.linspace(west, east, _SAMPLES), np.linspace(south, north, _SAMPLES))
    return lon.ravel(), lat.ravel()


def reached(
    tasks: Sequence[AreaTask], grid: AreaGrid, dems: DemSet, own: Sequence[int]
) -> list[AreaTask]:
    """The areas that one of the DEMs ``own`` (indices) reaches into. No pixel is read."""
    if len(own) == len(dems.dems):
        return list(tasks)
    boxes = [dems.dems[i].grid.bounds for i in own]
    return [
        task
        for task in tasks
        if any(box.meets(grid.box(task.row, task.column)) for box in boxes)
        and dems.candidates_at(*sample_places(grid, task.row, task.column))[list(own)].any()
    ]


def _window(
    grid: AreaGrid, row: int, column: int, places: tuple[Array, Array], whole: bool, gsd_m: float
) -> NodeWindow:
    """The nodes of an area that enclose places (longitudes, latitudes) in it, with a margin;
    ``whole``: they are all its sample points.
    """
    frame, (lon, lat) = EnuFrame(*grid.middle(row, column)), places
    x, y, _ = np.moveaxis(frame.from_mcmf(lonlat_to_mcmf(lon, lat)), -1, 0)
    step = math.radians(grid.height_deg) * MOON_RADIUS_M / (_SAMPLES - 1) / gsd_m
    margin = 1.0 if whole else step + 1.0
    return NodeWindow(
        row0=math.floor(-y.max() / gsd_m - margin),
        row1=math.ceil(-y.min() / gsd_m + margin) + 1,
        col0=math.floor(x.min() / gsd_m - margin),
        col1=math.ceil(x.max() / gsd_m + margin) + 1,
    )


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
