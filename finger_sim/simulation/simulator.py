"""`Simulator`: a scene that can be stepped. Owns the arrays; turns the kernel's status into results."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numba import types

from ..arrays import Floats, read_only
from ..errors import SceneError
from ..haptics.coupling import device_wrench, outside, set_down, spring_wrench
from ..haptics.following import MODES, Follower
from ..haptics.leading import KERNELS as DRIVE_KERNELS
from ..haptics.path import numbers, pose_of
from ..haptics.sending import KERNELS as SENDING_KERNELS
from ..haptics.sending import load
from ..physics.clock import STAGES
from ..physics.compile import compiling
from ..physics.elasticity import ALL_OF_A
from ..physics.ready import kernels as ready_kernels
from ..physics.ready import measure_strains, ready, refresh, step_beside, strains_of
from ..physics.records import direct, held
from ..physics.relaxation import suddenly
from ..physics.rotations import matrix
from ..physics.work import WORK
from ..physics.workspace import build_state
from ..scene import Pose, Scene, Solver, Vec3, checked_pose, place
from ..scene.mesh import TetMesh
from . import whole
from .build import build_model, with_live_values
from .drive import Drive, checked_time
from .ground import KERNELS as GROUND_KERNELS
from .ground import Ground, checked_target
from .guard import build_guard, wake
from .result import STATUSES, StepResult, measured
from .rigid import best_fit, carried, twist_of
from .touch import Imprint
from .whole import (
    AFTER_PLANE,
    ASLEEP,
    FALLS_ASLEEP,
    FIRST,
    REJECTED,
    SUNK,
    TO_MEND,
    Body,
    build_body,
)  # fmt: skip
from .whole import KERNELS as STEP_KERNELS

Tell = Callable[[str], None]
"""Takes short texts on what is going on."""

_WHERE_PLANES_ARE = {"plane.point", "plane.normal"}


class Compiled(NamedTuple):
    """A body as compiled code steps it (whole.advance): the address of a substep, and records."""

    address: int
    model: Any
    state: Any
    body: Body


class Changed(NamedTuple):
    """A scene with other live values, and whether they say where its plane is."""

    scene: Scene
    plane: bool


class Simulator:
    """A soft body on its scene, stepped by `scene.dt`.

    A command maps the mesh as read into the world (`Pose`). The body starts at rest at `scene.initial_pose`.
    `progress` is told in short texts what is going on while kernels compile or load.
    `timed`: steps measure their stages (`stage_seconds`), which costs them a few clock readings.
    `touch`: results hold contact area, centre of pressure and slip (`StepResult.touch`).
    `meanwhile` is called while a second process may compile the step, to compile what else is needed with the
    Simulator: it is told what the types of `compiled` will be, in which there is no step yet.
    Raises MeshError when the scene's mesh cannot be used.
    """

    def __init__(
        self,
        scene: Scene,
        progress: Tell | None = None,
        *,
        timed: bool = False,
        touch: bool = False,
        meanwhile: Callable[[Compiled], None] | None = None,
    ) -> None:
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
        self._given = self._good = scene.initial_pose
        self._ground = Ground(scene.plane)
        guard = build_guard(
            self._model.length, float(np.linalg.norm(self.mesh.points, axis=1).max()),
            driven=self._driven, sleeps=scene.solver.sleep,
        )  # fmt: skip
        self._asleep: StepResult | None = None  # what the body gave when it fell asleep
        self.set_down_by = 0.0
        """How far above its command the last reset put the body, as it would have been in the plane [m]."""
        self._touch = touch
        kernels = (*ready_kernels(self._model), *DRIVE_KERNELS, *GROUND_KERNELS, *STEP_KERNELS, *SENDING_KERNELS)
        with compiling(tell, kernels):
            with step_beside(self._model, self._state) as self._model:
                self._drive = Drive(
                    scene.initial_pose, self._rest_driven, self._centre if self._driven else None, self._yields,
                    self._state.target, self._ground.table,
                )  # fmt: skip
                self._body = build_body(self._drive.lead, self._ground.table, guard, self._state.result)
                self._held = held(self._body)
                self._place(scene.initial_pose)
                load()
                model, state = held(self._model), held(self._state)
                self._advance = direct(whole.advance, types.int64, model, state, self._held, types.float64, types.int64)
                if meanwhile is not None:
                    meanwhile(Compiled(0, model, state, self._body))
            self._ready = ready(self._model, self._state)
            self._use(scene)
            # Every kernel that a run will call is compiled or loaded here.
            self.set_state(self.mesh.points, np.zeros_like(self.mesh.points))
            self._run(math.nan, FIRST)
            measure_strains(self._ready)
        self.reset(scene.initial_pose)
        tell("ready")

    @property
    def pose(self) -> Pose:
        """The simulated finger frame, world."""
        return pose_of(self._body.pose)

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
        if plane is not None:
            self._ground.aim(plane)
        begins = math.nan if now is None else now
        why = self._run(begins, FIRST)
        while why in TO_MEND:
            why = self._run(begins, self.mend(why))
        if why == ASLEEP and self._asleep is not None:
            return self._asleep.later(self.time)
        out = self._report()
        if why == FALLS_ASLEEP:
            self._asleep = out
            self._state.v[:] = 0.0
        return out

    def _run(self, now: float, begin: int) -> int:
        """See whole.advance."""
        address, model, state, _ = self.compiled
        why: int = self._advance(address, model, state, self._held, now, begin)
        return why

    def mend(self, why: int) -> int:
        """What a compiled step (whole.py) returned for; where it is to go on."""
        body = self._body
        if why == SUNK:
            self._set_down()
            return AFTER_PLANE
        if why == REJECTED:
            self._move_rigidly(pose_of(body.before), self.pose, self.scene.dt / self.scene.substeps)
        else:
            self._restore()
            body.restored[0] = 1
        return int(body.done[0])

    def _checked(self, command: Pose) -> Pose:
        """A command with a unit quaternion. Raises SceneError; nothing has changed then."""
        if command is not self._given:
            self._good = checked_pose(command, "command")
            self._given = command
        return self._good

    def _report(self) -> StepResult:
        """What a step gives."""
        state, body = self._state, self._body
        wrench = self.locate()
        felt = spring_wrench(state.coupling, self.pose, self._drive.end) if self._yields else wrench
        return StepResult(
            self.time, wrench, device_wrench(self.scene.coupling, felt), self.pose, int(body.iterations[0]),
            float(body.residual[0]), STATUSES[body.status[0]], *measured(body.result.tolist()),
            touch=Imprint.of(self).touch() if self._touch else None,
        )  # fmt: skip

    def locate(self) -> Floats:
        """The contact wrench (6,) about the finger frame [N, N m]. `step` does this by itself.

        That of a body without a bone is where its nodes fit it best.
        """
        wrench = self._state.wrench.copy()
        if not self._driven:
            self._place(best_fit(self.mesh.points, self.positions, self._model.mass))
            wrench[3:] += np.cross(self._state.origin - np.array(self.pose.position), wrench[:3])
        return wrench

    def _place(self, pose: Pose) -> None:
        """The simulated finger frame is there."""
        self._body.pose[:] = numbers(pose)

    def reset(self, pose: Pose | None = None, plane: Pose | None = None) -> None:
        """Back to rest at `pose` (default: the last command), at time 0.

        plane: where the plane rests, as in `step`; None: where it was last wanted.
        A body that would be in the plane is put right above it, and goes on to `pose` from there in a tenth of a
        second (`set_down_by`).

        Raises SceneError as `step` does; nothing has changed then.
        """
        plane = checked_target(self._ground, plane)
        pose = self._drive.command if pose is None else self._checked(pose)
        self._ground.arrive(plane)
        there = outside(*self._ground.surface, self._skin, pose) if self._driven and self._ground else pose
        self.set_down_by = math.dist(there.position, pose.position)
        self._drive.rest(there, pose)
        self._place(there)
        self._body.steps[0] = 0
        self._restore()
        self._state.laps[:] = 0.0
        self._state.work[:] = 0

    def set_state(self, positions: Floats, velocities: Floats) -> None:
        """Put the nodes at `positions` [m] with `velocities` [m/s], both (n, 3), world; row forces are forgotten.

        Stress that relaxes is that of a body that was suddenly deformed so: nothing of it has faded yet.
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
        self._ground.write(state)
        wake(self._body.guard)
        state.stale[:], state.held_tets[0] = (ALL_OF_A, 0), 0
        state.newton.factors[0] = state.newton.spent[0] = state.newton.poor[0] = 0
        state.secants.ring[:] = 0
        refresh(self._ready)
        if self.scene.material.relaxation:
            suddenly(self._model, state)

    def apply(self, values: Mapping[str, Any]) -> None:
        """Change live values of the scene (dotted keys, e.g. {"plane.friction": 0.3}) between two steps.

        A plane goes to another place as to a target of `step`, in a tenth of a second; `reset` puts it there.
        All or none. Raises SceneError when one is out of range, or needs a new Simulator.
        """
        self.use(self.changed(values))

    def changed(self, values: Mapping[str, Any]) -> Changed:
        """What `use` takes to do the same: this much of it can be done while steps are made. Raises SceneError."""
        live = {p.name for p in self.scene.parameters() if p.spec.live}
        for key, value in values.items():
            if key not in live:
                raise SceneError(key, value, f"values that may change while running: {', '.join(sorted(live))}")
        return Changed(self.scene.with_values(values), bool(values.keys() & _WHERE_PLANES_ARE))

    def use(self, changed: Changed) -> None:
        """Changed live values, from the next step on."""
        self.scene, plane = changed.scene, changed.scene.plane
        if plane is not None and changed.plane:
            self._ground.move(plane)
        self._use(self.scene)

    def solve_with(self, solver: Solver) -> None:
        """Solve from the next step on with these settings (those that may change while running), not the scene's.

        `apply` takes the scene's again.
        """
        self._use(dataclasses.replace(self.scene, solver=solver))

    @property
    def time(self) -> float:
        """Simulated time since the last reset [s]."""
        return float(self._body.steps[0] * self.scene.dt)

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
        return self._ground.frame if self._ground else None

    @property
    def plane_twist(self) -> Floats:
        """(6,) velocity of that pose's origin [m/s] and angular velocity [rad/s], world; zeros without one."""
        return self._ground.twist

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
        return self._of_mesh(self._state.strain_ratio)

    def strains_of(self, bounded: Floats, ratios: Floats) -> Floats:
        """strain/limit (T,), as `strain_ratio`, of copies of State.limit_strain and strain_ratio; of another thread."""
        return self._of_mesh(strains_of(self._ready, bounded, ratios))

    def _of_mesh(self, values: Floats) -> Floats:
        """Values (T,) of the model's tetrahedra, as those of the mesh."""
        out = np.empty_like(values)
        out[self._model.tet_number] = values
        return read_only(out)

    def _use(self, scene: Scene) -> None:
        """The live values of a scene."""
        body = self._body
        self._model = with_live_values(self._model, scene)
        self._ready = ready(self._model, self._state, self._ready)
        self.compiled = Compiled(self._ready.address, self._ready.model, self._ready.state, self._body)
        """What compiled code steps; another one after `apply` and `solve_with`."""
        body.dt[0], body.substeps[0], body.mode[0] = scene.dt, scene.substeps, MODES[scene.coupling.following]
        self._drive.allow(scene.coupling)
        self._ground.allow(scene.coupling)
        self._state.stale[0] = ALL_OF_A
        wake(body.guard)

    def _move_rigidly(self, before: Pose, after: Pose, h: float) -> None:
        """After a rejected step: every node goes with the bone; a body whose bone yields, or that has none, stops.

        It stays deformed as it was, and its stress goes on to relax.
        """
        overstrain = self._state.relaxing.overstrain.copy()
        if not self._driven or self._yields:
            self.set_state(self.positions, np.zeros_like(self.positions))
        else:
            moved = carried(self.positions, before, after)
            self.set_state(moved, (moved - self.positions) / h)
        self._state.relaxing.overstrain[:] = overstrain

    def _restore(self) -> None:
        """Undeformed and at rest where the bone is: what else is left to a body that is beyond repair (see Guard)."""
        self._body.guard.rejections[0] = 0.0
        positions = place(self.mesh.points, self.pose)
        self.set_state(positions, np.zeros_like(positions))

    def _set_down(self) -> None:
        """A bone that yields and finds itself past the plane goes to rest on it; the step's status says so."""
        pose = self.pose
        there = set_down(*self._ground.surface, self._centre, self._skin, pose)
        if there is not pose:
            self._place(there)
            self._restore()
            self._body.restored[0] = 1
