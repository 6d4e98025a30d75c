"""What happened in a replay, in memory that does not grow with its steps."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from .result import StepResult


@dataclass
class Summary:
    """What happened in a replay."""

    out: Path
    topic: str
    commands: int
    refused: int
    """Commands left out: messages that are none, those that cannot be followed, or are in another frame."""
    warning: str | None
    """What was wrong with the bag of commands, if it was cut off."""
    refusal: str | None = None
    """Why the first of the refused was, with the number of its message."""
    warnings: list[str] = field(default_factory=list)
    """What was to be known before the first step: long gaps, and what could not be read."""
    plane_topic: str | None = None
    """Where the plane's poses came from, if there were any."""
    plane_poses: int = 0
    plane_refused: int = 0
    """Poses of the plane left out: as commands are, or all, where the scene has no plane."""
    plane_refusal: str | None = None
    """Why the first that is refused whatever the scene was."""
    as_recorded: bool = False
    """Whether what the bag was made with was simulated, and no scene that was given."""
    live_changes: int = 0
    """Recorded changes of parameters that were made again."""
    left_out: int = 0
    """Recorded changes of parameters that were not, as a scene was given."""
    resets: int = 0
    """Recorded resets, all made again."""
    differences: list[str] | None = None
    """Of what was simulated from what the bag was made with, a text for each; None where it does not say."""
    steps: int = 0
    duration: float = 0.0
    """Simulated time [s]."""
    passed_over: float = 0.0
    """Time in long gaps that was not simulated, as the finger was at rest [s]."""
    wall: float = 0.0
    """Time that the steps alone took [s]."""
    step_median: float = 0.0
    """[s]; like `step_p99` within half a percent, of a histogram."""
    step_p99: float = 0.0
    """[s]"""
    peak_force: float = 0.0
    """Largest contact force [N]."""
    peak_force_time: float = 0.0
    """When it was reached [s]."""
    limited_tets: int = 0
    """Most tetrahedra at a limit in one step."""
    max_strain_ratio: float = 0.0
    """Largest strain / limit."""
    max_penetration: float = 0.0
    """[m]"""
    set_down_by: float = 0.0
    """How far inside the plane the first command is [m]; the finger was put on the plane above it, and went there."""
    status: dict[str, int] = field(default_factory=dict)
    """Steps in which each status bit was set; empty when all went well."""

    @property
    def real_time_factor(self) -> float:
        """Simulated time per time that the steps took."""
        return self.duration / self.wall if self.wall > 0.0 else math.inf

    def count(self, result: StepResult, end: int) -> None:
        """Takes in one more step, which ended at `end` [ns]."""
        self.steps += 1
        force = float(np.linalg.norm(result.contact_wrench[:3]))
        if force > self.peak_force:
            self.peak_force, self.peak_force_time = force, end * 1e-9
        self.limited_tets = max(self.limited_tets, int(result.limited_tets))
        self.max_strain_ratio = max(self.max_strain_ratio, float(result.max_strain_ratio))
        self.max_penetration = max(self.max_penetration, float(result.max_penetration))
        for bit in result.status:
            name = bit.name or str(bit.value)
            self.status[name] = self.status.get(name, 0) + 1
