"""Deformation gradient and its signed singular value decomposition (Eq. 1-4)."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from ..arrays import Floats, Ints
from .compile import kernel

if TYPE_CHECKING:
    from .model import Model, State

_SWEEPS = 30  # one-sided Jacobi converges quadratically: 3 to 6 in practice
_ORTHOGONAL = 1e-15


@kernel
def deformation_gradient(tets: Ints, gradients: Floats, x: Floats, F: Floats) -> None:
    """F = Σ_n x_n r_nᵀ = D_s D_m⁻¹ of every tetrahedron (Eq. 1-3), columns in its material axes.

    tets (T, 4); gradients (T, 4, 3) the rows r_1 … r_4 [1/m]; x (n, 3) [m]; F (T, 3, 3) out.
    """
    for t in range(tets.shape[0]):
        for i in range(3):
            x4 = x[tets[t, 3], i]
            a, b, c = x[tets[t, 0], i] - x4, x[tets[t, 1], i] - x4, x[tets[t, 2], i] - x4
            for j in range(3):
                F[t, i, j] = a * gradients[t, 0, j] + b * gradients[t, 1, j] + c * gradients[t, 2, j]


@kernel
def signed_svd(F: Floats, U: Floats, s: Floats, V: Floats) -> None:
    """F = U diag(s) Vᵀ with det U = det V = +1; the singular value of least magnitude carries the sign of det F.

    One-sided Jacobi from V = I: accurate also where F is flat, and the columns stay with the axes they are
    nearest to instead of being sorted, so that a row (i, j) means the same thing from step to step.
    F, U, V (3, 3), s (3,); U, s, V out.
    """
    for i in range(3):
        for j in range(3):
            U[i, j] = F[i, j]  # U holds B = F V until its columns are orthogonal
            V[i, j] = 1.0 if i == j else 0.0
    for _ in range(_SWEEPS):
        turned = False
        for p in range(2):
            for q in range(p + 1, 3):
                alpha = U[0, p] * U[0, p] + U[1, p] * U[1, p] + U[2, p] * U[2, p]
                beta = U[0, q] * U[0, q] + U[1, q] * U[1, q] + U[2, q] * U[2, q]
                gamma = U[0, p] * U[0, q] + U[1, p] * U[1, q] + U[2, p] * U[2, q]
                if gamma * gamma <= _ORTHOGONAL * _ORTHOGONAL * (alpha * beta):
                    continue
                turned = True
                zeta = (beta - alpha) / (2.0 * gamma)
                t = (1.0 if zeta >= 0.0 else -1.0) / (abs(zeta) + math.sqrt(1.0 + zeta * zeta))
                c = 1.0 / math.sqrt(1.0 + t * t)
                d = c * t
                for i in range(3):
                    a, b = U[i, p], U[i, q]
                    U[i, p], U[i, q] = c * a - d * b, d * a + c * b
                    a, b = V[i, p], V[i, q]
                    V[i, p], V[i, q] = c * a - d * b, d * a + c * b
        if not turned:
            break
    for i in range(3):
        s[i] = math.sqrt(U[0, i] * U[0, i] + U[1, i] * U[1, i] + U[2, i] * U[2, i])
    m = 0
    if s[1] < s[m]:
        m = 1
    if s[2] < s[m]:
        m = 2
    p, q = (m + 1) % 3, (m + 2) % 3
    if s[q] > s[p]:
        _normalise(U, q, p, s)
    else:
        _normalise(U, p, q, s)
    b0, b1, b2 = U[0, m], U[1, m], U[2, m]
    U[0, m] = U[1, p] * U[2, q] - U[2, p] * U[1, q]
    U[1, m] = U[2, p] * U[0, q] - U[0, p] * U[2, q]
    U[2, m] = U[0, p] * U[1, q] - U[1, p] * U[0, q]
    s[m] = U[0, m] * b0 + U[1, m] * b1 + U[2, m] * b2


@kernel
def _normalise(U: Floats, p: int, q: int, s: Floats) -> None:
    """Orthonormal columns p and q of U from B's, |b_p| ≥ |b_q|; any perpendicular where one has collapsed."""
    if s[p] > 0.0:
        for i in range(3):
            U[i, p] /= s[p]
    else:
        for i in range(3):
            U[i, p] = 1.0 if i == p else 0.0
    along = U[0, p] * U[0, q] + U[1, p] * U[1, q] + U[2, p] * U[2, q]
    for i in range(3):
        U[i, q] -= along * U[i, p]
    length = math.sqrt(U[0, q] * U[0, q] + U[1, q] * U[1, q] + U[2, q] * U[2, q])
    if length > 1e-14 * s[p]:
        for i in range(3):
            U[i, q] /= length
        return
    k = 0
    if abs(U[1, p]) < abs(U[k, p]):
        k = 1
    if abs(U[2, p]) < abs(U[k, p]):
        k = 2
    along = U[k, p]
    for i in range(3):
        U[i, q] = (1.0 if i == k else 0.0) - along * U[i, p]
    length = math.sqrt(1.0 - along * along)
    for i in range(3):
        U[i, q] /= length


@kernel
def kinematics(model: Model, state: State) -> None:
    """F and its signed SVD for every tetrahedron, at the state's positions. Writes state.F, U, s, V."""
    deformation_gradient(model.tets, model.gradients, state.x, state.F)
    for t in range(model.tets.shape[0]):
        signed_svd(state.F[t], state.U[t], state.s[t], state.V[t])
