"""A finger lowered slowly on a table: the bodies and ways; force against depth, its tangent, the limits reached.

Three bodies of the same mesh, the paper's. `pulp`: soft tissue on a rigid bone (the scene `finger`). `paper`: the
paper's one stiff material, held at its cut end (`finger_paper`). `stiff`: that material on the bone.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ...arrays import Floats, Ints
from ...bags.strokes import FLAT, SIDE
from ...physics.rotations import Quaternion, matrix, normalised
from ...physics.step import Status
from ...scene import Pose, Scene
from ...scene.mesh import TetMesh
from ...simulation.result import StepResult
from ...simulation.simulator import Simulator
from ..shared import biot_strain

GAP, REST = 0.5e-3, 0.3
"""A body hangs so far above the table [m], for so long [s], before it is lowered."""
WINDOW = 10
"""Steps that one point of a curve is the mean of."""
NEAR = 1.25
"""A tangent is fitted to the forces within this factor of its own."""
FEWEST = 4
"""Points that a tangent takes at least."""
REACHED = 0.98
"""strain/limit from which on a limit counts as reached."""

UPRIGHT = (0.0, math.sqrt(0.5), 0.0, math.sqrt(0.5))
"""Orientation xyzw on the tip: maps e1 to −z."""
DIRECTIONS = {"flat": "pressed flat (e2)", "side": "on its side (e3)", "tip": "on its tip (e1)"}
MATERIALS: dict[str, dict[str, Any]] = {
    "anisotropic": {},
    "isotropic": {"limits.projection": "isotropic", "limits.stretch": [1.25] * 3, "limits.compress": [0.75] * 3},
}
FINELY = {"solver.tolerance": 1e-6, "solver.max_iterations": 4000}
"""At the scenes' 1e-3 a finger that sticks to the table creeps: up to 30 % less force on the tip."""
TISSUE: dict[str, Any] = {
    "mesh.file": "meshes/finger_paper.vtu",
    "material.young": 1.4e4,
    "material.poisson": 0.45,
    "material.volumetric": "element",
}
"""The mesh and the element of the paper, with the modulus that goes with them: the figures keep them, whatever mesh the
shipped scenes are tuned on."""
PAPERS: dict[str, Any] = TISSUE | {
    "limits.projection": "hyperbolic",
    "limits.stiffness": 100.0,
    "solver.method": "pgs",
}
"""The same with the paper's limits, as soft as the finger's, and its method."""
TILT = 20.0
"""Of the finger that is held at its cut end [degree]: its tip is to meet the table before that end does."""

Key = tuple[str, str, str]
"""Body, direction, material."""


@dataclass(frozen=True)
class Way:
    """How a body is pressed."""

    orientation: Quaternion  # finger frame in the world, x y z w
    speed: float  # of the bone [m/s]
    deepest: float  # where the press ends [m]
    shown: float  # the pictured depth [m]


@dataclass(frozen=True)
class Body:
    """A finger: its scene, what is changed in it, and how it is pressed."""

    scene: str
    values: dict[str, Any]
    ways: dict[str, Way]


def tilted(orientation: Quaternion, degrees: float) -> Quaternion:
    """The orientation with the tip lowered by an angle."""
    turn = Rotation.from_rotvec([0.0, math.radians(degrees), 0.0])
    return normalised((turn * Rotation.from_quat(orientation)).as_quat().tolist())


ON_BONE = {
    "flat": Way(FLAT, 0.5e-3, 2.1e-3, 1.5e-3),
    "side": Way(SIDE, 0.5e-3, 1.6e-3, 1.0e-3),
    "tip": Way(UPRIGHT, 0.5e-3, 2.1e-3, 1.0e-3),
}
BODIES = {
    "pulp": Body("finger", FINELY | PAPERS, ON_BONE),
    "paper": Body(
        "finger_paper",
        FINELY,
        {
            "flat": Way(tilted(FLAT, TILT), 5e-3, 13e-3, 11e-3),
            "side": Way(tilted((0.0, 0.0, 0.0, 1.0), TILT), 5e-3, 11.5e-3, 11e-3),
            "tip": Way(UPRIGHT, 0.5e-3, 3e-3, 2.5e-3),
        },
    ),
    "stiff": Body(
        "finger",
        FINELY | PAPERS | {"material.young": 2e6, "material.poisson": 0.4},
        {name: replace(way, speed=1e-3, shown=1e-3) for name, way in ON_BONE.items()},
    ),
}


def scene_of(key: Key, bodies: Mapping[str, Body] = BODIES) -> Scene:
    """The scene of a press."""
    body = bodies[key[0]]
    return Scene.load(body.scene).with_values(body.values | MATERIALS[key[2]])


@dataclass(frozen=True)
class Press:
    """One press: what was seen at each depth, and the body at the pictured one."""

    way: Way
    depth: Floats  # (k,) lowered since first touch [m]
    force: Floats  # (k,) of the plane along its normal [N]
    limited_tets: Ints  # (k,) held by a limit
    strain_ratio: Floats  # (k,) largest strain/limit
    penetration: float  # deepest free node of all times [m]
    status: Status  # all that came up
    result: StepResult  # of the step at the pictured depth
    points: Floats  # (n, 3) nodes there, world [m]
    tet_strain: Floats  # (T,) strain/limit there
    reached: Ints  # (3,) tetrahedra at their limit there, by the axis: `reached_axes`

    def force_at(self, depth: float) -> float:
        """Force [N] at a depth [m]; NaN beyond the last."""
        return float(np.interp(depth, self.depth, self.force, left=0.0, right=np.nan))

    def depth_at(self, force: float) -> float:
        """Depth [m] at which a force [N] is first reached; NaN when it is not."""
        return float(np.interp(force, np.maximum.accumulate(self.force), self.depth, left=0.0, right=np.nan))

    def tangent(self, force: float) -> float:
        """Tangent stiffness [N/m] at a force [N]: `tangent_stiffness`."""
        return tangent_stiffness(self.depth, self.force, force)

    @property
    def first_limit(self) -> float:
        """Force [N] when the first limit is reached; NaN when none is."""
        return float(self.force[np.argmax(self.limited_tets > 0)]) if self.limited_tets.any() else float("nan")

    @property
    def at_shown(self) -> int:
        """Index of the curve's point at the pictured depth."""
        return int(np.searchsorted(self.depth, self.way.shown))


def press(scene: Scene, way: Way, enough: float, tell: Callable[[float], None] = lambda part: None) -> Press:
    """Lower the scene's body to the way's end, or until it gives `enough` [N] beyond the pictured depth.

    Depth counts from where the body, as it hangs at rest, touches z = 0. `tell` is told the part that is done.
    """
    simulator = Simulator(scene)
    height = GAP - float((simulator.mesh.points @ matrix(way.orientation).T)[:, 2].min())
    simulator.reset(Pose((0.0, 0.0, height), way.orientation))
    for _ in range(round(REST / scene.dt)):
        simulator.step()
    free = np.ones(len(simulator.mesh.points), bool)
    free[scene.driven_nodes(simulator.mesh)] = False
    touch = height - float(simulator.positions[free, 2].min())
    rows: list[tuple[float, float, int, float]] = []
    penetration, status = 0.0, Status.OK
    shown: tuple[StepResult, Floats, Floats] | None = None
    down = way.speed * scene.dt
    steps, depth, force = 0, touch - height, 0.0
    while depth < way.deepest and (depth < way.shown or force < enough):
        total = 0.0
        for _ in range(WINDOW):
            steps += 1
            result = simulator.step(Pose((0.0, 0.0, height - steps * down), way.orientation))
            total += float(result.contact_wrench[2])
            penetration = max(penetration, -float(simulator.positions[free, 2].min()))
            status |= result.status
        force = total / WINDOW
        depth = touch - height + (steps - 0.5 * (WINDOW - 1)) * down
        rows.append((depth, force, result.limited_tets, result.max_strain_ratio))
        if shown is None and depth >= way.shown:
            shown = result, simulator.positions.copy(), simulator.strain_ratio.copy()
        tell(min(1.0, max(0.0, depth / way.deepest)))
    assert shown is not None
    depths, forces, tets, ratio = (np.array(column) for column in zip(*rows, strict=True))
    reached = reached_axes(simulator.mesh, *shown[1:], scene)
    return Press(way, depths, forces, tets, ratio, penetration, status, *shown, reached)


def tangent_stiffness(depth: Floats, force: Floats, at: float) -> float:
    """Slope [N/m] of the least-squares line through the points of a curve whose force is within NEAR of `at` [N].

    NaN when they are fewer than FEWEST, or the curve ends among them.
    """
    near = (force > at / NEAR) & (force < at * NEAR)
    if near.sum() < FEWEST or force.max() < at * NEAR:
        return float("nan")
    d = depth[near] - depth[near].mean()
    return float(d @ force[near] / (d @ d))


def reached_axes(mesh: TetMesh, points: Floats, tet_strain: Floats, scene: Scene) -> Ints:
    """Tetrahedra at their limit, counted by the axis along which the strain takes most of its room. (3,)

    points (n, 3) [m], tet_strain (T,) strain/limit. The strain is Biot's, U − I, along e1, e2, e3.
    """
    if scene.limits is None:
        return np.zeros(3, np.int64)
    strain = np.diagonal(biot_strain(mesh, points), axis1=1, axis2=2)
    room = np.where(strain > 0.0, scene.limits.stretch_room, scene.limits.compress_room)
    fullest = np.argmax(np.abs(strain) / room, axis=1)
    return np.bincount(fullest[tet_strain >= REACHED], minlength=3)
