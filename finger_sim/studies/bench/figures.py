"""What `finger_sim bench` makes of its records: rows of medians beside their errors, and the figures aimed at."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...arrays import Floats
from ...physics.step import Status
from .before import BEFORE
from .scenes import PHASES, Record

Mask = NDArray[np.bool_]
MUJOCO = "MuJoCo"
UNIT_SIZE = 350
"""Ratios are to MuJoCo at this size."""
DEFAULT_SIZE, LARGE_SIZE = 900, 16000
"""Of the mesh that the everyday scenes have, and of the finest one."""
MANY = 270
"""Tetrahedra at a limit in steps that one of the figures looks at."""
LEVEL = "lagged"
"""Contender that figures are of: what steps share is shared; with patches, those of `PATCHED`."""
PATCHED = "patch lagged"


class Key(NamedTuple):
    """One contender on one scene."""

    size: int
    scene: str
    contender: str


@dataclass(frozen=True)
class Row:
    """One contender in one phase. NaN: not known, or nothing to compare with."""

    size: int
    phase: str
    scene: str
    contender: str
    steps: int  # in the phase, of one repetition
    repeats: int
    median_us: float
    p99_us: float
    ratio_to_mujoco: float  # median over MuJoCo's in the same phase at UNIT_SIZE; of the cantilever, on it
    ratio_to_before: float  # that over the same of `newton` at the time of `before.py`
    iterations_median: float
    iterations_max: float
    residual_max: float  # see Solver.tolerance
    converged: float  # share of the steps
    error_rms: float  # of contact force (cantilever: tip), as a share of the largest in the reference's motion
    error_max: float
    limit_rows_median: float  # that carry a force
    limited_tets_median: float
    status: str


@dataclass(frozen=True)
class Figure:
    """One number that there is a goal for."""

    name: str
    value: float  # NaN: not measured
    unit: str
    must: float
    aim: float
    better: Literal["lower", "higher"]
    note: str = ""

    @property
    def reached(self) -> str:
        """One of: aim, must, no, not measured."""
        if math.isnan(self.value):
            return "not measured"
        sign = 1.0 if self.better == "lower" else -1.0
        passed = [name for name in ("aim", "must") if sign * self.value <= sign * getattr(self, name)]
        return passed[0] if passed else "no"


def median_and_p99(seconds: Floats) -> tuple[float, float]:
    """Over all of them; NaN when there are none."""
    if seconds.size == 0:
        return math.nan, math.nan
    median, p99 = np.percentile(seconds, [50.0, 99.0])
    return float(median), float(p99)


def ratio(ours: Floats, theirs: Floats) -> float:
    """Of two medians; NaN when either is of nothing."""
    return median_and_p99(ours)[0] / median_and_p99(theirs)[0] if ours.size and theirs.size else math.nan


def by_repetition(ours: Floats, theirs: Floats) -> str:
    """Between what the ratio of medians lies in single repetitions, (repeats, steps) each; empty for a single one."""
    ratios = [ratio(a, b) for a, b in zip(ours, theirs, strict=False)]
    return f", by repetition {min(ratios):.3g} to {max(ratios):.3g}" if len(ratios) > 1 else ""


def unsteadiness(seconds: Floats) -> float:
    """p99 over median."""
    median, p99 = median_and_p99(seconds)
    return p99 / median


def errors(answer: Floats, reference: Floats, mask: Mask) -> tuple[float, float]:
    """rms and largest |answer − reference| over the masked steps, by the largest |reference| over all steps.

    answer, reference: (steps, 3).
    """
    size = np.linalg.norm((answer - reference)[mask], axis=1)
    peak = float(np.linalg.norm(reference, axis=1).max())
    if size.size == 0 or peak == 0.0:
        return math.nan, math.nan
    return float(np.sqrt((size**2).mean())) / peak, float(size.max()) / peak


def row(key: Key, phase: str, record: Record, reference: Record, mask: Mask, mujoco: Floats) -> Row:
    """A row of the table. mujoco: the times to compare with, [s], empty without."""
    seconds = record.seconds[:, mask]
    median, p99 = median_and_p99(seconds)
    to_mujoco, before = ratio(seconds, mujoco), BEFORE.get((key.size, key.scene, phase), math.nan)
    rms, largest = errors(record.answer, reference.answer, mask)
    status = Status(int(np.bitwise_or.reduce(record.status[mask])))
    return Row(
        *(key.size, phase, key.scene, key.contender),
        steps=int(mask.sum()),
        repeats=len(seconds),
        median_us=1e6 * median,
        p99_us=1e6 * p99,
        ratio_to_mujoco=to_mujoco,
        ratio_to_before=to_mujoco / before if key.contender in ("newton", LEVEL) else math.nan,
        iterations_median=float(np.median(record.iterations[mask])),
        iterations_max=float(record.iterations[mask].max()),
        residual_max=float(record.residual[mask].max()),
        converged=float(record.converged[mask].mean()),
        error_rms=rms,
        error_max=largest,
        limit_rows_median=float(np.median(record.limit_rows[mask])),
        limited_tets_median=float(np.median(record.limited_tets[mask])),
        status=(status.name or "").replace("|", ", ") if status else "",
    )


class Records:
    """The records of all finger scenes, and the phases of their motions."""

    def __init__(self) -> None:
        self.of: dict[Key, Record] = {}
        self.reference: dict[Key, Record] = {}
        self.others: dict[Key, list[Record]] = {}  # further converged runs
        self.phase: dict[int, NDArray[np.signedinteger]] = {}  # by size, see Motion.phase

    def mask(self, size: int, *phases: str) -> Mask:
        """Steps of these phases."""
        return np.asarray(np.isin(self.phase[size], [PHASES.index(phase) for phase in phases]))

    def mujoco(self, mask: Mask, size: int = UNIT_SIZE) -> Floats:
        """MuJoCo's times over steps of the motion at a size [s]; empty without MuJoCo."""
        record = self.of.get(Key(size, "no limits", MUJOCO))
        return np.empty((0, 0)) if record is None else record.seconds[:, mask]

    def rows(self) -> list[Row]:
        """By size, phase, scene and contender."""
        out = []
        for size in sorted(self.phase):
            for phase in PHASES:
                mask = self.mask(size, phase)
                theirs = self.mujoco(self.mask(UNIT_SIZE, phase)) if UNIT_SIZE in self.phase else np.empty((0, 0))
                for key, record in self.of.items():
                    if key.size == size:
                        out.append(row(key, phase, record, self.reference[key], mask, theirs))
        return out

    def to_mujoco(self, size: int, scene: str, contender: str, phases: tuple[str, ...]) -> tuple[float, str]:
        """Ratio of medians over steps of these phases, MuJoCo's on the same tetrahedra; and what it is of."""
        record = self.of.get(Key(size, scene, contender))
        if record is None:
            return math.nan, f"needs --sizes {size}"
        mask = self.mask(size, *phases)
        seconds, theirs = record.seconds[:, mask], self.mujoco(mask, size)
        note = f"{int(mask.sum())} steps, {1e6 * median_and_p99(seconds)[0]:.0f} µs"
        if not theirs.size:
            return math.nan, f"{note}, no MuJoCo to compare with"
        note += f"; MuJoCo {1e6 * median_and_p99(theirs)[0]:.0f} µs{by_repetition(seconds, theirs)}"
        return ratio(seconds, theirs), note

    def to_before(self, key: Key, phases: tuple[str, ...], scene: str, phase: str) -> tuple[float, str]:
        """Median over steps of these phases, to that of `newton` before on a scene in a phase at UNIT_SIZE."""
        record = self.of.get(key)
        if record is None or UNIT_SIZE not in self.phase:
            return math.nan, f"needs --sizes {UNIT_SIZE} {key.size}"
        seconds, theirs = record.seconds[:, self.mask(key.size, *phases)], self.mujoco(self.mask(UNIT_SIZE, phase))
        note = f"{1e6 * median_and_p99(seconds)[0]:.0f} µs"
        if not theirs.size:
            return math.nan, f"{note}, no MuJoCo to compare with"
        note += f"; MuJoCo, {phase}, {UNIT_SIZE} tets: {1e6 * median_and_p99(theirs)[0]:.0f} µs"
        return ratio(seconds, theirs) / BEFORE[UNIT_SIZE, scene, phase], note

    def error(self, size: int, scene: str, contender: str, phases: tuple[str, ...]) -> tuple[float, str]:
        """The larger rms error of force in these phases [%]; each, and what converged runs differ by."""
        key = Key(size, scene, contender)
        if key not in self.of:
            return math.nan, f"needs --sizes {size}"
        answer, reference = self.of[key].answer, self.reference[key].answer
        found = {phase: 100.0 * errors(answer, reference, self.mask(size, phase))[0] for phase in phases}
        note = ", ".join(f"{phase} {error:.2g}" for phase, error in found.items())
        for phase in phases:
            apart = [
                100.0 * errors(other.answer, reference, self.mask(size, phase))[0] for other in self.others.get(key, [])
            ]
            if apart:
                note += f"; {phase}, converged runs: {', '.join(f'{error:.2g}' for error in apart)}"
        return max(found.values()), note


def figures(records: Records, extras: Mapping[str, tuple[float, str]]) -> list[Figure]:
    """All figures, those not measured with NaN. extras: "p99", "allocations", "cold", "cached", "patch" and their
    notes.
    """
    missing = (math.nan, "not asked for")
    touching = ("press", "slide")

    def lower(name: str, unit: str, goal: tuple[float, float], came: tuple[float, str]) -> Figure:
        return Figure(name, came[0], unit, *goal, "lower", came[1])

    def before(name: str, goal: tuple[float, float], scene: str, phase: str) -> Figure:
        came = records.to_before(Key(UNIT_SIZE, scene, LEVEL), (phase,), scene, phase)
        return lower(f"{UNIT_SIZE} tets, {name}, to newton before", "×", goal, came)

    default = Key(DEFAULT_SIZE, "limits", PATCHED)
    return [
        before("free air", (0.5, 0.35), "limits", "air"),
        before("press", (0.6, 0.45), "limits", "press"),
        before("slide", (0.5, 0.35), "limits", "slide"),
        before("slide, four in five at a limit", (0.45, 0.3), "limited", "slide"),
        lower(
            "default mesh with patches, press + slide, to a slide of 350 tets before", "×", (1.2, 0.8),
            records.to_before(default, touching, "limits", "slide"),
        ),
        lower("the same, p99/median, to that of fixed work", "×", (1.8, 1.3), extras.get("p99", missing)),
        lower(
            "the same, error of force, rms", "%", (0.05, 0.02), records.error(*default, touching),
        ),
        lower(
            f"{UNIT_SIZE} tets, press + slide, to MuJoCo", "×", (0.08, 0.04),
            records.to_mujoco(UNIT_SIZE, "limits", LEVEL, touching),
        ),
        lower(
            "default mesh, press + slide, to MuJoCo on it", "×", (0.08, 0.04),
            records.to_mujoco(DEFAULT_SIZE, "limits", LEVEL, touching),
        ),
        lower(
            "the same with patches, which MuJoCo has not", "×", (0.08, 0.04), records.to_mujoco(*default, touching),
        ),
        _rate(records, LARGE_SIZE, touching),
        lower(
            "patch against element on the same mesh, whole step, press + slide", "×", (1.5, 1.25),
            extras.get("patch", missing),
        ),
        _speed_up(records, touching),
        lower("allocations of compiled code", "a step", (0.0, 0.0), extras.get("allocations", missing)),
        lower("process start to ready, nothing compiled", "s", (40.0, 20.0), extras.get("cold", missing)),
        lower("process start to ready, compiled before", "s", (3.0, 1.5), extras.get("cached", missing)),
    ]  # fmt: skip


def _rate(records: Records, size: int, phases: tuple[str, ...]) -> Figure:
    """Steps a second: how many there are, by the time they take."""
    key, value, note = Key(size, "limits", LEVEL), math.nan, f"needs --sizes {size}"
    if key in records.of:
        seconds = records.of[key].seconds[:, records.mask(size, *phases)]
        value, note = 1.0 / float(seconds.mean()), f"by the median step {1.0 / median_and_p99(seconds)[0]:.0f}"
    return Figure(f"{size:,} tets, press + slide", value, "steps/s", 60.0, 200.0, "higher", note)


def _speed_up(records: Records, phases: tuple[str, ...]) -> Figure:
    """Newton's method against projected Gauss-Seidel, in steps in which both hold MANY tetrahedra at a limit."""
    keys = [Key(UNIT_SIZE, "limited", contender) for contender in ("pgs", "newton")]
    value, note = math.nan, f"needs --sizes {UNIT_SIZE}"
    if all(key in records.of for key in keys):
        pgs, newton = (records.of[key] for key in keys)
        mask = records.mask(UNIT_SIZE, *phases) & (np.minimum(pgs.limited_tets, newton.limited_tets) >= MANY)
        value = ratio(pgs.seconds[:, mask], newton.seconds[:, mask])
        rms = [
            errors(record.answer, records.reference[key].answer, mask)[0]
            for key, record in zip(keys, (pgs, newton), strict=True)
        ]
        note = f"{int(mask.sum())} steps; force error rms: pgs {100 * rms[0]:.2g} %, newton {100 * rms[1]:.2g} %"
        note += by_repetition(pgs.seconds[:, mask], newton.seconds[:, mask])
    name = f"newton against pgs, ≥ {MANY} tets at a limit"
    return Figure(name, value, "× as fast", 10.0, 40.0, "higher", note)
