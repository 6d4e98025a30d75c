"""What a body is let do: sleep at rest, and begin anew where it is beyond repair."""

from __future__ import annotations

from typing import NamedTuple

from ..arrays import Floats
from ..physics.compile import stage
from ..physics.model import State
from ..physics.records import side_by_side
from ..physics.step import CONTACTS, REACH, SPEED, Status

STILL, STILL_TIME = 1e-6, 0.01
"""A body is at rest when for so long [s] no node was faster than this part of the tetrahedra's size a second."""
RELAXED = 1e-5
"""Nor may it sleep while its stress relaxes: the strain that it has of the past fades by no more than this a second. A
tetrahedron strains by several times what its nodes move by, so this is more than STILL."""
MOST_REJECTIONS = 20
"""Steps rejected in a row that restore a body: one that moved rigidly with its bone for so long does not come back."""
TORN = 30.0
"""Distance from the finger frame's origin, over the largest at rest, at which a body is torn: far past any stretch that
a soft body under test came back from, near enough that numbers still have digits left."""
RAGING, RAGING_TIME = 20.0, 0.25
"""Speed in tetrahedra's sizes a second, and how long [s], of a body that swings without end though nothing moves it.

Less of either takes bodies away that would still come to rest; more of them shows a user noise for longer."""

INSIDE_OUT_TIME = 5.0
"""How long [s] tetrahedra may be inside out in a body that nothing touches or moves, however slowly it swings."""

_REJECTED, _INVERTED = int(Status.STEP_REJECTED), int(Status.INVERTED)
_STRAINED = int(Status.INVERTED | Status.LIMIT_EXCEEDED)
_UNSETTLED = int(Status.STEP_REJECTED | Status.COMMAND_LIMITED)


GOES_ON, SLEEPS, RESTORED = range(3)
"""What is to become of a body after a step."""


class Guard(NamedTuple):
    """Watches a body from step to step, in compiled code; (1,) each.

        ┌────────┐   at rest for STILL_TIME    ┌────────┐
        │        │ ──────────────────────────► │        │
        │ awake  │                             │ asleep │
        │        │ ◄────────────────────────── │        │
        └────────┘  something moves, or wake() └────────┘
          │    ▲
          │    │ undeformed, at rest, where the bone is
          ▼    │
        ┌──────────┐   after MOST_REJECTIONS in a row; torn to TORN times its size;
        │ restored │   inside out and at rest for STILL_TIME; raging for RAGING_TIME:
        └──────────┘   strained, fast, and nothing touches or moves it;
                       inside out for INSIDE_OUT_TIME while nothing does

    still_speed  : up to which a body is at rest [m/s]
    raging_speed : from which it may rage [m/s]
    torn         : distance from the finger frame's origin from which it is torn [m]
    driven       : 1 where it has a bone
    sleeps       : 1 where the scene lets bodies sleep
    still, raging, inverted, rejections : steps in a row, up to now
    asleep       : 1 while it is
    slept        : steps that were not computed since the body fell asleep
    """

    still_speed: Floats
    raging_speed: Floats
    torn: Floats
    driven: Floats
    sleeps: Floats
    still: Floats
    raging: Floats
    inverted: Floats
    rejections: Floats
    asleep: Floats
    slept: Floats


def build_guard(length: float, reach: float, *, driven: bool, sleeps: bool) -> Guard:
    """length: cube root of the mean tetrahedron volume [m]; reach: largest distance of a node at rest from the mesh's
    origin [m]; sleeps: whether the scene lets bodies sleep.
    """
    guard = Guard(**side_by_side(Guard))
    guard.still_speed[0], guard.raging_speed[0], guard.torn[0] = STILL * length, RAGING * length, TORN * reach
    guard.driven[0], guard.sleeps[0] = driven, sleeps
    return guard


def wake(guard: Guard) -> None:
    """Something was changed from outside: compute the next step, and judge anew."""
    guard.asleep[0] = guard.still[0] = guard.raging[0] = guard.inverted[0] = 0.0


@stage
def awake(guard: Guard, moves: bool) -> bool:
    """One step; `moves`: whether bone or plane do. Whether it has to be computed."""
    if moves:
        guard.asleep[0] = 0.0
    guard.slept[0] = guard.slept[0] + 1.0 if guard.asleep[0] != 0.0 else 0.0
    return bool(guard.asleep[0] == 0.0)


@stage
def broken(guard: Guard, status: int, result: Floats, h: float) -> bool:
    """Whether a body is beyond repair after a substep of h [s]. result: State.result; status: what it came to.

    A free body's frame is that of the step before, so that it may be further from it by one step's way.
    """
    guard.rejections[0] = guard.rejections[0] + 1.0 if status & _REJECTED else 0.0
    far = guard.torn[0] + (0.0 if guard.driven[0] != 0.0 else h * result[SPEED])
    return bool(guard.rejections[0] >= MOST_REJECTIONS or result[REACH] > far)


@stage
def relaxed(state: State) -> bool:
    """Whether no stress relaxes any more: the slowest term has settled."""
    rate = state.relaxing.rate
    return bool(rate.shape[0] == 0 or rate[0] <= RELAXED)


@stage
def judge(guard: Guard, status: int, result: Floats, moves: bool, relaxes: bool, dt: float) -> int:
    """What is to become of the body after a step of dt [s]. result: State.result of its last substep."""
    speed, alone = result[SPEED], not moves and not result[CONTACTS] > 0.0
    rages = status & _STRAINED != 0 and alone and speed > guard.raging_speed[0]
    guard.raging[0] = guard.raging[0] + 1.0 if rages else 0.0
    guard.inverted[0] = guard.inverted[0] + 1.0 if alone and status & _INVERTED else 0.0
    rests = speed <= guard.still_speed[0] and not moves and not relaxes and status & _UNSETTLED == 0
    guard.still[0] = guard.still[0] + 1.0 if rests else 0.0
    if guard.raging[0] * dt >= RAGING_TIME or guard.inverted[0] * dt >= INSIDE_OUT_TIME:
        return RESTORED
    if guard.still[0] * dt < STILL_TIME:
        return GOES_ON
    if status & _INVERTED and alone:
        return RESTORED
    guard.asleep[0] = guard.sleeps[0]
    return SLEEPS if guard.asleep[0] != 0.0 else GOES_ON
