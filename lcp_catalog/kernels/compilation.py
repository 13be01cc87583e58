"""How numba compiles kernels. By itself it optimises every function that a kernel calls, makes machine code of it, with
entries for Python and for C, and does the same with the kernel, into which the functions are linked: twice the time.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

import llvmlite.binding as llvm
from llvmlite import ir
from numba.core import cgutils
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.cpu import CPUContext
from numba.extending import overload

from .shortcuts import replaced, shortcuts


def _raise_of_shapes(source: Any, target: Any) -> None:
    """Stands for numba's function of this purpose, whose message of both shapes takes seconds to compile."""


@overload(_raise_of_shapes)
def _(source: Any, target: Any) -> Any:
    def code(source: Any, target: Any) -> None:
        raise ValueError("an array does not fit where it is assigned")

    return code


class _PartLibrary(JITCodeLibrary):
    """Code that is only linked into that of kernels: optimised and made machine code there, not alone as well."""

    def _optimize_final_module(self) -> None:
        cheap = {"loop_vectorize": False, "slp_vectorize": False, "opt": 0, "cost": "cheap"}
        passes, builder = self._codegen._module_pass_manager(**cheap)
        passes.run(self._final_module, builder)

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        """0: there is no machine code."""
        self._ensure_finalized()
        return 0

    @property
    def codegen(self) -> Any:
        """For `set_env`, which numba asks of it."""
        return self

    def set_env(self, name: str, env: Any) -> None:
        """Make the variable of this name, with which linked code finds its environment."""
        _set_environments(self._codegen, {name: env})

    def serialize_using_object_code(self) -> tuple[str, str, bytes]:
        """What a file keeps: LLVM's code."""
        return self.name, "bitcode", self._get_module_for_linking().as_bitcode()


def _set_environments(codegen: Any, environments: dict[str, Any]) -> None:
    """Make variables in one module: LLVM searches all modules that it has for each that is added."""
    module = codegen._create_empty_module("environments")
    for name in environments:
        place = ir.GlobalVariable(module, cgutils.voidptr_t, name)
        place.linkage, place.initializer = "common", cgutils.get_null_value(cgutils.voidptr_t)
    codegen._engine.add_module(llvm.parse_assembly(str(module)))
    codegen._engine.finalize_object()
    for name, env in environments.items():
        codegen.set_env(name, env)


_python_entry = CPUContext.create_cpython_wrapper


def _entry_of_kernel(self: Any, library: Any, *others: Any, **options: Any) -> None:
    if not isinstance(library, _PartLibrary):
        _python_entry(self, library, *others, **options)


def _no_entry(*_: Any) -> None:
    """Stands for the entry of a function for C."""


def only_parts(context: Any) -> Any:
    """In the block numba makes, or reads from files, parts."""
    return replaced(context.codegen(), "_library_class", _PartLibrary)


class KernelCompiler(Compiler):
    """Compiles a kernel for Python. What it needs on the way, from loops' bodies to numba's own functions, is parts."""

    def __init__(self, typing: Any, target: Any, library: Any, *others: Any) -> None:
        library = target.codegen().create_library("kernel")
        library.enable_object_caching()
        super().__init__(typing, target, library, *others)

    def compile_extra(self, function: Any) -> Any:
        """numba's result."""
        arrayobj = import_module("numba.np.arrayobj")  # 0.1 s, which kernels of files do not need
        parts: dict[str, Any] = {}
        with (
            only_parts(self.state.targetctx),
            shortcuts(),
            replaced(arrayobj, "raise_with_shape_context", _raise_of_shapes),
            replaced(CPUContext, "create_cpython_wrapper", _entry_of_kernel),
            replaced(CPUContext, "create_cfunc_wrapper", _no_entry),
            replaced(_PartLibrary, "set_env", lambda _, name, env: parts.update({name: env})),
        ):
            try:
                return super().compile_extra(function)
            finally:
                _set_environments(self.state.targetctx.codegen(), parts)


class PartCompiler(Compiler):
    """Compiles a kernel for other kernels."""

    def __init__(self, typing: Any, target: Any, library: Any, *others: Any) -> None:
        super().__init__(typing, target, _PartLibrary(target.codegen(), "part"), *others)
