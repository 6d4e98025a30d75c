"""A fit elsewhere: the same tissue on another mesh, and the scene as it runs, in time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ..arrays import Floats
from ..scene import Scene
from ..scene.calibration import scene_on
from ..studies.tradeoff.run import portable
from .model import Curve, Model, curve, relative_error
from .press import timed_path
from .runs import Runner, job
from .simulate import in_time

MOST_STEPS = 4000
"""Time steps of a press that was fitted at rest, at most: a longer one is pressed faster."""


class Carried(NamedTuple):
    """The fit on another mesh, whose modulus alone was fitted again.

    errors : of each press there, see `model.relative_error`
    apart  : root mean square of the difference to the forces of the fit's own mesh, over the largest
    """

    mesh: str
    scene: Scene
    young: float
    errors: list[float]
    apart: float


def carried(model: Model, runner: Runner, theta: Floats, found: Scene, mesh: str) -> Carried:
    """The tissue of `found` on a mesh: a shipped one by its name, or a file. Raises SceneError where there is none."""
    other = scene_on(found, mesh)
    there = model.with_(other, unknowns=())
    ways = [model.way(k, model.shift(theta, k)) for k in range(len(model.presses))]
    runs = runner([job(each.scene, way, each.area) for each, way in zip(there.jobs([]), ways, strict=True)])
    own = model.curves(runner, [theta])[0]
    theirs = [curve(p, w, run, 1.0) for p, w, run in zip(model.presses, ways, runs, strict=True)]
    measured = [press.normal[way.used] for press, way in zip(model.presses, ways, strict=True)]
    scale = _scale([c.normal for c in theirs], measured)
    scaled = [curve(p, w, run, scale) for p, w, run in zip(model.presses, ways, runs, strict=True)]
    young = other.material.young * scale
    wrong = [
        np.mean((a.normal - b.normal) ** 2) / max(float(b.normal.max()), 1e-12) ** 2
        for a, b in zip(scaled, own, strict=True)
    ]
    errors = [relative_error(press, each) for press, each in zip(model.presses, scaled, strict=True)]
    scene = other.with_values({"material.young": young})
    return Carried(mesh, scene, young, errors, float(np.sqrt(np.mean(wrong))))


def _scale(given: Sequence[Floats], measured: Sequence[Floats]) -> float:
    """The factor with which relative differences of forces are least, in their median."""
    ratios = []
    for ours, theirs in zip(given, measured, strict=True):
        strong = (theirs > 0.05 * theirs.max()) & (ours > 0.0)
        ratios.append(np.log(theirs[strong] / ours[strong]))
    return float(np.exp(np.median(np.concatenate(ratios))))


def as_it_runs(model: Model, runner: Runner, theta: Floats, found: Scene, own: Sequence[Curve]) -> list[Curve]:
    """What each press gives where the scene runs with its own step and settings, at the samples of `own`.

    own: of the fit; areas are its own, as nobody looks at them in each step
    """
    scene = portable(found.with_values(in_time(found)))
    presses, jobs = [], []
    for k, press in enumerate(model.presses):
        start, seconds = press.time[0], press.time[-1] - press.time[0]
        faster = 1.0 if model.in_time else min(1.0, MOST_STEPS * found.dt / seconds)
        presses.append(replace(press, time=start + (press.time - start) * faster, area=None))
        jobs.append(job(scene, timed_path(presses[-1], found.dt, model.shift(theta, k)), False))
    return [
        curve(press, each.way, run, 1.0)._replace(way=fitted.way, area=fitted.area)
        for press, each, run, fitted in zip(presses, jobs, runner(jobs), own, strict=True)
    ]
