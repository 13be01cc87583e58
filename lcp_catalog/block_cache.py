"""Means of blocks of pixels, kept: the far terrain of neighbouring areas, and every step of a node's solution, want them again.

A window of blocks is put together from square tiles of a fixed lattice, so that a block's mean is the same whatever is asked, and a
large file is read once for each of its block sizes and not once for each question.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable

import numpy as np

from .raster import Heights

LIMIT_BYTES = 256 << 20
"""Kept in a process at most; the tiles that were asked for longest ago go first."""

_TILE_PIXELS = 1024
_TILE_BLOCKS = 64
"""A tile's side: so many pixels, or so many blocks where these are more pixels."""

_lock = threading.Lock()
_tiles: OrderedDict[Hashable, Heights] = OrderedDict()
_held_bytes = 0


def window(
    source: Hashable,
    factor: int,
    row0: int,
    row1: int,
    col0: int,
    col1: int,
    read: Callable[[int, int, int, int], Heights],
) -> Heights:
    """Blocks row0..row1, col0..col1 (half open) of ``factor`` pixels a side of a source; ``read`` makes
    those of such a window that are not kept.
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


def forget() -> None:
    """Let everything go."""
    global _held_bytes  # noqa: PLW0603  (one store a process)
    with _lock:
        _tiles.clear()
        _held_bytes = 0


def _tile(
    source: Hashable,
    factor: int,
    side: int,
    i: int,
    j: int,
    read: Callable[[int, int, int, int], Heights],
) -> Heights:
    global _held_bytes  # noqa: PLW0603
    key = (source, factor, i, j)
    with _lock:
        if key in _tiles:
            _tiles.move_to_end(key)
            return _tiles[key]
    tile = read(i * side, (i + 1) * side, j * side, (j + 1) * side)
    with _lock:
        if key not in _tiles:
            _tiles[key] = tile
            _held_bytes += tile.nbytes
        while _held_bytes > LIMIT_BYTES and len(_tiles) > 1:
            _, oldest = _tiles.popitem(last=False)
            _held_bytes -= oldest.nbytes
    return tile
