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

from ..arrays import Floats
from .compile import formula, kernel, stage
from .dilatation import mean_strains
from .jacobi import Symmetric, Vector, eigen, eigen_from, load_symmetric
from .lanes import Lanes, absolute, bits, lane, load8, maximum, splat8, sqrt, store8, where
from .model import Model, State
from .polar import Matrix, load_matrix, polar
from .work import LIMITS_SEEN

NEAR = 0.85  # strain/limit from which on a row is formed, now or after a step at the velocities of now
_LEAST_DET = 1e-2  # of tr(U) I − U, 8 at rest: it vanishes where s_a = −s_b
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
def spin_of(E: Symmetric) -> Symmetric:
    """(tr(U) I − U)⁻¹ of U = I + E."""
    e0, e1, e2, e3, e4, e5 = E
    u0, u1, u2 = e0 + 1.0, e1 + 1.0, e2 + 1.0
    t0, t1, t2 = u1 + u2, u0 + u2, u0 + u1
    c00, c01, c02 = t1 * t2 - e3 * e3, e4 * e3 + e5 * t2, e5 * e3 + e4 * t1
    c11, c12, c22 = t0 * t2 - e4 * e4, e5 * e4 + t0 * e3, t0 * t1 - e5 * e5
    over = 1.0 / maximum(t0 * c00 - e5 * c01 - e4 * c02, _LEAST_DET)
    return over * c00, over * c11, over * c22, over * c12, over * c02, over * c01


@formula
def times(S: Symmetric, z: Vector) -> Vector:
    """S z."""
    s0, s1, s2, s3, s4, s5 = S
    z0, z1, z2 = z
    return s0 * z0 + s5 * z1 + s4 * z2, s5 * z0 + s1 * z1 + s3 * z2, s4 * z0 + s3 * z1 + s2 * z2


@formula
def leaning(E: Symmetric, y: Vector) -> Vector:
    """U y × y."""
    y0, y1, y2 = y
    p0, p1, p2 = times(E, y)
    return (p1 * y2 - p2 * y1), (p2 * y0 - p0 * y2), (p0 * y1 - p1 * y0)


@formula
def square(y: Vector) -> Symmetric:
    """y yᵀ."""
    y0, y1, y2 = y
    return y0 * y0, y1 * y1, y2 * y2, y1 * y2, y0 * y2, y0 * y1


@formula
def turned(R: Matrix, S: Symmetric, h: Vector) -> Matrix:
    """R (S − [h]×) by rows."""
    s0, s1, s2, s3, s4, s5 = S
    h0, h1, h2 = h
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
def at_node(slope: Matrix, r: Vector) -> Vector:
    """The gradient at a node, of that with respect to F: slope · r_n."""
    g0, g1, g2, g3, g4, g5, g6, g7, g8 = slope
    a0, a1, a2 = r
    return g0 * a0 + g1 * a1 + g2 * a2, g3 * a0 + g4 * a1 + g5 * a2, g6 * a0 + g7 * a1 + g8 * a2


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
    R, U = polar(load_matrix(F.reshape((1, 9, 8)), 0), quaternion, 0, np.zeros((2, 4, 4)), True)
    u0, u1, u2, u3, u4, u5, u6, u7, u8 = U
    E = (u0 - 1.0, u4 - 1.0, u8 - 1.0, 0.5 * (u5 + u7), 0.5 * (u2 + u6), 0.5 * (u1 + u3))
    spin = spin_of(E)
    for side in range(2):
        f = factors[side]
        sign = -1.0 if side == 0 else 1.0
        values, u, v, w = eigen(scaled(E, factors, side))
        for a, (q0, q1, q2) in enumerate((u, v, w)):
            C[side, a] = 1.0 - lane(values[a], 0)
            y = (f[6] * q0, f[7] * q1, f[8] * q2)
            for e, entry in enumerate(turned(R, square(y), times(spin, leaning(E, y)))):
                dC_dF[side, a, e // 3, e % 3] = sign * lane(entry, 0)


@formula
def limited(factors: Floats, side: int) -> bool:
    """Whether an axis is limited on this side."""
    any_axis: bool = factors[side, 6] + factors[side, 7] + factors[side, 8] > 0.0
    return any_axis


@formula
def pairs_of(model: Model, b: int, side: int) -> tuple[int, float]:
    """Entry of `frames` that batch b has for a side, and the sign of its eigenvalues there.

    Where both sides have the same room, −A E A has the eigenvectors of A E A.
    """
    return (2 * b, 1.0 - 2.0 * side) if model.mirrored else (2 * b + side, 1.0)


@stage
def find_near(model: Model, state: State, exact: bool) -> None:
    """What may be at a limit at the state's positions or a step later, into `near`; its eigenpairs into `frames`.

    Eight tetrahedra are decomposed where one of them is near. exact: see jacobi.eigen_from.
    """
    if model.patches.volume.shape[0] > 0:
        mean_strains(model, state)
    tensor, strains, factors, volumes = state.tensor, state.limit_strain, model.limit_factors, model.lane_volume
    bounds, near, frames = tensor.bound, tensor.near, tensor.frames
    zero, one, top = splat8(0.0), splat8(1.0), splat8(0.0)
    for b in range(strains.shape[0]):
        E, real, decomposed = load_symmetric(strains, b), load8(volumes, b, 0) > 0.0, False
        for side in range(2):
            if not limited(factors, side):
                store8(bounds, b, side, zero)
                continue
            bound, before = upper_bound(scaled(E, factors, side)), load8(bounds, b, side)
            store8(bounds, b, side, bound)
            found = real & (bound + maximum(bound - before, zero) > NEAR)
            store8(near, b, side, where(found, one, zero))
            if bits(found) == 0 or (decomposed and model.mirrored):
                continue
            decomposed = True
            entry, _ = pairs_of(model, b, side)
            p, q, r = eigen_from(scaled(E, factors, entry - 2 * b), frames, entry, exact)
            if model.mirrored:
                p, q, r = absolute(p), absolute(q), absolute(r)
            top = maximum(top, where(real, maximum(maximum(p, q), r), zero))
    tensor.top[0] = _largest(top)
    state.work[LIMITS_SEEN] += model.tets.shape[0] * (limited(factors, 0) + limited(factors, 1))


@stage
def greatest_strain(model: Model, state: State) -> float:
    """The largest strain/limit; 1 is exactly at the limit. Exact, also where nothing is near."""
    greatest: float = state.tensor.top[0]
    strains, factors, bounds = state.limit_strain, model.limit_factors, state.tensor.bound
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
