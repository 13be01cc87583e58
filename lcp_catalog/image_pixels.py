"""One band of an image file as it is stored, with what the file itself says of it: mask, scale, map, tags."""

from __future__ import annotations

import json
import logging
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from numpy.typing import NDArray
from rasterio.enums import ColorInterp
from rasterio.errors import NotGeoreferencedWarning, RasterioError

from .errors import ImageError, LabelError
from .label import find_label

log = logging.getLogger(__name__)

Mask = NDArray[np.bool_]

REC_709 = (0.2126, 0.7152, 0.0722)
"""Luminance of red, green and blue (ITU-R BT.709), taken of the samples as they are."""

OWN_CODES = ("ISIS3", "PDS")
"""Drivers of formats whose labels, or whose types, say which samples are no brightness."""

_COLOURS = (ColorInterp.red, ColorInterp.green, ColorInterp.blue)
_MOST_PIXELS = 400_000_000


@dataclass(frozen=True, eq=False)
class ImagePixels:
    """Samples (rows, cols) as they are stored, and which of them the file calls valid (rows, cols).

    ``transform`` (a, b, c, d, e, f) takes corner coordinates of pixels, 0 at the image's upper left
    corner, to the map: x = a col + b row + c, y = d col + e row + f. ``crs_wkt`` is None for an image
    that is not map-projected.
    """

    path: Path
    samples: NDArray[Any]
    valid: Mask
    driver: str
    scale: float = 1.0
    offset: float = 0.0
    crs_wkt: str | None = None
    transform: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0)
    tags: Mapping[str, str] | None = None
    isis: Mapping[str, Any] | None = None
    """The label of an ISIS cube, as GDAL turns it into JSON."""
    states_nodata: bool = False
    """Whether a value for what is missing was stated, by the file or the caller."""


def read_image(
    path: Path | str, band: int | None = None, nodata: float | None = None
) -> ImagePixels:
    """An image file's band (counted from 1; None: the luminance of a colour image, else the first).

    ``nodata`` is a value that means "nothing here", beside what the file says. ImageError for what is no image, has no such
    band, or cannot be read.
    """
    path = Path(path)
    opened = _pixels_of(path)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            with rasterio.open(opened) as file:
                return _read(path, file, band, nodata)
    except (RasterioError, OSError) as error:
        cause = " ".join(str(error.__cause__ or error).split())
        raise ImageError(f"{path}: not an image that can be read here ({cause})") from error


def _pixels_of(path: Path) -> Path:
    """What GDAL is to open: the label for the bare numbers of a PDS3 .IMG."""
    if not path.is_file():
        raise ImageError(f"{path}: no such image file")
    if path.suffix.lower() != ".img":
        return path
    try:
        return find_label(path)
    except LabelError:
        return path  # .img is also what others call their files: GDAL says whether it knows it


def _read(path: Path, file: Any, band: int | None, nodata: float | None) -> ImagePixels:
    if band is not None and not 1 <= band <= file.count:
        raise ImageError(f"{path}: has no band {band}; bands are 1 to {file.count}")
    if file.count == 0 or file.width * file.height > _MOST_PIXELS:
        raise ImageError(
            f"{path}: {file.width} x {file.height} pixels, {file.count} bands; at most "
            f"{_MOST_PIXELS / 1e6:g} million pixels are taken: cut out a part"
        )
    if np.dtype(file.dtypes[0]).kind not in "uif":
        raise ImageError(f"{path}: samples are {file.dtypes[0]}; give integers or floats")
    first = band or 1
    samples, colour = _samples(file, band)
    mask = _mask_band(file, first)
    valid = _valid(file, first, mask)
    if nodata is not None:
        valid &= samples != nodata
    scale, offset = (1.0, 0.0) if colour else (file.scales[first - 1], file.offsets[first - 1])
    return ImagePixels(
        path=path,
        samples=samples,
        valid=valid,
        driver=file.driver,
        scale=float(scale),
        offset=float(offset),
        crs_wkt=file.crs.to_wkt() if file.crs else None,
        transform=tuple(file.transform)[:6],
        tags=file.tags(),
        isis=_isis_label(file),
        states_nodata=nodata is not None or file.nodatavals[first - 1] is not None,
    )


def _valid(file: Any, first: int, mask: int | None) -> Mask:
    """What the file's mask says of a band. GDAL's own of cubes and PDS3 images is not asked: it throws what is too dark and
    too bright in with what is missing, and takes 0 for missing where no label says so.
    """
    if file.driver in OWN_CODES:
        return np.ones(file.shape, dtype=bool)
    return np.asarray((file.read_masks(first) if mask is None else file.read(mask)) != 0)


def _samples(file: Any, band: int | None) -> tuple[NDArray[Any], bool]:
    """The band's samples, and whether they were put together from colours."""
    kinds = file.colorinterp
    if band is None and all(colour in kinds for colour in _COLOURS):
        planes = [file.read(kinds.index(colour) + 1).astype(np.float32) for colour in _COLOURS]
        total = planes[0] * REC_709[0]
        for plane, weight in zip(planes[1:], REC_709[1:], strict=True):
            total += plane * weight
        return total, True
    samples = file.read(band or 1)
    if kinds[(band or 1) - 1] != ColorInterp.palette:
        return samples, False
    table = np.zeros(int(np.iinfo(samples.dtype).max) + 1, dtype=np.float32)
    for code, entry in file.colormap(band or 1).items():
        table[code] = np.dot(entry[:3], REC_709)
    grey = np.round(table).astype(samples.dtype)
    return (grey if np.allclose(grey, table, atol=1e-3) else table)[samples], True


def _mask_band(file: Any, first: int) -> int | None:
    """The band that says what is valid: one marked as alpha; or, where there are two, a second of nothing
    but 0 and the highest code.
    """
    kinds = file.colorinterp
    if ColorInterp.alpha in kinds:
        return int(kinds.index(ColorInterp.alpha)) + 1
    if file.count != 2 or first != 1 or np.dtype(file.dtypes[1]).kind != "u":
        return None
    top = np.iinfo(file.dtypes[1]).max
    second = file.read(2)
    return 2 if bool(((second == 0) | (second == top)).all()) else None


def _isis_label(file: Any) -> Mapping[str, Any] | None:
    """GDAL hands the JSON over as a tag that rasterio cuts at its first colon."""
    for key, rest in file.tags(ns="json:ISIS3").items():
        try:
            found: Mapping[str, Any] = json.loads(f"{key}:{rest}")
        except ValueError:
            log.warning("%s: its ISIS label cannot be understood and is left aside", file.name)
            return None
        return found
    return None
