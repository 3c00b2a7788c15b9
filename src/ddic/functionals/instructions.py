"""Instructions that numba does not offer: the widest vector written at once, a cache line asked for before its time.

A vector stands for what a loop would do after a test of overlap for every row of pixels.

Intrinsics are functions that numba asks, while it compiles a call of them, for the types and then for the
instructions: the function below a docstring takes types, ``generate`` writes the instructions for the values.
Vectors are float32, and what they are copied from is float32 or uint8. Arrays are contiguous, and the caller minds
their ends.
"""

from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]
from numba.core import cgutils, types
from numba.extending import intrinsic

WIDTH = 16
"""float32 numbers in the widest vector."""

_VECTOR = ir.VectorType(ir.FloatType(), WIDTH)
_BYTES = ir.VectorType(ir.IntType(8), WIDTH)
_ALIGNMENT = 4
_STEPS = ir.Constant(_VECTOR, [float(k) for k in range(WIDTH)])

_READ, _SECOND_LEVEL, _DATA = 0, 2, 1
"""llvm.prefetch's arguments. Rows of a cell at a stride of 2^k bytes share one set of the first-level cache,
and would drive each other out of it."""


def _address(context: Any, builder: Any, array_type: Any, array: Any, index: Any) -> Any:
    """Address of array[index], as that of a vector."""
    data = context.make_array(array_type)(context, builder, array).data
    first = builder.gep(data, [index])
    return builder.bitcast(first, _vector_type(array_type).as_pointer())


def _vector_type(array_type: Any) -> Any:
    """Type of as many neighbouring numbers of an array as a vector has."""
    return _BYTES if array_type.dtype == types.uint8 else _VECTOR


def _load(builder: Any, address: Any) -> Any:
    """The numbers at the address of a vector, as float32."""
    if address.type.pointee == _BYTES:
        return builder.uitofp(builder.load(address, align=1), _VECTOR)
    return builder.load(address, align=_ALIGNMENT)


def _splat(builder: Any, value: Any) -> Any:
    """A vector whose numbers are all one value."""
    undefined = ir.Constant(_VECTOR, ir.Undefined)
    one = builder.insert_element(undefined, value, ir.IntType(32)(0))
    all_from_first = ir.Constant(ir.VectorType(ir.IntType(32), WIDTH), [0] * WIDTH)
    return builder.shuffle_vector(one, undefined, all_from_first)


def _write(context: Any, builder: Any, signature: Any, arguments: Any, values: Any) -> Any:
    """Write a vector to the array and the index that an instruction's arguments begin with."""
    builder.store(values, _address(context, builder, signature.args[0], *arguments[:2]), align=_ALIGNMENT)
    return context.get_dummy_value()


@intrinsic  # type: ignore[untyped-decorator]
def copy_vector(typing_context: Any, to: Any, j: Any, source: Any, i: Any) -> Any:
    """Copy source[i : i + WIDTH] to to[j : j + WIDTH]."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        values = _load(builder, _address(context, builder, signature.args[2], *arguments[2:]))
        return _write(context, builder, signature, arguments, values)

    return types.void(to, j, source, i), generate


@intrinsic  # type: ignore[untyped-decorator]
def copy_some(typing_context: Any, to: Any, j: Any, source: Any, i: Any, n: Any) -> Any:
    """Copy source[i : i + n] to to[j : j + n], and zeros to the rest of a vector: a call, where a loop is unrolled."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        source_type = signature.args[2]
        source_array, source_index, count = arguments[2:]
        held = cgutils.alloca_once(builder, _vector_type(source_type))
        builder.store(ir.Constant(held.type.pointee, None), held)
        bytes_ = ir.IntType(8).as_pointer()
        held_bytes = builder.bitcast(held, bytes_)
        source_bytes = builder.bitcast(_address(context, builder, source_type, source_array, source_index), bytes_)
        size = builder.mul(count, ir.IntType(64)(source_type.dtype.bitwidth // 8))
        copy = builder.module.declare_intrinsic("llvm.memcpy", [bytes_, bytes_, ir.IntType(64)])
        is_volatile = ir.IntType(1)(0)
        builder.call(copy, [held_bytes, source_bytes, size, is_volatile])
        return _write(context, builder, signature, arguments, _load(builder, held))

    return types.void(to, j, source, i, types.int64), generate


@intrinsic  # type: ignore[untyped-decorator]
def fill_vector(typing_context: Any, to: Any, j: Any, value: Any) -> Any:
    """Set to[j : j + WIDTH] to one value."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return _write(context, builder, signature, arguments, _splat(builder, arguments[2]))

    return types.void(to, j, types.float32), generate


@intrinsic  # type: ignore[untyped-decorator]
def count_vector(typing_context: Any, to: Any, j: Any, value: Any) -> Any:
    """Set to[j : j + WIDTH] to value, value + 1, and so on."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        values = builder.fadd(_splat(builder, arguments[2]), _STEPS)
        return _write(context, builder, signature, arguments, values)

    return types.void(to, j, types.float32), generate


@intrinsic  # type: ignore[untyped-decorator]
def prefetch(typing_context: Any, array: Any, index: Any) -> Any:
    """Fetch array[index] into the second-level cache; an index beyond a contiguous array's ends does no harm."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        data = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        address = builder.gep(data, [arguments[1]])
        int32 = ir.IntType(32)
        kind = ir.FunctionType(ir.VoidType(), [address.type, int32, int32, int32])
        function = builder.module.declare_intrinsic("llvm.prefetch", [address.type], kind)
        builder.call(function, [address, int32(_READ), int32(_SECOND_LEVEL), int32(_DATA)])
        return context.get_dummy_value()

    return types.void(array, index), generate
