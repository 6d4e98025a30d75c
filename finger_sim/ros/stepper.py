"""One step of the node: the newest command, the watchdog, the simulation, and what it brought."""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ..budget import Budget, on_rung
from ..physics.step import Status
from ..scene import Pose, Scene
from ..simulator import Simulator, StepResult
from .loop import Ring
from .outputs import Outputs


class Command(NamedTuple):
    """A command that passed the check."""

    pose: Pose
    received: float
    """Steady time of receipt [s]."""


@dataclasses.dataclass
class Window:
    """The worst of the steps since the last report."""

    steps: int = 0
    iterations: int = 0
    residual: float = 0.0
    limit_rows: int = 0
    limited_tets: int = 0
    locked_tets: int = 0
    contacts: int = 0
    asleep: int = 0
    max_strain_ratio: float = 0.0
    max_penetration: float = 0.0
    status: Status = Status.OK
    troubled: int = 0
    """Steps with a status bit set."""

    def add(self, out: StepResult) -> None:
        self.steps += 1
        self.iterations = max(self.iterations, out.iterations)
        self.residual = max(self.residual, out.residual)
        self.limit_rows = max(self.limit_rows, out.limit_rows)
        self.limited_tets = max(self.limited_tets, out.limited_tets)
        self.locked_tets = max(self.locked_tets, out.locked_tets)
        self.contacts = max(self.contacts, out.contacts)
        self.asleep += out.asleep
        self.max_strain_ratio = max(self.max_strain_ratio, out.max_strain_ratio)
        self.max_penetration = max(self.max_penetration, out.max_penetration)
        if out.status:
            self.status |= out.status
            self.troubled += 1


class Stepper:
    """Owns the simulation; everything but `newest`, `window` and what is read belongs to the loop's thread.

    newest : the command to follow; whoever receives one puts it here
    window : the steps since whoever reports put a new one here
    delay  : times from the receipt of a command to the wrench of its step [s]
    stale  : whether the command is too old to render forces
    """

    def __init__(self, scene: Scene, outputs: Outputs, clock: Any, log: Any) -> None:
        self.scene = scene
        self.newest: Command | None = None
        self.window = Window()
        self.delay = Ring()
        self.stale = False
        self.budget: Budget | None = None
        self._outputs, self._clock, self._log = outputs, clock, log
        self._followed: Command | None = None
        self._none = np.zeros(6)

    def prepare(self, progress: Callable[[str], None]) -> None:
        """Loads mesh and kernels. Raises FingerSimError."""
        self.sim = Simulator(self.scene, progress=progress)
        self._take_budget()
        self._outputs.prepare(self.sim.mesh)

    def tick(self) -> None:
        """One step of scene.dt. The first command ever places the finger; each later one moves it there."""
        stamp = self._clock.now().nanoseconds
        command = self.newest
        begin = time.perf_counter()
        fresh = command is not None and self._watch(command)
        if command is None or command is self._followed:
            out = self.sim.step()
        else:
            if self._followed is None:
                self.sim.reset(command.pose)
            out = self.sim.step(command.pose)
        if self.budget is not None and self.budget.spent(time.perf_counter() - begin):
            self.sim.solve_with(on_rung(self.scene.solver, self.budget.rung))
        device = out.device_wrench if fresh and math.isfinite(sum(out.device_wrench.tolist())) else self._none
        self._outputs.step(self.sim, out, device, stamp)
        if command is not None and command is not self._followed:
            self._followed = command
            self.delay.add(time.monotonic() - command.received)
        self.window.add(out)

    def reset(self) -> Pose:
        """Back to rest at the last command."""
        self.sim.reset()
        return self.sim.pose

    def apply(self, changes: dict[str, Any]) -> None:
        """Changes live values of the scene. Raises SceneError."""
        self.sim.apply(changes)
        self.scene = self.sim.scene
        self._take_budget()

    def _take_budget(self) -> None:
        """Begin at the top of the ladder with the scene's budget, if it has one."""
        milliseconds = self.scene.solver.budget_ms
        self.budget = Budget(1e-3 * milliseconds) if milliseconds is not None else None

    def _watch(self, command: Command) -> bool:
        """Whether the command is recent by the steady clock; says so when that changes."""
        limit = self._outputs.options.command_timeout
        age = time.monotonic() - command.received
        if self.stale != (age > limit):
            self.stale = not self.stale
            if self.stale:
                self._log.warning(f"no command for {limit:g} s: holding the pose, device_wrench is zero")
            else:
                self._log.info("commands are back: device_wrench follows the contact again")
        return not self.stale
