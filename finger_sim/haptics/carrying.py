"""One step of a plane that follows targets, in compiled code. simulation/ground.py calls it.

To each target the plane goes at an even speed in the time that passed since the one before, LONGEST_GAP at most (so
that it moves steadily under targets that come steadily), no faster than the coupling's speeds. To the first target it
goes in LONGEST_GAP.
"""

from __future__ import annotations

from typing import NamedTuple

from ..arrays import Floats
from ..physics.compile import kernel, stage
from ..physics.records import side_by_side
from ..physics.turns import Quaternion, matrix_entries, normalised
from .coupling import LONGEST_GAP, allowed_part, between_numbers, way_and_turn
from .path import Numbers, read, turn, write

Vector = tuple[float, float, float]

_SAME_NORMAL = 1e-12
"""Unit normals nearer than this are one: what is left is rounding."""


class Table(NamedTuple):
    """A plane, for compiled code. All in world axes, [m] and [m/s], [rad/s]; (1,) each, unless said.

    normal   : (3,) unit, outward, at the end of the last step
    point    : (3,) of it
    pose     : (7,) the plane is the x-y plane of this pose, its z the normal
    before   : (7,) that at the start of the last step
    goal     : (7,) the pose that it goes to
    target   : (7,) a goal from the next step on
    twist    : (6,) velocity of the pose's origin and angular velocity in the last step
    fastest  : (2,) that the coupling allows
    exists   : 1 where the scene has a plane
    given    : 1 where `target` is one
    placed   : 1 from the first target on: before it the plane has no pose
    anchored : 1 where the pose is one that targets gave: until then origin and axes in the plane mean nothing
    since    : time since the last target, LONGEST_GAP at most [s]
    left     : time in which the goal is to be reached [s]
    """

    normal: Floats
    point: Floats
    pose: Floats
    before: Floats
    goal: Floats
    target: Floats
    twist: Floats
    fastest: Floats
    exists: Floats
    given: Floats
    placed: Floats
    anchored: Floats
    since: Floats
    left: Floats


def build_table() -> Table:
    """A plane that is not there."""
    poses = dict.fromkeys(("pose", "before", "goal", "target"), 7)
    return Table(**side_by_side(Table, normal=3, point=3, twist=6, fastest=2, **poses))


@stage
def advance(table: Table, dt: float) -> bool:
    """One step of `dt` [s], towards the target if one is given; whether the plane moves, or has just stopped."""
    given = table.given[0] != 0.0
    if table.placed[0] == 0.0 and not given:
        return False
    table.since[0] = min(table.since[0] + dt, LONGEST_GAP)
    if given:
        target = read(table.target)
        if table.anchored[0] == 0.0:
            # Seen from its first target, so that no sliding within itself and no turn about its normal is a motion.
            begin(table, nearest(target, _three(table.normal), _three(table.point)))
            table.anchored[0] = 1.0
        write(table.goal, target)
        table.left[0], table.since[0], table.given[0] = table.since[0], 0.0, 0.0
    before, goal = read(table.pose), read(table.goal)
    write(table.before, before)
    if before == goal:
        stops = False
        for i in range(6):
            stops |= table.twist[i] != 0.0
            table.twist[i] = 0.0
        return stops
    part = min(1.0, dt / table.left[0]) if table.left[0] > 1.5 * dt else 1.0
    wanted = between_numbers(before, goal, part)
    allowed = allowed_part(before, wanted, table.fastest[0] * dt, table.fastest[1] * dt)
    after = between_numbers(before, wanted, allowed)
    write(table.pose, after)
    table.left[0] -= dt
    way = way_and_turn(before, after)
    for i in range(6):
        table.twist[i] = way[i] / dt
    lay(table)
    return True


@kernel
def begin(table: Table, pose: Numbers) -> None:
    """The plane has this pose, and goes to the first target as to any that comes after a pause."""
    write(table.pose, pose)
    write(table.before, pose)
    write(table.goal, pose)
    table.placed[0], table.since[0] = 1.0, LONGEST_GAP


@kernel
def lay(table: Table) -> None:
    """Normal and point of the pose."""
    pose = read(table.pose)
    table.normal[0], table.normal[1], table.normal[2] = upward(pose)
    for i in range(3):
        table.point[i] = pose[i]


@stage
def place(table: Table, part: float, normal: Floats, point: Floats) -> None:
    """Normal (3,) and point (3,) after a part of the last step."""
    if part == 1.0:
        for i in range(3):
            normal[i], point[i] = table.normal[i], table.point[i]
        return
    at = between_numbers(read(table.before), read(table.pose), part)
    normal[0], normal[1], normal[2] = upward(at)
    for i in range(3):
        point[i] = at[i]


@stage
def upward(pose: Numbers) -> Vector:
    """The z axis of a pose, in world axes."""
    entries = matrix_entries(turn(pose))
    return entries[2], entries[5], entries[8]


@stage
def _three(row: Floats) -> Vector:
    return row[0], row[1], row[2]


@stage
def nearest(pose: Numbers, normal: Vector, point: Vector) -> Numbers:
    """The pose of a plane, given by normal and point, that is the least way and turn from `pose`."""
    own = upward(pose)
    distance = (
        normal[0] * (pose[0] - point[0]) + normal[1] * (pose[1] - point[1]) + normal[2] * (pose[2] - point[2])
    )  # fmt: skip
    x, y, z = pose[0] - distance * normal[0], pose[1] - distance * normal[1], pose[2] - distance * normal[2]
    a, b, c = normal[0] - own[0], normal[1] - own[1], normal[2] - own[2]
    e, f, g, h = turn(pose)
    if a * a + b * b + c * c < _SAME_NORMAL**2:
        return x, y, z, e, f, g, h
    a, b, c, d = turned(normal, own)
    i, j, k, l = normalised((
        d * e + a * h + b * g - c * f, d * f + b * h + c * e - a * g,
        d * g + c * h + a * f - b * e, d * h - a * e - b * f - c * g,
    ))  # fmt: skip
    return x, y, z, i, j, k, l


@stage
def turned(normal: Vector, start: Vector) -> Quaternion:
    """The least rotation that takes the unit vector `start` to `normal`; from opposite ones, about any axis across."""
    a, b, c = start
    x, y, z = normal
    w = 1.0 + a * x + b * y + c * z
    if w < _SAME_NORMAL:
        x = y = z = w = 0.0
        if abs(a) <= abs(b) and abs(a) <= abs(c):
            x = 1.0
        elif abs(b) <= abs(c):
            y = 1.0
        else:
            z = 1.0
    return normalised((b * z - c * y, c * x - a * z, a * y - b * x, w))


KERNELS = (begin, lay)
"""What a Ground calls."""
