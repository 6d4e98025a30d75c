"""When commands come: how often, how evenly, how long each has to last; and the time that each was meant for.

Commands reach a node with jitter of two kinds. Either the hand was sampled unevenly, and each pose is of the time at
which it came; or it was sampled evenly, and only the way here took now more, now less. In the first case a path through
the poses at their times of receipt is the hand's; in the second it is one at even intervals. Nobody tells which, but
the hand does not jerk: of the two times a command is given the one at which its velocity changes less, as it turned out
for the commands before.
"""

from __future__ import annotations

import math

from .path import Numbers

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


class Cadence:
    """Of one stream of commands. Times are in s, of any one clock.

    interval : mean time between commands; 0 until there are two
    jitter   : mean deviation of their receipt from even times
    count    : commands heard, FITTED at most
    """

    def __init__(self, received: float, at: Numbers) -> None:
        self.interval = self.jitter = 0.0
        self.count = 0
        self.time = received
        """That the last command was meant for."""
        self.received = received
        """When it came."""
        self._begin = self._even = received
        self._waits, self._gaps = _Extremes(), _Extremes()
        self._mean_wait = 0.0
        self._at = at
        self._way: Numbers | None = None  # from the command before to the last
        self._square = 0.0  # of it
        self._by_receipt = self._by_step = 0.0  # one over the time that it took [1/s]
        self._unrest_by_receipt = self._unrest_by_step = 0.0  # mean change of the hand's velocity by either time

    @property
    def known(self) -> bool:
        """Whether enough commands came to tell their rate."""
        return self.count >= BEGINNING and self.interval > 0.0

    @property
    def longest_wait(self) -> float:
        """Longest time that a command lately had to last until the next one was there; 0 until there are two."""
        return self._waits.largest

    @property
    def spread(self) -> float:
        """Longest less shortest interval between two commands lately."""
        return max(0.0, self._gaps.largest - self._gaps.smallest)

    def hear(self, received: float, now: float, at: Numbers) -> float:
        """The next command came, and is followed from `now` on; the time that it was meant for, later than the last."""
        gap, wait = received - self.received, now - self.time
        self.received = received
        self._gaps.add(now, gap)
        mean = self._mean_wait = self._mean_wait + (wait - self._mean_wait) / LATELY if self._mean_wait else wait
        if wait < OUTLIER * mean:
            self._waits.add(now, wait)
        step = self._fit(received)
        if at != self._at:
            self._compare(gap, step, at)
        even, uneven = self._unrest_by_step**4, self._unrest_by_receipt**4
        share = uneven / (uneven + even) if self.count > BEGINNING and uneven + even > 0.0 else 0.0
        self.time = max(received + share * (self._even - received), self.time + 1e-9)
        return self.time

    def _fit(self, received: float) -> float:
        """Fits the line; the even time of the next command after that of the one before."""
        k = self.count = min(self.count + 1, FITTED)
        if k <= 2:
            before, self._even = self._even, received
            self.interval = (received - self._begin) / k
            return received - before
        step = self.interval
        off = received - (self._even + step)
        self._even += step + off * 2.0 * (2.0 * k - 1.0) / (k * (k + 1.0))
        self.interval = max(self.interval + off * 6.0 / (k * (k + 1.0)), 0.0)
        self.jitter += (abs(off) - self.jitter) / min(k - 2, LATELY)
        return step

    def _compare(self, gap: float, step: float, at: Numbers) -> None:
        """How much the hand's velocity changes by receipt, and by even times."""
        shortest = max(0.05 * self.interval, 1e-6)
        by_receipt = 1.0 / (gap if gap > shortest else shortest)
        by_step = 1.0 / (step if step > shortest else shortest)
        a, b, c, d, e, f, g = self._at
        h, i, j, k, m, n, o = at
        turn = 2.0 * LEVER
        a, b, c, d, e, f, g = h - a, i - b, j - c, turn * (k - d), turn * (m - e), turn * (n - f), turn * (o - g)
        square = a * a + b * b + c * c + d * d + e * e + f * f + g * g
        before, old, p, q = self._way, self._square, self._by_receipt, self._by_step
        self._at, self._way, self._square = at, (a, b, c, d, e, f, g), square
        self._by_receipt, self._by_step = by_receipt, by_step
        if before is None:
            return
        h, i, j, k, m, n, o = before
        across = a * h + b * i + c * j + d * k + e * m + f * n + g * o
        change = by_receipt * by_receipt * square - 2.0 * by_receipt * p * across + p * p * old
        self._unrest_by_receipt += ((math.sqrt(change) if change > 0.0 else 0.0) - self._unrest_by_receipt) / LATELY
        change = by_step * by_step * square - 2.0 * by_step * q * across + q * q * old
        self._unrest_by_step += ((math.sqrt(change) if change > 0.0 else 0.0) - self._unrest_by_step) / LATELY


class _Extremes:
    """Largest and smallest of what was added lately: in this stretch of REMEMBERED, and in the one before."""

    def __init__(self) -> None:
        self._begin = -math.inf
        self._before = (math.inf, 0.0)  # smallest, largest
        self._low, self._high = self._before  # of this stretch
        self.smallest, self.largest = self._before

    def add(self, now: float, value: float) -> None:
        if now - self._begin > REMEMBERED:
            self._before = (self._low, self._high) if now - self._begin < 2.0 * REMEMBERED else (math.inf, 0.0)
            self._low, self._high, self._begin = value, max(0.0, value), now
            self.smallest, self.largest = min(self._before[0], self._low), max(self._before[1], self._high)
            return
        if value < self._low:
            self._low = value
            self.smallest = min(self._before[0], value)
        if value > self._high:
            self._high = value
            self.largest = max(self._before[1], value)
