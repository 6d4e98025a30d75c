"""What a body is let do: sleep at rest, and begin anew where it is beyond repair."""

from __future__ import annotations

import enum

from ..physics.step import CONTACTS, REACH, SPEED, Status

STILL, STILL_TIME = 1e-6, 0.01
"""A body is at rest when for so long [s] no node was faster than this part of the tetrahedra's size a second."""
MOST_REJECTIONS = 20
"""Steps rejected in a row that restore a body: one that moved rigidly with its bone for so long does not come back."""
TORN = 30.0
"""Distance from the finger frame's origin, over the largest at rest, at which a body is torn: far past any stretch that
a soft body under test came back from, near enough that numbers still have digits left."""
RAGING, RAGING_TIME = 20.0, 0.25
"""Speed in tetrahedra's sizes a second, and how long [s], of a body that swings without end though nothing moves it.

Less of either takes bodies away that would still come to rest; more of them shows a user noise for longer."""

_REJECTED, _INVERTED = int(Status.STEP_REJECTED), int(Status.INVERTED)
_STRAINED = int(Status.INVERTED | Status.LIMIT_EXCEEDED)
_UNSETTLED = int(Status.STEP_REJECTED | Status.COMMAND_LIMITED)


class Verdict(enum.Enum):
    """What is to become of a body after a step."""

    GOES_ON = enum.auto()
    SLEEPS = enum.auto()
    RESTORED = enum.auto()


class Guard:
    """Watches a body from step to step.

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
        └──────────┘   strained, fast, and nothing touches or moves it

    length: cube root of the mean tetrahedron volume [m]; reach: largest distance of a node at rest from the mesh's
    origin [m]; sleeps: whether the scene lets bodies sleep.
    """

    def __init__(self, length: float, reach: float, *, driven: bool, sleeps: bool) -> None:
        self._still_speed, self._raging_speed = STILL * length, RAGING * length
        self._torn, self._driven, self._sleeps = TORN * reach, driven, sleeps
        self._still = self._raging = 0  # steps in a row, up to now
        self._rejections = 0
        self.asleep = False
        self.slept = 0
        """Steps that were not computed since the body fell asleep."""

    def wake(self) -> None:
        """Something was changed from outside: compute the next step, and judge anew."""
        self.asleep = False
        self._still = self._raging = 0

    def advance(self, moves: bool) -> bool:
        """One step; `moves`: whether bone or plane do. Whether it has to be computed."""
        if moves:
            self.asleep = False
        self.slept = self.slept + 1 if self.asleep else 0
        return not self.asleep

    def broken(self, status: int, result: list[float], h: float) -> bool:
        """Whether a body is beyond repair after a substep of h [s]. result: State.result; status: what it came to.

        A free body's frame is that of the step before, so that it may be further from it by one step's way.
        """
        self._rejections = self._rejections + 1 if status & _REJECTED else 0
        far = self._torn + (0.0 if self._driven else h * result[SPEED])
        return self._rejections >= MOST_REJECTIONS or result[REACH] > far

    def restored(self) -> None:
        """The body begins anew."""
        self._rejections = 0
        self.wake()

    def judge(self, status: int, result: list[float], moves: bool, dt: float) -> Verdict:
        """What is to become of the body after a step of dt [s]. result: State.result of its last substep."""
        speed, touches = result[SPEED], result[CONTACTS] > 0
        rages = status & _STRAINED and not touches and speed > self._raging_speed and not moves
        self._raging = self._raging + 1 if rages else 0
        rests = speed <= self._still_speed and not moves and not status & _UNSETTLED
        self._still = self._still + 1 if rests else 0
        if self._raging * dt >= RAGING_TIME:
            return Verdict.RESTORED
        if self._still * dt < STILL_TIME:
            return Verdict.GOES_ON
        if status & _INVERTED and not touches:
            return Verdict.RESTORED
        self.asleep = self._sleeps
        return Verdict.SLEEPS if self.asleep else Verdict.GOES_ON
