"""A file on disk that HDF5 writes without seeing an error: it leaves a file that it cannot write open,
and crashes on it when the interpreter exits.
"""

from __future__ import annotations

import errno
import io
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any


class DiskStream(io.RawIOBase):
    """An existing file, read and written. The first error of the system is kept for `check`; from then
    on what is written is kept in memory. HDF5 then closes its file in order, and the writer, which
    checks after every part, gives it little more to write.
    """

    def __init__(self, path: Path) -> None:
        self._file = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        self._place = self._end = 0
        self._error: OSError | None = None
        self._unwritten: list[tuple[int, bytes]] = []  # in the order of writing: the last counts

    def check(self) -> None:
        """Raise the error that was met, if any."""
        if self._error is not None:
            raise self._error

    def sync(self) -> None:
        """Have everything on the disk, or raise what prevents it."""
        self._try(lambda: os.fsync(self._file))
        self.check()

    def tell(self) -> int:
        return self._place

    def seek(self, offset: int, whence: int = os.SEEK_SET, /) -> int:
        start = {os.SEEK_SET: 0, os.SEEK_CUR: self._place, os.SEEK_END: self._end}[whence]
        self._place = start + offset
        return self._place

    def truncate(self, size: int | None = None, /) -> int:
        self._end = self._place if size is None else size
        self._try(lambda: os.ftruncate(self._file, self._end))
        return self._end

    def write(self, data: Any, /) -> int:
        part, start = memoryview(data).cast("B"), self._place
        self._place += part.nbytes
        self._end = max(self._end, self._place)
        self._try(lambda: _write_all(self._file, part, start))
        if self._error is not None:
            self._unwritten.append((start, bytes(part)))
        return part.nbytes

    def readinto(self, buffer: Any, /) -> int:
        whole, start = memoryview(buffer).cast("B"), self._place
        whole[:] = bytes(whole.nbytes)
        self._place += whole.nbytes
        try:  # also after an error: HDF5 may loop on records that it does not find again
            _read_all(self._file, whole, start)
        except OSError as error:
            self._error = self._error or error
        for place, data in self._unwritten:
            first, last = max(place, start), min(place + len(data), start + whole.nbytes)
            if first < last:
                whole[first - start : last - start] = data[first - place : last - place]
        return whole.nbytes

    def close(self) -> None:
        if not self.closed:
            super().close()
            os.close(self._file)

    def _try(self, action: Callable[[], None]) -> None:
        if self._error is None:
            try:
                action()
            except OSError as error:
                self._error = error


def _write_all(file: int, part: memoryview, start: int) -> None:
    done = 0
    while done < part.nbytes:
        some = os.pwrite(file, part[done:], start + done)
        if not some:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        done += some


def _read_all(file: int, whole: memoryview, start: int) -> None:
    """Fill the buffer; behind the end of the file it stays as it is."""
    done = 0
    while some := os.preadv(file, [whole[done:]], start + done):
        done += some
