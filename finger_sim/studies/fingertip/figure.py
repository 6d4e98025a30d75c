"""The picture of the fingertip's laws, and what is known beside what the model gives."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ...pictures.surfaces import new_figure
from ...scene import Scene
from ...scene.calibration import scene_on
from ..paper.figures import Finding, Meter
from .laws import FORCES, KNOWN, Line, exponent, stiffness_line, tangent
from .measures import MESH, SCENE, Fingertip, measured

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SAID_BY = "what is known of fingertips"
"""Head of the column that measurements are held against."""
LINEAR = 0.98
"""R² from which stiffness counts as linear in force."""
PROPORTIONAL = 0.2
"""How far from 1 the exponent of tangential stiffness over normal force may be."""
MODEL, LINE, OTHER = "#0b5394", "0.4", "#d1730f"


def measure(progress: Meter) -> Fingertip:
    """Presses the everyday finger."""
    return measured(scene_on(Scene.load(SCENE), MESH), progress)


def numbers(result: Fingertip) -> dict[str, Any]:
    """Values for JSON."""
    lines = {
        f"{name}_to_{high:g}_n": None if line is None else {"b_n_per_m": line.b, "m_per_m": line.m, "r2": line.R2}
        for name, (_, high), line in (("known", KNOWN, _line(result, KNOWN)), ("asked", FORCES, _line(result, FORCES)))
    }
    return {
        "mesh": MESH,
        "depth_m": result.depth,
        "force_n": result.force,
        "area_m2": result.area,
        "lines": lines,
        "loads_n": result.loads,
        "tangential_n_per_m": result.tangential,
        "unlimited_tangential_n_per_m": result.unlimited,
        "tangential_exponent": exponent(result.loads, result.tangential),
        "tangential_exponents_at_first_loads": _exponents_at_first_loads(result),
        "area_exponent": _area_exponent(result),
        "shears": [
            {"load_n": s.load, "way_m": s.way, "force_n": s.force, "area_m2": s.area, "area_change": _change(s.area)}
            for s in result.shears
        ],
    }


def findings(result: Fingertip) -> list[Finding]:
    """What is known beside what the model gives."""
    return [_of_stiffness(result), _of_tangential(result), _of_shear(result), _of_area(result)]


def _line(result: Fingertip, between: tuple[float, float]) -> Line | None:
    return stiffness_line(result.depth, result.force, between)


def _of_stiffness(result: Fingertip) -> Finding:
    known, asked = _line(result, KNOWN), _line(result, FORCES)
    linear = known is not None and known.R2 >= LINEAR
    agrees = linear and known is not None and known.b > 0.0
    reason = "" if agrees else "straight, but b is below 0" if linear else "not straight"
    return Finding(
        "force grows exponentially with depth: k = b + m F, b and m above 0, from 0 to 2 N (Pawluk and Howe 1999)",
        f"{KNOWN[0]:g} to {KNOWN[1]:g} N: {known}; {FORCES[0]:g} to {FORCES[1]:g} N: {asked}",
        agrees,
        reason,
    )


def _of_tangential(result: Fingertip) -> Finding:
    power = exponent(result.loads, result.tangential)
    agrees = abs(power - 1.0) <= PROPORTIONAL
    limited, unlimited = _exponents_at_first_loads(result)
    last = result.loads[len(result.unlimited) - 1]
    reason = f"limits: to {last:g} N the power is {limited:.2f} with them, {unlimited:.2f} without"
    return Finding(
        "tangential stiffness is proportional to normal force (Pataky 2005)",
        f"it grows as the force to the power of {power:.2f}, {result.loads[0]:g} to {result.loads[-1]:g} N",
        agrees,
        "" if agrees else reason,
    )


def _exponents_at_first_loads(result: Fingertip) -> tuple[float, float]:
    """Of tangential stiffness over normal force, at the forces where it is known without limits: with them, without."""
    count = len(result.unlimited)
    loads = result.loads[:count]
    return exponent(loads, result.tangential[:count]), exponent(loads, result.unlimited)


def _of_shear(result: Fingertip) -> Finding:
    falls = [_change(shear.area) for shear in result.shears]
    told = ", ".join(f"{change:+.0%} at {shear.load:g} N" for change, shear in zip(falls, result.shears, strict=True))
    agrees = all(change < -0.02 for change in falls)
    return Finding(
        "contact area falls under shear (Delhaye 2014)",
        f"from rest until nearly all slips {told}",
        agrees,
        "" if agrees else "the cause is not known; the model has no skin that is stiffer than its pulp",
    )


def _of_area(result: Fingertip) -> Finding:
    at_1 = 1e6 * float(np.interp(1.0, result.force, result.area))
    return Finding(
        "(how contact area grows with force: not settled)",
        f"as the force to the power of {_area_exponent(result):.2f}; {at_1:.0f} mm² at 1 N",
        None,
    )


def _area_exponent(result: Fingertip) -> float:
    """Of contact area over normal force, over FORCES."""
    within = (result.force >= FORCES[0]) & (result.force <= FORCES[1])
    return exponent(result.force[within], result.area[within])


def _change(area: Any) -> float:
    """From the first to the mean of the last fifth, as a part of the first."""
    return float(np.mean(area[-max(1, len(area) // 5) :]) / area[0] - 1.0)


def draw(result: Fingertip) -> Figure:
    """The picture."""
    figure = new_figure(9.6, 6.4)
    from matplotlib import rc_context

    style: Any = {"font.size": 9, "axes.spines.top": False, "axes.spines.right": False}
    with rc_context(style):
        axes = figure.subplots(2, 2, gridspec_kw={"hspace": 0.42, "wspace": 0.28})
        figure.subplots_adjust(left=0.08, right=0.97, top=0.94, bottom=0.09)
        _stiffness(axes[0, 0], result)
        _area(axes[0, 1], result)
        _tangential(axes[1, 0], result)
        _shear(axes[1, 1], result)
    return figure


def _stiffness(axes: Axes, result: Fingertip) -> None:
    F, k = tangent(result.depth, result.force)
    axes.plot(F, 1e-3 * k, ".", color=MODEL, label="model")
    line = stiffness_line(result.depth, result.force)
    if line is not None:
        ends = np.array(FORCES)
        axes.plot(ends, 1e-3 * (line.b + line.m * ends), color=LINE, lw=1.2, label=f"k = b + m F, R² {line.R2:.3f}")
    axes.set(xlim=(0.0, 1.1 * FORCES[1]), xlabel="normal force F [N]", ylabel="stiffness k [N/mm]")
    axes.set_ylim(0.0, 1.2e-3 * float(k[1.1 * FORCES[1] >= F].max()))
    axes.set_title("Pressed flat: stiffness against force", fontsize=9)
    axes.legend(frameon=False, fontsize=8)


def _area(axes: Axes, result: Fingertip) -> None:
    axes.plot(result.force, 1e6 * result.area, ".-", color=MODEL, lw=0.8)
    axes.set(xlim=(0.0, 1.1 * FORCES[1]), ylim=(0.0, None), xlabel="normal force F [N]", ylabel="contact area [mm²]")
    axes.set_title("Contact area against force", fontsize=9)


def _tangential(axes: Axes, result: Fingertip) -> None:
    axes.loglog(result.loads, 1e-3 * result.tangential, "o", color=MODEL, label="model")
    loads = result.loads[: len(result.unlimited)]
    axes.loglog(loads, 1e-3 * result.unlimited, "o", color=OTHER, mfc="none", label="without limits")
    middle = float(np.exp(np.mean(np.log(result.tangential / result.loads))))
    axes.loglog(result.loads, 1e-3 * middle * result.loads, color=LINE, lw=1.2, label="proportional")
    axes.set(xlabel="normal force F [N]", ylabel="tangential stiffness [N/mm]")
    for axis, ticks in ((axes.xaxis, (0.25, 0.5, 1.0, 2.0, 5.0)), (axes.yaxis, (0.1, 0.2, 0.5, 1.0, 2.0, 5.0))):
        axis.set_ticks(ticks, [f"{tick:g}" for tick in ticks])
        axis.set_ticks([], minor=True)
    axes.set_title("Tangential stiffness against force", fontsize=9)
    axes.legend(frameon=False, fontsize=8)


def _shear(axes: Axes, result: Fingertip) -> None:
    for shear, color in zip(result.shears, (MODEL, OTHER), strict=False):
        axes.plot(
            1e3 * shear.way, shear.area / shear.area[0], ".-", color=color, lw=1.0, label=f"area, {shear.load:g} N"
        )
        part = shear.force / (result.friction * shear.load)
        axes.plot(1e3 * shear.way, part, color=color, lw=1.0, ls="--", label=f"shear over full slip, {shear.load:g} N")
    axes.axhline(1.0, color="0.8", lw=0.8)
    axes.set(xlabel="way of the bone along the finger [mm]", ylabel="contact area over that at rest", ylim=(0.0, 1.4))
    axes.set_title("Sheared at a held normal force", fontsize=9)
    axes.legend(frameon=False, fontsize=7, ncols=2, loc="lower right")
