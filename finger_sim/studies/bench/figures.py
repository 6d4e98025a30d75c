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
from .scenes import PHASES, Record

Mask = NDArray[np.bool_]
MUJOCO = "MuJoCo"
UNIT_SIZE = 350
"""Ratios are to MuJoCo at this size."""
DEFAULT_SIZE = 900
"""Of the mesh that the everyday scenes have."""
SOME, MANY = 80, 270
"""Tetrahedra at a limit in steps that two of the figures look at."""


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
    rms, largest = errors(record.answer, reference.answer, mask)
    status = Status(int(np.bitwise_or.reduce(record.status[mask])))
    return Row(
        *(key.size, phase, key.scene, key.contender),
        steps=int(mask.sum()),
        repeats=len(seconds),
        median_us=1e6 * median,
        p99_us=1e6 * p99,
        ratio_to_mujoco=ratio(seconds, mujoco),
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
        self.phase: dict[int, NDArray[np.signedinteger]] = {}  # by size, see Motion.phase

    def mask(self, size: int, *phases: str) -> Mask:
        """Steps of these phases."""
        return np.asarray(np.isin(self.phase[size], [PHASES.index(phase) for phase in phases]))

    def mujoco(self, mask: Mask) -> Floats:
        """MuJoCo's times over steps of the motion at UNIT_SIZE [s]; empty without MuJoCo."""
        record = self.of.get(Key(UNIT_SIZE, "no limits", MUJOCO))
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

    def to_mujoco(
        self, size: int, scene: str, contender: str, phases: tuple[str, ...], limited: int = 0
    ) -> tuple[float, str]:
        """Ratio of medians over steps of these phases with at least so many tetrahedra at a limit, and what it is of.

        MuJoCo's are its own times in the same steps; at another size, in the same phases.
        """
        record = self.of.get(Key(size, scene, contender))
        if record is None:
            return math.nan, f"needs --sizes {size}"
        mask = self.mask(size, *phases)
        if limited:
            mask &= record.limited_tets >= limited
        median = median_and_p99(record.seconds[:, mask])[0]
        theirs = np.empty((0, 0))
        if UNIT_SIZE in self.phase:
            theirs = self.mujoco(mask if size == UNIT_SIZE else self.mask(UNIT_SIZE, *phases))
        note = f"{int(mask.sum())} steps"
        if mask.any():
            rms, _ = errors(record.answer, self.reference[Key(size, scene, contender)].answer, mask)
            note += f", {1e6 * median:.0f} µs, force error {100.0 * rms:.2g} % rms"
        if not theirs.size:
            note += ", no MuJoCo to compare with"
        elif mask.any():
            note += f"; MuJoCo {1e6 * median_and_p99(theirs)[0]:.0f} µs"
            note += by_repetition(record.seconds[:, mask], theirs)
        return ratio(record.seconds[:, mask], theirs), note


def figures(records: Records, extras: Mapping[str, tuple[float, str]]) -> list[Figure]:
    """All figures, those not measured with NaN. extras: "p99", "allocations", "cold", "cached", "patch", "default mesh"
    and their notes.
    """
    missing = (math.nan, "not asked for")
    touching = ("press", "slide")

    def over(name: str, goal: tuple[float, float], came: tuple[float, str]) -> Figure:
        return Figure(f"{name}, to MuJoCo", came[0], "×", *goal, "lower", came[1])

    def extra(name: str, key: str, unit: str, must: float, aim: float) -> Figure:
        value, note = extras.get(key, missing)
        return Figure(name, value, unit, must, aim, "lower", note)

    to = records.to_mujoco
    return [
        over(f"press + slide, ≥ {SOME} tets at a limit", (0.12, 0.05), to(350, "limits", "newton", touching, SOME)),
        over(f"press + slide, ≥ {MANY} tets at a limit", (0.18, 0.07), to(350, "limited", "newton", touching, MANY)),
        over("free air", (0.08, 0.035), to(350, "limits", "newton", ("air",))),
        over("cheapest level (lagged), press + slide", (0.08, 0.03), to(350, "limits", "lagged", touching)),
        extra("p99/median of a step, to that of fixed work", "p99", "×", 1.5, 1.1),
        over("2,000 tets, press + slide", (1.2, 0.5), to(2000, "limits", "newton", touching)),
        _rate(records, 4000, touching),
        extra("patch against element on the same mesh, whole step, press + slide", "patch", "×", 1.5, 1.25),
        extra("default mesh with patches, press + slide, to 350 tets with elements", "default mesh", "×", 3.0, 2.0),
        _speed_up(records, touching),
        extra("allocations of compiled code", "allocations", "a step", 0.0, 0.0),
        extra("process start to ready, nothing compiled", "cold", "s", 40.0, 20.0),
        extra("process start to ready, compiled before", "cached", "s", 3.0, 1.5),
    ]


def _rate(records: Records, size: int, phases: tuple[str, ...]) -> Figure:
    """Steps a second: how many there are, by the time they take."""
    key, value, note = Key(size, "limits", "newton"), math.nan, f"needs --sizes {size}"
    if key in records.of:
        seconds = records.of[key].seconds[:, records.mask(size, *phases)]
        value, note = 1.0 / median_and_p99(seconds)[0], "one by the median step"
    return Figure(f"{size:,} tets, press + slide", value, "steps/s", 20.0, 60.0, "higher", note)


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
