"""One step of the method, as the paper tells it in Section 4. Start here."""

from __future__ import annotations

import enum
from typing import TYPE_CHECKING

from ..arrays import Floats
from .compile import kernel, stage
from .contact import contact_rows, deepest, store_contact
from .elasticity import assemble
from .kinematics import kinematics
from .linear_solver import factor, solve
from .pgs import apply_rows, inverse_between, solve_rows, touched_nodes
from .strain_limits import NONE, limit_rows, strain_ratio

if TYPE_CHECKING:
    from .model import Model, State


class Status(enum.IntFlag):
    """What a step has to say; 0: all well."""

    OK = 0
    NONFINITE = 1  # the step gave a number that is not finite or beyond all bounds; it was not taken
    INVERTED = 2  # a tetrahedron is inside out
    ITERATION_LIMIT = 4  # the solver stopped before its tolerance: best iterate used
    STEP_REJECTED = 8  # the step was not taken; the body was moved rigidly with its bone, or stopped if it has none
    LOCKED = 16  # a tetrahedron has more rows at their limit than ways to deform
    ROW_LIMIT = 32  # more rows near their limit than the arrays hold: the others were left out
    COMMAND_LIMITED = 64  # the command moved faster than the coupling allows and is being caught up with


# Where `step` writes what it reports, in State.result.
STATUS, ITERATIONS, RESIDUAL, LIMIT_ROWS, LIMITED_TETS, STRAIN_RATIO, CONTACTS, PENETRATION = range(8)

_FARTHEST = 1e9  # tetrahedron sizes that a node may go in one step
_REJECTED = int(Status.NONFINITE | Status.STEP_REJECTED)
_ROW_LIMIT, _ITERATION_LIMIT = int(Status.ROW_LIMIT), int(Status.ITERATION_LIMIT)
_LOCKED, _INVERTED = int(Status.LOCKED), int(Status.INVERTED)


@kernel
def step(model: Model, state: State, targets: Floats, h: float) -> None:
    """Advance `state` by h [s]; what happened goes into state.result.

    targets (nd, 3): where the driven nodes are to be at the end [m], world.

    state.F, U, s, V hold the kinematics of the start (Eq. 1-4), those of the end are left for the next step.
    After STEP_REJECTED the positions are those of the start and the velocities are of no use: set both anew.
    """
    state.result[:] = 0.0
    drive(model, state, targets, h)

    assemble(model, state, h)  # A and b: backward Euler, forces linearised at the start
    definite = factor(model.pattern, state.A_diagonal, state.A_lower, state.A_inverse)
    free_velocity(model, state)  # v_free = A⁻¹ b: the unconstrained step

    status = 0
    contacts = rows = 0
    if model.has_plane:
        rows = contact_rows(model, state, h, rows)
        if rows < 0:
            rows, status = (state.lam.shape[0] // 3) * 3, status | _ROW_LIMIT
        contacts = rows
    if model.projection != NONE:
        rows = limit_rows(model, state, h, rows)  # Eq. 9-12, linearised (Eq. 13-18)
        if rows < 0:
            rows, status = state.lam.shape[0], status | _ROW_LIMIT
    if rows > 0:
        touched = touched_nodes(model, state, rows)
        inverse_between(model, state, touched)
        sweeps, residual = solve_rows(model, state, h, contacts, rows, touched)
        apply_rows(model, state, rows)  # v = v_free + h A⁻¹ Jᵀ λ
        state.result[ITERATIONS], state.result[RESIDUAL] = sweeps, residual
        if not residual <= model.tolerance:
            status |= _ITERATION_LIMIT

    if not (definite and bounded(state.v, _FARTHEST * model.length / h)):
        state.result[STATUS] = _REJECTED
        return
    integrate(model, state, targets, h)  # x += h v
    kinematics(model, state)
    state.result[STATUS] = status
    observe(model, state, contacts, rows)


@stage
def drive(model: Model, state: State, targets: Floats, h: float) -> None:
    """Velocities that take the driven nodes to their targets in this step."""
    for d in range(model.driven.shape[0]):
        n = model.driven[d]
        for i in range(3):
            state.v[n, i] = (targets[d, i] - state.x[n, i]) / h


@stage
def free_velocity(model: Model, state: State) -> None:
    """Unconstrained velocities of the free nodes into state.v."""
    solve(model.pattern, state.A_lower, state.A_inverse, state.rhs)
    for k in range(model.free.shape[0]):
        for i in range(3):
            state.v[model.free[k], i] = state.rhs[k, i]


@kernel
def bounded(v: Floats, bound: float) -> bool:
    """Whether no velocity is beyond `bound`; one that is not a number is."""
    for n in range(v.shape[0]):
        for i in range(3):
            if not abs(v[n, i]) <= bound:
                return False
    return True


@stage
def integrate(model: Model, state: State, targets: Floats, h: float) -> None:
    """Positions at the end of the step; driven nodes are at their targets exactly."""
    for n in range(state.x.shape[0]):
        for i in range(3):
            state.x[n, i] += h * state.v[n, i]
    for d in range(model.driven.shape[0]):
        for i in range(3):
            state.x[model.driven[d], i] = targets[d, i]


@stage
def observe(model: Model, state: State, contacts: int, rows: int) -> None:
    """What the step reports, and the row forces that the next one starts from."""
    result = state.result
    status = int(result[STATUS])
    if model.has_plane:
        result[CONTACTS] = store_contact(model, state, contacts)
        result[PENETRATION] = deepest(model, state)
    if model.projection != NONE:
        strain_ratio(model, state)
        state.warm_limit[:] = 0.0
        state.active_rows[:] = 0
        for row in range(contacts, rows):
            if state.lam[row] > 0.0:
                t, key = state.row_tet[row], state.row_key[row]
                state.active_rows[t] += 1
                stretched = state.row_side[row]
                state.warm_limit[t, key // 3, key % 3] = state.lam[row] * stretched
    for t in range(model.tets.shape[0]):
        active = state.active_rows[t]
        result[LIMIT_ROWS] += active
        if active > 0:
            result[LIMITED_TETS] += 1.0
            if active > min(6, 3 * model.tet_moves[t]):
                status |= _LOCKED
        result[STRAIN_RATIO] = max(result[STRAIN_RATIO], state.strain_ratio[t])
        s = state.s[t]
        if s[0] < 0.0 or s[1] < 0.0 or s[2] < 0.0:
            status |= _INVERTED
    result[STATUS] = status
