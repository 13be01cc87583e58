"""Power loss: what a run did to a folder, and every state that a disk may be in if the power fails meanwhile.

A file that was not synced may hold nothing; changes of a folder that was not synced since may be lost, all
from any one on, or any one of them alone. `Recorder` sees the calls that give names and sync; what is written
in between, by any library, it finds in the files.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from lcp_catalog import atomic_files

Names = dict[str, int]
"""Numbers of files (inodes) by their paths in the folder."""

CALLS = ("rename", "replace", "link", "unlink", "mkdir", "rmdir")


@dataclass
class Recorder:
    """Steps of a run in ``folder``: the names after each, and the content that had been synced by then."""

    folder: Path
    steps: list[tuple[Names, dict[int, bytes]]] = field(default_factory=list)
    safe: list[set[str]] = field(default_factory=list)  # folders that are synced in the step
    synced: dict[int, bytes] = field(default_factory=dict)

    def names(self) -> Names:
        return {
            str(path.relative_to(self.folder)): path.lstat().st_ino
            for path in self.folder.rglob("*")
        }

    def step(self, synced: str | None = None) -> None:
        """Note the state after a call."""
        self.steps.append((self.names(), dict(self.synced)))
        self.safe.append(set() if synced is None else {synced})

    @contextmanager
    def recording(self) -> Iterator[Recorder]:
        """Record what the block does."""
        for path in self.folder.rglob("*"):  # what was there before is on the disk
            if path.is_file():
                self.synced[path.stat().st_ino] = path.read_bytes()
        self.step()
        with pytest.MonkeyPatch.context() as patch:
            for name in CALLS:
                patch.setattr(os, name, self._noting(getattr(os, name)))
            patch.setattr(atomic_files, "_exchange", self._noting(atomic_files._exchange))
            patch.setattr(os, "fsync", self._fsync(os.fsync))
            yield self
        self.step()

    def _noting(self, call: Any) -> Any:
        def noted(*given: Any, **more: Any) -> Any:
            found = call(*given, **more)
            self.step()
            return found

        return noted

    def _fsync(self, call: Any) -> Any:
        def noted(handle: int) -> None:
            call(handle)
            path = Path(os.readlink(f"/proc/self/fd/{handle}"))
            if path.is_dir():
                self.step(str(path.relative_to(self.folder)))
            else:
                self.synced[os.fstat(handle).st_ino] = path.read_bytes()
                self.step()

        return noted

    def after_failures(self, output: str) -> Iterator[dict[str, bytes | None]]:
        """What may be under the output's name, a file or a folder of files (by path; None: not on the
        disk), for a failure of the power after each step.
        """
        for last in range(len(self.steps)):
            content = self.steps[last][1]
            for names in self._left(last):
                found = {
                    path: content.get(number)
                    for path, number in names.items()
                    if path == output or path.startswith(f"{output}/")
                }
                yield {path: kept for path, kept in found.items() if not self._is_folder(path)}

    def _is_folder(self, path: str) -> bool:
        return any(other.startswith(f"{path}/") for names, _ in self.steps for other in names)

    def _left(self, last: int) -> Iterator[Names]:
        """Names after a failure: those of each step since the folders were synced, and of the last with
        one change of all since then undone.
        """
        base = last
        while base > 0 and "." not in self.safe[base]:
            base -= 1
        for k in range(base, last + 1):
            yield self.steps[k][0]
        for k in range(base + 1, last + 1):
            before, after = self.steps[k - 1][0], self.steps[k][0]
            names = dict(self.steps[last][0])
            for path in before.keys() | after.keys():
                if before.get(path) != after.get(path) and names.get(path) == after.get(path):
                    names.pop(path, None)
                    if path in before:
                        names[path] = before[path]
            yield names
