"""`finger_sim tradeoff --for-rate HZ`: the most accurate mesh and settings of a scene that hold a rate on this machine.

Of a shipped finger on its bone, mesh and element are chosen (MESHES), the error is against the finger that is meant;
of any other scene only how it is solved (dt = 1/HZ), the error is against the same model, converged. A setting holds
the rate when 99 of 100 steps take no longer than HEADROOM of the period: the rest is for the loop around the step. Of
those that hold, the one with the least force error; of some that are as good to CLOSE, the fastest.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...console import table
from ...errors import FingerSimError
from ...scene import Scene
from ..bench.bench import describe_machine
from .grid import AWAKE, MEANT, changed, meant, reference, soft
from .measures import Errors, errors, peak_force
from .motion import Motion, TradeoffError, motion
from .run import Course, Times, course, portable, times
from .scene import Meant, Measured, write_scene
from .store import Store, job

if TYPE_CHECKING:
    from rich.table import Table

Meter = Callable[[float, float], None]

HEADROOM = 0.8
CLOSE = 1.05
SUBSTEPS = (1, 2, 4, 8, 16)
"""Tried from the first on, until one is too slow."""
FAST: dict[str, Any] = {"solver.method": "newton", "solver.max_iterations": 30}
NEWTON: tuple[dict[str, Any], ...] = (
    {"solver.level": "lagged", "solver.tolerance": 1e-2},
    {"solver.level": "lagged", "solver.tolerance": 1e-3},
    {"solver.level": "standard", "solver.tolerance": 1e-3},
    {"solver.level": "standard", "solver.tolerance": 1e-4},
    {"solver.level": "standard", "solver.tolerance": 1e-3, "solver.relinearizations": 1},
)
PGS: tuple[dict[str, Any], ...] = tuple({"solver.tolerance": tolerance} for tolerance in (1e-1, 1e-2, 1e-3, 1e-4))
"""Settings tried, fast ones first: where limits give way, and where they are rigid."""
MESHES: tuple[dict[str, Any], ...] = tuple(
    {"mesh.file": f"meshes/{name}.vtu", "material.volumetric": volumetric}
    for name in ("finger_500", "finger", "finger_2000", MEANT)
    for volumetric in ("patch", "element")
)
"""Bodies tried in the place of a shipped finger, besides its own."""
CONTACT = (250.0, 1000.0)
"""plane.stiffness tried with each, besides the scene's."""


@dataclass(frozen=True)
class Try:
    """One setting, timed; `errors` where it holds the rate."""

    changed: Mapping[str, Any]
    times: Times
    holds: bool
    errors: Errors | None = None  # against the finger that is meant; where there is none, the same model, converged
    own: Course | None = None


@dataclass(frozen=True)
class Found:
    """What came of the search."""

    tries: list[Try]
    best: Try  # where none holds, the nearest
    scene: Path | None  # written; None where none holds


def for_rate(
    name: str, rate: float, bag: str | None, duration: float | None, out: Path, progress: Meter, mesh: str = MEANT
) -> Found:
    """Search, and write OUT/<scene>_<rate>hz.yaml; mesh: of the finger that is meant.

    Converged runs are kept in OUT/points. Raises SceneError, MeshError, BagError or TradeoffError.
    """
    given = Scene.load(name)
    try:
        scene = given.with_values({**AWAKE, "dt": 1.0 / rate, "substeps": 1, "solver.relinearizations": 0})
    except FingerSimError as error:
        raise TradeoffError(f"--for-rate: got {rate:g} Hz: {error}") from None
    path = motion(scene, bag, duration)
    if path.steps(scene.dt) < 3:
        raise TradeoffError(f"--for-rate: got {rate:g} Hz, allowed: three steps or more in {path.duration:g} s")
    store = Store(out / "points")
    scene = scene.with_values({"solver.level": "standard"})
    if soft(scene):
        contact = {"plane.stiffness": CONTACT[-1]} if scene.plane and scene.plane.stiffness is None else {}
        scene = scene.with_values({**FAST, **contact})
    finger = meant(scene, mesh)
    tries = search(ladders(scene, finger), lambda values: _timed(scene, values, path), scene.dt, progress)
    if not any(one.holds for one in tries):
        return Found(tries, choose(tries), None)
    exact = _converged(scene if finger is None else finger, scene, path, store)
    tries = [_with_errors(one, scene, path, exact) if one.holds else one for one in tries]
    best = choose(tries)
    chosen = changed(scene, {**best.changed, "solver.sleep": given.solver.sleep})
    assert best.errors is not None
    assert best.own is not None
    same, coarser = (_converged(chosen, scene, path, store, k) for k in (1, 2))
    off = None if finger is None else Meant(mesh, errors(same, exact, None), best.errors)
    doubt = errors(coarser, same, None).force_rel
    measured = Measured(errors(best.own, same, None), doubt, peak_force(best.own), best.times, off)
    comments = [
        f"The most accurate settings of {name} that were found to hold {rate:g} Hz: `finger_sim tradeoff --for-rate`.",
        *measured.sentences(path.name, describe_machine()["cpu"]),
    ]
    return Found(tries, best, write_scene(out / f"{Path(name).stem}_{rate:g}hz.yaml", chosen, comments))


def _converged(scene: Scene, base: Scene, path: Motion, store: Store, coarser: int = 1) -> Course:
    """The scene's model, converged: of before where it is there."""
    tets = len(scene.load_mesh().tets)
    wanted = job("course", reference(scene, base, tets, coarser), path, tets)
    found = store.load(wanted)
    if not isinstance(found, Course):
        found = course(portable(wanted.scene), path, False)
        store.save(wanted, found)
    return found


def ladders(scene: Scene, finger: Scene | None) -> list[list[dict[str, Any]]]:
    """Settings to try, a list for each body: that of the scene and, where another finger is meant, MESHES.

    On each, fast settings come first.
    """
    bodies: dict[Scene, dict[str, Any]] = {scene: {}}
    if finger is not None:
        for body in MESHES:
            bodies.setdefault(changed(scene, body), body)
    return [[{**body, **setting} for setting in ladder(scene)] for body in bodies.values()]


def ladder(scene: Scene) -> list[dict[str, Any]]:
    """Settings to try."""
    settings = NEWTON if soft(scene) else PGS
    if scene.plane is None:
        return [dict(setting) for setting in settings]
    contacts = dict.fromkeys([scene.plane.stiffness, *CONTACT])
    return [{**setting, "plane.stiffness": contact} for setting in settings for contact in contacts]


def search(
    bodies: Sequence[Sequence[Mapping[str, Any]]],
    clock: Callable[[Mapping[str, Any]], Times],
    dt: float,
    progress: Meter,
) -> list[Try]:
    """Time every setting of every body with more and more substeps, as long as it holds steps of `dt` [s].

    A body whose first setting misses even the whole period has no other tried.
    """
    tries = []
    total, begun = sum(map(len, bodies)) * len(SUBSTEPS), 0
    for settings in bodies:
        for k, setting in enumerate(settings):
            for i, substeps in enumerate(SUBSTEPS):
                progress(begun + k * len(SUBSTEPS) + i, total)
                values = {**setting, "substeps": substeps}
                took = clock(values)
                tries.append(Try(values, took, took.p99 <= HEADROOM * dt))
                if not tries[-1].holds:
                    break
            if k == 0 and tries[-1].changed["substeps"] == SUBSTEPS[0] and tries[-1].times.p99 > dt:
                break
        begun += len(settings) * len(SUBSTEPS)
    return tries


def choose(tries: Sequence[Try]) -> Try:
    """The most accurate that holds, the fastest of those about as good; where none holds, the fastest of all."""
    good = [one for one in tries if one.errors is not None and one.holds]
    if good:
        least = min(_error(one) for one in good)
        good = [one for one in good if _error(one) <= CLOSE * least]
    return min(good or tries, key=lambda one: one.times.p99)


def _error(one: Try) -> float:
    assert one.errors is not None
    return one.errors.force_rel


def _timed(scene: Scene, values: Mapping[str, Any], path: Motion) -> Times:
    """Given up when its steps take longer than the motion."""
    return times(portable(changed(scene, values)), path, give_up=path.duration)


def _with_errors(one: Try, scene: Scene, path: Motion, exact: Course) -> Try:
    own = course(portable(changed(scene, one.changed)), path, False)
    return Try(one.changed, one.times, one.holds, errors(own, exact, None), own)


def tried(found: Found) -> Table:
    """Every setting that was timed."""
    out = table("", "setting", "median ms", "p99 ms", "disturbed", "holds", "error RMS", "most N")
    for one in found.tries:
        error = one.errors
        out.add_row(
            "→" if one is found.best else "", words(one, times=False), f"{1e3 * one.times.median:.3f}",
            f"{1e3 * one.times.p99:.3f}", f"{1e3 * one.times.p99_disturbed:.3f}", "yes" if one.holds else "no",
            "" if error is None else f"{error.force_rel:.3%}", "" if error is None else f"{error.force_max_n:.3f}",
        )  # fmt: skip
    return out


def words(one: Try, times: bool = True) -> str:
    """A setting on one line, with its times."""
    text = ", ".join(f"{key.removeprefix('solver.')} {_word(value)}" for key, value in one.changed.items())
    return f"{text}: median {1e3 * one.times.median:.3f} ms, p99 {1e3 * one.times.p99:.3f} ms" if times else text


def _word(value: Any) -> str:
    """A mesh goes by its name."""
    return Path(value).stem if isinstance(value, str) else str(value)
