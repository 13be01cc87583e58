"""Signals that end a run as Ctrl-C does: SIGTERM (`kill`, batch systems) and SIGHUP (a closed terminal)."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

_REPEAT_S = 5.0
"""Time in which further signals are ignored: shells and terminals send SIGHUP twice, and the clean-up
after the first must not be interrupted."""


class Stopped(KeyboardInterrupt):
    """The process got a signal that ends it. ``name``: the signal's, ``exit_code``: 128 plus its number,
    as shells report it.
    """

    def __init__(self, number: int) -> None:
        super().__init__()
        self.name = signal.Signals(number).name
        self.exit_code = 128 + number


@contextmanager
def stopping_signals() -> Iterator[None]:
    """Raise `Stopped` in the block on SIGTERM and SIGHUP. One that is ignored (`nohup`) stays ignored.
    Outside the main thread nothing changes, because signals arrive there only.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    last = -float("inf")

    def stop(number: int, frame: FrameType | None) -> None:
        nonlocal last
        before, last = last, time.monotonic()
        if last - before > _REPEAT_S:
            raise Stopped(number)

    numbers = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
    previous = {n: signal.getsignal(n) for n in numbers}
    caught = [n for n in numbers if previous[n] is signal.SIG_DFL]
    try:
        for number in caught:
            signal.signal(number, stop)
        yield
    finally:
        for number in caught:
            signal.signal(number, previous[number])
