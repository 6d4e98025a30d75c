"""Which tetrahedra share their volume strain (dilatation.py): patches of neighbours, found once for a mesh."""

from __future__ import annotations

import heapq
import math
from itertools import combinations, combinations_with_replacement, pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..arrays import Floats, Ints

Flags = NDArray[np.bool_]

WANTED = 1.25
"""Free nodes that a patch is to have to itself, each shared out evenly among the patches at it.

As volume is all but kept each patch is a constraint: one that has less than a node's three freedoms to meet it holds
its nodes. More frees little more, and fills the matrix.
"""
USUAL, MOST = 8, 16
"""Tetrahedra of a patch: joined up to the first, and further only where it lacks nodes."""
FEW = 3
"""Free nodes below which a patch is joined rather to one that brings others."""


class Partition(NamedTuple):
    """Tetrahedra in patches; see Patches."""

    of_tet: Ints  # (T,)
    tet_place: Ints  # (T, 4)
    start: Ints  # (P + 1,)
    node: Ints  # (N,)
    pairs: Ints  # (k, 3) patch, and two of its entries


def each_alone() -> Partition:
    """No patch: every tetrahedron has its own volume strain."""
    none = np.empty(0, np.int64)
    return Partition(none, none.reshape(0, 4), np.zeros(1, np.int64), none, none.reshape(0, 3))


def partition(tets: Ints, is_free: Flags) -> Partition:
    """Patches of tetrahedra (T, 4) that have WANTED of the free nodes. The same mesh gives the same ones."""
    of_tet = _patches(tets, is_free)
    patch, node = np.repeat(of_tet, 4), tets.ravel()
    _, first, inverse = np.unique(patch * (node.max() + 1) + node, return_index=True, return_inverse=True)
    of_entry = patch[first]
    start = np.searchsorted(of_entry, np.arange(of_tet.max() + 2))
    pairs = [
        (p, a, b)
        for p, (begin, end) in enumerate(pairwise(start.tolist()))
        for b, a in combinations_with_replacement(range(begin, end), 2)
    ]
    return Partition(of_tet, inverse.reshape(-1, 4), start, node[first], np.array(pairs, np.int64))


def _patches(tets: Ints, is_free: Flags) -> Ints:
    """Patch of each tetrahedron: again and again that with the least share of free nodes is joined to a neighbour.

    A share only grows as others join. So one that has waited is looked at anew when it comes up, and not before.
    """
    joining = _Joining(tets, is_free)
    waiting = [(joining.share(patch), patch) for patch in joining.members]
    heapq.heapify(waiting)
    alone: set[int] = set()  # could join none, as they were
    while waiting:
        before, patch = heapq.heappop(waiting)
        if patch not in joining.members:
            continue
        share = joining.share(patch)
        if share != before:
            heapq.heappush(waiting, (share, patch))
            continue
        if share >= WANTED:
            break
        other = joining.partner(patch, USUAL)
        other = joining.partner(patch, MOST) if other is None else other
        if other is None:
            alone.add(patch)
            continue
        touched = joining.join(patch, other)
        for again in (alone & touched) | {patch}:
            heapq.heappush(waiting, (joining.share(again), again))
        alone -= touched | {other}
    return np.asarray(np.unique(joining.patch, return_inverse=True)[1], np.int64)


class _Joining:
    """Patches that begin as one tetrahedron each. One without a free node stays alone: it has no volume strain."""

    def __init__(self, tets: Ints, is_free: Flags) -> None:
        moves = is_free[tets].any(axis=1)
        self.patch = np.arange(len(tets))
        own = np.flatnonzero(moves).tolist()
        self.members = {t: [t] for t in own}
        self.nodes = {t: {node for node in tets[t].tolist() if is_free[node]} for t in own}
        self.beside: dict[int, set[int]] = {t: set() for t in own}
        faces: dict[tuple[int, ...], int] = {}
        for t in own:
            for face in combinations(sorted(tets[t].tolist()), 3):
                if (other := faces.setdefault(face, t)) != t:
                    self.beside[t].add(other)
                    self.beside[other].add(t)
        self.at: dict[int, set[int]] = {}
        for t, nodes in self.nodes.items():
            for node in nodes:
                self.at.setdefault(node, set()).add(t)

    def partner(self, patch: int, most: int) -> int | None:
        """The neighbour to join, with at most so many tetrahedra together: most of the patch's nodes, as that fills the
        matrix least; others where the patch has few; the least share."""
        mine, room = self.nodes[patch], most - len(self.members[patch])

        def cost(other: int) -> tuple[int, int, float, int]:
            theirs = self.nodes[other]
            return len(mine - theirs), max(0, FEW - len(mine | theirs)), self.share(other), other

        return min((each for each in self.beside[patch] if len(self.members[each]) <= room), key=cost, default=None)

    def join(self, patch: int, other: int) -> set[int]:
        """One patch of the two, under the first's number; the patches whose shares this changed."""
        self.patch[self.members[other]] = patch
        self.members[patch] += self.members.pop(other)
        touched = {patch}
        for node in self.nodes[other]:
            self.at[node].remove(other)
            touched |= self.at[node]
            self.at[node].add(patch)
        self.nodes[patch] |= self.nodes.pop(other)
        for third in self.beside.pop(other):
            self.beside[third].remove(other)
            if third != patch:
                self.beside[third].add(patch)
                self.beside[patch].add(third)
        return touched

    def share(self, patch: int) -> float:
        """Free nodes that a patch has, each shared out evenly."""
        return math.fsum(1.0 / len(self.at[node]) for node in self.nodes[patch])


def shares(partition: Partition, volume: Floats) -> tuple[Floats, Floats]:
    """Volume of each patch [m³], and each tetrahedron's share of its own patch's."""
    if not len(partition.of_tet):
        return np.empty(0), np.empty(0)
    whole = np.bincount(partition.of_tet, weights=volume).astype(np.float64)
    return whole, volume / whole[partition.of_tet]
