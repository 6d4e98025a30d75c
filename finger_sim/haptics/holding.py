"""Commands that come as often as steps, but for some jitter: whether they are held, how late, and how fast the hand is.

Held is a command that the bone reaches in the step that hears it. Where commands come a little earlier or later beside
steps, and now and then one comes in the next step, reaching each at once makes the bone go now farther, now less far in
a step. So the path is late by what most of them had to wait, a step at most: what comes later than most finds the bone
standing for a moment, and it makes up for that without haste. A hiccup of the sender so costs some hundredths of a
second, and not, as where the longest wait counts, half a second and more.

The damper of a coupling gets the speed of the hand, taken over several commands, and not that of the bone's steps.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from ..arrays import Floats, Ints
from ..physics.compile import formula, stage
from ..physics.records import side_by_side
from .coupling import way_and_turn
from .path import Numbers, distance, keep_among, read

EXACT = 1e-6
"""Times nearer to each other than this are one [s]: a log has whole nanoseconds, simulated time none."""
OFTEN, SELDOM = 1.5, 1.75
"""Steps between two commands, at the mean, up to which these come as often as steps, and from which no longer."""
LONG = 3.0
"""Steps: of a command that had to last for longer, two steps at least had none of their own."""
FEW, MANY = 0.01, 0.04
"""Share of such waits up to which commands that come as often as steps are held, and from which no longer."""
WAITS = 256.0
"""Commands over which that share is taken."""
MOST = 0.9
"""Part of the waits that make the path late by no more than they ask for."""
DRIFT = 0.02
"""Part of a step by which that is found with each command: some fifty of them find it anew."""
REGAIN = 0.25
"""What a late command or a skipped step has made the bone late by is made up for at this rate [s/s]."""
COASTS = 8.0
"""Steps without a command for which the hand is taken to go on as fast; in as many more it comes to rest."""
LAST = 4
"""Commands over which its speed is taken."""
APART = 0.5
"""Steps by which these are apart at least: those of a burst count as one."""


class Holding(NamedTuple):
    """What is known of commands that may be held; (1,) each, unless said.

    holds : 1 where they are
    late  : of the path behind them, as most of their waits ask for [s]
    long  : share of long waits
    heard : (LAST, 8) numbers of the last commands, the oldest first, and the times that they were meant for [s]
    kept  : how many these are
    """

    holds: Floats
    late: Floats
    long: Floats
    heard: Floats
    kept: Ints


def build_holding() -> Holding:
    """Of no command."""
    fields: dict[str, Any] = {**side_by_side(Holding, heard=0, kept=0)}
    return Holding(**fields | {"heard": np.zeros((LAST, 8)), "kept": np.zeros(1, np.int64)})


@stage
def begin(holding: Holding) -> None:
    """Nothing is left of what was before."""
    holding.holds[0] = holding.late[0] = holding.long[0] = 0.0
    holding.kept[0] = 0


@stage
def judge(holding: Holding, may: bool, interval: float, wait: float, dt: float) -> None:
    """Another command came. may: be held; interval: of commands, at the mean; wait: that the one before lasted [s]."""
    long = 1.0 if wait > LONG * dt + EXACT else 0.0
    by = DRIFT * dt * (MOST if wait - dt > holding.late[0] + EXACT else MOST - 1.0)
    holding.late[0] = min(max(holding.late[0] + by, 0.0), dt)
    holds = holding.holds[0] != 0.0
    often = interval <= (SELDOM if holds else OFTEN) * dt
    if often:
        holding.long[0] += (long - holding.long[0]) / WAITS
    holding.holds[0] = 1.0 if may and often and holding.long[0] <= (MANY if holds else FEW) else 0.0


@stage
def keep(holding: Holding, time: float, at: Numbers, dt: float) -> None:
    """A command that was meant for a time [s], among the last."""
    heard, count = holding.heard, holding.kept[0]
    if count > 1 and time - heard[count - 2, 7] < APART * dt:
        count -= 1
    holding.kept[0] = keep_among(heard, count, time, at)


@stage
def reached(holding: Holding, since: float, meant: float, stood: bool, interval: float, before: Numbers) -> float:
    """When the path reaches the newest command, of all that are held [s].

    meant: by what it is late, that is; since: when the path is at the command before. From there it goes at the hand's
    speed, by up to a quarter faster: commands that were only late on their way come all at once. Where it stood, it
    sets off no more than a quarter slower than the hand. before: the command before.
    """
    heard, last = holding.heard, holding.kept[0] - 1
    way, took = distance(before, read(heard[last])), heard[last, 7] - heard[0, 7]
    went = distance(read(heard[0]), read(heard[last]))
    if went == 0.0 or took <= 0.0:
        return meant
    pace = way * took / went
    time: float = max(meant, since + min(pace, interval) / (1.0 + REGAIN))
    return min(time, since + pace / (1.0 - REGAIN)) if stood else time


@formula
def measures(holding: Holding) -> bool:
    """Whether the hand's speed is taken from the commands."""
    measured: bool = holding.holds[0] != 0.0 and holding.kept[0] > 1
    return measured


@stage
def velocity(holding: Holding, time: float, dt: float, fastest: Floats, out: Floats) -> None:
    """Of the hand at a time [s], no faster than is allowed. out: (6,); fastest: (2,) [m/s], [rad/s]."""
    heard, last = holding.heard, holding.kept[0] - 1
    took = max(heard[last, 7] - heard[0, 7], dt)
    rests = (time - heard[last, 7]) / (COASTS * dt) - 1.0
    part = min(max(1.0 - rests, 0.0), 1.0) / took
    way = way_and_turn(read(heard[0]), read(heard[last]))
    straight, turning = math.hypot(way[0], way[1], way[2]), math.hypot(way[3], way[4], way[5])
    part /= max(part * straight / fastest[0], part * turning / fastest[1], 1.0)
    for i in range(6):
        out[i] = part * way[i]
