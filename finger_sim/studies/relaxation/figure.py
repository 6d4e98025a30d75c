"""The flesh of `finger_relaxing`: its force while a press is held, and how much of the work of a tap comes back.

A press goes down at 2 cm/s and holds. A tap is half a sine of depth in time, from first touch and back. Work is that of
the normal force on the bone's way. Each tap is made by the finger, by the same without limits, and by `finger_haptic`,
whose stress does not relax.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy.optimize import nnls

from ...arrays import Floats
from ...bags.strokes import FLAT, touch_height
from ...physics.step import Status
from ...pictures.surfaces import new_figure
from ...scene import Pose, Scene
from ...simulation.simulator import Simulator
from ..paper.figures import Finding, Meter

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Picture

SAID_BY = "known of fingertips"
"""Head of the column that measurements are held against."""
FINGER, ELASTIC = "finger_relaxing", "finger_haptic"
WHOLE, FREE, STILL = FINGER, f"{FINGER} without limits", ELASTIC
"""The fingers that tap."""
DEPTHS = (0.5e-3, 1e-3, 1.5e-3)
"""Of held presses [m]; the last one is a tap's."""
SPEED, HOLD = 0.02, 6.0
"""Of the way down [m/s], and how long a press is held [s]."""
TAPS = (0.02, 0.05, 0.1, 0.2, 0.5)
"""How long taps touch [s]."""
TAP = 0.1
"""The one whose loop is drawn and whose loss is held against LOST [s]."""
LOST, NEAR = 0.81, 0.05
"""Of a tap's work, lost on average over eight people and four ways to tap (Jindrich, Zhou, Becker and Dennerlein 2003);
what counts as agreement."""
FIT = 0.01
"""Rms of what three exponentials and a constant may leave of a held force, as a part of it."""
SIZE = (11.0, 4.1)
"""Of the picture [inch]."""
COLORS = {WHOLE: "#2a7f4f", FREE: "#d1730f", STILL: "0.55"}
SHADES = ("#9fd0b3", "#57a678", "#2a7f4f")
KNOWN_COLOR = "#b3332e"


class Held(NamedTuple):
    """A press that is held: the force [N] at times since its end [s]."""

    depth: float
    time: Floats
    force: Floats
    parts: Floats  # of the force at its end: of each term's time, and what stays; fitted
    missed: float  # rms of what they leave, as a part of that force


class Tap(NamedTuple):
    """Depth [m] and normal force [N] at the ends of steps."""

    depth: Floats
    force: Floats

    @property
    def lost(self) -> float:
        """Part of the work done on the way down that does not come back."""
        work = 0.5 * (self.force[1:] + self.force[:-1]) * np.diff(self.depth)
        return float(1.0 + work[work < 0.0].sum() / work[work > 0.0].sum())


@dataclass(frozen=True)
class Result:
    """All that was measured."""

    terms: tuple[tuple[float, float], ...]  # time [s] and share of each
    held: list[Held]
    taps: dict[str, dict[float, Tap]]  # by finger and duration
    inverted: int  # steps with a tetrahedron inside out


class _Finger:
    """A finger flat above the plane, moved by its depth since first touch."""

    def __init__(self, scene: Scene) -> None:
        self._simulator = Simulator(scene.with_values({"solver.sleep": False}))
        self._touch = touch_height(self._simulator.mesh.points, FLAT)
        self.inverted = 0

    def begin(self) -> None:
        """At first touch, its own weight hanging."""
        self._simulator.reset(self._pose(0.0))
        for _ in range(100):
            self._simulator.step()

    def _pose(self, depth: float) -> Pose:
        return Pose((0.0, 0.0, self._touch - depth), FLAT)

    def force(self, depth: float) -> float:
        """The normal force at the end of a step to there [N]."""
        came = self._simulator.step(self._pose(depth))
        self.inverted += bool(came.status & Status.INVERTED)
        return float(came.contact_wrench[2])


def fingers() -> dict[str, Scene]:
    """The scenes that tap."""
    whole = Scene.load(FINGER)
    return {WHOLE: whole, FREE: whole.with_values({"limits": None}), STILL: Scene.load(ELASTIC)}


def measure(progress: Meter, *, hold: float = HOLD, taps: tuple[float, ...] = TAPS) -> Result:
    """Press and hold (for so long [s]), and tap (each of these durations [s])."""
    scenes = fingers()
    whole = scenes[WHOLE]
    terms = tuple((term.time, term.share) for term in whole.material.relaxation)
    total = len(DEPTHS) * hold + len(scenes) * sum(taps)
    done, held, found, inverted = 0.0, [], dict[str, dict[float, Tap]](), 0
    for name, scene in scenes.items():
        finger = _Finger(scene)
        if name == WHOLE:
            for depth in DEPTHS:
                held.append(_held(finger, depth, hold, scene.dt, [time for time, _ in terms]))
                done += hold
                progress(done, total)
        found[name] = {}
        for duration in taps:
            found[name][duration] = _tap(finger, duration, scene.dt)
            done += duration
            progress(done, total)
        inverted += finger.inverted
    return Result(terms, held, found, inverted)


def _held(finger: _Finger, depth: float, hold: float, dt: float, times: list[float]) -> Held:
    finger.begin()
    steps = round(depth / SPEED / dt)
    for k in range(steps):
        finger.force(depth * (k + 1) / steps)
    time: Floats = np.arange(round(hold / dt)) * np.float64(dt)
    force = np.array([finger.force(depth) for _ in time])
    return Held(depth, time, force, *_fitted(time, force, times))


def _fitted(time: Floats, force: Floats, times: list[float]) -> tuple[Floats, float]:
    """Parts of a force that fade with these time constants, the last one for ever; rms of what they leave.

    By least squares over equal steps of the logarithm of time: each constant counts as much as another.
    """
    picked = np.unique(np.round(np.geomspace(1.0, len(time), 200)).astype(int)) - 1
    t, f = time[picked], force[picked]
    basis = np.stack([*(np.exp(-t / each) for each in times), np.ones_like(t)], axis=1)
    parts, left = nnls(basis, f)
    return parts / parts.sum(), float(left / math.sqrt(len(t)) / parts.sum())


def _tap(finger: _Finger, duration: float, dt: float) -> Tap:
    finger.begin()
    depth = DEPTHS[-1] * np.sin(np.linspace(0.0, math.pi, round(duration / dt) + 1))
    return Tap(depth, np.array([0.0, *(finger.force(each) for each in depth[1:])]))


def numbers(result: Result) -> dict[str, Any]:
    """What fades of a held force, and what taps lose."""
    return {
        "scene": FINGER,
        "terms": [{"time_s": time, "share": share} for time, share in result.terms],
        "press_speed_m_per_s": SPEED,
        "held": [
            {
                "depth_m": held.depth,
                "force_at_its_end_n": float(held.force[0]),
                "force_later": {f"{t:g}_s": _at(held, t) for t in (0.01, 0.1, 1.0, float(held.time[-1]))},
                "parts_by_time": [float(part) for part in held.parts],
                "rms_missed": held.missed,
            }
            for held in result.held
        ],
        "lost_known": LOST,
        "tap_depth_m": DEPTHS[-1],
        "lost": {name: {f"{t:g}_s": tap.lost for t, tap in taps.items()} for name, taps in result.taps.items()},
        "largest_force_n": {
            name: {f"{t:g}_s": float(tap.force.max()) for t, tap in taps.items()} for name, taps in result.taps.items()
        },
        "inverted_steps": result.inverted,
    }


def _at(held: Held, time: float) -> float:
    """Force at a time, as a part of that at the press's end."""
    return float(np.interp(time, held.time, held.force) / held.force[0])


def findings(result: Result) -> list[Finding]:
    """What is known of relaxation and of taps."""
    times = ", ".join(f"{1e3 * time:g}" for time, _ in result.terms)
    worst = max(held.missed for held in result.held)
    shares = [*(share for _, share in result.terms), 1.0 - sum(share for _, share in result.terms)]
    lost = {name: taps[TAP].lost for name, taps in result.taps.items()}
    return [
        Finding(
            paper="the force of a held press relaxes with time constants near 4 ms, 70 ms and 1.4 s, to a constant "
            "(Pawluk and Howe 1999)",
            measured=f"{times} ms and a constant leave {100.0 * worst:.2g} % of the force, rms; of it fade, and stay: "
            + "; ".join(f"{1e3 * held.depth:g} mm {_percents(held.parts)}" for held in result.held),
            agrees=worst < FIT,
            reason=f"the time constants are the scene's; its flesh has {_percents(np.array(shares))}. A press takes "
            "time, in which some fades, and what limits hold does not: the deeper, the less",
        ),
        Finding(
            paper="81 % of the energy of a tap is lost (Jindrich, Zhou, Becker and Dennerlein 2003)",
            measured=f"a tap of {1e3 * TAP:g} ms, {1e3 * DEPTHS[-1]:g} mm deep: "
            + ", ".join(f"{name} {100.0 * part:.0f} %" for name, part in lost.items()),
            agrees=abs(lost[WHOLE] - LOST) < NEAR,
            reason="limits are springs: what they hold comes back. A series that keeps a quarter of the stress, and "
            "linear in the strain, loses less than fingertips do also without them",
        ),
    ]


def _percents(parts: Floats) -> str:
    return " / ".join(f"{100.0 * part:.0f}" for part in parts) + " %"


def draw(result: Result) -> Picture:
    """Held forces over time; the loop of a tap; what taps lose over how long they touch."""
    figure = new_figure(*SIZE)
    from matplotlib import rc_context

    style: Any = {"font.size": 10, "axes.spines.top": False, "axes.spines.right": False}
    with rc_context(style):
        grid = figure.add_gridspec(1, 3, left=0.055, right=0.985, bottom=0.235, top=0.91, wspace=0.27)
        _fading(figure.add_subplot(grid[0]), result)
        _loops(figure.add_subplot(grid[1]), result)
        _losses(figure.add_subplot(grid[2]), result)
        figure.text(0.012, 0.02, _caption(), fontsize=8.5, color="0.3", va="bottom", linespacing=1.4)
    return figure


def _fading(axes: Axes, result: Result) -> None:
    """Force over that at the end of the press, and what flesh under a sudden strain would do."""
    for constant, _ in result.terms:
        axes.axvline(constant, color="0.85", linewidth=0.8)
        text = f"{constant:g} s" if constant >= 1.0 else f"{1e3 * constant:g} ms"
        axes.text(constant, 1.02, text, fontsize=8.5, color="0.45", ha="center", va="bottom")
    for held, color in zip(result.held, SHADES, strict=True):
        axes.semilogx(held.time[1:], held.force[1:] / held.force[0], color=color, linewidth=1.6)
        text = f"{1e3 * held.depth:g} mm"
        axes.text(0.5, _at(held, 0.2) + 0.005, text, color=color, ha="center", va="bottom", fontsize=9)
    time = result.held[0].time[1:]
    flesh = np.ones_like(time)
    for constant, share in result.terms:
        flesh += share * np.expm1(-time / constant)
    axes.semilogx(time, flesh, color="0.4", linewidth=1.0, linestyle="--")
    axes.text(time[0] * 1.2, 0.4, "its flesh,\nstrained at once", color="0.4", va="bottom", fontsize=9)
    axes.set(xlim=(time[0], time[-1]), ylim=(0.0, 1.0))
    axes.set(xlabel="time held [s]", ylabel="force / force when the press ends")


def _loops(axes: Axes, result: Result) -> None:
    """Force over depth."""
    for name in (STILL, FREE, WHOLE):
        tap = result.taps[name][TAP]
        axes.plot(1e3 * tap.depth, tap.force, color=COLORS[name], linewidth=1.6)
    axes.set(xlim=(0.0, None), ylim=(0.0, None), xlabel="depth [mm]", ylabel="normal force [N]")
    axes.set_title(f"a tap of {1e3 * TAP:g} ms", fontsize=10, loc="left")
    for k, name in enumerate((WHOLE, FREE, STILL)):
        text = f"{name}: {100.0 * result.taps[name][TAP].lost:.0f} % lost"
        axes.text(0.04, 0.95 - 0.075 * k, text, color=COLORS[name], transform=axes.transAxes, va="top", fontsize=9)


def _losses(axes: Axes, result: Result) -> None:
    """Work lost by how long a tap touches."""
    axes.axhline(100.0 * LOST, color=KNOWN_COLOR, linewidth=1.0)
    axes.text(0.98, 100.0 * LOST + 1.5, "fingertips: 81 %", color=KNOWN_COLOR, ha="right", va="bottom", fontsize=9,
              transform=axes.get_yaxis_transform())  # fmt: skip
    for name, taps in result.taps.items():
        lost = [100.0 * tap.lost for tap in taps.values()]
        axes.semilogx([1e3 * t for t in taps], lost, "o-", color=COLORS[name], markersize=4, linewidth=1.5)
    ticks = [1e3 * t for t in TAPS]
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.set_xticks([], minor=True)
    axes.set(ylim=(0.0, 100.0), xlabel="time that a tap touches [ms]", ylabel="work lost [%]")


def _caption() -> str:
    return (
        f"{FINGER} flat on the plane, steps of 1 ms. Left: pressed at {1e3 * SPEED:g} mm/s, then held. Middle, right: "
        f"half a sine, {1e3 * DEPTHS[-1]:g} mm deep.\nFingertips: Jindrich, Zhou, Becker and Dennerlein 2003, mean of "
        "eight people. Time constants: Pawluk and Howe 1999; the shares are chosen, not measured."
    )
