"""What limits did in a step: the forces on each tetrahedron, the rows that hold it, and over-constraint."""

from __future__ import annotations

from .compile import stage
from .dilatation import share_out
from .lanes import lane, load4, splat4, splat8, store4, store8, where
from .locking import STRAINS
from .methods import NEWTON, PGS, TENSOR
from .model import Model, State
from .strain_limits import strain_ratio
from .tensor_limit import greatest_strain
from .tensor_rows import DIRECTIONS


@stage
def observe_limits(model: Model, state: State, contacts: int, rows: int) -> tuple[float, int, int, int]:
    """The largest strain/limit, rows that carry a force, tetrahedra that they hold, and those over-constrained.

    Into state.active_rows the rows of each tetrahedron; state.limit_force is what the next step starts from.
    """
    if model.projection == TENSOR:
        greatest = greatest_strain(model, state)
    else:
        strain_ratio(model, state)
        greatest = 0.0
        for t in range(state.strain_ratio.shape[0]):
            greatest = max(greatest, state.strain_ratio[t])
    state.patch_force[:] = 0.0
    if model.projection == TENSOR and model.method == NEWTON:
        held, tets = observe_groups(model, state)
    else:
        held, tets = observe_rows(model, state, contacts, rows)
    if state.limit_force.shape[0] > 0 and model.patches.volume.shape[0] > 0:
        share_out(model, state)
    return greatest, held, tets, locked_tets(model, state)


@stage
def observe_groups(model: Model, state: State) -> tuple[int, int]:
    """Of rows in lanes (tensor_rows.py): how many carry a force, and how many tetrahedra they hold."""
    tensor, sums, patches, active = state.tensor, state.patch_force, model.patches.lane, state.active_rows
    first, lam, keys, tets = tensor.first, tensor.lam, tensor.key, active.shape[0]
    patched, none, one = model.patches.volume.shape[0] > 0, splat4(0.0), splat4(1.0)
    rows = held = 0
    for four in range(first.shape[0] - 1):
        force = count = none
        for k in range(first[four], first[four + 1]):
            carried = load4(lam, k, 0)
            force = force + carried
            if keys[k] < 2 * DIRECTIONS:
                count = count + where(carried > 0.0, one, none)
        b, half = four // 2, four % 2
        store4(state.limit_force, b, half, force)
        for l in range(min(4, tets - 4 * four)):
            number = int(lane(count, l))
            active[4 * four + l] = number
            rows += number
            held += number > 0
        if patched and first[four] < first[four + 1]:
            for l in range(4):
                sums[patches[b, 4 * half + l]] += lane(force, l) * (1.0 / 3.0)
    return rows, held


@stage
def observe_rows(model: Model, state: State, contacts: int, rows: int) -> tuple[int, int]:
    """The same of rows one after the other."""
    active, warm, lam, limit_force = state.active_rows, state.warm_limit, state.lam, state.limit_force
    row_tet, row_key, row_side, row_part = state.row_tet, state.row_key, state.row_side, state.row_part
    keeps, follows = model.method == PGS, limit_force.shape[0] > 0
    patches, patched = model.patches.lane, follows and model.patches.volume.shape[0] > 0
    counted = 2 * DIRECTIONS if model.projection == TENSOR else 9
    if keeps:
        warm[:] = 0.0
    for b in range(limit_force.shape[0]):
        store8(limit_force, b, 0, splat8(0.0))
    active[:] = 0
    held = tets = 0
    for row in range(contacts, rows):
        if lam[row] > 0.0:
            t, key = row_tet[row], row_key[row]
            if follows:
                limit_force[t // 8, t % 8] += lam[row]
            if patched:
                state.patch_force[patches[t // 8, t % 8]] += abs(row_part[row]) * lam[row]
            if keeps:
                warm[t, key] = lam[row] * row_side[row]
            if key < counted:
                held += 1
                tets += active[t] == 0
                active[t] += 1
    return held, tets


@stage
def locked_tets(model: Model, state: State) -> int:
    """How many tetrahedra at a limit are over-constrained.

    More rows hold them than they have ways to deform, or they are strained further along an axis than the others'
    limits allow at constant volume.
    """
    active_rows, moves, allowed = state.active_rows, model.tet_moves, model.isochoric_strain
    strains = state.limit_strain
    count = 0
    for t in range(active_rows.shape[0]):
        if active_rows[t] == 0:
            continue
        locked = active_rows[t] > min(STRAINS, 3 * moves[t])
        for j in range(3):
            strain = strains[t // 8, j, t % 8]
            locked |= strain > allowed[0, j] or -strain > allowed[1, j]
        count += locked
    return count
