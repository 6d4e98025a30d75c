"""Four or eight numbers at a time: vectors of float64 that live in registers, with the operators of numbers.

numba compiles scalar code well, but its vectoriser gives up on kernels with many
arrays; here a vector is a value of its own, <8 x double> to LLVM, so that a kernel on eight tetrahedra reads like one
on a single tetrahedron. Below they are plain NumPy on an array of 4 or 8: that is what runs with
NUMBA_DISABLE_JIT=1, and what the compiled ones (lowering.py) are tested against.

A place in a C-contiguous array is named by (i, k): entry i of the first axis, in it the k-th group of 4 or 8 numbers.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..arrays import Floats, Ints, Singles

LANES = 8  # tetrahedra side by side in registers: one vector of AVX-512, two of AVX2
BATCH = 32  # tetrahedra side by side in a plain loop that is left to LLVM to vectorise

Lanes = Any  # 4 or 8 float64
Mask = Any  # 4 or 8 bool


def padded(count: int) -> int:
    """The next multiple of LANES."""
    return -(-count // LANES) * LANES


def aligned(*shape: int) -> Floats:
    """Zeros that begin at a cache line: a vector across two lines costs twice."""
    size = int(np.prod(shape))
    room = np.zeros(size + 8)
    first = (-room.ctypes.data % 64) // 8
    return room[first : first + size].reshape(shape)


def aligned_copy(values: Floats) -> Floats:
    """A copy of that kind."""
    out = aligned(*values.shape)
    out[:] = values
    return out


def _place(a: Any, i: int, k: int, width: int) -> Any:
    return a.reshape(len(a), -1)[i, width * k : width * (k + 1)]


def load4(a: Floats | Singles, i: int, k: int) -> Lanes:
    """Group k of entry i: four numbers, which may be stored in single precision."""
    return np.array(_place(a, i, k, 4), np.float64)


def load8(a: Floats, i: int, k: int) -> Lanes:
    """Group k of entry i: eight numbers."""
    return _place(a, i, k, 8).copy()


def store4(a: Floats, i: int, k: int, v: Lanes) -> None:
    """Write group k of entry i."""
    _place(a, i, k, 4)[:] = v


def store8(a: Floats, i: int, k: int, v: Lanes) -> None:
    """Write group k of entry i."""
    _place(a, i, k, 8)[:] = v


def splat4(x: float) -> Lanes:
    """The same number in four lanes."""
    return np.full(4, float(x))


def splat8(x: float) -> Lanes:
    """The same number in eight lanes."""
    return np.full(8, float(x))


def sqrt(v: Lanes) -> Lanes:
    """Square roots; of negative numbers NaN."""
    return np.sqrt(v)


def absolute(v: Lanes) -> Lanes:
    """|v|."""
    return np.abs(v)


def maximum(a: Lanes, b: Lanes) -> Lanes:
    """The larger one, lane by lane; b, which may be one number for all, where a is not a number."""
    return np.where(a > b, a, b)


def where(mask: Mask, a: Lanes, b: Lanes) -> Lanes:
    """a where the mask holds, else b."""
    return np.where(mask, a, b)


def bits(mask: Mask) -> int:
    """The mask as an integer: bit l is lane l."""
    return int(sum(1 << int(l) for l in np.flatnonzero(mask)))


def lane(v: Lanes, l: int) -> float:
    """The number in lane l."""
    return float(v[l])


def sum3(v: Lanes) -> float:
    """v[0] + v[1] + v[2] of four lanes: a dot product of padded vectors, whatever the padding holds."""
    return float(v[0] + v[1] + v[2])


def gather3(a: Floats, index: Ints, i: int, k: int) -> tuple[Lanes, Lanes, Lanes]:
    """The three components of eight vectors a[n, :3], a (n, 4), n from group k of entry i of `index`."""
    rows = a[_place(index, i, k, 8)]
    return rows[:, 0].copy(), rows[:, 1].copy(), rows[:, 2].copy()


def gather3x4(a: Floats, index: Ints, i: int, k: int) -> tuple[Lanes, Lanes, Lanes]:
    """The same of four vectors, n from the k-th four of entry i of `index`."""
    rows = a[_place(index, i, k, 4)]
    return rows[:, 0].copy(), rows[:, 1].copy(), rows[:, 2].copy()


def pick4(a: Floats, index: Ints, i: int, k: int) -> Lanes:
    """Four numbers a[n], n as in `gather3x4`."""
    return a[_place(index, i, k, 4)].copy()


def add3(a: Floats, index: Ints, i: int, k: int, x: Lanes, y: Lanes, z: Lanes) -> None:
    """Add eight vectors to a[n, :3], one after the other; n as in `gather3`. a[n, 3] is left alone."""
    for l, n in enumerate(_place(index, i, k, 8)):
        a[n, :3] += x[l], y[l], z[l]


def add3x4(a: Floats, index: Ints, i: int, k: int, x: Lanes, y: Lanes, z: Lanes) -> None:
    """The same of four vectors, n as in `gather3x4`."""
    for l, n in enumerate(_place(index, i, k, 4)):
        a[n, :3] += x[l], y[l], z[l]


def scatter3(a: Floats, i: int, k: int, x: Lanes, y: Lanes, z: Lanes) -> None:
    """Write eight vectors to a[8 i + l, k, :3], a (8 …, K, 4); a[…, 3] becomes 0."""
    a[8 * i : 8 * i + 8, k, 0], a[8 * i : 8 * i + 8, k, 1] = x, y
    a[8 * i : 8 * i + 8, k, 2], a[8 * i : 8 * i + 8, k, 3] = z, 0.0


def scatter3x4(a: Floats, k: int, x: Lanes, y: Lanes, z: Lanes) -> None:
    """Write four vectors to a[l, k, :3], a (4, K, 4); a[…, 3] becomes 0."""
    a[:4, k, 0], a[:4, k, 1], a[:4, k, 2], a[:4, k, 3] = x, y, z, 0.0


def fill4(a: Floats, i: int, k: int) -> Lanes:
    """Number k of entry i, in four lanes."""
    return np.full(4, float(a.reshape(len(a), -1)[i, k]))


def fill8(a: Floats, i: int, k: int) -> Lanes:
    """The same in eight lanes."""
    return np.full(8, float(a.reshape(len(a), -1)[i, k]))


def join8(a: Lanes, b: Lanes) -> Lanes:
    """Eight lanes of two times four."""
    return np.concatenate([a, b])


def low4(v: Lanes) -> Lanes:
    """The first four of eight lanes."""
    return v[:4].copy()


def high4(v: Lanes) -> Lanes:
    """The last four of eight lanes."""
    return v[4:].copy()


def sums3(x: Lanes, y: Lanes, z: Lanes) -> Lanes:
    """(sum3(x), sum3(y), sum3(z), 0): a padded block of columns x, y, z, transposed, times (1, 1, 1)."""
    return np.array([sum3(x), sum3(y), sum3(z), 0.0])
