"""By how much the signals of one bag lie after those of another: the shift in time that leaves the least between them.

Both signals are taken at the same moments, STEP apart, between their messages linearly. For every shift of whole
steps up to REACH the squares of what is between a(t) and b(t + shift) are summed up, and the products of neighbours:
between two shifts b is the mean of both, weighted, so that the least square there follows from the sums.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..arrays import Floats

STEP = 1_000_000
"""Time between two moments [ns]: a step of a haptic loop."""
REACH = 100_000_000
"""Largest shift that is tried [ns]: more is no delay of a loop."""
LONGEST_PAUSE = 10_000_000_000
"""Time between two messages from which on nothing is taken in between [ns]: a line across it is no signal."""
MOST_AT_ONCE = 1 << 16
"""Moments that are summed up together: some megabytes, however far apart messages are."""
BLOCK = 4096
"""Messages after which what can be summed up is, and forgotten."""
FAINTEST = 0.01
"""The best shift leaves less than the worst one by this part at least: signals that stand still tell of no shift."""


@dataclass
class Lag:
    """How B's signal lies in time."""

    seconds: float
    """So much after A's [s]; negative: before it."""
    beyond: bool
    """Whether a still larger shift than those tried might fit better."""
    rms: float
    """Between the two as they are, in the unit of the signal."""
    rest: float
    """Between the two with the lag taken out."""


class LagMeter:
    """Takes the messages of both bags in the order of time; memory holds a block of them.

    overlap : time that both signals cover [ns]; shifts up to a quarter of it are tried
    """

    def __init__(self, overlap: int) -> None:
        self._reach = max(0, min(REACH, overlap // 4) // STEP)
        self._times: tuple[list[int], list[int]] = ([], [])
        self._values: tuple[list[Floats], list[Floats]] = ([], [])
        self._squares = np.zeros(2 * self._reach + 1)
        self._products = np.zeros(2 * self._reach)
        self._count = self._waiting = 0
        self._next: int | None = None

    def take(self, side: int, time: int, value: Floats) -> None:
        """The signal (d,) in a message of A (0) or B (1) at a time [ns]; of equal times the first counts."""
        times = self._times[side]
        if times and time <= times[-1]:
            return
        times.append(time)
        self._values[side].append(value)
        self._waiting += 1
        if self._waiting >= BLOCK:
            self._sum_up()

    def lag(self) -> Lag | None:
        """The best shift; None where the signals are too short, stand still, or are no numbers."""
        self._sum_up()
        squares, products = self._squares, self._products
        if self._reach == 0 or self._count <= self._reach or not np.isfinite(squares).all():
            return None
        low, high = squares[:-1], squares[1:]
        bend = low - 2.0 * products + high
        share = np.clip(np.divide(low - products, bend, out=np.zeros_like(bend), where=bend > 0.0), 0.0, 1.0)
        left = (1.0 - share) ** 2 * low + 2.0 * share * (1.0 - share) * products + share**2 * high
        best = int(left.argmin())
        if left[best] > (1.0 - FAINTEST) * squares.max() or squares.max() == 0.0:
            return None
        steps = best + float(share[best]) - self._reach
        return Lag(
            seconds=1e-9 * STEP * steps,
            beyond=abs(steps) >= self._reach,
            rms=float(np.sqrt(squares[self._reach] / self._count)),
            rest=float(np.sqrt(max(left[best], 0.0) / self._count)),
        )

    def _sum_up(self) -> None:
        """All moments for which both signals are known at every shift."""
        self._waiting = 0
        (ours, theirs), reach = self._times, self._reach
        if not ours or not theirs:
            return
        if self._next is None:
            self._next = max(-(-ours[0] // STEP), -(-theirs[0] // STEP) + reach)
        begin, end = self._next, min(ours[-1] // STEP, theirs[-1] // STEP - reach) + 1
        if end <= begin:
            return
        for first, last in self._runs(begin, end):
            self._sum_run(first, last)
        self._next = end
        self._forget(0, end * STEP)
        self._forget(1, (end - reach) * STEP)

    def _runs(self, begin: int, end: int) -> Iterator[tuple[int, int]]:
        """The moments from `begin` up to `end` but for those in long pauses, MOST_AT_ONCE at a time."""
        pauses = []
        for times, reach in zip(self._times, (0, self._reach), strict=True):
            kept = np.array(times, dtype=np.float64)
            for i in np.flatnonzero(np.diff(kept) > LONGEST_PAUSE).tolist():
                pauses.append((times[i] // STEP + 1 - reach, times[i + 1] // STEP + 1 + reach))
        for first, last in [*sorted(pauses), (end, end)]:
            while begin < min(first, end):
                stop = min(begin + MOST_AT_ONCE, first, end)
                yield begin, stop
                begin = stop
            begin = max(begin, last)

    def _sum_run(self, begin: int, end: int) -> None:
        """The moments from `begin` up to `end`."""
        reach = self._reach
        a, b = self._at(0, begin, end), self._at(1, begin - reach, end + reach)
        before = None
        for shift in range(2 * reach + 1):
            apart = (a - b[shift : shift + len(a)]).ravel()
            self._squares[shift] += apart @ apart
            if before is not None:
                self._products[shift - 1] += before @ apart
            before = apart
        self._count += end - begin

    def _at(self, side: int, begin: int, end: int) -> Floats:
        """The signal at the moments from `begin` up to `end` (n, d)."""
        moments = np.arange(begin, end, dtype=np.float64) * STEP
        times, values = np.array(self._times[side], dtype=np.float64), np.array(self._values[side])
        return np.stack([np.interp(moments, times, column) for column in values.T], axis=1)

    def _forget(self, side: int, time: int) -> None:
        """Messages before the last one up to `time` are not needed any more."""
        times = self._times[side]
        kept = max(int(np.searchsorted(np.array(times), time, side="right")) - 1, 0)
        del times[:kept], self._values[side][:kept]
