"""Sets of DEM products: heights above the sphere of 1 737 400 m at any longitude and latitude."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .dem import Dem
from .errors import AreaError, DemError
from .grid import EDGE_PX, Bounds, enclosing_arc
from .kernels import resample
from .raster import Heights

Array = NDArray[np.float64]
Indices = NDArray[np.int16]

_WINDOW_PIXELS = 32_000_000
"""A window of more pixels is read in parts."""
_MARGIN = 2
"""Pixels beside a fractional one that cubic convolution reaches for."""


@dataclass(frozen=True)
class DemSet:
    """Several products, in the order in which they are asked: the first with a height at a place
    gives it.
    """

    dems: tuple[Dem, ...]

    def __post_init__(self) -> None:
        if not self.dems:
            raise DemError("no DEM was given")

    @classmethod
    def open(cls, paths: Sequence[Path | str]) -> DemSet:
        """Open every file; the first that cannot be opened ends it with its own error."""
        return cls(tuple(Dem.open(path) for path in paths))

    @property
    def products(self) -> tuple[str, ...]:
        """Product name of each DEM, by index."""
        return tuple(dem.product for dem in self.dems)

    @cached_property
    def bounds(self) -> Bounds:
        """The box that holds all of them."""
        boxes = [dem.grid.bounds for dem in self.dems]
        if len(boxes) == 1:
            return boxes[0]
        west, east = enclosing_arc([(box.west, box.east) for box in boxes])
        return Bounds(west, min(b.south for b in boxes), east, max(b.north for b in boxes))

    def heights(
        self, lon_deg: ArrayLike, lat_deg: ArrayLike, gsd_m: float
    ) -> tuple[Array, Indices]:
        """Heights above the sphere, metres (NaN: none), and the index of the DEM each came from
        (-1: none).

        Cubic convolution, bilinear beside missing pixels; where ``gsd_m`` is 1.5 times a product's
        pixel or more, its pixels
        are averaged in blocks first (``Dem.factor``). A place's height does not depend on what else
        is asked.
        """
        lon, lat = np.broadcast_arrays(
            np.asarray(lon_deg, dtype=np.float64), np.asarray(lat_deg, dtype=np.float64)
        )
        shape, lon, lat = lon.shape, lon.ravel(), lat.ravel()
        height, index = np.full(lon.size, np.nan), np.full(lon.size, -1, np.int16)
        todo: NDArray[np.intp] | slice = slice(None)
        for number in range(len(self.dems)):
            self._fill(number, lon, lat, gsd_m, todo, height, index)
            todo = np.flatnonzero(index < 0)
            if todo.size == 0:
                break
        return height.reshape(shape), index.reshape(shape)

    def _fill(
        self,
        number: int,
        lon: Array,
        lat: Array,
        gsd_m: float,
        todo: NDArray[np.intp] | slice,
        height: Array,
        index: Indices,
    ) -> None:
        """Heights of DEM ``number`` at the places ``todo``, written where it has some."""
        grid = self.dems[number].grid
        u, v = grid.pixel(lon[todo], lat[todo])
        right, bottom = grid.width - 0.5, grid.height - 0.5
        inside = (u <= right + EDGE_PX) & (v >= -0.5 - EDGE_PX) & (v <= bottom + EDGE_PX)
        inside &= np.abs(lat[todo]) <= 90.0
        if not inside.any():
            return
        u, v = np.clip(u, -0.5, right), np.clip(v, -0.5, bottom)
        places = todo
        if not inside.all():
            places = np.flatnonzero(inside) if isinstance(todo, slice) else todo[inside]
            u, v = u[inside], v[inside]
        found = np.empty(u.size)
        self._sample(
            number,
            np.ascontiguousarray(u),
            np.ascontiguousarray(v),
            self.dems[number].factor(gsd_m),
            found,
        )
        height[places] = found
        index[places] = np.where(np.isnan(found), np.int16(-1), np.int16(number))

    def _sample(self, number: int, u: Array, v: Array, factor: int, out: Array) -> None:
        """Interpolate at fractional pixels, in halves while their window is too large."""
        grid = self.dems[number].grid
        period = grid.period // factor if grid.wraps else 0
        if factor > 1:
            u, v = (u - 0.5 * (factor - 1)) / factor, (v - 0.5 * (factor - 1)) / factor
        self._sample_window(number, u, v, factor, period, out)

    def _sample_window(
        self, number: int, u: Array, v: Array, factor: int, period: int, out: Array
    ) -> None:
        col0, col1 = _span(u, period)
        row0, row1 = _span(v, 0)
        if (row1 - row0) * (col1 - col0) > _WINDOW_PIXELS and u.size > 1:
            half = u.size // 2
            for part in (slice(0, half), slice(half, None)):
                self._sample_window(number, u[part], v[part], factor, period, out[part])
            return
        window = self._window(number, row0, row1, col0, col1, factor)
        resample.sample(window, row0, col0, period, u, v, out)

    def _window(
        self, number: int, row0: int, row1: int, col0: int, col1: int, factor: int
    ) -> Heights:
        """Heights of a window of pixels, or of blocks of ``factor`` x ``factor`` pixels, with the
        neighbouring tiles' pixels.
        """
        if factor == 1:
            return self._pixels(number, row0, row1, col0, col1)
        grid = self.dems[number].grid
        out = np.empty((row1 - row0, col1 - col0), np.float32)
        strip = max(1, _WINDOW_PIXELS // (factor * factor * (col1 - col0)))
        columns = np.arange(col0 * factor, col1 * factor) if grid.pole else np.zeros(1)
        for top in range(row0, row1, strip):
            bottom = min(top + strip, row1)
            pixels = self._pixels(
                number, top * factor, bottom * factor, col0 * factor, col1 * factor
            )
            rows = np.arange(top * factor, bottom * factor)[:, None]
            weight = np.ascontiguousarray(grid.cell_weight(columns[None, :], rows))
            resample.block_means(pixels, weight, factor, out[top - row0 : bottom - row0])
        return out

    def _pixels(self, number: int, row0: int, row1: int, col0: int, col1: int) -> Heights:
        """A window of one DEM's lattice; what is missing comes from other tiles of the same product
        on the same lattice.
        """
        pixels = self.dems[number].read(row0, row1, col0, col1)
        for other, columns, rows in self._mates[number]:
            if not np.isnan(pixels).any():
                break
            dem = self.dems[other]
            period = dem.grid.period or 1 << 40
            for turn in (-period, 0, period):
                low, high = col0 - columns + turn, col1 - columns + turn
                first, last = max(low, 0), min(high, dem.grid.width)
                top, bottom = max(row0 - rows, 0), min(row1 - rows, dem.grid.height)
                if first >= last or top >= bottom:
                    continue
                part = pixels[top - row0 + rows : bottom - row0 + rows, first - low : last - low]
                gaps = np.isnan(part)
                if gaps.any():
                    part[gaps] = dem.read(top, bottom, first, last)[gaps]
        return pixels

    @cached_property
    def _mates(self) -> tuple[tuple[tuple[int, int, int], ...], ...]:
        """For every DEM the other tiles of its product: (index, columns, rows) from its pixel (0,
        0) to theirs.
        """
        return tuple(
            tuple(
                (j, *offset)
                for j, other in enumerate(self.dems)
                if j != i
                and other.product == dem.product
                and (offset := dem.grid.same_lattice(other.grid)) is not None
            )
            for i, dem in enumerate(self.dems)
        )

    def native_gsd_m(self, lon_deg: float, lat_deg: float) -> float:
        """Pixel size of the first DEM that has a height at a place; ``AreaError`` when none has."""
        for number, dem in enumerate(self.dems):
            height, index = np.full(1, np.nan), np.full(1, -1, np.int16)
            place = np.array([lon_deg], dtype=np.float64), np.array([lat_deg], dtype=np.float64)
            self._fill(number, *place, dem.gsd_m, slice(None), height, index)
            if index[0] >= 0:
                return dem.gsd_m
        raise AreaError(
            f"no DEM has a height at longitude {lon_deg:g}, latitude {lat_deg:g}; the DEM "
            f"covers {self.bounds}"
        )

    def sources(self) -> list[dict[str, Any]]:
        """Name, size and SHA-256 of every file that heights come from, labels included; no folders,
        in the given order.
        """
        files = dict.fromkeys(path for dem in self.dems for path in dem.files)
        return [{"name": p.name, "size": p.stat().st_size, "sha256": _sha256(p)} for p in files]


def height_at(dem: Dem, lon_deg: float, lat_deg: float) -> float | None:
    """Height at a place, metres, from one product's own pixels; None where it has none."""
    height, _ = DemSet((dem,)).heights(lon_deg, lat_deg, dem.gsd_m)
    return None if np.isnan(height) else round(float(height), 6)


def _span(values: Array, period: int) -> tuple[int, int]:
    """Half-open range of whole pixels that cubic convolution needs around fractional ones; at most
    ``period`` of them.
    """
    whole = np.floor(values).astype(np.int64)
    low, high = int(whole.min()), int(whole.max())
    if period and high - low > period // 2:
        turned = (whole + period // 2) % period
        if int(turned.max()) - int(turned.min()) < high - low:
            low, high = int(turned.min()) - period // 2, int(turned.max()) - period // 2
    low, high = low - _MARGIN + 1, high + _MARGIN + 1
    if period and high - low >= period:
        return 0, period
    return low, high


def _sha256(path: Path) -> str:
    stat = os.stat(path)
    return _sha256_of(str(path), stat.st_mtime_ns, stat.st_size)


@lru_cache(maxsize=256)
def _sha256_of(path: str, _mtime_ns: int, _size: int) -> str:
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
