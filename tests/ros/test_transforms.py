"""Poses in other frames are transformed by tf2 where that is asked for; tf2 itself is a stand-in (tests/stand_ins)."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped, TransformStamped
from rclpy.clock import Clock
from rclpy.logging import get_logger
from ros_helpers import BLOCK_DT, REPOSITORY, Client, NodeProcess, command, environment, write_block
from scipy.spatial.transform import Rotation

from finger_sim.bags import cdr
from finger_sim.bags.poses import read_pose
from finger_sim.bags.reader import BagReader
from finger_sim.simulation.replay import Selection, run

STAND_INS = REPOSITORY / "tests" / "stand_ins"
NOW = 1_000_000_000_000
"""Time of the clock that a Lookup is given [ns]."""


@pytest.fixture
def lookup(monkeypatch: pytest.MonkeyPatch) -> Any:
    """A Lookup into `world`, whose buffer a test fills."""
    monkeypatch.syspath_prepend(str(STAND_INS))
    monkeypatch.delitem(sys.modules, "tf2_ros", raising=False)
    from finger_sim.ros import transforms

    monkeypatch.setattr(transforms, "time_of", lambda clock: NOW)
    yield transforms.Lookup(Node(), "world")
    sys.modules.pop("tf2_ros", None)


class Node:
    """What a Lookup needs of one."""

    def create_subscription(self, *_: Any) -> None: ...

    def get_clock(self) -> Any:
        return Clock()

    def get_logger(self) -> Any:
        return get_logger("test")


def transform(parent: str, child: str, position: Any, turn: Rotation, stamp: int = 0) -> TransformStamped:
    """Where a frame is in another one."""
    message = TransformStamped(child_frame_id=child)
    message.header.frame_id = parent
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 1_000_000_000)
    p, q = message.transform.translation, message.transform.rotation
    p.x, p.y, p.z = map(float, position)
    q.x, q.y, q.z, q.w = map(float, turn.as_quat())
    return message


def test_a_pose_goes_through_all_frames_on_its_way(lookup: Any) -> None:
    """Against matrices of SciPy: a base that stands, and an arm on it that moves; the stamp stays."""
    rng = np.random.default_rng(3)
    turns = Rotation.random(3, random_state=rng)
    points = rng.uniform(-1.0, 1.0, (3, 3))
    lookup._buffer.set_transform(transform("world", "base", points[0], turns[0]), "")
    lookup._buffer.set_transform(transform("base", "arm", points[1], turns[1], NOW - 900_000_000), "")
    moved = read_pose(lookup.in_world(cdr.pose_stamped(123, "arm", points[2], 1.7 * turns[2].as_quat())))
    assert (moved.stamp, moved.frame_id) == (123, "world")
    inside = turns[1].apply(points[2]) + points[1]
    assert np.allclose(moved.values[:3], turns[0].apply(inside) + points[0], atol=1e-14)
    apart = Rotation.from_quat(moved.values[3:]).inv() * turns[0] * turns[1] * turns[2]
    assert apart.magnitude() < 1e-12


def test_what_cannot_be_transformed_stays_as_it_is_and_says_why(lookup: Any) -> None:
    """A frame that nobody knows, one whose transform is old, no number, no pose; and what is in the world frame."""
    lookup._buffer.set_transform(transform("world", "arm", (0, 0, 0), Rotation.identity(), NOW - 1_200_000_000), "")
    level = (0.0, 0.0, 0.0, 1.0)
    for frame, position, says in (
        ("nowhere", (0, 0, 0), "frame_id 'nowhere' cannot be transformed to 'world': \"nowhere\" passed to"),
        ("arm", (0, 0, 0), "the transform from 'arm' to 'world' is 1.2 s old, allowed: 1 s"),
        ("arm", (np.nan, 0, 0), ""),
        ("world", (1, 2, 3), ""),
    ):
        data = cdr.pose_stamped(5, frame, position, level)
        assert lookup.in_world(data) == data
        assert lookup.why(read_pose(data)).startswith(says)
    assert lookup.in_world(b"nothing") == b"nothing"


def test_a_transform_is_looked_up_fifty_times_a_second_at_most(lookup: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """And the newest counts after that; anyone may send any name, and no more than a few are kept."""
    from finger_sim.ros import transforms

    now = [100.0]
    monkeypatch.setattr(transforms.time, "monotonic", lambda: now[0])
    data = cdr.pose_stamped(5, "arm", (0, 0, 0), (0, 0, 0, 1))

    def height(z: float, later: float) -> float:
        lookup._buffer.set_transform(transform("world", "arm", (0, 0, z), Rotation.identity()), "")
        now[0] += later
        return read_pose(lookup.in_world(data)).values[2]

    assert height(1.0, 0.0) == 1.0
    assert height(2.0, 0.015) == 1.0
    assert height(3.0, 0.015) == 3.0
    for k in range(100):
        lookup.in_world(cdr.pose_stamped(5, f"frame_{k}", (0, 0, 0), (0, 0, 0, 1)))
    assert len(lookup._found) <= 16


BASE = ((0.1, -0.2, 0.3), Rotation.from_euler("xyz", (0.4, -0.7, 1.9)))
"""Where the device's base stands in the world."""


def in_base(z: float, number: int) -> PoseStamped:
    """`command(z)` as a device at BASE tells it, with a number for a stamp."""
    message = command(0.0)
    message.header.frame_id = "device_base"
    message.header.stamp.sec, message.header.stamp.nanosec = 7, number
    point, turn = np.array((0.0, 0.0, z)) - BASE[0], BASE[1].inv()
    p, q = message.pose.position, message.pose.orientation
    p.x, p.y, p.z = map(float, turn.apply(point))
    q.x, q.y, q.z, q.w = map(float, turn.as_quat())
    return message


@pytest.mark.parametrize("mode", ["free", pytest.param("triggered", marks=pytest.mark.slow)])
def test_a_device_in_a_frame_of_its_own_drives_the_finger(tmp_path: Path, mode: str) -> None:
    """Refused while nobody says where its base is; followed then. A replay of what is recorded needs no transform."""
    bag = tmp_path / "bag"
    arguments = ("-p", f"scene:={write_block(tmp_path)}", "-p", "transform_commands:=true", "-p", f"record:={bag}")
    paths = f"{STAND_INS}:{environment(0)['PYTHONPATH']}"
    with (
        NodeProcess(tmp_path / "log", *arguments, "-p", f"mode:={mode}", changes={"PYTHONPATH": paths}) as node,
        Client(node.domain) as client,
    ):
        node.wait_for("ready after")
        numbers = iter(range(1, 10_000))
        poses = client.collect(PoseStamped, "pose")
        frames = client.collect(TransformStamped, "/stand_in_broadcast")
        send = lambda: client.publish(in_base(0.0096, next(numbers)))  # noqa: E731
        while (values := client.report(send)[1])["refused commands"] == "0":
            pass
        assert "frame_id 'device_base' cannot be transformed to 'world'" in values["last refusal"]
        assert "command refused: frame_id 'device_base' cannot be transformed" in node.output
        base = transform("world", "device_base", *BASE)
        client.until(lambda: poses and abs(poses[-1].pose.position.z - 0.0096) < 1e-9,
                     lambda: (client.publish(base, "/stand_in_tf"), send()), 2 * BLOCK_DT)  # fmt: skip
        (p, q) = (poses[-1].pose.position, poses[-1].pose.orientation)
        assert max(map(abs, (p.x, p.y, q.x, q.y, q.z))) < 1e-9
        client.until(lambda: any(f.child_frame_id == "finger" for f in frames))
        assert node.end() == 0, node.output
    assert "poses in 'device_base' are transformed to 'world'" in node.output
    said = [read_pose(m.data) for m in BagReader(bag).messages(["/command_pose"])]
    assert "/tf" in {topic.name for topic in BagReader(bag).topics}
    kinds = {pose.frame_id for pose in said}
    assert kinds == {"device_base", "world"}, "refused ones as they came, those that were followed in the world"
    assert all(abs(pose.values[2] - 0.0096) < 1e-12 for pose in said if pose.frame_id == "world")
    if mode == "triggered":
        done = run(None, bag, tmp_path / "again", Selection(mode="triggered"))
        assert done.refused == sum(pose.frame_id == "device_base" for pose in said)
        live, again = (
            [m.data[-56:] for m in BagReader(path).messages(["/pose"])] for path in (bag, tmp_path / "again")
        )
        assert len(live) == sum(pose.frame_id == "world" for pose in said)
        assert live == again


def test_without_tf2_it_says_so(tmp_path: Path) -> None:
    """One line at the start: what cannot be had, and what brings it."""
    done = subprocess.run(
        [sys.executable, "-m", "finger_sim.ros.node", "--ros-args", "-p", f"scene:={write_block(tmp_path)}", "-p",
         "transform_commands:=true"], env=environment(0), capture_output=True, text=True, timeout=100,
    )  # fmt: skip
    assert done.returncode == 1
    assert "transform_commands: got True, allowed: false, as tf2_ros cannot be imported" in done.stderr
    assert "ros-jazzy-tf2-ros-py" in done.stderr
    assert "Traceback" not in done.stderr
