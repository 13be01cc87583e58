"""What all pixels of a file amount to, from one pass in strips: extremes and how far they stand apart, what is
missing or impossible, rows and columns of nothing but zero, and whether the bytes make more sense swapped.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .raster import Raster

POSSIBLE_M = 12_000.0
"""Beyond it there is no ground: the Moon's lowest place is at -9.1 km, its highest at 10.8 km."""

_STRIP_PIXELS = 4_000_000


@dataclass(frozen=True)
class Extreme:
    """The lowest or highest sample of a file: its value, in how many pixels it stands, and how far the next one is."""

    value: float
    count: int
    gap: float  # infinite when there is no other value

    def joined(self, other: Extreme | None, sign: float) -> Extreme:
        """Of both; ``sign`` is +1 for the lowest, -1 for the highest."""
        if other is None:
            return self
        first, second = (self, other) if sign * (other.value - self.value) >= 0.0 else (other, self)
        apart = abs(second.value - first.value)
        if apart == 0.0:
            return Extreme(first.value, first.count + second.count, min(first.gap, second.gap))
        return Extreme(first.value, first.count, min(first.gap, apart))


@dataclass(frozen=True)
class PixelSurvey:
    """Of the whole file. Samples are the numbers as they are stored, heights are metres."""

    pixels: int
    missing: int  # declared missing, or not a finite number
    lowest: Extreme | None  # None when nothing is there
    highest: Extreme | None
    impossible: int  # heights beyond POSSIBLE_M
    impossible_at: tuple[int, int, float] | None  # row, column, height of the first
    zero_rows: int
    zero_columns: int
    looks_swapped: bool
    sample_sum: int | None  # modulo 2^32; None for samples that are not whole numbers


def survey_pixels(raster: Raster) -> PixelSurvey:
    """Read every pixel once; ``DemError`` when the file cannot be read to its end."""
    found = _Survey(raster)
    for row, samples in _strips(raster):
        found.add(row, samples)
    return found.result()


def _strips(raster: Raster) -> Iterator[tuple[int, NDArray[Any]]]:
    rows = max(1, _STRIP_PIXELS // raster.width)
    for row in range(0, raster.height, rows):
        yield row, raster.samples(row, min(row + rows, raster.height), 0, raster.width)


class _Survey:
    def __init__(self, raster: Raster) -> None:
        self.raster = raster
        self.missing = self.impossible = self.zero_rows = self.sample_sum = 0
        self.lowest: Extreme | None = None
        self.highest: Extreme | None = None
        self.impossible_at: tuple[int, int, float] | None = None
        self.zero_column = np.ones(raster.width, dtype=bool)
        self.order = _ByteOrder(raster)

    def add(self, row: int, samples: NDArray[Any]) -> None:
        heights = self.raster.heights_of(samples)
        there = ~np.isnan(heights)
        self.missing += int(there.size - np.count_nonzero(there))
        self._add_extremes(samples[there])
        self._add_impossible(row, heights)
        zero = heights == 0.0
        self.zero_rows += int(np.count_nonzero(zero.all(axis=1)))
        self.zero_column &= zero.all(axis=0)
        self.order.add(samples, heights)
        if samples.dtype.kind in "iu":
            self.sample_sum = (self.sample_sum + int(samples.sum(dtype=np.int64))) % 2**32

    def _add_extremes(self, samples: NDArray[Any]) -> None:
        if samples.size:
            self.lowest = _extreme(samples, 1.0).joined(self.lowest, 1.0)
            self.highest = _extreme(samples, -1.0).joined(self.highest, -1.0)

    def _add_impossible(self, row: int, heights: NDArray[np.float64]) -> None:
        with np.errstate(invalid="ignore"):
            wrong = np.abs(heights) > POSSIBLE_M
        count = int(np.count_nonzero(wrong))
        if count and self.impossible_at is None:
            i, j = divmod(int(np.argmax(wrong)), wrong.shape[1])
            self.impossible_at = (row + i, j, float(heights[i, j]))
        self.impossible += count

    def result(self) -> PixelSurvey:
        raster = self.raster
        whole = raster.raw_dtype is not None and np.dtype(raster.raw_dtype).kind in "iu"
        return PixelSurvey(
            pixels=raster.width * raster.height,
            missing=self.missing,
            lowest=self.lowest,
            highest=self.highest,
            impossible=self.impossible,
            impossible_at=self.impossible_at,
            zero_rows=self.zero_rows,
            zero_columns=int(np.count_nonzero(self.zero_column)),
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
    """Compares the samples of an uncompressed image with what they are when their bytes are swapped.

    Whole numbers: neighbours in a row of a swapped image differ by tens of thousands, of the right one by the slope of the
    ground. Real numbers: swapped ones are next to nothing or beyond all heights.
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
