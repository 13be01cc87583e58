"""What a function may do to its process."""

from __future__ import annotations

import os
import signal
import time
from typing import Any


def repeat(text: str) -> dict[str, Any]:
    return {"text": text * 300_000, "process": os.getpid()}


def crash(_: str) -> None:
    os.kill(os.getpid(), signal.SIGSEGV)


def loop(_: str) -> None:
    while True:
        pass


def hoard(_: str) -> int:
    return len(bytearray(10**9))


def fail(text: str) -> int:
    return int(text)


def leave(_: str) -> None:
    os._exit(7)


def wait(_: str) -> None:
    time.sleep(60.0)
