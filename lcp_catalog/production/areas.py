"""The areas of a build.

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

from ..arrays import Array
from ..constants import MOON_RADIUS_M
from ..dem.mosaic import DemSet
from ..errors import AreaError
from ..geometry.bounds import Bounds
from ..geometry.frames import EnuFrame, lonlat_to_mcmf, mcmf_to_lonlat
from ..terrain.area import Area, NodeWindow
from .model_config import ModelConfig
from .sweep import PART_STEP

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
    region have the same window, which is computed once; that of a part begins at multiples of `PART_STEP` nodes
    after it, so that pixels of coarser images are those of the whole area. AreaError for more than `AREAS_MAX`.
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
                window = _aligned(_window(grid, row, column, places, False, gsd_m), full)
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


def _aligned(part: NodeWindow, whole: NodeWindow) -> NodeWindow:
    """The window of a part of an area, within that of the whole area, with a first row and column that are multiples of
    `PART_STEP` after those of the whole.
    """
    row0, col0 = (
        start + max(0, own - start) // PART_STEP * PART_STEP
        for own, start in ((part.row0, whole.row0), (part.col0, whole.col0))
    )
    return NodeWindow(row0, min(part.row1, whole.row1), col0, min(part.col1, whole.col1))
