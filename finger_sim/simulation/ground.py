"""The plane under the body: where it is, and how it follows targets that come less often than steps."""

from __future__ import annotations

import math

import numpy as np

from ..arrays import Floats
from ..errors import SceneError
from ..haptics.coupling import LONGEST_GAP, between, displacement, follow
from ..physics.contact import plane_frame
from ..physics.model import State
from ..physics.rotations import Quaternion, matrix, normalised
from ..scene import Coupling, Plane, Pose, Vec3, checked_pose

Surface = tuple[Vec3, Vec3]
"""Unit outward normal and a point [m] of a plane, world."""


class Ground:
    """Where a plane is, and how fast.

    surface : normal and point of the plane at the end of the last step
    pose    : the plane is the x-y plane of this pose, its z the outward normal, world; None before the first target
    twist   : (6,) velocity of the pose's origin [m/s] and angular velocity [rad/s] in the last step, world

    To each target the plane goes at an even speed in the time that passed since the one before, LONGEST_GAP at most
    (so that it moves steadily under targets that come steadily), no faster than the coupling's max_speed and
    max_angular_speed. To the first target, and to a plane set by `move`, it goes in LONGEST_GAP.
    """

    def __init__(self, plane: Plane) -> None:
        x, y, z = plane.unit_normal.tolist()
        self.surface: Surface = (x, y, z), plane.point
        self.pose: Pose | None = None
        self.twist: Floats = np.zeros(6)
        self._goal: Pose | None = None
        self._before: Pose | None = None
        self._since = self._left = 0.0
        self._anchored = False  # to the poses that targets give: until then origin and axes in the plane mean nothing

    @property
    def frame(self) -> Pose:
        """The plane is the x-y plane of this pose now, its z the outward normal, world; before any target too."""
        normal, point = self.surface
        return self.pose or Pose(point, _turned(normal))

    def advance(self, target: Pose | None, coupling: Coupling, dt: float) -> bool:
        """One step of `dt` [s], towards `target` from now on; whether the plane moves, or has just stopped."""
        if self.pose is None and target is None:
            return False
        self._since = min(self._since + dt, LONGEST_GAP)
        if target is not None:
            if not self._anchored:
                # Seen from its first target, so that no sliding within itself and no turn about its normal is a motion.
                self._begin(_nearest(target, self.surface))
                self._anchored = True
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
        self.surface = _surface(self.pose)
        return True

    def move(self, plane: Plane) -> None:
        """Go to another plane of the scene, from the next step on."""
        x, y, z = plane.unit_normal.tolist()
        if self.pose is None:
            normal, point = self.surface
            self._begin(Pose(point, _turned(normal)))
        assert self.pose is not None
        self._goal, self._left = _nearest(self.pose, ((x, y, z), plane.point)), LONGEST_GAP

    def arrive(self, target: Pose | None = None) -> None:
        """At rest where it is to go: at `target`, or at the last one."""
        if target is not None:
            self._goal, self._anchored = target, True
        if self._goal is not None:
            self.pose = self._before = self._goal
            self.surface = _surface(self._goal)
        self.twist = np.zeros(6)

    def write(self, state: State, part: float = 1.0, *, moving: bool = False) -> None:
        """The plane as it is after a part of the last step into the state of a body; `moving`: with its velocity."""
        normal, point = self.surface
        if moving and part != 1.0:
            assert self.pose is not None
            assert self._before is not None
            normal, point = _surface(between(self._before, self.pose, part))
        state.plane_frame[:], state.plane_point[:] = plane_frame(np.array(normal)), point
        state.plane_motion[:] = self.twist if moving else 0.0
        state.clearance[0] = -1.0

    def _begin(self, pose: Pose) -> None:
        """The plane has this pose, and no target yet: it goes to the first one as to any that comes after a pause."""
        self.pose = self._before = self._goal = pose
        self._since = LONGEST_GAP


def checked_target(ground: Ground | None, target: Pose | None) -> Pose | None:
    """A target with a unit quaternion; None where there is none. Raises SceneError, also where there is no plane."""
    if target is not None and ground is None:
        raise SceneError("plane", None, "a scene with a plane, to move it")
    return None if target is None else checked_pose(target, "plane")


def _surface(pose: Pose) -> Surface:
    x, y, z = matrix(pose.orientation)[:, 2].tolist()
    return (x, y, z), pose.position


def _nearest(pose: Pose, surface: Surface) -> Pose:
    """The pose of a plane that is the least way and turn from `pose`."""
    normal, point = surface
    own, _ = _surface(pose)
    distance = sum(n * (p - q) for n, p, q in zip(normal, pose.position, point, strict=True))
    x, y, z = (p - distance * n for p, n in zip(pose.position, normal, strict=True))
    if math.dist(own, normal) < _SAME_NORMAL:
        return Pose((x, y, z), pose.orientation)
    a, b, c, d = _turned(normal, own)
    e, f, g, h = pose.orientation
    turned = (
        d * e + a * h + b * g - c * f, d * f + b * h + c * e - a * g,
        d * g + c * h + a * f - b * e, d * h - a * e - b * f - c * g,
    )  # fmt: skip
    return Pose((x, y, z), normalised(turned))


_SAME_NORMAL = 1e-12
"""Unit normals nearer than this are one: what is left is rounding."""


def _turned(normal: Vec3, start: Vec3 = (0.0, 0.0, 1.0)) -> Quaternion:
    """The least rotation that takes the unit vector `start` to `normal`; from opposite ones, about any axis across."""
    a, b, c = start
    x, y, z = normal
    w = 1.0 + a * x + b * y + c * z
    if w < _SAME_NORMAL:
        least = min(range(3), key=lambda i: abs(start[i]))
        x, y, z = (1.0 if i == least else 0.0 for i in range(3))
        w = 0.0
    return normalised((b * z - c * y, c * x - a * z, a * y - b * x, w))
