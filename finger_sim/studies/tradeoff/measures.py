"""What is read off a run: errors against a converged run, and what a hand feels."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ...arrays import Floats
from ...physics.step import Status
from .run import Course

WEBER, AT_FORCE = 0.08, 5.0
"""A difference of less than this part of a force of so much [N] is not felt."""
UNFELT = WEBER * AT_FORCE
"""Smallest difference of force that is felt at AT_FORCE [N]."""
CONE = 0.99
"""A contact slips where its tangential force is this part of the most that friction allows, or more."""
LOADED = 0.2
"""Part of the peak normal force from which on a slip counts."""
UNSOLVED = int(Status.NONFINITE | Status.STEP_REJECTED | Status.ITERATION_LIMIT)


class Errors(NamedTuple):
    """A run against another at the ends of its steps; NaN where there is nothing to compare."""

    force_rms_n: float
    force_max_n: float
    force_rel: float  # rms over the other's peak force
    torque_rms_nm: float
    node_rms_m: float
    slip_onset_s: float  # later than the other: positive


def errors(course: Course, other: Course, cone: tuple[Floats, float] | None) -> Errors:
    """Errors of `course` against `other`, read between its steps on a straight line. cone: see `slip_onset`."""
    wrench = course.wrench - _at(course.time, other)
    force, torque = (np.linalg.norm(wrench[:, part], axis=1) for part in (slice(0, 3), slice(3, 6)))
    peak = peak_force(other)
    node = math.nan
    count = min(len(course.nodes), len(other.nodes))
    if count and course.nodes.shape[1:] == other.nodes.shape[1:]:
        node = rms(np.linalg.norm(course.nodes[:count] - other.nodes[:count], axis=2).ravel())
    late = slip_onset(course, cone) - slip_onset(other, cone)
    relative = rms(force) / peak if peak > 0.0 else math.nan
    return Errors(rms(force), float(force.max()), relative, rms(torque), node, late)


def peak_force(course: Course) -> float:
    """Largest contact force [N]."""
    return float(np.linalg.norm(course.force, axis=1).max())


def slip_onset(course: Course, cone: tuple[Floats, float] | None) -> float:
    """Time of the first step with a loaded contact that slips [s]; NaN without one.

    cone: the plane's unit normal and its friction coefficient μ; None: no plane.
    """
    if cone is None or cone[1] == 0.0:
        return math.nan
    normal, friction = cone
    pressed = course.force @ normal
    sideways = np.linalg.norm(course.force - np.outer(pressed, normal), axis=1)
    slips = (sideways >= CONE * friction * pressed) & (pressed >= max(LOADED * pressed.max(), 1e-9))
    return float(course.time[np.argmax(slips)]) if slips.any() else math.nan


def jitter(course: Course, held: bool) -> float:
    """RMS of the second difference of the force from step to step [N], with the bone held or moving; NaN if never."""
    second = np.linalg.norm(np.diff(course.force, 2, axis=0), axis=1)
    wanted = (course.held if held else 1 - course.held).astype(bool)
    within = wanted[2:] & wanted[1:-1] & wanted[:-2]
    return rms(second[within]) if within.any() else math.nan


def overshoot(course: Course) -> float:
    """How far the largest strain went beyond its limit, as a part of the limit."""
    return max(0.0, float(course.strain_ratio.max()) - 1.0)


def unsolved(course: Course) -> float:
    """Share of steps that the solver did not finish within its tolerance, or that were not taken."""
    return float(((course.status & UNSOLVED) != 0).mean())


def rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _at(times: Floats, other: Course) -> Floats:
    """The wrench of another run at `times` (k,): (k, 6). At rest there is none before its first step."""
    t, w = np.append(0.0, other.time), np.vstack([np.zeros(6), other.wrench])
    return np.stack([np.interp(times, t, column) for column in w.T], axis=1)
