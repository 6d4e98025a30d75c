"""Lanes: each function and operator compiled, bit for bit against NumPy on arrays of four and eight."""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any

import numba
import numpy as np
import pytest
from cases import for_each
from numpy.testing import assert_array_equal
from physics_helpers import Array

from finger_sim.physics import lanes
from finger_sim.physics.compile import FASTMATH
from finger_sim.physics.lanes import (
    absolute,
    add3,
    add3x4,
    bits,
    gather3,
    gather3x4,
    lane,
    load4,
    load8,
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
    where,
)

pytestmark = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="compares compiled code with the same code uncompiled")

SPECIAL = np.array([0.0, -0.0, 1.0, -1.0, np.nan, np.inf, -np.inf, 5e-324, 1e308, -1e-308, 2.0, -3.5])


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """As the package's kernels are, but without a cache."""
    return numba.njit(error_model="numpy", fastmath=FASTMATH)(function)


def pairs(width: int, seed: int = 0) -> list[tuple[Array, Array]]:
    """Operands: random over decades, and every special number against every other."""
    rng = np.random.default_rng(seed)
    out = [tuple(rng.standard_normal((2, width)) * 10.0 ** rng.uniform(-9, 9, (2, width))) for _ in range(20)]
    a, b = (grid.ravel() for grid in np.meshgrid(SPECIAL, SPECIAL))
    out += [(a[k : k + width], b[k : k + width]) for k in range(0, len(a), width)]
    return out  # type: ignore[return-value]


def same(got: Any, expected: Any) -> None:
    """The same bits, NaN equal to NaN, −0 not equal to 0."""
    assert_array_equal(got, expected)
    real = ~np.isnan(expected)
    assert_array_equal(np.signbit(np.asarray(got))[real], np.signbit(np.asarray(expected))[real])


WIDTHS = [4, 8]
LOAD = {4: load4, 8: load8}
STORE = {4: store4, 8: store8}
SPLAT = {4: splat4, 8: splat8}


def binary(op: Any, width: int, left: str = "lanes", right: str = "lanes") -> Callable[..., Any]:
    """out ← op(a, b) for lanes, or a number (the first of an array) on one side."""
    load, store = LOAD[width], STORE[width]
    if left == "number":
        return lambda a, b, out: store(out, 0, 0, op(a[0, 0], load(b, 0, 0)))
    if right == "number":
        return lambda a, b, out: store(out, 0, 0, op(load(a, 0, 0), b[0, 0]))
    return lambda a, b, out: store(out, 0, 0, op(load(a, 0, 0), load(b, 0, 0)))


@for_each("width", WIDTHS)
@for_each("sides", [("lanes", "lanes"), ("number", "lanes"), ("lanes", "number")])
@for_each("op", [operator.add, operator.sub, operator.mul, operator.truediv])
def test_arithmetic(op: Any, sides: tuple[str, str], width: int) -> None:
    """+ − × ÷ of lanes with lanes, and with a number on either side: NumPy's bits, through NaN, ∞ and −0."""
    function = compiled(binary(op, width, *sides))
    for a, b in pairs(width):
        out = np.empty((1, width))
        function(a[None].copy(), b[None].copy(), out)
        with np.errstate(all="ignore"):
            same(out[0], op(a[0] if sides[0] == "number" else a, b[0] if sides[1] == "number" else b))


@for_each("width", WIDTHS)
@for_each("sides", [("lanes", "lanes"), ("number", "lanes"), ("lanes", "number")])
@for_each("op", [operator.lt, operator.gt, operator.le, operator.ge])
def test_comparisons_and_bits(op: Any, sides: tuple[str, str], width: int) -> None:
    """< > ≤ ≥ as masks, read by `bits`: lane l is bit l; every comparison with NaN is false."""
    load = LOAD[width]
    functions = {
        ("lanes", "lanes"): lambda a, b: bits(op(load(a, 0, 0), load(b, 0, 0))),
        ("number", "lanes"): lambda a, b: bits(op(a[0, 0], load(b, 0, 0))),
        ("lanes", "number"): lambda a, b: bits(op(load(a, 0, 0), b[0, 0])),
    }
    function = compiled(functions[sides])
    for a, b in pairs(width):
        mask = op(a[0] if sides[0] == "number" else a, b[0] if sides[1] == "number" else b)
        expected = sum(2**l for l in range(width) if mask[l])
        assert function(a[None].copy(), b[None].copy()) == expected
        assert functions[sides](a[None].copy(), b[None].copy()) == expected


@for_each("width", WIDTHS)
@for_each("op", [operator.and_, operator.or_])
def test_masks_combine(op: Any, width: int) -> None:
    """& and | of masks, for all pairs of truth values."""
    load = LOAD[width]

    def python(a: Array, b: Array) -> int:
        return bits(op(load(a, 0, 0) > 0.0, load(b, 0, 0) > 0.0))

    function = compiled(python)
    for seed in range(20):
        a, b = np.random.default_rng(seed).standard_normal((2, 1, width))
        expected = sum(2**l for l in range(width) if op(a[0, l] > 0.0, b[0, l] > 0.0))
        assert function(a, b) == python(a, b) == expected


@for_each("width", WIDTHS)
@for_each("one, numpy", [(operator.neg, np.negative), (sqrt, np.sqrt), (absolute, np.abs)])
def test_functions_of_one(one: Any, numpy: Any, width: int) -> None:
    """−v, √v, |v|: NumPy's bits; √ of a negative number is NaN, −0 and its sign are kept."""
    load, store = LOAD[width], STORE[width]
    function = compiled(lambda a, out: store(out, 0, 0, one(load(a, 0, 0))))
    for a, _ in pairs(width):
        out = np.empty((1, width))
        function(a[None].copy(), out)
        with np.errstate(all="ignore"):
            same(out[0], numpy(a))
            same(one(a), numpy(a))


@for_each("width", WIDTHS)
def test_maximum(width: int) -> None:
    """The larger one; the second where the first is NaN, and NaN where the second is: as documented, both ways."""
    function = compiled(binary(maximum, width))
    for a, b in pairs(width):
        expected = np.array([x if x > y else y for x, y in zip(a, b, strict=True)])
        out = np.empty((1, width))
        function(a[None].copy(), b[None].copy(), out)
        same(out[0], expected)
        same(maximum(a, b), expected)


@for_each("width", WIDTHS)
def test_where(width: int) -> None:
    """a where the mask holds, else b; nothing of the other one, NaN included, gets through."""
    load, store = LOAD[width], STORE[width]

    def python(m: Array, a: Array, b: Array, out: Array) -> None:
        store(out, 0, 0, where(load(m, 0, 0) > 0.0, load(a, 0, 0), load(b, 0, 0)))

    function = compiled(python)
    for seed, (a, b) in enumerate(pairs(width)):
        m = np.random.default_rng(seed).standard_normal((1, width))
        expected = np.array([x if c > 0.0 else y for c, x, y in zip(m[0], a, b, strict=True)])
        for each in (function, python):
            out = np.empty((1, width))
            each(m, a[None].copy(), b[None].copy(), out)
            same(out[0], expected)


@for_each("width", WIDTHS)
@for_each("shape", [(3, 8), (5, 3, 8), (4, 3, 2, 4), (2, 9, 8), (7, 24), (3, 1, 16)])
def test_places(shape: tuple[int, ...], width: int) -> None:
    """load and store reach group k of entry i of arrays of any rank, the last of each too, and touch nothing else."""
    load, store = LOAD[width], STORE[width]

    def python(a: Array, i: int, k: int, out: Array) -> None:
        store(out, i, k, load(a, i, k) + 1.0)

    function = compiled(python)
    a = np.random.default_rng(1).standard_normal(shape)
    groups = int(np.prod(shape[1:])) // width
    for i in range(shape[0]):
        for k in range(groups):
            expected = np.zeros(shape)
            expected.reshape(shape[0], -1)[i, width * k : width * (k + 1)] = (
                a.reshape(shape[0], -1)[i, width * k : width * (k + 1)] + 1.0
            )
            for each in (function, python):
                out = np.zeros(shape)
                each(a, i, k, out)
                assert_array_equal(out, expected)


def test_places_of_padded_rows_and_views() -> None:
    """An odd number of entries, a part of a larger array, and data that begins at any multiple of eight bytes."""
    function = compiled(lambda a, i, k, out: store4(out, 0, 0, load4(a, i, k)))
    whole = np.arange(400.0)
    for offset in range(9):
        a = whole[offset : offset + 7 * 12].reshape(7, 3, 4)
        for i, k in ((0, 0), (6, 2), (3, 1)):
            out = np.empty((1, 4))
            function(a, i, k, out)
            assert_array_equal(out[0], a[i, k])
    part = whole.reshape(10, 40)[3:9]
    out = np.empty((1, 4))
    function(part, 5, 9, out)
    assert_array_equal(out[0], part[5, 36:40])


@for_each("width", WIDTHS)
def test_a_load_is_a_copy(width: int) -> None:
    """What was loaded does not change with the array: kernels store where they have read."""
    load, store = LOAD[width], STORE[width]

    def python(a: Array) -> None:
        before = load(a, 0, 0)
        store(a, 0, 0, before * 2.0)
        store(a, 1, 0, before)

    for each in (compiled(python), python):
        a = np.arange(1.0, 2 * width + 1).reshape(2, width)
        each(a)
        assert_array_equal(a, [2 * np.arange(1.0, width + 1), np.arange(1.0, width + 1)])


@for_each("width", WIDTHS)
def test_splat_and_lane(width: int) -> None:
    """The same number in every lane, NaN and −0 too; lane l is entry l, of a variable index."""
    splat, load, store = SPLAT[width], LOAD[width], STORE[width]
    fill = compiled(lambda x, out: store(out, 0, 0, splat(x)))
    pick = compiled(lambda a, l: lane(load(a, 0, 0), l))
    for x in SPECIAL:
        out = np.empty((1, width))
        fill(x, out)
        same(out[0], np.full(width, x))
        same(splat(x), np.full(width, x))
    a = np.random.default_rng(2).standard_normal((1, width))
    assert [pick(a, l) for l in range(width)] == list(a[0]) == [lane(a[0], l) for l in range(width)]


def test_sum3_leaves_the_padding_out() -> None:
    """v₀ + v₁ + v₂ in that order, whatever is in the fourth lane."""
    function = compiled(lambda a: sum3(load4(a, 0, 0)))
    for a, b in pairs(4):
        for padding in (b[3], np.nan):
            v = np.append(a[:3], padding)
            with np.errstate(all="ignore"):
                same(np.array(function(v[None])), np.array(a[0] + a[1] + a[2]))
                same(np.array(sum3(v)), np.array(a[0] + a[1] + a[2]))


def test_gather3() -> None:
    """Three components of eight named rows of (n, 4), repeated and last rows too; the padding is not read."""

    def python(a: Array, index: Any, i: int, k: int, out: Array) -> None:
        x, y, z = gather3(a, index, i, k)
        store8(out, 0, 0, x)
        store8(out, 1, 0, y)
        store8(out, 2, 0, z)

    function = compiled(python)
    rng = np.random.default_rng(3)
    a = rng.standard_normal((13, 4))
    a[:, 3] = np.nan
    index = rng.integers(0, 13, (5, 4, 8))
    index[4, 3] = [12, 12, 0, 5, 12, 0, 1, 12]
    for i in range(5):
        for k in range(4):
            for each in (function, python):
                out = np.empty((3, 8))
                each(a, index, i, k, out)
                assert_array_equal(out, a[index[i, k], :3].T)


def test_add3() -> None:
    """Eight vectors added to named rows, one after the other where rows are named twice; the padding stays."""

    def python(a: Array, index: Any, i: int, k: int, v: Array) -> None:
        add3(a, index, i, k, load8(v, 0, 0), load8(v, 1, 0), load8(v, 2, 0))

    function = compiled(python)
    rng = np.random.default_rng(4)
    index = rng.integers(0, 6, (3, 4, 8))
    index[2, 3] = [5, 5, 5, 5, 0, 0, 5, 5]
    start = rng.standard_normal((6, 4))
    for i in range(3):
        for k in range(4):
            v = rng.standard_normal((3, 8)) * 10.0 ** rng.uniform(-3, 3, (3, 8))
            expected = start.copy()
            for l, n in enumerate(index[i, k]):
                for c in range(3):
                    expected[n, c] += v[c, l]
            for each in (function, python):
                a = start.copy()
                each(a, index, i, k, v)
                assert_array_equal(a, expected)


def test_four_at_once() -> None:
    """`gather3x4`, `pick4`, `add3x4` and `scatter3x4` at every half of every group, rows named twice among them."""

    def python(a: Array, index: Any, i: int, k: int, v: Array, numbers: Array, out: Array, apart: Array) -> None:
        x, y, z = gather3x4(a, index, i, k)
        store4(out, 0, 0, x)
        store4(out, 1, 0, y)
        store4(out, 2, 0, z)
        store4(out, 3, 0, pick4(numbers, index, i, k))
        add3x4(a, index, i, k, load4(v, 0, 0), load4(v, 1, 0), load4(v, 2, 0))
        scatter3x4(apart, 1, load4(v, 0, 0), load4(v, 1, 0), load4(v, 2, 0))

    function = compiled(python)
    rng = np.random.default_rng(6)
    start, numbers = rng.standard_normal((6, 4)), rng.standard_normal(6)
    index = rng.integers(0, 6, (3, 4, 8))
    index[2, 3] = [5, 5, 0, 5, 0, 0, 5, 5]
    for i in range(3):
        for k in range(8):
            named, v = index[i].ravel()[4 * k : 4 * k + 4], rng.standard_normal((3, 4))
            added = start.copy()
            for l, n in enumerate(named):
                added[n, :3] += v[:, l]
            spread = np.full((4, 3, 4), 7.0)
            spread[:, 1, :3], spread[:, 1, 3] = v.T, 0.0
            for each in (function, python):
                a, out, apart = start.copy(), np.empty((4, 4)), np.full((4, 3, 4), 7.0)
                each(a, index, i, k, v, numbers, out, apart)
                assert_array_equal(out, [*start[named, :3].T, numbers[named]])
                assert_array_equal(a, added)
                assert_array_equal(apart, spread)


@for_each("K", [1, 3, 4])
def test_scatter3(K: int) -> None:
    """Eight vectors to a[8 i + l, k, :3], zeros to their padding, and to nothing else; the last place too."""

    def python(a: Array, i: int, k: int, v: Array) -> None:
        scatter3(a, i, k, load8(v, 0, 0), load8(v, 1, 0), load8(v, 2, 0))

    function = compiled(python)
    rng = np.random.default_rng(5)
    for i in range(3):
        for k in range(K):
            v = rng.standard_normal((3, 8))
            expected = np.full((24, K, 4), 7.0)
            expected[8 * i : 8 * i + 8, k, :3] = v.T
            expected[8 * i : 8 * i + 8, k, 3] = 0.0
            for each in (function, python):
                a = np.full((24, K, 4), 7.0)
                each(a, i, k, v)
                assert_array_equal(a, expected)


def test_padded_and_aligned() -> None:
    """padded: the least multiple of eight not below; aligned: zeros that begin at 64 bytes, of any shape."""
    assert [lanes.padded(n) for n in (0, 1, 7, 8, 9, 16, 17)] == [0, 8, 8, 8, 16, 16, 24]
    for shape in [(3,), (5, 4), (2, 9, 8), (0, 4), (1, 1, 1)]:
        a = lanes.aligned(*shape)
        assert a.shape == shape
        assert a.flags.c_contiguous
        assert a.size == 0 or a.ctypes.data % 64 == 0
        assert (a == 0.0).all()
