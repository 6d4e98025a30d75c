"""Sparse block LDLᵀ: factor and solve on random patterns against numpy.linalg."""

from __future__ import annotations

import itertools
import math
from pathlib import Path
from typing import Any

import numpy as np
from cases import for_each
from numpy.testing import assert_allclose
from physics_helpers import Array, loaded

from finger_sim.physics import elimination, linear_solver
from finger_sim.physics.compile import kernel
from finger_sim.physics.lanes import fill4, fill8, high4, join8, load4, low4, store4, sums3
from finger_sim.scene.mesh import TetMesh


def random_system(rng: np.random.Generator, nodes: int, edges: int, spread: float) -> tuple[Any, Array]:
    """A random graph and a matrix on it: see `system_on`."""
    graph = {tuple(sorted(rng.choice(nodes, 2, replace=False))) for _ in range(edges)} if nodes > 1 else set()
    return system_on(rng, nodes, sorted(graph), spread)


def system_on(rng: np.random.Generator, nodes: int, graph: Any, spread: float) -> tuple[Any, Array]:
    """The graph (k, 2) and a dense SPD matrix (3 n, 3 n) with its blocks, diagonals over `spread` decades."""
    A = np.zeros((nodes, 3, nodes, 3))
    for a, b in graph:
        G = rng.standard_normal((3, 3)) * 10.0 ** rng.uniform(-spread, 0.0)
        A[a, :, a, :] += G @ G.T
        A[b, :, b, :] += np.eye(3)
        A[a, :, b, :] += G
        A[b, :, a, :] += G.T
    for k in range(nodes):
        A[k, :, k, :] += 0.1 * 10.0 ** rng.uniform(-spread, 0.0) * np.eye(3)
    return np.array(graph, np.int64).reshape(-1, 2), A.reshape(3 * nodes, 3 * nodes)


def check_solution(graph: Any, A: Array, rng: np.random.Generator) -> Any:
    """Factor A, solve for a random right-hand side and compare with numpy.linalg. The pattern."""
    nodes = len(A) // 3
    pattern, blocks, lower, inverse = loaded(graph, A)
    assert sorted(pattern.order) == list(range(nodes))
    assert (pattern.slot[pattern.order] == np.arange(nodes)).all()
    assert linear_solver.factor(pattern, blocks, inverse)
    y = np.zeros((nodes, 4))
    y[:, :3] = rng.standard_normal((nodes, 3))
    expected = np.linalg.solve(A, y[pattern.slot, :3].ravel()).reshape(-1, 3)
    linear_solver.solve(pattern, lower, inverse, y)
    bound = 1e-13 * np.linalg.cond(A) * np.abs(expected).max() + 1e-300
    assert_allclose(y[pattern.slot, :3], expected, rtol=0, atol=bound)
    assert (y[:, 3] == 0.0).all()
    return pattern


CASES = [(1, 0), (2, 1), (3, 0), (7, 30), (30, 60), (40, 40), (60, 300)]


@for_each("nodes, edges", CASES)
@for_each("spread", [0.0, 6.0])
def test_solve_against_numpy(nodes: int, edges: int, spread: float) -> None:
    """A⁻¹ y on random graphs, connected or not, over decades of stiffness; slots are a permutation."""
    for seed in range(3):
        rng = np.random.default_rng(seed)
        check_solution(*random_system(rng, nodes, edges, spread), rng)


def clique(names: Any) -> list[tuple[int, int]]:
    """All edges between the given nodes."""
    return list(itertools.combinations(sorted(int(n) for n in names), 2))


GRAPHS = {
    "dense": (21, clique(range(21))),
    "arrow": (30, [(0, k) for k in range(1, 30)]),
    "path": (25, [(k, k + 1) for k in range(24)]),
    # Cliques that share a few nodes with the next: panels of every width and height, odd and even.
    "cliques": (61, [e for k in range(0, 50, 5) for e in clique(range(k, k + 6 + k // 5 % 4))]),
    "two parts": (20, clique(range(9)) + clique(range(9, 20))),
}


@for_each("name", GRAPHS)
def test_panels_of_many_shapes(name: str) -> None:
    """A⁻¹ y where columns of L share their rows: blocks of a panel, its own columns and those below, are right."""
    nodes, edges = GRAPHS[name]
    rng = np.random.default_rng(7)
    graph, A = system_on(rng, nodes, sorted(set(edges)), 2.0)
    pattern = check_solution(graph, A, rng)
    assert pattern.panel[0] == 0
    assert pattern.panel[-1] == nodes
    widths = np.diff(pattern.panel)
    assert (widths > 0).all()
    assert (widths <= elimination.WIDEST).all()
    if name == "dense":
        assert len(widths) == math.ceil(nodes / elimination.WIDEST)
    for first, last in itertools.pairwise(pattern.panel):
        below = pattern.row[pattern.start[last - 1] : pattern.start[last]]
        for k in range(first, last):
            rows = pattern.row[pattern.start[k] : pattern.start[k + 1]]
            assert rows.tolist() == [*range(k + 1, last), *below]


def test_the_shipped_finger() -> None:
    """A⁻¹ y on the graph of the shipped mesh, held at nothing: the sizes of panels that a step meets."""
    mesh = TetMesh.load(Path(__file__).parents[2] / "config" / "meshes" / "finger_paper.vtu")
    edges = sorted({e for tet in mesh.tets for e in clique(tet)})
    rng = np.random.default_rng(8)
    graph, A = system_on(rng, len(mesh.points), edges, 1.0)
    check_solution(graph, A, rng)


@for_each("nodes, edges", CASES)
def test_lanes_are_columns_of_the_inverse(nodes: int, edges: int) -> None:
    """Many right-hand sides at once, from any slot on, give what numpy.linalg.inv has."""
    rng = np.random.default_rng(4)
    graph, A = random_system(rng, nodes, edges, 1.0)
    pattern, blocks, lower, inverse = loaded(graph, A)
    assert linear_solver.factor(pattern, blocks, inverse)
    index = (3 * pattern.order[:, None] + np.arange(3)).ravel()
    whole = np.linalg.inv(A)[np.ix_(index, index)]
    for first in range(nodes):
        Y = np.zeros((nodes, 3, linear_solver.SIDES_AT_ONCE))
        Y[first:] = rng.standard_normal(Y[first:].shape) * (rng.random((nodes - first, 1, 1)) < 0.5)
        reached = Y.any(axis=(1, 2)).astype(np.int64)
        expected = (whole @ Y.reshape(3 * nodes, -1)).reshape(Y.shape)
        linear_solver.solve_many(pattern, lower, inverse, first, reached, Y)
        assert_allclose(Y[first:], expected[first:], rtol=0, atol=1e-12 * np.abs(expected).max())


@kernel
def _of_the_solver(a: Array, out: Array) -> None:
    store4(out, 0, 0, fill4(a, 1, 2))
    store4(out, 1, 0, sums3(load4(a, 0, 0), load4(a, 1, 0), load4(a, 2, 0)))
    both = join8(load4(a, 1, 0), load4(a, 2, 0))
    store4(out, 2, 0, high4(both))
    store4(out, 3, 0, low4(both + fill8(a, 0, 1)))


def test_lanes_of_the_solver() -> None:
    """Lanes functions that only the solver uses: one number in all lanes, three sums of three, two halves."""
    a, out = np.arange(12.0).reshape(3, 4) ** 2, np.zeros((4, 4))
    _of_the_solver(a, out)
    assert out[0].tolist() == [36.0] * 4
    assert out[1].tolist() == [0 + 1 + 4, 16 + 25 + 36, 64 + 81 + 100, 0]
    assert out[2].tolist() == [64.0, 81.0, 100.0, 121.0]
    assert out[3].tolist() == [17.0, 26.0, 37.0, 50.0]


def test_fill_is_small_on_a_chain() -> None:
    """Minimum degree fills nothing in on a chain, whatever the numbering of its nodes."""
    names = np.random.default_rng(5).permutation(50)
    edges = np.array([names[:-1], names[1:]]).T
    pattern = elimination.analyse(np.sort(edges, axis=1), 50)
    assert len(pattern.row) == 49


@for_each("broken", ["negative", "singular", "nan"])
def test_a_matrix_that_is_not_positive_definite_is_reported(broken: str) -> None:
    """factor returns False, and does not raise, for indefinite, singular and NaN matrices."""
    rng = np.random.default_rng(6)
    graph, A = random_system(rng, 10, 20, 0.0)
    if broken == "negative":
        A[14, 14] = -1.0
    elif broken == "singular":
        A[9:12], A[:, 9:12] = 0.0, 0.0
    else:
        A[20, 20] = np.nan
    pattern, blocks, _, inverse = loaded(graph, A)
    assert not linear_solver.factor(pattern, blocks, inverse)
