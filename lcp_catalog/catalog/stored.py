"""A catalogue in its file: variables are read when they are used, whole or in part."""

from __future__ import annotations

import dataclasses
import json
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from ..arrays import AnyArray, Index
from ..errors import CatalogError
from .catalogue import (
    BLOCK_BYTES,
    Catalog,
    Coverage,
    CoverageLevels,
    CoverageMap,
    Guarantee,
    Overview,
    OverviewLevels,
    Promises,
)
from .file_structure import HDF5_ERRORS, group_names, line_of, variables
from .layout import (
    CLAIM_ATTRIBUTES,
    GLOBAL_ATTRIBUTES,
    GROUP_ATTRIBUTES,
    GROUPS,
    NUMBERS,
    OPTIONAL_ATTRIBUTES,
    TEXT,
    key,
)
from .packing import packing
from .schema import ADDED_IN_1_1, OPTIONAL_GROUPS, PACKED, Variable

_DEFAULTS = {name: np.nan for name in ADDED_IN_1_1} | {"level": np.int32(0)}
"""Values of per-point variables that files of older schemas lack."""


@dataclass(frozen=True)
class StoredFile:
    """A catalogue's file as it was when it was opened; opened again for every reading."""

    path: str
    stamp: tuple[int, ...]

    @classmethod
    def of(cls, path: Path | str) -> StoredFile:
        """CatalogError for what is not a plain file."""
        try:
            facts = os.stat(path)
        except OSError as error:
            text = (
                "there is no such file" if isinstance(error, FileNotFoundError) else error.strerror
            )
            raise CatalogError(f"{path}: {text}") from error
        if not stat.S_ISREG(facts.st_mode):
            raise CatalogError(f"{path}: is not a plain file")
        return cls(str(path), _stamp(facts))

    @property
    def size(self) -> int:
        """Bytes of the file."""
        return self.stamp[2]

    @contextmanager
    def opened(self) -> Iterator[h5py.File]:
        """The open file. CatalogError if it is another than before, is not HDF5, or is damaged where
        it is read.
        """
        if StoredFile.of(self.path) != self:
            raise CatalogError(f"{self.path}: was changed since it was opened; open it again")
        try:
            file = h5py.File(self.path, "r")
        except HDF5_ERRORS as error:
            if isinstance(error, PermissionError):
                raise CatalogError(f"{self.path}: no permission to read it") from error
            text = f"{self.path}: not an HDF5 file, or cut short: {line_of(error)}"
            raise CatalogError(text) from error
        with file:
            try:
                yield file
            except CatalogError:
                raise
            except HDF5_ERRORS as error:
                raise CatalogError(f"{self.path}: is damaged: {line_of(error)}") from error


def _stamp(facts: os.stat_result) -> tuple[int, ...]:
    return facts.st_dev, facts.st_ino, facts.st_size, facts.st_mtime_ns


# -- parts of an open file


def read_part(file: h5py.File, name: str, variable: Variable, *index: Any) -> AnyArray:
    """What NumPy's basic indexing selects of a variable, as stored; the first index may be an array of
    rows.
    """
    dataset = file[name]
    scattered = bool(index) and isinstance(index[0], np.ndarray)
    array = _read_rows(dataset, *index) if scattered else np.asarray(dataset[index])
    if variable.dtype != TEXT:
        return array
    texts = [bytes(text).decode("utf-8") for text in np.atleast_1d(array)]
    return np.array(texts, dtype=object).reshape(np.shape(array))


def _read_rows(dataset: h5py.Dataset, rows: Index, *rest: Any) -> AnyArray:
    """Rows in any order; every chunk of the file is read once."""
    wanted, place = np.unique(rows, return_inverse=True)
    chunk = wanted // dataset.chunks[0]
    starts = np.flatnonzero(np.diff(chunk, prepend=-1))
    parts = []
    for own in np.split(wanted, starts[1:]) if len(wanted) else ():
        first = int(own[0])
        parts.append(dataset[(slice(first, int(own[-1]) + 1), *rest)][own - first])
    if not parts:
        return np.asarray(dataset[(slice(0, 0), *rest)])
    return np.asarray(np.concatenate(parts)[place])


def attributes(file: h5py.File) -> dict[str, Any]:
    """The global attributes of the schema that the file has."""
    some = (*OPTIONAL_ATTRIBUTES, *CLAIM_ATTRIBUTES)
    names = (*GLOBAL_ATTRIBUTES, *(name for name in some if name in file.attrs))
    found = {name: file.attrs[name] for name in names}
    return {name: float(value) if name in NUMBERS else str(value) for name, value in found.items()}


def group_attributes(file: h5py.File) -> dict[str, dict[str, float | str]]:
    """Attributes of the groups by group and name."""
    found: dict[str, dict[str, float | str]] = {}
    for group in GROUP_ATTRIBUTES:
        if group in OPTIONAL_GROUPS and group not in file:
            continue
        stored = {name: file[group].attrs[name] for name in group_names(file[group], group)}
        found[group] = {n: v if isinstance(v, str) else float(v) for n, v in stored.items()}
    return found


def content_digests(stored: StoredFile) -> tuple[str, ...]:
    """Digests that a catalogue states of its content: of that of every catalogue and, in one with
    albedo, of the albedo. CatalogError for a file that cannot be read.
    """
    with stored.opened() as file:
        found = attributes(file)
    return tuple(found[name] for name in ("content_sha256", "albedo_sha256") if name in found)


# -- the catalogue


class _Part:
    """A variable that is read whole when it is used for the first time."""

    def __init__(self, group: str = "") -> None:
        self.group = group

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    def __get__(self, found: Any, owner: type) -> Any:
        if found is None:
            return self
        value = found._source.read(key(self.group, self.name))
        found.__dict__[self.name] = value
        return value


@dataclass(frozen=True, eq=False)
class _Source:
    """Reads variables of a file, completed and unpacked as a `Catalog` has them."""

    file: StoredFile
    shapes: dict[str, tuple[int, ...]]
    sigma_step_m: float

    def read(self, name: str, *index: Any) -> AnyArray | None:
        """None for a variable that the catalogue is without."""
        if name not in self.shapes:
            if name not in _DEFAULTS:
                return None
            whole = np.full(self.shapes["point_id"], _DEFAULTS[name])
            return np.asarray(whole[index])
        group, _, short = name.rpartition("/")
        with self.file.opened() as file:
            array = read_part(file, name, GROUPS[group][short], *index)
        return packing(name, self.sigma_step_m).unpacked(array) if name in PACKED else array


class StoredCatalog(Catalog):
    """A catalogue whose variables are read from its file when they are used.

    `part` reads a part of a variable, `within` the points of a box; both leave the rest in the
    file. A variable that is used as a whole stays in memory. CatalogError where the file is damaged,
    or was changed since it was opened.
    """

    _source: _Source

    @classmethod
    def of(cls, stored: StoredFile) -> StoredCatalog:
        """The catalogue of a file whose structure is sound."""
        with stored.opened() as file:
            found, groups = attributes(file), group_attributes(file)
            shapes = {name: file[name].shape for name in variables(file)}
        held = {name.partition("/")[0] for name in shapes if "/" in name}
        source = _Source(stored, shapes, found.get("sigma_step_m", 1.0))
        texts = {name: found[name] for name in _ATTRIBUTES if name in found}
        for name in ("sources", "scene_plan", "albedo_map", "errors"):
            texts[name] = json.loads(found.get(name, "null"))
        catalog = object.__new__(cls)
        catalog.__dict__.update(
            texts,
            sigma_step_m=found.get("sigma_step_m"),
            overview=_stored(_StoredOverview, source, groups["overview"]),
            coverage=_stored(_StoredCoverage, source, groups["coverage"]),
            **{
                group: _stored(kind, source, groups.get(group, {})) if group in held else None
                for group, kind in _SOMETIMES.items()
            },
            _source=source,
        )
        return catalog

    def __len__(self) -> int:
        return self._shape("point_id")[0]

    @property
    def patch_nodes(self) -> int:
        """Nodes along a patch's side."""
        return self._shape("dem")[1]

    def _shape(self, name: str) -> tuple[int, ...]:
        """Shape of a variable; a changed copy (`dataclasses.replace`) has all of them in memory."""
        known = self.__dict__.get(name)
        return self._source.shapes[name] if known is None else np.shape(known)

    def part(self, name: str, *index: Any) -> AnyArray:
        """See `Catalog.part`."""
        group, _, short = name.rpartition("/")
        if short in (getattr(self, group) if group else self).__dict__:
            return super().part(name, *index)
        found = self._source.read(name, *index)
        if found is None:
            raise CatalogError(f"{self._source.file.path}: has no {name}")
        return found

    def at(self, name: str, rows: Index, *index: Index) -> AnyArray:
        """See `Catalog.at`. Of the file those chunks are read that hold the points, and kept is the
        box of the indices.
        """
        if name in self.__dict__ or not len(rows):
            return super().at(name, rows, *index)
        low = [int(along.min()) for along in index]
        box = [slice(k, int(along.max()) + 1) for k, along in zip(low, index, strict=True)]
        wanted, place = np.unique(rows, return_inverse=True)
        step = max(1, BLOCK_BYTES // max(1, self.row_bytes(name)))
        parts, order = [], np.argsort(place, kind="stable")
        for start in range(0, len(wanted), step):
            values = self.part(name, wanted[start : start + step], *box)
            first, last = np.searchsorted(place[order], [start, start + step])
            here = order[first:last]
            inner = (along[here] - k for k, along in zip(low, index, strict=True))
            parts.append(values[(place[here, None] - start, *inner)])
        return np.asarray(np.concatenate(parts)[np.argsort(order)])

    def row_bytes(self, name: str) -> int:
        """See `Catalog.row_bytes`."""
        if name in self.__dict__:
            return super().row_bytes(name)
        variable = GROUPS[""][name]
        size = 64 if variable.dtype == TEXT else np.dtype(variable.dtype).itemsize
        return int(np.prod(self._source.shapes[name][1:])) * size


class _StoredOverview(Overview):
    _source: _Source


class _StoredCoverage(Coverage):
    _source: _Source


class _StoredGuarantee(Guarantee):
    _source: _Source


class _StoredPromises(Promises):
    _source: _Source


class _StoredOverviewLevels(OverviewLevels):
    _source: _Source


class _StoredCoverageLevels(CoverageLevels):
    _source: _Source


class _StoredCoverageMap(CoverageMap):
    _source: _Source


_SOMETIMES = {
    "guarantee": _StoredGuarantee,
    "promises": _StoredPromises,
    "overview_levels": _StoredOverviewLevels,
    "coverage_levels": _StoredCoverageLevels,
    "coverage_map": _StoredCoverageMap,
}
"""Classes of the groups that only some catalogues have."""


def _stored(cls: type[Any], source: _Source, numbers: dict[str, float | str]) -> Any:
    found = object.__new__(cls)
    found.__dict__.update(numbers, _source=source)
    return found


def _read_when_used(cls: type[Any], group: str) -> None:
    for field in dataclasses.fields(cls):
        if field.name in GROUPS[group]:
            part = _Part(group)
            part.__set_name__(cls, field.name)
            setattr(cls, field.name, part)


_read_when_used(StoredCatalog, "")
_read_when_used(_StoredOverview, "overview")
_read_when_used(_StoredCoverage, "coverage")
for _group, _kind in _SOMETIMES.items():
    _read_when_used(_kind, _group)

_ATTRIBUTES = (
    "config",
    "sources",
    "scene_plan",
    "title",
    "product_version",
    "software_version",
    "schema_version",
    "albedo_map",
    "errors",
)
"""Global attributes that are fields of a catalogue."""
