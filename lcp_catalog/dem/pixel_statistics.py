"""Statistics of all pixels of a DEM file, each from one pass: heights and missing pixels
(`height_statistics`), and stored samples, which show damage (`sample_statistics`).

Connected regions of a raster, and their boxes on the Moon.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..arrays import AnyArray, Array, Index, Mask
from ..constants import MOON_RADIUS_M
from ..geometry.bounds import Bounds, enclosing_bounds, wrapped_deg
from .dem import Dem
from .grid import Grid
from .raster import POSSIBLE_M, Raster


@dataclass(frozen=True)
class Region:
    """A part of the surface: the box around it, and its own area."""

    bounds: Bounds
    area_km2: float


def connected_regions(mask: Mask, wraps: bool = False) -> Index:
    """Number of each cell's region, (rows, columns): 0 outside the ``mask`` (rows, columns), 1, 2, ...
    in it. Cells are connected along their sides; if the raster ``wraps``, also from the last column
    to the first.
    """
    from scipy import ndimage
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    label, count = ndimage.label(mask)
    if wraps and count:
        first, last = label[:, 0], label[:, -1]
        both = (first > 0) & (last > 0)
        joined = coo_array(
            (np.ones(np.count_nonzero(both)), (first[both], last[both])), (count + 1, count + 1)
        )
        label = connected_components(joined, directed=False)[1][label]
    return np.asarray(label, np.int64)


_BLOCK_PX = 8
"""A square of so many pixels a side that are all zero is no ground."""

_ZEROS_PX = 16
_EQUAL_PX = 64
"""Lines of so many pixels of zeros, or of any one height, are no ground. The longest of the 55 million pixels of WAC GLD100
(16, 64 and 256 px/deg, whole metres), LDEM_4 and a polar LDEM have 7 and 24, where pixels are not narrower than high.
"""


@dataclass(frozen=True)
class Stuck:
    """Numbers of pixels in lines and squares of zeros, and in lines of another height."""

    zeros: int
    others: int

    def __add__(self, other: Stuck) -> Stuck:
        return Stuck(self.zeros + other.zeros, self.others + other.others)


def stuck_pixels(heights: AnyArray, narrow: Array) -> Stuck:
    """Pixels of a window (rows, cols) in lines, along a row or a column, of at least `_ZEROS_PX` zeros or `_EQUAL_PX` equal
    heights, or in squares of `_BLOCK_PX` x `_BLOCK_PX` zeros. ``narrow`` (rows,): width of the pixels over their height;
    rows of narrow ones need more.
    """
    zero = heights == 0.0
    zeros = np.zeros(zero.shape, np.bool_)
    high, wide = (size // _BLOCK_PX * _BLOCK_PX for size in zero.shape)
    squares = zero[:high, :wide].reshape(high // _BLOCK_PX, _BLOCK_PX, wide // _BLOCK_PX, _BLOCK_PX)
    whole = squares.all(axis=(1, 3))
    zeros[:high, :wide] = whole.repeat(_BLOCK_PX, axis=0).repeat(_BLOCK_PX, axis=1)
    others = np.zeros_like(zeros)
    octaves = np.rint(-np.log2(np.clip(narrow, 1e-6, 1.0))).astype(np.int64)
    for octave in np.unique(octaves).tolist():
        rows = octaves == octave
        _add_lines(heights[rows], zero[rows], octave, zeros, others, rows)
    _add_lines(heights.T, zero.T, 0, zeros.T, others.T, slice(None))
    return Stuck(int(np.count_nonzero(zeros)), int(np.count_nonzero(others)))


def _add_lines(
    heights: AnyArray, zero: Mask, octave: int, zeros: Mask, others: Mask, rows: Mask | slice
) -> None:
    same = heights[:, 1:] == heights[:, :-1]
    both = zero[:, 1:] & zero[:, :-1]
    for one, found, least in ((both, zeros, _ZEROS_PX), (same & ~both, others, _EQUAL_PX)):
        if (lines := _lines(one, least << octave)) is not None:
            found[rows] |= lines


def _lines(same: Mask, least: int) -> Mask | None:
    """Pixels (rows, cols) in runs of at least ``least`` that are the ``same`` (rows, cols - 1) as their next; None if none is."""
    first, size = same, 1
    while size < least - 1 and first.shape[1] and first.any():
        step = min(size, least - 1 - size)
        first, size = first[:, :-step] & first[:, step:], size + step
    if not first.any():
        return None
    found = np.zeros((len(same), same.shape[1] + 1), np.bool_)
    found[:, : first.shape[1]], size = first, 1
    while size < least:
        step = min(size, least - size)
        found[:, step:] |= found[:, :-step].copy()
        size += step
    return found


def narrowness(grid: Grid, row0: int, row1: int) -> Array:
    """Width of the pixels of rows over their height: less than 1 where a cylinder nears its pole."""
    if grid.pole:
        return np.ones(row1 - row0)
    lat = (grid.y0_m - np.arange(row0, row1) * grid.pixel_m) / MOON_RADIUS_M
    return np.asarray(np.cos(lat) / math.cos(math.radians(grid.true_lat_deg)))


_BLOCKS = 1024
"""Missing pixels are counted in at most so many square blocks a side."""


@dataclass(frozen=True)
class HeightStatistics:
    """Lowest and highest height, None in a file without heights; the share of missing pixels, and
    their number in blocks of ``block`` x ``block`` pixels, ``missing`` (rows, columns); pixels that are `Stuck`.
    """

    dem: Dem
    min_m: float | None
    max_m: float | None
    nodata_share: float
    block: int
    missing: NDArray[np.int64]
    stuck: Stuck

    def hole_km2(self) -> float:
        """Area of all missing pixels."""
        rows, columns = np.nonzero(self.missing)
        return float(self._ground(rows, columns).sum())

    def holes(self, most: int = 5) -> tuple[Region, ...]:
        """The largest connected regions of missing pixels, largest first; exact to a block."""
        rows, columns = np.nonzero(self.missing)
        if rows.size == 0:
            return ()
        label = connected_regions(self.missing > 0, self.dem.grid.wraps)[rows, columns]
        area_km2 = np.bincount(label, self._ground(rows, columns))
        largest = np.argsort(-area_km2[1:], kind="stable")[:most] + 1
        return tuple(
            self._region(rows[label == k], columns[label == k], area_km2[k]) for k in largest
        )

    def absent(self, lon_deg: ArrayLike, lat_deg: ArrayLike) -> NDArray[np.bool_]:
        """True at places of the footprint in a block of which at least half of the pixels are
        missing.
        """
        grid = self.dem.grid
        inside, u, v = grid.located(lon_deg, lat_deg)
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
        """Area of the missing pixels of blocks, km2, each taken at the centre of its block."""
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
        """The box around connected blocks, with their area."""
        grid = self.dem.grid
        left, right, top, bottom = self._edges(rows, columns)
        lon, lat = grid.lonlat(
            np.stack([left, right, left, right]), np.stack([top, top, bottom, bottom])
        )
        south, north = max(float(lat.min()), -90.0), min(float(lat.max()), 90.0)
        if not grid.pole:
            degree_m = math.radians(1.0) * MOON_RADIUS_M * math.cos(math.radians(grid.true_lat_deg))
            wide = (right - left) * grid.pixel_m / degree_m
            return Region(enclosing_bounds(lon[0], lon[0] + wide, south, north), float(area_km2))
        column, row = -grid.x0_m / grid.pixel_m, grid.y0_m / grid.pixel_m
        if bool(((left <= column) & (column <= right) & (top <= row) & (row <= bottom)).any()):
            south, north = (south, 90.0) if grid.pole > 0 else (-90.0, north)
            return Region(enclosing_bounds([0.0], [360.0], south, north), float(area_km2))
        away = wrapped_deg(lon - lon[0])
        box = enclosing_bounds(lon[0] + away.min(axis=0), lon[0] + away.max(axis=0), south, north)
        return Region(box, float(area_km2))


def height_statistics(dem: Dem) -> HeightStatistics:
    """Read a whole file once. DemError if it cannot be read, or for a height beyond
    `raster.POSSIBLE_M`.
    """
    raster = dem.raster
    block = math.ceil(max(raster.width, raster.height) / _BLOCKS)
    missing = np.zeros(
        (math.ceil(raster.height / block), math.ceil(raster.width / block)), np.int64
    )
    low, high, stuck = math.inf, -math.inf, Stuck(0, 0)
    for row0, row1, col0, col1 in raster.windows():
        heights = raster.read(row0, row1, col0, col1)
        stuck += stuck_pixels(heights, narrowness(dem.grid, row0, row1))
        bad = np.isnan(heights)
        if bad.any():
            rows, columns = np.nonzero(bad)
            np.add.at(missing, ((rows + row0) // block, (columns + col0) // block), 1)
        if not bad.all():
            low, high = min(low, float(np.nanmin(heights))), max(high, float(np.nanmax(heights)))
    share = int(missing.sum()) / (raster.width * raster.height)
    lowest, highest = (low, high) if low <= high else (None, None)
    return HeightStatistics(dem, lowest, highest, share, block, missing, stuck)


def pixel_km2(grid: Grid, column: ArrayLike, row: ArrayLike) -> Array:
    """Area of pixels on the surface, km2 (`Grid.cell_weight` leaves out a cylinder's standard
    parallel).
    """
    true = 1.0 if grid.pole else math.cos(math.radians(grid.true_lat_deg))
    return np.asarray((grid.pixel_m / 1000.0) ** 2 / true * grid.cell_weight(column, row))


@dataclass(frozen=True)
class Extreme:
    """The lowest or highest sample of a file: its value, the number of its pixels, and the distance
    to the next value.
    """

    value: float
    count: int
    gap: float  # infinite when there is no other value

    def joined(self, other: Extreme | None, sign: float) -> Extreme:
        """Extreme of two parts of a file; ``sign`` is +1 for the lowest, -1 for the highest."""
        if other is None:
            return self
        first, second = (self, other) if sign * (other.value - self.value) >= 0.0 else (other, self)
        apart = abs(second.value - first.value)
        if apart == 0.0:
            return Extreme(first.value, first.count + second.count, min(first.gap, second.gap))
        return Extreme(first.value, first.count, min(first.gap, apart))


@dataclass(frozen=True)
class SampleStatistics:
    """Statistics of a whole file. Samples are the stored numbers, heights are metres."""

    pixels: int
    missing: int  # declared missing, or not a finite number
    lowest: Extreme | None  # None when nothing is there
    highest: Extreme | None
    impossible: int  # heights beyond POSSIBLE_M
    impossible_at: tuple[int, int, float] | None  # row, column, height of the first
    zero_rows: int
    zero_columns: int
    stuck: Stuck
    looks_swapped: bool
    sample_sum: int | None  # modulo 2^32; None for samples that are not whole numbers


def sample_statistics(raster: Raster, grid: Grid | None = None) -> SampleStatistics:
    """Read every pixel once; with its ``grid`` lines of equal heights are sought. DemError if the file cannot be read to
    its end.
    """
    found = _SampleCounts(raster, grid)
    for row0, row1, col0, col1 in raster.windows():
        found.add(row0, col0, raster.samples(row0, row1, col0, col1))
    return found.result()


class _SampleCounts:
    def __init__(self, raster: Raster, grid: Grid | None) -> None:
        self.raster, self.grid = raster, grid
        self.missing = self.impossible = self.sample_sum = 0
        self.stuck = Stuck(0, 0)
        self.lowest: Extreme | None = None
        self.highest: Extreme | None = None
        self.impossible_at: tuple[int, int, float] | None = None
        self.zero_row = np.ones(raster.height, dtype=bool)
        self.zero_column = np.ones(raster.width, dtype=bool)
        self.order = _ByteOrder(raster)

    def add(self, row0: int, col0: int, samples: NDArray[Any]) -> None:
        heights = self.raster.heights_of(samples)
        there = ~np.isnan(heights)
        self.missing += int(there.size - np.count_nonzero(there))
        self._add_extremes(samples[there])
        self._add_impossible(row0, col0, heights)
        zero = heights == 0.0
        self.zero_row[row0 : row0 + len(zero)] &= zero.all(axis=1)
        self.zero_column[col0 : col0 + zero.shape[1]] &= zero.all(axis=0)
        if self.grid is not None:
            self.stuck += stuck_pixels(heights, narrowness(self.grid, row0, row0 + len(heights)))
        self.order.add(samples, heights)
        if samples.dtype.kind in "iu":
            self.sample_sum = (self.sample_sum + int(samples.sum(dtype=np.int64))) % 2**32

    def _add_extremes(self, samples: NDArray[Any]) -> None:
        if samples.size:
            self.lowest = _extreme(samples, 1.0).joined(self.lowest, 1.0)
            self.highest = _extreme(samples, -1.0).joined(self.highest, -1.0)

    def _add_impossible(self, row0: int, col0: int, heights: NDArray[np.float64]) -> None:
        with np.errstate(invalid="ignore"):
            wrong = np.abs(heights) > POSSIBLE_M
        count = int(np.count_nonzero(wrong))
        if count:
            i, j = divmod(int(np.argmax(wrong)), wrong.shape[1])
            first = row0 + i, col0 + j, float(heights[i, j])
            self.impossible_at = min(self.impossible_at or first, first)
        self.impossible += count

    def result(self) -> SampleStatistics:
        raster = self.raster
        whole = raster.raw_dtype is not None and np.dtype(raster.raw_dtype).kind in "iu"
        return SampleStatistics(
            pixels=raster.width * raster.height,
            missing=self.missing,
            lowest=self.lowest,
            highest=self.highest,
            impossible=self.impossible,
            impossible_at=self.impossible_at,
            zero_rows=int(np.count_nonzero(self.zero_row)),
            zero_columns=int(np.count_nonzero(self.zero_column)),
            stuck=self.stuck,
            looks_swapped=self.order.looks_swapped,
            sample_sum=self.sample_sum if whole else None,
        )


def _extreme(samples: NDArray[Any], sign: float) -> Extreme:
    value = samples.min() if sign > 0 else samples.max()
    others = samples[samples != value]
    gap = math.inf
    if others.size:
        gap = abs(float(others.min() if sign > 0 else others.max()) - float(value))
    return Extreme(float(value), int(samples.size - others.size), gap)


class _ByteOrder:
    """Comparison of the samples of an uncompressed image with their values after a swap of bytes.

    Integers: neighbours in a row of a swapped image differ by tens of thousands, those of the right
    one by the slope of the terrain. Real numbers: swapped ones are next to 0 or beyond all heights.
    """

    def __init__(self, raster: Raster) -> None:
        self.raster = raster
        self.whole = False
        self.steps = np.zeros(2)  # sums of |difference| of neighbours, metres: as stored, swapped
        self.possible = np.zeros(2)
        self.pixels = 0

    def add(self, samples: NDArray[Any], heights: NDArray[np.float64]) -> None:
        if self.raster.raw_dtype is None or samples.dtype.itemsize < 2:
            return
        self.whole = samples.dtype.kind in "iu"
        with np.errstate(all="ignore"):
            for place, these in enumerate((heights, self.raster.heights_of(samples.byteswap()))):
                self.steps[place] += (
                    float(np.nansum(np.abs(np.diff(these, axis=1)))) if self.whole else 0.0
                )
                size = np.abs(these)
                self.possible[place] += int(
                    np.count_nonzero((size == 0.0) | ((size > 1e-4) & (size <= POSSIBLE_M)))
                )
        self.pixels += samples.size

    @property
    def looks_swapped(self) -> bool:
        if self.whole:
            return bool(self.steps[0] > 8.0 * self.steps[1] and self.steps[0] > 50.0 * self.pixels)
        return bool(self.possible[0] < 0.5 * self.pixels and self.possible[1] > 0.95 * self.pixels)
