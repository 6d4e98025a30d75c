"""What lanes.py and atomics.py are to the compiler: the only place with compiler tricks.

numba gets two types each for vectors and for truth values of 4 and of 8 lanes, <8 x double> and <8 x i1> to LLVM, and
for every function of the two files the instructions that do the same. compile.py imports this before it compiles
anything.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba.core import cgutils, types
from numba.core.datamodel import models
from numba.core.extending import lower_builtin, register_model, type_callable
from numba.core.typing.arraydecl import GetItemBuffer, SetItemBuffer
from numba.core.typing.templates import AbstractTemplate, infer_global, signature

from .atomics import fence, load_acquire, store_release
from .lanes import (
    absolute,
    add3,
    add3x4,
    bits,
    fill4,
    fill8,
    gather3,
    gather3x4,
    high4,
    join8,
    lane,
    load4,
    load8,
    low4,
    maximum,
    pick4,
    scatter3,
    scatter3x4,
    splat4,
    splat8,
    sqrt,
    store4,
    store8,
    sum3,
    sums3,
    where,
)  # fmt: skip


class LanesType(types.Type):
    """numba's type of `width` float64 in a register."""

    def __init__(self, width: int) -> None:
        self.width = width
        super().__init__(name=f"Lanes({width})")


class MaskType(types.Type):
    """numba's type of `width` truth values in a register."""

    def __init__(self, width: int) -> None:
        self.width = width
        super().__init__(name=f"Mask({width})")


LANES4, LANES8, MASK4, MASK8 = LanesType(4), LanesType(8), MaskType(4), MaskType(8)
_PAIRS = ((LANES4, MASK4), (LANES8, MASK8))


@register_model(LanesType)
class _LanesModel(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, manager: Any, kind: LanesType) -> None:
        super().__init__(manager, kind, ir.VectorType(ir.DoubleType(), kind.width))


@register_model(MaskType)
class _MaskModel(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, manager: Any, kind: MaskType) -> None:
        super().__init__(manager, kind, ir.VectorType(ir.IntType(1), kind.width))


_FLAGS = ("contract",)
_FOR_PROCESSORS = {"target": "cpu"}
_I32 = ir.IntType(32)


def _splat(builder: Any, x: Any, width: int) -> Any:
    vector = ir.VectorType(ir.DoubleType(), width)
    first = builder.insert_element(ir.Constant(vector, ir.Undefined), x, ir.Constant(_I32, 0))
    zeros = ir.Constant(ir.VectorType(_I32, width), [0] * width)
    return builder.shuffle_vector(first, ir.Constant(vector, ir.Undefined), zeros)


def _shuffle(builder: Any, a: Any, b: Any, order: list[int]) -> Any:
    return builder.shuffle_vector(a, b, ir.Constant(ir.VectorType(_I32, len(order)), order))


def _first(op: Any, cases: list[Any]) -> None:
    """Type an operator so: what is for this processor is tried before what is for any."""
    by_kinds = {case.args: case for case in cases}

    class Template(AbstractTemplate):  # type: ignore[misc]
        key, metadata = op, _FOR_PROCESSORS

        def generic(self, args: Any, kws: Any) -> Any:
            return by_kinds.get(args)

    infer_global(op)(Template)


def _operator(op: Any, emit: Callable[[Any, Any, Any], Any], mask: bool = False) -> None:
    """Give Lanes the binary operator `op`, also with a plain number on either side."""
    cases = []
    for lanes, truth in _PAIRS:
        result = truth if mask else lanes
        for left, right in ((lanes, lanes), (lanes, types.float64), (types.float64, lanes)):
            cases.append(signature(result, left, right))

            def lower(context: Any, builder: Any, sig: Any, args: Any, width: int = lanes.width) -> Any:
                a, b = (
                    v if isinstance(t, LanesType) else _splat(builder, v, width)
                    for v, t in zip(args, sig.args, strict=True)
                )
                return emit(builder, a, b)

            lower_builtin(op, left, right)(lower)
    _first(op, cases)


_operator(operator.add, lambda builder, a, b: builder.fadd(a, b, flags=_FLAGS))
_operator(operator.sub, lambda builder, a, b: builder.fsub(a, b, flags=_FLAGS))
_operator(operator.mul, lambda builder, a, b: builder.fmul(a, b, flags=_FLAGS))
_operator(operator.truediv, lambda builder, a, b: builder.fdiv(a, b, flags=_FLAGS))
_operator(operator.lt, lambda builder, a, b: builder.fcmp_ordered("<", a, b), mask=True)
_operator(operator.gt, lambda builder, a, b: builder.fcmp_ordered(">", a, b), mask=True)
_operator(operator.le, lambda builder, a, b: builder.fcmp_ordered("<=", a, b), mask=True)
_operator(operator.ge, lambda builder, a, b: builder.fcmp_ordered(">=", a, b), mask=True)


def _mask_operator(op: Any, emit: Callable[[Any, Any, Any], Any]) -> None:
    cases = [signature(truth, truth, truth) for _, truth in _PAIRS]
    _first(op, cases)
    for _, truth in _PAIRS:
        lower_builtin(op, truth, truth)(lambda context, builder, sig, args: emit(builder, *args))


_mask_operator(operator.and_, lambda builder, a, b: builder.and_(a, b))
_mask_operator(operator.or_, lambda builder, a, b: builder.or_(a, b))


_first(operator.neg, [signature(lanes, lanes) for lanes, _ in _PAIRS])


@lower_builtin(operator.neg, LanesType)  # type: ignore[untyped-decorator]
def _lower_neg(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    return builder.fneg(args[0], flags=_FLAGS)


def _pointer(context: Any, builder: Any, array: Any, value: Any, i: Any, k: Any, width: int) -> Any:
    """Address of group k of entry i."""
    struct = context.make_array(array)(context, builder, value)
    stride = cgutils.unpack_tuple(builder, struct.strides, array.ndim)[0]
    size = ir.IntType(64)
    group = width * context.get_abi_sizeof(context.get_data_type(array.dtype))
    offset = builder.add(builder.mul(i, stride), builder.mul(k, ir.Constant(size, group)))
    base = builder.bitcast(struct.data, ir.IntType(8).as_pointer())
    return builder.gep(base, [offset])


def _as(builder: Any, pointer: Any, kind: Any) -> Any:
    return builder.bitcast(pointer, kind.as_pointer())


def _load(builder: Any, pointer: Any, width: int) -> Any:
    return builder.load(_as(builder, pointer, ir.VectorType(ir.DoubleType(), width)), align=8)


def _store(builder: Any, pointer: Any, value: Any) -> None:
    builder.store(value, _as(builder, pointer, value.type), align=8)


def _function(function: Any, result: Callable[..., Any], *patterns: Any) -> Callable[[Any], Any]:
    """Type `function` by `result` (None: no match) and lower it for each pattern of argument types."""

    def typer(context: Any) -> Callable[..., Any]:
        return result

    type_callable(function)(typer)

    def register(lower: Any) -> Any:
        for pattern in patterns:
            lower_builtin(function, *pattern)(lower)
        return lower

    return register


def _index(context: Any, builder: Any, sig: Any, args: Any, n: int) -> Any:
    return context.cast(builder, args[n], sig.args[n], types.intp)


_PLACE = (types.Array, types.Integer, types.Integer)
for _width, _kind, _read, _write, _splats, _fill in (
    (4, LANES4, load4, store4, splat4, fill4),
    (8, LANES8, load8, store8, splat8, fill8),
):

    @_function(_read, lambda a, i, k, kind=_kind: kind, _PLACE)
    def _lower_load(context: Any, builder: Any, sig: Any, args: Any, width: int = _width) -> Any:
        i, k = (_index(context, builder, sig, args, n) for n in (1, 2))
        pointer = _pointer(context, builder, sig.args[0], args[0], i, k, width)
        if sig.args[0].dtype == types.float32:
            single = builder.load(_as(builder, pointer, ir.VectorType(ir.FloatType(), width)), align=4)
            return builder.fpext(single, ir.VectorType(ir.DoubleType(), width))
        return _load(builder, pointer, width)

    @_function(_write, lambda a, i, k, v: types.none, (*_PLACE, _kind))
    def _lower_store(context: Any, builder: Any, sig: Any, args: Any, width: int = _width) -> Any:
        i, k = (_index(context, builder, sig, args, n) for n in (1, 2))
        _store(builder, _pointer(context, builder, sig.args[0], args[0], i, k, width), args[3])
        return context.get_dummy_value()

    @_function(_splats, lambda x, kind=_kind: kind, (types.Float,))
    def _lower_splat(context: Any, builder: Any, sig: Any, args: Any, width: int = _width) -> Any:
        return _splat(builder, args[0], width)

    @_function(_fill, lambda a, i, k, kind=_kind: kind, _PLACE)
    def _lower_fill(context: Any, builder: Any, sig: Any, args: Any, width: int = _width) -> Any:
        i, k = (_index(context, builder, sig, args, n) for n in (1, 2))
        pointer = _pointer(context, builder, sig.args[0], args[0], i, k, 1)
        return _splat(builder, builder.load(_as(builder, pointer, ir.DoubleType())), width)


def _unary(name: str) -> Callable[..., Any]:
    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        kind = args[0].type
        function = cgutils.get_or_insert_function(
            builder.module, ir.FunctionType(kind, [kind]), f"llvm.{name}.v{kind.count}f64"
        )
        return builder.call(function, args)

    return lower


def _same(v: Any) -> Any:
    """The type of v, if it is one of lanes."""
    return v if isinstance(v, LanesType) else None


_function(sqrt, _same, (LanesType,))(_unary("sqrt"))
_function(absolute, _same, (LanesType,))(_unary("fabs"))


@_function(maximum, lambda a, b: _same(a), (LanesType, LanesType), (LanesType, types.Float))
def _lower_maximum(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    a, b = args
    if a.type != b.type:
        b = _splat(builder, b, a.type.count)
    return builder.select(builder.fcmp_ordered(">", a, b), a, b)


@_function(where, lambda m, a, b: _same(a), (MaskType, LanesType, LanesType))
def _lower_where(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    return builder.select(*args)


@_function(bits, lambda m: types.intp if isinstance(m, MaskType) else None, (MaskType,))
def _lower_bits(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    number = builder.bitcast(args[0], ir.IntType(args[0].type.count))
    return builder.zext(number, ir.IntType(64))


@_function(lane, lambda v, l: types.float64 if isinstance(v, LanesType) else None, (LanesType, types.Integer))
def _lower_lane(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    return builder.extract_element(args[0], builder.trunc(_index(context, builder, sig, args, 1), _I32))


@_function(sum3, lambda v: types.float64 if v is LANES4 else None, (LANES4,))
def _lower_sum3(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    x, y, z = (builder.extract_element(args[0], ir.Constant(_I32, l)) for l in range(3))
    return builder.fadd(builder.fadd(x, y, flags=_FLAGS), z, flags=_FLAGS)


def _row_pointers(context: Any, builder: Any, sig: Any, args: Any) -> list[Any]:
    """Addresses of the eight rows of args[0] that group k of entry i of the index array args[1] names."""
    i, k = (_index(context, builder, sig, args, n) for n in (2, 3))
    numbers = _as(builder, _pointer(context, builder, sig.args[1], args[1], i, k, 8), ir.IntType(64))
    zero = ir.Constant(ir.IntType(64), 0)
    rows = (builder.load(builder.gep(numbers, [ir.Constant(_I32, l)])) for l in range(8))
    return [_pointer(context, builder, sig.args[0], args[0], n, zero, 4) for n in rows]


def _transposed(builder: Any, rows: list[Any]) -> list[Any]:
    """Components 0, 1, 2 of eight padded vectors, a vector of eight each."""
    pairs = [_shuffle(builder, rows[l], rows[l + 4], list(range(8))) for l in range(4)]
    low = [_shuffle(builder, pairs[l], pairs[l + 1], [0, 8, 2, 10, 4, 12, 6, 14]) for l in (0, 2)]
    high = [_shuffle(builder, pairs[l], pairs[l + 1], [1, 9, 3, 11, 5, 13, 7, 15]) for l in (0, 2)]
    even, odd = [0, 1, 8, 9, 4, 5, 12, 13], [2, 3, 10, 11, 6, 7, 14, 15]
    return [_shuffle(builder, a, b, order) for (a, b), order in ((low, even), (high, even), (low, odd))]


def _padded_rows(builder: Any, x: Any, y: Any, z: Any) -> list[Any]:
    """Eight vectors (x, y, z, 0) from their components."""
    zero = ir.Constant(x.type, [0.0] * 8)
    xy = [_shuffle(builder, x, y, o) for o in ([0, 8, 2, 10, 4, 12, 6, 14], [1, 9, 3, 11, 5, 13, 7, 15])]
    zw = [_shuffle(builder, z, zero, o) for o in ([0, 8, 2, 10, 4, 12, 6, 14], [1, 9, 3, 11, 5, 13, 7, 15])]
    return [
        _shuffle(builder, xy[l % 2], zw[l % 2], [c, c + 1, 8 + c, 9 + c])
        for l, c in ((l, 2 * (l // 2)) for l in range(8))
    ]


@_function(
    gather3,
    lambda a, index, i, k: types.UniTuple(LANES8, 3),  # type: ignore[attr-defined]
    (types.Array, types.Array, types.Integer, types.Integer),
)
def _lower_gather3(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    rows = [_load(builder, pointer, 4) for pointer in _row_pointers(context, builder, sig, args)]
    return context.make_tuple(builder, sig.return_type, _transposed(builder, rows))


@_function(
    add3,
    lambda a, index, i, k, x, y, z: types.none,
    (types.Array, types.Array, types.Integer, types.Integer, LANES8, LANES8, LANES8),
)
def _lower_add3(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    rows = _padded_rows(builder, *args[4:])
    for pointer, row in zip(_row_pointers(context, builder, sig, args), rows, strict=True):
        _store(builder, pointer, builder.fadd(_load(builder, pointer, 4), row, flags=_FLAGS))
    return context.get_dummy_value()


@_function(
    scatter3,
    lambda a, i, k, x, y, z: types.none,
    (types.Array, types.Integer, types.Integer, LANES8, LANES8, LANES8),
)
def _lower_scatter3(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    i, k = (_index(context, builder, sig, args, n) for n in (1, 2))
    first = builder.mul(i, ir.Constant(ir.IntType(64), 8))
    for l, row in enumerate(_padded_rows(builder, *args[3:])):
        t = builder.add(first, ir.Constant(ir.IntType(64), l))
        _store(builder, _pointer(context, builder, sig.args[0], args[0], t, k, 4), row)
    return context.get_dummy_value()


def _four_addresses(context: Any, builder: Any, sig: Any, args: Any, width: int) -> list[Any]:
    """Addresses of the four entries of args[0], of `width` numbers, that the k-th four of args[1][i] name."""
    i, k = (_index(context, builder, sig, args, n) for n in (2, 3))
    numbers = _as(builder, _pointer(context, builder, sig.args[1], args[1], i, k, 4), ir.IntType(64))
    zero = ir.Constant(ir.IntType(64), 0)
    entries = (builder.load(builder.gep(numbers, [ir.Constant(_I32, l)])) for l in range(4))
    return [_pointer(context, builder, sig.args[0], args[0], n, zero, width) for n in entries]


def _transposed4(builder: Any, a: Any, b: Any, c: Any, d: Any) -> list[Any]:
    """The columns of four rows of four."""
    low = [_shuffle(builder, p, q, [0, 4, 2, 6]) for p, q in ((a, b), (c, d))]
    high = [_shuffle(builder, p, q, [1, 5, 3, 7]) for p, q in ((a, b), (c, d))]
    return [_shuffle(builder, p, q, order) for order in ([0, 1, 4, 5], [2, 3, 6, 7]) for p, q in (low, high)]


@_function(
    gather3x4,
    lambda a, index, i, k: types.UniTuple(LANES4, 3),  # type: ignore[attr-defined]
    (types.Array, types.Array, types.Integer, types.Integer),
)
def _lower_gather3x4(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    a, b, c, d = (_load(builder, pointer, 4) for pointer in _four_addresses(context, builder, sig, args, 4))
    return context.make_tuple(builder, sig.return_type, _transposed4(builder, a, b, c, d)[:3])


@_function(pick4, lambda a, index, i, k: LANES4, (types.Array, types.Array, types.Integer, types.Integer))
def _lower_pick4(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    vector = ir.Constant(ir.VectorType(ir.DoubleType(), 4), ir.Undefined)
    for l, pointer in enumerate(_four_addresses(context, builder, sig, args, 1)):
        number = builder.load(_as(builder, pointer, ir.DoubleType()))
        vector = builder.insert_element(vector, number, ir.Constant(_I32, l))
    return vector


@_function(
    add3x4,
    lambda a, index, i, k, x, y, z: types.none,
    (types.Array, types.Array, types.Integer, types.Integer, LANES4, LANES4, LANES4),
)
def _lower_add3x4(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    x, y, z = args[4:]
    rows = _transposed4(builder, x, y, z, ir.Constant(x.type, [0.0] * 4))
    for pointer, row in zip(_four_addresses(context, builder, sig, args, 4), rows, strict=True):
        _store(builder, pointer, builder.fadd(_load(builder, pointer, 4), row, flags=_FLAGS))
    return context.get_dummy_value()


@_function(
    scatter3x4,
    lambda a, k, x, y, z: types.none,
    (types.Array, types.Integer, LANES4, LANES4, LANES4),
)
def _lower_scatter3x4(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    k = _index(context, builder, sig, args, 1)
    x, y, z = args[2:]
    rows = _transposed4(builder, x, y, z, ir.Constant(x.type, [0.0] * 4))
    for l, row in enumerate(rows):
        entry = ir.Constant(ir.IntType(64), l)
        _store(builder, _pointer(context, builder, sig.args[0], args[0], entry, k, 4), row)
    return context.get_dummy_value()


@_function(join8, lambda a, b: LANES8 if a is LANES4 and b is LANES4 else None, (LANES4, LANES4))
def _lower_join8(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    return _shuffle(builder, args[0], args[1], list(range(8)))


for _half, _order in ((low4, [0, 1, 2, 3]), (high4, [4, 5, 6, 7])):

    @_function(_half, lambda v: LANES4 if v is LANES8 else None, (LANES8,))
    def _lower_half(context: Any, builder: Any, sig: Any, args: Any, order: list[int] = _order) -> Any:
        return _shuffle(builder, args[0], args[0], order)


@_function(sums3, lambda x, y, z: LANES4 if x is LANES4 else None, (LANES4, LANES4, LANES4))
def _lower_sums3(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    x, y, z = args
    w = ir.Constant(x.type, [0.0] * 4)
    even_xy, even_zw = (_shuffle(builder, a, b, [0, 4, 2, 6]) for a, b in ((x, y), (z, w)))
    odd_xy, odd_zw = (_shuffle(builder, a, b, [1, 5, 3, 7]) for a, b in ((x, y), (z, w)))
    first, second = _shuffle(builder, even_xy, even_zw, [0, 1, 4, 5]), _shuffle(builder, odd_xy, odd_zw, [0, 1, 4, 5])
    third = _shuffle(builder, even_xy, even_zw, [2, 3, 6, 7])
    return builder.fadd(builder.fadd(first, second, flags=_FLAGS), third, flags=_FLAGS)


_WORD = ir.IntType(64)


def _word(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    """Address of args[0][args[1]]."""
    k, zero = _index(context, builder, sig, args, 1), ir.Constant(_WORD, 0)
    return _as(builder, _pointer(context, builder, sig.args[0], args[0], k, zero, 1), _WORD)


def _words(kind: Any) -> bool:
    return isinstance(kind, types.Array) and kind.ndim == 1 and kind.dtype == types.int64


@_function(fence, lambda: types.none, ())
def _lower_fence(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    builder.fence("seq_cst")
    return context.get_dummy_value()


@_function(load_acquire, lambda words, k: types.int64 if _words(words) else None, (types.Array, types.Integer))
def _lower_load_acquire(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    return builder.load_atomic(_word(context, builder, sig, args), "acquire", 8)


@_function(
    store_release,
    lambda words, k, value: types.none if _words(words) else None,
    (types.Array, types.Integer, types.Integer),
)
def _lower_store_release(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    value = context.cast(builder, args[2], sig.args[2], types.int64)
    builder.store_atomic(value, _word(context, builder, sig, args), "release", 8)
    return context.get_dummy_value()


# Entries of arrays are typed as ever, but without a try of all else that may have entries: a fifth of the time to
# compile a step.
@infer_global(operator.getitem)
class _Entry(GetItemBuffer):  # type: ignore[misc]
    metadata = _FOR_PROCESSORS


@infer_global(operator.setitem)
class _SetEntry(SetItemBuffer):  # type: ignore[misc]
    metadata = _FOR_PROCESSORS
