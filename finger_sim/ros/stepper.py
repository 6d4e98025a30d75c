"""One step of the node: the newest command, the watchdog, the simulation, and what it brought."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ..arrays import Floats
from ..haptics.budget import Budget, Rung, usable
from ..haptics.coupling import displacement
from ..haptics.passivity import NONE, Port
from ..haptics.rendering import NO_WRENCH, Rendering
from ..physics.step import Status
from ..scene import Pose, Scene
from ..simulation.result import StepResult
from ..simulation.simulator import Simulator
from .inbox import Command
from .loop import Recent
from .messages import time_of
from .options import NodeOptions
from .outputs import Outputs

DOUBTFUL = ~Status.LOCKED
"""Status of a step that did not do what was asked. LOCKED alone is how limits of a scene hold tissue that keeps its
volume: the solver converged, the limits are met. Where they are not, ITERATION_LIMIT or LIMIT_EXCEEDED say so."""


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
    doubtful: int = 0
    """Steps with one of DOUBTFUL set."""

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
            self.doubtful += bool(out.status & DOUBTFUL)


class Stepper:
    """Owns the simulation; everything but `newest`, `plane`, `window` and what is read belongs to the loop's thread.

    newest : the command to follow; whoever receives one puts it here
    plane  : the pose that the plane is to take; whoever receives one puts it here
    window : the steps since whoever reports put a new one here
    delay  : times from the receipt of a command to the wrench of its step [s]
    transport : times from the stamp of a command to its receipt [s]
    rendering : of the wrench for the device; it knows whether the command is too old for one
    port   : account of the energy that goes to the device
    """

    def __init__(self, scene: Scene, outputs: Outputs, clock: Any, log: Any) -> None:
        self.scene = scene
        self.newest: Command | None = None
        self.plane: Pose | None = None
        self.window = Window()
        self.delay = Recent()
        self.transport = Recent()
        self.rendering = Rendering()
        self.budget: Budget | None = None
        self.rungs: tuple[Rung, ...] = ()
        self._outputs, self._clock, self._log = outputs, clock, log
        self._followed: Command | None = None
        self._shifted: Pose | None = None
        self._zero = 0  # receipt of the command that placed the finger [ns]: times are counted from it
        self._delay = 0.0
        self.port = Port(scene.dt)

    def prepare(self, progress: Callable[[str], None]) -> None:
        """Loads mesh and kernels. Raises FingerSimError."""
        self.sim = Simulator(self.scene, progress=progress)
        for note in self.sim.mesh.notes:
            self._log.warning(f"{self.scene.mesh.file}: {note}")
        self._take_budget()
        self._outputs.prepare(self.sim.mesh)

    def tick(self, now: int, commands: Sequence[Command]) -> None:
        """One step of scene.dt that begins at a steady time [ns], after commands that came since the last one.

        It is stamped with the present time of the node's clock.
        """
        followed = self._begin(now)
        if self.newest is not None and not followed:
            commands = [self.newest]
        for command in commands:
            self.sim.hear(command.pose, 1e-9 * (command.received_ns - self._zero))
        self._step(None, self.newest, now, time_of(self._clock))

    def answer(self, command: Command) -> None:
        """One step of scene.dt for `command`, with its stamp if it has one, so that the two can be paired."""
        now, before = time.monotonic_ns(), self._followed
        self._begin(now, command)
        if before is not None and command.received - before.received > self.rendering.timeout:
            self.rendering.silence()
        self._step(command.pose, command, now, command.stamp or time_of(self._clock))

    def idle(self) -> None:
        """Between commands that are each answered by a step: when the last is too old, the device gets no force."""
        command, options = self.newest, self._outputs.options
        now = time.monotonic_ns()
        if command is not None and not self.rendering.stale and not self._watch(command, now):
            device = self._passive(self.rendering.silence(), command, options)
            self._outputs.device(device, time_of(self._clock), now)

    def _begin(self, now: int, command: Command | None = None) -> bool:
        """The first command ever places the finger, each later one moves it there; whether it was placed before."""
        first = command or self.newest
        if self._followed is not None or first is None:
            return True
        self._zero = first.received_ns
        self._shifted = self.plane
        self.sim.reset(first.pose, self.plane)
        if self.sim.set_down_by > 0.0:
            self._log.info(
                f"the first command is {1e3 * self.sim.set_down_by:.2f} mm inside the plane: the finger is put on the "
                "plane above it, and goes there in a tenth of a second"
            )
        return False

    def _step(self, command: Pose | None, newest: Command | None, now: int, stamp: int) -> None:
        """A step, and what it brought. command: of a step that answers it; else what was heard is followed by time."""
        begin, options = time.perf_counter(), self._outputs.options
        rendering = self.rendering
        rendering.scale, rendering.ramp = options.force_scale, options.force_ramp
        rendering.timeout = options.command_timeout
        if newest is not None:
            self._watch(newest, now)
        plane = self.plane if self.plane is not self._shifted else None
        self._shifted = self.plane
        out = self.sim.step(command, plane, now=None if command else 1e-9 * (now - self._zero))
        if self.budget is not None and self.budget.spent(time.perf_counter() - begin):
            self.sim.solve_with(self.rungs[self.budget.rung].solver)
        device = NO_WRENCH
        if newest is not None:
            device = self._passive(
                rendering.render(out.device_wrench, self.scene.coupling, self.scene.dt), newest, options
            )
        self._outputs.step(self.sim, out, device, stamp, options, now)
        if newest is not None and newest is not self._followed:
            self._followed = newest
            self.delay.add(time.monotonic() - newest.received)
            self.transport.add(newest.transport)
        self.window.add(out)

    def _passive(self, wrench: Floats, command: Command, options: NodeOptions) -> Floats:
        """The wrench as the port's account lets it pass; with `passivity` observe it passes as it is.

        The way back to the device is taken to be as long as the way here.
        """
        port, limits, before = self.port, self.scene.coupling, self._followed
        fresh = command is not before
        moved = displacement(before.pose, command.pose) if fresh and before is not None else NONE
        if fresh:
            self._delay = 2.0 * command.transport + time.monotonic() - command.received
        port.controlled = options.passivity == "control"
        port.force_limit, port.torque_limit = limits.force_limit, limits.torque_limit
        sent = port.step(wrench.tolist(), moved, self._delay, fresh)
        return np.array(sent) if port.controlled else wrench

    def reset(self) -> Pose:
        """Back to rest at the last command."""
        self.sim.reset()
        return self.sim.pose

    def apply(self, changes: dict[str, Any], options: NodeOptions) -> None:
        """Changes live values of the scene, and the node's options with them. Raises SceneError."""
        self.sim.apply(changes)
        self._outputs.options = options
        self.scene = self.sim.scene
        self._take_budget()

    def _take_budget(self) -> None:
        """Begin at the top of the ladder with the scene's budget, if it has one."""
        milliseconds = self.scene.solver.budget_ms
        self.rungs = usable(self.scene, self.sim.mesh) if milliseconds is not None else ()
        self.budget = Budget(1e-3 * milliseconds, len(self.rungs)) if milliseconds is not None else None

    def _watch(self, command: Command, now: int) -> bool:
        """Whether the command is recent at a steady time [ns]; says so when that changes."""
        rendering, was = self.rendering, self.rendering.stale
        recent = rendering.watch(1e-9 * (now - command.received_ns))
        if rendering.stale and not was:
            self._log.warning(f"no command for {rendering.timeout:g} s: holding the pose, device_wrench is zero")
        elif was and recent:
            self._log.info("commands are back: device_wrench follows the contact again")
        return recent
