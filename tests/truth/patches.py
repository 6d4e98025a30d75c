"""Partitions of a mesh's tetrahedra into patches that share one volume strain: numbers of patches from 0, (T,).

    `freedoms`  joined until each patch has a vertex' worth of freedoms; the best for its cost by measurement
    `stars`     cut from the stars of vertices, of about `size` tetrahedra
    `faces`     grown over common facets, as compact as can be, of about `size`

As ν nears ½ each volume strain becomes a constraint, and a free node has three freedoms. Three freedoms a constraint
are the continuum's. A patch that has few free nodes, or shares them with many patches, takes from them what they need
to deform: a patch with one free node holds that node.

Every tetrahedron is in one patch. The tetrahedra of a patch hang together over facets; in `stars`, and where
leftovers joined a neighbour, over vertices. The same mesh gives the same patches. `held` (n,) tells the driven
nodes. A tetrahedron without a free node is a patch of its own: it does not deform, and in another patch its volume
would only dilute the volume strain.
"""

from __future__ import annotations

import heapq
from collections import Counter, defaultdict

import numpy as np
from numpy.typing import NDArray
from truth.problems import FACETS, Ints

Flags = NDArray[np.bool_]

LARGEST_STAR = 1.5
"""A star of up to so many times the wanted size becomes a patch as it is; of a larger one a part."""
SMALLEST = 0.5
"""A patch of fewer than so many times the wanted size is joined to a neighbour."""
FEW = 3
"""Free nodes below which a patch first looks for a neighbour that brings others: one tetrahedron's worth on a facet."""


def neighbours(tets: Ints) -> list[list[int]]:
    """Of each tetrahedron those it shares a facet with, ascending."""
    sides = defaultdict(list)
    facets = np.sort(tets[:, FACETS].reshape(-1, 3), axis=1).tolist()
    for number, facet in enumerate(facets):
        sides[tuple(facet)].append(number // 4)
    found: list[list[int]] = [[] for _ in tets]
    for pair in sides.values():
        if len(pair) == 2:
            found[pair[0]].append(pair[1])
            found[pair[1]].append(pair[0])
    return [sorted(row) for row in found]


def around(tets: Ints) -> dict[int, list[int]]:
    """Of each vertex the tetrahedra at it, ascending."""
    found = defaultdict(list)
    for tet, nodes in enumerate(tets.tolist()):
        for node in nodes:
            found[node].append(tet)
    return dict(sorted(found.items()))


def _numbered(labels: Ints) -> Ints:
    """The same patches, numbered from 0 in the order of their first tetrahedra."""
    _, first, label = np.unique(labels, return_index=True, return_inverse=True)
    return np.argsort(np.argsort(first))[label]


class _Merging:
    """Patches that begin as single tetrahedra and are joined two by two."""

    def __init__(self, tets: Ints, held: Flags) -> None:
        rigid = held[tets].all(1)
        beside = neighbours(tets)
        self.label = np.arange(len(tets))
        self.members = {tet: [tet] for tet in np.flatnonzero(~rigid).tolist()}
        self.nodes = {tet: {node for node in tets[tet].tolist() if not held[node]} for tet in self.members}
        self.beside = {tet: {other for other in beside[tet] if not rigid[other]} for tet in self.members}
        self.at: dict[int, set[int]] = defaultdict(set)
        for patch, nodes in self.nodes.items():
            for node in nodes:
                self.at[node].add(patch)

    def share(self, patch: int) -> float:
        """Free nodes of the patch, each divided by the number of patches at it."""
        return round(sum(1.0 / len(self.at[node]) for node in sorted(self.nodes[patch])), 9)

    def partner(self, patch: int, largest: int) -> int | None:
        """The neighbour to join: of at most `largest` tetrahedra together; with most of the patch's nodes, so that the
        matrix fills least; one that brings other nodes to a patch of few; with the least share.
        """
        mine = self.nodes[patch]
        room = largest - len(self.members[patch])

        def cost(other: int) -> tuple[int, int, float, int]:
            theirs = self.nodes[other]
            return len(mine - theirs), max(0, FEW - len(mine | theirs)), self.share(other), other

        return min((p for p in self.beside[patch] if len(self.members[p]) <= room), key=cost, default=None)

    def join(self, patch: int, other: int) -> set[int]:
        """Make one of the two, under the first's number. The patches whose share that changed."""
        self.label[self.members[other]] = patch
        self.members[patch] += self.members.pop(other)
        touched = {patch}
        for node in self.nodes[other]:
            self.at[node].remove(other)
            touched |= self.at[node]
            self.at[node].add(patch)
        self.nodes[patch] |= self.nodes.pop(other)
        for third in self.beside.pop(other):
            self.beside[third].discard(other)
            if third != patch:
                self.beside[third].add(patch)
                self.beside[patch].add(third)
        return touched


def freedoms(tets: Ints, held: Flags, wanted: float = 1.25, size: int = 8, largest: int = 16) -> Ints:
    """Patches of a share of `wanted` free nodes, where a node is shared out evenly among the patches at it.

    Again and again the patch with the least share is joined to a neighbour: one with which it has up to `size`
    tetrahedra, or else up to `largest`. A patch that finds none stays short of its share.
    """
    tets = np.asarray(tets, np.int64)
    patches = _Merging(tets, held)
    heap = [(patches.share(patch), patch) for patch in patches.members]
    heapq.heapify(heap)
    while heap:
        share, patch = heapq.heappop(heap)
        if patch not in patches.members or share != patches.share(patch):
            continue  # an entry from before a join
        if share >= wanted:
            break
        other = patches.partner(patch, size)
        if other is None:
            other = patches.partner(patch, largest)
        if other is not None:
            for changed in patches.join(patch, other):
                heapq.heappush(heap, (patches.share(changed), changed))
    return _numbered(patches.label)


class _Partition:
    """Patch numbers while they are given out, −1 where none is yet."""

    def __init__(self, tets: Ints, held: Flags) -> None:
        self.tets = np.asarray(tets, np.int64)
        self.held = held
        self.rigid = held[self.tets].all(1)
        self.beside = neighbours(self.tets)
        self.around = around(self.tets)
        self.label = np.full(len(self.tets), -1)
        self.count = 0
        for tet in np.flatnonzero(self.rigid).tolist():
            self.give([tet])

    def give(self, members: list[int]) -> None:
        self.label[members] = self.count
        self.count += 1

    def start(self, left: list[int] | set[int]) -> int:
        """The tetrahedron with the fewest neighbours that are not given out: what it would leave is cut off least."""
        return min(left, key=lambda tet: (sum(self.label[other] < 0 for other in self.beside[tet]), tet))

    def cluster(self, start: int, size: int, allowed: set[int]) -> list[int]:
        """Up to `size` allowed tetrahedra from `start` on: the next shares a facet, and the most nodes, with these."""
        members, nodes = [start], set(self.tets[start].tolist())
        while len(members) < size:
            rim = {tet for one in members for tet in self.beside[one] if tet in allowed}.difference(members)
            if not rim:
                break
            costs = [
                (
                    len(set(self.tets[tet].tolist()) - nodes),
                    len(allowed.intersection(self.beside[tet]) - set(members)),
                    tet,
                )
                for tet in rim
            ]
            best = min(costs)[2]
            members.append(best)
            nodes.update(self.tets[best].tolist())
        return members

    def joined(self, smallest: int) -> Ints:
        """The patches, each too small one joined to its smallest neighbour: over a facet, or else over a vertex."""
        sizes = Counter(self.label.tolist())
        rigid = set(self.label[self.rigid].tolist())
        for own in sorted(sizes, key=lambda patch: (sizes[patch], patch)):
            if own in rigid or sizes[own] >= smallest:
                continue
            members = np.flatnonzero(self.label == own).tolist()
            over_facets = {self.label[other] for tet in members for other in self.beside[tet]}
            over_nodes = {self.label[tet] for node in np.unique(self.tets[members]) for tet in self.around[node]}
            for near in (over_facets, over_nodes):
                others = near - rigid - {own}
                if others:
                    other = min(others, key=lambda patch: (sizes[patch], patch))
                    self.label[members] = other
                    sizes[other] += sizes.pop(own)
                    break
        return _numbered(self.label)


def stars(tets: Ints, held: Flags, size: int = 4) -> Ints:
    """Patches cut from vertices' stars: of free vertices before driven ones, what is left nearest to `size` first."""
    part = _Partition(tets, held)
    left = part.around
    while (part.label < 0).any():
        rest = {node: [tet for tet in star if part.label[tet] < 0] for node, star in left.items()}
        left = {node: star for node, star in rest.items() if star}
        node = min(left, key=lambda v: (bool(held[v]), abs(len(left[v]) - size), v))
        star = left[node]
        if len(star) > LARGEST_STAR * size:
            star = part.cluster(part.start(star), size, set(star))
        part.give(star)
    return part.joined(int(np.ceil(SMALLEST * size)))


def faces(tets: Ints, held: Flags, size: int = 4) -> Ints:
    """Patches grown over common facets."""
    part = _Partition(tets, held)
    left = set(np.flatnonzero(part.label < 0).tolist())
    while left:
        members = part.cluster(part.start(left), size, left)
        part.give(members)
        left.difference_update(members)
    return part.joined(int(np.ceil(SMALLEST * size)))
