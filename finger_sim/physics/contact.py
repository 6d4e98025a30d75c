"""Contact of surface nodes with a plane, and Coulomb's cone.

Gap φ = n · (x − p), negative inside the plane, n the outward unit normal. Rows of a node, in this order:
normal φ + h n·v + λ_n / k_n ≥ 0 ⊥ λ_n ≥ 0, and two tangents h t·v with |λ_t| ≤ μ λ_n, opposing slip.
The force of the plane on the node is n λ_n + t₁ λ_t1 + t₂ λ_t2 [N], world axes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from .compile import stage

if TYPE_CHECKING:
    from .model import Model, State

_MARGIN = 0.03  # nodes nearer than this part of the tetrahedra's size get rows: they may be pushed in


@stage
def contact_rows(model: Model, state: State, h: float, rows: int) -> int:
    """Append three rows for every free surface node that can reach the plane in this step; return the number of rows.

    -1 when the arrays hold no more rows.
    """
    frame, point = model.plane_frame, model.plane_point
    margin = _MARGIN * model.length
    for c in range(model.contact_nodes.shape[0]):
        node = model.contact_nodes[c]
        x, v, warm = state.x[node], state.v[node], state.contact_force[node]
        gap = frame[0, 0] * (x[0] - point[0]) + frame[0, 1] * (x[1] - point[1]) + frame[0, 2] * (x[2] - point[2])
        ahead = gap + h * (frame[0, 0] * v[0] + frame[0, 1] * v[1] + frame[0, 2] * v[2])
        if gap > margin and ahead > margin:
            continue
        if rows + 3 > state.lam.shape[0]:
            return -1
        for axis in range(3):
            d = frame[axis]
            state.row_slot[rows, 0] = model.slot[node]
            for k in range(3):
                state.row_slot[rows, k + 1] = -1
                state.J[rows, 0, k] = d[k]
                for n in range(1, 4):
                    state.J[rows, n, k] = 0.0
            state.row_tet[rows] = -1 - node
            state.constant[rows] = ahead if axis == 0 else h * (d[0] * v[0] + d[1] * v[1] + d[2] * v[2])
            state.compliance[rows] = model.contact_compliance if axis == 0 else 0.0
            state.scale[rows] = 1.0
            state.lam[rows] = d[0] * warm[0] + d[1] * warm[1] + d[2] * warm[2]
            rows += 1
    return rows


@stage
def store_contact(model: Model, state: State, contact_rows: int) -> int:
    """Node forces of this step into state.contact_force, their wrench into state.wrench; how many nodes carry one."""
    state.contact_force[:] = 0.0
    wrench = state.wrench
    wrench[:] = 0.0
    frame, origin = model.plane_frame, state.origin
    contacts = 0
    for row in range(0, contact_rows, 3):
        node = -1 - state.row_tet[row]
        if state.lam[row] > 0.0:
            contacts += 1
            f, x = state.contact_force[node], state.x[node]
            for k in range(3):
                f[k] = (
                    frame[0, k] * state.lam[row] + frame[1, k] * state.lam[row + 1] + frame[2, k] * state.lam[row + 2]
                )
                wrench[k] += f[k]
            a, b, c = x[0] - origin[0], x[1] - origin[1], x[2] - origin[2]
            wrench[3] += b * f[2] - c * f[1]
            wrench[4] += c * f[0] - a * f[2]
            wrench[5] += a * f[1] - b * f[0]
    return contacts


@stage
def deepest(model: Model, state: State) -> float:
    """Largest penetration of any surface node, driven ones too, at the state's positions [m], 0 when none."""
    frame, point = model.plane_frame, model.plane_point
    deepest = 0.0
    for c in range(model.surface_nodes.shape[0]):
        x = state.x[model.surface_nodes[c]]
        gap = frame[0, 0] * (x[0] - point[0]) + frame[0, 1] * (x[1] - point[1]) + frame[0, 2] * (x[2] - point[2])
        deepest = max(deepest, -gap)
    return deepest
