"""One step of the node: the newest command, the watchdog, the simulation, and what it brought."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Sequence
from typing import Any

from ..arrays import Floats
from ..haptics.budget import Budget, Rung, usable
from ..haptics.rendering import NO_WRENCH
from ..haptics.sending import BACK, BECAME_STALE, Sender
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
    rendering, port : of the wrench for the device; see Sender
    """

    def __init__(self, scene: Scene, outputs: Outputs, clock: Any, log: Any) -> None:
        self.scene = scene
        self.newest: Command | None = None
        self.plane: Pose | None = None
        self.window = Window()
        self.delay = Recent()
        self.transport = Recent()
        self._sender = Sender(scene.dt)
        self.rendering, self.port = self._sender.rendering, self._sender.port
        self.budget: Budget | None = None
        self.rungs: tuple[Rung, ...] = ()
        self._outputs, self._clock, self._log = outputs, clock, log
        self._followed: Command | None = None
        self._shifted: Pose | None = None
        self._zero = 0  # receipt of the command that placed the finger [ns]: times are counted from it

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
        command, options, now = self.newest, self._outputs.options, time.monotonic_ns()
        if command is None or self.rendering.stale:
            return
        if 1e-9 * (now - command.received_ns) > options.command_timeout:
            self._outputs.device(self._send(NO_WRENCH, command, now, options), time_of(self._clock), now)

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
        plane = self.plane if self.plane is not self._shifted else None
        self._shifted = self.plane
        out = self.sim.step(command, plane, now=None if command else 1e-9 * (now - self._zero))
        if self.budget is not None and self.budget.spent(time.perf_counter() - begin):
            self.sim.solve_with(self.rungs[self.budget.rung].solver)
        device = NO_WRENCH if newest is None else self._send(out.device_wrench, newest, now, options)
        self._outputs.step(self.sim, out, device, stamp, options, now)
        if newest is not None and newest is not self._followed:
            self._followed = newest
            self.delay.add(time.monotonic() - newest.received)
            self.transport.add(newest.transport)
        self.window.add(out)

    def _send(self, wrench: Floats, command: Command, now: int, options: NodeOptions) -> Floats:
        """What the device is sent of a step that began at a steady time [ns]; tells when commands stop or are back."""
        rendering = self.rendering
        rendering.scale, rendering.ramp = options.force_scale, options.force_ramp
        rendering.timeout = options.command_timeout
        self.port.controlled = options.passivity == "control"
        device, told = self._sender.send(
            wrench, self.scene.coupling, command.pose if command is not self._followed else None, self.scene.dt,
            transport=command.transport, age=1e-9 * (now - command.received_ns),
            took=1e-9 * (time.monotonic_ns() - now),
        )  # fmt: skip
        if told == BECAME_STALE:
            self._log.warning(f"no command for {rendering.timeout:g} s: holding the pose, device_wrench is zero")
        elif told == BACK:
            self._log.info("commands are back: device_wrench follows the contact again")
        return device

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
