"""The file below HDF5: after an error it still gives back what was written."""

from __future__ import annotations

import errno
import io
import os
import random
from pathlib import Path

import pytest

from lcp_catalog.catalog import disk_stream
from lcp_catalog.catalog.disk_stream import DiskStream


@pytest.mark.parametrize("seed", range(40))
def test_a_full_disk_keeps_what_was_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, seed: int
) -> None:
    """Against a file in memory: writes that overlap and reads, before and after the disk is full.
    HDF5, which reads its own records again, can loop for ever if they are lost.
    """
    dice = random.Random(seed)
    room, write = dice.randrange(1000), os.pwrite

    def limited(file: int, data: memoryview, place: int) -> int:
        nonlocal room
        if not room:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        some = min(room, len(data))
        room -= some
        return write(file, data[:some], place)

    monkeypatch.setattr(disk_stream.os, "pwrite", limited)
    (tmp_path / "file").touch()
    twin = io.BytesIO()
    with DiskStream(tmp_path / "file") as stream:
        for _ in range(100):
            place, count = dice.randrange(200), dice.randrange(1, 60)
            stream.seek(place)
            twin.seek(place)
            if dice.random() < 0.6:
                data = dice.randbytes(count)
                stream.write(data)
                twin.write(data)
            else:
                found = bytearray(count)
                stream.readinto(found)
                assert found == twin.read(count).ljust(count, b"\0")
        with pytest.raises(OSError, match="No space left"):
            stream.check()


def test_a_disk_that_takes_nothing_is_full(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(disk_stream.os, "pwrite", lambda *_: 0)
    (tmp_path / "file").touch()
    with DiskStream(tmp_path / "file") as stream:
        stream.write(b"x")
        with pytest.raises(OSError, match="No space left"):
            stream.check()
