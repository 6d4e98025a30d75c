"""Pictures of a trade-off study: a dot a point; solver and mesh error on one axis, each alone, rate against error."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...pictures.surfaces import new_figure, save
from .measures import AT_FORCE, UNFELT, WEBER
from .table import Row, front

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLORS = ("#0b5394", "#d1730f", "#2a7f4f", "#7a5ba6", "#b3332e", "#1f9aa8", "#8a6d3b", "#d65f9e", "#6b8e23", "#555555")
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
BASE_COLOR, LINE_COLOR, FELT_COLOR = "black", "0.35", "#b3332e"
SIZE = (11.0, 6.2)
"""Of a picture [inch]."""
DOT = 40.0
"""Area of a dot [point²]."""
TINY = 1e-6
"""Smallest error drawn."""
LETTERS = "ABCDEFGHIJKLMNOPQRSTUVWXYZ"
"""Names of the points that no other beats in both."""
LETTER = (5.5, 11.0)
"""About the breadth of a letter and the height of a line of labels [pixel]."""


def draw(rows: Sequence[Row], out: Path) -> list[Path]:
    """For each scene and motion <scene>_<motion>_error.png and …_rate.png in a folder; …_total.png for a finger."""
    made = []
    for scene, motion in dict.fromkeys((row.scene, row.motion) for row in rows):
        of = [row for row in rows if (row.scene, row.motion) == (scene, motion) and row.step_p99_s > 0.0]
        if of:
            made.append(save(error_against_time(of), out / f"{scene}_{motion}_error.png"))
            made.append(save(rate_against_error(of), out / f"{scene}_{motion}_rate.png"))
            if any(row.total_force_rel > 0.0 for row in of):
                made.append(save(total_against_time(of), out / f"{scene}_{motion}_total.png"))
    return made


def error_against_time(rows: Sequence[Row]) -> Figure:
    """Left, how it is solved; right, what is solved: error over computing time for a second simulated."""
    figure = new_figure(*SIZE)
    left, right = figure.add_axes((0.08, 0.24, 0.41, 0.71)), figure.add_axes((0.575, 0.24, 0.41, 0.71))
    how = [row for row in rows if row.how]
    cost, error = [row.cost for row in how], [max(row.solver_force_rel, TINY) for row in how]
    best = front(cost, error)
    _logarithmic(left, cost, [*error, WEBER])
    _dots(left, how, cost, error, best)
    _front(left, cost, error, best)
    doubt = max((row.reference_uncertainty_rel for row in how), default=math.nan)
    if doubt > 0.0:
        left.axhspan(TINY, doubt, color="0.93", zorder=0)
        left.annotate("within the reference's uncertainty", (0.985, doubt), xycoords=("axes fraction", "data"),
                      ha="right", va="top", fontsize=8, color="0.45")  # fmt: skip
    left.set_title("how it is solved: against the same model, converged", fontsize=10, loc="left")
    left.set_ylabel("force error, RMS over peak force")
    what = [row for row in rows if not row.how and row.model_force_rel > 0.0 and math.isnan(row.total_force_rel)]
    cost, error = [row.cost for row in what], [row.model_force_rel for row in what]
    _logarithmic(right, cost, [*error, WEBER])
    _dots(right, what, cost, error, [])
    right.set_title("what is solved: the model, converged, against the base's", fontsize=10, loc="left")
    for axes in (left, right):
        _real_time_and_weber(axes)
        axes.set_xlabel("computing time for a second simulated [s]")
    figure.text(0.012, 0.015, _caption(rows, [how[k] for k in best], 165), fontsize=8, color="0.3", linespacing=1.4)
    return figure


def total_against_time(rows: Sequence[Row]) -> Figure:
    """Error of force against the finger that is meant over computing time: by mesh and element, down to its solver's.

    A line hangs from each point down to what of its error is the solver's; the rest is the mesh's.
    """
    figure = new_figure(0.9 * SIZE[0], 1.1 * SIZE[1])
    axes = figure.add_axes((0.08, 0.27, 0.9, 0.71))
    told = [row for row in rows if row.total_force_rel > 0.0]
    cost, total = [row.cost for row in told], [row.total_force_rel for row in told]
    part = [row.solver_part if row.solver_part > TINY else TINY for row in told]
    best = front(cost, total)
    _logarithmic(axes, cost, [*total, *part, WEBER])
    axes.vlines(cost, part, total, color="0.82", linewidth=0.7, zorder=1)
    axes.scatter(cost, part, marker="_", s=18, color="0.6", linewidths=0.9, zorder=1)
    meshes = {row.mesh: row.tets for row in sorted(told, key=lambda row: row.tets)}
    for k, (mesh, tets) in enumerate(meshes.items()):
        color, style = COLORS[k % len(COLORS)], MARKERS[k % len(MARKERS)]
        axes.scatter([], [], c=color, marker=style, s=DOT, label=f"{mesh}, {tets:,} tetrahedra")
        for i, row in enumerate(told):
            if row.mesh == mesh:
                face = color if row.volumetric == "patch" else "white"
                size = DOT if row.level == "standard" else 0.4 * DOT
                axes.scatter(cost[i], total[i], c=face, marker=style, s=size, edgecolors=color, zorder=3)
    axes.scatter([], [], c="white", edgecolors="0.3", s=DOT, label="hollow: element; filled: patch; small: lagged")
    axes.vlines([], [], [], color="0.7", label="down to the solver's error")
    _front(axes, cost, total, best)
    _real_time_and_weber(axes)
    axes.set_xlabel("computing time for a second simulated [s]: at 1 kHz the mean time of a step [ms]")
    axes.set_ylabel("force error against the finger that is meant, RMS over peak force")
    axes.legend(fontsize=7.5, frameon=False, loc="lower left")
    caption = "\n".join(textwrap.wrap(_total_caption(told, [told[k] for k in best]), 160))
    figure.text(0.012, 0.012, caption, fontsize=7.5, color="0.3", linespacing=1.35)
    return figure


def _real_time_and_weber(axes: Axes) -> None:
    """Lines at a second's computing for a second, and at the difference that is not felt."""
    axes.axvline(1.0, color=LINE_COLOR, linewidth=0.9, linestyle=":")
    axes.annotate("real time", (1.0, 0.01), xycoords=("data", "axes fraction"), rotation=90, fontsize=8,
                  color=LINE_COLOR, ha="right", va="bottom")  # fmt: skip
    axes.yaxis.set_major_formatter(lambda value, _: f"{100.0 * value:g} %")
    axes.axhline(WEBER, color=FELT_COLOR, linewidth=1.0, linestyle="--")
    axes.annotate(f"not felt under {WEBER:.0%} of {AT_FORCE:g} N", (0.985, WEBER), xytext=(0, 2),
                  xycoords=("axes fraction", "data"), textcoords="offset points", ha="right", va="bottom",
                  fontsize=8, color=FELT_COLOR)  # fmt: skip


def rate_against_error(rows: Sequence[Row]) -> Figure:
    """The largest rate that settings sustain over their largest force error."""
    figure = new_figure(0.8 * SIZE[0], SIZE[1])
    axes = figure.add_axes((0.09, 0.25, 0.89, 0.73))
    how = [row for row in rows if row.how]
    error, rate = [max(row.solver_force_max_n, TINY) for row in how], [row.rate_sustained_hz for row in how]
    best = front([-hz for hz in rate], error)
    _logarithmic(axes, [*error, UNFELT], [*rate, 1000.0])
    _dots(axes, how, error, rate, best, hollow=[not row.holds_rate for row in how])
    _front(axes, error, rate, best)
    axes.axvline(UNFELT, color=FELT_COLOR, linewidth=1.0, linestyle="--")
    axes.annotate(f"{WEBER:.0%} of {AT_FORCE:g} N: felt from here on", (UNFELT, 0.015), xytext=(3, 0),
                  xycoords=("data", "axes fraction"), textcoords="offset points", fontsize=8,
                  color=FELT_COLOR)  # fmt: skip
    axes.axhline(1000.0, color=LINE_COLOR, linewidth=0.9, linestyle=":")
    axes.annotate("1 kHz", (0.995, 1000.0), xytext=(0, 2), xycoords=("axes fraction", "data"),
                  textcoords="offset points", fontsize=8, color=LINE_COLOR, ha="right")  # fmt: skip
    axes.set_xlabel("largest force error against the same model, converged [N]")
    axes.set_ylabel("rate sustained: 1 / p99 of the step time [Hz]")
    caption = f"{_caption(rows, [how[k] for k in best], 130)}\nHollow: slower than its own time step."
    figure.text(0.012, 0.015, caption, fontsize=8, color="0.3", linespacing=1.4)
    return figure


def _logarithmic(axes: Axes, x: Sequence[float], y: Sequence[float]) -> None:
    """Scales with room around the values, and plain numbers at 1, 2 and 5."""
    from matplotlib.ticker import LogLocator, NullFormatter

    axes.set_xscale("log")
    axes.set_yscale("log")
    for axis, set_limits, values in ((axes.xaxis, axes.set_xlim, x), (axes.yaxis, axes.set_ylim, y)):
        finite = [value for value in values if math.isfinite(value)] or [1.0]
        set_limits(0.6 * min(finite), 2.2 * max(finite))
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if max(finite) < 300.0 * min(finite) else (1.0,)))
        axis.set_major_formatter(lambda value, _: f"{value:g}")
        axis.set_minor_formatter(NullFormatter())
    axes.grid(color="0.92", linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def _dots(
    axes: Axes,
    rows: Sequence[Row],
    x: Sequence[float],
    y: Sequence[float],
    lettered: Sequence[int],
    hollow: Sequence[bool] | None = None,
) -> None:
    """A dot for each point, by knob, with its value where there is room; a star for the scene as it is."""
    knobs = [knob for knob in dict.fromkeys(row.knob for row in rows) if knob != "base"]
    names = {"base": "as the scene is", "several": "several at once"}
    taken: list[tuple[float, float, float]] = []
    right = axes.transAxes.transform((1.0, 0.0))[0]
    for k, knob in enumerate([*knobs, "base"]):
        of = [i for i, row in enumerate(rows) if row.knob == knob]
        color = BASE_COLOR if knob == "base" else COLORS[k % len(COLORS)]
        style: Any = {"marker": "*" if knob == "base" else "o", "edgecolors": color, "zorder": 3}
        size = 130 if knob == "base" else 30
        if of:
            axes.scatter([], [], c=color, s=size, label=names.get(knob, knob), **style)
        for i in of:
            face = "white" if hollow and hollow[i] else color
            axes.scatter([x[i]], [y[i]], c=face, s=size, **style)
            if i in lettered or (knob == "several" and lettered) or knob == "base":
                continue
            (left, height), width = axes.transData.transform((x[i], y[i])), LETTER[0] * len(rows[i].value)
            flipped = left + width > right
            label = (left - width if flipped else left, height, width)
            if _room(label, taken):
                taken.append(label)
                axes.annotate(rows[i].value, (x[i], y[i]), xytext=(-4 if flipped else 4, 3), fontsize=6.5, color=color,
                              textcoords="offset points", ha="right" if flipped else "left")  # fmt: skip
    if rows:
        axes.legend(fontsize=7, frameon=False, loc="best")


def _room(label: tuple[float, float, float], taken: Sequence[tuple[float, float, float]]) -> bool:
    """Whether a label, (left, height, width) in pixels, is clear of the others."""
    left, height, width = label
    return all(left > a + w or a > left + width or abs(height - b) > LETTER[1] for a, b, w in taken)


def _front(axes: Axes, x: Sequence[float], y: Sequence[float], best: Sequence[int]) -> None:
    """A line through the points that no other beats in both, with their letters."""
    axes.plot([x[k] for k in best], [y[k] for k in best], color="0.6", linewidth=1.0, zorder=1)
    for letter, k in zip(LETTERS, best, strict=False):
        axes.annotate(letter, (x[k], y[k]), xytext=(-3, -11), textcoords="offset points", fontsize=8, weight="bold",
                      ha="right")  # fmt: skip


def _total_caption(rows: Sequence[Row], best: Sequence[Row]) -> str:
    """What the picture is of, and the points of the line by their letters."""
    named = [
        f"{letter}: {', '.join([row.mesh, row.volumetric, row.level, f'dt {1e3 * row.dt_s:g} ms', *_besides(row)])}"
        for letter, row in zip(LETTERS, best, strict=False)
    ]
    base = rows[0]
    return (
        f"{base.scene}, {base.motion}. The finger that is meant: {base.meant} with patches, converged; each mesh has "
        "its own modulus. Where solver and mesh err in opposite ways the whole is less than the solver's part. The "
        f"line joins what nothing beats in both. {'. '.join(named)}."
    )


def _besides(row: Row) -> list[str]:
    """Changes that the caption's first words do not tell."""
    told = ("mesh.file", "material.volumetric", "solver.level", "dt")
    parts = [part.partition("=") for part in row.changed.split("; ") if part]
    return [f"{key.rpartition('.')[2]} {value}" for key, _, value in parts if key not in told]


def _caption(rows: Sequence[Row], best: Sequence[Row], width: int) -> str:
    base = rows[0]
    named = [f"{letter}: {row.changed or 'as the scene is'}" for letter, row in zip(LETTERS, best, strict=False)]
    text = (
        f"{base.scene}, {base.motion}, {base.tets} tetrahedra, {1e3 * base.dt_s:g} ms a step where not said otherwise. "
        f"The line joins what nothing beats in both. {'. '.join(named)}."
    )
    return "\n".join(textwrap.wrap(text, width))
