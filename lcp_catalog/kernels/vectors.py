"""Vectors of eight float32 numbers for kernels: the compiler's own vectorisation of short loops tests
in every call whether arrays overlap, and keeps sums in memory.

A vector is a value of the compiled code: `load` and `store` move it from and to places of a
one-dimensional float32 array, `splat` repeats a number, and + - * work number by number; a product and
the sum that uses it may be rounded once (fused). Processors without such wide registers use
several.
"""

from __future__ import annotations

import operator
from typing import Any

from llvmlite import ir
from numba import njit
from numba.core import cgutils, types
from numba.core.typing import signature
from numba.core.typing.templates import ConcreteTemplate, infer_global
from numba.extending import intrinsic, lower_builtin, models, register_model

LANES = 8
"""Numbers of a vector."""


@njit(cache=True, nogil=True)
def multiple(count, of):
    """The least multiple of ``of`` that is not below count."""
    return (count + of - 1) // of * of


_VECTOR = ir.VectorType(ir.FloatType(), LANES)
_FUSED = ("contract",)


class Vector(types.Type):
    """The type of a vector in compiled code."""

    def __init__(self) -> None:
        super().__init__(name=f"Vector{LANES}")


vector = Vector()


@register_model(Vector)
class _Model(models.PrimitiveModel):
    def __init__(self, manager: Any, of: Any) -> None:
        super().__init__(manager, of, _VECTOR)


def _address(context: Any, builder: Any, types_: Any, values: Any) -> Any:
    """Pointer to a vector at a place of an array; types and values of (array, place)."""
    place = context.cast(builder, values[1], types_[1], types.intp)
    data = cgutils.create_struct_proxy(types_[0])(context, builder, value=values[0]).data
    return builder.bitcast(builder.gep(data, [place]), _VECTOR.as_pointer())


@intrinsic
def load(_context: Any, array: Any, place: Any) -> Any:
    """The vector of the numbers from ``place`` on; array (n,) float32, contiguous."""

    def code(context: Any, builder: Any, sig: Any, values: Any) -> Any:
        found = builder.load(_address(context, builder, sig.args, values))
        found.align = 4
        return found

    return vector(array, place), code


@intrinsic
def store(_context: Any, array: Any, place: Any, value: Any) -> Any:
    """Write a vector to the places from ``place`` on; array (n,) float32, contiguous."""

    def code(context: Any, builder: Any, sig: Any, values: Any) -> Any:
        builder.store(values[2], _address(context, builder, sig.args, values), align=4)
        return context.get_dummy_value()

    return types.void(array, place, value), code


@intrinsic
def splat(_context: Any, _number: Any) -> Any:
    """The vector of a float32 number, repeated."""

    def code(_: Any, builder: Any, _sig: Any, values: Any) -> Any:
        empty = ir.Constant(_VECTOR, ir.Undefined)
        index = ir.IntType(32)
        one = builder.insert_element(empty, values[0], ir.Constant(index, 0))
        return builder.shuffle_vector(
            one, empty, ir.Constant(ir.VectorType(index, LANES), [0] * LANES)
        )

    return vector(types.float32), code


def _operation(symbol: Any, name: str) -> None:
    """Let an operator of two vectors be an instruction."""

    class Template(ConcreteTemplate):
        cases = (signature(vector, vector, vector),)

    infer_global(symbol)(Template)

    @lower_builtin(symbol, Vector, Vector)
    def code(_context: Any, builder: Any, _sig: Any, values: Any) -> Any:
        return getattr(builder, name)(*values, flags=_FUSED)


for _symbol, _name in ((operator.add, "fadd"), (operator.sub, "fsub"), (operator.mul, "fmul")):
    _operation(_symbol, _name)


def _interleaved(first: int) -> Any:
    """The code of `low` and `high`: numbers from ``first`` on of two vectors, in turn."""
    turns = [first + k // 2 + k % 2 * LANES for k in range(LANES)]
    pattern = ir.Constant(ir.VectorType(ir.IntType(32), LANES), turns)

    def code(_: Any, builder: Any, _sig: Any, values: Any) -> Any:
        return builder.shuffle_vector(*values, pattern)

    return code


@intrinsic
def low(_context: Any, _one: Any, _other: Any) -> Any:
    """The first halves of two vectors, number by number in turn."""
    return vector(vector, vector), _interleaved(0)


@intrinsic
def high(_context: Any, _one: Any, _other: Any) -> Any:
    """The second halves of two vectors, number by number in turn."""
    return vector(vector, vector), _interleaved(LANES // 2)


@intrinsic
def total(_context: Any, _vector: Any) -> Any:
    """The sum of a vector's numbers, float32."""

    def code(_: Any, builder: Any, _sig: Any, values: Any) -> Any:
        name = f"llvm.vector.reduce.fadd.v{LANES}f32"
        form = ir.FunctionType(ir.FloatType(), [ir.FloatType(), _VECTOR])
        function = cgutils.get_or_insert_function(builder.module, form, name)
        zero = ir.Constant(ir.FloatType(), 0.0)
        return builder.call(function, [zero, values[0]], fastmath=("reassoc",))

    return types.float32(vector), code


@intrinsic
def larger(_context: Any, _one: Any, _other: Any) -> Any:
    """The larger one of two vectors' numbers, number by number."""

    def code(_: Any, builder: Any, _sig: Any, values: Any) -> Any:
        return builder.select(builder.fcmp_ordered(">", *values), *values)

    return vector(vector, vector), code


@intrinsic
def not_below(_context: Any, _one: Any, _other: Any) -> Any:
    """An integer whose bit k is 1 where number k of the first vector is not below that of the second."""

    def code(_: Any, builder: Any, _sig: Any, values: Any) -> Any:
        bits = builder.bitcast(builder.fcmp_ordered(">=", *values), ir.IntType(LANES))
        return builder.zext(bits, ir.IntType(64))

    return types.int64(vector, vector), code


@njit(cache=True, nogil=True)
def load_four(array, at, step):
    """The vectors from the places at, at + step, at + 2 step and at + 3 step on."""
    return (
        load(array, at),
        load(array, at + step),
        load(array, at + 2 * step),
        load(array, at + 3 * step),
    )


@njit(cache=True, nogil=True)
def store_four(out, at, step, a, b, c, d):
    """Write four vectors to the places from at, at + step, at + 2 step and at + 3 step on."""
    store(out, at, a)
    store(out, at + step, b)
    store(out, at + 2 * step, c)
    store(out, at + 3 * step, d)
