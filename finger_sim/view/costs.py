"""What a level of the solver costs: the error of contact force where it was measured, and the step time seen here."""

from __future__ import annotations

from ..haptics.budget import claimed
from ..scene import Scene
from ..scene.mesh import TetMesh
from .words import Report

LEVELS = ("standard", "lagged")
SETTLE = 6
"""Reports after which the node's figures, of its last 4096 steps, are of the present level alone."""


class LevelCosts:
    """Remembers the step time of each level of one scene."""

    def __init__(self) -> None:
        self._errors: dict[str, float | None] = {}
        self._times: dict[str, tuple[float, float]] = {}
        self._level: str | None = None
        self._alike = 0

    def measured_errors(self, scene: Scene, mesh: TetMesh) -> None:
        """Looks up the errors of a scene's levels."""
        found: dict[str, float | None] = {}
        for level in LEVELS:
            found[level] = claimed(scene.with_values({"solver.level": level}), mesh).get("scene")
        self._errors = found

    def use(self, level: str | None) -> None:
        """From now on steps are made on this level."""
        if level != self._level:
            self._level, self._alike = level, 0

    def see(self, report: Report) -> None:
        """Takes the step time of a report, once it is of the present level alone, and of no body that sleeps."""
        self._alike = self._alike + 1 if report.number("steps asleep") == 0.0 else 0
        median, p99 = report.number("step time p50 [ms]"), report.number("step time p99 [ms]")
        if self._level and median and p99 and self._alike > SETTLE:
            self._times[self._level] = (median, p99)

    def texts(self) -> dict[str, str] | None:
        """By level, what is known; None where that is nothing."""
        if not any(self._errors.values()) and not self._times:
            return None
        return {level: self._text(level) for level in LEVELS}

    def _text(self, level: str) -> str:
        error, times = self._errors.get(level), self._times.get(level)
        of_force = "not measured for this scene" if error is None else f"{error:.2g} of the peak force (rms)"
        of_time = "not seen yet" if times is None else f"{times[0]:.2f} ms, p99 {times[1]:.2f} ms"
        return f"force error {of_force}; step time {of_time}"
