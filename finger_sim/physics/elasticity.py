"""Corotational linear elasticity (Müller & Gross 2004), linearised once a step: the matrix A and the right-hand side.

With the polar decomposition F = R U and the Biot strain E = U − I in material axes,

    P = R (2 μ E + λ tr E I),    f_n = −vol P r_n,
    K_ab = vol (λ g_a g_bᵀ + μ g_b g_aᵀ + μ (g_a · g_b) I),    g_n = R r_n.

Backward Euler with f(x + h v) ≈ f(x) − h K v (Baraff & Witkin 1998), M lumped, Rayleigh D = α M + β K:

    A v = b,    A = (1 + h α) M + h (h + β) K,    b = M v₀ + h (M g + f(x)).

Under the `tensor` limit, the limit forces Λ = Σ λ of a tetrahedron (of the last step) turn with it. The stiffness of
that need not be positive, but its size is about Λ r_a · r_b; `limits.viscosity` times so much is added to h² K, where
it acts as a viscosity h Λ / vol: nothing at rest, and an end to the chatter where limits cannot all hold.

Where stress relaxes, it is that of another strain with the moduli of the step: see relaxation.py.

g_a · g_b = r_a · r_b does not turn: that part of A is known beforehand (Model.laplace). Driven nodes are no unknowns
(but for those of a bone that yields, see bone.py): their velocity enters as the strain (h + β) sym(RᵀḞ_driven) that it
gives their tetrahedra within the step.
"""

from __future__ import annotations

from ..arrays import Floats
from .compile import formula, stage
from .dilatation import patch_pressures, patch_stiffness
from .kinematics import edges_times
from .lanes import absolute, add3, bits, fill4, lane, load4, load8, maximum, scatter3, splat4, splat8, store4
from .methods import NEWTON, NONE, TENSOR
from .model import Model, State
from .polar import load_matrix, transposed_times
from .relaxation import step_moduli
from .turning import add_turning, resist_driven
from .vectors import add, clear, copy8, subtract_product
from .work import MATRICES

ELASTIC, TURNING = 1, 2  # parts of A that are formed by themselves: all but add_turning's, and that
ALL_OF_A = ELASTIC | TURNING
_CHANGED = 0.3  # of the largest limit force of a tetrahedron, by which one may change while steps share A


@stage
def assemble(model: Model, state: State, h: float, again: bool) -> None:
    """A into state.A, what is stale of it, and b into state.rhs (slot order).

    state.v holds the velocities of the step's start on free nodes and those of this step on driven ones [m/s].
    `again`: state.x is an estimate x₀ + h v* of the step's end, v* in state.v and v₀ in state.v_start; then, with f and
    K taken there, b = M v₀ + h (M g + f(x)) + h² K v*.
    """
    rhs, free, masses, gravity = state.rhs, model.free, model.mass, model.gravity
    v = state.v_start if again else state.v
    nf = free.shape[0]
    for k in range(nf, rhs.shape[0]):
        store4(rhs, k, 0, splat4(0.0))
    for k in range(nf):
        n = free[k]
        mass = masses[n]
        for i in range(3):
            rhs[k, i] = mass * (v[n, i] + h * gravity[i])
    if model.has_bone:
        for d in range(model.driven.shape[0]):
            n = model.driven[d]
            for i in range(3):
                rhs[nf + 3 + d, i] = masses[n] * (v[n, i] + h * gravity[i])
    beta = model.damping_stiffness
    elastic = state.stale[0] & ELASTIC != 0
    if elastic:
        copy8(state.turning_force, state.limit_force, 1)
    if model.patches.volume.shape[0] > 0:
        patch_pressures(model, state, beta if again else h + beta)
    stresses(model, state, h, beta if again else h + beta, elastic)
    if elastic:
        matrix(model, state, state.elastic_A if keeps_parts(model, state) else state.A, h)
        state.work[MATRICES] += 1
        if model.method == NEWTON:
            copy8(state.turned, state.quaternion, 4)
    if turns(model):
        form_turning(model, state, h)
        resist_driven(model, state)
    if again:
        w, product, part = state.slot_velocity, state.slot_product, h / (h + beta)
        slot_velocities(model, state)
        clear(product)
        subtract_product(nf, model.block_row, model.block_column, state.A, w, product)
        add(rhs, rhs, product, -part)
        inertia = part * (1.0 + h * model.damping_mass)
        for k in range(nf):
            store4(rhs, k, 0, load4(rhs, k, 0) - load4(w, k, 0) * (inertia * masses[free[k]]))
        if model.has_bone:
            for d in range(model.driven.shape[0]):
                k = nf + 3 + d
                store4(rhs, k, 0, load4(rhs, k, 0) - load4(w, k, 0) * (inertia * masses[model.driven[d]]))


@formula
def turns(model: Model) -> bool:
    """Whether A has a part that resists turning."""
    does: bool = model.projection == TENSOR and model.limit_compliance > 0.0
    return does


@formula
def keeps_parts(model: Model, state: State) -> bool:
    """Whether steps share A, and its two parts are kept apart, as each may be formed without the other."""
    shared: bool = model.turn < 1.0 and model.relinearizations == 0
    return shared and turns(model) and state.turning_A.shape[0] > 0


@stage
def form_turning(model: Model, state: State, h: float) -> None:
    """What of A resists turning: anew where it is stale; then both parts together."""
    A, own, elastic, stale = state.A, state.turning_A, state.elastic_A, state.stale[0]
    if not keeps_parts(model, state):
        add_turning(model, state, A, h)
        return
    if stale & TURNING != 0:
        for k in range(own.shape[0]):
            for j in range(3):
                store4(own, k, j, splat4(0.0))
        add_turning(model, state, own, h)
    if stale != 0:
        for k in range(A.shape[0]):
            for j in range(3):
                store4(A, k, j, load4(elastic, k, j) + load4(own, k, j))


@stage
def slot_velocities(model: Model, state: State) -> None:
    """state.v, in slot order, into state.slot_velocity; nothing for driven nodes that are no unknowns."""
    w, v, free = state.slot_velocity, state.v, model.free
    nf = free.shape[0]
    for k in range(nf):
        store4(w, k, 0, load4(v, free[k], 0))
    if model.has_bone:
        for d in range(model.driven.shape[0]):
            store4(w, nf + 3 + d, 0, load4(v, model.driven[d], 0))


@formula
def turning_limits(model: Model, state: State) -> bool:
    """Whether limit forces of the last step turn with their tetrahedra."""
    held: bool = state.held_tets[0] > 0 and state.limit_force.shape[0] > 0 and model.limit_viscosity > 0.0
    return held


@stage
def limits_changed(state: State) -> bool:
    """Whether limit forces are so much other ones than A has that it is to be formed anew."""
    now, then = state.limit_force, state.turning_force
    largest, change = splat8(0.0), splat8(0.0)
    for b in range(now.shape[0]):
        p, q = load8(now, b, 0), load8(then, b, 0)
        largest, change = maximum(largest, maximum(p, q)), maximum(change, absolute(p - q))
    most = least = 0.0
    for l in range(8):
        most, least = max(most, lane(change, l)), max(least, lane(largest, l))
    return most > _CHANGED * least


@stage
def stresses(model: Model, state: State, h: float, lead: float, anew: bool) -> None:
    """Add h f(x) to state.rhs, driven nodes going on for `lead` [s]; of g_n = R r_n what patches make of them, state.G.

    anew: `matrix` needs state.g = R r_n of every node of every tetrahedron, as rows on principal stretches do.
    """
    lame_lambda, lame_mu, _ = step_moduli(model, state)
    r, two_mu, strains = model.lane_gradients, 2.0 * lame_mu, state.felt_strain
    rotations, volumes, slots, nodes = state.R, model.lane_volume, model.lane_slot, model.lane_node
    driven, w, rhs, g = model.lane_driven, state.driven_velocity, state.rhs, state.g
    limit_force, patched, pressures = state.turning_force, model.patches.volume.shape[0] > 0, state.pressure
    follows = turning_limits(model, state)
    own, G = model.patches, state.G
    keeps = anew or (patched and model.projection != NONE and model.projection != TENSOR)
    clear(G)
    for b in range(rotations.shape[0]):
        turns = False
        f0 = f1 = f2 = f3 = f4 = f5 = f6 = f7 = f8 = splat8(0.0)  # turning stiffness at driven nodes, times Ḟ_driven
        R = load_matrix(rotations, b)
        e0, e1, e2 = load8(strains, b, 0), load8(strains, b, 1), load8(strains, b, 2)
        e3, e4, e5 = load8(strains, b, 3), load8(strains, b, 4), load8(strains, b, 5)
        if driven[b]:
            rate = edges_times(w, nodes, r, b)
            d0, d1, d2, d3, d4, d5, d6, d7, d8 = transposed_times(R, rate)
            e0, e1, e2 = e0 + lead * d0, e1 + lead * d4, e2 + lead * d8
            e3, e4, e5 = e3 + 0.5 * lead * (d5 + d7), e4 + 0.5 * lead * (d2 + d6), e5 + 0.5 * lead * (d1 + d3)
            if follows:
                w0 = load8(limit_force, b, 0) * (-model.limit_viscosity * h * h)
                turns = bits(w0 < 0.0) != 0
                f0, f1, f2, f3, f4, f5, f6, f7, f8 = rate
                f0, f1, f2, f3, f4 = w0 * f0, w0 * f1, w0 * f2, w0 * f3, w0 * f4
                f5, f6, f7, f8 = w0 * f5, w0 * f6, w0 * f7, w0 * f8
        impulse = -h * load8(volumes, b, 0)
        pressure = lame_lambda * (e0 + e1 + e2)
        if patched:
            pressure = pressure + load8(pressures, b, 0)
        s0, s1, s2 = (
            impulse * (two_mu * e0 + pressure),
            impulse * (two_mu * e1 + pressure),
            impulse * (two_mu * e2 + pressure),
        )
        s3, s4, s5 = impulse * (two_mu * e3), impulse * (two_mu * e4), impulse * (two_mu * e5)
        r0, r1, r2, r3, r4, r5, r6, r7, r8 = R
        for n in range(4):
            a, c, d = load8(r, b, 3 * n), load8(r, b, 3 * n + 1), load8(r, b, 3 * n + 2)
            t0, t1, t2 = s0 * a + s5 * c + s4 * d, s5 * a + s1 * c + s3 * d, s4 * a + s3 * c + s2 * d
            x, y, z = r0 * t0 + r1 * t1 + r2 * t2, r3 * t0 + r4 * t1 + r5 * t2, r6 * t0 + r7 * t1 + r8 * t2
            if turns:
                x = x + (f0 * a + f1 * c + f2 * d)
                y = y + (f3 * a + f4 * c + f5 * d)
                z = z + (f6 * a + f7 * c + f8 * d)
            add3(rhs, slots, b, n, x, y, z)
            x, y, z = r0 * a + r1 * c + r2 * d, r3 * a + r4 * c + r5 * d, r6 * a + r7 * c + r8 * d
            if keeps:
                scatter3(g, b, n, x, y, z)
            if patched:
                share = load8(own.lane_share, b, 0)
                add3(G, own.lane_entry, b, n, x * share, y * share, z * share)


@stage
def matrix(model: Model, state: State, A: Floats, h: float) -> None:
    """A of the rotations that state.g has, but for what resists turning."""
    g, free, mass, laplace, nf = state.g, model.free, model.mass, model.laplace, model.free.shape[0]
    assembly, start, volume, dot = model.assembly, model.assembly_start, model.volume, model.assembly_dot
    weight = h * (h + model.damping_stiffness)
    lame_lambda, lame_mu, _ = step_moduli(model, state)
    w_lambda, w_mu = weight * lame_lambda, weight * lame_mu
    inertia, viscosity = 1.0 + h * model.damping_mass, model.limit_viscosity * h * h
    limit_force, turns = state.turning_force.reshape(-1), turning_limits(model, state)
    bones = nf + model.block_row.shape[0]  # the first diagonal block of a bone's node
    for k in range(A.shape[0]):
        same = w_mu * laplace[k]
        if k < nf:
            same += inertia * mass[free[k]]
        elif k >= bones:
            same += inertia * mass[model.driven[k - bones]]
        p, q, r = splat4(0.0), splat4(0.0), splat4(0.0)
        for c in range(start[k], start[k + 1]):
            t, row, column = assembly[c, 0], assembly[c, 1], assembly[c, 2]
            a, b = load4(g, t, row) * (volume[t] * w_lambda), load4(g, t, column) * (volume[t] * w_mu)
            column, row = 4 * column, 4 * row
            p = p + (a * fill4(g, t, column) + b * fill4(g, t, row))
            q = q + (a * fill4(g, t, column + 1) + b * fill4(g, t, row + 1))
            r = r + (a * fill4(g, t, column + 2) + b * fill4(g, t, row + 2))
            if turns:
                same += viscosity * limit_force[t] * dot[c]
        store4(A, k, 0, p)
        store4(A, k, 1, q)
        store4(A, k, 2, r)
        for j in range(3):
            A[k, j, j] += same
    if model.patches.volume.shape[0] > 0:
        patch_stiffness(model, state, A, weight)
