"""The reference: the same problems with quadratic tetrahedra of scikit-fem, which shares no code with ours."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
import skfem
from scipy.sparse.linalg import cg
from skfem.models.elasticity import lame_parameters, linear_elasticity
from truth.problems import YOUNG, Floats, Problem

RESIDUAL = 1e-8
"""Of the conjugate gradients, against the load."""


def force(problem: Problem, poisson: float, element: skfem.Element | None = None) -> float:
    """Answer of the problem [N] with quadratic tetrahedra, or with another scalar `element` of scikit-fem."""
    forces, _, axes = solve(problem, poisson, element)
    return float(axes @ forces)


def solve(problem: Problem, poisson: float, element: skfem.Element | None = None) -> tuple[Floats, Floats, Floats]:
    """Forces [N], displacements [m], and what of the axis counts in the answer, of all unknowns. (m,) each"""
    scalar = skfem.ElementTetP2() if element is None else element
    mesh = skfem.MeshTet(problem.points.T, problem.tets.T)
    basis = skfem.Basis(mesh, skfem.ElementVector(scalar), intorder=2 * (scalar.maxdeg - 1))
    matrix = skfem.asm(linear_elasticity(*lame_parameters(YOUNG, poisson)), basis).tocsr()
    number = {facet: k for k, facet in enumerate(map(tuple, np.sort(mesh.facets.T, axis=1).tolist()))}
    u, held, moved = np.zeros(basis.N), np.zeros(basis.N, bool), np.zeros(basis.N)
    for hold in problem.holds:
        facets = np.array([number[facet] for facet in map(tuple, np.sort(hold.facets, axis=1).tolist())])
        there = basis.get_dofs(facets)
        moved[:] = 0.0
        for axis in range(3):
            dofs = there.all(f"u^{axis + 1}")
            given = hold.displacement(basis.doflocs[:, dofs].T)[:, axis]
            known = np.isfinite(given)
            u[dofs[known]], held[dofs[known]] = given[known], True
            moved[dofs] = problem.axis[axis]
    free = np.flatnonzero(~held & (matrix.diagonal() > 0.0))
    inner, right = matrix[free][:, free], -(matrix @ u)[free]
    scale = sp.diags(inner.diagonal() ** -0.5)
    solution, failed = cg(scale @ inner @ scale, scale @ right, rtol=RESIDUAL, maxiter=20_000)
    assert not failed
    u[free] = scale @ solution
    return matrix @ u, u, moved
