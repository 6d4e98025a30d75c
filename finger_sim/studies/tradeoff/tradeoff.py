"""`finger_sim tradeoff`: what each setting of a scene costs and what it gives up, against converged runs.

| error | of | against | so it is of |
|---|---|---|---|
| `solver_*` | a point | its own model, converged | time step, solver, tolerance: how it is solved |
| `model_*` | a point's model, converged | the base's model, converged | mesh, limits, contact: what is solved |
| `mesh_*` | a point's model, converged | the finger that is meant, converged | mesh and element |
| `total_*` | a point | the finger that is meant, converged | both: what a user gets |

Converged: a fine time step, tolerance 1e-9, linearised three times a step (grid.py); run at twice that time step too,
and the difference is told as `reference_uncertainty_rel`. The finger that is meant: the finest affordable mesh, with
patches. Every shipped finger has a mesh error; another body has none. Points of one mesh and element share their
converged run, and all of a scene share the finger that is meant.
Answers are made in parallel, then times, one after the other. Each finished run is a file in OUT/points: a study
that was interrupted goes on where it was. The table has one row for each point: see `tradeoff_table.py`.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from ...console import say
from ...pictures.surfaces import new_figure
from ...scene import MeshSource, Scene
from ...scene.calibration import MODULUS
from . import pool
from .grid import DEFAULT, MEANT, Grid, Point, has_mesh_error, points, reference
from .grid import meant as finger_meant
from .motion import Motion, TradeoffError, motion
from .pictures import draw
from .run import Course, Times
from .store import Job, Store, job
from .table import Courses, Row, row, write_csv

SCENES = ("finger_haptic",)
LINE_PERIOD = 5.0
"""Time between two lines of progress [s]."""


@dataclass(frozen=True)
class Options:
    """What to study, and where."""

    scenes: Sequence[str] = SCENES
    bags: Sequence[str | None] = (None,)  # None: the built-in motion
    grid: Grid = DEFAULT
    meant: str = MEANT  # mesh of the finger that is meant: a shipped finger
    duration: float | None = None  # of each motion [s]; None: all of it
    scheduler: str | None = None  # None: a cluster of its own
    workers: int | None = None  # of that cluster; None: one for each processor
    out: Path = Path("tradeoff")


@dataclass(frozen=True)
class Report:
    """What came of a study."""

    rows: list[Row]
    table: Path
    pictures: list[Path]
    failed: list[str]  # what could not be run, and why


@dataclass(frozen=True)
class _Trial:
    """A point on a motion, with all the runs that it needs."""

    point: Point
    motion: Motion
    tets: int
    answer: Job
    clock: Job
    converged: Job
    coarser: Job
    base: Job
    meant: Job | None

    @property
    def courses(self) -> list[Job]:
        """All that are no times."""
        return [job for job in (self.answer, self.converged, self.coarser, self.base, self.meant) if job is not None]


def tradeoff(options: Options) -> Report:
    """Run it, write the table and the pictures. Raises TradeoffError, SceneError, MeshError or BagError before."""
    pool.require_dask()
    checked_finger(options.meant, "--reference")
    new_figure(1.0, 1.0)  # a missing matplotlib shows before anything long
    trials = _trials(options)
    store = Store(options.out / "points")
    wanted = {job.key: job for t in trials for job in t.courses}
    clocks = {t.clock.key: t.clock for t in trials}
    outcomes = _outcomes([*wanted.values(), *clocks.values()], options, store)
    rows = [_row(trial, outcomes) for trial in trials]
    table = write_csv(rows, options.out / "tradeoff.csv")
    failed = [f"{row.scene}, {row.motion}, {row.changed}: {row.failed}" for row in rows if row.failed]
    return Report(rows, table, draw(rows, options.out), failed)


def _outcomes(jobs: Sequence[Job], options: Options, store: Store) -> dict[str, pool.Outcome]:
    """What every job gave, by key: of before where it is there."""
    found = {job.key: came for job in jobs if (came := store.load(job)) is not None}
    say(f"{len(jobs)} runs, {len(found)} of them finished before")
    outcomes: dict[str, pool.Outcome] = dict(found)
    missing = [job for job in jobs if job.key not in found]
    if not missing:
        return outcomes
    with pool.connected(options.scheduler, options.workers) as client:
        for words, kind, run in (("answers", "course", pool.answers), ("times", "times", pool.alone)):
            of_kind = [job for job in missing if job.kind == kind]
            left = TimeLeft(words, of_kind)
            say(f"{words}: {len(of_kind)} runs")
            for done, result in run(client, of_kind):
                outcomes[done.key] = result
                if not isinstance(result, str):
                    store.save(done, result)
                left(done)
    return outcomes


def checked_finger(mesh: str, option: str) -> str:
    """The mesh. Raises TradeoffError naming the option where it is no shipped finger."""
    if mesh not in MODULUS:
        raise TradeoffError(f"{option}: got {mesh}, allowed: a shipped finger: {', '.join(MODULUS)}")
    return mesh


def _trials(options: Options) -> list[_Trial]:
    """Every point of every scene on every motion; mistakes show here."""
    trials = []
    for name in options.scenes:
        of_scene = points(name, options.grid)
        tets = {point.scene.mesh: len(point.scene.load_mesh().tets) for point in of_scene}
        base = of_scene[0].scene
        finger = finger_meant(base, options.meant)
        if finger is not None:
            tets.setdefault(finger.mesh, len(finger.load_mesh().tets))
        for bag in options.bags:
            path = motion(base, bag, options.duration)
            for point in of_scene:
                if path.steps(point.scene.dt) < 3:
                    raise TradeoffError(f"dt: got {point.scene.dt:g}, allowed: at most a third of {path.duration:g} s")
                trials.append(_trial(point, path, base, finger if has_mesh_error(point) else None, tets))
    return trials


def _trial(point: Point, path: Motion, base: Scene, finger: Scene | None, tets: Mapping[MeshSource, int]) -> _Trial:
    def converged(scene: Scene, coarser: int = 1) -> Job:
        return job("course", reference(scene, base, tets[scene.mesh], coarser), path, tets[scene.mesh])

    own = tets[point.scene.mesh]
    return _Trial(
        point=point,
        motion=path,
        tets=own,
        answer=job("course", point.scene, path, own, drift=True),
        clock=job("times", point.scene, path, own),
        converged=converged(point.scene),
        coarser=converged(point.scene, coarser=2),
        base=converged(base),
        meant=None if finger is None else converged(finger),
    )


def _row(trial: _Trial, outcomes: dict[str, pool.Outcome]) -> Row:
    came = [outcomes[job.key] for job in (*trial.courses, trial.clock)]
    refused = [text for text in came if isinstance(text, str)]
    runs = [c for c in came if isinstance(c, Course)]
    courses = None
    if len(runs) == len(trial.courses):
        courses = Courses(*runs)
    clock = came[-1] if isinstance(came[-1], Times) else None
    meant = "" if trial.meant is None else Path(trial.meant.scene.mesh.file or "").stem
    return row(trial.point, trial.motion.name, trial.tets, courses, clock, meant=meant, refused=refused)


class TimeLeft:
    """Lines on stderr: how many runs are done, and about how much time is left."""

    def __init__(self, text: str, jobs: Sequence[Job]) -> None:
        self._text, self._count, self._done, self._cost = text, len(jobs), 0, 0.0
        self._total = sum(job.cost for job in jobs)
        self._begun = time.monotonic()
        self._due = self._begun

    def __call__(self, job: Job) -> None:
        self._done, self._cost, now = self._done + 1, self._cost + job.cost, time.monotonic()
        if now < self._due and self._done < self._count:
            return
        self._due = now + LINE_PERIOD
        left = max(0.0, (now - self._begun) * (self._total / self._cost - 1.0))
        say(f"{self._text}: {self._done} of {self._count} runs, about {in_words(left)} left")


def in_words(seconds: float) -> str:
    """A time as people say it."""
    return f"{seconds:.0f} s" if seconds < 100.0 else f"{seconds / 60.0:.0f} min"
