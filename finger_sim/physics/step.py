"""One step of the method, as the paper tells it in Section 4. Start here."""

from __future__ import annotations

import enum
import math

from ..arrays import Floats
from . import apart
from .bone import aim_bone, move_bone, place_driven
from .clock import ASSEMBLY, KINEMATICS, OUTPUT, ROWS, SOLVE, lap
from .compile import formula, kernel, stage
from .contact import contact_rows, deepest, store_contact
from .elasticity import ALL_OF_A, ELASTIC, assemble
from .hessian import factor_elastic
from .kinematics import strains_at, turned_far
from .lanes import load4, store4, sum3
from .linear_solver import solve
from .methods import NEWTON, NONE, PGS, TENSOR
from .model import Model, State
from .newton import newton
from .observed import observe_limits
from .plan import plan
from .relaxation import BEGIN, END, MOVED
from .strain_limits import bounded_at
from .tensor_rows import pack_rows, tensor_rows
from .vectors import add, copy, copy_first
from .work import CONTACT_ROWS, LIMITS, LINEAR


class Status(enum.IntFlag):
    """What a step has to say; 0: all well."""

    OK = 0
    NONFINITE = 1  # the step gave a number that is not finite or beyond all bounds; it was not taken
    INVERTED = 2  # a tetrahedron is inside out
    ITERATION_LIMIT = 4  # the solver stopped before its tolerance: best iterate used
    STEP_REJECTED = 8  # the step was not taken; the body was moved rigidly with its bone, or stopped if it has none
    LOCKED = 16  # a tetrahedron is over-constrained: see locking.py
    ROW_LIMIT = 32  # more rows near their limit than the arrays hold: the others were left out
    COMMAND_LIMITED = 64  # the command moved faster than the coupling allows and is being caught up with
    LIMIT_EXCEEDED = (
        128  # a strain is more than half as large again as its limit: not all limits can hold, or too softly
    )
    RESTORED = 256  # the body was beyond repair and was put back, undeformed, at its bone: see simulation/guard.py


# Where `step` writes what it reports, in State.result.
(
    STATUS,
    ITERATIONS,
    RESIDUAL,
    LIMIT_ROWS,
    LIMITED_TETS,
    STRAIN_RATIO,
    CONTACTS,
    PENETRATION,
    LOCKED_TETS,
    SPEED,
    REACH,
) = range(11)

_FARTHEST = 1e4  # tetrahedron sizes that a node may go in one step
_REJECTED = int(Status.NONFINITE | Status.STEP_REJECTED)
_ROW_LIMIT, _ITERATION_LIMIT = int(Status.ROW_LIMIT), int(Status.ITERATION_LIMIT)
_LOCKED, _INVERTED, _LIMIT_EXCEEDED = int(Status.LOCKED), int(Status.INVERTED), int(Status.LIMIT_EXCEEDED)
_HELD = 0.02  # time that the driven nodes stay before a body settles [s]: commands come slower than steps
# Part of the tetrahedra's size that the nodes of a body that settles move in a step, rms, at most. Linearised once
# more, a step costs twice: not worth it while the body still moves by more than linearisation is good for.
_SLOW = 3e-3
# Part of the tolerance that a step of `newton` aims at while the driven nodes stay: what it leaves of the residual is
# what keeps a body at rest moving. Less costs iterations in every held step, more lets it creep.
_SETTLED = 1e-6
# cos² of half the angle that a tetrahedron may turn by until the end of a step that shares A, 0.1 rad: what is left of
# the stiff part of A's error then moves nodes that little else holds.
_STRAYED = math.cos(0.05) ** 2
_EXCEEDED = 1.5  # strain/limit from which on LIMIT_EXCEEDED is set


@kernel
def step(model: Model, state: State, targets: Floats, h: float) -> None:
    """Advance `state` by h [s]; what happened goes into state.result.

    targets (nd, 3): where the driven nodes are to be at the end [m], world. Not looked at where the bone yields: it is
    drawn to the pose in state.target.

    state.R, E (F, U, s, V) hold the kinematics of the start (Eq. 1-4), those of the end are left for the next step.
    After STEP_REJECTED the positions are those of the start and the velocities are of no use: set both anew. Stress
    that relaxes has done so for a step.
    """
    state.result[:] = 0.0
    lap(state.laps, state.time, OUTPUT)
    moved = drive(model, state, targets, h)
    wanted, tolerance = model.relinearizations, model.tolerance
    state.held[0] = 0.0 if moved else state.held[0] + h
    if model.settles and state.held[0] > _HELD and model.method == NEWTON:
        tolerance *= _SETTLED
        if state.held_tets[0] > 0 and state.motion[0] * h < _SLOW * model.length:
            wanted = max(wanted, 1)
    plan(model, state, wanted > 0)
    shares = state.stale[0] & ELASTIC == 0
    if shares:
        copy(state.x_start, state.x)
        copy_first(state.twist_start, state.twist, state.twist.shape[0])
    if shares or wanted > 0:
        copy(state.v_start, state.v)
    relaxes = state.relaxing.rate.shape[0] > 0
    if relaxes:
        apart.relax(model, state, h, BEGIN)
    while True:
        for again in range(wanted + 1):
            if again > 0:
                relinearise(model, state, targets, h, again)
                if relaxes:
                    apart.relax(model, state, h, MOVED)
            contacts, rows, definite = linear_step(model, state, h, again, tolerance)
            well = definite and bounded(state.v, _FARTHEST * model.length / h)
            if not well:
                break
        if again > 0:
            copy(state.x, state.x_start)
        if well:
            fastest = integrate(model, state, targets, h)  # x += h v
            deform(model, state)
            if not (shares and turned_far(state, _STRAYED)):
                break
        elif not shares:
            state.result[STATUS] = _REJECTED
            if relaxes:
                deform(model, state)
                apart.relax(model, state, h, END)
            return
        shares = False  # it has gone where A is no good: once more, with its own
        put_back(model, state)
        if relaxes:
            apart.relax(model, state, h, MOVED)
    if relaxes:
        apart.relax(model, state, h, END)
    if model.has_bone:
        for i in range(7):
            state.bone[i] = state.bone[7 + i]
    lap(state.laps, state.time, KINEMATICS)
    state.stale[0] = 0
    if model.projection != NONE:
        bounded_at(model, state, held_still(model, state))
    lap(state.laps, state.time, ROWS)
    state.result[SPEED] = fastest
    observe(model, state, contacts, rows)
    lap(state.laps, state.time, OUTPUT)


@stage
def linear_step(model: Model, state: State, h: float, again: int, tolerance: float) -> tuple[int, int, bool]:
    """Velocities of a step that is linearised at state.x: (contact rows, all rows, whether A is positive definite).

    again: 0 where x is the step's start, else x and state.v_base are what linearisation number `again` gave before.
    What is stale of A is formed anew: where it has changed by little since it was formed, steps share it.
    """
    work = state.work
    work[LINEAR] += 1
    assemble(model, state, h, again > 0)  # A and b: backward Euler
    if model.has_bone:
        aim_bone(model, state, h, again > 0)
    lap(state.laps, state.time, ASSEMBLY)
    if model.method == PGS and not unconstrained(model, state):  # v_free = A⁻¹ b
        return 0, 0, False
    since_linearised(state, again)
    contacts = contact_rows(model, state, h, again > 0) if model.has_plane else 0
    status = 0
    if contacts < 0:
        contacts, status = (state.lam.shape[0] // 3) * 3, _ROW_LIMIT
    rows = contacts
    if model.projection != NONE:  # Eq. 9-12, linearised (Eq. 13-18)
        if model.projection == TENSOR:
            rows = contacts + tensor_rows(model, state, h)
            if model.method == PGS:
                rows = pack_rows(model, state, contacts, False)
        else:
            rows = apart.limit_rows(model, state, h, contacts)
        if rows < 0:
            rows, status = state.lam.shape[0], _ROW_LIMIT
    work[CONTACT_ROWS] += contacts
    work[LIMITS] += rows - contacts
    lap(state.laps, state.time, ROWS)
    iterations, residual, definite = 0, 0.0, True
    if model.method == NEWTON:
        iterations, residual, definite = newton(model, state, h, contacts, rows, state.stale[0] != 0, tolerance)
    elif rows > 0:
        iterations, residual = apart.solve_by_sweeps(model, state, h, contacts, rows)  # v = v_free + h A⁻¹ Jᵀ λ
    if not residual <= model.tolerance:
        status |= _ITERATION_LIMIT
    result = state.result
    result[STATUS], result[RESIDUAL] = int(result[STATUS]) | status, residual
    result[ITERATIONS] += iterations
    lap(state.laps, state.time, SOLVE)
    return contacts, rows, definite


@stage
def relinearise(model: Model, state: State, targets: Floats, h: float, again: int) -> None:
    """Put state.x where the linear step just taken ends, to linearise there."""
    if again == 1:
        copy(state.x_start, state.x)
    copy(state.x, state.x_start)
    copy(state.v_base, state.v)
    integrate(model, state, targets, h)
    deform(model, state)
    if model.projection != NONE:
        bounded_at(model, state, held_still(model, state))


@stage
def put_back(model: Model, state: State) -> None:
    """Everything to where the step began; A is to be formed anew."""
    copy(state.x, state.x_start)
    copy(state.v, state.v_start)
    copy_first(state.twist, state.twist_start, state.twist.shape[0])
    if model.has_bone:
        for i in range(7):
            state.bone[7 + i] = state.bone[i]
    deform(model, state)
    if model.projection != NONE:
        bounded_at(model, state, held_still(model, state))
    state.stale[0] = ALL_OF_A


@stage
def deform(model: Model, state: State) -> None:
    """R and E of every tetrahedron at the state's positions; U, s, V for limits on principal stretches."""
    strains_at(model, state, held_still(model, state))
    if state.principal.F.shape[0] > 0:
        apart.decompose(model, state)


@formula
def held_still(model: Model, state: State) -> bool:
    """Whether the body may come to rest: what is left of its rotations and eigenvectors would keep it moving."""
    still: bool = state.held[0] > 0.0 or model.driven.shape[0] == 0
    return still


@stage
def since_linearised(state: State, again: int) -> None:
    """state.moving: velocities that state.x has not yet moved by."""
    if again > 0:
        add(state.moving, state.v, state.v_base, -1.0)
    else:
        copy(state.moving, state.v)


@stage
def drive(model: Model, state: State, targets: Floats, h: float) -> bool:
    """Velocities that take the driven nodes to their targets; whether these or the plane move (or none is driven)."""
    moved: bool = state.moves[0] != 0 or model.driven.shape[0] == 0
    if model.has_bone:
        return moved
    driven, x, v, driven_velocity = model.driven, state.x, state.v, state.driven_velocity
    for d in range(driven.shape[0]):
        n = driven[d]
        for i in range(3):
            v[n, i] = driven_velocity[n, i] = (targets[d, i] - x[n, i]) / h
            moved |= v[n, i] != 0.0
    return moved


@stage
def unconstrained(model: Model, state: State) -> bool:
    """Velocities of the unconstrained step into state.v. False if A is not positive definite."""
    definite = factor_elastic(model, state)
    solve(model.pattern, state.L_lower, state.L_inverse, state.rhs)
    free, v, rhs = model.free, state.v, state.rhs
    for k in range(free.shape[0]):
        for i in range(3):
            v[free[k], i] = rhs[k, i]
    return definite


@kernel
def bounded(v: Floats, bound: float) -> bool:
    """Whether no velocity is beyond `bound`; one that is not a number is."""
    for n in range(v.shape[0]):
        for i in range(3):
            if not abs(v[n, i]) <= bound:
                return False
    return True


@stage
def integrate(model: Model, state: State, targets: Floats, h: float) -> float:
    """Positions at the end of the step; driven nodes are at their targets exactly. Gives the largest speed."""
    x, v, driven = state.x, state.v, model.driven
    fastest = total = farthest = 0.0
    if model.has_bone:
        move_bone(model, state, h)
    a, b, c = state.origin[0], state.origin[1], state.origin[2]
    for n in range(x.shape[0]):
        w = load4(v, n, 0)
        store4(x, n, 0, load4(x, n, 0) + w * h)
        p, q, r = x[n, 0] - a, x[n, 1] - b, x[n, 2] - c
        farthest = max(farthest, p * p + q * q + r * r)
        square = sum3(w * w)
        fastest = max(fastest, square)
        total += square
    if model.has_bone:
        place_driven(model, state)
    else:
        for d in range(driven.shape[0]):
            for i in range(3):
                x[driven[d], i] = targets[d, i]
    fastest = math.sqrt(fastest)
    state.result[REACH] = math.sqrt(farthest)
    state.clearance[0] -= h * fastest
    state.motion[0] = math.sqrt(total / x.shape[0])
    return fastest


@stage
def observe(model: Model, state: State, contacts: int, rows: int) -> None:
    """What the step reports, and the row forces that the next one starts from."""
    result = state.result
    status = int(result[STATUS])
    if model.has_plane:
        result[CONTACTS] = store_contact(model, state, contacts)
        result[PENETRATION] = deepest(model, state)
        if model.has_bone:
            for i in range(6):
                state.wrench[i] += state.yielding.stop[8] * state.yielding.stop[i]
    if model.projection != NONE:
        limits = observe_limits(model, state, contacts, rows)
        result[STRAIN_RATIO], result[LIMIT_ROWS], result[LIMITED_TETS], result[LOCKED_TETS] = limits
        if result[LOCKED_TETS] > 0.0 or result[LIMIT_ROWS] > 3 * model.free.shape[0]:
            status |= _LOCKED
        state.held_tets[0] = int(result[LIMITED_TETS])
    if result[STRAIN_RATIO] > _EXCEEDED:
        status |= _LIMIT_EXCEEDED
    if state.inverted[0] > 0:
        status |= _INVERTED
    result[STATUS] = status
