"""The local files behind a raster, and its opening by GDAL: formats by list, no network, no pipe or device.

A virtual raster (VRT) names other files, among them other VRTs and files in archives, and GDAL opens
whatever is named. Here every file is found and judged before GDAL opens the first.
"""

from __future__ import annotations

import logging
import os
import stat
import threading
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import rasterio
from rasterio._err import CPLE_BaseError
from rasterio.errors import CRSError, NotGeoreferencedWarning, RasterioError
from rasterio.io import DatasetReader
from rasterio.windows import Window

from ..atomic_files import file_state
from ..child_process import ChildFailedError, call_apart
from ..errors import DemError, LcpError
from ..file_kinds import may_wait, other_kind
from ..remote_files import first_state, gdal_name, server_state, url_of

DRIVERS = (
    *("GTiff", "VRT", "JP2OpenJPEG", "PDS", "PDS4", "ISIS3", "ISIS2", "VICAR", "HFA", "ENVI"),
    *("EHdr", "AAIGrid", "PNG", "JPEG", "GIF", "BMP", "WEBP"),
)
"""GDAL's drivers that may open a file: of formats that name no other file, or only their own parts."""

_ALONE = ("GTiff", "VRT", "JP2OpenJPEG", "AAIGrid", "PNG", "JPEG", "GIF", "BMP", "WEBP")
"""Those that open nothing but files of the same folder, and files that were judged here (VRT). The label of any other
format can name a pipe anywhere.
"""
_OPENING_S, _ARCHIVE_BYTES_S = 1.0, 20e6
"""Processor time in which a file must be opened, and bytes of an archive that are unpacked in a second of it."""

UNREADABLE = (RasterioError, CRSError, OSError, UnicodeError, CPLE_BaseError)
"""Errors of rasterio for a file that cannot be opened or read: also for names and texts that are not UTF-8, and
GDAL's own, which rasterio hands on where it has no name for them.
"""

_ARCHIVES = ("/vsizip/", "/vsitar/", "/vsigzip/")
_NAMING = ("sourcefilename", "sourcedataset", "dempath")
"""Elements of a VRT that hold the name of a file, in small letters (GDAL ignores the case)."""
_NAMING_KEYS = ("overview_file", "x_dataset", "y_dataset")
"""Keys of metadata, also in a sidecar file, that do."""
_BESIDE = (".aux.xml", ".ovr", ".msk", ".OVR", ".MSK")
"""Endings, behind the whole name, of sidecar files that are rasters or can name one."""
_BASE = ":::BASE:::"
_HEAD_BYTES, _XML_BYTES = 1024, 100_000_000
"""Bytes that show what a file is; most that are read of a VRT."""
_BLOCK_BYTES = 268_435_456
"""Largest block, which is decoded whole, that is read: as much as GDAL keeps decoded."""


def open_raster(path: Path, kind: str) -> tuple[Any, tuple[Path, ...]]:
    """The file opened by GDAL, and every local file that is read for it, itself first: its sidecar files, the
    sources of a VRT, also of one among its sources, and the archives that sources lie in. ``kind``: what
    the file should be.

    DemError if it is no raster of a known format (`DRIVERS`); if a file that it names is missing, no
    plain file, or not on this machine; if a block of it is beyond reason.
    """
    if (url := url_of(path)) is not None:
        if first_state(url) != server_state(url):  # GDAL keeps parts of it by its URL
            raise DemError(f"{url}: has changed since this process first read it; start again")
        return opened(str(path), kind), (path,)
    name = gdal_name(path)
    todo, seen, files = [_Named(name, path)], {name}, dict[Path, None]()
    with _offline():
        for one in todo:  # which grows
            file = one.file()
            files[file] = None
            xml = None
            if not one.name.startswith("/vsi"):  # not in an archive
                xml = _xml(file)
                for new in _named(xml, file):
                    if new.name not in seen:
                        todo.append(new)
                        seen.add(new.name)
            if one is not todo[0] and one.is_raster and xml is None:
                with _opened_in_time(one.name, f"a raster (named by {one.by})", file) as dataset:
                    _add(files, _no_vrt_in_archive(one.name, dataset))
        dataset = _no_vrt_in_archive(name, _opened_in_time(name, kind, next(iter(files))))
        _add(files, dataset)
    return dataset, tuple(files)


def _no_vrt_in_archive(name: str, dataset: Any) -> Any:
    """The dataset; DemError for a virtual raster in an archive: what it names is not looked at."""
    if name.startswith("/vsi") and dataset.driver == "VRT":
        raise DemError(f"{name}: is a virtual raster in an archive; unpack it")
    return dataset


def _opened_in_time(name: str, kind: str, file: Path) -> Any:
    """`opened`, but where GDAL could wait for the writer of a pipe, it opens the file in another process before, which is
    ended if it takes too long. ``file``: the file itself, or the archive that it lies in.
    """
    folder = os.path.dirname(os.path.abspath(file))
    if not _holds_pipe(folder, os.stat(folder).st_mtime_ns):
        with suppress(DemError):
            return opened(name, kind, _ALONE)
    if failed := _failed(name, file_state(os.stat(file))):
        raise DemError(
            f"{name}: opening it {failed}; a file that it names, or one beside it, may be a pipe or a device: only "
            "plain files are read"
        )
    return opened(name, kind)


@lru_cache(maxsize=64)
def _failed(name: str, state: tuple[int, ...]) -> str:
    """How the process that opened a file ended; empty if it came to an end."""
    size = state[2] if name.startswith("/vsi") else 0
    try:
        call_apart(open_all, name, _OPENING_S + size / _ARCHIVE_BYTES_S)
    except ChildFailedError as error:
        return str(error)
    return ""


@lru_cache(maxsize=64)
def _holds_pipe(folder: str, _changed_ns: int) -> bool:
    """True if a pipe or a device, or a link to one, stands in a folder: GDAL opens files by itself whose names are
    made of that of a raster.
    """
    with os.scandir(folder) as entries:
        return any(may_wait(one) for one in entries if not one.is_file(follow_symlinks=False))


def open_all(name: str) -> None:
    """Open a file by GDAL, and what it opens later by itself, when that is asked for. Errors are left to the next try."""
    try:
        with opened(name, "a raster") as dataset:
            for number in dataset.indexes[:1]:
                dataset.overviews(number), dataset.files, dataset.tags()
                dataset.read_masks(number, window=Window(0, 0, 1, 1))
                dataset.read(number, window=Window(0, 0, 1, 1))
    except UNREADABLE:
        return


def opened(name: str, kind: str, drivers: Sequence[str] = DRIVERS) -> Any:
    """A file opened by GDAL without a look at what it names; DemError as `open_raster`. Of files on a server only
    GeoTIFFs are read, which name no other.
    """
    url = url_of(name)
    if url is not None:
        first_state(url)
        name, drivers = url, ["GTiff"]  # the URL in messages
    try:
        with warnings.catch_warnings(), _offline() if url is None else _online(url):
            warnings.simplefilter(
                "ignore", NotGeoreferencedWarning
            )  # said where the grid is needed
            dataset = DatasetReader(f"/vsicurl/{url}" if url else name, driver=list(drivers))
    except UNREADABLE as error:
        other = other_kind(name, kind, raster=True)
        why = other or f"not {kind} that can be read here ({cause_of(error)})"
        raise DemError(f"{name}: {why}") from error
    for (high, wide), dtype in zip(dataset.block_shapes, dataset.dtypes, strict=True):
        if high * wide * np.dtype(dtype).itemsize > _BLOCK_BYTES:
            raise DemError(
                f"{name}: is stored in blocks of {wide} x {high} pixels, each of which must be decoded whole; "
                "store it in tiles (gdal_translate -co TILED=YES)"
            )
    return dataset


def _offline() -> rasterio.Env:
    """An environment of GDAL, with its drivers, that asks no server."""
    return rasterio.Env.from_defaults(CPL_VSIL_CURL_ALLOWED_FILENAME="none")


def _online(url: str) -> rasterio.Env:
    """An environment of GDAL that asks for parts of one file of a server."""
    return rasterio.Env.from_defaults(
        CPL_VSIL_CURL_ALLOWED_FILENAME=f"/vsicurl/{url}",
        GDAL_DISABLE_READDIR_ON_OPEN="EMPTY_DIR",
        GDAL_HTTP_TIMEOUT="30",
        GDAL_HTTP_MAX_RETRY="3",
    )


class _Signalled(logging.Filter):
    """Keeps what GDAL signals in this thread. The messages themselves are below warnings and go nowhere."""

    here = threading.local()

    def filter(self, record: logging.LogRecord) -> bool:
        said = getattr(self.here, "said", None)
        if said is not None and str(record.msg).startswith("GDAL signalled an error"):
            said.append(record.getMessage())
        return record.levelno > logging.INFO


for _name in ("rasterio._err", "rasterio._env"):
    logging.getLogger(_name).setLevel(logging.INFO)
    logging.getLogger(_name).addFilter(_Signalled())


@contextmanager
def whole_reads(path: object) -> Iterator[None]:
    """DemError for a read that GDAL refuses, and if it signals an error during one that succeeds: GDAL 3.10 goes on with
    wrong numbers after a failed read of the places of a TIFF's strips. It does not tell damage from a failure of the system.
    """
    before = getattr(_Signalled.here, "said", None)
    said = _Signalled.here.said = list[str]()
    refused: BaseException | None = None
    try:
        yield
    except UNREADABLE as error:
        if isinstance(error, LcpError):
            raise
        refused = error
        said.insert(0, cause_of(error))
    finally:
        _Signalled.here.said = before
    if said:
        raise DemError(
            f"{path}: cannot be read; the file is damaged or truncated, if it fails again ({said[0]})"
        ) from refused


def cause_of(error: BaseException) -> str:
    """GDAL's own message, which rasterio hides behind its own."""
    return " ".join(str(error.__cause__ or error).split())


@dataclass(frozen=True)
class _Named:
    """A file by the name that GDAL opens, and the file that names it."""

    name: str
    by: Path
    is_raster: bool = True  # False for bare samples and sidecar files

    def file(self) -> Path:
        """The file itself, or the archive that it lies in. DemError if that is no plain file."""
        inner = self.name
        while inner.startswith(_ARCHIVES):
            rest = inner[inner.index("/", 1) :]  # GDAL takes /vsizip/vsitar/ as /vsizip//vsitar/
            inner = rest if rest.startswith("/vsi") else rest[1:].lstrip("{")
        whole = Path(inner if inner == self.name else inner.partition("}")[0])
        for place in (*reversed(whole.parents), whole):
            try:
                if stat.S_ISREG(os.stat(place).st_mode):
                    return place
            except (OSError, ValueError):  # ValueError: a zero byte
                continue
        raise DemError(
            f"{self.by}: names {self.name}, which is no plain file on this machine, and only such files are read; "
            "put it there, or name a copy of it"
        )


def _add(files: dict[Path, None], dataset: Any) -> None:
    """Add the files that GDAL names for an open raster, unless they are known by another name."""
    known = {os.path.realpath(file) for file in files}
    for name in dataset.files:
        file = _Named(name, Path(dataset.name)).file()
        if os.path.realpath(file) not in known:
            files[file] = None


def _xml(file: Path) -> ElementTree.Element | None:
    """The content of a VRT or of a sidecar file in XML, None of any other file. DemError if it cannot be read."""
    with file.open("rb") as stream:
        text = stream.read(_HEAD_BYTES)
        if b"<VRTDataset" not in text and b"<PAMDataset" not in text:
            return None
        text += stream.read(_XML_BYTES)
    try:
        parser = ElementTree.XMLParser(target=ElementTree.TreeBuilder(insert_comments=True))
        return ElementTree.fromstring(text, parser)
    except (ElementTree.ParseError, LookupError, ValueError) as error:
        raise DemError(f"{file}: not a virtual raster that can be read ({error})") from error


def _refuse_other_forms(one: ElementTree.Element, file: Path) -> None:
    """DemError for what GDAL takes, too, but no program writes: a name in an attribute, another folder for the names, a word
    for 0 or 1.
    """
    given = {key.lower(): value.strip().lower() for key, value in one.attrib.items()}
    other = next((key for key in given if key in _NAMING), None)
    if other is None and given.get("relativetovrt", "0") not in ("0", "1"):
        other = "relativeToVRT"
    texts = {*given.values(), *((part.text or "").strip().lower() for part in one)}
    if other is None and "root_path" in texts:
        other = "ROOT_PATH"
    if other is not None:
        raise DemError(
            f"{file}: holds {other} in a form that only GDAL resolves; write it anew (gdal_translate -of VRT)"
        )


def _named(xml: ElementTree.Element | None, file: Path) -> Iterator[_Named]:
    """The sidecar files of a file, and the files that its content names, as GDAL resolves them."""
    for ending in _BESIDE:
        if os.path.lexists(f"{file}{ending}"):
            yield _Named(f"{file}{ending}", file, is_raster=ending != _BESIDE[0])
    holder = file
    while holder.is_symlink():
        holder = holder.parent / os.readlink(holder)
    for parent in () if xml is None else xml.iter():
        _refuse_other_forms(parent, file)
        for one in parent:
            tag = str(one.tag).lower()  # of a comment it is a function
            given = {key.lower(): value.lower().strip() for key, value in one.attrib.items()}
            if (
                tag in _NAMING
                or (tag == "mdi" and given.get("key") in _NAMING_KEYS)
                or (tag == "argument" and "filename" in given.get("name", ""))
            ):
                text = "" if len(one) else (one.text or "").lstrip()  # GDAL ends it at a comment
                name = text.removeprefix(_BASE)
                if name != text or given.get("relativetovrt", "0") == "1":
                    name = os.path.join(holder.parent, name)
                yield _Named(name, file, str(parent.tag).lower() != "vrtrasterband")
