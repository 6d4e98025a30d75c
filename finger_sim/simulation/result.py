"""`StepResult`: what one step gives."""

from __future__ import annotations

import dataclasses

from ..arrays import Floats
from ..physics import step as stepping
from ..physics.step import Status
from ..scene import Pose
from .touch import Touch

STATUSES = [Status(bits) for bits in range(sum(Status) + 1)]
"""A Status of each number: made anew in every step, it would cost as much as the rest of a StepResult."""


@dataclasses.dataclass(slots=True)  # frozen, each field of it would cost a call
class StepResult:
    """What one step gives. Wrenches are of the plane on the finger, world axes, about the finger frame's origin."""

    time: float  # end of the step [s]
    contact_wrench: Floats  # (6,) force [N] and torque [N m]
    device_wrench: Floats  # (6,) what a device is to render: clamped
    pose: Pose  # the simulated finger frame, world
    iterations: int  # solver sweeps
    residual: float  # see Solver.tolerance
    status: Status  # 0: all well
    limited_tets: int  # tetrahedra held by at least one limit
    limit_rows: int  # limit rows that carry a force
    locked_tets: int  # tetrahedra at a limit that are over-constrained: see physics/locking.py
    max_strain_ratio: float  # largest strain/limit, 1: exactly at the limit; 0 without limits
    contacts: int  # nodes that carry a contact force
    max_penetration: float  # deepest surface node [m], 0 when none
    asleep: bool = False  # nothing moved and nothing changed: the step was not computed
    touch: Touch | None = None  # area, centre and slip of the contact; None unless the Simulator was asked for it

    def later(self, time: float) -> StepResult:
        """The same of a body asleep, at another time."""
        return StepResult(
            time, self.contact_wrench.copy(), self.device_wrench.copy(), self.pose, 0, self.residual, self.status,
            self.limited_tets, self.limit_rows, self.locked_tets, self.max_strain_ratio, self.contacts,
            self.max_penetration, True, self.touch,
        )  # fmt: skip


def measured(result: list[float]) -> tuple[int, int, int, float, int, float]:
    """The fields from `limited_tets` to `max_penetration`, which the kernel itself tells, of State.result."""
    return (
        int(result[stepping.LIMITED_TETS]),
        int(result[stepping.LIMIT_ROWS]),
        int(result[stepping.LOCKED_TETS]),
        result[stepping.STRAIN_RATIO],
        int(result[stepping.CONTACTS]),
        result[stepping.PENETRATION],
    )
