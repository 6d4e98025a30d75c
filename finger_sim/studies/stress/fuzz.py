"""Random cases of `finger_sim stress`: scenes and motions over the whole of what a scene may say."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ...scene import Pose
from . import motions
from .case import MESH_FILE, Case, RawMesh
from .motions import STILL, placed, pose

PROJECTIONS = ("hyperbolic", "isotropic", "tensor", "orthogonal", "linear")
CORNERS = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
ONE_TET = np.array([[0, 1, 2, 3]])
FAR = 1e3
"""How far from the origin the world may be put [m]."""
SHAKE = (100.0, 0.01)
"""Frequency [Hz] and amplitude [m] of a shake."""


def fuzz_case(seed: int, index: int) -> Case:
    """Case number `index` of a seed: the same for the same two numbers."""
    draw = _Draw(np.random.default_rng([seed, index]))
    size = draw.log(1e-3, 10.0)
    scene, mesh, height = draw.body(size)
    frame = draw.frame()
    dt = draw.log(1e-6, 0.1)
    scene |= {
        "material": draw.material(),
        "solver": draw.solver(),
        "dt": dt,
        "coupling": {"max_speed": draw.log(0.1, 100.0), "max_angular_speed": draw.log(1.0, 1e3)},
    }
    own = _Draw(np.random.default_rng([seed, index, 1]))  # what other draws of the same case do not depend on
    if own.chance(0.25):
        scene["material"] |= own.relaxation()
    scene["gravity"] = [0.0, 0.0, 0.0] if draw.chance(0.3) else [0.0, 0.0, -9.81]
    rigid = scene["solver"]["method"] == "pgs"
    if draw.chance(0.75):
        scene["limits"] = draw.limits(rigid)
    if draw.chance(0.75):
        scene["plane"] = draw.plane(frame, -draw.log(1e-3, 0.1) * height, rigid)
    if draw.chance(0.15):
        scene["driven"] = None
    family, way = draw.motion(size, height, dt)
    return Case(f"fuzz_{seed}_{index}", f"fuzz {family}", scene, motions.carried(way, frame), mesh=mesh)


class _Draw:
    """What a case is made of, out of one stream of random numbers."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng

    def chance(self, part: float) -> bool:
        return bool(self.rng.random() < part)

    def log(self, low: float, high: float) -> float:
        """Between the two, every decade as likely."""
        return float(math.exp(self.rng.uniform(math.log(low), math.log(high))))

    def one_of(self, *choices: Any) -> Any:
        return choices[self.rng.integers(len(choices))]

    def body(self, size: float) -> tuple[dict[str, Any], RawMesh | None, float]:
        """Mesh and driven nodes (those at the top) of a scene, the mesh where it is a file, and its height [m]."""
        if self.chance(0.2):
            flat = self.log(1e-4, 1.0) if self.chance(0.5) else 1.0
            points = size * CORNERS * [1.0, 1.0, flat]
            top = 0.999 * size * flat
            return {"mesh": {"file": MESH_FILE}, "driven": _above(top)}, RawMesh(points, ONE_TET), size * flat
        cells = [int(self.rng.integers(1, n + 1)) for n in (5, 4, 3)]
        edges = [size, size * self.log(0.1, 1.0), size * self.log(0.1, 1.0)]
        return {"mesh": {"beam": {"size": edges, "cells": cells}}, "driven": _above(0.999 * edges[2])}, None, edges[2]

    def material(self) -> dict[str, Any]:
        damping = {"mass": 0.0, "stiffness": self.one_of(0.0, 0.002, self.log(1e-6, 1.0))}
        return {
            "density": self.log(1.0, 1e5),
            "young": self.log(1.0, 1e12),
            "poisson": self.one_of(float(self.rng.uniform(-0.9, 0.49)), 0.5 - self.log(1e-4, 0.1)),
            "damping": damping,
            "volumetric": self.one_of("element", "patch"),
        }

    def relaxation(self) -> dict[str, Any]:
        """One to four terms, together up to all but a thousandth of the stress."""
        shares = self.rng.dirichlet(np.ones(1 + self.rng.integers(1, 5)))[1:] * 0.999
        terms = [{"time": self.log(1e-5, 1e5), "share": float(share)} for share in shares]
        return {"relaxation": terms, "relaxes": self.one_of("deviator", "stress")}

    def solver(self) -> dict[str, Any]:
        if self.chance(0.4):
            return {"method": "pgs", "max_iterations": 100}
        again = self.one_of(0, 0, 0, 1)
        level = "lagged" if again == 0 and self.chance(0.2) else "standard"
        own = {"relinearizations": again, "level": level, "settle": self.chance(0.7), "sleep": self.chance(0.7)}
        return {"method": "newton", "max_iterations": 50} | own

    def limits(self, rigid: bool) -> dict[str, Any]:
        projection = self.one_of(*PROJECTIONS)
        stretch, compress = [self.room() for _ in range(3)], [self.room() for _ in range(3)]
        if projection == "isotropic":
            stretch, compress = stretch[:1] * 3, compress[:1] * 3
        return {
            "projection": projection,
            "stretch": [None if a is None else 1.0 + a for a in stretch],
            "compress": [None if a is None else max(0.0, 1.0 - a) for a in compress],
            "stiffness": None if rigid and self.chance(0.3) else self.log(1e-1, 1e5),
            "inertia": self.one_of(0.0, 0.0, self.log(1.0, 1e3)),
        }

    def room(self) -> float | None:
        """Of one axis on one side: none, little, some, or free."""
        return self.one_of(0.0, self.log(1e-4, 1.0), self.log(1e-2, 0.5), None)  # type: ignore[no-any-return]

    def plane(self, frame: Pose, height: float, rigid: bool) -> dict[str, Any]:
        turn = Rotation.from_quat(frame.orientation)
        return {
            "point": (np.array(frame.position) + turn.apply([0.0, 0.0, height])).tolist(),
            "normal": turn.apply([0.0, 0.0, 1.0]).tolist(),
            "friction": self.one_of(0.0, 0.5, self.log(1e-2, 100.0)),
            "stiffness": None if rigid and self.chance(0.3) else self.log(1.0, 1e5),
        }

    def frame(self) -> Pose:
        """Where the body's z axis points, and how far from the origin it is."""
        turn = Rotation.random(random_state=self.rng) if self.chance(0.5) else Rotation.identity()
        away = self.log(1e-3, FAR) if self.chance(0.5) else 0.0
        return placed(away * turn.apply([0.6, 0.0, 0.8]), turn)

    def motion(self, size: float, height: float, dt: float) -> tuple[str, list[Pose]]:
        """A kind of motion and its poses, from the identity on."""
        name = self.one_of("press", "slide", "jump", "shake", "turn", "walk", "hold")
        kinds: dict[str, Callable[[], list[Pose]]] = {
            "press": lambda: motions.there_and_back(pose((0, 0, -height * self.log(0.01, 0.9))), 25, 20),
            "slide": lambda: self._slide(size, height),
            "jump": lambda: self._jump(size, height),
            "shake": lambda: motions.shake((SHAKE[1], 0.0, SHAKE[1]), SHAKE[0], dt, 60),
            "turn": lambda: motions.there_and_back(pose(turn=(0, math.pi * self.rng.random(), 0.1)), 30, 15),
            "walk": lambda: motions.walk(self.rng, size * self.log(1e-4, 0.1), self.log(1e-3, 0.5), 60),
            "hold": lambda: motions.hold(STILL, 60),
        }
        return name, [STILL, *kinds[name](), *motions.hold(STILL, 10)]

    def _slide(self, size: float, height: float) -> list[Pose]:
        down = pose((0, 0, -height * self.log(0.01, 0.5)))
        along = pose((size * self.log(0.1, 1.0), 0, down.position[2]))
        return [*motions.move(STILL, down, 20), *motions.move(down, along, 40), *motions.move(along, STILL, 20)]

    def _jump(self, size: float, height: float) -> list[Pose]:
        """Up to 1 m and 180° between two steps, twice."""
        far = pose(self.rng.uniform(-1.0, 1.0, 3), self.rng.uniform(-math.pi, math.pi, 3) * 0.57)
        down = pose((0, 0, -height * self.log(0.01, 0.5)))
        return [*motions.move(STILL, down, 15), *motions.hold(far, 25), *motions.hold(down, 25)]


def _above(height: float) -> dict[str, Any]:
    return {"box": [[-1e4, -1e4, height], [1e4, 1e4, 1e4]]}
