"""The rows of the `tensor` limit, four tetrahedra side by side: which there are, and what forces they carry.

A row stays in the lane of its tetrahedron: a group has four of one direction and side, and where a lane has no row its
stiffness is 0. Of a row with ∂C/∂F the rate is ∂C/∂F : Ḟ, and its force adds −λ ∂C/∂F to the stress: what rows ask of
nodes, and give them, is gathered and added once for all rows of four tetrahedra. Four, because what is at work for
one of them is more than sixteen registers hold already.
"""

from __future__ import annotations

import math

from ..arrays import Floats, Ints
from .compile import formula, stage
from .dilatation import add_patch_forces, patch_rates, patch_sizes
from .jacobi import Vector
from .kinematics import products
from .lanes import (
    Lanes,
    absolute,
    add3x4,
    bits,
    gather3x4,
    lane,
    load4,
    maximum,
    pick4,
    scatter3x4,
    splat4,
    store4,
    where,
)  # fmt: skip
from .methods import PGS
from .model import Model, State, Tensor
from .polar import Matrix, transposed_times
from .tensor_limit import NEAR, at_node, leaning, less, pairs_of, spin_of, square, times, turned

# Of a row, in Tensor.row: g at δ = 0, 1 / ε, (nodal force)² per unit of λ², what its patch gets counted apart.
CONSTANT, STIFFNESS, SQUARE = range(3)
# Directions of rows: the eigenvectors, then those halfway between two of them, on either side.
DIRECTIONS, MOST_DIRECTIONS = 3, 9
_FIRST, _SECOND = (0, 1, 2, 0, 0, 0, 0, 1, 1), (0, 1, 2, 1, 1, 2, 2, 2, 2)
_SIGN = (1.0, 1.0, 1.0, 1.0, -1.0, 1.0, -1.0, 1.0, -1.0)
_WORTH = 0.5  # eigenvalues below are not looked at any closer
# Strain/limit that two eigenvalues near their limit may differ by to be taken as one. More makes rows that hold
# nothing; less lets strain through where the eigenvectors turn by more in a step, and where both are passed their force
# comes and goes within one: at 0.1 single tetrahedra of a sliding finger trembled.
_COINCIDE = 0.3
_NO_GRADIENT = 1e-20  # |J|² at free nodes, in units of the tetrahedra's size, of a row that nothing can move


@stage
def tensor_rows(model: Model, state: State, h: float) -> int:
    """Form a row for every eigenvalue in `frames` that is near its limit, now or after h; return their number.

    Two eigenvalues that nearly coincide have two more between them: their eigenvectors may turn within the step.
    """
    tensor = state.tensor
    near, first, row, fours = tensor.near, tensor.first, tensor.row, 2 * tensor.near.shape[0]
    if model.patches.volume.shape[0] > 0:
        patch_rates(model, state, model.patches.node, state.moving)
        patch_sizes(model, state)
    groups = 0
    for four in range(fours):
        first[four] = groups
        b, half = four // 2, four % 2
        if bits((load4(near, b, half) > 0.0) | (load4(near, b, 2 + half) > 0.0)) != 0:
            groups = rows_of_four(model, state, h, b, half, groups)
    first[fours] = groups
    rows, one, none = splat4(0.0), splat4(1.0), splat4(0.0)
    for k in range(groups):
        rows = rows + where(load4(row, k, STIFFNESS) > 0.0, one, none)
    return int(lane(rows, 0) + lane(rows, 1) + lane(rows, 2) + lane(rows, 3))


@stage
def rows_of_four(model: Model, state: State, h: float, b: int, half: int, groups: int) -> int:
    """Form those of half of batch b from group `groups` on; the number of groups then."""
    tensor, factors, gradients, frames = state.tensor, model.limit_factors, model.lane_gradients, state.tensor.frames
    slopes, row, keys = tensor.slope, tensor.row, tensor.key
    none, one, least = splat4(0.0), splat4(1.0), splat4(_NO_GRADIENT / model.length**2)
    R, volume = load_half(state.R, b, half), load4(model.lane_volume, b, half)
    E = (
        load4(state.E, b, half), load4(state.E, b, 2 + half), load4(state.E, b, 4 + half),
        load4(state.E, b, 6 + half), load4(state.E, b, 8 + half), load4(state.E, b, 10 + half),
    )  # fmt: skip
    rate = transposed_times(R, rate_of(state.moving, model.lane_node, gradients, b, half))
    spin = spin_of(E)
    swelling = size_G = moved_G = none
    own = model.patches
    patched, inert = own.volume.shape[0] > 0, model.limit_inertia > 0.0
    moved_along_G = (none, none, none, none, none, none, none, none, none)
    if patched:
        swelling = pick4(state.patch_rate, own.lane, b, half) - (rate[0] + rate[4] + rate[8])
        size_G = pick4(state.patch_size[0], own.lane, b, half)
        if inert:
            moved_G = pick4(state.patch_size[1], own.lane, b, half)
            moved_along_G = patch_at_masses(model, state, b, half)
    for side in range(2):
        near = load4(tensor.near, b, 2 * side + half) > 0.0
        if bits(near) == 0:
            continue
        entry, sign = pairs_of(model, b, side)
        outwards, part = 2.0 * side - 1.0, (2.0 * side - 1.0) * (1.0 / 3.0)
        between = bits(near & _coincide(frames, entry, half, sign)) != 0
        for d in range(MOST_DIRECTIONS if between else DIRECTIONS):
            value, share, axis = _direction(frames, entry, half, sign, d)
            worth = near & (value > _WORTH) if d < DIRECTIONS else near & (share > 0.0)
            if bits(worth) == 0:
                continue
            y = (factors[side, 6] * axis[0], factors[side, 7] * axis[1], factors[side, 8] * axis[2])
            size = y[0] * y[0] + y[1] * y[1] + y[2] * y[2]
            spun = times(spin, leaning(E, y))
            left = 1.0 - value  # C / room
            ahead = left + (h * outwards) * _along(rate, y, spun) + (h * part) * size * swelling
            worth = worth & ((left <= 1.0 - NEAR) | (ahead <= 1.0 - NEAR))
            if bits(worth) == 0:
                continue
            room = one / where(size > 0.0, size, one)
            slope = turned(R, square(y), spun)
            if patched:
                slope = less(slope, R, size * (1.0 / 3.0))
            slope = _scaled(slope, outwards * room)
            force = squared(slope, model.lane_metric, b, 0, half) + (part * part) * size_G
            stiffness = share * volume * (1.0 / model.limit_compliance)
            if inert:
                moved = squared(slope, model.lane_metric, b, 6, half) + (2.0 * part) * double_dot(slope, moved_along_G)
                moved = moved + (part * part) * moved_G
                stiffness = maximum(stiffness, share * model.limit_inertia / (moved * (h * h)))
            worth = worth & (force > least)
            store_group(slopes, groups, slope)
            store4(row, groups, CONSTANT, where(worth, ahead * room, one))
            store4(row, groups, STIFFNESS, where(worth, stiffness, none))
            store4(row, groups, SQUARE, 0.5 * force)
            keys[groups] = 2 * d + side
            groups += 1
    return groups


@stage
def patch_at_masses(model: Model, state: State, b: int, half: int) -> Matrix:
    """Σ G_n r_nᵀ / m_n over the nodes of half of batch b."""
    none, own = splat4(0.0), model.patches
    total = (none, none, none, none, none, none, none, none, none)
    for n in range(4):
        x, y, z = gather3x4(state.G, own.lane_entry, b, 2 * n + half)
        mobile = load4(model.lane_mobility, b, 2 * n + half)
        p, q, r = gradient_of(model.lane_gradients, b, n, half)
        p, q, r = p * mobile, q * mobile, r * mobile
        t0, t1, t2, t3, t4, t5, t6, t7, t8 = total
        total = (
            t0 + x * p, t1 + x * q, t2 + x * r, t3 + y * p, t4 + y * q, t5 + y * r, t6 + z * p, t7 + z * q, t8 + z * r
        )  # fmt: skip
    return total


@formula
def squared(slope: Matrix, metric: Floats, b: int, first: int, half: int) -> Lanes:
    """Σ_n w_n |slope r_n|² from Σ_n w_n r_n r_nᵀ, in six numbers of `metric` from `first` on."""
    k = 2 * first + half
    c0, c1, c2 = load4(metric, b, k), load4(metric, b, k + 2), load4(metric, b, k + 4)
    c3, c4, c5 = load4(metric, b, k + 6), load4(metric, b, k + 8), load4(metric, b, k + 10)
    g0, g1, g2, g3, g4, g5, g6, g7, g8 = slope
    total = c0 * (g0 * g0 + g3 * g3 + g6 * g6) + c1 * (g1 * g1 + g4 * g4 + g7 * g7)
    total = total + c2 * (g2 * g2 + g5 * g5 + g8 * g8)
    across = c3 * (g1 * g2 + g4 * g5 + g7 * g8) + c4 * (g0 * g2 + g3 * g5 + g6 * g8)
    return total + 2.0 * (across + c5 * (g0 * g1 + g3 * g4 + g6 * g7))


@formula
def double_dot(M: Matrix, N: Matrix) -> Lanes:
    """M : N."""
    m0, m1, m2, m3, m4, m5, m6, m7, m8 = M
    n0, n1, n2, n3, n4, n5, n6, n7, n8 = N
    return m0 * n0 + m1 * n1 + m2 * n2 + (m3 * n3 + m4 * n4 + m5 * n5) + (m6 * n6 + m7 * n7 + m8 * n8)


@formula
def load_half(a: Floats, b: int, half: int) -> Matrix:
    """Four matrices from half of entry b of a (B, 9, 8)."""
    return (
        load4(a, b, half), load4(a, b, 2 + half), load4(a, b, 4 + half),
        load4(a, b, 6 + half), load4(a, b, 8 + half), load4(a, b, 10 + half),
        load4(a, b, 12 + half), load4(a, b, 14 + half), load4(a, b, 16 + half),
    )  # fmt: skip


@formula
def load_group(a: Floats, k: int) -> Matrix:
    """Four matrices from entry k of a (groups, 9, 4)."""
    return (
        load4(a, k, 0), load4(a, k, 1), load4(a, k, 2), load4(a, k, 3), load4(a, k, 4), load4(a, k, 5),
        load4(a, k, 6), load4(a, k, 7), load4(a, k, 8),
    )  # fmt: skip


@formula
def store_group(a: Floats, k: int, M: Matrix) -> None:
    """Write four matrices to entry k of a (groups, 9, 4)."""
    m0, m1, m2, m3, m4, m5, m6, m7, m8 = M
    store4(a, k, 0, m0)
    store4(a, k, 1, m1)
    store4(a, k, 2, m2)
    store4(a, k, 3, m3)
    store4(a, k, 4, m4)
    store4(a, k, 5, m5)
    store4(a, k, 6, m6)
    store4(a, k, 7, m7)
    store4(a, k, 8, m8)


@formula
def gradient_of(gradients: Floats, b: int, n: int, half: int) -> Vector:
    """r_n of half of batch b."""
    k = 6 * n + half
    return load4(gradients, b, k), load4(gradients, b, k + 2), load4(gradients, b, k + 4)


@formula
def rate_of(velocities: Floats, nodes: Ints, gradients: Floats, b: int, half: int) -> Matrix:
    """Ḟ of half of batch b at the nodes' velocities."""
    x4, y4, z4 = gather3x4(velocities, nodes, b, 6 + half)
    x1, y1, z1 = gather3x4(velocities, nodes, b, half)
    x2, y2, z2 = gather3x4(velocities, nodes, b, 2 + half)
    x3, y3, z3 = gather3x4(velocities, nodes, b, 4 + half)
    return products(
        (x1 - x4, y1 - y4, z1 - z4), gradient_of(gradients, b, 0, half),
        (x2 - x4, y2 - y4, z2 - z4), gradient_of(gradients, b, 1, half),
        (x3 - x4, y3 - y4, z3 - z4), gradient_of(gradients, b, 2, half),
    )  # fmt: skip


@formula
def _coincide(frames: Floats, entry: int, half: int, sign: float) -> Lanes:
    """Whether two eigenvalues are near their limit and each other."""
    p, q = sign * load4(frames, entry, half), sign * load4(frames, entry, 2 + half)
    r = sign * load4(frames, entry, 4 + half)
    two = (p > NEAR) & (q > NEAR) & (absolute(p - q) < _COINCIDE)
    two = two | ((p > NEAR) & (r > NEAR) & (absolute(p - r) < _COINCIDE))
    return two | ((q > NEAR) & (r > NEAR) & (absolute(q - r) < _COINCIDE))


@formula
def _direction(frames: Floats, entry: int, half: int, sign: float, d: int) -> tuple[Lanes, Lanes, Vector]:
    """qᵀ B q, the share of a limit's stiffness, and q: an eigenvector, or a unit vector halfway between two of them.

    The share of such a one is the larger the nearer the two; 0 where they are not near each other and the limit.
    """
    a, c = _FIRST[d], _SECOND[d]
    value, share, k = sign * load4(frames, entry, 2 * a + half), splat4(1.0), 6 + 6 * a + half
    q0, q1, q2 = load4(frames, entry, k), load4(frames, entry, k + 2), load4(frames, entry, k + 4)
    if d >= DIRECTIONS:
        other, even, odd = sign * load4(frames, entry, 2 * c + half), math.sqrt(0.5), _SIGN[d] * math.sqrt(0.5)
        share = where((value > NEAR) & (other > NEAR), 1.0 - absolute(value - other) * (1.0 / _COINCIDE), splat4(0.0))
        value, k = 0.5 * (value + other), 6 + 6 * c + half
        q0 = even * q0 + odd * load4(frames, entry, k)
        q1 = even * q1 + odd * load4(frames, entry, k + 2)
        q2 = even * q2 + odd * load4(frames, entry, k + 4)
    return value, share, (q0, q1, q2)


@formula
def _along(M: Matrix, y: Vector, h: Vector) -> Lanes:
    """(y yᵀ − [h]×) : M."""
    m0, m1, m2, m3, m4, m5, m6, m7, m8 = M
    y0, y1, y2 = y
    h0, h1, h2 = h
    stretch = y0 * (y0 * m0 + y1 * m1 + y2 * m2) + y1 * (y0 * m3 + y1 * m4 + y2 * m5)
    stretch = stretch + y2 * (y0 * m6 + y1 * m7 + y2 * m8)
    return stretch + (h0 * (m5 - m7) + h1 * (m6 - m2) + h2 * (m1 - m3))


@formula
def _scaled(M: Matrix, by: Lanes) -> Matrix:
    """M · by."""
    m0, m1, m2, m3, m4, m5, m6, m7, m8 = M
    return m0 * by, m1 * by, m2 * by, m3 * by, m4 * by, m5 * by, m6 * by, m7 * by, m8 * by


@stage
def tensor_forces(model: Model, state: State, h: float) -> float:
    """Forces of the rows at their gaps into Tensor.lam, and what they give nodes to next_residual.

    Returns the largest nodal force.
    """
    tensor, own, r = state.tensor, model.patches, state.newton.next_residual
    first, slopes, row, lam, keys = tensor.first, tensor.slope, tensor.row, tensor.lam, tensor.key
    gradients, slots, sums = model.lane_gradients, model.lane_slot, state.patch_force
    patched, largest, none = own.volume.shape[0] > 0, splat4(0.0), splat4(0.0)
    if patched:
        sums[:] = 0.0
    for four in range(first.shape[0] - 1):
        if first[four] == first[four + 1]:
            continue
        b, half = four // 2, four % 2
        p0 = p1 = p2 = p3 = p4 = p5 = p6 = p7 = p8 = pushed = none
        for k in range(first[four], first[four + 1]):
            force = maximum(-load4(tensor.gap, k, 0) * load4(row, k, STIFFNESS), none)
            s0, s1, s2, s3, s4, s5, s6, s7, s8 = load_group(slopes, k)
            outwards = 2.0 * (keys[k] % 2) - 1.0
            store4(lam, k, 0, force)
            largest = maximum(largest, force * force * load4(row, k, SQUARE))
            pushed = pushed + outwards * force
            p0, p1, p2 = p0 + s0 * force, p1 + s1 * force, p2 + s2 * force
            p3, p4, p5 = p3 + s3 * force, p4 + s4 * force, p5 + s5 * force
            p6, p7, p8 = p6 + s6 * force, p7 + s7 * force, p8 + s8 * force
        stress = _scaled((p0, p1, p2, p3, p4, p5, p6, p7, p8), splat4(h))
        s0 = s1 = s2 = none
        for n in range(3):
            x, y, z = at_node(stress, gradient_of(gradients, b, n, half))
            add3x4(r, slots, b, 2 * n + half, x, y, z)
            s0, s1, s2 = s0 - x, s1 - y, s2 - z
        add3x4(r, slots, b, 6 + half, s0, s1, s2)
        if patched:
            pushed = pushed * (1.0 / 3.0)
            for l in range(4):
                sums[own.lane[b, 4 * half + l]] += lane(pushed, l)
    if patched:
        add_patch_forces(model, state, h, r)
    return math.sqrt(max(lane(largest, 0), lane(largest, 1), lane(largest, 2), lane(largest, 3)))


@stage
def copy_groups(tensor: Tensor, out: Floats, forces: Floats) -> None:
    """out = forces, of all groups of this step."""
    for k in range(tensor.first[tensor.first.shape[0] - 1]):
        store4(out, k, 0, load4(forces, k, 0))


@stage
def pack_rows(model: Model, state: State, first: int, held: bool) -> int:
    """Write rows as all other projections have theirs, one after the other from `first` on: their number then.

    held: only those that carry a force now, with their stiffness. -1: too many.
    """
    tensor, lane_J = state.tensor, state.tensor.lane_J
    J, row_slot, row_tet, row_key, row_side = state.J, state.row_slot, state.row_tet, state.row_key, state.row_side
    starts, row, keys, forces, slopes = tensor.first, tensor.row, tensor.key, tensor.lam, tensor.slope
    tet_slot, patched, rows = model.tet_slot, model.patches.volume.shape[0] > 0, first
    for four in range(starts.shape[0] - 1):
        for k in range(starts[four], starts[four + 1]):
            found = bits(load4(forces, k, 0) > 0.0) if held else bits(load4(row, k, STIFFNESS) > 0.0)
            if found == 0:
                continue
            slope = load_group(slopes, k)
            for n in range(4):
                x, y, z = at_node(slope, gradient_of(model.lane_gradients, four // 2, n, four % 2))
                scatter3x4(lane_J, n, x, y, z)
            for l in range(4):
                if not (found >> l) & 1:
                    continue
                if rows >= row_tet.shape[0]:
                    return -1
                t, key, stiffness = 4 * four + l, keys[k], row[k, STIFFNESS, l]
                for n in range(4):
                    store4(J, rows, n, load4(lane_J, l, n))
                    row_slot[rows, n] = tet_slot[t, n]
                row_tet[rows], row_key[rows], row_side[rows] = t, key, 1.0 - 2.0 * (key % 2)
                if patched:
                    state.row_part[rows] = (2.0 * (key % 2) - 1.0) * (1.0 / 3.0)
                state.constant[rows], state.scale[rows] = row[k, CONSTANT, l], math.sqrt(row[k, SQUARE, l])
                state.compliance[rows] = 1.0 / stiffness
                if model.method == PGS:
                    state.lam[rows] = abs(state.warm_limit[t, key])
                else:
                    state.lam[rows], state.newton.stiffness[rows] = forces[k, l], stiffness
                rows += 1
    return rows
