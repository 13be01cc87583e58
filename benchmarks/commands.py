"""Commands as processes of their own: wall and processor time, memory, what they print."""

from __future__ import annotations

import contextlib
import ctypes
import os
import subprocess
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

LCP = str(Path(sys.executable).with_name("lcp"))
_SET_CHILD_SUBREAPER = 36
"""PR_SET_CHILD_SUBREAPER of <sys/prctl.h>."""


@dataclass(frozen=True)
class Ran:
    """A command that has ended: wall time and processor time with its workers', seconds; greatest resident memory
    of its process and of one below it, MB; standard output and error.
    """

    seconds: float
    processor_s: float
    parent_mb: float
    worker_mb: float
    output: str
    said: str


def lcp(*words: str, good: int = 0) -> Ran:
    """Run ``lcp``. SystemExit with its message for another exit code than ``good``."""
    return ran([LCP, *words], good=good)


def ran(
    command: Sequence[str],
    folder: Path | None = None,
    variables: Mapping[str, str] | None = None,
    good: int = 0,
) -> Ran:
    """Run a command in a folder, with further environment variables, and look at its memory five times a
    second; Python keeps compiled modules, as for users. SystemExit with its message for another exit code than ``good``.
    """
    _adopt_orphans()
    known, peaks = set(children(os.getpid())), dict[int, float]()
    start, before = time.perf_counter(), os.times()
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=folder,
        env={**os.environ, "PYTHONDONTWRITEBYTECODE": "", **(variables or {})},
    )  # fmt: skip
    ended = threading.Event()

    def watch() -> None:
        while not ended.wait(0.2):
            for number in _family(process.pid):
                peaks[number] = max(peaks.get(number, 0.0), _peak_mb(number))

    watcher = threading.Thread(target=watch)
    watcher.start()
    output, said = process.communicate()
    took = time.perf_counter() - start
    ended.set()
    watcher.join()
    if process.returncode != good:
        raise SystemExit(said)
    for orphan in set(children(os.getpid())) - known:
        with contextlib.suppress(ChildProcessError):
            os.waitpid(orphan, 0)
    after = os.times()
    used = sum(after[2:4]) - sum(before[2:4])
    below = [peak for number, peak in peaks.items() if number != process.pid]
    return Ran(took, used, peaks.get(process.pid, 0.0), max(below, default=0.0), output, said)


def _adopt_orphans() -> None:
    """Let processes whose parent has ended become this one's: workers end after the command, and their
    processor time counts here when this process waits for them.
    """
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_SET_CHILD_SUBREAPER, 1, 0, 0, 0)


def children(number: int) -> list[int]:
    """The processes that a process has started. Nothing of one that has ended."""
    try:
        tasks = list(Path(f"/proc/{number}/task").iterdir())
        return [int(word) for task in tasks for word in (task / "children").read_text().split()]
    except OSError:
        return []


def _family(number: int) -> list[int]:
    """A process and all below it."""
    return [number, *(each for child in children(number) for each in _family(child))]


def _peak_mb(number: int) -> float:
    try:
        lines = Path(f"/proc/{number}/status").read_text().splitlines()
    except OSError:
        return 0.0
    return next((int(x.split()[1]) * 1.024e-3 for x in lines if x.startswith("VmHWM:")), 0.0)
