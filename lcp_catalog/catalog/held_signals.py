"""Signals that wait: handlers in Python must not raise inside HDF5, which then crashes."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

_SIGNALS = ("SIGINT", "SIGTERM", "SIGHUP")


class HeldSignals:
    """A context in which SIGINT, SIGTERM and SIGHUP wait for `release` or its end; only in the main
    thread, which alone gets them.
    """

    def __init__(self) -> None:
        self._handlers: dict[int, Callable[[int, Any], Any]] = {}
        self._held: list[int] = []

    def __enter__(self) -> HeldSignals:
        self._hold_all()
        return self

    def _hold_all(self) -> None:
        if threading.current_thread() is threading.main_thread():
            for name in _SIGNALS:
                number = getattr(signal, name, None)  # Windows has no SIGHUP
                handler = None if number is None else signal.getsignal(number)
                if number is not None and callable(handler):
                    self._handlers[number] = handler
                    signal.signal(number, self._hold)

    def __exit__(self, *_: object) -> None:
        self._hold_none()

    @contextmanager
    def let_through(self) -> Iterator[None]:
        """A context within this one in which signals are handled at once: for long work without HDF5."""
        self._hold_none()
        try:
            yield
        finally:
            self._hold_all()

    def _hold_none(self) -> None:
        for number, handler in self._handlers.items():
            signal.signal(number, handler)
        self.release()

    def release(self) -> None:
        """Handle the signals that have come."""
        while self._held:
            number = self._held.pop(0)
            self._handlers[number](number, None)

    def _hold(self, number: int, _frame: Any) -> None:
        self._held.append(number)
