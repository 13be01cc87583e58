"""Writing of catalogue files: HDF5 that is also netCDF-4. Points are written in parts, so that no more
than a part of them is in memory.
"""

from __future__ import annotations

import dataclasses
import io
import zlib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, cast

import h5py
import numpy as np

from ..arrays import AnyArray, Bytes
from ..atomic_files import write_aside
from ..errors import CatalogError
from .catalogue import Catalog, attributes, group_attributes, values
from .checks import first_few, lines, part_findings, shape_problems
from .chunk_writing import ChunkWriter, Deflate
from .disk_stream import DiskStream
from .held_signals import HeldSignals
from .integrity import (
    CONTENT,
    DIGEST_BYTES,
    DIGESTS,
    INTEGRITY,
    TABLE,
    chunk_grids,
    content_digest,
    digest_table,
)
from .layout import CRS, GROUPS, TEXT, Values, grid_mapping, key, variable_attributes
from .maps import coverage_levels, coverage_map
from .model import Coverage, Promise
from .schema import Variable

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
