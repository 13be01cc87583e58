"""Environment maps: luminance in all directions as one equirectangular image.

The image is twice as wide as high. The top row is at the zenith of the area's east-north-up frame,
the bottom row at the nadir. The middle column is at ``azimuth_deg``, clockwise from north; azimuth
increases to the right. Luminance is constant within a pixel's rectangle of azimuth and elevation;
integrals over pixels are exact.

Linear luminance of image files, read by OpenCV.

Float samples (Radiance, PFM, TIFF) are linear. Integer samples (PNG, JPEG, TIFF with 8 or 16 bits)
are decoded as sRGB (IEC 61966-2-1); their dynamic range is at most 3294 : 1 for 8 bits. Luminance
is that of Rec. 709 primaries, 0.2126 R + 0.7152 G + 0.0722 B. PRIMARIES, EXPOSURE and COLORCORR of
a Radiance file are ignored: they only scale or tint.
"""

from __future__ import annotations

import logging
import math
import os
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..arrays import Array
from ..errors import ImageError
from ..photometry.srgb import REC_709, decode_srgb

log = logging.getLogger(__name__)

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
    import cv2  # noqa: PLC0415  # 20 MB and 0.1 s: only where there is an image

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
    import cv2  # noqa: PLC0415  # as in `resized`

    logging = getattr(cv2.utils, "logging", cv2)  # the latter in OpenCV 4
    before = logging.setLogLevel(0)  # silent
    try:
        found = cv2.imread(os.fspath(path), cv2.IMREAD_UNCHANGED)
        return None if found is None else np.asarray(found)
    except cv2.error:
        return None
    finally:
        logging.setLogLevel(before)


def _require_light(path: Path | str, plane: NDArray[Any]) -> None:
    if plane.dtype.name not in _FLOATS:
        return
    bad = int(np.count_nonzero(~np.isfinite(plane)))
    if bad:
        raise ImageError(f"{path}: {bad} samples are not finite")
    below = int(np.count_nonzero(plane < 0))
    if below:
        raise ImageError(f"{path}: {below} samples are negative")


DARKEST_SHARE = 0.01
"""Share of the solid angle with light that a dynamic range leaves out at its dark end: the darkest
pixels are noise (1e-15 in recorded panoramas), and one of them must not decide the range."""

_RANGE_PIXELS = 1 << 20


@dataclass(frozen=True, eq=False)
class Panorama:
    """Luminance (rows, 2 rows) in any linear unit, and the azimuth of the middle column. ImageError
    for another shape, for luminance that is negative or not finite, and if it is 0 everywhere.
    """

    luminance: Array
    azimuth_deg: float = 0.0
    name: str = "panorama"
    encoded: bool = False
    """True if the samples were encoded for a display, which cuts off a Sun's luminance."""

    def __post_init__(self) -> None:
        luminance = np.ascontiguousarray(self.luminance, dtype=np.float64)
        shape = luminance.shape
        if luminance.ndim != 2 or shape[0] < 2 or shape[1] != 2 * shape[0]:
            size = " x ".join(map(str, shape[::-1]))
            raise ImageError(
                f"{self.name}: {size} pixels; a panorama of all directions is twice as wide as high"
            )
        if not np.isfinite(luminance).all() or (luminance < 0.0).any():
            raise ImageError(f"{self.name}: luminance must be finite and 0 or more")
        if not luminance.any():
            raise ImageError(f"{self.name}: the panorama is black")
        if not math.isfinite(self.azimuth_deg):
            raise ImageError(f"{self.name}: invalid azimuth {self.azimuth_deg}")
        object.__setattr__(self, "luminance", luminance)

    @property
    def rows(self) -> int:
        return int(self.luminance.shape[0])

    @property
    def cols(self) -> int:
        return int(self.luminance.shape[1])

    @property
    def pixel_rad(self) -> float:
        """Height and width of a pixel in elevation and azimuth."""
        return math.pi / self.rows

    @cached_property
    def elevations(self) -> Array:
        """Elevations of the rows' centres, radians (rows,), from the zenith down."""
        return np.asarray(math.pi / 2.0 - (np.arange(self.rows) + 0.5) * self.pixel_rad)

    @cached_property
    def azimuths(self) -> Array:
        """Azimuths of the columns' centres, radians (cols,), clockwise from north, not reduced to
        one turn.
        """
        return self.column_azimuth(np.arange(self.cols) + 0.5)

    def column_azimuth(self, place: ArrayLike) -> Array:
        """Azimuth (radians) of positions in columns from the image's left edge."""
        turn = math.radians(self.azimuth_deg) - math.pi
        return np.asarray(place, dtype=np.float64) * self.pixel_rad + turn

    @cached_property
    def solid_angles(self) -> Array:
        """Solid angle of a pixel of each row, sr (rows,): (sin upper - sin lower) x width."""
        half = 0.5 * self.pixel_rad
        return 2.0 * np.cos(self.elevations) * math.sin(half) * self.pixel_rad

    @cached_property
    def levels(self) -> Array:
        """Integral of the sine of elevation over a pixel of each row, sr (rows,): its contribution
        to a horizontal plane; negative below the horizon.
        """
        sine = np.sin(2.0 * self.elevations) * math.sin(self.pixel_rad)
        return 0.5 * sine * self.pixel_rad

    def moments(self, row: NDArray[np.int64], col: NDArray[np.int64]) -> Array:
        """Integral of the unit direction (east, north, up) over pixels (n,), sr (n, 3)."""
        half = 0.5 * self.pixel_rad
        level = half + 0.5 * math.sin(2.0 * half) * np.cos(2.0 * self.elevations[row])
        level *= 2.0 * math.sin(half)
        azimuth = self.azimuths[col]
        east, north = level * np.sin(azimuth), level * np.cos(azimuth)
        return np.stack([east, north, self.levels[row]], axis=-1)

    @cached_property
    def above(self) -> Array:
        """Share of each row above the horizontal plane, (rows,): 1 or 0, and 1/2 for the middle row
        of an odd number of rows.
        """
        return np.clip(0.5 * self.rows - np.arange(self.rows), 0.0, 1.0)

    @cached_property
    def power(self) -> float:
        """Integral of luminance over the sphere."""
        return float(self.luminance.sum(axis=1) @ self.solid_angles)

    @cached_property
    def power_above(self) -> float:
        """Integral of luminance over the sphere above the horizontal plane."""
        solid = self.solid_angles * self.above
        return float(self.luminance.sum(axis=1) @ solid)

    @cached_property
    def horizontal_irradiance(self) -> float:
        """Irradiance of a horizontal plane from above: integral of luminance times the sine of
        elevation.
        """
        half = 0.5 * self.pixel_rad
        middle = (
            0.5 * math.sin(half) ** 2 * self.pixel_rad
        )  # contribution of a half row above the horizon
        levels = np.where(self.above == 0.5, middle, self.levels * (self.above == 1.0))
        return float(self.luminance.sum(axis=1) @ levels)

    @property
    def moment_above(self) -> Array:
        """Integral of luminance times the unit direction (3,) above the horizontal plane."""
        rows = np.arange((self.rows + 1) // 2)
        along = self.luminance[rows] @ np.stack([np.sin(self.azimuths), np.cos(self.azimuths)], 1)
        level = self.moments(rows, np.zeros_like(rows))
        level = np.hypot(level[:, 0], level[:, 1]) * self.above[rows]
        east, north = level @ along
        return np.array([east, north, self.horizontal_irradiance])

    @property
    def middle_above(self) -> Array:
        """Unit direction (3,) to the centroid of the power above the horizontal plane; the zenith
        if the centroid is undefined.
        """
        found = self.moment_above
        length = float(np.linalg.norm(found))
        return found / length if length > 0.0 else np.array([0.0, 0.0, 1.0])

    @cached_property
    def dynamic_range(self) -> float:
        """Greatest luminance over the least, of the luminance above 0 without the darkest
        `DARKEST_SHARE` of its solid angle.
        """
        return self._range(self.rows)

    @cached_property
    def dynamic_range_above(self) -> float:
        """Dynamic range above the horizon; NaN if all of that is black."""
        return self._range(self.rows // 2)

    def _range(self, rows: int) -> float:
        """Dynamic range of the first rows; of a large panorama the dark end is that of a sample."""
        light = self.luminance[:rows]
        if not light.any():
            return math.nan
        step = max(1, math.isqrt(light.size // _RANGE_PIXELS))
        solid = np.broadcast_to(self.solid_angles[:rows, None], light.shape)[::step, ::step]
        values = light[::step, ::step]
        lit = values > 0.0
        if not lit.any():
            values, solid, lit = light, np.ones_like(light), light > 0.0
        order = np.argsort(values[lit])
        sums = np.cumsum(solid[lit][order])
        least = values[lit][order[np.searchsorted(sums, DARKEST_SHARE * sums[-1])]]
        return float(light.max() / least)

    def at(self, directions: ArrayLike) -> Array:
        """Luminance (...) in directions (..., 3), linear between pixel centres; constant beyond the
        first and the last row's centres.
        """
        east, north, up = np.moveaxis(np.asarray(directions, dtype=np.float64), -1, 0)
        azimuth = np.arctan2(east, north) - self.azimuths[0]
        col = (azimuth / self.pixel_rad) % self.cols
        elevation = np.arctan2(up, np.hypot(east, north))
        row = np.clip((self.elevations[0] - elevation) / self.pixel_rad, 0.0, self.rows - 1.0)
        left, top = np.floor(col).astype(np.int64) % self.cols, np.floor(row).astype(np.int64)
        right, below = (left + 1) % self.cols, np.minimum(top + 1, self.rows - 1)
        x, y = col - np.floor(col), row - top
        light = self.luminance
        upper = light[top, left] * (1.0 - x) + light[top, right] * x
        lower = light[below, left] * (1.0 - x) + light[below, right] * x
        return np.asarray(upper * (1.0 - y) + lower * y)

    def times(self, factor: float) -> Panorama:
        """The same with luminance multiplied by a factor."""
        return replace(self, luminance=self.luminance * factor)


def read_panorama(path: Path | str, azimuth_deg: float = 0.0) -> Panorama:
    """Panorama of an image file (`environment_map.read_picture`); ImageError for a file that is not a
    panorama.
    """
    picture = read_picture(path)
    if picture.encoded:
        log.warning(
            "%s: 8 or 16 bit samples, decoded as sRGB: luminance of bright sources is cut off at white",
            picture.name,
        )
    return Panorama(picture.luminance, azimuth_deg, picture.name, picture.encoded)
