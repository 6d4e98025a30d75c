"""From commands to where the bone is wanted, a step at a time."""

from __future__ import annotations

import math

import numpy as np

from ..arrays import Floats
from ..errors import SceneError
from ..haptics.coupling import CommandSpeed, between, displacement, follow, stop_at_plane
from ..haptics.following import Follower
from ..scene import Coupling, Pose, Vec3
from .ground import Surface


class Drive:
    """Follows commands as the coupling says (haptics/following.py), no faster than it allows.

    command    : the last one heard
    follower   : its path through the commands
    start, end : where the bone is wanted at the start and at the end of the last step, world
    limited    : whether a speed limit, or the plane, held the bone back in it
    velocity   : (6,) of the bone as it is wanted [m/s, rad/s], world; zero where the coupling is kinematic

    centre: mean of the driven nodes, as the mesh has them [m]; None: the body is free, and follows nothing.
    Under a kinematic coupling that point does not pass the plane: the bone stops there.
    """

    def __init__(self, pose: Pose, centre: Vec3 | None, yields: bool) -> None:
        self._centre, self._yields = centre, yields
        self.follower = Follower(pose)
        self.rest(pose)

    def rest(self, pose: Pose, command: Pose | None = None) -> None:
        """At rest at `pose`, and on to `command`, which is the command from now on; None: `pose` is."""
        self.command = pose if command is None else command
        self.start = self.end = pose
        self.limited = False
        self.velocity: Floats = np.zeros(6)
        self._speed: CommandSpeed | None = None  # while held
        self.follower.rest(pose, self.command)

    def hear(self, command: Pose, received: float | None) -> None:
        """A command that came at a time [s], by which the next step begins; None: just as that begins."""
        self.command = command
        if self._centre is not None:
            self.follower.hear(command, received)

    def advance(self, coupling: Coupling, surface: Surface | None, now: float | None, dt: float) -> bool:
        """One step of `dt` that begins at a time [s]; whether the bone is wanted elsewhere, or with a speed.

        now: of the clock that commands are received by; None: dt after the last step began.
        """
        start, self.limited = self.end, False
        goal = self.follower.advance(coupling.following, now, dt)
        end = start
        if start is not goal:
            end, self.limited = follow(coupling, start, goal, dt)
            if surface is not None and self._centre is not None and not self._yields:
                end, stopped = stop_at_plane(*surface, self._centre, start, end)
                self.limited |= stopped
        self.start, self.end = start, end
        if self._yields:
            self._measure(coupling, dt)
        return end != start or bool(self.velocity.any())

    def at(self, part: float) -> Pose:
        """Where the bone is wanted after a part of the last step."""
        return between(self.start, self.end, part)

    def _measure(self, coupling: Coupling, dt: float) -> None:
        """The velocity in the last step: of a path as it is, of jumps their mean."""
        if coupling.following == "hold":
            self._speed = self._speed or CommandSpeed()
            self.velocity = self._speed.step(self.start, self.end, dt)
            return
        self._speed = None
        if self.end is not self.start:
            self.velocity = np.array(displacement(self.start, self.end)) / dt
        elif self.velocity.any():
            self.velocity = np.zeros(6)


def checked_time(time: float | None, name: str) -> float | None:
    """A time [s], if there is one. Raises SceneError where it is not finite."""
    if time is not None and not math.isfinite(time):
        raise SceneError(name, time, "a finite time [s]")
    return time
