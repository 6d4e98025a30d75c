"""`pointed`: a record of arrays as compiled code holds it. One address; a type says where each field lies from there.

Handing the hundred arrays of a Model and a State over takes longer than some stages of a step, and so does counting
who refers to each array in every function: here both are done once. What a record points to lives as long as the
`Pointed` does, and compiled code counts nothing.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any, Generic, NamedTuple, TypeVar, cast

import numba
import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.core.datamodel import models
from numba.core.extending import (
    NativeValue,
    infer_getattr,
    lower_getattr_generic,
    register_model,
    typeof_impl,
    unbox,
)
from numba.core.typing.templates import AttributeTemplate

from ..arrays import Floats

_WORD = ir.IntType(64)
VECTOR = types.float64[::1]
"""numba's type of a one-dimensional array of numbers."""
T = TypeVar("T")


class RecordType(types.Type):
    """numba's type of a record: its name, and the types of its fields."""

    def __init__(self, record: str, fields: tuple[tuple[str, Any], ...]) -> None:
        self.fields, self.places, place = dict(fields), {}, 0
        for name, kind in fields:
            self.places[name] = place
            place += 1 + 2 * kind.ndim if isinstance(kind, types.Array) else 1
        self.words = place
        super().__init__(name=f"{record}({', '.join(f'{name}={_short(kind)}' for name, kind in fields)})")


def _short(kind: Any) -> str:
    return f"{kind.dtype}x{kind.ndim}" if isinstance(kind, types.Array) else str(kind)


class Pointed:
    """A record in memory that stays where it is. In compiled code it has the fields of the record."""

    def __init__(self, record: NamedTuple) -> None:
        """Arrays are shared, not copied; they must be C-contiguous."""
        self.record = record
        self._within = {name: Pointed(part) for name, part in record._asdict().items() if _is_record(part)}
        values = record._asdict() | self._within
        self.kind = RecordType(type(record).__name__, tuple((name, _kind_of(part)) for name, part in values.items()))
        words: list[int] = []
        for part in values.values():
            words += _words(part)
        self._memory = np.array(words, np.int64)
        self.address = self._memory.ctypes.data

    def changed(self, record: NamedTuple) -> Pointed:
        """Of another record of the same type, most of whose fields are the very same: a tenth of the time."""
        other = copy.copy(self)
        other.record, other._within, other._memory = record, dict(self._within), self._memory.copy()
        other.address = other._memory.ctypes.data
        for name, before, now in zip(record._fields, self.record, record, strict=True):
            if now is not before:
                part = Pointed(now) if _is_record(now) else now
                if not _alike(before, now) and _kind_of(part) != self.kind.fields[name]:
                    return Pointed(record)
                if isinstance(part, Pointed):
                    other._within[name] = part
                words, place = _words(part), self.kind.places[name]
                other._memory[place : place + len(words)] = words
        return other


def side_by_side(record: type, **sizes: int) -> dict[str, Floats]:
    """Fields of a record by name: one-dimensional arrays of zeros in one piece of memory, of size 1 unless said."""
    lengths = {name: sizes.get(name, 1) for name in record.__annotations__}
    whole, fields, begin = np.zeros(sum(lengths.values())), dict[str, Floats](), 0
    for name, length in lengths.items():
        fields[name] = whole[begin : begin + length]
        begin += length
    return fields


def direct(kernel: Callable[..., Any], *arguments: Any) -> Callable[..., Any]:
    """A kernel as compiled for arguments like these (`Pointed` or numba types), without the search for that version."""
    if numba.config.DISABLE_JIT:
        return kernel
    kinds = tuple(argument.kind if isinstance(argument, Pointed) else argument for argument in arguments)
    return cast(Callable[..., Any], kernel.compile(kinds))  # type: ignore[attr-defined]


def held(record: Any) -> Any:
    """A record as kernels take it: `Pointed` where they are compiled, else itself."""
    return record if numba.config.DISABLE_JIT else Pointed(record)


def changed(before: Any, record: Any) -> Any:
    """`held` of another record of the same kind, most of whose fields are the very same."""
    return before.changed(record) if isinstance(before, Pointed) else record


class Entry(Generic[T]):
    """An attribute of objects that have a `record`: the number in the field of that name, of size 1."""

    def __init__(self, kind: Callable[[Any], T]) -> None:
        self._kind = kind

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    def __get__(self, owner: Any, kind: type | None = None) -> T:
        return self._kind(getattr(owner.record, self._name)[0])

    def __set__(self, owner: Any, value: T) -> None:
        getattr(owner.record, self._name)[0] = value


def _alike(a: Any, b: Any) -> bool:
    """Whether both are plain numbers of one type, and so of one kind."""
    return type(a) is type(b) and isinstance(a, (bool, int, float))


def _is_record(part: Any) -> bool:
    return isinstance(part, tuple) and hasattr(part, "_fields")


def _kind_of(part: Any) -> Any:
    if isinstance(part, Pointed):
        return part.kind
    if isinstance(part, np.ndarray):
        if not part.flags.c_contiguous:
            raise ValueError(
                f"an array of shape {part.shape} of a record: got strides {part.strides}, allowed: C order"
            )
        return types.Array(numba.from_dtype(part.dtype), part.ndim, "C")
    return types.boolean if isinstance(part, (bool, np.bool_)) else numba.typeof(part)


def _words(part: Any) -> list[int]:
    if isinstance(part, Pointed):
        return [part.address]
    if isinstance(part, np.ndarray):
        return [part.ctypes.data, *part.shape, *part.strides]
    return [int(np.float64(part).view(np.int64)) if isinstance(part, float) else int(part)]


register_model(RecordType)(models.OpaqueModel)


@typeof_impl.register(Pointed)  # type: ignore[untyped-decorator]
def _typeof_pointed(pointed: Pointed, context: Any) -> RecordType:
    return pointed.kind


@unbox(RecordType)  # type: ignore[untyped-decorator]
def _unbox_record(kind: RecordType, instance: Any, c: Any) -> Any:
    address = c.pyapi.object_getattr_string(instance, "address")
    number = c.pyapi.long_as_longlong(address)
    c.pyapi.decref(address)
    return NativeValue(c.builder.inttoptr(number, cgutils.voidptr_t))


@infer_getattr
class _RecordField(AttributeTemplate):  # type: ignore[misc]
    key = RecordType

    def generic_resolve(self, kind: RecordType, name: str) -> Any:
        return kind.fields.get(name)


@lower_getattr_generic(RecordType)  # type: ignore[untyped-decorator]
def _lower_field(context: Any, builder: Any, kind: RecordType, value: Any, name: str) -> Any:
    field = kind.fields[name]
    words = builder.bitcast(value, _WORD.as_pointer())
    place = builder.gep(words, [ir.Constant(_WORD, kind.places[name])], inbounds=True)
    if isinstance(field, types.Array):
        return builder.call(_array_reader(context, builder.module, field), [place])
    word = _word(builder, place, 0)
    if isinstance(field, RecordType):
        return builder.inttoptr(word, cgutils.voidptr_t)
    if isinstance(field, types.Float):
        return builder.bitcast(word, ir.DoubleType())
    if isinstance(field, types.Boolean):
        return builder.icmp_signed("!=", word, ir.Constant(_WORD, 0))
    return word


def _word(builder: Any, words: Any, k: int) -> Any:
    loaded = builder.load(builder.gep(words, [ir.Constant(_WORD, k)], inbounds=True), align=8)
    loaded.set_metadata("invariant.load", builder.module.add_metadata([]))  # nothing writes a record's memory
    return loaded


def _array_reader(context: Any, module: Any, kind: Any) -> Any:
    """A function that makes an array of its address, shape and strides: called, as it is long, and inlined."""
    signature = ir.FunctionType(context.get_value_type(kind), [_WORD.as_pointer()])
    reader = cgutils.get_or_insert_function(module, signature, f"finger_sim.array.{kind.dtype}.{kind.ndim}")
    if not reader.is_declaration:
        return reader
    reader.linkage = "linkonce_odr"
    reader.attributes.add("alwaysinline")
    builder = ir.IRBuilder(reader.append_basic_block())
    words, array = reader.args[0], context.make_array(kind)(context, builder)
    array.data = builder.inttoptr(_word(builder, words, 0), array.data.type)
    shape = [_word(builder, words, 1 + d) for d in range(kind.ndim)]
    array.shape = cgutils.pack_array(builder, shape, ty=_WORD)
    strides = [_word(builder, words, 1 + kind.ndim + d) for d in range(kind.ndim)]
    array.strides = cgutils.pack_array(builder, strides, ty=_WORD)
    count = shape[0]
    for size in shape[1:]:
        count = builder.mul(count, size)
    array.nitems = count
    array.itemsize = ir.Constant(_WORD, context.get_abi_sizeof(context.get_data_type(kind.dtype)))
    array.meminfo = cgutils.get_null_value(array.meminfo.type)  # counted by nobody
    array.parent = cgutils.get_null_value(array.parent.type)
    builder.ret(array._getvalue())
    return reader
