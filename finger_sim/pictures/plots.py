"""The picture of a touch: commanded depth and contact force over time, the deformed finger at peak force."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..arrays import Floats
from ..scene import Plane
from .report import Moment, Recorded
from .surfaces import View, draw_body, draw_ground, look, new_figure, save, strain_bar, top_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SIZE = (11.0, 4.4)
"""Of the whole picture [inch]."""
DEPTH, NORMAL, TANGENTIAL, GREY = "0.25", "#0b5394", "#d1730f", "0.45"
ARROW_COLOR = "#0b5394"
VIEW = View()


def draw(recorded: Recorded, path: str | Path) -> Path:
    """Writes the picture of a recording as a PNG (or what else the name's end asks for) and returns its path.

    Raises MissingExtraError without matplotlib, FingerSimError when the file cannot be written.
    """
    return save(make_figure(recorded), path)


def make_figure(recorded: Recorded) -> Figure:
    """The picture as a matplotlib figure, without a display. Raises MissingExtraError without matplotlib."""
    figure = new_figure(*SIZE)
    from matplotlib import rc_context

    style: Any = {"font.size": 10, "axes.spines.top": False, "axes.spines.right": False}
    with rc_context(style):
        left = figure.add_gridspec(2, 1, left=0.065, right=0.43, bottom=0.13, top=0.93, hspace=0.18)
        depth = figure.add_subplot(left[0])
        force = figure.add_subplot(left[1], sharex=depth)
        _depth(depth, recorded)
        _force(force, recorded)
        body = figure.add_axes((0.397, -0.12, 0.56, 1.2), projection="3d")
        _body(body, recorded.peak, recorded.plane)
        _caption(figure, recorded)
        strain_bar(figure, (0.915, 0.22, 0.014, 0.56), top_of(recorded.peak.strain))
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
    frame, origin = _frame(plane), np.array((plane or Plane()).point)
    x = 1e3 * (moment.points - origin) @ frame.T
    low, high = x.min(axis=0), x.max(axis=0)
    extent = high - low
    if plane is not None:
        margin = 0.1 * float(extent.max())
        draw_ground(axes, low[:2] - margin, high[:2] + margin)
    draw_body(axes, x, moment.triangles, moment.strain, top_of(moment.strain), VIEW)
    _arrows(axes, x, moment.forces @ frame.T, extent)
    look(axes, 0.5 * (low + high), float(extent.max()), VIEW)


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


def _frame(plane: Plane | None) -> Floats:
    """Rows (3, 3): two tangents and the normal of the plane, right-handed; if it lies flat, x y z."""
    normal = (plane or Plane()).unit_normal
    ahead = np.array([1.0, 0.0, 0.0]) if abs(normal[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    first = ahead - (ahead @ normal) * normal
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(normal, first), normal])
