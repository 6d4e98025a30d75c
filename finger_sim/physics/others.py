"""Kernels called by the address of their machine code, as one library calls another.

A kernel that calls another by name has all of its code linked in, optimised and kept once more. For a step of the
physics that takes longer than to compile what calls it.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic


def address_of(kernel: Any, kinds: tuple[Any, ...]) -> int:
    """Of the machine code of a kernel that is compiled for arguments of these numba types."""
    compiled = kernel.overloads[kinds]
    return int(compiled.library.get_pointer_to_function(compiled.fndesc.llvm_func_name))


@intrinsic(prefer_literal=False)  # type: ignore[untyped-decorator]
def call_at(typing: Any, address: Any, *kinds: Any) -> Any:
    """Call a kernel that returns nothing, at an address that `address_of` gave for just these arguments."""
    given = kinds[0] if len(kinds) == 1 and isinstance(kinds[0], types.BaseTuple) else kinds

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        convention = context.call_conv
        function = convention.get_function_type(types.none, tuple(given))
        returned, raised = (builder.alloca(kind.pointee) for kind in function.args[:2])
        for place in (returned, raised):
            builder.store(ir.Constant(place.type.pointee, None), place)
        values = [builder.extract_value(args[1], k) for k in range(len(given))]
        packed = convention._get_arg_packer(tuple(given)).as_arguments(builder, values)
        builder.call(builder.inttoptr(args[0], function.as_pointer()), [returned, raised, *packed])
        return context.get_dummy_value()

    return types.none(address, types.BaseTuple.from_types(tuple(given))), generate
