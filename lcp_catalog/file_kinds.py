"""What a file is that was given in the place of another, by its first bytes."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path

_BEGINNINGS = (
    (b"\x89HDF", "an HDF5 file, such as a catalogue"),
    (b"\x89PNG", "a PNG image"),
    (b"\xff\xd8\xff", "a JPEG image"),
    (b"II*\0", "a TIFF image, such as a DEM"),
    (b"MM\0*", "a TIFF image, such as a DEM"),
    (b"II+\0", "a TIFF image, such as a DEM"),
    (b"LCPF", "a flight file"),
    (b"{", "a JSON file, such as a camera"),
)


def plain_opener(path: str, flags: int) -> int:
    """An opener for `open` that does not wait for the writer of a pipe: OSError for what is no plain file."""
    opened = os.open(path, flags | os.O_NONBLOCK)
    if not stat.S_ISREG(os.fstat(opened).st_mode):
        os.close(opened)
        raise OSError(errno.EINVAL, "is not a plain file", path)
    return opened


def may_wait(path: str | os.PathLike[str]) -> bool:
    """True for a pipe or a device, or a link to one: whoever opens or reads it may wait for another program."""
    return os.path.exists(path) and not (os.path.isfile(path) or os.path.isdir(path))


def no_file(path: Path, wanted: str) -> str:
    """Why a path is no file: ``is a folder, not a DEM``."""
    if path.is_dir():
        return f"is a folder, not {wanted}"
    return "is not a plain file" if path.exists() else "there is no such file"


def other_kind(path: Path | str, wanted: str, raster: bool = False) -> str:
    """``is a PNG image, not a catalogue``, for a file whose beginning is known and not that of what is ``wanted``;
    empty for others, and for a file that cannot be read. ``raster``: every image can be what is wanted.
    """
    try:
        with Path(path).open("rb") as file:
            beginning = file.read(64).lstrip()
    except OSError:
        return ""
    kind = next((text for start, text in _BEGINNINGS if beginning.startswith(start)), "")
    if not kind and Path(path).suffix.lower() == ".toml":
        kind = "a configuration (TOML), which is given with `config`"
    if raster and " image" in kind:
        return ""
    return f"is {kind}, not {wanted}" if kind and not kind.endswith(wanted) else ""
