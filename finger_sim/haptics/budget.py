"""A time budget for steps: down a ladder of accuracy while they take too long, and back up when they do not.

The node holds `solver.budget_ms` with it. What each rung costs in accuracy is measured: `python benchmarks/budget.py`.
"""

from __future__ import annotations

import dataclasses
from collections import deque
from typing import NamedTuple

from ..scene import Solver


class Rung(NamedTuple):
    """Settings of one rung, and what they cost."""

    name: str
    tolerance: float  # at least
    lagged: bool  # one stiffness matrix for four steps (`newton`)
    iterations: int  # at most
    error: str  # of contact force through `press_slide` with `finger_haptic`, rms, of the peak


LADDER = (
    Rung("scene", 0.0, False, 1_000_000, "as the scene has it"),
    Rung("coarse", 1e-2, False, 1_000_000, "0.05 %"),
    Rung("lagged", 1e-2, True, 1_000_000, "0.1 %"),
    Rung("capped", 5e-2, True, 2, "2 %"),
)
"""From the best to the quickest."""
WINDOW = 50
"""Steps that are looked at together."""
OVER = 5
"""So many of them beyond the budget lead a rung down."""
EASY = 0.7
"""Part of the budget below which nine in ten steps must stay to lead a rung up."""
PATIENCE, MOST_PATIENCE = 500, 16_000
"""Steps on a rung before the next one up is tried; twice as many each time that was too early, up to the second."""


class Budget:
    """Which rung to stand on; told how long each step took."""

    def __init__(self, seconds: float) -> None:
        self.seconds = seconds
        self.rung = 0
        self.moves = 0
        """Times the rung changed."""
        self._times: deque[float] = deque(maxlen=WINDOW)
        self._since = 0
        self._patience = PATIENCE
        self._tried = False

    def spent(self, seconds: float) -> bool:
        """One step took so long; whether `rung` changed by it."""
        self._times.append(seconds)
        self._since += 1
        if len(self._times) < WINDOW:
            return False
        if sum(time > self.seconds for time in self._times) >= OVER:
            if self._tried and self._since < self._patience:
                self._patience = min(2 * self._patience, MOST_PATIENCE)
            return self._move(1)
        if self._since < self._patience:
            return False
        if self._tried:
            self._patience, self._tried = PATIENCE, False
        if self.rung > 0 and sorted(self._times)[9 * WINDOW // 10] < EASY * self.seconds:
            return self._move(-1)
        return False

    def _move(self, down: int) -> bool:
        rung = min(self.rung + down, len(LADDER) - 1)
        if rung == self.rung:
            return False
        self.rung, self._since, self._tried = rung, 0, down < 0
        self.moves += 1
        self._times.clear()
        return True


def on_rung(solver: Solver, rung: int) -> Solver:
    """The solver settings of a scene on a rung of the ladder. `lagged` is for `newton`, linearised once a step."""
    step = LADDER[rung]
    lags = step.lagged and solver.method == "newton" and solver.relinearizations == 0
    return dataclasses.replace(
        solver,
        tolerance=max(solver.tolerance, step.tolerance),
        level="lagged" if lags else solver.level,
        max_iterations=min(solver.max_iterations, step.iterations),
    )
