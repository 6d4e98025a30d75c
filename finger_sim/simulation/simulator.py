"""`Simulator`: a scene that can be stepped. Owns the arrays; turns the kernel's status into results."""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ..arrays import Floats
from ..bags.layout import place
from ..errors import SceneError
from ..haptics.coupling import CommandSpeed, between, device_wrench, follow, set_down, spring_wrench, stop_at_plane
from ..haptics.plane_motion import PlaneMotion
from ..physics import step as stepping
from ..physics.clock import STAGES
from ..physics.compile import compiled_before
from ..physics.contact import plane_frame
from ..physics.ready import advance, measure_strains, ready, refresh
from ..physics.rotations import ZERO_NORM, matrix, normalised
from ..physics.step import Status
from ..physics.work import WORK
from ..physics.workspace import build_state
from ..scene import Pose, Scene, Solver, Vec3
from ..scene.fields import specs
from ..scene.mesh import TetMesh
from .build import build_model, with_live_values

Progress = Callable[[str], None]

MOST_REJECTIONS, TORN = 20, 30.0
"""Steps rejected in a row, and distance from the finger frame's origin over that at rest, that restore a body."""
RAGING, RAGING_TIME = 20.0, 0.25
"""Speed in tetrahedra's sizes a second, and time under a command that holds [s], that restore a strained body."""
_POSE = specs(Pose)
_FARTHEST = _POSE["position"].high
_REJECTED = int(Status.STEP_REJECTED)
_INVERTED, _RESTORED = int(Status.INVERTED), int(Status.RESTORED)
_STRAINED = int(Status.INVERTED | Status.LIMIT_EXCEEDED)
_UNSETTLED = int(Status.STEP_REJECTED | Status.COMMAND_LIMITED)
STILL, STILL_TIME = 1e-7, 0.01
"""A body sleeps when for so long [s] no node was faster than this part of the tetrahedra's size a second."""


@dataclasses.dataclass(frozen=True, slots=True)
class StepResult:
    """What one step gives. Wrenches are of the plane on the finger, world axes, about the finger frame's origin."""

    time: float  # end of the step [s]
    contact_wrench: Floats  # (6,) force [N] and torque [N m]
    device_wrench: Floats  # (6,) what a device is to render: clamped
    pose: Pose  # the simulated finger frame, world
    iterations: int  # solver sweeps
    residual: float  # see Solver.tolerance
    status: Status  # 0: all well
    limited_tets: int  # tetrahedra held by at least one limit
    limit_rows: int  # limit rows that carry a force
    locked_tets: int  # tetrahedra at a limit that are over-constrained: see locking.py
    max_strain_ratio: float  # largest strain/limit, 1: exactly at the limit; 0 without limits
    contacts: int  # nodes that carry a contact force
    max_penetration: float  # deepest surface node [m], 0 when none
    asleep: bool = False  # nothing moved and nothing changed: the step was not computed

    def later(self, time: float) -> StepResult:
        """The same of a body asleep, at another time."""
        return StepResult(
            time, self.contact_wrench.copy(), self.device_wrench.copy(), self.pose, 0, self.residual, self.status,
            self.limited_tets, self.limit_rows, self.locked_tets, self.max_strain_ratio, self.contacts,
            self.max_penetration, True,
        )  # fmt: skip


class Simulator:
    """A soft body on its scene, stepped by `scene.dt`.

    A command maps the mesh as read into the world (`Pose`). The body starts at rest at `scene.initial_pose`.
    `progress` is told in short texts what is going on while kernels compile or load.
    `timed`: steps measure their stages (`stage_seconds`), which costs them a few clock readings.
    Raises MeshError when the scene's mesh cannot be used.
    """

    def __init__(self, scene: Scene, progress: Progress | None = None, *, timed: bool = False) -> None:
        tell = progress or (lambda text: None)
        self.scene = scene
        self.mesh: TetMesh = scene.load_mesh()
        tell(f"mesh: {len(self.mesh.tets)} tetrahedra, {len(self.mesh.points)} nodes")
        self._model = build_model(scene, self.mesh)
        self._state = build_state(self._model, self.mesh.points, timed)
        self._ready = ready(self._model, self._state)
        self._plane = _plane_of(scene)
        self._motion = PlaneMotion()
        self._rest_driven = self.mesh.points[self._model.driven]
        self._centre = tuple(self._rest_driven.mean(axis=0).tolist()) if len(self._rest_driven) else (0.0, 0.0, 0.0)
        self._turned_by, self._turned_driven = Pose().orientation, self._rest_driven
        self._driven = scene.driven is not None
        self._yields = scene.coupling.type == "virtual"
        self._command = self._given = self._target = self.pose = scene.initial_pose
        self._speed = CommandSpeed()
        self._still = STILL * self._model.length
        self._torn = TORN * float(np.linalg.norm(self.mesh.points, axis=1).max())
        self._raging = RAGING * self._model.length
        self._rejections = 0
        self._was_set_down = False
        self._asleep: StepResult | None = None
        self._still_since = self._raging_since = self._steps = 0
        self._timed = timed
        if compiled_before():
            tell("loading compiled kernels")
        else:
            tell("compiling kernels: once for this version, up to a minute")
        self._warm_up()
        self.reset(scene.initial_pose)
        tell("ready")

    def step(self, command: Pose | None = None, plane: Pose | None = None) -> StepResult:
        """Advance by `scene.dt` towards `command`; None holds the last one. A free body takes no command.

        plane: where the plane is wanted from now on, as the x-y plane of a pose (see PlaneMotion); None: as before.

        Raises SceneError when a pose is not finite or its quaternion is zero, or when the scene has no plane to move;
        the state is then unchanged.
        """
        if plane is not None:
            if self._plane is None:
                raise SceneError("plane", None, "a scene with a plane, to move it")
            plane = _checked(plane, "plane")
        if self._asleep is not None:
            if plane is None and (command is None or command == self._given):
                self._steps += 1
                return self._asleep.later(self._steps * self.scene.dt)
            self._asleep = None
        if command is not None:
            self._command, self._given = _checked(command), command
        scene, state = self.scene, self._state
        shifts = self._motion.step(plane, scene.coupling, scene.dt)
        if shifts:
            self._plane = self._motion.surface()
            self._set_down()
        start, limited = self._target if self._yields else self.pose, False
        end = start
        if self._driven:
            end, limited = follow(scene.coupling, start, self._command, scene.dt)
            if self._plane is not None and end is not start and not self._yields:
                end, stopped = stop_at_plane(*self._plane, self._centre, start, end)
                limited |= stopped
        self._target = end
        moves = end != start or shifts
        if self._yields:
            state.target[7:13] = self._speed.step(start, end, scene.dt)
            state.target[13] = moves
            moves |= bool(state.target[7:13].any())
        h = scene.dt / scene.substeps
        status, iterations, residual = int(Status.COMMAND_LIMITED) if limited else 0, 0, 0.0
        if self._was_set_down:
            status |= _RESTORED
            self._was_set_down = False
        for substep in range(1, scene.substeps + 1):
            before, after = self.pose, between(start, end, substep / scene.substeps)
            if shifts:
                self._plane = self._motion.surface(substep / scene.substeps)
                self._place_plane()
                state.plane_motion[:] = self._motion.twist
            if self._yields:
                state.target[:7] = *after.position, *after.orientation
            else:
                self.pose = after
                state.origin[:] = after.position
            if self._timed:
                state.laps[len(STAGES)] = time.perf_counter()  # the same clock as compiled code's
            advance(self._ready, self._rest_driven if self._yields else self._targets(), h)
            result = state.result.tolist()
            came = int(result[stepping.STATUS])
            if came & _REJECTED:
                self._move_rigidly(before, self.pose, h)
            elif self._yields:
                self.pose = _pose_of(state.bone[:7].tolist())
            self._rejections = self._rejections + 1 if came & _REJECTED else 0
            if self._rejections >= MOST_REJECTIONS or self._torn_apart(result, h):
                self._restore()
                came |= _RESTORED
            status |= came
            iterations += int(result[stepping.ITERATIONS])
            residual = max(residual, result[stepping.RESIDUAL])
        self._steps += 1
        wrench = state.wrench.copy()
        if not self._driven:
            self.pose = self._best_fit()
            wrench[3:] += np.cross(state.origin - np.array(self.pose.position), wrench[:3])
        out = StepResult(
            time=self.time,
            contact_wrench=wrench,
            device_wrench=device_wrench(scene.coupling, self._felt(wrench)),
            pose=self.pose,
            iterations=iterations,
            residual=residual,
            status=Status(status),
            limited_tets=int(result[stepping.LIMITED_TETS]),
            limit_rows=int(result[stepping.LIMIT_ROWS]),
            locked_tets=int(result[stepping.LOCKED_TETS]),
            max_strain_ratio=result[stepping.STRAIN_RATIO],
            contacts=int(result[stepping.CONTACTS]),
            max_penetration=result[stepping.PENETRATION],
        )
        raging = status & _STRAINED and out.contacts == 0 and result[stepping.SPEED] > self._raging
        if not raging or moves:
            self._raging_since = self._steps
        elif (self._steps - self._raging_since) * scene.dt >= RAGING_TIME:
            self._restore()
            return dataclasses.replace(out, status=Status(status | _RESTORED))
        if result[stepping.SPEED] > self._still or moves or status & _UNSETTLED:
            self._still_since = self._steps
        elif status & _INVERTED and out.contacts == 0:
            if (self._steps - self._still_since) * scene.dt >= STILL_TIME:
                self._restore()
                return dataclasses.replace(out, status=Status(status | _RESTORED))
        elif scene.solver.sleep and (self._steps - self._still_since) * scene.dt >= STILL_TIME:
            self._asleep = out
            state.v[:] = 0.0
        return out

    def reset(self, pose: Pose | None = None) -> None:
        """Back to rest at `pose` (default: the last command), at time 0; a bone that yields not past the plane."""
        if pose is not None:
            self._command = _checked(pose)
        self.pose = self._target = self._command
        self._speed = CommandSpeed()
        self._steps = 0
        self._restore()
        self._set_down()
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
        state.twist[:] = self._rigid_velocity(v) if self._yields else 0.0
        state.coupling[:] = 0.0
        state.bone[:] = (*self.pose.position, *self.pose.orientation) * 2
        state.origin[:] = self.pose.position
        self._place_plane()
        self._wake()
        state.age[0] = state.held_tets[0] = 0
        refresh(self._ready)

    def apply(self, values: Mapping[str, Any]) -> None:
        """Change live values of the scene (dotted keys, e.g. {"plane.friction": 0.3}) between two steps.

        All or none. Raises SceneError when one is out of range, or needs a new Simulator.
        """
        live = {p.name for p in self.scene.parameters() if p.spec.live}
        for key, value in values.items():
            if key not in live:
                raise SceneError(key, value, f"values that may change while running: {', '.join(sorted(live))}")
        before, self.scene = self.scene.plane, self.scene.with_values(values)
        after = self.scene.plane
        if before and after and (before.point, before.normal) != (after.point, after.normal):
            self._plane, self._motion = _plane_of(self.scene), PlaneMotion()
            self._set_down()
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
    def stage_seconds(self) -> dict[str, float]:
        """Time spent in each stage of the steps since the last reset [s]; empty unless `timed`."""
        return dict(zip(STAGES, self._state.laps.tolist(), strict=False))

    @property
    def positions(self) -> Floats:
        """Node positions (n, 3) [m], world, read-only; a view that the next step changes."""
        return _read_only(self._state.x[:, :3])

    @property
    def velocities(self) -> Floats:
        """Node velocities (n, 3) [m/s], world, read-only."""
        return _read_only(self._state.v[:, :3])

    @property
    def work(self) -> dict[str, int]:
        """What the steps since the last reset did, counted: linear steps, factorisations, nodes looked at, …"""
        return dict(zip(WORK, self._state.work.tolist(), strict=True))

    @property
    def node_mass(self) -> Floats:
        """Lumped mass of each node (n,) [kg], read-only."""
        return _read_only(self._model.mass)

    @property
    def contact_forces(self) -> Floats:
        """Force of the plane on each node (n, 3) [N], world, read-only."""
        return _read_only(self._state.contact_force)

    @property
    def strain_ratio(self) -> Floats:
        """strain/limit of each tetrahedron (T,), 1: exactly at its limit, 0 without limits; read-only."""
        measure_strains(self._ready)
        return _read_only(self._state.strain_ratio)

    def _use(self, scene: Scene) -> None:
        """The live values of a scene."""
        self._model = with_live_values(self._model, scene)
        self._place_plane()
        self._state.age[0] = 0
        self._wake()
        self._ready = ready(self._model, self._state)

    def _place_plane(self) -> None:
        """The plane where it is now, at rest."""
        if self._plane is not None:
            normal, point = self._plane
            self._state.plane_frame[:], self._state.plane_point[:] = plane_frame(np.array(normal)), point
        self._state.plane_motion[:] = 0.0
        self._state.clearance[0] = -1.0

    def _felt(self, contact_wrench: Floats) -> Floats:
        """What a device is to render, before its limits: the coupling's wrench on it, or that of the plane."""
        if self._yields:
            return spring_wrench(self._state.coupling, self.pose, self._target)
        return contact_wrench

    def _wake(self) -> None:
        """Compute the next step, whatever the command."""
        self._asleep = None
        self._still_since = self._raging_since = self._steps

    def _targets(self) -> Floats:
        """Where the driven nodes are to be, (nd, 3) [m], at self.pose; the turned rest nodes are kept for the next."""
        if self.pose.orientation != self._turned_by:
            self._turned_by = self.pose.orientation
            self._turned_driven = self._rest_driven @ matrix(self._turned_by).T
        targets: Floats = self._turned_driven + self.pose.position
        return targets

    def _move_rigidly(self, before: Pose, after: Pose, h: float) -> None:
        """After a rejected step: every node goes with the bone; a body whose bone yields, or that has none, stops."""
        if not self._driven or self._yields:
            self.set_state(self.positions, np.zeros_like(self.positions))
            return
        turn = matrix(after.orientation) @ matrix(before.orientation).T
        moved = (self.positions - np.array(before.position)) @ turn.T + np.array(after.position)
        self.set_state(moved, (moved - self.positions) / h)

    def _torn_apart(self, result: list[float], h: float) -> bool:
        """Whether a node is beyond TORN; a free body's frame is that of the step before."""
        lag = 0.0 if self._driven else h * result[stepping.SPEED]
        return result[stepping.REACH] > self._torn + lag

    def _restore(self) -> None:
        """Undeformed and at rest where the bone is: what else is left to a body that is beyond repair.

        After MOST_REJECTIONS in a row, torn to TORN times its size, at rest with a tetrahedron inside out, or raging:
        strained beyond its limits or inside out, and not coming to rest, with nothing that holds it so.
        """
        self._rejections = 0
        positions = place(self.mesh.points, self.pose)
        self.set_state(positions, np.zeros_like(positions))

    def _set_down(self) -> None:
        """A bone that yields and finds itself past the plane goes to rest on it; the next step's status says so."""
        if self._yields and self._plane is not None:
            there = set_down(*self._plane, self._centre, self.mesh.points, self.pose)
            if there is not self.pose:
                self.pose = there
                self._restore()
                self._was_set_down = True

    def _rigid_velocity(self, velocities: Floats) -> Floats:
        """(6,) velocity [m/s] of the finger frame's origin and angular velocity [rad/s], from those of all nodes."""
        driven, arms = velocities[self._model.driven], self._rest_driven @ matrix(self.pose.orientation).T
        turning = np.cross(np.eye(3)[None], arms[:, None, :])  # e_k × ρ
        system = np.concatenate([np.broadcast_to(np.eye(3), turning.shape), turning], axis=1).transpose(0, 2, 1)
        twist: Floats = np.linalg.lstsq(system.reshape(-1, 6), driven.ravel())[0]
        return twist

    def _best_fit(self) -> Pose:
        """Frame of a free body: the rigid motion of the rest mesh nearest to the nodes, by mass."""
        mass, x, X = self._model.mass, self.positions, self.mesh.points
        centre, rest_centre = (mass @ x / mass.sum(), mass @ X / mass.sum())
        turn, _ = Rotation.align_vectors(x - centre, X - rest_centre, weights=mass)
        px, py, pz = centre - turn.apply(rest_centre)
        qx, qy, qz, qw = turn.as_quat()
        return Pose((float(px), float(py), float(pz)), (float(qx), float(qy), float(qz), float(qw)))

    def _warm_up(self) -> None:
        """Compile or load every kernel that a run will call."""
        self.set_state(self.mesh.points, np.zeros_like(self.mesh.points))
        advance(self._ready, self._rest_driven.copy(), self.scene.dt / self.scene.substeps)
        measure_strains(self._ready)


def _checked(pose: Pose, name: str = "command") -> Pose:
    """The pose with a unit quaternion. Raises SceneError when it cannot be one."""
    position, orientation = pose.position, pose.orientation
    if not max(map(abs, position)) <= _FARTHEST or not all(map(math.isfinite, position)):
        raise SceneError(f"{name}.position", position, _POSE["position"].allowed)
    if not all(map(math.isfinite, orientation)) or math.hypot(*orientation) < ZERO_NORM:
        raise SceneError(f"{name}.orientation", orientation, _POSE["orientation"].allowed)
    return Pose(position, normalised(orientation))


def _pose_of(numbers: list[float]) -> Pose:
    """The pose of position and unit quaternion, seven numbers."""
    x, y, z, qx, qy, qz, qw = numbers
    return Pose((x, y, z), (qx, qy, qz, qw))


def _plane_of(scene: Scene) -> tuple[Vec3, Vec3] | None:
    """Unit normal and a point of the scene's plane, as plain numbers."""
    if scene.plane is None:
        return None
    x, y, z = scene.plane.unit_normal.tolist()
    return (x, y, z), scene.plane.point


def _read_only(array: Floats) -> Floats:
    view = array.view()
    view.setflags(write=False)
    return view
