"""The files of one product on one lattice as one raster: values at any place, and the distance of a
place from the outer edge of the files.

Outer edges of what a product covers, and weights that rise smoothly from them, for the blending
of products.

The weight is 0 at the outer edge and 1 from one band inside it on; between them it is the
smoothstep 3 t^2 - 2 t^3 of the distance. Its slope is at most 1.5 / band and 0 at both ends, so
that neither height nor slope jumps.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array, Float32, Int16
from ..constants import MOON_RADIUS_M
from ..kernels.resampling import heights
from . import block_cache
from .grid import Grid
from .raster import Gridded

BAND_PX = 16.0
"""Width of a seam, in pixels of the coarser of the two products that meet."""
BAND_SHARE = 0.125
"""Greatest width of a band, as a share of the product's smaller side."""

_SLACK = 1e-3  # pixels; tiles lie on whole ones


class Tile(NamedTuple):
    """A file's rectangle on the unbounded lattice of its product, pixel edges: columns ``left`` to
    ``right``, rows ``top`` down to ``bottom``.
    """

    left: float
    right: float
    top: float
    bottom: float


class Edge(NamedTuple):
    """A straight piece of an outer edge: at the column (or row) ``at``, from ``low`` to ``high``
    along it, in pixels.
    """

    column: bool
    at: float
    low: float
    high: float


def smoothstep(share: Array) -> Array:
    """0 below 0, 1 above 1, and 3 t^2 - 2 t^3 between."""
    t = np.clip(share, 0.0, 1.0)
    return np.asarray(t * t * (3.0 - 2.0 * t))


def outer_edges(tiles: Sequence[Tile], period: float, poles: tuple[bool, bool]) -> tuple[Edge, ...]:
    """Edges of tiles that have no other tile on their outer side.

    ``period``: columns around the Moon, 0 for a map without a seam. ``poles``: True if the first or
    last row of the tiles ends at a pole, which is no edge.
    """
    turns = (-period, 0.0, period) if period else (0.0,)
    around = [Tile(t.left + turn, t.right + turn, t.top, t.bottom) for t in tiles for turn in turns]
    top, bottom = min(t.top for t in tiles), max(t.bottom for t in tiles)
    found: dict[tuple[bool, float], list[tuple[float, float]]] = {}
    for tile in tiles:
        for column, at, sign in (
            (True, tile.left, -1),
            (True, tile.right, 1),
            (False, tile.top, -1),
            (False, tile.bottom, 1),
        ):
            if not column and ((poles[0] and at == top) or (poles[1] and at == bottom)):
                continue
            span = (tile.top, tile.bottom) if column else (tile.left, tile.right)
            bare = _without(span, _behind(around, column, at, sign))
            found.setdefault((column, at), []).extend(bare)
    return tuple(
        Edge(column, at, first, last)
        for (column, at), spans in found.items()
        for first, last in _joined(spans)
    )


def _behind(
    tiles: Iterable[Tile], column: bool, at: float, sign: int
) -> Iterable[tuple[float, float]]:
    """Spans along an edge that have a tile on the other side."""
    for tile in tiles:
        low, high = (tile.left, tile.right) if column else (tile.top, tile.bottom)
        beyond = at + sign * 2.0 * _SLACK
        if low < beyond < high:
            yield (tile.top, tile.bottom) if column else (tile.left, tile.right)


def _without(
    span: tuple[float, float], others: Iterable[tuple[float, float]]
) -> list[tuple[float, float]]:
    """Parts of a span outside other spans."""
    left = [span]
    for low, high in others:
        cut = [piece for a, b in left for piece in ((a, min(b, low)), (max(a, high), b))]
        left = [(a, b) for a, b in cut if b - a > _SLACK]
    return left


def _joined(spans: Iterable[tuple[float, float]]) -> list[tuple[float, float]]:
    """Spans, those that touch joined: two edges in line must count once."""
    out: list[tuple[float, float]] = []
    for low, high in sorted(spans):
        if out and low <= out[-1][1] + _SLACK:
            out[-1] = (out[-1][0], max(out[-1][1], high))
        else:
            out.append((low, high))
    return out


def edge_weight(
    column: Array,
    row: Array,
    stretch: Array | float,
    edges: Sequence[Edge],
    period: float,
    band: float,
) -> Array:
    """Weight (n,) of a product at fractional pixels, from the distance to each of its edges.

    ``stretch``: width of a pixel on the surface over its height, (n,); ``band``: width of the seam
    in heights of a pixel.
    """
    weight = np.ones(column.shape)
    if not column.size:
        return weight
    for edge in edges:
        at, along = (column, row) if edge.column else (row, column)
        away = np.abs(at - edge.at)
        past = np.maximum(np.maximum(edge.low - along, along - edge.high), 0.0)
        if period and edge.column:
            away = away % period
            away = np.minimum(away, period - away)
        elif period:
            east = (along - edge.low) % period  # of the edge's west end
            past = np.where(
                east <= edge.high - edge.low,
                0.0,
                np.minimum(east - (edge.high - edge.low), period - east),
            )
        away, past = (away * stretch, past) if edge.column else (away, past * stretch)
        if away.min() < band:
            weight *= smoothstep(np.sqrt(away * away + past * past) / band)
    return weight


def clear_of(
    edges: Iterable[Edge],
    columns: tuple[float, float],
    rows: tuple[float, float],
    stretch: float,
    period: float,
    band: float,
) -> bool:
    """True if every place in a box of pixels is at least a band away from every edge, taken as an
    unbounded line.
    """
    for edge in edges:
        low, high = columns if edge.column else rows
        turns = (-period, 0.0, period) if edge.column and period else (0.0,)
        away = min(max(low - edge.at - t, edge.at + t - high) for t in turns)
        if away * (stretch if edge.column else 1.0) < band * (1.0 + 1e-9):
            return False
    return True


Places = NDArray[np.intp] | slice
File = TypeVar("File", bound=Gridded)
Box = tuple[tuple[float, float], tuple[float, float]]
"""Least and greatest column, least and greatest row, on the first file's lattice."""

_WINDOW_PIXELS = 16_000_000
"""Windows with more pixels are read in parts; a pixel takes some 20 bytes meanwhile."""
_BLOCK_PIXELS = 2_000_000
"""Pixels that are read together for means of blocks, if a block is not larger."""
_MARGIN = 2
"""Pixels beside a fractional one that cubic convolution uses."""
_SPARE_PX = 16
"""Pixels around a window that are read with it for the next steps of an iteration."""
HOLE_PX = 4.0
"""Number of pixels around missing ones over which the next product takes over."""
_STRETCHED = 2.0
"""From this ratio of a cell to the east-west size of a (block of) pixels on, these are averaged
along their row.
"""
_FULLY = 4.0
"""From this ratio on they are averaged over the whole cell; the length grows steadily between the
two.
"""
_ARC_MAX = 2.0
"""Greatest length of a mean along a row, radians of longitude: the last rows around a pole."""


class TileSample(NamedTuple):
    """Of places (n,): heights (metres, NaN without one), the file of the layer (-1 without one),
    its weight in a blend (0..1).
    """

    height: Array
    tile: Int16
    weight: Array | None


@dataclass(frozen=True)
class Layer(Generic[File]):
    """Files of one product on one lattice, in the order of their use."""

    dems: tuple[File, ...]

    @property
    def pixel_m(self) -> float:
        """Pixel size at true scale."""
        return self.dems[0].gsd_m

    @cached_property
    def _offsets(self) -> tuple[tuple[int, int], ...]:
        """(columns, rows) from the first file's pixel (0, 0) to each one's."""
        found = (self.dems[0].grid.same_lattice(dem.grid) for dem in self.dems)
        return tuple(offset for offset in found if offset is not None)

    @cached_property
    def _tiles(self) -> tuple[Tile, ...]:
        return tuple(
            Tile(cols - 0.5, cols - 0.5 + dem.grid.width, rows - 0.5, rows - 0.5 + dem.grid.height)
            for dem, (cols, rows) in zip(self.dems, self._offsets, strict=True)
        )

    @property
    def _turn(self) -> float:
        """Pixels around the Moon of a cylinder, not always a whole number; 0 of a polar map."""
        grid = self.dems[0].grid
        return 0.0 if grid.pole else 2.0 * math.pi * MOON_RADIUS_M * _true_cos(grid) / grid.pixel_m

    @cached_property
    def edges(self) -> tuple[Edge, ...]:
        """The outer edges of all files together, on the first one's lattice."""
        grid, tiles = self.dems[0].grid, self._tiles
        if grid.pole:
            return outer_edges(tiles, 0.0, (False, False))
        rows = np.array([min(t.top for t in tiles), max(t.bottom for t in tiles)])
        _, (north, south) = grid.lonlat(np.zeros(2), rows)
        period = float(grid.period) or self._turn
        return outer_edges(tiles, period, (north > 90.0 - 1e-6, south < -90.0 + 1e-6))

    @property
    def smaller_side_m(self) -> float:
        """Smaller side of the box around the files, on the map."""
        wide = max(t.right for t in self._tiles) - min(t.left for t in self._tiles)
        high = max(t.bottom for t in self._tiles) - min(t.top for t in self._tiles)
        return min(wide, high) * self.pixel_m

    def holds(self, lon: Array, lat: Array) -> NDArray[np.bool_]:
        """True where a file's footprint contains a place, (files, n); no pixel is read."""
        return np.array([dem.grid.holds(lon, lat) for dem in self.dems])

    def sample(
        self, lon: Array, lat: Array, gsd_m: float, band_m: float | None = None
    ) -> TileSample:
        """Heights at places (n,), from the first file that has one; with ``band_m``, the width of
        the seam at the outer edge, also the weight of each place.
        """
        count = lon.size
        height, tile = np.full(count, np.nan), np.full(count, -1, np.int16)
        clear = None if band_m is None else np.full(count, HOLE_PX)
        todo: Places = slice(None)
        boxes: list[Box] = []
        for number in range(len(self.dems)):
            boxes += self._fill(number, lon, lat, gsd_m, todo, height, tile, clear)
            todo = np.flatnonzero(tile < 0)
            if todo.size == 0:
                break
        if band_m is None or clear is None:
            return TileSample(height, tile, None)
        all_found = not isinstance(todo, slice) and not todo.size
        if all_found and self._all_whole(boxes, lat, clear, band_m):
            return TileSample(height, tile, None)
        return TileSample(height, tile, self._weights(lon, lat, tile >= 0, clear, band_m))

    def _all_whole(self, boxes: list[Box], lat: Array, clear: Array, band_m: float) -> bool:
        """True if all places inside boxes of pixels have weight 1; False if the boxes are too
        coarse to tell.
        """
        if clear.min(initial=HOLE_PX) < HOLE_PX:
            return False
        if not self.edges or not lat.size:
            return True
        stretch, grid = 1.0, self.dems[0].grid
        if not grid.pole:
            furthest = min(max(abs(float(lat.min())), abs(float(lat.max()))), 90.0)
            stretch = math.cos(math.radians(furthest)) / _true_cos(grid)
        band_px = band_m / self.pixel_m
        return all(clear_of(self.edges, u, v, stretch, self._turn, band_px) for u, v in boxes)

    def _weights(
        self, lon: Array, lat: Array, there: NDArray[np.bool_], clear: Array, band_m: float
    ) -> Array:
        """0 without a height; else above 0, and 1 from one band inside the outer edge and `HOLE_PX`
        from missing pixels on.
        """
        weight = np.zeros(lon.size)
        places: Places = slice(None) if there.all() else np.flatnonzero(there)
        if not there.any():
            return weight
        grid = self.dems[0].grid
        found = np.ones(weight[places].size)
        if self.edges:
            column, row = grid.pixel(lon[places], lat[places])
            stretch = 1.0 if grid.pole else np.cos(np.radians(lat[places])) / _true_cos(grid)
            found = edge_weight(column, row, stretch, self.edges, self._turn, band_m / self.pixel_m)
        if clear[places].min() < HOLE_PX:
            found = found * smoothstep(clear[places] / HOLE_PX)
        weight[places] = np.maximum(
            found, 1e-9
        )  # positive: without another product it is used alone
        return weight

    def _fill(
        self,
        number: int,
        lon: Array,
        lat: Array,
        gsd_m: float,
        todo: Places,
        height: Array,
        tile: Int16,
        clear: Array | None,
    ) -> list[Box]:
        """Write the heights of one file at the places ``todo`` where it has some; return the box of
        their pixels if it is needed.
        """
        grid = self.dems[number].grid
        inside, u, v = grid.located(lon[todo], lat[todo])
        if not inside.any():
            return []
        places = todo
        if not inside.all():
            places = np.flatnonzero(inside) if isinstance(todo, slice) else todo[inside]
            u, v = u[inside], v[inside]
        u, v = np.clip(u, -0.5, grid.width - 0.5), np.clip(v, -0.5, grid.height - 0.5)
        box = [] if clear is None else [_box(u, v, self._offsets[number])]
        factor = self.dems[number].factor(gsd_m)
        if factor > 1:
            u, v = (u - 0.5 * (factor - 1)) / factor, (v - 0.5 * (factor - 1)) / factor
        found, away = np.empty(u.size), np.empty(0 if clear is None else u.size)
        u, v = np.ascontiguousarray(u), np.ascontiguousarray(v)
        self._sample_window(number, u, v, factor, gsd_m, found, away)
        height[places] = found
        known = np.isfinite(found.sum())  # without a gap
        tile[places] = number if known else np.where(np.isnan(found), -1, number)
        if clear is not None:
            clear[places] = away
        return box

    def _sample_window(
        self, number: int, u: Array, v: Array, factor: int, gsd_m: float, out: Array, away: Array
    ) -> None:
        """Interpolate at fractional pixels (of blocks), in halves while their window is too large."""
        grid = self.dems[number].grid
        period = grid.period // factor if grid.wraps else 0
        margin = max(_MARGIN, int(HOLE_PX) + 2) if away.size else _MARGIN
        col0, col1 = _span(u, period, margin)
        row0, row1 = _span(v, 0, margin)
        if (row1 - row0) * (col1 - col0) > _WINDOW_PIXELS and u.size > 1:
            half = u.size // 2
            for part in (slice(0, half), slice(half, None)):
                self._sample_window(number, u[part], v[part], factor, gsd_m, out[part], away[part])
            return
        wide = _SPARE_PX if not period or col1 - col0 + 2 * _SPARE_PX < period else 0
        window, row0, col0 = block_cache.recent(
            (self._identity, number, factor, gsd_m),
            (row0, row1, col0, col1),
            (_SPARE_PX, wide),
            lambda box: self._ground_window(number, box, factor, gsd_m),
        )
        heights.sample(window, row0, col0, period, u, v, out)
        if away.size and not np.isnan(window).any():
            away[:] = HOLE_PX
        elif away.size:
            cover = self._cover(number, factor)
            heights.clearance(window, row0, col0, period, cover, u, v, HOLE_PX, away)

    def _cover(self, number: int, factor: int) -> tuple[int, int, int, int]:
        """First and last row, first and last column (of blocks) of the box around all files,
        counted on one file's lattice; unbounded around the Moon and over a pole.
        """
        column, row = self._offsets[number]
        wide = any(edge.column for edge in self.edges)
        tops = {edge.at for edge in self.edges if not edge.column}
        top, bottom = min(t.top for t in self._tiles), max(t.bottom for t in self._tiles)
        left, right = min(t.left for t in self._tiles), max(t.right for t in self._tiles)
        endless = 1 << 40
        return (
            math.floor((top + 0.5 - row) / factor) if top in tops else -endless,
            math.ceil((bottom + 0.5 - row) / factor) - 1 if bottom in tops else endless,
            math.floor((left + 0.5 - column) / factor) if wide else -endless,
            math.ceil((right + 0.5 - column) / factor) - 1 if wide else endless,
        )

    def _ground_window(
        self, number: int, window: tuple[int, int, int, int], factor: int, gsd_m: float
    ) -> Float32:
        """A window of pixels (or of blocks), averaged along its rows where the cell is far wider
        than they are on the surface.
        """
        row0, row1, col0, col1 = window
        grid = self.dems[number].grid
        if _widest_ratio(grid, row0, row1, factor, gsd_m) <= _STRETCHED:
            return self._window(number, row0, row1, col0, col1, factor)
        length, turn = row_lengths(grid, np.arange(row0 - 1, row1 + 1), factor, gsd_m)
        pad = math.ceil((float(length.max()) - 1.0) / 2.0)
        wide = self._window(number, row0 - 1, row1 + 1, col0 - pad, col1 + pad, factor)
        out = np.empty((row1 - row0, col1 - col0), np.float32)
        heights.row_means(wide, length, turn, pad, out)
        return out

    def _window(
        self, number: int, row0: int, row1: int, col0: int, col1: int, factor: int
    ) -> Float32:
        """Heights of a window of pixels, or of blocks of ``factor`` x ``factor`` pixels, including
        the pixels of neighbouring tiles.
        """
        if factor == 1:
            return self._pixels(number, row0, row1, col0, col1)
        source = (self._identity, number)
        return block_cache.window(
            source,
            factor,
            row0,
            row1,
            col0,
            col1,
            lambda top, bottom, left, right: self._blocks(number, top, bottom, left, right, factor),
        )

    @cached_property
    def _identity(self) -> tuple[Hashable, ...]:
        """Key of the pixels for the cache."""
        return tuple(dem.identity for dem in self.dems)

    def _blocks(
        self, number: int, row0: int, row1: int, col0: int, col1: int, factor: int
    ) -> Float32:
        """Means of a window of blocks, from the pixels; NaN outside the files, where none is read."""
        grid = self.dems[number].grid
        out = np.full((row1 - row0, col1 - col0), np.nan, np.float32)
        first_row, last_row, first_col, last_col = self._cover(number, factor)
        above, left, right = max(row0, first_row), max(col0, first_col), min(col1, last_col + 1)
        below = min(row1, last_row + 1)
        if left >= right:
            return out
        together = max(1, _BLOCK_PIXELS // factor**2)
        across = min(right - left, together)
        down = together // across
        for top, first in product(range(above, below, down), range(left, right, across)):
            bottom, last = min(top + down, below), min(first + across, right)
            row, end_row, column, end_column = (factor * i for i in (top, bottom, first, last))
            columns = np.arange(column, end_column) if grid.pole else np.zeros(1)
            rows = np.arange(row, end_row)[:, None]
            weight = np.ascontiguousarray(grid.cell_weight(columns[None, :], rows))
            means = np.empty((bottom - top, last - first), np.float32)
            pixels = self._pixels(number, row, end_row, column, end_column)
            heights.block_means(pixels, weight, factor, means)
            out[top - row0 : bottom - row0, first - col0 : last - col0] = means
        return out

    def _pixels(self, number: int, row0: int, row1: int, col0: int, col1: int) -> Float32:
        """A window of one file's lattice; missing pixels are taken from the other files."""
        pixels = self.dems[number].read(row0, row1, col0, col1)
        column, row = self._offsets[number]
        for other, dem in enumerate(self.dems):
            if other == number:
                continue
            if not np.isnan(pixels).any():
                break
            columns, rows = self._offsets[other][0] - column, self._offsets[other][1] - row
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


def row_lengths(
    grid: Grid, rows: NDArray[np.int64], factor: int, gsd_m: float
) -> tuple[Array, Array]:
    """Number of (blocks of) pixels over which each row of a cylinder is averaged, and the number of
    rows by which its mean lies too near the pole, (rows,) each.

    The length is the cell's width over the pixel's on the surface, at least 1. The second value is
    from the mean of cos(longitude) over the averaged pixels: the distance from the Moon's axis
    shrinks by that factor.
    """
    lat = (grid.y0_m - ((rows + 0.5) * factor - 0.5) * grid.pixel_m) / MOON_RADIUS_M
    step = factor * grid.pixel_m / (MOON_RADIUS_M * _true_cos(grid))  # radians of longitude
    cos = np.cos(lat)
    ratio = gsd_m / (factor * grid.pixel_m * np.maximum(np.abs(cos), 1e-9) / _true_cos(grid))
    rise = (_FULLY - 1.0) / (_FULLY - _STRETCHED)
    length = np.where(ratio < _FULLY, 1.0 + (ratio - _STRETCHED) * rise, ratio)
    length = np.clip(length, 1.0, max(1.0, _ARC_MAX / step))
    whole = np.floor((length - 1.0) / 2.0)
    part = (length - 1.0) / 2.0 - whole
    shrunk = np.sin((whole + 0.5) * step) / math.sin(0.5 * step) + 2.0 * part * np.cos(
        (whole + 1.0) * step
    )
    sin = np.where(length > 1.0, np.sin(lat), 1.0)
    turn = (1.0 - shrunk / length) * cos / (sin * factor * grid.pixel_m / MOON_RADIUS_M)
    return length, np.where(length > 1.0, turn, 0.0)


def _widest_ratio(grid: Grid, row0: int, row1: int, factor: int, gsd_m: float) -> float:
    """Greatest ratio of the cell to the east-west size of a window's (blocks of) pixels; 0 of a
    polar map.
    """
    if grid.pole:
        return 0.0
    ends = (grid.y0_m - (row * factor - 0.5) * grid.pixel_m for row in (row0 - 1, row1 + 1))
    narrow = min(math.cos(min(abs(y) / MOON_RADIUS_M, math.pi / 2.0)) for y in ends)
    return gsd_m * _true_cos(grid) / (factor * grid.pixel_m * max(narrow, 1e-9))


def _box(u: Array, v: Array, offset: tuple[int, int]) -> Box:
    columns, rows = offset
    return (
        (float(u.min()) + columns, float(u.max()) + columns),
        (float(v.min()) + rows, float(v.max()) + rows),
    )


def _true_cos(grid: Grid) -> float:
    return math.cos(math.radians(grid.true_lat_deg))


def _span(values: Array, period: int, margin: int) -> tuple[int, int]:
    """Half-open range of whole pixels within ``margin`` of fractional ones; at most ``period`` of
    them.
    """
    low, high = math.floor(values.min()), math.floor(values.max())
    if period and high - low > period // 2:
        whole = np.floor(values).astype(np.int64)
        turned = (whole + period // 2) % period
        if int(turned.max()) - int(turned.min()) < high - low:
            low, high = int(turned.min()) - period // 2, int(turned.max()) - period // 2
    low, high = low - margin + 1, high + margin + 1
    if period and high - low >= period:
        return 0, period
    return low, high
