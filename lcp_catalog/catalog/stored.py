"""A catalogue in its file: variables are read when they are used, whole or in part, and each chunk is checked
before a value of it is used.
"""

from __future__ import annotations

import dataclasses
import json
import os
import stat
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from ..arrays import AnyArray, Index
from ..atomic_files import file_state
from ..errors import CatalogError
from ..file_kinds import other_kind, plain_opener
from .catalogue import Catalog
from .file_structure import global_names, group_names, has_group, variables
from .integrity import CONTENT, HDF5_ERRORS, ChunkDigests, Known, UnreadError, line_of
from .layout import GROUP_ATTRIBUTES, GROUPS, LEVELS, NUMBERS, TEXT, packing
from .model import Coverage, CoverageLevels, CoverageMap, Overview, Promise, StoredArray, held
from .schema import PACKED, Variable
from .shards import SHARDS, Shard

_CHANGED = "was changed since it was opened; open it again"

_TEXT_BYTES = 64
"""Bytes that a text is taken to need in memory."""


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
        return cls(str(path), file_state(facts))

    @classmethod
    def received(cls, facts: Sequence[Any]) -> StoredFile:
        """The same in another process, from what JSON made of `facts`."""
        return cls(facts[0], tuple(facts[1:]))

    @property
    def facts(self) -> list[str | int]:
        """What another process needs to know the file by."""
        return [self.path, *self.stamp]

    @property
    def size(self) -> int:
        """Bytes of the file."""
        return self.stamp[2]

    @contextmanager
    def opened(self) -> Iterator[h5py.File]:
        """The open file. CatalogError if it is another than before, is not HDF5, or is damaged where it is
        read. Judged is what HDF5 holds open: its name may mean another file in the next moment.
        """
        StoredFile.of(self.path)  # HDF5 would wait for the writer of a pipe
        try:
            file = h5py.File(self.path, "r")
        except HDF5_ERRORS as error:
            raise CatalogError(f"{self.path}: {self._unopened(error)}") from error
        try:
            if file_state(os.fstat(file.id.get_vfd_handle())) != self.stamp:
                raise CatalogError(_CHANGED)
            yield file
        except CatalogError as error:
            raise CatalogError(
                f"{self.path}: {str(error).removeprefix(f'{self.path}: ')}"
            ) from error
        except HDF5_ERRORS as error:
            raise CatalogError(f"{self.path}: {_damage(error)}") from error
        finally:
            with suppress(*HDF5_ERRORS):  # an error of closing says nothing about what was read
                file.close()

    def _unopened(self, error: BaseException) -> str:
        """Why HDF5 does not open the file. What it opened may be another one, and the name mean this one again."""
        try:
            line_of(error)
            with open(self.path, "rb", opener=plain_opener) as stream:
                if file_state(os.fstat(stream.fileno())) == self.stamp:
                    h5py.File(stream, "r").close()
            return _CHANGED
        except UnreadError as unread:
            return str(unread)
        except HDF5_ERRORS:
            return other_kind(self.path, "a catalogue") or "not an HDF5 file, or cut short"


def _damage(error: BaseException) -> str:
    try:
        return f"is damaged: {line_of(error)}"
    except UnreadError as unread:
        return str(unread)


# -- parts of an open file


def texts(array: AnyArray) -> AnyArray:
    """Texts from their bytes."""
    found = [bytes(text).decode("utf-8") for text in np.atleast_1d(array)]
    return np.array(found, dtype=object).reshape(np.shape(array))


def attributes(file: h5py.File) -> dict[str, Any]:
    """The global attributes of the file."""
    found = {name: file.attrs[name] for name in global_names(file)}
    return {name: float(value) if name in NUMBERS else str(value) for name, value in found.items()}


def group_attributes(file: h5py.File) -> dict[str, dict[str, float | str]]:
    """Attributes of the groups by group and name."""
    found: dict[str, dict[str, float | str]] = {}
    for group in GROUP_ATTRIBUTES:
        if has_group(file, group):
            stored = {name: file[group].attrs[name] for name in group_names(file[group], group)}
            found[group] = {n: v if isinstance(v, str) else float(v) for n, v in stored.items()}
    return found


@dataclass(frozen=True)
class FileHead:
    """What is known of a file before a value of a variable is read: the digests of its chunks, its attributes, those
    of its groups, and the shapes of its variables by their paths.
    """

    digests: ChunkDigests
    attributes: dict[str, Any]
    groups: dict[str, dict[str, float | str]]
    shapes: dict[str, tuple[int, ...]]

    @classmethod
    def of(cls, file: h5py.File, known: Known | None = None) -> FileHead:
        """CatalogError for a file whose digests do not belong together."""
        digests = ChunkDigests.of(file, known)
        shapes = {name: digests.grids[name].shape for name in variables(file)}
        return cls(digests, attributes(file), group_attributes(file), shapes)

    @property
    def facts(self) -> list[Any]:
        """The same for another process, as JSON can hold it."""
        return [self.digests.facts, self.attributes, self.groups, self.shapes]

    @classmethod
    def received(cls, facts: Sequence[Any]) -> FileHead:
        """From what JSON made of `facts`."""
        digests, attributes, groups, shapes = facts
        sizes = {path: tuple(shape) for path, shape in shapes.items()}
        return cls(ChunkDigests.received(digests), attributes, groups, sizes)


# -- the catalogue


class FileSource:
    """Reads variables of a file, unpacked as a `Catalog` has them. CatalogError for a file whose digests do not
    belong together, and for a damaged chunk. ``head``: the file's, if it is known.
    """

    def __init__(self, stored: StoredFile, head: FileHead | None = None) -> None:
        self._stored, self.name = stored, stored.path
        if head is None:
            with stored.opened() as file:
                head = FileHead.of(file)
        self.head, self._digests = head, head.digests
        self.attributes, self.groups = head.attributes, head.groups
        self._shapes = dict(head.shapes)

    def read(self, path: str, index: tuple[Any, ...], *, keep: bool = False) -> AnyArray:
        """See `model.Source`."""
        group, _, short = path.rpartition("/")
        with self._stored.opened() as file:
            array = self._digests.part(file, path, index, keep=keep)
        if path in PACKED:
            return packing(path, self.attributes["sigma_step_m"]).unpacked(array)
        return texts(array) if GROUPS[group][short].dtype == TEXT else array

    def part(self, kind: type[Any], group: str) -> Any:
        """The part of the model in a group; None for a group that the file is without. The schema's names
        of variables and attributes are the fields.
        """
        arrays = self.arrays(kind, group)
        return kind(**arrays, **self.groups.get(group, {})) if arrays else None

    def arrays(self, kind: type[Any], group: str) -> dict[str, Any]:
        """The variables of a part of the model, by the names of its fields."""
        own = {field.name for field in dataclasses.fields(kind)}
        found: dict[str, Any] = {}
        for path, shape in self._shapes.items():
            above, _, short = path.rpartition("/")
            if above == group and short in own:
                size = _item_bytes(GROUPS[group][short])
                row = size * int(np.prod(shape[1:], dtype=np.int64))
                found[short] = StoredArray(self, path, shape, row)
        return found


def _item_bytes(variable: Variable) -> int:
    return _TEXT_BYTES if variable.dtype == TEXT else np.dtype(variable.dtype).itemsize


Opener = Callable[[Path], Catalog]
"""How the file of a shard is opened and judged: CatalogError for a bad one."""


class ShardedSource(FileSource):
    """An index (`catalog.shards`): the points of some of its shards, each opened when a value of it is needed, in the
    order of their ids; all else from the index itself. CatalogError for a shard that cannot be opened, or is not
    the one that the index was made of.
    """

    def __init__(
        self,
        stored: StoredFile,
        opener: Opener,
        head: FileHead | None = None,
        which: AnyArray | None = None,
    ) -> None:
        super().__init__(stored, head)
        self._opener, self._open = opener, dict[int, Catalog]()
        every = [Shard.read(one) for one in json.loads(self.attributes[SHARDS])]
        self.every, some = every, np.ones(len(every), bool) if which is None else which
        self.shards = [one for one, own in zip(every, some, strict=True) if own]
        count = sum(one.points for one in self.shards)
        for name, shape in self._shapes.items():
            if name in GROUPS[""] and GROUPS[""][name].dims[0] == "point":
                self._shapes[name] = (count, *shape[1:])

    def some(self, which: AnyArray) -> ShardedSource:
        """The same of some of the shards (k,), as if the index had no others."""
        return ShardedSource(self._stored, self._opener, self.head, which)

    def path_of(self, shard: Shard) -> Path:
        """The file of a shard."""
        return Path(self.name).parent / shard.path

    def opened(self, number: int) -> Catalog:
        """The catalogue of a shard."""
        if number not in self._open:
            shard = self.shards[number]
            path = self.path_of(shard)
            try:
                found = self._opener(path)
            except CatalogError as error:
                raise CatalogError(f"{self.name}: its shard {error}") from error
            if content_sha256(found) != shard.content_sha256:
                raise CatalogError(f"{self.name}: its shard {path}: {CHANGED}")
            self._open[number] = found
        return self._open[number]

    @cached_property
    def _order(self) -> tuple[Index, Index]:
        """Number of the shard, and row in it, of each point."""
        parts = []
        for number, shard in enumerate(self.shards):
            ids = self.opened(number).part("point_id")
            rows = shard.rows(len(ids))
            parts.append(np.stack([ids[rows], np.full(len(rows), number), rows]))
        every = np.concatenate([np.zeros((3, 0), np.int64), *parts], axis=1)
        _, number, row = every[:, np.argsort(every[0])]
        return number, row

    def read(self, path: str, index: tuple[Any, ...], *, keep: bool = False) -> AnyArray:
        """See `model.Source`."""
        if path not in GROUPS[""] or GROUPS[""][path].dims[0] != "point":
            return super().read(path, index, keep=keep)
        first, *rest = index or (slice(None),)
        places = np.arange(self._shapes[path][0])[first]
        none = super().read(path, (slice(0, 0), *rest))
        found = np.empty((places.size, *none.shape[1:]), none.dtype)
        number, row = (of[places.reshape(-1)] for of in self._order)
        for shard in np.unique(number).tolist():
            own = np.flatnonzero(number == shard)
            found[own] = self._part(shard, path, row[own], rest, keep)
        return found.reshape((*places.shape, *none.shape[1:]))

    def _part(self, number: int, path: str, rows: Index, rest: list[Any], keep: bool) -> Any:
        """Values of a shard's rows, as they are in a merged file."""
        catalog, step_m = self.opened(number), self.attributes["sigma_step_m"]
        if path not in catalog.point_variables:  # albedo: the shard has no map
            return np.nan
        value = held(catalog, path)
        found = value.source.read(path, (rows, *rest), keep=keep)
        if path == "level":
            return np.array(self.shards[number].levels)[found]
        if path in PACKED and catalog.sigma_step_m != step_m:
            pack = packing(path, step_m)
            return pack.unpacked(pack.packed(found))
        return found


CHANGED = "is another catalogue than when the index was made; make the index again with lcp merge"
"""What is said of a shard with another digest."""


def sharded(catalog: Catalog) -> ShardedSource | None:
    """Where the points of an index are read; None for any other catalogue."""
    sources = (value.source for value in vars(catalog).values() if isinstance(value, StoredArray))
    return next((one for one in sources if isinstance(one, ShardedSource)), None)


def narrowed(catalog: Catalog, near: Callable[[Shard], bool]) -> Catalog:
    """The catalogue of an index with those shards alone that are ``near``; any other as it is."""
    source = sharded(catalog)
    if source is None:
        return catalog
    some = source.some(np.array([near(one) for one in source.every], bool))
    return dataclasses.replace(catalog, **some.arrays(Catalog, ""))


def stored_catalog(
    stored: StoredFile, opener: Opener | None = None, head: FileHead | None = None
) -> Catalog:
    """The catalogue of a file whose structure is sound, and whose ``head`` is read if it is not given; of an index, the
    shards are opened by the ``opener``.
    """
    source = FileSource(stored, head)
    if SHARDS in source.attributes:
        source = ShardedSource(stored, opener or unchecked, source.head)
    stated = {name: source.attributes[name] for name in _TEXTS}
    levels = (source.part(Overview, group) for group in LEVELS)
    return Catalog(
        **source.arrays(Catalog, ""),  # the schema's names are the fields
        **stated,
        **{name: json.loads(source.attributes.get(name, "null")) for name in _DOCUMENTS},
        sigma_step_m=source.attributes["sigma_step_m"],
        overview=source.part(Overview, "overview"),
        overview_levels=tuple(level for level in levels if level is not None),
        coverage=source.part(Coverage, "coverage"),
        coverage_levels=source.part(CoverageLevels, "coverage_levels"),
        coverage_map=source.part(CoverageMap, "coverage_map"),
        promise=source.part(Promise, "promise"),
    )


def unchecked(path: Path | str) -> Catalog:
    """`stored_catalog` of a file, which is not judged."""
    return stored_catalog(StoredFile.of(path))


def content_sha256(catalog: Catalog) -> str:
    """The digest of the content of the file from which a catalogue is read."""
    return str(held(catalog, "point_id").source.attributes[CONTENT])


_TEXTS = ("config", "history", "title", "product_version", "software_version")
_DOCUMENTS = ("sources", "scene_plan", "albedo_map", "errors")
"""Global attributes that are fields of a catalogue: texts, and JSON."""
