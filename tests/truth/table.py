"""Errors of linear tetrahedra, on patches and without, against quadratic ones: `cd tests && python -m truth.table`.

Files of finger meshes that follow are measured too: against quadratic tetrahedra on the same mesh, and against those on
the mesh refined once with `--refine`. Costs are those of the factor of the free nodes' matrix, in the order of minimum
degree, against the standard element's: non-zeros and multiply-adds.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.linalg import splu
from truth import linear, patches, quadratic
from truth.problems import POISSONS, Ints, Problem, block, cantilever, cook, finger
from truth.reference import ANSWERS

Flags = NDArray[np.bool_]

WAYS: dict[str, Callable[[Ints, Flags], Ints | None]] = {
    "element": lambda tets, driven: None,
    "stars of 4": lambda tets, driven: patches.stars(tets, driven, 4),
    "faces of 4": lambda tets, driven: patches.faces(tets, driven, 4),
    "stars of 8": lambda tets, driven: patches.stars(tets, driven, 8),
    "faces of 8": lambda tets, driven: patches.faces(tets, driven, 8),
    "freedoms 1": lambda tets, driven: patches.freedoms(tets, driven, 1.0),
    "freedoms": patches.freedoms,
}
"""Name → patches (T,) of the tetrahedra (T, 4) and the driven nodes (n,), or None."""


def fill(tets: Ints, driven: Flags, patch: Ints | None) -> tuple[float, float]:
    """Non-zeros and multiply-adds of the factor of the free nodes' matrix, counted in nodes."""
    patch = np.arange(len(tets)) if patch is None else patch
    touches = sp.csr_matrix(
        (np.ones(tets.size), (np.repeat(patch, 4), tets.ravel())), shape=(patch.max() + 1, len(driven))
    )
    used = np.zeros(len(driven), bool)
    used[tets] = True
    graph = sp.csc_matrix(touches.T @ touches)[used & ~driven][:, used & ~driven]
    graph.data[:] = -1.0
    graph.setdiag(float(graph.shape[0]))
    factor = splu(graph, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    columns = np.diff(factor.L.indptr).astype(float)
    return columns.sum(), (columns**2).sum()


def rows(problem: Problem, truth: list[float]) -> Iterator[str]:
    """Lines of the problem's table."""
    driven = problem.driven()
    before = fill(problem.tets, driven, None)
    for name, way in WAYS.items():
        patch = way(problem.tets, driven)
        errors = [
            linear.force(problem, poisson, patch) / force - 1.0 for poisson, force in zip(POISSONS, truth, strict=True)
        ]
        cost = np.divide(fill(problem.tets, driven, patch), before)
        counts = np.ones(len(problem.tets), int) if patch is None else np.bincount(patch)
        told = " | ".join(f"{100.0 * error:+.1f} %" for error in errors)
        yield f"| {name} | {told} | ×{cost[0]:.2f} | ×{cost[1]:.2f} | {len(counts)} of {counts.min()}–{counts.max()} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("meshes", nargs="*", type=Path)
    parser.add_argument("--refine", action="store_true")
    options = parser.parse_args()
    problems = [
        (problem, [ANSWERS[problem.name, nu].force for nu in POISSONS])
        for problem in (block(4), block(6), block(8), cook(8), cantilever(2))
    ]
    for path in options.meshes:
        problem = finger(path)
        fine = problem.refined() if options.refine else problem
        problems.append((problem, [quadratic.force(fine, poisson) for poisson in POISSONS]))
    for problem, truth in problems:
        print(
            f"\n{problem.name}, {len(problem.tets)} tets, quadratic "
            + " / ".join(f"{force:.4g}" for force in truth)
            + " N\n"
        )
        print("| | " + " | ".join(f"ν {poisson}" for poisson in POISSONS) + " | non-zeros | multiply-adds | patches |")
        print("|---|" + "---|" * (len(POISSONS) + 3))
        for row in rows(problem, truth):
            print(row, flush=True)


if __name__ == "__main__":
    main()
