"""The one owner of thread counts: numba's parallel kernels and OpenCV's own pool.

Results never depend on the count. Numba's workqueue layer must be entered by one Python thread at a time; parallelism beyond that
comes from processes (`engine`).
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

import numba


def set_threads(count: int) -> None:
    """Let every kernel of this process use ``count`` threads (at least 1, at most what numba was started with)."""
    numba.set_num_threads(max(1, min(count, numba.config.NUMBA_NUM_THREADS)))
    cv2 = sys.modules.get("cv2")
    if cv2 is None:
        import cv2
    cv2.setNumThreads(count)


@contextmanager
def limit_threads(count: int) -> Iterator[None]:
    """``set_threads`` for a block; the numba count is put back at its end."""
    before = numba.get_num_threads()
    set_threads(count)
    try:
        yield
    finally:
        set_threads(before)
