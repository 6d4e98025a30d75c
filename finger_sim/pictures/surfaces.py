"""Shaded pictures of a deformed body: its surface to scale, coloured by strain/limit. Drawn without a display."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..arrays import Floats
from ..errors import FingerSimError, MissingExtraError
from ..plain import whole_file

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DPI = 160
PLANE_COLOR, PLANE_EDGE, EDGE_COLOR = "#eef1f4", "#c9ced4", "#00000030"
FACETS = 6000
"""Triangles drawn, about: each of the surface is divided until there are as many."""
LIGHT = np.array([-0.25, -0.55, 0.8]) / math.sqrt(0.25**2 + 0.55**2 + 0.8**2)
"""Direction to the light, in the axes of the picture."""
AMBIENT = 0.62
"""Brightness of a facet turned away from the light; 1: no shading."""


@dataclass(frozen=True)
class View:
    """Where the eye is: elevation over the x-y plane and azimuth about z [degree]; z is up in the picture."""

    elevation: float = 15.0
    azimuth: float = -56.0

    @property
    def eye(self) -> Floats:
        """Unit vector to the eye. (3,)"""
        e, a = math.radians(self.elevation), math.radians(self.azimuth)
        return np.array([math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e)])


def new_figure(width: float, height: float) -> Figure:
    """An empty picture of that size [inch]. Raises MissingExtraError without matplotlib."""
    try:
        import matplotlib  # noqa: F401
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError:
        raise MissingExtraError("drawing", "plot") from None
    figure = Figure(figsize=(width, height))
    FigureCanvasAgg(figure)
    return figure


def save(figure: Figure, path: str | Path) -> Path:
    """Writes a picture as what its name's end asks for. Raises FingerSimError when the file cannot be written."""
    try:
        with whole_file(path) as file:
            figure.savefig(file, dpi=DPI)
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise FingerSimError(f"{path}: the picture cannot be written: {reason}") from None
    return Path(path)


def draw_body(axes: Any, points: Floats, triangles: Any, strain: Floats, top: float, view: View) -> None:
    """The surface `triangles` (k, 3) of a body with nodes `points` (n, 3), shaded and coloured.

    axes: of matplotlib's 3-D projection; z up. strain (n,) strain/limit at the nodes, `top` the end of its scale.
    """
    from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection

    corners, values = _divided(points, triangles), _divided(strain, triangles).mean(axis=1)
    normals = _divided(_node_normals(points, triangles), triangles).mean(axis=1)
    facing = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) @ view.eye
    seen = facing > 0.0
    brightness = AMBIENT + (1.0 - AMBIENT) * np.clip(normals @ LIGHT, 0.0, 1.0)
    colors = color_map()(values / top)
    colors[:, :3] *= brightness[:, None]
    body = Poly3DCollection(corners[seen], facecolors=colors[seen], edgecolors=colors[seen], linewidths=0.3)
    body.set_zorder(2)
    edges = Line3DCollection(_front_edges(points, triangles, view.eye), colors=EDGE_COLOR, linewidths=0.35)
    edges.set_zorder(3)
    axes.computed_zorder = False
    axes.add_collection3d(body)
    axes.add_collection3d(edges)


def draw_ground(axes: Any, low: Any, high: Any, height: float = 0.0) -> None:
    """A patch of the plane z = height, from (x, y) `low` to `high`, behind all else."""
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    (x0, y0), (x1, y1) = low, high
    patch = [[(x0, y0, height), (x1, y0, height), (x1, y1, height), (x0, y1, height)]]
    ground = Poly3DCollection(patch, facecolors=PLANE_COLOR, edgecolors=PLANE_EDGE, linewidths=0.8)
    ground.set_zorder(0)
    axes.computed_zorder = False
    axes.add_collection3d(ground)


def look(axes: Any, centre: Any, extent: float, view: View, zoom: float = 1.34) -> None:
    """Point the camera: a cube of edge `extent` about `centre`, equal axes, no frame. Same arguments: same scale."""
    x, y, z = centre
    half = 0.5 * extent
    axes.set(xlim=(x - half, x + half), ylim=(y - half, y + half), zlim=(z - half, z + half))
    axes.set_box_aspect((1.0, 1.0, 1.0), zoom=zoom)
    axes.set_proj_type("persp", focal_length=4.0)
    axes.view_init(view.elevation, view.azimuth)
    axes.set_axis_off()


def strain_bar(figure: Figure, place: tuple[float, float, float, float], top: float) -> None:
    """A colour bar of strain/limit at `place` (left, bottom, width, height; parts of the picture), the limit marked."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    bar = figure.colorbar(ScalarMappable(Normalize(0.0, top), color_map()), cax=figure.add_axes(place))
    bar.set_label("strain / limit")
    bar.outline.set_linewidth(0.6)
    bar.ax.axhline(1.0, color="white", linewidth=1.6)
    bar.ax.axhline(1.0, color="black", linewidth=0.8)


def top_of(strain: Floats) -> float:
    """Upper end of a colour scale: beyond the limit, and with room for the largest strain."""
    return max(1.2, math.ceil(10.0 * float(strain.max(initial=0.0))) / 10.0)


def color_map() -> Any:
    """Colours of strain/limit, from none to `top`."""
    from matplotlib import colormaps
    from matplotlib.colors import ListedColormap

    return ListedColormap(colormaps["magma_r"](np.linspace(0.03, 0.85, 256)))


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
