"""Section 5.1's performance: steps a second by the number of tetrahedra at a limit.

The motions are cut into short pieces that take turns in one process: what else the machine does falls on all alike.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ...arrays import Floats, Ints
from ...bags.strokes import SIDE, Stroke, touch_height, trace
from ...physics.step import Status
from ...pictures.surfaces import new_figure
from ...scene import Pose, Scene
from ...simulation.simulator import Simulator
from ..bench.bench import describe_machine
from ..shared import poses
from .figures import Finding, Meter
from .presses import PAPERS, TISSUE

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Picture


class Contender(NamedTuple):
    """A shipped scene, what is changed in it, and its motion: a shipped bag, or SIDE_PRESS without."""

    scene: str
    values: Mapping[str, Any]
    bag: str | None


SLIDE = "press_slide"
CONTENDERS = {
    "hyperbolic, pgs": Contender("finger", PAPERS, SLIDE),
    "hyperbolic, newton": Contender("finger", PAPERS | {"solver.method": "newton"}, SLIDE),
    "tensor, newton": Contender("finger_haptic", TISSUE, SLIDE),
    "rigid hyperbolic, pgs": Contender("finger_paper", {}, None),
}
SIDE_PRESS = (Stroke(0.1, (0.0, 0.0, 0.0)), Stroke(1.2, (0.0, 0.0, -7e-3)), Stroke(0.6, (0.0, 0.0, 0.0)))
"""A finger held at its cut end is laid on its side and lowered; past 5.5 mm its rigid limits cannot all hold."""
AWAKE: dict[str, Any] = {"solver.sleep": False}
"""Steps that are not computed are none."""
REPEATS, PIECE = 3, 100
"""Times that each motion runs, and steps of a piece."""
FEWEST = (0, 1, 5, 10, 20, 40, 80, 160)
"""Tetrahedra at a limit from which on a step belongs to the next group."""
PAPER_HZ, PAPER_TETS, PAPER_CONSTRAINTS = 1.0, 40, 5
"""The paper: under 1 Hz above 40 tetrahedra with constraints, real time below about 5 constraints."""
PAPER_MACHINE = "3.4 GHz Core i7-3770 (2013)"

SIZE = (10.5, 6.4)
"""Of the picture [inch]."""
COLORS = {
    "hyperbolic, pgs": "#0b5394",
    "hyperbolic, newton": "#7a5ba6",
    "tensor, newton": "#2a7f4f",
    "rigid hyperbolic, pgs": "#d1730f",
}
PAPER_COLOR = "#b3332e"
LOWEST, HIGHEST = 0.1, 1e5
"""Steps a second, the ends of the scale [Hz]."""


@dataclass(frozen=True)
class Timings:
    """What the steps of one contender took and gave; all (repeats, steps)."""

    seconds: Floats
    tets: Ints  # at a limit
    status: Ints

    @staticmethod
    def empty(repeats: int, steps: int) -> Timings:
        shape = (repeats, steps)
        return Timings(np.full(shape, np.nan), np.zeros(shape, np.int64), np.zeros(shape, np.int64))


class Group(NamedTuple):
    """Steps with about as many tetrahedra at a limit."""

    fewest: int
    most: int | None  # None: no bound
    steps: int
    tets: float  # median
    median: float  # steps a second [Hz]
    p10: float
    p90: float


@dataclass(frozen=True)
class Result:
    """All that was timed."""

    courses: dict[str, Timings]
    dt: float  # [s]
    machine: dict[str, Any]


def measure(progress: Meter, *, repeats: int = REPEATS, steps: int | None = None) -> Result:
    """Time every contender through its motion (steps: no more than so many of them)."""
    scenes = {name: Scene.load(who.scene).with_values({**AWAKE, **who.values}) for name, who in CONTENDERS.items()}
    motions = {name: motion_of(who, scenes[name])[:steps] for name, who in CONTENDERS.items()}
    simulators = {name: Simulator(scene) for name, scene in scenes.items()}
    dt = {scene.dt for scene in scenes.values()}
    assert len(dt) == 1
    return Result(timed(simulators, motions, repeats, progress), dt.pop(), describe_machine())


def motion_of(who: Contender, scene: Scene) -> list[Pose]:
    """One command for each step: of the contender's bag; without one, SIDE_PRESS."""
    if who.bag is not None:
        return poses(scene, who.bag)
    t = np.arange(0.0, sum(stroke.duration for stroke in SIDE_PRESS), scene.dt)
    position = trace(SIDE_PRESS, t)
    position[:, 2] += touch_height(scene.load_mesh().points, SIDE)
    return [Pose((*p,), SIDE) for p in position.tolist()]


def timed(
    simulators: Mapping[str, Simulator], motions: Mapping[str, Sequence[Pose]], repeats: int, progress: Meter
) -> dict[str, Timings]:
    """Each simulator's steps through its motion, `repeats` times; all take turns, PIECE steps each."""
    courses = {name: Timings.empty(repeats, len(motions[name])) for name in simulators}
    longest = max(len(motion) for motion in motions.values())
    for repeat in range(repeats):
        for name, simulator in simulators.items():
            simulator.reset(motions[name][0])
        for first in range(0, longest, PIECE):
            for name, simulator in simulators.items():
                _piece(simulator, motions[name], first, repeat, courses[name])
            progress(repeat * longest + first + PIECE, repeats * longest)
    return courses


def _piece(simulator: Simulator, motion: Sequence[Pose], first: int, repeat: int, course: Timings) -> None:
    """PIECE steps from `first` on, or what is left of them, into row `repeat`."""
    for k in range(first, min(first + PIECE, len(motion))):
        start = time.perf_counter()
        came = simulator.step(motion[k])
        course.seconds[repeat, k] = time.perf_counter() - start
        course.tets[repeat, k], course.status[repeat, k] = came.limited_tets, int(came.status)


def groups(tets: Ints, seconds: Floats) -> list[Group]:
    """Steps a second by tetrahedra at a limit, one group for each of FEWEST that has steps. Both of one shape."""
    index = np.searchsorted(FEWEST, tets, side="right") - 1
    bounds = zip(FEWEST, [*(fewest - 1 for fewest in FEWEST[1:]), None], strict=True)
    return [
        _group(fewest, most, tets[index == k], seconds[index == k])
        for k, (fewest, most) in enumerate(bounds)
        if (index == k).any()
    ]


def _group(fewest: int, most: int | None, tets: Ints, seconds: Floats) -> Group:
    p10, median, p90 = (float(rate) for rate in np.percentile(1.0 / seconds, (10.0, 50.0, 90.0)))
    return Group(fewest, most, len(tets), float(np.median(tets)), median, p10, p90)


def above(course: Timings) -> Group | None:
    """All steps with more tetrahedra at a limit than the paper's number; None when there are none."""
    many = course.tets > PAPER_TETS
    return _group(PAPER_TETS + 1, None, course.tets[many], course.seconds[many]) if many.any() else None


def numbers(result: Result) -> dict[str, Any]:
    """Steps a second of each contender, by group and above the paper's 40 tetrahedra."""
    return {
        "cpu": result.machine["cpu"],
        "dt_s": result.dt,
        "real_time_hz": 1.0 / result.dt,
        "paper_hz": PAPER_HZ,
        "paper_machine": PAPER_MACHINE,
        "contenders": {name: _contender_numbers(name, course) for name, course in result.courses.items()},
    }


def _contender_numbers(name: str, course: Timings) -> dict[str, Any]:
    who, many = CONTENDERS[name], above(course)
    unsolved = int(Status.ITERATION_LIMIT | Status.STEP_REJECTED)
    return {
        "scene": who.scene,
        "values": dict(who.values),
        "motion": who.bag or "side press",
        "repeats": len(course.tets),
        "most_tets": int(course.tets.max()),
        "solved_steps": float((course.status & unsolved == 0).mean()),
        "groups": [_group_numbers(group) for group in groups(course.tets, course.seconds)],
        "above_40": None if many is None else _group_numbers(many) | {"over_paper": many.median / PAPER_HZ},
    }


def _group_numbers(group: Group) -> dict[str, Any]:
    return {
        "tets_from": group.fewest,
        "tets_to": group.most,
        "tets_median": group.tets,
        "steps": group.steps,
        "median_hz": group.median,
        "p10_hz": group.p10,
        "p90_hz": group.p90,
    }


def findings(result: Result) -> list[Finding]:
    """The paper's two statements on speed."""
    real_time = 1.0 / result.dt
    few = {name: _few(course) for name, course in result.courses.items()}
    many = {name: group for name, course in result.courses.items() if (group := above(course)) is not None}
    return [
        Finding(
            paper="runs in real time for a low number of constraints (about < 5)",
            measured=f"median with 1 to 4 tetrahedra at a limit: {_rates(few)}; real time at {1e3 * result.dt:g} ms is "
            f"{real_time:.0f} Hz",
            agrees=min(group.median for group in few.values()) >= real_time,
        ),
        Finding(
            paper="drops below 1 Hz with more than 40 tetrahedra with constraints",
            measured=f"median there: {_rates(many)}; one core of {result.machine['cpu']}",
            agrees=max(group.median for group in many.values()) < PAPER_HZ,
            reason=f"its machine was a {PAPER_MACHINE}, its solver not tuned to converge; its time step and tolerance "
            "are not given. Where rigid limits cannot all hold (finger_paper past about 35 tetrahedra), projected "
            "Gauss-Seidel needs up to its cap of 400 sweeps",
        ),
    ]


def _few(course: Timings) -> Group:
    """Steps with a tetrahedron at a limit or more, but fewer than the paper's constraints."""
    some = (course.tets > 0) & (course.tets < PAPER_CONSTRAINTS)
    return _group(1, PAPER_CONSTRAINTS - 1, course.tets[some], course.seconds[some])


def _rates(found: Mapping[str, Group]) -> str:
    return "; ".join(f"{name}: {group.median:.0f} Hz" for name, group in found.items())


def draw(result: Result) -> Picture:
    """Steps a second over tetrahedra at a limit; what the paper says in red."""
    figure = new_figure(*SIZE)
    from matplotlib import rc_context

    style: Any = {"font.size": 10, "axes.spines.top": False, "axes.spines.right": False}
    with rc_context(style):
        axes = figure.add_axes((0.075, 0.21, 0.905, 0.765))
        _scales(axes)
        _paper(axes)
        axes.axhline(1.0 / result.dt, color="0.3", linewidth=0.9, linestyle="--")
        axes.text(
            0.1, 0.85 / result.dt, f"real time at {1e3 * result.dt:g} ms a step", color="0.3", va="top", fontsize=9
        )
        for name, course in result.courses.items():
            _curve(axes, name, groups(course.tets, course.seconds))
        axes.legend(frameon=False, loc="upper right", fontsize=9, ncols=2)
        figure.text(0.012, 0.018, _caption(result), fontsize=8.5, color="0.3", va="bottom", linespacing=1.4)
    return figure


def _scales(axes: Axes) -> None:
    axes.set_xscale("symlog", linthresh=1.0, linscale=0.6)
    axes.set_yscale("log")
    axes.set(xlim=(-0.15, 270.0), ylim=(LOWEST, HIGHEST))
    ticks = (0, 1, 2, 5, 10, 20, 40, 80, 160)
    axes.set_xticks(ticks, [f"{tick}" for tick in ticks])
    axes.set_xticks([], minor=True)
    axes.set(xlabel="tetrahedra at a limit", ylabel="steps a second [Hz]")
    axes.grid(axis="y", color="0.92", linewidth=0.6)
    axes.set_axisbelow(True)


def _paper(axes: Axes) -> None:
    """The paper's two statements: a shaded corner, and a bracket without a height."""
    right = axes.get_xlim()[1]
    axes.fill_between([PAPER_TETS, right], LOWEST, PAPER_HZ, color=PAPER_COLOR, alpha=0.13, linewidth=0)
    axes.plot([PAPER_TETS, PAPER_TETS, right], [LOWEST, PAPER_HZ, PAPER_HZ], color=PAPER_COLOR, linewidth=1.0)
    style: Any = {"color": PAPER_COLOR, "fontsize": 9}
    middle = float(np.sqrt(PAPER_TETS * right))
    axes.text(middle, 0.32, "the paper: under 1 Hz\nabove 40 tetrahedra", ha="center", va="center", **style)
    axes.annotate("", (0.0, 4.0), (PAPER_CONSTRAINTS, 4.0), arrowprops={"arrowstyle": "|-|", "color": PAPER_COLOR})
    axes.text(0.1, 5.5, "the paper: “real time” below about 5 constraints", va="bottom", **style)


def _curve(axes: Axes, name: str, found: Sequence[Group]) -> None:
    """Medians, and a band from p10 to p90."""
    tets = [group.tets for group in found]
    label = f"{name} ({CONTENDERS[name].scene})"
    axes.fill_between(tets, [g.p10 for g in found], [g.p90 for g in found], color=COLORS[name], alpha=0.15, linewidth=0)
    axes.plot(tets, [g.median for g in found], "o-", color=COLORS[name], markersize=4, linewidth=1.5, label=label)


def _caption(result: Result) -> str:
    return (
        f"350 tetrahedra, {1e3 * result.dt:g} ms a step, whole steps from Python on one core of "
        f"{result.machine['cpu']}: median, p10 to p90. Motion: {SLIDE}; "
        "finger_paper: pressed 7 mm on\nits side, where past about 35 tetrahedra its rigid limits cannot all hold. "
        f"The paper: 347 tetrahedra on a {PAPER_MACHINE}; it gives no\nnumber for “real time” and no time step; a "
        "tetrahedron may have several constraints."
    )
