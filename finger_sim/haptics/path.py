"""A path through poses: straight between them, and its mean over a window of time."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

from ..physics.rotations import Quaternion, angle, normalised, slerp
from ..scene import Pose

Numbers = tuple[float, float, float, float, float, float, float]
"""Position [m] and quaternion x y z w of a pose."""

FINE_TURN = 0.2
"""Turns above this are split [rad]: straight lines between the quaternions are then slerp to 1e-4 rad."""

SHORT = 1e-6
"""Time in which no turn is split [s]."""
_FINE = math.cos(0.5 * FINE_TURN)


class _Knot(NamedTuple):
    time: float
    at: Numbers
    pose: Pose


class Path:
    """Poses at times that grow; before the first and after the last it stands.

    Quaternions are averaged as numbers, each on the side of the one before: over a window they are near to each other.
    """

    def __init__(self, time: float, pose: Pose) -> None:
        self._knots = deque([_Knot(time, numbers(pose), pose)])

    @classmethod
    def passing(cls, time: float, before: Pose, pose: Pose, dt: float, window: float) -> Path:
        """One whose mean over a window up to a time [s] is at `pose`, as fast as from `before` there in `dt` [s]."""
        here = numbers(pose)
        was = numbers(before, here)
        ahead = [0.5 * window / dt * (b - a) for a, b in zip(was, here, strict=True)]
        path = cls(time - window, _pose([a - b for a, b in zip(here, ahead, strict=True)]))
        path.append(time, _pose([a + b for a, b in zip(here, ahead, strict=True)]))
        return path

    @property
    def end(self) -> float:
        """Time of the last pose [s]."""
        return self._knots[-1].time

    @property
    def last(self) -> Pose:
        """The last pose."""
        return self._knots[-1].pose

    @property
    def last_numbers(self) -> Numbers:
        """Of the last pose."""
        return self._knots[-1].at

    def append(self, time: float, pose: Pose) -> None:
        """On to a pose at a time [s]; poses from then on are replaced."""
        knots = self._knots
        while len(knots) > 1 and knots[-1].time >= time:
            knots.pop()
        last = knots[-1]
        if last.time >= time:
            knots[0] = _Knot(time, numbers(pose, last.at), pose)
            return
        if last.pose == pose:
            if len(knots) > 1 and knots[-2].pose == pose:
                knots.pop()
            knots.append(_Knot(time, last.at, last.pose))
            return
        at = numbers(pose, last.at)
        parts = 1
        _, _, _, a, b, c, d = at
        _, _, _, e, f, g, h = last.at
        if a * e + b * f + c * g + d * h < _FINE and time - last.time > SHORT:
            parts = math.ceil(angle(last.pose.orientation, pose.orientation) / FINE_TURN)
        for i in range(1, parts):
            share = i / parts
            x, y, z, *_ = _mix(last.at, at, share)
            there = (x, y, z, *slerp(_turn(last.at), _turn(at), share))
            knots.append(_Knot(last.time + share * (time - last.time), there, _pose(there)))
        knots.append(_Knot(time, at, pose))

    def stand(self, time: float) -> None:
        """At its last pose until a later time [s]."""
        if time > self.end:
            self.append(time, self.last)

    def forget(self, time: float) -> None:
        """What was before a time [s] is no longer asked for."""
        knots = self._knots
        while len(knots) > 1 and knots[1].time <= time:
            knots.popleft()

    def standing(self, begin: float, end: float) -> Pose | None:
        """The pose at which it stands all the time from `begin` to `end` [s]; None where it moves in it."""
        pose = None
        for knot in reversed(self._around(begin, end)):
            if pose is not None and knot.pose != pose:
                return None
            pose = knot.pose
        return pose

    def mean(self, begin: float, end: float) -> Pose:
        """Its mean from `begin` to `end` [s]; where it is, if they are the same."""
        standing = self.standing(begin, end)
        if standing is not None:
            return standing
        knots = self._around(begin, end)
        if begin == end:
            return _pose(_at(knots[0], knots[-1], end))
        weights = [0.0] * len(knots)  # a straight piece counts by its ends, as far as it lies in the window
        for i, (knot, after) in enumerate(pairwise(knots)):
            low, high = max(begin, knot.time), min(end, after.time)
            share = (high - low) / (end - begin)
            later = 0.5 * share * (low + high - 2.0 * knot.time) / (after.time - knot.time)
            weights[i] += share - later
            weights[i + 1] += later
        x = y = z = p = q = r = s = 0.0
        for weight, (_, (a, b, c, d, e, f, g), _) in zip(weights, knots, strict=True):
            x, y, z = x + weight * a, y + weight * b, z + weight * c
            p, q, r, s = p + weight * d, q + weight * e, r + weight * f, s + weight * g
        return Pose((x, y, z), normalised((p, q, r, s)))

    def _around(self, begin: float, end: float) -> list[_Knot]:
        """The knots from the last up to `begin` to the first from `end` on; before and after all, it stands."""
        knots = self._knots
        found: list[_Knot] = [] if end <= knots[-1].time else [knots[-1]._replace(time=end)]
        for knot in reversed(knots):
            found = [knot] if knot.time >= end else [*found, knot]
            if knot.time <= begin:
                break
        else:
            if knots[0].time > begin:
                found.append(knots[0]._replace(time=begin))
        found.reverse()
        return found


def numbers(pose: Pose, near: Numbers | None = None) -> Numbers:
    """Position and quaternion of a pose; of q and −q, which are one orientation, the one nearer to that of `near`."""
    x, y, z, w = pose.orientation
    if near is not None and x * near[3] + y * near[4] + z * near[5] + w * near[6] < 0.0:
        return (*pose.position, -x, -y, -z, -w)
    return (*pose.position, x, y, z, w)


def _at(a: _Knot, b: _Knot, time: float) -> Sequence[float]:
    """The straight line between two knots."""
    share = (time - a.time) / (b.time - a.time)
    return a.at if share <= 0.0 else b.at if share >= 1.0 else _mix(a.at, b.at, share)


def _mix(a: Numbers, b: Numbers, share: float) -> list[float]:
    return [x + share * (y - x) for x, y in zip(a, b, strict=True)]


def _turn(at: Numbers) -> Quaternion:
    _, _, _, x, y, z, w = at
    return x, y, z, w


def _pose(at: Sequence[float]) -> Pose:
    x, y, z, *turn = at
    return Pose((x, y, z), normalised(turn))
