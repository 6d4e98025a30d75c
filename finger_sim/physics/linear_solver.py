"""Sparse block LDLᵀ of a symmetric positive definite matrix of 3 × 3 blocks: ordered once, factored each step.

A = L D Lᵀ with L unit lower triangular, in the order and the pattern that `elimination.analyse` finds. Block row and
column numbers below are positions in that order ("slots"). The columns of a panel are finished one after the other,
then everything they subtract from the columns of their rows is summed in registers, two blocks of a column at a time,
which is what sixteen registers hold: each block is read and written once for a whole panel.

There are three triangular solves because there are three layouts of right-hand sides: one vector of padded nodes
(`solve`), eight lanes (`solve8`), and many that skip what is zero (`solve_many`). Each sums in the order that suits it.
"""

from __future__ import annotations

from typing import Any

from ..arrays import Floats, Ints
from .compile import kernel
from .lanes import Lanes, fill4, lane, load4, load8, splat4, store4, store8, sums3
from .model import Pattern

NODES_AT_ONCE = 16  # `solve_many` solves for the right-hand sides of so many nodes:
SIDES_AT_ONCE = 3 * NODES_AT_ONCE  # a fixed, contiguous inner loop that vectorises


@kernel
def factor(pattern: Pattern, diagonal: Floats, lower: Floats, inverse: Floats) -> bool:
    """Turn A (diagonal, lower) into L (lower) and D⁻¹ (inverse), in place. False if A is not positive definite.

    diagonal (nf, 3, 4), lower (nnz, 3, 4), inverse (nf, 3, 4): blocks by columns, each padded to four numbers.
    Uses pattern.work.

    One function of many lines, and helpers of many parameters, on purpose: cut in two, with blocks handed over as
    tuples, it gives other last bits, and with it every step.
    """
    start, row, panel, target, work = pattern.start, pattern.row, pattern.panel, pattern.target, pattern.work
    update = 0
    for s in range(panel.shape[0] - 1):
        # Row r of the panel (its own columns first) is block origin + r of column 0. One column on that is
        # height - 2 blocks on, then height - 3, …: columns get shorter. Its L D is in work[r * width + column].
        first, width = panel[s], panel[s + 1] - panel[s]
        height = width + start[first + width] - start[first + width - 1]
        origin = start[first] - 1

        for j in range(width):
            k, q, base = first + j, j * width, start[first + j] - j - 1
            a, b, c = _block(diagonal, k)
            a, b, c = _minus_products(a, b, c, lower, origin + j, height, work, q, j)
            if not _invert(a, b, c, inverse, k):
                return False
            i00, i10, i20 = inverse[k, 0, 0], inverse[k, 0, 1], inverse[k, 0, 2]
            i11, i21, i22 = inverse[k, 1, 1], inverse[k, 1, 2], inverse[k, 2, 2]
            for r in range(j + 1, height - 1, 2):
                a, b, c = _block(lower, base + r)
                d, e, f = _block(lower, base + r + 1)
                p = origin + r
                for i in range(j):
                    a, b, c = _minus_product(a, b, c, lower, p, work, q + i)
                    d, e, f = _minus_product(d, e, f, lower, p + 1, work, q + i)
                    p += height - 2 - i
                _finish(a, b, c, i00, i10, i20, i11, i21, i22, lower, base + r, work, r * width + j)
                q1 = r * width + width + j
                _finish(d, e, f, i00, i10, i20, i11, i21, i22, lower, base + r + 1, work, q1)
            if (height - j) % 2 == 0:
                r = height - 1
                a, b, c = _block(lower, base + r)
                a, b, c = _minus_products(a, b, c, lower, origin + r, height, work, q, j)
                _finish(a, b, c, i00, i10, i20, i11, i21, i22, lower, base + r, work, r * width + j)

        slots = start[first + width - 1] - width  # row[slots + r] is the slot of row r
        for t in range(width, height):
            q, place = t * width, row[slots + t]
            a, b, c = _block(diagonal, place)
            a, b, c = _minus_products(a, b, c, lower, origin + t, height, work, q, width)
            _store(diagonal, place, a, b, c)
            for r in range(t + 1, height - 1, 2):
                t0, t1 = target[update], target[update + 1]
                update += 2
                a, b, c = _block(lower, t0)
                d, e, f = _block(lower, t1)
                p = origin + r
                for j in range(width):
                    a, b, c = _minus_product(a, b, c, lower, p, work, q + j)
                    d, e, f = _minus_product(d, e, f, lower, p + 1, work, q + j)
                    p += height - 2 - j
                _store(lower, t0, a, b, c)
                _store(lower, t1, d, e, f)
            if (height - t) % 2 == 0:
                place = target[update]
                update += 1
                a, b, c = _block(lower, place)
                a, b, c = _minus_products(a, b, c, lower, origin + height - 1, height, work, q, width)
                _store(lower, place, a, b, c)
    return True


@kernel
def _block(A: Floats, p: int) -> tuple[Lanes, Lanes, Lanes]:
    return load4(A, p, 0), load4(A, p, 1), load4(A, p, 2)


@kernel
def _store(A: Floats, p: int, a: Lanes, b: Lanes, c: Lanes) -> None:
    store4(A, p, 0, a)
    store4(A, p, 1, b)
    store4(A, p, 2, c)


@kernel
def _minus_product(a: Lanes, b: Lanes, c: Lanes, L: Floats, p: int, W: Floats, q: int) -> tuple[Lanes, Lanes, Lanes]:
    """The columns (a b c) − L[p] W[q]ᵀ."""
    x, y, z = load4(L, p, 0), load4(L, p, 1), load4(L, p, 2)
    return (
        a - x * fill4(W, q, 0) - y * fill4(W, q, 4) - z * fill4(W, q, 8),
        b - x * fill4(W, q, 1) - y * fill4(W, q, 5) - z * fill4(W, q, 9),
        c - x * fill4(W, q, 2) - y * fill4(W, q, 6) - z * fill4(W, q, 10),
    )


@kernel
def _minus_products(
    a: Lanes, b: Lanes, c: Lanes, L: Floats, p: int, height: int, W: Floats, q: int, count: int
) -> tuple[Lanes, Lanes, Lanes]:
    """(a b c) minus the products of the first `count` columns of a panel; p, q: those of its column 0."""
    for i in range(count):
        a, b, c = _minus_product(a, b, c, L, p, W, q + i)
        p += height - 2 - i
    return a, b, c


@kernel
def _invert(a: Lanes, b: Lanes, c: Lanes, inverse: Floats, k: int) -> bool:
    """inverse[k] = (a b c)⁻¹ of a symmetric block; False, and nothing done, if it is not positive definite."""
    a00, a10, a20, a11, a21, a22 = lane(a, 0), lane(a, 1), lane(a, 2), lane(b, 1), lane(b, 2), lane(c, 2)
    if not a00 > 0.0:
        return False
    l10, l20 = a10 / a00, a20 / a00
    d1, t = a11 - l10 * a10, a21 - l20 * a10
    if not d1 > 0.0:
        return False
    l21 = t / d1
    d2 = a22 - l20 * a20 - l21 * t
    if not d2 > 0.0:
        return False
    m20, i1, i22 = l10 * l21 - l20, 1.0 / d1, 1.0 / d2
    i20, i21 = m20 * i22, -l21 * i22
    i00, i10, i11 = 1.0 / a00 + l10 * l10 * i1 + m20 * i20, m20 * i21 - l10 * i1, i1 - l21 * i21
    inverse[k, 0, 0], inverse[k, 0, 1], inverse[k, 0, 2] = i00, i10, i20
    inverse[k, 1, 0], inverse[k, 1, 1], inverse[k, 1, 2] = i10, i11, i21
    inverse[k, 2, 0], inverse[k, 2, 1], inverse[k, 2, 2] = i20, i21, i22
    return True


@kernel
def _finish(
    a: Lanes, b: Lanes, c: Lanes, i00: float, i10: float, i20: float, i11: float, i21: float, i22: float,
    lower: Floats, p: int, work: Floats, q: int,
) -> None:  # fmt: skip
    """work[q] = (a b c), which is L D, and lower[p] = (a b c) D⁻¹."""
    _store(work, q, a, b, c)
    _store(lower, p, a * i00 + b * i10 + c * i20, a * i10 + b * i11 + c * i21, a * i20 + b * i21 + c * i22)


@kernel
def solve(pattern: Pattern, lower: Floats, inverse: Floats, y: Floats) -> None:
    """Replace y (nf or more, 4), in slot order, by A⁻¹ y; y[:, 3] becomes 0, as the padding of inverse is."""
    start, row = pattern.start, pattern.row
    nf = inverse.shape[0]
    for k in range(nf):
        v = load4(y, k, 0)
        a, b, c = splat4(lane(v, 0)), splat4(lane(v, 1)), splat4(lane(v, 2))
        store4(y, k, 0, load4(inverse, k, 0) * a + load4(inverse, k, 1) * b + load4(inverse, k, 2) * c)
        for p in range(start[k], start[k + 1]):
            i = row[p]
            store4(y, i, 0, load4(y, i, 0) - load4(lower, p, 0) * a - load4(lower, p, 1) * b - load4(lower, p, 2) * c)
    for k in range(nf - 1, -1, -1):
        a, b, c = splat4(0.0), splat4(0.0), splat4(0.0)
        for p in range(start[k + 1] - 1, start[k] - 1, -1):  # last row first: the first was solved for just now
            x = load4(y, row[p], 0)
            a, b, c = a + load4(lower, p, 0) * x, b + load4(lower, p, 1) * x, c + load4(lower, p, 2) * x
        store4(y, k, 0, load4(y, k, 0) - sums3(a, b, c))


@kernel
def solve8(pattern: Pattern, lower: Floats, inverse: Floats, Y: Floats) -> None:
    """Replace the eight right-hand sides Y (nf, 3, 8), in slot order, by A⁻¹ Y."""
    start, row = pattern.start, pattern.row
    nf = inverse.shape[0]
    for k in range(nf):
        a, b, c = load8(Y, k, 0), load8(Y, k, 1), load8(Y, k, 2)
        for p in range(start[k], start[k + 1]):
            for j in range(3):
                left = load8(Y, row[p], j)
                store8(Y, row[p], j, left - a * lower[p, 0, j] - b * lower[p, 1, j] - c * lower[p, 2, j])
    for k in range(nf - 1, -1, -1):
        x, y, z = load8(Y, k, 0), load8(Y, k, 1), load8(Y, k, 2)
        for j in range(3):
            store8(Y, k, j, x * inverse[k, 0, j] + y * inverse[k, 1, j] + z * inverse[k, 2, j])
        x, y, z = load8(Y, k, 0), load8(Y, k, 1), load8(Y, k, 2)
        for p in range(start[k], start[k + 1]):
            a, b, c = load8(Y, row[p], 0), load8(Y, row[p], 1), load8(Y, row[p], 2)
            x = x - (a * lower[p, 0, 0] + b * lower[p, 0, 1] + c * lower[p, 0, 2])
            y = y - (a * lower[p, 1, 0] + b * lower[p, 1, 1] + c * lower[p, 1, 2])
            z = z - (a * lower[p, 2, 0] + b * lower[p, 2, 1] + c * lower[p, 2, 2])
        store8(Y, k, 0, x)
        store8(Y, k, 1, y)
        store8(Y, k, 2, z)


@kernel
def solve_many(pattern: Pattern, lower: Floats, inverse: Floats, first: int, reached: Ints, Y: Floats) -> None:
    """Replace the SIDES_AT_ONCE right-hand sides Y (nf, 3, SIDES_AT_ONCE) by A⁻¹ Y, from slot `first` on.

    Slots before `first` must be zero on entry; they are not computed. reached (nf,): 0 where Y is zero, so that
    the way down the elimination tree passes such slots over; changed on the way.
    """
    nf = inverse.shape[0]
    for k in range(first, nf):
        if reached[k] == 0:
            continue
        for p in range(pattern.start[k], pattern.start[k + 1]):
            L = lower[p]
            reached[pattern.row[p]] = 1
            columns = (L[0, 0], L[1, 0], L[2, 0], L[0, 1], L[1, 1], L[2, 1], L[0, 2], L[1, 2], L[2, 2])
            _subtract(Y[pattern.row[p]], Y[k], columns)
    for k in range(nf - 1, first - 1, -1):
        D, y = inverse[k], Y[k]
        d00, d10, d20, d11, d21, d22 = D[0, 0], D[1, 0], D[2, 0], D[1, 1], D[2, 1], D[2, 2]
        for l in range(SIDES_AT_ONCE):
            y0, y1, y2 = y[0, l], y[1, l], y[2, l]
            y[0, l] = d00 * y0 + d10 * y1 + d20 * y2
            y[1, l] = d10 * y0 + d11 * y1 + d21 * y2
            y[2, l] = d20 * y0 + d21 * y1 + d22 * y2
        for p in range(pattern.start[k], pattern.start[k + 1]):
            L = lower[p]
            rows = (L[0, 0], L[0, 1], L[0, 2], L[1, 0], L[1, 1], L[1, 2], L[2, 0], L[2, 1], L[2, 2])
            _subtract(y, Y[pattern.row[p]], rows)


@kernel
def _subtract(y: Floats, x: Floats, matrix: Any) -> None:
    """y −= M x for (3, SIDES_AT_ONCE) arrays; matrix: M's nine entries by rows."""
    a, b, c, d, e, f, g, h, i = matrix
    for l in range(SIDES_AT_ONCE):
        x0, x1, x2 = x[0, l], x[1, l], x[2, l]
        y[0, l] = y[0, l] - a * x0 - b * x1 - c * x2
        y[1, l] = y[1, l] - d * x0 - e * x1 - f * x2
        y[2, l] = y[2, l] - g * x0 - h * x1 - i * x2
