"""A time budget for steps: down a ladder of accuracy while they take too long, and back up when they do not.

The node holds `solver.budget_ms` with it. What a rung costs in accuracy depends on the scene: `claimed` knows it of
those scenes for which `python -m finger_sim.studies.tradeoff.rungs` measured it.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
from functools import cache, cached_property
from typing import Any, NamedTuple

import numpy as np
import yaml
from numba import types

from ..arrays import Floats, Ints
from ..physics.compile import kernel, stage
from ..physics.records import direct, held
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


class Purse(NamedTuple):
    """A Budget, for compiled code; (1,) each, unless said.

    seconds  : that a step may take; 0: there is no budget
    times    : (WINDOW,) of the last steps on this rung [s]; number k lies in row k % WINDOW
    rungs    : of the ladder
    rung     : stood on
    moves    : times the rung changed
    kept     : times so far on this rung, and since the rung changed
    patience : steps on a rung before the next one up is tried
    tried    : 1 where the last move was up
    """

    seconds: Floats
    times: Floats
    rungs: Ints
    rung: Ints
    moves: Ints
    kept: Ints
    patience: Ints
    tried: Ints


def build_purse(seconds: float = 0.0, rungs: int = 1) -> Purse:
    """On the first of so many rungs."""
    whole = {name: np.zeros(1, np.int64) for name in Purse._fields[2:]}
    purse = Purse(np.full(1, seconds), np.zeros(WINDOW), **whole)
    purse.rungs[0], purse.patience[0] = rungs, PATIENCE
    return purse


class Budget:
    """Which of so many rungs to stand on; told how long each step took.

    purse : what it knows, for compiled code
    """

    def __init__(self, seconds: float, rungs: int) -> None:
        self.purse = build_purse(seconds, rungs)

    @property
    def seconds(self) -> float:
        """That a step may take [s]."""
        return float(self.purse.seconds[0])

    @property
    def rung(self) -> int:
        """Stood on, from 0 on."""
        return int(self.purse.rung[0])

    @property
    def moves(self) -> int:
        """Times the rung changed."""
        return int(self.purse.moves[0])

    def spent(self, seconds: float) -> bool:
        """One step took so long; whether `rung` changed by it."""
        return bool(self._spent(self._held, seconds))

    @cached_property
    def _held(self) -> Any:
        return held(self.purse)

    @cached_property
    def _spent(self) -> Any:
        return direct(spent, self._held, types.float64)


@kernel
def spent(purse: Purse, seconds: float) -> bool:
    """`Budget.spent`."""
    times, budget = purse.times, purse.seconds[0]
    times[purse.kept[0] % WINDOW] = seconds
    purse.kept[0] += 1
    kept = purse.kept[0]
    if kept < WINDOW:
        return False
    over = easy = 0
    for k in range(WINDOW):
        over += 1 if times[k] > budget else 0
        easy += 1 if times[k] < EASY * budget else 0
    if over >= OVER:
        if purse.tried[0] != 0 and kept < purse.patience[0]:
            purse.patience[0] = min(2 * purse.patience[0], MOST_PATIENCE)
        return _move(purse, 1)
    if kept < purse.patience[0]:
        return False
    if purse.tried[0] != 0:
        purse.patience[0], purse.tried[0] = PATIENCE, 0
    return purse.rung[0] > 0 and easy > 9 * WINDOW // 10 and _move(purse, -1)


@stage
def _move(purse: Purse, down: int) -> bool:
    rung = min(purse.rung[0] + down, purse.rungs[0] - 1)
    if rung == purse.rung[0]:
        return False
    purse.rung[0], purse.kept[0], purse.tried[0] = rung, 0, 1 if down < 0 else 0
    purse.moves[0] += 1
    return True


KERNELS = (spent,)
"""What a Budget calls."""
