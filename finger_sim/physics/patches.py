"""Which tetrahedra share their volume strain (dilatation.py): patches of neighbours, found once for a mesh."""

from __future__ import annotations

import heapq
from itertools import combinations_with_replacement
from typing import NamedTuple

import numpy as np

from ..arrays import Floats, Ints

USUAL = 4
"""Tetrahedra that a patch is to have: more do not lock less, and cost more."""


class Partition(NamedTuple):
    """Tetrahedra in patches; see Patches."""

    of_tet: Ints  # (T,)
    tet_place: Ints  # (T, 4)
    node: Ints  # (N,)
    pairs: Ints  # (k, 3) patch, and two of its entries


def each_alone() -> Partition:
    """No patch: every tetrahedron has its own volume strain."""
    return Partition(
        np.empty(0, np.int64), np.empty((0, 4), np.int64), np.empty(0, np.int64), np.empty((0, 3), np.int64)
    )


def partition(tets: Ints) -> Partition:
    """Patches of about USUAL tetrahedra (T, 4) around a common node."""
    of_tet = _stars(tets)
    patch, node = np.repeat(of_tet, 4), tets.ravel()
    (_, first), inverse = _unique_rows(patch, node)
    entries_patch, entries_node = patch[first], node[first]
    pairs = []
    starts = np.searchsorted(entries_patch, np.arange(of_tet.max() + 2))
    for p, (begin, end) in enumerate(zip(starts[:-1].tolist(), starts[1:].tolist(), strict=True)):
        pairs += [(p, a, b) for b, a in combinations_with_replacement(range(begin, end), 2)]
    return Partition(of_tet, inverse.reshape(-1, 4), entries_node, np.array(pairs, np.int64))


def _unique_rows(patch: Ints, node: Ints) -> tuple[tuple[Ints, Ints], Ints]:
    numbers, first, inverse = np.unique(patch * (node.max() + 1) + node, return_index=True, return_inverse=True)
    return (numbers, first), inverse


def _stars(tets: Ints) -> Ints:
    """Patch of each tetrahedron: again and again those left around the node that has nearest to USUAL of them."""
    around: list[list[int]] = [[] for _ in range(int(tets.max()) + 1)]
    for t, nodes in enumerate(tets.tolist()):
        for node in nodes:
            around[node].append(t)
    left = [len(star) for star in around]
    waiting = [(abs(count - USUAL), node, count) for node, count in enumerate(left) if count]
    heapq.heapify(waiting)
    patch = np.full(len(tets), -1, np.int64)
    count = 0
    while waiting:
        _, node, known = heapq.heappop(waiting)
        if known != left[node] or not known:
            continue
        star = [t for t in around[node] if patch[t] < 0][: USUAL + USUAL // 2]
        touched = set()
        for t in star:
            patch[t] = count
            for other in tets[t].tolist():
                left[other] -= 1
                touched.add(other)
        count += 1
        for other in sorted(touched):
            if left[other]:
                heapq.heappush(waiting, (abs(left[other] - USUAL), other, left[other]))
    return _joined(tets, patch)


def _joined(tets: Ints, patch: Ints) -> Ints:
    """Patches of fewer than half of USUAL go to the smallest one that they share a face with."""
    faces: dict[tuple[int, ...], int] = {}
    beside: list[list[int]] = [[] for _ in tets]
    for t, nodes in enumerate(tets.tolist()):
        for k in range(4):
            face = tuple(sorted(nodes[:k] + nodes[k + 1 :]))
            if face in faces:
                beside[t].append(faces[face])
                beside[faces[face]].append(t)
            else:
                faces[face] = t
    members: list[list[int]] = [[] for _ in range(int(patch.max()) + 1)]
    for t, p in enumerate(patch.tolist()):
        members[p].append(t)
    for p in sorted(range(len(members)), key=lambda p: len(members[p])):
        if not 0 < len(members[p]) < USUAL / 2:
            continue
        others = {int(patch[other]) for t in members[p] for other in beside[t]} - {p}
        if others:
            new = min(others, key=lambda q: (len(members[q]), q))
            patch[members[p]] = new
            members[new] += members[p]
            members[p] = []
    _, numbers = np.unique(patch, return_inverse=True)
    return np.asarray(numbers, np.int64)


def shares(partition: Partition, volume: Floats) -> tuple[Floats, Floats]:
    """Volume of each patch [m³], and each tetrahedron's share of its own patch's."""
    if not len(partition.of_tet):
        return np.empty(0), np.empty(0)
    whole = np.bincount(partition.of_tet, weights=volume).astype(np.float64)
    return whole, volume / whole[partition.of_tet]
