"""Kernels called by the address of their machine code, as one library calls another.

A kernel that calls another by name has all of its code linked in, optimised and kept once more. For a step of the
physics that takes longer than to compile what calls it.
"""

from __future__ import annotations

from typing import Any

from numba import types
from numba.extending import intrinsic


def address_of(kernel: Any, kinds: tuple[Any, ...]) -> int:
    """Of the machine code of a kernel that is compiled for arguments of these numba types."""
    compiled = kernel.overloads[kinds]
    return int(compiled.library.get_pointer_to_function(compiled.fndesc.llvm_func_name))


def calls(returned: Any) -> Any:
    """For compiled code: call a kernel that returns this numba type and raises nothing.

    At an address that `address_of` gave for just the arguments that follow it.
    """

    @intrinsic(prefer_literal=False)  # type: ignore[untyped-decorator]
    def call(typing: Any, address: Any, *kinds: Any) -> Any:
        given = tuple(kinds[0] if len(kinds) == 1 and isinstance(kinds[0], types.BaseTuple) else kinds)

        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            convention = context.call_conv
            function = builder.inttoptr(args[0], convention.get_function_type(returned, given).as_pointer())
            values = [builder.extract_value(args[1], k) for k in range(len(given))]
            return convention.call_function(builder, function, returned, given, values)[1]

        return returned(address, types.BaseTuple.from_types(given)), generate

    return call


call_at = calls(types.none)
