"""Eight float64 problems side by side: one Numba value that LLVM keeps in vector registers.

``Vec`` is ``<8 x double>``, ``Mask`` is ``<8 x i1>``. Kernels written with them do the same arithmetic in every
lane by construction, which a loop left to the auto-vectoriser does not promise, and need no fast-math flag but
``contract`` (a multiply and an add may become one fused instruction, in all lanes alike). On a machine with shorter
registers LLVM splits a vector into several.

Inside kernels: ``+ - * /`` and comparisons between vectors and floats, ``& | ~`` between masks, and the functions
below. All memory is one-dimensional, contiguous and float64; offsets count elements. Where an array is allowed, so is
its `pointer`.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.core import cgutils
from numba.core.typing.templates import ConcreteTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, models, register_model

W = 8  # lanes
NO_LANES: Any = np.int64(0)  # an empty set of lanes; the literal 0 is another type, and Numba compiles for both

_F64 = ir.DoubleType()
_I64 = ir.IntType(64)
_VEC = ir.VectorType(_F64, W)
_BITS = ir.VectorType(_I64, W)
_MASK = ir.VectorType(ir.IntType(1), W)
_FUSE = ("contract",)


class _VecType(types.Type):
    def __init__(self) -> None:
        super().__init__(name="Vec")


class _MaskType(types.Type):
    def __init__(self) -> None:
        super().__init__(name="Mask")


Vec, Mask = _VecType(), _MaskType()


@register_model(_VecType)
class _VecModel(models.PrimitiveModel):
    def __init__(self, dmm: Any, fe_type: Any) -> None:
        super().__init__(dmm, fe_type, _VEC)


@register_model(_MaskType)
class _MaskModel(models.PrimitiveModel):
    def __init__(self, dmm: Any, fe_type: Any) -> None:
        super().__init__(dmm, fe_type, _MASK)


def _intrinsic(make: Any) -> Any:
    """Numba's decorator, untyped: callers do not pass its first argument."""
    return intrinsic(make)


def _splat(builder: Any, x: Any) -> Any:
    """The same scalar in every lane; vectors pass unchanged."""
    if isinstance(x.type, ir.VectorType):
        return x
    one = builder.insert_element(ir.Constant(_VEC, ir.Undefined), x, ir.Constant(ir.IntType(32), 0))
    zeros = ir.Constant(ir.VectorType(ir.IntType(32), W), [0] * W)
    return builder.shuffle_vector(one, ir.Constant(_VEC, ir.Undefined), zeros)


def _operator(op: Any, result: Any, emit: Callable[..., Any]) -> None:
    """Teach Numba a binary operator on Vec x Vec, Vec x float and float x Vec."""
    pairs = [(Vec, Vec), (Vec, types.float64), (types.float64, Vec)]

    class Template(ConcreteTemplate):
        cases = [signature(result, a, b) for a, b in pairs]  # noqa: RUF012

    infer_global(op)(Template)

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return emit(builder, _splat(builder, args[0]), _splat(builder, args[1]))

    for a, b in pairs:
        lower_builtin(op, a, b)(lower)


_operator(operator.add, Vec, lambda b, x, y: b.fadd(x, y, flags=_FUSE))
_operator(operator.sub, Vec, lambda b, x, y: b.fsub(x, y, flags=_FUSE))
_operator(operator.mul, Vec, lambda b, x, y: b.fmul(x, y, flags=_FUSE))
_operator(operator.truediv, Vec, lambda b, x, y: b.fdiv(x, y))
_operator(operator.lt, Mask, lambda b, x, y: b.fcmp_ordered("<", x, y))
_operator(operator.le, Mask, lambda b, x, y: b.fcmp_ordered("<=", x, y))
_operator(operator.gt, Mask, lambda b, x, y: b.fcmp_ordered(">", x, y))
_operator(operator.ge, Mask, lambda b, x, y: b.fcmp_ordered(">=", x, y))
_operator(operator.eq, Mask, lambda b, x, y: b.fcmp_ordered("==", x, y))


@infer_global(operator.and_)
class _And(ConcreteTemplate):
    cases = [signature(Mask, Mask, Mask)]  # noqa: RUF012


@infer_global(operator.or_)
class _Or(ConcreteTemplate):
    cases = [signature(Mask, Mask, Mask)]  # noqa: RUF012


@infer_global(operator.invert)
class _Invert(ConcreteTemplate):
    cases = [signature(Mask, Mask)]  # noqa: RUF012


@infer_global(operator.neg)
class _Neg(ConcreteTemplate):
    cases = [signature(Vec, Vec)]  # noqa: RUF012


lower_builtin(operator.and_, Mask, Mask)(lambda c, b, sig, args: b.and_(*args))
lower_builtin(operator.or_, Mask, Mask)(lambda c, b, sig, args: b.or_(*args))
lower_builtin(operator.invert, Mask)(lambda c, b, sig, args: b.not_(args[0]))
lower_builtin(operator.neg, Vec)(lambda c, b, sig, args: b.fneg(args[0]))


def _pointer(context: Any, builder: Any, array_type: Any, array: Any, offset: Any, kind: Any) -> Any:
    is_pointer = isinstance(array_type, types.CPointer)
    data = array if is_pointer else context.make_array(array_type)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [offset]), kind.as_pointer())


@_intrinsic
def splat(typingctx, x):  # type: ignore[no-untyped-def]
    """Vec with the float ``x`` in every lane."""
    return Vec(types.float64), lambda c, b, sig, args: _splat(b, args[0])


@_intrinsic
def pointer(typingctx, array):  # type: ignore[no-untyped-def]
    """Where an array's elements are, for `load` and `store` in inlined functions with branches.

    Numba counts references to an array where it is handed on, and behind a branch it fails to leave that out again: two
    atomic operations an access. A pointer is not counted; the caller's caller keeps the array alive.
    """

    def codegen(context, builder, sig, args):  # type: ignore[no-untyped-def]
        return context.make_array(sig.args[0])(context, builder, args[0]).data

    return types.CPointer(array.dtype)(array), codegen


@_intrinsic
def ahead(typingctx, memory, count):  # type: ignore[no-untyped-def]
    """The pointer ``count`` elements on."""
    return memory(memory, types.int64), lambda c, b, sig, args: b.gep(args[0], [args[1]])


@_intrinsic
def peek(typingctx, memory, offset):  # type: ignore[no-untyped-def]
    """One element behind a pointer."""

    def codegen(context, builder, sig, args):  # type: ignore[no-untyped-def]
        return builder.load(builder.gep(args[0], [args[1]]))

    return memory.dtype(memory, types.int64), codegen


@_intrinsic
def load(typingctx, array, offset):  # type: ignore[no-untyped-def]
    """Vec from eight neighbours in memory, starting at element ``offset``."""

    def codegen(context, builder, sig, args):  # type: ignore[no-untyped-def]
        pointer = _pointer(context, builder, sig.args[0], args[0], args[1], _VEC)
        return builder.load(pointer, align=8)

    return Vec(array, types.int64), codegen


@_intrinsic
def store(typingctx, array, offset, value):  # type: ignore[no-untyped-def]
    """Write a Vec to eight neighbours in memory, starting at element ``offset``."""

    def codegen(context, builder, sig, args):  # type: ignore[no-untyped-def]
        pointer = _pointer(context, builder, sig.args[0], args[0], args[1], _VEC)
        builder.store(args[2], pointer, align=8)
        return context.get_dummy_value()

    return types.void(array, types.int64, Vec), codegen


@_intrinsic
def load_single(typingctx, array, offset):  # type: ignore[no-untyped-def]
    """Vec from eight float32 neighbours in memory."""

    def codegen(context, builder, sig, args):  # type: ignore[no-untyped-def]
        singles = ir.VectorType(ir.FloatType(), W)
        pointer = _pointer(context, builder, sig.args[0], args[0], args[1], singles)
        return builder.fpext(builder.load(pointer, align=4), _VEC)

    return Vec(array, types.int64), codegen


@_intrinsic
def load_column(typingctx, array, offset, stride):  # type: ignore[no-untyped-def]
    """Vec whose lane i is element ``offset + i * stride``: one column of eight rows."""

    def codegen(context, builder, sig, args):  # type: ignore[no-untyped-def]
        value = ir.Constant(_VEC, ir.Undefined)
        index = args[1]
        for i in range(W):
            pointer = _pointer(context, builder, sig.args[0], args[0], index, _F64)
            value = builder.insert_element(value, builder.load(pointer), ir.Constant(ir.IntType(32), i))
            index = builder.add(index, args[2])
        return value

    return Vec(array, types.int64, types.int64), codegen


@_intrinsic
def load_rows(typingctx, array, rows, offset):  # type: ignore[no-untyped-def]
    """Vec whose lane i is element ``rows[i] + offset``, with ``rows`` an int64 array: one column of any eight rows."""

    def codegen(context, builder, sig, args):  # type: ignore[no-untyped-def]
        value = ir.Constant(_VEC, ir.Undefined)
        for i in range(W):
            row = builder.load(_pointer(context, builder, sig.args[1], args[1], ir.Constant(_I64, i), _I64))
            pointer = _pointer(context, builder, sig.args[0], args[0], builder.add(row, args[2]), _F64)
            value = builder.insert_element(value, builder.load(pointer), ir.Constant(ir.IntType(32), i))
        return value

    return Vec(array, rows, types.int64), codegen


@_intrinsic
def transpose(typingctx, rows):  # type: ignore[no-untyped-def]
    """Eight Vecs as the rows of an 8 x 8 matrix -> its columns, by 24 shuffles in registers."""

    def shuffle(builder, a, b, block):  # type: ignore[no-untyped-def]
        low, high = [], []
        for i in range(0, W, 2 * block):
            low += [*range(i, i + block), *range(W + i, W + i + block)]
            high += [*range(i + block, i + 2 * block), *range(W + i + block, W + i + 2 * block)]
        kind = ir.VectorType(ir.IntType(32), W)
        return [builder.shuffle_vector(a, b, ir.Constant(kind, index)) for index in (low, high)]

    def codegen(context, builder, sig, args):  # type: ignore[no-untyped-def]
        v = [builder.extract_value(args[0], i) for i in range(W)]
        for block in (1, 2, 4):
            for i in range(W):
                if not i & block:
                    v[i], v[i + block] = shuffle(builder, v[i], v[i + block], block)
        return cgutils.pack_array(builder, v)

    rows_type = types.UniTuple(Vec, W)
    return rows_type(rows_type), codegen


@_intrinsic
def select(typingctx, mask, a, b):  # type: ignore[no-untyped-def]
    """Lane by lane ``a if mask else b``; a and b may be floats."""

    def codegen(context, builder, sig, args):  # type: ignore[no-untyped-def]
        return builder.select(args[0], _splat(builder, args[1]), _splat(builder, args[2]))

    return Vec(Mask, a, b), codegen


def _unary(name: str) -> Callable[..., Any]:
    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        kind = ir.FunctionType(_VEC, [_VEC])
        return builder.call(cgutils.get_or_insert_function(builder.module, kind, f"{name}.v{W}f64"), args)

    return codegen


@_intrinsic
def sqrt(typingctx, x):  # type: ignore[no-untyped-def]
    """Square root of each lane."""
    return Vec(Vec), _unary("llvm.sqrt")


@_intrinsic
def fabs(typingctx, x):  # type: ignore[no-untyped-def]
    """Absolute value of each lane."""
    return Vec(Vec), _unary("llvm.fabs")


@_intrinsic
def floor(typingctx, x):  # type: ignore[no-untyped-def]
    """Largest integer at or below each lane."""
    return Vec(Vec), _unary("llvm.floor")


@_intrinsic
def lowest(typingctx, x):  # type: ignore[no-untyped-def]
    """The lane with the smallest number, the first of several; 8 if all are NaN."""

    def codegen(context, builder, sig, args):  # type: ignore[no-untyped-def]
        kind = ir.FunctionType(_F64, [_VEC])
        reduce = cgutils.get_or_insert_function(builder.module, kind, f"llvm.vector.reduce.fmin.v{W}f64")
        least = builder.fcmp_ordered("==", args[0], _splat(builder, builder.call(reduce, args)))
        found = builder.zext(builder.bitcast(least, ir.IntType(W)), _I64)
        return builder.cttz(builder.or_(found, ir.Constant(_I64, 1 << W)), ir.Constant(ir.IntType(1), 0))

    return types.int64(Vec), codegen


@_intrinsic
def bits(typingctx, mask):  # type: ignore[no-untyped-def]
    """Mask as an integer, lane i in bit i."""

    def codegen(context, builder, sig, args):  # type: ignore[no-untyped-def]
        return builder.zext(builder.bitcast(args[0], ir.IntType(W)), _I64)

    return types.int64(Mask), codegen


@_intrinsic
def mask_of(typingctx, value):  # type: ignore[no-untyped-def]
    """Mask from an integer, the inverse of `bits`."""

    def codegen(context, builder, sig, args):  # type: ignore[no-untyped-def]
        return builder.bitcast(builder.trunc(args[0], ir.IntType(W)), _MASK)

    return Mask(types.int64), codegen


@_intrinsic
def has_bit(typingctx, x, position):  # type: ignore[no-untyped-def]
    """Mask of the lanes whose float64 bit pattern has this bit set."""

    def codegen(context, builder, sig, args):  # type: ignore[no-untyped-def]
        one = builder.shl(ir.Constant(_I64, 1), args[1])
        first = builder.insert_element(ir.Constant(_BITS, ir.Undefined), one, ir.Constant(ir.IntType(32), 0))
        zeros = ir.Constant(ir.VectorType(ir.IntType(32), W), [0] * W)
        wanted = builder.shuffle_vector(first, ir.Constant(_BITS, ir.Undefined), zeros)
        found = builder.and_(builder.bitcast(args[0], _BITS), wanted)
        return builder.icmp_unsigned("!=", found, ir.Constant(_BITS, [0] * W))

    return Mask(Vec, types.int64), codegen


@_intrinsic
def power_of_two(typingctx, x):  # type: ignore[no-untyped-def]
    """2^k of each lane, where the low eleven bits of the lane's pattern hold k + 1023; 0 and infinity at the ends."""

    def codegen(context, builder, sig, args):  # type: ignore[no-untyped-def]
        by = ir.Constant(_BITS, [52] * W)
        return builder.bitcast(builder.shl(builder.bitcast(args[0], _BITS), by), _VEC)

    return Vec(Vec), codegen


@_intrinsic
def get_lane(typingctx, x, lane):  # type: ignore[no-untyped-def]
    """The float in one lane."""
    return types.float64(Vec, types.int64), lambda c, b, sig, args: b.extract_element(args[0], args[1])


@_intrinsic
def set_lane(typingctx, x, lane, value):  # type: ignore[no-untyped-def]
    """``x`` with another float in one lane."""

    def codegen(context, builder, sig, args):  # type: ignore[no-untyped-def]
        return builder.insert_element(args[0], args[2], args[1])

    return Vec(Vec, types.int64, types.float64), codegen
