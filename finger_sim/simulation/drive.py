"""Commands for the bone, and where it is wanted; compiled code leads it (haptics/leading.py)."""

from __future__ import annotations

import math

from numba import types

from ..arrays import Floats
from ..errors import SceneError
from ..haptics import leading
from ..haptics.carrying import Table
from ..haptics.following import Follower
from ..haptics.leading import build_lead
from ..haptics.path import numbers, pose_of
from ..physics.records import direct, held
from ..scene import Coupling, Pose, Vec3


class Drive:
    """Follows commands as the coupling says, no faster than it allows.

    follower : its path through the commands
    lead     : what it knows, for compiled code

    points: (n, 3) the driven nodes, as the mesh has them [m]; centre: their mean; None: the body is free, and follows
    nothing. Under a kinematic coupling that point does not pass the plane of `table`: the bone stops there.
    target: (13,) is written: the pose where the bone is wanted then, and the velocity.
    """

    def __init__(
        self, pose: Pose, points: Floats, centre: Vec3 | None, yields: bool, target: Floats, table: Table
    ) -> None:
        self.follower = Follower(pose)
        self.lead = build_lead(self.follower.course, points, target, (table.normal, table.point))
        self.lead.centre[:] = (0.0, 0.0, 0.0) if centre is None else centre
        self.lead.driven[0], self.lead.yields[0] = centre is not None, yields
        self.lead.stops[0] = table.exists[0] != 0.0 and centre is not None and not yields
        self._held = held(self.lead)
        self._put = direct(leading.put, self._held, types.float64)
        self.rest(pose)

    @property
    def command(self) -> Pose:
        """The last one heard, or where the body was put."""
        return self.follower.last

    @property
    def end(self) -> Pose:
        """Where the bone is wanted at the end of the last step."""
        return pose_of(self.lead.end)

    def allow(self, coupling: Coupling) -> None:
        """How fast it goes from now on: as the coupling allows."""
        self.lead.fastest[:] = coupling.max_speed, coupling.max_angular_speed

    def rest(self, pose: Pose, command: Pose | None = None) -> None:
        """At rest at `pose`, and on to `command`, which is the command from now on; None: `pose` is."""
        lead = self.lead
        lead.start[:] = lead.end[:] = numbers(pose)
        lead.velocity[:] = lead.jumps[0] = 0.0
        self._put(self._held, 1.0)
        self.follower.rest(pose, command)

    def hear(self, command: Pose, received: float | None) -> None:
        """A command that came at a time [s], by which the next step begins; None: just as that begins."""
        if self.lead.driven[0] != 0.0:
            self.follower.hear(command, received)


def checked_time(time: float | None, name: str) -> float | None:
    """A time [s], if there is one. Raises SceneError where it is not finite."""
    if time is not None and not math.isfinite(time):
        raise SceneError(name, time, "a finite time [s]")
    return time
