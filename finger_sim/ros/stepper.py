"""What the loop steps, and what it works by: the simulation, its budget, the wrench for the device."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ..haptics.budget import Budget, Rung, usable
from ..haptics.sending import BACK, BECAME_STALE, Sender
from ..scene import Pose, Scene
from ..simulation.simulator import Changed, Compiled, Simulator
from .accounts import Recent
from .inbox import Command
from .options import NodeOptions
from .outputs import Outputs


class Stepper:
    """Owns the simulation; everything but `newest`, `plane` and what is read belongs to the loop's thread.

    newest : the command to follow; whoever receives one puts it here
    plane  : the pose that the plane is to take; whoever receives one puts it here
    delay  : times from the receipt of a command to the wrench of its step [s]
    transport : times from the stamp of a command to its receipt [s]
    sender : of the wrench for the device
    """

    def __init__(self, scene: Scene, outputs: Outputs, log: Any) -> None:
        self.scene = scene
        self._newest: Command | None = None
        self.plane: Pose | None = None
        self.delay = Recent.none()
        self.transport = Recent.none()
        self.sender = Sender(scene.dt)
        self.rendering, self.port = self.sender.rendering, self.sender.port
        self.budget: Budget | None = None
        self.rungs: tuple[Rung, ...] = ()
        self._followed: Callable[[], Command | None] | None = None
        self._outputs, self._log = outputs, log
        self._let_go = False

    def prepare(self, progress: Callable[[str], None], meanwhile: Callable[[Compiled], None] | None = None) -> None:
        """Loads mesh and kernels; meanwhile: see Simulator. Raises FingerSimError."""
        self.sim = Simulator(self.scene, progress=progress, meanwhile=meanwhile)
        for note in self.sim.mesh.notes:
            self._log.warning(f"{self.scene.mesh.file}: {note}")
        self._take_budget()
        self._outputs.prepare(self.sim.mesh)

    @property
    def newest(self) -> Command | None:
        return self._newest if self._followed is None else self._followed()

    @newest.setter
    def newest(self, command: Command) -> None:
        self._newest = command

    def follow(self, followed: Callable[[], Command | None]) -> None:
        """Steps are made from now on: who makes them knows the newest command."""
        self._followed = followed

    def place(self, pose: Pose, plane: Pose | None) -> None:
        """The first command ever, and where the plane is wanted by then."""
        self.sim.reset(pose, plane)
        if self.sim.set_down_by > 0.0:
            self._log.info(
                f"the first command is {1e3 * self.sim.set_down_by:.2f} mm inside the plane: the finger is put on the "
                "plane above it, and goes there in a tenth of a second"
            )

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
            self._let_go = self.rendering.clutched
        if told & BECAME_STALE and self._let_go:
            self._log.info("the clutch is open: holding the pose, device_wrench is zero")
        elif told & BECAME_STALE:
            self._log.warning(f"no command for {self.rendering.timeout:g} s: holding the pose, device_wrench is zero")
        elif told & BACK:
            why = "the clutch is closed" if self._let_go else "commands are back"
            self._log.info(f"{why}: device_wrench follows the contact again")

    def take_rung(self) -> None:
        """Solve as the rung that the budget stands on has it."""
        if self.budget is not None:
            self.sim.solve_with(self.rungs[self.budget.rung].solver)

    def reset(self) -> Pose:
        """Back to rest at the last command."""
        self.sim.reset()
        return self.sim.pose

    def apply(self, changed: Changed, options: NodeOptions) -> None:
        """Live values of the scene from the next step on, and the node's options with them."""
        self.sim.use(changed)
        self._outputs.options = options
        self.scene = self.sim.scene
        self._take_budget()

    def _take_budget(self) -> None:
        """Begin at the top of the ladder with the scene's budget, if it has one."""
        milliseconds = self.scene.solver.budget_ms
        self.rungs = usable(self.scene, self.sim.mesh) if milliseconds is not None else ()
        self.budget = Budget(1e-3 * milliseconds, len(self.rungs)) if milliseconds is not None else None
