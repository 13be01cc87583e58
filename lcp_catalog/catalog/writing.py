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
from typing import cast

import h5py
import numpy as np

from ..arrays import AnyArray, Bytes
from ..atomic_files import write_aside
from ..errors import CatalogError
from ..held_signals import HeldSignals
from .catalogue import Catalog, Coverage, Guarantee, Promises
from .checks import first_few, lines, part_findings, shape_problems
from .chunk_writing import ChunkWriter, Deflate
from .coverage_map import coverage_map
from .disk_stream import DiskStream
from .layout import (
    CRS,
    GROUPS,
    TEXT,
    Values,
    digests,
    grid_mapping,
    key,
    variable_attributes,
    without_level,
)
from .map_levels import coverage_levels
from .schema import Variable

_CHUNK_BYTES = 2**18

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
    values = catalog.values()
    products = values["dem_product"]
    with new_catalog(catalog, len(catalog), products, path, overwrite) as file:
        file.add(values)
        file.finish(catalog.coverage, catalog.guarantee, catalog.promises)


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
    return h5py.File(stream, "w", driver="fileobj", libver=("earliest", "v110"), track_order=True)


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
        self._fixed, self._added = head.values(), 0
        self._fixed["point"] = np.arange(points, dtype=np.int32)
        self._of_points = [
            name
            for name, variable in GROUPS[""].items()
            if variable.dims[0] == "point" and name in self._fixed and name != "point"
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
            values, dataset = points[name], self._file[name]
            if values.dtype == object:
                values = self._as_bytes(values)
            deflate = _DEFLATE_RUNS if name in _RUNS else _DEFLATE
            self._rows.add(dataset, values.astype(dataset.dtype, copy=False), deflate)
        if self._added == self._points:
            self._rows.finish()

    def _check(self) -> None:
        """Between two calls of HDF5: raise what the disk or a signal has brought."""
        self._stream.check()
        self._signals.release()

    def _require_sound(self, points: Values) -> None:
        values = self._fixed | {name: points[name] for name in self._of_points}
        values["point"] = np.arange(len(points["point_id"]), dtype=np.int32)
        problems = shape_problems({name: array.shape for name, array in values.items()})
        problems = problems or lines(part_findings("points", values, self._head.errors))
        if problems:
            raise CatalogError(f"not a catalogue: {first_few(problems)}")

    def finish(
        self,
        coverage: Coverage,
        guarantee: Guarantee | None = None,
        promises: Promises | None = None,
    ) -> None:
        """Write the groups, the attributes and the digests of the content, which is read again.
        CatalogError if points are missing or have the same id.
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
            guarantee=guarantee,
            promises=promises,
            coverage_levels=coverage_levels(coverage) if self._head.overview_levels else None,
            coverage_map=coverage_map(coverage, self._head.overview.plane),
        )
        self._fixed = head.values()
        for group in GROUPS:
            if group and getattr(head, group) is not None:
                self._create_group(group, head.group_attributes().get(group, {}))
        attributes = head.attributes()
        more = digests(
            {name: self._stored(name) for name in self._fixed},
            attributes,
            head.group_attributes(),
            head.optional_attributes(),
        )
        self._file.attrs.update(attributes | more)
        self._file.flush()
        self._check()

    def _stored(self, name: str) -> AnyArray:
        """A variable of the file; text as strings."""
        dataset = self._file[name]
        if h5py.check_string_dtype(dataset.dtype) is None:
            return dataset
        texts = dataset[()].tolist()
        names = {text: text.decode() for text in set(texts)}  # few: the names of products
        return np.array([names[text] for text in texts], dtype=object)

    def _create_group(
        self, group: str, attributes: Mapping[str, float | str] | None = None
    ) -> None:
        """The datasets of a group, with the content of those that are not of points."""
        place = self._file.create_group(group, track_order=True) if group else self._file
        place.attrs.update(attributes or {})
        variables = {
            name: variable
            for name, variable in GROUPS[group].items()
            if key(group, name) in self._fixed
        }
        for name in sorted(variables, key=lambda name: variables[name].dims != (name,)):
            self._create_variable(place, group, name, variables[name])
            self._check()
        if mapped := grid_mapping(group, attributes or {}):
            place.create_dataset(CRS, (), "i4", track_times=False).attrs.update(mapped)

    def _create_variable(
        self, place: h5py.Group, group: str, name: str, variable: Variable
    ) -> None:
        array = self._fixed[key(group, name)]
        of_points = variable.dims[0] == "point" and name != "point"
        shape = (self._points, *array.shape[1:]) if of_points else array.shape
        text = variable.dtype == TEXT
        kind = h5py.string_dtype("utf-8", self._text_bytes) if text else array.dtype
        attributes = variable_attributes(
            group, name, variable, self._head.sigma_step_m or 1.0, self._head.overview.projection
        )
        if not self._head.has_claims:
            attributes = without_level(attributes)
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
            fillvalue=attributes.get("_FillValue"),
        )
        if not of_points:
            dataset[...] = array
        for attribute, value in attributes.items():
            dataset.attrs[attribute] = value
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
