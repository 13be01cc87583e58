"""Signals that end a run: Ctrl-C, SIGTERM (`kill`, batch systems) and SIGHUP (a closed terminal)."""

from __future__ import annotations

import os
import signal
import threading
import time
import weakref
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import FrameType

from .messages import line

_AGAIN_S = 0.2
"""Time after which the signal is raised again if a library has lost it."""

_LONGEST_S = 20.0
"""Time after which a process that has got a signal is ended, whatever it does."""


class Stopped(KeyboardInterrupt):
    """The process got a signal that ends it. ``how``: in words, ``exit_code``: 128 plus its number, as
    shells report it.
    """

    def __init__(self, number: int) -> None:
        super().__init__()
        name = signal.Signals(number).name
        self.how = "interrupted" if number == signal.SIGINT else f"stopped by {name}"
        self.exit_code = 128 + number


@contextmanager
def stopping_signals() -> Iterator[None]:
    """Raise `Stopped` in the block on SIGINT, SIGTERM and SIGHUP, and at its end whatever it made of that. While
    the exception is on its way, further signals do not interrupt the clean-up. Where it ends in a callback of
    a library, which cannot hand it on, it is raised again. A process that does not end is ended, with the
    same exit code. A signal that is ignored (`nohup`) stays ignored. Outside the main thread nothing changes,
    because signals arrive there only.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    numbers = [getattr(signal, name, None) for name in ("SIGINT", "SIGTERM", "SIGHUP")]
    previous = {n: signal.getsignal(n) for n in numbers if n is not None}
    caught = [n for n in previous if previous[n] in (signal.SIG_DFL, signal.default_int_handler)]
    stop = _Stop()
    try:
        for number in caught:
            signal.signal(number, stop)
        yield
    except Stopped:
        raise
    except BaseException as error:
        if stop.number:  # its text is that of the call that was interrupted
            raise stop.raised() from error
        raise
    else:
        if stop.number:
            raise stop.raised()
    finally:
        stop.end()
        for number in caught:
            signal.signal(number, previous[number])


class _Stop:
    """Handles the signals of a run."""

    def __init__(self) -> None:
        self.number = 0
        self._ended, self._watcher = (
            threading.Event(),
            threading.Thread(target=self._watch, daemon=True),
        )
        self._on_its_way: weakref.ref[Stopped] | None = None

    def __call__(self, number: int, frame: FrameType | None) -> None:
        if self._is_on_its_way():
            return
        if not self.number:
            self.number = number
            with suppress(RuntimeError, MemoryError):  # no memory for its stack
                self._watcher.start()
        raise self.raised()

    def end(self) -> None:
        """End the watch."""
        self._ended.set()
        if self._watcher.is_alive():
            self._watcher.join()

    def raised(self) -> Stopped:
        """The exception; no frame of its traceback may hold it, else it would not be seen to be lost."""
        stopped = Stopped(self.number)
        self._on_its_way = weakref.ref(stopped)
        return stopped

    def _is_on_its_way(self) -> bool:
        return self._on_its_way is not None and self._on_its_way() is not None

    def _watch(self) -> None:
        """Send the signal again when it was lost, and end the process after `_LONGEST_S`."""
        began = time.monotonic()
        while not self._ended.wait(_AGAIN_S):
            if time.monotonic() - began > _LONGEST_S:
                self._end_process()
            if not self._is_on_its_way():
                signal.pthread_kill(threading.main_thread().ident or 0, self.number)

    def _end_process(self) -> None:
        stopped = Stopped(self.number)
        text = f"lcp: {stopped.how}, and ended because it went on for {_LONGEST_S:g} s; the next run removes what it has begun"
        # not by a stream, which the main thread may hold
        os.write(2, f"{line(text, 'error', {'exit_code': stopped.exit_code})}\n".encode())
        os._exit(stopped.exit_code)
