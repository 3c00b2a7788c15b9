"""Write the widest vector of float32 at once: what a loop would do after a test of overlap for every row of pixels."""

from __future__ import annotations

from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]
from numba.core import types
from numba.extending import intrinsic

WIDTH = 16
"""float32 numbers in the widest vector."""

_VECTOR = ir.VectorType(ir.FloatType(), WIDTH)
_ALIGNMENT = 4
_STEPS = ir.Constant(_VECTOR, [float(k) for k in range(WIDTH)])


def _address(context: Any, builder: Any, array_type: Any, array: Any, index: Any) -> Any:
    data = context.make_array(array_type)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [index]), _VECTOR.as_pointer())


def _splat(builder: Any, value: Any) -> Any:
    lanes = ir.Constant(ir.VectorType(ir.IntType(32), WIDTH), [0] * WIDTH)
    one = builder.insert_element(ir.Constant(_VECTOR, ir.Undefined), value, ir.IntType(32)(0))
    return builder.shuffle_vector(one, ir.Constant(_VECTOR, ir.Undefined), lanes)


@intrinsic  # type: ignore[untyped-decorator]
def copy_vector(typing_context: Any, to: Any, j: Any, source: Any, i: Any) -> Any:
    """Copy source[i : i + WIDTH] to to[j : j + WIDTH], float32, contiguous; the caller minds their ends."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        to_type, _, source_type, _ = signature.args
        values = builder.load(_address(context, builder, source_type, arguments[2], arguments[3]), align=_ALIGNMENT)
        builder.store(values, _address(context, builder, to_type, arguments[0], arguments[1]), align=_ALIGNMENT)
        return context.get_dummy_value()

    return types.void(to, j, source, i), generate


@intrinsic  # type: ignore[untyped-decorator]
def copy_some(typing_context: Any, to: Any, j: Any, source: Any, i: Any, n: Any) -> Any:
    """Copy source[i : i + n] to to[j : j + n], float32, contiguous and apart: a call, where a loop is unrolled."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        to_type, _, source_type, _, _ = signature.args
        bytes_ = ir.IntType(8).as_pointer()
        ends = [builder.bitcast(_address(context, builder, *end), bytes_)
                for end in ((to_type, arguments[0], arguments[1]), (source_type, arguments[2], arguments[3]))]
        size = builder.mul(arguments[4], ir.IntType(64)(4))
        copy = builder.module.declare_intrinsic("llvm.memcpy", [bytes_, bytes_, ir.IntType(64)])
        builder.call(copy, [*ends, size, ir.IntType(1)(0)])
        return context.get_dummy_value()

    return types.void(to, j, source, i, types.int64), generate


@intrinsic  # type: ignore[untyped-decorator]
def fill_vector(typing_context: Any, to: Any, j: Any, value: Any) -> Any:
    """Set to[j : j + WIDTH], float32, contiguous, to a float32 value; the caller minds its end."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        values = _splat(builder, arguments[2])
        builder.store(values, _address(context, builder, signature.args[0], *arguments[:2]), align=_ALIGNMENT)
        return context.get_dummy_value()

    return types.void(to, j, types.float32), generate


@intrinsic  # type: ignore[untyped-decorator]
def count_vector(typing_context: Any, to: Any, j: Any, value: Any) -> Any:
    """Set to[j : j + WIDTH], float32, contiguous, to value, value + 1, and so on; the caller minds its end."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        values = builder.fadd(_splat(builder, arguments[2]), _STEPS)
        builder.store(values, _address(context, builder, signature.args[0], *arguments[:2]), align=_ALIGNMENT)
        return context.get_dummy_value()

    return types.void(to, j, types.float32), generate
