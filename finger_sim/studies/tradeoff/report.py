"""Tables that `finger_sim tradeoff` prints."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from ...console import table
from .rate import Found, Try
from .table import Row

if TYPE_CHECKING:
    from rich.table import Table


def summary(rows: Sequence[Row]) -> Table:
    """The main columns of the study's table."""
    out = table("scene", "changed", "tets", "median ms", "p99 ms", "real time", "Hz held", "solver error", "most N",
                "model error", "reference", "overshoot", "jitter N", "slip ms")  # fmt: skip
    for row in rows:
        out.add_row(
            row.scene, row.changed, str(row.tets), _number(1e3 * row.step_median_s, ".3f"),
            _number(1e3 * row.step_p99_s, ".3f"), _number(row.real_time_factor, ".2f", "×"),
            _number(row.rate_sustained_hz, ".0f"), _number(row.solver_force_rel, ".3%"),
            _number(row.solver_force_max_n, ".3f"), _number(row.model_force_rel, ".2%"),
            _number(row.reference_uncertainty_rel, ".3%"), _number(row.strain_overshoot, ".2f"),
            _number(row.jitter_held_n, ".1e"), _number(1e3 * row.solver_slip_onset_s, "+.1f"),
        )  # fmt: skip
    return out


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
    text = ", ".join(f"{key.removeprefix('solver.')} {value}" for key, value in one.changed.items())
    return f"{text}: median {1e3 * one.times.median:.3f} ms, p99 {1e3 * one.times.p99:.3f} ms" if times else text


def _number(value: float, form: str, unit: str = "") -> str:
    return "" if math.isnan(value) else f"{value:{form}}{unit}"
