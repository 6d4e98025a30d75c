"""Mesh generators: the paper's beam, and a parametric finger with its bones.

Frame of the finger: x (e1) to the tip, y (e2) up to the nail, z (e3) across; the origin lies inside the
distal bone, above the pad. The finger is straight, so the material axes are x y z everywhere. It is its own
mirror image in z = 0: one half is meshed, by gmsh, and mirrored.

Lengths in this file's anatomy are millimetres; meshes are in metres.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import PchipInterpolator

from finger_sim.errors import MeshError, MissingExtraError
from finger_sim.scene.mesh import TetMesh

Floats = NDArray[np.float64]

FINGER_TETS, FEWEST_TETS = 347, 250
TETS_TOLERANCE = 0.05  # largest relative difference between the tets asked for and those made
MIN_DIHEDRAL = math.radians(15.0)  # of a finger as generated; 10 degrees is promised

# x of the tip, of the bone's tip, of the two joints and of the cut face [mm]
TIP, BONE_TIP, DIP, PIP, CUT = 11.6, 7.8, -8.0, -30.4, -58.4
CAP = 2.0  # x where the rounded fingertip begins [mm]

# Skin: x, y of the pad side, y of the nail side, half breadth [mm].
_SKIN = np.array(
    [
        [CUT, -4.6, 11.6, 9.3],
        [-45.0, -4.5, 11.2, 9.0],
        [PIP, -5.1, 10.5, 10.0],
        [-19.0, -5.0, 8.3, 8.7],
        [DIP, -6.1, 6.8, 8.4],
        [-2.0, -7.0, 5.0, 8.2],
        [2.5, -7.5, 4.4, 8.0],
        [TIP, -6.8, 3.4, 7.6],
    ]
)
# Bone, of elliptic cross-section: x, y of its centre, half breadth, half depth [mm].
_BONE = np.array(
    [
        [CUT, 3.9, 4.5, 4.0],
        [-46.0, 3.6, 3.5, 3.0],
        [-34.0, 3.3, 4.5, 3.5],
        [PIP, 3.0, 5.5, 4.0],
        [-27.0, 2.6, 5.0, 3.5],
        [-19.0, 1.6, 2.5, 2.3],
        [-11.0, 0.6, 4.0, 2.8],
        [DIP, 0.1, 5.5, 3.0],
        [-5.5, -0.2, 5.0, 2.7],
        [0.0, -0.5, 2.25, 1.9],
        [5.0, -0.6, 3.75, 1.6],
        [BONE_TIP, -0.6, 3.0, 1.3],
    ]
)
_skin = PchipInterpolator(_SKIN[:, 0], _SKIN[:, 1:])
_bone = PchipInterpolator(_BONE[:, 0], _BONE[:, 1:])
_SQUARENESS = {"pad": 2.4, "nail": 2.7}  # exponents of the superelliptic cross-section; 2 is an ellipse

_TETRA = 4  # gmsh's number for a 4-node tetrahedron
_GMSH_OPTIONS = {
    "General.Terminal": 0,
    "General.NumThreads": 1,
    "Mesh.Algorithm": 6,  # frontal Delaunay
    "Mesh.Algorithm3D": 1,  # Delaunay, keeps embedded points
    "Mesh.MeshSizeExtendFromBoundary": 0,
    "Mesh.MeshSizeFromPoints": 0,
    "Mesh.MeshSizeFromCurvature": 0,
    "Mesh.Optimize": 1,
    "Mesh.OptimizeThreshold": 0.5,
}

# A cube's corners are numbered i + 2 j + 4 k; its five tets, positive, the middle one last.
_CUBE = np.array([[1, 0, 2, 4], [1, 3, 7, 2], [1, 5, 4, 7], [2, 6, 7, 4], [1, 2, 7, 4]])


def beam(size: Sequence[float] = (1.0, 0.2, 0.2), cells: Sequence[int] = (10, 2, 2)) -> TetMesh:
    """Box of `size` [m] along x y z with a corner at the origin, in `cells` bricks of five tets each.

    Neighbouring bricks are mirrored so that their faces match. Node sets: `base` (x = 0) and `tip`.
    Raises MeshError when a size is not positive or a cell count is not a whole number of 1 or more.
    """
    if len(size) != 3 or not all(math.isfinite(s) and s > 0.0 for s in size):
        raise MeshError(f"beam size: got {size!r}, allowed: three lengths > 0 m")
    if len(cells) != 3 or not all(int(c) == c and c >= 1 for c in cells):
        raise MeshError(f"beam cells: got {cells!r}, allowed: three whole numbers >= 1")
    nx, ny, nz = (int(c) for c in cells)
    ticks = (np.linspace(0.0, s, n + 1) for s, n in zip(size, (nx, ny, nz), strict=True))
    points = np.stack(np.meshgrid(*ticks, indexing="ij"), axis=-1).reshape(-1, 3)

    corner = np.arange(8)
    tets = []
    for cell in itertools.product(range(nx), range(ny), range(nz)):
        i, j, k = (c + (corner >> axis & 1) for axis, c in enumerate(cell))
        node = (i * (ny + 1) + j) * (nz + 1) + k
        tets.append(node[_CUBE] if sum(cell) % 2 == 0 else node[_CUBE ^ 1][:, [1, 0, 2, 3]])
    x = points[:, 0]
    ends = {"base": np.flatnonzero(x == 0.0), "tip": np.flatnonzero(x == x[-1])}
    return TetMesh.from_arrays(points, np.concatenate(tets), ends)


def finger(tets: int = FINGER_TETS) -> TetMesh:
    """Last 7 cm of a finger in about `tets` tets (within 5 %), finest in the pad of the fingertip.

    Node sets: `base`, the cut face; `bone`, the nodes inside the phalanges and those of the base. The same
    gmsh makes the same mesh every time. Raises MissingExtraError without gmsh, MeshError when no mesh of that
    many tets has every dihedral angle of 15 degrees or more.
    """
    if int(tets) != tets or tets < FEWEST_TETS:
        raise MeshError(f"finger tets: got {tets!r}, allowed: a whole number >= {FEWEST_TETS}")
    with _gmsh_session() as gmsh:
        size = 4.0 * (FINGER_TETS / tets) ** 0.4
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


def write_mesh(
    kind: str,
    out: str | Path,
    *,
    tets: int = FINGER_TETS,
    size: Sequence[float] = (1.0, 0.2, 0.2),
    cells: Sequence[int] = (10, 2, 2),
) -> TetMesh:
    """Make the mesh of `kind`, "finger" (of `tets`) or "beam" (of `size` and `cells`), and write it to `out`.

    Raises MeshError on another kind, on arguments that `finger` or `beam` refuse, and when `out` is not .vtu.
    """
    if kind not in ("finger", "beam"):
        raise MeshError(f"mesh kind: got {kind!r}, allowed: finger, beam")
    mesh = finger(tets) if kind == "finger" else beam(size, cells)
    mesh.save(out)
    return mesh


def inside_bone(points: ArrayLike) -> NDArray[np.bool_]:
    """Which of `points` (n, 3) [mm] lie inside the bones of the finger, (n,)."""
    x, y, z = np.asarray(points, dtype=np.float64).T
    centre, half_breadth, half_depth = _bone(np.clip(x, CUT, BONE_TIP)).T
    inside: NDArray[np.bool_] = np.logical_and(
        np.hypot((y - centre) / half_depth, z / half_breadth) <= 1.0, x <= BONE_TIP + 1e-6
    )
    return inside


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
    grid = _skin_points(along[:, None], across[None, :])
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
    at_joints = _skin_points((np.array([DIP, PIP]) - CAP) / (CAP - CUT), np.zeros(2))
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
    tags, flat, _ = mesh.getNodes()
    points = np.asarray(flat, dtype=np.float64).reshape(-1, 3)
    _, nodes = mesh.getElementsByType(_TETRA)
    order = np.argsort(tags)
    used, tets = np.unique(order[np.searchsorted(tags, nodes, sorter=order)], return_inverse=True)
    points = points[used]
    points[np.abs(points[:, 2]) < 1e-6, 2] = 0.0
    points[np.abs(points[:, 0] - CUT) < 1e-6, 0] = CUT
    return points, tets.reshape(-1, 4)


def _skin_points(along: Floats, across: Floats) -> Floats:
    """Points of the half skin [mm]; `along` -1 (cut) to 0 (cap) to 1 (tip), `across` -1 (pad) to 1 (nail).

    The shaft is a half cylinder, the cap a quarter sphere over the elliptical map of a square to a disc;
    cross-sections are then made superelliptic and scaled to the finger's outline.
    """
    u, v = np.sin(0.5 * np.pi * np.clip(along, 0.0, 1.0)), np.sin(0.5 * np.pi * across)
    forward, up = u * np.sqrt(1.0 - 0.5 * v**2), v * np.sqrt(1.0 - 0.5 * u**2)
    side = np.sqrt((1.0 - u**2) * (1.0 - v**2))
    x = np.where(along < 0.0, CAP + along * (CAP - CUT), CAP + forward * (TIP - CAP))

    exponent = np.where(up > 0.0, _SQUARENESS["nail"], _SQUARENESS["pad"])
    radius = np.maximum(np.hypot(up, side), 1e-12)
    norm = (np.abs(up / radius) ** exponent + np.abs(side / radius) ** exponent) ** (1.0 / exponent)
    stretch = 1.0 / np.where(norm > 0.0, norm, 1.0)
    up, side = up * stretch, side * stretch
    pad, nail, half_breadth = np.moveaxis(_skin(x), -1, 0)
    widest = pad + 0.5 * (nail - pad)
    y = widest + up * np.where(up > 0.0, nail - widest, widest - pad)
    return np.stack([x, y, half_breadth * side], axis=-1)


def _bone_points(size: float) -> tuple[list[Floats], list[Floats]]:
    """Nodes that the half mesh must have: the bones' axis in z = 0, and their sides where wide [mm]."""
    axis, sides = [], []
    for head, foot in itertools.pairwise((BONE_TIP, DIP, PIP, CUT)):
        spacing = size * _coarseness(0.5 * (head + foot), 0.0)
        for x in np.linspace(head, foot, max(2, math.ceil((head - foot) / spacing)) + 1)[:-1]:
            centre, half_breadth, _ = _bone(x)
            axis.append(np.array([x, centre, 0.0]))
            if 0.9 * half_breadth > 0.62 * size * _coarseness(x, centre):
                sides.append(np.array([x, centre, 0.9 * half_breadth]))
    return axis, sides


def _coarseness(x: float, y: float) -> float:
    """Edge length at (x, y) [mm] over that in the pad: grows towards the cut face and towards the nail."""
    return min(1.0 + 0.085 * max(0.0, -6.0 - x) + 0.08 * max(0.0, y + 1.0), 3.0)


@contextmanager
def _gmsh_session() -> Iterator[Any]:
    """gmsh, started and set up; closed at the end unless it was in use before."""
    try:
        import gmsh
    except (ImportError, OSError) as error:
        raise MissingExtraError("making a finger mesh", "mesh") from error
    in_use = gmsh.isInitialized()
    if not in_use:
        gmsh.initialize(interruptible=False)
    gmsh.model.add("finger_sim")
    try:
        for name, value in _GMSH_OPTIONS.items():
            gmsh.option.setNumber(name, value)
        yield gmsh
    finally:
        gmsh.model.mesh.removeSizeCallback()
        gmsh.model.remove()
        if not in_use:
            gmsh.finalize()
