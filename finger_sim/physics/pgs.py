"""Projected Gauss-Seidel on the rows of a step: the paper's solver (Section 4; Cottle, Pang & Stone 1992).

With v = v_free + h A⁻¹ Jᵀ λ, the row values are g = C + h J v + ε λ = constant + W λ, where
W = h² J A⁻¹ Jᵀ + diag(ε) is the Delassus matrix and ε the rows' compliance. Wanted: g ≥ 0 ⊥ λ ≥ 0 for limits and
normals, and for the two tangents of a contact Coulomb's cone: |λ_t| ≤ μ λ_n, opposing the slip.

One sweep updates each row by its own diagonal; g is kept up to date, so a row at rest off its limit costs nothing.
"""

from __future__ import annotations

import math

from .compile import kernel
from .linear_solver import LANES, solve, solve_lanes

_FLOOR = 1e-3  # forces are judged relative to the largest row force, and no finer than this part of E · length²


@kernel
def delassus(model, state, h, rows):  # type: ignore[no-untyped-def]
    """Z = A⁻¹ Jᵀ and W = h² J Z + diag(compliance) of the first `rows` rows."""
    padded = -(-rows // LANES) * LANES
    W = state.W[: padded * padded].reshape((padded, padded))
    for chunk in range(padded // LANES):
        Z = state.Z[chunk]
        Z[:] = 0.0
        first = Z.shape[0]
        for l in range(min(LANES, rows - chunk * LANES)):
            row = chunk * LANES + l
            for n in range(4):
                k = state.row_slot[row, n]
                if k >= 0:
                    first = min(first, k)
                    for i in range(3):
                        Z[k, i, l] = state.J[row, n, i]
        solve_lanes(model.pattern, state.A_lower, state.A_inverse, first, Z)
    for row in range(rows):
        w = W[row]
        w[:] = 0.0
        for n in range(4):
            k = state.row_slot[row, n]
            if k < 0:
                continue
            a = h * h * state.J[row, n, 0]
            b = h * h * state.J[row, n, 1]
            c = h * h * state.J[row, n, 2]
            for chunk in range(padded // LANES):
                Z = state.Z[chunk, k]
                o = chunk * LANES
                for l in range(LANES):
                    w[o + l] += a * Z[0, l] + b * Z[1, l] + c * Z[2, l]
        w[row] += state.compliance[row]


@kernel
def solve_rows(model, state, contact_rows, rows):  # type: ignore[no-untyped-def]
    """Row forces into state.lam[:rows], warm-started from what is there. Returns (sweeps, residual).

    The residual is the largest change any row's force would still need on its own (its violation or lack of
    complementarity over its diagonal of W), as nodal force relative to the largest one. When the sweeps run out,
    the iterate with the least residual is kept.
    """
    padded = -(-rows // LANES) * LANES
    W = state.W[: padded * padded].reshape((padded, padded))
    lam, g = state.lam, state.g
    for row in range(rows):
        g[row] = state.constant[row]
    for row in range(rows):
        if lam[row] != 0.0:
            _add(g, W[row], lam[row], rows)
    least = residual(model, state, W, contact_rows, rows)
    _copy(lam, state.best, rows)
    sweeps = 0
    while least > model.tolerance and sweeps < model.max_iterations:
        sweeps += 1
        for row in range(0, contact_rows, 3):
            _contact(model, W, lam, g, row, rows)
        for row in range(contact_rows, rows):
            wanted = max(0.0, lam[row] - g[row] / W[row, row])
            change = wanted - lam[row]
            if change != 0.0:
                lam[row] = wanted
                _add(g, W[row], change, rows)
        now = residual(model, state, W, contact_rows, rows)
        if now < least:
            least = now
            _copy(lam, state.best, rows)
        elif not now < math.inf:
            break
    _copy(state.best, lam, rows)
    return sweeps, least


@kernel
def residual(model, state, W, contact_rows, rows):  # type: ignore[no-untyped-def]
    """See `solve_rows`: 0 when every row's condition holds exactly."""
    lam, g = state.lam, state.g
    worst, largest = 0.0, _FLOOR * model.lame_mu * model.length * model.length
    for row in range(0, contact_rows, 3):
        wanted = max(0.0, lam[row] - g[row] / W[row, row])
        a, b = _tangents(model, W, lam, g, row)
        worst = max(worst, abs(wanted - lam[row]), abs(a - lam[row + 1]), abs(b - lam[row + 2]))
        largest = max(largest, lam[row])
    for row in range(contact_rows, rows):
        wanted = max(0.0, lam[row] - g[row] / W[row, row])
        worst = max(worst, abs(wanted - lam[row]) * state.scale[row])
        largest = max(largest, lam[row] * state.scale[row])
    return worst / largest


@kernel
def _contact(model, W, lam, g, row, rows):  # type: ignore[no-untyped-def]
    """One contact: the normal by its own diagonal, then the tangents onto Coulomb's disk."""
    wanted = max(0.0, lam[row] - g[row] / W[row, row])
    change = wanted - lam[row]
    if change != 0.0:
        lam[row] = wanted
        _add(g, W[row], change, rows)
    a, b = _tangents(model, W, lam, g, row)
    change = a - lam[row + 1]
    if change != 0.0:
        lam[row + 1] = a
        _add(g, W[row + 1], change, rows)
    change = b - lam[row + 2]
    if change != 0.0:
        lam[row + 2] = b
        _add(g, W[row + 2], change, rows)


@kernel
def _tangents(model, W, lam, g, row):  # type: ignore[no-untyped-def]
    """Tangential forces that stop the slip of this contact, or the nearest step towards it inside the disk."""
    bound = model.mu_friction * lam[row]
    if bound <= 0.0:
        return 0.0, 0.0
    w11, w22, w12 = W[row + 1, row + 1], W[row + 2, row + 2], W[row + 1, row + 2]
    g1, g2 = g[row + 1], g[row + 2]
    det = w11 * w22 - w12 * w12
    a = lam[row + 1] - (w22 * g1 - w12 * g2) / det
    b = lam[row + 2] - (w11 * g2 - w12 * g1) / det
    if a * a + b * b <= bound * bound:
        return a, b
    half = 0.5 * (w11 - w22)
    stiffest = 0.5 * (w11 + w22) + math.sqrt(half * half + w12 * w12)
    a, b = lam[row + 1] - g1 / stiffest, lam[row + 2] - g2 / stiffest
    length = math.sqrt(a * a + b * b)
    if length > bound:
        a, b = a * bound / length, b * bound / length
    return a, b


@kernel
def apply_rows(model, state, h, rows):  # type: ignore[no-untyped-def]
    """Add h A⁻¹ Jᵀ λ to the free nodes' velocities."""
    y = state.rhs
    y[:] = 0.0
    for row in range(rows):
        force = h * state.lam[row]
        if force != 0.0:
            for n in range(4):
                k = state.row_slot[row, n]
                if k >= 0:
                    for i in range(3):
                        y[k, i] += force * state.J[row, n, i]
    solve(model.pattern, state.A_lower, state.A_inverse, y)
    for k in range(y.shape[0]):
        for i in range(3):
            state.v[model.free[k], i] += y[k, i]


@kernel
def _add(g, w, change, rows):  # type: ignore[no-untyped-def]
    for row in range(rows):
        g[row] += change * w[row]


@kernel
def _copy(source, out, rows):  # type: ignore[no-untyped-def]
    for row in range(rows):
        out[row] = source[row]
