"""Command → bone, and what a device is asked to render.

Kinematic coupling: the driven nodes follow the commanded pose exactly. Virtual coupling: they are a rigid body on a
damped spring to it (physics/bone.py). Both no faster than the scene allows, so that a jump of the command (a tracker
that re-acquires, a first message from afar) gives a bounded motion. How commands become a path: following.py.
"""

from __future__ import annotations

import math

import numpy as np

from ..arrays import Floats
from ..physics.rotations import angle, rotation_vector, slerp
from ..scene import Coupling, Pose, Vec3, place

LONGEST_GAP = 0.1
"""Most time that a command, or a target of the plane, counts as having taken since the one before [s]."""

TOUCHING = 1e-6
"""Depth up to which a body at rest only touches a plane [m]."""


def follow(coupling: Coupling, pose: Pose, command: Pose, dt: float) -> tuple[Pose, bool]:
    """The pose after `dt` [s] on the way from `pose` to `command`, and whether a speed limit held it back."""
    fraction = 1.0
    distance = math.dist(pose.position, command.position)
    turn = angle(pose.orientation, command.orientation) if pose.orientation != command.orientation else 0.0
    if distance > coupling.max_speed * dt:
        fraction = coupling.max_speed * dt / distance
    if turn > coupling.max_angular_speed * dt:
        fraction = min(fraction, coupling.max_angular_speed * dt / turn)
    return (command, False) if fraction == 1.0 else (between(pose, command, fraction), True)


def stop_at_plane(normal: Vec3, point: Vec3, centre: Vec3, start: Pose, end: Pose) -> tuple[Pose, bool]:
    """Where a bone comes on its way from `start` to `end`, its centre not past the plane; whether that stopped it.

    normal: unit, outward; point: of the plane [m], world. centre: the mean of the driven nodes, as read [m].
    A bone that is past the plane already may not go deeper.
    """
    after = _height(normal, point, centre, end)
    if after >= 0.0:
        return end, False
    before = _height(normal, point, centre, start)
    if after >= before:
        return end, False
    return between(start, end, before / (before - after) if before > 0.0 else 0.0), True


def set_down(normal: Vec3, point: Vec3, centre: Vec3, skin: Floats, pose: Pose) -> Pose:
    """`pose`, or where the bone's centre is past the plane there: the one right above it whose skin touches the plane.

    For a bone that yields: contact would throw it out at its depth over dt. skin: see `outside`.
    """
    return pose if _height(normal, point, centre, pose) >= 0.0 else outside(normal, point, skin, pose)


def outside(normal: Vec3, point: Vec3, skin: Floats, pose: Pose) -> Pose:
    """`pose`, or where a body at rest would be in the plane there: the one right above it where it touches the plane.

    normal: unit, outward; point: of the plane [m], world. skin: (n, 3) nodes that meet the plane, as read [m].
    """
    depth = float(np.dot(normal, point) - (place(skin, pose) @ np.array(normal)).min(initial=math.inf))
    if not depth > TOUCHING:
        return pose
    x, y, z = (c + depth * n for c, n in zip(pose.position, normal, strict=True))
    return Pose((x, y, z), pose.orientation)


def _height(normal: Vec3, point: Vec3, centre: Vec3, pose: Pose) -> float:
    """Of the bone's centre over the plane [m]."""
    x, y, z, w = pose.orientation
    a, b, c = centre
    s, t, u = 2.0 * (y * c - z * b), 2.0 * (z * a - x * c), 2.0 * (x * b - y * a)
    (n0, n1, n2), (p0, p1, p2), (q0, q1, q2) = normal, pose.position, point
    return (
        n0 * (a + w * s + y * u - z * t + p0 - q0)
        + n1 * (b + w * t + z * s - x * u + p1 - q1)
        + n2 * (c + w * u + x * t - y * s + p2 - q2)
    )


def between(a: Pose, b: Pose, fraction: float) -> Pose:
    """The pose `fraction` of the way from a to b: position on the line, orientation on the shorter arc."""
    if fraction == 1.0:
        return b
    x, y, z = (p + fraction * (q - p) for p, q in zip(a.position, b.position, strict=True))
    return Pose((x, y, z), slerp(a.orientation, b.orientation, fraction))


class CommandSpeed:
    """Velocity of a command that comes in jumps, less often than steps.

    A jump's size over the time since the one before, for as long as that took and half as long again, so that commands
    which come regularly but for some jitter give a steady velocity; then zero. A jump after LONGEST_GAP of rest counts
    as having taken that.
    """

    def __init__(self) -> None:
        self.value: Floats = np.zeros(6)
        self._since = self._holds = 0.0

    def step(self, before: Pose, after: Pose, dt: float) -> Floats:
        """(6,) linear [m/s] and angular [rad/s] velocity, world, at the end of a step of `dt` [s]."""
        self._since += dt
        if after != before:
            took = min(self._since, LONGEST_GAP)
            self.value = np.array(displacement(before, after)) / took
            self._holds, self._since = 1.5 * took, 0.0
        elif self._since > self._holds:
            self.value = np.zeros(6)
        return self.value


def displacement(start: Pose, end: Pose) -> tuple[float, float, float, float, float, float]:
    """From pose to pose: way [m] and rotation vector [rad], world axes; the shorter turn."""
    a, b, c = start.position
    x, y, z = end.position
    return (x - a, y - b, z - c, *rotation_vector(start.orientation, end.orientation))


def spring_wrench(on_bone: Floats, bone: Pose, command: Pose) -> Floats:
    """(6,) wrench [N, N m] of a coupling on the device, about the commanded point.

    on_bone: its wrench on the bone, about the bone's origin; all in world axes.
    """
    out = -on_bone
    out[3:] += np.cross(np.array(bone.position) - np.array(command.position), out[:3])
    return out


def device_wrench(coupling: Coupling, wrench: Floats) -> Floats:
    """A wrench (6,) [N, N m], its force and torque each scaled back to the coupling's limits."""
    a, b, c, d, e, f = wrench.tolist()
    force, torque = math.hypot(a, b, c), math.hypot(d, e, f)
    if force <= coupling.force_limit and torque <= coupling.torque_limit:
        return wrench.copy()
    p, q = min(1.0, coupling.force_limit / (force or 1.0)), min(1.0, coupling.torque_limit / (torque or 1.0))
    return np.array((p * a, p * b, p * c, q * d, q * e, q * f))
