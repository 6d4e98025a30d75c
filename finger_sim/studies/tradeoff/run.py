"""A scene through a motion: for its answers and what they cost, counted; and for its times on this machine.

Pure functions of plain values: any worker may call them.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from ...arrays import Floats, Ints
from ...scene import Pose, Scene
from ...scene.mesh import TetMesh
from ...scene.resources import shipped
from ...simulation.simulator import Simulator
from ..shared import deformation, pinned, stretches
from .motion import Motion

SNAPSHOT = 0.025
"""Time between two snapshots of the nodes [s]."""
KICK = 0.02
"""Velocity of the free nodes at the start [m/s]."""
DURATION = 0.01
"""Time over which energy is followed [s]."""
REPEATS = 5
"""Times that a motion is timed, after a warm-up."""
TIMED_ENOUGH = 15.0
"""Time after which no further repetition of a motion is begun [s]."""


@dataclass(frozen=True, eq=False)
class Course:
    """What a scene answered, step by step, and what that took, counted."""

    time: Floats  # (k,) ends of the steps [s]
    wrench: Floats  # (k, 6) contact wrench [N, N m]
    strain_ratio: Floats  # (k,) largest strain/limit
    penetration: Floats  # (k,) [m]
    status: Ints  # (k,)
    held: Ints  # (k,) 1 where the bone was held
    nodes: Floats  # (m, n, 3) positions at the snapshots [m]
    work: Floats  # (2,) factorisations and solver iterations a step
    energy: Floats  # (1,) energy_drift

    @property
    def force(self) -> Floats:
        """(k, 3) [N]."""
        return self.wrench[:, :3]


NAMES = tuple(f.name for f in fields(Course))


def portable(scene: Scene) -> dict[str, Any]:
    """The scene as plain values; a shipped mesh by its name, so that another machine finds its own."""
    data = scene.to_dict()
    folder = str(shipped("config").resolve()) + "/"
    name = data["mesh"].get("file")
    if name is not None and name.startswith(folder):
        data["mesh"]["file"] = name.removeprefix(folder)
    return data


def course(data: dict[str, Any], motion: Motion, drift: bool = True) -> Course:
    """Run a scene (`portable`) through a motion; drift: the energy too. Raises SceneError or MeshError."""
    scene = Scene.from_dict(data)
    simulator, poses, dt = Simulator(scene), motion.poses(scene.dt), scene.dt
    simulator.reset(motion.at(0.0))
    steps, iterations = len(poses), 0
    ends = dt * np.arange(1.0, steps + 1.0, dtype=np.float64)
    wrench, ratio, depth = np.empty((steps, 6)), np.empty(steps), np.empty(steps)
    status = np.zeros(steps, np.int64)
    nodes: list[Floats] = []
    wanted = SNAPSHOT * np.arange(1, int(ends[-1] / SNAPSHOT + 1e-6) + 1)
    for k, pose in enumerate(poses):
        before = simulator.positions.copy() if len(nodes) < len(wanted) else None
        out = simulator.step(pose)
        wrench[k], ratio[k], depth[k] = out.contact_wrench, out.max_strain_ratio, out.max_penetration
        status[k], iterations = int(out.status), iterations + out.iterations
        while before is not None and len(nodes) < len(wanted) and wanted[len(nodes)] <= ends[k] + 1e-9:
            share = 1.0 - (ends[k] - wanted[len(nodes)]) / dt
            nodes.append(before + share * (simulator.positions - before))
    work = np.array([simulator.work["factorisations"], iterations]) / steps
    held = motion.held(ends, dt).astype(np.int64)
    energy = np.array([energy_drift(scene) if drift else np.nan])
    n = len(simulator.mesh.points)
    return Course(ends, wrench, ratio, depth, status, held, np.array(nodes).reshape(-1, n, 3), work, energy)


def energy_drift(scene: Scene) -> float:
    """Change of energy over DURATION as a part of what there was: 0 is right, −1: all of it is lost.

    The scene's body and time step, without limits, plane, gravity and damping; its bone at rest, its free nodes
    kicked along e2. Kinetic energy of the lumped masses and elastic energy of the corotational material.
    """
    data = scene.to_dict() | {"gravity": [0.0, 0.0, 0.0]}
    data["material"] = data["material"] | {"damping": {"mass": 0.0, "stiffness": 0.0}}
    for part in ("limits", "plane", "initial_pose"):
        data.pop(part, None)
    free = Scene.from_dict(data)
    simulator = Simulator(free)
    mesh = simulator.mesh
    velocity = np.zeros_like(mesh.points)
    velocity[np.setdiff1d(np.arange(len(mesh.points)), free.driven_nodes(mesh)), 1] = KICK
    simulator.reset(Pose())
    simulator.set_state(mesh.points, velocity)
    before = _kinetic(simulator)
    for _ in range(max(1, round(DURATION / free.dt))):
        simulator.step()
    young, poisson = free.material.young, free.material.poisson
    return (_kinetic(simulator) + elastic_energy(mesh, simulator.positions, young, poisson)) / before - 1.0


def _kinetic(simulator: Simulator) -> float:
    return 0.5 * float(simulator.node_mass @ (simulator.velocities**2).sum(axis=1))


def elastic_energy(mesh: TetMesh, x: Floats, young: float, poisson: float) -> float:
    """Σ V (μ ‖F − R‖² + λ/2 tr² (RᵀF − I)) of a mesh with its nodes at x (n, 3) [J]."""
    mu, lame = young / (2.0 * (1.0 + poisson)), young * poisson / ((1.0 + poisson) * (1.0 - 2.0 * poisson))
    strain = stretches(deformation(mesh, x))[0] - 1.0
    density = mu * (strain**2).sum(axis=1) + 0.5 * lame * strain.sum(axis=1) ** 2
    edges = mesh.points[mesh.tets[:, :3]] - mesh.points[mesh.tets[:, 3:]]
    return float(np.abs(np.linalg.det(edges)) @ density) / 6.0


@dataclass(frozen=True)
class Times:
    """Seconds of a step. Steps are the same in every repetition: of each, its least time counts."""

    steps: int  # of the motion
    mean: float
    median: float
    p99: float
    p99_disturbed: float  # of all times as they came


def times(data: dict[str, Any], motion: Motion, repeats: int = REPEATS, give_up: float | None = None) -> Times:
    """Time a scene (`portable`) on one processor, whole motions after a warm-up.

    give_up: a motion ends where its steps took so long together [s].
    """
    scene = Scene.from_dict(data)
    with pinned(None):
        simulator, poses = Simulator(scene), motion.poses(scene.dt)
        begun = time.perf_counter()
        passes = [_pass(simulator, motion, poses, give_up)]
        if time.perf_counter() - begun < TIMED_ENOUGH:
            passes.clear()
        while len(passes) < repeats and (not passes or time.perf_counter() - begun < TIMED_ENOUGH):
            passes.append(_pass(simulator, motion, poses, give_up))
    return summary(passes)


def summary(passes: Sequence[Floats]) -> Times:
    """Times of repetitions, each (k,) [s]; a step counts when all of them came to it."""
    steps = min(len(seconds) for seconds in passes)
    least = np.min([seconds[:steps] for seconds in passes], axis=0)
    p99, disturbed = (float(np.percentile(of, 99.0)) for of in (least, np.concatenate(passes)))
    return Times(steps, float(least.mean()), float(np.median(least)), p99, disturbed)


def _pass(simulator: Simulator, motion: Motion, poses: Sequence[Pose], give_up: float | None) -> Floats:
    """Seconds of each step."""
    simulator.reset(motion.at(0.0))
    seconds, spent = np.empty(len(poses)), 0.0
    for k, pose in enumerate(poses):
        start = time.perf_counter()
        simulator.step(pose)
        seconds[k] = time.perf_counter() - start
        spent += seconds[k]
        if give_up is not None and spent > give_up:
            return seconds[: k + 1]
    return seconds
