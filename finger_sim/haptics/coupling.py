"""Command → bone, and what a device is asked to render.

Kinematic coupling: the driven nodes follow the commanded pose exactly. Virtual coupling: they are a rigid body on a
damped spring to it (physics/bone.py). Both no faster than the scene allows, so that a jump of the command (a tracker
that re-acquires, a first message from afar) gives a bounded motion. How commands become a path: following.py. A step of
it in compiled code: leading.py.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ..arrays import Floats
from ..physics.compile import formula, kernel, stage
from ..physics.turns import angle, rotation_vector, slerp
from ..scene import Coupling, Pose, Vec3, place
from .path import Numbers, numbers, turn

LONGEST_GAP = 0.1
"""Most time that a command, or a target of the plane, counts as having taken since the one before [s]."""

TOUCHING = 1e-6
"""Depth up to which a body at rest only touches a plane [m]."""


def follow(coupling: Coupling, pose: Pose, command: Pose, dt: float) -> tuple[Pose, bool]:
    """The pose after `dt` [s] on the way from `pose` to `command`, and whether a speed limit held it back."""
    way, turn = coupling.max_speed * dt, coupling.max_angular_speed * dt
    part = allowed_part(numbers(pose), numbers(command), way, turn)
    return between(pose, command, part), part != 1.0


@stage
def allowed_part(start: Numbers, goal: Numbers, way: float, most_turn: float) -> float:
    """Of the way from start to goal: where neither way [m] nor turn [rad] is longer than these."""
    part = 1.0
    distance = math.hypot(start[0] - goal[0], start[1] - goal[1], start[2] - goal[2])
    if distance > way:
        part = way / distance
    if turn(start) != turn(goal):
        turned = angle(turn(start), turn(goal))
        if turned > most_turn:
            part = min(part, most_turn / turned)
    return part


def set_down(normal: Vec3, point: Vec3, centre: Vec3, skin: Floats, pose: Pose) -> Pose:
    """`pose`, or where the bone's centre is past the plane there: the one right above it whose skin touches the plane.

    For a bone that yields: contact would throw it out at its depth over dt. skin: see `outside`.
    """
    return pose if height(normal, point, centre, numbers(pose)) >= 0.0 else outside(normal, point, skin, pose)


def outside(normal: Vec3, point: Vec3, skin: Floats, pose: Pose) -> Pose:
    """`pose`, or where a body at rest would be in the plane there: the one right above it where it touches the plane.

    normal: unit, outward; point: of the plane [m], world. skin: (n, 3) nodes that meet the plane, as read [m].
    """
    depth = float(np.dot(normal, point) - (place(skin, pose) @ np.array(normal)).min(initial=math.inf))
    if not depth > TOUCHING:
        return pose
    x, y, z = (c + depth * n for c, n in zip(pose.position, normal, strict=True))
    return Pose((x, y, z), pose.orientation)


@stage
def height(normal: Vec3 | Floats, point: Vec3 | Floats, centre: Vec3 | Floats, at: Numbers) -> float:
    """Of the bone's centre over the plane [m], where the bone has a pose of these numbers."""
    x, y, z, w = turn(at)
    a, b, c = centre[0], centre[1], centre[2]
    s, t, u = 2.0 * (y * c - z * b), 2.0 * (z * a - x * c), 2.0 * (x * b - y * a)
    over: float = (
        normal[0] * (a + w * s + y * u - z * t + at[0] - point[0])
        + normal[1] * (b + w * t + z * s - x * u + at[1] - point[1])
        + normal[2] * (c + w * u + x * t - y * s + at[2] - point[2])
    )
    return over


def between(a: Pose, b: Pose, fraction: float) -> Pose:
    """The pose `fraction` of the way from a to b: position on the line, orientation on the shorter arc."""
    if fraction == 1.0:
        return b
    x, y, z, i, j, k, w = between_numbers(numbers(a), numbers(b), fraction)
    return Pose((x, y, z), (i, j, k, w))


@stage
def between_numbers(a: Numbers, b: Numbers, fraction: float) -> Numbers:
    """`between` of numbers of poses."""
    if fraction == 1.0:
        return b
    x, y, z, w = slerp(turn(a), turn(b), fraction)
    return (
        a[0] + fraction * (b[0] - a[0]), a[1] + fraction * (b[1] - a[1]), a[2] + fraction * (b[2] - a[2]), x, y, z, w,
    )  # fmt: skip


def displacement(start: Pose, end: Pose) -> tuple[float, float, float, float, float, float]:
    """From pose to pose: way [m] and rotation vector [rad], world axes; the shorter turn."""
    return way_and_turn(numbers(start), numbers(end))


@stage
def way_and_turn(start: Numbers, end: Numbers) -> tuple[float, float, float, float, float, float]:
    """`displacement` of numbers of poses."""
    x, y, z = rotation_vector(turn(start), turn(end))
    return end[0] - start[0], end[1] - start[1], end[2] - start[2], x, y, z


def six(vector: Sequence[float] | Floats) -> Floats:
    """A copy (6,), as kernels take it. Raises ValueError where there are more numbers, or less."""
    out = np.empty(6)
    out[:] = vector
    return out


def spring_wrench(on_bone: Floats, bone: Pose, command: Pose) -> Floats:
    """(6,) wrench [N, N m] of a coupling on the device, about the commanded point.

    on_bone: its wrench on the bone, about the bone's origin; all in world axes.
    """
    out = six(on_bone)
    turned_round(out, np.array(bone.position, np.float64), np.array(command.position, np.float64), out)
    return out


@kernel
def turned_round(on_bone: Floats, bone: Floats, command: Floats, out: Floats) -> None:
    """`spring_wrench` into `out`, which may be `on_bone`; of both poses only the positions are read."""
    for i in range(6):
        out[i] = -on_bone[i]
    x, y, z = bone[0] - command[0], bone[1] - command[1], bone[2] - command[2]
    out[3] += y * out[2] - z * out[1]
    out[4] += z * out[0] - x * out[2]
    out[5] += x * out[1] - y * out[0]


def device_wrench(coupling: Coupling, wrench: Floats) -> Floats:
    """A wrench (6,) [N, N m], its force and torque each scaled back to the coupling's limits."""
    out = six(wrench)
    clamped(out, float(coupling.force_limit), float(coupling.torque_limit), out)
    return out


@kernel
def clamped(wrench: Floats, force_limit: float, torque_limit: float, out: Floats) -> None:
    """A wrench, its force and torque each scaled back to a limit [N], [N m]; `out` may be `wrench`."""
    p = part_within(force_limit, wrench[0], wrench[1], wrench[2])
    q = part_within(torque_limit, wrench[3], wrench[4], wrench[5])
    for i in range(6):
        out[i] = (p if i < 3 else q) * wrench[i]


@formula
def part_within(limit: float, x: float, y: float, z: float) -> float:
    """Of a vector, the largest part up to all of it that is no longer than a limit."""
    size = math.hypot(math.hypot(x, y), z)  # of two numbers at a time, which neither overflows nor underflows
    return limit / size if size > limit else 1.0


@formula
def finite(vector: Floats) -> bool:
    """Whether all six numbers are finite, and their sum."""
    total = 0.0
    for i in range(6):
        total += vector[i]
    return math.isfinite(total)
