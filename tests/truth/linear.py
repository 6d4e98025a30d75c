"""Linear elasticity with linear tetrahedra in plain NumPy and SciPy: standard, and with one volume strain a patch.

Small strain ε = sym ∇u; the energy of a body of Lamé's μ and bulk modulus K = E / (3 (1 − 2 ν)) is

    Σ_e V_e μ |dev ε_e|²  +  Σ_p ½ K V_p θ_p²,      θ_p = Σ_{e in p} V_e tr ε_e / V_p,      V_p = Σ_{e in p} V_e

Without patches each tetrahedron is its own, and the sum is the standard linear element's ½ ∫ σ : ε.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike
from scipy.sparse.linalg import splu
from truth.problems import YOUNG, Floats, Problem


def gradients(points: ArrayLike, tets: ArrayLike) -> tuple[Floats, Floats]:
    """∇N of each node of each tetrahedron [1/m], (T, 4, 3), and volumes [m³], (T,), positive for either orientation."""
    x = np.asarray(points, float)[np.asarray(tets)]
    edges = x[:, 1:] - x[:, :1]
    inner = np.swapaxes(np.linalg.inv(edges), 1, 2)
    return np.concatenate([-inner.sum(1, keepdims=True), inner], axis=1), np.abs(np.linalg.det(edges)) / 6.0


def stiffness(
    points: ArrayLike, tets: ArrayLike, young: float, poisson: float, patches: ArrayLike | None = None
) -> sp.csr_matrix:
    """Stiffness [N/m] of a body of linear tetrahedra, (3 n, 3 n), unknown 3 i + k the displacement of node i along k.

    `points` (n, 3) [m]; `tets` (T, 4) node indices, of either orientation; `young` [Pa]; `poisson` in (−1, 0.5).
    `patches` (T,): number of each tetrahedron's patch, any integers; None: each tetrahedron is its own.
    """
    tets = np.asarray(tets, np.int64)
    unknowns = 3 * len(np.asarray(points))
    grad, volumes = gradients(points, tets)
    mu, bulk = young / (2.0 * (1.0 + poisson)), young / (3.0 * (1.0 - 2.0 * poisson))
    # 2 μ V dev ε : dev ε for nodes a, b and axes i, j: μ V (∇a·∇b δ_ij + ∂_j a ∂_i b − ⅔ ∂_i a ∂_j b)
    dots = np.einsum("tak,tbk->tab", grad, grad)
    blocks = np.einsum("tab,ij->taibj", dots, np.eye(3))
    blocks += np.einsum("taj,tbi->taibj", grad, grad) - 2.0 / 3.0 * np.einsum("tai,tbj->taibj", grad, grad)
    blocks *= (mu * volumes)[:, None, None, None, None]
    own = (3 * tets[:, :, None] + np.arange(3)).reshape(-1, 12)
    rows, columns = np.repeat(own, 12, axis=1), np.tile(own, (1, 12))
    deviator = sp.csr_matrix((blocks.ravel(), (rows.ravel(), columns.ravel())), shape=(unknowns, unknowns))
    patch = np.arange(len(tets)) if patches is None else np.unique(np.asarray(patches), return_inverse=True)[1]
    size = np.bincount(patch, volumes)
    # θ = swell u: one row a patch
    entries = grad.reshape(-1, 12) * (volumes / size[patch])[:, None]
    swell = sp.csr_matrix((entries.ravel(), (np.repeat(patch, 12), own.ravel())), shape=(len(size), unknowns))
    return sp.csr_matrix(deviator + swell.T @ sp.diags(bulk * size) @ swell)


def reaction(matrix: sp.csr_matrix, nodes: ArrayLike, displacements: ArrayLike) -> tuple[Floats, Floats]:
    """Forces [N] that hold `nodes` (k,) at `displacements` (k, 3) [m], (k, 3), and all displacements [m], (n, 3).

    `matrix` (3 n, 3 n): any stiffness [N/m]. NaN in `displacements`: that component is free, its force zero.
    All else is free and bears no load. A node that no element uses stays where it is.
    """
    nodes, given = np.asarray(nodes), np.asarray(displacements, float)
    held = (3 * nodes[:, None] + np.arange(3))[np.isfinite(given)]
    u = np.zeros(matrix.shape[0])
    u[held] = given[np.isfinite(given)]
    free = np.setdiff1d(np.flatnonzero(matrix.diagonal()), held)
    csc = sp.csc_matrix(matrix)
    right = -(matrix @ u)[free]
    factor = splu(
        csc[free][:, free], permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
    )
    u[free] = factor.solve(right)
    forces = np.zeros(matrix.shape[0])
    forces[held] = (matrix @ u)[held]
    return forces.reshape(-1, 3)[nodes], u.reshape(-1, 3)


def force(problem: Problem, poisson: float, patches: ArrayLike | None = None) -> float:
    """Answer of the problem [N] with linear tetrahedra, on patches or without."""
    matrix = stiffness(problem.points, problem.tets, YOUNG, poisson, patches)
    return problem.answer(reaction(matrix, *problem.prescribed())[0])
