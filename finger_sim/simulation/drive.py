"""From commands to where the bone is wanted, a step at a time."""

from __future__ import annotations

import numpy as np

from ..arrays import Floats
from ..haptics.coupling import CommandSpeed, between, follow, stop_at_plane
from ..scene import Coupling, Pose, Vec3
from .ground import Surface


class Drive:
    """Follows commands no faster than the coupling allows.

    start, end : where the bone is wanted at the start and at the end of the last step, world
    limited    : whether a speed limit, or the plane, held the bone back in it
    velocity   : (6,) of the commands [m/s, rad/s], world; zero where the coupling is kinematic

    centre: mean of the driven nodes, as the mesh has them [m]; None: the body is free, and follows nothing.
    Under a kinematic coupling that point does not pass the plane: the bone stops there.
    """

    def __init__(self, pose: Pose, centre: Vec3 | None, yields: bool) -> None:
        self._centre, self._yields = centre, yields
        self.command = self.start = self.end = pose
        self.limited = False
        self.velocity: Floats = np.zeros(6)
        self._speed = CommandSpeed()

    def rest(self, pose: Pose) -> None:
        """At rest at `pose`, which is the command from now on."""
        self.command = self.start = self.end = pose
        self.limited = False
        self.velocity, self._speed = np.zeros(6), CommandSpeed()

    def advance(self, command: Pose | None, coupling: Coupling, surface: Surface | None, dt: float) -> bool:
        """One step of `dt` [s], after `command` from now on; whether the bone is wanted elsewhere, or with a speed."""
        if command is not None:
            self.command = command
        start, self.limited = self.end, False
        end = start
        if self._centre is not None and start is not self.command:
            end, self.limited = follow(coupling, start, self.command, dt)
            if surface is not None and not self._yields:
                end, stopped = stop_at_plane(*surface, self._centre, start, end)
                self.limited |= stopped
        self.start, self.end = start, end
        if not self._yields:
            return end != start
        self.velocity = self._speed.step(start, end, dt)
        return end != start or bool(self.velocity.any())

    def at(self, part: float) -> Pose:
        """Where the bone is wanted after a part of the last step."""
        return between(self.start, self.end, part)
