r"""A bone that yields: the driven nodes as one rigid body between the tissue and a spring to the commanded pose.

The virtual coupling of haptics (Colgate, Stanley & Brown 1995; Adams & Hannaford 1999), six degrees of freedom, solved
for together with the tissue. V = (w, ω) is the bone's velocity at the finger frame's origin p, world [m/s, rad/s]. A
driven node at arm ρ_d = x_d − p moves by v_d = G_d V, G_d = [I, −[ρ_d]×]. Before that is used the driven nodes are
nodes like others: with their masses, their weight, their blocks of A and their part of limit rows. Residuals on them
add up to one of the bone, Σ G_dᵀ r_d, and to it come h times

    spring  f = k (p_c − p − h w) + d (v_c − w),   τ = k_r (θ − h ω) + d_r (ω_c − ω),   |f| ≤ F, |τ| ≤ T,

θ the rotation vector from the bone to the command (p_c, v_c, ω_c: the commanded pose at the step's end and its
velocity); the weight of the whole body, which the coupling bears by itself, so that it is at the commanded pose when
nothing touches it; and a stop that keeps the driven nodes' mean out of the plane. All is implicit in V: stable at any k
and h.

In Newton's method V is eliminated last: with H_ff = L D Lᵀ of the free nodes as ever and B = H_fb between them and V,

    S = H_bb − Bᵀ H_ff⁻¹ B,    S δ_b = r_b − Bᵀ H_ff⁻¹ r_f,    δ_f = H_ff⁻¹ (r_f − B δ_b).

Slots after the free nodes' and the empty one: nf + 1 the bone's translation, nf + 2 its rotation, then the driven
nodes, where vectors of velocity hold G_d V.
"""

from __future__ import annotations

import math

from ..arrays import Floats
from .compile import stage
from .lanes import Lanes, lane, load4, load8, splat4, splat8, store4, store8
from .linear_solver import solve, solve8
from .model import Model, State

PULLED, TWISTED, STOPPED = 1, 2, 4  # spring at its force limit, at its torque limit; bone at the plane: bits
_STOP = 1e3  # stiffness of the stop, in units of the body's inertia within a step, and ten times the spring's at least


@stage
def cross(a: Lanes, b: Lanes) -> tuple[float, float, float]:
    """a × b."""
    a0, a1, a2, b0, b1, b2 = lane(a, 0), lane(a, 1), lane(a, 2), lane(b, 0), lane(b, 1), lane(b, 2)
    return a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0


@stage
def aim_bone(model: Model, state: State, h: float, again: bool) -> None:
    """What the linear step needs to know of the bone at state.x: arms, wrenches at its present velocity, its stop.

    again: state.x is an estimate of the step's end, else its start, from which the present velocity leads on.
    """
    driven, x, v = model.driven, state.x, state.v
    pose, twist, target, base, arms = (
        state.bone[7:],
        state.twist,
        state.target,
        state.yielding.base,
        state.yielding.arms,
    )
    lead = 0.0 if again else h
    mean0 = mean1 = mean2 = 0.0
    for d in range(driven.shape[0]):
        n = driven[d]
        a0, a1, a2 = x[n, 0] - pose[0], x[n, 1] - pose[1], x[n, 2] - pose[2]
        arms[d, 0], arms[d, 1], arms[d, 2] = a0, a1, a2
        mean0, mean1, mean2 = mean0 + a0, mean1 + a1, mean2 + a2
        v[n, 0] = twist[0] + twist[4] * a2 - twist[5] * a1
        v[n, 1] = twist[1] + twist[5] * a0 - twist[3] * a2
        v[n, 2] = twist[2] + twist[3] * a1 - twist[4] * a0
        store4(state.driven_velocity, n, 0, load4(v, n, 0))
    turn = rotation_between(pose[3:], target[3:])
    spring = model.spring
    for i in range(3):
        base[i] = spring[0, 0] * (target[i] - pose[i] - lead * twist[i]) + spring[0, 1] * (target[7 + i] - twist[i])
        base[3 + i] = spring[1, 0] * (turn[i] - lead * twist[3 + i]) + spring[1, 1] * (target[10 + i] - twist[3 + i])
    load, gravity, total = state.yielding.load, model.gravity, 0.0
    m0 = m1 = m2 = 0.0
    for n in range(x.shape[0]):
        mass = model.mass[n]
        total += mass
        m0, m1, m2 = m0 + mass * x[n, 0], m1 + mass * x[n, 1], m2 + mass * x[n, 2]
    m0, m1, m2 = m0 - total * pose[0], m1 - total * pose[1], m2 - total * pose[2]
    load[0], load[1], load[2] = -total * gravity[0], -total * gravity[1], -total * gravity[2]
    load[3] = -(m1 * gravity[2] - m2 * gravity[1])
    load[4] = -(m2 * gravity[0] - m0 * gravity[2])
    load[5] = -(m0 * gravity[1] - m1 * gravity[0])
    pull = math.sqrt(base[0] * base[0] + base[1] * base[1] + base[2] * base[2])
    state.yielding.reach[0] = h * min(pull, model.spring_limit[0]) / total
    stop = state.yielding.stop
    if model.has_plane:
        count = driven.shape[0]
        mean0, mean1, mean2 = mean0 / count, mean1 / count, mean2 / count
        n0, n1, n2 = state.plane_frame[0, 0], state.plane_frame[0, 1], state.plane_frame[0, 2]
        stop[0], stop[1], stop[2] = n0, n1, n2
        stop[3], stop[4], stop[5] = mean1 * n2 - mean2 * n1, mean2 * n0 - mean0 * n2, mean0 * n1 - mean1 * n0
        point = state.plane_point
        gap = n0 * (mean0 + pose[0] - point[0]) + n1 * (mean1 + pose[1] - point[1]) + n2 * (mean2 + pose[2] - point[2])
        for i in range(6):
            gap += lead * stop[i] * twist[i]
        stop[6], stop[7] = gap, max(_STOP * total / (h * h), 10.0 * spring[0, 0])


@stage
def bone_residual(model: Model, state: State, h: float, change: Floats, r: Floats) -> int:
    """Gather the residual of the bone at `change` into slots nf + 1 and nf + 2 of r; which of PULLED … hold.

    The driven nodes' slots of r become 0. The spring's wrench on the bone goes into state.coupling [N, N m], the stop's
    force into state.yielding.stop[8] [N].
    """
    nf, arms, spring, base, load = (
        model.free.shape[0],
        state.yielding.arms,
        model.spring,
        state.yielding.base,
        state.yielding.load,
    )
    coupling, pulls = state.coupling, state.yielding.pulls
    force, t0, t1, t2 = splat4(0.0), 0.0, 0.0, 0.0
    for d in range(arms.shape[0]):
        f = load4(r, nf + 3 + d, 0)
        force = force + f
        a, b, c = cross(load4(arms, d, 0), f)
        t0, t1, t2 = t0 + a, t1 + b, t2 + c
        store4(r, nf + 3 + d, 0, splat4(0.0))
    store4(r, nf + 1, 0, force)
    r[nf + 2, 0], r[nf + 2, 1], r[nf + 2, 2] = t0, t1, t2
    holds = 0
    for part in range(2):
        gives, slot = h * spring[part, 0] + spring[part, 1], nf + 1 + part
        size = 0.0
        for i in range(3):
            pull = base[3 * part + i] - gives * change[slot, i]
            coupling[3 * part + i] = pull
            size += pull * pull
        size = math.sqrt(size)
        share = 1.0
        if size > model.spring_limit[part]:
            share = model.spring_limit[part] / size
            holds |= PULLED << part
        pulls[part, 3] = share
        for i in range(3):
            pulls[part, i] = coupling[3 * part + i] / size if share < 1.0 else 0.0
            coupling[3 * part + i] *= share
            r[slot, i] += h * (coupling[3 * part + i] + load[3 * part + i])
    stop = state.yielding.stop
    stop[8] = 0.0
    if model.has_plane:
        gap = stop[6]
        for i in range(3):
            gap += h * (stop[i] * change[nf + 1, i] + stop[3 + i] * change[nf + 2, i])
        if gap < 0.0:
            holds |= STOPPED
            stop[8] = -stop[7] * gap
            for i in range(3):
                r[nf + 1, i] += h * stop[8] * stop[i]
                r[nf + 2, i] += h * stop[8] * stop[3 + i]
    return holds


@stage
def factor_bone(model: Model, state: State, h: float, contacts: int, rows: int, holds: int) -> bool:
    """B, H_ff⁻¹ B and the Cholesky factor of S, for rows and `holds` as they are. False: S is not positive definite."""
    nf, arms, A, S, B, Y = (
        model.free.shape[0],
        state.yielding.arms,
        state.A,
        state.yielding.S,
        state.yielding.border,
        state.yielding.border_solved,
    )
    J, stiffness, row_slot, scratch = state.J, state.newton.stiffness, state.row_slot, state.yielding.scratch
    block_row, block_column = model.block_row, model.block_column
    state.yielding.holds[1] = holds
    S[:] = 0.0
    B[:] = 0.0
    scratch[:] = 0.0
    free_blocks, blocks = model.block_place.shape[0], block_row.shape[0]
    for p in range(free_blocks, blocks):
        arm, other = load4(arms, block_row[p] - nf - 3, 0), block_column[p]
        of_bone(A, nf + p, arm, scratch)
        if other < nf:
            for j in range(3):
                store8(B, other, j, load8(B, other, j) + load8(scratch, j, 0))
        else:
            add_rigid(S, scratch, load4(arms, other - nf - 3, 0), True)
    for d in range(arms.shape[0]):
        arm = load4(arms, d, 0)
        of_bone(A, nf + blocks + d, arm, scratch)
        add_rigid(S, scratch, arm, False)
    for row in range(contacts, rows):
        if stiffness[row] <= 0.0:
            continue
        pull, t0, t1, t2, touches = splat4(0.0), 0.0, 0.0, 0.0, False
        for n in range(4):
            slot = row_slot[row, n]
            if slot > nf:
                touches = True
                j4 = load4(J, row, n)
                pull = pull + j4
                a, b, c = cross(load4(arms, slot - nf - 3, 0), j4)
                t0, t1, t2 = t0 + a, t1 + b, t2 + c
        if touches:
            scratch[0, 0], scratch[0, 1], scratch[0, 2] = lane(pull, 0), lane(pull, 1), lane(pull, 2)
            scratch[0, 3], scratch[0, 4], scratch[0, 5] = t0, t1, t2
            weight = h * h * stiffness[row]
            add_square(S, scratch[0], weight)
            for n in range(4):
                slot = row_slot[row, n]
                if slot < nf:
                    for j in range(3):
                        store8(B, slot, j, load8(B, slot, j) + load8(scratch, 0, 0) * (weight * J[row, n, j]))
    spring, pulls, stop = model.spring, state.yielding.pulls, state.yielding.stop
    for part in range(2):
        gives = h * (h * spring[part, 0] + spring[part, 1]) * pulls[part, 3]
        for i in range(3):
            for j in range(3):
                S[3 * part + i, 3 * part + j] += gives * ((1.0 if i == j else 0.0) - pulls[part, i] * pulls[part, j])
    if holds & STOPPED:
        add_square(S, stop, h * h * stop[7])
    for k in range(nf):
        for j in range(3):
            store8(Y, k, j, load8(B, k, j))
    solve8(model.pattern, state.L_lower, state.L_inverse, Y)
    for i in range(6):
        total = splat8(0.0)
        for k in range(nf):
            total = total + load8(Y, k, 0) * B[k, 0, i] + load8(Y, k, 1) * B[k, 1, i] + load8(Y, k, 2) * B[k, 2, i]
        store8(scratch, 0, 0, total)
        for j in range(6):
            S[i, j] -= scratch[0, j]
    return cholesky(S)


@stage
def of_bone(A: Floats, block: int, arm: Lanes, out: Floats) -> None:
    """out (3, 8) = Bᵀ G for a block B of A and G of `arm`."""
    for j in range(3):
        u = load4(A, block, j)
        out[j, 0], out[j, 1], out[j, 2] = lane(u, 0), lane(u, 1), lane(u, 2)
        out[j, 3], out[j, 4], out[j, 5] = cross(arm, u)


@stage
def add_rigid(S: Floats, product: Floats, arm: Lanes, twice: bool) -> None:
    """S += Gᵀ Pᵀ for P (3, 6) = Aᵀ G' by columns in `product`, G of `arm`; `twice`: and its transpose."""
    for c in range(6):
        a, b, d = product[0, c], product[1, c], product[2, c]
        a0, a1, a2 = lane(arm, 0), lane(arm, 1), lane(arm, 2)
        column = (a, b, d, a1 * d - a2 * b, a2 * a - a0 * d, a0 * b - a1 * a)
        for i in range(6):
            S[i, c] += column[i]
            if twice:
                S[c, i] += column[i]


@stage
def add_square(S: Floats, a: Floats, weight: float) -> None:
    """S += weight · a aᵀ, of the first six."""
    for i in range(6):
        for j in range(6):
            S[i, j] += weight * a[i] * a[j]


@stage
def cholesky(S: Floats) -> bool:
    """The lower triangle of S (6, 6) becomes its Cholesky factor; False if S is not positive definite."""
    for j in range(6):
        for i in range(j, 6):
            total = S[i, j]
            for k in range(j):
                total -= S[i, k] * S[j, k]
            if i > j:
                S[i, j] = total / S[j, j]
            elif total > 0.0:
                S[j, j] = math.sqrt(total)
            else:
                return False
    return True


@stage
def solve_all(model: Model, state: State, y: Floats) -> None:
    """Replace y, in slot order, by H⁻¹ y; the driven nodes' slots get what the bone's velocity is to them."""
    if not model.has_bone:
        solve(model.pattern, state.L_lower, state.L_inverse, y)
        return
    nf, S, Y, b = model.free.shape[0], state.yielding.S, state.yielding.border_solved, state.yielding.scratch[0]
    total = splat8(0.0)
    for k in range(nf):
        total = total + load8(Y, k, 0) * y[k, 0] + load8(Y, k, 1) * y[k, 1] + load8(Y, k, 2) * y[k, 2]
    store8(state.yielding.scratch, 0, 0, total)
    for i in range(6):
        b[i] = y[nf + 1 + i // 3, i % 3] - b[i]
    for i in range(6):
        for j in range(i):
            b[i] -= S[i, j] * b[j]
        b[i] /= S[i, i]
    for i in range(5, -1, -1):
        for j in range(i + 1, 6):
            b[i] -= S[j, i] * b[j]
        b[i] /= S[i, i]
    solve(model.pattern, state.L_lower, state.L_inverse, y)
    moves = load8(state.yielding.scratch, 0, 0)
    for k in range(nf):
        for j in range(3):
            store8(state.yielding.scratch, 1, 0, load8(Y, k, j) * moves)
            part = state.yielding.scratch[1]
            y[k, j] -= part[0] + part[1] + part[2] + part[3] + part[4] + part[5]
    for i in range(3):
        y[nf + 1, i], y[nf + 2, i] = b[i], b[3 + i]
    spread(model, state, y)


@stage
def spread(model: Model, state: State, y: Floats) -> None:
    """Slots of the driven nodes: G_d V of the V in slots nf + 1 and nf + 2."""
    nf, arms = model.free.shape[0], state.yielding.arms
    w, turn = load4(y, nf + 1, 0), load4(y, nf + 2, 0)
    for d in range(arms.shape[0]):
        a, b, c = cross(turn, load4(arms, d, 0))
        y[nf + 3 + d, 0], y[nf + 3 + d, 1], y[nf + 3 + d, 2] = lane(w, 0) + a, lane(w, 1) + b, lane(w, 2) + c


@stage
def move_bone(model: Model, state: State, h: float) -> None:
    """The bone's pose now: that of the step's start moved by its velocity for h; the finger frame's origin."""
    start, pose, twist = state.bone[:7], state.bone[7:], state.twist
    for i in range(3):
        pose[i] = state.origin[i] = start[i] + h * twist[i]
    turned = turned_by(start[3:], h * twist[3], h * twist[4], h * twist[5])
    for i in range(4):
        pose[3 + i] = turned[i]


@stage
def place_driven(model: Model, state: State) -> None:
    """The driven nodes where the bone's pose has them."""
    rest, driven, x, pose = model.rest_driven, model.driven, state.x, state.bone[7:]
    a, b, c, w = pose[3], pose[4], pose[5], pose[6]
    for d in range(driven.shape[0]):
        n, r0, r1, r2 = driven[d], rest[d, 0], rest[d, 1], rest[d, 2]
        s0, s1, s2 = 2.0 * (b * r2 - c * r1), 2.0 * (c * r0 - a * r2), 2.0 * (a * r1 - b * r0)
        x[n, 0] = pose[0] + r0 + w * s0 + b * s2 - c * s1
        x[n, 1] = pose[1] + r1 + w * s1 + c * s0 - a * s2
        x[n, 2] = pose[2] + r2 + w * s2 + a * s1 - b * s0


@stage
def turned_by(q: Floats, x: float, y: float, z: float) -> tuple[float, float, float, float]:
    """The orientation q (x y z w) turned by the rotation vector (x, y, z) [rad], world axes; of unit length."""
    angle = math.sqrt(x * x + y * y + z * z)
    s = math.sin(0.5 * angle) / angle if angle > 1e-12 else 0.5
    x, y, z, w = s * x, s * y, s * z, math.cos(0.5 * angle)
    a, b, c, d = (
        w * q[0] + x * q[3] + y * q[2] - z * q[1],
        w * q[1] + y * q[3] + z * q[0] - x * q[2],
        w * q[2] + z * q[3] + x * q[1] - y * q[0],
        w * q[3] - x * q[0] - y * q[1] - z * q[2],
    )
    size = 1.0 / math.sqrt(a * a + b * b + c * c + d * d)
    return a * size, b * size, c * size, d * size


@stage
def rotation_between(a: Floats, b: Floats) -> tuple[float, float, float]:
    """Rotation vector [rad] from orientation a to b (x y z w), world axes, the shorter way."""
    x = b[0] * a[3] - b[3] * a[0] - b[1] * a[2] + b[2] * a[1]
    y = b[1] * a[3] - b[3] * a[1] - b[2] * a[0] + b[0] * a[2]
    z = b[2] * a[3] - b[3] * a[2] - b[0] * a[1] + b[1] * a[0]
    w = b[3] * a[3] + b[0] * a[0] + b[1] * a[1] + b[2] * a[2]
    size = math.sqrt(x * x + y * y + z * z)
    factor = 2.0 * math.atan2(size, abs(w)) / size if size > 1e-12 else 2.0
    if w < 0.0:
        factor = -factor
    return factor * x, factor * y, factor * z
