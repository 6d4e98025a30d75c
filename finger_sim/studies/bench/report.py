"""How `finger_sim bench` tells what it found: tables and a plot for people, JSON for machines."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.table import Table

from ...console import table
from ...errors import MissingExtraError
from ...physics.clock import STAGES
from ...plain import plain, whole_file
from .bench import Report
from .figures import Row
from .scenes import BASE, CONVERGED, DEPTH, LIMITS, MESHES, PHASES, SPEED, BenchError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Picture

PICTURES = (".png", ".pdf", ".svg")
DPI = 160
OURS, PEER, WHISKER = "#0b5394", "#9aa5b1", "0.25"
"""Colours of bars: ours, theirs; and of whiskers."""
NOTES = (
    "press: straight down, then held. error: of contact force (cantilever: tip), against a run to "
    f"{CONVERGED['tolerance']:g}, by the largest force of that run.",
    "Peers have no strain limits; MuJoCo's material is Saint Venant-Kirchhoff, which softens under compression: at "
    "2 mm its force differs from the corotated one of the reference by its law, not by its solver; nH, neo-Hookean, "
    "stiffens.",
    "before: newton when each step made its own matrix and factors, as it stood to MuJoCo 4.0 in a run of its own.",
)


def require_writable(path: Path, option: str, endings: tuple[str, ...] = ()) -> None:
    """Raises BenchError when a file cannot be made there, MissingExtraError when a picture cannot be drawn."""
    if endings and path.suffix.lower() not in endings:
        raise BenchError(f"{option}: got {path}, allowed: a name that ends in {', '.join(endings)}")
    if path.is_dir() or not path.parent.is_dir():
        raise BenchError(f"{option}: got {path}, allowed: a file in a folder that exists")
    if endings:
        try:
            import matplotlib  # noqa: F401
        except ImportError:
            raise MissingExtraError("drawing", "plot") from None


def write_json(report: Report, path: Path) -> None:
    """Everything, NaN as null. Raises BenchError when it cannot be written."""
    data = dataclasses.asdict(report)
    for row, figure in zip(data["figures"], report.figures, strict=True):
        row["reached"] = figure.reached
    data["scenes"] = {"base": BASE, "limits": LIMITS, "converged": CONVERGED, "meshes": MESHES}
    try:
        with whole_file(path) as file:
            file.write_text(json.dumps(plain(data), indent=1, allow_nan=False) + "\n", encoding="utf-8")
    except OSError as error:
        raise BenchError(f"--json: {path} cannot be written: {error.strerror}") from None


def sections(report: Report) -> list[tuple[str, Table]]:
    """Titles and tables, in the order to print them."""
    return [
        ("finger_sim bench", _head(report)),
        ("finger: step times, and how well steps were solved", _steps(report.rows)),
        ("cantilever of 200 tetrahedra, falling from rest", _steps(report.cantilever)),
        ("stages: mean µs a step", _stages(report.stages)),
        ("figures", _figures(report)),
    ]


def _head(report: Report) -> Table:
    machine, out = report.machine, table()
    out.add_row("date", machine["date"])
    out.add_row("processor", f"{machine['cpu']}, pinned to {machine['cpu_index']} of {machine['cpus_allowed']}")
    out.add_row("load average", " ".join(f"{load:.2f}" for load in machine["load_average"]))
    out.add_row("versions", ", ".join(f"{name} {number}" for name, number in machine["versions"].items()))
    out.add_row("command", machine.get("command", ""))
    for name, what in report.peers.items():
        out.add_row(name, what)
    return out


def _steps(rows: list[Row]) -> Table:
    names = ("≈ tets", "phase", "scene", "contender", "median µs", "p99 µs", "/ MuJoCo", "/ before", "iter.",
             "residual", "conv. %", "error rms %", "max %", "rows", "tets at limit", "status")  # fmt: skip
    out = table(*names)
    for column in out.columns[4:15]:
        column.justify = "right"
    for column in out.columns:
        column.no_wrap = True
    last: tuple[int, str] | None = None
    for r in rows:
        if last is not None and last != (r.size, r.phase):
            out.add_row()
        last = r.size, r.phase
        iterations = "–" if math.isnan(r.iterations_median) else f"{r.iterations_median:.0f}/{r.iterations_max:.0f}"
        out.add_row(
            *(str(r.size), r.phase, r.scene, r.contender, f"{r.median_us:.0f}", f"{r.p99_us:.0f}"),
            *(_number(r.ratio_to_mujoco, ".3f"), _number(r.ratio_to_before, ".2f")),
            *(iterations, _number(r.residual_max, ".1e")),
            *(_number(100.0 * r.converged, ".0f"), _percent(r.error_rms), _percent(r.error_max)),
            *(_number(r.limit_rows_median, ".0f"), _number(r.limited_tets_median, ".0f"), r.status),
        )
    return out


def _stages(stages: list[dict[str, Any]]) -> Table:
    out = table("≈ tets", "phase", "scene", "contender", *STAGES, "sum")
    for column in out.columns[4:]:
        column.justify = "right"
    for stage in stages:
        spent = [stage[f"{name}_us"] for name in STAGES]
        numbers = [f"{us:.1f}" for us in (*spent, sum(spent))]
        out.add_row(str(stage["size"]), stage["phase"], stage["scene"], stage["contender"], *numbers)
    return out


def _figures(report: Report) -> Table:
    out = table("figure", "measured", "must", "aim", "unit", "reached", "of")
    for column in out.columns[1:4]:
        column.justify = "right"
    for f in report.figures:
        sign = "≤" if f.better == "lower" else "≥"
        value = "–" if math.isnan(f.value) else f"{f.value:.4g}"
        out.add_row(f.name, value, f"{sign} {f.must:g}", f"{sign} {f.aim:g}", f.unit, f.reached, f.note)
    return out


def _number(value: float, form: str) -> str:
    return "–" if math.isnan(value) else f"{value:{form}}"


def _percent(share: float) -> str:
    """Two digits, without an exponent."""
    return _number(100.0 * share, ".0f" if share >= 0.1 else ".1f" if share >= 0.01 else ".2f")


def draw(report: Report, path: Path) -> None:
    """The plot. Raises BenchError when it cannot be written."""
    try:
        with whole_file(path) as file:
            make_picture(report).savefig(file, dpi=DPI)
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise BenchError(f"--plot: {path} cannot be written: {reason}") from None


def make_picture(report: Report) -> Picture:
    """Median and p99 of a step of every contender, a panel for each phase, one logarithmic axis."""
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    contenders = list(dict.fromkeys((r.size, r.scene, r.contender) for r in report.rows))
    low = 10.0 ** math.floor(math.log10(min(r.median_us for r in report.rows)) - 0.3)
    high = 1.9 * max(r.p99_us for r in report.rows)
    style: Any = {"font.size": 9, "axes.spines.top": False, "axes.spines.right": False, "axes.spines.left": False}
    with rc_context(style):
        height = 1.35 + 0.23 * (len(contenders) + len({size for size, _, _ in contenders}))
        picture = Figure(figsize=(11.0, height))
        FigureCanvasAgg(picture)
        panels = picture.subplots(1, len(PHASES), sharex=True, sharey=True, squeeze=False)[0]
        picture.subplots_adjust(left=0.185, right=0.985, top=1.0 - 0.35 / height, bottom=0.95 / height, wspace=0.06)
        for phase, axes in zip(PHASES, panels, strict=True):
            _panel(axes, [r for r in report.rows if r.phase == phase], contenders)
            axes.set_title({"air": "free air", "press": "press and hold", "slide": "slide"}[phase], fontsize=10)
            axes.set_xlim(low, high)
        panels[1].set_xlabel("time of a step [µs]: median (bar), 99th percentile (whisker)")
        picture.text(0.012, 0.1 / height, _caption(report), fontsize=7.5, va="bottom", color="0.3", linespacing=1.35)
    return picture


def _panel(axes: Axes, rows: list[Row], contenders: list[tuple[int, str, str]]) -> None:
    axes.set_xscale("log")
    place, ticks = dict[tuple[int, str, str], int](), list[str]()
    for size, scene, name in contenders:  # a line for each, and one to name each size
        if f"{size:,} tetrahedra" not in ticks:
            ticks.append(f"{size:,} tetrahedra")
        place[size, scene, name] = len(ticks)
        ticks.append(f"{name}, {scene}")
    for r in rows:
        y, ours = place[r.size, r.scene, r.contender], not math.isnan(r.iterations_median)
        axes.barh(y, r.median_us, 0.76, color=OURS if ours else PEER)
        axes.plot([r.median_us, r.p99_us], [y, y], color=WHISKER, linewidth=0.9)
        axes.plot([r.p99_us, r.p99_us], [y - 0.2, y + 0.2], color=WHISKER, linewidth=0.9)
        axes.annotate(
            f"{r.median_us:,.0f}", (r.median_us, y), (-3, -0.5), textcoords="offset points",
            ha="right", va="center", fontsize=7.5, color="white" if ours else "black",
        )  # fmt: skip
    axes.set_yticks(range(len(ticks)), ticks)
    for label in axes.get_yticklabels():
        label.set_fontweight("bold" if label.get_text().endswith(" tetrahedra") else "normal")
    axes.set_ylim(max(place.values()) + 0.6, -0.6)
    axes.tick_params(axis="y", length=0)
    axes.grid(axis="x", which="major", color="0.9", linewidth=0.8)
    axes.set_axisbelow(True)


def _caption(report: Report) -> str:
    machine, material = report.machine, BASE["material"]
    versions = ", ".join(f"{name} {machine['versions'][name]}" for name in ("python", "numba", "mujoco", "drake"))
    return (
        f"Finger on its bone, E {material['young'] / 1e6:g} MPa, ν {material['poisson']:g}, dt {1e3 * BASE['dt']:g} ms,"
        f" pressed {1e3 * DEPTH:g} mm into a plane with friction {BASE['plane']['friction']:g} and slid, all at "
        f"{100 * SPEED:g} cm/s; tolerance {BASE['solver']['tolerance']:g}.\n"
        f"{machine['date'][:10]}, {machine['cpu']}, one processor; {versions}. Grey: peers, "
        "which have no strain limits."
    )
