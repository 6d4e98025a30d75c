"""The table of a trade-off study: one row for each point, plain columns with their unit in the name."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ...console import table
from ...plain import whole_file
from ...scene import Scene
from .grid import Point, is_how
from .measures import UNFELT, Errors, errors, jitter, overshoot, peak_force, unsolved
from .motion import TradeoffError
from .run import Course, Times

if TYPE_CHECKING:
    from rich.table import Table


@dataclass(frozen=True)
class Row:
    """One point. NaN: not measured, or nothing to compare."""

    scene: str
    motion: str
    knob: str  # the key that was changed
    value: str  # to what
    changed: str  # all keys that were changed
    how: bool  # only how it is solved was changed: the model is the base's
    mesh: str
    tets: int
    volumetric: str
    young_pa: float
    dt_s: float
    substeps: int
    method: str
    tolerance: float
    max_iterations: int
    relinearizations: int
    level: str
    projection: str
    limit_stiffness: float  # inf: rigid
    plane_stiffness: float
    step_median_s: float
    step_mean_s: float
    step_p99_s: float
    step_p99_disturbed_s: float  # with what else the machine did
    real_time_factor: float  # dt over the mean step time
    rate_sustained_hz: float  # largest rate at which 99 of 100 steps are done in their period
    holds_rate: bool  # 99 of 100 steps are done within dt
    peak_force_n: float
    solver_force_rms_n: float  # against the same model, converged
    solver_force_max_n: float
    solver_force_rel: float  # rms over the peak force
    solver_torque_rms_nm: float
    solver_node_rms_m: float
    solver_slip_onset_s: float  # positive: late
    model_force_rms_n: float  # of the model, converged, against the base's
    model_force_max_n: float
    model_force_rel: float
    model_torque_rms_nm: float
    model_node_rms_m: float
    model_slip_onset_s: float
    meant: str  # mesh of the finger that is meant, which has patches; empty where there is none
    mesh_force_rms_n: float  # of the model, converged, against the finger that is meant: mesh, element, modulus
    mesh_force_max_n: float
    mesh_force_rel: float
    mesh_torque_rms_nm: float
    mesh_slip_onset_s: float
    total_force_rms_n: float  # of the point against the finger that is meant: solver and mesh
    total_force_max_n: float
    total_force_rel: float
    total_torque_rms_nm: float
    total_slip_onset_s: float
    reference_uncertainty_rel: float  # of what solver_* are against: its error at twice the time step
    felt: bool  # the solver's error reaches 8 % of 5 N
    strain_overshoot: float  # beyond the limit, as a part of it
    strain_overshoot_reference: float  # of the same model, converged
    penetration_m: float
    jitter_held_n: float  # second difference of force from step to step, RMS
    jitter_moving_n: float
    energy_drift: float  # see run.py
    factorisations: float  # a step
    iterations: float  # a step
    unsolved: float  # share of steps that did not meet the tolerance, or were rejected
    failed: str  # why it could not be run

    @property
    def cost(self) -> float:
        """Computing time for a second simulated [s/s]."""
        return self.step_mean_s / self.dt_s

    @property
    def solver_part(self) -> float:
        """The solver's error as `total_force_rel` has it: over the peak force of the finger that is meant."""
        return self.solver_force_rms_n * self.total_force_rel / (self.total_force_rms_n or math.nan)


class Courses(NamedTuple):
    """The runs behind a row."""

    own: Course
    converged: Course  # the same model
    coarser: Course  # that, at twice the time step
    base: Course  # the base's model, converged
    meant: Course | None = None  # the finger that is meant, converged; None where there is none


def row(
    point: Point,
    motion: str,
    tets: int,
    courses: Courses | None,
    clock: Times | None,
    *,
    meant: str = "",
    refused: Sequence[str] = (),
) -> Row:
    """The row of a point; courses: None where one of its runs failed. meant: see Row."""
    scene, nan = point.scene, math.nan
    solver, model, doubt, mesh, total = (Errors(*[nan] * 6),) * 5
    measured: dict[str, Any] = dict.fromkeys(
        ("peak_force_n", "strain_overshoot", "strain_overshoot_reference", "penetration_m", "jitter_held_n",
         "jitter_moving_n", "energy_drift", "factorisations", "iterations", "unsolved"), nan
    )  # fmt: skip
    if courses is not None:
        own, converged, coarser, base, finger = courses
        plane = scene.plane
        cone = None if plane is None else (plane.unit_normal, plane.friction)
        solver, model = errors(own, converged, cone), errors(converged, base, cone)
        doubt = errors(coarser, converged, cone)
        if finger is not None:
            mesh, total = errors(converged, finger, cone), errors(own, finger, cone)
        measured = {
            "peak_force_n": peak_force(own),
            "strain_overshoot": overshoot(own),
            "strain_overshoot_reference": overshoot(converged),
            "penetration_m": float(own.penetration.max()),
            "jitter_held_n": jitter(own, held=True),
            "jitter_moving_n": jitter(own, held=False),
            "energy_drift": float(own.energy[0]),
            "factorisations": float(own.work[0]),
            "iterations": float(own.work[1]),
            "unsolved": unsolved(own),
        }
    across: dict[str, Any] = _across("mesh", mesh) | _across("total", total)
    t = clock or Times(0, nan, nan, nan, nan)
    return Row(
        scene=point.name,
        motion=motion,
        knob=point.knob,
        value=point.value,
        changed="; ".join(f"{key}={value}" for key, value in point.changed.items()),
        how=all(is_how(key) for key in point.changed),
        tets=tets,
        **_settings(scene),
        step_median_s=t.median,
        step_mean_s=t.mean,
        step_p99_s=t.p99,
        step_p99_disturbed_s=t.p99_disturbed,
        real_time_factor=scene.dt / t.mean,
        rate_sustained_hz=1.0 / t.p99,
        holds_rate=t.p99 <= scene.dt,
        **{f"solver_{name}": value for name, value in solver._asdict().items()},
        **{f"model_{name}": value for name, value in model._asdict().items()},
        meant=meant,
        **across,
        reference_uncertainty_rel=doubt.force_rel,
        felt=solver.force_max_n >= UNFELT,
        **measured,
        failed="; ".join(dict.fromkeys(refused)),
    )


def _across(name: str, errors: Errors) -> dict[str, float]:
    """Columns of errors between meshes, whose nodes are not the same."""
    return {f"{name}_{key}": value for key, value in errors._asdict().items() if key != "node_rms_m"}


def _settings(scene: Scene) -> dict[str, Any]:
    """Columns that say how a scene is set."""
    limits, plane, solver = scene.limits, scene.plane, scene.solver
    rigid = math.inf
    return {
        "mesh": "beam" if scene.mesh.file is None else Path(scene.mesh.file).stem,
        "volumetric": scene.material.volumetric,
        "young_pa": scene.material.young,
        "dt_s": scene.dt,
        "substeps": scene.substeps,
        "method": solver.method,
        "tolerance": solver.tolerance,
        "max_iterations": solver.max_iterations,
        "relinearizations": solver.relinearizations,
        "level": solver.level,
        "projection": "none" if limits is None else limits.projection,
        "limit_stiffness": math.nan if limits is None else rigid if limits.stiffness is None else limits.stiffness,
        "plane_stiffness": math.nan if plane is None else rigid if plane.stiffness is None else plane.stiffness,
    }


def write_csv(rows: Sequence[Row], path: Path) -> Path:
    """All rows; what is not known is left empty. Raises TradeoffError when the file cannot be written."""
    try:
        with whole_file(path) as part, part.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow([f.name for f in fields(Row)])
            for one in rows:
                writer.writerow([_cell(value) for value in asdict(one).values()])
    except OSError as error:
        raise TradeoffError(f"--out: {path}: cannot be written: {error.strerror}") from None
    return path


def _cell(value: Any) -> Any:
    if isinstance(value, float):
        return "" if math.isnan(value) else f"{value:.6g}"
    return value


def summary(rows: Sequence[Row]) -> Table:
    """The main columns of the study's table."""
    out = table("scene", "changed", "tets", "median ms", "p99 ms", "real time", "Hz held", "solver error", "mesh error",
                "total error", "most N", "model error", "reference", "overshoot", "jitter N", "slip ms")  # fmt: skip
    for row in rows:
        out.add_row(
            row.scene, row.changed, str(row.tets), _number(1e3 * row.step_median_s, ".3f"),
            _number(1e3 * row.step_p99_s, ".3f"), _number(row.real_time_factor, ".2f", "×"),
            _number(row.rate_sustained_hz, ".0f"), _number(row.solver_force_rel, ".3%"),
            _number(row.mesh_force_rel, ".2%"), _number(row.total_force_rel, ".2%"),
            _number(row.solver_force_max_n, ".3f"), _number(row.model_force_rel, ".2%"),
            _number(row.reference_uncertainty_rel, ".3%"), _number(row.strain_overshoot, ".2f"),
            _number(row.jitter_held_n, ".1e"), _number(1e3 * row.solver_slip_onset_s, "+.1f"),
        )  # fmt: skip
    return out


def _number(value: float, form: str, unit: str = "") -> str:
    return "" if math.isnan(value) else f"{value:{form}}{unit}"


def front(cost: Sequence[float], error: Sequence[float]) -> list[int]:
    """Indices of the points that no other beats in both, from the cheapest on. NaN is beaten by all."""
    best, out = math.inf, []
    for k in np.lexsort((error, cost)).tolist():
        if error[k] < best and math.isfinite(cost[k]):
            best = error[k]
            out.append(k)
    return out
