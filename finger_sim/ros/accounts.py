"""What a loop keeps of its steps: recent times, and the worst of a window of steps. Compiled code writes into both."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np

from ..arrays import Floats, Ints
from ..physics import step as stepping
from ..physics.compile import stage
from ..physics.step import Status
from ..simulation.whole import Body

KEPT = 4096
"""Steps whose times are kept for percentiles: the last 4 s at 1 kHz, so that a report tells of the present."""
DOUBTFUL = ~Status.LOCKED
"""Status of a step that did not do what was asked. LOCKED alone is how limits of a scene hold tissue that keeps its
volume: the solver converged, the limits are met. Where they are not, ITERATION_LIMIT or LIMIT_EXCEEDED say so."""
MOST_TRANSPORT = 1.0
"""A command whose stamp is older than this, or younger than its receipt, was stamped by another clock [s]."""
_DOUBTFUL = int(DOUBTFUL)


class Recent(NamedTuple):
    """The last KEPT numbers, for percentiles; written by one thread, read by any.

    values : (KEPT,); number k lies in row k % KEPT
    number : (1,) of them so far
    """

    values: Floats
    number: Ints

    @classmethod
    def none(cls) -> Recent:
        """No number so far."""
        return cls(np.zeros(KEPT), np.zeros(1, np.int64))

    def add(self, value: float) -> None:
        """One number more."""
        self.values[int(self.number[0]) % KEPT] = value
        self.number[0] += 1

    def percentiles(self, *wanted: float) -> tuple[float, ...]:
        """The wanted percentiles [0, 100] of what is kept; zeros when nothing is."""
        kept = self.values[: min(int(self.number[0]), KEPT)]
        return tuple(float(p) for p in np.percentile(kept, wanted)) if len(kept) else (0.0,) * len(wanted)


@stage
def add(recent: Recent, value: float) -> None:
    """`Recent.add` in compiled code."""
    recent.values[recent.number[0] % KEPT] = value
    recent.number[0] += 1


class Counted(NamedTuple):
    """Numbers of a Window, (1,) each, as compiled code counts them. `most` : (6,) the largest of MOST."""

    steps: Ints
    asleep: Ints
    status: Ints
    troubled: Ints
    doubtful: Ints
    iterations: Ints
    residual: Floats
    most: Floats


MOST = (
    stepping.LIMIT_ROWS, stepping.LIMITED_TETS, stepping.LOCKED_TETS, stepping.CONTACTS, stepping.STRAIN_RATIO,
    stepping.PENETRATION,
)  # fmt: skip
"""Places in State.result of what a Window has the largest of."""


def nothing_counted() -> Counted:
    """Of no step."""
    steps, asleep, status, troubled, doubtful, iterations = np.zeros((6, 1), np.int64)
    return Counted(steps, asleep, status, troubled, doubtful, iterations, np.zeros(1), np.zeros(len(MOST)))


@stage
def count(counted: Counted, body: Body, asleep: bool) -> None:
    """One step more, as it left the body."""
    status = body.status[0]
    counted.steps[0] += 1
    counted.asleep[0] += 1 if asleep else 0
    if not asleep:
        counted.iterations[0] = max(counted.iterations[0], body.iterations[0])
    counted.residual[0] = max(counted.residual[0], body.residual[0])
    for k, place in enumerate(MOST):
        counted.most[k] = max(counted.most[k], body.result[place])
    if status != 0:
        counted.status[0] |= status
        counted.troubled[0] += 1
        counted.doubtful[0] += 1 if status & _DOUBTFUL != 0 else 0


@dataclasses.dataclass
class Window:
    """The worst of the steps since the last report."""

    steps: int = 0
    iterations: int = 0
    residual: float = 0.0
    limit_rows: int = 0
    limited_tets: int = 0
    locked_tets: int = 0
    contacts: int = 0
    asleep: int = 0
    max_strain_ratio: float = 0.0
    max_penetration: float = 0.0
    status: Status = Status.OK
    troubled: int = 0
    """Steps with a status bit set."""
    doubtful: int = 0
    """Steps with one of DOUBTFUL set."""

    @classmethod
    def of(cls, counted: Counted) -> Window:
        """What compiled code counted, which begins anew."""
        rows, tets, locked, contacts, strain, depth = counted.most.tolist()
        steps, asleep, status, troubled, doubtful, iterations = (int(numbers[0]) for numbers in counted[:6])
        window = cls(
            steps, iterations, float(counted.residual[0]), int(rows), int(tets), int(locked), int(contacts), asleep,
            strain, depth, Status(status), troubled, doubtful,
        )  # fmt: skip
        for numbers in counted:
            numbers[:] = 0
        return window
