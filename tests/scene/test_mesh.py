"""Tet meshes: what is accepted, what is refused and how it is named, and files that others can read."""

from __future__ import annotations

import itertools
from collections import Counter
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest

from finger_sim.errors import MeshError
from finger_sim.scene.mesh import TetMesh

# A unit tet in VTK's order, a second one on its slanted face, and the points of both.
POINTS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]], dtype=float)
TETS = np.array([[0, 1, 2, 3], [1, 2, 3, 4]])


def vtk_volume(p: np.ndarray) -> float:
    """Signed volume in VTK's convention, by the scalar triple product."""
    a, b, c = p[1] - p[0], p[2] - p[0], p[3] - p[0]
    return float(np.dot(np.cross(a, b), c) / 6.0)


def refused(*args: Any, **kwargs: Any) -> str:
    """What the error says about a mesh that must not be accepted."""
    with pytest.raises(MeshError) as error:
        TetMesh.from_arrays(*args, **kwargs)
    return str(error.value)


@pytest.mark.parametrize("order", [[0, 1, 2, 3], [1, 0, 2, 3]])
def test_either_orientation_is_accepted_and_made_ours(order: list[int]) -> None:
    """det(x1 - x4, x2 - x4, x3 - x4) > 0 for every tet, whichever of the two conventions comes in."""
    mesh = TetMesh.from_arrays(POINTS, TETS[:, order])
    for x1, x2, x3, x4 in mesh.points[mesh.tets]:
        assert np.linalg.det(np.column_stack([x1 - x4, x2 - x4, x3 - x4])) > 0.0
    np.testing.assert_allclose(mesh.volumes, [1 / 6, 1 / 3], rtol=1e-14)


def test_surface_is_closed_and_faces_outward() -> None:
    """Flux of x through the surface is three volumes; each edge is walked once in each direction."""
    mesh = TetMesh.from_arrays(POINTS, TETS)
    a, b, c = (mesh.points[mesh.surface[:, k]] for k in range(3))
    flux = np.einsum("ij,ij->", (a + b + c) / 3.0, np.cross(b - a, c - a) / 2.0)
    assert flux == pytest.approx(3.0 * 0.5, rel=1e-14)
    walked = Counter((int(t[k]), int(t[k - 2])) for t in mesh.surface for k in range(3))
    assert set(walked.values()) == {1}
    assert all((v, u) in walked for u, v in walked)


def test_arrays_are_typed_and_read_only() -> None:
    """Nothing that a mesh hands out can be changed."""
    mesh = TetMesh.from_arrays(POINTS, TETS, {"base": [2, 0, 2]})
    assert mesh.tets.dtype == mesh.surface.dtype == mesh.node_sets["base"].dtype == np.int32
    assert mesh.node_sets["base"].tolist() == [0, 2]
    assert mesh.axes.shape == (2, 3, 3)
    for array in (mesh.points, mesh.tets, mesh.surface, mesh.axes, mesh.volumes, mesh.node_sets["base"]):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0
    with pytest.raises(TypeError):
        mesh.node_sets["tip"] = mesh.node_sets["base"]  # type: ignore[index]


def test_a_mesh_does_not_share_memory_with_its_input() -> None:
    """Changing the input afterwards leaves the mesh as it was."""
    points = POINTS.copy()
    mesh = TetMesh.from_arrays(points, TETS)
    points[0] = 9.0
    assert mesh.points[0].tolist() == [0.0, 0.0, 0.0]


def test_dihedral_angles_by_projection() -> None:
    """Smallest dihedral angle = angle between the two other nodes seen along each edge."""
    rng = np.random.default_rng(3)
    mesh = TetMesh.from_arrays(POINTS + 0.1 * rng.standard_normal(POINTS.shape), TETS)
    for tet, smallest in zip(mesh.tets, mesh.min_dihedral_angles, strict=True):
        angles = []
        for i, j in itertools.combinations(range(4), 2):
            k, m = (n for n in range(4) if n not in (i, j))
            p = mesh.points[tet]
            edge = (p[j] - p[i]) / np.linalg.norm(p[j] - p[i])
            u, v = (p[n] - p[i] - edge * np.dot(p[n] - p[i], edge) for n in (k, m))
            angles.append(np.arccos(np.dot(u, v) / np.linalg.norm(u) / np.linalg.norm(v)))
        assert smallest == pytest.approx(min(angles), rel=1e-10)


def test_round_trip_keeps_everything(tmp_path: Path) -> None:
    """Saved and loaded: the same nodes, tets, surface, sets and axes, bit for bit."""
    rng = np.random.default_rng(1)
    axes = np.linalg.qr(rng.standard_normal((2, 3, 3)))[0]
    axes *= np.linalg.det(axes)[:, None, None]
    mesh = TetMesh.from_arrays(POINTS / 3.0, TETS, {"base": [0, 1], "none": []}, axes)
    mesh.save(tmp_path / "m.vtu")
    again = TetMesh.load(tmp_path / "m.vtu")
    for name in ("points", "tets", "surface", "axes"):
        np.testing.assert_array_equal(getattr(again, name), getattr(mesh, name))
    assert {k: v.tolist() for k, v in again.node_sets.items()} == {"base": [0, 1], "none": []}


def test_saved_file_is_right_for_vtk_readers(tmp_path: Path) -> None:
    """Read by meshio alone: VTK's orientation, 0/1 node sets, nine numbers of axes a tet, row by row."""
    turn = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    TetMesh.from_arrays(POINTS, TETS, {"base": [3]}, [np.eye(3), turn]).save(tmp_path / "m.vtu")
    raw = meshio.read(tmp_path / "m.vtu")
    tets = raw.cells_dict["tetra"]
    assert [vtk_volume(raw.points[t]) for t in tets] == pytest.approx([1 / 6, 1 / 3])
    assert raw.point_data["base"].tolist() == [0, 0, 0, 1, 0]
    assert raw.cell_data["axes"][0].tolist() == [np.eye(3).ravel().tolist(), turn.ravel().tolist()]


def test_foreign_files_load(tmp_path: Path) -> None:
    """A gmsh file with surface triangles and a float point datum: tets taken, 0/1 data become node sets."""
    cells = [("triangle", np.array([[0, 1, 2]])), ("tetra", TETS[:1]), ("tetra", TETS[1:])]
    data = {"grip": np.array([0, 1, 0, 0, 1.0]), "heat": np.linspace(0.0, 2.0, 5)}
    meshio.write(tmp_path / "m.msh", meshio.Mesh(POINTS, cells, point_data=data), file_format="gmsh22")
    meshio.write(tmp_path / "m.vtk", meshio.Mesh(POINTS, cells, point_data=data))
    for name in ("m.msh", "m.vtk"):
        mesh = TetMesh.load(tmp_path / name)
        assert len(mesh.tets) == 2
        assert {k: v.tolist() for k, v in mesh.node_sets.items()} == {"grip": [1, 4]}


FAR = POINTS + 10.0
STAR = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, -1], [1, 1, 2]], dtype=float)
DEFECTS = {
    "inverted": (POINTS, [[0, 1, 2, 3], [2, 1, 3, 4]], "1 inverted tet (1)"),
    "zero volume": ([*POINTS[:4], [0.5, 0.5, 0.0]], [*TETS[:1], [1, 2, 0, 4]], "1 zero-volume tet (1)"),
    "sliver": ([*POINTS[:4], [0.5, 0.5, -1e-9]], [*TETS[:1], [1, 2, 0, 4]], "1 zero-volume tet (1)"),
    "duplicate tet": (POINTS, [*TETS, [2, 0, 1, 3], [4, 3, 1, 2]], "2 duplicate tets (2, 3)"),
    "duplicate node": ([*POINTS[:4], *POINTS[1:]], [[0, 1, 2, 3], [4, 5, 6, 7]], "3 duplicate nodes (4, 5, 6)"),
    "pieces": ([*POINTS, *FAR[:4]], [*TETS, [5, 6, 7, 8]], "2 disconnected pieces (2 tets, 1 tets)"),
    "unreferenced": ([*POINTS, [5, 5, 5], [6, 5, 5]], TETS, "2 unreferenced nodes (5, 6)"),
    "not finite": ([*POINTS[:4], [np.nan, 0, 0]], TETS, "1 non-finite point (4)"),
    "infinite": ([*POINTS[:4], [0, np.inf, 0]], TETS, "1 non-finite point (4)"),
    "far away": ([*POINTS[:4], [0, 1e200, 0]], TETS, "1 non-finite point (4)"),
    "out of range": (POINTS, [*TETS, [0, 1, 2, 5]], "1 index-out-of-range tet (2)"),
    "negative index": (POINTS, [*TETS, [0, 1, 2, -1]], "1 index-out-of-range tet (2)"),
    "repeated node": (POINTS, [*TETS, [0, 1, 1, 4]], "1 repeated-node tet (2)"),
    "non-manifold": (STAR, [[0, 1, 2, 3], [1, 0, 2, 4], [0, 1, 2, 5]], "1 non-manifold face (0-1-2)"),
}


@pytest.mark.parametrize("name", DEFECTS)
def test_each_defect_is_refused_by_name_and_count(name: str) -> None:
    """The message names the defect, how often it occurs and where."""
    points, tets, says = DEFECTS[name]
    assert says in refused(points, tets)


def test_all_defects_come_in_one_message() -> None:
    """A mesh with several defects lists them all."""
    text = refused([*POINTS, [9, 9, 9]], [*TETS, [0, 1, 1, 4], [0, 1, 2, 99]], {"grip": [-1]})
    for says in (
        "1 unreferenced node (5)",
        "1 repeated-node tet (2)",
        "1 index-out-of-range tet (3)",
        "node set 'grip': 1 out-of-range node (-1)",
    ):
        assert says in text


def test_only_the_first_few_indices_are_listed() -> None:
    """Many defects of one kind: the count is whole, the list is short."""
    assert "8 unreferenced nodes (5, 6, 7, 8, 9, …)" in refused([*POINTS, *(POINTS + 7.0), *FAR[:3]], TETS)


@pytest.mark.parametrize(
    ("axes", "says"),
    [
        ([np.eye(3), 2.0 * np.eye(3)], "1 not-orthonormal axes triad (1)"),
        ([np.eye(3), np.full((3, 3), np.nan)], "1 not-orthonormal axes triad (1)"),
        ([-np.eye(3), np.eye(3)], "1 left-handed axes triad (0)"),
        ([np.eye(3)], "axes: expected 9 numbers for each of 2 tets"),
    ],
)
def test_broken_axes_are_refused(axes: list[np.ndarray], says: str) -> None:
    """Axes must be right-handed and orthonormal, one triad for each tet."""
    assert says in refused(POINTS, TETS, axes=axes)


@pytest.mark.parametrize(
    ("points", "tets", "says"),
    [
        (POINTS, [], "no tets"),
        (POINTS, TETS[:, :3], "tets: expected shape (m, 4)"),
        (POINTS[:, :2], TETS, "points: expected shape (m, 3)"),
        (POINTS, TETS.astype(float), "tets: expected whole numbers"),
    ],
)
def test_wrong_shapes_are_refused(points: np.ndarray, tets: np.ndarray, says: str) -> None:
    """Arrays of another shape or kind are refused before they are used."""
    assert says in refused(points, tets)


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("missing.vtu", None, "file not found"),
        ("empty.vtu", b"", "empty file"),
        ("foreign.vtu", b"not a mesh", "unreadable"),
        ("foreign.msh", b"not a mesh", "unreadable"),
        ("mesh.nonsense", b"not a mesh", "unreadable"),
        ("only_text.vtk", b"# vtk DataFile Version 3.0\n", "unreadable"),
        ("folder.vtu", "folder", "is a folder"),
    ],
)
def test_unusable_files_are_refused_by_path(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], name: str, content: bytes | str | None, says: str
) -> None:
    """The message names the file and the reason, and nothing else is printed."""
    path = tmp_path / name
    if isinstance(content, bytes):
        path.write_bytes(content)
    elif content == "folder":
        path.mkdir()
    with pytest.raises(MeshError) as error:
        TetMesh.load(path)
    assert str(error.value).startswith(f"{path}: ")
    assert says in str(error.value)
    assert capfd.readouterr() == ("", "")


def test_truncated_file_is_refused(tmp_path: Path) -> None:
    """A file cut off anywhere is an error of ours, not of a parser."""
    TetMesh.from_arrays(POINTS, TETS).save(tmp_path / "m.vtu")
    whole = (tmp_path / "m.vtu").read_bytes()
    for size in range(1, len(whole) - 20, 97):
        (tmp_path / "cut.vtu").write_bytes(whole[:size])
        with pytest.raises(MeshError, match="unreadable"):
            TetMesh.load(tmp_path / "cut.vtu")


@pytest.mark.parametrize(
    ("cells", "says"),
    [
        ([("hexahedron", np.arange(8)[None])], "cells that are not 4-node tetrahedra: 1 hexahedron"),
        ([("triangle", np.array([[0, 1, 2]]))], "no tets"),
    ],
)
def test_files_without_tets_are_refused(tmp_path: Path, cells: list[Any], says: str) -> None:
    """Volume cells of another kind are named; a surface mesh has no tets."""
    cube = np.array(list(itertools.product((0.0, 1.0), repeat=3)))
    meshio.write(tmp_path / "m.vtu", meshio.Mesh(cube, cells))
    with pytest.raises(MeshError, match=says):
        TetMesh.load(tmp_path / "m.vtu")


def test_defects_in_a_file_are_named_with_its_path(tmp_path: Path) -> None:
    """A mixed orientation in a file is refused, with the path before the count."""
    meshio.write(tmp_path / "m.vtu", meshio.Mesh(POINTS, [("tetra", np.array([[0, 1, 2, 3], [2, 1, 3, 4]]))]))
    with pytest.raises(MeshError, match=r"m\.vtu: 1 inverted tet \(1\)"):
        TetMesh.load(tmp_path / "m.vtu")


@pytest.mark.parametrize("name", ["m.msh", "no/such/folder/m.vtu"])
def test_save_refuses_what_it_cannot_write(tmp_path: Path, name: str) -> None:
    """Another suffix, or a folder that is not there."""
    with pytest.raises(MeshError, match=r"m\.(msh|vtu)"):
        TetMesh.from_arrays(POINTS, TETS).save(tmp_path / name)


def test_summary_counts() -> None:
    """The summary says how many tets, nodes and set members there are."""
    summary = TetMesh.from_arrays(POINTS, TETS, {"grip": [1, 4]}).summary()
    assert summary["tets"] == "2"
    assert summary["nodes"] == "5, 5 on the surface"
    assert summary["node set grip"] == "2 nodes"
    assert summary["volume"] == "5e+08 mm³"
