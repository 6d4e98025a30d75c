"""When a replay makes its steps, and which commands have come for each. Times are in ns since the first command."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import NamedTuple

from ..bags.excerpt import Arrivals, Excerpt, Received
from ..bags.gaps import Gap


class Moment(NamedTuple):
    """A step: when it begins, what time its results have [ns], and the commands that came for it."""

    begin: int
    end: int
    commands: list[Received]
    number: int
    """Steps up to and with this one, those that were passed over too."""


def on_a_clock(
    commands: Excerpt, start: int, count: int, dt: float, gaps: Iterator[Gap], unchanged: Callable[[], float]
) -> Iterator[Moment]:
    """So many steps of dt [s], one after another; in a gap those are passed over that would change nothing.

    start     : log time that is 0
    gaps      : the long ones between all that may change a step, in the order of time
    unchanged : log time [ns] up to which every step gives what the last one gave, as far as nothing comes
    The last step before something comes or changes is made, so that what is recorded holds up to there.
    """
    arrivals, gap = Arrivals(commands.poses()), next(gaps, None)
    k = begin = 0
    while k < count:
        end = nanoseconds(k + 1, dt)
        yield Moment(begin, end, arrivals.up_to(start + begin), k + 1)
        heard = start + begin
        k, begin = k + 1, end
        while gap is not None and gap.end <= heard:
            gap = next(gaps, None)
        if gap is not None and gap.begin <= heard:
            wake = min(gap.end, unchanged()) - start
            if wake > begin:
                k = max(k, steps_to(math.floor(wake), dt) - 2)
                begin = nanoseconds(k, dt)


def of_commands(commands: Excerpt, start: int) -> Iterator[Moment]:
    """One step for each command, at its receipt."""
    for number, command in enumerate(commands.poses(), start=1):
        at = command.log_time - start
        yield Moment(at, at, [command], number)


def at_times(commands: Excerpt, start: int, begins: Iterator[int]) -> Iterator[Moment]:
    """Steps that begin at such times."""
    arrivals = Arrivals(commands.poses())
    for number, begin in enumerate(begins, start=1):
        yield Moment(begin, begin, arrivals.up_to(start + begin), number)


def steps_to(last: int, dt: float) -> int:
    """Steps until the pose received at `last` [ns] has been simulated for one of them."""
    k = math.floor(last * 1e-9 / dt)
    while nanoseconds(k, dt) < last:
        k += 1
    return k + 1


def nanoseconds(k: int, dt: float) -> int:
    """k dt, rounded once [ns]."""
    return round(k * dt * 1e9)
