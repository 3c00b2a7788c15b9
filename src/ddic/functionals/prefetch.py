"""Ask the processor for a cache line before it is needed."""

from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]
from numba.core import types
from numba.extending import intrinsic

_READ, _SECOND_LEVEL, _DATA = 0, 2, 1
"""llvm.prefetch's arguments. Rows of a cell at a stride of 2^k bytes share one set of the first-level cache,
and would drive each other out of it."""


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
