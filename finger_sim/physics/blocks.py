"""Where the 3 × 3 blocks of A lie, and which tetrahedra add to which of them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..arrays import Ints
from .elimination import block_of
from .model import Pattern

PAIR_ROW, PAIR_COLUMN = (0, 1, 1, 2, 2, 2, 3, 3, 3, 3), (0, 0, 1, 0, 1, 2, 0, 1, 2, 3)
"""Pairs of a tetrahedron's nodes, by ascending slots: row and column of the blocks on and below the diagonal."""


class Blocks(NamedTuple):
    """The blocks of A and what adds to them: see Model."""

    tet_place: Ints
    tet_block: Ints
    assembly: Ints
    assembly_start: Ints
    patch_assembly: Ints
    patch_place: Ints
    row: Ints
    column: Ints
    place: Ints


def blocks_of(tet_slot: Ints, patch_pairs: Ints, entry_slot: Ints, nf: int, pattern: Pattern) -> Blocks:
    """The blocks of A for tetrahedra with these slots, (T, 4) ascending, and for the nodes of patches.

    patch_pairs: (k, 3) patch and two of its entries; entry_slot: (N,) slot of each entry (see Patches).
    """
    count = len(tet_slot)
    pairs = np.column_stack([PAIR_ROW, PAIR_COLUMN])
    slots = tet_slot[:, pairs]  # (T, 10, 2)
    ends = entry_slot[patch_pairs[:, 1:]]
    both = np.concatenate([slots.reshape(-1, 2), ends])
    block, place, row, column, place_of = _numbered(both.max(axis=1), both.min(axis=1), nf, pattern)
    tet_block = block[: 10 * count].reshape(count, 10)
    t, e = np.nonzero(tet_block >= 0)
    by_block = np.argsort(tet_block[t, e], kind="stable")
    t, e = t[by_block], e[by_block]
    start = np.searchsorted(tet_block[t, e], np.arange(block.max(initial=-1) + 2))
    assembly = np.column_stack([t, pairs[e]])
    patch_block, turned = block[10 * count :], ends[:, 0] < ends[:, 1]
    entries = np.where(turned[:, None], patch_pairs[:, :0:-1], patch_pairs[:, 1:])
    patch_assembly = np.column_stack([patch_pairs[:, 0], entries, patch_block])[patch_block >= 0]
    patch_place = place[10 * count :][patch_block >= 0]
    tet_place = place[: 10 * count].reshape(count, 10)
    return Blocks(
        tet_place, tet_block, assembly, start, patch_assembly, patch_place, row, column, place_of
    )  # fmt: skip


def _numbered(rows: Ints, columns: Ints, nf: int, pattern: Pattern) -> tuple[Ints, Ints, Ints, Ints, Ints]:
    """Of pairs of slots, row ≥ column: their blocks of A, their places in the factorisation, −1 where there is none.

    And of the blocks below A's diagonal, column after column: row, column, and the place in the factorisation, where
    they have one.
    """
    exists = rows < nf
    below = exists & (rows != columns)
    numbers, inverse = np.unique(columns[below] * nf + rows[below], return_inverse=True)
    row, column = numbers % nf, numbers // nf
    place_of = np.array([nf + block_of(pattern, int(r), int(c)) for r, c in zip(row, column, strict=True)], np.int64)
    block, place = np.full(len(rows), -1, np.int64), np.full(len(rows), -1, np.int64)
    diagonal = exists & (rows == columns)
    block[diagonal] = place[diagonal] = rows[diagonal]
    block[below], place[below] = nf + inverse, place_of[inverse]
    bone = (rows > nf) & (columns != nf)
    if bone.any():
        beside = bone & (rows != columns)
        slots = rows.max() + 1
        numbers, inverse = np.unique(rows[beside] * slots + columns[beside], return_inverse=True)
        block[beside] = nf + len(row) + inverse
        row, column = np.append(row, numbers // slots), np.append(column, numbers % slots)
        diagonal = bone & (rows == columns)
        block[diagonal] = nf + len(row) + rows[diagonal] - (nf + 3)
    return block, place, row, column, place_of
