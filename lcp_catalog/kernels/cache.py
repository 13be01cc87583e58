"""The folder of compiled kernels.

numba keeps them beside their source, or else in the user's home. If neither can be written (a node of a
cluster), they are kept in the temporary directory, so that they are compiled once for each machine.
"""

from __future__ import annotations

import hashlib
import logging
import multiprocessing
import os
import stat
import tempfile
from pathlib import Path

import numba
from numba.core import event

log = logging.getLogger(__name__)

_VARIABLE = "NUMBA_CACHE_DIR"


def use_writable_folder() -> None:
    """Set the folder before the first kernel is defined. The environment takes it to child processes."""
    if not _numba_has_a_folder():
        folder = str(_folder(Path(tempfile.gettempdir())))
        os.environ[_VARIABLE] = folder
        numba.config.CACHE_DIR = folder  # type: ignore[attr-defined]  # made when numba is imported
    if multiprocessing.parent_process() is None:  # one process of a build says it
        event.register("numba:compile", _Notice())


def _numba_has_a_folder() -> bool:
    """True if numba finds a place for the kernels: it looks for one when a function is declared."""
    try:
        numba.njit(cache=True)(_folder)
    except RuntimeError:
        return False
    return True


def _folder(parent: Path) -> Path:
    """A folder for this user and this source of the kernels: a cached kernel does not notice changes in
    other modules. Another user's folder of that name, whose files would be run, is not used.
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
