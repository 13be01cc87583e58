"""One band of an image file as it is stored, with what the file itself says of it: mask, scale, map, tags."""

from __future__ import annotations

import json
import logging
import re
import struct
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from numpy.typing import NDArray
from rasterio.enums import ColorInterp
from rasterio.errors import NotGeoreferencedWarning, RasterioError

from ..arrays import Mask
from ..choices import ENCODINGS
from ..errors import ImageError, LabelError, LcpError
from ..pds.label_files import find_label
from ..pds.pds3 import read_label_text
from ..pds.pds4 import is_pds4
from ..photometry.srgb import REC_709, decode_srgb

log = logging.getLogger(__name__)

OWN_CODES = ("ISIS3", "PDS")
"""Drivers of formats whose labels, or whose types, say which samples are no brightness."""

_BARE = ("PDS", "PDS4", "VICAR")
"""Drivers of formats whose samples lie in the file as they are."""
_PLACE = r"\^IMAGE\s*=\s*(\d+)\s*(<BYTES>)?"
_RECORD = r"RECORD_BYTES\s*=\s*(\d+)"

_COLOURS = (ColorInterp.red, ColorInterp.green, ColorInterp.blue)
_MOST_PIXELS = 300_000_000


@dataclass(frozen=True, eq=False)
class ImagePixels:
    """Samples (rows, cols) as they are stored, and which of them the file calls valid (rows, cols).

    ``transform`` (a, b, c, d, e, f) takes corner coordinates of pixels, 0 at the image's upper left
    corner, to the map: x = a col + b row + c, y = d col + e row + f. ``crs_wkt`` is None for an image
    that is not map-projected. ``opened`` is the file that was read: the label, for the bare numbers of an .IMG.
    """

    path: Path
    opened: Path
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
    is_decoded: bool = False
    """Whether the samples are luminance already, whatever the encoding was."""
    states_nodata: bool = False
    """Whether a value for what is missing was stated, by the file or the caller."""


def read_pixels(
    path: Path | str,
    band: int | None = None,
    nodata: float | None = None,
    encoding: str = ENCODINGS[0],
) -> ImagePixels:
    """An image file's band (counted from 1; None: the luminance of a colour image, else the first).

    ``nodata`` is a value that means "nothing here", beside what the file says. ``encoding`` matters to colours alone, which become
    luminance here: codes of a display (``srgb``) are decoded before. ImageError for what is no image, has no such
    band, or cannot be read.
    """
    with _opened(Path(path)) as (opened, file):
        return _read((Path(path), opened), file, (band, nodata, encoding))


def image_shape(path: Path | str) -> tuple[int, int]:
    """Rows and columns of an image file, none of which is read; ImageError as `read_pixels`."""
    with _opened(Path(path)) as (_, file):
        return int(file.height), int(file.width)


@contextmanager
def _opened(path: Path) -> Iterator[tuple[Path, Any]]:
    """What GDAL opens of an image, and the open file."""
    opened = _pixels_of(path)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            with rasterio.open(opened) as file:
                yield opened, file
    except (RasterioError, OSError) as error:
        if isinstance(error, LcpError):
            raise
        cause = " ".join(str(error.__cause__ or error).split())
        raise ImageError(f"{path}: not an image that can be read here ({cause})") from error


def _pixels_of(path: Path) -> Path:
    """What GDAL is to open: the label for the bare numbers of an .IMG of PDS3 or PDS4."""
    if not path.is_file():
        raise ImageError(f"{path}: no such image file")
    if path.suffix.lower() != ".img":
        return path
    try:
        return find_label(path)
    except LabelError:
        names = (path.with_suffix(".xml"), path.with_suffix(".XML"))
        of_pds4 = [name for name in names if name.is_file() and is_pds4(name)]
        return of_pds4[0] if of_pds4 else path  # .img is also what others call their files


def _read(
    paths: tuple[Path, Path], file: Any, how: tuple[int | None, float | None, str]
) -> ImagePixels:
    (path, opened), (band, nodata, encoding) = paths, how
    if band is not None and not 1 <= band <= file.count:
        raise ImageError(f"{path}: has no band {band}; bands are 1 to {file.count}")
    if file.count == 0 or file.width * file.height > _MOST_PIXELS:
        raise ImageError(
            f"{path}: {file.width} x {file.height} pixels, {file.count} bands; at most "
            f"{_MOST_PIXELS / 1e6:g} million pixels are taken: cut out a part"
        )
    if np.dtype(file.dtypes[0]).kind not in "uif":
        raise ImageError(f"{path}: samples are {file.dtypes[0]}; give integers or floats")
    if not _is_whole(file):
        raise ImageError(f"{path}: is cut short: the end of its pixels is missing; fetch it again")
    first = band or 1
    samples, colour = _samples(file, band, encoding)
    mask = _mask_band(file, first)
    valid = _valid(file, first, mask)
    if nodata is not None:
        valid &= samples != nodata
    scale, offset = (1.0, 0.0) if colour else (file.scales[first - 1], file.offsets[first - 1])
    return ImagePixels(
        path=path,
        opened=opened,
        samples=samples,
        valid=valid,
        driver=file.driver,
        scale=float(scale),
        offset=float(offset),
        crs_wkt=file.crs.to_wkt() if file.crs else None,
        transform=tuple(file.transform)[:6],
        tags=file.tags(),
        isis=_isis_label(file),
        is_decoded=colour and np.dtype(file.dtypes[0]).kind in "ui",
        states_nodata=nodata is not None or file.nodatavals[first - 1] is not None,
    )


def _is_whole(file: Any) -> bool:
    """Whether a file's end is there, of those formats of which GDAL 3.10 reads without a word what is cut short: of a PNG of 8
    bits it hands over the compressed bytes as samples, for the lost end of bare numbers zeros, which are shadow here.
    """
    if file.driver == "PNG":
        return _has_end(Path(file.name))
    if file.driver not in _BARE or "compression" in file.profile:
        return True
    numbers = [name for name in file.files if not name.lower().endswith((".lbl", ".xml"))]
    size = Path(numbers[0] if numbers else file.name).stat().st_size
    samples = file.width * file.height * sum(np.dtype(dtype).itemsize for dtype in file.dtypes)
    return bool(size >= _first_byte(read_label_text(Path(file.name)) or "") + samples)


def _first_byte(label: str) -> int:
    """Where a PDS3 label says that its own file's image begins: ``^IMAGE = 2`` (records) or ``4097 <BYTES>``; else 0."""
    place, record = (re.search(what, label) for what in (_PLACE, _RECORD))
    if place is None or not (place[2] or record):
        return 0
    return (int(place[1]) - 1) * (1 if place[2] or not record else int(record[1]))


def _has_end(path: Path) -> bool:
    """Whether a PNG's chunks run on to its last one (PNG, second edition, 5.3 and 11.2.5: length, type, data, checksum; IEND)."""
    with path.open("rb") as png:
        png.seek(8)
        while len(head := png.read(8)) == 8:
            length, kind = struct.unpack(">I4s", head)
            if kind == b"IEND":
                return True
            png.seek(length + 4, 1)
    return False


def _valid(file: Any, first: int, mask: int | None) -> Mask:
    """What the file's mask, alpha band or nodata value says of a band.

    GDAL's own mask of cubes and PDS3 images is not asked: it throws what is too dark and too bright in with what is missing, and
    takes 0 for missing where no label says so.
    """
    if file.driver in OWN_CODES:
        return np.ones(file.shape, dtype=bool)
    return np.asarray((file.read_masks(first) if mask is None else file.read(mask)) != 0)


def _samples(file: Any, band: int | None, encoding: str) -> tuple[NDArray[Any], bool]:
    """The band's samples, and whether they are no longer those that were stored: luminance of colours that differ."""
    kinds = file.colorinterp
    if band is None and all(colour in kinds for colour in _COLOURS):
        return _luminance([file.read(kinds.index(colour) + 1) for colour in _COLOURS], encoding)
    samples = file.read(band or 1)
    if kinds[(band or 1) - 1] != ColorInterp.palette:
        return samples, False
    table = np.zeros((int(np.iinfo(samples.dtype).max) + 1, 3), dtype=samples.dtype)
    for code, entry in file.colormap(band or 1).items():
        table[code] = entry[:3]
    values, changed = _luminance(list(table.T), encoding)
    return values[samples], changed


def _luminance(planes: list[NDArray[Any]], encoding: str) -> tuple[NDArray[Any], bool]:
    """Of red, green and blue; of greys that are written as colours the grey, as it is stored."""
    if all(np.array_equal(planes[0], plane) for plane in planes[1:]):
        return planes[0], False
    total = np.zeros(planes[0].shape, dtype=np.float32)
    for plane, weight in zip(planes, REC_709, strict=True):
        decoded = encoding == "srgb" and plane.dtype.kind in "ui"
        total += weight * (decode_srgb(plane / np.iinfo(plane.dtype).max) if decoded else plane)
    return total, True


def _mask_band(file: Any, first: int) -> int | None:
    """The band that says what is valid though nothing calls it a mask: the second of two, of nothing but 0
    and the highest code.
    """
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
