"""Bodies held on facets, one part of them moved: the force that moves it is the answer of each.

Held is what a facet of three held nodes spans, not single nodes: so a finer mesh of the same body poses the same
problem, and the linear and the quadratic element answer one question.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import meshio
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

YOUNG = 14e3
"""Of every problem [Pa]; the answers are proportional to it."""
POISSONS = (0.3, 0.45, 0.49)

TOUCH = 1e-9
"""Points so near to a plane lie on it [m]."""

FACETS = np.array([[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]])
EDGES = np.array([[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]])
FIVE = np.array([[0, 3, 5, 6], [1, 0, 3, 5], [2, 3, 0, 6], [4, 5, 6, 0], [7, 6, 5, 3]])
"""Tetrahedra of a cube whose corner i + 2 j + 4 k lies at (i, j, k); its mirror image is the neighbours'."""


@dataclass(frozen=True)
class Hold:
    """Facets that are held, (f, 3) node indices, and where to."""

    facets: Ints
    displacement: Callable[[Floats], Floats]  # of points at rest (k, 3) [m] → (k, 3) [m]; NaN: free along that axis
    driven: bool = True  # by a bone or a plate that always holds these nodes; a finger's pad is free but for the dent

    @property
    def nodes(self) -> Ints:
        """Those of the facets, sorted. (k,)"""
        return np.unique(self.facets)


@dataclass(frozen=True)
class Problem:
    """A body at rest, what holds it, and the axis along which the last hold's force is the answer.

    Where holds meet the later one counts.
    """

    name: str
    points: Floats  # (n, 3) [m]
    tets: Ints  # (T, 4)
    holds: tuple[Hold, ...]
    axis: Floats  # (3,) the answer is the force times it: a unit vector, longer where a part stands for the whole

    def prescribed(self) -> tuple[Ints, Floats]:
        """Held nodes (k,) and their displacements (k, 3) [m], NaN where free; the last hold's come last."""
        given = np.full_like(self.points, np.nan)
        for hold in self.holds:
            own = hold.displacement(self.points[hold.nodes])
            given[hold.nodes] = np.where(np.isfinite(own), own, given[hold.nodes])
        last = self.holds[-1].nodes
        others = np.setdiff1d(np.concatenate([hold.nodes for hold in self.holds]), last)
        nodes = np.concatenate([others, last])
        return nodes, given[nodes]

    def driven(self) -> NDArray[np.bool_]:
        """Nodes that are held along all axes, but for those of holds that are not `driven`. (n,)"""
        nodes, given = replace(self, holds=tuple(hold for hold in self.holds if hold.driven)).prescribed()
        flags = np.zeros(len(self.points), bool)
        flags[nodes] = np.isfinite(given).all(1)
        return flags

    def answer(self, forces: Floats) -> float:
        """Force [N] on the last hold along the axis, of the forces at `prescribed` nodes (k, 3) [N]."""
        return float(forces[-len(self.holds[-1].nodes) :].sum(0) @ self.axis)

    def refined(self) -> Problem:
        """The same problem, each tetrahedron cut into eight and each facet into four at the middles of the edges."""
        edges = np.unique(np.sort(self.tets[:, EDGES].reshape(-1, 2), axis=1), axis=0)
        codes = edges @ [len(self.points), 1]

        def middle(a: Ints, b: Ints) -> Ints:
            return len(self.points) + np.searchsorted(codes, np.minimum(a, b) * len(self.points) + np.maximum(a, b))

        a, b, c, d = self.tets.T
        ab, ac, ad, bc, bd, cd = (middle(*self.tets[:, pair].T) for pair in EDGES)
        # Of the inner octahedron's three diagonals the one from ab to cd.
        corners = [(a, ab, ac, ad), (ab, b, bc, bd), (ac, bc, c, cd), (ad, bd, cd, d)]
        inner = [(ab, cd, ac, ad), (ab, cd, ad, bd), (ab, cd, bd, bc), (ab, cd, bc, ac)]
        tets = np.stack([np.stack(nodes, axis=1) for nodes in [*corners, *inner]], axis=1).reshape(-1, 4)

        def cut(facets: Ints) -> Ints:
            a, b, c = facets.T
            ab, ac, bc = middle(a, b), middle(a, c), middle(b, c)
            parts = [(a, ab, ac), (ab, b, bc), (ac, bc, c), (ab, bc, ac)]
            return np.stack([np.stack(nodes, axis=1) for nodes in parts], axis=1).reshape(-1, 3)

        points = np.concatenate([self.points, self.points[edges].mean(1)])
        holds = tuple(replace(hold, facets=cut(hold.facets)) for hold in self.holds)
        return replace(self, points=points, tets=tets, holds=holds)


def boundary(tets: Ints) -> Ints:
    """Facets that only one tetrahedron has. (f, 3), sorted node indices"""
    facets, counts = np.unique(np.sort(tets[:, FACETS].reshape(-1, 3), axis=1), axis=0, return_counts=True)
    return facets[counts == 1]


def of_nodes(facets: Ints, chosen: NDArray[np.bool_]) -> Ints:
    """Facets all of whose nodes are chosen, `chosen` (n,)."""
    return facets[chosen[facets].all(1)]


def cubes(x: Floats, y: Floats, z: Floats) -> tuple[Floats, Ints]:
    """Points (n, 3) and tetrahedra (T, 4), five a cell, of a box of cells between the given coordinates."""
    shape = (len(x), len(y), len(z))
    points = np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1).reshape(-1, 3)
    number = np.arange(len(points)).reshape(shape)
    cells = np.stack(np.meshgrid(*(np.arange(n - 1) for n in shape), indexing="ij"), axis=-1).reshape(-1, 3)
    corners = np.array([[i, j, k] for k in range(2) for j in range(2) for i in range(2)])
    odd = cells.sum(1) % 2
    # The mirror image along x.
    places = cells[:, None] + np.where(odd[:, None, None], corners ^ [1, 0, 0], corners)
    return points, number[tuple(np.moveaxis(places, -1, 0))][:, FIVE].reshape(-1, 4)


def moved(*displacement: float) -> Callable[[Floats], Floats]:
    """The same displacement [m] everywhere."""
    return lambda points: np.tile(displacement, (len(points), 1))


def even(n: int) -> Floats:
    """n + 1 numbers from 0 to 1, evenly apart."""
    return np.linspace(0.0, 1.0, n + 1)


def block(n: int = 4) -> Problem:
    """20 × 20 × 10 mm between plates it sticks to, pressed by 0.1 mm. n × n × n/2 cubes: 160 tetrahedra at 4."""
    points, tets = cubes(20e-3 * even(n), 20e-3 * even(n), 10e-3 * even(n // 2))
    facets, z = boundary(tets), points[:, 2]
    holds = (
        Hold(of_nodes(facets, z < TOUCH), moved(0.0, 0.0, 0.0)),
        Hold(of_nodes(facets, z > 10e-3 - TOUCH), moved(0.0, 0.0, -1e-4)),
    )
    return Problem("block", points, tets, holds, np.array([0.0, 0.0, -1.0]))


def cook(n: int = 8) -> Problem:
    """Cook's membrane, 48 × (44 to 16) × 12 mm, stuck on its left. n × n × n/4 cells.

    Its right face is moved up by 1 mm and free to go right, left and to the sides.
    """
    return cook_of(even(n), even(n), even(n // 4))


def cook_of(s: Floats, t: Floats, w: Floats, *, half: bool = False) -> Problem:
    """Cook's membrane with cells between s, t, w, all 0 to 1: to the right, up, through the thickness.

    `half`: w is from the middle plane, of symmetry, to a side.
    """
    unit, tets = cubes(s, t, w)
    s, t, w = unit.T
    points = 1e-3 * np.stack([48.0 * s, 44.0 * s + t * (44.0 - 28.0 * s), (6.0 if half else 12.0) * w], axis=1)
    facets = boundary(tets)
    holds = [
        Hold(of_nodes(facets, s == 0.0), moved(0.0, 0.0, 0.0)),
        Hold(of_nodes(facets, s == 1.0), moved(np.nan, 1e-3, np.nan)),
    ]
    if half:
        holds.insert(0, Hold(of_nodes(facets, w == 0.0), moved(np.nan, np.nan, 0.0)))
    return Problem("cook", points, tets, tuple(holds), np.array([0.0, 2.0 if half else 1.0, 0.0]))


def cantilever(n: int = 2) -> Problem:
    """100 × 10 × 10 mm, stuck at one end. 10 n × n × n cubes.

    The other end's face is moved up by 1 mm and free to go along and to the sides.
    """
    points, tets = cubes(100e-3 * even(10 * n), 10e-3 * even(n), 10e-3 * even(n))
    facets, x = boundary(tets), points[:, 0]
    holds = (
        Hold(of_nodes(facets, x < TOUCH), moved(0.0, 0.0, 0.0)),
        Hold(of_nodes(facets, x > 100e-3 - TOUCH), moved(np.nan, 1e-3, np.nan)),
    )
    return Problem("cantilever", points, tets, holds, np.array([0.0, 1.0, 0.0]))


DENT_CENTRE, DENT_RADIUS, DENT_DEPTH = 2.5e-3, 4e-3, 1e-3
PAD_BELOW = -4e-3
"""The pad's skin lies below it [m]."""


def dent(points: Floats) -> Floats:
    """Paraboloid, 1 mm deep at the middle of the pad, upwards; to the sides it stays. (k, 3) [m]"""
    r2 = ((points[:, 0] - DENT_CENTRE) ** 2 + points[:, 2] ** 2) / DENT_RADIUS**2
    return np.stack([np.zeros_like(r2), DENT_DEPTH * (1.0 - r2), np.zeros_like(r2)], axis=1)


def finger(path: Path) -> Problem:
    """A shipped finger: its bone fixed, a smooth dent pressed into the pad.

    A solid finger's bone is what tetrahedra and facets of four or three driven nodes span.
    """
    mesh = meshio.read(path)
    points, tets = mesh.points.astype(float), mesh.cells_dict["tetra"].astype(np.int64)
    driven = (mesh.point_data["bone"] > 0.5) | (mesh.point_data["base"] > 0.5)
    skin = boundary(tets)
    r2 = ((points[:, 0] - DENT_CENTRE) ** 2 + points[:, 2] ** 2) / DENT_RADIUS**2
    pad = (r2 < 1.0) & (points[:, 1] < PAD_BELOW) & ~driven
    facets = np.unique(np.sort(tets[:, FACETS].reshape(-1, 3), axis=1), axis=0)
    holds = (Hold(of_nodes(facets, driven), moved(0.0, 0.0, 0.0)), Hold(of_nodes(skin, pad), dent, driven=False))
    return Problem(Path(path).stem, points, tets, holds, np.array([0.0, 1.0, 0.0]))
