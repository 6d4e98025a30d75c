"""Replay: commands hold by their receipt, the output is the node's, the same input makes the same bytes."""

from __future__ import annotations

import hashlib
import json
import math
import os
import subprocess
import sys
from enum import IntFlag
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from finger_sim.bags import cdr
from finger_sim.bags.layout import POINT_NAMES, express_wrench, node_strain, pack_points, wrench_frame_id
from finger_sim.bags.reader import BagReader, BagWriter, read_commands, write_commands
from finger_sim.errors import BagError
from finger_sim.scene import Coupling, Pose, Scene, place
from finger_sim.simulation import replay

START = 1_700_000_000_123_456_789
BEAM = {
    "mesh": {"beam": {"size": [0.03, 0.01, 0.01], "cells": [3, 1, 1]}},
    "driven": {"box": [[-1.0, -1.0, 0.009], [1.0, 1.0, 1.0]]},
    "material": {"density": 1000.0, "young": 5.0e4, "poisson": 0.3},
    "limits": {"stretch": [1.05, 1.25, 1.02], "compress": [0.95, 0.75, 0.98]},
    "plane": {"point": [0, 0, 0], "normal": [0, 0, 1], "friction": 0.5},
    "dt": 0.002,
}


class Bits(IntFlag):
    TIRED = 1
    LOST = 2


class FakeSimulator:
    """Stands for a simulator: notes the commands it is given and answers with numbers that count steps."""

    def __init__(self) -> None:
        self.commands: list[Pose] = []
        self.planes: list[Pose | None] = []
        self.resets: list[Pose] = []
        tets = np.array([[0, 1, 2, 3]])
        self.mesh = SimpleNamespace(
            points=np.vstack([np.zeros(3), np.eye(3)]), tets=tets, surface=tets[:, :3], node_sets={}, axes=np.eye(3)
        )
        self.strain_ratio = np.array([0.75])
        self.contact_forces = np.arange(12.0).reshape(4, 3)
        self.plane_pose = None

    set_down_by = 0.0
    scene = SimpleNamespace(coupling=Coupling())

    def reset(self, pose: Pose, plane: Pose | None = None) -> None:
        self.resets.append(pose)
        self.laid = plane

    def hear(self, pose: Pose, received: float) -> None:
        self.newest = pose

    def step(self, pose: Pose | None, plane: Pose | None = None, now: float | None = None) -> Any:
        pose = pose or self.newest
        self.commands.append(pose)
        self.planes.append(plane)
        self.positions = place(self.mesh.points, pose) + np.array([0.0, 0.0, 0.5])
        k = len(self.commands)
        return SimpleNamespace(
            contact_wrench=np.array([0.0, 0.0, float(k), 0.0, 0.0, 0.0]),
            device_wrench=np.full(6, -1.0),
            pose=pose,
            status=Bits.TIRED | Bits.LOST if k == 2 else Bits(0),
            limited_tets=k % 3,
            max_strain_ratio=0.5 * k,
            max_penetration=1e-6 * k,
        )


def scene(dt: float, plane: dict[str, Any] | None = None) -> Scene:
    return Scene.from_dict({"mesh": {"beam": {}}, "dt": dt, "plane": plane})


def commands(path: Path, receipts: list[int]) -> Path:
    """A bag of commands, received so many ns after START; x counts them."""
    n = len(receipts)
    position = np.stack([np.arange(n), np.zeros(n), np.zeros(n)], axis=1)
    return write_commands(path, [START + r for r in receipts], position, np.tile([0.0, 0.0, 0.0, 1.0], (n, 1)))


def test_the_newest_command_received_holds(tmp_path: Path) -> None:
    """Step k uses the newest command received up to k dt: kept over gaps, skipped if two come in a step."""
    ms = 1_000_000
    bag = commands(tmp_path / "in", [0, 1 * ms, 1 * ms, 1 * ms + 1, 5 * ms, 7 * ms - 1])
    fake = FakeSimulator()
    summary = replay.run(scene(1e-3), bag, tmp_path / "out", simulator=fake)  # type: ignore[arg-type]
    assert [pose.position[0] for pose in fake.commands] == [0, 2, 3, 3, 3, 4, 4, 5]
    assert [pose.position[0] for pose in fake.resets] == [0]
    assert (summary.steps, summary.commands) == (8, 6)
    assert summary.duration == pytest.approx(0.008)


def test_stamps_do_not_drift(tmp_path: Path) -> None:
    """With a dt that no nanosecond count divides, step k is stamped START + k dt to the nanosecond."""
    bag = commands(tmp_path / "in", [0, 10_000_000_000])
    replay.run(scene(1.0 / 300.0), bag, tmp_path / "out", simulator=FakeSimulator())  # type: ignore[arg-type]
    stamps = [m.log_time - START for m in BagReader(tmp_path / "out").messages(["pose"])]
    assert stamps == [(k * 10**9 + 150) // 300 for k in range(1, 3002)]


def test_output_is_what_the_node_publishes(tmp_path: Path) -> None:
    """Topics, types, frames, rates, values: read back by a decoder that shares no code with us."""
    bag = commands(tmp_path / "in", [k * 2_000_000 for k in range(501)])
    fake = FakeSimulator()
    seen: list[tuple[int, int]] = []
    summary = replay.run(
        scene(1e-3),
        bag,
        tmp_path / "out",
        progress=lambda k, n: seen.append((k, n)),
        simulator=fake,  # type: ignore[arg-type]
    )
    assert seen == [(k, 1001) for k in range(1, 1002)]
    assert (summary.peak_force, summary.peak_force_time) == (1001.0, pytest.approx(1.001))
    assert summary.limited_tets == 2
    assert summary.max_penetration == pytest.approx(1.001e-3)
    assert summary.status == {"TIRED": 1, "LOST": 1}
    found: dict[str, list[Any]] = {}
    with (tmp_path / "out" / "out_0.mcap").open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for schema, channel, message, decoded in reader.iter_decoded_messages():
            assert schema is not None
            found.setdefault(f"{channel.topic} {schema.name}", []).append((message.log_time, decoded))
            if channel.topic not in ("/mesh_topology", "/command_pose"):
                stamp = (decoded.transforms[0] if channel.topic == "/tf" else decoded).header.stamp
                assert stamp.sec * 10**9 + stamp.nanosec == message.log_time
    assert {topic: len(messages) for topic, messages in found.items()} == {
        "/command_pose geometry_msgs/msg/PoseStamped": 501,
        "/contact_wrench geometry_msgs/msg/WrenchStamped": 1001,
        "/device_wrench geometry_msgs/msg/WrenchStamped": 1001,
        "/pose geometry_msgs/msg/PoseStamped": 1001,
        "/mesh_points sensor_msgs/msg/PointCloud2": 61,
        "/mesh_topology shape_msgs/msg/Mesh": 1,
        "/tf tf2_msgs/msg/TFMessage": 101,
    }
    _, wrench = found["/contact_wrench geometry_msgs/msg/WrenchStamped"][41]
    assert (wrench.header.frame_id, wrench.wrench.force.z) == ("finger_world_aligned", 42.0)
    logged, pose = found["/pose geometry_msgs/msg/PoseStamped"][41]
    assert (pose.header.frame_id, pose.pose.position.x, logged) == ("world", 20.0, START + 42_000_000)
    _, mesh = found["/mesh_topology shape_msgs/msg/Mesh"][0]
    assert [list(face.vertex_indices) for face in mesh.triangles] == [[0, 1, 2]]
    assert len(mesh.vertices) == 4
    times = np.array([t for t, _ in found["/mesh_points sensor_msgs/msg/PointCloud2"]]) - START
    np.testing.assert_allclose(np.diff(times[1:]), 1e9 / 60, atol=1e6)
    _, cloud = found["/mesh_points sensor_msgs/msg/PointCloud2"][-1]
    assert [(f.name, f.offset, f.datatype) for f in cloud.fields] == [
        (name, 4 * i, 7) for i, name in enumerate(POINT_NAMES)
    ]
    points = np.frombuffer(cloud.data, "<f4").reshape(4, 10)
    np.testing.assert_allclose(points[:, 2], [0.5, 0.5, 0.5, 1.5], rtol=1e-6)
    np.testing.assert_allclose(points[:, 3:6], [[0.0, 0.0, 0.5]] * 4, atol=1e-6)
    np.testing.assert_array_equal(points[:, 6:9], fake.contact_forces)
    np.testing.assert_array_equal(points[:, 9], 0.75)


def test_commands_are_copied_as_read(tmp_path: Path) -> None:
    """Bytes, times and numbers of the commands are in the output, refused ones and losses included."""
    with BagWriter(tmp_path / "in") as bag:
        bag.add_topic("hand/pose", cdr.POSE_STAMPED)
        for k in (1, 2, 5, 6):
            bad = k == 5
            data = cdr.pose_stamped(k, "world", (math.nan if bad else 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
            bag.write("hand/pose", data, START + k * 700_000, START, sequence=k)
    summary = replay.run(
        scene(1e-3),
        tmp_path / "in",
        tmp_path / "out",
        simulator=FakeSimulator(),  # type: ignore[arg-type]
    )
    assert (summary.topic, summary.refused) == ("/hand/pose", 1)
    before, after = (
        list(BagReader(tmp_path / name).messages([topic]))
        for name, topic in (("in", "hand/pose"), ("out", "command_pose"))
    )
    assert [m[2:] for m in after] == [m[2:] for m in before]
    assert read_commands(tmp_path / "out").topic == "/command_pose"


def plane_poses(path: Path, receipts: list[int], bad: tuple[int, ...] = ()) -> Path:
    """Commands every 2 ms for 20 ms, and poses of the plane received so many ns after START; x counts them from 1.

    bad : numbers of those in another frame
    """
    with BagWriter(path) as bag:
        bag.add_topic("command_pose", cdr.POSE_STAMPED)
        bag.add_topic("plane_pose", cdr.POSE_STAMPED)
        level = (0.0, 0.0, 0.0, 1.0)
        for k in range(11):
            bag.write("command_pose", cdr.pose_stamped(k, "world", (k, 0.0, 0.0), level), START + k * 2_000_000)
        for k, receipt in enumerate(receipts, start=1):
            frame = "map" if k in bad else "world"
            bag.write("plane_pose", cdr.pose_stamped(k, frame, (k, 0.0, 0.0), level), START + receipt)
    return path


def test_the_plane_goes_where_it_was_told(tmp_path: Path) -> None:
    """A pose of the plane counts once, in the first step that begins after its receipt, the newest of several.

    At the beginning it rests where the newest before the first command has it; one in another frame is left out, but
    copied; the last one is followed though no command comes with it.
    """
    ms = 1_000_000
    bag = plane_poses(tmp_path / "in", [-50 * ms, -1, 1, 3 * ms, 3 * ms + 5, 3 * ms + 7, 20 * ms, 90 * ms], bad=(6,))
    fake = FakeSimulator()
    summary = replay.run(scene(1e-3, plane={}), bag, tmp_path / "out", simulator=fake)  # type: ignore[arg-type]
    told = {k: plane.position[0] for k, plane in enumerate(fake.planes) if plane is not None}
    assert fake.laid is not None
    assert fake.laid.position[0] == 2
    assert told == {1: 3, 3: 4, 4: 5, 20: 7, 90: 8}
    assert (summary.steps, summary.plane_topic) == (91, "/plane_pose")
    assert (summary.plane_poses, summary.plane_refused) == (7, 1)
    for topic in ("plane_pose", "command_pose"):
        before, after = (list(BagReader(tmp_path / name).messages([topic])) for name in ("in", "out"))
        assert before == after


def test_a_scene_without_a_plane_has_none_to_move(tmp_path: Path) -> None:
    """As the node does, it refuses all poses of the plane and goes on."""
    bag, fake = plane_poses(tmp_path / "in", [0, 5_000_000]), FakeSimulator()
    summary = replay.run(scene(1e-3), bag, tmp_path / "out", simulator=fake)  # type: ignore[arg-type]
    assert fake.planes == [None] * 21
    assert (summary.plane_poses, summary.plane_refused) == (0, 2)


def test_a_plane_that_moves_is_replayed_bit_by_bit(tmp_path: Path) -> None:
    """A table drawn away from the block ends the touch; the output, replayed, gives itself."""
    bag, still = tmp_path / "in", press(tmp_path / "still")
    with BagWriter(bag) as both:
        for message in BagReader(still):
            both.write(both.add_topic(message.topic, message.type), message.data, message.log_time)
        both.add_topic("plane_pose", cdr.POSE_STAMPED)
        for k in range(100):
            at = (0.0, 0.0, -2e-5 * max(0, k - 4))
            data = cdr.pose_stamped(0, "world", at, (0.0, 0.0, 0.0, 1.0))
            both.write("plane_pose", data, START + 4_000_000 * k)
    beam = Scene.from_dict(BEAM)
    moved = replay.run(beam, bag, tmp_path / "a" / "out")
    again = replay.run(beam, tmp_path / "a" / "out", tmp_path / "b" / "out")
    assert (moved.plane_poses, again.plane_poses) == (100, 100)
    assert len({(tmp_path / name / "out" / "out_0.mcap").read_bytes() for name in "ab"}) == 1
    rest = replay.run(beam, still, tmp_path / "c" / "out")
    assert rest.plane_topic is None
    assert rest.peak_force > 2.0 * moved.peak_force > 0.0


def test_cut_off_commands_are_used_and_told(tmp_path: Path) -> None:
    """A bag of commands that was cut off is replayed up to its last whole chunk, with a warning."""
    bag = commands(tmp_path / "in", [k * 2_000_000 for k in range(1000)])
    os.truncate(bag / "in_0.mcap", (bag / "in_0.mcap").stat().st_size // 2)
    summary = replay.run(scene(1e-2), bag, tmp_path / "out", simulator=FakeSimulator())  # type: ignore[arg-type]
    assert "cut off" in str(summary.warning)
    assert 250 <= summary.commands < 1000


def test_existing_output_is_refused_before_any_work(tmp_path: Path) -> None:
    """Nothing is simulated when the output is in the way, and nothing is made when the input is bad."""
    bag = commands(tmp_path / "in", [0])
    fake = FakeSimulator()
    with pytest.raises(BagError, match="exists already"):
        replay.run(scene(1e-3), bag, bag, simulator=fake)  # type: ignore[arg-type]
    with pytest.raises(BagError, match="no such bag"):
        replay.run(scene(1e-3), tmp_path / "no", tmp_path / "out", simulator=fake)  # type: ignore[arg-type]
    assert not fake.commands
    assert not (tmp_path / "out").exists()


def press(path: Path) -> Path:
    """0.4 s of a block pressed 1 mm and turned a little."""
    t = np.arange(200) * 0.002
    position = np.stack([0.0 * t, 0.01 * t, -1e-3 * np.sin(np.pi * t / 0.4)], axis=1)
    half = 0.05 * t
    orientation = np.stack([0.0 * t, 0.0 * t, np.sin(half), np.cos(half)], axis=1)
    return write_commands(path, [START + int(s * 1e9) for s in t], position, orientation)


RUN = "import json, sys; from finger_sim import Scene; from finger_sim.simulation import replay; \
replay.run(Scene.from_dict(json.loads(sys.argv[3])), sys.argv[1], sys.argv[2])"


def test_bit_identical_twice_and_in_a_fresh_process(tmp_path: Path) -> None:
    """The real simulator, the same commands: the same bytes here, again, and in a new process.

    With an empty kernel cache this process compiles and the new one loads: that must not show either.
    """
    bag = press(tmp_path / "in")
    beam = Scene.from_dict(BEAM)
    summary = replay.run(beam, bag, tmp_path / "a" / "out")
    assert summary.peak_force > 0.1
    replay.run(beam, bag, tmp_path / "b" / "out")
    environment = {**os.environ, "PYTHONPATH": str(Path(replay.__file__).parents[2])}
    command = [sys.executable, "-c", RUN, str(bag), str(tmp_path / "c" / "out"), json.dumps(BEAM)]
    subprocess.run(command, check=True, env=environment)
    digests = {hashlib.sha256((tmp_path / name / "out" / "out_0.mcap").read_bytes()).hexdigest() for name in "abc"}
    assert len(digests) == 1


def test_wrench_by_a_lever_arm() -> None:
    """A force on a lever: the right torque about each point, in each axes."""
    quarter = math.sqrt(0.5)
    pose = Pose(position=(0.0, 0.0, 2.0), orientation=(0.0, 0.0, quarter, quarter))  # finger x is world y
    at, force = np.array([3.0, 0.0, 2.0]), np.array([0.0, 0.0, 10.0])
    about_finger = np.concatenate([force, np.cross(at - pose.position, force)])
    np.testing.assert_allclose(about_finger, [0, 0, 10, 0, -30, 0])
    np.testing.assert_array_equal(express_wrench(about_finger, pose, "world_aligned"), about_finger)
    np.testing.assert_allclose(express_wrench(about_finger, pose, "finger"), [0, 0, 10, -30, 0, 0], atol=1e-12)
    sideways = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0])  # through the finger's origin, 2 m above the world's
    np.testing.assert_allclose(express_wrench(sideways, pose, "world"), [1, 0, 0, 0, 2, 0], atol=1e-15)
    assert wrench_frame_id("world_aligned", "tip") == "tip_world_aligned"
    assert wrench_frame_id("finger", "tip") == "tip"
    assert wrench_frame_id("world", "tip", "map") == "map"
    for call in (lambda: express_wrench(sideways, pose, "base"), lambda: wrench_frame_id("base")):  # type: ignore
        with pytest.raises(ValueError, match="got 'base', allowed: world_aligned, finger, world"):
            call()


def test_points_of_a_rigid_motion_are_not_displaced() -> None:
    """Displacement is what is left after the rigid motion; a node's strain is the largest around it."""
    rest = np.random.default_rng(0).normal(size=(6, 3))
    pose = Pose(position=(1.0, 2.0, 3.0), orientation=(0.5, 0.5, 0.5, 0.5))
    moved = place(rest, pose)
    np.testing.assert_allclose(moved, rest[:, [2, 0, 1]] + [1.0, 2.0, 3.0], rtol=1e-14)
    tets = np.array([[0, 1, 2, 3], [1, 2, 3, 4]])
    strain = node_strain(np.array([0.2, 0.9]), tets, 6)
    np.testing.assert_array_equal(strain, [0.2, 0.9, 0.9, 0.9, 0.9, 0.0])
    points = pack_points(moved, place(rest, pose), rest, strain)
    np.testing.assert_array_equal([points[name] for name in ("dx", "dy", "dz")], 0.0)
    np.testing.assert_allclose(points["fy"], rest[:, 1], rtol=1e-6)
    assert points.tobytes() == pack_points(moved, place(rest, pose), rest, strain, out=points).tobytes()
