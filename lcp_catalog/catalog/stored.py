"""A catalogue in its file: variables are read when they are used, whole or in part, and each chunk is checked
before a value of it is used.
"""

from __future__ import annotations

import dataclasses
import json
import os
import stat
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from ..arrays import AnyArray
from ..atomic_files import file_state
from ..errors import CatalogError
from ..file_kinds import other_kind
from .catalogue import Catalog
from .file_structure import global_names, group_names, has_group, variables
from .integrity import CONTENT, HDF5_ERRORS, ChunkDigests, line_of
from .layout import GROUP_ATTRIBUTES, GROUPS, LEVELS, NUMBERS, TEXT, packing
from .model import Coverage, CoverageLevels, CoverageMap, Overview, Promise, StoredArray, held
from .schema import PACKED, Variable

NOT_OPENED = "cannot be opened: "
"""How the text begins for a file of which nothing is known because the system does not open it."""

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
            if isinstance(error, OSError) and error.errno:
                text = f"{self.path}: {NOT_OPENED}{os.strerror(error.errno)}"
                raise CatalogError(text) from error
            kind = other_kind(self.path, "a catalogue")
            text = kind or f"not an HDF5 file, or cut short: {line_of(error)}"
            raise CatalogError(f"{self.path}: {text}") from error
        try:
            if file_state(os.fstat(file.id.get_vfd_handle())) != self.stamp:
                raise CatalogError("was changed since it was opened; open it again")
            yield file
        except CatalogError as error:
            raise CatalogError(
                f"{self.path}: {str(error).removeprefix(f'{self.path}: ')}"
            ) from error
        except HDF5_ERRORS as error:
            raise CatalogError(f"{self.path}: is damaged: {line_of(error)}") from error
        finally:
            with suppress(*HDF5_ERRORS):  # an error of closing says nothing about what was read
                file.close()


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


# -- the catalogue


class FileSource:
    """Reads variables of a file, unpacked as a `Catalog` has them. CatalogError for a file whose digests do not
    belong together, and for a damaged chunk.
    """

    def __init__(self, stored: StoredFile) -> None:
        self._stored, self.name = stored, stored.path
        with stored.opened() as file:
            self._digests = ChunkDigests(file)
            self.attributes, self.groups = attributes(file), group_attributes(file)
            self._shapes = {name: file[name].shape for name in variables(file)}

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


def stored_catalog(stored: StoredFile) -> Catalog:
    """The catalogue of a file whose structure is sound."""
    source = FileSource(stored)
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


def content_sha256(catalog: Catalog) -> str:
    """The digest of the content of the file from which a catalogue is read."""
    return str(held(catalog, "point_id").source.attributes[CONTENT])


_TEXTS = ("config", "history", "title", "product_version", "software_version")
_DOCUMENTS = ("sources", "scene_plan", "albedo_map", "errors")
"""Global attributes that are fields of a catalogue: texts, and JSON."""
