"""Writing of catalogue files: HDF5 that is also netCDF-4. Points are written in parts, so that no more
than a part of them is in memory.

A file on disk that HDF5 writes without seeing an error: it leaves a file that it cannot write open,
and crashes on it when the interpreter exits.

Rows of datasets that are compressed by threads: HDF5 itself runs its filters in one thread at a time.

Signals that wait: handlers in Python must not raise inside HDF5, which then crashes.
"""

from __future__ import annotations

import dataclasses
import errno
import io
import itertools
import os
import signal
import threading
import zlib
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import h5py
import numpy as np

from ..arrays import AnyArray, Bytes
from ..atomic_files import write_aside
from ..errors import CatalogError
from ..threads import thread_count
from .catalogue import Catalog, attributes, group_attributes, values
from .checks import first_few, lines, part_findings, shape_problems
from .integrity import (
    CONTENT,
    DIGEST_BYTES,
    DIGESTS,
    INTEGRITY,
    TABLE,
    chunk_digest,
    chunk_grids,
    content_digest,
    digest_table,
)
from .layout import CRS, GROUPS, TEXT, Values, grid_mapping, key, variable_attributes
from .maps import coverage_levels, coverage_map
from .model import Coverage, Promise
from .schema import Variable

_SIGNALS = ("SIGINT", "SIGTERM", "SIGHUP")


class HeldSignals:
    """A context in which SIGINT, SIGTERM and SIGHUP wait for `release` or its end; only in the main
    thread, which alone gets them.
    """

    def __init__(self) -> None:
        self._handlers: dict[int, Callable[[int, Any], Any]] = {}
        self._held: list[int] = []

    def __enter__(self) -> HeldSignals:
        self._hold_all()
        return self

    def _hold_all(self) -> None:
        if threading.current_thread() is threading.main_thread():
            for name in _SIGNALS:
                number = getattr(signal, name, None)  # Windows has no SIGHUP
                handler = None if number is None else signal.getsignal(number)
                if number is not None and callable(handler):
                    self._handlers[number] = handler
                    signal.signal(number, self._hold)

    def __exit__(self, *_: object) -> None:
        self._hold_none()

    @contextmanager
    def let_through(self) -> Iterator[None]:
        """A context within this one in which signals are handled at once: for long work without HDF5."""
        self._hold_none()
        try:
            yield
        finally:
            self._hold_all()

    def _hold_none(self) -> None:
        for number, handler in self._handlers.items():
            signal.signal(number, handler)
        self.release()

    def release(self) -> None:
        """Handle the signals that have come."""
        while self._held:
            number = self._held.pop(0)
            self._handlers[number](number, None)

    def _hold(self, number: int, _frame: Any) -> None:
        self._held.append(number)


_WAITING_BYTES = 2**25
"""Most bytes of chunks that are compressed, or wait for it, at a time."""


@dataclass(frozen=True)
class Deflate:
    """How zlib compresses."""

    level: int
    strategy: int = zlib.Z_DEFAULT_STRATEGY


_Chunk = tuple[h5py.Dataset, tuple[int, ...], int, "Future[tuple[bytes, bytes]]"]


class ChunkWriter:
    """Writes rows of chunked datasets that have the filters shuffle, deflate and Fletcher32, in this
    order, as HDF5 would. The order of what is written does not depend
    on the number of threads.

    ``check``: called after each chunk that was written. ``digests``: of the chunks that were written
    (`integrity.chunk_digest`), by the dataset's path and the chunk's offset.
    """

    def __init__(self, check: Callable[[], None]) -> None:
        self._check = check
        self.digests: dict[str, dict[tuple[int, ...], bytes]] = {}
        self._pool = ThreadPoolExecutor(thread_count(), "compression")
        self._chunks: deque[_Chunk] = deque()
        self._waiting = 0  # bytes of their content
        self._started: dict[str, tuple[int, AnyArray]] = {}  # first row, rows of a chunk

    def add(self, dataset: h5py.Dataset, rows: AnyArray, deflate: Deflate) -> None:
        """The next rows of a dataset, from its first one on, in its type. Each chunk is written when
        all of its rows are there, or all of the dataset's.
        """
        name = str(dataset.name)[1:]
        self.digests.setdefault(name, {})
        first, before = self._started.pop(name, (0, rows[:0]))
        if len(before):
            rows = np.concatenate([before, rows])
        height, end = dataset.chunks[0], first + len(rows)
        while first < end and (first + height <= end or end == len(dataset)):
            for offset, chunk in _chunk_offsets(dataset, first, rows[:height]):
                self._compress(dataset, offset, chunk, deflate)
            rows, first = rows[height:], min(first + height, end)
        if first < len(dataset):
            self._started[name] = first, rows.copy()

    def _compress(
        self, dataset: h5py.Dataset, offset: tuple[int, ...], chunk: AnyArray, deflate: Deflate
    ) -> None:
        while self._waiting > _WAITING_BYTES:
            self._write()
        work = self._pool.submit(_with_digest, chunk, dataset.chunks, deflate)
        self._chunks.append((dataset, offset, chunk.nbytes, work))
        self._waiting += chunk.nbytes
        while self._chunks and self._chunks[0][3].done():
            self._write()

    def _write(self) -> None:
        dataset, offset, size, work = self._chunks.popleft()
        self._waiting -= size
        stored, digest = work.result()
        dataset.id.write_direct_chunk(offset, stored)
        self.digests[str(dataset.name)[1:]][offset] = digest
        self._check()

    def finish(self) -> None:
        """Write what is left. All rows of the datasets must have been added."""
        while self._chunks:
            self._write()

    def close(self) -> None:
        """End the threads; what is not written is lost."""
        self._pool.shutdown(cancel_futures=True)


def _chunk_offsets(
    dataset: h5py.Dataset, first: int, rows: AnyArray
) -> Iterator[tuple[tuple[int, ...], AnyArray]]:
    """The chunks of a row of chunks, from their content in ``rows``: offset and content."""
    sides = dataset.chunks[1:]
    starts = [range(0, length, side) for length, side in zip(rows.shape[1:], sides, strict=True)]
    for start in itertools.product(*starts):
        part = tuple(slice(k, k + side) for k, side in zip(start, sides, strict=True))
        yield (first, *start), rows[(slice(None), *part)]


def _with_digest(chunk: AnyArray, shape: tuple[int, ...], deflate: Deflate) -> tuple[bytes, bytes]:
    """The stored bytes of a chunk, and their digest."""
    stored = compressed(chunk, shape, deflate)
    return stored, chunk_digest(stored)


def compressed(chunk: AnyArray, shape: tuple[int, ...], deflate: Deflate) -> bytes:
    """The stored bytes of a chunk of this shape: shuffled, compressed (RFC 1950), with the checksum.
    What ``chunk`` lacks at the edge of its dataset is 0.
    """
    if chunk.shape != shape:
        whole = np.zeros(shape, chunk.dtype)
        whole[tuple(slice(length) for length in chunk.shape)] = chunk
        chunk = whole
    content = np.ascontiguousarray(chunk).reshape(-1).view(np.uint8)
    shuffled = np.ascontiguousarray(content.reshape(-1, chunk.dtype.itemsize).T)
    stream = zlib.compressobj(deflate.level, strategy=deflate.strategy)
    data = stream.compress(shuffled.data) + stream.flush()
    return data + fletcher32(data).to_bytes(4, "little")


def fletcher32(data: bytes) -> int:
    """Fletcher's checksum as HDF5 has it (`H5_checksum_fletcher32`): of big-endian words of 16 bits,
    modulo 65535, where a sum that is not zero by its words is 65535 instead of 0.
    """
    if len(data) % 2:
        data += b"\0"
    words = np.frombuffer(data, ">u2").astype(np.int64)
    if not words.any():
        return 0
    first = int(words.sum()) % 65535 or 65535
    second = int(words @ np.arange(len(words), 0, -1)) % 65535 or 65535
    return second << 16 | first


class DiskStream(io.RawIOBase):
    """An existing file, read and written. The first error of the system is kept for `check`; from then
    on what is written is kept in memory. HDF5 then closes its file in order, and the writer, which
    checks after every part, gives it little more to write.
    """

    def __init__(self, path: Path) -> None:
        self._file = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        self._place = self._end = 0
        self._error: OSError | None = None
        self._unwritten: list[tuple[int, bytes]] = []  # in the order of writing: the last counts

    def check(self) -> None:
        """Raise the error that was met, if any."""
        if self._error is not None:
            raise self._error

    def sync(self) -> None:
        """Have everything on the disk, or raise what prevents it."""
        self._try(lambda: os.fsync(self._file))
        self.check()

    def tell(self) -> int:
        return self._place

    def seek(self, offset: int, whence: int = os.SEEK_SET, /) -> int:
        start = {os.SEEK_SET: 0, os.SEEK_CUR: self._place, os.SEEK_END: self._end}[whence]
        self._place = start + offset
        return self._place

    def truncate(self, size: int | None = None, /) -> int:
        self._end = self._place if size is None else size
        self._try(lambda: os.ftruncate(self._file, self._end))
        return self._end

    def write(self, data: Any, /) -> int:
        part, start = memoryview(data).cast("B"), self._place
        self._place += part.nbytes
        self._end = max(self._end, self._place)
        self._try(lambda: _write_all(self._file, part, start))
        if self._error is not None:
            self._unwritten.append((start, bytes(part)))
        return part.nbytes

    def readinto(self, buffer: Any, /) -> int:
        whole, start = memoryview(buffer).cast("B"), self._place
        whole[:] = bytes(whole.nbytes)
        self._place += whole.nbytes
        try:  # also after an error: HDF5 may loop on records that it does not find again
            _read_all(self._file, whole, start)
        except OSError as error:
            self._error = self._error or error
        for place, data in self._unwritten:
            first, last = max(place, start), min(place + len(data), start + whole.nbytes)
            if first < last:
                whole[first - start : last - start] = data[first - place : last - place]
        return whole.nbytes

    def close(self) -> None:
        if not self.closed:
            super().close()
            os.close(self._file)

    def _try(self, action: Callable[[], None]) -> None:
        if self._error is None:
            try:
                action()
            except OSError as error:
                self._error = error


def _write_all(file: int, part: memoryview, start: int) -> None:
    done = 0
    while done < part.nbytes:
        some = os.pwrite(file, part[done:], start + done)
        if not some:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        done += some


def _read_all(file: int, whole: memoryview, start: int) -> None:
    """Fill the buffer; behind the end of the file it stays as it is."""
    done = 0
    while some := os.preadv(file, [whole[done:]], start + done):
        done += some


_CHUNK_BYTES = 2**18

_NO_VARIABLE = "This is a netCDF dimension but not a netCDF variable."
"""Name by which netCDF-4 tells a dimension from a coordinate."""

_DEFLATE = Deflate(2)
"""Level 2: 2 % more bytes than level 4 on the sample, a quarter less time."""

_DEFLATE_RUNS = Deflate(1, zlib.Z_RLE)
"""Compression that looks for runs of equal bytes only, in half the time."""

_RUNS = ("dem", "latitude", "longitude", "position_mcmf", "rotation_mcmf_to_enu")
"""Variables that `_DEFLATE_RUNS` suits, because their bytes seldom repeat: heights become 1 to 3 %
smaller, coordinates 2 to 11 % larger (measured on the sample and on `benchmarks/speed/merge.py`)."""


def write_catalog(catalog: Catalog, path: Path | str, overwrite: bool = False) -> None:
    """Write the file; it appears under its name only when it is complete. Equal catalogues give
    equal bytes.

    Raises OutputExistsError and OutputError as `atomic_files.check_output` does.
    """
    content = values(catalog)
    products = content["dem_product"]
    with new_catalog(catalog, len(catalog), products, path, overwrite) as file:
        file.add(content)
        file.finish(catalog.coverage, catalog.promise)


@contextmanager
def new_catalog(
    head: Catalog, points: int, products: Iterable[str], path: Path | str, overwrite: bool = False
) -> Iterator[NewCatalog]:
    """A file for a catalogue of so many ``points``, which are added in parts. It appears under its
    name when the block ends without an error, complete and synced.

    ``head``: everything but the points and the coverage; its own are not written. ``products``: the
    names that ``dem_product`` may have. Raises OutputExistsError and OutputError as
    `atomic_files.write_aside` does.
    """
    with (
        write_aside(path, overwrite) as aside,
        HeldSignals() as signals,
        DiskStream(aside) as stream,
    ):
        try:
            with (
                _create(stream) as file,
                NewCatalog(head, points, products, file, stream, signals) as catalog,
            ):
                yield catalog
        finally:
            stream.check()  # the cause of whatever HDF5 says
        stream.sync()


def _create(stream: io.RawIOBase) -> h5py.File:
    """A new file of the format of HDF5 1.10, whose records have checksums. Its root group holds no time."""
    access = h5py.h5p.create(h5py.h5p.FILE_ACCESS)
    access.set_libver_bounds(h5py.h5f.LIBVER_V110, h5py.h5f.LIBVER_V110)
    access.set_fileobj_driver(h5py.h5fd.fileobj_driver, stream)
    made = h5py.h5p.create(h5py.h5p.FILE_CREATE)
    _in_order_without_times(made)
    return h5py.File(h5py.h5f.create(b"catalogue", h5py.h5f.ACC_TRUNC, fapl=access, fcpl=made))


def _in_order_without_times(made: Any) -> None:
    """Properties of a group that is to list its members in the order of their making, without times."""
    order = h5py.h5p.CRT_ORDER_TRACKED | h5py.h5p.CRT_ORDER_INDEXED
    made.set_link_creation_order(order)
    made.set_attr_creation_order(order)
    made.set_obj_track_times(False)


class _Flags:
    """`Catalog.condition` in a file: each slice is read from it."""

    def __init__(self, dataset: h5py.Dataset) -> None:
        self._dataset, self.shape = dataset, dataset.shape

    def __len__(self) -> int:
        return int(self.shape[0])

    def __getitem__(self, rows: slice) -> Bytes:
        with HeldSignals():
            return np.asarray(self._dataset[rows])


class NewCatalog:
    """A catalogue file that is being written (`new_catalog`), a context: `add` its points in order, then
    `finish` it.
    """

    def __init__(
        self,
        head: Catalog,
        points: int,
        products: Iterable[str],
        file: h5py.File,
        stream: DiskStream,
        signals: HeldSignals,
    ) -> None:
        self._head, self._points, self._file, self._stream = head, points, file, stream
        self._signals = signals
        self._text_bytes = max((len(name.encode()) for name in products), default=1) or 1
        self._fixed, self._added = values(head), 0
        self._fixed["point"] = np.arange(points, dtype=np.int32)
        self._of_points = [
            name
            for name, variable in GROUPS[""].items()
            if name in self._fixed and _is_of_points(name, variable)
        ]
        self._rows = ChunkWriter(self._check)
        self._create_group("")

    def __enter__(self) -> NewCatalog:
        return self

    def __exit__(self, *_: object) -> None:
        self._rows.close()

    @contextmanager
    def flags(self) -> Iterator[AnyArray]:
        """The flags of all points that were added, for long work on them: it can be interrupted, but for
        the reading.
        """
        flags = _Flags(self._file["condition"])
        with self._signals.let_through():
            yield cast(AnyArray, flags)  # an array for whoever reads slices

    def add(self, points: Values) -> None:
        """Write the next points: their variables by name, in the types of the file. CatalogError for
        values that are out of range or do not fit together.
        """
        self._added += len(points["point_id"])
        self._require_sound(points)
        for name in self._of_points:
            array, dataset = points[name], self._file[name]
            if array.dtype == object:
                array = self._as_bytes(array)
            deflate = _DEFLATE_RUNS if name in _RUNS else _DEFLATE
            self._rows.add(dataset, array.astype(dataset.dtype, copy=False), deflate)
        if self._added == self._points:
            self._rows.finish()

    def _check(self) -> None:
        """Between two calls of HDF5: raise what the disk or a signal has brought."""
        self._stream.check()
        self._signals.release()

    def _require_sound(self, points: Values) -> None:
        some = self._fixed | {name: points[name] for name in self._of_points}
        some["point"] = np.arange(len(points["point_id"]), dtype=np.int32)
        problems = shape_problems({name: array.shape for name, array in some.items()})
        problems = problems or lines(part_findings("points", some, self._head.errors))
        if problems:
            raise CatalogError(f"not a catalogue: {first_few(problems)}")

    def finish(self, coverage: Coverage, promise: Promise | None = None) -> None:
        """Write the groups, the attributes and the digests. CatalogError if points are missing or have the same
        id.
        """
        if self._added != self._points:
            raise CatalogError(f"{self._added} points were added instead of {self._points}")
        if not (
            np.diff(np.sort(self._file["point_id"][()])) > 0
        ).all():  # np.unique: 10 times as long
            raise CatalogError("not a catalogue: point_id: numbers occur more than once")
        head = dataclasses.replace(
            self._head,
            coverage=coverage,
            promise=promise,
            coverage_levels=coverage_levels(coverage) if self._head.overview_levels else None,
            coverage_map=coverage_map(coverage, self._head.overview.plane),
        )
        self._fixed, stated = values(head), group_attributes(head)
        for group in head.groups():
            if group:
                self._create_group(group, stated.get(group, {}))
        self._file.attrs.update(attributes(head))
        self._write_digests()
        self._file.flush()
        self._check()

    def _write_digests(self) -> None:
        """The table of the chunks' digests, and the digest of the content."""
        written = self._rows.digests
        layouts = {path: (self._file[path].shape, self._file[path].chunks) for path in written}
        table = digest_table(written, chunk_grids(layouts))
        place = self._group(INTEGRITY)
        for name, length in (("chunk", len(table)), ("byte", DIGEST_BYTES)):
            bare = place.create_dataset(name, (length,), ">f4", track_times=False)
            bare.make_scale(f"{_NO_VARIABLE}{length:10d}")
        shape = (max(1, min(len(table), _CHUNK_BYTES // DIGEST_BYTES)), DIGEST_BYTES)
        dataset = place.create_dataset(
            TABLE, data=table, chunks=shape, fletcher32=True, track_times=False
        )
        dataset.attrs.update(variable_attributes(INTEGRITY, TABLE, DIGESTS))
        for axis, name in enumerate(DIGESTS.dims):
            dataset.dims[axis].attach_scale(place[name])
        self._file.attrs[CONTENT] = content_digest(self._file, table)

    def _group(self, name: str) -> h5py.Group:
        """A new group."""
        made = h5py.h5p.create(h5py.h5p.GROUP_CREATE)
        _in_order_without_times(made)
        return h5py.Group(h5py.h5g.create(self._file.id, name.encode(), gcpl=made))

    def _create_group(self, group: str, stated: Mapping[str, float | str] | None = None) -> None:
        """The datasets of a group, with the content of those that are not of points."""
        place = self._group(group) if group else self._file
        place.attrs.update(stated or {})
        variables = {
            name: variable
            for name, variable in GROUPS[group].items()
            if key(group, name) in self._fixed
        }
        for name in sorted(variables, key=lambda name: variables[name].dims != (name,)):
            self._create_variable(place, group, name, variables[name])
            self._check()
        if mapped := grid_mapping(group, stated or {}):
            place.create_dataset(CRS, (), "i4", track_times=False).attrs.update(mapped)
        for name, variable in variables.items():
            if not _is_of_points(name, variable):
                path = key(group, name)
                self._rows.add(self._file[path], self._fixed[path], _DEFLATE)
        self._rows.finish()  # so that the order in the file does not depend on threads

    def _create_variable(
        self, place: h5py.Group, group: str, name: str, variable: Variable
    ) -> None:
        array = self._fixed[key(group, name)]
        shape = (self._points, *array.shape[1:]) if _is_of_points(name, variable) else array.shape
        text = variable.dtype == TEXT
        kind = h5py.string_dtype("utf-8", self._text_bytes) if text else array.dtype
        stated = variable_attributes(
            group, name, variable, self._head.sigma_step_m or 1.0, self._head.overview.projection
        )
        dataset = place.create_dataset(
            name,
            shape,
            kind,
            chunks=_chunks(shape, np.dtype(kind).itemsize),
            maxshape=tuple(
                length or None for length in shape
            ),  # HDF5 has no chunk for a fixed length of 0
            compression="gzip",
            compression_opts=_DEFLATE.level,
            shuffle=True,
            fletcher32=True,
            track_times=False,
            fillvalue=stated.get("_FillValue"),
        )
        dataset.attrs.update(stated)
        if variable.dims == (name,):
            dataset.make_scale(name)
            return
        for axis, dim in enumerate(variable.dims):
            dataset.dims[axis].attach_scale(place[dim] if dim in place else place.file[dim])

    def _as_bytes(self, texts: AnyArray) -> AnyArray:
        """Text of fixed length in bytes, which, unlike text of variable length, can be compressed and
        checksummed.
        """
        kind = h5py.string_dtype("utf-8", self._text_bytes)
        codes = {text: text.encode() for text in set(texts.tolist())}
        return np.array([codes[text] for text in texts.tolist()], dtype=kind)


def _is_of_points(name: str, variable: Variable) -> bool:
    """True for a variable that is written with the points."""
    return variable.dims[0] == "point" and name != "point"


def _chunks(full: tuple[int, ...], item_bytes: int) -> tuple[int, ...]:
    """Whole rows of the first axis, as many as fit into a chunk; long rows are halved along their
    longest axis.
    """
    shape = [max(1, length) for length in full]
    shape[0] = max(1, min(shape[0], _CHUNK_BYTES // (item_bytes * max(1, int(np.prod(shape[1:]))))))
    while int(np.prod(shape)) * item_bytes > 4 * _CHUNK_BYTES:
        longest = shape.index(max(shape))
        shape[longest] = -(-shape[longest] // 2)
    return tuple(shape)
