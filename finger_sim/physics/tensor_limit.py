r"""The `tensor` limit: one bound for all directions, beyond the paper.

Rooms a⁺_j, a⁻_j along the material axes (∞: free) bound the Biot strain E = RᵀF − I as a tensor,

    λ_max(A⁺ E A⁺) ≤ 1,    λ_min(A⁻ E A⁻) ≥ −1,    A = diag(1/√a), 0 on a free axis.

Equal rooms give the isotropic limit in every direction (`hyperbolic` allows √3 more along (1, 1, 1)); a single
limited axis bounds that axis's own strain E_jj; shear is bounded too, E_12² ≤ (a_1 − E_11)(a_2 − E_22). There is no
singular value decomposition in it, and no singular gradient but at s_a = −s_b (inverted): with q a unit eigenvector
of A E A, y = A q and U = I + E,

    ∂λ/∂F = R (y yᵀ − [h]×),    h = (tr(U) I − U)⁻¹ (U y × y).

Every eigenvalue near its limit has a row, C = (1 − λ)/|y|²: the room along y less the strain used up, as in the other
projections. Where two of them nearly coincide their eigenvectors are free to turn, and rows for these alone would let
strain through between them: qᵀ A E A q ≤ 1 holds for every unit q, with the same gradient, and the two q halfway
between them get rows too, the stiffer the nearer the two. Tetrahedra far from all limits are passed over by a bound
that cannot miss one, λ_max(B) ≤ tr B/3 + √(2/3) |dev B|.
"""

from __future__ import annotations

import math

import numpy as np

from ..arrays import Floats, Ints
from .compile import formula, kernel, stage
from .dilatation import mean_strains, patch_rates
from .jacobi import Symmetric, Vector, eigen, load_symmetric, store_vector
from .lanes import (
    Lanes,
    absolute,
    bits,
    lane,
    load4,
    load8,
    maximum,
    scatter3,
    splat8,
    sqrt,
    store4,
    store8,
    sum3,
    where,
)  # fmt: skip
from .model import Model, State
from .polar import Matrix, load_matrix, polar
from .work import LIMITS_SEEN

NEAR = 0.85  # strain/limit from which on a row is formed, now or after a step at the velocities of now
_WORTH = 0.5  # eigenvalues below are not looked at any closer
# Strain/limit that two eigenvalues near their limit may differ by to be taken as one. More makes rows that hold
# nothing; less lets strain through where the eigenvectors turn by more in a step.
_COINCIDE = 0.1
# Directions of the rows: the eigenvectors, then those halfway between two of them, on either side.
_FIRST, _SECOND = (0, 1, 2, 0, 0, 0, 0, 1, 1), (0, 1, 2, 1, 1, 2, 2, 2, 2)
_SIGN = (1.0, 1.0, 1.0, 1.0, -1.0, 1.0, -1.0, 1.0, -1.0)
DIRECTIONS = 3  # of them are eigenvectors
_LEAST_DET = 1e-2  # of tr(U) I − U, 8 at rest: it vanishes where s_a = −s_b
_NO_GRADIENT = 1e-20  # |J|² at free nodes, in units of the tetrahedra's size, of a row that nothing can move
LEAST_ROOM = 1e-6  # rooms below count as this


@kernel
def limit_factors(rooms: Floats, factors: Floats) -> None:
    """± 1/√(a_i a_j) in the order 00 11 22 12 02 01, and 1/√a_j: factors (2, 9) out; rooms (2, 3), ∞: free."""
    for side in range(2):
        for j in range(3):
            free = not rooms[side, j] < math.inf
            factors[side, 6 + j] = 0.0 if free else 1.0 / math.sqrt(max(rooms[side, j], LEAST_ROOM))
        w0, w1, w2 = factors[side, 6], factors[side, 7], factors[side, 8]
        sign = 1.0 if side == 0 else -1.0
        factors[side, 0], factors[side, 1], factors[side, 2] = sign * w0 * w0, sign * w1 * w1, sign * w2 * w2
        factors[side, 3], factors[side, 4], factors[side, 5] = sign * w1 * w2, sign * w0 * w2, sign * w0 * w1


@formula
def upper_bound(B: Symmetric) -> Lanes:
    """No eigenvalue of B is larger: tr B/3 + √(2/3) |dev B|."""
    b0, b1, b2, b3, b4, b5 = B
    mean = (b0 + b1 + b2) * (1.0 / 3.0)
    d0, d1, d2 = b0 - mean, b1 - mean, b2 - mean
    return mean + sqrt((d0 * d0 + d1 * d1 + d2 * d2 + 2.0 * (b3 * b3 + b4 * b4 + b5 * b5)) * (2.0 / 3.0))


@formula
def gradient(R: Matrix, E: Symmetric, y: Vector) -> Matrix:
    """∂λ/∂F = R (y yᵀ − [h]×) by rows."""
    e0, e1, e2, e3, e4, e5 = E
    y0, y1, y2 = y
    u0, u1, u2 = e0 + 1.0, e1 + 1.0, e2 + 1.0
    p0, p1, p2 = u0 * y0 + e5 * y1 + e4 * y2, e5 * y0 + u1 * y1 + e3 * y2, e4 * y0 + e3 * y1 + u2 * y2
    z0, z1, z2 = p1 * y2 - p2 * y1, p2 * y0 - p0 * y2, p0 * y1 - p1 * y0
    return turned(R, E, (y0 * y0, y1 * y1, y2 * y2, y1 * y2, y0 * y2, y0 * y1), (z0, z1, z2))


@formula
def turned(R: Matrix, E: Symmetric, S: Symmetric, z: Vector) -> Matrix:
    """R (S − [h]×) by rows, h = (tr(U) I − U)⁻¹ z."""
    e0, e1, e2, e3, e4, e5 = E
    s0, s1, s2, s3, s4, s5 = S
    z0, z1, z2 = z
    u0, u1, u2 = e0 + 1.0, e1 + 1.0, e2 + 1.0
    t0, t1, t2 = u1 + u2, u0 + u2, u0 + u1
    c00, c01, c02 = t1 * t2 - e3 * e3, e4 * e3 + e5 * t2, e5 * e3 + e4 * t1
    c11, c12, c22 = t0 * t2 - e4 * e4, e5 * e4 + t0 * e3, t0 * t1 - e5 * e5
    over = 1.0 / maximum(t0 * c00 - e5 * c01 - e4 * c02, splat8(_LEAST_DET))
    h0, h1, h2 = (
        over * (c00 * z0 + c01 * z1 + c02 * z2),
        over * (c01 * z0 + c11 * z1 + c12 * z2),
        over * (c02 * z0 + c12 * z1 + c22 * z2),
    )
    g00, g01, g02 = s0, s5 + h2, s4 - h1
    g10, g11, g12 = s5 - h2, s1, s3 + h0
    g20, g21, g22 = s4 + h1, s3 - h0, s2
    r0, r1, r2, r3, r4, r5, r6, r7, r8 = R
    return (
        r0 * g00 + r1 * g10 + r2 * g20, r0 * g01 + r1 * g11 + r2 * g21, r0 * g02 + r1 * g12 + r2 * g22,
        r3 * g00 + r4 * g10 + r5 * g20, r3 * g01 + r4 * g11 + r5 * g21, r3 * g02 + r4 * g12 + r5 * g22,
        r6 * g00 + r7 * g10 + r8 * g20, r6 * g01 + r7 * g11 + r8 * g21, r6 * g02 + r7 * g12 + r8 * g22,
    )  # fmt: skip


@formula
def less(M: Matrix, N: Matrix, by: Lanes) -> Matrix:
    """M − N · by."""
    a0, a1, a2, a3, a4, a5, a6, a7, a8 = M
    b0, b1, b2, b3, b4, b5, b6, b7, b8 = N
    return (
        a0 - by * b0, a1 - by * b1, a2 - by * b2, a3 - by * b3, a4 - by * b4, a5 - by * b5, a6 - by * b6, a7 - by * b7,
        a8 - by * b8,
    )  # fmt: skip


@formula
def scaled(E: Symmetric, factors: Floats, side: int) -> Symmetric:
    """± A E A."""
    e0, e1, e2, e3, e4, e5 = E
    f = factors[side]
    return e0 * f[0], e1 * f[1], e2 * f[2], e3 * f[3], e4 * f[4], e5 * f[5]


@kernel
def evaluate_tensor(F: Floats, factors: Floats, C: Floats, dC_dF: Floats) -> None:
    """1 − λ and its gradient, of all three eigenvalues on both sides: C (2, 3), dC_dF (2, 3, 3, 3) out; F (9, 8)."""
    quaternion = np.zeros((1, 4, 8))
    quaternion[0, 3] = 1.0
    R, U = polar(load_matrix(F.reshape((1, 9, 8)), 0), quaternion, 0, np.zeros((2, 4, 4)))
    u0, u1, u2, u3, u4, u5, u6, u7, u8 = U
    E = (u0 - 1.0, u4 - 1.0, u8 - 1.0, 0.5 * (u5 + u7), 0.5 * (u2 + u6), 0.5 * (u1 + u3))
    for side in range(2):
        f = factors[side]
        sign = -1.0 if side == 0 else 1.0
        values, u, v, w = eigen(scaled(E, factors, side))
        for a, (q0, q1, q2) in enumerate((u, v, w)):
            C[side, a] = 1.0 - lane(values[a], 0)
            for e, entry in enumerate(gradient(R, E, (f[6] * q0, f[7] * q1, f[8] * q2))):
                dC_dF[side, a, e // 3, e % 3] = sign * lane(entry, 0)


@kernel
def find_near(model: Model, state: State) -> None:
    """What may be at a limit at the state's positions or a step later, into `near`; its eigenpairs into `eigen`."""
    if model.patches.volume.shape[0] > 0:
        mean_strains(model, state)
    tensor, strains, factors, tets, count = (
        state.tensor,
        state.limit_strain,
        model.limit_factors,
        model.tets.shape[0],
        0,
    )
    bounds, near, pairs, gathered = tensor.bound, tensor.near, tensor.eigen, tensor.gathered
    whole = gathered.reshape((1, -1))
    for side in range(2):
        if factors[side, 6] + factors[side, 7] + factors[side, 8] == 0.0:  # no axis is limited on this side
            for b in range(strains.shape[0]):
                store8(bounds, b, side, splat8(0.0))
            continue
        state.work[LIMITS_SEEN] += tets
        for b in range(strains.shape[0]):
            bound = upper_bound(scaled(load_symmetric(strains, b), factors, side))
            before = load8(bounds, b, side)
            store8(bounds, b, side, bound)
            found = bits(bound + maximum(bound - before, splat8(0.0)) > NEAR)
            while found != 0:
                l = 0
                while not (found >> l) & 1:
                    l += 1
                found &= found - 1
                if 8 * b + l < tets:
                    near[count] = 2 * (8 * b + l) + side
                    count += 1
    tensor.near_count[0] = count
    for group in range((count + 7) // 8):
        _gather(near, 8 * group, count, strains, factors, gathered)
        values, u, v, w = eigen(load_symmetric(whole, 0))
        store_vector(pairs, group, 0, values)
        store_vector(pairs, group, 3, u)
        store_vector(pairs, group, 6, v)
        store_vector(pairs, group, 9, w)


@stage
def greatest_strain(model: Model, state: State) -> float:
    """The largest strain/limit; 1 is exactly at the limit. Exact, also where nothing is near."""
    greatest = 0.0
    pairs, strains, factors, bounds = state.tensor.eigen, state.limit_strain, model.limit_factors, state.tensor.bound
    for group in range((state.tensor.near_count[0] + 7) // 8):
        for a in range(3):
            for l in range(8):
                greatest = max(greatest, pairs[group, a, l])
    if greatest >= NEAR:
        return greatest
    top = 0
    for k in range(2 * strains.shape[0]):
        if _largest(load8(bounds, k // 2, k % 2)) > _largest(load8(bounds, top // 2, top % 2)):
            top = k
    greatest = max(greatest, _largest(batch_strain(strains, factors, top // 2, top % 2)))
    for k in range(2 * strains.shape[0]):
        if bits(load8(bounds, k // 2, k % 2) > greatest) != 0:
            greatest = max(greatest, _largest(batch_strain(strains, factors, k // 2, k % 2)))
    return greatest


@kernel
def all_strains(model: Model, state: State) -> None:
    """strain/limit of every tetrahedron into state.strain_ratio (T,); other projections have it there already."""
    strains, factors, ratios = state.limit_strain, model.limit_factors, state.strain_ratio
    if state.tensor.bound.shape[0] == 0:
        return
    ratios[:] = 0.0
    for side in range(2):
        for b in range(strains.shape[0]):
            ratio = batch_strain(strains, factors, b, side)
            for l in range(min(8, ratios.shape[0] - 8 * b)):
                ratios[8 * b + l] = max(ratios[8 * b + l], lane(ratio, l))


@stage
def batch_strain(E: Floats, factors: Floats, b: int, side: int) -> Lanes:
    """The largest eigenvalue of ± A E A of eight tetrahedra."""
    (p, q, r), _, _, _ = eigen(scaled(load_symmetric(E, b), factors, side))
    return maximum(maximum(p, q), r)


@formula
def _largest(v: Lanes) -> float:
    greatest = lane(v, 0)
    for l in range(1, 8):
        greatest = max(greatest, lane(v, l))
    return greatest


@stage
def _gather(near: Ints, first: int, count: int, E: Floats, factors: Floats, out: Floats) -> None:
    """± A E A of eight entries of `near` from `first` on (the last one again where they end) into out[:6]."""
    for l in range(8):
        entry = near[min(first + l, count - 1)]
        t, f = entry // 2, factors[entry % 2]
        for c in range(6):
            out[c, l] = E[t // 8, c, t % 8] * f[c]


@formula
def _direction(eigen: Floats, group: int, a: int, c: int, sign: float) -> tuple[Lanes, Lanes, Lanes, Lanes]:
    """qᵀ B q and q of eigenvector a, or of the unit vector halfway between a and ± c."""
    value, q0, q1, q2 = (
        load8(eigen, group, a),
        load8(eigen, group, 3 + 3 * a),
        load8(eigen, group, 4 + 3 * a),
        load8(eigen, group, 5 + 3 * a),
    )
    if a != c:
        half, other = math.sqrt(0.5), sign * math.sqrt(0.5)
        value = 0.5 * (value + load8(eigen, group, c))
        q0 = half * q0 + other * load8(eigen, group, 3 + 3 * c)
        q1 = half * q1 + other * load8(eigen, group, 4 + 3 * c)
        q2 = half * q2 + other * load8(eigen, group, 5 + 3 * c)
    return value, q0, q1, q2


@stage
def gather_tets(model: Model, state: State, group: int) -> None:
    """R, E, r_1 … r_3, 1/√a and the sign of the side of eight entries of `near`, side by side, into `gathered`."""
    out, near_list, count = state.tensor.gathered, state.tensor.near, state.tensor.near_count[0]
    rotations, strains, gradients, factors = state.R, state.E, model.lane_gradients, model.limit_factors
    for l in range(8):
        entry = near_list[min(8 * group + l, count - 1)]
        t, side = entry // 2, entry % 2
        b, i = t // 8, t % 8
        for c in range(9):
            out[c, l] = rotations[b, c, i]
            out[15 + c, l] = gradients[b, c, i]
        for c in range(6):
            out[9 + c, l] = strains[b, c, i]
        for c in range(3):
            out[24 + c, l] = factors[side, 6 + c]
        out[27, l] = 1.0 if side == 0 else -1.0


@formula
def node_gradients(slope: Matrix, down: Lanes, whole: Floats, lane_J: Floats) -> None:
    """∂C/∂x at the four nodes into lane_J, of ∂λ/∂F = `slope`; down: −side · room; whole: what was gathered."""
    g0, g1, g2, g3, g4, g5, g6, g7, g8 = slope
    s0, s1, s2 = splat8(0.0), splat8(0.0), splat8(0.0)
    for n in range(3):
        a0, a1, a2 = load8(whole, 0, 15 + 3 * n), load8(whole, 0, 16 + 3 * n), load8(whole, 0, 17 + 3 * n)
        x = down * (g0 * a0 + g1 * a1 + g2 * a2)
        y = down * (g3 * a0 + g4 * a1 + g5 * a2)
        z = down * (g6 * a0 + g7 * a1 + g8 * a2)
        scatter3(lane_J, 0, n, x, y, z)
        s0, s1, s2 = s0 - x, s1 - y, s2 - z
    scatter3(lane_J, 0, 3, s0, s1, s2)


@stage
def tensor_rows(model: Model, state: State, h: float, rows: int) -> int:
    """Append a row for every eigenvalue in `eigen` that is near its limit, now or after h; return their number.

    Two eigenvalues that nearly coincide have two more between them: their eigenvectors may turn within the step.
    Writes what `limit_rows` does; a row's key is 2 · direction + side. -1: too many rows.
    """
    tensor, nf, least = state.tensor, model.free.shape[0], _NO_GRADIENT / model.length**2
    count, lane_J, pairs, near_list = tensor.near_count[0], tensor.lane_J, tensor.eigen, tensor.near
    tets, tet_slot, velocities = model.tets, model.tet_slot, state.moving
    J, row_slot, row_tet, row_key = state.J, state.row_slot, state.row_tet, state.row_key
    row_side, constant, shares = state.row_side, state.constant, state.compliance
    whole = tensor.gathered.reshape((1, -1))
    patched, patches, rates, parts = (
        model.patches.volume.shape[0] > 0,
        model.patches.lane,
        state.patch_rate,
        state.row_part,
    )
    if patched:
        patch_rates(model, state, model.patches.node, velocities)
    for group in range((count + 7) // 8):
        gather_tets(model, state, group)
        R = load_matrix(whole, 0)
        e0, e1, e2 = load8(whole, 0, 9), load8(whole, 0, 10), load8(whole, 0, 11)
        E = (e0, e1, e2, load8(whole, 0, 12), load8(whole, 0, 13), load8(whole, 0, 14))
        for d in range(9):
            a, c = _FIRST[d], _SECOND[d]
            value, q0, q1, q2 = _direction(pairs, group, a, c, _SIGN[d])
            worth, share = bits(value > _WORTH), splat8(1.0)
            if a != c:
                p, q = load8(pairs, group, a), load8(pairs, group, c)
                share = 1.0 - absolute(p - q) * (1.0 / _COINCIDE)
                worth = bits((p > NEAR) & (q > NEAR) & (share > 0.0))
            if worth == 0:
                continue
            y0, y1, y2 = load8(whole, 0, 24) * q0, load8(whole, 0, 25) * q1, load8(whole, 0, 26) * q2
            size = y0 * y0 + y1 * y1 + y2 * y2
            room = 1.0 / where(size > 0.0, size, splat8(1.0))
            slope = gradient(R, E, (y0, y1, y2))
            if patched:
                slope = less(slope, R, size * (1.0 / 3.0))
            node_gradients(slope, -load8(whole, 0, 27) * room, whole, lane_J)
            for l in range(min(8, count - 8 * group)):
                if not (worth >> l) & 1:
                    continue
                entry = near_list[8 * group + l]
                t = entry // 2
                if rows >= row_tet.shape[0]:
                    return -1
                C = lane(room, l) * (1.0 - lane(value, l))
                change = force = 0.0
                for n in range(4):
                    node, slot = tets[t, n], tet_slot[t, n]
                    j, v = load4(lane_J, l, n), load4(velocities, node, 0)
                    change += sum3(j * v)
                    force += sum3(j * j) if slot < nf else 0.0
                    store4(J, rows, n, j)
                    row_slot[rows, n] = slot
                if patched:
                    parts[rows] = (2.0 * (entry % 2) - 1.0) * (1.0 / 3.0)
                    change += parts[rows] * rates[patches[t // 8, t % 8]]
                ahead = C + h * change
                near = (1.0 - NEAR) * lane(room, l)
                if (near < C and ahead > near) or force <= least:
                    continue
                row_tet[rows], row_key[rows] = t, 2 * d + entry % 2
                row_side[rows], constant[rows], shares[rows] = 1.0 - 2.0 * (entry % 2), ahead, lane(share, l)
                rows += 1
    return rows
