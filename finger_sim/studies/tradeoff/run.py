"""One run of a scene through a motion, for its answers. A pure function: any worker may call it."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from ...arrays import Floats, Ints
from ...scene import Scene
from ...scene.resources import shipped
from ...simulation.simulator import Simulator
from .energy import energy_drift
from .motion import Motion

SNAPSHOT = 0.025
"""Time between two snapshots of the nodes [s]."""


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
