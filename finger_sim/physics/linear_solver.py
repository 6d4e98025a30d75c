"""Sparse block LDLᵀ of a symmetric positive definite matrix of 3 × 3 blocks: ordered once, factored each step.

A = L D Lᵀ with L unit lower triangular, in the order and the pattern that `elimination.analyse` finds. Block row and
column numbers below are positions in that order ("slots"). The columns of a panel are finished one after the other,
then everything they subtract from the columns of their rows is summed in registers, blocks of two rows side by side in
eight lanes, for two columns at a time: each block is read and written once for a whole panel. Thirty-two registers of
eight hold four rows.

There are three triangular solves because there are three layouts of right-hand sides: one vector of padded nodes
(`solve`), eight lanes (`solve8`), and many that skip what is zero (`solve_many`). Each sums in the order that suits it.
"""

from __future__ import annotations

from typing import Any

from ..arrays import Floats, Ints, Singles
from .compile import REGISTERS_OF_EIGHT, kernel
from .lanes import Lanes, fill4, fill8, high4, join8, lane, load4, load8, low4, splat4, splat8, store4, store8, sums3
from .model import Pattern

NODES_AT_ONCE = 16  # `solve_many` solves for the right-hand sides of so many nodes:
SIDES_AT_ONCE = 3 * NODES_AT_ONCE  # a fixed, contiguous inner loop that vectorises
MANY_BLOCKS = 16_000  # of L, 1.5 MB: from here on it is not all in a processor's own cache


@kernel
def factor(pattern: Pattern, blocks: Floats, inverse: Floats) -> bool:
    """Turn A into L, in place, and give D⁻¹ (inverse). False if A is not positive definite.

    blocks (nf + nnz + 1, 3, 4): diagonal blocks, those below the diagonal, and one for what nobody wants; each by
    columns padded to four numbers. inverse (nf, 3, 4) likewise. Uses pattern.work and pattern.pairs.
    """
    start, panel, target, work, pairs = pattern.start, pattern.panel, pattern.target, pattern.work, pattern.pairs
    nf, nowhere = inverse.shape[0], blocks.shape[0] - 1
    update = 0
    for s in range(panel.shape[0] - 1):
        # Row r of the panel (its own columns first): its L D is in work[r * width + column], its L in one half of
        # pairs[r // 2 * width + column].
        first, width = panel[s], panel[s + 1] - panel[s]
        height = width + start[first + width] - start[first + width - 1]
        for j in range(width):
            k, q, base = first + j, j * width, nf + start[first + j] - j - 1
            a, b, c = load4(blocks, k, 0), load4(blocks, k, 1), load4(blocks, k, 2)
            for i in range(j):
                p, half = j // 2 * width + i, j % 2
                x, y, z = load4(pairs, p, half), load4(pairs, p, 2 + half), load4(pairs, p, 4 + half)
                a = a - x * fill4(work, q + i, 0) - y * fill4(work, q + i, 4) - z * fill4(work, q + i, 8)
                b = b - x * fill4(work, q + i, 1) - y * fill4(work, q + i, 5) - z * fill4(work, q + i, 9)
                c = c - x * fill4(work, q + i, 2) - y * fill4(work, q + i, 6) - z * fill4(work, q + i, 10)
            if not _invert(a, b, c, inverse, k):
                return False
            for m in range((j + 1) // 2, (height + 1) // 2):
                p0 = base + 2 * m if 2 * m > j else nowhere
                p1 = base + 2 * m + 1 if 2 * m + 1 < height else nowhere
                d = join8(load4(blocks, p0, 0), load4(blocks, p1, 0))
                e = join8(load4(blocks, p0, 1), load4(blocks, p1, 1))
                f = join8(load4(blocks, p0, 2), load4(blocks, p1, 2))
                for i in range(j):
                    d, e, f = _minus_product(d, e, f, pairs, m * width + i, work, q + i)
                _store_halves(work, 2 * m * width + j, (2 * m + 1) * width + j, d, e, f)
                x = d * fill8(inverse, k, 0) + e * fill8(inverse, k, 1) + f * fill8(inverse, k, 2)
                y = d * fill8(inverse, k, 4) + e * fill8(inverse, k, 5) + f * fill8(inverse, k, 6)
                z = d * fill8(inverse, k, 8) + e * fill8(inverse, k, 9) + f * fill8(inverse, k, 10)
                _store_halves(blocks, p0, p1, x, y, z)
                p = m * width + j
                store8(pairs, p, 0, x)
                store8(pairs, p, 1, y)
                store8(pairs, p, 2, z)
        count = (height + 1) // 2
        for t in range(width // 2, count):
            m, q = t, 2 * t * width
            if REGISTERS_OF_EIGHT:
                while m + 1 < count:
                    _subtract_four(blocks, target, update, pairs, m * width, work, q, width)
                    m, update = m + 2, update + 8
            while m < count:
                _subtract_two(blocks, target, update, pairs, m * width, work, q, width)
                m, update = m + 1, update + 4
    return True


@kernel
def _minus_product(a: Lanes, b: Lanes, c: Lanes, L: Floats, p: int, W: Floats, q: int) -> tuple[Lanes, Lanes, Lanes]:
    """The columns (a b c) − L[p] W[q]ᵀ, of two blocks side by side."""
    x, y, z = load8(L, p, 0), load8(L, p, 1), load8(L, p, 2)
    return (
        a - x * fill8(W, q, 0) - y * fill8(W, q, 4) - z * fill8(W, q, 8),
        b - x * fill8(W, q, 1) - y * fill8(W, q, 5) - z * fill8(W, q, 9),
        c - x * fill8(W, q, 2) - y * fill8(W, q, 6) - z * fill8(W, q, 10),
    )


@kernel
def _subtract_two(blocks: Floats, target: Ints, u: int, L: Floats, p: int, W: Floats, q: int, width: int) -> None:
    """Products of all columns of a panel, of two rows (L[p …]) with two (W[q …]), from blocks target[u] to [u + 3]."""
    a = b = c = d = e = f = splat8(0.0)
    for j in range(width):
        a, b, c = _minus_product(a, b, c, L, p + j, W, q + j)
        d, e, f = _minus_product(d, e, f, L, p + j, W, q + width + j)
    _add_halves(blocks, target[u], target[u + 1], a, b, c)
    _add_halves(blocks, target[u + 2], target[u + 3], d, e, f)


@kernel
def _subtract_four(blocks: Floats, target: Ints, u: int, L: Floats, p: int, W: Floats, q: int, width: int) -> None:
    """The same of four rows with two: the two times two of the first two rows, then those of the others."""
    a = b = c = d = e = f = splat8(0.0)
    g = h = i = k = l = m = splat8(0.0)
    for j in range(width):
        a, b, c = _minus_product(a, b, c, L, p + j, W, q + j)
        g, h, i = _minus_product(g, h, i, L, p + width + j, W, q + j)
        d, e, f = _minus_product(d, e, f, L, p + j, W, q + width + j)
        k, l, m = _minus_product(k, l, m, L, p + width + j, W, q + width + j)
    _add_halves(blocks, target[u], target[u + 1], a, b, c)
    _add_halves(blocks, target[u + 2], target[u + 3], d, e, f)
    _add_halves(blocks, target[u + 4], target[u + 5], g, h, i)
    _add_halves(blocks, target[u + 6], target[u + 7], k, l, m)


@kernel
def _store_halves(A: Floats, p0: int, p1: int, a: Lanes, b: Lanes, c: Lanes) -> None:
    """A[p0], A[p1] = (a b c)."""
    store4(A, p0, 0, low4(a))
    store4(A, p0, 1, low4(b))
    store4(A, p0, 2, low4(c))
    store4(A, p1, 0, high4(a))
    store4(A, p1, 1, high4(b))
    store4(A, p1, 2, high4(c))


@kernel
def _add_halves(A: Floats, p0: int, p1: int, a: Lanes, b: Lanes, c: Lanes) -> None:
    """A[p0], A[p1] += (a b c)."""
    store4(A, p0, 0, load4(A, p0, 0) + low4(a))
    store4(A, p0, 1, load4(A, p0, 1) + low4(b))
    store4(A, p0, 2, load4(A, p0, 2) + low4(c))
    store4(A, p1, 0, load4(A, p1, 0) + high4(a))
    store4(A, p1, 1, load4(A, p1, 1) + high4(b))
    store4(A, p1, 2, load4(A, p1, 2) + high4(c))


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
def solve(pattern: Pattern, lower: Floats | Singles, inverse: Floats, y: Floats) -> None:
    """Replace y (nf or more, 4), in slot order, by A⁻¹ y; y[:, 3] becomes 0, as the padding of inverse is.

    lower may be in single precision.
    """
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
