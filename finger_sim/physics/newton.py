r"""Primal semismooth Newton on the rows of a step: as sparse as the elastic matrix, however many limits hold.

With compliances ε > 0 the step of `pgs` is a problem in the velocities alone. In δ, the change of the free nodes'
velocities since the rows were formed,

    r(δ) = b − A (v + δ) + h Σ_i J_iᵀ λ_i = 0,    λ_i = max(0, −g_i) / ε_i,    g_i = constant_i + h J_i δ,

and for the tangents of a contact λ_t = τ min(1, μ λ_n / |τ|), τ_t = −g_t / ε_t: the exact Coulomb cone. A limit row
couples the four nodes of its tetrahedron only, or of its patch, a contact one node: the Hessian

    H = A + h² Σ_{λ_i > 0} J_iᵀ J_i / ε_i + contacts

has the pattern of A. It is kept symmetric; that friction grows with the normal force, μ t nᵀ / ε, is brought in by a
few more solves with the same factors where nodes slip. A step is taken whole unless dᵀr says that it went too far: r is
minus the gradient of a convex merit function (but for friction), so that its zero along d is the least merit. What is
kept is the iterate with the least force missing, so that a step that stops early is never worse than its start.
Typically one factorisation a step: the rows that held before hold again.
"""

from __future__ import annotations

import math

from ..arrays import Floats
from .bone import bone_residual
from .border import solve_all
from .clock import FACTOR, SOLVE, lap, seconds
from .compile import stage
from .dilatation import add_patch_forces, patch_rates
from .elasticity import slot_velocities
from .hessian import factor_elastic, refactor
from .lanes import load4, splat4, store4, sum3
from .model import Model, State
from .vectors import add, clear, copy, copy_first, inner, subtract_product
from .work import CORRECTIONS

_CORRECTIONS = 1  # solves that bring friction's unsymmetric part in
_SLACK = 0.5  # a line search ends where dᵀr is within so much of what it was to either side of 0
_TRIALS = 12
_STALLED, _PROGRESS = 20, 0.9  # so many iterations without that much progress end a step
_WEAK = 0.3  # an iteration that leaves more of the residual than this asks for new factors: one costs as some solves
OPEN, STICKS, SLIPS = 0.0, 1.0, 2.0
_OTHER_MATRIX = -1  # in place of that number: the factors at hand, if any, are not of this A
_STICKING, _SLIPPING, _BONE = 1 << 20, 1 << 40, 1 << 60  # places in the number that counts what holds


@stage
def newton(
    model: Model, state: State, h: float, contacts: int, rows: int, anew: bool, tolerance: float
) -> tuple[int, float, bool]:
    """Velocities of the free nodes into state.v, row forces into state.lam[:rows]. (iterations, residual, definite).

    anew: A was formed anew. Where it was not, and as many rows hold as when it was factored, its factors serve again.

    The residual is the largest force missing at any node [N], relative to the largest row force.
    """
    began = seconds(state.time) if model.deadline > 0.0 else 0.0
    own, lam, best = state.newton, state.lam, state.best
    change, tried, direction, best_change = own.change, own.tried, own.direction, own.best_change
    if anew:
        own.factored_holds[0] = _OTHER_MATRIX
    remainder(model, state)
    if rows == 0 and not model.has_bone:
        copy(direction, own.start_residual)
        lap(state.laps, state.time, SOLVE)
        definite = own.factored_holds[0] == 0 or factor_elastic(model, state)
        lap(state.laps, state.time, FACTOR)
        solve_all(model, state, direction)
        add_to_velocities(model, state, direction)
        return 0, 0.0, definite
    clear(change)
    copy(own.next_residual, own.start_residual)
    residual, missing, holds, changed = evaluate(model, state, h, contacts, rows, change)
    if not missing < math.inf:
        return 0, residual, False
    stale = holds != own.factored_holds[0]
    changed = False
    copy_first(own.factored, own.stiffness, rows)
    least, least_missing, iterations, stalled = residual, missing, 0, 0
    clear(best_change)
    copy_first(best, lam, rows)
    while residual > tolerance and iterations < model.max_iterations:
        if model.deadline > 0.0 and iterations > 0 and seconds(state.time) - began > model.deadline:
            break
        if changed or stale:
            lap(state.laps, state.time, SOLVE)
            definite = refactor(model, state, h, contacts, rows, holds)
            lap(state.laps, state.time, FACTOR)
            if not definite:
                return iterations, residual, False
        before = residual
        ascent = newton_direction(model, state, h, contacts)
        part, low, high, low_ahead, high_ahead = 1.0, 0.0, 1.0, ascent, -ascent
        for trial in range(_TRIALS):
            add(tried, change, direction, part)
            remainder_at(model, state, tried)
            residual, missing, holds, changed = evaluate(model, state, h, contacts, rows, tried)
            ahead = inner(direction, own.next_residual)
            if (ahead >= -_SLACK * ascent and (ahead <= _SLACK * ascent or trial == 0)) or residual <= tolerance:
                break
            if ahead > 0.0:
                low, low_ahead, high_ahead = part, ahead, 0.5 * high_ahead if trial > 1 else high_ahead
            else:
                high, high_ahead, low_ahead = part, ahead, 0.5 * low_ahead if trial > 1 else low_ahead
            part = low + (high - low) * max(0.05, min(0.95, low_ahead / (low_ahead - high_ahead)))
        iterations += 1
        copy(change, tried)
        stalled += 1
        if missing < least_missing:
            stalled = 0 if missing < _PROGRESS * least_missing else stalled
            least, least_missing = residual, missing
            copy(best_change, change)
            copy_first(best, lam, rows)
        if stalled >= _STALLED or not missing < math.inf:
            break
        stale = residual > _WEAK * before
    copy_first(lam, best, rows)
    if model.has_bone:
        bone_residual(model, state, h, best_change, own.next_residual)
    add_to_velocities(model, state, best_change)
    return iterations, least, True


@stage
def newton_direction(model: Model, state: State, h: float, contacts: int) -> float:
    """H⁻¹ r into `direction`, friction's unsymmetric part included; returns dᵀr."""
    own, J, row_slot = state.newton, state.J, state.row_slot
    direction, other, r, slip, stiffness = own.direction, own.tried, own.next_residual, own.slip, own.stiffness
    copy(direction, r)
    solve_all(model, state, direction)
    ascent = inner(direction, r)
    for _ in range(_CORRECTIONS):
        slips = False
        copy(other, r)
        for c in range(contacts // 3):
            if slip[c, 3] > 0.0 and stiffness[3 * c] > 0.0:
                slips = True
                slot = row_slot[3 * c, 0]
                pressed = sum3(load4(J, 3 * c, 0) * load4(direction, slot, 0))
                push = h * h * slip[c, 3] * stiffness[3 * c] * pressed
                store4(other, slot, 0, load4(other, slot, 0) - load4(slip, c, 0) * push)
        if not slips:
            break
        state.work[CORRECTIONS] += 1
        solve_all(model, state, other)
        along = inner(other, r)
        if not along > 0.0:
            break
        copy(direction, other)
        ascent = along
    return ascent


@stage
def remainder(model: Model, state: State) -> None:
    """b − A v of the free nodes' velocities into state.newton.start_residual."""
    slot_velocities(model, state)
    copy(state.newton.start_residual, state.rhs)
    nf = model.free.shape[0]
    subtract_product(nf, model.block_row, model.block_column, state.A, state.slot_velocity, state.newton.start_residual)


@stage
def remainder_at(model: Model, state: State, change: Floats) -> None:
    """b − A (v + δ) at δ = `change` into next_residual."""
    r = state.newton.next_residual
    copy(r, state.newton.start_residual)
    subtract_product(model.free.shape[0], model.block_row, model.block_column, state.A, change, r)


@stage
def evaluate(
    model: Model, state: State, h: float, contacts: int, rows: int, change: Floats
) -> tuple[float, float, int, bool]:
    """Add the rows' forces at δ = `change` to next_residual, which holds b − A (v + δ); their part of the Hessian.

    Returns the residual; the largest force missing [N]; how many limits hold and contacts stick and slip, as one
    number; and whether these are other ones than in the factors at hand.
    """
    r, nf = state.newton.next_residual, model.free.shape[0]
    pressed, touching, changed = contact_forces(model, state, h, contacts, change)
    strongest, held, others = limit_forces(model, state, h, contacts, rows, change)
    largest = max(pressed, strongest)
    held += touching
    changed |= others
    store4(r, nf, 0, splat4(0.0))
    if model.has_bone:
        bone = bone_residual(model, state, h, change, r)
        changed |= bone != state.yielding.holds[1]
        state.yielding.holds[0] = bone
        held += bone * _BONE
    worst = total = 0.0
    for k in range(r.shape[0]):
        force = load4(r, k, 0)
        size = sum3(force * force)
        if k == nf + 2:
            size /= model.bone_lever * model.bone_lever
        worst = max(worst, size)
        total += size
    if not total < math.inf:  # max() passes over what is not a number
        return math.inf, math.inf, held, changed
    missing = math.sqrt(worst) / h
    return missing / max(largest, model.least_force), missing, held, changed


@stage
def contact_forces(model: Model, state: State, h: float, contacts: int, change: Floats) -> tuple[float, int, bool]:
    """The part of contacts in `evaluate`, with slip directions. (largest normal force, what holds, whether it did)."""
    own, J, lam, row_slot = state.newton, state.J, state.lam, state.row_slot
    r, stiffness, factored, slip = own.next_residual, own.stiffness, own.factored, own.slip
    constant, compliance, mu_friction = state.constant, state.compliance, model.mu_friction
    largest, held, changed = 0.0, 0, False
    for c in range(contacts // 3):
        row = 3 * c
        slot = row_slot[row, 0]
        d = load4(change, slot, 0)
        n, t1, t2 = load4(J, row, 0), load4(J, row + 1, 0), load4(J, row + 2, 0)
        normal = -(constant[row] + h * sum3(n * d)) / compliance[row]
        slip[c] = 0.0
        holds = OPEN
        if normal > 0.0:
            a = -(constant[row + 1] + h * sum3(t1 * d)) / compliance[row + 1]
            b = -(constant[row + 2] + h * sum3(t2 * d)) / compliance[row + 2]
            size, cone = math.sqrt(a * a + b * b), mu_friction * normal
            holds, share = STICKS, 1.0
            held += _STICKING
            if size > cone:
                holds, share = SLIPS, cone / size
                held += _SLIPPING
                store4(slip, c, 0, t1 * (a / size) + t2 * (b / size))
                slip[c, 3] = mu_friction
            lam[row], lam[row + 1], lam[row + 2] = normal, a * share, b * share
            stiffness[row], stiffness[row + 1] = 1.0 / compliance[row], share / compliance[row]
            force = n * (h * normal) + t1 * (h * a * share) + t2 * (h * b * share)
            store4(r, slot, 0, load4(r, slot, 0) + force)
            largest = max(largest, normal)
        else:
            lam[row] = lam[row + 1] = lam[row + 2] = stiffness[row] = stiffness[row + 1] = 0.0
        stiffness[row + 2] = holds
        changed |= holds != factored[row + 2]
    return largest, held, changed


@stage
def limit_forces(
    model: Model, state: State, h: float, contacts: int, rows: int, change: Floats
) -> tuple[float, int, bool]:
    """The part of limits in `evaluate`. (largest nodal force, how many hold, whether others did)."""
    own, J, lam, row_slot, scale = state.newton, state.J, state.lam, state.row_slot, state.scale
    r, stiffness, factored = own.next_residual, own.stiffness, own.factored
    constant, compliance = state.constant, state.compliance
    largest, held, changed = 0.0, 0, False
    own_patches, row_tet, row_part = model.patches, state.row_tet, state.row_part
    patched, patches, rates, sums = (
        own_patches.volume.shape[0] > 0,
        own_patches.lane,
        state.patch_rate,
        state.patch_force,
    )
    if patched and rows > contacts:
        patch_rates(model, state, own_patches.slot, change)
        sums[:] = 0.0
    for row in range(contacts, rows):
        s0, s1, s2, s3 = row_slot[row, 0], row_slot[row, 1], row_slot[row, 2], row_slot[row, 3]
        j0, j1, j2, j3 = load4(J, row, 0), load4(J, row, 1), load4(J, row, 2), load4(J, row, 3)
        moved = j0 * load4(change, s0, 0) + j1 * load4(change, s1, 0)
        moved = moved + j2 * load4(change, s2, 0) + j3 * load4(change, s3, 0)
        total, patch, part = sum3(moved), 0, 0.0
        if patched:
            t = row_tet[row]
            patch, part = patches[t // 8, t % 8], row_part[row]
            total += part * rates[patch]
        force = -(constant[row] + h * total) / compliance[row]
        if force > 0.0:
            lam[row], stiffness[row] = force, 1.0 / compliance[row]
            held += 1
            if patched:
                sums[patch] += part * force
            largest = max(largest, force * scale[row])
            force *= h
            store4(r, s0, 0, load4(r, s0, 0) + j0 * force)
            store4(r, s1, 0, load4(r, s1, 0) + j1 * force)
            store4(r, s2, 0, load4(r, s2, 0) + j2 * force)
            store4(r, s3, 0, load4(r, s3, 0) + j3 * force)
        else:
            lam[row] = stiffness[row] = 0.0
        changed |= (stiffness[row] > 0.0) != (factored[row] > 0.0)
    if patched and held > 0:
        add_patch_forces(model, state, h, r)
    return largest, held, changed


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
