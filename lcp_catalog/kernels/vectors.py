"""Vectors of float32 numbers for kernels, as wide as the processor's registers: the compiler's own
vectorisation of short loops tests in every call whether arrays overlap, and keeps sums in memory.

A vector is a value of the compiled code: `load` and `store` move it from and to places of a
one-dimensional float32 array, `splat` repeats a number, and + - * work number by number; a product and
the sum that uses it may be rounded once (fused). Sums over the numbers of a vector have another order on
processors with wider registers: results differ in their last digits.
"""

from __future__ import annotations

import operator
from typing import Any

import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.core.typing import signature
from numba.core.typing.templates import ConcreteTemplate, infer_global
from numba.extending import intrinsic, lower_builtin, models, register_model

from .cache import njit
from .cpu_level import lanes

LANES = lanes()
"""Numbers of a vector: 8 or 16."""


@njit(nogil=True)
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
        return _repeated(builder, values[0])

    return vector(types.float32), code


@intrinsic
def splat_at(_context: Any, array: Any, place: Any) -> Any:
    """The vector of the number at a place of an array (n,), repeated. Places are not counted from the
    end, as numba's own reading does, which would test the place in every loop.
    """

    def code(context: Any, builder: Any, sig: Any, values: Any) -> Any:
        place = context.cast(builder, values[1], sig.args[1], types.intp)
        data = cgutils.create_struct_proxy(sig.args[0])(context, builder, value=values[0]).data
        return _repeated(builder, builder.load(builder.gep(data, [place])))

    return vector(array, place), code


def _repeated(builder: Any, number: Any) -> Any:
    index = ir.IntType(32)
    one = builder.insert_element(ir.Constant(_VECTOR, ir.Undefined), number, ir.Constant(index, 0))
    pattern = ir.Constant(ir.VectorType(index, LANES), [0] * LANES)
    return builder.shuffle_vector(one, ir.Constant(_VECTOR, ir.Undefined), pattern)


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


@intrinsic
def transpose(
    _context: Any, source: Any, starts: Any, first: Any, factor: Any, out: Any, place: Any
) -> Any:
    """Write the vectors that begin ``first`` places behind `LANES` places of source (n,), times a
    vector, into out (m,) from ``place`` on so that their numbers k stand side by side, number by
    number. starts (LANES,) int64.
    """

    def code(context: Any, builder: Any, sig: Any, values: Any) -> Any:
        source, starts, first, factor, out, place = values
        first = context.cast(builder, first, sig.args[2], types.intp)
        place = context.cast(builder, place, sig.args[5], types.intp)
        data = cgutils.create_struct_proxy(sig.args[1])(context, builder, value=starts).data
        rows = []
        for k in range(LANES):
            at = builder.load(builder.gep(data, [context.get_constant(types.intp, k)]))
            types_, at = (sig.args[0], types.intp), builder.add(at, first)
            rows.append(builder.load(_address(context, builder, types_, (source, at)), align=4))
        half = LANES // 2
        for _ in range(LANES.bit_length() - 1):  # so many perfect shuffles are a transposition
            pairs = [(rows[k], rows[k + half]) for k in range(half)]
            rows = [_interleaved(builder, a, b, first) for a, b in pairs for first in (0, half)]
        for k, row in enumerate(rows):
            at = builder.add(place, context.get_constant(types.intp, k * LANES))
            types_ = (sig.args[4], types.intp)
            product = builder.fmul(row, factor)
            builder.store(product, _address(context, builder, types_, (out, at)), align=4)
        return context.get_dummy_value()

    return types.void(source, starts, first, factor, out, place), code


def _interleaved(builder: Any, one: Any, other: Any, first: int) -> Any:
    """The numbers from ``first`` on of two vectors in turn."""
    turns = [first + k // 2 + k % 2 * LANES for k in range(LANES)]
    pattern = ir.Constant(ir.VectorType(ir.IntType(32), LANES), turns)
    return builder.shuffle_vector(one, other, pattern)


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
    return vector(vector, vector), _selected(">")


@intrinsic
def smaller(_context: Any, _one: Any, _other: Any) -> Any:
    """The smaller one of two vectors' numbers, number by number."""
    return vector(vector, vector), _selected("<")


def _selected(comparison: str) -> Any:
    """The code of `larger` and `smaller`."""

    def code(_: Any, builder: Any, _sig: Any, values: Any) -> Any:
        one, other = values
        return builder.select(builder.fcmp_ordered(comparison, one, other), one, other)

    return code


def _of_library(builder: Any, name: str, values: Any) -> Any:
    """The result of one of LLVM's functions of vectors."""
    form = ir.FunctionType(_VECTOR, [_VECTOR] * len(values))
    name = f"llvm.{name}.v{LANES}f32"
    return builder.call(cgutils.get_or_insert_function(builder.module, form, name), values)


@intrinsic
def magnitude(_context: Any, _vector: Any) -> Any:
    """The absolute values of a vector's numbers."""

    def code(_: Any, builder: Any, _sig: Any, values: Any) -> Any:
        return _of_library(builder, "fabs", values)

    return vector(vector), code


@intrinsic
def rounded(_context: Any, _vector: Any) -> Any:
    """A vector's numbers, rounded to whole ones."""

    def code(_: Any, builder: Any, _sig: Any, values: Any) -> Any:
        return _of_library(builder, "rint", values)

    return vector(vector), code


@intrinsic
def two_to(_context: Any, _vector: Any) -> Any:
    """2 to the power of a vector's numbers, which are whole, from -126 to 127."""

    def code(_: Any, builder: Any, _sig: Any, values: Any) -> Any:
        whole = ir.VectorType(ir.IntType(32), LANES)
        power = builder.fptosi(values[0], whole)
        bits = builder.add(power, ir.Constant(whole, [127] * LANES))
        return builder.bitcast(builder.shl(bits, ir.Constant(whole, [23] * LANES)), _VECTOR)

    return vector(vector), code


@intrinsic
def where_above(_context: Any, _one: Any, _other: Any, _then: Any, _else: Any) -> Any:
    """Numbers of the third vector where those of the first are above those of the second, else of the
    fourth.
    """

    def code(_: Any, builder: Any, _sig: Any, values: Any) -> Any:
        return builder.select(builder.fcmp_ordered(">", *values[:2]), *values[2:])

    return vector(vector, vector, vector, vector), code


@intrinsic
def not_below(_context: Any, _one: Any, _other: Any) -> Any:
    """An integer whose bit k is 1 where number k of the first vector is not below that of the second."""

    def code(_: Any, builder: Any, _sig: Any, values: Any) -> Any:
        bits = builder.bitcast(builder.fcmp_ordered(">=", *values), ir.IntType(LANES))
        return builder.zext(bits, ir.IntType(64))

    return types.int64(vector, vector), code


@intrinsic
def lowest_bit(_context: Any, _bits: Any) -> Any:
    """The number of the lowest bit of an int64 that is 1; 64 if none is."""

    def code(_: Any, builder: Any, _sig: Any, values: Any) -> Any:
        return builder.cttz(values[0], ir.Constant(ir.IntType(1), 0))

    return types.int64(types.int64), code


@njit(nogil=True)
def load_four(array, at, step):
    """The vectors from the places at, at + step, at + 2 step and at + 3 step on."""
    return (
        load(array, at),
        load(array, at + step),
        load(array, at + 2 * step),
        load(array, at + 3 * step),
    )


@njit(nogil=True)
def store_four(out, at, step, a, b, c, d):
    """Write four vectors to the places from at, at + step, at + 2 step and at + 3 step on."""
    store(out, at, a)
    store(out, at + step, b)
    store(out, at + 2 * step, c)
    store(out, at + 3 * step, d)


@njit(nogil=True)
def aligned(count):
    """An array (count,) of float32, not set, at the beginning of a cache line (64 bytes): a vector at a
    multiple of `LANES` lies in one line.
    """
    spare = np.empty(count + 16, np.float32)
    first = -(spare.ctypes.data // 4) % 16
    return spare[first : first + count]
