r"""Primal semismooth Newton on the rows of a step: as sparse as the elastic matrix, however many limits hold.

With compliances ε > 0 the step of `pgs` is a problem in the velocities alone. In δ, the change of the free nodes'
velocities since the rows were formed,

    r(δ) = b − A (v + δ) + h Σ_i J_iᵀ λ_i = 0,    λ_i = max(0, −g_i) / ε_i,    g_i = constant_i + h J_i δ,

and for the tangents of a contact λ_t = τ min(1, μ λ_n / |τ|), τ_t = −g_t / ε_t: the exact Coulomb cone. A limit row
couples the four nodes of its tetrahedron only, or of its patch, a contact one node: the Hessian

    H = A + h² Σ_{λ_i > 0} J_iᵀ J_i / ε_i + contacts

has the pattern of A. It is kept symmetric; that friction grows with the normal force, μ t nᵀ / ε, is brought in by a
second solve with new factors where nodes slip. A step is taken whole unless dᵀr says that it went too far: r is
minus the gradient of a convex merit function (but for friction), so that its zero along d is the least merit. What is
kept is the iterate with the least force missing, so that a step that stops early is never worse than its start.

Friction's bound moves with the normal force, so that a search may go round: nodes that come down in one step slip, let
go and stick in turn. One that does not get on is solved with bounds that are held, again the zero of a merit function
that is convex, and then with those of the normal forces that came out, until they agree (Tresca friction and its fixed
point: Nečas, Jarušek and Haslinger 1980, *On the solution of the variational inequality to the Signorini problem with
small friction*).

r itself is exact, but H is not formed and factored in every iteration, nor in every step: factors once made serve until
they would need more iterations than new ones are worth, mended by what iterations tell of H (secants.py). Most steps
make none. Where old factors are poor once, the step goes on and the next one begins with new ones; poor twice, it makes
its own.
"""

from __future__ import annotations

import math

from ..arrays import Floats
from .along import begin_gaps, move_gaps, pressed_by, row_rates, row_slope
from .bone import bone_residual
from .border import solve_all
from .clock import FACTOR, SOLVE, lap, seconds
from .compile import stage
from .dilatation import add_patch_forces
from .elasticity import slot_velocities
from .hessian import NONE, OF_A, OF_ANOTHER, factor_elastic, refactor
from .lanes import load4, splat4, store4, sum3
from .linear_solver import solve
from .methods import TENSOR
from .model import Model, State
from .secants import learn, mended_solve
from .tensor_rows import copy_groups, tensor_forces
from .vectors import add, clear, copy, copy_first, inner, subtract_product
from .work import CORRECTIONS

# A line search ends where dᵀr is within so much of what it was to either side of 0: one iteration more costs new
# factors, as long as ten trials. A whole step along old ones, which is rough anyway, may go further past it.
_SLACK, _TOO_FAR = 0.1, 0.5
_TRIALS = 12
_STALLED, _PROGRESS = 20, 0.9  # so many iterations without that much progress end a step
_STALLS = 12  # after so many, friction's bounds are held
_TURNS = 30  # iterations with the same bounds, at most


@stage
def newton(
    model: Model, state: State, h: float, contacts: int, rows: int, anew: bool, tolerance: float
) -> tuple[int, float, bool]:
    """Velocities of the free nodes into state.v, row forces into state.lam[:rows]. (iterations, residual, definite).

    anew: A was formed anew. Factors of another A, and of other rows, serve as long as the residual falls fast enough.

    The residual is the largest force missing at any node [N], relative to the largest row force.
    """
    began = seconds(state.time) if model.deadline > 0.0 else 0.0
    own, lam, best, tensor = state.newton, state.lam, state.best, state.tensor
    packed = contacts if model.projection == TENSOR else rows  # the other ones are in groups (tensor_rows.py)
    change, tried, direction, best_change, factors = own.change, own.tried, own.direction, own.best_change, own.factors
    own.spent[0] = own.poor[0] = 0
    if anew and factors[0] == OF_A:
        factors[0] = OF_ANOTHER
    slot_velocities(model, state)
    remainder(model, state)
    if rows == 0 and not model.has_bone:
        copy(direction, own.remainder)
        lap(state.laps, state.time, SOLVE)
        definite = factors[0] == OF_A or factor_elastic(model, state)
        lap(state.laps, state.time, FACTOR)
        solve(model.pattern, state.L_lower, state.L_inverse, direction)
        add_to_velocities(model, state, direction)
        return 0, 0.0, definite
    own.holds[0] = 0
    clear(change)
    begin_gaps(model, state, contacts, rows)
    copy(own.next_residual, own.remainder)
    residual, missing = evaluate(model, state, h, contacts, rows, change)
    if not missing < math.inf:
        return 0, residual, False
    worth = model.pattern.worth
    stale = factors[0] == NONE or model.max_iterations <= worth  # of few, none is spent on old factors
    patience = 2 * worth if anew else worth  # a step that makes a matrix or factors is long enough
    doubted = False  # old factors have been poor once
    least, least_missing, iterations, stalled, made, turns = residual, missing, 0, 0, 0, 0
    keep(state, packed)
    while iterations < model.max_iterations:
        if residual <= tolerance or turns >= _TURNS:
            if own.holds[0] == 0:
                break
            residual, missing = evaluate_anew(model, state, h, contacts, rows, False)
            if missing < least_missing:
                stalled = 0 if missing < _PROGRESS * least_missing else stalled + 1
                least, least_missing = residual, missing
                keep(state, packed)
            else:
                stalled += 1
            if residual <= tolerance or stalled >= _STALLED:
                break
            residual, missing = hold_friction(model, state, h, contacts, rows, lam)
            turns, stale = 0, True
        if model.deadline > 0.0 and iterations > 0 and seconds(state.time) - began > model.deadline:
            break
        if stale:
            lap(state.laps, state.time, SOLVE)
            definite = refactor(model, state, h, contacts, rows)
            made += 1
            patience = 2 * worth if made == 1 else worth
            lap(state.laps, state.time, FACTOR)
            if not definite:
                return iterations, residual, False
        before = residual
        ascent = newton_direction(model, state, h, contacts, stale)
        residual, missing = search(model, state, h, contacts, rows, ascent, stale)
        iterations += 1
        if not missing < math.inf:
            break
        learn(state.secants, change, tried, own.next_residual, residual / before)
        copy(change, tried)
        if own.holds[0] != 0:
            turns += 1
        else:
            stalled += 1
            if missing < least_missing:
                stalled = 0 if missing < _PROGRESS * least_missing else stalled
                least, least_missing = residual, missing
                keep(state, packed)
            if stalled >= _STALLS and contacts > 0:
                copy(change, best_change)
                residual, missing = hold_friction(model, state, h, contacts, rows, best)
                turns, stale = 0, True
                continue
            if stalled >= _STALLED:
                break
        most = min(patience, (model.max_iterations - iterations) // 2) if stalled == 0 else worth
        poor = residual >= before or math.log(tolerance / residual) < most * math.log(residual / before)
        stale = poor and (made > 0 or doubted)
        doubted |= poor
    if own.holds[0] != 0:
        residual, missing = evaluate_anew(model, state, h, contacts, rows, False)
        if missing < least_missing:
            least = residual
            keep(state, packed)
    if made == 0:
        own.spent[0], own.poor[0] = iterations, int(doubted)
    copy_first(lam, best, packed)
    copy_groups(tensor, tensor.lam, tensor.best)
    if model.has_bone:
        bone_residual(model, state, h, best_change, own.next_residual)
    add_to_velocities(model, state, best_change)
    return iterations, least, True


@stage
def keep(state: State, packed: int) -> None:
    """Where the search is, as the best so far: velocities, and the forces of rows, the first `packed` not in groups."""
    copy(state.newton.best_change, state.newton.change)
    copy_first(state.best, state.lam, packed)
    copy_groups(state.tensor, state.tensor.best, state.tensor.lam)


@stage
def newton_direction(model: Model, state: State, h: float, contacts: int, corrects: bool) -> float:
    """H⁻¹ r into `direction`; returns dᵀr. corrects: with friction's unsymmetric part: old factors are too rough."""
    own, J, row_slot = state.newton, state.J, state.row_slot
    direction, other, r, slip, stiffness = own.direction, own.tried, own.next_residual, own.slip, own.stiffness
    mended_solve(model, state, r, direction)
    ascent = inner(direction, r)
    if corrects:
        slips = False
        copy(other, r)
        for c in range(contacts // 3):
            if slip[c, 3] > 0.0 and stiffness[3 * c] > 0.0:
                slips = True
                slot = row_slot[3 * c, 0]
                pressed = sum3(load4(J, 3 * c, 0) * load4(direction, slot, 0))
                push = h * h * slip[c, 3] * stiffness[3 * c] * pressed
                store4(other, slot, 0, load4(other, slot, 0) - load4(slip, c, 0) * push)
        if slips:
            state.work[CORRECTIONS] += 1
            solve_all(model, state, other)
            along = inner(other, r)
            if along > 0.0:
                copy(direction, other)
                ascent = along
    return ascent


@stage
def search(
    model: Model, state: State, h: float, contacts: int, rows: int, ascent: float, new: bool
) -> tuple[float, float]:
    """Go along `direction`, all of it or a part; what `evaluate` gives there, δ in `tried`. new: it is of new factors.

    dᵀr is ascent where it begins, and falls: linearly, but for where rows come to hold or let go.
    """
    own, nf = state.newton, model.free.shape[0]
    direction, along = own.direction, own.along
    clear(along)
    subtract_product(nf, model.block_row, model.block_column, state.A, direction, along)
    row_rates(model, state, h, contacts, rows, direction)
    linear, bend = inner(direction, own.remainder), inner(direction, along)
    too_far = (_SLACK if new else _TOO_FAR) * ascent
    part, low, high, low_ahead, high_ahead = 1.0, 0.0, 1.0, ascent, -ascent
    for trial in range(_TRIALS):
        ahead = linear + part * bend + row_slope(model, state, h, contacts, rows, part)
        if ahead >= -too_far if trial == 0 else abs(ahead) <= _SLACK * ascent:
            break
        if ahead > 0.0:
            low, low_ahead, high_ahead = part, ahead, 0.5 * high_ahead if trial > 2 else high_ahead
        else:
            high, high_ahead, low_ahead = part, ahead, 0.5 * low_ahead if trial > 2 else low_ahead
        part = low + (high - low) * max(0.05, min(0.95, low_ahead / (low_ahead - high_ahead)))
    move_gaps(model, state, contacts, rows, part)
    add(own.tried, own.change, direction, part)
    add(own.remainder, own.remainder, along, part)
    copy(own.next_residual, own.remainder)
    return evaluate(model, state, h, contacts, rows, own.tried)


@stage
def remainder(model: Model, state: State) -> None:
    """b − A v into state.newton.remainder, of the velocities in state.slot_velocity."""
    own, nf = state.newton, model.free.shape[0]
    copy(own.remainder, state.rhs)
    subtract_product(nf, model.block_row, model.block_column, state.A, state.slot_velocity, own.remainder)


@stage
def evaluate(model: Model, state: State, h: float, contacts: int, rows: int, change: Floats) -> tuple[float, float]:
    """Add the rows' forces at δ = `change` and its gaps to next_residual, b − A (v + δ); their part of the Hessian.

    Returns the residual, and the largest force missing [N].
    """
    r, nf = state.newton.next_residual, model.free.shape[0]
    pressed = contact_forces(model, state, h, contacts)
    if model.projection == TENSOR:
        largest = max(pressed, tensor_forces(model, state, h))
    else:
        largest = max(pressed, limit_forces(model, state, h, contacts, rows))
    store4(r, nf, 0, splat4(0.0))
    if model.has_bone:
        bone_residual(model, state, h, change, r)
    worst = total = 0.0
    for k in range(r.shape[0]):
        force = load4(r, k, 0)
        size = sum3(force * force)
        if k == nf + 2:
            size /= model.bone_lever * model.bone_lever
        worst = max(worst, size)
        total += size
    if not total < math.inf:  # max() passes over what is not a number
        return math.inf, math.inf
    missing = math.sqrt(worst) / h
    return missing / max(largest, model.least_force, model.felt_force), missing


@stage
def evaluate_anew(model: Model, state: State, h: float, contacts: int, rows: int, holds: bool) -> tuple[float, float]:
    """`evaluate`, with what it adds to, at the δ that is reached; holds: with friction's bounds as they are held."""
    own = state.newton
    own.holds[0] = 1 if holds else 0
    slot_velocities(model, state)
    add(state.slot_velocity, state.slot_velocity, own.change, 1.0)
    remainder(model, state)
    row_rates(model, state, h, contacts, rows, own.change)
    begin_gaps(model, state, contacts, rows)
    move_gaps(model, state, contacts, rows, 1.0)
    copy(own.next_residual, own.remainder)
    return evaluate(model, state, h, contacts, rows, own.change)


@stage
def hold_friction(model: Model, state: State, h: float, contacts: int, rows: int, lam: Floats) -> tuple[float, float]:
    """Hold friction's bounds, those of the normal forces in lam, from now on; what `evaluate` gives with them."""
    for c in range(contacts // 3):
        state.newton.bound[c] = model.mu_friction * lam[3 * c]
    return evaluate_anew(model, state, h, contacts, rows, True)


@stage
def contact_forces(model: Model, state: State, h: float, contacts: int) -> float:
    """The part of contacts in `evaluate`, with slip directions; the largest normal force."""
    own, J, lam, row_slot = state.newton, state.J, state.lam, state.row_slot
    r, gaps, stiffness, slip, compliance = own.next_residual, own.gap, own.stiffness, own.slip, state.compliance
    largest = 0.0
    for c in range(contacts // 3):
        row = 3 * c
        slot = row_slot[row, 0]
        normal, a, b, share = pressed_by(model, state, c, gaps[row], gaps[row + 1], gaps[row + 2])
        slip[c] = 0.0
        if normal > 0.0 or share > 0.0:
            n, t1, t2 = load4(J, row, 0), load4(J, row + 1, 0), load4(J, row + 2, 0)
            if share < 1.0:
                size = math.sqrt(a * a + b * b)
                store4(slip, c, 0, t1 * (a / size) + t2 * (b / size))
                slip[c, 3] = 0.0 if own.holds[0] != 0 else model.mu_friction
            lam[row], lam[row + 1], lam[row + 2] = normal, a * share, b * share
            stiffness[row] = 1.0 / compliance[row] if normal > 0.0 else 0.0
            stiffness[row + 1] = share / compliance[row + 1]
            force = n * (h * normal) + t1 * (h * a * share) + t2 * (h * b * share)
            store4(r, slot, 0, load4(r, slot, 0) + force)
            largest = max(largest, normal)
        else:
            lam[row] = lam[row + 1] = lam[row + 2] = stiffness[row] = stiffness[row + 1] = 0.0
    return largest


@stage
def limit_forces(model: Model, state: State, h: float, contacts: int, rows: int) -> float:
    """The part of limits in `evaluate`; the largest nodal force."""
    own, J, lam, row_slot, scale = state.newton, state.J, state.lam, state.row_slot, state.scale
    r, stiffness, compliance, patches = own.next_residual, own.stiffness, state.compliance, model.patches.lane
    row_tet, row_part, sums, patched = state.row_tet, state.row_part, state.patch_force, len(model.patches.volume) > 0
    largest, held = 0.0, 0
    if patched:
        sums[:] = 0.0
    for row in range(contacts, rows):
        force = -own.gap[row] / compliance[row]
        if force > 0.0:
            lam[row], stiffness[row] = force, 1.0 / compliance[row]
            held += 1
            if patched:
                t = row_tet[row]
                sums[patches[t // 8, t % 8]] += row_part[row] * force
            largest = max(largest, force * scale[row])
            for n in range(4):
                slot = row_slot[row, n]
                store4(r, slot, 0, load4(r, slot, 0) + load4(J, row, n) * (h * force))
        else:
            lam[row] = stiffness[row] = 0.0
    if patched and held > 0:
        add_patch_forces(model, state, h, r)
    return largest


@stage
def add_to_velocities(model: Model, state: State, change: Floats) -> None:
    """Velocities at δ."""
    v, free = state.v, model.free
    nf = free.shape[0]
    for k in range(nf):
        store4(v, free[k], 0, load4(v, free[k], 0) + load4(change, k, 0))
    if model.has_bone:
        for i in range(3):
            state.twist[i] += change[nf + 1, i]
            state.twist[3 + i] += change[nf + 2, i]
        for d in range(model.driven.shape[0]):
            n = model.driven[d]
            store4(v, n, 0, load4(v, n, 0) + load4(change, nf + 3 + d, 0))
