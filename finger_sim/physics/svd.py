"""F = U diag(s) Vᵀ of every tetrahedron, for limits on principal stretches (Eq. 1-4)."""

from __future__ import annotations

import math

import numpy as np

from ..arrays import Floats, Ints
from .compile import kernel
from .jacobi import turn_columns
from .lanes import BATCH
from .model import Model, State
from .work import DECOMPOSITIONS

_SWEEPS = 30  # one-sided Jacobi converges quadratically: 3 to 6 in practice


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


def signed_svd(F: Floats) -> tuple[Floats, Floats, Floats]:
    """U, s, V of one matrix F (3, 3): see `signed_svds`."""
    U, s, V = np.empty((1, 3, 3)), np.empty((1, 3)), np.empty((1, 3, 3))
    signed_svds(np.ascontiguousarray(F)[None], U, s, V, np.empty((3, 3, BATCH)), np.empty((3, 3, BATCH)))
    return U[0], s[0], V[0]


@kernel
def signed_svds(F: Floats, U: Floats, s: Floats, V: Floats, B: Floats, turn: Floats) -> None:
    """F = U diag(s) Vᵀ with det U = det V = +1; the singular value of least magnitude carries the sign of det F.

    One-sided Jacobi from V = I: accurate also where F is flat, and the columns stay with the axes they are
    nearest to instead of being sorted, so that a row (i, j) means the same thing from step to step.
    F, U, V (T, 3, 3), s (T, 3); U, s, V out. B, turn (3, 3, BATCH) scratch: columns of F V, and of V, a matrix a lane.
    """
    for start in range(0, F.shape[0], BATCH):
        count = min(BATCH, F.shape[0] - start)
        turn[:] = 0.0
        for j in range(3):
            for l in range(BATCH):
                turn[j, j, l] = 1.0
                for i in range(3):
                    B[j, i, l] = F[start + l, i, j] if l < count else 0.0
        for _ in range(_SWEEPS):
            turned = turn_columns(B[0], B[1], turn[0], turn[1])
            turned += turn_columns(B[0], B[2], turn[0], turn[2])
            turned += turn_columns(B[1], B[2], turn[1], turn[2])
            if turned == 0:
                break
        for l in range(count):
            t = start + l
            for i in range(3):
                for j in range(3):
                    U[t, i, j] = B[j, i, l]
                    V[t, i, j] = turn[j, i, l]
            _finish(U[t], s[t])


@kernel
def _finish(U: Floats, s: Floats) -> None:
    """U and the signed s of F = U diag(s) Vᵀ from the orthogonal columns of F V, which U (3, 3) holds on entry."""
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
def decompose(model: Model, state: State) -> None:
    """F and its U, s, V at the state's positions into state.principal."""
    own = state.principal
    state.work[DECOMPOSITIONS] += model.tets.shape[0]
    deformation_gradient(model.tets, model.gradients, state.x, own.F)
    signed_svds(own.F, own.U, own.s, own.V, own.columns, own.turn)
