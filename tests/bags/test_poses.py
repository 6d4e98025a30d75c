"""Messages on a topic of poses that are none: each is refused for itself, with its number and the reason."""

from __future__ import annotations

from pathlib import Path

import pytest
from mcap.writer import Writer

from finger_sim.bags import cdr
from finger_sim.bags.excerpt import commands_in
from finger_sim.bags.imports.poses import import_poses
from finger_sim.bags.imports.recorded import Reading
from finger_sim.bags.poses import read_pose
from finger_sim.bags.reader import START, BagReader, BagWriter, commands_of, plane_poses_of, read_commands
from finger_sim.errors import BagError
from finger_sim.pictures.info import info

PERIOD = 10_000_000


def good(k: int) -> bytes:
    return cdr.pose_stamped(START + k * PERIOD, "world", (1e-3 * k, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))


BROKEN = {
    3: b"",
    4: good(4)[:40],
    5: b"\x00\x07" + good(5)[2:],
    6: good(6)[:12] + b"\xff\xff\xff\x7f" + good(6)[16:],
    7: bytes(range(90)),
    8: b"\x00\x01\x00\x00" + bytes(56),
    9: good(9)[:8] + b"\xff\xff\xff\xff" + good(9)[12:],
}
"""By their numbers from 1 on: empty, cut short, another encoding, a length of no sense, anything, a Pose, no time."""


def damaged(path: Path) -> Path:
    """A bag of 12 commands and 12 poses of the plane, seven of each broken."""
    with BagWriter(path) as bag:
        for topic in ("command_pose", "plane_pose"):
            bag.add_topic(topic, cdr.POSE_STAMPED)
        for k in range(1, 13):
            for topic in ("command_pose", "plane_pose"):
                bag.write(topic, BROKEN.get(k, good(k)), START + k * PERIOD)
    return path


def test_each_is_refused_for_itself(tmp_path: Path) -> None:
    """Readers of whole bags and of one message at a time leave out the same ones; import and info do not end."""
    path = damaged(tmp_path / "bag")
    reader = BagReader(path)
    commands = commands_of(reader)
    kept = [k for k in range(1, 13) if k not in BROKEN]
    assert [round(1e3 * x) for x in commands.position[:, 0].tolist()] == kept
    assert (commands.refused, commands.refusal) == (7, "message 3: 0 bytes that are no PoseStamped")
    plane = plane_poses_of(reader, commands)
    assert plane is not None
    assert (len(plane), plane.refused) == (5, 7)
    excerpt, tally = commands_in(reader)
    assert (tally.good, tally.refused, tally.refusal) == (5, 7, commands.refusal)
    assert [pose.number for pose in excerpt.poses()] == kept
    assert len(list(excerpt.messages())) == 12
    later = excerpt.cut(START + 8 * PERIOD, None)
    assert [(pose.number, (pose.log_time - START) // PERIOD) for pose in later.poses()] == [
        (2, 8), (10, 10), (11, 11), (12, 12)
    ]  # fmt: skip
    assert str(later.tally().refusal).startswith("message 9: stamp of 1767225600 s and 4294967295 ns, must be")
    made = import_poses(path, tmp_path / "made", reading=Reading(from_topic="command_pose", clock="receipt"))
    assert made.figures.poses == 5 + 1  # a stamp does not make it less of a pose
    assert "6 messages cannot be decoded and are left out; topic /command_pose, message 3: " in made.warnings[0]
    assert any("on /command_pose" in title for title, _ in info(str(path)))


def test_nothing_good_is_an_error(tmp_path: Path) -> None:
    """With the first reason; info shows it."""
    with BagWriter(tmp_path / "bag") as bag:
        bag.add_topic("command_pose", cdr.POSE_STAMPED)
        for k in range(3, 9):
            bag.write("command_pose", BROKEN[k], START + k)
    with pytest.raises(BagError, match="no good command; message 1: 0 bytes that are no PoseStamped"):
        read_commands(tmp_path / "bag")
    with pytest.raises(BagError, match="topic /command_pose, message 1: is no geometry_msgs/msg/PoseStamped"):
        import_poses(tmp_path / "bag", tmp_path / "made")
    assert list(info(str(tmp_path / "bag")))[-1][0] == "commands on /command_pose"


def test_bytes_behind_the_end_and_either_order_are_read() -> None:
    """As rclpy reads them."""
    said = read_pose(good(2))
    assert read_pose(good(2) + bytes(9)) == said
    store = cdr.typestore()
    message = store.deserialize_cdr(good(2), cdr.POSE_STAMPED)
    assert read_pose(bytes(store.serialize_cdr(message, cdr.POSE_STAMPED, little_endian=False))) == said


def test_messages_of_another_type_are_not_heard(tmp_path: Path) -> None:
    """As a subscriber does not hear them: neither refused nor copied; the topic is found all the same."""
    with (tmp_path / "bag.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2")
        for k, kind in enumerate(("geometry_msgs/msg/Pose", cdr.POSE_STAMPED, "geometry_msgs/msg/Pose")):
            schema = writer.register_schema(kind, "ros2msg", cdr.definition(kind)[0].encode())
            channel = writer.register_channel("/command_pose", "cdr", schema)
            writer.add_message(channel, START + k, good(k), START + k)
        writer.finish()
    reader = BagReader(tmp_path / "bag.mcap")
    excerpt, tally = commands_in(reader, "command_pose")
    assert (tally.good, tally.refused) == (1, 0)
    assert [message.log_time for message in excerpt.messages()] == [START + 1]
