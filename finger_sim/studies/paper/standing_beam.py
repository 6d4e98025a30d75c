"""The paper's standing beam: where each projection is first violated, and how it moves when limits hold.

The beam stands upright, e1 up, within 0.95-1.05 along e2 and free along e1 and e3. Let go at rest it sinks under its
own weight. Up to its first violation a limit carries no force: one motion without limits serves all projections.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...arrays import Floats
from ...physics.step import Status
from ...scene import Scene
from ...scene.mesh import TetMesh
from ...simulation.simulator import Simulator
from ..shared import biot_strain, deformation, stretches
from .figures import Meter

SCENE = "beam_standing"
PROJECTIONS = ("orthogonal", "hyperbolic", "linear", "tensor")
FINITE = "linear_free_axes_10_and_0.1"
"""Large numbers in place of unrestricted."""
OTHER_AXES = "hyperbolic_lapack_axes"
"""Principal axes of another decomposition: where two stretches are equal, as good as ours."""
ROOM, RESTRICTED = 0.05, 1
"""Strain allowed, along e2."""
LENGTH = 1.0
"""Of the beam at rest [m]."""
DURATION, DT, HELD_DT = 0.35, 0.00025, 0.001
"""Time simulated, its step, and that of a beam whose limits hold [s]."""
VIOLATED = 1.001
"""Strain/limit that counts as violated: where a limit leaves no room at all, rounding reaches 1."""


@dataclass(frozen=True)
class Moment:
    """The beam at the end of the first step that violates a limit; where none does, where strain/limit is largest."""

    violated: bool
    step: int
    time: float  # [s]
    points: Floats  # (n, 3) [m]
    ratio: Floats  # (T,) strain/limit


@dataclass(frozen=True)
class Motion:
    """The beam let go without limits, judged by each projection."""

    mesh: TetMesh
    time: Floats  # (k,) [s]
    transverse: Floats  # (k,) largest strain along e2 of any tetrahedron
    ratio: dict[str, Floats]  # (k,) each: largest strain/limit
    moments: dict[str, Moment]


@dataclass(frozen=True)
class Held:
    """The beam with limits that hold."""

    time: Floats  # (k,) [s]
    transverse: Floats  # (k,) largest strain along e2 of any tetrahedron
    ratio: Floats  # (k,) largest strain/limit
    height: Floats  # (k,) of the top, mean [m]
    status: Status  # of all steps


def beam(dt: float = DT, *, clamped: bool = True) -> Scene:
    """The standing beam without limits: its base clamped, or free on a floor without friction."""
    solver = {"method": "newton", "tolerance": 1e-6, "max_iterations": 50}
    changed = {"limits": None, "solver": solver, "dt": dt}
    if not clamped:
        changed |= {"driven": None, "plane.friction": 0.0}
    return Scene.load(SCENE).with_values(changed)


def limited(scene: Scene, projection: str, free: tuple[float | None, float | None] = (None, None)) -> Scene:
    """The scene with 0.95-1.05 along e2; `free`: s_max and s_min along the others."""
    high, low = free
    limits = {
        "projection": projection,
        "stretch": [high, 1.0 + ROOM, high],
        "compress": [low, 1.0 - ROOM, low],
        "stiffness": 30.0,
        "inertia": 300.0,
    }
    return scene.with_values({"limits": limits})


def let_go(scene: Scene, progress: Meter) -> Motion:
    """The motion of the beam from rest, and where each projection is first violated."""
    body = Simulator(scene)
    mesh, steps = body.mesh, round(DURATION / scene.dt)
    judges = {name: judge(limited(scene, name)) for name in PROJECTIONS}
    judges[FINITE] = judge(limited(scene, "linear", (10.0, 0.1)))
    judges[OTHER_AXES] = lambda points: hyperbolic_ratio(deformation(mesh, points))
    ratio = {name: np.zeros(steps + 1) for name in judges}
    transverse = np.zeros(steps + 1)
    moments: dict[str, Moment] = {}
    for k in range(steps + 1):
        points = body.positions.copy()
        transverse[k] = biot_strain(mesh, points)[:, RESTRICTED, RESTRICTED].max()
        for name, ratio_at in judges.items():
            of_tets = ratio_at(points)
            ratio[name][k] = largest = of_tets.max()
            if name not in moments or (not moments[name].violated and largest > moments[name].ratio.max()):
                moments[name] = Moment(bool(largest > VIOLATED), k, k * scene.dt, points, of_tets)
        body.step()
        progress(k, steps)
    return Motion(mesh, np.linspace(0.0, steps * scene.dt, steps + 1), transverse, ratio, moments)


def judge(scene: Scene) -> Callable[[Floats], Floats]:
    """The function of node positions (n, 3) [m] that gives strain/limit (T,) in that scene."""
    simulator = Simulator(scene)

    def ratio_at(points: Floats) -> Floats:
        simulator.set_state(points, np.zeros_like(points))
        return simulator.strain_ratio.copy()

    return ratio_at


def hyperbolic_ratio(F: Floats) -> Floats:
    """strain/limit of `hyperbolic`, from LAPACK's singular value decomposition. (T,)"""
    s, V = stretches(F)
    return np.asarray((np.abs(V[:, RESTRICTED, :]) * np.abs(s - 1.0)).max(axis=1) / ROOM)


def hold(projection: str, progress: Meter) -> Held:
    """The motion of the clamped beam with limits."""
    simulator = Simulator(limited(beam(HELD_DT), projection))
    mesh, steps = simulator.mesh, round(DURATION / HELD_DT)
    transverse, ratio, height = np.zeros(steps + 1), np.zeros(steps + 1), np.zeros(steps + 1)
    height[0] = LENGTH
    status = Status.OK
    for k in range(1, steps + 1):
        status |= simulator.step().status
        points = simulator.positions
        transverse[k] = biot_strain(mesh, points)[:, RESTRICTED, RESTRICTED].max()
        ratio[k], height[k] = simulator.strain_ratio.max(), top(mesh, points)
        progress(k, steps)
    return Held(np.linspace(0.0, steps * HELD_DT, steps + 1), transverse, ratio, height, status)


def top(mesh: TetMesh, points: Floats) -> float:
    """Mean height of the upper end [m]."""
    return float(points[mesh.node_sets["tip"], 2].mean())


def verdicts(motion: Motion) -> dict[str, dict[str, Any]]:
    """The state at the first violation, by projection. Strains are the largest of any tetrahedron unless `of_tet`."""
    return {name: verdict(motion.mesh, moment) for name, moment in motion.moments.items()}


def verdict(mesh: TetMesh, moment: Moment) -> dict[str, Any]:
    F, E = deformation(mesh, moment.points), biot_strain(mesh, moment.points)
    tet = int(moment.ratio.argmax())
    transverse = float(E[:, RESTRICTED, RESTRICTED].max())
    return {
        "violated": moment.violated,
        "step": moment.step,
        "time_s": moment.time,
        "strain_over_limit": float(moment.ratio.max()),
        "height_over_rest": top(mesh, moment.points) / LENGTH,
        "transverse_strain": transverse,
        "transverse_strain_over_allowed": transverse / ROOM,
        "fibre_strain": float(np.linalg.norm(F[:, :, RESTRICTED], axis=1).max()) - 1.0,
        "principal_strain": float(np.abs(np.linalg.eigvalsh(E)).max()),
        "vertical_strain": float(E[:, 0, 0].min()),
        "tet": tet,
        "transverse_strain_of_tet": float(E[tet, RESTRICTED, RESTRICTED]),
        "vertical_strain_of_tet": float(E[tet, 0, 0]),
    }


def held_numbers(held: Held) -> dict[str, Any]:
    return {
        "duration_s": DURATION,
        "dt_s": HELD_DT,
        "transverse_strain": float(held.transverse.max()),
        "strain_over_limit": float(held.ratio.max()),
        "height_over_rest": float(held.height[-1]) / LENGTH,
        "least_height_over_rest": float(held.height.min()) / LENGTH,
        "status": int(held.status),
    }
