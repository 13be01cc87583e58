"""One DEM file read once, in strips: its heights' range, and where pixels are missing."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..arrays import Array
from ..constants import MOON_RADIUS_M
from ..geometry.bounds import around
from .connected_regions import Region, components
from .dem import Dem, Statistics
from .grid import EDGE_PX, Grid

_BLOCKS = 1024
"""Missing pixels are counted in so many square blocks a side at most."""
_STRIP_PIXELS = 4_000_000


@dataclass(frozen=True)
class Survey:
    """What one pass over a file found; ``missing`` (rows, columns) counts missing pixels in blocks of ``block`` x ``block``."""

    dem: Dem
    statistics: Statistics
    block: int
    missing: NDArray[np.int64]

    def hole_km2(self) -> float:
        """Ground of all missing pixels."""
        rows, columns = np.nonzero(self.missing)
        return float(self._ground(rows, columns).sum())

    def holes(self, most: int = 5) -> tuple[Region, ...]:
        """The largest pieces of missing ground, largest first; exact to a block."""
        rows, columns = np.nonzero(self.missing)
        if rows.size == 0:
            return ()
        grid = self.dem.grid
        turn = float(self.missing.shape[1]) if grid.wraps else 0.0
        label = components(rows, columns.astype(np.float64), columns + np.float64(1.0), turn)
        ground = np.bincount(label, self._ground(rows, columns))
        largest = np.argsort(-ground, kind="stable")[:most]
        return tuple(
            self._region(rows[label == k], columns[label == k], ground[k]) for k in largest
        )

    def absent(self, lon_deg: ArrayLike, lat_deg: ArrayLike) -> NDArray[np.bool_]:
        """True at places of the footprint in whose block at least half of the pixels are missing."""
        grid = self.dem.grid
        u, v = grid.pixel(lon_deg, lat_deg)
        with np.errstate(invalid="ignore"):
            inside = (u >= -0.5 - EDGE_PX) & (u <= grid.width - 0.5 + EDGE_PX)
            inside &= (v >= -0.5 - EDGE_PX) & (v <= grid.height - 0.5 + EDGE_PX)
        column = np.clip(np.floor(np.where(inside, u, 0.0) + 0.5), 0, grid.width - 1).astype(
            np.int64
        )
        row = np.clip(np.floor(np.where(inside, v, 0.0) + 0.5), 0, grid.height - 1).astype(np.int64)
        return (
            inside & (2 * self.missing >= self._pixels())[row // self.block, column // self.block]
        )

    def _pixels(self) -> NDArray[np.int64]:
        """Pixels of every block: fewer at the right and lower edge."""
        (rows, columns), grid = self.missing.shape, self.dem.grid
        high = np.minimum(self.block, grid.height - self.block * np.arange(rows))
        wide = np.minimum(self.block, grid.width - self.block * np.arange(columns))
        return high[:, None] * wide

    def _ground(self, rows: NDArray[np.int64], columns: NDArray[np.int64]) -> Array:
        """Square kilometres of the missing pixels of blocks, each counted at its block's centre."""
        left, right, top, bottom = self._edges(rows, columns)
        area = pixel_km2(self.dem.grid, 0.5 * (left + right), 0.5 * (top + bottom))
        return np.asarray(self.missing[rows, columns] * area)

    def _edges(self, rows: NDArray[np.int64], columns: NDArray[np.int64]) -> tuple[Array, ...]:
        """Fractional pixels of the blocks' outer edges: left, right, top, bottom."""
        grid, block = self.dem.grid, self.block
        left, top = columns * block - 0.5, rows * block - 0.5
        right, bottom = (
            np.minimum(left + block, grid.width - 0.5),
            np.minimum(top + block, grid.height - 0.5),
        )
        return tuple(np.asarray(edge, np.float64) for edge in (left, right, top, bottom))

    def _region(
        self, rows: NDArray[np.int64], columns: NDArray[np.int64], area_km2: float
    ) -> Region:
        """The box around blocks that hang together."""
        grid = self.dem.grid
        left, right, top, bottom = self._edges(rows, columns)
        lon, lat = grid.lonlat(
            np.stack([left, right, left, right]), np.stack([top, top, bottom, bottom])
        )
        south, north = max(float(lat.min()), -90.0), min(float(lat.max()), 90.0)
        if not grid.pole:
            degree_m = math.radians(1.0) * MOON_RADIUS_M * math.cos(math.radians(grid.true_lat_deg))
            wide = (right - left) * grid.pixel_m / degree_m
            return Region(around(lon[0], lon[0] + wide, south, north), float(area_km2))
        column, row = -grid.x0_m / grid.pixel_m, grid.y0_m / grid.pixel_m
        if bool(((left <= column) & (column <= right) & (top <= row) & (row <= bottom)).any()):
            south, north = (south, 90.0) if grid.pole > 0 else (-90.0, north)
            return Region(around(np.zeros(1), np.full(1, 360.0), south, north), float(area_km2))
        away = (lon - lon[0] + 180.0) % 360.0 - 180.0
        box = around(lon[0] + away.min(axis=0), lon[0] + away.max(axis=0), south, north)
        return Region(box, float(area_km2))


def survey(dem: Dem) -> Survey:
    """Read a whole file, once, in strips of a few million pixels."""
    raster = dem.raster
    block = math.ceil(max(raster.width, raster.height) / _BLOCKS)
    starts = np.arange(0, raster.width, block)
    missing = np.zeros((math.ceil(raster.height / block), starts.size), np.int64)
    low, high = math.inf, -math.inf
    for row, heights in _strips(dem):
        bad = np.isnan(heights)
        if bad.any():
            counts = np.add.reduceat(bad, starts, axis=1, dtype=np.int64)
            np.add.at(missing, (row + np.arange(len(counts))) // block, counts)
        if not bad.all():
            low, high = min(low, float(np.nanmin(heights))), max(high, float(np.nanmax(heights)))
    share = int(missing.sum()) / (raster.width * raster.height)
    found = Statistics(low, high, share) if low <= high else Statistics(None, None, share)
    return Survey(dem, found, block, missing)


def _strips(dem: Dem) -> Iterator[tuple[int, NDArray[np.float32]]]:
    raster = dem.raster
    step = max(1, _STRIP_PIXELS // raster.width)
    for row in range(0, raster.height, step):
        yield row, raster.read(row, min(row + step, raster.height), 0, raster.width)


def pixel_km2(grid: Grid, column: ArrayLike, row: ArrayLike) -> Array:
    """Ground area of pixels, square kilometres (`Grid.cell_weight` leaves out a cylinder's standard parallel)."""
    true = 1.0 if grid.pole else math.cos(math.radians(grid.true_lat_deg))
    return np.asarray((grid.pixel_m / 1000.0) ** 2 / true * grid.cell_weight(column, row))
