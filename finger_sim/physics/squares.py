"""Squares g gᵀ of gradients of one tetrahedron, onto the blocks of A or of what is factored."""

from __future__ import annotations

from ..arrays import Floats, Ints
from .blocks import PAIR_COLUMN, PAIR_ROW
from .compile import stage
from .lanes import fill4, load4, store4


@stage
def add_squares(blocks: Floats, place: Ints, t: int, g: Floats, l: int, count: int) -> None:
    """Add `count` squares of tetrahedron t to `blocks`; place (T, 10): where each pair of its nodes is, −1: nowhere.

    g: gradient k has that of node n in g[l, 4 k + n], times the root of its weight.
    """
    for e in range(10):
        p = place[t, e]
        if p < 0:
            continue
        row, column = PAIR_ROW[e], PAIR_COLUMN[e]
        x, y, z = load4(blocks, p, 0), load4(blocks, p, 1), load4(blocks, p, 2)
        for k in range(count):
            a, m = load4(g, l, 4 * k + row), 4 * (4 * k + column)
            x, y, z = x + a * fill4(g, l, m), y + a * fill4(g, l, m + 1), z + a * fill4(g, l, m + 2)
        store4(blocks, p, 0, x)
        store4(blocks, p, 1, y)
        store4(blocks, p, 2, z)
