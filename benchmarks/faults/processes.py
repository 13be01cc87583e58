"""Builds that are disturbed: their inputs, and the processes that they leave."""

from __future__ import annotations

import os
import time
from collections.abc import Callable

from benchmarks.places import ROOT

CONFIG = ROOT / "tests" / "data" / "nine_areas.toml"
"""A build of nine small areas."""


def is_gone(group: int) -> bool:
    """True if no process of a group is left."""
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return True
    return False


def wait_for(condition: Callable[[], bool], seconds: float) -> bool:
    """True as soon as the function gives True, False after the time."""
    end = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > end:
            return False
        time.sleep(0.02)
    return True
