"""Rasters with a grid on the Moon: windows that continue around the Moon and over the poles.
Heights (`dem`) and brightness (`photometry.albedo_raster`) are read through it.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterator
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from ..arrays import Float32
from ..errors import DemError, LabelError
from .grid import Grid

_COARSER = 1.5
"""From this ratio of cell to pixel on, blocks of pixels are averaged before sampling."""


class WindowReader(Protocol):
    """Source of values: rows row0..row1, columns col0..col1 (half open, inside the raster), NaN
    without a value.
    """

    def read(self, row0: int, row1: int, col0: int, col1: int) -> Float32:
        """Values of a window, float32."""


def grid_of(dataset: Any, path: Path) -> Grid:
    """Grid of a file that GDAL opened. DemError if it has none, or none on the Moon."""
    if dataset.crs is None or dataset.transform.is_identity:
        raise DemError(f"{path}: has no map projection; a map of the Moon is needed")
    wkt, transform = dataset.crs.to_wkt(), tuple(dataset.transform)
    try:
        return Grid.from_wkt(wkt, transform, dataset.width, dataset.height)
    except LabelError as error:
        raise DemError(f"{path}: {error}") from error


class Gridded:
    """Base class of rasters with a grid."""

    path: Path
    grid: Grid
    raster: WindowReader

    @property
    def gsd_m(self) -> float:
        """Pixel size at true scale."""
        return self.grid.pixel_m

    @property
    def identity(self) -> Hashable:
        """Key of the values for caches; it changes when the file is written again."""
        stat = self.path.stat()
        return str(self.path), stat.st_mtime_ns, stat.st_size

    def read(self, row0: int, row1: int, col0: int, col1: int) -> Float32:
        """Values of a window that may reach beyond the raster: NaN there, except where the product
        continues around the Moon or over a pole.

        Columns of a global product repeat; beyond the pole of a global cylinder its rows continue
        on the other side.
        """
        out = np.full((row1 - row0, col1 - col0), np.nan, np.float32)
        for source, target, turn in self._row_runs(row0, row1):
            for columns, place in self._column_runs(col0 + turn, col1 + turn):
                block = self.raster.read(source[0], source[1], columns[0], columns[1])
                out[target[0] : target[1], place[0] : place[1]] = (
                    block if target[2] > 0 else block[::-1]
                )
        return out

    def _row_runs(
        self, row0: int, row1: int
    ) -> Iterator[tuple[tuple[int, int], tuple[int, int, int], int]]:
        """(rows of the raster), (rows of the window, direction), number of columns to turn by."""
        height, half = self.grid.height, self.grid.period // 2
        first, last = max(row0, 0), min(row1, height)
        if first < last:
            yield (first, last), (first - row0, last - row0, 1), 0
        if not self.grid.wraps or self.grid.period % 2:
            return
        north, south = self._reaches_poles
        for there, above, below, mirror in (
            (north, row0, min(row1, 0), -1),
            (south, max(row0, height), row1, 2 * height - 1),
        ):
            top, bottom = max(above, mirror - height + 1), min(below, mirror + 1)
            if there and top < bottom:  # row r beyond the pole is row mirror - r on the other side
                yield (mirror - bottom + 1, mirror - top + 1), (top - row0, bottom - row0, -1), half

    @cached_property
    def _reaches_poles(self) -> tuple[bool, bool]:
        box = self.grid.bounds
        return abs(box.north - 90.0) < 1e-6, abs(box.south + 90.0) < 1e-6

    def _column_runs(
        self, col0: int, col1: int
    ) -> Iterator[tuple[tuple[int, int], tuple[int, int]]]:
        """(columns of the raster), (columns of the window)."""
        width = self.grid.period if self.grid.wraps else self.grid.width
        turns = (
            range(math.floor(col0 / width), math.ceil(col1 / width))
            if self.grid.wraps
            else range(1)
        )
        for turn in turns:
            first, last = max(col0, turn * width), min(col1, (turn + 1) * width)
            if first < last:
                yield (first - turn * width, last - turn * width), (first - col0, last - col0)

    def factor(self, gsd_m: float) -> int:
        """Pixels a side that are averaged before sampling at ``gsd_m``: 1 below a ratio of 1.5,
        else the rounded ratio.

        Around the Moon it is lowered to a divisor of the number of columns, so that blocks do not
        depend on the start of a window.
        """
        ratio = gsd_m / self.grid.pixel_m
        if not ratio >= _COARSER:
            return 1
        wanted = min(math.floor(ratio + 0.5), max(self.grid.width, self.grid.height))
        if not self.grid.wraps:
            return wanted
        return next(f for f in range(wanted, 0, -1) if self.grid.period % f == 0)
