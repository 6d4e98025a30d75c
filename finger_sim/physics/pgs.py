"""Projected Gauss-Seidel on the rows of a step: the paper's solver (Section 4; Cottle, Pang & Stone 1992).

With v = v_free + h A⁻¹ Jᵀ λ, the row values are g = C + h J v + ε λ = constant + W λ, where
W = h² J A⁻¹ Jᵀ + diag(ε) is the Delassus matrix and ε the rows' compliance. Wanted: g ≥ 0 ⊥ λ ≥ 0 for limits and
normals, and for the two tangents of a contact Coulomb's cone: |λ_t| ≤ μ λ_n, opposing the slip.

One sweep updates each row by its own diagonal of W. W itself is never formed: the sweeps keep u = h A⁻¹ Jᵀ λ at
the nodes that rows touch. A row reads its g from its own nodes, and adds its column h A⁻¹ J_iᵀ to u when its force
changes, so that a row at rest off its limit costs a dozen products. The columns come from S, the block of A⁻¹
between touched nodes (touched.py), each when first needed.

What a limit row has at all nodes of its patch, α G (dilatation.py), is one entry more of the row: α, for h θ̇ = h G u
of its patch, which u has beside its nodes.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from ..arrays import Floats, Ints
from .compile import kernel, stage
from .dilatation import add_patch_forces
from .linear_solver import solve
from .model import Model, State
from .touched import inverse_between, touched_nodes
from .vectors import clear, copy_first

_CHECK = 16  # the residual is taken after a sweep that changed little enough to hope, and after every so many


@kernel
def solve_by_sweeps(model: Model, state: State, h: float, contacts: int, rows: int) -> tuple[int, float]:
    """Row forces into state.lam[:rows], velocities v_free + h A⁻¹ Jᵀ λ into state.v. What `solve_rows` returns."""
    touched, patches = touched_nodes(model, state, contacts, rows)
    inverse_between(model, state, h, touched, patches)
    sweeps, residual = solve_rows(model, state, h, contacts, rows, 3 * touched + patches)
    apply_rows(model, state, h, contacts, rows)
    return sweeps, residual


@stage
def solve_rows(model: Model, state: State, h: float, contact_rows: int, rows: int, size: int) -> tuple[int, float]:
    """Row forces into state.lam[:rows], warm-started from what is there. Returns (sweeps, residual).

    The residual is the largest change any row's force would still need on its own (its violation or lack of
    complementarity over its diagonal of W), as nodal force relative to the largest one. When the sweeps run out,
    the iterate with the least residual is kept. size: unknowns of S. On return state.J holds h J.
    """
    pgs, J, lam, best, compliance = state.pgs, state.J, state.lam, state.best, state.compliance
    nodes, u, diagonal, cross, has_column = pgs.row_local, pgs.u, pgs.diagonal, pgs.cross, pgs.has_column
    part, rates = state.row_part, pgs.row_rate
    S = pgs.S[: size * size].reshape((size, size))
    Z = pgs.Z[: rows * size].reshape((rows, size))
    u[: size + 3] = 0.0
    for row in range(rows):
        for n in range(4):
            for i in range(3):
                J[row, n, i] *= h
        has_column[row] = 0
        diagonal[row] = _product(S, J, nodes, row, row) + compliance[row]
        if part.shape[0] > 0:
            diagonal[row] += _square_of_patch(S, J, nodes, row, part[row], rates[row])
    for row in range(0, contact_rows, 3):
        cross[row + 1] = _product(S, J, nodes, row + 1, row + 2)
    system = System(
        J, nodes, part, rates, state.constant, compliance, diagonal, cross, state.scale, lam, u,
        has_column, S, Z,
    )  # fmt: skip
    for row in range(rows):
        if lam[row] != 0.0:
            has_column[row] = 1
            _make_column(system, row, Z[row])
            _add(u, Z[row], lam[row])

    floor = max(model.least_force, model.felt_force)
    worst, largest = visit(system, model.mu_friction, contact_rows, rows, False)
    residual = least = worst / max(largest, floor)
    copy_first(best, lam, rows)
    sweeps = 0
    while residual > model.tolerance and sweeps < model.max_iterations:
        sweeps += 1
        worst, largest = visit(system, model.mu_friction, contact_rows, rows, True)
        if worst > model.tolerance * max(largest, floor) and sweeps % _CHECK != 0 and sweeps < model.max_iterations:
            continue
        worst, largest = visit(system, model.mu_friction, contact_rows, rows, False)
        residual = worst / max(largest, floor)
        if residual < least:
            least = residual
            copy_first(best, lam, rows)
        elif not residual < math.inf:
            break
    copy_first(lam, best, rows)
    return sweeps, least


class System(NamedTuple):
    """The rows of a step, as `visit` needs them; shapes as in State, S and Z as matrices."""

    J: Floats
    nodes: Ints
    part: Floats
    rates: Ints
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
    lam, u, Z = system.lam, system.u, system.Z
    constant, compliance, diagonal = system.constant, system.compliance, system.diagonal
    worst = largest = 0.0
    along_1 = along_2 = 0.0
    for row in range(rows):
        axis = row % 3 if row < contact_rows else 0
        if axis == 0:
            g = constant[row] + compliance[row] * lam[row] + _dot(system, row)
            wanted = max(0.0, lam[row] - g / diagonal[row])
            largest = max(largest, lam[row] * system.scale[row])
        elif axis == 1:
            along_1, along_2 = tangents(
                mu_friction * lam[row - 1], lam[row], lam[row + 1],
                constant[row] + compliance[row] * lam[row] + _dot(system, row),
                constant[row + 1] + compliance[row + 1] * lam[row + 1] + _dot(system, row + 1),
                diagonal[row], diagonal[row + 1], system.cross[row],
            )  # fmt: skip
            wanted = along_1
        else:
            wanted = along_2
        change = wanted - lam[row]
        worst = max(worst, abs(change) * system.scale[row])
        if update and change != 0.0:
            lam[row] = wanted
            if system.has_column[row] == 0:
                system.has_column[row] = 1
                _make_column(system, row, Z[row])
            _add(u, Z[row], change)
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
def _dot(system: System, row: int) -> float:
    """h J A⁻¹ (…)ᵀ of one row: its gradient times u at its own nodes."""
    J, nodes, u = system.J, system.nodes, system.u
    a, b, c, d = nodes[row, 0], nodes[row, 1], nodes[row, 2], nodes[row, 3]
    total: float = (
        (J[row, 0, 0] * u[a] + J[row, 0, 1] * u[a + 1] + J[row, 0, 2] * u[a + 2])
        + (J[row, 1, 0] * u[b] + J[row, 1, 1] * u[b + 1] + J[row, 1, 2] * u[b + 2])
        + (J[row, 2, 0] * u[c] + J[row, 2, 1] * u[c + 1] + J[row, 2, 2] * u[c + 2])
        + (J[row, 3, 0] * u[d] + J[row, 3, 1] * u[d + 1] + J[row, 3, 2] * u[d + 2])
    )
    if system.part.shape[0] > 0:
        total += system.part[row] * u[system.rates[row]]
    return total


@kernel
def _make_column(system: System, row: int, column: Floats) -> None:
    """column = A⁻¹ (h J)ᵀ of one row, at the touched nodes, and what that is to the touched patches."""
    S, J, nodes = system.S, system.J, system.nodes
    size = S.shape[0]
    column[:] = 0.0
    for n in range(4):
        k = nodes[row, n]
        if k < size:
            a, b, c = J[row, n, 0], J[row, n, 1], J[row, n, 2]
            x, y, z = S[k], S[k + 1], S[k + 2]
            for i in range(size):
                column[i] += a * x[i] + b * y[i] + c * z[i]
    if system.part.shape[0] > 0 and system.rates[row] < size:
        a, x = system.part[row], S[system.rates[row]]
        for i in range(size):
            column[i] += a * x[i]


@kernel
def _add(u: Floats, column: Floats, change: float) -> None:
    """u += column · change."""
    for i in range(column.shape[0]):
        u[i] += change * column[i]


@kernel
def _product(S: Floats, J: Floats, nodes: Ints, row: int, other: int) -> float:
    """(h J) A⁻¹ (h J)ᵀ of two rows."""
    total = 0.0
    for m in range(4):
        a = nodes[row, m]
        if a >= S.shape[0]:
            continue
        for n in range(4):
            b = nodes[other, n]
            if b < S.shape[0]:
                for i in range(3):
                    along = S[a + i, b] * J[other, n, 0] + S[a + i, b + 1] * J[other, n, 1]
                    total += J[row, m, i] * (along + S[a + i, b + 2] * J[other, n, 2])
    return total


@kernel
def _square_of_patch(S: Floats, J: Floats, nodes: Ints, row: int, part: float, rate: int) -> float:
    """What its patch adds to `_product` of a row with itself: 2 (h J) A⁻¹ (h α G)ᵀ + α² h² G A⁻¹ Gᵀ."""
    if rate >= S.shape[0]:
        return 0.0
    total: float = part * S[rate, rate]
    for n in range(4):
        a = nodes[row, n]
        if a < S.shape[0]:
            for i in range(3):
                total += 2.0 * J[row, n, i] * S[a + i, rate]
    return part * total


@stage
def apply_rows(model: Model, state: State, h: float, contacts: int, rows: int) -> None:
    """Add A⁻¹ (h J)ᵀ λ to the velocities of all free nodes; state.J holds h J since `solve_rows`."""
    y, lam, J, row_slot, v, free = state.rhs, state.lam, state.J, state.row_slot, state.v, model.free
    sums, row_tet, patches = state.patch_force, state.row_tet, model.patches.lane
    clear(y)
    for row in range(rows):
        force = lam[row]
        if force != 0.0:
            for n in range(4):
                k = row_slot[row, n]
                for i in range(3):
                    y[k, i] += force * J[row, n, i]
    if state.row_part.shape[0] > 0:
        sums[:] = 0.0
        for row in range(contacts, rows):
            t = row_tet[row]
            sums[patches[t // 8, t % 8]] += lam[row] * state.row_part[row]
        add_patch_forces(model, state, h, y)
    solve(model.pattern, state.L_lower, state.L_inverse, y)
    for k in range(free.shape[0]):
        for i in range(3):
            v[free[k], i] += y[k, i]
