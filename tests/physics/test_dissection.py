"""Nested dissection: orders of elimination, against brute force and against what is known of grids."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import scipy.sparse
from cases import for_each
from physics_helpers import loaded

from finger_sim.physics import dissection, elimination, linear_solver


def graph_of(nodes: int, edges: Any) -> dissection.Graph:
    """Both directions of each edge."""
    ends = np.array(sorted(edges), np.int64).reshape(-1, 2)
    once = scipy.sparse.coo_matrix((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(nodes, nodes))
    return scipy.sparse.csr_matrix(once + once.T)


def grid(*sizes: int) -> tuple[int, list[tuple[int, int]]]:
    """Nodes of a grid, and edges to the next ones along its axes."""
    number = np.arange(int(np.prod(sizes))).reshape(sizes)
    edges = []
    for axis in range(len(sizes)):
        there = np.moveaxis(number, axis, 0)
        edges += list(zip(there[:-1].ravel().tolist(), there[1:].ravel().tolist(), strict=True))
    return number.size, edges


def as_they_come(graph: dissection.Graph) -> Any:
    return np.arange(graph.shape[0])


def products(nodes: int, edges: Any, order: Any) -> int:
    """Products of entries that elimination in this order takes, by elimination itself."""
    rows: list[set[int]] = [set() for _ in range(nodes)]
    for a, b in edges:
        rows[a].add(b)
        rows[b].add(a)
    total = 0
    for node in order:
        others = rows[node]
        total += len(others) * (len(others) + 1) // 2
        for other in others:
            rows[other] |= others - {other}
            rows[other].discard(node)
    return total


GRAPHS: dict[str, tuple[int, list[tuple[int, int]]]] = {
    "two boxes": (
        2 * 216,
        [*grid(6, 6, 6)[1], *((a + 216, b + 216) for a, b in grid(6, 6, 6)[1])],
    ),
    "all with all": (150, list(itertools.combinations(range(150), 2))),
    "star": (300, [(0, k) for k in range(1, 300)]),
    "no edge": (200, []),
    "path": (257, [(k, k + 1) for k in range(256)]),
    "few": (5, [(0, 1)]),
}  # fmt: skip


@for_each("name", GRAPHS)
def test_an_order_has_every_node_once(name: str) -> None:
    """Of graphs in one part and in many, of such as nothing parts, and of small ones."""
    nodes, edges = GRAPHS[name]
    order = dissection.dissect(graph_of(nodes, edges), as_they_come)
    assert sorted(order) == list(range(nodes))


def test_the_fewest_nodes_of_a_cut() -> None:
    """Against all sets of nodes, on random graphs of ten."""
    rng = np.random.default_rng(3)
    for _ in range(40):
        edges = [e for e in itertools.combinations(range(10), 2) if rng.random() < 0.3]
        left = rng.random(10) < 0.5
        cut = [(a, b) for a, b in edges if left[a] != left[b]]
        found = set(np.flatnonzero(dissection._cover(graph_of(10, edges), left)).tolist())
        assert all(a in found or b in found for a, b in cut)
        fewest = next(
            size
            for size in range(11)
            if any(all(a in s or b in s for a, b in cut) for s in map(set, itertools.combinations(range(10), size)))
        )
        assert len(found) == fewest


def test_a_long_box_is_parted_across() -> None:
    """The first cut of a box of 40 × 5 × 5 has the 25 nodes of a section, near its middle; nothing reaches past it."""
    nodes, edges = grid(40, 5, 5)
    between, left = dissection._parted(graph_of(nodes, edges))
    assert between.sum() == 25
    assert not (between & left).any()
    assert 0.4 * nodes < left.sum() < 0.6 * nodes
    side = np.where(between, 0, np.where(left, 1, -1))
    assert all(side[a] * side[b] >= 0 for a, b in edges)


@for_each("sizes", [(12, 12, 12), (60, 6, 6), (40, 40)])
def test_large_graphs_fill_less(sizes: tuple[int, ...]) -> None:
    """What `analyse` takes is never worse than either order; a cube of 12 takes less than by minimum degree."""
    nodes, edges = grid(*sizes)
    graph = graph_of(nodes, edges)
    degree = products(nodes, edges, elimination._minimum_degree(graph))
    dissected = products(nodes, edges, dissection.dissect(graph, elimination._minimum_degree))
    pattern = elimination.analyse(np.array(edges), nodes)
    lengths = np.diff(pattern.start)
    assert (lengths * (lengths + 1) // 2).sum() == min(degree, dissected)
    if sizes == (12, 12, 12):
        assert dissected < 0.8 * degree


def test_a_large_system_is_solved() -> None:
    """A⁻¹ y on a box of 700 nodes, against numpy.linalg; with L in single precision to that."""
    nodes, edges = grid(7, 10, 10)
    rng = np.random.default_rng(11)
    A = np.zeros((nodes, 3, nodes, 3))
    for a, b in edges:
        G = rng.standard_normal((3, 3))
        A[a, :, a, :] += G @ G.T
        A[b, :, b, :] += np.eye(3)
        A[a, :, b, :] += G
        A[b, :, a, :] += G.T
    A[range(nodes), :, range(nodes), :] += np.eye(3)
    whole = A.reshape(3 * nodes, 3 * nodes)
    pattern, blocks, lower, inverse = loaded(np.array(edges), whole)
    assert linear_solver.factor(pattern, blocks, inverse)
    y = np.zeros((nodes, 4))
    y[:, :3] = rng.standard_normal((nodes, 3))
    expected = np.linalg.solve(whole, y[pattern.slot, :3].ravel()).reshape(-1, 3)
    for factors, tolerance in ((lower, 1e-10), (lower.astype(np.float32), 1e-4)):
        z = y.copy()
        linear_solver.solve(pattern, factors, inverse, z)
        error = np.abs(z[pattern.slot, :3] - expected).max() / np.abs(expected).max()
        assert error < tolerance
    assert error > 1e-12  # the last one was of single precision
