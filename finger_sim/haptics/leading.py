"""One step of the driven bone, from the commands heard to where its nodes are wanted, in compiled code.

commands → goal (following.py) → no faster than the coupling allows → not past the plane → start and end of the step,
the velocity, and the driven nodes at a part of it. simulation/whole.py calls it.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ..arrays import Floats
from ..physics.compile import kernel, stage
from ..physics.records import side_by_side
from ..physics.turns import matrix_entries
from . import following, holding, path
from .coupling import LONGEST_GAP, allowed_part, between_numbers, height, way_and_turn
from .following import HOLD, Course
from .path import read, turn, write

MOVES, LIMITED = 1, 2
"""What a step was: the bone is wanted elsewhere, or with a velocity; held back by a speed limit or the plane."""


class Lead(NamedTuple):
    """A bone that is led, for compiled code. All in world axes, [m] and [m/s], [rad/s]; (1,) each, unless said.

    start, end : (7,) poses at which the bone is wanted at the start and at the end of the last step
    wanted     : (7,) the pose at the part of it that was asked for last
    velocity   : (6,) of the bone as it is wanted; zero where the coupling is kinematic
    points     : (n, 3) the driven nodes, as read
    targets    : (n, 3) where they are wanted at that part; where the bone yields, they are not looked at
    fastest    : (2,) that the coupling allows
    centre     : (3,) mean of the driven nodes, as read
    normal     : (3,) of the plane, unit, outward
    point      : (3,) of the plane
    driven     : 1 where the body has a bone
    stops      : 1 where the centre does not pass the plane
    yields     : 1 where the bone is on a spring (a virtual coupling)
    jumps      : 1 while commands are held, so that the bone is wanted in jumps
    since      : time after the last jump [s]
    holds      : time after it for which the velocity is that of the jump [s]
    """

    start: Floats
    end: Floats
    fastest: Floats
    centre: Floats
    normal: Floats
    point: Floats
    driven: Floats
    stops: Floats
    yields: Floats
    jumps: Floats
    since: Floats
    holds: Floats
    wanted: Floats
    velocity: Floats
    points: Floats
    targets: Floats
    course: Course


def build_lead(course: Course, points: Floats, target: Floats, surface: tuple[Floats, Floats]) -> Lead:
    """Shared: target (13,) as `wanted` and `velocity`, surface as `normal` and `point`."""
    given = ("wanted", "velocity", "points", "targets", "course", "normal", "point")
    fields: dict[str, Any] = {**side_by_side(Lead, start=7, end=7, fastest=2, centre=3, **dict.fromkeys(given, 0))}
    fields |= {"wanted": target[:7], "velocity": target[7:], "points": np.ascontiguousarray(points)}
    fields |= {"normal": surface[0], "point": surface[1]}
    return Lead(**fields | {"targets": points.copy(), "course": course})


@stage
def advance(lead: Lead, mode: int, now: float, dt: float, part: float) -> int:
    """One step of `dt` that begins at a time [s]; NaN: dt after the last one began. What it was, of the bits above.

    mode: of following. Afterwards `wanted` and `targets` are those after a part of the step.
    """
    course, start = lead.course, read(lead.end)
    following.advance(course, mode, now, dt)
    told, end, goal = 0, start, read(course.pose)
    if start != goal:
        allowed = allowed_part(start, goal, lead.fastest[0] * dt, lead.fastest[1] * dt)
        end = between_numbers(start, goal, allowed)
        told |= 0 if allowed == 1.0 else LIMITED
        if lead.stops[0] != 0.0:
            free = _free_part(lead, start, end)
            if free >= 0.0:
                end = between_numbers(start, end, free)
                told |= LIMITED
    write(lead.start, start)
    write(lead.end, end)
    if lead.yields[0] != 0.0:
        if told & LIMITED or not holding.measures(course.holding):
            _measure(lead, mode, dt)
        else:
            lead.jumps[0] = 0.0
            holding.velocity(course.holding, course.time[0] - course.offset[0], dt, lead.fastest, lead.velocity)
    put(lead, part)
    if end != start:
        told |= MOVES
    for i in range(6):
        if lead.velocity[i] != 0.0:
            told |= MOVES
    return told


@kernel
def put(lead: Lead, part: float) -> None:
    """The pose, and the driven nodes, after a part of the last step."""
    at = between_numbers(read(lead.start), read(lead.end), part)
    write(lead.wanted, at)
    if lead.yields[0] == 0.0:
        a, b, c, d, e, f, g, h, i = matrix_entries(turn(at))
        for k in range(lead.points.shape[0]):
            x, y, z = lead.points[k, 0], lead.points[k, 1], lead.points[k, 2]
            lead.targets[k, 0] = a * x + b * y + c * z + at[0]
            lead.targets[k, 1] = d * x + e * y + f * z + at[1]
            lead.targets[k, 2] = g * x + h * y + i * z + at[2]


@stage
def _free_part(lead: Lead, start: path.Numbers, end: path.Numbers) -> float:
    """Of the way from start to end, up to where the bone's centre is in the plane; -1: all of it.

    A bone that is past the plane already may not go deeper.
    """
    normal, point, centre = lead.normal, lead.point, lead.centre
    after = height(normal, point, centre, end)
    if after >= 0.0:
        return -1.0
    before = height(normal, point, centre, start)
    if after >= before:
        return -1.0
    return before / (before - after) if before > 0.0 else 0.0


@stage
def _measure(lead: Lead, mode: int, dt: float) -> None:
    """The velocity in the last step: of a path as it is, of jumps their mean.

    That is a jump's size over the time since the one before, for as long as that took and half as long again, so that
    commands which come regularly but for some jitter give a steady velocity; then zero. A jump after LONGEST_GAP of
    rest counts as having taken that.
    """
    start, end = read(lead.start), read(lead.end)
    took = dt
    if mode == HOLD:
        if lead.jumps[0] == 0.0:
            lead.jumps[0], lead.since[0], lead.holds[0] = 1.0, 0.0, 0.0
            _set(lead.velocity, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0), 1.0)
        lead.since[0] += dt
        took = min(lead.since[0], LONGEST_GAP)
        if end == start and lead.since[0] <= lead.holds[0]:
            return
        if end != start:
            lead.holds[0], lead.since[0] = 1.5 * took, 0.0
    else:
        lead.jumps[0] = 0.0
    _set(lead.velocity, way_and_turn(start, end), took)


@stage
def _set(velocity: Floats, way: tuple[float, float, float, float, float, float], took: float) -> None:
    for i in range(6):
        velocity[i] = way[i] / took


KERNELS = (following.rest, following.hear, put)
"""What a Drive calls."""
