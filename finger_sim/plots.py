"""The picture of a touch: commanded depth and contact force over time, the deformed finger at peak force."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .arrays import Floats
from .errors import FingerSimError, MissingExtraError
from .report import Moment, Recorded
from .scene import Plane

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SIZE = (11.0, 4.4)
"""Of the whole picture [inch]."""
DPI = 160
DEPTH, NORMAL, TANGENTIAL, GREY = "0.25", "#0b5394", "#d1730f", "0.45"
PLANE_COLOR, EDGE_COLOR, ARROW_COLOR = "#eef1f4", "#00000030", "#0b5394"
FACETS = 6000
"""Triangles drawn, about: each of the surface is divided until there are as many."""
LIGHT = np.array([-0.25, -0.55, 0.8]) / math.sqrt(0.25**2 + 0.55**2 + 0.8**2)
"""Direction to the light, in the plane's frame."""
AMBIENT = 0.62
"""Brightness of a facet turned away from the light; 1: no shading."""
VIEW = (15.0, -56.0)
"""Elevation over the plane and azimuth of the eye [degree]."""


def draw(recorded: Recorded, path: str | Path) -> Path:
    """Writes the picture of a recording as a PNG (or what else the name's end asks for) and returns its path.

    Raises MissingExtraError without matplotlib, FingerSimError when the file cannot be written.
    """
    figure = make_figure(recorded)
    try:
        figure.savefig(path, dpi=DPI)
    except (OSError, ValueError) as error:
        raise FingerSimError(f"{path}: the picture cannot be written: {error}") from None
    return Path(path)


def make_figure(recorded: Recorded) -> Figure:
    """The picture as a matplotlib figure, without a display. Raises MissingExtraError without matplotlib."""
    try:
        from matplotlib import rc_context
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError:
        raise MissingExtraError("drawing", "plot") from None
    style: Any = {"font.size": 10, "axes.spines.top": False, "axes.spines.right": False}
    with rc_context(style):
        figure = Figure(figsize=SIZE)
        FigureCanvasAgg(figure)
        left = figure.add_gridspec(2, 1, left=0.065, right=0.43, bottom=0.13, top=0.93, hspace=0.18)
        depth = figure.add_subplot(left[0])
        force = figure.add_subplot(left[1], sharex=depth)
        _depth(depth, recorded)
        _force(force, recorded)
        body = figure.add_axes((0.397, -0.12, 0.56, 1.2), projection="3d")
        _body(body, recorded.peak, recorded.plane)
        _caption(figure, recorded)
        _strain_bar(figure, recorded.peak)
    return figure


def _depth(axes: Axes, recorded: Recorded) -> None:
    axes.axhline(0.0, color=GREY, linewidth=0.8)
    axes.plot(recorded.command_time, 1e3 * recorded.depth, color=DEPTH, linewidth=1.3)
    axes.axvline(recorded.peak.time, color=GREY, linewidth=0.8, linestyle=(0, (2, 2)))
    axes.set_ylabel("commanded depth [mm]")
    axes.tick_params(labelbottom=False)


def _force(axes: Axes, recorded: Recorded) -> None:
    t = recorded.wrench_time
    axes.axvline(recorded.peak.time, color=GREY, linewidth=0.8, linestyle=(0, (2, 2)))
    axes.plot(t, recorded.normal, color=NORMAL, linewidth=1.3, label="normal")
    axes.plot(t, recorded.tangential, color=TANGENTIAL, linewidth=1.3, label="tangential")
    axes.set_xlim(min(0.0, float(recorded.command_time[0])), float(recorded.command_time[-1]))
    axes.set_ylim(min(0.0, 1.05 * float(recorded.normal.min())), 1.25 * max(0.1, float(recorded.force.max())))
    axes.set_xlabel("time [s]")
    axes.set_ylabel("contact force [N]")
    axes.legend(loc="upper left", ncols=2, frameon=False, handlelength=1.4, borderaxespad=0.1)


def _body(axes: Any, moment: Moment, plane: Plane | None) -> None:
    """The shaded surface, lengths in mm, in axes whose z is the plane's normal."""
    from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection

    frame, origin = _frame(plane), np.array((plane or Plane()).point)
    x = 1e3 * (moment.points - origin) @ frame.T
    forces = moment.forces @ frame.T
    low, high = x.min(axis=0), x.max(axis=0)
    centre, extent = 0.5 * (low + high), (high - low)
    eye = _eye()

    corners, values = _divided(x, moment.triangles), _divided(moment.strain, moment.triangles).mean(axis=1)
    normals = _divided(_node_normals(x, moment.triangles), moment.triangles).mean(axis=1)
    facing = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) @ eye
    seen = facing > 0.0
    brightness = AMBIENT + (1.0 - AMBIENT) * np.clip(normals @ LIGHT, 0.0, 1.0)
    colors = _color_map()(values / _top(moment.strain))
    colors[:, :3] *= brightness[:, None]
    body = Poly3DCollection(corners[seen], facecolors=colors[seen], edgecolors=colors[seen], linewidths=0.3)
    body.set_zorder(2)

    axes.computed_zorder = False
    if plane is not None:
        margin = 0.1 * float(extent.max())
        (x0, y0, _), (x1, y1, _) = low - margin, high + margin
        patch = [[(x0, y0, 0.0), (x1, y0, 0.0), (x1, y1, 0.0), (x0, y1, 0.0)]]
        ground = Poly3DCollection(patch, facecolors=PLANE_COLOR, edgecolors="#c9ced4", linewidths=0.8)
        ground.set_zorder(0)
        axes.add_collection3d(ground)
    axes.add_collection3d(body)
    edges = Line3DCollection(_front_edges(x, moment.triangles, eye), colors=EDGE_COLOR, linewidths=0.35)
    edges.set_zorder(3)
    axes.add_collection3d(edges)
    _arrows(axes, x, forces, extent)

    half = 0.5 * extent.max() * np.array([1.0, 1.0, 1.0])
    axes.set(
        xlim=(centre[0] - half[0], centre[0] + half[0]),
        ylim=(centre[1] - half[1], centre[1] + half[1]),
        zlim=(centre[2] - half[2], centre[2] + half[2]),
    )
    axes.set_box_aspect((1.0, 1.0, 1.0), zoom=1.34)
    axes.set_proj_type("persp", focal_length=4.0)
    axes.view_init(*VIEW)
    axes.set_axis_off()


def _arrows(axes: Any, x: Floats, forces: Floats, extent: Floats) -> None:
    """Contact forces as arrows, the largest a sixth of the body long."""
    size = np.linalg.norm(forces, axis=1)
    pressed = size > 0.02 * size.max(initial=0.0)
    if not pressed.any():
        return
    scale = 0.17 * float(extent.max()) / float(size.max())
    at, vector = x[pressed], scale * forces[pressed]
    style = {"color": ARROW_COLOR, "linewidth": 1.0, "arrow_length_ratio": 0.3, "pivot": "tip"}
    arrows = axes.quiver(*at.T, *vector.T, **style)
    arrows.set_zorder(4)


def _caption(figure: Figure, recorded: Recorded) -> None:
    """Says what is seen on the right."""
    moment = recorded.peak
    force = float(np.linalg.norm(moment.forces.sum(axis=0)))
    largest = float(np.linalg.norm(moment.forces, axis=1).max())
    text = f"at peak force: {force:.2g} N, {moment.time:.2f} s" if force > 0.0 else "no contact"
    figure.text(0.68, 0.86, text, ha="center", va="center")
    if largest > 0.0:
        arrows = f"arrows: contact force at each node, up to {largest:.2g} N"
        figure.text(0.68, 0.12, arrows, ha="center", va="center", fontsize=9, color=ARROW_COLOR)


def _strain_bar(figure: Figure, moment: Moment) -> None:
    """The colour bar, with the limit marked."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    top = _top(moment.strain)
    place = figure.add_axes((0.915, 0.22, 0.014, 0.56))
    bar = figure.colorbar(ScalarMappable(Normalize(0.0, top), _color_map()), cax=place)
    bar.set_label("strain / limit")
    bar.outline.set_linewidth(0.6)
    bar.ax.axhline(1.0, color="white", linewidth=1.6)
    bar.ax.axhline(1.0, color="black", linewidth=0.8)


def _top(strain: Floats) -> float:
    """Upper end of the colour scale: beyond the limit, and with room for the largest strain."""
    return max(1.2, math.ceil(10.0 * float(strain.max(initial=0.0))) / 10.0)


def _color_map() -> Any:
    from matplotlib import colormaps
    from matplotlib.colors import ListedColormap

    return ListedColormap(colormaps["magma_r"](np.linspace(0.03, 0.85, 256)))


def _frame(plane: Plane | None) -> Floats:
    """Rows (3, 3): two tangents and the normal of the plane, right-handed; if it lies flat, x y z."""
    normal = (plane or Plane()).unit_normal
    ahead = np.array([1.0, 0.0, 0.0]) if abs(normal[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    first = ahead - (ahead @ normal) * normal
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(normal, first), normal])


def _eye() -> Floats:
    """Direction to the eye, in the plane's frame."""
    elevation, azimuth = np.radians(VIEW)
    return np.array(
        [math.cos(elevation) * math.cos(azimuth), math.cos(elevation) * math.sin(azimuth), math.sin(elevation)]
    )


def _divided(at_nodes: Floats, triangles: Any) -> Floats:
    """Values at nodes (n, …) as the corners (m, 3, …) of triangles (k, 3) cut into smaller ones."""
    corners: Floats = at_nodes[triangles]
    while 4 * len(corners) <= FACETS:
        corners = _quartered(corners)
    return corners


def _node_normals(x: Floats, triangles: Any) -> Floats:
    """Unit normals of the surface at its nodes, zero inside. (n, 3)"""
    a, b, c = (x[triangles[:, i]] for i in range(3))
    normals = np.zeros_like(x)
    for corner in range(3):
        np.add.at(normals, triangles[:, corner], np.cross(b - a, c - a))
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.asarray(normals / np.maximum(length, 1e-300))


def _quartered(corners: Floats) -> Floats:
    """Each triangle (m, 3, …) cut into four at the middles of its edges: (4 m, 3, …)."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
    parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.concatenate([np.stack(part, axis=1) for part in parts])


def _front_edges(x: Floats, triangles: Any, eye: Floats) -> Floats:
    """Ends (m, 2, 3) of the edges of triangles that face the eye."""
    a, b, c = (x[triangles[:, i]] for i in range(3))
    front = triangles[np.cross(b - a, c - a) @ eye > 0.0]
    edges = np.unique(np.sort(front[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    return np.asarray(x[edges])
