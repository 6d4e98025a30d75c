"""Projected Gauss-Seidel on the rows of a step: the paper's solver (Section 4; Cottle, Pang & Stone 1992).

With v = v_free + h A⁻¹ Jᵀ λ, the row values are g = C + h J v + ε λ = constant + W λ, where
W = h² J A⁻¹ Jᵀ + diag(ε) is the Delassus matrix and ε the rows' compliance. Wanted: g ≥ 0 ⊥ λ ≥ 0 for limits and
normals, and for the two tangents of a contact Coulomb's cone: |λ_t| ≤ μ λ_n, opposing the slip.

One sweep updates each row by its own diagonal of W. W itself is never formed: the sweeps keep u = h A⁻¹ Jᵀ λ at
the nodes that rows touch. A row reads its g from its own nodes, and adds its column h A⁻¹ J_iᵀ to u when its force
changes, so that a row at rest off its limit costs a dozen products. The columns come from S, the block of A⁻¹
between touched nodes, each when first needed.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

from ..arrays import Floats, Ints
from .compile import kernel, stage
from .linear_solver import NODE_LANES, solve, solve_lanes

if TYPE_CHECKING:
    from .model import Model, State

_FLOOR = 1e-3  # forces are judged relative to the largest row force, and no finer than this part of G · length²


@stage
def touched_nodes(model: Model, state: State, rows: int) -> int:
    """Number the slots that the first `rows` rows touch, in slot order: state.touched and row_local. Their count.

    -1 when they are more than the arrays hold.
    """
    local = state.local
    local[:] = -1
    for row in range(rows):
        for n in range(4):
            k = state.row_slot[row, n]
            if k >= 0:
                local[k] = 0
    count = 0
    for k in range(local.shape[0]):
        if local[k] == 0:
            if count == state.touched.shape[0]:
                return -1
            local[k] = count
            state.touched[count] = k
            count += 1
    for row in range(rows):
        for n in range(4):
            k = state.row_slot[row, n]
            state.row_local[row, n] = local[k] if k >= 0 else -1
    return count


@stage
def inverse_between(model: Model, state: State, count: int) -> None:
    """S (3 count, 3 count): the symmetric block of A⁻¹ between touched nodes, some of its columns at a time."""
    S = state.S[: 9 * count * count].reshape((3 * count, 3 * count))
    Y = state.Y
    for start in range(0, count, NODE_LANES):
        first = state.touched[start]
        Y[first:] = 0.0
        width = min(NODE_LANES, count - start)
        for c in range(width):
            for i in range(3):
                Y[state.touched[start + c], i, 3 * c + i] = 1.0
        solve_lanes(model.pattern, state.A_lower, state.A_inverse, first, Y)
        for a in range(start, count):
            k = state.touched[a]
            for i in range(3):
                for l in range(3 * width):
                    S[3 * a + i, 3 * start + l] = Y[k, i, l]
                    S[3 * start + l, 3 * a + i] = Y[k, i, l]


@stage
def solve_rows(model: Model, state: State, h: float, contact_rows: int, rows: int, count: int) -> tuple[int, float]:
    """Row forces into state.lam[:rows], warm-started from what is there. Returns (sweeps, residual).

    The residual is the largest change any row's force would still need on its own (its violation or lack of
    complementarity over its diagonal of W), as nodal force relative to the largest one. When the sweeps run out,
    the iterate with the least residual is kept. On return state.J holds h J.
    """
    size = 3 * count
    S = state.S[: size * size].reshape((size, size))
    Z = state.Z[: rows * size].reshape((rows, size))
    J, nodes, lam = state.J, state.row_local, state.lam
    state.u[:size] = 0.0
    for row in range(rows):
        for n in range(4):
            for i in range(3):
                J[row, n, i] *= h
        state.has_column[row] = 0
        state.diagonal[row] = _product(S, J[row], nodes[row], J[row], nodes[row]) + state.compliance[row]
    for row in range(0, contact_rows, 3):
        state.cross[row] = _product(S, J[row + 1], nodes[row + 1], J[row + 2], nodes[row + 2])
    system = System(
        J, nodes, state.constant, state.compliance, state.diagonal, state.cross, state.scale, lam, state.u,
        state.has_column, S, Z,
    )  # fmt: skip
    for row in range(rows):
        if lam[row] != 0.0:
            _push(S, J[row], nodes[row], state.has_column[row:], Z[row], state.u, lam[row])

    floor = _FLOOR * model.lame_mu * model.length * model.length
    least = math.inf
    sweeps = 0
    while True:
        worst, largest = visit(system, model.mu_friction, contact_rows, rows, False)
        now = worst / max(largest, floor)
        if now < least:
            least = now
            state.best[:rows] = lam[:rows]
        if least <= model.tolerance or sweeps == model.max_iterations or not now < math.inf:
            break
        visit(system, model.mu_friction, contact_rows, rows, True)
        sweeps += 1
    lam[:rows] = state.best[:rows]
    return sweeps, least


class System(NamedTuple):
    """The rows of a step, as `visit` needs them; shapes as in State, S and Z as matrices."""

    J: Floats
    nodes: Ints
    constant: Floats
    compliance: Floats
    diagonal: Floats
    cross: Floats
    scale: Floats
    lam: Floats
    u: Floats
    has_column: Ints
    S: Floats
    Z: Floats


@kernel
def visit(system: System, mu_friction: float, contact_rows: int, rows: int, update: bool) -> tuple[float, float]:
    """Every row once: how far its force is from what it wants. With `update` it gets that at once: a sweep.

    A limit or a normal wants max(0, λ − g / W_ii), two tangents want `tangents`. Returns the largest difference and
    the largest force, as nodal forces [N].
    """
    J, nodes, lam, u = system.J, system.nodes, system.lam, system.u
    constant, compliance, diagonal = system.constant, system.compliance, system.diagonal
    worst = largest = 0.0
    for row in range(rows):
        contact = row < contact_rows
        if contact and row % 3 != 0:
            continue
        g = constant[row] + compliance[row] * lam[row] + _dot(J[row], nodes[row], u)
        change = max(0.0, lam[row] - g / diagonal[row]) - lam[row]
        worst = max(worst, abs(change) * system.scale[row])
        largest = max(largest, lam[row] * system.scale[row])
        if update and change != 0.0:
            lam[row] += change
            _push(system.S, J[row], nodes[row], system.has_column[row:], system.Z[row], u, change)
        if not contact:
            continue
        g1 = constant[row + 1] + _dot(J[row + 1], nodes[row + 1], u)
        g2 = constant[row + 2] + _dot(J[row + 2], nodes[row + 2], u)
        a, b = tangents(
            mu_friction * lam[row], lam[row + 1], lam[row + 2], g1, g2,
            diagonal[row + 1], diagonal[row + 2], system.cross[row],
        )  # fmt: skip
        for t in range(row + 1, row + 3):
            change = (a if t == row + 1 else b) - lam[t]
            worst = max(worst, abs(change))
            if update and change != 0.0:
                lam[t] += change
                _push(system.S, J[t], nodes[t], system.has_column[t:], system.Z[t], u, change)
    return worst, largest


@kernel
def tangents(
    bound: float, l1: float, l2: float, g1: float, g2: float, w11: float, w22: float, w12: float
) -> tuple[float, float]:
    """Tangential forces that stop a contact's slip, or the nearest step towards it inside the disk of radius bound.

    l1, l2 [N] the forces now, g1, g2 [m] the slips, w [m/N] their 2 × 2 block of W.
    """
    if bound <= 0.0:
        return 0.0, 0.0
    det = w11 * w22 - w12 * w12
    a, b = l1 - (w22 * g1 - w12 * g2) / det, l2 - (w11 * g2 - w12 * g1) / det
    if a * a + b * b <= bound * bound:
        return a, b
    half = 0.5 * (w11 - w22)
    stiffest = 0.5 * (w11 + w22) + math.sqrt(half * half + w12 * w12)
    a, b = l1 - g1 / stiffest, l2 - g2 / stiffest
    length = math.sqrt(a * a + b * b)
    if length > bound:
        a, b = a * bound / length, b * bound / length
    return a, b


@kernel
def _dot(J: Floats, nodes: Ints, u: Floats) -> float:
    """h J A⁻¹ (…)ᵀ of one row: its gradient times u at its own nodes."""
    total = 0.0
    for n in range(4):
        k = 3 * nodes[n]
        if k >= 0:
            total += J[n, 0] * u[k] + J[n, 1] * u[k + 1] + J[n, 2] * u[k + 2]
    return total


@kernel
def _push(S: Floats, J: Floats, nodes: Ints, has_column: Ints, column: Floats, u: Floats, change: float) -> None:
    """u += column · change, the row's column A⁻¹ (h J)ᵀ at the touched nodes; made when first needed."""
    size = S.shape[0]
    if has_column[0] == 0:
        has_column[0] = 1
        column[:] = 0.0
        for n in range(4):
            k = 3 * nodes[n]
            if k >= 0:
                a, b, c = J[n, 0], J[n, 1], J[n, 2]
                x, y, z = S[k], S[k + 1], S[k + 2]
                for i in range(size):
                    column[i] += a * x[i] + b * y[i] + c * z[i]
    for i in range(size):
        u[i] += change * column[i]


@kernel
def _product(S: Floats, J: Floats, nodes: Ints, J_other: Floats, nodes_other: Ints) -> float:
    """(h J) A⁻¹ (h J_other)ᵀ of two rows."""
    total = 0.0
    for m in range(4):
        a = 3 * nodes[m]
        if a < 0:
            continue
        for n in range(4):
            b = 3 * nodes_other[n]
            if b >= 0:
                for i in range(3):
                    T = S[a + i]
                    total += J[m, i] * (T[b] * J_other[n, 0] + T[b + 1] * J_other[n, 1] + T[b + 2] * J_other[n, 2])
    return total


@stage
def apply_rows(model: Model, state: State, rows: int) -> None:
    """Add A⁻¹ (h J)ᵀ λ to the velocities of all free nodes; state.J holds h J since `solve_rows`."""
    y = state.rhs
    y[:] = 0.0
    for row in range(rows):
        force = state.lam[row]
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
