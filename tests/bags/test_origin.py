"""What a bag says of its making: in its metadata and in each of its files, however much of it is left."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from finger_sim.bags import cdr
from finger_sim.bags.frames import Frames
from finger_sim.bags.origin import block_text, mesh_hash, origin_of, read_origin, recorded_scene
from finger_sim.bags.reader import BagReader, BagWriter
from finger_sim.errors import BagError
from finger_sim.scene import Pose, Scene
from finger_sim.scene.mesh import TetMesh
from finger_sim.scene.resources import shipped

MS = 1_000_000
LEVEL = (0.0, 0.0, 0.0, 1.0)
REACHED = {"rate": 999.5, "steps": 3000, "late": 2, "skipped": 1}


def write(path: Path, scene: Scene, *, splits: bool = False) -> Path:
    """Three seconds of commands, in one file or three; what makes it is said first, and the rate reached last."""
    origin = origin_of("node", scene, scene.load_mesh(), {"force_scale": 0.1, "mode": "free"}, {"cpu": "x", "cores": 2})
    with BagWriter(path, origin=origin.words(), split_seconds=1.0 if splits else 1e9) as bag:
        bag.add_topic("command_pose", cdr.POSE_STAMPED)
        for k in range(300):
            bag.write("command_pose", cdr.pose_stamped(k, "world", (0.0, 0.0, 0.0), LEVEL), k * 10 * MS)
        bag.say_at_end({"reached": block_text(REACHED)})
    return path


def test_it_is_read_back_from_folder_file_and_what_is_left_of_one(tmp_path: Path) -> None:
    """All values to the last bit; only the rate is not known where the end is lost."""
    scene = Scene.load("finger_haptic").with_values({"plane.friction": 1 / 3, "limits.stiffness": 1e-3})
    bag = write(tmp_path / "bag", scene)
    origin = read_origin(BagReader(bag))
    assert origin is not None
    assert (origin.made_by, origin.options["force_scale"], origin.machine["cores"]) == ("node", 0.1, 2)
    assert origin.scene["mesh"] == {"file": "meshes/finger.vtu"}
    assert origin.reached == REACHED
    assert recorded_scene(BagReader(bag), origin) == scene
    file = bag / "bag_0.mcap"
    assert read_origin(BagReader(file)) == origin
    os.truncate(file, file.stat().st_size // 2)
    (bag / "metadata.yaml").unlink()
    left = read_origin(BagReader(bag))
    assert left is not None
    assert left.reached == {}
    assert recorded_scene(BagReader(bag), left) == scene


def test_rosbags_reads_it_too(tmp_path: Path) -> None:
    """Under names that begin with finger_sim, the scene as the YAML of a file; the bag can be read as ever."""
    bag = write(tmp_path / "bag", Scene.load("finger"))
    with Reader(bag) as reader:
        assert reader.message_count == 300
    text = (bag / "metadata.yaml").read_text()
    assert "    finger_sim.scene: |\n      mesh: {file: meshes/finger.vtu}\n" in text
    assert f"finger_sim.mesh_sha256: {mesh_hash(Scene.load('finger').load_mesh())}\n" in text


def test_a_later_file_alone_does_not_know_what_was_changed_before_it(tmp_path: Path) -> None:
    """It says what the bag began with, but gives no scene; the folder and the first file do."""
    bag = write(tmp_path / "bag", Scene.load("finger"), splits=True)
    for path in (bag, bag / "bag_0.mcap"):
        reader = BagReader(path)
        assert recorded_scene(reader, read_origin(reader)) == Scene.load("finger")
    reader = BagReader(bag / "bag_1.mcap")
    with pytest.raises(BagError, match=r"file 1 of a bag, .* give the folder"):
        recorded_scene(reader, read_origin(reader))


def test_a_scene_that_cannot_be_had(tmp_path: Path) -> None:
    """None recorded, another mesh where it was, none there: each says so, and both hashes where they differ."""
    mesh = tmp_path / "own.vtu"
    shutil.copy(shipped("config") / "meshes" / "finger.vtu", mesh)
    scene = Scene.load("finger").with_values({"mesh.file": str(mesh)})
    reader = BagReader(write(tmp_path / "bag", scene))
    origin = read_origin(reader)
    assert origin is not None
    assert origin.scene["mesh"]["file"] == str(mesh)
    loaded = TetMesh.load(mesh)
    TetMesh.from_arrays(loaded.points, loaded.tets, loaded.node_sets, loaded.axes[:, [1, 2, 0]]).save(mesh)
    with pytest.raises(
        BagError, match=f"{mesh} has the sha256 {mesh_hash(TetMesh.load(mesh))} now, had {origin.mesh_sha256}"
    ):
        recorded_scene(reader, origin)
    mesh.unlink()
    with pytest.raises(BagError, match=r"the recorded scene cannot be had: .*own\.vtu.* give a scene: finger_sim run"):
        recorded_scene(reader, origin)
    with pytest.raises(BagError, match=r"holds no scene, .* give a scene: finger_sim run SCENE --bag"):
        recorded_scene(reader, None)


def test_frames_as_rosbags_writes_them() -> None:
    """Finger frame, twin and plane, byte for byte as rosbags' own serialiser has them; the plane once it moved."""
    store = get_typestore(Stores.ROS2_JAZZY)

    def message(stamp: int, **poses: Pose) -> bytes:
        transforms = []
        for name, pose in poses.items():
            time = store.types["builtin_interfaces/msg/Time"](*divmod(stamp, 10**9))
            header = store.types["std_msgs/msg/Header"](time, "map")
            p = store.types["geometry_msgs/msg/Vector3"](*pose.position)
            q = store.types["geometry_msgs/msg/Quaternion"](*pose.orientation)
            transform = store.types["geometry_msgs/msg/Transform"](p, q)
            transforms.append(store.types["geometry_msgs/msg/TransformStamped"](header, name, transform))
        kind = "tf2_msgs/msg/TFMessage"
        return bytes(store.serialize_cdr(store.types[kind](transforms), kind))

    finger, level = Pose((1.0, 2.0, 3.0), (0.6, 0.0, 0.0, 0.8)), Pose((1.0, 2.0, 3.0))
    plane, moved, stamp = Pose((0.0, 0.0, 0.1)), Pose((0.0, 0.0, 0.2)), 1_700_000_000_123_456_789
    frames = Frames("map", "tip")
    assert frames.standing(stamp, plane) == message(stamp, plane=plane)
    assert frames.moving(stamp, finger, plane) == message(stamp, tip=finger, tip_world_aligned=level)
    for where in (moved, plane):
        wanted = message(stamp + 7, tip=finger, tip_world_aligned=level, plane=where)
        assert frames.moving(stamp + 7, finger, where) == wanted
    free = Frames("map", "tip")
    assert free.standing(stamp, None) is None
    assert free.moving(stamp, finger, None) == message(stamp, tip=finger, tip_world_aligned=level)


def test_parameter_events_are_read_back_by_every_type() -> None:
    """Name and value of each kind that a parameter of the node has, from the bytes, by rosbags."""
    values = {"a": True, "b": 3, "c": 0.5, "d": "text", "e": [1.0, 2.0], "f": [1, 2], "g": ["x"], "h": [True, False]}
    event = get_typestore(Stores.ROS2_JAZZY).deserialize_cdr(
        cdr.parameter_event(7_000_000_003, "/finger", values), "rcl_interfaces/msg/ParameterEvent"
    )
    fields = ("bool_value", "integer_value", "double_value", "string_value", "double_array_value",
              "integer_array_value", "string_array_value", "bool_array_value")  # fmt: skip
    found = {p.name: getattr(p.value, field) for p, field in zip(event.changed_parameters, fields, strict=True)}
    assert (event.stamp.sec, event.stamp.nanosec, event.node) == (7, 3, "/finger")
    assert {name: np.asarray(value).tolist() for name, value in found.items()} == values
    assert [p.value.type for p in event.changed_parameters] == [1, 2, 3, 4, 8, 7, 9, 6]


def test_foxglove_reads_frames(tmp_path: Path, foxglove: tuple[str, ...]) -> None:
    """The names and places of frames, by Foxglove's reader, in JavaScript."""
    frames = Frames("world", "finger")
    with BagWriter(tmp_path / "bag") as bag:
        bag.add_topic("/tf", "tf2_msgs/msg/TFMessage")
        for k in range(20):
            bag.write("/tf", frames.moving(k * MS, Pose((0.5 * k, 0.0, 0.0)), Pose()), k * MS)
    done = subprocess.run([*foxglove, str(tmp_path / "bag" / "bag_0.mcap")], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    x = json.loads(done.stdout)["x"]
    assert x == [{"finger": 0.5 * k, "finger_world_aligned": 0.5 * k, "plane": 0.0} for k in range(20)]
