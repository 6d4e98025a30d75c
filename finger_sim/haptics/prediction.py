"""Where a hand is by now, from where it was and how fast: first order, bounded, without delay."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from ..arrays import Floats, Ints
from ..physics.compile import formula, stage
from ..physics.records import side_by_side
from .path import Numbers, clear, keep_among, on_side, read, side_near, with_unit_turn, write

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


class Prediction(NamedTuple):
    """Draws the bone to the straight line that the hand went on last, without overshoot: it never jumps.

    The way off the line falls as that of a critically damped spring; in the line itself nothing lags. (1,) each,
    unless said.

    pose     : (7,) where the bone is
    at       : (7,) its numbers, the quaternion on the side of the last command's
    rate     : (7,) of these [1/s]
    speed    : (7,) of the hand, in these numbers [1/s]
    heard    : (LAST, 8) numbers of the last commands, the oldest first, and the times that they were meant for [s]
    kept     : how many these are
    interval : of commands [s]
    horizon  : how long after the last command the hand is taken to go on [s]
    """

    pose: Floats
    at: Floats
    rate: Floats
    speed: Floats
    interval: Floats
    horizon: Floats
    heard: Floats
    kept: Ints


def build_prediction() -> Prediction:
    """One that heard nothing."""
    fields: dict[str, Any] = {**side_by_side(Prediction, pose=7, at=7, rate=7, speed=7, heard=0, kept=0)}
    return Prediction(**fields | {"heard": np.zeros((LAST, 8)), "kept": np.zeros(1, np.int64)})


@stage
def rest(prediction: Prediction, pose: Numbers) -> None:
    """The bone rests at a pose; what was heard is forgotten."""
    write(prediction.pose, pose)
    write(prediction.at, pose)
    clear(prediction.rate)
    prediction.kept[0] = 0
    prediction.interval[0] = prediction.horizon[0] = 0.0


@stage
def place(prediction: Prediction, pose: Numbers, before: Numbers, dt: float) -> None:
    """The bone is at a pose now, and was at another one `dt` before [s]."""
    at, count = pose, prediction.kept[0]
    if count > 0:
        at = on_side(pose, side_near(pose, read(prediction.heard[count - 1])))
    was = on_side(before, side_near(before, at))
    write(prediction.pose, pose)
    write(prediction.at, at)
    for i in range(7):
        prediction.rate[i] = (at[i] - was[i]) / dt


@stage
def begin(prediction: Prediction, time: float, at: Numbers, takes: float) -> None:
    """A first command, or the first after a pause, meant for a time [s]; the bone takes about `takes` to it [s]."""
    pose = read(prediction.pose)
    write(prediction.at, on_side(pose, side_near(pose, at)))
    clear(prediction.rate)
    prediction.kept[0] = 0
    _keep(prediction, time, at)
    prediction.interval[0], prediction.horizon[0] = takes, 0.0


@stage
def hear(prediction: Prediction, time: float, at: Numbers, interval: float, longest_wait: float) -> None:
    """The next command; of the cadence of commands, their interval and the longest wait for one [s]."""
    _keep(prediction, time, at)
    prediction.interval[0] = interval
    prediction.horizon[0] = FARTHEST * longest_wait


@stage
def advance(prediction: Prediction, last: Numbers, time: float, dt: float) -> None:
    """One step of `dt` that ends at a time [s]; `last`: the command heard last."""
    if prediction.kept[0] == 0:
        return
    here, at, rate, speed = prediction.heard[prediction.kept[0] - 1], prediction.at, prediction.rate, prediction.speed
    age = time - here[7]
    _measure_speed(prediction, age, dt)
    way = 0.0
    for i in range(7):
        off = at[i] - (here[i] + speed[i] * (age - dt))
        way += off * off
    jolt = math.sqrt(JOLT / max(math.sqrt(way), NEAR))
    pull = max(min(PULL / max(prediction.interval[0], dt), HARDEST, jolt), SOFTEST)
    fall = math.exp(-pull * dt)
    goes, far, fast = False, 0.0, 0.0
    for i in range(7):
        off = at[i] - (here[i] + speed[i] * (age - dt))
        drift = rate[i] - speed[i] + pull * off
        at[i] = here[i] + speed[i] * age + (off + drift * dt) * fall
        rate[i] = speed[i] + (rate[i] - speed[i] - pull * drift * dt) * fall
        goes = goes or speed[i] != 0.0
        far += (at[i] - here[i]) ** 2
        fast += rate[i] ** 2
    if not goes and math.sqrt(far) < NEAR and math.sqrt(fast) < SLOW:
        write(at, read(here))
        clear(rate)
        write(prediction.pose, last)
    else:
        write(prediction.pose, with_unit_turn(read(at)))


@stage
def _measure_speed(prediction: Prediction, age: float, dt: float) -> None:
    """Of the hand in the last commands: of none that is too old, and scaled down where it is faster than predicted."""
    first, here, speed = prediction.heard[0], prediction.heard[prediction.kept[0] - 1], prediction.speed
    if not (here[7] > first[7] and abs(age) <= prediction.horizon[0]):
        clear(speed)
        return
    took = max(here[7] - first[7], SHORTEST * prediction.interval[0], dt)
    for i in range(7):
        speed[i] = (here[i] - first[i]) / took
    straight, turning = math.hypot(speed[0], speed[1], speed[2]), math.hypot(speed[3], speed[4], speed[5], speed[6])
    fast = max(straight / FASTEST_HAND, 2.0 * turning / FASTEST_TURN, 1.0)
    for i in range(7):
        speed[i] /= fast


@formula
def _keep(prediction: Prediction, time: float, at: Numbers) -> None:
    """Among the last commands; the oldest goes."""
    prediction.kept[0] = keep_among(prediction.heard, prediction.kept[0], time, at)
