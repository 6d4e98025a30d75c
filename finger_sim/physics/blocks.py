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
    tet_block: Ints
    pair_row: Ints
    pair_column: Ints
    assembly: Ints
    assembly_start: Ints
    patch_assembly: Ints
    patch_place: Ints
    row: Ints
    column: Ints
    place: Ints


def blocks_of(tet_slot: Ints, patch_pairs: Ints, entry_slot: Ints, nf: int, pattern: Pattern) -> Blocks:
    """The blocks of A for tetrahedra with these slots, (T, 4), and for the nodes of patches.

    patch_pairs: (k, 3) patch and two of its entries; entry_slot: (N,) slot of each entry (see Patches).
    """
    count = len(tet_slot)
    pairs = np.array(PAIRS)
    slots = tet_slot[:, pairs]  # (T, 10, 2)
    swap = slots[..., 0] < slots[..., 1]
    pair_row = np.ascontiguousarray(np.where(swap, pairs[:, 1], pairs[:, 0]))
    pair_column = np.ascontiguousarray(np.where(swap, pairs[:, 0], pairs[:, 1]))
    ends = entry_slot[patch_pairs[:, 1:]]
    both = np.concatenate([slots.reshape(-1, 2), ends])
    block, place, row, column, place_of = _numbered(both.max(axis=1), both.min(axis=1), nf, pattern)
    tet_block = block[: 10 * count].reshape(count, 10)
    t, e = np.nonzero(tet_block >= 0)
    by_block = np.argsort(tet_block[t, e], kind="stable")
    t, e = t[by_block], e[by_block]
    start = np.searchsorted(tet_block[t, e], np.arange(block.max(initial=-1) + 2))
    assembly = np.stack([t, pair_row[t, e], pair_column[t, e]], axis=1)
    patch_block, turned = block[10 * count :], ends[:, 0] < ends[:, 1]
    entries = np.where(turned[:, None], patch_pairs[:, :0:-1], patch_pairs[:, 1:])
    patch_assembly = np.column_stack([patch_pairs[:, 0], entries, patch_block])[patch_block >= 0]
    patch_place = place[10 * count :][patch_block >= 0]
    tet_place = place[: 10 * count].reshape(count, 10)
    return Blocks(
        tet_place, tet_block, pair_row, pair_column, assembly, start, patch_assembly, patch_place, row, column, place_of
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
