"""Nested dissection: an order of elimination for large graphs, which fills less there than minimum degree.

A few nodes are found that part the graph in two when they are left out. They are eliminated last: no column of one side
fills rows of the other. Each side is parted likewise, until it is small. See Davis, *Direct Methods for Sparse Linear
Systems*, 7.6; Kőnig's theorem gives the fewest nodes of a cut (Pothen and Fan 1990, *Computing the block triangular
form of a sparse matrix*).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.sparse
from numpy.typing import NDArray
from scipy.sparse import csgraph

from ..arrays import Floats, Ints

Flags = NDArray[np.bool_]
Graph = scipy.sparse.csr_matrix
"""Symmetric, 1 for each edge in both directions, nothing on the diagonal."""

SMALL = 100
"""Nodes of a side that is not parted any more."""
SWEEPS = (10, 90)
"""Of smoothing what tells nodes apart, first and between two tries: it follows what is near, then the whole body."""
SHARES = (0.4, 0.45, 0.5, 0.55, 0.6)
"""Of the nodes that are tried for one side."""
ROUNDS = 3
"""Times that the nodes between two sides are given to the smaller one, to look for fewer."""
UNEVEN = 4.0
"""What sides of different sizes cost: sides of one and two thirds half as much again, nearly, as nodes between them."""


def dissect(graph: Graph, rest: Callable[[Graph], Ints]) -> Ints:
    """The nodes in an order of elimination; that of small parts is what `rest` makes of them."""
    nodes = graph.shape[0]
    if nodes <= SMALL:
        return rest(graph)
    count, part = csgraph.connected_components(graph, directed=False)
    between = np.zeros(nodes, np.bool_)
    if count == 1:
        between, left = _parted(graph)
        part = left.astype(np.int64)
        if not (left.any() and (~left & ~between).any()):  # all are neighbours of all
            return rest(graph)
    sides = [np.flatnonzero((part == k) & ~between) for k in range(max(count, 2))]
    ordered = [side[dissect(graph[side][:, side], rest)] for side in sides]
    return np.concatenate([*ordered, np.flatnonzero(between)])


def _parted(graph: Graph) -> tuple[Flags, Flags]:
    """The nodes between two sides of a connected graph, and those of one side."""
    nodes = graph.shape[0]
    best, found = np.inf, (np.zeros(nodes, np.bool_), np.zeros(nodes, np.bool_))
    for far in _far_apart(graph):
        ranked = np.argsort(far, kind="stable")
        for share in SHARES:
            left = np.zeros(nodes, np.bool_)
            left[ranked[: int(share * nodes)]] = True
            least = np.inf
            for _ in range(ROUNDS):
                between = _cover(graph, left)
                left &= ~between
                one, other = int(left.sum()), int((~left & ~between).sum())
                price = int(between.sum()) * (1.0 + UNEVEN * ((one - other) / nodes) ** 2)
                if price < best:
                    best, found = price, (between, left.copy())
                if price >= least:
                    break
                least = price
                if one <= other:
                    left |= between
    return found


def _far_apart(graph: Graph) -> list[Floats]:
    """Numbers that grow from one end of the graph to the other: from distances, smoothed more and more."""
    degree = np.asarray(graph.sum(axis=1)).ravel()
    end, distances = 0, []
    for _ in range(4):
        distances.append(csgraph.shortest_path(graph, unweighted=True, indices=end))
        end = int(np.argmax(distances[-1]))
    far, found = distances[-2] - distances[-1], []
    for sweeps in SWEEPS:
        for _ in range(sweeps):
            far = 0.5 * (far + graph @ far / degree)
            far -= far.mean()
        found.append(far)
    return found


def _cover(graph: Graph, left: Flags) -> Flags:
    """The fewest nodes that all edges between `left` and the others end at (Kőnig's theorem)."""
    nodes = graph.shape[0]
    edges = graph.tocoo()
    cut = left[edges.row] & ~left[edges.col]
    start, end = edges.row[cut], edges.col[cut]
    crossing = scipy.sparse.csr_matrix((np.ones(len(start)), (start, end)), shape=(nodes, nodes))
    match = csgraph.maximum_bipartite_matching(crossing, perm_type="column")
    matched = np.flatnonzero(match >= 0)
    back = np.full(nodes, -1)
    back[match[matched]] = matched
    near, beyond = np.zeros(nodes, np.bool_), np.zeros(nodes, np.bool_)
    near[start], beyond[end] = True, True
    # What alternating paths reach from nodes of `left` that have no partner.
    reached, others = near & (match < 0), np.zeros(nodes, np.bool_)
    front = reached
    while front.any():
        new = (crossing.T @ front.astype(np.float64) > 0.0) & ~others
        others |= new
        front = np.zeros(nodes, np.bool_)
        front[back[new]] = True
        front &= ~reached
        reached = reached | front
    return np.asarray((near & ~reached) | (beyond & others))
