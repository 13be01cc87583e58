"""The folder of compiled kernels.

numba keeps them beside their source, or else in the user's home, and compiles a kernel again when its own
file has changed, but not when a kernel that it calls has changed in another file. Compiled kernels of
other sources are therefore removed, or kept apart. If neither place can be written (a node of a
cluster), kernels are kept in the temporary directory, so that they are compiled once for each machine.
"""

from __future__ import annotations

import hashlib
import logging
import multiprocessing
import os
import stat
import tempfile
from pathlib import Path
from typing import Any

import numba
from numba.core import event

log = logging.getLogger(__name__)

_VARIABLE = "NUMBA_CACHE_DIR"
_BESIDE = Path(__file__).parent / "__pycache__"


def use_writable_folder() -> None:
    """Set the folder before the first kernel is defined. The environment takes it to child processes."""
    found, digest = _numba_folder(), _source_digest()
    if os.environ.get(_VARIABLE):
        if digest[:16] not in os.environ[_VARIABLE]:  # else this process's parent has set it
            _set_folder(str(Path(os.environ[_VARIABLE]) / f"lcp-kernels-{digest[:16]}"))
    elif found != _BESIDE or not _remove_others(digest):
        folder = str(_folder(found.parent if found else Path(tempfile.gettempdir())))
        os.environ[_VARIABLE] = folder
        _set_folder(folder)
    if multiprocessing.parent_process() is None:  # one process of a build says it
        event.register("numba:compile", _Notice())


def _set_folder(folder: str) -> None:
    numba.config.CACHE_DIR = folder  # type: ignore[attr-defined]  # made when numba is imported


def _numba_folder() -> Path | None:
    """The folder in which numba keeps the kernels of this folder; None if it finds no place: it looks for
    one when a function is declared.
    """
    try:
        probe: Any = numba.njit(cache=True)(_folder)
        return Path(probe._cache.cache_path)
    except RuntimeError:
        return None


def _remove_others(digest: str) -> bool:
    """Remove kernels beside their source that were compiled from other sources. False if they cannot be
    removed.
    """
    note = _BESIDE / "sources.sha256"
    try:
        if not note.exists() or note.read_text() != digest:
            for path in Path(__file__).parent.rglob("*.nb[ci]"):
                path.unlink(missing_ok=True)
            part = note.with_suffix(f".{os.getpid()}")
            part.write_text(digest)
            part.replace(note)
    except OSError:
        return False
    return True


def _folder(parent: Path) -> Path:
    """A folder for this user and these sources of the kernels. Another user's folder of that name, whose
    files would be run, is not used.
    """
    user = os.getuid() if hasattr(os, "getuid") else 0
    folder = parent / f"lcp-kernels-{user}-{_source_digest()[:16]}"
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        facts = folder.lstat()
        if stat.S_ISDIR(facts.st_mode) and facts.st_uid == user and not facts.st_mode & 0o022:
            return folder
    except OSError:
        pass
    return Path(tempfile.mkdtemp(prefix="lcp-kernels-", dir=parent))


def _source_digest() -> str:
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parent.rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()


class _Notice(event.Listener):
    """Says once that kernels are compiled, which delays the first image."""

    said = False

    def on_start(self, event: event.Event) -> None:
        if not self.said:
            self.said = True
            log.warning(
                "compiling kernels for this machine: up to two minutes, the first time only"
            )

    def on_end(self, event: event.Event) -> None:
        pass
