"""Files of meshes as gmsh, Abaqus and others write them: what is taken, what is left out and said, what is refused."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest

from finger_sim import Scene
from finger_sim.errors import MeshError
from finger_sim.scene.mesh import TetMesh

# A tet of 1 cm, a second one on its slanted face, and the points of both.
POINTS = 0.01 * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]], dtype=float)
TETS = np.array([[0, 1, 2, 3], [1, 2, 3, 4]])

# Node 1 is the centre of an arc; the group Bone is surface 4, in a file that was saved with all elements.
GMSH_41 = """$MeshFormat
4.1 0 8
$EndMeshFormat
$PhysicalNames
1
2 7 "Bone"
$EndPhysicalNames
$Entities
1 0 2 1
1 .5 .5 .5 0
4 0 0 0 .01 .01 0 1 7 0
5 0 0 0 .01 .01 0 0 0
6 0 0 0 .01 .01 .01 0 0
$EndEntities
$Nodes
2 6 1 6
0 1 0 1
1
.5 .5 .5
3 6 0 5
2
3
4
5
6
0 0 0
.01 0 0
0 .01 0
0 0 .01
.01 .01 .01
$EndNodes
$Elements
4 5 1 5
0 1 15 1
1 1
2 4 2 1
2 2 3 4
2 5 2 1
3 2 3 5
3 6 4 2
4 2 3 4 5
5 3 4 5 6
$EndElements
"""

# Tet 1 is in both groups, so that it is there twice; names of groups and tags of surfaces and bodies are apart.
GMSH_22 = """$MeshFormat
2.2 0 8
$EndMeshFormat
$PhysicalNames
2
3 1 "all"
3 2 "lower"
$EndPhysicalNames
$Nodes
5
1 0 0 0
2 .01 0 0
3 0 .01 0
4 0 0 .01
5 .01 .01 .01
$EndNodes
$Elements
4
1 2 2 1 9 1 2 3
2 4 2 1 6 1 2 3 4
3 4 2 1 6 2 3 4 5
4 4 2 2 6 1 2 3 4
$EndElements
"""

# The part is moved by 5 cm along z, then turned by 90° about the axis through (0, 0, 0.05) along z.
ABAQUS_CAE = """*Heading
** Job name: press Model name: Model-1
*Part, name=Finger
*Node
      1,           0.,           0.,           0.
      2,         0.01,           0.,           0.
** a comment in between
      3,           0.,         0.01,           0.
      4,           0.,           0.,         0.01
     11,       0.01,     0.01,     0.01
*Element, type=C3D4H
1, 1, 2, 3, 4
2, 2, 3, 4, 11
*Nset, nset=Ends, generate
  1,  11,  10
*Elset, elset=First
 1,
*Solid Section, elset=First, material=Soft
,
*End Part
*Assembly, name=Assembly
*Instance, name=Finger-1, part=Finger
 0., 0., 0.05
 0., 0., 0.05, 0., 0., 1., 90.
*End Instance
*Node
      1,           0.,           0.,           1.
*Nset, nset=RP
 1,
*Nset, nset=BONE, internal, instance=Finger-1
 2,  3
*Nset, nset=both, instance=Finger-1
 Ends, BONE
*Element, type=CONN3D2
1, 1, Finger-1.1
*End Assembly
*Step, name=Press
*Static
1., 1., 1e-05, 1.
*Boundary
BONE, ENCASTRE
*Node Output
U,
*End Step
"""

# As CalculiX takes it: a quadratic tet in three lines, nodes in two blocks, a surface of a type that meshio lacks.
ABAQUS_FLAT = """*NODE, NSET=corners
1, 0,0,0
2, .01,0,0
3, 0,1.0D-2,0
4, 0,0,.01
*NODE
5, .005,0,0
6, .005,.005,0
7, 0,.005,0
8, 0,0,.005
9, .005,0,.005
10, 0,.005,.005
*ELEMENT, TYPE=C3D10, ELSET=body
1, 1,2,3,4,
5,6,7,
8,9,10
*ELEMENT, TYPE=M3D3, ELSET=skin
7, 1,2,3
*NSET, NSET=fix
1,5
*NSET, NSET=fix
4
"""


def loaded(folder: Path, name: str, content: str | bytes) -> TetMesh:
    """The mesh of a file of that name and content."""
    path = folder / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return TetMesh.load(path)


def refusal(folder: Path, name: str, content: str | bytes) -> str:
    """What the error says after the path."""
    with pytest.raises(MeshError) as error:
        loaded(folder, name, content)
    path, text = f"{folder / name}: ", str(error.value)
    assert text.startswith(path)
    return text.removeprefix(path)


def sets(mesh: TetMesh) -> dict[str, list[list[float]]]:
    """Positions of the nodes of each set [cm], however nodes are numbered."""
    return {name: sorted(np.round(100 * mesh.points[k], 9).tolist()) for name, k in mesh.node_sets.items()}


def test_gmsh_groups_become_node_sets_and_arc_centres_are_left_out(tmp_path: Path) -> None:
    """Also where not all cells are in a group; names and tags of groups; a tet of two groups is one tet."""
    mesh = loaded(tmp_path, "new.msh", GMSH_41)
    np.testing.assert_array_equal(mesh.points, POINTS)
    assert len(mesh.tets) == 2
    assert sets(mesh) == {"Bone": [[0, 0, 0], [0, 1, 0], [1, 0, 0]]}
    (note,) = mesh.notes
    assert note.startswith("1 unreferenced node left out")
    assert note in mesh.summary().values()

    mesh = loaded(tmp_path, "old.msh", GMSH_22)
    assert mesh.volumes.sum() == pytest.approx(1e-6 * 0.5)
    assert {name: len(nodes) for name, nodes in mesh.node_sets.items()} == {
        "all": 5, "lower": 4, "surface gmsh:physical=1": 3,
    }  # fmt: skip
    assert mesh.notes == ("1 duplicate tet left out, as written for a second group",)


def test_abaqus_files_of_cae_and_of_calculix(tmp_path: Path) -> None:
    """Parts, instances, nodes in several blocks, sets of ranges, of sets and in pieces; quadratic tets by corners."""
    mesh = loaded(tmp_path, "cae.inp", ABAQUS_CAE)
    turned = np.round(100 * mesh.points, 9).tolist()
    assert turned == [[0, 0, 5], [0, 1, 5], [-1, 0, 5], [0, 0, 6], [-1, 1, 6]]
    assert sets(mesh) == {
        "Ends": [[-1, 1, 6], [0, 0, 5]],
        "First": [[-1, 0, 5], [0, 0, 5], [0, 0, 6], [0, 1, 5]],
        "BONE": [[-1, 0, 5], [0, 1, 5]],
        "both": [[-1, 0, 5], [-1, 1, 6], [0, 0, 5], [0, 1, 5]],
        "RP": [],
    }
    (note,) = mesh.notes
    assert "node set RP loses 1 of its 1" in note

    mesh = loaded(tmp_path, "flat.inp", ABAQUS_FLAT)
    np.testing.assert_array_equal(mesh.points, POINTS[:4])
    assert {name: len(nodes) for name, nodes in sets(mesh).items()} == {"corners": 4, "body": 4, "skin": 3, "fix": 2}
    assert mesh.notes == ("1 tet of higher order taken by the corners, with straight edges",)


def test_mixed_blocks_data_and_sets(tmp_path: Path) -> None:
    """Linear and quadratic tets beside surface cells; masks and tags of points and cells, and axes of each tet."""
    middle = 0.5 * (POINTS[[1, 2, 1, 1, 2, 3]] + POINTS[[2, 3, 3, 4, 4, 4]])
    quadratic = np.array([[1, 2, 3, 4, 5, 6, 7, 8, 9, 10]])
    cells = [("triangle", TETS[:1, :3]), ("tetra", TETS[:1]), ("vertex", [[4]]), ("tetra10", quadratic)]
    turn = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    axes = [np.tile(a.ravel(), (1, 1)) for a in (np.eye(3), np.eye(3), np.eye(3), turn)]
    data = {
        "axes": axes, "bone": [[0.0], [1.0], [0.0], [0.0]], "part": [[3], [1], [1], [2]],
        "heat": [[0.1], [1.0], [0.0], [0.3]],
    }  # fmt: skip
    tip = np.isin(np.arange(11), (4, 10)).astype(float)
    mesh_file = meshio.Mesh(np.vstack([POINTS, middle]), cells, cell_data=data, point_data={"tip": tip})
    meshio.write(tmp_path / "m.vtu", mesh_file)
    mesh = TetMesh.load(tmp_path / "m.vtu")
    np.testing.assert_array_equal(mesh.points, POINTS)
    np.testing.assert_array_equal(mesh.axes, [np.eye(3), turn])
    assert {name: nodes.tolist() for name, nodes in mesh.node_sets.items()} == {
        "tip": [4],
        "bone": [0, 1, 2, 3],
        "volume part=1": [0, 1, 2, 3],
        "volume part=2": [1, 2, 3, 4],
        "surface part=3": [0, 1, 2],
        "point part=1": [4],
    }
    mesh.save(tmp_path / "again.vtu")
    again = TetMesh.load(tmp_path / "again.vtu").node_sets
    assert {name: nodes.tolist() for name, nodes in again.items()} == {
        name: nodes.tolist() for name, nodes in mesh.node_sets.items()
    }


def test_corners_that_leave_gaps_are_refused(tmp_path: Path) -> None:
    """A quadratic tet whose mid-edge node is a corner of its neighbour cannot be taken by its corners."""
    middle = 0.5 * (POINTS[[0, 1, 0, 0, 1, 2]] + POINTS[[1, 2, 2, 3, 3, 3]])
    cells = [("tetra10", [[0, 1, 2, 3, 5, 6, 7, 8, 9, 10]]), ("tetra", [[1, 6, 3, 4]])]
    meshio.write(tmp_path / "m.vtu", meshio.Mesh(np.vstack([POINTS, middle]), cells))
    with pytest.raises(MeshError, match=r"corners of other tets between their own \(6\).*of one order"):
        TetMesh.load(tmp_path / "m.vtu")


def test_other_units_are_doubted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A finger of 10 m is warned of, with a command that makes it one of 10 mm; one of 10 cm is not."""
    from finger_sim.cli import main

    monkeypatch.chdir(tmp_path)
    meshio.write("a b.vtu", meshio.Mesh(1000 * POINTS, [("tetra", TETS)], point_data={"bone": [1, 0, 0, 0, 0]}))
    (note,) = TetMesh.load("a b.vtu").notes
    assert note.startswith("it is 10 m long")
    command = note[note.index("finger_sim mesh") : note.index(" for millimetres")]
    assert main(shlex.split(command)[1:]) == 0
    mesh = TetMesh.load("a b_in_m.vtu")
    np.testing.assert_allclose(mesh.points, POINTS, rtol=1e-14)
    assert mesh.node_sets["bone"].tolist() == [0]
    assert mesh.notes == ()


def test_a_scene_finds_a_set_in_other_letters(tmp_path: Path) -> None:
    """The exact name first, else the only one; else the error lists the sets and says how to make one."""

    def driven(name: str, **masks: list[int]) -> Any:
        meshio.write(tmp_path / "m.vtu", meshio.Mesh(POINTS, [("tetra", TETS)], point_data=masks))
        scene = Scene.from_dict({"mesh": {"file": str(tmp_path / "m.vtu")}, "driven": name})
        return scene.driven_nodes(scene.load_mesh()).tolist()

    one, other = [1, 1, 0, 0, 0], [0, 0, 1, 0, 0]
    assert driven("bone", BONE=one) == [0, 1]
    assert driven("bone", BONE=one, bone=other) == [2]
    with pytest.raises(MeshError, match=r"m\.vtu: .*'bone', but BONE and Bone are"):
        driven("bone", BONE=one, Bone=other)
    with pytest.raises(MeshError, match=r"there are: base, tip\..*Physical Surface\(\"bone\"\).*NSET=bone.*zeros and"):
        driven("bone", tip=one, base=other)


HEAD = "*NODE\n1,0,0,0\n2,1,0,0\n3,0,1,0\n4,0,0,1\n*ELEMENT,TYPE=C3D4\n"
UNREADABLE = {
    "n.inp": (HEAD + "1,1,2,3,4\n*NSET,NSET=bone\n1,11\n", "as Abaqus: line 9: node set 'bone' names node 11, which"),
    "e.inp": (HEAD + "1,1,2,3,11\n", "as Abaqus: line 7: element 1 names node 11, which"),
    "short.inp": (HEAD + "1,1,2,3\n", "as Abaqus: line 7: element 1 of type C3D4 has 3 nodes instead of 4"),
    "text.inp": ("no mesh", "as Abaqus: line 1: a keyword such as *NODE"),
    "long.inp": ("*NSET,NSET=a,GENERATE\n1,999999999999,1\n", "as Abaqus: line 2: got 1, 999999999999, 1, allowed"),
    "text.vtu": ("no mesh", "as VTU: it does not begin as such files do"),
    "text.msh": ("no mesh", "as gmsh: it does not begin as such files do"),
    "cut.msh": (GMSH_41[:400], "as gmsh: it ends within a section: it was cut off"),
    "binary.msh": (bytes(range(120, 256)) * 9, "as gmsh: it is not text"),
    "kind.msh": (GMSH_22.replace("\n2 4 2", "\n2 133 2"), "as gmsh: it names 133, a node, cell or kind of cell"),
    "other.msh": ("<?xml version='1.0'?><VTKFile type='x'>", "it looks like VTU: end its name in .vtu"),
    "packed.msh": (b"\x1f\x8b\x08\x00" + bytes(40), "it is compressed: unpack it first"),
    "begun.bdf": ("BEGIN BULK\n", "as NASTRAN: there is no BEGIN BULK with an ENDDATA after it: it was cut off"),
    "begun.node": ("# nodes\n", "as TetGen: it was cut off, or is damaged"),
    "m.e": ("CDF\x01", "as Exodus: that needs the Python package netCDF4: pip install netCDF4"),
    "m.unv": ("    -1\n", "the ending '.unv' belongs to no format that is read: VTU (.vtu), legacy VTK (.vtk), gmsh"),
}


@pytest.mark.parametrize("name", UNREADABLE)
def test_why_a_file_is_unreadable_is_said_in_words(
    tmp_path: Path, name: str, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The format it was taken for, what is wrong, and what to do; no words of a parser, nothing else printed."""
    monkeypatch.setitem(sys.modules, "netCDF4", None)  # as where it is not installed
    content, says = UNREADABLE[name]
    text = refusal(tmp_path, name, content)
    assert text.startswith("unreadable")
    assert says in text
    assert "np." not in text
    assert capfd.readouterr() == ("", "")


def test_other_cells_and_defects_are_refused_with_a_remedy(tmp_path: Path) -> None:
    """Bricks, surfaces alone, nodes twice, tets of both orientations."""
    flat = GMSH_22[: GMSH_22.index("$Elements")] + "$Elements\n1\n1 2 2 1 9 1 2 3\n$EndElements\n"
    brick = GMSH_22.replace("2 4 2 1 6 1 2 3 4", "2 5 2 1 6 1 2 3 4 5 1 2 3")
    twice = GMSH_22.replace("5 .01 .01 .01", "5 0 0 .01")
    turned = GMSH_22.replace("2 3 4 5", "3 2 4 5").replace("4\n1 2 2", "3\n1 2 2").replace("4 4 2 2 6 1 2 3 4\n", "")
    for name, content, says in (
        ("flat.msh", flat, "it holds 1 triangle alone; fill the body with tetrahedra"),
        ("brick.msh", brick, "1 hexahedron; take them apart into tetrahedra (in ParaView"),
        ("twice.msh", twice, "1 duplicate node (4): merge"),
        ("turned.msh", turned, "1 inverted tet (1): number the nodes of all tets alike"),
    ):
        assert says in refusal(tmp_path, name, content)
