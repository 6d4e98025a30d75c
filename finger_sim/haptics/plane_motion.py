"""A plane that moves: from targets that come less often than steps to a pose and a velocity in each step."""

from __future__ import annotations

import numpy as np

from ..arrays import Floats
from ..physics.rotations import matrix
from ..scene import Coupling, Pose, Vec3
from .coupling import LONGEST, between, displacement, follow


class PlaneMotion:
    """Where a moving plane is, and how fast.

    pose  : the plane is the x-y plane of this pose, its z the outward normal, world; None before the first target
    twist : (6,) velocity of the pose's origin [m/s] and angular velocity [rad/s] in the last step, world

    The first target is where the plane is put. To each later one it goes at an even speed in the time that passed since
    the one before, LONGEST at most (so that it moves steadily under targets that come steadily), no faster than the
    coupling's max_speed and max_angular_speed.
    """

    def __init__(self) -> None:
        self.pose: Pose | None = None
        self.twist: Floats = np.zeros(6)
        self._goal: Pose | None = None
        self._before: Pose | None = None
        self._since = self._left = 0.0

    def step(self, target: Pose | None, coupling: Coupling, dt: float) -> bool:
        """One step of `dt` [s]; whether the plane is elsewhere, or otherwise fast, than after the one before."""
        self._since = min(self._since + dt, LONGEST)
        if target is not None:
            if self.pose is None:
                self.pose = self._goal = self._before = target
                self._since = 0.0
                return True
            self._goal, self._left, self._since = target, self._since, 0.0
        if self.pose is None or self._goal is None:
            return False
        if self.pose == self._goal:
            stops = bool(self.twist.any())
            self.twist, self._before = np.zeros(6), self.pose
            return stops
        before = self._before = self.pose
        part = min(1.0, dt / self._left) if self._left > 1.5 * dt else 1.0
        self.pose, _ = follow(coupling, before, between(before, self._goal, part), dt)
        self._left -= dt
        self.twist = np.array(displacement(before, self.pose)) / dt
        return True

    def surface(self, part: float = 1.0) -> tuple[Vec3, Vec3]:
        """Unit normal and a point [m] of the plane after a part of the last step; not before the first target."""
        assert self.pose is not None
        assert self._before is not None
        pose = between(self._before, self.pose, part)
        x, y, z = matrix(pose.orientation)[:, 2].tolist()
        return (x, y, z), pose.position
