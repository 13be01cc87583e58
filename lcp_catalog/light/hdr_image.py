"""Linear luminance of image files, read by OpenCV.

Float samples (Radiance, PFM, TIFF) are linear. Integer samples (PNG, JPEG, TIFF with 8 or 16 bits)
are decoded as sRGB (IEC 61966-2-1); their dynamic range is at most 3294 : 1 for 8 bits. Luminance
is that of Rec. 709 primaries, 0.2126 R + 0.7152 G + 0.0722 B. PRIMARIES, EXPOSURE and COLORCORR of
a Radiance file are ignored: they only scale or tint.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ..arrays import Array
from ..errors import ImageError
from ..photometry.srgb import REC_709, decode_srgb

_FULL_SCALE = {"uint8": 255.0, "uint16": 65535.0}
_FLOATS = ("float32", "float64")
_TAIL = 1024


@dataclass(frozen=True, eq=False)
class LuminanceImage:
    """Linear luminance (rows, cols). ``encoded``: True if the samples were encoded for a display;
    white is 1 then.
    """

    luminance: Array
    encoded: bool
    name: str


def read_picture(path: Path | str) -> LuminanceImage:
    """Luminance of an image file; an alpha channel is ignored. ImageError for a file that is
    missing, unreadable, negative or not finite.
    """
    name = Path(path).name
    samples = _samples(path)
    kind = samples.dtype.name
    if kind not in _FULL_SCALE and kind not in _FLOATS:
        raise ImageError(f"{path}: samples are {kind}; give 8 or 16 bits, or floats")
    encoded = kind in _FULL_SCALE
    planes = samples[:, :, None] if samples.ndim == 2 else samples
    weights = REC_709[::-1] if planes.shape[2] >= 3 else (1.0,)  # OpenCV's order is blue first
    luminance = np.zeros(planes.shape[:2])
    for channel, weight in enumerate(weights):
        plane = planes[:, :, channel].astype(np.float64)
        luminance += weight * (decode_srgb(plane / _FULL_SCALE[kind]) if encoded else plane)
        _require_light(path, planes[:, :, channel])
    return LuminanceImage(luminance, encoded, name)


def resized(values: Array, shape: tuple[int, int]) -> Array:
    """Values on another raster of the same extent: area means if it is coarser, linear between
    pixel centres if it is finer.
    """
    if values.shape == shape:
        return values
    coarser = shape[0] < values.shape[0]
    how = cv2.INTER_AREA if coarser else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(values, shape[::-1], interpolation=how), dtype=np.float64)


def _samples(path: Path | str) -> NDArray[Any]:
    """Samples as OpenCV reads them, (rows, cols) or (rows, cols, channels)."""
    try:
        with open(path, "rb") as file:
            start = file.read(2)
            file.seek(-min(_TAIL, os.fstat(file.fileno()).st_size), os.SEEK_END)
            end = file.read()
    except OSError as error:
        raise ImageError(f"{path}: {error.strerror or error}") from error
    # OpenCV silently fills the missing part of a truncated JPEG with grey
    cut_short = start == b"\xff\xd8" and b"\xff\xd9" not in end
    samples = None if cut_short else _decoded(path)
    if samples is None:
        hint = "; OpenEXR is not built in: convert to .hdr, .pfm or float .tif"
        exr = os.fspath(path).lower().endswith(".exr")
        raise ImageError(f"{path}: not a complete image that OpenCV can read{hint if exr else ''}")
    return samples


def _decoded(path: Path | str) -> NDArray[Any] | None:
    """None for a file that OpenCV cannot read; OpenCV's own messages are suppressed."""
    logging = cv2.utils.logging
    before = logging.setLogLevel(logging.LOG_LEVEL_SILENT)
    try:
        return np.asarray(found) if (found := _imread(path)) is not None else None
    finally:
        logging.setLogLevel(before)


def _imread(path: Path | str) -> NDArray[Any] | None:
    try:
        return cv2.imread(os.fspath(path), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        return None


def _require_light(path: Path | str, plane: NDArray[Any]) -> None:
    if plane.dtype.name not in _FLOATS:
        return
    bad = int(np.count_nonzero(~np.isfinite(plane)))
    if bad:
        raise ImageError(f"{path}: {bad} samples are not finite")
    below = int(np.count_nonzero(plane < 0))
    if below:
        raise ImageError(f"{path}: {below} samples are negative")
