"""Tetrahedral meshes: nodes, tets, surface, node sets and material axes, checked before they are simulated.

Orientation. A tet with nodes x1..x4 is positive when det(D_m) > 0, where D_m = (x1 - x4, x2 - x4, x3 - x4)
in columns. VTK's order has the other sign (there det(x2 - x1, x3 - x1, x4 - x1) > 0), so the two conventions
differ by one swap of nodes: `load` accepts both, `save` writes VTK's.
"""

from __future__ import annotations

import dataclasses
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any

import meshio
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from finger_sim.errors import MeshError
from finger_sim.plain import whole_file
from finger_sim.scene import mesh_files
from finger_sim.scene.mesh_failures import REMEDIES

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

# Faces of a positive tet, counter-clockwise seen from outside.
FACES = np.array([[0, 2, 3], [1, 0, 3], [2, 1, 3], [0, 1, 2]])
_EDGES = np.array([[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]])

DEGENERATE = 1e-6  # 6 V / (longest edge)^3 at or below which a tet counts as flat; a regular tet has 0.71
LONGEST, SHORTEST = 1.5, 1e-3  # of a finger, or the paper's beam of 1 m [m]; a fingertip in millimetres has 20
LISTED = 30  # node sets that an error lists
TOO_FAR = 1e100  # coordinate from which on a point counts as not finite: the cube of a length must be [m]
COINCIDENT = 1e-9  # distance / mesh diagonal at or below which two nodes count as one
ORTHONORMAL = 1e-5  # largest entry of A A^T - I of material axes; leaves room for axes stored as float32


@dataclass(frozen=True, eq=False)
class TetMesh:
    """A checked tet mesh at rest; build it with `from_arrays` or `load`. Every array is read-only.

    points:    (n, 3) float64, node positions in mesh coordinates [m]
    tets:      (T, 4) int32, positively oriented: det(x1 - x4, x2 - x4, x3 - x4) > 0
    surface:   (k, 3) int32, boundary triangles, counter-clockwise seen from outside
    node_sets: name -> (m,) int32, sorted node indices
    axes:      (T, 3, 3) float64, row k of axes[t] is the material axis e_{k+1} of tet t in mesh coordinates
    notes:     what the user should know about the file that it was read from; none where it was not
    """

    points: Floats
    tets: Ints
    surface: Ints
    node_sets: Mapping[str, Ints]
    axes: Floats
    notes: tuple[str, ...] = ()

    @classmethod
    def from_arrays(
        cls,
        points: ArrayLike,
        tets: ArrayLike,
        node_sets: Mapping[str, ArrayLike] | None = None,
        axes: ArrayLike | None = None,
    ) -> TetMesh:
        """Mesh of `points` (n, 3) [m] and `tets` (T, 4), all of one orientation, either one.

        `node_sets` maps names to node indices; `axes` is (T, 3, 3) or (T, 9), identity when left out. Nothing is
        renumbered or left out, so that arrays of the caller's still fit the mesh.
        Raises MeshError that names every defect, its count and what to do about it.
        """
        x = _array(points, (3,), "points", np.float64)
        t = _array(tets, (4,), "tets", np.int64)
        if len(t) == 0:
            raise MeshError("no tets: the mesh has no 4-node tetrahedra")
        if len(x) == 0:
            raise MeshError("no points")
        a = np.broadcast_to(np.eye(3), (len(t), 3, 3)) if axes is None else np.asarray(axes, dtype=np.float64)
        if a.size != 9 * len(t) or a.shape[0] != len(t):
            raise MeshError(f"axes: expected 9 numbers for each of {len(t)} tets, got shape {a.shape}")
        a = a.reshape(-1, 3, 3)
        given = (node_sets or {}).items()
        sets = {name: _array(nodes, (), f"node set {name!r}", np.int64) for name, nodes in given}

        defects = [*_defects(x, t), *_axes_defects(a), *_node_set_defects(sets, len(x))]
        if defects:
            raise MeshError("; ".join(defects))
        if _dets(x, t)[0] < 0.0:
            t = t[:, [1, 0, 2, 3]]
        return cls(
            points=_frozen(x),
            tets=_frozen(t.astype(np.int32)),
            surface=_frozen(_boundary(t).astype(np.int32)),
            node_sets=MappingProxyType({k: _frozen(np.unique(v).astype(np.int32)) for k, v in sets.items()}),
            axes=_frozen(a),
        )

    @classmethod
    def load(cls, path: str | Path, scale: float = 1.0) -> TetMesh:
        """Mesh of a file of any format that meshio reads, or Abaqus, its lengths times `scale` in metres.

        Its tets are taken, those of higher order by their corners; nodes that no tet has are left out, and points,
        lines and surface cells ignored. Node sets are those of the file, the nodes of its named or numbered cells
        (see mesh_sets.py), and point or cell data of zeros and ones; cell data `axes` (9 numbers a tet, row by row)
        are the material axes. What was left out is told in `notes`.
        Raises MeshError naming the file and what is wrong with it.
        """
        path, left_out = Path(path), ""
        try:
            read = mesh_files.read(path)
            left_out = (
                f". Numbers count from 0 without what was left out: {'; '.join(read.notes)}" if read.notes else ""
            )
            axes = None if read.axes is None else read.axes[0]
            mesh = cls.from_arrays(scale * read.points, read.solids[0][1], read.node_sets, axes)
        except MeshError as error:
            raise MeshError(f"{path}: {error}{left_out}") from error.__cause__
        return dataclasses.replace(mesh, notes=(*read.notes, *mesh._doubts(path)))

    def node_set(self, name: str) -> Ints:
        """Indices of the nodes of a set: of that name, or the only one of that name in other letters, BONE for bone.

        Raises MeshError that says which sets there are, and how to make one.
        """
        alike = [own for own in self.node_sets if own.casefold() == name.casefold()]
        if name in self.node_sets or len(alike) == 1:
            return self.node_sets[name if name in self.node_sets else alike[0]]
        if alike:
            raise MeshError(f"no node set is named {name!r}, but {' and '.join(alike)} are: write one as it is there")
        sets = sorted(self.node_sets)
        more = f", … ({len(sets)} in all)" if len(sets) > LISTED else ""
        raise MeshError(
            f"no node set is named {name!r}; there are: {', '.join(sets[:LISTED]) or 'none'}{more}. To make one: "
            f'in gmsh Physical Surface("{name}") = {{…}} beside a Physical Volume, in Abaqus *NSET, NSET={name}, '
            f"in other files point data {name} of zeros and ones"
        )

    def _doubts(self, path: Path) -> list[str]:
        """What makes the lengths doubtful, and the command that mends them."""
        length = float(np.ptp(self.points, axis=0).max())
        if SHORTEST <= length <= LONGEST:
            return []
        command = f"finger_sim mesh convert {shlex.quote(str(path))} -o {shlex.quote(path.stem)}_in_m.vtu --scale"
        mend = f"{command} 0.001 for millimetres, 0.01 for centimetres" if length > LONGEST else f"{command} 1000"
        return [f"it is {length:.3g} m long, as lengths are taken for metres; if they are in another unit: {mend}"]

    def save(self, path: str | Path) -> None:
        """Write a VTU file in VTK's node order, node sets as point data, axes as cell data `axes`.

        Raises MeshError when `path` does not end in .vtu or cannot be written.
        """
        path = Path(path)
        if path.suffix != ".vtu":
            raise MeshError(f"{path}: meshes are written as .vtu")
        masks = {name: np.zeros(len(self.points), dtype=np.uint8) for name in self.node_sets}
        for name, nodes in self.node_sets.items():
            masks[name][nodes] = 1
        mesh = meshio.Mesh(
            self.points,
            [("tetra", self.tets[:, [1, 0, 2, 3]])],
            point_data=masks,
            cell_data={"axes": [self.axes.reshape(-1, 9)]},
        )
        try:
            with whole_file(path) as file:
                meshio.write(file, mesh, file_format="vtu", binary=True, compression="zlib")
        except OSError as error:
            raise MeshError(f"{path}: cannot be written: {error.strerror}") from error

    @cached_property
    def volumes(self) -> Floats:
        """Volume of each tet, (T,) [m^3]."""
        return _frozen(_dets(self.points, self.tets) / 6.0)

    @cached_property
    def min_dihedral_angles(self) -> Floats:
        """Smallest of the six angles between the faces of each tet, (T,) [rad]; 1.23 in a regular tet."""
        x = self.points[self.tets[:, FACES]]
        n = np.cross(x[:, :, 1] - x[:, :, 0], x[:, :, 2] - x[:, :, 0])
        n /= np.linalg.norm(n, axis=2, keepdims=True)
        cos = -np.einsum("tek,tek->te", n[:, _EDGES[:, 0]], n[:, _EDGES[:, 1]])
        return _frozen(np.arccos(np.clip(cos, -1.0, 1.0)).min(axis=1))

    @cached_property
    def edges(self) -> Ints:
        """Each edge once, (E, 2), lower node first."""
        return _frozen(np.unique(np.sort(self.tets[:, _EDGES].reshape(-1, 2), axis=1), axis=0))

    def summary(self) -> dict[str, str]:
        """What the mesh holds, name -> text with unit, in the order to print it."""
        low, high = self.points.min(axis=0), self.points.max(axis=0)
        lengths = np.linalg.norm(np.diff(self.points[self.edges], axis=1)[:, 0], axis=1)
        identity = np.allclose(self.axes, np.eye(3), rtol=0.0, atol=ORTHONORMAL)
        return {
            "tets": str(len(self.tets)),
            "nodes": f"{len(self.points)}, {len(np.unique(self.surface))} on the surface",
            "surface triangles": str(len(self.surface)),
            **{f"node set {name}": f"{len(nodes)} nodes" for name, nodes in self.node_sets.items()},
            "size": " × ".join(f"{1e3 * extent:.4g}" for extent in high - low) + " mm",
            "from, to": ", ".join("(" + " ".join(f"{1e3 * c:.4g}" for c in p) + ") mm" for p in (low, high)),
            "volume": f"{1e9 * self.volumes.sum():.4g} mm³",
            "edges": f"{1e3 * lengths.min():.4g} to {1e3 * lengths.max():.4g} mm",
            "smallest dihedral angle": f"{np.degrees(self.min_dihedral_angles.min()):.1f}°",
            "material axes": "e1 e2 e3 = x y z" if identity else "given for each tet",
            **{f"note{f' {k}' * (k > 1)}": text for k, text in enumerate(self.notes, start=1)},
        }


def _array(values: ArrayLike, tail: tuple[int, ...], name: str, dtype: type[Any]) -> NDArray[Any]:
    """`values` as an array (m, *tail) of `dtype`. Raises MeshError on another shape or broken indices."""
    array = np.asarray(values)
    if array.size == 0:
        array = array.reshape(0, *tail)
    if array.ndim != 1 + len(tail) or array.shape[1:] != tail:
        raise MeshError(f"{name}: expected shape (m{''.join(f', {n}' for n in tail)}), got {array.shape}")
    if dtype is np.int64 and array.size and not np.issubdtype(array.dtype, np.integer):
        raise MeshError(f"{name}: expected whole numbers, got {array.dtype}")
    return array.astype(dtype)


def _frozen(array: NDArray[Any]) -> NDArray[Any]:
    """A contiguous copy that cannot be written to."""
    copy = np.array(array, order="C")
    copy.setflags(write=False)
    return copy


def _dets(points: Floats, tets: NDArray[Any]) -> Floats:
    """det(x1 - x4, x2 - x4, x3 - x4) of each tet, six times its signed volume, (T,) [m^3]."""
    x = points[tets]
    dets: Floats = np.linalg.det(x[:, :3] - x[:, 3:])
    return dets


def _boundary(tets: NDArray[np.int64]) -> NDArray[np.int64]:
    """Faces that belong to one tet only, (k, 3), outward for positive tets."""
    faces = tets[:, FACES].reshape(-1, 3)
    _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    outer: NDArray[np.int64] = faces[np.sort(first[count == 1])]
    return outer


def _named(what: str, which: Sequence[object] | NDArray[Any]) -> list[str]:
    """["3 inverted tets (4, 7, 9): REMEDY"], five named at most; nothing when `which` is empty."""
    if len(which) == 0:
        return []
    listed = ", ".join(str(one) for one in which[:5]) + (", …" if len(which) > 5 else "")
    remedy = f": {REMEDIES[what]}" if what in REMEDIES else ""
    return [f"{len(which)} {what}{'s' * (len(which) > 1)} ({listed}){remedy}"]


def _defects(x: Floats, t: NDArray[np.int64]) -> list[str]:
    """What is wrong with nodes and tets, each by name, count and first indices."""
    finite: NDArray[np.bool_] = np.logical_and.reduce(np.abs(x) < TOO_FAR, axis=1)
    foreign = (t < 0).any(axis=1) | (t >= len(x)).any(axis=1)
    ordered = np.sort(t, axis=1)
    repeated = ~foreign & (np.diff(ordered, axis=1) == 0).any(axis=1)
    _, first = np.unique(ordered, axis=0, return_index=True)
    inside = t[~foreign]
    used = np.zeros(len(x), dtype=np.bool_)
    used[inside] = True
    sound = np.logical_not(foreign | repeated)
    whole = t[np.intersect1d(first, np.flatnonzero(sound))]
    sound &= finite[np.clip(t, 0, len(x) - 1)].all(axis=1)
    return [
        *_named("non-finite point", np.flatnonzero(~finite)),
        *_named("unreferenced node", np.flatnonzero(~used)),
        *_named("duplicate node", _coincident(x) if finite.all() else []),
        *_named("index-out-of-range tet", np.flatnonzero(foreign)),
        *_named("repeated-node tet", np.flatnonzero(repeated)),
        *_named("duplicate tet", np.setdiff1d(np.arange(len(t)), first)),
        *_volume_defects(x, t, np.flatnonzero(sound)),
        *_named("non-manifold face", _crowded(whole)),
        *_piece_defects(inside, used),
    ]


def _coincident(x: Floats) -> NDArray[Any]:
    """Nodes that lie where a node of lower index lies."""
    reach = COINCIDENT * float(np.linalg.norm(np.ptp(x, axis=0)))
    pairs: NDArray[Any] = cKDTree(x).query_pairs(reach, output_type="ndarray")
    return np.unique(pairs.reshape(-1, 2).max(axis=1))


def _volume_defects(x: Floats, t: NDArray[np.int64], which: NDArray[Any]) -> list[str]:
    """Tets without volume, and those of the rarer orientation (in a draw: not the first tet's)."""
    if len(which) == 0:
        return []
    ends = x[t[which][:, _EDGES]]
    longest = np.linalg.norm(ends[:, :, 1] - ends[:, :, 0], axis=2).max(axis=1)
    dets = _dets(x, t[which])
    flat = np.abs(dets) <= DEGENERATE * longest**3
    signs = np.sign(dets[~flat])
    usual = signs.sum() or signs[:1].sum()
    return [
        *_named("zero-volume tet", which[flat]),
        *_named("inverted tet", which[~flat][signs * usual < 0.0]),
    ]


def _crowded(t: NDArray[np.int64]) -> list[str]:
    """Faces that more than two tets share, as "a-b-c"."""
    faces, count = np.unique(np.sort(t[:, FACES].reshape(-1, 3), axis=1), axis=0, return_counts=True)
    return ["-".join(str(node) for node in face) for face in faces[count > 2].tolist()]


def _piece_defects(t: NDArray[np.int64], used: NDArray[np.bool_]) -> list[str]:
    """Parts of the mesh that no chain of shared nodes joins."""
    rows, columns = np.repeat(t[:, 0], 3), t[:, 1:].ravel()
    links = coo_array((np.ones(len(rows), dtype=np.int8), (rows, columns)), shape=(len(used), len(used)))
    _, label = connected_components(links, directed=False)
    sizes = np.unique(label[t[:, 0]], return_counts=True)[1]
    if len(sizes) < 2:
        return []
    return _named("disconnected piece", [f"{size} tets" for size in np.sort(sizes)[::-1].tolist()])


def _axes_defects(axes: Floats) -> list[str]:
    """Tets whose material axes are not a right-handed orthonormal triad."""
    with np.errstate(invalid="ignore"):
        gram = np.abs(axes @ axes.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
        orthonormal = gram <= ORTHONORMAL
        left = orthonormal & (np.linalg.det(np.where(orthonormal[:, None, None], axes, np.eye(3))) < 0.0)
    return [
        *_named("not-orthonormal axes triad", np.flatnonzero(~orthonormal)),
        *_named("left-handed axes triad", np.flatnonzero(left)),
    ]


def _node_set_defects(sets: Mapping[str, NDArray[np.int64]], n: int) -> list[str]:
    """Node sets that point outside the mesh."""
    outside = {name: nodes[(nodes < 0) | (nodes >= n)] for name, nodes in sets.items()}
    return [
        f"node set {name!r}: {text}" for name, nodes in outside.items() for text in _named("out-of-range node", nodes)
    ]
