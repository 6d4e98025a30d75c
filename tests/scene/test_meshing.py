"""Generated meshes: the paper's beam exactly, and a solid finger that is one."""

from __future__ import annotations

import itertools
import subprocess
import sys
from collections import Counter
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import meshio
import numpy as np
import pytest

from finger_sim.errors import MeshError, MissingExtraError
from finger_sim.scene.finger_solid import solid_finger
from finger_sim.scene.mesh import TetMesh
from finger_sim.scene.meshing import beam, write_mesh
from finger_sim.scene.resources import shipped

needs_gmsh = pytest.mark.skipif(find_spec("gmsh") is None, reason="gmsh makes finger meshes")
SHIPPED = "shipped"


@cache
def mesh_of(source: str | int) -> TetMesh:
    """The shipped finger, or one generated in about so many tets."""
    if source == SHIPPED:
        return TetMesh.load(shipped("config") / "meshes" / "finger_paper.vtu")
    return solid_finger(int(source))


every_finger = pytest.mark.parametrize(
    "source",
    [
        SHIPPED,
        pytest.param(347, marks=needs_gmsh),
        *(pytest.param(tets, marks=[needs_gmsh, pytest.mark.slow]) for tets in (2_000, 10_000)),
    ],
)


def faces_of(mesh: TetMesh) -> Counter[tuple[int, ...]]:
    """How many tets each face belongs to."""
    return Counter(f for tet in mesh.tets.tolist() for f in itertools.combinations(sorted(tet), 3))


def area(mesh: TetMesh, face: tuple[int, ...]) -> float:
    """Area of a face by Heron's formula [m^2]."""
    a, b, c = (float(np.linalg.norm(mesh.points[face[i]] - mesh.points[face[i - 1]])) for i in range(3))
    s = 0.5 * (a + b + c)
    return float(np.sqrt(s * (s - a) * (s - b) * (s - c)))


def dihedral_angles(mesh: TetMesh) -> np.ndarray:
    """All six dihedral angles of each tet, from V = 2/3 A1 A2 sin(angle) / edge, (T, 6) [rad].

    The sine leaves acute and obtuse apart by 180 degrees, which does not matter to a bound on both.
    """
    p = mesh.points[mesh.tets]
    a, b, c = (p[:, n] - p[:, 0] for n in (1, 2, 3))
    volume = np.abs(np.einsum("ij,ij->i", a, np.cross(b, c))) / 6.0
    angles = []
    for i, j in itertools.combinations(range(4), 2):
        k, m = (n for n in range(4) if n not in (i, j))
        edge = p[:, j] - p[:, i]
        areas = [0.5 * np.linalg.norm(np.cross(edge, p[:, n] - p[:, i]), axis=1) for n in (k, m)]
        sine = 1.5 * volume * np.linalg.norm(edge, axis=1) / (areas[0] * areas[1])
        angles.append(np.arcsin(np.clip(sine, 0.0, 1.0)))
    return np.stack(angles, axis=1)


def test_the_papers_beam_has_200_tets_and_99_nodes() -> None:
    """10 x 2 x 2 cubes of five tets, 11 x 3 x 3 nodes, filling 1 x 0.2 x 0.2 m exactly."""
    mesh = beam()
    assert (len(mesh.tets), len(mesh.points)) == (200, 99)
    assert mesh.volumes.sum() == pytest.approx(0.04, rel=1e-13)
    assert mesh.points.min(axis=0).tolist() == [0.0, 0.0, 0.0]
    assert mesh.points.max(axis=0).tolist() == [1.0, 0.2, 0.2]
    assert Counter(np.round(mesh.volumes * 6e6).tolist()) == {1000.0: 160, 2000.0: 40}


@pytest.mark.parametrize(("size", "cells"), [((1.0, 0.2, 0.2), (10, 2, 2)), ((0.3, 0.5, 0.7), (3, 1, 4))])
def test_neighbouring_bricks_match(size: tuple[float, ...], cells: tuple[int, ...]) -> None:
    """No face belongs to three tets, and those of one tet have the area of the box: no gap inside."""
    mesh = beam(size, cells)
    faces = faces_of(mesh)
    a, b, c = size
    assert set(faces.values()) == {1, 2}
    outer = [face for face, count in faces.items() if count == 1]
    assert sum(area(mesh, f) for f in outer) == pytest.approx(2.0 * (a * b + b * c + c * a), rel=1e-12)
    assert {tuple(sorted(f)) for f in mesh.surface.tolist()} == set(outer)
    assert len(mesh.tets) == 5 * np.prod(cells)


def test_neighbouring_cubes_are_mirrored() -> None:
    """Reflecting a cube's five tets in the face it shares gives its neighbour's five."""
    mesh = beam((2.0, 1.0, 1.0), (2, 1, 1))
    tets = {frozenset(map(tuple, mesh.points[t].tolist())) for t in mesh.tets}
    mirrored = {frozenset((2.0 - x, y, z) for x, y, z in tet) for tet in tets}
    assert tets == mirrored


def test_beam_ends_are_node_sets() -> None:
    """`base` holds the nine nodes at x = 0, `tip` the nine at x = 1."""
    mesh = beam()
    assert {k: sorted(set(mesh.points[v, 0].tolist())) for k, v in mesh.node_sets.items()} == {
        "base": [0.0],
        "tip": [1.0],
    }
    assert {k: len(v) for k, v in mesh.node_sets.items()} == {"base": 9, "tip": 9}


@pytest.mark.parametrize(
    ("size", "cells", "says"),
    [
        ((0.0, 1.0, 1.0), (1, 1, 1), "beam size"),
        ((1.0, -1.0, 1.0), (1, 1, 1), "beam size"),
        ((1.0, np.nan, 1.0), (1, 1, 1), "beam size"),
        ((1.0, np.inf, 1.0), (1, 1, 1), "beam size"),
        ((1.0, 1.0), (1, 1, 1), "beam size"),
        ((1.0, 1.0, 1.0), (1, 0, 1), "beam cells"),
        ((1.0, 1.0, 1.0), (1, 1.5, 1), "beam cells"),
        ((1.0, 1.0, 1.0), (1, 1), "beam cells"),
    ],
)
def test_impossible_beams_are_refused(size: tuple[float, ...], cells: tuple[int, ...], says: str) -> None:
    """Three positive lengths and three whole counts, nothing else."""
    with pytest.raises(MeshError, match=says):
        beam(size, cells)


@every_finger
def test_finger_has_the_tets_asked_for(source: str | int) -> None:
    """Within 5 % of the number."""
    asked = 347 if source == SHIPPED else int(source)
    assert abs(len(mesh_of(source).tets) - asked) <= 0.05 * asked


@every_finger
def test_finger_tets_are_well_shaped(source: str | int) -> None:
    """No dihedral angle below 10 degrees nor above 170, and ours agree with the sine formula."""
    mesh = mesh_of(source)
    angles = dihedral_angles(mesh)
    assert np.degrees(angles.min()) >= 10.0
    assert np.all(np.sin(mesh.min_dihedral_angles) >= np.sin(angles).min(axis=1) - 1e-9)
    assert (mesh.volumes > 0.0).all()
    assert set(faces_of(mesh).values()) == {1, 2}


@every_finger
def test_finger_is_its_own_mirror_image(source: str | int) -> None:
    """Reflecting z maps the nodes onto nodes and the tets onto tets."""
    mesh = mesh_of(source)
    index = {tuple(p): i for i, p in enumerate((mesh.points + 0.0).tolist())}
    image = [index[x, y, -z + 0.0] for x, y, z in mesh.points.tolist()]
    tets = {frozenset(t) for t in mesh.tets.tolist()}
    assert {frozenset(image[i] for i in t) for t in tets} == tets


@every_finger
def test_finger_measures(source: str | int) -> None:
    """7 cm long; at the joints as broad and deep as a finger; flattened on the nail side."""
    mesh = mesh_of(source)
    x, y, z = 1e3 * mesh.points.T
    assert np.ptp(x) == pytest.approx(70.0, abs=0.1)
    assert x.max() == pytest.approx(11.6, abs=0.1)  # so PIP, at -30.4, is 42 mm from the tip
    dip, pip = np.abs(x + 8.0) < 4.0, np.abs(x + 30.4) < 6.0
    assert 16.0 <= np.ptp(z[dip]) <= 18.0
    assert 19.0 <= np.ptp(z[pip]) <= 21.0
    assert 12.0 <= np.ptp(y[dip]) <= 14.5
    distal = (x > -4.0) & (x < 9.0)
    assert y[distal].max() < 0.8 * -y[distal].min()
    np.testing.assert_allclose(mesh.axes, np.broadcast_to(np.eye(3), mesh.axes.shape), atol=0.0)


@every_finger
def test_finger_node_sets(source: str | int) -> None:
    """`base` is all of the cut face; `bone` adds interior nodes only, on the axis and beside it."""
    mesh = mesh_of(source)
    base, bone = set(mesh.node_sets["base"].tolist()), set(mesh.node_sets["bone"].tolist())
    x = mesh.points[:, 0]
    assert base == set(np.flatnonzero(x < x.min() + 1e-6).tolist())
    assert base < bone
    assert not (bone - base) & set(mesh.surface.ravel().tolist())


@every_finger
def test_bone_reaches_through_the_distal_phalanx(source: str | int) -> None:
    """Nodes from the joint to 3.8 mm from the tip, never more than 4.5 mm apart, 5 to 11 mm across in all."""
    mesh = mesh_of(source)
    core = 1e3 * mesh.points[np.setdiff1d(mesh.node_sets["bone"], mesh.node_sets["base"])]
    distal = core[core[:, 0] > -8.01]
    along = np.unique(np.round(distal[np.abs(distal[:, 2]) < 1e-6, 0], 6))
    assert 1e3 * mesh.points[:, 0].max() - along[-1] == pytest.approx(3.8, abs=0.1)
    assert along[-1] - along[0] == pytest.approx(15.8, abs=1e-6)
    assert np.diff(along).max() <= 4.5
    assert 9.0 <= np.ptp(distal[:, 2]) <= 11.0
    tuft = distal[(distal[:, 0] > 3.0)]
    assert 5.0 <= np.ptp(tuft[:, 2]) <= 8.0


@every_finger
def test_pulp_is_4_to_8_mm_and_thicker_than_the_nail_side(source: str | int) -> None:
    """Below each node on the distal bone's axis: 4 to 8 mm to the pad, more than above it to the nail."""
    mesh = mesh_of(source)
    p = 1e3 * mesh.points
    bone = p[np.setdiff1d(mesh.node_sets["bone"], mesh.node_sets["base"])]
    x, y, z = bone.T
    axis = bone[(x > -4.1) & (x < 6.0) & (y > -1.0) & (y < 0.0) & (z == 0.0)]
    assert len(axis) >= 3
    for x, y, z in axis:
        heights = []
        for triangle in p[mesh.surface]:
            (ax, az), (bx, bz), (cx, cz) = triangle[:, [0, 2]]
            m = np.array([[ax, bx, cx], [az, bz, cz], [1.0, 1.0, 1.0]])
            if abs(np.linalg.det(m)) < 1e-9:
                continue
            weights = np.linalg.solve(m, [x, z, 1.0])
            if weights.min() >= -1e-9:
                heights.append(float(weights @ triangle[:, 1]))
        below, above = y - min(heights), max(heights) - y
        assert 4.0 <= below <= 8.0
        assert above < below


@every_finger
def test_pad_is_finely_meshed_where_it_is_pressed(source: str | int) -> None:
    """Lowest at x = 0 to 10 mm, edges of 5 mm at most, and free nodes between the bone and the pad.

    What gmsh makes differs from machine to machine: a finger made here may be a little coarser than the shipped ones.
    """
    longest, fewest = (5.0, 5) if isinstance(source, str) else (6.0, 4)
    mesh = mesh_of(source)
    p = 1e3 * mesh.points
    assert 0.0 <= p[p[:, 1].argmin(), 0] <= 10.0
    pairs = (pair for t in mesh.surface.tolist() for pair in itertools.combinations(t, 2))
    edges = np.unique([sorted(pair) for pair in pairs], axis=0)
    middle = p[edges].mean(axis=1)
    pad = (middle[:, 0] > -4.0) & (middle[:, 1] < -1.0)
    assert np.linalg.norm(p[edges[pad, 0]] - p[edges[pad, 1]], axis=1).max() <= longest
    skin = p[np.unique(mesh.surface)]
    assert (skin[:, 1] < skin[:, 1].min() + 0.5).sum() >= fewest
    free = np.setdiff1d(np.arange(len(p)), np.union1d(mesh.surface, mesh.node_sets["bone"]))
    under = (np.abs(p[free, 0]) < 10.0) & (p[free, 1] < -2.0)
    assert under.sum() >= fewest


@needs_gmsh
@pytest.mark.slow
def test_finger_is_the_same_every_time(tmp_path: Path) -> None:
    """Two generations give the same file, byte for byte."""
    for name in ("a.vtu", "b.vtu"):
        write_mesh("solid-finger", tmp_path / name, tets=347)
    assert (tmp_path / "a.vtu").read_bytes() == (tmp_path / "b.vtu").read_bytes()


@needs_gmsh
def test_the_shipped_finger_is_what_the_command_makes() -> None:
    """Of the same size and shape as a fresh one, whatever the version of gmsh."""
    made, kept = mesh_of(347), mesh_of(SHIPPED)
    assert len(kept.tets) == pytest.approx(len(made.tets), rel=0.1)
    assert kept.volumes.sum() == pytest.approx(made.volumes.sum(), rel=0.05)
    np.testing.assert_allclose(kept.points.min(axis=0), made.points.min(axis=0), atol=5e-4)
    np.testing.assert_allclose(kept.points.max(axis=0), made.points.max(axis=0), atol=5e-4)


@needs_gmsh
@pytest.mark.parametrize("tets", [249, 0, -5, 300.5])
def test_impossible_fingers_are_refused(tets: int) -> None:
    """Not a count, or too few tets for the shape of a finger."""
    with pytest.raises(MeshError, match="finger tets"):
        solid_finger(tets)


def test_without_gmsh_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """The error says what to install."""
    monkeypatch.setitem(sys.modules, "gmsh", None)
    with pytest.raises(MissingExtraError, match=r"finger_sim\[mesh\]"):
        solid_finger()


def test_gmsh_is_imported_only_when_a_finger_is_made() -> None:
    """Importing the generators and making a beam needs no gmsh."""
    code = "import sys, finger_sim.scene.meshing as m; m.beam(); assert 'gmsh' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_write_mesh_writes_what_meshio_reads(tmp_path: Path) -> None:
    """A beam of given size and cells, read by meshio alone, in VTK's orientation."""
    mesh = write_mesh("beam", tmp_path / "beam.vtu", size=(0.1, 0.02, 0.02), cells=(5, 1, 1))
    raw = meshio.read(tmp_path / "beam.vtu")
    p = raw.points[raw.cells_dict["tetra"]]
    volumes = np.einsum("ij,ij->i", np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), p[:, 3] - p[:, 0]) / 6.0
    assert len(mesh.tets) == len(p) == 25
    assert (volumes > 0.0).all()
    assert volumes.sum() == pytest.approx(4e-5)


def test_write_mesh_refuses_other_kinds(tmp_path: Path) -> None:
    """Only fingers and a beam."""
    with pytest.raises(MeshError, match="mesh kind"):
        write_mesh("hand", tmp_path / "hand.vtu")
