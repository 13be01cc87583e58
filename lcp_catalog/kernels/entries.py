"""The list of the kernels that commands call, with their signatures, so that they can be compiled before they are
called; `tests/kernels/refresh_entries.py` writes it. A kernel that is not in the list is compiled when it is called.
"""

from __future__ import annotations

import functools
import json
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from numba.core.sigutils import normalize_signature

from . import cache

_LIST = Path(__file__).with_name("entries.json")


@dataclass(frozen=True)
class Entry:
    """A kernel for parameters of certain types."""

    kernel: str
    """Module below `kernels`, and function."""

    signature: str
    """The types of the parameters, as numba writes them."""

    seconds: float
    """Processor time of its compilation on the machine that made the list."""

    commands: tuple[str, ...]
    """Commands of `lcp` whose runs on the sample call it."""

    @property
    def file_name(self) -> str:
        """The name of its file."""
        return cache.file_name(self.kernel, self.signature)

    @property
    def is_compiled(self) -> bool:
        """Its file is in one of the folders for this process's level; whether it is whole is seen when it is loaded."""
        return any((folder / self.file_name).is_file() for folder in cache.folders())

    def compiled(self) -> Path | None:
        """Load or compile it. The whole file in which it is then; None if no folder can be written."""
        module, _, name = self.kernel.rpartition(".")
        kernel: Any = getattr(import_module(f"{__package__}.{module}"), name)
        kernel.compile(normalize_signature(self.signature)[0])
        return cache.whole_file(self.file_name)


def entries(command: str | None = None) -> list[Entry]:
    """The entries of a command, or all; those that take longest first."""
    return [entry for entry in _list() if command is None or command in entry.commands]


@functools.cache
def _list() -> list[Entry]:
    rows = json.loads(_LIST.read_text(encoding="utf-8"))
    found = [Entry(**{**row, "commands": tuple(row["commands"])}) for row in rows]
    return sorted(found, key=lambda entry: entry.seconds, reverse=True)
