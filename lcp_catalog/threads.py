"""Thread counts: the number of threads that the kernels and OpenCV may use in this process.

Results do not depend on it: every output value is computed by one thread from inputs that no thread
writes.
"""

from __future__ import annotations

import os
import sys
from types import ModuleType, TracebackType

import numba


def cores() -> int:
    """Processor cores that this process may use, which a batch system can limit."""
    limited = hasattr(os, "sched_getaffinity")
    return len(os.sched_getaffinity(0)) if limited else os.cpu_count() or 1


def thread_limit() -> int:
    """Greatest number of threads for the kernels in this process: ``NUMBA_NUM_THREADS`` at the
    start of numba, else the number of cores.
    """
    return int(numba.config.NUMBA_NUM_THREADS)  # type: ignore[attr-defined]  # made when numba is imported


def thread_count() -> int:
    """Number of threads that the kernels use now (`limit_threads`)."""
    return int(numba.get_num_threads())


class limit_threads:  # noqa: N801  (used like a function; ``with`` restores the limit)
    """Limit the kernels, and OpenCV if it is imported, to ``count`` threads.

    The limit is set at once and holds until the next one; a context manager restores the previous
    limit at the end of its block. A count above ``thread_limit()`` is lowered to it. ValueError for
    a count below 1.
    """

    def __init__(self, count: int) -> None:
        if count < 1:
            raise ValueError(f"at least one thread is needed, not {count}")
        opencv = _opencv()
        self._kernels_before = numba.get_num_threads()
        self._opencv_before = opencv.getNumThreads() if opencv else None
        numba.set_num_threads(min(count, thread_limit()))
        if opencv:
            opencv.setNumThreads(min(count, os.cpu_count() or 1))

    def __enter__(self) -> limit_threads:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        numba.set_num_threads(self._kernels_before)
        opencv = _opencv()
        if opencv and self._opencv_before is not None:
            opencv.setNumThreads(self._opencv_before)


def _opencv() -> ModuleType | None:
    """The OpenCV module if it is imported; None otherwise."""
    return sys.modules.get("cv2")
