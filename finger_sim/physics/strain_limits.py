r"""Strain limits: the rows C ≥ 0 of one tetrahedron and their gradients.

With F = U diag(s) Vᵀ in material axes, stretch room a⁺_j = s_max,j − 1 and compression room a⁻_j = 1 − s_min,j:

* `hyperbolic` (Eq. 7-8, 11-12): C_ij = a_j − |V_ji| |s_i − 1|, up to nine rows; the sign of s_i − 1 picks a⁺ or a⁻,
  a free axis j (a_j = ∞) has none.
* `isotropic` (Eq. 9-10): C_i = a − |s_i − 1|, up to three rows.
* `orthogonal` (Eq. 19-20): C_ij = |V_ji| a_j − |s_i − 1|, up to nine rows: the paper's example of too stiff a rule.
  A principal axis across e_j has no room at all.
* `linear` (Eq. 21-22): C_i = ± (b_i − s_i), b_i = |diag(s_max) V e_i| (s_min: compression), up to three rows: the
  paper's example of too soft a rule. A free axis counts as s_max = ∞ or s_min = 0.
* `tensor`: see tensor_limit.py.

Gradients have the full derivative of V (Eq. 13-18), ∂s_i/∂F = u_i v_iᵀ and
∂V_ji/∂F = Σ_{k≠i} V_jk (s_k u_k v_iᵀ + s_i u_i v_kᵀ) / (s_i² − s_k²).
The denominator vanishes where singular values cross (and at s_i = −s_k, inverted): its magnitude is kept at
`gap` or more. A row of a tetrahedron becomes a row of the step by ∂C/∂x_n = (∂C/∂F) r_n.

With patches (dilatation.py) limits bound F̄, whose strain has the patch's volume strain: the same U and V, and
s̄_i = s_i + (θ_p − tr E)/3. It is s̄ that is measured, so that a row has w = ∂C/∂s̄_i as much less for its own volume as
its part α = w/3 for that of the patch: w (u_i v_iᵀ − R/3), beside what V turns, which turns with s as ever.
"""

from __future__ import annotations

import math
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import Floats, Ints
from .compile import kernel, stage
from .dilatation import mean_strains, patch_rates
from .methods import HYPERBOLIC, ISOTROPIC, LINEAR, ORTHOGONAL, PROJECTIONS, TENSOR
from .model import Model, State
from .rows import finish_rows
from .svd import signed_svd
from .tensor_limit import evaluate_tensor, find_near, limit_factors
from .work import LIMITS_SEEN

SOLVER_GAP = 0.03  # |s_i² − s_k²| in a step's rows: what keeps a force near crossing singular values from exploding
EXACT_GAP = 1e-12  # in `evaluate`: the plain derivative
# Rows closer to their limit than this part of its room, now or after the unconstrained step, are formed. A rigid limit
# that its neighbours push past it in between has no way back but the next step; a stiff one gives by less.
_MARGIN, _RIGID_MARGIN = 0.05, 0.15
_NO_GRADIENT = 1e-20  # |J|² at free nodes, in units of the tetrahedra's size, of a row that nothing can move
_LEAST_REACH = 1e-9  # of |diag(s_min) V e_i| in a gradient
_RATIO_ROOM = 1e-3  # strain/limit is counted in units of the room, but of no less than this


Svd = tuple[Floats, Floats, Floats]
"""U, s, V of one tetrahedron."""
Row = tuple[int, int, float]
"""Principal axis i, material axis j, side: +1 stretch, −1 compression."""


class Limits(Protocol):
    """What `evaluate` asks of a scene's limits."""

    @property
    def projection(self) -> str:
        """One of methods.PROJECTIONS."""

    @property
    def stretch_room(self) -> Floats:
        """(3,) a⁺ along e1, e2, e3; ∞: free."""

    @property
    def compress_room(self) -> Floats:
        """(3,) a⁻ along e1, e2, e3; ∞: free."""


def evaluate(F: ArrayLike, limits: Limits, gap: float = EXACT_GAP) -> tuple[Floats, Floats]:
    """All limit rows of one tetrahedron with deformation gradient F, whether near their limit or not.

    F (3, 3) with columns in the material axes e1, e2, e3. Returns C (m,), dC_dF (m, 3, 3); C ≥ 0 is inside. Rows are
    in the order of falling |s_i|, for each by material axis. `tensor`: C = 1 − λ, λ the eigenvalues of A⁺EA⁺ and of
    −A⁻EA⁻, the least C first (three a side that has a limited axis): λ = strain/limit.
    `gap` bounds |s_i² − s_k²| from below in the gradient; a step uses SOLVER_GAP.
    Raises ValueError when F is not a finite 3 × 3 matrix.
    """
    F = np.array(F, dtype=np.float64)
    if F.shape != (3, 3) or not np.isfinite(F).all():
        raise ValueError(f"F: got {F!r}, allowed: a finite 3 x 3 matrix")
    projection = PROJECTIONS[limits.projection]
    stretch, compress = limits.stretch_room, limits.compress_room
    if projection == TENSOR:
        return _evaluate_tensor(F, np.array([stretch, compress]))
    U, s, V = signed_svd(F)
    C: list[float] = []
    gradients: list[Any] = []
    for i in np.argsort(-np.abs(s), kind="stable"):
        side, rooms = (1.0, stretch) if s[i] >= 1.0 else (-1.0, compress)
        for j in range(rows_of(projection)):
            room = room_of(projection, V, i, j, side, rooms)
            if np.isfinite(room):
                p, q = np.empty(3), np.empty(3)
                gradient(projection, (U, s, V), s[i] - 1.0, (int(i), j, side), rooms, gap, p, q)
                C.append(float(room - used(projection, s, V, i, j, side)))
                gradients.append(np.outer(U[:, i], p) + np.outer(q, V[:, i]))
    return np.array(C), np.array(gradients).reshape(-1, 3, 3)


def _evaluate_tensor(F: Floats, rooms: Floats) -> tuple[Floats, Floats]:
    factors, C, dC_dF = np.empty((2, 9)), np.empty((2, 3)), np.empty((2, 3, 3, 3))
    limit_factors(rooms, factors)
    evaluate_tensor(np.repeat(F.reshape(9, 1), 8, axis=1), factors, C, dC_dF)
    limited = np.repeat(np.isfinite(rooms).any(axis=1), 3)
    values = C.ravel()[limited]
    order = np.argsort(values, kind="stable")
    return values[order], dC_dF.reshape(6, 3, 3)[limited][order]


@kernel
def rows_of(projection: int) -> int:
    """Rows of a principal axis on one side: one per material axis, or one."""
    return 3 if projection in (HYPERBOLIC, ORTHOGONAL) else 1


@kernel
def room_of(projection: int, V: Floats, i: int, j: int, side: float, rooms: Floats) -> float:
    """Room of row (i, j) on the stretch side (+1) or the compression side (−1); ∞: there is no such row.

    rooms (3,): that side's, along e1, e2, e3.
    """
    if projection == LINEAR:
        if side > 0.0:
            for k in range(3):
                if V[k, i] != 0.0 and not rooms[k] < math.inf:
                    return math.inf
        elif not min(rooms[0], rooms[1], rooms[2]) < math.inf:
            return math.inf
        return side * (_reach(V, i, side, rooms) - 1.0)
    if projection == ORTHOGONAL:
        return rooms[j] * abs(V[j, i]) if rooms[j] < math.inf else math.inf
    room: float = rooms[j]
    return room


@kernel
def used(projection: int, s: Floats, V: Floats, i: int, j: int, side: float) -> float:
    """How much of its room row (i, j) has used up: C = room − used. s (3,): what limits bound, so s̄ on patches."""
    weight: float = abs(V[j, i]) if projection == HYPERBOLIC else 1.0
    return weight * side * (float(s[i]) - 1.0)


@kernel
def _reach(V: Floats, i: int, side: float, rooms: Floats) -> float:
    """|diag(s) V e_i| of the limits s along the axes (Eq. 21, 22)."""
    total = 0.0
    for k in range(3):
        along = _bound(side, rooms[k]) * V[k, i]
        total += along * along
    return math.sqrt(total)


@kernel
def _bound(side: float, room: float) -> float:
    """s_max or s_min of an axis for `linear`; 0: a free one, which in a stretch row has no part."""
    return 1.0 + side * room if room < math.inf else 0.0


@kernel
def gradient(
    projection: int, svd: Svd, strain: float, row: Row, rooms: Floats, gap: float, p: Floats, q: Floats
) -> float:
    """∂C/∂F of a row as u_i pᵀ + q v_iᵀ; p, q (3,) out. By Eq. 13 through s_i, by Eq. 17-18 through V.

    strain: s_i − 1, or s̄_i − 1. Returns w = ∂C/∂s_i, which is in p as w v_i.
    """
    U, s, V = svd
    i, j, side = row
    along: float = -side
    if projection == HYPERBOLIC:
        along = -side * abs(V[j, i])
    for k in range(3):
        p[k] = along * V[k, i]
        q[k] = 0.0
    if projection == ISOTROPIC:
        return along
    sign = 1.0 if V[j, i] >= 0.0 else -1.0
    reach = max(_reach(V, i, side, rooms), _LEAST_REACH) if projection == LINEAR else 1.0
    for m in range(3):
        if m == i:
            continue
        if projection == HYPERBOLIC:
            turn = -side * strain * sign * V[j, m]
        elif projection == ORTHOGONAL:
            turn = rooms[j] * sign * V[j, m]
        else:
            turn = 0.0
            for k in range(3):
                bound = _bound(side, rooms[k])
                turn += side * bound * bound * V[k, i] * V[k, m] / reach
        difference = s[i] * s[i] - s[m] * s[m]
        if abs(difference) < gap:
            difference = gap if difference >= 0.0 else -gap
        w = turn / difference
        for k in range(3):
            p[k] += w * s[i] * V[k, m]
            q[k] += w * s[m] * U[k, m]
    return along


@kernel
def find_bounded(model: Model, state: State) -> None:
    """`bounded_at`, exactly."""
    bounded_at(model, state, True)


@stage
def bounded_at(model: Model, state: State, exact: bool) -> None:
    """What limits bound at the state's kinematics, where that is more than these: for `tensor` what may be at a limit,
    with patches their volume strain in Ē and s̄. exact: to round-off."""
    if model.projection == TENSOR:
        find_near(model, state, exact)
    elif state.principal.s.shape[0] > 0 and model.patches.volume.shape[0] > 0:
        mean_strains(model, state)
        bounded, s, own, mean = state.principal.bounded, state.principal.s, state.E, state.limit_strain
        for t in range(s.shape[0]):
            change = mean[t // 8, 0, t % 8] - own[t // 8, 0, t % 8]
            for i in range(3):
                bounded[t, i] = s[t, i] + change


@kernel
def strain_ratio(model: Model, state: State) -> None:
    """strain/limit of every tetrahedron into state.strain_ratio (T,): 1 is exactly at its nearest limit."""
    stretches, axes_of = state.principal.bounded, state.principal.V
    ratio, projection = state.strain_ratio, model.projection
    stretch_room, compress_room = model.stretch_room, model.compress_room
    for t in range(ratio.shape[0]):
        s, V = stretches[t], axes_of[t]
        worst = 0.0
        for i in range(3):
            side = 1.0 if s[i] >= 1.0 else -1.0
            rooms = stretch_room if s[i] >= 1.0 else compress_room
            for j in range(rows_of(projection)):
                room = room_of(projection, V, i, j, side, rooms)
                if room < math.inf:
                    excess = used(projection, s, V, i, j, side) - room
                    worst = max(worst, 1.0 + excess / max(room, _RATIO_ROOM))
        ratio[t] = worst


@kernel
def limit_rows(model: Model, state: State, h: float, contacts: int) -> int:
    """Append the rows that are near their limit, now or at the end of the step; return the number of rows.

    -1 when the arrays hold no more rows.
    """
    rows = near_rows(model, state, h, contacts)
    finish_rows(model, state, h, contacts, rows if rows >= 0 else state.lam.shape[0])
    return rows


@stage
def near_rows(model: Model, state: State, h: float, rows: int) -> int:
    """What `limit_rows` returns; of the rows state.J (rows, 4, 4) [1/m], row_slot, row_part, constant C + h J v at
    state.v, and the row's key: tetrahedron, i, j and side. The rest is for `finish_rows`.
    """
    p, q = state.principal.P[0], state.principal.P[1]
    margin = _MARGIN if model.limit_compliance > 0.0 else _RIGID_MARGIN
    least = _NO_GRADIENT / model.length**2
    nf = model.free.shape[0]
    tets, order, moves, gradients, tet_slot = (
        model.tets, model.tet_order, model.tet_moves, model.gradients, model.tet_slot
    )  # fmt: skip
    own, velocities = state.principal, state.moving
    left, stretches, bounded, right, scratch = own.U, own.s, own.bounded, own.V, own.D
    patched, patches, rates, g, parts = (
        model.patches.volume.shape[0] > 0, model.patches.lane, state.patch_rate, state.g, state.row_part
    )  # fmt: skip
    if patched:
        patch_rates(model, state, model.patches.node, velocities)
    all_J, row_slot, row_tet, row_key = state.J, state.row_slot, state.row_tet, state.row_key
    row_side, constant, projection = state.row_side, state.constant, model.projection
    shares = state.compliance
    stretch_room, compress_room = model.stretch_room, model.compress_room
    turning = projection in (ORTHOGONAL, LINEAR)  # the room itself changes, and may vanish: both sides
    axes = rows_of(projection)
    state.work[LIMITS_SEEN] += order.shape[0]
    for o in range(order.shape[0]):
        t = order[o]
        if not moves[t]:
            continue
        U, s, s_bar, V, r = left[t], stretches[t], bounded[t], right[t], gradients[t]
        swelling = rates[patches[t // 8, t % 8]] if patched else 0.0
        reach = -1.0
        for number in range(3 * axes * (2 if turning else 1)):
            i, j = number // axes % 3, number % axes
            stretched = (s_bar[i] >= 1.0) == (number < 3 * axes)
            side = 1.0 if stretched else -1.0
            rooms = stretch_room if stretched else compress_room
            room = room_of(projection, V, i, j, side, rooms)
            if not room < math.inf:
                continue
            C = room - used(projection, s_bar, V, i, j, side)
            near = margin * room
            if near < C and not turning:
                if reach < 0.0:
                    reach = h * _strain_rate(tets[t], velocities, r, U, V, scratch)
                    if patched:
                        reach += h * abs(swelling - scratch[0, 0] - scratch[1, 1] - scratch[2, 2]) / 3.0
                if C - reach > near:
                    continue
            part = gradient(projection, (U, s, V), s_bar[i] - 1.0, (i, j, side), rooms, SOLVER_GAP, p, q) / 3.0
            change = force = 0.0
            if rows >= row_tet.shape[0]:
                return -1
            J = all_J[rows]
            for n in range(4):
                v, slot = velocities[tets[t, n]], tet_slot[t, n]
                a = p[0] * r[n, 0] + p[1] * r[n, 1] + p[2] * r[n, 2]
                b = V[0, i] * r[n, 0] + V[1, i] * r[n, 1] + V[2, i] * r[n, 2]
                for k in range(3):
                    value = U[k, i] * a + q[k] * b
                    if patched:
                        value -= part * g[t, n, k]
                    J[n, k] = value
                    change += value * v[k]
                    force += value * value if slot < nf else 0.0
                row_slot[rows, n] = slot
            if patched:
                parts[rows] = part
                change += part * swelling
            if (near < C and C + h * change > near) or force <= least:
                continue
            row_tet[rows], row_key[rows] = t, 3 * i + j
            row_side[rows], constant[rows], shares[rows] = side, C + h * change, 1.0
            rows += 1
    return rows


@kernel
def _strain_rate(nodes: Ints, v: Floats, r: Floats, U: Floats, V: Floats, D: Floats) -> float:
    """|sym(RᵀḞ)| at the nodes' velocities [1/s]: no singular value changes faster. D (3, 3) out: UᵀḞV."""
    D[:] = 0.0
    for n in range(4):
        w = v[nodes[n]]
        a0 = w[0] * U[0, 0] + w[1] * U[1, 0] + w[2] * U[2, 0]
        a1 = w[0] * U[0, 1] + w[1] * U[1, 1] + w[2] * U[2, 1]
        a2 = w[0] * U[0, 2] + w[1] * U[1, 2] + w[2] * U[2, 2]
        for j in range(3):
            b = r[n, 0] * V[0, j] + r[n, 1] * V[1, j] + r[n, 2] * V[2, j]
            D[0, j] += a0 * b
            D[1, j] += a1 * b
            D[2, j] += a2 * b
    total = 0.0
    for i in range(3):
        total += D[i, i] * D[i, i]
        for j in range(i):
            shear = 0.5 * (D[i, j] + D[j, i])
            total += 2.0 * shear * shear
    return math.sqrt(total)
