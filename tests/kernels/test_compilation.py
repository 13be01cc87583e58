"""Kernels that kernels call are linked into them: what that changes for Python, for errors, and for other programs."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest
from numba.core.registry import cpu_target

from lcp_catalog.kernels import cache

linked = pytest.mark.skipif(not cache.LINKED, reason="this numba compiles in its own way")


@pytest.fixture(autouse=True)
def own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The user's folder."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "own"))
    monkeypatch.delenv(cache.SHARED, raising=False)
    return tmp_path / "own" / "kernels" / cache.key()


def _inner(x: Any) -> Any:
    if x < 0.0:
        raise ValueError("below zero", x)
    return x * x


def _kernels() -> tuple[Any, Any]:
    inner = cache.njit(nogil=True)(_inner)

    @cache.njit(nogil=True)
    def outer(x: Any) -> Any:
        return inner(x) + 1.0

    return inner, outer


def _machine_code(name: str) -> bool:
    """Whether the engine knows a function for Python whose name has this part."""
    symbols = cpu_target.target_context.codegen()._engine._defined_symbols
    return any(name in symbol and symbol.startswith("_ZN7cpython") for symbol in symbols)


@linked
def test_only_what_python_calls_is_compiled_for_python(own: Path) -> None:
    inner, outer = _kernels()
    assert outer(3.0) == 10.0
    place = f"{__name__}._kernels.<locals>"
    assert _names(own) == [f"{__name__}._inner.part", f"{place}.outer"]
    assert not inner.signatures
    assert inner(3.0) == 9.0
    assert outer(4.0) == 17.0
    assert _names(own) == [f"{__name__}._inner", f"{__name__}._inner.part", f"{place}.outer"]


def _names(folder: Path) -> list[str]:
    return sorted(path.name.rpartition("-")[0] for path in folder.iterdir())


@linked
def test_no_entry_for_python_is_made_of_what_kernels_call() -> None:
    def called_by_one_kernel(x: Any) -> Any:
        return x + 1.0

    called = cache.njit()(called_by_one_kernel)

    @cache.njit()
    def calling_it(x: Any) -> Any:
        return called(x)

    assert calling_it(1.0) == 2.0
    assert _machine_code("calling_it")
    assert not _machine_code("called_by_one_kernel")
    assert called(1.0) == 2.0
    assert _machine_code("called_by_one_kernel")


def test_an_error_with_a_number_of_the_call_reaches_python() -> None:
    """It needs the environment of the kernel that raises it, which has no machine code of its own."""
    _, outer = _kernels()
    with pytest.raises(ValueError, match="below zero") as found:
        outer(-2.0)
    assert found.value.args == ("below zero", -2.0)


def test_another_program_may_call_kernels_from_its_own_numba_functions() -> None:
    inner, outer = _kernels()

    @numba.njit
    def theirs(x: Any) -> Any:
        return inner(x) - outer(x)

    assert theirs(5.0) == -1.0
    with pytest.raises(ValueError, match="below zero"):
        theirs(-1.0)


@pytest.mark.slow
def test_numba_functions_first_compiled_in_a_kernel_serve_other_programs() -> None:
    """The kernel's compilation leaves the mean of an array in numba's memory, without machine code."""

    @cache.njit()
    def ours(x: Any) -> Any:
        return np.median(x), np.array_equal(x, x[::-1])

    @numba.njit
    def theirs(x: Any) -> Any:
        return np.median(x), np.array_equal(x, x[::-1])

    values = np.array([1.0, 5.0, 9.0, 11.0])
    assert ours(values) == theirs(values) == (np.median(values), False)
    codegen = cpu_target.target_context.codegen()
    assert "_library_class" not in vars(codegen)


@pytest.mark.slow
def test_arrays_that_do_not_fit_are_refused_with_and_without_kernels() -> None:
    def assigned(target: Any, source: Any) -> None:
        target[1:] = source

    ours, theirs = cache.njit()(assigned), numba.njit(assigned)
    target = np.zeros(4)
    ours(target, np.arange(3.0))
    assert target.tolist() == [0.0, 0.0, 1.0, 2.0]
    for function in (ours, theirs):
        with pytest.raises(ValueError, match="assign"):
            function(target, np.arange(2.0))


@pytest.mark.slow
@pytest.mark.parametrize("count", [0, 1, 1000])
def test_bodies_of_parallel_loops_are_linked_in(count: int) -> None:
    inner, _ = _kernels()

    @cache.njit(nogil=True, parallel=True)
    def summed(values: Any) -> Any:
        total = 0.0
        for k in numba.prange(len(values)):
            total += inner(values[k])
        return total

    values = np.arange(count, dtype=float)
    assert summed(values) == pytest.approx(np.sum(values**2), rel=1e-14)


@linked
def test_a_part_is_read_from_its_file_where_another_kernel_calls_it(own: Path) -> None:
    _, outer = _kernels()
    assert outer(2.0) == 5.0
    inner, _ = _kernels()

    @cache.njit(nogil=True)
    def other(x: Any) -> Any:
        return inner(x) - 1.0

    assert other(2.0) == 3.0
    with pytest.raises(ValueError, match="below zero") as found:
        other(-2.0)
    assert found.value.args == ("below zero", -2.0)
    part = inner.get_call_template.__self__
    assert sum(part.stats.cache_hits.values()) == 1
    for path in own.glob("*.part-*"):
        path.write_bytes(path.read_bytes()[:-1])
    inner, _ = _kernels()

    @cache.njit()
    def third(x: Any) -> Any:
        return inner(x)

    assert third(3.0) == 9.0
    assert not inner.get_call_template.__self__.stats.cache_hits


LOADED = """
import sys
sys.path.insert(0, sys.argv[1])
import test_compilation as t
_, outer = t._kernels()
try:
    outer(-2.0)
except ValueError as error:
    print(error.args, len(outer.stats.cache_hits), outer(2.0))
"""


@pytest.mark.slow
def test_another_process_loads_a_kernel_with_what_it_calls() -> None:
    found = [
        subprocess.run(
            [sys.executable, "-c", LOADED, str(Path(__file__).parent)],
            check=True, capture_output=True, text=True, timeout=120,
        ).stdout
        for _ in range(2)
    ]  # fmt: skip
    assert found == [f"('below zero', -2.0) {hits} 5.0\n" for hits in (0, 1)]
