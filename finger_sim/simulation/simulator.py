"""`Simulator`: a scene that can be stepped. Owns the arrays; turns the kernel's status into results."""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from ..arrays import Floats, read_only
from ..errors import SceneError
from ..haptics.coupling import device_wrench, outside, set_down, spring_wrench
from ..haptics.following import Follower
from ..haptics.leading import KERNELS as DRIVE_KERNELS
from ..haptics.sending import KERNELS as SENDING_KERNELS
from ..haptics.sending import load
from ..physics import step as stepping
from ..physics.clock import STAGES
from ..physics.compile import compiling
from ..physics.ready import KERNELS, advance, measure_strains, ready, refresh
from ..physics.rotations import matrix
from ..physics.step import Status
from ..physics.work import WORK
from ..physics.workspace import build_state
from ..scene import Pose, Scene, Solver, Vec3, checked_pose, place
from ..scene.mesh import TetMesh
from .build import build_model, with_live_values
from .drive import Drive, checked_time
from .ground import Ground, checked_target
from .guard import Guard, Verdict
from .result import STATUSES, StepResult, measured
from .rigid import best_fit, carried, twist_of
from .touch import Imprint

Tell = Callable[[str], None]
"""Takes short texts on what is going on."""

_WHERE_PLANES_ARE = {"plane.point", "plane.normal"}
_REJECTED, _RESTORED = int(Status.STEP_REJECTED), int(Status.RESTORED)


class Simulator:
    """A soft body on its scene, stepped by `scene.dt`.

    A command maps the mesh as read into the world (`Pose`). The body starts at rest at `scene.initial_pose`.
    `progress` is told in short texts what is going on while kernels compile or load.
    `timed`: steps measure their stages (`stage_seconds`), which costs them a few clock readings.
    `touch`: results hold contact area, centre of pressure and slip (`StepResult.touch`).
    Raises MeshError when the scene's mesh cannot be used.
    """

    def __init__(self, scene: Scene, progress: Tell | None = None, *, timed: bool = False, touch: bool = False) -> None:
        tell = progress or (lambda text: None)
        self.scene = scene
        self.mesh: TetMesh = scene.load_mesh()
        tell(f"mesh: {len(self.mesh.tets)} tetrahedra, {len(self.mesh.points)} nodes")
        self._model = build_model(scene, self.mesh)
        self._state = build_state(self._model, self.mesh.points, timed)
        self._rest_driven = self.mesh.points[self._model.driven]
        self._driven, self._yields = scene.driven is not None, scene.coupling.type == "virtual"
        self._skin = self.mesh.points[self._model.contact_nodes]
        x, y, z = self._rest_driven.mean(axis=0).tolist() if self._driven else (0.0, 0.0, 0.0)
        self._centre: Vec3 = (x, y, z)
        self._given = self._good = self.pose = scene.initial_pose
        self._ground = Ground(scene.plane) if scene.plane is not None else None
        self._guard = Guard(
            self._model.length, float(np.linalg.norm(self.mesh.points, axis=1).max()),
            driven=self._driven, sleeps=scene.solver.sleep,
        )  # fmt: skip
        self._asleep: StepResult | None = None  # what the body gave when it fell asleep
        self.set_down_by = 0.0
        """How far above its command the last reset put the body, as it would have been in the plane [m]."""
        self._was_set_down = False
        self._steps, self._timed, self._touch = 0, timed, touch
        with compiling(tell, (*KERNELS, *DRIVE_KERNELS, *SENDING_KERNELS)):
            self._drive = Drive(
                self.pose, self._rest_driven, self._centre if self._driven else None, self._yields, self._state.target
            )
            self._ready = ready(self._model, self._state)
            # Every kernel that a run will call is compiled or loaded here.
            self.set_state(self.mesh.points, np.zeros_like(self.mesh.points))
            advance(self._ready, self._rest_driven.copy(), scene.dt / scene.substeps)
            measure_strains(self._ready)
            load()
        self.reset(scene.initial_pose)
        tell("ready")

    def hear(self, command: Pose, received: float) -> None:
        """A command for the next step that came at a time [s], as `step` takes it; for several, or late ones.

        Raises SceneError as `step` does; nothing has changed then.
        """
        self._drive.hear(self._checked(command), checked_time(received, "received"))

    def step(self, command: Pose | None = None, plane: Pose | None = None, *, now: float | None = None) -> StepResult:
        """Advance by `scene.dt` towards `command`; None holds the last one. A free body takes no command.

        How commands that come less often than steps are followed: `coupling.following`.
        plane: where the plane is wanted from now on, as the x-y plane of a pose (see Ground); None: as before.
        now: when the step begins [s], on the clock that `hear` was told times of; None: dt after the last one began.

        Raises SceneError when a pose is refused (see checked_pose), when the scene has no plane to move, or when a
        time is not finite; the state is then unchanged.
        """
        plane, now = checked_target(self._ground, plane), checked_time(now, "now")
        if command is not None:
            self._drive.hear(self._checked(command), None)
        scene, drive, ground = self.scene, self._drive, self._ground
        self._steps += 1
        shifts = ground is not None and ground.advance(plane, scene.coupling, scene.dt)
        if shifts:
            self._set_down()
        surface, part = ground.surface if ground else None, 1.0 / scene.substeps
        moves = drive.advance(scene.coupling, surface, now, scene.dt, part) or shifts
        slept = self._guard.slept
        if not self._guard.advance(moves) and self._asleep is not None:
            return self._asleep.later(self.time)
        if slept:
            self._state.held[0] += slept * scene.dt
        self._state.moves[0] = moves
        status, iterations, residual = int(Status.COMMAND_LIMITED) if drive.limited else 0, 0, 0.0
        if self._was_set_down:
            status |= _RESTORED
            self._was_set_down = False
        for substep in range(1, scene.substeps + 1):
            result = self._substep(substep / scene.substeps, shifts)
            status |= int(result[stepping.STATUS])
            iterations += int(result[stepping.ITERATIONS])
            residual = max(residual, result[stepping.RESIDUAL])
        out = self._report(status, iterations, residual, result)
        match self._guard.judge(status, result, moves, scene.dt):
            case Verdict.SLEEPS:
                self._asleep = out
                self._state.v[:] = 0.0
            case Verdict.RESTORED:
                self._restore()
                out = dataclasses.replace(out, status=out.status | Status.RESTORED)
        return out

    def _checked(self, command: Pose) -> Pose:
        """A command with a unit quaternion. Raises SceneError; nothing has changed then."""
        if command is not self._given:
            self._good = checked_pose(command, "command")
            self._given = command
        return self._good

    def _substep(self, part: float, shifts: bool) -> list[float]:
        """Advance by the substep that ends after a part of the step; State.result, with RESTORED in its status."""
        scene, state, drive = self.scene, self._state, self._drive
        h = scene.dt / scene.substeps
        before, wanted = self.pose, drive.at(part)
        if shifts and self._ground is not None:
            self._ground.write(state, part, moving=True)
        if not self._yields:
            if self._driven:
                self.pose = wanted
            origin = state.origin
            origin[0], origin[1], origin[2] = self.pose.position
        if self._timed:
            state.laps[len(STAGES)] = time.perf_counter()  # the same clock as compiled code's
        advance(self._ready, drive.targets, h)
        result: list[float] = state.result.tolist()
        status = int(result[stepping.STATUS])
        if status & _REJECTED:
            self._move_rigidly(before, self.pose, h)
        elif self._yields:
            x, y, z, *turn = state.bone[:7].tolist()
            self.pose = Pose((x, y, z), tuple(turn))
        if self._guard.broken(status, result, h):
            self._restore()
            result[stepping.STATUS] = status | _RESTORED
        return result

    def _report(self, status: int, iterations: int, residual: float, result: list[float]) -> StepResult:
        """What a step gives, from State.result of its last substep and what all of them came to."""
        state = self._state
        wrench = state.wrench.copy()
        if not self._driven:
            self.pose = best_fit(self.mesh.points, self.positions, self._model.mass)
            wrench[3:] += np.cross(state.origin - np.array(self.pose.position), wrench[:3])
        felt = spring_wrench(state.coupling, self.pose, self._drive.end) if self._yields else wrench
        return StepResult(
            self.time, wrench, device_wrench(self.scene.coupling, felt), self.pose, iterations,
            residual, STATUSES[status], *measured(result),
            touch=Imprint.of(self).touch() if self._touch else None,
        )  # fmt: skip

    def reset(self, pose: Pose | None = None, plane: Pose | None = None) -> None:
        """Back to rest at `pose` (default: the last command), at time 0.

        plane: where the plane rests, as in `step`; None: where it was last wanted.
        A body that would be in the plane is put right above it, and goes on to `pose` from there in a tenth of a
        second (`set_down_by`).

        Raises SceneError as `step` does; nothing has changed then.
        """
        plane = checked_target(self._ground, plane)
        pose = self._drive.command if pose is None else self._checked(pose)
        if self._ground is not None:
            self._ground.arrive(plane)
        there = outside(*self._ground.surface, self._skin, pose) if self._driven and self._ground else pose
        self.set_down_by = math.dist(there.position, pose.position)
        self._drive.rest(there, pose)
        self.pose = there
        self._steps = 0
        self._restore()
        self._was_set_down = False
        self._state.laps[:] = 0.0
        self._state.work[:] = 0

    def set_state(self, positions: Floats, velocities: Floats) -> None:
        """Put the nodes at `positions` [m] with `velocities` [m/s], both (n, 3), world; row forces are forgotten.

        Driven nodes go on from where `pose` has them; a bone that yields, with the rigid motion nearest to theirs.

        Raises SceneError when a shape is wrong or a number is not finite.
        """
        state = self._state
        x, v = (np.array(given, np.float64) for given in (positions, velocities))
        for name, value in (("positions", x), ("velocities", v)):
            if value.shape != self.mesh.points.shape or not np.isfinite(value).all():
                raise SceneError(name, f"shape {value.shape}", f"finite numbers of shape {self.mesh.points.shape}")
        state.x[:, :3], state.v[:, :3] = x, v
        for report in (state.contact_force, state.wrench, state.warm_limit, state.limit_force, state.result):
            report[:] = 0.0
        state.active_rows[:] = 0
        arms = self._rest_driven @ matrix(self.pose.orientation).T
        state.twist[:] = twist_of(arms, v[self._model.driven]) if self._yields else 0.0
        state.coupling[:] = 0.0
        state.bone[:] = (*self.pose.position, *self.pose.orientation) * 2
        state.origin[:] = self.pose.position
        if self._ground is not None:
            self._ground.write(state)
        self._guard.wake()
        state.age[0] = state.held_tets[0] = state.newton.factors[0] = 0
        refresh(self._ready)

    def apply(self, values: Mapping[str, Any]) -> None:
        """Change live values of the scene (dotted keys, e.g. {"plane.friction": 0.3}) between two steps.

        A plane goes to another place as to a target of `step`, in a tenth of a second; `reset` puts it there.
        All or none. Raises SceneError when one is out of range, or needs a new Simulator.
        """
        live = {p.name for p in self.scene.parameters() if p.spec.live}
        for key, value in values.items():
            if key not in live:
                raise SceneError(key, value, f"values that may change while running: {', '.join(sorted(live))}")
        self.scene = self.scene.with_values(values)
        if self._ground is not None and self.scene.plane is not None and values.keys() & _WHERE_PLANES_ARE:
            self._ground.move(self.scene.plane)
        self._use(self.scene)

    def solve_with(self, solver: Solver) -> None:
        """Solve from the next step on with these settings (those that may change while running), not the scene's.

        `apply` takes the scene's again.
        """
        self._use(dataclasses.replace(self.scene, solver=solver))

    @property
    def time(self) -> float:
        """Simulated time since the last reset [s]."""
        return self._steps * self.scene.dt

    @property
    def follower(self) -> Follower:
        """How commands come and are followed: its `cadence`, `delay` and `mode`."""
        return self._drive.follower

    @property
    def stage_seconds(self) -> dict[str, float]:
        """Time spent in each stage of the steps since the last reset [s]; empty unless `timed`."""
        return dict(zip(STAGES, self._state.laps.tolist(), strict=False))

    @property
    def positions(self) -> Floats:
        """Node positions (n, 3) [m], world, read-only; a view that the next step changes."""
        return read_only(self._state.x[:, :3])

    @property
    def velocities(self) -> Floats:
        """Node velocities (n, 3) [m/s], world, read-only."""
        return read_only(self._state.v[:, :3])

    @property
    def work(self) -> dict[str, int]:
        """What the steps since the last reset did, counted: linear steps, factorisations, nodes looked at, …"""
        return dict(zip(WORK, self._state.work.tolist(), strict=True))

    @property
    def plane_pose(self) -> Pose | None:
        """Where the plane is: the x-y plane of this pose, its z the outward normal, world; None without one."""
        return None if self._ground is None else self._ground.frame

    @property
    def plane_twist(self) -> Floats:
        """(6,) velocity of that pose's origin [m/s] and angular velocity [rad/s], world; zeros without one."""
        return np.zeros(6) if self._ground is None else self._ground.twist

    @property
    def node_mass(self) -> Floats:
        """Lumped mass of each node (n,) [kg], read-only."""
        return read_only(self._model.mass)

    @property
    def contact_forces(self) -> Floats:
        """Force of the plane on each node (n, 3) [N], world, read-only."""
        return read_only(self._state.contact_force)

    @property
    def strain_ratio(self) -> Floats:
        """strain/limit of each tetrahedron (T,), 1: exactly at its limit, 0 without limits; read-only."""
        measure_strains(self._ready)
        return read_only(self._state.strain_ratio)

    def _use(self, scene: Scene) -> None:
        """The live values of a scene."""
        self._model = with_live_values(self._model, scene)
        self._state.age[0] = 0
        self._guard.wake()
        self._ready = ready(self._model, self._state)

    def _move_rigidly(self, before: Pose, after: Pose, h: float) -> None:
        """After a rejected step: every node goes with the bone; a body whose bone yields, or that has none, stops."""
        if not self._driven or self._yields:
            self.set_state(self.positions, np.zeros_like(self.positions))
            return
        moved = carried(self.positions, before, after)
        self.set_state(moved, (moved - self.positions) / h)

    def _restore(self) -> None:
        """Undeformed and at rest where the bone is: what else is left to a body that is beyond repair (see Guard)."""
        self._guard.restored()
        positions = place(self.mesh.points, self.pose)
        self.set_state(positions, np.zeros_like(positions))

    def _set_down(self) -> None:
        """A bone that yields and finds itself past the plane goes to rest on it; the next step's status says so."""
        if self._yields and self._ground is not None:
            there = set_down(*self._ground.surface, self._centre, self._skin, self.pose)
            if there is not self.pose:
                self.pose = there
                self._restore()
                self._was_set_down = True
