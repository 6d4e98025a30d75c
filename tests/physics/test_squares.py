"""Squares of a tetrahedron's gradients onto blocks, against the outer product of all twelve numbers."""

from __future__ import annotations

import numpy as np
from cases import for_each

from finger_sim.physics.blocks import PAIR_COLUMN, PAIR_ROW
from finger_sim.physics.compile import kernel
from finger_sim.physics.squares import add_squares

MISSING = 4  # the pair that is a driven node's


@kernel
def squares(blocks, place, t, g, l, count):  # type: ignore[no-untyped-def]
    add_squares(blocks, place, t, g, l, count)


@for_each("count", [0, 1, 2, 5])
def test_squares_are_outer_products(count: int) -> None:
    """Blocks on and below the diagonal get those of their two nodes, in columns; what has no place gets nothing."""
    rng = np.random.default_rng(count)
    g = np.zeros((8, 24, 4))
    g[..., :3] = rng.normal(size=(8, 24, 3))
    place = np.array([np.full(10, -1), rng.permutation(12)[:10]])
    place[1, MISSING] = -1
    blocks = np.zeros((12, 3, 4))
    blocks[..., :3] = rng.normal(size=(12, 3, 3))
    expected = blocks.copy()
    for k in range(count):
        whole = g[5, 4 * k : 4 * k + 4, :3].ravel()
        outer = np.outer(whole, whole).reshape(4, 3, 4, 3)
        for p, a, b in zip(place[1], PAIR_ROW, PAIR_COLUMN, strict=True):
            if p >= 0:
                expected[p, :, :3] += outer[a, :, b, :].T
    squares(blocks, place, 1, g, 5, count)
    np.testing.assert_allclose(blocks, expected, rtol=1e-13, atol=1e-13)
    squares(blocks, place, 0, g, 5, count)
    np.testing.assert_allclose(blocks, expected, rtol=1e-13, atol=1e-13)
