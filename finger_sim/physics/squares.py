"""Squares g gᵀ of gradients of one tetrahedron, onto the blocks of A or of what is factored."""

from __future__ import annotations

from ..arrays import Floats, Ints
from .compile import formula, stage
from .lanes import Lanes, fill8, high4, load4, load8, low4, splat8, store4


@stage
def add_squares(blocks: Floats, place: Ints, t: int, g: Floats, l: int, count: int) -> None:
    """Add `count` squares of tetrahedron t to `blocks`; place (T, 10): where each pair of its nodes is, −1: nowhere.

    g: gradient k has that of node n in g[l, 4 k + n], times the root of its weight. Of the four by four blocks those on
    and below the diagonal, two rows side by side.
    """
    for column in range(2):
        a = b = c = d = e = f = splat8(0.0)
        for k in range(count):
            upper, lower, m = load8(g, l, 2 * k), load8(g, l, 2 * k + 1), 4 * (4 * k + column)
            x, y, z = fill8(g, l, m), fill8(g, l, m + 1), fill8(g, l, m + 2)
            a, b, c = a + upper * x, b + upper * y, c + upper * z
            d, e, f = d + lower * x, e + lower * y, f + lower * z
        _add(blocks, place[t, 0] if column == 0 else -1, place[t, 1 + column], a, b, c)
        _add(blocks, place[t, 3 + column], place[t, 6 + column], d, e, f)
    for column in range(2, 4):
        a = b = c = splat8(0.0)
        for k in range(count):
            lower, m = load8(g, l, 2 * k + 1), 4 * (4 * k + column)
            a, b = a + lower * fill8(g, l, m), b + lower * fill8(g, l, m + 1)
            c = c + lower * fill8(g, l, m + 2)
        _add(blocks, place[t, 5] if column == 2 else -1, place[t, 6 + column], a, b, c)


@formula
def _add(blocks: Floats, p: int, q: int, a: Lanes, b: Lanes, c: Lanes) -> None:
    """Columns a, b, c of two blocks onto p and q, where there are such."""
    if p >= 0:
        store4(blocks, p, 0, load4(blocks, p, 0) + low4(a))
        store4(blocks, p, 1, load4(blocks, p, 1) + low4(b))
        store4(blocks, p, 2, load4(blocks, p, 2) + low4(c))
    if q >= 0:
        store4(blocks, q, 0, load4(blocks, q, 0) + high4(a))
        store4(blocks, q, 1, load4(blocks, q, 1) + high4(b))
        store4(blocks, q, 2, load4(blocks, q, 2) + high4(c))
