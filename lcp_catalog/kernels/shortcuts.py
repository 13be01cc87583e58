"""Slow places of numba's compiler, replaced while a kernel is compiled. The code of kernels is the same without them; compilation
takes a third longer.
"""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from importlib import import_module
from typing import Any

from numba.core import ir
from numba.core.base import BaseContext
from numba.core.codegen import CPUCodeLibrary
from numba.core.targetconfig import TargetConfig
from numba.core.types.functions import BaseFunction

_THRESHOLDS = 100_000, 1000, 1000
"""Those of Python's garbage collector: numba's objects live as long as the process, and looking through them again and again takes
an eighth of the time.
"""

_WITHOUT_VARIABLES = {
    *(str, int, bool, type(None)),
    *(ir.Loc, ir.Const, ir.Global, ir.FreeVar, ir.Arg, ir.Scope),
}

_call_type, _variables = BaseFunction.get_call_type, ir.Inst._rec_list_vars
_known_calls: dict[Any, Any] = {}
_defaults: dict[Any, dict[str, Any]] = {}
_sizes: dict[Any, int] = {}


@contextmanager
def replaced(owner: Any, name: str, value: Any) -> Iterator[None]:
    """Give an object or module an attribute of its own in the block."""
    before = vars(owner).get(name)
    setattr(owner, name, value)
    try:
        yield
    finally:
        if before is None:
            delattr(owner, name)
        else:
            setattr(owner, name, before)


@contextmanager
def shortcuts() -> Iterator[None]:
    """In the block numba's slow places are replaced."""
    passes = import_module("numba.core.untyped_passes")  # which kernels of files do not need
    before = gc.get_threshold()
    with ExitStack() as stack:
        for owner, name, value in (
            (CPUCodeLibrary, "_optimize_functions", _optimize_functions),
            (TargetConfig, "values", _values),
            (ir.Inst, "_rec_list_vars", _variables_of),
            (BaseFunction, "get_call_type", _call_type_of),
            (BaseContext, "get_abi_sizeof", _size_of),
            (passes, "fixup_var_define_in_scope", _define_everywhere),
        ):
            stack.enter_context(replaced(owner, name, value))
        stack.callback(gc.set_threshold, *before)
        gc.set_threshold(*_THRESHOLDS)
        yield


def _optimize_functions(self: Any, module: Any) -> None:
    """Not those that are only declared, nine of ten."""
    module.data_layout = self._codegen._data_layout
    for function in module.functions:
        if not function.is_declaration:
            manager, builder = self._codegen._function_pass_manager()
            manager.run(function, builder)


def _values(self: Any) -> dict[str, Any]:
    """Options, which are compared for each call of a function, without a call for each of them."""
    kind = type(self)
    if kind not in _defaults:
        _defaults[kind] = {name: option.default for name, option in kind.options.items()}
    return _defaults[kind] | self._values


def _variables_of(self: Any, value: Any) -> list[Any]:
    """Variables of a statement, without four tests for each of its parts that has none."""
    if type(value) is not dict:
        return [] if type(value) in _WITHOUT_VARIABLES else _variables(self, value)
    found = []
    for part in value.values():
        if type(part) is ir.Var:
            found.append(part)
        elif type(part) not in _WITHOUT_VARIABLES:
            found += self._rec_list_vars(part)
    return found


def _call_type_of(self: Any, context: Any, args: Any, kws: Any) -> Any:
    """The types of a call, found once for a function and its arguments. Functions that numba compiles for a call
    (`overload`) depend on the caller's options: they are looked up each time.
    """
    key = self, context, tuple(args)
    found = None if kws else _known_calls.get(key)
    if found is None:
        found = _call_type(self, context, args, kws)
        if not kws and self.get_impl_key(found) is self.typing_key:
            _known_calls[key] = found
    return found


def _size_of(self: Any, kind: Any) -> int:
    """The size of a type, for which LLVM parses a text."""
    if kind not in _sizes:
        _sizes[kind] = kind.get_abi_size(self.target_data)
    return _sizes[kind]


def _define_everywhere(blocks: Any) -> None:
    """Define all variables in each scope: in one that all blocks share once, not once for each block."""
    used: dict[str, Any] = {}
    for block in blocks.values():
        for statement in block.body:
            for variable in statement.list_vars():
                used.setdefault(variable.name, variable)
    for scope in {id(block.scope): block.scope for block in blocks.values()}.values():
        for name, variable in used.items():
            if name not in scope.localvars:
                scope.localvars.define(name, variable)
