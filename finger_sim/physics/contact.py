"""Contact of surface nodes with a plane, and Coulomb's cone.

Gap φ = n · (x − p), negative inside the plane, n the outward unit normal. Rows of a node, in this order:
normal φ + h n·v + (λ_n − λ_n⁰) / k ≥ 0 ⊥ λ_n ≥ 0, and two tangents h t·(v − v_p) + (λ_t − λ_t⁰) / k with
|λ_t| ≤ μ λ_n, opposing slip. A plane that moves is taken where it is at the step's end; v_p is its velocity under the
node. λ⁰ is the force of the step before: a contact is a spring only while its force changes, so that a soft
one neither sinks in nor creeps (the method of multipliers, one iteration a step). That is stable where k exceeds the
inertia m / h² of the node: k is kept at or above _INERTIA times it. k = ∞ (model.contact_compliance 0): rigid.
The force of the plane on the node is n λ_n + t₁ λ_t1 + t₂ λ_t2 [N], world axes.
"""

from __future__ import annotations

import math

from ..arrays import Floats
from .compile import kernel, stage
from .lanes import load4, sum3
from .model import Model, State
from .work import NODES_SEEN

# A soft contact is at least so many times as stiff as its node's inertia: one step takes all but 1/31 of what a free
# node would go too deep. More makes the rows of a step stiffer against each other, less lets a node sink in for longer.
_INERTIA = 30.0
_MARGIN = 0.03  # nodes nearer than this part of the tetrahedra's size get rows: they may be pushed in


@kernel
def plane_frame(normal: Floats, frame: Floats) -> None:
    """Right-handed rows n, t₁, t₂ (3, 3) for a unit normal (3,); t₁ lies along the world axis most across it."""
    a, b, c = normal[0], normal[1], normal[2]
    x, y, z = 0.0, 0.0, 1.0
    if abs(a) <= abs(b) and abs(a) <= abs(c):
        x, z = 1.0, 0.0
    elif abs(b) <= abs(c):
        y, z = 1.0, 0.0
    along = a * x + b * y + c * z
    x, y, z = x - along * a, y - along * b, z - along * c
    size = math.sqrt(x * x + y * y + z * z)
    x, y, z = x / size, y / size, z / size
    frame[0, 0], frame[0, 1], frame[0, 2] = a, b, c
    frame[1, 0], frame[1, 1], frame[1, 2] = x, y, z
    frame[2, 0], frame[2, 1], frame[2, 2] = b * z - c * y, c * x - a * z, a * y - b * x


@stage
def contact_rows(model: Model, state: State, h: float, again: bool) -> int:
    """Three rows, from the first on, for every free surface node that can reach the plane in this step; their number.

    -1 when the arrays hold no more rows. `again`: state.x is an estimate of the step's end, which a node may leave too.
    """
    frame, point = state.plane_frame, state.plane_point
    margin = _MARGIN * model.length
    nodes, slots, mobility = model.contact_nodes, model.slot, model.mobility
    positions, velocities, forces = state.x, state.v, state.contact_force
    J, row_slot, row_tet, constant = state.J, state.row_slot, state.row_tet, state.constant
    compliances, scale, lam = state.compliance, state.scale, state.lam
    moving = state.moving
    nf, rows = model.free.shape[0], 0
    nearing, g = bone_nears(model, state), model.gravity
    falling = -h * h * min(0.0, frame[0, 0] * g[0] + frame[0, 1] * g[1] + frame[0, 2] * g[2])  # from rest, in the step
    if state.clearance[0] > margin + falling + h * max(fastest(state.v_start if again else moving), nearing):
        return 0
    state.work[NODES_SEEN] += nodes.shape[0]
    for c in range(nodes.shape[0]):
        node = nodes[c]
        x, v, w, warm = positions[node], velocities[node], moving[node], forces[node]
        gap = frame[0, 0] * (x[0] - point[0]) + frame[0, 1] * (x[1] - point[1]) + frame[0, 2] * (x[2] - point[2])
        ahead = gap + h * (frame[0, 0] * w[0] + frame[0, 1] * w[1] + frame[0, 2] * w[2])
        far = gap > margin and ahead - falling > margin and gap - h * nearing > margin
        if far and not (again and set_out_for(model, state, node, h) <= margin):
            continue
        if rows + 3 > lam.shape[0]:
            return -1
        slot = slots[node]
        compliance = min(model.contact_compliance, h * h * mobility[slot] / _INERTIA)
        for axis in range(3):
            d = frame[axis]
            row_slot[rows, 0] = slot
            for k in range(3):
                row_slot[rows, k + 1] = nf
                J[rows, 0, k] = d[k]
                for n in range(1, 4):
                    J[rows, n, k] = 0.0
            row_tet[rows] = -1 - node
            before = d[0] * warm[0] + d[1] * warm[1] + d[2] * warm[2]
            reach = ahead if axis == 0 else h * (d[0] * v[0] + d[1] * v[1] + d[2] * v[2] - carried(state, x, axis))
            constant[rows] = reach - compliance * before
            compliances[rows] = compliance
            scale[rows] = 1.0
            lam[rows] = before
            rows += 1
    return rows


@stage
def store_contact(model: Model, state: State, contact_rows: int) -> int:
    """Node forces of this step into state.contact_force, their wrench into state.wrench; how many nodes carry one."""
    forces, positions, lam, row_tet, wrench = state.contact_force, state.x, state.lam, state.row_tet, state.wrench
    forces[:] = 0.0
    wrench[:] = 0.0
    frame, origin = state.plane_frame, state.origin
    contacts = 0
    for row in range(0, contact_rows, 3):
        node = -1 - row_tet[row]
        if lam[row] > 0.0:
            contacts += 1
            f, x = forces[node], positions[node]
            for k in range(3):
                f[k] = frame[0, k] * lam[row] + frame[1, k] * lam[row + 1] + frame[2, k] * lam[row + 2]
                wrench[k] += f[k]
            a, b, c = x[0] - origin[0], x[1] - origin[1], x[2] - origin[2]
            wrench[3] += b * f[2] - c * f[1]
            wrench[4] += c * f[0] - a * f[2]
            wrench[5] += a * f[1] - b * f[0]
    return contacts


@stage
def deepest(model: Model, state: State) -> float:
    """Largest penetration of any surface node, driven ones too, at the state's positions [m], 0 when none.

    As long as no node can have come near, none is looked at.
    """
    if state.clearance[0] > 0.0:
        return 0.0
    state.work[NODES_SEEN] += model.surface_nodes.shape[0]
    frame, point, nodes, positions = state.plane_frame, state.plane_point, model.surface_nodes, state.x
    least = math.inf
    for c in range(nodes.shape[0]):
        x = positions[nodes[c]]
        gap = frame[0, 0] * (x[0] - point[0]) + frame[0, 1] * (x[1] - point[1]) + frame[0, 2] * (x[2] - point[2])
        least = min(least, gap)
    state.clearance[0] = least
    return max(0.0, -least)


@stage
def set_out_for(model: Model, state: State, node: int, h: float) -> float:
    """Gap that the node would have at the end of the step at the velocity it began it with [m]."""
    frame, point, x, v = state.plane_frame, state.plane_point, state.x_start[node], state.v_start[node]
    gap = 0.0
    for k in range(3):
        gap += frame[0, k] * (x[k] + h * v[k] - point[k])
    return gap


@stage
def bone_nears(model: Model, state: State) -> float:
    """How fast the fastest driven node comes towards the plane in this step [m/s], 0 when none does: skin follows."""
    frame, driven, velocities = state.plane_frame, model.driven, state.driven_velocity
    most: float = 0.0
    for d in range(driven.shape[0]):
        v = velocities[driven[d]]
        most = max(most, -(frame[0, 0] * v[0] + frame[0, 1] * v[1] + frame[0, 2] * v[2]))
    if model.has_bone:
        most += state.yielding.reach[0]
    return most


@stage
def carried(state: State, x: Floats, axis: int) -> float:
    """Velocity of the plane's point at x along its tangent `axis` [m/s]."""
    m, d, p = state.plane_motion, state.plane_frame[axis], state.plane_point
    a, b, c = x[0] - p[0], x[1] - p[1], x[2] - p[2]
    along: float = d[0] * (m[0] + m[4] * c - m[5] * b) + d[1] * (m[1] + m[5] * a - m[3] * c)
    along += d[2] * (m[2] + m[3] * b - m[4] * a)
    return along


@stage
def fastest(v: Floats) -> float:
    """Largest of these velocities [m/s]. v (n, 4)."""
    most = 0.0
    for n in range(v.shape[0]):
        w = load4(v, n, 0)
        most = max(most, sum3(w * w))
    return math.sqrt(most)
