"""Commands keep the memory of their arrays."""

from __future__ import annotations

import os
import platform
import subprocess
import sys

import pytest

FAULTS = """
import resource
import numpy as np
from lcp_cli.main import run

def faults():
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _ in range(50):
        np.ones(1_000_000)
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before

first = faults()
run(["sun", "--lon", "0", "--lat", "0", "--time", "2026-01-01"])
print(first, faults())
"""
"""Pages that are faulted in for 50 arrays of 8 MB, before and after a command."""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="mallopt is glibc's")
def test_a_command_keeps_the_memory_of_its_arrays() -> None:
    """An array has 1953 pages, some of them large ones; with a fixed threshold each of 50 is faulted in."""
    fixed = os.environ | {"MALLOC_TRIM_THRESHOLD_": "65536"}
    ran = subprocess.run(
        [sys.executable, "-c", FAULTS], env=fixed, capture_output=True, text=True, check=True
    )
    before, after = map(int, ran.stdout.split()[-2:])
    assert (before > 15_000, after < 8_000) == (True, True), (before, after)
