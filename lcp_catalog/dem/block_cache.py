"""Caches of windows of pixels, and of means of blocks of pixels, which the far terrain of neighbouring
areas needs again.

A window of blocks is assembled from square tiles of a fixed lattice. So the mean of a block does
not depend on the window, and a large file is read once for each block size. The last windows of
pixels are kept with a margin, since the steps of an iteration need almost the same ones.

Limit of the memory in which a process keeps what it has read of DEM files: tiles of means, and GDAL's blocks.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable

import numpy as np

from ..arrays import Float32
from .raster import GDAL_CACHE_BYTES, limit_gdal_cache

Window = tuple[int, int, int, int]
"""First row, row behind the last, first column, column behind the last."""

LIMIT_BYTES = 256 << 20
"""Greatest size of the tiles in a process (`limit`); the least recently used ones are removed first."""

RECENT = 4
"""Windows that `recent` keeps in a process."""
RECENT_PIXELS = 4_000_000
"""Largest window that `recent` keeps."""

_TILE_PIXELS = 1024
_TILE_BLOCKS = 64
"""Side of a tile: `_TILE_PIXELS` pixels, or so many blocks if these have more pixels."""


class _Store:
    """Tiles of this process, the most recently used last, and their memory."""

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.tiles: OrderedDict[Hashable, Float32] = OrderedDict()
        self.held_bytes, self.limit_bytes = 0, LIMIT_BYTES

    def find(self, key: Hashable) -> Float32 | None:
        with self.lock:
            if key in self.tiles:
                self.tiles.move_to_end(key)
            return self.tiles.get(key)

    def keep(self, key: Hashable, tile: Float32) -> None:
        with self.lock:
            if key not in self.tiles:
                self.tiles[key] = tile
                self.held_bytes += tile.nbytes
            while self.held_bytes > self.limit_bytes and len(self.tiles) > 1:
                _, oldest = self.tiles.popitem(last=False)
                self.held_bytes -= oldest.nbytes


_store = _Store()


def limit(size_bytes: int) -> None:
    """Let the tiles of this process take so much memory, at most `LIMIT_BYTES`; the next tile that is
    read frees what is too much.
    """
    with _store.lock:
        _store.limit_bytes = min(size_bytes, LIMIT_BYTES)


_windows: OrderedDict[Hashable, tuple[Window, Float32]] = OrderedDict()


def window(
    source: Hashable,
    factor: int,
    row0: int,
    row1: int,
    col0: int,
    col1: int,
    read: Callable[[int, int, int, int], Float32],
) -> Float32:
    """Blocks row0..row1, col0..col1 (half open) of ``factor`` pixels a side of a source; ``read``
    computes a window of blocks that are not in the cache.
    """
    side = max(_TILE_BLOCKS, -(-_TILE_PIXELS // factor))
    out = np.empty((row1 - row0, col1 - col0), np.float32)
    for i in range(row0 // side, -(-row1 // side)):
        for j in range(col0 // side, -(-col1 // side)):
            tile = _tile(source, factor, side, i, j, read)
            top, bottom = max(row0, i * side), min(row1, (i + 1) * side)
            left, right = max(col0, j * side), min(col1, (j + 1) * side)
            out[top - row0 : bottom - row0, left - col0 : right - col0] = tile[
                top - i * side : bottom - i * side, left - j * side : right - j * side
            ]
    return out


def _tile(
    source: Hashable,
    factor: int,
    side: int,
    i: int,
    j: int,
    read: Callable[[int, int, int, int], Float32],
) -> Float32:
    key = (source, factor, i, j)
    tile = _store.find(key)
    if tile is None:
        tile = read(i * side, (i + 1) * side, j * side, (j + 1) * side)
        _store.keep(key, tile)
    return tile


def recent(
    source: Hashable, wanted: Window, margins: tuple[int, int], read: Callable[[Window], Float32]
) -> tuple[Float32, int, int]:
    """A window of a source that contains the wanted one, with its first row and column: the last one
    that was read if it does, otherwise one with ``margins`` (rows, columns) around the wanted one.
    """
    row0, row1, col0, col1 = wanted
    with _store.lock:
        found = _windows.get(source)
    if found is not None:
        (top, bottom, left, right), pixels = found
        if top <= row0 and row1 <= bottom and left <= col0 and col1 <= right:
            return pixels, top, left
    more = (row0 - margins[0], row1 + margins[0], col0 - margins[1], col1 + margins[1])
    if (more[1] - more[0]) * (more[3] - more[2]) > RECENT_PIXELS:
        return read(wanted), row0, col0
    pixels = read(more)
    with _store.lock:
        _windows[source] = more, pixels
        _windows.move_to_end(source)
        while len(_windows) > RECENT:
            _windows.popitem(last=False)
    return pixels, more[0], more[2]


CACHES_BYTES = LIMIT_BYTES + GDAL_CACHE_BYTES
"""Greatest size of the caches together, which is also the size without a limit of the caller's."""


def limit_caches(size_bytes: int) -> None:
    """Let the caches of this process take so much memory together, half each, at most `CACHES_BYTES`.
    What is read does not depend on it.
    """
    limit(size_bytes // 2)
    limit_gdal_cache(size_bytes // 2)
