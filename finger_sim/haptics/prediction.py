"""Where a hand is by now, from where it was and how fast: first order, bounded, without delay."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

from ..physics.rotations import normalised
from ..scene import Pose
from .cadence import Cadence
from .path import Numbers, numbers

LAST = 3
"""Commands from which a velocity is taken: two intervals even out half of a jitter, and are not old yet."""
FARTHEST = 1.5
"""Longest waits that are predicted over; a hand of which nothing was heard for longer is taken to have stopped."""
PULL = 4.0
"""Rate at which the bone is drawn to the prediction, times the interval of commands, over which errors are spread."""
HARDEST, SOFTEST = 300.0, 15.0
"""Largest and smallest rate at which it is drawn [1/s]."""
JOLT = 30.0
"""Between them, the acceleration that a way off the line may give it [m/s²]: 0.09 N in 1 ms for 3 N s/m."""
FASTEST_HAND, FASTEST_TURN = 2.0, 20.0
"""A hand is not predicted faster than this [m/s], [rad/s]: it could not be stopped in time."""
SHORTEST = 1.0
"""Intervals of commands that the last LAST took at least: those of a burst come in no time at all."""
NEAR, SLOW = 1e-9, 1e-6
"""Of a bone that has come to rest at the last command: way [m] and velocity [m/s]."""

_NOTHING: Numbers = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


class Prediction:
    """Draws the bone to the straight line that the hand went on last, without overshoot: it never jumps.

    The way off the line falls as that of a critically damped spring; in the line itself nothing lags.
    """

    def __init__(self, pose: Pose) -> None:
        self._pose = pose
        self._at: Sequence[float] = numbers(pose)
        self._rate: Sequence[float] = _NOTHING
        self._heard: deque[tuple[float, Numbers]] = deque(maxlen=LAST)
        self._interval = self._horizon = 0.0

    def place(self, pose: Pose, before: Pose, dt: float) -> None:
        """The bone is at a pose now, and was at another one `dt` before [s]."""
        near = self._heard[-1][1] if self._heard else None
        self._pose, self._at = pose, numbers(pose, near)
        was = numbers(before, numbers(pose, near))
        self._rate = [(b - a) / dt for a, b in zip(was, self._at, strict=True)]

    def begin(self, time: float, at: Numbers, takes: float) -> None:
        """A first command, or the first after a pause, meant for a time [s]; the bone takes about `takes` to it [s]."""
        self._at = numbers(self._pose, at)
        self._rate = _NOTHING
        self._heard.clear()
        self._heard.append((time, at))
        self._interval, self._horizon = takes, 0.0

    def hear(self, time: float, at: Numbers, cadence: Cadence) -> None:
        """The next command."""
        self._heard.append((time, at))
        self._interval = cadence.interval
        self._horizon = FARTHEST * cadence.longest_wait

    def advance(self, last: Pose, time: float, dt: float) -> Pose:
        """One step of `dt` that ends at a time [s]; `last`: the command heard last."""
        if not self._heard:
            return self._pose
        (first, there), (newest, here) = self._heard[0], self._heard[-1]
        age = time - newest
        speed: Sequence[float] = _NOTHING
        took = max(newest - first, SHORTEST * self._interval, dt)
        if newest > first and abs(age) <= self._horizon:
            speed = _bounded([(b - a) / took for a, b in zip(there, here, strict=True)])
        at, rate = [], []
        way = math.dist(self._at, [x + w * (age - dt) for x, w in zip(here, speed, strict=True)])
        pull = max(min(PULL / max(self._interval, dt), HARDEST, math.sqrt(JOLT / max(way, NEAR))), SOFTEST)
        fall = math.exp(-pull * dt)
        for x, v, goal, w in zip(self._at, self._rate, here, speed, strict=True):
            off = x - (goal + w * (age - dt))
            drift = v - w + pull * off
            at.append(goal + w * age + (off + drift * dt) * fall)
            rate.append(w + (v - w - pull * drift * dt) * fall)
        self._at, self._rate = at, rate
        if not any(speed) and math.dist(at, here) < NEAR and math.hypot(*rate) < SLOW:
            self._at, self._rate, self._pose = here, _NOTHING, last
        else:
            x, y, z, *turn = at
            self._pose = Pose((x, y, z), normalised(turn))
        return self._pose


def _bounded(speed: list[float]) -> list[float]:
    """Of position and quaternion, in a second: scaled down where it is faster than a hand is predicted."""
    fast = max(math.hypot(*speed[:3]) / FASTEST_HAND, 2.0 * math.hypot(*speed[3:]) / FASTEST_TURN, 1.0)
    return [s / fast for s in speed]
