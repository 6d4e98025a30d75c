"""Locking (the paper's Section 6): over-constrained tetrahedra of a pressed finger, by projection and ν."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ...bags.layout import node_strain
from ...pictures.surfaces import View, draw_body, draw_ground, look, new_figure, strain_bar
from ...scene import Scene
from ...scene.locking import bulk_to_shear, count, isochoric_strain, volume_at_limit
from ...scene.mesh import TetMesh
from .figures import Finding, Meter
from .presses import FINELY, PAPERS, Press, Way, press

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Picture

SCENE = "finger"
"""The finger on its bone, pressed flat."""
DEPTH, SPEED = 1.5e-3, 5e-3
"""How deep [m], and how fast [m/s]."""
PROJECTIONS = ("isotropic", "linear", "tensor", "hyperbolic", "orthogonal")
"""From the loosest to the tightest. `isotropic`: 0.75-1.25 everywhere, the others the paper's finger."""
METHODS = ("newton", "pgs")
POISSON = (0.3, 0.35, 0.4, 0.45, 0.48, 0.49, 0.495)
SWEPT = ("none", "patches", "isotropic", "tensor", "hyperbolic")
"""Pressed at each of POISSON; `none`, `patches`: without limits, with the paper's element and with patches."""
MOST = 3.0
"""End of the pictures' scale of strain/limit."""

SIZE = (13.0, 7.2)
VIEW = View(8.0, -62.0)
COLORS = {
    "none": "0.65", "patches": "0.25", "isotropic": "#7b8794", "linear": "#d1730f", "tensor": "#2a7f4f",
    "hyperbolic": "#0b5394", "orthogonal": "#a61c3c",
}  # fmt: skip


@dataclass(frozen=True)
class Result:
    """All that the figure shows."""

    mesh: TetMesh
    presses: dict[str, dict[str, Press]]  # projection, solver
    forces: dict[str, list[float]]  # projection: force at DEPTH for each of POISSON [N]


def measure(
    progress: Meter, projections: tuple[str, ...] = PROJECTIONS, poisson: tuple[float, ...] = POISSON
) -> Result:
    """Press the finger with each projection and solver, then with each of SWEPT and Poisson's ratio."""
    total, done = len(METHODS) * len(projections) + len(SWEPT) * len(poisson), 0

    def pressed(scene: Scene) -> Press:
        nonlocal done
        progress(done, total)
        done += 1
        return press(scene, Way(scene.initial_pose.orientation, SPEED, DEPTH, DEPTH - 2e-5), np.inf)

    presses = {name: {method: pressed(scene_of(name, method)) for method in METHODS} for name in projections}
    forces = {name: [pressed(scene_of(name, "newton", nu)).force_at(DEPTH) for nu in poisson] for name in SWEPT}
    return Result(base().load_mesh(), presses, forces)


def base() -> Scene:
    """The finger on the paper's mesh, with its element."""
    return Scene.load(SCENE).with_values(PAPERS)


def scene_of(projection: str, method: str, poisson: float | None = None) -> Scene:
    """The finger with a projection (see SWEPT), a solver and, unless it is the scene's, a Poisson's ratio."""
    values: dict[str, Any] = {**FINELY, "limits.projection": projection, "solver.method": method}
    if projection in ("none", "patches"):
        element = "element" if projection == "none" else "patch"
        values = {**FINELY, "limits": None, "solver.method": method, "material.volumetric": element}
    elif projection == "isotropic":
        values |= {"limits.stretch": 1.25, "limits.compress": 0.75}
    if poisson is not None:
        values["material.poisson"] = poisson
    return base().with_values(values)


def numbers(result: Result) -> dict[str, Any]:
    """What may lock, and what did. mean_force_n: over the deeper half of a press, as `orthogonal` chatters."""
    scene, mesh = base(), result.mesh
    assert scene.limits is not None
    is_free = np.ones(len(mesh.points), bool)
    is_free[scene.driven_nodes(mesh)] = False
    counted = count(scene.limits, is_free[mesh.tets].sum(axis=1), int(is_free.sum()))
    return {
        "scene": SCENE,
        "depth_m": DEPTH,
        "poisson": scene.material.poisson,
        "bulk_over_shear": bulk_to_shear(scene.material),
        "isochoric_strain": isochoric_strain(scene.limits),
        "volume_at_limit": volume_at_limit(scene.limits),
        "tetrahedra": len(mesh.tets),
        "rows_each": counted.rows_each,
        "crowded_tets": counted.crowded,
        "freedoms": counted.freedoms,
        "presses": {
            name: {method: _press_numbers(press) for method, press in both.items()}
            for name, both in result.presses.items()
        },
        "swept_poisson": list(POISSON),
        "force_by_poisson_n": result.forces,
    }


def _press_numbers(press: Press) -> dict[str, Any]:
    out = press.result
    return {
        "force_n": press.force_at(DEPTH),
        "mean_force_n": float(press.force[press.depth > 0.5 * DEPTH].mean()),
        "limit_rows": out.limit_rows,
        "limited_tets": out.limited_tets,
        "locked_tets": out.locked_tets,
        "strain_over_limit": out.max_strain_ratio,
        "residual": out.residual,
        "iterations": out.iterations,
        "status": (out.status.name if out.status else None) or "OK",
    }


def findings(result: Result) -> list[Finding]:
    """The paper's words on locking (Section 6)."""
    told = numbers(result)
    ours = {name: told["presses"][name]["newton"] for name in result.presses}
    rise = {name: forces[-1] / forces[0] for name, forces in result.forces.items()}
    volume = told["volume_at_limit"][1][1]
    locked = ", ".join(f"{name} {ours[name]['locked_tets']} of {ours[name]['limited_tets']}" for name in ours)
    return [
        Finding(
            "we observed some cases of locking when the limits were too restrictive, resulting in an overconstrained "
            "system",
            f"pressed flat by {1e3 * DEPTH:g} mm, of the tetrahedra at a limit so many are over-constrained: {locked}",
            ours["hyperbolic"]["locked_tets"] > 0,
            f"e2 at 0.75 and the others at 1.05 and 1.02 make {volume:.2f} of the volume at most, and with ν "
            f"{told['poisson']:g} the bulk is {told['bulk_over_shear']:.1f} times as stiff as the shear",
        ),
        Finding(
            "(how much it costs)",
            f"from ν {POISSON[0]:g} to {POISSON[-1]:g} the force rises "
            + ", ".join(f"{rise[name]:.1f} times ({name})" for name in rise),
            None,
            "near incompressibility the limits along e1 and e3 leave e2 nowhere to go; without limits pulp that can "
            "only flow sideways stiffens, and linear tetrahedra do, less in patches that share a volume strain",
        ),
        Finding(
            "(the rule makes a difference)",
            ", ".join(f"{name} {ours[name]['limit_rows']} rows, {ours[name]['force_n']:.2f} N" for name in ours),
            None,
            "hyperbolic needs up to nine rows for what tensor says with one to three; orthogonal forbids nearly all",
        ),
    ]


def draw(result: Result) -> Picture:
    """The pressed fingertip by projection; force against depth, rows and locked tetrahedra, force against ν."""
    figure = new_figure(*SIZE)
    from matplotlib import rc_context

    style: Any = {"font.size": 10, "axes.spines.top": False, "axes.spines.right": False}
    with rc_context(style):
        width = 0.9 / len(result.presses)
        for index, name in enumerate(result.presses):
            _panel(figure, 0.01 + index * width, width, result, name)
        strain_bar(figure, (0.925, 0.56, 0.011, 0.32), MOST)
        below = figure.add_gridspec(1, 3, left=0.055, right=0.985, bottom=0.14, top=0.46, wspace=0.22)
        _depths(figure.add_subplot(below[0]), result)
        _counts(figure.add_subplot(below[1]), result)
        _ratios(figure.add_subplot(below[2]), result)
        figure.text(0.012, 0.015, _caption(result), fontsize=8.5, color="0.3", va="bottom")
    return figure


def _panel(figure: Picture, left: float, width: float, result: Result, name: str) -> None:
    """The fingertip of one projection, by `newton`."""
    mesh, press = result.mesh, result.presses[name]["newton"]
    axes: Any = figure.add_axes((left, 0.44, width, 0.5), projection="3d")
    axes.patch.set_visible(False)
    points = 1e3 * press.points
    draw_ground(axes, (-14.0, -13.0), (15.0, 13.0))
    strain = node_strain(np.minimum(press.tet_strain, MOST), mesh.tets, len(mesh.points))
    tip = mesh.surface[(points[mesh.surface][:, :, 0] > -13.0).all(axis=1)]
    draw_body(axes, points, tip, strain, MOST, VIEW)
    look(axes, (0.0, 0.0, 4.0), 25.0, VIEW, 1.5)
    title = f"{name}\n{press.force_at(DEPTH):.2f} N, strain/limit {press.result.max_strain_ratio:.3g}"
    figure.text(left + 0.5 * width, 0.985, title, ha="center", va="top", color=COLORS[name], linespacing=1.3)


def _depths(axes: Axes, result: Result) -> None:
    for name, both in result.presses.items():
        press = both["newton"]
        axes.plot(1e3 * press.depth, press.force, color=COLORS[name], linewidth=1.5, label=name)
    axes.set(xlim=(0.0, 1e3 * DEPTH), ylim=(0.01, 100.0), yscale="log")
    axes.set(xlabel="depth of a flat press [mm]", ylabel="normal force [N]")
    axes.legend(frameon=False, fontsize=8.5, loc="upper left", ncols=2)


def _counts(axes: Axes, result: Result) -> None:
    """Rows that hold, tetrahedra at a limit, those over-constrained; dots: `pgs`."""
    shown = (("rows that hold", "limit_rows", 0.35), ("tetrahedra at a limit", "limited_tets", 0.65),
             ("over-constrained", "locked_tets", 1.0))  # fmt: skip
    for index, (name, both) in enumerate(result.presses.items()):
        for bar, (_, key, depth) in enumerate(shown):
            x = index + 0.27 * (bar - 1)
            axes.bar(x, getattr(both["newton"].result, key), 0.25, color=COLORS[name], alpha=depth)
            axes.plot(x, getattr(both["pgs"].result, key), "o", color="black", markersize=3)
    axes.set_xticks(range(len(result.presses)), list(result.presses), fontsize=7.5)
    words = ", ".join(word for word, _, _ in shown)
    axes.set_title(f"{words} (dots: pgs)", fontsize=8.5, loc="left")
    freedoms = numbers(result)["freedoms"]
    axes.axhline(freedoms, color="0.5", linewidth=0.8, linestyle=(0, (3, 2)))
    axes.text(-0.4, freedoms + 4, f"{freedoms} freedoms", color="0.4", fontsize=8.5, va="bottom")
    axes.set_ylabel("count")


def _ratios(axes: Axes, result: Result) -> None:
    for name, forces in result.forces.items():
        label = {"none": "no limits", "patches": "no limits, patches"}.get(name, name)
        axes.plot(POISSON[: len(forces)], forces, "o-", color=COLORS[name], markersize=4, label=label)
    axes.set(xlabel="Poisson's ratio ν", ylabel=f"force at {1e3 * DEPTH:g} mm [N]", ylim=(0.0, None))
    axes.legend(frameon=False, fontsize=8.5, loc="upper left")


def _caption(result: Result) -> str:
    material = base().material
    return (
        f"The finger on its bone pressed flat by {1e3 * DEPTH:g} mm: {len(result.mesh.tets)} tetrahedra, "
        f"E {1e-3 * material.young:g} kPa, ν {material.poisson:g} above and left, limits 0.95–1.05, 0.75–1.25, "
        "0.98–1.02 of stiffness κ 100 (isotropic: 0.75–1.25 everywhere), solved by newton.\n"
        "Over-constrained: strained along an axis beyond what the other limits allow at constant volume, or more rows "
        f"than ways to deform. Colours end at {MOST:g}."
    )
