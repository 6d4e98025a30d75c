"""The paper's Figure 2: a stiff beam, a compliant one free along its length, one within 4 % everywhere.

Each is let go straight and at rest under gravity, once to swing and once, damped, to come to rest. The compliant ones
twice: by the paper's method, and with the `tensor` limit and the `newton` solver.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ...pictures.surfaces import PLANE_COLOR, PLANE_EDGE, View, draw_body, look, new_figure, strain_bar, top_of
from ...scene import Scene
from .beam_measures import (
    LATE,
    SMALL,
    Measured,
    Run,
    at_rest,
    beam_numbers,
    late_oscillation,
    let_go,
    small_load,
    small_sag,
    time_to_settle,
)
from .figures import Finding, Meter

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Picture

STIFF, ANISOTROPIC, ISOTROPIC = "beam_stiff", "beam_anisotropic", "beam_isotropic"
OURS = {ANISOTROPIC: "beam_anisotropic_newton", ISOTROPIC: "beam_isotropic_newton"}
"""The same beams with the `tensor` limit and the `newton` solver."""
BEAMS = (STIFF, ANISOTROPIC, ISOTROPIC, *OURS.values())
"""Shipped scenes, from left to right."""
SWING, REST = 10.0, 6.0
"""Simulated time of each run [s]."""
PATCHED = {"material.volumetric": "patch", "solver.method": "newton"}
"""The stiff beam beyond the paper: patches of tetrahedra share one volume strain."""
REST_DAMPING = 5.0
"""Mass-proportional damping that brings a beam to rest [1/s]."""
SIMILAR = 1.5
"""Tip deflections within this factor are called similar."""
STRETCHED, WOBBLY = 5.0, 2.0
"""Significantly more stretched, and wobbly along its axis: so many times as much as either other beam."""
HELD = 1.05
"""Strain/limit up to which a limit is called held."""
SHEAR = (
    "tensor bounds strain among the restricted axes only: shear between them and the free one is free (mean |cosine| "
    "of the angle between e1 and e3 {:.2f}, hyperbolic {:.2f}); with the other solver either beam hangs as low"
)
TREMBLING = (
    "the hyperbolic limit's gradient jumps where singular values cross: the anisotropic beam trembles "
    "({:.2f} m/s rms at rest), and does so with newton, too"
)
SIZE = (12.0, 9.0)
"""Of the whole picture [inch]."""
VIEW = View(elevation=10.0, azimuth=-68.0)
TITLES = {
    STIFF: ("stiff", "E 200 kPa, no limits"),
    ANISOTROPIC: ("anisotropic", "E 5 kPa, free along,\n0.96 to 1.04 across"),
    ISOTROPIC: ("isotropic", "E 5 kPa, 0.96 to 1.04\nin every direction"),
}
COLORS = {STIFF: "0.25", ANISOTROPIC: "#0b5394", ISOTROPIC: "#d1730f"}
OUTLINE = "0.6"
LEFT, COLUMN = 0.03, 0.182
"""Where the pictures of beams begin, and how wide each is, of the whole picture."""
PAPERS = {other: name for name, other in OURS.items()}


@dataclasses.dataclass(frozen=True)
class Result:
    """Every beam by its scene's name, and the stiff one under a small load: as the paper's, and with patches."""

    beams: dict[str, Measured]
    small: Measured
    patched: Run  # brought to rest


def measure(progress: Meter, *, beams: Sequence[str] = BEAMS, swing: float = SWING, rest: float = REST) -> Result:
    """Let the beams go for `swing` and, damped, for `rest` [s]."""
    scenes = {name: Scene.load(name) for name in beams}
    gravity = [SMALL * g for g in Scene.load(STIFF).gravity]
    small = Scene.load(STIFF).with_values({"gravity": gravity})
    patched = small.with_values(PATCHED)
    total = sum(_cost(scene) for scene in (*scenes.values(), small)) * (swing + rest) + _cost(patched) * rest
    spent = 0.0

    def let(scene: Scene, duration: float) -> Run:
        def done() -> None:
            nonlocal spent
            spent += _cost(scene) * scene.dt
            progress(spent, total)

        return let_go(scene, duration, done)

    def to_rest(scene: Scene) -> Run:
        return let(scene.with_values({"material.damping.mass": REST_DAMPING}), rest)

    def both(scene: Scene) -> Measured:
        return Measured(let(scene, swing), to_rest(scene))

    return Result({name: both(scene) for name, scene in scenes.items()}, both(small), to_rest(patched))


def numbers(result: Result) -> dict[str, Any]:
    """By scene: at rest means over the last second; frequencies and decays of the later part of the swing."""
    return {
        "swing_s": float(result.small.swing.series.time[-1]),
        "rest_s": float(result.small.rest.series.time[-1]),
        "rest_damping_per_s": REST_DAMPING,
        "beams": {name: beam_numbers(beam) for name, beam in result.beams.items()},
        "small_load": small_load(result.small),
        "small_load_with_patches": small_sag(result.patched),
    }


def findings(result: Result) -> list[Finding]:
    """Every statement about the beams by the paper's method, and with `tensor` and `newton`."""
    stiff, paper = result.beams[STIFF], {name: result.beams[name] for name in OURS}
    ours = {name: result.beams[other] for name, other in OURS.items()}
    shear = (at_rest(pair[ANISOTROPIC].rest).shear for pair in (ours, paper))
    small, patched = small_load(result.small), small_sag(result.patched)
    locking = Finding(
        "(200 tetrahedra; their stiffness in bending is not spoken of)",
        f"under a small load they sag {small['sag_below_quadratic_percent']:.0f} % less than quadratic ones on the "
        f"same mesh: {small['stiffness_over_quadratic']:.2f} times as stiff; with patches "
        f"{patched['sag_below_quadratic_percent']:.0f} % less, {patched['stiffness_over_quadratic']:.2f} times",
        None,
        "patches free the volume, not the bending of single linear tetrahedra",
    )
    return [
        *_paper_findings(stiff, paper, "the paper's limits, pgs", ""),
        _limits_hold(paper, "the paper's limits, pgs", TREMBLING.format(at_rest(paper[ANISOTROPIC].rest).speed)),
        *_paper_findings(stiff, ours, "tensor, newton", SHEAR.format(*shear)),
        _limits_hold(ours, "tensor, newton", ""),
        locking,
    ]


def draw(result: Result) -> Picture:
    """The beams at rest, side by side, and under them how they swing."""
    figure = new_figure(*SIZE)
    from matplotlib import rc_context

    style: Any = {"font.size": 9, "axes.spines.top": False, "axes.spines.right": False}
    top = top_of(np.concatenate([beam.rest.strain for beam in result.beams.values()]))
    with rc_context(style):
        _group(figure, 0, 3, "the paper's method: hyperbolic and isotropic limit, pgs")
        _group(figure, 3, 5, "beyond the paper: tensor limit, newton")
        for column, (name, beam) in enumerate(result.beams.items()):
            _hanging(figure, column, name, beam.rest, top)
        strain_bar(figure, (0.945, 0.49, 0.011, 0.3), top)
        _curves(figure, result)
        figure.text(LEFT, 0.018, _caption(result), va="bottom", linespacing=1.5)
    return figure


def _cost(scene: Scene) -> float:
    """Time that a step takes, in those of a step without limits, about."""
    if scene.limits is None:
        return 1.0
    return 4.0 if scene.solver.method == "newton" else 22.0


def _paper_findings(stiff: Measured, pair: dict[str, Measured], how: str, sags: str) -> Iterator[Finding]:
    """What Section 5.1 says of Figure 2, with the compliant beams simulated `how`; `sags`: why they hang otherwise."""
    rests = [at_rest(beam.rest) for beam in (stiff, pair[ANISOTROPIC], pair[ISOTROPIC])]
    hang, free, _ = (rest.deflection for rest in rests)
    similar = max(hang, free) / min(hang, free) <= SIMILAR
    yield Finding(
        "stiff and anisotropic beam: similar vertical deformation",
        f"{how}: tip {hang:.2f} and {free:.2f} m down at rest (isotropic {rests[2].deflection:.2f} m)",
        similar,
        "" if similar else sags,
    )
    lengths = [rest.length for rest in rests]
    yield Finding(
        "the anisotropic beam is significantly more stretched than the others",
        f"{how}: {_percent(lengths[1])} longer at rest, stiff {_percent(lengths[0])}, isotropic {_percent(lengths[2])}",
        lengths[1] - 1.0 > STRETCHED * (max(lengths[0], lengths[2]) - 1.0),
    )
    swings = [
        late_oscillation(beam.swing, beam.swing.series.length) for beam in (stiff, pair[ANISOTROPIC], pair[ISOTROPIC])
    ]
    sizes = [swing.amplitude for swing in swings]
    series = pair[ANISOTROPIC].swing.series
    settled = time_to_settle(series.time, series.length, swings[1].middle)
    until = f"within a tenth after {settled:.1f} s" if math.isfinite(settled) else "beyond a tenth all the time"
    yield Finding(
        "it preserves its wobbly elastic behaviour along its main axis",
        f"{how}: past {LATE * series.time[-1]:.0f} s its length still swings by ±{100.0 * sizes[1]:.1f} % at "
        f"{swings[1].frequency:.2f} Hz, decaying at {swings[1].decay:.2f}/s ({until}); "
        f"stiff ±{100.0 * sizes[0]:.1f} %, isotropic ±{100.0 * sizes[2]:.2f} %",
        sizes[1] > WOBBLY * max(sizes[0], sizes[2]),
    )


def _limits_hold(pair: dict[str, Measured], how: str, trembling: str) -> Finding:
    """Whether every limit holds at rest; `trembling`: why not."""
    rests = [at_rest(pair[name].rest) for name in (ANISOTROPIC, ISOTROPIC)]
    hold = max(rest.strain_max for rest in rests) <= HELD
    shown = " and ".join(f"{rest.strain:.3f} (largest {rest.strain_max:.3f})" for rest in rests)
    return Finding(
        "0.96 < s < 1.04",
        f"{how}: strain/limit at rest {shown}, anisotropic and isotropic",
        hold,
        "" if hold else trembling,
    )


def _percent(ratio: float) -> str:
    return f"{100.0 * (ratio - 1.0):.2g} %"


def _group(figure: Picture, first: int, end: int, text: str) -> None:
    """A heading over the columns from `first` to before `end`."""
    from matplotlib.lines import Line2D

    left, right = LEFT + first * COLUMN, LEFT + end * COLUMN - 0.02
    figure.text(left, 0.965, text, weight="bold")
    figure.add_artist(Line2D([left, right], [0.957, 0.957], color=OUTLINE, linewidth=0.8))


def _hanging(figure: Picture, column: int, name: str, run: Run, top: float) -> None:
    """One beam at rest, where it was before, and what it is."""
    left = LEFT + column * COLUMN
    axes: Any = figure.add_axes((left - 0.222, 0.207, 0.6, 0.6 * SIZE[0] / SIZE[1]), projection="3d")
    axes.patch.set_alpha(0.0)
    _undeformed(axes, run.scene)
    draw_body(axes, run.points, run.mesh.surface, run.strain, top, VIEW)
    look(axes, (0.5, 0.1, -0.7), 2.95, VIEW)
    title, what = TITLES[PAPERS.get(name, name)]
    rest = at_rest(run)
    figure.text(left, 0.94, title, va="top", fontsize=11)
    text = f"{what}\nat rest: tip {rest.deflection:.2f} m down,\n{_percent(rest.length)} longer"
    figure.text(left, 0.912, text, va="top", linespacing=1.3)


def _undeformed(axes: Any, scene: Scene) -> None:
    """Outline of the beam before it was let go, and the wall that holds it."""
    from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection

    assert scene.mesh.beam is not None
    size = np.array(scene.mesh.beam.size)
    corners = np.array(list(itertools.product((0.0, 1.0), repeat=3)))
    edges = [(a, b) for a, b in itertools.combinations(corners, 2) if np.abs(a - b).sum() == 1.0]
    outline = Line3DCollection(np.array(edges) * size, colors=OUTLINE, linewidths=0.7, linestyles=(0, (3, 2)))
    outline.set_zorder(1)
    axes.add_collection3d(outline)
    (low, high) = -0.3, 1.3
    wall = np.array([(0.0, low, low), (0.0, high, low), (0.0, high, high), (0.0, low, high)]) * size
    axes.add_collection3d(
        Poly3DCollection([wall], facecolors=PLANE_COLOR, edgecolors=PLANE_EDGE, linewidths=0.8, zorder=0)
    )


def _curves(figure: Picture, result: Result) -> None:
    """Tip and length over the time of the swing."""
    grid = figure.add_gridspec(1, 2, left=0.065, right=0.985, bottom=0.165, top=0.395, wspace=0.14)
    tip, length = figure.add_subplot(grid[0]), figure.add_subplot(grid[1])
    for name, beam in result.beams.items():
        series, paper = beam.swing.series, PAPERS.get(name, name)
        line: Any = {"color": COLORS[paper], "linewidth": 1.2, "linestyle": "-" if name == paper else (0, (3, 1.5))}
        label = TITLES[paper][0] + ("" if name == paper else ", tensor")
        tip.plot(series.time, -series.deflection, label=label, **line)
        length.plot(series.time, series.length, **line)
    for axes, text in ((tip, "height of the tip [m]"), (length, "length / undeformed length")):
        axes.set(xlabel="time since let go [s]", ylabel=text, xlim=(0.0, series.time[-1]))
    figure.legend(*tip.get_legend_handles_labels(), ncols=5, loc="center", bbox_to_anchor=(0.5, 0.42), frameon=False)


def _caption(result: Result) -> str:
    small, patched = small_load(result.small), small_sag(result.patched)
    damping = result.small.swing.scene.material.damping.stiffness
    free = result.beams[ANISOTROPIC].swing
    swing = late_oscillation(free, free.series.length)
    return (
        "Beams of 1 × 0.2 × 0.2 m, 200 linear tetrahedra, 1000 kg/m³, ν 0.3, held at one end, let go straight under "
        f"gravity (dashed); dt {1e3 * free.scene.dt:.0f} ms, stiffness damping {1e3 * damping:.0f} ms.\n"
        f"At rest: with mass damping {REST_DAMPING:.0f}/s. Curves: without; past {LATE * free.series.time[-1]:.0f} s "
        f"the paper's anisotropic beam still swings along its axis by ±{100.0 * swing.amplitude:.1f} % at "
        f"{swing.frequency:.2f} Hz.\n"
        f"Locking: under a small load linear tetrahedra sag {small['sag_below_quadratic_percent']:.0f} % less than "
        f"quadratic ones on this mesh: {small['stiffness_over_quadratic']:.2f} times as stiff in bending,\n"
        f"{patched['stiffness_over_quadratic']:.2f} times with patches that share one volume strain. "
        "The fourth beam hangs lower: hyperbolic bounds shear between the free axis and the others, tensor does not."
    )
