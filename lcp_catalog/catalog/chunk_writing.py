"""Rows of datasets that are compressed by threads: HDF5 itself runs its filters in one thread at a time."""

from __future__ import annotations

import itertools
import zlib
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

import h5py
import numpy as np

from ..arrays import AnyArray
from ..threads import thread_count
from .integrity import chunk_digest

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
