"""The solid finger: tets through skin and bones, with nodes along the bones. The paper's pictures have this one.

One half is meshed, by gmsh, and mirrored. Its bone is the nodes that lie inside the phalanges, so it is smaller than
the bone that is meant, the more so the coarser the mesh is: see `finger_mesh` for a finger with the bones' surface.
Lengths are millimetres; the mesh is in metres.
"""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import Floats
from ..errors import MeshError
from .finger_shape import BONE, BONE_TIP, CAP, CUT, DIP, PIP, SKIN, inside_bone
from .gmsh_session import gmsh_session, tetrahedra
from .mesh import TetMesh

SOLID_TETS, FEWEST_TETS = 347, 250
TETS_TOLERANCE = 0.05  # largest relative difference between the tets asked for and those made
MIN_DIHEDRAL = math.radians(15.0)  # of a finger as generated; 10 degrees is promised
_GMSH = {
    "Mesh.Algorithm": 6,  # frontal Delaunay
    "Mesh.Algorithm3D": 1,  # Delaunay, keeps embedded points
}


def solid_finger(tets: int = SOLID_TETS) -> TetMesh:
    """Last 7 cm of a finger in about `tets` tets (within 5 %), finest in the pad of the fingertip.

    Node sets: `base`, the cut face; `bone`, the nodes inside the phalanges and those of the base. The same
    gmsh makes the same mesh every time. Raises MissingExtraError without gmsh, MeshError when no mesh of that
    many tets has every dihedral angle of 15 degrees or more.
    """
    if not tets >= FEWEST_TETS or int(tets) != tets:
        raise MeshError(f"finger tets: got {tets!r}, allowed: a whole number >= {FEWEST_TETS}")
    with gmsh_session(_GMSH) as gmsh:
        size = 4.0 * (SOLID_TETS / tets) ** 0.4
        for _ in range(3):
            made = 2 * len(_half_finger(gmsh, size)[1])
            size *= (made / tets) ** 0.4
        for nudge in sorted(np.arange(-40, 41) * 0.005, key=abs):
            points, half = _half_finger(gmsh, size * (1.0 + nudge))
            if abs(2 * len(half) - tets) > TETS_TOLERANCE * tets:
                continue
            mesh = _mirrored(points, half)
            if mesh.min_dihedral_angles.min() >= MIN_DIHEDRAL:
                return mesh
    raise MeshError(f"finger tets: found no good mesh of {tets}; ask for another number")


def _mirrored(points: Floats, half: NDArray[np.int64]) -> TetMesh:
    """The whole finger of its half at z >= 0 (`points` in mm), with its node sets."""
    beside = np.flatnonzero(points[:, 2] > 0.0)
    image = np.arange(len(points))
    image[beside] = len(points) + np.arange(len(beside))
    x = np.concatenate([points, points[beside] * [1.0, 1.0, -1.0]])
    tets = np.concatenate([half, image[half][:, [1, 0, 2, 3]]])
    base = np.flatnonzero(x[:, 0] == CUT)
    bone = np.union1d(base, np.flatnonzero(inside_bone(x)))
    return TetMesh.from_arrays(1e-3 * x, tets, {"base": base, "bone": bone})


def _half_finger(gmsh: Any, size: float) -> tuple[Floats, NDArray[np.int64]]:
    """Nodes (n, 3) [mm] and tets (T, 4) of the half at z >= 0, edges of about `size` [mm] in the pad."""
    gmsh.model.remove()
    gmsh.model.add("finger_sim")
    occ, mesh = gmsh.model.occ, gmsh.model.mesh
    along = np.concatenate([np.linspace(-1.0, 0.0, 24)[:-1], np.linspace(0.0, 1.0, 15)])
    across = np.linspace(-1.0, 1.0, 25)
    grid = SKIN.grid(along[:, None], across[None, :])
    poles = [occ.addPoint(*grid[i, j]) for j in range(len(across)) for i in range(len(along))]
    skin = occ.addBSplineSurface(poles, len(along))
    occ.remove([(0, pole) for pole in poles])
    occ.synchronize()

    # The skin's four edges: the rim of the cut face, then pad, tip and nail side in the plane z = 0.
    edges = {edge: gmsh.model.getBoundary([(1, edge)]) for _, edge in gmsh.model.getEntities(1)}
    rim, *_, front = sorted(edges, key=lambda edge: float(occ.getCenterOfMass(1, edge)[0]))
    seam = occ.addLine(*(vertex for _, vertex in edges[rim]))
    cut = occ.addPlaneSurface([occ.addCurveLoop([rim, seam])])
    middle = occ.addPlaneSurface([occ.addCurveLoop([*(edge for edge in edges if edge != rim), seam])])
    body = occ.addVolume([occ.addSurfaceLoop([skin, cut, middle])])
    axis, sides = _bone_points(size)
    at_joints = SKIN.grid((np.array([DIP, PIP]) - CAP) / (CAP - CUT), np.zeros(2))
    widest = [gmsh.model.getClosestPoint(2, skin, p)[0] for p in at_joints]
    on_axis, beside, on_skin = ([occ.addPoint(*p) for p in points] for points in (axis, sides, widest))
    occ.synchronize()
    mesh.embed(0, on_skin, 2, skin)
    mesh.embed(0, on_axis, 2, middle)
    mesh.embed(0, beside, 3, body)

    # An even number of edges over the front puts a node on the very tip.
    mesh.setTransfiniteCurve(front, 1 + 2 * math.ceil(0.5 * occ.getMass(1, front) / (1.15 * size)))
    mesh.setSizeCallback(lambda dim, tag, x, y, z, given: size * _coarseness(x, y))
    mesh.generate(3)
    points, tets, _ = tetrahedra(gmsh)
    points[np.abs(points[:, 2]) < 1e-6, 2] = 0.0
    points[np.abs(points[:, 0] - CUT) < 1e-6, 0] = CUT
    return points, tets


def _bone_points(size: float) -> tuple[list[Floats], list[Floats]]:
    """Nodes that the half mesh must have: the bones' axis in z = 0, and their sides where wide [mm]."""
    axis, sides = [], []
    for head, foot in itertools.pairwise((BONE_TIP, DIP, PIP, CUT)):
        spacing = size * _coarseness(0.5 * (head + foot), 0.0)
        for x in np.linspace(head, foot, max(2, math.ceil((head - foot) / spacing)) + 1)[:-1]:
            centre, _, half_breadth = BONE.section(x)
            axis.append(np.array([x, centre, 0.0]))
            if 0.9 * half_breadth > 0.62 * size * _coarseness(float(x), float(centre)):
                sides.append(np.array([x, centre, 0.9 * half_breadth]))
    return axis, sides


def _coarseness(x: float, y: float) -> float:
    """Edge length at (x, y) [mm] over that in the pad: grows towards the cut face and towards the nail."""
    return min(1.0 + 0.085 * max(0.0, -6.0 - x) + 0.08 * max(0.0, y + 1.0), 3.0)
