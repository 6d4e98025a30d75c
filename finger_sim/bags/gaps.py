"""Times without a message: how long a gap may be before it is told, and before it is refused."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

from ..errors import BagError
from .cdr import STAMPS_END

GAP_TOLD = 60.0
"""Longest time between two messages that nothing is said of [s].

Hands rest, and devices pause, for seconds. A minute is the longest that a replay steps through whatever the finger
does: it writes a hundred megabytes for it.
"""
GAP_ALLOWED = 600.0
"""Longest one that is simulated unless it is asked for [s].

Longer ones come of clocks that were set and of stray messages without a time. A finger that does not come to rest takes
some minutes and a gigabyte for so long.
"""
SHOWN = 3
"""Gaps that are named; of more the number is told."""


class Gap(NamedTuple):
    """A time without a message."""

    topic: str
    number: int
    """Of the message that ends it, on its topic, from 1 on."""
    begin: int
    """Log time of the message before [ns]."""
    end: int
    """Log time of the message that ends it [ns]."""

    @property
    def seconds(self) -> float:
        """Its length [s]."""
        return (self.end - self.begin) * 1e-9

    def __str__(self) -> str:
        seconds = f"{self.seconds:.3f}".rstrip("0").rstrip(".")
        return f"{seconds} s without a message before message {self.number} on {self.topic}"


def gaps_in(received: Iterable[tuple[int, str, int]]) -> Iterator[Gap]:
    """The gaps longer than GAP_TOLD between messages: (log time [ns], topic, number) in the order of time."""
    before: int | None = None
    for time, topic, number in received:
        if before is not None and time - before > GAP_TOLD * 1e9:
            yield Gap(topic, number, before, time)
        before = time


def told(gaps: Sequence[Gap]) -> str:
    """Some gaps in words, the longest first."""
    longest = sorted(gaps, key=lambda gap: gap.begin - gap.end)
    more = f", and {len(gaps) - SHOWN} more of over {GAP_TOLD:g} s" if len(gaps) > SHOWN else ""
    return ", ".join(map(str, longest[:SHOWN])) + more


def require_allowed(where: object, gaps: Iterable[Gap], window: tuple[int, int] | None = None) -> None:
    """Raises BagError for a gap that is longer than GAP_ALLOWED.

    window : log times [ns] that --start, and --duration, count from; None: there are no such options
    """
    longest = max(gaps, key=lambda gap: gap.end - gap.begin, default=None)
    if longest is None or longest.seconds <= GAP_ALLOWED:
        return
    what, doubt = f"{where}: {longest}, allowed: {GAP_ALLOWED:g} s", "a clock that was set, or stray messages?"
    if window is None:
        raise BagError(f"{what}; {doubt}")
    zero, start = window
    after, before = (longest.end - zero) // 1_000 + 2, (longest.begin - start) // 1_000  # whole microseconds
    ways = [f"--start {after * 1e-6:.6f} begins after it"] if longest.end < STAMPS_END else []
    ways += [f"--duration {before * 1e-6:.6f} ends before it"] if before > 0 else []
    raise BagError(f"{what}, or any with --allow-gaps; {doubt} {', '.join(ways)}")
