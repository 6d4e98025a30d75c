"""Figure 3: a finger pressed on a table flat, on its side and on its tip, with anisotropic and with isotropic limits.

The limits are `hyperbolic`, as in the paper, or `isotropic`; all else is equal. The picture shows soft tissue on a
rigid bone, `pulp` of `finger_presses`; the paper's finger that is held at its cut end has its curves beside.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ...bags.layout import node_strain
from ...physics.step import Status
from ...pictures.surfaces import View, draw_body, draw_ground, look, new_figure, strain_bar
from ...scene.mesh import TetMesh
from .figures import Finding, Meter
from .presses import BODIES, DIRECTIONS, MATERIALS, TILT, Body, Key, Press, press, scene_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Picture

LIGHT, FIRM = 0.2, 1.5
"""Forces at which tangent stiffnesses are compared [N]."""
ENOUGH = 8.0
"""Force at which a press ends [N]."""
ALIKE, FAR = 2.0, 3.0
"""Ratios of force at equal depth below which two materials count as similar, and from which on as far stiffer."""
HARDLY = 0.4
"""mm on the side for one mm flat, below which there is hardly any deformation."""
RIGID = 4.0
"""Firm over light tangent stiffness from which on a finger counts as soon almost rigid."""
STEPS = "pulp"
"""The body that is pressed once more at half the speed in steps half as long."""

SIZE = (11.0, 11.6)
"""Of the picture [inch]."""
LEFT, PANEL, BOTTOMS = 0.05, (0.28, 0.22), (0.308, 0.068)
"""Left end of the pictures, width and height of each, lower ends of the plots; parts of the figure."""
VIEW = View(8.0, -72.0)
EXTENT, TOP = 36.0, 2.0
"""Edge of the cube looked at [mm], and the end of the scale of strain/limit."""
CENTRES = {"flat": (-6.0, 0.0, 8.0), "side": (-6.0, 0.0, 8.0), "tip": (0.0, 0.0, 8.0)}
"""Middle of what is seen [mm], world."""
GROUND = ((-70.0, -85.0), (70.0, 25.0))
COLORS = {"anisotropic": "#0b5394", "isotropic": "#d1730f"}
CURVES = {
    "pulp": "On its bone, as in the pictures: pulp of E 14 kPa, ν 0.45; limits of stiffness κ 100; μ 0.5",
    "paper": f"The paper's: E 2 MPa, ν 0.4, held at its cut end; rigid limits; μ 0.5; flat and side tilted {TILT:g}°",
}
"""The bodies plotted, and what stands over their plots."""
HIGHEST = 5.0
"""Largest force of the plots [N]."""
CAPTION = (
    f"Dots and numbers: tangent stiffness at {LIGHT:g} N → at {FIRM:g} N, and their ratio. "
    "Depth counts from first touch. All: 350 tetrahedra, 1000 kg/m³."
)
ROWS = ("anisotropic\n$e_1$ ±5 %, $e_2$ ±25 %, $e_3$ ±2 %", "isotropic\n±25 % every way")


@dataclass(frozen=True)
class Result:
    """All presses; those of the body STEPS also in finer steps."""

    presses: dict[Key, Press]
    finer: dict[Key, Press]
    mesh: TetMesh


def measure(progress: Meter, bodies: Mapping[str, Body] = BODIES, finer: bool = True) -> Result:
    """Press every body in every direction, of both materials; `finer`: the body STEPS once more."""
    keys = [(name, direction, material) for name in bodies for direction in DIRECTIONS for material in MATERIALS]
    again = [key for key in keys if key[0] == STEPS] if finer else []
    total, done = float(len(keys) + 4 * len(again)), 0.0
    presses: dict[Key, Press] = {}
    repeated: dict[Key, Press] = {}
    for key in keys:
        way = bodies[key[0]].ways[key[1]]
        presses[key] = press(scene_of(key, bodies), way, ENOUGH, _part(progress, done, 1.0, total))
        done += 1.0
    for key in again:
        scene, way = scene_of(key, bodies), presses[key].way
        scene, way = scene.with_values({"dt": 0.5 * scene.dt}), replace(way, speed=0.5 * way.speed)
        repeated[key] = press(scene, way, ENOUGH, _part(progress, done, 4.0, total))
        done += 4.0
    return Result(presses, repeated, scene_of((STEPS, next(iter(DIRECTIONS)), next(iter(MATERIALS)))).load_mesh())


def _part(progress: Meter, done: float, weight: float, total: float) -> Callable[[float], None]:
    """Tells `progress` of a part of the whole that began at `done` and weighs `weight`."""
    return lambda part: progress(done + weight * part, total)


def numbers(result: Result) -> dict[str, Any]:
    """What the figure claims."""
    bodies = dict.fromkeys(key[0] for key in result.presses)
    return {
        "light_n": LIGHT,
        "firm_n": FIRM,
        "bodies": {name: {d: _direction(result, name, d) for d in DIRECTIONS} for name in bodies},
        "change_in_steps_half_as_long": {
            d: {m: _change(result.presses[STEPS, d, m], result.finer[STEPS, d, m]) for m in MATERIALS}
            for d in DIRECTIONS
            if (STEPS, d, "isotropic") in result.finer
        },
    }


def _direction(result: Result, body: str, direction: str) -> dict[str, Any]:
    """Both materials pressed alike, and the one beside the other."""
    anisotropic, isotropic = (result.presses[body, direction, material] for material in MATERIALS)
    depths = np.linspace(0.0, min(anisotropic.depth[-1], isotropic.depth[-1]), 31)[1:]
    forces = [[press.force_at(depth) for depth in depths] for press in (anisotropic, isotropic)]
    return {
        "shown_depth_m": anisotropic.way.shown,
        "force_ratio_at_shown": force_ratio(result, body, direction),
        "depth_ratio_at_firm": anisotropic.depth_at(FIRM) / isotropic.depth_at(FIRM),
        "depth_m": depths,
        "force_ratio": np.array(forces[0]) / np.array(forces[1]),
        "anisotropic": {"force_n": forces[0]} | _press(anisotropic),
        "isotropic": {"force_n": forces[1]} | _press(isotropic),
    }


def _press(press: Press) -> dict[str, Any]:
    """The numbers of one press; `at_shown`: at the pictured depth."""
    return {
        "force_at_shown_n": press.force_at(press.way.shown),
        "depth_at_light_m": press.depth_at(LIGHT),
        "depth_at_firm_m": press.depth_at(FIRM),
        "tangent_at_light_n_per_m": press.tangent(LIGHT),
        "tangent_at_firm_n_per_m": press.tangent(FIRM),
        "tangent_firm_over_light": _stiffening(press),
        "force_at_first_limit_n": press.first_limit,
        "limited_tets_at_shown": press.limited_tets[press.at_shown],
        "strain_over_limit_at_shown": press.strain_ratio[press.at_shown],
        "reached_tets_by_axis_at_shown": press.reached,
        "penetration_m": press.penetration,
        "status": [flag.name for flag in Status if flag in press.status],
    }


def force_ratio(result: Result, body: str, direction: str) -> float:
    """Anisotropic over isotropic force at the pictured depth."""
    depth = result.presses[body, direction, "isotropic"].way.shown
    anisotropic, isotropic = (result.presses[body, direction, material].force_at(depth) for material in MATERIALS)
    return anisotropic / isotropic


def _change(press: Press, finer: Press) -> dict[str, float]:
    """By what part the finer steps change the force, at most from half of LIGHT on, and the tangents."""
    both = (press.force > 0.5 * LIGHT) & (press.depth < finer.depth[-1])
    force = np.interp(press.depth[both], finer.depth, finer.force)
    return {
        "force": float(np.abs(force / press.force[both] - 1.0).max()),
        "tangent_at_light": abs(finer.tangent(LIGHT) / press.tangent(LIGHT) - 1.0),
        "tangent_at_firm": abs(finer.tangent(FIRM) / press.tangent(FIRM) - 1.0),
    }


def findings(result: Result) -> list[Finding]:
    """What the paper says of its Figure 3 (Section 5.1)."""
    pulp = {key[1:]: press for key, press in result.presses.items() if key[0] == "pulp"}
    flat, side = pulp["flat", "anisotropic"], pulp["side", "anisotropic"]
    ratio = {direction: force_ratio(result, "pulp", direction) for direction in DIRECTIONS}
    largest = float(np.nanmax(_direction(result, "pulp", "flat")["force_ratio"]))
    light, firm = (f"{flat.tangent(force) / 1e3:.2f} N/mm at {force:g} N" for force in (LIGHT, FIRM))
    return [
        Finding(
            "for the same motions similar results along e2",
            f"anisotropic {ratio['flat']:.2f} times the isotropic force at {_mm(flat.way.shown)}, {largest:.2f} times "
            f"at most; {FIRM:g} N at {_depths(pulp, 'flat')}",
            largest < ALIKE,
            "what differs: pulp that is pressed flat spreads across, where 2 % is the limit; e3 is the axis of "
            f"{flat.reached[2]} of the {flat.reached.sum()} tetrahedra at theirs",
        ),
        Finding(
            "isotropic limits overly compliant along the other axes",
            f"anisotropic {ratio['side']:.0f} times the isotropic force at {_mm(side.way.shown)} on the side, "
            f"{ratio['tip']:.0f} times on the tip",
            min(ratio["side"], ratio["tip"]) > FAR,
        ),
        Finding(
            "very compliant under light loading, but soon becomes almost rigid",
            f"flat: {light}, {firm}, {_stiffening(flat):.1f} times as stiff",
            _stiffening(flat) > RIGID,
            f"isotropic limits stiffen too, {_stiffening(pulp['flat', 'isotropic']):.0f} times: later, where the pulp "
            "between skin and bone is down to three quarters",
        ),
        Finding(
            "when pressed on the side there is hardly any deformation",
            f"{FIRM:g} N at {_depths(pulp, 'side')} on the side, {_depths(pulp, 'flat')} flat",
            side.depth_at(FIRM) < HARDLY * flat.depth_at(FIRM),
        ),
        *_at_two_megapascal(result),
    ]


def _at_two_megapascal(result: Result) -> list[Finding]:
    """The same with the paper's modulus, on both holds."""
    first = (f"{result.presses['paper', d, 'anisotropic'].first_limit:.1f}" for d in DIRECTIONS)
    flat = result.presses["stiff", "flat", "anisotropic"]
    reasons = {
        "paper": "held there it bends as a whole: no limit is reached, and both are the same, up to "
        f"{', '.join(first)} N; then 5 % along e1 holds the bending, and soon after not all limits can hold. "
        "The paper does not say how its finger is held",
        "stiff": f"but far too stiff for a finger: {flat.force_at(flat.way.shown):.0f} N flat",
    }
    holds = {"paper": "held at its cut end", "stiff": "on the rigid bone"}
    made = []
    for body, hold in holds.items():
        ratio = {direction: force_ratio(result, body, direction) for direction in DIRECTIONS}
        depth = {direction: _mm(result.presses[body, direction, "isotropic"].way.shown) for direction in DIRECTIONS}
        measured = ", ".join(f"{ratio[d]:.3g} {d} at {depth[d]}" for d in DIRECTIONS)
        agrees = ratio["flat"] < ALIKE and min(ratio["side"], ratio["tip"]) > FAR
        claim = "similar along e2, overly compliant along the other axes, with E 2 MPa"
        made.append(Finding(claim, f"{hold}: anisotropic over isotropic force {measured}", agrees, reasons[body]))
    return made


def _mm(depth: float) -> str:
    """A depth as text."""
    return f"{1e3 * depth:.3g} mm"


def _depths(pulp: Mapping[tuple[str, str], Press], direction: str) -> str:
    """Depth at FIRM of both materials, as text."""
    return " against ".join(f"{1e3 * pulp[direction, m].depth_at(FIRM):.2f}" for m in MATERIALS) + " mm"


def _stiffening(press: Press) -> float:
    """Tangent stiffness at FIRM over that at LIGHT."""
    return press.tangent(FIRM) / press.tangent(LIGHT)


def draw(result: Result) -> Picture:
    """The fingertip pressed three ways, anisotropic above isotropic; below, force against depth of both bodies."""
    figure = new_figure(*SIZE)
    from matplotlib import rc_context

    style: Any = {"font.size": 10, "axes.spines.top": False, "axes.spines.right": False}
    with rc_context(style):
        for column, direction in enumerate(DIRECTIONS):
            for row, material in enumerate(MATERIALS):
                _body(figure, result, direction, material, row, column)
            _heading(figure, result, direction, column)
            for row, body in enumerate(CURVES):
                _curves(figure, result, body, direction, row, column)
        for row, text in enumerate(CURVES.values()):
            figure.text(LEFT + 0.02, BOTTOMS[row] + 0.182, text, ha="left", va="center", fontsize=10.5)
        for row, text in enumerate(ROWS):
            figure.text(0.022, _at(row, 0)[1] + 0.5 * PANEL[1], text, rotation=90, ha="center", va="center")
        figure.text(LEFT + 0.02, 0.014, CAPTION, ha="left", va="center", fontsize=9.5)
        _bar(figure)
    return figure


def _at(row: int, column: int) -> tuple[float, float, float, float]:
    """Place of a picture: left, bottom, width, height; parts of the figure."""
    width, height = PANEL
    return LEFT + column * (width + 0.008), 0.742 - row * (height + 0.008), width, height


def _body(figure: Picture, result: Result, direction: str, material: str, row: int, column: int) -> None:
    """The fingertip at the pictured depth, to scale, with what it takes."""
    press = result.presses["pulp", direction, material]
    left, bottom, width, height = _at(row, column)
    frame = figure.add_axes((left, bottom, width, height), xticks=[], yticks=[])
    frame.spines[:].set(visible=True, color="0.8", linewidth=0.8)
    square = width * SIZE[0] / SIZE[1]
    axes = figure.add_axes((left, bottom - 0.5 * (square - height), width, square), projection="3d", facecolor="none")
    x = 1e3 * press.points
    strain = node_strain(press.tet_strain, result.mesh.tets, len(x))
    draw_ground(axes, *GROUND)
    draw_body(axes, x, result.mesh.surface, np.minimum(strain, TOP), TOP, VIEW)
    look(axes, CENTRES[direction], EXTENT, VIEW)
    for part in axes.collections:
        part.set_clip_path(frame.patch)
    text = f"{press.force_at(press.way.shown):.2f} N, {press.limited_tets[press.at_shown]} tetrahedra at a limit"
    figure.text(left + 0.008, bottom + 0.014, text, va="center")


def _heading(figure: Picture, result: Result, direction: str, column: int) -> None:
    """What a column shows."""
    left, bottom, width, height = _at(0, column)
    text = f"{DIRECTIONS[direction]}, {_mm(result.presses['pulp', direction, 'isotropic'].way.shown)} deep"
    figure.text(left + 0.5 * width, bottom + height + 0.008, text, ha="center", va="bottom", fontsize=11)


def _bar(figure: Picture) -> None:
    """The scale of all pictures; it ends below the largest strain."""
    bottom, top = _at(1, 0)[1], _at(0, 0)[1] + PANEL[1]
    strain_bar(figure, (0.928, bottom + 0.1, 0.013, top - bottom - 0.2), TOP)
    axes = figure.axes[-1]
    axes.set_yticks([0.0, 0.5, 1.0, 1.5, TOP], ["0", "0.5", "1", "1.5", f"≥ {TOP:g}"])


def _curves(figure: Picture, result: Result, body: str, direction: str, row: int, column: int) -> None:
    """Force against depth of both materials, with the tangents at LIGHT and FIRM."""
    left, _, width, _ = _at(0, column)
    axes: Axes = figure.add_axes((left + 0.02, BOTTOMS[row], width - 0.035, 0.134))
    for material, color in COLORS.items():
        press = result.presses[body, direction, material]
        axes.plot(1e3 * press.depth, press.force, color=color, linewidth=1.5, label=_label(press, material))
        for force in (LIGHT, FIRM):
            _tangent(axes, press, force, color)
    axes.set(xlim=(0.0, 1e3 * result.presses[body, direction, "isotropic"].depth[-1]), ylim=(0.0, HIGHEST))
    axes.legend(
        loc="lower left", bbox_to_anchor=(0.0, 0.98), frameon=False, fontsize=9, handlelength=1.2, borderpad=0.1
    )
    axes.set_xlabel("depth [mm]", labelpad=1.0)
    if column == 0:
        axes.set_ylabel("normal force [N]")


def _label(press: Press, material: str) -> str:
    """Name of a curve, with its tangent stiffnesses."""
    light, firm = (press.tangent(force) / 1e3 for force in (LIGHT, FIRM))
    return f"{material}: {light:.2f} → {firm:.2f} N/mm, ×{firm / light:.2g}"


def _tangent(axes: Axes, press: Press, force: float, color: str) -> None:
    """A point of a curve and a piece of its tangent there."""
    depth, slope = press.depth_at(force), press.tangent(force)
    axes.plot(1e3 * depth, force, "o", color=color, markersize=4.5, markeredgecolor="white", zorder=4)
    run = min(0.6 / slope, 0.1 * float(press.depth[-1]))
    ends = np.array([-run, run])
    axes.plot(1e3 * (depth + ends), force + slope * ends, color=color, linewidth=0.9)
