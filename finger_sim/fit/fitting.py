"""`finger_sim fit`: a scene's tissue from measured presses, step by step.

1. Read the presses and judge them (`csv_data`, `bag_data`, `checks`), or make one of a target (`target`).
2. Search: from several starts, with presses in longer parts, of a fine shipped finger on the mesh of 900 tetrahedra.
3. Leave out what the data cannot tell: such a value stays as it is in the scene. A target is served by all.
4. Converge on the scene's own mesh (`solve`).
5. Say how well each is known (`uncertainty`), and how other meshes and the scene as it really runs do (`carrying`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..arrays import Floats
from ..scene import Scene
from ..scene.calibration import name_of, scene_on
from ..studies.at_rest import faded
from .bag_data import read_bag
from .carrying import Carried, as_it_runs, carried
from .checks import checked
from .csv_data import read_csv
from .model import Curve, Model, differences, joined, needs_time, relative_error
from .parameters import Unknown, allowed, changes, default_names, unknowns_of
from .press import FitError, Press, touching
from .runs import Runner
from .solve import Solution, best_modulus, jacobian, robust_cost, robust_scale, solve, starts, usual_size
from .target import target_press
from .uncertainty import Interval, LeftOut, Local, bootstrap, left_out, linear_errors, local, moved, profile, widened

SEARCHED_ON = {"finger_2000": "finger", "finger_4000": "finger", "finger_16000": "finger"}
"""Mesh of the search by the scene's own: a sixth of the time and less. On `finger_500` the side is another finger."""
LONGER = 1.7
"""Parts of a press in the search, over those at the end."""
REFINED = 2
"""So many of the starts are followed to their end."""
FIRST, LAST = 8, 10
"""Trial points of a search and of the end, at most."""
DOUBTED = 0.45
"""Standard error of θ above which it is asked whether data tell an unknown at all."""

Tell = Callable[[str], None]


@dataclass(frozen=True)
class Options:
    """What to fit, to what; see `finger_sim fit --help`."""

    scene: str
    data: Sequence[Path] = ()
    target: str | None = None
    names: Sequence[str] = ()
    direction: str | None = None
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    priors: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    starts: int = 6
    floor: float = 0.0
    carry: Sequence[str] = ()
    in_time: bool = False


class Estimate(NamedTuple):
    """What came of one unknown, θ and ends of its interval.

    told   : whether data tell it; if not it is what it was
    why    : what data cannot tell, in words
    resampled : interval of the bootstrap over presses; None with too few
    """

    unknown: Unknown
    theta: float
    interval: Interval | None
    told: bool
    why: str
    resampled: tuple[float, float] | None


@dataclass(frozen=True)
class Fit:
    """What came of a fit.

    scene     : with the values that were found
    curves    : of each press with it, and `before` with the scene as it was
    errors    : root mean square of each press's normal force over its largest, `errors_before` likewise
    foretold  : presses left out
    as_run    : of each press, the same error where the scene runs in time with its own settings; None: a target
    notes     : what is doubtful about data
    """

    given: Scene
    scene: Scene
    model: Model
    estimates: list[Estimate]
    curves: list[Curve]
    before: list[Curve]
    errors: list[float]
    errors_before: list[float]
    size: float
    foretold: list[LeftOut]
    carried: list[Carried]
    as_run: list[float] | None
    notes: list[str]


def read(options: Options) -> tuple[Scene, list[Press], list[str]]:
    """Scene, presses and what is doubtful about them. Raises FitError and others; nothing was simulated then."""
    scene = Scene.load(options.scene)
    if scene.plane is None:
        raise FitError(f"{options.scene}: plane: the scene has none, allowed: one to press on")
    mesh = scene.load_mesh()
    if scene.driven is None:
        raise FitError(f"{options.scene}: driven: nothing is, allowed: a scene whose bone is driven")
    for other in options.carry:
        scene_on(scene, other).load_mesh()
    if options.target is not None:
        if options.data:
            raise FitError("--target: not allowed with --data")
        return scene, [target_press(options.target, scene, mesh, options.direction or "flat")], []
    if not options.data:
        raise FitError("--data: got none, allowed: a CSV file or a bag of presses; or --target")
    presses: list[Press] = []
    for path in options.data:
        if not path.exists():
            raise FitError(f"--data: {path}: no such file")
        is_bag = path.is_dir() or path.suffix in (".mcap", ".db3")
        presses += read_bag(path, scene, mesh) if is_bag else read_csv(path, scene, mesh, options.direction)
    presses, notes = checked(presses, scene, mesh)
    return scene, presses, notes


def asked(options: Options, scene: Scene, presses: Sequence[Press]) -> list[Unknown]:
    """The unknowns that are to be fitted. Raises FitError."""
    names = [press.name for press in presses]
    found = unknowns_of(scene, options.names or default_names(scene), names, options.bounds, options.priors)
    timed = [one.name for one in found if one.timed]
    if options.target is not None and timed:
        raise FitError(f"--fit: {', '.join(timed)}: a target is a curve at rest, allowed: what shows at rest")
    return found


def fit(options: Options, runner: Runner, tell: Tell) -> Fit:
    """The whole of it. tell: takes a line on each stage. Raises FitError, SceneError, MeshError, BagError."""
    scene, presses, notes = read(options)
    unknowns = asked(options, scene, presses)
    wanted, in_time = options.target is not None, options.in_time
    in_time = in_time or needs_time(faded(scene) if wanted else scene, unknowns)
    model = Model(scene, tuple(unknowns), tuple(presses), in_time, wanted=wanted, floor=options.floor)
    count = len(unknowns)
    runner.foreseen = len(presses) * (options.starts + (REFINED * 5 + 4) * (count + 1) + 16 * count + 16)
    tell(f"{len(presses)} presses, {count} unknowns: {', '.join(one.name for one in unknowns)}")
    before = model.curves(runner, [np.array([one.theta(one.start) for one in unknowns])])[0]
    _require_same_world(model, before)
    tell(f"searching from {options.starts} starts")
    searched = search(model, runner, options.starts)
    own = best_modulus(model, runner, [searched.theta])[0]
    theta, lost = own, dict[str, tuple[Interval, str]]()
    if not wanted:
        tell("what data can tell")
        model, theta, lost = without_untold(model, runner, own)
    tell(f"converging on {_mesh_words(scene)}")
    size = usual_size(model.residuals(runner, [theta])[0])
    solution = solve(model, runner, theta, size, LAST)
    size = usual_size(solution.residuals)
    solution = replace(solution, theta=allowed(model.unknowns, scene, solution.theta), size=size)
    near = local(solution, _derivatives(model, runner, solution))
    tell("how well each is known")
    intervals = profile(model, runner, near, range(len(model.unknowns)))
    resampled = bootstrap(model, near)
    foretold = left_out(model, runner, near)
    found = scene.with_values(changes(model.unknowns, scene, solution.theta))
    curves = model.curves(runner, [solution.theta])[0]
    runs = None
    if not wanted:
        tell("as the scene runs, in time")
        runs = as_it_runs(model, runner, solution.theta, found, curves)
    intervals = _widened(model, runner, near, intervals, runs)
    estimates = _estimates(unknowns, model, near, intervals, resampled, lost)
    others = []
    for mesh in options.carry:
        tell(f"the same tissue on {mesh}")
        others.append(carried(model, runner, solution.theta, found, mesh))
    as_run = None if runs is None else [relative_error(p, c) for p, c in zip(presses, runs, strict=True)]
    return Fit(
        scene, found, model, estimates, curves, before,
        [relative_error(p, c) for p, c in zip(presses, curves, strict=True)],
        [relative_error(p, c) for p, c in zip(presses, before, strict=True)],
        size, foretold, others, as_run, notes,
    )  # fmt: skip


def search(model: Model, runner: Runner, count: int) -> Solution:
    """The best of several starts, on a mesh and with parts that are quick."""
    mesh = SEARCHED_ON.get(name_of(model.scene.mesh.file) or "")
    quick = model.with_(scene_on(model.scene, mesh) if mesh else model.scene, coarse=LONGER)
    points = best_modulus(quick, runner, starts(quick, count))
    found = quick.residuals(runner, points)
    ranked = sorted(range(len(points)), key=lambda k: robust_cost(found[k].values, robust_scale(1.0)))
    ends = [solve(quick, runner, points[k], usual_size(found[k]), FIRST) for k in ranked[:REFINED]]
    return min(ends, key=lambda end: robust_cost(end.residuals.values, robust_scale(1.0)))


def without_untold(
    model: Model, runner: Runner, theta: Floats
) -> tuple[Model, Floats, dict[str, tuple[Interval, str]]]:
    """The model without unknowns that data do not tell, which keep the scene's value; θ of the others; and why.

    One at a time, the least known first: what seems unknown may only be so together with another.
    """
    lost: dict[str, tuple[Interval, str]] = {}
    while len(model.unknowns):
        residuals = model.residuals(runner, [theta])[0]
        solution = Solution(theta, residuals, usual_size(residuals), 0.0)
        near = local(solution, _derivatives(model, runner, solution))
        errors = linear_errors(model, near)
        doubted = [j for j in np.argsort(-errors).tolist() if errors[j] > DOUBTED and model.unknowns[j].kind != "touch"]
        if not doubted:
            break
        intervals = profile(model, runner, near, doubted)
        curves = model.curves(runner, [theta])[0]
        gone = next((j for j in doubted if _untold(model.unknowns[j], intervals[j])), None)
        if gone is None:
            break
        one = model.unknowns[gone]
        lost[one.name] = (intervals[gone], _why(model, near, gone, intervals[gone], curves))
        model = model.with_(unknowns=[u for j, u in enumerate(model.unknowns) if j != gone])
        theta = solve(model, runner, np.delete(theta, gone), usual_size(residuals), 3).theta
    return model, theta, lost


def _untold(one: Unknown, interval: Interval) -> bool:
    """Whether data allow the scene's value, and everything beyond on a side."""
    was = one.theta(one.start)
    if interval.low_open and interval.high_open:
        return True
    return (interval.low_open and was <= interval.high) or (interval.high_open and was >= interval.low)


def _why(model: Model, near: Local, j: int, interval: Interval, curves: Sequence[Curve]) -> str:
    """Why data do not tell an unknown, in words."""
    one = model.unknowns[j]
    if interval.low_open and interval.high_open:
        fits = "any value fits"
    else:
        end = interval.low if interval.high_open else interval.high
        above = interval.high_open != (one.kind == "compress")
        fits = f"any value {'above' if above else 'below'} {one.words(end)} fits"
    was = f"it is left as it was, {one.words(one.theta(one.start))}"
    if one.axes:
        which = [axis + (3 if one.kind == "compress" else 0) for axis in one.axes]
        reach = max(float(each.reach[which].max()) for each in curves) if curves else 0.0
        axes = ", ".join(f"e{axis + 1}" for axis in one.axes)
        side = "stretch" if one.kind == "stretch" else "compression"
        if reach < 1.0:
            return f"no press reaches a limit of {side} along {axes} (strain comes to {reach:.2f} of it): {fits}; {was}"
    if one.kind == "time":
        longest = max(float(np.ptp(press.time[touching(press)])) for press in model.presses)
        return f"the longest press touches for {longest:.3g} s: {fits}; {was}{_companion(model, near, j)}"
    return f"{fits}; {was}{_companion(model, near, j)}"


def _companion(model: Model, near: Local, j: int) -> str:
    """The unknown that most nearly does the same to the presses, where one does."""
    size = np.linalg.norm(near.J, axis=0)
    if size[j] <= 0.0 or len(size) < 2:
        return ""
    alike = np.abs(near.J.T @ near.J[:, j]) / np.maximum(size * size[j], 1e-12)
    alike[j] = 0.0
    other = int(np.argmax(alike))
    return f" ({model.unknowns[other].name} does nearly the same)" if alike[other] > 0.9 else ""


def _widened(
    model: Model, runner: Runner, near: Local, intervals: Mapping[int, Interval], runs: Sequence[Curve] | None
) -> dict[int, Interval]:
    """Intervals that also hold what halved parts of presses, and the scene as it runs, would give."""
    if not intervals:
        return {}
    theta = near.solution.theta
    by = np.zeros(len(theta))
    if not model.in_time:
        by = np.maximum(by, moved(model, near, model.with_(finer=2).residuals(runner, [theta])[0]))
    if runs is not None:
        pairs = zip(model.presses, runs, strict=True)
        by = np.maximum(by, moved(model, near, joined([differences(p, c, model.floor) for p, c in pairs])))
    return {j: widened(interval, float(by[j])) for j, interval in intervals.items()}


def _derivatives(model: Model, runner: Runner, solution: Solution) -> Floats:
    if not len(model.unknowns):
        return np.empty((len(solution.residuals.values), 0))
    return jacobian(model, runner, solution.theta, central=True)


def _require_same_world(model: Model, before: Sequence[Curve]) -> None:
    """Raises FitError where forces are so far from the scene's that a unit must be wrong."""
    for press, given in zip(model.presses, before, strict=True):
        theirs, ours = float(np.abs(press.normal).max()), float(np.nanmax(given.normal))
        if ours > 0.0 and not 1e-3 < theirs / ours < 1e3:
            raise FitError(
                f"{press.name}: normal: got {theirs:.3g} N where the scene gives {ours:.3g} N at the same depth, "
                f"allowed: within a factor of 1000; are units of depth or force mixed up?"
            )


def _mesh_words(scene: Scene) -> str:
    return Path(scene.mesh.file).stem if scene.mesh.file else "the scene's beam"


def _estimates(
    unknowns: Sequence[Unknown], model: Model, near: Local, intervals: Mapping[int, Interval],
    resampled: Sequence[tuple[float, float]], lost: Mapping[str, tuple[Interval, str]],
) -> list[Estimate]:  # fmt: skip
    """In the order that was asked for."""
    out = []
    fitted = {one.name: j for j, one in enumerate(model.unknowns)}
    for one in unknowns:
        if one.name in lost:
            interval, why = lost[one.name]
            out.append(Estimate(one, one.theta(one.start), interval, False, why, None))
            continue
        j = fitted[one.name]
        interval = intervals[j]
        why = ""
        if interval.low_open and interval.high_open:
            why = "data do not bound it"
        elif interval.low_open or interval.high_open:
            low = interval.low_open != (one.kind == "compress")
            why = f"data do not bound it {'below' if low else 'above'}"
        theta = float(near.solution.theta[j])
        out.append(Estimate(one, theta, interval, True, why, resampled[j] if resampled else None))
    return out
