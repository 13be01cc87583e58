"""The areas of a build.

Areas lie on a grid that is fixed on the Moon: rows of equal latitude, each divided into equal
longitudes. It depends only on the cell size and the direction tolerance, so a place has the same nodes
and a point the same id in every build.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array
from ..constants import MOON_RADIUS_M
from ..geometry.frames import EnuFrame, lonlat_to_mcmf, mcmf_to_lonlat
from ..terrain.area import Area, NodeWindow
from .config import ModelConfig

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

    def box(self, row: int, column: int) -> tuple[float, float, float, float]:
        """West, south, east, north of an area, degrees; longitudes 0..360."""
        south, north = self.latitudes(row)
        width = 360.0 / self.columns(row)
        return column * width, south, (column + 1) * width, north

    def owner(self, lon_deg: Array, lat_deg: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Row and column of the area that contains each place; every place belongs to exactly one area."""
        row = np.clip(
            np.floor((np.asarray(lat_deg) + 90.0) / self.height_deg).astype(np.int64),
            0,
            self.rows - 1,
        )
        rows, back = np.unique(row, return_inverse=True)
        columns = np.array([self.columns(int(r)) for r in rows], dtype=np.int64)[back].reshape(
            row.shape
        )
        column = np.floor((np.asarray(lon_deg) % 360.0) / 360.0 * columns).astype(np.int64)
        return row, np.minimum(column, columns - 1)


@dataclass(frozen=True)
class AreaTask:
    """One area of a build: its place in the grid, its frame's centre, and the window of nodes that the region needs of it."""

    row: int
    column: int
    lon_deg: float
    lat_deg: float
    window: NodeWindow

    @property
    def name(self) -> str:
        return f"r{self.row:05d}c{self.column:05d}"

    @property
    def frame(self) -> EnuFrame:
        return EnuFrame(self.lon_deg, self.lat_deg)


def plan_areas(grid: AreaGrid, region: Area, gsd_m: float) -> list[AreaTask]:
    """The areas that intersect the region, from south to north and west to east.

    An area's part of the region is found from sample points in its box and on the region's outline (a
    narrow part can lie between the points of the box).
    """
    outline = _outline(grid, region)
    rows, columns = grid.owner(*outline)
    areas = sorted(
        set(_touched(grid, region)) | set(zip(rows.tolist(), columns.tolist(), strict=True))
    )
    tasks = []
    for row, column in areas:
        mine = (rows == row) & (columns == column)
        task = _task(grid, row, column, region, (outline[0][mine], outline[1][mine]), gsd_m)
        if task is not None:
            tasks.append(task)
    return tasks


def _outline(grid: AreaGrid, region: Area) -> tuple[Array, Array]:
    """Longitudes and latitudes along the region's outline, as dense as the sample points of a box."""
    x0, x1, y0, y1 = region.extent_m
    step_m = math.radians(grid.height_deg) * MOON_RADIUS_M / (_SAMPLES - 1)
    along = np.linspace(0.0, 1.0, math.ceil(max(x1 - x0, y1 - y0) / step_m) + 2)
    low, high = np.zeros_like(along), np.ones_like(along)
    east, north = (
        np.concatenate([along, along, low, high]),
        np.concatenate([low, high, along, along]),
    )
    if region.box is not None:
        west, south, box_east, box_north = region.box
        return west + east * (box_east - west), south + north * (box_north - south)
    x, y = x0 + east * (x1 - x0), y0 + north * (y1 - y0)
    z = np.sqrt(MOON_RADIUS_M**2 - x**2 - y**2) - MOON_RADIUS_M
    lon, lat, _ = mcmf_to_lonlat(region.frame.to_mcmf(np.stack([x, y, z], axis=-1)))
    return lon, lat


def _touched(grid: AreaGrid, region: Area) -> Iterator[tuple[int, int]]:
    """Rows and columns whose boxes can intersect the region's bounds, with a margin of one area."""
    west, south, east, north = region.bounds
    first = max(0, int((south + 90.0) / grid.height_deg) - 1)
    last = min(grid.rows - 1, int((north + 90.0) / grid.height_deg) + 1)
    for row in range(first, last + 1):
        columns = grid.columns(row)
        width = 360.0 / columns
        start, stop = math.floor(west / width) - 1, math.floor(east / width) + 1
        wanted = (
            range(columns)
            if stop - start + 1 >= columns
            else sorted({c % columns for c in range(start, stop + 1)})
        )
        yield from ((row, column) for column in wanted)


def _task(
    grid: AreaGrid, row: int, column: int, region: Area, outline: tuple[Array, Array], gsd_m: float
) -> AreaTask | None:
    west, south, east, north = grid.box(row, column)
    lon, lat = np.meshgrid(np.linspace(west, east, _SAMPLES), np.linspace(south, north, _SAMPLES))
    inside = region.contains(lon, lat)
    lons, lats = (
        np.concatenate([lon[inside], outline[0]]),
        np.concatenate([lat[inside], outline[1]]),
    )
    if not lons.size:
        return None
    task_lon, task_lat = (west + east) / 2.0, (south + north) / 2.0
    x, y, _ = np.moveaxis(EnuFrame(task_lon, task_lat).from_mcmf(lonlat_to_mcmf(lons, lats)), -1, 0)
    step = math.radians(grid.height_deg) * MOON_RADIUS_M / (_SAMPLES - 1) / gsd_m
    margin = 1.0 if inside.all() else step + 1.0
    return AreaTask(
        row=row,
        column=column,
        lon_deg=task_lon,
        lat_deg=task_lat,
        window=NodeWindow(
            row0=math.floor(-y.max() / gsd_m - margin),
            row1=math.ceil(-y.min() / gsd_m + margin) + 1,
            col0=math.floor(x.min() / gsd_m - margin),
            col1=math.ceil(x.max() / gsd_m + margin) + 1,
        ),
    )
