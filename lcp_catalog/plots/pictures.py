"""Images for pages: values with gaps as grey pixels, reduced to a size that suits a page, and a PNG
encoder that needs no raster library.

Small text in pictures of pixels (OpenCV's Hershey font: ASCII only).
"""

from __future__ import annotations

import base64
import math
import struct
import zlib
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..arrays import AnyArray, Array, Bytes
from ..errors import package

HEIGHT_PX = 9
"""Height of a capital letter."""
LINE_PX = 14
"""Distance of two lines of text."""

_SCALE = 0.4


def width_px(text: str) -> int:
    """Width of a line of text."""
    import cv2  # noqa: PLC0415  # 20 MB and 0.1 s: a render imports this module

    return int(cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, _SCALE, 1)[0][0])


def draw_text(picture: Bytes, left: int, top: int, text: str, colour: tuple[int, int, int]) -> None:
    """Draw a line of text into a picture (rows, columns, 3), its capitals from row ``top`` down; parts outside the picture are
    cut off.
    """
    import cv2  # noqa: PLC0415  # as in `width_px`

    font, place = cv2.FONT_HERSHEY_SIMPLEX, (left, top + HEIGHT_PX)
    cv2.putText(picture, text, place, font, _SCALE, colour, 1, cv2.LINE_AA)


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


PIXELS_MAX = 640_000
"""Most pixels of an image: about half a megabyte as PNG."""

SIDE_MAX = 3000
"""Longest side of an image, pixels; matters for line-scanner strips."""

DARK, LIGHT = 8, 247
"""Grey values of the 1st and the 99th percentile."""


def shrunk(values: ArrayLike, pixels_max: int = PIXELS_MAX) -> Array:
    """Values (rows, cols) reduced to a smaller image of the same extent, unchanged if small enough.

    Each new pixel is the area-weighted mean of the finite values in it; NaN if they cover less than
    half of it.
    """
    image = np.asarray(values)
    rows, cols = image.shape
    scale = min(1.0, math.sqrt(pixels_max / max(rows * cols, 1)), SIDE_MAX / max(rows, cols, 1))
    if scale == 1.0:
        return image.astype(np.float64)
    shape = max(1, int(rows * scale)), max(1, int(cols * scale))
    known = np.isfinite(image)
    light = _area_means(np.where(known, image, 0.0), shape)
    share = _area_means(known, shape)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(share >= 0.5 - 1e-9, light / share, np.nan)


def _area_means(values: NDArray[np.generic], shape: tuple[int, int]) -> Array:
    """Means over equal boxes, first along rows, then along columns. Box edges may cut pixels."""
    half = _along_rows(values, shape[0])
    return _along_rows(half.T, shape[1]).T


def _along_rows(values: NDArray[np.generic], count: int) -> Array:
    """Means over ``count`` equal ranges of rows, at most as many as rows: whole rows, and shares of
    rows at the edges.
    """
    rows = len(values)
    edges = np.linspace(0.0, rows, count + 1)
    first = edges[:-1].astype(np.int64)
    total = np.add.reduceat(values, first, axis=0, dtype=np.float64)
    before = np.asarray(values[first], dtype=np.float64) * (edges[:-1] - first)[:, None]
    total -= before
    total[:-1] += before[1:]
    return total * (count / rows)


def grey(values: ArrayLike, like: ArrayLike | None = None) -> NDArray[np.uint8]:
    """Values (rows, cols) as grey and alpha (rows, cols, 2), stretched from the 1st percentile
    (`DARK`) to the 99th (`LIGHT`).

    NaN is transparent. ``like`` is another image of the same terrain: the percentiles are taken
    where both are finite, so that images that differ by gain and offset look the same.
    """
    image = np.asarray(values, dtype=np.float64)
    known = np.isfinite(image)
    both = known if like is None else known & np.isfinite(np.asarray(like))
    pixels = np.zeros((*image.shape, 2), dtype=np.uint8)
    if known.any():
        low, high = np.percentile(image[both if both.any() else known], [1.0, 99.0])
        stretched = DARK + (LIGHT - DARK) * (image[known] - low) / (
            high - low if high > low else 1.0
        )
        pixels[known, 0] = np.clip(stretched, 0, 255).astype(np.uint8)
        pixels[known, 1] = 255
    return pixels


_SHOWN_PIXELS = 100_000
"""Most pixels of a picture in a notebook."""


def shown(values: ArrayLike) -> str:
    """A picture of values (rows, cols) for a notebook, as an element of HTML."""
    address = data_uri(grey(shrunk(values, _SHOWN_PIXELS)))
    return f'<img src="{address}" alt="the picture" style="image-rendering:pixelated"/>'


def new_axis() -> Any:
    """An axis of matplotlib in a figure of its own. MissingPackageError without matplotlib."""
    return package("matplotlib.pyplot", "notebook", "a plot").subplots(layout="constrained")[1]
