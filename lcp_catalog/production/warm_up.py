"""Kernels that are compiled before they are called, each once, in several processes: for the workers of a build, and
for other machines.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from pathlib import Path

from ..atomic_files import write_bytes
from ..errors import ConfigError, OutputError
from ..kernels.cpu_level import LEVELS
from ..kernels.cpu_level import level as own_level
from ..kernels.entries import Entry, entries
from ..stages import Progress, unseen
from ..threads import thread_limit
from .executor import children_start, processes

log = logging.getLogger(__name__)

_PROCESSES = 8
"""Most processes that compile: each takes half a gigabyte."""

_NAME = "NUMBA_CPU_NAME"


def missing(command: str) -> list[Entry]:
    """The kernels of a command of `lcp` that are not compiled, those that take longest first."""
    return [entry for entry in entries(command) if not entry.is_compiled]


def compile_kernels(
    found: Sequence[Entry], progress: Progress = unseen, level: str | None = None
) -> list[Path]:
    """Load or compile kernels, for a level or for this machine. Their files: those that fail, or that no folder takes,
    are left out, and compiled when they are called.
    """
    files: list[Path] = []
    count = min(thread_limit(), _PROCESSES, len(found))
    progress(0, len(found))
    with processes(max(count, 1)) as pool:
        with _for_level(level), children_start():
            calls = [pool.submit(entry.compiled) for entry in found]
        for done, call in enumerate(as_completed(calls), 1):
            try:
                files += filter(None, [call.result()])
            except BrokenProcessPool:
                log.warning("a process that compiles kernels died (killed, or out of memory)")
                break
            except Exception as error:  # a list that is not of these sources
                log.warning("a kernel of the list cannot be compiled: %s", error)
            progress(done, len(found))
    return files


@contextmanager
def _for_level(level: str | None) -> Iterator[None]:
    """Processes that start in the block compile for a level."""
    before = os.environ.get(_NAME)
    try:
        os.environ |= {} if level is None else {_NAME: level}
        yield
    finally:
        os.environ.pop(_NAME, None)
        os.environ |= {} if before is None else {_NAME: before}


def warm_up(
    level: str | None = None,
    output: Path | str | None = None,
    progress: Progress = unseen,
) -> list[Path]:
    """Compile all kernels that the commands call on the sample, so that no first use waits for them.

    Parameters
    ----------
    level:
        ``x86-64-v4`` (with AVX-512), ``x86-64-v3`` (AVX2) or ``x86-64``; None: that of this machine.
    output:
        A folder in which the files are collected, for containers and clusters: ``LCP_KERNELS`` names it there. None:
        they stay in the user's folder.
    progress:
        Called with the number of finished kernels and of all.

    Returns
    -------
    list of Path
        The files, in a folder named after level and version.

    Raises
    ------
    ConfigError
        For a level of other processors.
    OutputError
        If files cannot be written.

    Examples
    --------
    >>> files = lcp.warm_up(output=folder / "kernels")  # doctest: +SKIP
    >>> lcp.warm_up("armv8")  # doctest: +IGNORE_EXCEPTION_DETAIL
    Traceback (most recent call last):
    ConfigError: `level` must be one of x86-64, x86-64-v3, x86-64-v4
    """
    if level is not None and (level not in LEVELS or own_level() not in LEVELS):
        raise ConfigError(
            f"`level` must be one of {', '.join(LEVELS)}, on such a processor, not {level}"
        )
    found = entries()
    files = compile_kernels(found, progress, level)
    if len(files) < len(found):
        raise OutputError(
            f"{len(found) - len(files)} of {len(found)} kernels are not compiled: no memory, or no folder to write "
            "(XDG_CACHE_HOME names the user's)"
        )
    if output is None:
        return files
    folder = Path(output) / files[0].parent.name
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{folder}: the folder cannot be created: {error.strerror}") from error
    for path in files:
        write_bytes(folder / path.name, path.read_bytes(), overwrite=True)
    return [folder / path.name for path in files]
