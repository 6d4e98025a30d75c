"""Bags of ROS 1 and ROS 2 become bags of commands: topics, frames, and whose clock."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from finger_sim.bags.imports.poses import import_poses
from finger_sim.bags.imports.recorded import Reading
from finger_sim.bags.reader import BagReader, Commands, read_commands
from finger_sim.errors import BagError

POSE, POSES, TRANSFORM, ODOMETRY, TF, TWIST = (
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "geometry_msgs/msg/TransformStamped",
    "nav_msgs/msg/Odometry",
    "tf2_msgs/msg/TFMessage",
    "geometry_msgs/msg/TwistStamped",
)
RECEIVED = 1_700_000_000_000_000_000
QUARTER = (0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5))
"""A turn by 90° about z: x becomes y."""
ABOUT_X = (math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5))
"""A turn by 90° about x: y becomes z."""
Entry = tuple[int, str, str, Any]
"""When it was received [ms], topic, type, and what `Makes` makes the message of."""


class Makes:
    """Messages of one of the two ROS."""

    def __init__(self, ros: int) -> None:
        self.ros = ros
        self.store = get_typestore(Stores.ROS1_NOETIC if ros == 1 else Stores.ROS2_JAZZY)
        if ros == 1:
            self.store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms\n", TF))

    def new(self, type: str, *values: Any) -> Any:
        return self.store.types[type](*values)

    def header(self, stamp: float, frame: str) -> Any:
        whole = int(stamp)
        time = self.new("builtin_interfaces/msg/Time", whole, round((stamp - whole) * 1e9))
        return self.new("std_msgs/msg/Header", *((0,) if self.ros == 1 else ()), time, frame)

    def message(self, type: str, stamp: float, frame: str, child: str, p: Sequence[float], q: Sequence[float]) -> Any:
        """A message of that pose; its stamp in [s]."""
        header = self.header(stamp, frame)
        vector, turn = self.new("geometry_msgs/msg/Vector3", *p), self.new("geometry_msgs/msg/Quaternion", *q)
        if type == TWIST:
            return self.new(type, header, self.new("geometry_msgs/msg/Twist", vector, vector))
        if type in (TRANSFORM, TF):
            moved = self.new(TRANSFORM, header, child, self.new("geometry_msgs/msg/Transform", vector, turn))
            return moved if type == TRANSFORM else self.new(TF, [moved])
        pose = self.new("geometry_msgs/msg/Pose", self.new("geometry_msgs/msg/Point", *p), turn)
        if type == POSE:
            return self.new(type, header, pose)
        uncertain = self.new("geometry_msgs/msg/PoseWithCovariance", pose, np.zeros(36))
        if type == POSES:
            return self.new(type, header, uncertain)
        twist = self.new("geometry_msgs/msg/Twist", vector, vector)
        return self.new(
            type, header, child, uncertain, self.new("geometry_msgs/msg/TwistWithCovariance", twist, np.zeros(36))
        )


def made(path: Path, *entries: Entry) -> Path:
    """A bag of ROS 1 where `path` ends in .bag, else of ROS 2."""
    makes = Makes(1 if path.suffix == ".bag" else 2)
    writer: Any = Writer1(path) if makes.ros == 1 else Writer2(path, version=9, storage_plugin=StoragePlugin.SQLITE3)
    with writer:
        connections: dict[str, Any] = {}
        for received, topic, type, values in entries:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, type, typestore=makes.store)
            serialize = makes.store.serialize_ros1 if makes.ros == 1 else makes.store.serialize_cdr
            writer.write(
                connections[topic], RECEIVED + received * 1_000_000, serialize(makes.message(type, *values), type)
            )
    return path


def taken(bag: Path, **reading: Any) -> Commands:
    """The commands of an imported bag."""
    out = bag.parent / f"out{len(list(bag.parent.glob('out*')))}"
    return read_commands(import_poses(bag, out, reading=Reading(**reading)).path)


def said(bag: Path, **reading: Any) -> str:
    """What is said of an imported bag."""
    made = import_poses(bag, bag.parent / f"out{len(list(bag.parent.glob('out*')))}", reading=Reading(**reading))
    return "\n".join((made.format, *made.notes, *made.warnings))


def refusal(bag: Path, **reading: Any) -> str:
    """Why a bag is not imported."""
    with pytest.raises(BagError) as caught:
        taken(bag, **reading)
    return str(caught.value)


def course(type: str, topic: str = "/hand", frame: str = "base", child: str = "tool") -> list[Entry]:
    """Three poses sampled every 10 ms, received 3, 1 and 8 ms later."""
    stamps = (5.0, 5.01, 5.02)
    late = (3, 11, 28)
    return [
        (at, topic, type, (stamp, frame, child, (0.1 * k, -0.2, 0.3), QUARTER))
        for k, (at, stamp) in enumerate(zip(late, stamps, strict=True))
    ]


@pytest.mark.parametrize("name", ["hand.bag", "hand"])
def test_topics_of_poses_of_both_ros(tmp_path: Path, name: str) -> None:
    """Each type of pose gives the same commands; the header's clock where it runs, or the one that is asked for."""
    for type in (POSE, POSES, TRANSFORM, ODOMETRY):
        folder = tmp_path / type.rpartition("/")[2]
        folder.mkdir()
        bag = made(folder / name, *course(type))
        commands = taken(bag)
        np.testing.assert_array_equal(commands.receipt_ns, [0, 10_000_000, 20_000_000])
        np.testing.assert_allclose(commands.position, [[0.0, -0.2, 0.3], [0.1, -0.2, 0.3], [0.2, -0.2, 0.3]])
        np.testing.assert_allclose(commands.orientation, [QUARTER] * 3)
        assert commands.frame_id == "world"
        text = said(bag)
        assert f"{type} on /hand" in text
        assert "in 'base'" in text
        assert "times of header stamps" in text
    np.testing.assert_array_equal(taken(bag, clock="receipt").receipt_ns, [0, 8_000_000, 25_000_000])
    assert "times of receipt" in said(bag, clock="receipt")


@pytest.mark.parametrize(
    ("stamps", "why"),
    [((0.0, 0.0, 0.0), "are zero"), ((7.0, 7.0, 7.0), "stand still"), ((5.0, 5.02, 5.01), "fall by 0.01 s at pose 3")],
)
def test_receipt_where_stamps_tell_no_time(tmp_path: Path, stamps: tuple[float, ...], why: str) -> None:
    """Stamps that are zero, stand still or fall: times of receipt, and it is said; asked for, they are refused."""
    entries = [
        (at, "/hand", POSE, (stamp, *values[1:]))
        for stamp, (at, _, _, values) in zip(stamps, course(POSE), strict=True)
    ]
    bag = made(tmp_path / "hand", *entries)
    np.testing.assert_array_equal(taken(bag).receipt_ns, [0, 8_000_000, 25_000_000])
    assert f"times of receipt, for header stamps {why}" in said(bag)
    assert f"header stamps {why}, allowed with --clock header" in refusal(bag, clock="header")


def test_which_topic(tmp_path: Path) -> None:
    """Of several the user chooses; what holds none is told what does, and that velocities are no poses."""
    bag = made(tmp_path / "two", *course(POSE), *course(ODOMETRY, "/odom"), *course(TWIST, "/twist"))
    text = refusal(bag)
    assert f"/hand ({POSE}, 3 messages), /odom ({ODOMETRY}, 3 messages); choose one with --from-topic" in text
    assert "/twist" not in text
    assert len(taken(bag, from_topic="odom")) == 3
    assert "no topic /none; found /hand" in refusal(bag, from_topic="none")
    assert "topic /twist is geometry_msgs/msg/TwistStamped, allowed: " in refusal(bag, from_topic="/twist")
    assert "--columns is for text files" in refusal(bag, columns={"t": "time"})
    assert "is a bag, not TUM" in refusal(made(tmp_path / "one.bag", *course(POSE)), format="tum")
    only = refusal(made(tmp_path / "velocities", *course(TWIST, "/twist")))
    assert "no topic of poses" in only
    assert "velocities say no place: record the device's PoseStamped" in only
    several = made(tmp_path / "several", *course(TRANSFORM), *course(TRANSFORM, child="thumb"))
    assert "moves several frames: thumb, tool; choose one with --tf" in refusal(several)
    assert len(taken(several, tf=("base", "thumb"))) == 3


def test_poses_that_are_none_are_left_out_and_said(tmp_path: Path) -> None:
    """Not finite, or in another frame than most: the others go through, as the node would take them."""
    lost = (15, "/hand", POSE, (5.015, "base", "", (math.nan, 0.0, 0.0), QUARTER))
    astray = (16, "/hand", POSE, (5.016, "map", "", (0.0, 0.0, 0.0), QUARTER))
    bag = made(tmp_path / "hand", *course(POSE), lost, astray)
    assert len(taken(bag)) == 3
    assert "2 messages are left out; message 3: position: got (nan, 0.0, 0.0)" in said(bag)


def frames(name: Path) -> Path:
    """base → arm turned (static, received late), arm → hand turned and moving by 1 m/s, world → base moving too."""
    moving = [(10 * k, "/tf", TF, (5.0 + 0.01 * k, "/arm", "/hand", (0.01 * k, 0.0, 0.5), ABOUT_X)) for k in range(5)]
    slow = [
        (15 + 20 * k, "/tf", TF, (5.005 + 0.02 * k, "world", "base", (0.0, 0.0, 0.2 * k), (0.0, 0.0, 0.0, 1.0)))
        for k in range(2)
    ]
    static = (30, "/tf_static", TF, (0.0, "base", "arm", (1.0, 2.0, 0.0), QUARTER))
    return made(name, *sorted([*moving, *slow, static], key=lambda entry: entry[0]))


@pytest.mark.parametrize("name", ["arm.bag", "arm"])
def test_frames_are_followed_both_ways(tmp_path: Path, name: str) -> None:
    """A chain up and down, static parts composed in, slower parts interpolated: by hand, p = p₁ + R₁ p₂."""
    bag = frames(tmp_path / name)
    commands = taken(bag, tf=("base", "hand"))
    np.testing.assert_allclose(commands.receipt, 0.01 * np.arange(5), atol=1e-9)
    np.testing.assert_allclose(commands.position, [[1.0, 2.0 + 0.01 * k, 0.5] for k in range(5)], atol=1e-12)
    np.testing.assert_allclose(commands.orientation, [[0.5] * 4] * 5, atol=1e-12)  # x becomes y, y z, z x
    back = taken(bag, tf=("hand", "base"))
    np.testing.assert_allclose(back.position, [[-2.0 - 0.01 * k, -0.5, -1.0] for k in range(5)], atol=1e-12)
    np.testing.assert_allclose(back.orientation, [[-0.5, -0.5, -0.5, 0.5]] * 5, atol=1e-12)
    both = taken(bag, tf=("world", "hand"))
    heights = [0.55, 0.65]  # at 5.01 and 5.02 s, where world → base is known on either side
    np.testing.assert_allclose(both.position, [[1.0, 2.01, heights[0]], [1.0, 2.02, heights[1]]], atol=1e-9)
    text = said(bag, tf=("world", "hand"))
    assert "transforms world → base → arm → hand" in text
    assert "at the times of arm → hand, the others interpolated" in text
    assert "no way from frame 'base' to 'nose'; found arm → hand (5 times)" in refusal(bag, tf=("base", "nose"))
    assert "nothing moves" in refusal(bag, tf=("base", "arm"))
    assert "say which with --tf PARENT CHILD; found arm → hand (5 times)" in refusal(bag)
    assert "--tf and --from-topic: allowed: one of them" in refusal(bag, tf=("a", "b"), from_topic="tf")


def test_ros1_elsewhere_names_what_converts(tmp_path: Path) -> None:
    """Where only ROS 2 is read, the two commands that make a bag of it; a broken one is no traceback."""
    bag = made(tmp_path / "hand.bag", *course(POSE))
    with pytest.raises(BagError) as caught:
        BagReader(bag)
    assert f"a ROS 1 bag: `finger_sim import {bag} -o NAME` makes" in str(caught.value)
    assert f"`rosbags-convert --src {bag} --dst FOLDER`" in str(caught.value)
    renamed = bag.rename(tmp_path / "hand.bag.orig")
    assert len(taken(renamed)) == 3
    bag.write_bytes(renamed.read_bytes()[:3000])
    assert "a ROS 1 bag that cannot be read: " in refusal(bag)
    (tmp_path / "empty.bag").write_bytes(b"#ROSBAG V1.2\n")
    assert "Bag version 102 is not supported" in refusal(tmp_path / "empty.bag")


def test_a_damaged_database_is_no_traceback(tmp_path: Path) -> None:
    """A row of a sqlite3 bag that claims a wrong length is left out, and said; all others are read."""
    made(tmp_path / "hand", *(entry for _ in range(200) for entry in course(POSE)))
    database = next((tmp_path / "hand").glob("*.db3"))
    data, size, leaf = bytearray(database.read_bytes()), 4096, 0x0D
    page = next(at for at in range(len(data) // 2 // size * size, len(data), size) if data[at] == leaf)
    data[page + int.from_bytes(data[page + 8 : page + 10])] = 0xF8
    database.write_bytes(data)
    found = BagReader(tmp_path / "hand")
    assert found.message_count == len(list(found)) >= 590
    assert re.search(r"hand.db3: messages between rows \d+ and \d+ cannot be read", str(found.warning))
