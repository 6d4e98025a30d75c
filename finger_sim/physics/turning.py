r"""How limit forces turn with the eigenvectors that they act along: the part of their stiffness that rows leave out.

A `tensor` limit that is passed holds with the energy ½ κ E V a² (λ_i − 1)², a its room along eigenvector i. With

    ∂²λ_i = 2 Σ_{j ≠ i} g_ij g_ijᵀ / (λ_i − λ_j),    g_ij = ∂(q_iᵀ A E A q_j)/∂x, q fixed,

the eigenvector of a limit that is passed resists turning; a row has ∂λ_i ∂λ_iᵀ only. A step that leaves the rest out
overshoots, and so does the next one, for ever: a finger that is pressed hard trembled at half the rate of the steps.
Rooms that differ much make it worse, as A then magnifies g. For each two eigenvalues, however far apart, A has

    2 (f_i − f_j) / (λ_i − λ_j) g_ij g_ijᵀ,    f = κ E V a² max(0, λ − 1).

It changes no state of rest: what it adds to forces goes with the velocities.
"""

from __future__ import annotations

from ..arrays import Floats
from .compile import formula, stage
from .jacobi import Symmetric, Vector, load_symmetric, load_vector
from .lanes import Lanes, absolute, bits, lane, load4, load8, maximum, scatter3, splat8, store4, sum3, where
from .model import Model, State
from .polar import Matrix, load_matrix
from .tensor_limit import at_node, less, pairs_of, spin_of, times, turned

_FIRST, _SECOND = (0, 0, 1), (1, 2, 2)
_APART = 0.1  # of λ_i − λ_j at least: nearer ones have rows between them (tensor_limit.py)
# A limit counts as passed so much of its room before it is, as it may be so within the step; or, if that is less, what
# gives a stress of so many shear moduli. Of a limit that is all but rigid the first would be a huge force.
_AHEAD, _MODULI = 0.05, 15.0


@stage
def add_turning(model: Model, state: State, h: float) -> None:
    """Add what limits at state.x resist turning with to A."""
    tensor, volume = state.tensor, model.volume
    near, frames, lane_J, factors = tensor.near, tensor.frames, tensor.lane_J, model.limit_factors
    tensor.turning_count[0] = 0
    stiffness = h * h / model.limit_compliance
    passed = 1.0 - min(_AHEAD, _MODULI * model.lame_mu * model.limit_compliance)
    trace = 1.0 / 3.0 if model.patches.volume.shape[0] > 0 else 0.0
    for k in range(2 * near.shape[0]):
        b, side = k // 2, k % 2
        at_limit = load8(near, b, side) > 0.0
        if bits(at_limit) == 0:
            continue
        entry, sign = pairs_of(model, b, side)
        for d in range(3):
            i, j = _FIRST[d], _SECOND[d]
            p, q = sign * load8(frames, entry, i), sign * load8(frames, entry, j)
            if bits(at_limit & (maximum(p, q) > passed)) == 0:
                continue
            a, c = _scaled(frames, entry, i, factors, side), _scaled(frames, entry, j, factors, side)
            weight = _resistance(p, q, a, c, passed)
            found = bits(at_limit & (weight > 0.0))
            if found == 0:
                continue
            slope = _slope(load_matrix(state.R, b), load_symmetric(state.E, b), a, c, trace)
            for n in range(4):
                x, y, z = at_node(slope, load_vector(model.lane_gradients, b, 3 * n))
                scatter3(lane_J, 0, n, x, y, z)
            for l in range(8):
                if (found >> l) & 1:
                    t = 8 * b + l
                    add_square(model, state, t, l, stiffness * volume[t] * lane(weight, l))


@formula
def _scaled(frames: Floats, entry: int, i: int, factors: Floats, side: int) -> Vector:
    """y = A q of eigenvector i."""
    return (
        factors[side, 6] * load8(frames, entry, 3 + 3 * i),
        factors[side, 7] * load8(frames, entry, 4 + 3 * i),
        factors[side, 8] * load8(frames, entry, 5 + 3 * i),
    )


@formula
def _resistance(p: Lanes, q: Lanes, a: Vector, b: Vector, passed: float) -> Lanes:
    """2 (f_i − f_j) / (λ_i − λ_j) in units of κ E V, of eigenvalues p, q and vectors a, b; 0 where it is negative."""
    a0, a1, a2 = a
    b0, b1, b2 = b
    none, one = splat8(0.0), splat8(1.0)
    size_a, size_b = a0 * a0 + a1 * a1 + a2 * a2, b0 * b0 + b1 * b1 + b2 * b2
    room_a, room_b = where(size_a > 0.0, one / size_a, none), where(size_b > 0.0, one / size_b, none)
    more = room_a * room_a * maximum(p - passed, none) - room_b * room_b * maximum(q - passed, none)
    more = where(p > q, more, none - more)
    return 2.0 * maximum(more, none) / maximum(absolute(p - q), splat8(_APART))


@formula
def _slope(R: Matrix, E: Symmetric, a: Vector, b: Vector, trace: float) -> Matrix:
    """∂(aᵀ E b)/∂F, without so much of its trace: a third where it is that of the patch."""
    a0, a1, a2 = a
    b0, b1, b2 = b
    p0, p1, p2 = times(E, a)
    q0, q1, q2 = times(E, b)
    z = (
        0.5 * (p1 * b2 - p2 * b1 + q1 * a2 - q2 * a1),
        0.5 * (p2 * b0 - p0 * b2 + q2 * a0 - q0 * a2),
        0.5 * (p0 * b1 - p1 * b0 + q0 * a1 - q1 * a0),
    )
    s0, s1, s2 = a0 * b0, a1 * b1, a2 * b2
    S = (s0, s1, s2, 0.5 * (a1 * b2 + a2 * b1), 0.5 * (a0 * b2 + a2 * b0), 0.5 * (a0 * b1 + a1 * b0))
    return less(turned(R, S, times(spin_of(E), z)), R, (s0 + s1 + s2) * trace)


@stage
def add_square(model: Model, state: State, t: int, l: int, weight: float) -> None:
    """Add weight · g gᵀ of tetrahedron t, whose g is in lane l of lane_J, to A, and keep it for `resist_driven`."""
    A, tensor, g = state.A, state.tensor, state.tensor.lane_J
    for e in range(10):
        block = model.tet_block[t, e]
        if block >= 0:
            row, column = model.pair_row[t, e], model.pair_column[t, e]
            a = load4(g, l, row) * weight
            for c in range(3):
                store4(A, block, c, load4(A, block, c) + a * g[l, column, c])
    if model.tet_moves[t] < 4 and not model.has_bone:
        k = tensor.turning_count[0]
        tensor.turning_tet[k], tensor.turning_weight[k] = t, weight
        for n in range(4):
            store4(tensor.turning_J, k, n, load4(g, l, n))
        tensor.turning_count[0] = k + 1


@stage
def resist_driven(model: Model, state: State) -> None:
    """What driven nodes do of what A resists turning with, to state.rhs."""
    tensor, rhs, nf = state.tensor, state.rhs, model.free.shape[0]
    g = tensor.turning_J
    for k in range(tensor.turning_count[0]):
        t, rate = tensor.turning_tet[k], 0.0
        for n in range(4):
            rate += sum3(load4(g, k, n) * load4(state.driven_velocity, model.tets[t, n], 0))
        push = tensor.turning_weight[k] * rate
        for n in range(4):
            slot = model.tet_slot[t, n]
            if slot < nf:
                store4(rhs, slot, 0, load4(rhs, slot, 0) - load4(g, k, n) * push)
