"""Reads images and heights while one read of their files fails, each in turn; a process of its own with
`failing_calls.so` loaded before all others runs it: ``python failed_reads.py FOLDER STATE NAME...``.
"""

from __future__ import annotations

import hashlib
import json
import mmap
import os
import struct
import sys
from pathlib import Path

STATE = struct.Struct("6q16q64s512s512s")
"""`struct state` of benchmarks/faults/failing_calls.c."""
SIDES = 120, 150
READ, EIO, COUNT_OF_READS = 1, 5, 7


def content(path: Path) -> str:
    """Digest of what is read, or "refused"."""
    from lcp_catalog.dem import raster
    from lcp_catalog.dem.dem import Dem
    from lcp_catalog.errors import LcpError
    from lcp_catalog.images.pixels import read_pixels

    try:
        if path.name.startswith("heights"):
            dem = Dem.open(path)
            return hashlib.sha256(dem.read(0, *SIDES[:1], 0, *SIDES[1:])).hexdigest()
        pixels = read_pixels(path)
        return hashlib.sha256(pixels.samples.tobytes() + pixels.valid.tobytes()).hexdigest()
    except (LcpError, OSError):  # a command says the second in one line
        return "refused"
    finally:
        raster._local.__dict__.clear()  # open files, with what GDAL has read of them


def main(folder: str, state: str, *names: str) -> None:
    with open(state, "r+b") as file:
        shared = mmap.mmap(file.fileno(), 0)
    found = {}

    def run(path: Path, nth: int) -> tuple[str, int]:
        shared[:] = STATE.pack(1, READ, nth, EIO, 0, 0, *[0] * 16, b"", b"", os.fsencode(folder))
        text = content(path)
        reads = STATE.unpack(shared[:])[COUNT_OF_READS]
        shared[:8] = bytes(8)  # no longer armed
        return text, reads

    for name in names:
        path = Path(folder) / name
        good, reads = run(path, 2**40)
        found[name] = [good, [run(path, nth)[0] for nth in range(1, reads + 1)]]
    print(json.dumps(found))


if __name__ == "__main__":
    main(*sys.argv[1:])
