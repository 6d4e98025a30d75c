"""The finger whose bones are a hole: shipped meshes against the formulas of its shape, and what makes them."""

from __future__ import annotations

import itertools
import math
import sys
from collections import Counter
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from finger_sim.errors import MeshError, MissingExtraError
from finger_sim.scene.finger_mesh import finger
from finger_sim.scene.finger_shape import (
    BONE,
    CUT,
    DIP,
    DISTAL_CUT,
    PIP,
    SKIN,
    TIP,
    Surface,
)
from finger_sim.scene.mesh import TetMesh
from finger_sim.scene.mesh_improvement import cut_edges, narrowest, widened
from finger_sim.scene.meshing import write_mesh
from finger_sim.scene.resources import shipped

Array = NDArray[np.float64]

needs_gmsh = pytest.mark.skipif(find_spec("gmsh") is None, reason="gmsh makes finger meshes")
WHOLE = {"finger_500": 500, "finger": 900, "finger_2000": 2000, "finger_4000": 4000, "finger_16000": 16000}
SHIPPED = {**WHOLE, "finger_distal": 1000}
every_finger = pytest.mark.parametrize("name", SHIPPED)
ON_SURFACE = 1e-9  # of the level, 1 on a surface


@cache
def mesh_of(name: str) -> TetMesh:
    """A shipped mesh."""
    return TetMesh.load(shipped("config") / "meshes" / f"{name}.vtu")


def millimetres(mesh: TetMesh, name: str | None = None) -> Array:
    """Nodes, or those of a node set, in millimetres."""
    return 1e3 * (mesh.points if name is None else mesh.points[mesh.node_sets[name]])


def cut_of(name: str) -> float:
    """x of the cut face [mm]."""
    return DISTAL_CUT if "distal" in name else CUT


def faces_of(mesh: TetMesh) -> Counter[tuple[int, ...]]:
    """How many tets each face belongs to."""
    return Counter(f for tet in mesh.tets.tolist() for f in itertools.combinations(sorted(tet), 3))


def mask(mesh: TetMesh, name: str) -> NDArray[np.bool_]:
    """Whether each node is of a node set."""
    out = np.zeros(len(mesh.points), dtype=np.bool_)
    out[mesh.node_sets[name]] = True
    return out


def volume_within(surface: Surface, cut: float) -> float:
    """Volume of a surface beyond the cut [mm³]: superelliptic areas in closed form, summed along x by Gauss's rule."""
    nodes, weights = np.polynomial.legendre.leggauss(20)
    stations = np.unique([cut, *np.arange(-58.0, surface.cap, 2.0), surface.cap, surface.tip])
    stations = stations[stations >= cut]
    half, middle = 0.5 * np.diff(stations)[:, None], 0.5 * (stations[1:] + stations[:-1])[:, None]
    x = middle + half * nodes
    _, half_depth, half_breadth = surface.section(x)
    forward = np.maximum(0.0, (x - surface.cap) / (surface.tip - surface.cap))
    of_unit = sum(2.0 * math.gamma(1.0 + 1.0 / p) ** 2 / math.gamma(1.0 + 2.0 / p) for p in surface.squareness)
    area = of_unit * half_depth * half_breadth * (1.0 - forward**2)
    return float((half * weights * area).sum())


def tets_on_the_way(mesh: TetMesh, start: int) -> int:
    """Tets that hold one of a hundred points on the straight way from a node to the bone's nearest node.

    The way is put beside itself by a hundredth of a millimetre, for it would run along faces in the plane z = 0.
    """
    x, bone = mesh.points, mesh.node_sets["bone"]
    end = bone[np.linalg.norm(x[bone] - x[start], axis=1).argmin()]
    way = x[start] + np.linspace(0.01, 0.99, 100)[:, None] * (x[end] - x[start]) + [0.0, 0.0, 1e-5]
    corners = x[mesh.tets]
    first = np.einsum("tij,ptj->pti", np.linalg.inv(_edges(corners)), way[:, None] - corners[:, 3])
    weights = np.concatenate([first, 1.0 - first.sum(axis=2, keepdims=True)], axis=2)
    held = (weights >= 0.0).all(axis=2)
    return len(np.unique(held[held.any(axis=1)].argmax(axis=1)))


def _edges(corners: Array) -> Array:
    """Edges from the last corner of tets to the others, in columns."""
    return (corners[:, :3] - corners[:, 3:]).transpose(0, 2, 1)


@every_finger
def test_as_many_tets_as_asked_for_and_none_narrow(name: str) -> None:
    """Within 5 %; no angle below 18 degrees; inside is inside."""
    mesh = mesh_of(name)
    assert len(mesh.tets) == pytest.approx(SHIPPED[name], rel=0.05)
    assert np.degrees(mesh.min_dihedral_angles.min()) >= 18.0
    assert (mesh.volumes > 0.0).all()


@every_finger
def test_the_boundary_is_skin_bone_and_cut_and_closed(name: str) -> None:
    """Each edge of it belongs to two triangles; each triangle has its corners on one of the three."""
    mesh = mesh_of(name)
    outer = np.array([face for face, count in faces_of(mesh).items() if count == 1])
    edges = Counter(edge for face in outer.tolist() for edge in itertools.combinations(face, 2))
    assert set(edges.values()) == {2}
    pairs = np.array(list(edges))
    _, piece = connected_components(coo_array((np.ones(len(pairs)), pairs.T), shape=(len(mesh.points),) * 2), False)
    assert len(np.unique(piece[outer])) == 1  # a bone that is closed somewhere leaves a hole by itself
    assert len(np.unique(outer)) - len(edges) + len(outer) == 2  # Euler: a sphere, since the bones end inside
    x = millimetres(mesh)
    skin, bone, cut = (
        np.abs(level - at) < ON_SURFACE
        for level, at in ((SKIN.level(x), 1), (BONE.level(x), 1), (x[:, 0], cut_of(name)))
    )
    of_skin, of_bone, of_cut = (on[outer].all(axis=1) for on in (skin, bone, cut))
    assert (of_skin | of_bone | of_cut).all()
    assert min(of_skin.sum(), of_bone.sum(), of_cut.sum()) > 0
    corners = x[outer]
    areas = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert np.abs(areas[of_cut & ~of_skin & ~of_bone][:, 1:]).max() == 0.0


@every_finger
def test_node_sets_are_what_they_are_called(name: str) -> None:
    """`bone`: all on the bones' surface, and the cut face, which is `base`; `pad` below, `nail` on top of the tip."""
    mesh = mesh_of(name)
    x = millimetres(mesh)
    on_bone, on_skin, on_cut = (
        np.abs(BONE.level(x) - 1.0) < ON_SURFACE,
        np.abs(SKIN.level(x) - 1.0) < ON_SURFACE,
        x[:, 0] == cut_of(name),
    )
    assert (mask(mesh, "base") == (np.abs(x[:, 0] - x[:, 0].min()) < 1e-6)).all()
    assert (mask(mesh, "bone") == (on_bone | mask(mesh, "base"))).all()
    assert on_cut.sum() in (0, mask(mesh, "base").sum())  # metres may not come back to the same millimetres
    assert (mask(mesh, "bone_nail") == (mask(mesh, "bone") | mask(mesh, "nail"))).all()
    pad, nail = mask(mesh, "pad"), mask(mesh, "nail")
    assert (on_skin[pad | nail]).all()
    below = on_skin & (x[:, 0] >= -5.0) & (x[:, 1] <= -4.5)
    assert (pad == below).all()
    assert x[nail, 1].min() > 1.0
    assert x[nail, 0].min() >= -2.0
    assert x[nail, 0].max() <= 9.5
    assert np.abs(x[nail, 2]).max() <= 6.7
    assert pad.sum() >= 10
    assert nail.sum() >= 5
    assert (on_bone | on_skin | mask(mesh, "base"))[np.unique(mesh.surface)].all()


@every_finger
def test_every_tet_has_a_free_node(name: str) -> None:
    """Also where the nail is driven with the bone."""
    mesh = mesh_of(name)
    assert not mask(mesh, "bone_nail")[mesh.tets].all(axis=1).any()


@every_finger
def test_two_layers_of_tets_or_more_between_pad_and_bone(name: str) -> None:
    """No tet touches both, so that any way from one to the other goes through two at least."""
    mesh = mesh_of(name)
    pad, bone = (mask(mesh, which)[mesh.tets].any(axis=1) for which in ("pad", "bone"))
    assert not (pad & bone).any()
    if len(mesh.tets) < 1500:
        assert min(tets_on_the_way(mesh, node) for node in mesh.node_sets["pad"].tolist()) >= 2


@every_finger
def test_it_is_its_own_mirror_image(name: str) -> None:
    """Reflecting z maps nodes onto nodes, tets onto tets and node sets onto themselves."""
    mesh = mesh_of(name)
    index = {tuple(p): i for i, p in enumerate((mesh.points + 0.0).tolist())}
    image = np.array([index[x, y, -z + 0.0] for x, y, z in mesh.points.tolist()])
    assert {frozenset(t) for t in image[mesh.tets].tolist()} == {frozenset(t) for t in mesh.tets.tolist()}
    for nodes in mesh.node_sets.values():
        assert set(image[nodes].tolist()) == set(nodes.tolist())


def test_the_volume_converges_to_that_of_the_formulas() -> None:
    """Skin less bone: the error falls with size, to 3 % of the finest, coarse far away; of the fingertip too."""
    volume = volume_within(SKIN, CUT) - volume_within(BONE, CUT)
    errors = [abs(1e9 * mesh_of(name).volumes.sum() / volume - 1.0) for name in WHOLE]
    assert errors[-1] < 0.03
    assert all(later < 1.05 * earlier for earlier, later in itertools.pairwise(errors))
    tip = volume_within(SKIN, DISTAL_CUT) - volume_within(BONE, DISTAL_CUT)
    assert 1e9 * mesh_of("finger_distal").volumes.sum() == pytest.approx(tip, rel=0.05)


def test_measures_of_a_finger() -> None:
    """7 cm long, as broad and deep at the joints as a finger, bone to 3.8 mm from the tip, pulp 4 to 6 mm."""
    mesh = mesh_of("finger_4000")
    x, y, z = millimetres(mesh).T
    assert np.ptp(x) == pytest.approx(70.0, abs=0.02)
    assert TIP - millimetres(mesh, "bone")[:, 0].max() == pytest.approx(3.8, abs=0.02)
    dip, pip = np.abs(x - DIP) < 4.0, np.abs(x - PIP) < 6.0
    assert 16.0 <= np.ptp(z[dip]) <= 18.0
    assert 19.0 <= np.ptp(z[pip]) <= 21.0
    assert 12.0 <= np.ptp(y[dip]) <= 14.5
    bone = millimetres(mesh, "bone")
    under = bone[(bone[:, 0] > -2.0) & (bone[:, 0] < 6.0)]
    assert 4.0 <= under[:, 1].min() - y.min() <= 6.0
    pad, far = (np.cbrt(1e9 * mesh.volumes[where[mesh.tets].all(axis=1)].mean()) for where in (y < -4.0, x < DIP))
    assert pad < 0.5 * far


def test_finest_in_the_pad_of_every_size() -> None:
    """Edges of the pad's skin shrink with size: 4 mm on average at 500 tets, below 1 mm at 16,000."""
    means = []
    for name in WHOLE:
        mesh = mesh_of(name)
        edges = mesh.edges[mask(mesh, "pad")[mesh.edges].all(axis=1)]
        x = millimetres(mesh)
        means.append(float(np.linalg.norm(x[edges[:, 0]] - x[edges[:, 1]], axis=1).mean()))
    assert means == sorted(means, reverse=True)
    assert means[0] < 4.5
    assert means[-1] < 1.0


def test_points_are_put_on_the_surfaces_that_the_grid_draws() -> None:
    """Places off a surface come to lie on it where the formula says 1; those of the grid stay where they are."""
    rng = np.random.default_rng(3)
    for surface in (SKIN, BONE):
        grid = surface.grid(rng.uniform(-1.0, 1.0, 200), rng.uniform(-1.0, 1.0, 200))
        np.testing.assert_allclose(surface.level(grid), 1.0, atol=1e-9)
        np.testing.assert_allclose(surface.nearby(grid), grid, atol=1e-9)
        near = surface.nearby(grid + rng.uniform(-0.3, 0.3, grid.shape))
        np.testing.assert_allclose(surface.level(near), 1.0, atol=1e-9)
        assert np.linalg.norm(near - grid, axis=1).max() < 2.0


def test_an_edge_that_is_cut_is_cut_in_all_its_tets() -> None:
    """Three tets around an edge become six of the same volume and no gap, with angles as they were or better."""
    ring = [[1.0, 0.0, 0.0], [-0.5, 0.9, 0.0], [-0.5, -0.9, 0.0]]
    points = np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0], *ring])
    tets = np.array([[0, 2, 3, 1], [0, 3, 4, 1], [0, 4, 2, 1]])
    x, cells, ends = cut_edges(points, tets, [(0, 1)])
    assert ends.tolist() == [[0, 1]]
    assert x[5].tolist() == [0.0, 0.0, 0.0]
    assert len(cells) == 6
    before, after = TetMesh.from_arrays(points, tets), TetMesh.from_arrays(x, cells)
    assert after.volumes.sum() == pytest.approx(before.volumes.sum())
    assert set(map(frozenset, after.surface.tolist())) == set(map(frozenset, before.surface.tolist()))

    moved = x.copy()
    moved[5] = [0.7, 0.1, 0.6]
    better = widened(moved, cells, lambda node, tried: tried if node == 5 else np.repeat(x[[node]], len(tried), 0), 0.7)
    assert narrowest(moved[cells]).min() < 0.3
    assert narrowest(better[cells]).min() > 2.0 * narrowest(moved[cells]).min()
    assert (better[:5] == x[:5]).all()


@needs_gmsh
def test_what_is_shipped_is_what_the_command_makes(tmp_path: Path) -> None:
    """The fingertip alone, of the same size and shape whatever the version of gmsh."""
    made, kept = write_mesh("finger", tmp_path / "tip.vtu", tets=1000, distal=True), mesh_of("finger_distal")
    assert len(made.tets) == pytest.approx(1000, rel=0.05)
    assert made.volumes.sum() == pytest.approx(kept.volumes.sum(), rel=0.05)
    assert np.degrees(made.min_dihedral_angles.min()) >= 12.0
    assert not mask(made, "bone_nail")[made.tets].all(axis=1).any()
    assert made.node_sets.keys() == kept.node_sets.keys()


@needs_gmsh
@pytest.mark.slow
@pytest.mark.parametrize("distal", [False, True])
def test_a_finger_is_the_same_every_time(tmp_path: Path, distal: bool) -> None:
    """Two generations give the same file, byte for byte."""
    for file in ("a.vtu", "b.vtu"):
        write_mesh("finger", tmp_path / file, tets=1000, distal=distal)
    assert (tmp_path / "a.vtu").read_bytes() == (tmp_path / "b.vtu").read_bytes()


@pytest.mark.parametrize(
    ("tets", "distal"), [(449, False), (449, True), (-5, False), (1000.5, False), (math.nan, True)]
)
def test_impossible_fingers_are_refused(tets: float, distal: bool) -> None:
    """Not a count, or too few tets for the shape."""
    with pytest.raises(MeshError, match="finger tets"):
        finger(tets, distal=distal)  # type: ignore[arg-type]


def test_without_gmsh_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """The error says what to install."""
    monkeypatch.setitem(sys.modules, "gmsh", None)
    with pytest.raises(MissingExtraError, match=r"finger_sim\[mesh\]"):
        finger()
