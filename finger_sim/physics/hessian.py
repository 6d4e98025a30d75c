"""What is factored: A alone, or the Hessian H = A + h² Σ J_iᵀ J_i / ε_i + contacts of Newton's method (newton.py)."""

from __future__ import annotations

from ..arrays import Floats
from .border import factor_bone
from .compile import formula, stage
from .dilatation import add_patch_rows
from .lanes import Lanes, lane, load4, splat4, store4
from .linear_solver import factor
from .methods import TENSOR
from .model import Model, State
from .tensor_rows import pack_rows
from .vectors import clear
from .work import FACTORISATIONS

NONE, OF_A, OF_ANOTHER = range(3)  # factors at hand: none; of A as it is and no row; of another A, or with rows


@stage
def factor_elastic(model: Model, state: State) -> bool:
    """Factors of A alone. False if A is not positive definite."""
    load_elastic(model, state)
    definite = factor(model.pattern, state.L_blocks, state.L_inverse)
    state.newton.factors[0] = OF_A if definite else NONE
    return definite


@stage
def load_elastic(model: Model, state: State) -> None:
    """A to where it is factored."""
    nf, A, D, L, block_place = model.free.shape[0], state.A, state.L_diagonal, state.L_lower, model.block_place
    for k in range(nf):
        for j in range(3):
            store4(D, k, j, load4(A, k, j))
    for p in range(L.shape[0]):
        for j in range(3):
            store4(L, p, j, splat4(0.0))
    for p in range(block_place.shape[0]):
        for j in range(3):
            store4(L, block_place[p], j, load4(A, nf + p, j))
    state.work[FACTORISATIONS] += 1


@stage
def refactor(model: Model, state: State, h: float, contacts: int, rows: int) -> bool:
    """Factors of H at the rows that hold now (`stiffness`). False if H is not positive definite."""
    own, J, D, L, row_slot, row_tet = (
        state.newton, state.J, state.L_diagonal, state.L_lower, state.row_slot, state.row_tet
    )  # fmt: skip
    tet_place, pair_row, pair_column = model.tet_place, model.pair_row, model.pair_column
    stiffness, slip = own.stiffness, own.slip
    if model.projection == TENSOR:
        rows = pack_rows(model, state, contacts, True)
    load_elastic(model, state)
    for c in range(contacts // 3):
        row = 3 * c
        if stiffness[row] > 0.0 or stiffness[row + 1] > 0.0:
            normal, tangent = h * h * stiffness[row], h * h * stiffness[row + 1]
            add_contact(D, row_slot[row, 0], J, row, load4(slip, c, 0), normal, tangent)
    patched, patches, entries = model.patches.volume.shape[0] > 0, model.patches.lane, model.patches.tet_place
    cross, square, row_part = state.patch_cross, state.patch_force, state.row_part
    if patched:
        clear(cross)
        square[:] = 0.0
    for row in range(contacts, rows):
        if stiffness[row] > 0.0:
            weight, t = h * h * stiffness[row], row_tet[row]
            if patched:
                part = row_part[row]
                square[patches[t // 8, t % 8]] += weight * part * part
                for n in range(4):
                    k = entries[t, n]
                    store4(cross, k, 0, load4(cross, k, 0) + load4(J, row, n) * (weight * part))
            for e in range(10):
                place = tet_place[t, e]
                if place < 0:
                    continue
                i, k = pair_row[t, e], pair_column[t, e]
                if i == k:
                    add_outer(D, place, load4(J, row, i) * weight, J, row, k)
                else:
                    add_outer(L, place, load4(J, row, i) * weight, J, row, k)
    if patched:
        add_patch_rows(model, state, D, L)
    definite = factor(model.pattern, state.L_blocks, state.L_inverse)
    if definite and model.has_bone:
        definite = factor_bone(model, state, h, contacts, rows)
    own.factors[0] = OF_ANOTHER if definite else NONE
    return definite


@formula
def add_contact(D: Floats, slot: int, frame: Floats, row: int, s: Lanes, normal: float, tangent: float) -> None:
    """normal · n nᵀ + tangent · (I − n nᵀ − s sᵀ) onto a node's block; n t₁ t₂: frame[row …], s: slip direction."""
    n, t1, t2 = load4(frame, row, 0), load4(frame, row + 1, 0), load4(frame, row + 2, 0)
    for j in range(3):
        column = n * (normal * lane(n, j)) + (t1 * lane(t1, j) + t2 * lane(t2, j) - s * lane(s, j)) * tangent
        store4(D, slot, j, load4(D, slot, j) + column)


@formula
def add_outer(B: Floats, p: int, a: Lanes, J: Floats, row: int, n: int) -> None:
    """a J[row, n]ᵀ onto block p of B."""
    for j in range(3):
        store4(B, p, j, load4(B, p, j) + a * J[row, n, j])
