"""A recording of the node says what made it: scene, parameters, what was changed live, frames, what was logged."""

from __future__ import annotations

import math
import time

import numpy as np
import pytest
from rcl_interfaces.msg import ParameterEvent
from rclpy.serialization import deserialize_message
from ros_helpers import Client, NodeProcess, beyond_replay, forces, kept_pace, write_block
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore
from std_srvs.srv import Trigger

from finger_sim import Scene
from finger_sim.bags.origin import read_origin
from finger_sim.bags.reader import BagReader
from finger_sim.simulation import replay


def read(bag, *topics):
    """(topic, log time [ns], message) of some topics, read with rosbags alone."""
    store = get_typestore(Stores.ROS2_JAZZY)
    with Reader(bag) as reader:
        connections = [connection for connection in reader.connections if connection.topic in topics]
        return [
            (connection.topic, at, store.deserialize_cdr(data, connection.msgtype))
            for connection, at, data in reader.messages(connections)
        ]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A recording of presses and slides, with friction and force_scale changed live and a reset; what was heard."""
    folder = tmp_path_factory.mktemp("origin")
    scene = write_block(folder)
    arguments = ("-p", f"scene:={scene}", "-p", f"record:={folder / 'bag'}", "-p", "finger_frame:=tip")
    with NodeProcess(folder / "log", *arguments, "-p", "plane.friction:=0.4") as node:
        node.wait_for("ready after")
        with Client(node.domain) as client:
            events = client.collect(ParameterEvent, "/parameter_events")
            client.until(lambda: client.node.count_publishers("/parameter_events") > 1)
            client.command(0.002)
            begin = time.monotonic()
            age = lambda: time.monotonic() - begin  # noqa: E731
            stroke = lambda: client.command(0.001 - 0.0013 * math.sin(3.0 * age()), 0.002 * math.sin(7.0 * age()))  # noqa: E731
            client.until(lambda: age() > 0.5, stroke)
            assert client.set("plane.friction", 0).successful
            client.until(lambda: age() > 0.6, stroke)
            assert client.set("force_scale", 0.1).successful
            assert not client.set("plane.friction", -1.0).successful
            client.until(lambda: age() > 2.6, stroke)
            assert client.call(Trigger, "/finger/reset", Trigger.Request()).success
            client.until(lambda: age() > 3.0 and len(events) >= 2, stroke)
        assert node.end() == 0, node.output
    return folder / "bag", scene, events


def test_live_changes_are_made_again(recorded, tmp_path):
    """Without a scene, run gives the live forces as ever, of the node's own steps to the last bit, after the reset too.

    With the node's file as its scene it does not, and says why.
    """
    bag, scene, _ = recorded
    summary = replay.run(None, bag, tmp_path / "again")
    assert (summary.live_changes, summary.resets, summary.differences) == (2, 1, [])
    times, live, beyond = beyond_replay(bag, tmp_path / "again")
    ((_, reset, _),) = read(bag, "/finger/reset")
    peak = np.linalg.norm(live, axis=1).max()
    assert peak > 1.0
    assert len(live) > 300
    # Once put above the plane, the block comes down as commands happen to meet steps; and a busy machine skips some.
    assert np.percentile(beyond[times < 1e-9 * reset], 80) < 0.02 * peak or not kept_pace(bag)
    replay.run(None, tmp_path / "again", tmp_path / "third" / "again")
    one, other = (next(path.glob("*.mcap")).read_bytes() for path in (tmp_path / "again", tmp_path / "third" / "again"))
    assert one == other
    replay.run(None, bag, tmp_path / "steps", replay.Selection(mode="recorded"))
    of_steps = dict(zip(*forces(tmp_path / "steps"), strict=True))
    live_then = [(force, of_steps[at]) for at, force in zip(*forces(bag), strict=True) if at in of_steps]
    assert len(live_then) > 500
    assert all((one == other).all() for one, other in live_then)
    summary = replay.run(Scene.load(str(scene)), bag, tmp_path / "other")
    assert summary.differences == ["plane.friction 0.5 (recorded: 0.4)", "finger_frame finger (recorded: tip)"]
    assert (summary.left_out, summary.resets) == (2, 1)
    _, _, beyond = beyond_replay(bag, tmp_path / "other")
    assert np.percentile(beyond, 99) > 0.1 * peak


def test_what_it_says_of_its_making(recorded):
    """Scene with overrides, parameters, mesh, machine and the rate reached; a bare file says the same."""
    bag, _, _ = recorded
    origin = read_origin(BagReader(bag))
    assert origin == read_origin(BagReader(next(bag.glob("*.mcap"))))
    assert origin.made_by == "node"
    assert origin.scene["plane"]["friction"] == 0.4
    assert (origin.options["finger_frame"], origin.options["force_scale"]) == ("tip", 1.0)
    assert origin.machine["cores"] >= 1
    steps = sum(topic.count for topic in BagReader(bag).topics if topic.name == "/contact_wrench")
    assert origin.reached["steps"] == steps
    assert 20.0 < origin.reached["rate"] < 201.0


def test_changes_are_recorded_as_they_are_published(recorded):
    """On the topic and with the content that listeners get, once each, in force when the recording says so."""
    bag, _, events = recorded
    found = [message for _, _, message in read(bag, "/parameter_events")]
    said = [
        [(e.node, p.name, p.value.type, p.value.double_value) for e in side for p in e.changed_parameters]
        for side in (found, events)
    ]
    assert said[0] == [("/finger", "plane.friction", 3, 0.0), ("/finger", "force_scale", 3, 0.1)]
    assert said[1] == said[0]
    kept = [deserialize_message(m.data, ParameterEvent) for m in BagReader(bag).messages(["/parameter_events"])]
    for mine, theirs in zip(kept, events, strict=True):
        mine.stamp = theirs.stamp  # when it took effect, and when it was told
        assert mine == theirs
    ((_, at, _),) = read(bag, "/finger/reset")
    assert at > found[1].stamp.sec * 10**9


def test_frames_and_logs(recorded):
    """Finger frame and twin go with the finger, the plane stands; what the node logged is there."""
    bag, _, _ = recorded
    ((_, _, standing),) = read(bag, "/tf_static")
    (plane,) = standing.transforms
    assert (plane.header.frame_id, plane.child_frame_id, plane.transform.rotation.w) == ("world", "plane", 1.0)
    messages = read(bag, "/tf", "/pose")
    frames = [message for topic, _, message in messages if topic == "/tf"]
    poses = {(m.header.stamp.sec, m.header.stamp.nanosec): m.pose for topic, _, m in messages if topic == "/pose"}
    assert len(frames) > 150
    for frame in frames:
        assert [t.child_frame_id for t in frame.transforms] == ["tip", "tip_world_aligned"]
        pose = poses[frame.transforms[0].header.stamp.sec, frame.transforms[0].header.stamp.nanosec]
        for t in frame.transforms:
            p = t.transform.translation
            assert (p.x, p.y, p.z) == (pose.position.x, pose.position.y, pose.position.z)
    (ready,) = (message for _, _, message in read(bag, "/rosout") if message.msg.startswith("ready after"))
    assert ready.name == "finger"
