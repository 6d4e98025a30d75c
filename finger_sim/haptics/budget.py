"""A time budget for steps: down a ladder of accuracy while they take too long, and back up when they do not.

The node holds `solver.budget_ms` with it. What a rung costs in accuracy depends on the scene: `claimed` knows it of
those scenes for which `python -m finger_sim.studies.tradeoff.rungs` measured it.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections import deque
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import yaml

from ..plain import plain
from ..scene import Scene, Solver
from ..scene.mesh import TetMesh
from ..scene.resources import shipped


class Cut(NamedTuple):
    """What a rung takes away from the accuracy that a scene asks for."""

    name: str
    tolerance: float  # at least
    lagged: bool  # steps share a stiffness matrix longer (`newton`)
    iterations: int  # at most


class Rung(NamedTuple):
    """A scene's solver settings on one rung of its ladder."""

    name: str
    solver: Solver


CUTS = (
    Cut("coarse", 1e-2, False, 1_000_000),
    Cut("lagged", 1e-2, True, 1_000_000),
    Cut("capped", 5e-2, True, 2),
)
"""From the best to the quickest."""
USELESS = 0.5
"""A rung whose measured error is this part of the peak force or more is no rung: two iterations blow a body up whose
bone yields to the hand."""
CLAIMS = "presets/rungs.yaml"
"""Measured errors of rungs, in the folder of the shipped scenes."""
WINDOW = 50
"""Steps that are looked at together."""
OVER = 5
"""So many of them beyond the budget lead a rung down."""
EASY = 0.7
"""Part of the budget below which nine in ten steps must stay to lead a rung up."""
PATIENCE, MOST_PATIENCE = 500, 16_000
"""Steps on a rung before the next one up is tried; twice as many each time that was too early, up to the second."""


def ladder(solver: Solver) -> tuple[Rung, ...]:
    """The rungs of a scene with this solver, its own settings first; without those that would change nothing."""
    rungs = [Rung("scene", solver)]
    for cut in CUTS:
        lags = cut.lagged and solver.method == "newton" and solver.relinearizations == 0
        settings = dataclasses.replace(
            solver,
            tolerance=max(solver.tolerance, cut.tolerance),
            level="lagged" if lags else solver.level,
            max_iterations=min(solver.max_iterations, cut.iterations),
        )
        if settings != rungs[-1].solver:
            rungs.append(Rung(cut.name, settings))
    return tuple(rungs)


def usable(scene: Scene, mesh: TetMesh) -> tuple[Rung, ...]:
    """The ladder of a scene without the rungs that were measured to be USELESS for it."""
    errors = claimed(scene, mesh)
    return tuple(rung for rung in ladder(scene.solver) if errors.get(rung.name, 0.0) < USELESS)


def fingerprint(scene: Scene, mesh: TetMesh) -> str:
    """Of all values that decide how large a rung's error is; wherever the mesh's file lies.

    A body that sleeps is not stepped, a budget leads to rungs and is none, motions have a start of their own, and a
    command for every step is followed at once.
    """
    values: dict[str, Any] = scene.to_dict()
    del values["mesh"], values["initial_pose"], values["coupling"]["following"]
    values["solver"] = {key: value for key, value in values["solver"].items() if key not in ("budget_ms", "sleep")}
    whole = hashlib.sha256(json.dumps(plain(values), sort_keys=True).encode())
    driven = scene.driven_nodes(mesh)
    for array in (mesh.points, mesh.tets, mesh.axes, driven):
        whole.update(np.ascontiguousarray(array).tobytes())
    return whole.hexdigest()[:16]


def claimed(scene: Scene, mesh: TetMesh) -> dict[str, float]:
    """Error of contact force of each rung, rms as a part of the peak force; empty: not measured for this scene."""
    return _claims().get(fingerprint(scene, mesh), {})


@cache
def _claims() -> dict[str, dict[str, float]]:
    """By fingerprint; none where the file is missing."""
    try:
        claims = yaml.safe_load((shipped("config") / CLAIMS).read_text(encoding="utf-8"))
    except (OSError, yaml.YAMLError):
        return {}
    return {measured["fingerprint"]: measured["rms"] for measured in claims["scenes"].values()}


class Budget:
    """Which of so many rungs to stand on; told how long each step took."""

    def __init__(self, seconds: float, rungs: int) -> None:
        self.seconds = seconds
        self.last = rungs - 1
        self.rung = 0
        self.moves = 0
        """Times the rung changed."""
        self._times: deque[float] = deque(maxlen=WINDOW)
        self._since = 0
        self._patience = PATIENCE
        self._tried = False

    def spent(self, seconds: float) -> bool:
        """One step took so long; whether `rung` changed by it."""
        self._times.append(seconds)
        self._since += 1
        if len(self._times) < WINDOW:
            return False
        if sum(time > self.seconds for time in self._times) >= OVER:
            if self._tried and self._since < self._patience:
                self._patience = min(2 * self._patience, MOST_PATIENCE)
            return self._move(1)
        if self._since < self._patience:
            return False
        if self._tried:
            self._patience, self._tried = PATIENCE, False
        if self.rung > 0 and sorted(self._times)[9 * WINDOW // 10] < EASY * self.seconds:
            return self._move(-1)
        return False

    def _move(self, down: int) -> bool:
        rung = min(self.rung + down, self.last)
        if rung == self.rung:
            return False
        self.rung, self._since, self._tried = rung, 0, down < 0
        self.moves += 1
        self._times.clear()
        return True
