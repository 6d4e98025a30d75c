"""When commands come: how often, how evenly, how long each has to last; and the time that each was meant for.

Commands reach a node with jitter of two kinds. Either the hand was sampled unevenly, and each pose is of the time at
which it came; or it was sampled evenly, and only the way here took now more, now less. In the first case a path through
the poses at their times of receipt is the hand's; in the second it is one at even intervals. Nobody tells which, but
the hand does not jerk: of the two times a command is given the one at which its velocity changes less, as it turned out
for the commands before.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any, NamedTuple

from ..arrays import Floats
from ..physics.compile import formula, stage
from ..physics.records import side_by_side
from .path import Numbers, clear, read, write

REMEMBERED = 0.5
"""Least time for which extremes are remembered [s]; twice that at most."""
FITTED = 20
"""Commands over which even times are fitted: a straight line of receipt against count, in the form of a g-h filter
whose gains are those of a least-squares fit until there are so many (Brookner 1998, Tracking and Kalman Filtering Made
Easy, section 1.2.10)."""
BEGINNING = 8
"""Commands until even times are trusted."""
LATELY = 16
"""Commands over which means are taken."""
OUTLIER = 8.0
"""A wait longer than so many mean ones is a gap of its own, and says nothing of the next."""
LEVER = 0.05
"""A turn of 1 rad counts as a way of this length where velocities are compared [m]."""


class Extremes(NamedTuple):
    """Largest and smallest of what was added lately: in this stretch of REMEMBERED, and in the one before; (1,) each.

    smallest, largest     : of both stretches
    begin                 : of this stretch [s]
    low, high             : in this stretch
    low_before, high_before : in the one before
    """

    smallest: Floats
    largest: Floats
    begin: Floats
    low: Floats
    high: Floats
    low_before: Floats
    high_before: Floats


class Cadence(NamedTuple):
    """Of one stream of commands. Times are in s, of any one clock; (1,) each, unless said.

    interval  : mean time between commands; 0 until there are two
    jitter    : mean deviation of their receipt from even times
    commands  : heard after the first, FITTED at most; -1: there was none
    time      : that the last command was meant for
    received  : when it came
    begin     : when the first came
    even      : the even time of the last
    waits     : how long commands had to last until the next one was there
    gaps      : between the receipt of two
    mean_wait : of the waits; 0 before the first
    at        : (7,) numbers of the last pose that was another one than before
    way       : (7,) from the one before to it, turns by LEVER; zero before the second
    square    : of the way
    by_receipt, by_step               : one over the time that it took [1/s]: as received, and by even times
    unrest_by_receipt, unrest_by_step : mean change of the hand's velocity by either time
    """

    interval: Floats
    jitter: Floats
    commands: Floats
    time: Floats
    received: Floats
    begin: Floats
    even: Floats
    mean_wait: Floats
    at: Floats
    way: Floats
    square: Floats
    by_receipt: Floats
    by_step: Floats
    unrest_by_receipt: Floats
    unrest_by_step: Floats
    waits: Extremes
    gaps: Extremes


@dataclasses.dataclass(frozen=True)
class Rhythm:
    """What is known of a cadence, as plain numbers; see there.

    count        : commands heard after the first, FITTED at most
    known        : whether enough commands came to tell their rate
    longest_wait : longest time that a command lately had to last until the next one was there; 0 until there are two
    spread       : longest less shortest interval between two commands lately
    """

    interval: float
    jitter: float
    count: int
    time: float
    received: float
    known: bool
    longest_wait: float
    spread: float


def build_cadence() -> Cadence:
    """Before the first command."""
    waits, gaps = (Extremes(**side_by_side(Extremes)) for _ in range(2))
    fields: dict[str, Any] = {**side_by_side(Cadence, at=7, way=7, waits=0, gaps=0), "waits": waits, "gaps": gaps}
    cadence = Cadence(**fields)
    cadence.commands[0] = -1.0
    return cadence


def rhythm(cadence: Cadence) -> Rhythm | None:
    """None before the first command."""
    count = int(cadence.commands[0])
    if count < 0:
        return None
    interval, jitter, time, received, longest, largest, smallest = (
        float(field[0])
        for field in (
            cadence.interval, cadence.jitter, cadence.time, cadence.received,
            cadence.waits.largest, cadence.gaps.largest, cadence.gaps.smallest,
        )
    )  # fmt: skip
    known = count >= BEGINNING and interval > 0.0
    return Rhythm(interval, jitter, count, time, received, known, longest, max(0.0, largest - smallest))


@stage
def begin(cadence: Cadence, received: float, at: Numbers) -> None:
    """The first command came; nothing is left of what was before."""
    cadence.interval[0] = cadence.jitter[0] = cadence.commands[0] = cadence.mean_wait[0] = 0.0
    cadence.time[0] = cadence.received[0] = cadence.begin[0] = cadence.even[0] = received
    write(cadence.at, at)
    clear(cadence.way)
    cadence.square[0] = cadence.by_receipt[0] = cadence.by_step[0] = 0.0
    cadence.unrest_by_receipt[0] = cadence.unrest_by_step[0] = 0.0
    _empty(cadence.waits)
    _empty(cadence.gaps)


@stage
def hear(cadence: Cadence, received: float, now: float, at: Numbers) -> float:
    """The next command came, and is followed from `now` on; the time that it was meant for, later than the last."""
    gap, wait, mean = received - cadence.received[0], now - cadence.time[0], cadence.mean_wait[0]
    cadence.received[0] = received
    _add(cadence.gaps, now, gap)
    mean = mean + (wait - mean) / LATELY if mean != 0.0 else wait
    cadence.mean_wait[0] = mean
    if wait < OUTLIER * mean:
        _add(cadence.waits, now, wait)
    step = _fit(cadence, received)
    if at != read(cadence.at):
        _compare(cadence, gap, step, at)
    even, uneven = cadence.unrest_by_step[0] ** 4, cadence.unrest_by_receipt[0] ** 4
    share = uneven / (uneven + even) if cadence.commands[0] > BEGINNING and uneven + even > 0.0 else 0.0
    meant: float = max(received + share * (cadence.even[0] - received), cadence.time[0] + 1e-9)
    cadence.time[0] = meant
    return meant


@formula
def spread(cadence: Cadence) -> float:
    """Longest less shortest interval between two commands lately [s]."""
    longer: float = max(0.0, cadence.gaps.largest[0] - cadence.gaps.smallest[0])
    return longer


@stage
def _fit(cadence: Cadence, received: float) -> float:
    """Fits the line; the even time of the next command after that of the one before."""
    k = min(cadence.commands[0] + 1.0, float(FITTED))
    cadence.commands[0] = k
    step: float = cadence.interval[0]
    if k <= 2.0:
        step = received - cadence.even[0]
        cadence.even[0] = received
        cadence.interval[0] = (received - cadence.begin[0]) / k
        return step
    off = received - (cadence.even[0] + step)
    cadence.even[0] += step + off * 2.0 * (2.0 * k - 1.0) / (k * (k + 1.0))
    cadence.interval[0] = max(step + off * 6.0 / (k * (k + 1.0)), 0.0)
    cadence.jitter[0] += (abs(off) - cadence.jitter[0]) / min(k - 2.0, float(LATELY))
    return step


@stage
def _compare(cadence: Cadence, gap: float, step: float, at: Numbers) -> None:
    """How much the hand's velocity changes by receipt, and by even times."""
    shortest = max(0.05 * cadence.interval[0], 1e-6)
    by_receipt, by_step = 1.0 / max(gap, shortest), 1.0 / max(step, shortest)
    square = across = 0.0
    for i in range(7):
        way = (at[i] - cadence.at[i]) * (1.0 if i < 3 else 2.0 * LEVER)
        square += way * way
        across += way * cadence.way[i]
        cadence.way[i] = way
    old, p, q = cadence.square[0], cadence.by_receipt[0], cadence.by_step[0]
    write(cadence.at, at)
    cadence.square[0], cadence.by_receipt[0], cadence.by_step[0] = square, by_receipt, by_step
    if p == 0.0:  # the first way
        return
    change = by_receipt * by_receipt * square - 2.0 * by_receipt * p * across + p * p * old
    cadence.unrest_by_receipt[0] += (math.sqrt(max(change, 0.0)) - cadence.unrest_by_receipt[0]) / LATELY
    change = by_step * by_step * square - 2.0 * by_step * q * across + q * q * old
    cadence.unrest_by_step[0] += (math.sqrt(max(change, 0.0)) - cadence.unrest_by_step[0]) / LATELY


@formula
def _empty(extremes: Extremes) -> None:
    extremes.begin[0] = -math.inf
    extremes.smallest[0] = extremes.low[0] = extremes.low_before[0] = math.inf
    extremes.largest[0] = extremes.high[0] = extremes.high_before[0] = 0.0


@stage
def _add(extremes: Extremes, now: float, value: float) -> None:
    since = now - extremes.begin[0]
    if since > REMEMBERED:
        lately = since < 2.0 * REMEMBERED
        extremes.low_before[0] = extremes.low[0] if lately else math.inf
        extremes.high_before[0] = extremes.high[0] if lately else 0.0
        extremes.low[0], extremes.high[0], extremes.begin[0] = value, max(0.0, value), now
    extremes.low[0] = min(extremes.low[0], value)
    extremes.high[0] = max(extremes.high[0], value)
    extremes.smallest[0] = min(extremes.low_before[0], extremes.low[0])
    extremes.largest[0] = max(extremes.high_before[0], extremes.high[0])
