"""How long the steps of a scene take on this machine, what else it does left out."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...arrays import Floats
from ...scene import Pose, Scene
from ...simulation.simulator import Simulator
from ..bench.passes import pinned
from .motion import Motion

REPEATS = 5
"""Times that a motion is timed, after a warm-up."""
LONGEST = 15.0
"""Time after which no further repetition of a motion is begun [s]."""


@dataclass(frozen=True)
class Times:
    """Seconds of a step. Steps are the same in every repetition: of each, its least time counts."""

    steps: int  # of the motion
    mean: float
    median: float
    p99: float
    p99_disturbed: float  # of all times as they came


def times(data: dict[str, Any], motion: Motion, repeats: int = REPEATS, give_up: float | None = None) -> Times:
    """Time a scene (`portable`) on one processor, whole motions after a warm-up.

    give_up: a motion ends where its steps took so long together [s].
    """
    scene = Scene.from_dict(data)
    with pinned(None):
        simulator, poses = Simulator(scene), motion.poses(scene.dt)
        begun = time.perf_counter()
        passes = [_pass(simulator, motion, poses, give_up)]
        if time.perf_counter() - begun < LONGEST:
            passes.clear()
        while len(passes) < repeats and (not passes or time.perf_counter() - begun < LONGEST):
            passes.append(_pass(simulator, motion, poses, give_up))
    return summary(passes)


def summary(passes: Sequence[Floats]) -> Times:
    """Times of repetitions, each (k,) [s]; a step counts when all of them came to it."""
    steps = min(len(seconds) for seconds in passes)
    least = np.min([seconds[:steps] for seconds in passes], axis=0)
    p99, disturbed = (float(np.percentile(of, 99.0)) for of in (least, np.concatenate(passes)))
    return Times(steps, float(least.mean()), float(np.median(least)), p99, disturbed)


def _pass(simulator: Simulator, motion: Motion, poses: Sequence[Pose], give_up: float | None) -> Floats:
    """Seconds of each step."""
    simulator.reset(motion.at(0.0))
    seconds, spent = np.empty(len(poses)), 0.0
    for k, pose in enumerate(poses):
        start = time.perf_counter()
        simulator.step(pose)
        seconds[k] = time.perf_counter() - start
        spent += seconds[k]
        if give_up is not None and spent > give_up:
            return seconds[: k + 1]
    return seconds
