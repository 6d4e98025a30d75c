r"""What rows touch, and A⁻¹ between it: the matrix S that `pgs` takes its columns from (pgs.py).

Rows touch nodes, and limit rows their patches (dilatation.py), by h θ̇ = h G v alone: a patch is one row and column of
S, however many nodes it has. S has A⁻¹ between touched nodes, h A⁻¹ Gᵀ between these and patches, and h² G A⁻¹ Gᵀ.
"""

from __future__ import annotations

from ..arrays import Floats
from .compile import stage
from .linear_solver import NODES_AT_ONCE, SIDES_AT_ONCE, solve_many
from .model import Model, State


@stage
def touched_nodes(model: Model, state: State, contacts: int, rows: int) -> tuple[int, int]:
    """Number the slots that the first `rows` rows touch, in slot order: state.pgs.touched and row_local. Their count.

    And the count of patches that limit rows, those from `contacts` on, touch: see touched_patches.

    row_local is where a node's three components are in u; those of driven nodes, or none, are past the others and 0.
    """
    local, touched, row_slot, row_local = state.pgs.local, state.pgs.touched, state.row_slot, state.pgs.row_local
    local[:] = -1
    for row in range(rows):
        for n in range(4):
            k = row_slot[row, n]
            if k < local.shape[0]:
                local[k] = 0
    count = 0
    for k in range(local.shape[0]):
        if local[k] == 0:
            local[k] = count
            touched[count] = k
            count += 1
    patches = touched_patches(model, state, contacts, rows, 3 * count)
    for row in range(rows):
        for n in range(4):
            k = row_slot[row, n]
            row_local[row, n] = 3 * local[k] if k < local.shape[0] else 3 * count + patches
    return count, patches


@stage
def touched_patches(model: Model, state: State, contacts: int, rows: int, first: int) -> int:
    """Number the patches of limit rows: state.pgs.touched_patch and row_rate, from `first` on. Their count."""
    local, touched, row_rate, row_part = (
        state.pgs.local_patch, state.pgs.touched_patch, state.pgs.row_rate, state.row_part
    )  # fmt: skip
    patches, row_tet, count = model.patches.lane, state.row_tet, 0
    if local.shape[0] == 0:
        return 0
    local[:] = -1
    for row in range(contacts, rows):
        t = row_tet[row]
        p = patches[t // 8, t % 8]
        if local[p] < 0:
            local[p] = count
            touched[count] = p
            count += 1
        row_rate[row] = first + local[p]
    for row in range(contacts):
        row_rate[row], row_part[row] = first + count, 0.0
    return count


@stage
def inverse_between(model: Model, state: State, h: float, count: int, patches: int) -> None:
    """S: the symmetric block of A⁻¹ between touched nodes, some of its columns at a time; then touched patches."""
    Y, touched, reached = state.pgs.Y, state.pgs.touched, state.pgs.reached
    pattern, lower, inverse = model.pattern, state.L_lower, state.L_inverse
    size = 3 * count + patches
    S = state.pgs.S[: size * size].reshape((size, size))
    for start in range(0, count, NODES_AT_ONCE):
        first = touched[start]
        Y[first:] = 0.0
        reached[first:] = 0
        width = min(NODES_AT_ONCE, count - start)
        for c in range(width):
            reached[touched[start + c]] = 1
            for i in range(3):
                Y[touched[start + c], i, 3 * c + i] = 1.0
        solve_many(pattern, lower, inverse, first, reached, Y)
        for a in range(start, count):
            k = touched[a]
            for i in range(3):
                for l in range(3 * width):
                    S[3 * a + i, 3 * start + l] = Y[k, i, l]
                    S[3 * start + l, 3 * a + i] = Y[k, i, l]
    if patches > 0:
        inverse_of_patches(model, state, h, S, count, patches)


@stage
def inverse_of_patches(model: Model, state: State, h: float, S: Floats, count: int, patches: int) -> None:
    """The rows and columns of S that touched patches have: h A⁻¹ Gᵀ at touched nodes, and h² G A⁻¹ Gᵀ."""
    Y, touched, touched_patch, reached = state.pgs.Y, state.pgs.touched, state.pgs.touched_patch, state.pgs.reached
    pattern, lower, inverse, nf = model.pattern, state.L_lower, state.L_inverse, model.free.shape[0]
    entries, slots, G, own = model.patches.start, model.patches.slot, state.G, 3 * count
    first = touched[0] if count > 0 else nf
    for q in range(patches):
        for k in range(entries[touched_patch[q]], entries[touched_patch[q] + 1]):
            first = min(first, slots[k])
    for start in range(0, patches, SIDES_AT_ONCE):
        Y[first:] = 0.0
        reached[first:] = 0
        width = min(SIDES_AT_ONCE, patches - start)
        for l in range(width):
            p = touched_patch[start + l]
            for k in range(entries[p], entries[p + 1]):
                if slots[k] < nf:
                    reached[slots[k]] = 1
                    for i in range(3):
                        Y[slots[k], i, l] = h * G[k, i]
        solve_many(pattern, lower, inverse, first, reached, Y)
        for a in range(count):
            for i in range(3):
                for l in range(width):
                    S[3 * a + i, own + start + l] = S[own + start + l, 3 * a + i] = Y[touched[a], i, l]
        for q in range(start, patches):
            S[own + q, own + start : own + start + width] = 0.0
            for k in range(entries[touched_patch[q]], entries[touched_patch[q] + 1]):
                if slots[k] < nf:
                    for i in range(3):
                        for l in range(width):
                            S[own + q, own + start + l] += h * G[k, i] * Y[slots[k], i, l]
            for l in range(width):
                S[own + start + l, own + q] = S[own + q, own + start + l]
