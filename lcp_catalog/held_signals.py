"""Signals that wait: handlers in Python must not raise inside HDF5, which then crashes."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable
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
        if threading.current_thread() is threading.main_thread():
            for name in _SIGNALS:
                number = getattr(signal, name, None)  # Windows has no SIGHUP
                handler = None if number is None else signal.getsignal(number)
                if number is not None and callable(handler):
                    self._handlers[number] = handler
                    signal.signal(number, self._hold)
        return self

    def __exit__(self, *_: object) -> None:
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
