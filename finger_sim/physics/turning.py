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
from .lanes import Lanes, absolute, bits, load4, load8, maximum, scatter3, splat8, sqrt, store4, store8, sum3, where
from .model import Model, State, Tensor
from .polar import Matrix, load_matrix
from .squares import add_squares
from .tensor_limit import at_node, less, pairs_of, spin_of, times, turned

_FIRST, _SECOND = (0, 0, 1), (1, 2, 2)
_APART = 0.1  # of λ_i − λ_j at least: nearer ones have rows between them (tensor_limit.py)
# A limit counts as passed so much of its room before it is, as it may be so within the step; or, if that is less, what
# gives a stress of so many shear moduli. Of a limit that is all but rigid the first would be a huge force.
AHEAD, _MODULI = 0.05, 15.0


@formula
def ahead_of(model: Model) -> float:
    """Part of its room before which a limit counts as passed."""
    return min(AHEAD, _MODULI * model.lame_mu * model.limit_compliance)


@stage
def add_turning(model: Model, state: State, blocks: Floats, h: float) -> None:
    """Add what limits at state.x resist turning with to `blocks`, as A has them."""
    tensor, volume = state.tensor, model.lane_volume
    near, frames, lane_J, factors, none = tensor.near, tensor.frames, tensor.lane_J, model.limit_factors, splat8(0.0)
    tensor.turning_count[0] = 0
    stiffness = h * h / model.limit_compliance
    passed = 1.0 - ahead_of(model)
    trace = 1.0 / 3.0 if model.patches.volume.shape[0] > 0 else 0.0
    for b in range(near.shape[0]):
        if bits((load8(near, b, 0) > 0.0) | (load8(near, b, 1) > 0.0)) == 0:
            continue
        found = count = 0
        R, E = load_matrix(state.R, b), load_symmetric(state.E, b)
        spin, size = spin_of(E), stiffness * load8(volume, b, 0)
        for k in range(3 if model.mirrored else 6):
            side, i, j, weight = k // 3, _FIRST[k % 3], _SECOND[k % 3], none
            entry, _ = pairs_of(model, b, side)
            a, c = _scaled(frames, entry, i, factors, side), _scaled(frames, entry, j, factors, side)
            for one in range(side, 2 if model.mirrored else side + 1):  # mirrored, both sides have the same g
                _, sign = pairs_of(model, b, one)
                p, q = sign * load8(frames, entry, i), sign * load8(frames, entry, j)
                passes = (load8(near, b, one) > 0.0) & (maximum(p, q) > passed)
                if bits(passes) != 0:
                    weight = weight + where(passes, _resistance(p, q, a, c, passed), none)
            root = sqrt(weight * size)
            if bits(root > 0.0) == 0:
                continue
            found |= bits(root > 0.0)
            slope = _slope(R, E, spin, a, c, trace)
            for n in range(4):
                x, y, z = at_node(slope, load_vector(model.lane_gradients, b, 3 * n))
                scatter3(lane_J, 0, 4 * count + n, x * root, y * root, z * root)
            store8(tensor.lane_root, count, 0, root)
            count += 1
        for l in range(8):
            if (found >> l) & 1:
                add_squares(blocks, model.tet_block, 8 * b + l, lane_J, l, count)
                if model.tet_moves[8 * b + l] < 4 and not model.has_bone:
                    keep_squares(tensor, 8 * b + l, l, count)


@stage
def keep_squares(tensor: Tensor, t: int, l: int, count: int) -> None:
    """Keep the squares of tetrahedron t, whose gradients are in lane l of lane_J, for `resist_driven`."""
    for k in range(count):
        if tensor.lane_root[k, l] == 0.0:
            continue
        own = tensor.turning_count[0]
        tensor.turning_tet[own] = t
        for n in range(4):
            store4(tensor.turning_J, own, n, load4(tensor.lane_J, l, 4 * k + n))
        tensor.turning_count[0] = own + 1


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
def _slope(R: Matrix, E: Symmetric, spin: Symmetric, a: Vector, b: Vector, trace: float) -> Matrix:
    """∂(aᵀ E b)/∂F, without so much of its trace: a third where it is that of the patch; spin: `spin_of` E."""
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
    return less(turned(R, S, times(spin, z)), R, (s0 + s1 + s2) * trace)


@stage
def resist_driven(model: Model, state: State) -> None:
    """What driven nodes do of what A resists turning with, to state.rhs."""
    tensor, rhs, nf = state.tensor, state.rhs, model.free.shape[0]
    g = tensor.turning_J
    for k in range(tensor.turning_count[0]):
        t, rate = tensor.turning_tet[k], 0.0
        for n in range(4):
            rate += sum3(load4(g, k, n) * load4(state.driven_velocity, model.tets[t, n], 0))
        for n in range(4):
            slot = model.tet_slot[t, n]
            if slot < nf:
                store4(rhs, slot, 0, load4(rhs, slot, 0) - load4(g, k, n) * rate)
