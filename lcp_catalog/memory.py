"""Memory use of this process."""

from __future__ import annotations

import contextlib
import ctypes
import resource
import sys
from pathlib import Path


def keep_memory() -> None:
    """Let this process keep the memory of arrays for the next ones, with glibc: the system clears what it hands out."""
    if mallopt := getattr(ctypes.CDLL(None), "mallopt", None):
        # `M_TRIM_THRESHOLD` and `M_MMAP_THRESHOLD`: glibc raises them so far by itself, array by array
        mallopt(-1, 64 << 20)
        mallopt(-3, 32 << 20)


def resident_mb() -> float:
    """Resident memory of this process, MB; where the system does not say it, the greatest so far."""
    return _status_mb("VmRSS") or peak_mb()


def mapped_mb() -> float:
    """Resident memory of this process that is mapped files, of libraries mostly, MB; 0 where the system does not say it."""
    return _status_mb("RssFile")


def peak_mb() -> float:
    """Greatest resident memory of this process so far, MB.

    On Linux from ``VmHWM``, because ``ru_maxrss`` starts at the memory of the parent process.
    """
    known = _status_mb("VmHWM")
    if known:
        return known
    unit = 1 if sys.platform == "darwin" else 1024  # kilobytes, but on macOS bytes
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6


def restart_peak() -> None:
    """Let `peak_mb` count from now on, where the system can (Linux); what the process keeps free counts."""
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")


def _status_mb(name: str) -> float:
    """A figure of Linux about this process, MB; 0 elsewhere."""
    status = Path("/proc/self/status")
    if status.exists():
        for line in status.read_text(encoding="ascii", errors="replace").splitlines():
            if line.startswith(f"{name}:"):
                return int(line.split()[1]) * 1024 / 1e6
    return 0.0
