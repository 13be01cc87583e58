"""What replaces slow places of numba's compiler gives what numba gives."""

from __future__ import annotations

import gc
import math
import os
import subprocess
import sys
from functools import partial
from pathlib import Path
from typing import Any

import numba
import pytest
from llvmlite import ir as llvm_ir
from numba.core import compiler, ir_utils, types
from numba.core.base import BaseContext
from numba.core.codegen import CPUCodeLibrary
from numba.core.registry import cpu_target
from numba.core.targetconfig import TargetConfig
from numba.core.types.functions import BaseFunction
from numba.extending import overload

from lcp_catalog.kernels import cache, shortcuts

pytestmark = pytest.mark.skipif(not cache.LINKED, reason="this numba compiles in its own way")


@pytest.fixture
def own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A folder for kernels without any."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "own"))
    monkeypatch.delenv(cache.SHARED, raising=False)


def _function(values: Any, start: Any = (1.0, 2.0)) -> Any:
    total, (first, second) = {"a": start[0]}["a"], start
    for one in values:
        value = one
        while value > first:
            value = max(value / 2.0, second) - 1.0
        total += [value, total][0]
    return total


def test_options_have_the_values_that_numba_gives() -> None:
    flags = compiler.Flags()
    flags.nrt, flags.fastmath = True, {"contract"}
    for one in (flags, compiler.Flags()):
        assert shortcuts._values(one) == TargetConfig.values(one)
    with shortcuts.shortcuts():
        assert flags == flags.copy() != compiler.Flags()
        assert hash(flags) == hash(flags.copy())


def test_statements_have_the_variables_that_numba_finds() -> None:
    frontend = compiler.run_frontend(_function)
    statements = [s for block in frontend.blocks.values() for s in block.body]
    before = [[v.name for v in s.list_vars()] for s in statements]
    with shortcuts.shortcuts():
        assert [[v.name for v in s.list_vars()] for s in statements] == before
    assert len(before) > 40
    assert max(map(len, before)) > 2


def test_every_scope_defines_the_variables_that_numba_defines() -> None:
    found = []
    for define in (ir_utils.fixup_var_define_in_scope, shortcuts._define_everywhere):
        blocks = compiler.run_frontend(_function).blocks
        scopes = [blocks[k].scope for k in sorted(blocks)]
        for k, scope in enumerate(scopes[: len(scopes) // 2]):  # scopes of their own, without names
            blocks[sorted(blocks)[k]].scope = type(scope)(None, scope.loc)
        define(blocks)
        found.append([list(blocks[k].scope.localvars._con.items()) for k in sorted(blocks)])
    ours, theirs = ([[(n, v.name) for n, v in names] for names in one] for one in found)
    assert ours == theirs
    assert min(map(len, ours)) > 10


def test_types_have_the_sizes_that_llvm_gives() -> None:
    context = cpu_target.target_context
    for kind in (types.int8, types.float64, types.UniTuple(types.float32, 3), types.float32[:, :]):
        value = context.get_value_type(kind)
        expected = context.get_abi_sizeof(value)
        assert shortcuts._size_of(context, value) == expected
        assert shortcuts._size_of(context, value) == expected
    assert shortcuts._size_of(context, llvm_ir.ArrayType(llvm_ir.IntType(16), 5)) == 10


def test_a_call_is_looked_up_once_and_one_that_numba_compiles_each_time(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    context = cpu_target.typing_context
    context.refresh()
    looked_up = []
    own = shortcuts._call_type
    monkeypatch.setattr(shortcuts, "_known_calls", {})
    monkeypatch.setattr(shortcuts, "_call_type", lambda *call: looked_up.append(call) or own(*call))
    root, greatest = context.resolve_value_type(math.sqrt), context.resolve_value_type(max)
    for function, arguments, times in (
        (root, (types.float32,), 1),
        (root, (types.int64,), 1),
        (greatest, (types.float64, types.int64), 2),
    ):
        looked_up.clear()
        expected = BaseFunction.get_call_type(function, context, arguments, {})
        for _ in range(2):
            assert shortcuts._call_type_of(function, context, arguments, {}) == expected
        assert len(looked_up) == times


def _ratio(x: Any, y: Any) -> Any:
    """Stands for one of numba's functions that are compiled for their callers."""


@overload(_ratio)
def _(x: Any, y: Any) -> Any:
    def code(x: Any, y: Any) -> Any:
        return x / y

    return code


@pytest.mark.usefixtures("own")
def test_an_option_of_one_kernel_is_not_that_of_the_next() -> None:
    @cache.njit()
    def strict(x: Any) -> Any:
        return _ratio(x, 0.0)

    @cache.njit(error_model="numpy")
    def lenient(x: Any) -> Any:
        return _ratio(x, 0.0)

    @cache.njit()
    def strict_again(x: Any) -> Any:
        return _ratio(x, 0.0) + 1.0

    assert lenient(1.0) == math.inf
    for kernel in (strict, strict_again):
        with pytest.raises(ZeroDivisionError):
            kernel(1.0)


@pytest.mark.usefixtures("own")
def test_numba_is_as_before_after_a_kernel_and_after_one_that_fails(
    request: pytest.FixtureRequest,
) -> None:
    def state() -> list[Any]:
        owners = (CPUCodeLibrary, TargetConfig, BaseFunction, BaseContext)
        return [*(dict(vars(owner)) for owner in owners), gc.get_threshold()]

    request.addfinalizer(partial(gc.set_threshold, *gc.get_threshold()))
    gc.set_threshold(701, 11, 12)
    before = state()

    @cache.njit()
    def right(x: Any) -> Any:
        return x + 1.0

    @cache.njit()
    def wrong(x: Any) -> Any:
        return x.nothing

    assert right(2.0) == 3.0
    assert state() == before
    with pytest.raises(numba.TypingError):
        wrong(2.0)
    assert state() == before


KERNEL = """
import contextlib, sys
import numba, numpy as np
from lcp_catalog.kernels import cache, compilation
if sys.argv[1] == "numba":
    compilation.shortcuts = contextlib.nullcontext

@cache.njit(nogil=True, error_model="numpy", fastmath={"contract", "reassoc"})
def part(row, weights):
    total = np.float32(0.0)
    for k in range(len(row)):
        total += row[k] * weights[k] if row[k] > 0.0 else min(row[k], weights[k])
    return total / max(len(row), 1)

@cache.njit(nogil=True, error_model="numpy", fastmath={"contract"})
def kernel(image, weights):
    found = np.empty(image.shape[0])
    for i in range(image.shape[0]):
        found[i] = part(image[i], weights) + np.sqrt(abs(weights[i]))
    return found

print(kernel(np.ones((3, 4), np.float32), np.ones(4, np.float32)), file=sys.stderr)
print(kernel.overloads[kernel.signatures[0]].library._final_module)
"""


@pytest.mark.slow
def test_the_optimised_code_of_a_kernel_is_the_same(tmp_path: Path) -> None:
    texts = []
    for way in ("numba", "ours"):
        environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / way), "PYTHONHASHSEED": "0"}
        done = subprocess.run(
            [sys.executable, "-c", KERNEL, way], env=environment, check=True, text=True, capture_output=True, timeout=300
        )  # fmt: skip
        texts.append(done.stdout)
    assert texts[0] == texts[1]
    assert "fmul reassoc contract <" in texts[0], "a loop of vectors"
