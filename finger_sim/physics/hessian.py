"""What is factored: A alone, or the Hessian H = A + h² Σ J_iᵀ J_i / ε_i + contacts of Newton's method (newton.py)."""

from __future__ import annotations

from ..arrays import Floats, Singles
from .blocks import PAIR_COLUMN, PAIR_ROW
from .border import factor_bone
from .compile import formula, kernel, stage
from .dilatation import add_patch_rows
from .lanes import Lanes, add3x4, bits, lane, load4, scatter3x4, splat4, sqrt, store4, where
from .linear_solver import factor
from .methods import TENSOR
from .model import Model, State
from .squares import add_squares
from .tensor_limit import at_node
from .tensor_rows import STIFFNESS, gradient_of, load_group, pack_rows
from .vectors import clear
from .work import FACTORISATIONS

NONE, OF_A, OF_ANOTHER = range(3)  # factors at hand: none; of A as it is and no row; of another A, or with rows


@stage
def factor_elastic(model: Model, state: State) -> bool:
    """Factors of A alone. False if A is not positive definite."""
    load_elastic(model, state)
    definite = factor(model.pattern, state.L_blocks, state.L_inverse)
    keep_single(state.L_lower, state.L_single)
    state.newton.factors[0] = OF_A if definite else NONE
    state.secants.ring[0] = 0
    return definite


@kernel
def keep_single(lower: Floats, single: Singles) -> None:
    """L in single precision, of a body that has room for it: what is read from far caches is half as much.

    Directions from it are as good: residuals are exact.
    """
    for p in range(single.shape[0]):
        for j in range(3):
            for i in range(4):
                single[p, j, i] = lower[p, j, i]


@stage
def load_elastic(model: Model, state: State) -> None:
    """A to where it is factored."""
    nf, A, blocks, block_place = model.free.shape[0], state.A, state.L_blocks, model.block_place
    for k in range(nf):
        for j in range(3):
            store4(blocks, k, j, load4(A, k, j))
    empty = nf
    for p in range(block_place.shape[0]):
        for k in range(empty, block_place[p]):
            for j in range(3):
                store4(blocks, k, j, splat4(0.0))
        for j in range(3):
            store4(blocks, block_place[p], j, load4(A, nf + p, j))
        empty = block_place[p] + 1
    for k in range(empty, blocks.shape[0]):
        for j in range(3):
            store4(blocks, k, j, splat4(0.0))
    state.work[FACTORISATIONS] += 1


@stage
def refactor(model: Model, state: State, h: float, contacts: int, rows: int) -> bool:
    """Factors of H at the rows that hold now (`stiffness`). False if H is not positive definite."""
    own, J, blocks, row_slot = state.newton, state.J, state.L_blocks, state.row_slot
    stiffness, slip = own.stiffness, own.slip
    load_elastic(model, state)
    for c in range(contacts // 3):
        row = 3 * c
        if stiffness[row] > 0.0 or stiffness[row + 1] > 0.0:
            normal, tangent = h * h * stiffness[row], h * h * stiffness[row + 1]
            add_contact(blocks, row_slot[row, 0], J, row, load4(slip, c, 0), normal, tangent)
    patched = model.patches.volume.shape[0] > 0
    if patched:
        clear(state.patch_cross)
        state.patch_force[:] = 0.0
    if model.projection == TENSOR:
        add_tensor_rows(model, state, h)
    else:
        add_limit_rows(model, state, h, contacts, rows)
    if patched:
        add_patch_rows(model, state, blocks)
    definite = factor(model.pattern, blocks, state.L_inverse)
    keep_single(state.L_lower, state.L_single)
    if definite and model.has_bone:
        if model.projection == TENSOR:
            rows = pack_rows(model, state, contacts, True)
        definite = factor_bone(model, state, h, contacts, rows)
    own.factors[0] = OF_ANOTHER if definite else NONE
    state.secants.ring[0] = 0
    return definite


@stage
def add_limit_rows(model: Model, state: State, h: float, contacts: int, rows: int) -> None:
    """h² Jᵀ J / ε of limits on principal stretches that hold to the Hessian; for patches, see `add_patch_rows`."""
    J, row_tet, stiffness, blocks = state.J, state.row_tet, state.newton.stiffness, state.L_blocks
    tet_place = model.tet_place
    patched, patches, entries = model.patches.volume.shape[0] > 0, model.patches.lane, model.patches.tet_place
    cross, square, row_part = state.patch_cross, state.patch_force, state.row_part
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
                if place >= 0:
                    add_outer(blocks, place, load4(J, row, PAIR_ROW[e]) * weight, J, row, PAIR_COLUMN[e])


@stage
def add_tensor_rows(model: Model, state: State, h: float) -> None:
    """The same of the `tensor` limit: all rows of a tetrahedron at once, four tetrahedra side by side."""
    tensor, g, own, gradients = state.tensor, state.tensor.lane_J, model.patches, model.lane_gradients
    first, row, forces, keys, none = tensor.first, tensor.row, tensor.lam, tensor.key, splat4(0.0)
    patched, cross, square = own.volume.shape[0] > 0, state.patch_cross, state.patch_force
    for four in range(first.shape[0] - 1):
        held = count = 0
        b, half, squares = four // 2, four % 2, none
        m0 = m1 = m2 = m3 = m4 = m5 = m6 = m7 = m8 = none
        for k in range(first[four], first[four + 1]):
            holds = load4(forces, k, 0) > 0.0
            if bits(holds) == 0:
                continue
            held |= bits(holds)
            weight = where(holds, h * sqrt(load4(row, k, STIFFNESS)), none)
            slope = load_group(tensor.slope, k)
            for n in range(4):
                x, y, z = at_node(slope, gradient_of(gradients, b, n, half))
                scatter3x4(g, 4 * count + n, x * weight, y * weight, z * weight)
            count += 1
            if patched:
                part = weight * ((2.0 * (keys[k] % 2) - 1.0) * (1.0 / 3.0))
                squares, mixed = squares + part * part, part * weight
                s0, s1, s2, s3, s4, s5, s6, s7, s8 = slope
                m0, m1, m2 = m0 + s0 * mixed, m1 + s1 * mixed, m2 + s2 * mixed
                m3, m4, m5 = m3 + s3 * mixed, m4 + s4 * mixed, m5 + s5 * mixed
                m6, m7, m8 = m6 + s6 * mixed, m7 + s7 * mixed, m8 + s8 * mixed
        for l in range(4):
            if (held >> l) & 1:
                t = 4 * four + l
                add_squares(state.L_blocks, model.tet_place, t, g, l, count)
        if patched and held != 0:
            for l in range(4):
                square[own.lane[b, 4 * half + l]] += lane(squares, l)
            for n in range(4):
                x, y, z = at_node((m0, m1, m2, m3, m4, m5, m6, m7, m8), gradient_of(gradients, b, n, half))
                add3x4(cross, own.lane_entry, b, 2 * n + half, x, y, z)


@formula
def add_contact(blocks: Floats, slot: int, frame: Floats, row: int, s: Lanes, normal: float, tangent: float) -> None:
    """normal · n nᵀ + tangent · (I − n nᵀ − s sᵀ) onto a node's block; n t₁ t₂: frame[row …], s: slip direction."""
    n, t1, t2 = load4(frame, row, 0), load4(frame, row + 1, 0), load4(frame, row + 2, 0)
    for j in range(3):
        column = n * (normal * lane(n, j)) + (t1 * lane(t1, j) + t2 * lane(t2, j) - s * lane(s, j)) * tangent
        store4(blocks, slot, j, load4(blocks, slot, j) + column)


@formula
def add_outer(B: Floats, p: int, a: Lanes, J: Floats, row: int, n: int) -> None:
    """a J[row, n]ᵀ onto block p of B."""
    for j in range(3):
        store4(B, p, j, load4(B, p, j) + a * J[row, n, j])
