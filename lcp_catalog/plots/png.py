"""PNG encoder for small images inside pages; needs no raster library."""

from __future__ import annotations

import base64
import struct
import zlib

import numpy as np
from numpy.typing import NDArray

from ..arrays import AnyArray

_COLOUR_TYPES = {1: 0, 2: 4, 3: 2, 4: 6}
"""Channels -> PNG colour type: grey, grey and alpha, RGB, RGBA."""


def encode_png(pixels: NDArray[np.uint8]) -> bytes:
    """PNG of pixels (rows, cols) grey or (rows, cols, 2 | 3 | 4): grey and alpha, RGB, RGBA.

    Equal pixels give equal bytes. ValueError for another shape or type, or an empty image.
    """
    planes = pixels[..., None] if pixels.ndim == 2 else pixels
    if planes.ndim != 3 or planes.shape[2] not in _COLOUR_TYPES or planes.dtype != np.uint8:
        raise ValueError(f"not an image: {pixels.dtype} {pixels.shape}")
    rows, cols, channels = planes.shape
    if not rows * cols:
        raise ValueError("empty image")
    header = struct.pack(">IIBBBBB", cols, rows, 8, _COLOUR_TYPES[channels], 0, 0, 0)
    lines = _up_filtered(planes.reshape(rows, cols * channels))
    body = _chunk(b"IHDR", header) + _chunk(b"IDAT", zlib.compress(lines, 9)) + _chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + body


def data_uri(pixels: NDArray[np.uint8]) -> str:
    """An image as a ``data:`` address that contains it."""
    return "data:image/png;base64," + base64.b64encode(encode_png(pixels)).decode("ascii")


def _up_filtered(lines: AnyArray) -> bytes:
    """Each row as its difference from the row above (PNG filter 2), which compresses shaded relief
    better than the pixels themselves.
    """
    above = np.vstack([np.zeros_like(lines[:1]), lines[:-1]])
    return np.hstack([np.full((len(lines), 1), 2, np.uint8), lines - above]).tobytes()


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
