"""Chunks that threads compress, against those that HDF5 itself writes."""

import io
import zlib

import h5py
import numpy as np
import pytest

from lcp_catalog.catalog.chunk_writing import ChunkWriter, Deflate, compressed, fletcher32

SHAPES = {  # dataset, chunk, type
    "numbers": ((1000,), (300,), "<f8"),
    "flags": ((70, 5, 3), (32, 5, 3), "u1"),
    "long rows": ((3, 40, 50), (1, 20, 50), "<f4"),
    "parts of two axes": ((9, 17, 5), (4, 6, 2), "<u2"),
    "text": ((25,), (10,), "S7"),
    "one chunk": ((4,), (10,), "<i8"),
}


def _content(shape: tuple[int, ...], kind: str, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    values = rng.integers(0, 100, shape)
    return values.astype("U").astype(kind) if kind.startswith("S") else values.astype(kind)


def _dataset(
    file: h5py.File, shape: tuple[int, ...], chunk: tuple[int, ...], kind: str
) -> h5py.Dataset:
    filters = {"compression": "gzip", "compression_opts": 2, "shuffle": True, "fletcher32": True}
    unlimited = (None,) * len(shape)
    return file.create_dataset("x", shape, kind, chunks=chunk, maxshape=unlimited, **filters)


@pytest.mark.parametrize(
    ("waiting", "deflate"), [(100, Deflate(2)), (10**6, Deflate(1, zlib.Z_RLE))]
)
@pytest.mark.parametrize("name", SHAPES)
def test_hdf5_reads_rows_that_come_in_parts(
    name: str, waiting: int, deflate: Deflate, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("lcp_catalog.catalog.chunk_writing._WAITING_BYTES", waiting)
    shape, chunk, kind = SHAPES[name]
    values, rng = _content(shape, kind, 3), np.random.default_rng(5)
    stream, checks = io.BytesIO(), []
    with h5py.File(stream, "w") as file:
        writer, dataset = (
            ChunkWriter(lambda: checks.append(1)),
            _dataset(file, shape, chunk, kind),
        )
        for part in np.split(values, np.sort(rng.integers(0, shape[0], 4))):
            writer.add(dataset, part, deflate)
        writer.finish()
        writer.close()
    with h5py.File(stream) as file:
        assert np.array_equal(file["x"][()], values)
        assert len(checks) == file["x"].id.get_num_chunks()


@pytest.mark.parametrize("name", SHAPES)
def test_chunks_are_those_of_hdf5(name: str) -> None:
    shape, chunk, kind = SHAPES[name]
    values = _content(shape, kind, 4)
    with h5py.File(io.BytesIO(), "w") as file:
        dataset = _dataset(file, shape, chunk, kind)
        dataset[...] = values
        file.flush()
        for number in range(dataset.id.get_num_chunks()):
            offset = dataset.id.get_chunk_info(number).chunk_offset
            theirs = dataset.id.read_direct_chunk(offset)[1]
            part = tuple(slice(k, k + side) for k, side in zip(offset, chunk, strict=True))
            ours = compressed(values[part], chunk, Deflate(2))
            assert zlib.decompress(ours[:-4]) == zlib.decompress(theirs[:-4])
            assert fletcher32(theirs[:-4]) == int.from_bytes(theirs[-4:], "little")
            assert fletcher32(ours[:-4]) == int.from_bytes(ours[-4:], "little")


@pytest.mark.parametrize(
    "data",
    [bytes(8), b"\xff" * 6, b"\xff\xff" * 65535, b"\1", b"abc", bytes(4) + b"\xff\xff", bytes(range(251)) * 997],
    ids=["zeros", "65535 three times", "65535 often", "one byte", "odd", "zeros first", "long"],
)  # fmt: skip
def test_checksum_is_that_of_hdf5(data: bytes) -> None:
    with h5py.File(io.BytesIO(), "w") as file:
        dataset = file.create_dataset("x", len(data), "u1", chunks=(len(data),), fletcher32=True)
        dataset[...] = np.frombuffer(data, np.uint8)
        file.flush()
        stored = dataset.id.read_direct_chunk((0,))[1]
    assert stored[:-4] == data
    assert fletcher32(data) == int.from_bytes(stored[-4:], "little")


def test_threads_do_not_change_the_order(monkeypatch: pytest.MonkeyPatch) -> None:
    values, files = _content((5000, 8), "<f4", 6), []
    for threads in (1, 7):
        monkeypatch.setattr("lcp_catalog.catalog.chunk_writing.thread_count", lambda n=threads: n)
        stream = io.BytesIO()
        with h5py.File(stream, "w", libver=("earliest", "v110")) as file:
            writer = ChunkWriter(lambda: None)
            filters = {
                "compression": "gzip",
                "compression_opts": 2,
                "shuffle": True,
                "fletcher32": True,
            }
            dataset = file.create_dataset(
                "x", values.shape, "<f4", chunks=(64, 8), track_times=False, **filters
            )
            writer.add(dataset, values, Deflate(2))
            writer.finish()
            writer.close()
        files.append(stream.getvalue())
    assert files[0] == files[1]
