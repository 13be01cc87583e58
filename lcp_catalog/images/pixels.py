"""One band of an image file as stored, with the file's mask, scale, map and tags.

Samples that are not brightness: ISIS special pixels, and plateaus at the ends of a scale.

ISIS reserves codes at the ends of each sample type (its SpecialPixel): NULL (missing), LRS and LIS
(below the range of the file or of the instrument), HRS and HIS (above). They are stored codes: base
and multiplier do not apply to them.
"""

from __future__ import annotations

import json
import logging
import re
import struct
import uuid
import warnings
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rasterio.enums import ColorInterp
from rasterio.errors import NotGeoreferencedWarning
from rasterio.io import MemoryFile
from scipy import ndimage

from ..arrays import Mask
from ..choices import ENCODINGS
from ..dem.raster_files import UNREADABLE, cause_of, open_raster, whole_reads
from ..errors import DemError, ImageError, LabelError, LcpError
from ..file_kinds import no_file
from ..pds.label_files import find_label
from ..pds.pds3 import read_label_text
from ..pds.pds4 import is_pds4
from ..photometry.srgb import REC_709, decode_srgb

log = logging.getLogger(__name__)

_FLOAT_CODES = {
    # null, low, low, high, high: bits of the five most negative finite numbers, from NULL on
    "float32": (0xFF7FFFFB, 0xFF7FFFFC, 0xFF7FFFFD, 0xFF7FFFFE, 0xFF7FFFFF),
    "float64": tuple(0xFFEFFFFFFFFFFFFB + step for step in range(5)),
}
_INTEGER_CODES = {
    # null, lrs, lis, his, hrs, and the valid range
    "uint8": ((0, 0, 0, 255, 255), (1, 254)),
    "int16": ((-32768, -32767, -32766, -32765, -32764), (-32752, 32767)),
    "uint16": ((0, 1, 2, 65534, 65535), (3, 65522)),
    "int32": (tuple(-(2**31) + step for step in range(5)), (-(2**31) + 16, 2**31 - 1)),
    "uint32": ((0, 1, 2, 2**32 - 2, 2**32 - 1), (3, 2**32 - 14)),
}

PLATEAU_NEIGHBOURS = 4
PLATEAU_FACTOR = 3.0
PLATEAU_LEAST = 8


@dataclass(frozen=True, eq=False)
class SpecialPixels:
    """Masks (rows, cols) of samples that are not brightness: ``missing``, below the range
    (``low``), above the range (``high``).
    """

    missing: Mask
    low: Mask
    high: Mask

    def __or__(self, other: SpecialPixels) -> SpecialPixels:
        return SpecialPixels(
            self.missing | other.missing, self.low | other.low, self.high | other.high
        )


@dataclass(frozen=True)
class Codes:
    """Stored samples that a label defines as not brightness; whole numbers above 2^31 are the bits
    of floats.
    """

    missing: tuple[float | int, ...] = ()
    low: tuple[float | int, ...] = ()
    high: tuple[float | int, ...] = ()

    def among(self, samples: NDArray[Any]) -> SpecialPixels:
        """Masks of the codes in samples (rows, cols)."""
        return SpecialPixels(
            *(_any_of(samples, codes) for codes in (self.missing, self.low, self.high))
        )


NO_CODES = Codes()


def _any_of(samples: NDArray[Any], codes: tuple[float | int, ...]) -> Mask:
    found = np.zeros(samples.shape, dtype=bool)
    bits = None
    if samples.dtype.kind == "f":
        bits = np.ascontiguousarray(samples).view(f"u{samples.dtype.itemsize}")
    for code in codes:
        if bits is not None and isinstance(code, int) and code > 2**31:
            found |= bits == code
        else:
            found |= samples == code
    return found


def isis_special(samples: NDArray[Any]) -> SpecialPixels:
    """Special pixels of a cube's samples (rows, cols). 8-bit samples have one code for NULL and
    both low codes, which is taken as NULL.

    Codes between the special ones and the valid range are reserved by ISIS and taken as missing.
    """
    if samples.dtype.kind == "f":
        return _special_floats(samples)
    if samples.dtype.name not in _INTEGER_CODES:
        nothing = np.zeros(samples.shape, dtype=bool)
        return SpecialPixels(nothing, nothing, nothing)
    (null, lrs, lis, his, hrs), (least, most) = _INTEGER_CODES[samples.dtype.name]
    low = ((samples == lrs) | (samples == lis)) & (samples != null)
    high = (samples == his) | (samples == hrs)
    return SpecialPixels(((samples < least) | (samples > most)) & ~low & ~high, low, high)


def _special_floats(samples: NDArray[Any]) -> SpecialPixels:
    bits = np.ascontiguousarray(samples).view(f"u{samples.dtype.itemsize}")
    null, lrs, lis, his, hrs = _FLOAT_CODES[samples.dtype.name]
    low, high = (bits == lrs) | (bits == lis), (bits == his) | (bits == hrs)
    return SpecialPixels((bits == null) | ~np.isfinite(samples), low, high)


def plateau_ends(samples: NDArray[Any], valid: Mask) -> tuple[float | None, float | None]:
    """The lowest and the highest value of samples where ``valid``, each only if it is a plateau;
    else None.

    At the end of a scale without clipping, values become rare. A plateau is an end value that
    occurs at least `PLATEAU_LEAST` times, and more than `PLATEAU_FACTOR` times as often as the
    average neighbouring value. Neighbouring values are those next to the end that make up
    `PLATEAU_NEIGHBOURS` times its count of pixels.
    """
    values = samples[valid]
    if values.size == 0:
        return None, None
    low, high = values.min(), values.max()
    if low == high:
        return None, None
    return (
        float(low) if _is_plateau(values, low, 1.0) else None,
        float(high) if _is_plateau(values, high, -1.0) else None,
    )


def _is_plateau(values: NDArray[Any], end: Any, towards: float) -> bool:
    others = values[values != end]
    count = values.size - others.size
    if count < PLATEAU_LEAST:
        return False
    next_to = min(others.size, PLATEAU_NEIGHBOURS * count)
    kth = next_to - 1 if towards > 0 else others.size - next_to
    parted = np.partition(others, kth)
    nearest = parted[:next_to] if towards > 0 else parted[kth:]
    return bool(count > PLATEAU_FACTOR * next_to / np.unique(nearest).size)


def touching_edge(mask: Mask) -> Mask:
    """The parts of a mask (rows, cols), connected by sides, that touch the edge of the image."""
    labels, count = ndimage.label(mask)
    at_edge = np.zeros(count + 1, dtype=np.bool_)
    for edge in (labels[0], labels[-1], labels[:, 0], labels[:, -1]):
        at_edge[edge] = True
    at_edge[0] = False  # the label of the background
    return np.asarray(at_edge[labels])


OWN_CODES = ("ISIS3", "PDS")
"""GDAL drivers of formats whose labels or types define samples that are not brightness."""

_BARE = ("PDS", "PDS4", "VICAR")
"""GDAL drivers of formats with uncompressed samples."""
_PLACE = r"\^IMAGE\s*=\s*(\d+)\s*(<BYTES>)?"
_RECORD = r"RECORD_BYTES\s*=\s*(\d+)"

_COLOURS = (ColorInterp.red, ColorInterp.green, ColorInterp.blue)
_MOST_PIXELS = 300_000_000
_WHOLE = ("PNG", "JPEG", "GIF", "BMP", "WEBP")
"""GDAL drivers of formats that are decoded from memory: GDAL 3.10 returns other samples of an 8-bit PNG after a
failed read, without an error.
"""


@dataclass(frozen=True, eq=False)
class ImagePixels:
    """Samples (rows, cols) as stored, and mask (rows, cols) of the samples that the file declares
    valid.

    ``transform`` (a, b, c, d, e, f) takes corner coordinates of pixels, 0 at the image's upper left
    corner, to the map: x = a col + b row + c, y = d col + e row + f. ``crs_wkt`` is None for an
    image that is not map-projected. ``opened`` is the file that was read: the label, for an .IMG
    file with a detached label.
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
    """Label of an ISIS cube, as JSON from GDAL."""
    is_decoded: bool = False
    """True if the samples are luminance already, whatever the encoding was."""
    states_nodata: bool = False
    """True if the file or the caller gives a value for missing samples."""


def read_pixels(
    path: Path | str,
    band: int | None = None,
    nodata: float | None = None,
    encoding: str = ENCODINGS[0],
) -> ImagePixels:
    """A band of an image file, counted from 1; None: the luminance of a colour image, else the
    first band.

    ``nodata``: value of missing samples, in addition to the file's own. ``encoding`` applies to
    colours only, which become luminance here: codes of a display image (``srgb``) are decoded
    first. ImageError for a file that is no image, cannot be read, or does not have the band.
    """
    with _opened(Path(path)) as (opened, file), whole_reads(path):
        return _read((Path(path), opened), file, (band, nodata, encoding))


def image_shape(path: Path | str) -> tuple[int, int]:
    """Rows and columns of an image file, without reading its pixels; ImageError as `read_pixels`."""
    with _opened(Path(path)) as (_, file):
        return int(file.height), int(file.width)


@contextmanager
def _opened(path: Path) -> Iterator[tuple[Path, Any]]:
    """Path that GDAL opens for an image, and the open file."""
    opened = _pixels_of(path)
    try:
        with warnings.catch_warnings(), open_raster(opened, "an image")[0] as file:
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            with _from_memory(file) if file.driver in _WHOLE else nullcontext(file) as source:
                yield opened, source
    except DemError as error:
        raise ImageError(str(error)) from error
    except UNREADABLE as error:
        if isinstance(error, LcpError):
            raise
        raise ImageError(
            f"{path}: not an image that can be read here ({cause_of(error)})"
        ) from error


@contextmanager
def _from_memory(file: Any) -> Iterator[Any]:
    """The same image with its sidecar files, all read by Python, opened in GDAL's memory."""
    with ExitStack() as stack:
        folder = f"lcp-{uuid.uuid4().hex}"
        copies = [
            stack.enter_context(
                MemoryFile(Path(name).read_bytes(), dirname=folder, filename=Path(name).name)
            )
            for name in file.files
        ]
        yield stack.enter_context(copies[0].open(driver=file.driver))


def _pixels_of(path: Path) -> Path:
    """Path that GDAL opens: the label, for an .IMG file of PDS3 or PDS4 with a detached label."""
    if not path.is_file():
        raise ImageError(f"{path}: {no_file(path, 'an image')}")
    if path.suffix.lower() != ".img":
        return path
    try:
        return find_label(path)
    except LabelError:
        names = (path.with_suffix(".xml"), path.with_suffix(".XML"))
        of_pds4 = [name for name in names if name.is_file() and is_pds4(name)]
        return of_pds4[0] if of_pds4 else path  # other formats use .img, too


def _read(
    paths: tuple[Path, Path], file: Any, how: tuple[int | None, float | None, str]
) -> ImagePixels:
    (path, opened), (band, nodata, encoding) = paths, how
    if band is not None and not 1 <= band <= file.count:
        raise ImageError(f"{path}: has no band {band}; its bands are 1 to {file.count}")
    if file.count == 0 or file.width * file.height > _MOST_PIXELS:
        raise ImageError(
            f"{path}: {file.width} x {file.height} pixels, {file.count} bands; at most "
            f"{_MOST_PIXELS / 1e6:g} million pixels are supported: use a part of the image"
        )
    if np.dtype(file.dtypes[0]).kind not in "uif":
        raise ImageError(f"{path}: samples are {file.dtypes[0]}; supported are integers and floats")
    if not _is_whole(opened, file):
        raise ImageError(
            f"{path}: is truncated: the end of its pixels is missing; download it again"
        )
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


def _is_whole(path: Path, file: Any) -> bool:
    """True if the end of the file is present.

    Checked for the formats of which GDAL 3.10 reads truncated files without an error: for an 8-bit
    PNG it returns the compressed bytes as samples, for uncompressed samples zeros, which are shadow
    here.
    """
    if file.driver == "PNG":
        return _has_end(path)
    if file.driver not in _BARE or "compression" in file.profile:
        return True
    numbers = [name for name in file.files if not name.lower().endswith((".lbl", ".xml"))]
    size = Path(numbers[0] if numbers else file.name).stat().st_size
    samples = file.width * file.height * sum(np.dtype(dtype).itemsize for dtype in file.dtypes)
    return bool(size >= _first_byte(read_label_text(Path(file.name)) or "") + samples)


def _first_byte(label: str) -> int:
    """Byte offset of the image in its own file by a PDS3 label: ``^IMAGE = 2`` (records) or ``4097
    <BYTES>``; else 0.
    """
    place, record = (re.search(what, label) for what in (_PLACE, _RECORD))
    if place is None or not (place[2] or record):
        return 0
    return (int(place[1]) - 1) * (1 if place[2] or not record else int(record[1]))


def _has_end(path: Path) -> bool:
    """True if a PNG's chunks continue to the last one (PNG, second edition, 5.3 and 11.2.5: length,
    type, data, checksum; IEND).
    """
    with path.open("rb") as png:
        png.seek(8)
        while len(head := png.read(8)) == 8:
            length, kind = struct.unpack(">I4s", head)
            if kind == b"IEND":
                return True
            png.seek(length + 4, 1)
    return False


def _valid(file: Any, first: int, mask: int | None) -> Mask:
    """Mask of a band from the file's mask, alpha band or nodata value.

    GDAL's own mask of cubes and PDS3 images is not used: it combines samples that are too dark or
    too bright with missing ones, and takes 0 as missing where no label defines it.
    """
    if file.driver in OWN_CODES:
        return np.ones(file.shape, dtype=bool)
    return np.asarray((file.read_masks(first) if mask is None else file.read(mask)) != 0)


def _samples(file: Any, band: int | None, encoding: str) -> tuple[NDArray[Any], bool]:
    """Samples of the band, and True if they are luminance of unequal colours instead of stored
    values.
    """
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
    """Luminance of red, green and blue and True; for equal planes the stored grey values and False."""
    if all(np.array_equal(planes[0], plane) for plane in planes[1:]):
        return planes[0], False
    total = np.zeros(planes[0].shape, dtype=np.float32)
    for plane, weight in zip(planes, REC_709, strict=True):
        decoded = encoding == "srgb" and plane.dtype.kind in "ui"
        total += weight * (decode_srgb(plane / np.iinfo(plane.dtype).max) if decoded else plane)
    return total, True


def _mask_band(file: Any, first: int) -> int | None:
    """Band that is a mask although it is not declared so: the second of two, if it holds only 0 and
    the highest code.
    """
    if file.count != 2 or first != 1 or np.dtype(file.dtypes[1]).kind != "u":
        return None
    top = np.iinfo(file.dtypes[1]).max
    second = file.read(2)
    return 2 if bool(((second == 0) | (second == top)).all()) else None


def _isis_label(file: Any) -> Mapping[str, Any] | None:
    """The label of an ISIS cube; None for other files. GDAL returns JSON as a tag that rasterio
    splits at its first colon.
    """
    for key, rest in file.tags(ns="json:ISIS3").items():
        try:
            found: Mapping[str, Any] = json.loads(f"{key}:{rest}")
        except ValueError:
            log.warning("%s: its ISIS label cannot be parsed and is ignored", file.name)
            return None
        return found
    return None
