"""Vectors in slot order, (slots, 4): free nodes, one that is empty and zero, then a bone and its nodes (bone.py)."""

from __future__ import annotations

from ..arrays import Floats, Ints
from .compile import formula, stage
from .lanes import Lanes, lane, load4, load8, splat4, store4, store8, sum3, sums3


@formula
def copy(out: Floats, values: Floats) -> None:
    """out = values."""
    for k in range(out.shape[0]):
        store4(out, k, 0, load4(values, k, 0))


@formula
def clear(out: Floats) -> None:
    """out = 0."""
    for k in range(out.shape[0]):
        store4(out, k, 0, splat4(0.0))


@formula
def add(out: Floats, a: Floats, b: Floats, part: float) -> None:
    """out = a + part · b."""
    for k in range(out.shape[0]):
        store4(out, k, 0, load4(a, k, 0) + load4(b, k, 0) * part)


@formula
def inner(a: Floats, b: Floats) -> float:
    """a · b: two sums side by side, as each waits for the one before it."""
    even, odd, half = splat4(0.0), splat4(0.0), a.shape[0] // 2
    for k in range(half):
        even = even + load4(a, 2 * k, 0) * load4(b, 2 * k, 0)
        odd = odd + load4(a, 2 * k + 1, 0) * load4(b, 2 * k + 1, 0)
    if 2 * half < a.shape[0]:
        even = even + load4(a, 2 * half, 0) * load4(b, 2 * half, 0)
    return sum3(even + odd)


@stage
def subtract_product(nf: int, block_row: Ints, block_column: Ints, A: Floats, v: Floats, out: Floats) -> None:
    """out −= A v; A symmetric, in blocks as Model says; nf free nodes."""
    for k in range(nf):
        y = load4(A, k, 0) * v[k, 0] + load4(A, k, 1) * v[k, 1] + load4(A, k, 2) * v[k, 2]
        store4(out, k, 0, load4(out, k, 0) - y)
    p, blocks = 0, block_row.shape[0]
    while p < blocks:
        j = block_column[p]
        u = load4(v, j, 0)
        u0, u1, u2 = splat4(lane(u, 0)), splat4(lane(u, 1)), splat4(lane(u, 2))
        r = s = t = splat4(0.0)
        while p < blocks and block_column[p] == j:
            i, x = block_row[p], load4(v, block_row[p], 0)
            a, b, c = load4(A, nf + p, 0), load4(A, nf + p, 1), load4(A, nf + p, 2)
            store4(out, i, 0, load4(out, i, 0) - (a * u0 + b * u1 + c * u2))
            r, s, t = r + a * x, s + b * x, t + c * x
            p += 1
        store4(out, j, 0, load4(out, j, 0) - sums3(r, s, t))
    first = nf + block_row.shape[0]
    for k in range(first, A.shape[0]):
        d = k - first + nf + 3
        y = load4(A, k, 0) * v[d, 0] + load4(A, k, 1) * v[d, 1] + load4(A, k, 2) * v[d, 2]
        store4(out, d, 0, load4(out, d, 0) - y)


@formula
def copy_first(out: Floats, values: Floats, count: int) -> None:
    """out[:count] = values[:count], of plain numbers."""
    for k in range(count):
        out[k] = values[k]


@formula
def copy8(out: Floats, values: Floats, groups: int) -> None:
    """out = values, so many numbers of each tetrahedron, in lanes: (B, 8) or (B, groups, 8)."""
    for b in range(out.shape[0]):
        for k in range(groups):
            store8(out, b, k, load8(values, b, k))


@stage
def cross(a: Lanes, b: Lanes) -> tuple[float, float, float]:
    """a × b."""
    a0, a1, a2, b0, b1, b2 = lane(a, 0), lane(a, 1), lane(a, 2), lane(b, 0), lane(b, 1), lane(b, 2)
    return a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0
