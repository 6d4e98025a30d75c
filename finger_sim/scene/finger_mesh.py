"""The parametric finger in tets: the soft part alone, between the skin and the surface of the bones.

One half is meshed by gmsh, at z >= 0, between two spline surfaces; its nodes are then put on skin and bone exactly.
Edges that would leave a single layer of tets between pad and bone, or a tet without a free node, are cut in two, and
nodes are moved until no angle is narrow. The half is then mirrored. Lengths are millimetres; the mesh is in metres.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import Floats
from ..errors import MeshError
from .finger_shape import BONE, BONE_TIP, CUT, DISTAL_CUT, SKIN, Surface, in_nail, in_pad
from .gmsh_session import gmsh_session, tetrahedra
from .mesh import FACES, TetMesh
from .mesh_improvement import Indices, cut_edges, edges_of, narrowest, widened

Mask = NDArray[np.bool_]

FINGER_TETS, FEWEST_TETS = 900, 450
TETS_TOLERANCE = 0.05  # largest relative difference between the tets asked for and those made
MIN_DIHEDRAL = math.radians(12.0)  # of a finger as generated
AIM_DIHEDRAL = math.radians(18.0)  # of one that is taken without looking for a better one
_WIDENED = math.radians(20.0)  # nodes of tets with narrower angles are moved
_NUDGES = sorted(np.arange(-20, 21) * 0.008, key=abs)  # changes of size that are tried, nearest first
_ROUNDS = 6  # times that edges are cut; two are usual

_AT_1000 = 2.0  # edge [mm] where tets are finest, of 1,000, to begin with
_LONGEST = 14.4  # edge [mm]: a quarter of the way around the skin
_LONGEST_TO_ROOT = 10.0  # longest edge over the root of the finest [mm^0.5]: far away, refining gains less

_BONE_TIP, _AT_BONE_TIP = (BONE_TIP, -0.6, 0.0), 3.0  # longest edge at the bone's tip [mm], which is 3 mm thick

_FILLED_FROM, _FILLED_FROM_DISTAL = 1500, 900  # tets from which Netgen fills the inside; fewer serve better on the skin
_GMSH = {
    "Mesh.Algorithm": 1,  # MeshAdapt, which alone copes with a coarse bone tip
    "Mesh.Algorithm3D": 1,  # Delaunay
}
_FLAT = 1e-6  # z of the middle of an edge in z = 0 [mm]
_POLES_ACROSS = 25
_POLES_APART = 1.5  # along the shaft [mm]: the bones' waists are 10 mm long
_POLES_OF_CAP = 15


@dataclass(frozen=True)
class Finest:
    """Where tets are finest [mm]: about the middle in x and z, and below in y."""

    x: float
    half_x: float
    below: float
    half_z: float
    growth: float
    """Of the edge length, for each mm away from there, over the finest."""

    def away(self, x: float, y: float, z: float) -> float:
        """Distance of a place from there [mm]."""
        return math.hypot(
            max(0.0, abs(x - self.x) - self.half_x), max(0.0, y - self.below), max(0.0, abs(z) - self.half_z)
        )


PAD = Finest(x=3.7, half_x=5.5, below=-3.0, half_z=6.75, growth=0.27)
"""Of all fingers: where a press is felt, on the pad as on its side and near the tip.

Of some hundred choices tried at 800 to 1,100 tets, the one whose answers at rest (studies/at_rest.py) came nearest to
those that converged.
"""


@dataclass(frozen=True)
class _Half:
    """The half at z >= 0: nodes (n, 3) [mm], tets (T, 4) in VTK's order, and which nodes lie on what, (n,)."""

    points: Floats
    tets: Indices
    skin: Mask
    bone: Mask
    cut: Mask
    middle: Mask  # z = 0

    @property
    def pad(self) -> Mask:
        return self.skin & in_pad(self.points)

    @property
    def driven(self) -> Mask:
        """Nodes of bone, cut face and nail: more than any scene drives."""
        return self.bone | self.cut | (self.skin & in_nail(self.points))

    def allowed(self, node: int, tried: Floats) -> Floats:
        """Places for a node near those tried: on all surfaces that it lies on."""
        places = tried.copy()
        if self.middle[node]:
            places[:, 2] = 0.0
        if self.cut[node]:
            places[:, 0] = self.points[node, 0]
        if self.skin[node]:
            places = SKIN.nearby(places)
        if self.bone[node]:
            places = BONE.nearby(places)
        return places


def finger(tets: int = FINGER_TETS, *, distal: bool = False, finest: Finest = PAD) -> TetMesh:
    """Last 7 cm of a finger, or with `distal` the last 28 mm, in about `tets` tets (within 5 %), finest as told.

    The bones are a hole. Node sets: `base`, the cut face; `bone`, the surface of the bones and the cut face; `pad`,
    what a plane can touch of the fingertip's palmar skin; `nail`, the skin below the nail plate; `bone_nail`, bone and
    nail. The same gmsh makes the same mesh every time. Raises MissingExtraError without gmsh, MeshError when there is
    no mesh of that many tets with every dihedral angle of 12 degrees or more.
    """
    if not tets >= FEWEST_TETS or int(tets) != tets:
        raise MeshError(f"finger tets: got {tets!r}, allowed: a whole number >= {FEWEST_TETS}")
    cut = DISTAL_CUT if distal else CUT
    options = _GMSH | {"Mesh.OptimizeNetgen": int(tets >= (_FILLED_FROM_DISTAL if distal else _FILLED_FROM))}
    best, widest = None, MIN_DIHEDRAL
    with gmsh_session(options) as gmsh:
        size = _AT_1000 * (1000.0 / tets) ** 0.4
        for _ in range(4):
            half = _half(gmsh, size, finest, cut)
            size *= 0.99 if half is None else (2 * len(half.tets) / tets) ** 0.4
        for nudge in _NUDGES:
            half = _half(gmsh, size * (1.0 + nudge), finest, cut)
            if half is None or abs(2 * len(half.tets) - tets) > TETS_TOLERANCE * tets or not _is_sound(half):
                continue
            angle = float(narrowest(half.points[half.tets]).min())
            if angle >= widest:
                best, widest = half, angle
            if angle >= AIM_DIHEDRAL:
                break
    if best is None:
        raise MeshError(f"finger tets: found no good mesh of {tets}; ask for another number")
    return _mirrored(best)


def _half(gmsh: Any, size: float, finest: Finest, cut: float) -> _Half | None:
    """The improved half with edges of about `size` [mm] in the pad; None where gmsh cannot fill it at that size."""
    surfaces = _surfaces(gmsh, size, cut)
    gmsh.model.mesh.setSizeCallback(lambda dim, tag, x, y, z, given: _edge_length(size, finest, x, y, z))
    try:
        gmsh.model.mesh.generate(3)
    except Exception:  # gmsh has no kind of its own: coarse triangles of two surfaces may pass through each other
        return None
    points, tets, (skin, bone, face, middle) = tetrahedra(gmsh, surfaces)
    if len(tets) == 0:
        return None
    points[middle, 2], points[face, 0] = 0.0, cut
    points[skin], points[bone] = SKIN.nearby(points[skin]), BONE.nearby(points[bone])
    return _improved(_Half(points, tets, skin, bone, face, middle))


def _is_sound(half: _Half) -> bool:
    """Whether each tet has a free node, and pad and bone are two layers apart."""
    return not (half.driven[half.tets].all(axis=1).any() or _edges_to_cut(half))


def _mirrored(half: _Half) -> TetMesh:
    """The whole finger with its node sets."""
    beside = np.flatnonzero(half.points[:, 2] > 0.0)
    image = np.arange(len(half.points))
    image[beside] = len(image) + np.arange(len(beside))
    x = np.concatenate([half.points, half.points[beside] * [1.0, 1.0, -1.0]])
    tets = np.concatenate([half.tets, image[half.tets][:, [1, 0, 2, 3]]])
    skin, bone, cut = (np.concatenate([on, on[beside]]) for on in (half.skin, half.bone, half.cut))
    masks = {"base": cut, "bone": bone | cut, "pad": skin & in_pad(x), "nail": skin & in_nail(x)}
    masks["bone_nail"] = masks["bone"] | masks["nail"]
    return TetMesh.from_arrays(1e-3 * x, tets, {name: np.flatnonzero(mask) for name, mask in masks.items()})


def _improved(half: _Half) -> _Half:
    """The half with two layers in the pad, no tet without a free node, and wide angles."""
    for _ in range(_ROUNDS):
        half = replace(half, points=widened(half.points, half.tets, half.allowed, _WIDENED))
        edges = _edges_to_cut(half)
        if not edges:
            break
        half = _cut(half, edges)
    return half


def _cut(half: _Half, edges: set[tuple[int, int]]) -> _Half:
    """The half with inner edges cut in two; a new node lies in a plane where both ends do, on no surface."""
    points, tets, ends = cut_edges(half.points, half.tets, edges)
    inside = np.zeros(len(ends), dtype=np.bool_)
    skin, bone = (np.concatenate([on, inside]) for on in (half.skin, half.bone))
    cut, middle = (np.concatenate([on, on[ends].all(axis=1)]) for on in (half.cut, half.middle))
    return _Half(points, tets, skin, bone, cut, middle)


def _edges_to_cut(half: _Half) -> set[tuple[int, int]]:
    """Edges from pad to bone, and the longest inner edge of each tet that has no free node."""
    a, b = edges_of(half.tets).T
    pad = half.pad
    across = (pad[a] & half.bone[b]) | (pad[b] & half.bone[a])
    edges = {(int(i), int(j)) for i, j in zip(a[across], b[across], strict=True)}
    outer = _edges_of_surfaces(half)
    for tet in half.tets[half.driven[half.tets].all(axis=1)].tolist():
        inner = set(itertools.combinations(sorted(tet), 2)) - outer
        if inner and not inner & edges:
            edges.add(max(inner, key=lambda e: (float(np.linalg.norm(half.points[e[0]] - half.points[e[1]])), e)))
    return edges


def _edges_of_surfaces(half: _Half) -> set[tuple[int, int]]:
    """Edges of the triangles on skin, bone and cut face."""
    faces, count = np.unique(np.sort(half.tets[:, FACES].reshape(-1, 3), axis=1), axis=0, return_counts=True)
    outer = faces[(count == 1) & ~half.middle[faces].all(axis=1)]
    return {edge for face in outer.tolist() for edge in itertools.combinations(face, 2)}


def _surfaces(gmsh: Any, size: float, cut: float) -> tuple[tuple[int, ...], ...]:
    """A new model of the half: its skin, bone, cut face and the face in z = 0; `size` of the edges in the pad [mm].

    The bone is in two parts, below and above its side: on one part, a coarse mesh would have edges from below to above
    that lie in z = 0, where the other half has them too, and the bone would be closed there.
    """
    gmsh.model.remove()
    gmsh.model.add("finger_sim")
    occ, mesh = gmsh.model.occ, gmsh.model.mesh
    skin = _spline_surface(occ, SKIN, cut, -1.0, 1.0)
    halves = [(2, _spline_surface(occ, BONE, cut, *part)) for part in ((-1.0, 0.0), (0.0, 1.0))]
    (_, below), (_, above) = occ.fragment(halves[:1], halves[1:])[0]
    occ.synchronize()
    skin_rim, skin_tip, (skin_pad, skin_nail) = _edges_around(gmsh, skin)
    rim_below, tip_below, (bone_pad,) = _edges_around(gmsh, below)
    rim_above, tip_above, (bone_nail,) = _edges_around(gmsh, above)
    (low, high), (bone_low, _), (_, bone_high) = (_ends(gmsh, rim) for rim in (skin_rim, rim_below, rim_above))
    pad_seam, nail_seam = occ.addLine(low, bone_low), occ.addLine(high, bone_high)
    face = occ.addPlaneSurface([occ.addCurveLoop([skin_rim, nail_seam, rim_above, rim_below, pad_seam])])
    around = [skin_pad, skin_tip, skin_nail, nail_seam, bone_nail, tip_above, tip_below, bone_pad, pad_seam]
    middle = occ.addPlaneSurface([occ.addCurveLoop(around)])
    occ.addVolume([occ.addSurfaceLoop([skin, below, above, face, middle])])
    occ.synchronize()

    # An even number of edges over the front puts a node on the very tip.
    mesh.setTransfiniteCurve(skin_tip, 1 + 2 * math.ceil(0.5 * occ.getMass(1, skin_tip) / (1.15 * size)))
    return (skin,), (below, above), (face,), (middle,)


def _edge_length(size: float, finest: Finest, x: float, y: float, z: float) -> float:
    """Edge length at a place [mm]: `size` in the finest part, more with the way from there."""
    from_bone_tip = math.dist((x, y, z), _BONE_TIP)
    longest = min(_LONGEST, _LONGEST_TO_ROOT * math.sqrt(size))
    return min(size * (1.0 + finest.growth * finest.away(x, y, z)), longest, _AT_BONE_TIP + 0.4 * from_bone_tip)


def _spline_surface(occ: Any, surface: Surface, cut: float, low: float, high: float) -> int:
    """Half of a surface, `low` to `high` across, as one spline; a hair inside of it where it is round."""
    of_shaft = 1 + math.ceil((surface.cap - cut) / _POLES_APART)
    along = np.concatenate([np.linspace(-1.0, 0.0, of_shaft)[:-1], np.linspace(0.0, 1.0, _POLES_OF_CAP)])
    across = np.linspace(low, high, _POLES_ACROSS)
    grid = surface.grid(along[:, None], across[None, :], cut)
    poles = [occ.addPoint(*grid[i, j]) for j in range(len(across)) for i in range(len(along))]
    tag: int = occ.addBSplineSurface(poles, len(along))
    occ.remove([(0, pole) for pole in poles])
    return tag


def _edges_around(gmsh: Any, surface: int) -> tuple[int, int, list[int]]:
    """Its edges: the rim of the cut face; in the plane z = 0, that of the tip, and those along it, the lower first."""
    centres = {
        edge: gmsh.model.occ.getCenterOfMass(1, edge)
        for _, edge in gmsh.model.getBoundary([(2, surface)], oriented=False)
    }
    rim = min(centres, key=lambda edge: float(centres[edge][0]))
    flat = [edge for edge in centres if edge != rim and abs(centres[edge][2]) < _FLAT]
    *sides, tip = sorted(flat, key=lambda edge: float(centres[edge][0]))
    return rim, tip, sorted(sides, key=lambda edge: float(centres[edge][1]))


def _ends(gmsh: Any, edge: int) -> list[int]:
    """Points at the ends of an edge, the lower one first."""
    points = [point for _, point in gmsh.model.getBoundary([(1, edge)], oriented=False)]
    return sorted(points, key=lambda point: float(gmsh.model.getValue(0, point, [])[1]))
