"""Sparse block LDLᵀ: factor and solve on random patterns against numpy.linalg."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from physics_helpers import Array

from finger_sim.physics import linear_solver


def random_system(rng: np.random.Generator, nodes: int, edges: int, spread: float) -> tuple[Any, Array]:
    """A graph (k, 2) and a dense SPD matrix (3 n, 3 n) with its blocks, diagonals over `spread` decades."""
    graph = {tuple(sorted(rng.choice(nodes, 2, replace=False))) for _ in range(edges)} if nodes > 1 else set()
    A = np.zeros((nodes, 3, nodes, 3))
    for a, b in graph:
        G = rng.standard_normal((3, 3)) * 10.0 ** rng.uniform(-spread, 0.0)
        A[a, :, a, :] += G @ G.T
        A[b, :, b, :] += np.eye(3)
        A[a, :, b, :] += G
        A[b, :, a, :] += G.T
    for k in range(nodes):
        A[k, :, k, :] += 0.1 * 10.0 ** rng.uniform(-spread, 0.0) * np.eye(3)
    return np.array(sorted(graph), np.int64).reshape(-1, 2), A.reshape(3 * nodes, 3 * nodes)


def loaded(edges: Any, A: Array) -> tuple[Any, Array, Array, Array]:
    """The pattern of the graph and A's blocks in its slots."""
    nodes = len(A) // 3
    blocks = A.reshape(nodes, 3, nodes, 3)
    pattern = linear_solver.analyse(edges, nodes)
    order = pattern.order
    diagonal = np.array([blocks[k, :, k, :] for k in order]).reshape(nodes, 3, 3)
    lower = np.zeros((len(pattern.row), 3, 3))
    for column in range(nodes):
        for p in range(pattern.start[column], pattern.start[column + 1]):
            lower[p] = blocks[order[pattern.row[p]], :, order[column], :]
    return pattern, diagonal, lower, np.zeros((nodes, 3, 3))


CASES = [(1, 0), (2, 1), (3, 0), (7, 30), (30, 60), (40, 40), (60, 300)]


@pytest.mark.parametrize(("nodes", "edges"), CASES)
@pytest.mark.parametrize("spread", [0.0, 6.0])
def test_solve_against_numpy(nodes: int, edges: int, spread: float) -> None:
    """A⁻¹ y on random graphs, connected or not, over decades of stiffness; slots are a permutation."""
    for seed in range(3):
        rng = np.random.default_rng(seed)
        graph, A = random_system(rng, nodes, edges, spread)
        pattern, diagonal, lower, inverse = loaded(graph, A)
        assert sorted(pattern.order) == list(range(nodes))
        assert (pattern.slot[pattern.order] == np.arange(nodes)).all()
        assert linear_solver.factor(pattern, diagonal, lower, inverse)
        y = rng.standard_normal((nodes, 3))
        expected = np.linalg.solve(A, y[pattern.slot].ravel()).reshape(-1, 3)
        got = y.copy()
        linear_solver.solve(pattern, lower, inverse, got)
        bound = 1e-13 * np.linalg.cond(A) * np.abs(expected).max() + 1e-300
        assert_allclose(got[pattern.slot], expected, rtol=0, atol=bound)


@pytest.mark.parametrize(("nodes", "edges"), CASES)
def test_lanes_are_columns_of_the_inverse(nodes: int, edges: int) -> None:
    """Many right-hand sides at once, from any slot on, give what numpy.linalg.inv has."""
    rng = np.random.default_rng(4)
    graph, A = random_system(rng, nodes, edges, 1.0)
    pattern, diagonal, lower, inverse = loaded(graph, A)
    assert linear_solver.factor(pattern, diagonal, lower, inverse)
    index = (3 * pattern.order[:, None] + np.arange(3)).ravel()
    whole = np.linalg.inv(A)[np.ix_(index, index)]
    for first in range(nodes):
        Y = np.zeros((nodes, 3, linear_solver.LANES))
        Y[first:] = rng.standard_normal(Y[first:].shape) * (rng.random((nodes - first, 1, 1)) < 0.5)
        reached = Y.any(axis=(1, 2)).astype(np.int64)
        expected = (whole @ Y.reshape(3 * nodes, -1)).reshape(Y.shape)
        linear_solver.solve_lanes(pattern, lower, inverse, first, reached, Y)
        assert_allclose(Y[first:], expected[first:], rtol=0, atol=1e-12 * np.abs(expected).max())


def test_fill_is_small_on_a_chain() -> None:
    """Minimum degree fills nothing in on a chain, whatever the numbering of its nodes."""
    names = np.random.default_rng(5).permutation(50)
    edges = np.array([names[:-1], names[1:]]).T
    pattern = linear_solver.analyse(np.sort(edges, axis=1), 50)
    assert len(pattern.row) == 49


@pytest.mark.parametrize("broken", ["negative", "singular", "nan"])
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
    pattern, diagonal, lower, inverse = loaded(graph, A)
    assert not linear_solver.factor(pattern, diagonal, lower, inverse)
