"""Clouds as pictures: where the finger is, what touches, sticks and slips, against its own simulation."""

from __future__ import annotations

import numpy as np
import pytest
from cases import for_each
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from finger_sim import Pose, Scene
from finger_sim.bags import cdr
from finger_sim.bags.layout import pack_points
from finger_sim.errors import FingerSimError
from finger_sim.scene import place
from finger_sim.view.picture import Ground, Painter, plane_frame
from finger_sim.view.raw import Cloud, CloudReader, read_wrench
from finger_sim.view.samples import KEPT, Samples

MESH = Scene.load("finger_haptic").load_mesh()
RANDOM = np.random.default_rng(3)


def cloud(pose: Pose, forces=None, time: int = 0) -> Cloud:
    """The finger, bent at random by up to 2 mm."""
    placed = place(MESH.points, pose)
    bent = placed + RANDOM.uniform(-2e-3, 2e-3, placed.shape)
    points = pack_points(bent, placed, np.zeros_like(placed) if forces is None else forces, np.zeros(len(placed)))
    return CloudReader().read(cdr.point_cloud(time, "world", points))


HALF_TURNS = [[180, 0, 0], [0, 180, 0], [0, 0, 180], [0, 0, 0]]


@for_each("k", range(12))
def test_the_pose_of_the_finger_frame(k) -> None:
    """Whatever the finger's shape: position to a micrometre, orientation to 1e-4, in any attitude."""
    turn = Rotation.from_euler("xyz", HALF_TURNS[k], degrees=True) if k < 4 else Rotation.random(random_state=k)
    position = RANDOM.uniform(-0.2, 0.2, 3)
    picture = Painter(MESH.points).paint(cloud(Pose(position, turn.as_quat())), 1.0, Ground())
    assert_allclose(picture.pose[:3], position, atol=1e-6)
    assert (Rotation.from_quat(picture.pose[3:]) * turn.inv()).magnitude() < 1e-4


def test_forces_together_and_their_centre() -> None:
    """The wrench is about the finger frame's origin; the centre of pressure is that of the normal forces."""
    forces = np.zeros_like(MESH.points)
    nodes = [5, 40, 99]
    forces[nodes] = RANDOM.uniform(0.1, 1.0, (3, 3))
    pose = Pose((0.1, -0.2, 0.05))
    scene_plane = Scene.load("finger_haptic").with_values({"plane.normal": [0.1, -0.3, 1.0]}).plane
    ground = Ground(plane_frame(scene_plane), 0.5)
    assert_allclose(ground.normal, scene_plane.unit_normal, atol=1e-12)
    seen = cloud(pose, forces)
    picture = Painter(MESH.points).paint(seen, 1.0, ground)
    at = seen.points[:, :3].astype(float)
    assert_allclose(picture.wrench[:3], forces.sum(axis=0), rtol=1e-6)
    assert_allclose(picture.wrench[3:], np.cross(at - pose.position, forces).sum(axis=0), atol=1e-6)
    push = forces @ scene_plane.unit_normal
    assert_allclose(picture.centre, push @ at / push.sum(), atol=1e-7)
    assert picture.contacts["node"].tolist() == nodes
    depth = -((place(MESH.points, pose)) @ scene_plane.unit_normal).min()
    assert abs(picture.depth - max(depth, 0.0)) < 1e-6


def test_what_sticks_and_what_slips() -> None:
    """Friction at its limit, and motion along the plane: one alone is no slip; a plane that moves along is none."""
    forces = np.zeros_like(MESH.points)
    forces[10], forces[20], forces[30] = [0.5, 0, 1], [0.5, 0, 1], [0.2, 0, 1]
    rest = pack_points(MESH.points, MESH.points, forces, np.zeros(len(MESH.points)))
    moved = MESH.points.copy()
    moved[[10, 30]] += [1e-5, 0, 0]
    after = pack_points(moved, MESH.points, forces, np.zeros(len(MESH.points)))
    clouds = [CloudReader().read(cdr.point_cloud(0, "world", points)) for points in (rest, after)]
    painter, ground = Painter(MESH.points), Ground(Pose(), 0.5, 1e-3)
    assert painter.paint(clouds[0], 1.0, ground).contacts["slips"].tolist() == [0, 0, 0]
    assert painter.paint(clouds[1], 1.01, ground).contacts["slips"].tolist() == [1, 0, 0]
    painter.forget()
    painter.paint(clouds[0], 1.0, ground)
    carried = Ground(Pose((1e-5, 0, 0)), 0.5, 1e-3)
    assert painter.paint(clouds[1], 1.01, carried).contacts["slips"].tolist() == [0, 1, 0]


def test_bytes_that_are_no_messages() -> None:
    """Each is refused in words, whatever its length."""
    good = cdr.point_cloud(0, "world", pack_points(MESH.points, MESH.points, MESH.points, MESH.points[:, 0]))
    reader = CloudReader()
    assert len(reader.read(good).points) == len(MESH.points)
    wrench = cdr.wrench_stamped(0, "world", np.arange(6.0))
    assert read_wrench(wrench) == ("world", (0.0, 1.0, 2.0, 3.0, 4.0, 5.0))
    for data in (b"", b"\0\1\0\0", good[:100], good[:-500], wrench, b"\0\0" + good[2:], bytes(4000)):
        with pytest.raises(FingerSimError):
            CloudReader().read(data)
    for data in (b"", wrench[:30], b"\0\0" + wrench[2:]):
        with pytest.raises(FingerSimError):
            read_wrench(data)


def test_samples_since() -> None:
    """Those after the last one that was sent; the oldest are forgotten; a page that comes new gets all."""
    samples = Samples()
    assert samples.since(-1, 0.0) == (b"", -1)
    for k in range(KEPT + 50):
        samples.add(0.01 * k, float(k), 0.0, 0.0, 1e-3)
    data, newest = samples.since(-1, 100.0)
    rows = np.frombuffer(data, "<f4").reshape(-1, 5)
    assert (len(rows), newest) == (KEPT, KEPT + 49)
    assert rows[:, 1].tolist() == list(range(50, KEPT + 50))
    assert rows[-1].tolist() == pytest.approx([0.01 * (KEPT + 49) - 100.0, KEPT + 49, 0, 0, 1.0], rel=1e-5)
    data, newest = samples.since(KEPT + 46, 100.0)
    assert np.frombuffer(data, "<f4").reshape(-1, 5)[:, 1].tolist() == [KEPT + 47, KEPT + 48, KEPT + 49]
    assert samples.since(newest, 100.0) == (b"", newest)
