"""What a finger answers at rest, pressed on a table: what a mesh is judged by.

Depth is how far the bone has come down since the skin of the finger that is meant, that of `finger_shape`, first
touched: a command moves the bone, so that a mesh whose pad lies too high presses too little. A press goes down in small
parts and rests after each; what a finger answers at rest depends on neither the time step nor damping.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from ..arrays import Floats
from ..bags.strokes import FLAT, SIDE
from ..errors import FingerSimError
from ..physics.rotations import Quaternion, matrix
from ..scene import Pose, Scene
from ..scene.finger_shape import first_touch
from ..simulation.simulator import Simulator
from ..simulation.touch import Imprint

TIP_TILT = math.radians(60.0)
"""Of a finger on its tip: more, and the bone would be between the table and what is pressed."""
ORIENTATIONS: dict[str, Quaternion] = {
    "flat": FLAT,
    "side": SIDE,
    "tip": (
        math.cos(0.5 * TIP_TILT) * FLAT[0], math.sin(0.5 * TIP_TILT) * FLAT[3],
        -math.sin(0.5 * TIP_TILT) * FLAT[0], math.cos(0.5 * TIP_TILT) * FLAT[3],
    ),
}  # fmt: skip
"""Of the finger frame in the world: on the pad, on its side, tilted towards its tip."""
DEPTHS = {"flat": (0.5e-3, 1e-3, 1.5e-3, 2e-3), "side": (0.5e-3, 1e-3), "tip": (0.5e-3, 1e-3)}
"""How far the bone comes down [m]."""
FORCES = (1.0, 4.0)
"""Normal forces of a flat press at which area and tangential stiffness are taken [N]."""
SHEAR = 2e-5
"""Way of the bone along the finger that tangential stiffness is taken over [m], there and back."""
STICKY = 100.0
"""Friction meanwhile: nodes at the rim would slip at once, and what is asked for is the stiffness before."""

SETTING: dict[str, Any] = {
    "gravity": [0.0, 0.0, 0.0],
    "dt": 1e-2,
    "substeps": 1,
    "solver.method": "newton",
    "solver.level": "standard",
    "solver.tolerance": 1e-6,
    "solver.max_iterations": 100,
    "solver.relinearizations": 0,
    "solver.settle": False,
    "solver.sleep": False,
    "coupling.type": "kinematic",
}
"""Of every press: long steps, which let motion die out at once."""
NO_VISCOSITY = {"limits.viscosity": 0.0}
"""Of limits: in long steps it makes a finger creep to its rest, so slowly that it seems to be there."""
_PART = 2e-4  # of a press between two rests [m]; half of it: flat 0.3 %, on the side 3 %
_APART = 1e-5  # two rests tell a slope [m]
_CALM_STEPS, _CHANGE = 4, 5e-5  # at rest in so many steps the force changes by no more than this part of itself
_LONGEST, _STIRRED = 60, 2e-2  # after so many steps, by this in half of them: a few limits come and go
_FORCE, _TRIES = 2e-3, 20  # part by which a force that is sought may be missed, and how often it may be passed


@dataclasses.dataclass(frozen=True)
class Answers:
    """A finger's answers at rest."""

    force: Mapping[str, tuple[float, ...]]
    """Normal force at DEPTHS, by orientation [N]."""
    tangential: tuple[float, ...]
    """Tangential stiffness along the finger at FORCES, flat, before anything slips [N/m]; empty without limits."""
    area: tuple[float, ...]
    """Contact area at FORCES, flat [m²]: that of the deformed skin at the nodes that press; empty without limits."""

    def values(self) -> dict[str, float]:
        """By name, units included."""
        out = {
            f"{name} {1e3 * depth:g} mm [N]": force
            for name, depths in DEPTHS.items()
            for depth, force in zip(depths, self.force.get(name, ()), strict=False)
        }
        for load, stiffness, area in zip(FORCES, self.tangential, self.area, strict=False):
            out[f"tangential {load:g} N [N/mm]"] = 1e-3 * stiffness
            out[f"area {load:g} N [mm²]"] = 1e6 * area
        return out


class NotAtRestError(FingerSimError):
    """A press that does not come to rest."""


def answers(scene: Scene, orientations: tuple[str, ...] = ("flat", "side", "tip")) -> Answers:
    """The answers of a scene's finger, its limits included; without limits those of the flat press alone make sense.

    Raises NotAtRestError when the finger does not come to rest, SceneError where the scene has no table.
    """
    scene = at_rest(scene)
    forces: dict[str, tuple[float, ...]] = {}
    tangential: list[float] = []
    area: list[float] = []
    for name in orientations:
        loads = list(FORCES) if name == "flat" and scene.limits is not None else []
        press, forces[name] = Press(scene, ORIENTATIONS[name]), ()
        for depth in (*DEPTHS[name], math.inf):
            while loads and press.until(loads[0], depth):
                loads.pop(0)
                area.append(press.area())
                tangential.append(press.tangential())
            if depth < math.inf:
                forces[name] += (press.to(depth),)
    return Answers(forces, tuple(tangential), tuple(area))


def at_rest(scene: Scene) -> Scene:
    """The scene as it is pressed."""
    return resting(scene, SETTING)


def resting(scene: Scene, setting: dict[str, Any]) -> Scene:
    """The scene with a setting, and NO_VISCOSITY where it has limits; stress that relaxes has done so."""
    return faded(scene).with_values(setting | (NO_VISCOSITY if scene.limits is not None else {}))


def faded(scene: Scene) -> Scene:
    """The scene once all that relaxes has faded; limits and plane as stiff as before."""
    material = scene.material.lasting
    if material == scene.material:
        return scene
    values: dict[str, Any] = {f"material.{name}": getattr(material, name) for name in ("young", "poisson")}
    values["material.relaxation"] = []
    for name, part in (("limits", scene.limits), ("plane", scene.plane)):
        if part is not None and part.stiffness is not None:
            values[f"{name}.stiffness"] = part.stiffness * scene.material.young / material.young
    return scene.with_values(values)


class Press:
    """A finger above the table, and the way down."""

    def __init__(self, scene: Scene, orientation: Quaternion) -> None:
        self.simulator = Simulator(scene)
        self._orientation = orientation
        self._touch = first_touch(matrix(orientation))
        self._height = self._touch + 1e-4
        self._along = self._force = 0.0
        self._before = (-math.inf, 0.0)  # depth and force of the rest before
        self.simulator.reset(self._pose())

    @property
    def depth(self) -> float:
        """Of the bone [m]."""
        return self._touch - self._height

    @property
    def force(self) -> float:
        """The normal force at the last rest [N]."""
        return self._force

    def along(self, way: float) -> float:
        """Goes along the finger to so far from where it came down [m]; the force of the plane along it, at rest [N]."""
        self._along = way
        force = self._rest()
        self._force = float(force[2])
        return float(force[0])

    def to(self, depth: float) -> float:
        """Goes there; the normal force at rest [N]."""
        start, way = self._height, self._touch - depth - self._height
        parts = math.ceil(abs(way) / _PART - 1e-6)
        for part in range(1, parts + 1):
            if abs(self.depth - self._before[0]) >= _APART:
                self._before = self.depth, self._force
            self._height = start + way * part / parts
            self._force = float(self._rest()[2])
        return self._force

    def until(self, load: float, deepest: float = math.inf) -> bool:
        """Goes on until the normal force at rest is `load` [N], or to a depth [m]; whether the load was reached."""
        tries = 0
        while abs(self._force - load) > _FORCE * load:
            if self._force < load and self.depth >= deepest - 1e-9:
                return False
            tries += self._force > load
            if tries > _TRIES:
                raise NotAtRestError(f"a press to {load} N: got {self._force:.6g} N at {1e3 * self.depth:.6g} mm")
            self.to(min(deepest, self.depth + self._way_to(load)))
        return True

    def _way_to(self, load: float) -> float:
        """How much deeper the load should be [m], as force grows exponentially; _PART at most."""
        depth, force = self._before
        if force <= 0.0 or abs(self.depth - depth) < 0.1 * _APART:
            return _PART
        rate = math.log(self._force / force) / (self.depth - depth)
        return float(np.clip(math.log(load / self._force) / rate, -_PART, _PART)) if rate > 0.0 else _PART

    def tangential(self) -> float:
        """Tangential stiffness along the finger here [N/m]."""
        plane = self.simulator.scene.plane
        assert plane is not None
        self.simulator.apply({"plane.friction": STICKY})
        ways = []
        for along in (SHEAR, -SHEAR):
            start = float(self._rest()[0])
            self._along += along
            ways.append((float(self._rest()[0]) - start) / -along)
        self.simulator.apply({"plane.friction": plane.friction})
        return float(np.mean(ways))

    def area(self) -> float:
        """Contact area here [m²]: of each triangle of the skin, as the table sees it, a third per node that presses."""
        return Imprint.of(self.simulator).touch().area

    def _rest(self) -> Floats:
        """The contact force at rest [N], (3,); the mean where what is left of motion hardly changes it."""
        forces: list[Floats] = []
        while len(forces) < _LONGEST:
            forces.append(self.simulator.step(self._pose()).contact_wrench[:3])
            last = np.array(forces[-_CALM_STEPS:])
            if len(last) == _CALM_STEPS and _spread(last) <= _CHANGE:
                return np.asarray(last[-1])
        last = np.array(forces[-_LONGEST // 2 :])
        if _spread(last) <= _STIRRED:
            return np.asarray(last.mean(axis=0))
        raise NotAtRestError(
            f"a press to {1e3 * self.depth:.4g} mm: moves still after {_LONGEST} steps, force {last[-1]} N"
        )

    def _pose(self) -> Pose:
        return Pose((self._along, 0.0, self._height), self._orientation)


def _spread(forces: Floats) -> float:
    """How much forces (n, 3) differ, in parts of the last."""
    return float(np.ptp(forces, axis=0).max() / max(np.linalg.norm(forces[-1]), 1e-9))
