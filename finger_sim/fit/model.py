"""Presses, unknowns and a scene as differences between what is simulated and what was measured.

At rest every force is proportional to E, so that E costs no simulation: it scales what another E gave.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ..arrays import Floats, Ints
from ..scene import Scene
from ..studies.at_rest import resting
from ..studies.tradeoff.run import portable
from .parameters import Unknown, changes
from .press import Path as Way
from .press import Press, at_rest_path, timed_path
from .runs import Job, Runner, job
from .simulate import AT_REST, Run, in_time

RELATIVE = 0.02
"""Error of a force that counts as one, a part of it."""
FLOOR = 0.004
"""The same, a part of the press's largest force: what weak forces are judged by."""
RELATIVE_AREA = 0.1
"""Of a contact area: that of a mesh jumps by the share of a node."""
HOPELESS = 1e3
"""Difference that stands for a force that is no number."""


Theta = Sequence[float] | Floats


class Curve(NamedTuple):
    """What a press of the scene gives at the samples that are compared (Path.used)."""

    normal: Floats
    tangential: Floats | None  # as Press.tangential
    area: Floats | None
    way: Way
    reach: Floats  # see Run.reach


class Residuals(NamedTuple):
    """Differences (n,), each a mean over a group of samples, in errors that count as one.

    press, channel : (n,) what each is of; channel 0: normal force, 1: tangential, 2: area
    """

    values: Floats
    press: Ints
    channel: Ints


@dataclass(frozen=True)
class Model:
    """A scene with unknowns, and the presses that it is to give.

    in_time : presses are followed in time, with the scene's own step; else they rest after each small part
    coarse  : factor of the parts' length
    finer   : so many moments a part, see `at_rest_path`
    wanted  : presses are a target, not data: all unknowns serve it, and priors are weak however far it stays away
    floor   : error of a force that counts as one, whatever the force [N]
    """

    scene: Scene
    unknowns: tuple[Unknown, ...]
    presses: tuple[Press, ...]
    in_time: bool
    coarse: float = 1.0
    finer: int = 1
    wanted: bool = False
    floor: float = 0.0

    def jobs(self, theta: Theta) -> list[Job]:
        """What is to be simulated for these θ, a job for each press."""
        values = changes(self.unknowns, self.scene, theta)
        if not self.in_time:
            values.pop("material.young", None)
        scene = self.scene.with_values(values)
        if self.in_time:
            scene = scene.with_values(in_time(scene) | {"solver.level": "standard"})
        else:
            scene = resting(scene, AT_REST)
        data = portable(scene)
        return [
            job(data, self.way(k, self.shift(theta, k)), press.area is not None) for k, press in enumerate(self.presses)
        ]

    def way(self, press: int, shift: float = 0.0) -> Way:
        """How a press is followed."""
        if self.in_time:
            return timed_path(self.presses[press], self.scene.dt, shift)
        return at_rest_path(self.presses[press], shift, self.coarse, self.finer)

    def curves(self, runner: Runner, thetas: Sequence[Floats]) -> list[list[Curve]]:
        """What each press gives at each of several θ, all made at once."""
        jobs = [self.jobs(theta) for theta in thetas]
        runs = iter(runner([each for of_theta in jobs for each in of_theta]))
        return [
            [curve(self.presses[k], each.way, next(runs), self.scale(theta)) for k, each in enumerate(of_theta)]
            for theta, of_theta in zip(thetas, jobs, strict=True)
        ]

    def residuals(self, runner: Runner, thetas: Sequence[Floats]) -> list[Residuals]:
        """Differences at each of several θ."""
        return [
            joined([differences(press, each, self.floor) for press, each in zip(self.presses, of_theta, strict=True)])
            for of_theta in self.curves(runner, thetas)
        ]

    def with_(self, scene: Scene | None = None, unknowns: Sequence[Unknown] | None = None, **others: object) -> Model:
        """The same with another scene, other unknowns, or other fields."""
        return replace(
            self,
            scene=scene or self.scene,
            unknowns=tuple(self.unknowns if unknowns is None else unknowns),
            **others,  # type: ignore[arg-type]
        )

    def scale(self, theta: Theta) -> float:
        """E over that of the simulation."""
        if self.in_time:
            return 1.0
        young = changes(self.unknowns, self.scene, theta).get("material.young", self.scene.material.young)
        return float(young / self.scene.material.young)

    def shift(self, theta: Theta, press: int) -> float:
        """How much deeper a press is than was measured [m]."""
        return sum(one.amount(each) for one, each in zip(self.unknowns, theta, strict=True) if one.press == press)


def needs_time(scene: Scene, unknowns: Sequence[Unknown]) -> bool:
    """Whether presses are to be followed in time: for an unknown that shows only so, and for what does not rest.

    Limits on principal stretches (all projections but `tensor`) give other forces in long steps than in short ones.
    Flesh that relaxes pushes back less the longer it is held.
    """
    restless = scene.limits is not None and scene.limits.projection != "tensor"
    return restless or bool(scene.material.relaxation) or any(one.timed for one in unknowns)


def curve(press: Press, way: Way, run: Run, scale: float) -> Curve:
    """A run at the samples of a press; forces times `scale`."""
    force = scale * run.force
    normal = _between(force[:, 2], way, exponential=True)
    tangential = None
    if press.tangential is not None:
        sides = np.stack([_between(force[:, axis], way) for axis in (0, 1)], axis=1)
        tangential = sides if press.tangential.ndim == 2 else np.linalg.norm(sides, axis=1)
    return Curve(normal, tangential, _between(run.area, way) if press.area is not None else None, way, run.reach)


def _between(values: Floats, way: Way, exponential: bool = False) -> Floats:
    """Values at commands (k,) as they are at samples: force grows exponentially between two commands."""
    a, b = values[way.after - 1], values[way.after]
    line = a + (b - a) * way.part
    if not exponential:
        return np.asarray(line)
    both = (a > 0.0) & (b > 0.0)
    safe_a, safe_b = np.where(both, a, 1.0), np.where(both, b, 1.0)
    return np.asarray(np.where(both, safe_a * (safe_b / safe_a) ** way.part, line))


def differences(press: Press, given: Curve, floor: float = 0.0) -> tuple[Floats, Ints]:
    """(n,) differences of a press and (n,) the channel that each is of."""
    used, group = given.way.used, given.way.group
    normal = press.normal[used]
    error = np.hypot(RELATIVE * normal, max(FLOOR * float(np.abs(press.normal).max()), floor))
    parts = [_means((given.normal - normal) / error, group)]
    channels = [np.zeros(len(parts[0]), int)]
    if press.tangential is not None and given.tangential is not None:
        measured = press.tangential[used]
        size = measured if measured.ndim == 1 else np.linalg.norm(measured, axis=1)
        against = np.hypot(error, RELATIVE * size)
        for axis in range(1 if measured.ndim == 1 else 2):
            pick = (slice(None),) if measured.ndim == 1 else (slice(None), axis)
            parts.append(_means((given.tangential[pick] - measured[pick]) / against, group))
            channels.append(np.ones(len(parts[-1]), int))
    if press.area is not None and given.area is not None:
        area = press.area[used]
        against = np.hypot(RELATIVE_AREA * area, 0.02 * float(area.max()))
        parts.append(_means((given.area - area) / against, group))
        channels.append(np.full(len(parts[-1]), 2))
    return np.concatenate(parts), np.concatenate(channels)


def joined(parts: Sequence[tuple[Floats, Ints]]) -> Residuals:
    """Those of all presses."""
    press = np.concatenate([np.full(len(values), k) for k, (values, _) in enumerate(parts)])
    return Residuals(np.concatenate([v for v, _ in parts]), press, np.concatenate([c for _, c in parts]))


def relative_error(press: Press, given: Curve) -> float:
    """Root mean square of the normal force's error over the groups, as a part of the press's largest force."""
    wrong = _means(given.normal - press.normal[given.way.used], given.way.group)
    return float(np.sqrt(np.mean(wrong**2)) / max(float(np.abs(press.normal).max()), 1e-12))


def _means(values: Floats, group: Ints) -> Floats:
    """Mean over each group; what is no number counts as HOPELESS."""
    values = np.where(np.isfinite(values), np.clip(values, -HOPELESS, HOPELESS), HOPELESS)
    return np.asarray(np.bincount(group, values) / np.bincount(group))
