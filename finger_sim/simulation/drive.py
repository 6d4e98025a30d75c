"""From commands to where the bone is wanted, a step at a time."""

from __future__ import annotations

import math

from numba import types

from ..arrays import Floats
from ..errors import SceneError
from ..haptics import leading
from ..haptics.following import MODES, Follower
from ..haptics.leading import AT_COMMAND, AT_GOAL, LIMITED, MOVES, STAYS, build_lead
from ..haptics.path import numbers, pose_of
from ..physics.records import direct, held
from ..scene import Coupling, Pose, Vec3
from .ground import Surface


class Drive:
    """Follows commands as the coupling says (haptics/following.py), no faster than it allows (haptics/leading.py).

    command    : the last one heard
    follower   : its path through the commands
    start, end : where the bone is wanted at the start and at the end of the last step, world
    limited    : whether a speed limit, or the plane, held the bone back in it
    velocity   : (6,) of the bone as it is wanted [m/s, rad/s], world; zero where the coupling is kinematic
    targets    : (n, 3) where the driven nodes are wanted after the part of the step that `at` was asked for [m], world;
                 as the mesh has them where the bone yields

    points: (n, 3) the driven nodes, as the mesh has them [m]; centre: their mean; None: the body is free, and follows
    nothing. Under a kinematic coupling that point does not pass the plane: the bone stops there.
    target: (13,) is written: the pose where the bone is wanted then, and the velocity.
    """

    def __init__(self, pose: Pose, points: Floats, centre: Vec3 | None, yields: bool, target: Floats) -> None:
        self._free, self._yields = centre is None, yields
        self.follower = Follower(pose)
        self._lead = build_lead(self.follower.course, points, target)
        self._lead.centre[:] = (0.0, 0.0, 0.0) if centre is None else centre
        self._lead.yields[0] = yields
        self.velocity, self.targets = self._lead.velocity, self._lead.targets
        self._held = held(self._lead)
        number = types.float64
        self._advance = direct(leading.advance, self._held, types.int64, number, number, number)
        self._put = direct(leading.put, self._held, number)
        self._coupling: Coupling | None = None
        self._surface: Surface | None = None
        self._mode = 0
        self.rest(pose)

    def rest(self, pose: Pose, command: Pose | None = None) -> None:
        """At rest at `pose`, and on to `command`, which is the command from now on; None: `pose` is."""
        self.command = pose if command is None else command
        self.start = self.end = pose
        self.limited, self._part = False, 1.0
        lead = self._lead
        lead.start[:] = lead.end[:] = numbers(pose)
        lead.velocity[:] = lead.jumps[0] = 0.0
        self._put(self._held, self._part)
        self.follower.rest(pose, self.command)

    def hear(self, command: Pose, received: float | None) -> None:
        """A command that came at a time [s], by which the next step begins; None: just as that begins."""
        self.command = command
        if not self._free:
            self.follower.hear(command, received)

    def advance(
        self, coupling: Coupling, surface: Surface | None, now: float | None, dt: float, part: float = 1.0
    ) -> bool:
        """One step of `dt` that begins at a time [s]; whether the bone is wanted elsewhere, or with a speed.

        now: of the clock that commands are received by; None: dt after the last step began.
        part: of the step, that `at` will be asked for first.
        """
        if coupling is not self._coupling or surface is not self._surface:
            self._allow(coupling, surface)
        told: int = self._advance(self._held, self._mode, math.nan if now is None else now, dt, part)
        follower = self.follower
        follower.arrived(told & AT_GOAL != 0)
        self.start, self._part, self.limited = self.end, part, told & LIMITED != 0
        if not told & STAYS:
            self.end = follower.last if told & AT_COMMAND else pose_of(self._lead.end)
        return told & MOVES != 0

    def at(self, part: float) -> Pose:
        """Where the bone is wanted after a part of the last step; its nodes are in `targets` then."""
        if part != self._part:
            self._part = part
            self._put(self._held, part)
        return self.end if part == 1.0 else pose_of(self._lead.wanted)

    def _allow(self, coupling: Coupling, surface: Surface | None) -> None:
        """What may have changed since the last step."""
        lead, self._coupling, self._surface = self._lead, coupling, surface
        self._mode = MODES[coupling.following]
        lead.fastest[:] = coupling.max_speed, coupling.max_angular_speed
        lead.stops[0] = surface is not None and not self._free and not self._yields
        if surface is not None:
            lead.normal[:], lead.point[:] = surface


def checked_time(time: float | None, name: str) -> float | None:
    """A time [s], if there is one. Raises SceneError where it is not finite."""
    if time is not None and not math.isfinite(time):
        raise SceneError(name, time, "a finite time [s]")
    return time
