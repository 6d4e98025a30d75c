"""Corotational linear elasticity (Müller & Gross 2004), linearised once a step: the matrix A and the right-hand side.

With R = U Vᵀ and the small strain ε = sym(RᵀF) − I = V (S − I) Vᵀ in material axes,

    P = R (2 μ ε + λ tr ε I) = U (2 μ (S − I) + λ tr(S − I) I) Vᵀ,    f_n = −vol P r_n,
    K_ab = vol (λ g_a g_bᵀ + μ g_b g_aᵀ + μ (g_a · g_b) I),           g_n = R r_n.

Backward Euler with f(x + h v) ≈ f(x) − h K v (Baraff & Witkin 1998), M lumped, Rayleigh D = α M + β K:

    A v = b,    A = (1 + h α) M + h (h + β) K,    b = M v₀ + h (M g + f(x)).

Driven nodes are no unknowns: their velocity enters as the stress h (h + β) ∂P/∂F : Ḟ_driven on the right.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..arrays import Floats, Ints
from .compile import kernel

if TYPE_CHECKING:
    from .model import Model, State


@kernel
def assemble(model: Model, state: State, h: float) -> None:
    """A into state.A_diagonal, A_lower (blocks, slot order) and b into state.rhs (nf, 3).

    state.v holds the velocities of the step's start on free nodes and those of this step on driven ones [m/s].
    """
    A_diagonal, A_lower, rhs, G, P = state.A_diagonal, state.A_lower, state.rhs, state.G, state.P
    A_lower[:] = 0.0
    mass_factor = 1.0 + h * model.damping_mass
    for k in range(rhs.shape[0]):
        n = model.free[k]
        mass = model.mass[n]
        for i in range(3):
            for j in range(3):
                A_diagonal[k, i, j] = 0.0
            A_diagonal[k, i, i] = mass_factor * mass
            rhs[k, i] = mass * (state.v[n, i] + h * model.gravity[i])
    stiffness_factor = h * (h + model.damping_stiffness)
    lame_lambda, lame_mu = model.lame_lambda, model.lame_mu
    for t in range(model.tets.shape[0]):
        U, s, V, r = state.U[t], state.s[t], state.V[t], model.gradients[t]
        volume = model.volume[t]
        trace = s[0] + s[1] + s[2] - 3.0
        p0 = 2.0 * lame_mu * (s[0] - 1.0) + lame_lambda * trace
        p1 = 2.0 * lame_mu * (s[1] - 1.0) + lame_lambda * trace
        p2 = 2.0 * lame_mu * (s[2] - 1.0) + lame_lambda * trace
        for i in range(3):
            for j in range(3):
                P[i, j] = h * (U[i, 0] * p0 * V[j, 0] + U[i, 1] * p1 * V[j, 1] + U[i, 2] * p2 * V[j, 2])
        for n in range(4):
            a0 = V[0, 0] * r[n, 0] + V[1, 0] * r[n, 1] + V[2, 0] * r[n, 2]
            a1 = V[0, 1] * r[n, 0] + V[1, 1] * r[n, 1] + V[2, 1] * r[n, 2]
            a2 = V[0, 2] * r[n, 0] + V[1, 2] * r[n, 1] + V[2, 2] * r[n, 2]
            for i in range(3):
                G[n, i] = U[i, 0] * a0 + U[i, 1] * a1 + U[i, 2] * a2
        if model.touches_driven[t]:
            _add_driven_stress(
                model.tets[t],
                model.tet_slot[t],
                state.v,
                U,
                V,
                G,
                state.D,
                stiffness_factor * lame_lambda,
                stiffness_factor * lame_mu,
                P,
            )
        for a in range(4):
            k = model.tet_slot[t, a]
            if k < 0:
                continue
            for i in range(3):
                rhs[k, i] -= volume * (P[i, 0] * r[a, 0] + P[i, 1] * r[a, 1] + P[i, 2] * r[a, 2])
        w_lambda, w_mu = stiffness_factor * volume * lame_lambda, stiffness_factor * volume * lame_mu
        for e in range(10):
            block = model.tet_block[t, e]
            if block == -1:
                continue
            a, b = model.pair_row[t, e], model.pair_column[t, e]
            a0, a1, a2, b0, b1, b2 = G[a, 0], G[a, 1], G[a, 2], G[b, 0], G[b, 1], G[b, 2]
            dot = w_mu * (a0 * b0 + a1 * b1 + a2 * b2)
            B = A_lower[block] if a != b else A_diagonal[block]
            B[0, 0] += w_lambda * a0 * b0 + w_mu * b0 * a0 + dot
            B[0, 1] += w_lambda * a0 * b1 + w_mu * b0 * a1
            B[0, 2] += w_lambda * a0 * b2 + w_mu * b0 * a2
            B[1, 0] += w_lambda * a1 * b0 + w_mu * b1 * a0
            B[1, 1] += w_lambda * a1 * b1 + w_mu * b1 * a1 + dot
            B[1, 2] += w_lambda * a1 * b2 + w_mu * b1 * a2
            B[2, 0] += w_lambda * a2 * b0 + w_mu * b2 * a0
            B[2, 1] += w_lambda * a2 * b1 + w_mu * b2 * a1
            B[2, 2] += w_lambda * a2 * b2 + w_mu * b2 * a2 + dot


@kernel
def _add_driven_stress(
    nodes: Ints,
    slots: Ints,
    v: Floats,
    U: Floats,
    V: Floats,
    G: Floats,
    D: Floats,
    w_lambda: float,
    w_mu: float,
    P: Floats,
) -> None:
    """P += ∂P/∂F : Ḟ, weighted, for the velocity gradient Ḟ that the driven nodes alone give a tetrahedron.

    In world axes D = Σ v_n g_nᵀ = Ḟ Rᵀ, so that R sym(RᵀḞ) = sym(D) R. D (3, 3) scratch.
    """
    D[:] = 0.0
    for n in range(4):
        if slots[n] < 0:
            w = v[nodes[n]]
            for i in range(3):
                for j in range(3):
                    D[i, j] += w[i] * G[n, j]
    pressure = w_lambda * (D[0, 0] + D[1, 1] + D[2, 2])
    for i in range(3):
        e0 = w_mu * (D[i, 0] + D[0, i]) + (pressure if i == 0 else 0.0)
        e1 = w_mu * (D[i, 1] + D[1, i]) + (pressure if i == 1 else 0.0)
        e2 = w_mu * (D[i, 2] + D[2, i]) + (pressure if i == 2 else 0.0)
        for k in range(3):
            e = e0 * U[0, k] + e1 * U[1, k] + e2 * U[2, k]
            for j in range(3):
                P[i, j] += e * V[j, k]
