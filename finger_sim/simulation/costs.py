"""What steps cost, in memory that does not grow with their number."""

from __future__ import annotations

import math

import numpy as np

SHORTEST, LONGEST_COST = 1e-7, 1e3
"""Costs [s] that are told apart; beyond, they count as these: no step takes less, and nobody waits for longer ones."""
RATIO = 1.01
"""Of the ends of a bin: a percentile is the middle of its bin, within half a percent of the true one."""


class Costs:
    """A histogram of the costs of steps, its bins in a fixed ratio."""

    def __init__(self) -> None:
        self.total = 0.0
        """Of all [s]."""
        self._counts = np.zeros(1 + math.ceil(math.log(LONGEST_COST / SHORTEST) / math.log(RATIO)), dtype=np.int64)

    def add(self, cost: float) -> None:
        """One more step [s]."""
        self.total += cost
        self._counts[int(math.log(min(max(cost, SHORTEST), LONGEST_COST) / SHORTEST) / math.log(RATIO))] += 1

    def percentile(self, percent: float) -> float:
        """The cost that `percent` of the steps do not exceed [s]; 0 where there was no step."""
        ends = np.cumsum(self._counts)
        if ends[-1] == 0:
            return 0.0
        place = math.ceil(0.01 * percent * float(ends[-1]))
        number = int(np.searchsorted(ends, max(place, 1)))
        return SHORTEST * math.pow(RATIO, number + 0.5)
