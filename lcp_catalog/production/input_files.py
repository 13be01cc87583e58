"""The files that a build reads, which must stay the same while it runs."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

from ..atomic_files import file_facts, file_state
from ..errors import AreaFailedError


class InputFiles:
    """Files as they were when they were opened: their state (`atomic_files.file_state`), and after
    `digest` also their content.
    """

    def __init__(self) -> None:
        self._stamps: dict[Path, tuple[int, ...]] = {}
        self._sums: dict[Path, str] = {}

    def add(self, paths: Iterable[Path]) -> None:
        """Note the state of files; to be called when they have just been opened."""
        self._stamps |= {path: _stamp(path) for path in paths}

    def digest(self) -> None:
        """Note the content of all files. AreaFailedError if one was changed since it was added."""
        self._sums = {path: _sum(path) for path in self._stamps}
        for path, stamp in self._stamps.items():
            if _stamp(path) != stamp:
                raise _changed(path)

    def require_unchanged(self) -> None:
        """AreaFailedError for a file whose content is another than at the start. Only files in another
        state are read again.
        """
        for path, stamp in self._stamps.items():
            now = _stamp(path)
            if now != stamp:
                if _sum(path) != self._sums.get(path):
                    raise _changed(path)
                self._stamps[path] = now


def _stamp(path: Path) -> tuple[int, ...]:
    try:
        facts = os.stat(path)
    except OSError as error:
        raise _changed(path) from error
    return file_state(facts)


def _sum(path: Path) -> str:
    try:
        (facts,) = file_facts([path])
    except OSError as error:
        raise _changed(path) from error
    return str(facts["sha256"])


def _changed(path: Path) -> AreaFailedError:
    return AreaFailedError(
        f"{path}: was changed, replaced or removed while the build ran; put it back and run again with `resume`, "
        "or build anew"
    )
