"""Vectors of eight numbers as values of compiled code: loaded, added and multiplied in one instruction each.

What loops over neighbouring voxels do with them is written out, where a compiler that finds vectors by itself took
twice the time over the 64 taps of a tricubic spline. Numbers are float32, ``Single``, or float64, ``Double``. Arrays
are contiguous, and the caller minds their ends: a vector is always loaded whole.

Intrinsics are functions that numba asks, while it compiles a call of them, for the types and then for the
instructions: the inner function writes the instructions for the values.
"""
# mypy: disable-error-code="no-untyped-def, no-untyped-call, untyped-decorator"

import operator

from llvmlite import ir  # type: ignore[import-untyped]
from numba.core import types
from numba.core.datamodel import models
from numba.extending import intrinsic, overload, register_model

WIDTH = 8
"""Numbers in a vector."""

_BIT, _INT32 = ir.IntType(1), ir.IntType(32)
_INTEGERS = ir.VectorType(_INT32, WIDTH)
_COUNT = ir.Constant(_INTEGERS, list(range(WIDTH)))


class VectorType(types.Type):  # type: ignore[misc]
    """Numba's type of a vector.

    Parameters
    ----------
    name : str
        As numba tells it.
    element : ir.Type
        LLVM's type of its numbers.
    """

    def __init__(self, name, element):
        super().__init__(name=name)
        self.llvm = ir.VectorType(element, WIDTH)


Single = VectorType("Single", ir.FloatType())
Double = VectorType("Double", ir.DoubleType())

_STORED = {types.uint8: ir.IntType(8), types.uint16: ir.IntType(16), types.int16: ir.IntType(16),
           types.float32: ir.FloatType(), types.float64: ir.DoubleType()}


@register_model(VectorType)
class _VectorModel(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, manager, of_type):
        super().__init__(manager, of_type, of_type.llvm)


def _address(context, builder, array_type, array, index):
    """Address of array[index], as that of a vector of what the array holds."""
    data = context.make_array(array_type)(context, builder, array).data
    vector = ir.VectorType(_STORED[array_type.dtype], WIDTH)
    return builder.bitcast(builder.gep(data, [index]), vector.as_pointer())


def _repeat(builder, value, vector):
    """A vector whose numbers are all one value."""
    one = builder.insert_element(ir.Constant(vector, ir.Undefined), value, _INT32(0))
    return builder.shuffle_vector(one, one, ir.Constant(_INTEGERS, [0] * WIDTH))


def _halve(builder, values, n):
    """The first n numbers of a vector, and the n after them."""
    return [builder.shuffle_vector(values, values, ir.Constant(ir.VectorType(_INT32, n), list(range(k, k + n))))
            for k in (0, n)]


@intrinsic
def load(typing_context, array, i):
    """Neighbouring numbers of an array, array[i : i + WIDTH], integers as float32."""
    holds = array.dtype

    def generate(context, builder, signature, arguments):
        values = builder.load(_address(context, builder, signature.args[0], *arguments), align=holds.bitwidth // 8)
        if isinstance(holds, types.Float):
            return values
        return (builder.sitofp if holds.signed else builder.uitofp)(values, Single.llvm)

    return (Double if holds == types.float64 else Single)(array, i), generate


@intrinsic
def store(typing_context, array, i, vector):
    """Set array[i : i + WIDTH] to a vector, whose numbers an array of integers has rounded."""
    holds = array.dtype

    def generate(context, builder, signature, arguments):
        values = arguments[2]
        if isinstance(holds, types.Integer):
            nearest = builder.module.declare_intrinsic(
                f"llvm.rint.v{WIDTH}f32", (), ir.FunctionType(Single.llvm, [Single.llvm]))
            values = builder.fptosi(builder.call(nearest, [values]), ir.VectorType(_STORED[holds], WIDTH))
        address = _address(context, builder, signature.args[0], *arguments[:2])
        builder.store(values, address, align=holds.bitwidth // 8)
        return context.get_dummy_value()

    return types.void(array, i, vector), generate


@intrinsic
def fill(typing_context, value):
    """A vector whose numbers are all one value, as float32."""

    def generate(context, builder, signature, arguments):
        number = context.cast(builder, arguments[0], signature.args[0], types.float32)
        return _repeat(builder, number, Single.llvm)

    return Single(value), generate


@intrinsic
def fill_wide(typing_context, value):
    """A vector whose numbers are all one value, as float64."""

    def generate(context, builder, signature, arguments):
        number = context.cast(builder, arguments[0], signature.args[0], types.float64)
        return _repeat(builder, number, Double.llvm)

    return Double(value), generate


@intrinsic
def count(typing_context):
    """The vector 0, 1, 2 and so on."""
    return Single(), lambda *_: ir.Constant(Single.llvm, [float(k) for k in range(WIDTH)])


@intrinsic
def mark_first(typing_context, n):
    """A vector of n ones, and zeros after them."""

    def generate(context, builder, signature, arguments):
        end = _repeat(builder, builder.trunc(arguments[0], _INT32), _INTEGERS)
        is_before = builder.icmp_signed("<", _COUNT, end)
        return builder.uitofp(is_before, Single.llvm)

    return Single(types.int64), generate


@intrinsic
def widen(typing_context, vector):
    """The same numbers as float64."""
    return Double(vector), lambda context, builder, signature, arguments: builder.fpext(arguments[0], Double.llvm)


@intrinsic
def sum_lanes(typing_context, vector):
    """Sum of a vector's numbers: halves are added until one number is left."""

    def generate(context, builder, signature, arguments):
        values, n = arguments[0], WIDTH
        while n > 1:
            n //= 2
            values = builder.fadd(*_halve(builder, values, n))
        return builder.extract_element(values, _INT32(0))

    return (types.float64 if vector is Double else types.float32)(vector), generate


@intrinsic
def take_first(typing_context, vector):
    """First number of a vector."""
    return types.float32(vector), lambda context, builder, signature, arguments: builder.extract_element(
        arguments[0], _INT32(0))


@intrinsic
def round_down(typing_context, vector):
    """Largest whole numbers that are not above a vector's."""

    def generate(context, builder, signature, arguments):
        floor = builder.module.declare_intrinsic(
            f"llvm.floor.v{WIDTH}f32", (), ir.FunctionType(Single.llvm, [Single.llvm]))
        return builder.call(floor, arguments)

    return Single(vector), generate


@intrinsic
def count_equal(typing_context, one, other):
    """How many numbers of two vectors are equal, from the first one on."""

    def generate(context, builder, signature, arguments):
        differs = builder.bitcast(builder.fcmp_unordered("!=", *arguments), ir.IntType(WIDTH))
        first = builder.cttz(builder.zext(differs, ir.IntType(64)), _BIT(0))
        end = ir.IntType(64)(WIDTH)
        return builder.select(builder.icmp_unsigned("<", first, end), first, end)

    return types.int64(one, other), generate


def _define(operation, instruction):
    """Let an operation between vectors of one type be one instruction."""

    @intrinsic
    def calculate(typing_context, one, other):
        return one(one, other), lambda context, builder, signature, arguments: getattr(builder, instruction)(
            *arguments, flags=("contract", "nsz", "arcp"))

    @overload(operation)
    def choose(one, other):
        # A function of Python's, since numba compiles what comes back.
        if isinstance(one, VectorType) and one == other:
            return lambda one, other: calculate(one, other)  # noqa: PLW0108
        return None


for _operation, _instruction in ((operator.add, "fadd"), (operator.sub, "fsub"), (operator.mul, "fmul"),
                                 (operator.truediv, "fdiv")):
    _define(_operation, _instruction)
