"""Where the 3 × 3 blocks of A lie, and which tetrahedra add to which of them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..arrays import Ints
from .elimination import block_of
from .model import Pattern

PAIRS = [(a, b) for a in range(4) for b in range(a + 1)]
"""Pairs of a tetrahedron's nodes: the blocks on and below the diagonal that it adds to."""


class Blocks(NamedTuple):
    """The blocks of A and what adds to them: see Model."""

    tet_place: Ints
    pair_row: Ints
    pair_column: Ints
    assembly: Ints
    row: Ints
    column: Ints
    place: Ints


def blocks_of(tet_slot: Ints, nf: int, pattern: Pattern) -> Blocks:
    """The blocks of A for tetrahedra with these slots, (T, 4)."""
    count = len(tet_slot)
    pairs = np.array(PAIRS)
    slots = tet_slot[:, pairs]  # (T, 10, 2)
    swap = slots[..., 0] < slots[..., 1]
    pair_row = np.ascontiguousarray(np.where(swap, pairs[:, 1], pairs[:, 0]))
    pair_column = np.ascontiguousarray(np.where(swap, pairs[:, 0], pairs[:, 1]))
    rows, columns = slots.max(axis=2), slots.min(axis=2)
    exists = rows < nf
    below = exists & (rows != columns)
    numbers, inverse = np.unique(rows[below] * nf + columns[below], return_inverse=True)
    row, column = numbers // nf, numbers % nf
    place = np.array([block_of(pattern, int(r), int(c)) for r, c in zip(row, column, strict=True)], np.int64)
    block, tet_place = np.full((count, 10), -1, np.int64), np.full((count, 10), -1, np.int64)
    diagonal = exists & (rows == columns)
    block[diagonal] = tet_place[diagonal] = rows[diagonal]
    block[below], tet_place[below] = nf + inverse, place[inverse]
    bone = (rows > nf) & (columns != nf)
    if bone.any():
        beside = bone & (rows != columns)
        slots = rows.max() + 1
        numbers, inverse = np.unique(rows[beside] * slots + columns[beside], return_inverse=True)
        block[beside] = nf + len(row) + inverse
        row, column = np.append(row, numbers // slots), np.append(column, numbers % slots)
        diagonal = bone & (rows == columns)
        block[diagonal] = nf + len(row) + rows[diagonal] - (nf + 3)
    t, e = np.nonzero(block >= 0)
    assembly = np.stack([t, pair_row[t, e], pair_column[t, e], block[t, e]], axis=1)
    return Blocks(tet_place, pair_row, pair_column, assembly, row, column, place)
