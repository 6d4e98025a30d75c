"""What the node refuses, a replay of its recording refuses too: message by message, in both modes of steps."""

from __future__ import annotations

import math
import struct

import pytest
from geometry_msgs.msg import PoseStamped
from rclpy.serialization import serialize_message
from ros_helpers import Client, NodeProcess, command, write_block

from finger_sim.simulation.replay import Replay, Selection, run


def stamped(sec: int, nanosec: int) -> bytes:
    message = command(0.01)
    message.header.stamp.sec, message.header.stamp.nanosec = sec, nanosec
    return bytes(serialize_message(message))


def framed(frame_id: str) -> bytes:
    message = command(0.01)
    message.header.frame_id = frame_id
    return bytes(serialize_message(message))


GOOD = stamped(7, 5)
REFUSED = [
    GOOD[:52],
    GOOD[:12] + struct.pack("<I", 2**32 - 1) + GOOD[16:],
    b"\x00\x01\x00\x00" + bytes(56),
    bytes(range(90)),
    framed("map"),
    GOOD[:-8] + struct.pack("<d", math.inf),
    stamped(2**31 - 1, 2**32 - 1),
    stamped(-(2**31), 0),
    stamped(0, 1_000_000_000),
]
"""Cut short, a length of no sense, a Pose, anything, another frame, no number, stamps that are no times."""
TAKEN = [stamped(2**31 - 1, 999_999_999), stamped(0, 1), GOOD + b"\x00" * 9]
"""The latest and the earliest stamp that are times, and bytes behind the end."""


TOPICS = ("command_pose", "plane_pose")
RELIABLE = "qos_overrides./command_pose.subscription.reliability:=reliable"


@pytest.mark.parametrize("mode", [pytest.param(mode, marks=pytest.mark.slow) for mode in ("triggered", "free")])
def test_a_replay_refuses_what_the_node_refused(tmp_path, mode):
    """Commands and poses of the plane alike; the node goes on, and counts what its recording, replayed, counts."""
    bag = tmp_path / "bag"
    arguments = ("-p", f"scene:={write_block(tmp_path)}", "-p", f"mode:={mode}", "-p", f"record:={bag}")
    with NodeProcess(tmp_path / "log", *arguments, "-p", RELIABLE) as node, Client(node.domain) as client:
        node.wait_for("ready after")

        def refused() -> int:
            values = {item.key: item.value for item in client.reports[-1].status[0].values} if client.reports else {}
            return int(values.get("refused commands", 0))

        def send(topic, messages) -> None:
            for data in messages:
                publishers[topic].publish(data)

        publishers = {topic: client.node.create_publisher(PoseStamped, topic, 100) for topic in TOPICS}
        client.until(lambda: all(publisher.get_subscription_count() for publisher in publishers.values()))
        send("command_pose", (GOOD, *REFUSED, *TAKEN))
        client.until(lambda: refused() >= len(REFUSED))
        # Nobody repeats a pose of the plane that is lost, and ten may wait.
        client.until(lambda: refused() > len(REFUSED), lambda: send("plane_pose", (*REFUSED[-3:], *TAKEN)), 0.5)
        values = client.report()[1]
        assert node.end() == 0
        assert "Traceback" not in node.output
    replay = Replay(None, bag)
    commands, plane = replay.tally, replay.plane_tally
    assert (commands.good, commands.refused) == (1 + len(TAKEN), len(REFUSED))
    assert commands.refusal == "message 2: 52 bytes that are no PoseStamped"
    assert int(values["received commands"]) == commands.good + commands.refused
    assert int(values["refused commands"]) == commands.refused + plane.refused
    assert plane.refused > 0
    done = run(None, bag, tmp_path / "again", Selection(mode="triggered"))
    assert (done.steps, done.refused, done.plane_refused) == (commands.good, commands.refused, plane.refused)
