"""Whether a catalogue's file is sound: judged in a process of its own, block by block, before this
process reads it.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from ..arrays import AnyArray
from ..child_process import ChildFailedError, call_apart
from ..errors import CatalogError, not_a
from .catalogue import Catalog
from .checks import Finding, first_few, lines, part_findings, text_problems
from .file_structure import structure_problems, variables
from .integrity import HDF5_ERRORS, Known, line_of
from .layout import LEVELS, TEXT
from .model import BLOCK_BYTES
from .schema import Variable
from .stored import (
    FileHead,
    StoredFile,
    attributes,
    group_attributes,
    sharded,
    stored_catalog,
    texts,
)

_SECONDS = 10.0
_SECONDS_PER_MB = 1.0
"""Processor time that the check of a file may take, 10 times and more of what it takes."""

_WHOLE_BYTES = 2**24
"""Content that is checked in any case: it takes less time than the process of the check."""

_DIMS = {"points": "point", "cells": "cell", "overview": "y"}
"""Dimension along which a part of the content is cut into blocks."""


def open_catalog(path: Path | str, check: bool = True) -> Catalog:
    """Open a catalogue.

    Variables are read when they are used: `Catalog.part` and `Catalog.within` leave the rest in the
    file. Before, another process with limits of time and memory checks the structure of the file, its digests
    and all its values.

    Parameters
    ----------
    path:
        The file.
    check:
        False: check the structure alone of a large catalogue, for a window of it. In any case the digest of a
        chunk is checked before a value of it is used.

    Raises
    ------
    CatalogError
        One line, for a file that is no catalogue or is damaged; `inspect` lists all its problems.
    KindError
        For what is no path.

    Examples
    --------
    >>> opened = lcp.open_catalog(catalog)
    >>> opened.longitude.shape == (len(opened),)
    True
    """
    if not isinstance(path, Path | str):
        raise not_a(path, "path", "the path of a catalogue")
    stored = StoredFile.of(path)
    problems, head = apart(stored, _whole_judgement if check else _structure_judgement)
    if problems:
        raise CatalogError(f"{path}: {first_few(problems)}")
    return judged(stored, head, check)


def judged(stored: StoredFile, head: Any, check: bool = True) -> Catalog:
    """The catalogue of a file that was judged, with the facts of its ``head`` (None: it is read again); the shards of
    an index are judged when they are opened.
    """
    found = head and FileHead.received(head)
    return stored_catalog(stored, partial(open_catalog, check=check), found)


def shard_problems(catalog: Catalog) -> list[str]:
    """A line for each shard of an index, which is `judged`, that cannot be opened."""
    source, found = sharded(catalog), list[str]()
    if source is None:
        return found
    for number in range(len(source.shards)):
        try:
            source.opened(number)
        except CatalogError as error:
            found.append(str(error).removeprefix(f"{source.name}: "))
    return found


def apart(stored: StoredFile, check: Any) -> Any:
    """The result of a check in another process; CatalogError if the check does not survive the file."""
    seconds = _SECONDS + _SECONDS_PER_MB * stored.size / 1e6
    try:
        return call_apart(check, stored.facts, seconds)
    except ChildFailedError as error:
        raise CatalogError(f"{stored.path}: damaged: reading it {error}") from error


# -- in the other process


def _structure_judgement(facts: Sequence[Any]) -> Any:
    return _with_facts(*judge(StoredFile.received(facts), content=False))


def _whole_judgement(facts: Sequence[Any]) -> Any:
    return _with_facts(*judge(StoredFile.received(facts)))


def _with_facts(problems: list[str], head: FileHead | None) -> Any:
    return problems, head and head.facts


def judge(stored: StoredFile, content: bool = True) -> tuple[list[str], FileHead | None]:
    """All problems of a file, found in this process, and the head of one without any; without the ``content`` only
    problems of the structure of a large one.
    """
    found: list[str] = []
    head, known = None, Known()
    try:
        with stored.opened() as file:
            found = structure_problems(file, stored.size, known)
            if found:
                return found, None
            texts = attributes(file)
            found = text_problems(texts, group_attributes(file))
            content |= sum(file[name].nbytes for name in variables(file)) <= _WHOLE_BYTES
            if content:
                sound = not any(line.startswith("errors") for line in found)
                found += lines(_findings(file, json.loads(texts["errors"]) if sound else None))
            head = FileHead.of(file, known)
            if content:
                unread = {line.partition(":")[0] for line in found if "cannot be read" in line}
                found += head.digests.problems(file, unread)
    except CatalogError as error:
        found.append(str(error).removeprefix(f"{stored.path}: "))
    return found, None if found else head


def _findings(file: h5py.File, errors: Any) -> Iterator[Finding]:
    """Faults of the values, part by part and block by block; a block that cannot be read is one."""
    found = variables(file)
    axes = [name for name in found if _is_axis(name, found[name])]
    common, unreadable = _read(file, {name: found[name] for name in axes}, slice(None))
    yield from unreadable
    if unreadable:
        return
    yield from part_findings("axes", common, errors)
    for part, dim in _DIMS.items():
        own = {n: v for n, v in found.items() if v.dims[0] == dim and n not in axes}
        total = file[next(iter(own))].shape[0]
        for rows in _blocks(file, list(own), total):
            values, unreadable = _read(file, own, rows)
            yield from unreadable
            for finding in () if unreadable else part_findings(part, common | values, errors):
                yield finding.of_block(rows.start, rows.stop, total)


def _is_axis(name: str, variable: Variable) -> bool:
    """True for variables that are checked whole: coordinates, those of no part, and identifiers."""
    group, _, short = name.rpartition("/")
    whole = variable.dims == (short,) or name == "point_id" or group in LEVELS
    return whole or variable.dims[0] not in _DIMS.values()


def _read(
    file: h5py.File, wanted: dict[str, Variable], rows: slice
) -> tuple[dict[str, AnyArray], list[Finding]]:
    """Rows of variables, and those that cannot be read."""
    values, unreadable = {}, []
    for name, variable in wanted.items():
        try:
            array = np.asarray(file[name][rows])
            values[name] = texts(array) if variable.dtype == TEXT else array
        except HDF5_ERRORS as error:
            unreadable.append(Finding(name, f"cannot be read: {line_of(error)}"))
    return values, unreadable


def _blocks(file: h5py.File, names: list[str], total: int) -> Iterator[slice]:
    """All rows of variables of one length, in blocks of `BLOCK_BYTES`; at least one block."""
    row_bytes = sum(file[name].nbytes for name in names) // max(1, total)
    step = max(1, BLOCK_BYTES // max(1, row_bytes))
    for start in range(0, max(1, total), step):
        yield slice(start, min(start + step, total))
