"""One step of the node: the newest command, the watchdog, the simulation, and what it brought."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from ..arrays import Floats
from ..haptics.budget import Budget, Rung, usable
from ..haptics.rendering import NO_WRENCH
from ..haptics.sending import BACK, BECAME_STALE, Sender
from ..scene import Pose, Scene
from ..simulation.simulator import Compiled, Simulator
from .accounts import Recent, Window
from .inbox import Command
from .messages import time_of
from .options import NodeOptions
from .outputs import Outputs


class Observed(NamedTuple):
    """What a loop in compiled code is asked: see Stepper."""

    newest: Callable[[], Command | None]
    moment: Callable[[], tuple[int, int] | None]
    take_window: Callable[[], Window]


class Stepper:
    """Owns the simulation; everything but `newest`, `plane` and what is read belongs to the loop's thread.

    newest : the command to follow; whoever receives one puts it here
    plane  : the pose that the plane is to take; whoever receives one puts it here
    delay  : times from the receipt of a command to the wrench of its step [s]
    transport : times from the stamp of a command to its receipt [s]
    sender : of the wrench for the device
    """

    def __init__(self, scene: Scene, outputs: Outputs, clock: Any, log: Any) -> None:
        self.scene = scene
        self._newest: Command | None = None
        self.plane: Pose | None = None
        self.delay = Recent.none()
        self.transport = Recent.none()
        self.sender = Sender(scene.dt)
        self.rendering, self.port = self.sender.rendering, self.sender.port
        self.budget: Budget | None = None
        self.rungs: tuple[Rung, ...] = ()
        self._moment: tuple[int, int] | None = None
        self._compiled: Observed | None = None
        self._window = Window()
        self._outputs, self._clock, self._log = outputs, clock, log
        self._followed: Command | None = None
        self._shifted: Pose | None = None
        self._zero = 0  # receipt of the command that placed the finger [ns]: times are counted from it

    def prepare(self, progress: Callable[[str], None], meanwhile: Callable[[Compiled], None] | None = None) -> None:
        """Loads mesh and kernels; meanwhile: see Simulator. Raises FingerSimError."""
        self.sim = Simulator(self.scene, progress=progress, meanwhile=meanwhile)
        for note in self.sim.mesh.notes:
            self._log.warning(f"{self.scene.mesh.file}: {note}")
        self._take_budget()
        self._outputs.prepare(self.sim.mesh)

    @property
    def newest(self) -> Command | None:
        return self._newest if self._compiled is None else self._compiled.newest()

    @newest.setter
    def newest(self, command: Command) -> None:
        self._newest = command

    @property
    def moment(self) -> tuple[int, int] | None:
        """Stamp of the last step, and the steady time at which it began [ns]; None before the first."""
        return self._moment if self._compiled is None else self._compiled.moment()

    def observe(self, compiled: Observed | None) -> None:
        """Compiled code makes the steps from now on, and knows of them; None: it does not any more."""
        self._compiled = compiled

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
        self.place(first.pose, self.plane)
        return False

    def place(self, pose: Pose, plane: Pose | None) -> None:
        """The first command ever, and where the plane is wanted by then."""
        self.sim.reset(pose, plane)
        if self.sim.set_down_by > 0.0:
            self._log.info(
                f"the first command is {1e3 * self.sim.set_down_by:.2f} mm inside the plane: the finger is put on the "
                "plane above it, and goes there in a tenth of a second"
            )

    def _step(self, command: Pose | None, newest: Command | None, now: int, stamp: int) -> None:
        """A step, and what it brought. command: of a step that answers it; else what was heard is followed by time."""
        begin, options = time.perf_counter(), self._outputs.options
        plane = self.plane if self.plane is not self._shifted else None
        self._shifted = self.plane
        out = self.sim.step(command, plane, now=None if command else 1e-9 * (now - self._zero))
        if self.budget is not None and self.budget.spent(time.perf_counter() - begin):
            self.take_rung()
        device = NO_WRENCH if newest is None else self._send(out.device_wrench, newest, now, options)
        self._outputs.step(out, device, stamp, options, now)
        self._moment = (stamp, now)
        if newest is not None and newest is not self._followed:
            self._followed = newest
            self.delay.add(time.monotonic() - newest.received)
            self.transport.add(newest.transport)
        self._window.add(out)

    def _send(self, wrench: Floats, command: Command, now: int, options: NodeOptions) -> Floats:
        """What the device is sent of a step that began at a steady time [ns]; tells when commands stop or are back."""
        self.allow(options)
        device, told = self.sender.send(
            wrench, self.scene.coupling, command.pose if command is not self._followed else None, self.scene.dt,
            transport=command.transport, age=1e-9 * (now - command.received_ns),
            took=1e-9 * (time.monotonic_ns() - now),
        )  # fmt: skip
        self.tell(told)
        return device

    def allow(self, options: NodeOptions) -> None:
        """What a device is sent from now on: as options and coupling have it."""
        rendering, coupling = self.rendering, self.scene.coupling
        rendering.scale, rendering.ramp = options.force_scale, options.force_ramp
        rendering.timeout = options.command_timeout
        self.port.controlled = options.passivity == "control"
        self.sender.allow(coupling)

    def tell(self, told: int) -> None:
        """Of a step: that commands stop, or are back; bits of sending.py."""
        if told & BECAME_STALE:
            self._log.warning(f"no command for {self.rendering.timeout:g} s: holding the pose, device_wrench is zero")
        elif told & BACK:
            self._log.info("commands are back: device_wrench follows the contact again")

    def take_window(self) -> Window:
        """The steps since the last call."""
        if self._compiled is not None:
            return self._compiled.take_window()
        window, self._window = self._window, Window()
        return window

    def take_rung(self) -> None:
        """Solve as the rung that the budget stands on has it."""
        if self.budget is not None:
            self.sim.solve_with(self.rungs[self.budget.rung].solver)

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
