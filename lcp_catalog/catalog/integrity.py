"""Digests of a file: the SHA-256 of every stored chunk in one table, and of this table with all that describes the
variables, the attribute `CONTENT`. docs/reference/catalogue-format.md has the form that is digested.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import os
import re
import threading
import zlib
from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from math import prod
from typing import Any, NamedTuple

import h5py
import numpy as np

from ..arrays import AnyArray, Bytes, Index
from ..errors import CatalogError
from .schema import Variable

CONTENT = "content_sha256"
"""Global attribute with the digest of the content."""

INTEGRITY = "integrity"
"""Group of the table of digests and of its dimensions."""

TABLE = "chunk_sha256"
"""The table: a row of `DIGEST_BYTES` for each chunk."""

DIGEST_BYTES = 32

DIGESTS = Variable(("chunk", "byte"), "u1", "1", "SHA-256 of each chunk of each variable")

HDF5_ERRORS = (
    OSError,
    RuntimeError,
    ValueError,
    KeyError,
    TypeError,
    AttributeError,
    OverflowError,
    MemoryError,
)
"""Errors that h5py raises for damaged files."""

RECENT_BYTES = 32 << 20
"""Most memory of the decoded chunks that an open file keeps: the next frame reads the same ones."""

_KEEPING = threading.Lock()

_ADDRESSES = ("DIMENSION_LIST", "REFERENCE_LIST")
"""Attributes that hold places in the file: the names of the dimensions stand for them."""


class UnreadError(CatalogError):
    """The operating system does not read the file: nothing is known of its content."""


NOT_READ = "cannot be read: "
"""How the text of an `UnreadError` begins."""

_WORDS = {
    "checksum": "a checksum does not match",
    "truncated": "it is cut short",
    "addr overflow": "it is cut short",
    "filter": "a chunk cannot be unpacked",
    "decompress": "a chunk cannot be unpacked",
}
"""What HDF5 says of damage, by a word of its text, which is for its developers."""


def line_of(error: BaseException) -> str:
    """What an error of HDF5 says of a file, in our words. UnreadError where a call of the operating system failed."""
    text = str(error)
    if isinstance(error, UnreadError):
        raise error
    found = re.search(r"errno = (\d+)", text)
    code = (error.errno if isinstance(error, OSError) else None) or int(found[1] if found else 0)
    if code:
        reason = os.strerror(code)
        raise UnreadError(
            f"{NOT_READ}{reason}; that says nothing about its content: try again"
        ) from error
    if isinstance(error, MemoryError):
        return "it needs more memory than there is"
    return next(
        (own for word, own in _WORDS.items() if word in text.lower()), "its structure is broken"
    )


def chunk_digest(stored: bytes, filter_mask: int = 0) -> bytes:
    """SHA-256 of a chunk: its filter mask, 4 bytes with the lowest first, and its stored bytes."""
    return hashlib.sha256(filter_mask.to_bytes(4, "little") + stored).digest()


@dataclass(frozen=True)
class Known:
    """What was read of an open file, and is not read again: names of coordinates by their address in it, and by the path
    of a member its dimensions and its attributes.
    """

    names: dict[int, str] = field(default_factory=dict)
    dims: dict[str, tuple[str, ...]] = field(default_factory=dict)
    attributes: dict[str, dict[str, Any]] = field(default_factory=lambda: defaultdict(dict))


def content_digest(file: h5py.File, table: Bytes) -> str:
    """The digest of an open file's content with this table of chunks (n, 32)."""
    return _digest(list(_members(file)), table, Known())


def _digest(members: Sequence[tuple[str, Any]], table: Bytes, known: Known) -> str:
    variables, groups = {}, {}
    for path, member in members:
        if isinstance(member, h5py.Dataset) and member.is_scale:
            known.names[_address(member.id)] = path.rpartition("/")[2]
    for path, member in members:
        if isinstance(member, h5py.Group):
            groups[path] = _attributes(member, known.attributes[path])
        else:
            variables[path] = _described(member, path, known)
    content = {
        "groups": groups,
        "variables": variables,
        "chunks": hashlib.sha256(table.tobytes()).hexdigest(),
    }
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def _members(place: h5py.Group, before: str = "") -> Iterator[tuple[str, Any]]:
    """All groups and variables by their paths, the file itself first, whose path is empty."""
    yield before[:-1], place
    for name in sorted(place):
        member = h5py.h5o.open(
            place.id, name.encode(errors="surrogateescape")
        )  # half the time of place[name]
        if isinstance(member, h5py.h5g.GroupID):
            yield from _members(h5py.Group(member), f"{before}{name}/")
        else:
            yield f"{before}{name}", h5py.Dataset(member)


def _attributes(place: Any, known: Mapping[str, Any]) -> dict[str, Any]:
    """The attributes of a group or a variable: texts as they are, numbers as type, shape and bytes."""
    stored = place.attrs
    return {
        name: _plain(known[name] if name in known else stored[name])
        for name in stored
        if name not in (*_ADDRESSES, CONTENT)
    }


def _plain(value: Any) -> Any:
    if isinstance(value, str):
        return value
    array = np.asarray(value)
    return [array.dtype.str, list(array.shape), array.tobytes().hex()]


def _described(dataset: h5py.Dataset, path: str, known: Known) -> dict[str, Any]:
    kind = dataset.dtype
    text = h5py.check_string_dtype(kind)
    return {
        "type": kind.str if text is None else f"{kind.str} {text.encoding}",
        "shape": list(dataset.shape),
        "chunks": list(dataset.chunks or ()),
        "filters": _filters(dataset),
        "dimensions": list(dimensions(dataset, path, known)),
        "attributes": _attributes(dataset, known.attributes[path]),
    }


def dimensions(dataset: h5py.Dataset, path: str, known: Known) -> tuple[str, ...]:
    """Names of the dimensions of a variable, which are those of the coordinates it refers to. HDF5 looks through the
    file for each that is not ``known``.
    """
    if path not in known.dims:
        own = path.rpartition("/")[2]
        known.dims[path] = (own,) if dataset.is_scale else _dimensions(dataset, known.names)
    return known.dims[path]


def _dimensions(dataset: h5py.Dataset, names: dict[int, str]) -> tuple[str, ...]:
    found = ["?"] * len(dataset.shape)
    if not h5py.h5a.exists(dataset.id, b"DIMENSION_LIST"):
        return tuple(found)
    # not by h5py.h5ds.iterate: where HDF5 2.0.0 cannot read the list, it frees what it has not filled, for ever
    stored = h5py.h5a.open(dataset.id, b"DIMENSION_LIST")
    lists = np.empty(len(found), h5py.vlen_dtype(h5py.ref_dtype))
    if stored.shape == lists.shape:
        stored.read(lists)
        for axis, scales in enumerate(lists):
            if len(scales):
                found[axis] = _known_name(h5py.h5r.dereference(scales[0], dataset.id), names)
    return tuple(found)


def _known_name(scale: Any, names: dict[int, str]) -> str:
    address = _address(scale)
    if address not in names:
        names[address] = _name(scale)
    return names[address]


def _address(member: Any) -> int:
    """The place of HDF5's object in its file."""
    return int(h5py.h5o.get_info(member).addr)


def _name(member: Any) -> str:
    """The last part of the path of HDF5's object."""
    get = h5py.h5i.get_name
    name = get(member) or get(member)  # a read that fails in its search gives none
    return str(name.decode(errors="surrogateescape")).rpartition("/")[2]


@dataclass(frozen=True)
class ChunkGrid:
    """The chunks of a variable, and the row of its first one in the table."""

    first: int
    shape: tuple[int, ...]
    sides: tuple[int, ...]

    @cached_property
    def along(self) -> tuple[int, ...]:
        """Numbers of chunks along the axes."""
        return tuple(-(-n // side) for n, side in zip(self.shape, self.sides, strict=True))

    def __len__(self) -> int:
        return prod(self.along)

    def number(self, offset: tuple[int, ...]) -> int:
        """Row in the table of the chunk with this offset: the last axis runs fastest."""
        where = tuple(k // side for k, side in zip(offset, self.sides, strict=True))
        return self.first + int(np.ravel_multi_index(where, self.along))

    def offset(self, number: int) -> tuple[int, ...]:
        """Offset of the chunk with this row in the table."""
        where = np.unravel_index(number - self.first, self.along)
        return tuple(int(k) * side for k, side in zip(where, self.sides, strict=True))


def chunk_grids(
    layouts: Mapping[str, tuple[tuple[int, ...], tuple[int, ...]]],
) -> dict[str, ChunkGrid]:
    """The chunks of variables with these shapes and sides of chunks, by path: the table has them in the
    order of the paths.
    """
    found, first = {}, 0
    for path in sorted(layouts):
        found[path] = ChunkGrid(first, *layouts[path])
        first += len(found[path])
    return found


def _grids(members: Iterable[tuple[str, Any]]) -> dict[str, ChunkGrid]:
    return chunk_grids(
        {
            path: (member.shape, member.chunks)
            for path, member in members
            if isinstance(member, h5py.Dataset) and member.chunks and path != f"{INTEGRITY}/{TABLE}"
        }
    )


class ChunkDigests:
    """The chunks of a file, and the table of their digests (n, 32). A chunk is decoded from the very bytes whose
    digest was compared with it.
    """

    def __init__(self, grids: dict[str, ChunkGrid], table: Bytes) -> None:
        self.grids, self._table = grids, table
        self._recent: dict[tuple[str, int], AnyArray] = {}

    @classmethod
    def of(cls, file: h5py.File, known: Known | None = None) -> ChunkDigests:
        """Those of an open file, of which something may be known. CatalogError for a table that is not that of the
        attribute `CONTENT`, or that has not a row for each chunk.
        """
        members = list(_members(file))
        grids = _grids(members)
        table: Bytes = np.asarray(file[f"{INTEGRITY}/{TABLE}"][()])
        count = sum(map(len, grids.values()))
        if table.shape != (count, DIGEST_BYTES):
            raise CatalogError(f"{INTEGRITY}/{TABLE}: has not a digest for each of {count} chunks")
        if _digest(members, table, known or Known()) != file.attrs[CONTENT]:
            raise CatalogError(
                f"{CONTENT}: the content is not what was written (damaged or edited)"
            )
        return cls(grids, table)

    @property
    def facts(self) -> list[Any]:
        """The same for another process, as JSON can hold it."""
        layouts = {path: (grid.shape, grid.sides) for path, grid in self.grids.items()}
        return [layouts, self._table.tobytes().hex()]

    @classmethod
    def received(cls, facts: Sequence[Any]) -> ChunkDigests:
        """From what JSON made of `facts`."""
        layouts = {path: (tuple(shape), tuple(sides)) for path, (shape, sides) in facts[0].items()}
        table = np.frombuffer(bytes.fromhex(facts[1]), np.uint8).reshape(-1, DIGEST_BYTES)
        return cls(chunk_grids(layouts), table)

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_recent": {}}

    def part(
        self, file: h5py.File, path: str, index: tuple[Any, ...], *, keep: bool = False
    ) -> AnyArray:
        """What an index selects of a variable, as stored: numbers and slices, and rows in any order for the
        first axis. CatalogError if a chunk that holds some of it is not the one that was written. ``keep``: hold the
        chunks, up to `RECENT_BYTES` of all, for the next time.
        """
        dataset, grid = file[path], self.grids[path]
        index = (*index, *[slice(None)] * (len(grid.shape) - len(index)))
        axes = [
            list(_along(own, length, side))
            for own, length, side in zip(index, grid.shape, grid.sides, strict=True)
        ]
        filters = _filters(dataset)
        kept = [np.arange(n)[own] for n, own in zip(grid.shape, index, strict=True)]
        found = np.empty([places.size for places in kept], dataset.dtype)
        for parts in itertools.product(*axes):
            number = grid.number(tuple(part.start for part in parts))
            chunk = self._recent.get((path, number))
            if chunk is None:
                stored = self._sound_chunk(dataset, grid, number)
                if stored is None:
                    where = ", ".join(map(str, grid.offset(number)))
                    raise CatalogError(
                        f"{path}: is damaged: the chunk at [{where}] is not what was written"
                    )
                chunk = decoded(stored, filters, grid.sides, dataset.dtype)
            if keep:
                self._keep((path, number), chunk)
            found[tuple(part.to for part in parts)] = chunk[tuple(part.of for part in parts)]
        return found.reshape([len(places) for places in kept if places.ndim])

    def _keep(self, key: tuple[str, int], chunk: AnyArray) -> None:
        """Keep a decoded chunk, the most recently used last, and at most `RECENT_BYTES` of all."""
        with _KEEPING:
            self._recent.pop(key, None)
            self._recent[key] = chunk
            held = sum(kept.nbytes for kept in self._recent.values())
            while held > RECENT_BYTES:
                held -= self._recent.pop(next(iter(self._recent))).nbytes

    def problems(self, file: h5py.File, but: Collection[str] = ()) -> Iterator[str]:
        """A line for each variable with chunks that are not those that were written; ``but``: paths of variables
        that are left out.
        """
        for path, grid in self.grids.items():
            if path in but:
                continue
            numbers = range(grid.first, grid.first + len(grid))
            dataset = file[path]
            wrong = sum(not self._is_intact(dataset, grid, number) for number in numbers)
            if wrong:
                yield f"{path}: {wrong} of {len(grid)} chunks are not what was written (damaged or edited)"

    def _is_intact(self, dataset: h5py.Dataset, grid: ChunkGrid, number: int) -> bool:
        """False for a chunk that is not what was written, or that cannot be read."""
        try:
            return self._sound_chunk(dataset, grid, number) is not None
        except HDF5_ERRORS as error:
            line_of(error)  # raises if the system does not read it
            return False

    def _sound_chunk(self, dataset: h5py.Dataset, grid: ChunkGrid, number: int) -> bytes | None:
        """The stored bytes of a chunk; None if they are not what was written."""
        mask, stored = dataset.id.read_direct_chunk(grid.offset(number))
        return stored if chunk_digest(stored, mask) == self._table[number].tobytes() else None


class _Part(NamedTuple):
    """What is selected of a chunk along an axis: the chunk's first place, and the places in it (``of``) that go
    to others (``to``) of the result.
    """

    start: int
    of: slice | Index
    to: slice | Index


def _along(index: Any, length: int, side: int) -> Iterator[_Part]:
    """What an index selects along an axis, by chunks."""
    wanted = np.arange(length)[index].reshape(-1)
    chunk = wanted // side
    order = np.argsort(chunk, kind="stable")
    first = np.flatnonzero(np.diff(chunk[order], prepend=-1))
    for to in np.split(order, first[1:]) if len(order) else ():
        start = int(chunk[to[0]]) * side
        yield _Part(start, _as_slice(wanted[to] - start), _as_slice(to))


def _as_slice(places: Index) -> slice | Index:
    """Places as a slice, by which NumPy copies faster, if they rise in equal steps."""
    steps = np.diff(places)
    step = int(steps[0]) if len(steps) else 1
    if step < 1 or (steps != step).any():
        return places
    return slice(int(places[0]), int(places[-1]) + 1, step)


def _filters(dataset: h5py.Dataset) -> list[int]:
    stored = dataset.id.get_create_plist()
    return [stored.get_filter(k)[0] for k in range(stored.get_nfilters())]


def decoded(
    stored: bytes, filters: Sequence[int], shape: tuple[int, ...], dtype: np.dtype[Any]
) -> AnyArray:
    """The content of a chunk from its stored bytes, whose digest stands for Fletcher's checksum at their end."""
    content: Any = stored
    for number in reversed(filters):
        if number == h5py.h5z.FILTER_FLETCHER32:
            content = memoryview(content)[:-4]
        elif number == h5py.h5z.FILTER_DEFLATE:
            content = zlib.decompress(content, bufsize=prod(shape) * dtype.itemsize)
        elif dtype.itemsize > 1:  # shuffled
            planes = np.frombuffer(content, np.uint8).reshape(dtype.itemsize, -1)
            content = np.empty((planes.shape[1], dtype.itemsize), np.uint8)
            for k, plane in enumerate(planes):  # three times as fast as a transposed copy
                content[:, k] = plane
    return np.frombuffer(content, dtype).reshape(shape)


def digest_table(
    digests: Mapping[str, Mapping[tuple[int, ...], bytes]], grids: Mapping[str, ChunkGrid]
) -> AnyArray:
    """The table (n, 32) from the digests of chunks by path and offset. KeyError for a chunk without."""
    rows = [
        digests[path][grid.offset(number)]
        for path, grid in grids.items()
        for number in range(grid.first, grid.first + len(grid))
    ]
    return np.frombuffer(b"".join(rows), np.uint8).reshape(-1, DIGEST_BYTES)
