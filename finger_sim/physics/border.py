r"""The Newton system with a bone's velocity V in it: a border of six columns, eliminated last.

With H_ff = L D Lᵀ of the free nodes as ever and B = H_fb between them and V (bone.py),

    S = H_bb − Bᵀ H_ff⁻¹ B,    S δ_b = r_b − Bᵀ H_ff⁻¹ r_f,    δ_f = H_ff⁻¹ (r_f − B δ_b).
"""

from __future__ import annotations

import math

from ..arrays import Floats
from .compile import stage
from .lanes import Lanes, lane, load4, load8, splat4, splat8, store8
from .linear_solver import solve, solve8
from .model import Model, State
from .vectors import cross


@stage
def factor_bone(model: Model, state: State, h: float, contacts: int, rows: int) -> bool:
    """B, H_ff⁻¹ B and the Cholesky factor of S, for rows and stop as they are. False: S is not positive definite."""
    nf, bone, A = model.free.shape[0], state.yielding, state.A
    arms, S, B, Y, scratch = bone.arms, bone.S, bone.border, bone.border_solved, bone.scratch
    J, stiffness, row_slot = state.J, state.newton.stiffness, state.row_slot
    block_row, block_column = model.block_row, model.block_column
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
    own, G = model.patches, state.G
    patched = own.volume.shape[0] > 0
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
        part, first, last = 0.0, 0, 0
        if patched:
            t = state.row_tet[row]
            patch, part = own.lane[t // 8, t % 8], state.row_part[row]
            first, last = own.start[patch], own.start[patch + 1]
        for k in range(first, last):
            slot = own.slot[k]
            if slot > nf:
                touches = True
                j4 = load4(G, k, 0) * part
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
            for k in range(first, last):
                slot = own.slot[k]
                if slot < nf:
                    for j in range(3):
                        store8(B, slot, j, load8(B, slot, j) + load8(scratch, 0, 0) * (weight * part * G[k, j]))
    spring, pulls, stop = model.spring, bone.pulls, bone.stop
    for part in range(2):
        gives = h * (h * spring[part, 0] + spring[part, 1]) * pulls[part, 3]
        for i in range(3):
            for j in range(3):
                S[3 * part + i, 3 * part + j] += gives * ((1.0 if i == j else 0.0) - pulls[part, i] * pulls[part, j])
    if stop[8] > 0.0:
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
    """Replace y, in slot order, by H⁻¹ y, nearly; the driven nodes' slots get what the bone's velocity is to them."""
    if not model.has_bone:
        solve_free(model, state, y)
        return
    nf, S, Y, scratch = model.free.shape[0], state.yielding.S, state.yielding.border_solved, state.yielding.scratch
    b = scratch[0]
    total = splat8(0.0)
    for k in range(nf):
        total = total + load8(Y, k, 0) * y[k, 0] + load8(Y, k, 1) * y[k, 1] + load8(Y, k, 2) * y[k, 2]
    store8(scratch, 0, 0, total)
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
    solve_free(model, state, y)
    moves = load8(scratch, 0, 0)
    for k in range(nf):
        for j in range(3):
            store8(scratch, 1, 0, load8(Y, k, j) * moves)
            part = scratch[1]
            y[k, j] -= part[0] + part[1] + part[2] + part[3] + part[4] + part[5]
    for i in range(3):
        y[nf + 1, i], y[nf + 2, i] = b[i], b[3 + i]
    spread(model, state, y)


@stage
def solve_free(model: Model, state: State, y: Floats) -> None:
    """Replace y by H_ff⁻¹ y; to single precision in a large body."""
    if state.L_single.shape[0] > 0:
        solve(model.pattern, state.L_single, state.L_inverse, y)
    else:
        solve(model.pattern, state.L_lower, state.L_inverse, y)


@stage
def spread(model: Model, state: State, y: Floats) -> None:
    """Slots of the driven nodes: G_d V of the V in slots nf + 1 and nf + 2."""
    nf, arms = model.free.shape[0], state.yielding.arms
    w, turn = load4(y, nf + 1, 0), load4(y, nf + 2, 0)
    for d in range(arms.shape[0]):
        a, b, c = cross(turn, load4(arms, d, 0))
        y[nf + 3 + d, 0], y[nf + 3 + d, 1], y[nf + 3 + d, 2] = lane(w, 0) + a, lane(w, 1) + b, lane(w, 2) + c
