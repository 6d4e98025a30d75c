"""`Ledger`: where a body's energy came from, step by step; what came from nowhere."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...arrays import Floats
from ...scene import Scene
from .measures import KNOWN, Body, Shape, limit_energy

EXACT = 1e-6
"""Of the energies at play, that may come from nowhere where each step is solved exactly."""
SOLVED = 0.01
"""The same where contact or limits are solved to a tolerance, and limits linearised."""


class Moment(NamedTuple):
    """A body at the end of a step."""

    x: Floats  # (n, 3) [m]
    v: Floats  # (n, 3) [m/s]
    shape: Shape


class Ledger:
    """Energy of now ≤ energy at first + work of bone and plane + what linearisation does not see.

    Energy is that of the free nodes' motion, of the elastic body and of its height; what violated limits have stored
    counts at the first only. Backward Euler linearised with the rotations of its start loses energy in each step but
    for `Body.linearised_away`: to round-off where no limit or contact holds (EXACT), else to the solver's tolerance and
    the linearisation of limits (SOLVED).
    """

    def __init__(self, scene: Scene, body: Body, begin: Moment) -> None:
        self._scene, self._body = scene, body
        limits = scene.limits
        self.springs_known = limits is None or (limits.projection in KNOWN and limits.inertia == 0.0)
        self.begin(begin)

    def begin(self, now: Moment) -> None:
        """Count from here on."""
        energy, scene = self._energy(now), self._scene
        self._least = self._most = self._first = energy
        if scene.limits is not None and self.springs_known:
            # `tensor` has up to twice the springs: rows halfway between eigenvectors that nearly coincide.
            self._first += 2.0 * limit_energy(scene.limits, scene.material.young, self._body, now.shape)
        self._work = self._unseen = 0.0
        self._allowed = EXACT

    def add(self, work: float, unseen: float, exact: bool) -> None:
        """What a step did: work from outside [J], energy not seen by it [J], whether it was solved exactly."""
        self._work += work
        self._unseen += unseen
        if not exact:
            self._allowed = SOLVED

    def from_nowhere(self, now: Moment) -> tuple[float, float, bool]:
        """Energy that nothing explains [J], the same as a part of the energies at play, and whether it is too much."""
        energy = self._energy(now)
        self._least, self._most = min(self._least, energy), max(self._most, energy)
        excess = energy - self._first - self._work - self._unseen
        scale = self._most - self._least + abs(self._work) + self._round_off(now) / EXACT + 1e-300
        return excess, excess / scale, excess > self._allowed * scale

    def _energy(self, now: Moment) -> float:
        return self._body.energy(now.x, now.v, now.shape)

    def _round_off(self, now: Moment) -> float:
        """What positions that are far away leave uncertain: height, strain and speed [J]."""
        body, away = self._body, float(np.abs(now.x).max())
        mass, volume = float(body.mass.sum()), float(body.volume.sum())
        strain, speed = 1e-15 * away * float(np.abs(body.inverse).max()), 1e-15 * away / self._scene.dt
        height = 1e-12 * away * mass * float(np.abs(body.gravity).max())
        return height + 10.0 * self._scene.material.young * volume * strain**2 + mass * speed**2
