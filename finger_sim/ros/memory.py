"""C functions by their addresses, and numbers at any byte: what kernels need to talk to a library.

Below they are plain Python: that is what runs with NUMBA_DISABLE_JIT=1. What follows each is the same to the compiler.
An address is a number that a kernel is given, so that its machine code can be kept for other processes. Memory is read
and written as this machine has it, which is little-endian as CDR is here; nothing is checked against the end of it.
"""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core.extending import lower_builtin, type_callable
from numba.np.arrayobj import populate_array

from ..arrays import Bytes

_WORD, _BYTE = ir.IntType(64), ir.IntType(8)
_BYTES = types.Array(types.uint8, 1, "C")


def call(address: int, arguments: tuple[int, ...]) -> int:
    """What the C function at an address gives, an int, for arguments that are integers and addresses."""
    kind = ctypes.CFUNCTYPE(ctypes.c_int, *[ctypes.c_int64] * len(arguments))
    return int(kind(address)(*map(int, arguments)))


def bytes_at(address: int, size: int) -> Bytes:
    """The memory at an address as an array (size,), shared."""
    return np.ctypeslib.as_array((ctypes.c_uint8 * int(size)).from_address(int(address)))


def read_int32(data: Bytes, at: int) -> int:
    """The signed number in the four bytes from `at` on."""
    return int(data[at : at + 4].view(np.int32)[0])


def read_float64(data: Bytes, at: int) -> float:
    """The number in the eight bytes from `at` on."""
    return float(data[at : at + 8].view(np.float64)[0])


def read_float32(data: Bytes, at: int) -> float:
    """The number of half that precision in the four bytes from `at` on."""
    return float(data[at : at + 4].view(np.float32)[0])


def write_int32(data: Bytes, at: int, value: int) -> None:
    """The lower 32 bits of a number into the four bytes from `at` on."""
    data[at : at + 4] = np.array([value], np.int64).view(np.uint8)[:4]


def write_float64(data: Bytes, at: int, value: float) -> None:
    """A number into the eight bytes from `at` on."""
    data[at : at + 8] = np.array([value], np.float64).view(np.uint8)


def write_float32(data: Bytes, at: int, value: float) -> None:
    """A number, rounded to half that precision, into the four bytes from `at` on."""
    data[at : at + 4] = np.array([value], np.float32).view(np.uint8)


type_callable(call)(lambda context: lambda address, arguments: types.int64)
type_callable(bytes_at)(lambda context: lambda address, size: _BYTES)
type_callable(read_int32)(lambda context: lambda data, at: types.int64)
type_callable(read_float64)(lambda context: lambda data, at: types.float64)
type_callable(read_float32)(lambda context: lambda data, at: types.float64)
type_callable(write_int32)(lambda context: lambda data, at, value: types.none)
type_callable(write_float64)(lambda context: lambda data, at, value: types.none)
type_callable(write_float32)(lambda context: lambda data, at, value: types.none)


@lower_builtin(call, types.Integer, types.BaseTuple)  # type: ignore[untyped-decorator]
def _lower_call(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    kinds = sig.args[1].types
    given = [builder.extract_value(args[1], k) for k in range(len(kinds))]
    words = [context.cast(builder, value, kind, types.int64) for value, kind in zip(given, kinds, strict=True)]
    function = ir.FunctionType(ir.IntType(32), [_WORD] * len(words)).as_pointer()
    address = context.cast(builder, args[0], sig.args[0], types.int64)
    return builder.sext(builder.call(builder.inttoptr(address, function), words), _WORD)


@lower_builtin(bytes_at, types.Integer, types.Integer)  # type: ignore[untyped-decorator]
def _lower_bytes_at(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    address, size = (context.cast(builder, a, kind, types.int64) for a, kind in zip(args, sig.args, strict=True))
    array = context.make_array(_BYTES)(context, builder)
    start, one = builder.inttoptr(address, _BYTE.as_pointer()), ir.Constant(_WORD, 1)
    populate_array(array, data=start, shape=[size], strides=[one], itemsize=one, meminfo=None)
    return array._getvalue()


def _place(context: Any, builder: Any, sig: Any, args: Any, kind: Any) -> Any:
    """Pointer to a value of a kind at byte args[1] of the array args[0], which no alignment is promised for."""
    data = context.make_array(sig.args[0])(context, builder, args[0]).data
    at = context.cast(builder, args[1], sig.args[1], types.int64)
    return builder.bitcast(builder.gep(data, [at]), context.get_value_type(kind).as_pointer())


for _read, _write, _kind, _stored in (
    (read_int32, write_int32, types.int64, types.int32),
    (read_float64, write_float64, types.float64, types.float64),
    (read_float32, write_float32, types.float64, types.float32),
):

    @lower_builtin(_read, types.Array, types.Integer)  # type: ignore[untyped-decorator]
    def _lower_read(context: Any, builder: Any, sig: Any, args: Any, kind: Any = _kind, stored: Any = _stored) -> Any:
        value = builder.load(_place(context, builder, sig, args, stored), align=1)
        return context.cast(builder, value, stored, kind)

    @lower_builtin(_write, types.Array, types.Integer, types.Number)  # type: ignore[untyped-decorator]
    def _lower_write(context: Any, builder: Any, sig: Any, args: Any, stored: Any = _stored) -> Any:
        value = context.cast(builder, args[2], sig.args[2], stored)
        builder.store(value, _place(context, builder, sig, args, stored), align=1)
        return context.get_dummy_value()
