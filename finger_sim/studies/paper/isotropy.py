"""Section 6: equal limits and the strain they allow, by direction; and rows where two singular values cross.

What is measured, and how: isotropy_measures.py.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ...arrays import Floats
from ...pictures.surfaces import AMBIENT, LIGHT, View, look, new_figure
from .figures import Finding, Meter
from .isotropy_measures import (
    CELLS,
    CORNERS,
    FINGER,
    FINGER_ISOTROPIC,
    GAPS,
    LEG,
    MIDDLE,
    PROJECTIONS,
    ROOM,
    SIDES,
    THIRD,
    Crossing,
    allowed_strains,
    crossing,
    directions,
    linear_rules,
    pass_points,
    path,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Picture

SIZE = (13.0, 8.0)
"""Of the picture [inch]."""
VIEW = View(24.0, -60.0)
TITLES = {
    "isotropic": "isotropic, Eq. 9–10",
    "hyperbolic": "hyperbolic, the paper’s",
    "tensor": "tensor, ours",
    "linear": "linear, Eq. 21–22",
    "orthogonal": "orthogonal, Eq. 19–20",
}
COLORS = {
    "isotropic": "black",
    "hyperbolic": "#0b5394",
    "tensor": "#2a7f4f",
    "linear": "#d1730f",
    "orthogonal": "0.55",
}
DASHES: dict[str, Any] = dict.fromkeys(PROJECTIONS, "-") | {"isotropic": (0, (1, 2)), "linear": (0, (5, 3))}
"""Where curves lie on each other, each is to be seen."""


@dataclass(frozen=True)
class Result:
    """All that the figure shows; strains as parts of ROOM."""

    directions: Floats  # (6, n, n, 3) unit vectors on the faces of a cube
    allowed: dict[str, dict[str, Floats]]  # by projection and side, (6, n, n)
    on_path: dict[str, dict[str, Floats]]  # the same along `path`, (k,)
    crossings: dict[str, Crossing]


def measure(progress: Meter, *, cells: int = CELLS) -> Result:
    """Search the allowed strain in every direction, then look at the crossing."""
    ways, (way, _) = directions(cells), path()
    total, done = len(PROJECTIONS) * (len(SIDES) + 1), itertools.count(1)
    allowed: dict[str, dict[str, Floats]] = {name: {} for name in PROJECTIONS}
    on_path: dict[str, dict[str, Floats]] = {name: {} for name in PROJECTIONS}
    crossings = {}
    for name in PROJECTIONS:
        for side in SIDES:
            allowed[name][side] = allowed_strains(name, ways, side)
            on_path[name][side] = allowed_strains(name, way, side)
            progress(next(done), total)
        crossings[name] = crossing(name)
        progress(next(done), total)
    return Result(ways, allowed, on_path, crossings)


def numbers(result: Result) -> dict[str, Any]:
    """What each projection allows, as parts of the limit, and what it does near a crossing."""
    halfway = linear_rules(path()[0][LEG])
    printed, ellipsoid = linear_rules(result.directions)
    return {
        "limits": [1.0 - ROOM, 1.0 + ROOM],
        "directions": result.directions[..., 0].size,
        "allowed_over_limit": {name: {side: _extremes(result, name, side) for side in SIDES} for name in PROJECTIONS},
        "crossing": {
            "limits": dict(zip(("stretch", "compress"), FINGER, strict=True)),
            "limits_isotropic": dict(zip(("stretch", "compress"), FINGER_ISOTROPIC, strict=True)),
            "stretches": [MIDDLE, MIDDLE, THIRD],
            "gaps": GAPS,
            **{name: _crossing_numbers(result.crossings[name]) for name in PROJECTIONS},
        },
        "linear_110": {"as_printed": float(halfway[0]), "ellipsoid": float(halfway[1])},
        "linear_largest_difference": float((printed - ellipsoid).max()),
    }


def _extremes(result: Result, name: str, side: str) -> dict[str, float]:
    allowed = result.allowed[name][side]
    at = {text: float(result.on_path[name][side][LEG * stop]) for text, stop in CORNERS.items()}
    return {"min": float(allowed.min()), "max": float(allowed.max())} | at


def _crossing_numbers(came: Crossing) -> dict[str, Any]:
    return {
        "value_jump": came.jump,
        "value_jump_nearest": float(came.jump[-1]),
        "gradient": came.gradient,
        "gradient_nearest": float(came.gradient[-1]),
        "gradient_exponent": came.exponent,
        "gradient_times_gap": float(came.gradient[-1] * GAPS[-1]),
    }


def findings(result: Result) -> list[Finding]:
    """The flaw that Section 6 admits, the other rules of Section 5.2, and what the paper does not speak of."""
    allowed = {name: _both(result, name) for name in PROJECTIONS}
    hyperbolic = result.on_path["hyperbolic"]["compress"]
    printed, ellipsoid = (float(limit) for limit in linear_rules(path()[0][LEG]))
    near = {name: _crossing_numbers(result.crossings[name]) for name in PROJECTIONS}
    singular, bounded = near["hyperbolic"], near["tensor"]
    return [
        Finding(
            paper="hyperbolic with equal limits: 1 + (s_min − 1) √2 in the worst case, at 45 degrees",
            measured=f"{hyperbolic[LEG]:.4f} times the limit halfway between two axes, {hyperbolic[2 * LEG]:.4f} along "
            "(1, 1, 1)",
            agrees=bool(allowed["hyperbolic"].max() < 1.001 * math.sqrt(2.0)),
            reason="45 degrees is the worst in a plane; in space it is halfway between three axes, √3",
        ),
        Finding(
            paper="in an isotropic scenario limits should not be scaled: they are the same for every direction",
            measured=", ".join(f"{name} {_span(allowed[name])}" for name in ("tensor", "isotropic", "linear")),
            agrees=bool(max(np.abs(allowed[name] - 1.0).max() for name in ("tensor", "isotropic", "linear")) < 1e-6),
        ),
        Finding(
            paper="orthogonal: no deformation is allowed along a principal axis orthogonal to a limited one",
            measured=f"{_span(allowed['orthogonal'])} times the limit, least along the axes, most along (1, 1, 1)",
            agrees=bool(max(result.on_path["orthogonal"][side][0] for side in SIDES) < 1e-6),
        ),
        Finding(
            paper="linear: the intersection of the principal axis with the ellipsoid of the limits, Eq. 21-22",
            measured="the finger's limits, halfway between e1 and e2: "
            f"Eq. 22 gives {printed:.4f}, the ellipsoid {ellipsoid:.4f}",
            agrees=abs(printed - ellipsoid) < 1e-6,
            reason="|diag(s) v| is not the ellipsoid's radius 1/|diag(1/s) v|, but where v lies along an axis or the "
            "limits are equal. With one limited axis j the first is ∞, the second s_max/|v_j|",
        ),
        Finding(
            paper="(what a limit does where two singular values cross is not spoken of)",
            measured=f"hyperbolic: its strain/limit jumps by {singular['value_jump_nearest']:.2f}, its gradient grows "
            f"as {singular['gradient_times_gap']:.3f}/gap (exponent {singular['gradient_exponent']:.2f}); "
            f"tensor: no jump ({bounded['value_jump_nearest']:.0e} at a gap of {GAPS[-1]:.0e}), its gradient stays "
            f"{result.crossings['tensor'].gradient.max():.2f}",
            agrees=None,
            reason="the gradient carries 1/(s_i² − s_k²) of ∂V/∂x, Eq. 16",
        ),
    ]


def _both(result: Result, name: str) -> Floats:
    return np.stack([result.allowed[name][side] for side in SIDES])


def _span(allowed: Floats) -> str:
    return f"{allowed.min():.4f}" if np.ptp(allowed) < 5e-5 else f"{allowed.min():.4f} to {allowed.max():.4f}"


def draw(result: Result) -> Picture:
    """The allowed strain as a surface for each projection; below, along a path, and what happens at a crossing."""
    figure = new_figure(*SIZE)
    from matplotlib import rc_context

    style: Any = {"font.size": 10, "axes.spines.top": False, "axes.spines.right": False}
    with rc_context(style):
        for index, name in enumerate(PROJECTIONS):
            _lobe(figure, 0.1 + 0.2 * index, result, name)
        _bar(figure)
        grid = figure.add_gridspec(1, 3, left=0.055, right=0.985, bottom=0.135, top=0.445, wspace=0.24)
        _path(figure.add_subplot(grid[0]), result)
        _passes(figure.add_subplot(grid[1]), result)
        _gradients(figure.add_subplot(grid[2]), result)
        figure.text(0.012, 0.012, _caption(), fontsize=8.5, color="0.3", va="bottom")
    return figure


def _lobe(figure: Picture, centre: float, result: Result, name: str) -> None:
    """One surface, its radius the allowed strain; a dashed circle where it ought to be."""
    from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection

    height = 0.44
    width = height * SIZE[1] / SIZE[0]
    axes: Any = figure.add_axes((centre - 0.5 * width, 0.5, width, height), projection="3d")
    axes.patch.set_visible(False)
    axes.computed_zorder = False
    radius = result.allowed[name]["stretch"]
    corners = _triangles(radius[..., None] * result.directions)
    normals = _normals(corners)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    colors = _color_map()(_scale()(np.linalg.norm(corners, axis=2).mean(axis=1)))
    colors[:, :3] *= (AMBIENT + (1.0 - AMBIENT) * np.clip(normals @ LIGHT, 0.0, 1.0))[:, None]
    axes.add_collection3d(Poly3DCollection(corners, facecolors=colors, edgecolors=colors, linewidths=0.2, zorder=1))
    axes.add_collection3d(Line3DCollection([_silhouette()], colors="black", linewidths=0.8, linestyles="--", zorder=2))
    look(axes, (0.0, 0.0, 0.0), 2.9, VIEW, zoom=1.2)
    span = _span(_both(result, name)).replace("0.0000 to", "0 to")
    figure.text(centre, 0.965, TITLES[name], ha="center", va="top", color=COLORS[name], fontsize=11)
    figure.text(centre, 0.93, f"{span} of the limit", ha="center", va="top", fontsize=9)


def _triangles(points: Floats) -> Floats:
    """Corners (k, 3, 3) of the triangles of points (6, n, n, 3), outward, cut along the diagonals of the faces."""
    a, b, c, d = points[:, :-1, :-1], points[:, 1:, :-1], points[:, 1:, 1:], points[:, :-1, 1:]
    cells = a.shape[1]
    first = np.arange(cells) < cells // 2
    along = (first[:, None] == first[None, :])[None, :, :, None, None]
    halves = [
        np.where(along, np.stack(p, 3), np.stack(q, 3)) for p, q in (((a, b, c), (a, b, d)), ((a, c, d), (b, c, d)))
    ]
    return np.concatenate([half.reshape(-1, 3, 3) for half in halves])


def _normals(corners: Floats) -> Floats:
    """Normals of triangles (k, 3, 3), twice their area long. (k, 3)"""
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def _silhouette() -> Floats:
    """The limit itself: a circle of radius 1 across the line of sight. (k, 3)"""
    eye = VIEW.eye
    right = np.cross([0.0, 0.0, 1.0], eye)
    right /= np.linalg.norm(right)
    angles = np.linspace(0.0, 2.0 * math.pi, 121)[:, None]
    return np.asarray(np.cos(angles) * right + np.sin(angles) * np.cross(eye, right))


def _bar(figure: Picture) -> None:
    """The colours, and what they mean."""
    from matplotlib.cm import ScalarMappable

    mappable = ScalarMappable(_scale(), _color_map())
    bar = figure.colorbar(mappable, cax=figure.add_axes((0.35, 0.525, 0.3, 0.012)), orientation="horizontal")
    bar.set_ticks([0.0, 0.5, 1.0, math.sqrt(2.0), math.sqrt(3.0)], labels=["0", "0.5", "1", "√2", "√3"])
    bar.outline.set_linewidth(0.6)
    figure.text(0.34, 0.531, "allowed strain / limit", ha="right", va="center", fontsize=9)


def _scale() -> Any:
    from matplotlib.colors import TwoSlopeNorm

    return TwoSlopeNorm(1.0, 0.0, math.sqrt(3.0))


def _color_map() -> Any:
    """Blue where less is allowed than asked for, grey where just that, red where more."""
    from matplotlib.colors import LinearSegmentedColormap

    return LinearSegmentedColormap.from_list("allowed", ["#2b6cb0", "#9cc3e6", "#e9e9e6", "#f0a58a", "#b3332e"])


def _path(axes: Axes, result: Result) -> None:
    """Allowed strain along great circles from e1 past the diagonals to e3."""
    _, angle = path()
    for name in reversed(PROJECTIONS):
        axes.plot(angle, result.on_path[name]["stretch"], color=COLORS[name], linestyle=DASHES[name], linewidth=1.6)
    axes.set_xticks(angle[::LEG], ["$e_1$", "(1,1,0)", "(1,1,1)", "$e_3$"])
    axes.set_yticks([0.0, 0.5, 1.0, math.sqrt(2.0), math.sqrt(3.0)], ["0", "0.5", "1", "√2", "√3"])
    axes.grid(color="0.88", linewidth=0.6)
    axes.set(xlim=(0.0, angle[-1]), ylim=(0.0, 1.85), xlabel="direction of strain", ylabel="allowed strain / limit")
    axes.set_title("allowed strain, equal limits", fontsize=10, loc="left")
    middle = angle[2 * LEG]
    axes.text(middle, 1.755, "hyperbolic", color=COLORS["hyperbolic"], ha="center", va="bottom", fontsize=9)
    axes.text(middle, 0.6, "orthogonal", color=COLORS["orthogonal"], ha="center", va="bottom", fontsize=9)
    axes.text(0.25, 0.93, "tensor, isotropic, linear", color=COLORS["tensor"], ha="left", va="top", fontsize=9)


def _passes(axes: Axes, result: Result) -> None:
    """strain/limit as the crossing is passed; nearer and nearer for the paper's and ours."""
    t = 100.0 * pass_points()
    axes.axhline(1.0, color="0.88", linewidth=0.6)
    for name in reversed(PROJECTIONS):
        passes = result.crossings[name].passes
        if name in ("hyperbolic", "tensor"):
            for values, dashes in zip(passes, ((0, (1, 1.5)), (0, (4, 2)), "-"), strict=True):
                axes.plot(t, values, color=COLORS[name], linewidth=1.4, linestyle=dashes)
        else:
            axes.plot(t, passes[-1], color=COLORS[name], linewidth=0.9)
    axes.set(xlim=(t[0], t[-1]), ylim=(0.2, 3.4), xlabel="$t$ [%]")
    axes.set_ylabel("strain / limit, worst row")
    axes.set_title("two stretches cross (δ 1 % dotted, 0.1 % dashed, 0.01 %)", fontsize=10, loc="left")
    places = {
        "orthogonal": (-1.4, 2.78),
        "hyperbolic": (-1.4, 2.17),
        "tensor": (-1.4, 1.2),
        "isotropic": (-0.6, 0.93),
        "linear": (-1.4, 0.5),
    }
    for name, (x, y) in places.items():
        axes.text(x, y, name, color=COLORS[name], ha="center", va="center", fontsize=9)


def _gradients(axes: Axes, result: Result) -> None:
    """Largest gradient of the worst row against the gap."""
    for name in reversed(PROJECTIONS):
        axes.loglog(GAPS, result.crossings[name].gradient, color=COLORS[name], linestyle=DASHES[name], linewidth=1.6)
    axes.set(xlim=(GAPS[-1], GAPS[0]), ylim=(0.3, 2e5), xlabel="gap between the two stretches")
    axes.set_ylabel("|∂C/∂F| of the worst row")
    axes.set_title("gradient, largest at that gap", fontsize=10, loc="left")
    for name, gap, height in (("linear", 1e-4, 2.2e3), ("hyperbolic", 1.3e-6, 60.0), ("orthogonal", 1.3e-6, 18.0)):
        text = f"{name}: {result.crossings[name].gradient[-1] * GAPS[-1]:.3f} / gap"
        axes.text(gap, height, text, color=COLORS[name], fontsize=9)
    axes.text(1.3e-6, 1.4, "tensor, isotropic: 1", color=COLORS["tensor"], fontsize=9)


def _caption() -> str:
    return (
        f"Above and left: F = I + ε d dᵀ, limits 1 ± {ROOM:g} on every axis (compressed: the same); radius and colour "
        f"are the largest ε, over {ROOM:g}; dashed circle: the limit.\n"
        f"Middle and right: U = {MIDDLE:g} I + [[t, δ], [δ, −t]] and {THIRD:g} across, in axes turned against the "
        "material's; the finger’s limits 0.95–1.05, 0.75–1.25, 0.98–1.02 (isotropic: 0.95–1.05)."
    )
