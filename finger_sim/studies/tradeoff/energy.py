"""Energy that a scene's settings lose on their own: what an undamped body keeps of a kick."""

from __future__ import annotations

import numpy as np

from ...arrays import Floats
from ...scene import Pose, Scene
from ...scene.mesh import TetMesh
from ...simulation.simulator import Simulator
from ..strains import deformation, stretches

KICK = 0.02
"""Velocity of the free nodes at the start [m/s]."""
DURATION = 0.01
"""Time over which energy is followed [s]."""


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
