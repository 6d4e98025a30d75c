"""One step of `Scene.dt` in compiled code: plane, bone, substeps, and what is to become of the body.

    plane → bone (haptics/leading.py) → asleep? → substeps (physics/step.py) → goes on, sleeps, or begins anew

What is rare is left to who called: `advance` returns before it, with a reason, and is called again to go on.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ..arrays import Floats, Ints
from ..haptics import carrying, leading
from ..haptics.carrying import Table
from ..haptics.coupling import height
from ..haptics.leading import LIMITED, MOVES, Lead
from ..haptics.path import read, write
from ..physics import step as stepping
from ..physics.clock import STAGES, seconds
from ..physics.compile import kernel, stage
from ..physics.contact import plane_frame
from ..physics.model import Model, State
from ..physics.ready import step_at
from ..physics.records import side_by_side
from ..physics.step import Status
from .guard import GOES_ON, SLEEPS, Guard, awake, broken, judge, relaxed

DONE, FALLS_ASLEEP, ASLEEP, TO_RESTORE, SUNK, REJECTED, BROKEN = range(7)
"""Why `advance` returned. The step is done: the body goes on, or has fallen asleep; or it sleeps, and nothing was
computed. Or the step is to go on, once that is mended: the body rages, or rests inside out; a bone that yields is in
the plane; the last substep was rejected; the body is beyond repair."""
TO_MEND = (TO_RESTORE, SUNK, REJECTED, BROKEN)
"""Those after which it is to go on."""
FIRST, AFTER_PLANE = -1, 0
"""Where `advance` is to begin: at the start, after the plane has moved, or after so many substeps."""

_REJECTED, _RESTORED = int(Status.STEP_REJECTED), int(Status.RESTORED)
_COMMAND_LIMITED = int(Status.COMMAND_LIMITED)
_TIMED = len(STAGES)


class Body(NamedTuple):
    """A body in its scene, for compiled code; (1,) each, unless said.

    pose       : (7,) of the simulated finger frame, world, as it is now
    before     : (7,) that at the start of the last substep
    result     : State.result of the last substep
    residual   : the worst of the step's substeps
    dt         : of a step [s]
    steps      : since the last reset
    mode       : number of the mode of following
    done       : substeps of the step that are done
    substeps   : of a step
    status     : of the step so far; while the body sleeps, of the last one that was computed
    iterations : of the step so far
    restored   : 1 where the body was put back in the step
    moves      : whether bone or plane move in the step
    shifts     : whether the plane does
    """

    pose: Floats
    before: Floats
    result: Floats
    residual: Floats
    dt: Floats
    steps: Ints
    mode: Ints
    done: Ints
    substeps: Ints
    status: Ints
    iterations: Ints
    restored: Ints
    moves: Ints
    shifts: Ints
    lead: Lead
    table: Table
    guard: Guard


def build_body(lead: Lead, table: Table, guard: Guard, result: Floats) -> Body:
    """result: State.result, for its size."""
    floats = ("pose", "before", "result", "residual", "dt")
    parts: dict[str, Any] = {"lead": lead, "table": table, "guard": guard}
    numbers = {name: np.zeros(1, np.int64) for name in Body._fields if name not in (*floats, *parts)}
    sizes = dict.fromkeys((*numbers, *parts), 0)
    fields = side_by_side(Body, pose=7, before=7, result=len(result), **sizes)
    return Body(**{**fields, **numbers, **parts})


@kernel
def advance(address: int, model: Model, state: State, body: Body, now: float, begin: int) -> int:
    """One step that begins at a time [s] (NaN: dt after the last one began), or the rest of it; why it returned.

    address: of step.step, for `step_at`. begin: FIRST, AFTER_PLANE, or the number of substeps that are done.
    """
    lead, table, guard = body.lead, body.table, body.guard
    dt, substeps = body.dt[0], body.substeps[0]
    h = dt / substeps
    if begin == FIRST:
        body.steps[0] += 1
        body.shifts[0], body.restored[0] = 0, 0
        if table.exists[0] != 0.0 and carrying.advance(table, dt):
            body.shifts[0] = 1
            if lead.yields[0] != 0.0 and height(table.normal, table.point, lead.centre, read(body.pose)) < 0.0:
                return SUNK
    if begin <= AFTER_PLANE and not _set_out(state, body, now):
        return ASLEEP
    for done in range(max(begin, 0), substeps):
        _prepare(state, body, done)
        step_at(address, model, state, lead.targets, h)
        why = _take(state, body, h)
        body.done[0] = done + 1
        if why != DONE:
            return why
    if body.restored[0] != 0:
        body.status[0] |= _RESTORED
    verdict = judge(guard, body.status[0], body.result, body.moves[0] != 0, not relaxed(state), dt)
    return DONE if verdict == GOES_ON else FALLS_ASLEEP if verdict == SLEEPS else TO_RESTORE


@stage
def _set_out(state: State, body: Body, now: float) -> bool:
    """Where the bone is wanted in the step; whether it is to be computed."""
    guard, dt = body.guard, body.dt[0]
    told = leading.advance(body.lead, body.mode[0], now, dt, 1.0 / body.substeps[0])
    moves, slept = told & MOVES != 0 or body.shifts[0] != 0, guard.slept[0]
    body.moves[0] = moves
    if not awake(guard, moves):
        return False
    state.held[0] += slept * dt
    state.moves[0] = moves
    body.status[0] = _COMMAND_LIMITED if told & LIMITED else 0
    body.iterations[0], body.residual[0] = 0, 0.0
    return True


@stage
def _prepare(state: State, body: Body, done: int) -> None:
    """Bone and plane at the end of the next substep, after so many of them."""
    lead, table, pose = body.lead, body.table, body.pose
    part = (done + 1) / body.substeps[0]
    write(body.before, read(pose))
    if done > 0:
        leading.put(lead, part)
    if lead.driven[0] != 0.0 and lead.yields[0] == 0.0:
        write(pose, read(lead.wanted))
    for i in range(3):
        state.origin[i] = pose[i]
    if body.shifts[0] != 0:
        carrying.place(table, part, state.plane_frame[0], state.plane_point)
        plane_frame(state.plane_frame[0], state.plane_frame)
        for i in range(6):
            state.plane_motion[i] = table.twist[i]
        state.clearance[0] = -1.0
    if state.laps.shape[0] > 0:
        state.laps[_TIMED] = seconds(state.time)


@stage
def _take(state: State, body: Body, h: float) -> int:
    """What a substep of h [s] came to; why the step cannot go on, or DONE."""
    result = state.result
    for i in range(result.shape[0]):
        body.result[i] = result[i]
    status = int(result[stepping.STATUS])
    body.status[0] |= status
    body.iterations[0] += int(result[stepping.ITERATIONS])
    if result[stepping.RESIDUAL] > body.residual[0]:
        body.residual[0] = result[stepping.RESIDUAL]
    rejected = status & _REJECTED != 0
    if body.lead.yields[0] != 0.0 and not rejected:
        for i in range(7):
            body.pose[i] = state.bone[i]
    if broken(body.guard, status, result, h):
        return BROKEN
    return REJECTED if rejected else DONE


KERNELS = (advance,)
"""What a Simulator calls."""
