"""Parallel loops of kernels notice passes that are lost: numba drops an exception of a thread."""

from __future__ import annotations

import ast
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numba import njit, prange

from lcp_catalog.kernels.completion import all_done

KERNELS = Path(__file__).resolve().parents[2] / "lcp_catalog" / "kernels"


def uncounted(text: str) -> list[int]:
    """Lines of the loops over `prange` that do not count their passes, or whose count is not compared with their range,
    or whose threads can leave the count behind.
    """
    blocks: list[list[ast.stmt]] = [
        block
        for node in ast.walk(ast.parse(text))
        for block in (getattr(node, "body", None), getattr(node, "orelse", None))
        if isinstance(block, list)
    ]
    found = []
    for block in blocks:
        for place, loop in enumerate(block):
            if not isinstance(loop, ast.For) or not ast.unparse(loop.iter).startswith("prange("):
                continue
            assert isinstance(loop.iter, ast.Call)
            *first, last = map(ast.unparse, loop.iter.args)
            count = f"{last} - {first[0]}" if first else last
            before, inside = ast.unparse(block[place - 1]), ast.unparse(loop.body[0])
            after = [ast.unparse(one) for one in block[place + 1 : place + 2]]
            if (before, inside, after) != ("done = 0", "done += 1", [f"all_done(done, {count})"]):
                found.append(loop.lineno)
    return found


def test_every_parallel_loop_counts_its_passes() -> None:
    texts = {path: path.read_text() for path in KERNELS.rglob("*.py")}
    assert sum("prange(" in text for text in texts.values()) > 20
    assert {path.name: uncounted(text) for path, text in texts.items() if uncounted(text)} == {}


@pytest.mark.parametrize(
    ("change", "lines"),
    [
        (("", ""), []),
        (("done = 0", "done = 1"), [4]),
        (("done += 1", "a[k] = 0"), [4]),
        (("all_done(done, n)", "return"), [4]),
        (("all_done(done, n)", "all_done(done, m)"), [4]),
        (("prange(n)", "prange(2, n)"), [4]),
        (("prange(n)", "range(n)"), []),
    ],
)
def test_a_loop_that_does_not_count_is_found(change: tuple[str, str], lines: list[int]) -> None:
    text = (
        "def f(n, a):\n    if n:\n        done = 0\n        for k in prange(n):\n"
        "            done += 1\n            a[k] = 1\n        all_done(done, n)\n"
    )
    assert uncounted(text.replace(*change)) == lines


@njit(nogil=True, error_model="numpy", parallel=True)
def _filled(sizes: Any, out: Any) -> None:
    done = 0
    for k in prange(sizes.size):
        done += 1
        if sizes[k] == 0:
            continue
        own = np.full(sizes[k], 1.0)
        out[k] = own.sum()
    all_done(done, sizes.size)


@pytest.mark.slow
def test_an_array_that_cannot_be_allocated_in_any_thread_is_noticed() -> None:
    """Of each pass in turn; two in a row leave no trace of the first."""
    out = np.zeros(40)
    for k in range(40):
        sizes = np.arange(40) % 3
        _filled(sizes, out)
        assert np.array_equal(out[sizes > 0], sizes[sizes > 0])
        sizes[k] = 2**55
        with pytest.raises(MemoryError):
            _filled(sizes, out)
