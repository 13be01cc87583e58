"""Small pictures as PNG bytes, without a raster library: for pages that hold their own pictures."""

from __future__ import annotations

import struct
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

_COLOUR_TYPES = {1: 0, 2: 4, 3: 2, 4: 6}
"""Channels -> PNG colour type: grey, grey and alpha, RGB, RGBA."""


def encode_png(pixels: NDArray[np.uint8]) -> bytes:
    """PNG of (rows, cols) grey or (rows, cols, 2 | 3 | 4) grey-alpha, RGB, RGBA; equal pixels
    give equal bytes.

    ValueError for another shape or type, or an empty picture.
    """
    planes = pixels[..., None] if pixels.ndim == 2 else pixels
    if planes.ndim != 3 or planes.shape[2] not in _COLOUR_TYPES or planes.dtype != np.uint8:
        raise ValueError(f"no picture: {pixels.dtype} {pixels.shape}")
    rows, cols, channels = planes.shape
    if not rows * cols:
        raise ValueError("an empty picture")
    header = struct.pack(">IIBBBBB", cols, rows, 8, _COLOUR_TYPES[channels], 0, 0, 0)
    lines = _up_filtered(planes.reshape(rows, cols * channels))
    body = _chunk(b"IHDR", header) + _chunk(b"IDAT", zlib.compress(lines, 9)) + _chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + body


def _up_filtered(lines: NDArray[Any]) -> bytes:
    """Each row as its difference from the row above (filter 2), which packs relief better than
    the pixels themselves.
    """
    above = np.vstack([np.zeros_like(lines[:1]), lines[:-1]])
    return np.hstack([np.full((len(lines), 1), 2, np.uint8), lines - above]).tobytes()


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
