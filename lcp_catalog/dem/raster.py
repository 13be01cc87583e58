"""Pixels of a DEM file as heights in metres: windows only, NaN for missing pixels.

Uncompressed PDS images are mapped into memory by the label's description; GeoTIFF and JPEG 2000 are
read by GDAL. Open files belong to a process and a thread and are found by their path, so that a
``Raster`` can be pickled and sent to a worker.

Rasters with a grid on the Moon: windows that continue around the Moon and over the poles.
Heights (`dem`) and brightness (`photometry.albedo_map`) are read through it.
"""

from __future__ import annotations

import math
import os
import re
import threading
from collections import OrderedDict
from collections.abc import Hashable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from rasterio.env import set_gdal_config
from rasterio.windows import Window

from ..arrays import Float32
from ..atomic_files import file_state
from ..errors import DemError, LabelError
from ..file_kinds import no_file
from ..remote_files import archive_of, first_state, gdal_name, url_of
from .grid import Grid
from .raster_files import open_raster, opened, whole_reads

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
    files: tuple[Path, ...]
    """Every local file that is read."""

    @property
    def gsd_m(self) -> float:
        """Pixel size at true scale."""
        return self.grid.pixel_m

    @property
    def identity(self) -> Hashable:
        """Key of the values for caches; it changes when a file is written again."""
        return tuple((str(file), *_state(file)) for file in self.files)

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


POSSIBLE_M = 12_000.0
"""Greatest height or depth that is read (lowest place -9.1 km, highest 10.8 km): samples beyond it
are no heights.
"""

PIXELS_MAX = 30_000_000_000
"""Most pixels of a file that are all read: three times the Moon at 512 pixels a degree, minutes of reading."""
_PACKED, _MANY = 2000, 1_000_000_000
"""Beyond this ratio of the pixels' bytes to those of the files (deflate of zeros has 1030), most of so many pixels were
never written.
"""
_OPEN_FILES = 16
_WINDOW_PIXELS = 4_000_000
_CACHED_PIXELS = 1 << 16
"""Pixels that are made heights at a time: they stay in the processor's cache."""
GDAL_CACHE_BYTES = 256 << 20
"""Greatest size of GDAL's cache in a process, unless the variable GDAL_CACHEMAX of the environment
states one; GDAL itself takes 5 % of the machine's memory in every process."""
_local = threading.local()


@dataclass(frozen=True)
class Raster:
    """One band of heights: ``height_m = sample * scale_m + offset_m`` for samples that are not in
    ``missing``.
    """

    path: Path
    width: int
    height: int
    scale_m: float = 1.0
    offset_m: float = 0.0
    missing: tuple[float, ...] = ()
    raw_dtype: str | None = None  # None: read by GDAL
    raw_offset_bytes: int = 0
    band: int = 1  # of the file, counted from 1; read by GDAL
    masked: bool = False  # True if an alpha band or a mask of the file marks missing pixels
    stated_m: tuple[float, float] | None = None  # least and greatest height that the label admits
    is_sparse: bool = False  # True if most of very many pixels were never written

    @classmethod
    def of_band(cls, dataset: Any, files: tuple[Path, ...], path: Path, band: int = 1) -> Raster:
        """A band of a dataset that GDAL opened, counted from 1, with its scale, offset and missing value; ``files``: what is
        read for it.
        """
        scale, offset, nodata = (
            values[band - 1] for values in (dataset.scales, dataset.offsets, dataset.nodatavals)
        )
        missing = () if nodata is None or math.isnan(nodata) else (float(nodata),)
        size = dataset.width, dataset.height
        pixels = dataset.width * dataset.height
        stored = 0 if url_of(path) else sum(os.stat(file).st_size for file in files)
        packed = pixels * np.dtype(dataset.dtypes[band - 1]).itemsize / max(1, stored)
        sparse = pixels > _MANY and bool(stored) and packed > _PACKED
        found = cls(path, size[0], size[1], float(scale), float(offset), missing, band=band)
        return replace(found, is_sparse=sparse)

    def read(self, row0: int, row1: int, col0: int, col1: int) -> Float32:
        """Heights of rows row0..row1 and columns col0..col1 (half open, inside the raster), float32
        metres. DemError for a height beyond `POSSIBLE_M`, or beyond those that the label states.
        """
        samples = self.samples(row0, row1, col0, col1)
        out = np.empty(samples.shape, np.float32)
        rows = max(1, _CACHED_PIXELS // max(1, samples.shape[1]))
        for first in range(0, len(samples), rows):
            heights = self.heights_of(samples[first : first + rows])
            self._refuse_impossible(heights)
            out[first : first + rows] = heights
        return out

    def windows(self, width: int | None = None) -> Iterator[tuple[int, int, int, int]]:
        """Half-open windows (row0, row1, col0, col1) of some million pixels that cover the raster,
        or its first ``width`` columns, once; in whole blocks of the file, or in rows of one after the other
        if these are larger. DemError for more than `PIXELS_MAX`, and if most were never written.
        """
        width = self.width if width is None else width
        if width * self.height > PIXELS_MAX:
            raise DemError(
                f"{self.path}: {width} x {self.height} pixels are too many to read them all (at most "
                f"{PIXELS_MAX / 1e9:g} thousand million); make a file of a part (gdal_translate -projwin)"
            )
        if self.is_sparse:
            raise DemError(
                f"{self.path}: nearly none of its {self.width} x {self.height} pixels was ever written; make a file of "
                "the part that holds values (gdal_translate -projwin)"
            )
        high, wide = 1, width
        if self.raw_dtype is None:
            high, wide = _dataset(self.path).block_shapes[0]
        if high * wide > _WINDOW_PIXELS and wide < width:
            yield from _in_blocks((high, wide), (self.height, width))
            return
        if high * wide > _WINDOW_PIXELS:
            high, wide = 1, width
        across = max(1, min(width, _WINDOW_PIXELS // high) // wide) * wide
        down = max(1, _WINDOW_PIXELS // (min(across, width) * high)) * high
        for row in range(0, self.height, down):
            for column in range(0, width, across):
                yield row, min(row + down, self.height), column, min(column + across, width)

    def heights_of(self, samples: NDArray[Any]) -> NDArray[np.float64]:
        """Heights of samples, metres, NaN for missing data; not checked."""
        with np.errstate(
            invalid="ignore", over="ignore"
        ):  # signalling NaNs, and scales beyond reason
            heights = samples.astype(np.float64)
            if self.scale_m != 1.0:
                heights *= self.scale_m
            if self.offset_m != 0.0:
                heights += self.offset_m
        bad = ~np.isfinite(heights)
        for value in self.missing:
            bad |= samples == samples.dtype.type(value) if _fits(value, samples.dtype) else False
        heights[bad] = np.nan
        return heights

    def values(self, row0: int, row1: int, col0: int, col1: int) -> NDArray[np.float64]:
        """Values of a window, `heights_of` its samples, not checked; NaN also where the file's mask marks
        missing pixels, if it is `masked`.
        """
        values = self.heights_of(self.samples(row0, row1, col0, col1))
        if self.masked:
            window = Window(col0, row0, col1 - col0, row1 - row0)
            with whole_reads(self.path):
                values[_dataset(self.path).read_masks(self.band, window=window) == 0] = np.nan
        return values

    def samples(self, row0: int, row1: int, col0: int, col1: int) -> NDArray[Any]:
        """The stored numbers of a window. DemError if they cannot be read."""
        if self.raw_dtype is not None:
            return self._mapped()[row0:row1, col0:col1]
        with whole_reads(self.path):
            samples: NDArray[Any] = _dataset(self.path).read(
                self.band, window=Window(col0, row0, col1 - col0, row1 - row0)
            )
        return samples

    def _mapped(self) -> NDArray[Any]:
        try:
            return np.memmap(
                self.path,
                self.raw_dtype or "<i2",
                "r",
                offset=self.raw_offset_bytes,
                shape=(self.height, self.width),
            )
        except (OSError, ValueError) as error:
            raise DemError(f"{self.path}: cannot be read ({error})") from error

    def _refuse_impossible(self, heights: NDArray[np.float64]) -> None:
        ends = np.fmin.reduce(heights, axis=None), np.fmax.reduce(heights, axis=None)
        for value in map(float, ends):
            if abs(value) > POSSIBLE_M:
                raise DemError(
                    f"{self.path}: a height of {value:g} m cannot be on the Moon; its scale, its value for missing data, or that "
                    "heights are radii (their offset: gdal_translate -a_offset -1737400) is not declared"
                )
            if self.stated_m and (value < self.stated_m[0] or value > self.stated_m[1]):
                raise DemError(
                    f"{self.path}: has a height of {value:g} m where its label states {self.stated_m[0]:g} to "
                    f"{self.stated_m[1]:g} m: one of them is damaged or of another product; fetch both again"
                )


def _in_blocks(
    block: tuple[int, int], shape: tuple[int, int]
) -> Iterator[tuple[int, int, int, int]]:
    """Windows as `Raster.windows`, one block (rows, columns) of a raster (rows, columns) after the other: GDAL decodes a
    large one once as long as no other is read.
    """
    down = max(1, _WINDOW_PIXELS // block[1])
    for top in range(0, shape[0], block[0]):
        bottom = min(top + block[0], shape[0])
        for column in range(0, shape[1], block[1]):
            for row in range(top, bottom, down):
                yield row, min(row + down, bottom), column, min(column + block[1], shape[1])


def open_dataset(path: Path, kind: str = "a DEM") -> tuple[Any, tuple[Path, ...]]:
    """The file opened by GDAL (kept open for this thread), and every local file that is read for it
    (`raster_files.open_raster`); ``kind``: what it should be. DemError for a path that is no file and
    for a raster that cannot be read.
    """
    require_file(path, kind)
    dataset, files = open_raster(path, kind)
    return _dataset(path, dataset), files


_OTHER_LENGTHS = (
    r"[cdm]m|(centi|deci|milli)met(er|re)s?|(us[-_ ]?(survey )?)?(ft|foot|feet)([-_ ]?us)?\.?"
    r"|inch(es)?|y(ar)?ds?|miles?"
)
"""Units of length, other than metres and kilometres, as files state them."""


def unit_m(dataset: Any) -> float:
    """Metres in the unit of a dataset's first band: of kilometres 1000, of none or any text 1. DemError for `_OTHER_LENGTHS`."""
    unit = (dataset.units[0] or "").strip()
    if re.fullmatch(_OTHER_LENGTHS, unit, re.I):
        raise DemError(f"{dataset.name}: the unit is {unit}; convert the values to metres")
    return 1e3 if re.fullmatch(r"km|kilomet(er|re)s?", unit, re.I) else 1.0


def require_file(path: Path, kind: str) -> None:
    """DemError for a path that is no file; ``kind``: what it should be."""
    if url_of(path) is None and not (archive_of(path) or path).is_file():
        raise DemError(f"{path}: {no_file(path, kind)}")


def _dataset(path: Path, fresh: Any = None) -> Any:
    """The open dataset of a file in this process and thread; a file that has changed is opened
    again. ``fresh``: a dataset to be kept in place of one whose sources may have changed.
    """
    if getattr(_local, "pid", None) != os.getpid():
        _local.pid, _local.files = os.getpid(), OrderedDict()
    files: OrderedDict[tuple[int | str, ...], Any] = _local.files
    key = (str(path), *_state(path))
    if fresh is not None or key not in files:
        files[key] = opened(gdal_name(path), "a raster") if fresh is None else fresh
        if len(files) > _OPEN_FILES:
            files.popitem(last=False)[1].close()
    files.move_to_end(key)
    return files[key]


def _state(path: Path) -> tuple[int | str, ...]:
    """What changes with the content of a file; one on a server is asked once."""
    url = url_of(path)
    return file_state(os.stat(archive_of(path) or path)) if url is None else first_state(url)


def limit_gdal_cache(size_bytes: int) -> None:
    """Let GDAL's cache of this process take so much memory, at most `GDAL_CACHE_BYTES`."""
    if "GDAL_CACHEMAX" not in os.environ:
        set_gdal_config("GDAL_CACHEMAX", min(size_bytes, GDAL_CACHE_BYTES))


limit_gdal_cache(GDAL_CACHE_BYTES)


def _fits(value: float, dtype: np.dtype[Any]) -> bool:
    if np.issubdtype(dtype, np.integer):
        info = np.iinfo(dtype)
        return bool(info.min <= value <= info.max)
    return bool(abs(value) <= np.finfo(dtype).max)
