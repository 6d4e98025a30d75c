"""The node under what users and networks do to it: nothing is lost in silence, nothing queues up, it goes on."""

from __future__ import annotations

import itertools
import math
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped, TwistStamped, WrenchStamped
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import serialize_message
from ros_helpers import Client, NodeProcess, command, environment, write_block
from shape_msgs.msg import Mesh

from finger_sim.bags.reader import BagReader

RELIABLE = "qos_overrides./command_pose.subscription.reliability:=reliable"
MANY = QoSProfile(depth=1000)


@pytest.fixture(scope="module")
def node(tmp_path_factory):
    folder = tmp_path_factory.mktemp("fire")
    with NodeProcess(folder / "log", "-p", f"scene:={write_block(folder)}", "-p", RELIABLE) as node:
        node.wait_for("ready after")
        yield node
        assert node.end() == 0, node.output
        assert "Traceback" not in node.output


@pytest.fixture(scope="module")
def client(node):
    with Client(node.domain) as client:
        client.publisher = client.node.create_publisher(PoseStamped, "command_pose", MANY)
        client.until(lambda: client.publisher.get_subscription_count())
        client.until(
            lambda: client.reports and int(values(client)["received commands"]),
            lambda: client.publisher.publish(command(0.01)),
        )
        yield client


def values(client):
    """The items of the last report."""
    return {item.key: item.value for item in client.reports[-1].status[0].values}


def numbered(number):
    """A command whose x is a number of micrometres, clear of the plane."""
    return command(0.01, 1e-6 * number)


@pytest.mark.slow
def test_two_thousand_commands_a_second_and_bursts(client):
    """All are received, the newest is followed, none later than one that came after it."""
    poses = client.collect(PoseStamped, "pose", MANY)
    client.next(poses)
    before = int(client.report()[1]["received commands"])
    begin = time.monotonic()
    for number in range(1, 4001):
        while time.monotonic() < begin + number / 2000:
            client.executor.spin_once(timeout_sec=0.0)
        client.publisher.publish(numbered(number))
        if number % 100 == 0:  # a reliable reader holds a thousand: no more are sent ahead to one that is not run
            client.until(lambda number=number: poses[-1].pose.position.x >= 1e-6 * (number - 700))
    client.until(lambda: poses[-1].pose.position.x == 4000e-6)
    for number in range(4001, 4501):
        client.publisher.publish(numbered(number))
    client.until(lambda: poses[-1].pose.position.x == 4500e-6)
    seen = [p.pose.position.x for p in poses if p.pose.position.x > 0.0]
    assert all(a <= b for a, b in itertools.pairwise(seen))
    client.until(lambda: int(client.report()[1]["received commands"]) == before + 4500)


def test_a_late_listener_gets_the_topology_and_what_comes(client, node):
    """As if it had been there from the start."""
    with Client(node.domain) as late:
        topology = late.collect(Mesh, "mesh_topology", QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL))
        wrenches = late.collect(WrenchStamped, "contact_wrench")
        late.until(lambda: topology and wrenches)
        assert len(topology[0].vertices) == 12


READER = """
import rclpy
from geometry_msgs.msg import WrenchStamped
rclpy.init()
node = rclpy.create_node("reader")
node.create_subscription(WrenchStamped, "contact_wrench", lambda _: print("reading", flush=True), 1000)
rclpy.spin(node)
"""


@pytest.mark.slow
def test_listeners_that_stop_reading_stop_nobody(client, node):
    """One whose process is paused, one that is never spun: steps go on and messages come."""
    with Client(node.domain) as idle:
        idle.collect(WrenchStamped, "contact_wrench", MANY)
        reader = subprocess.Popen(
            [sys.executable, "-c", READER], env=environment(node.domain), stdout=subprocess.PIPE, text=True
        )
        try:
            assert reader.stdout is not None
            assert any(line.strip() == "reading" for line in reader.stdout)  # after what DDS has to say
            reader.send_signal(signal.SIGSTOP)
            wrenches = client.collect(WrenchStamped, "contact_wrench")
            steps = int(client.report()[1]["steps"])
            client.until(lambda: int(client.report()[1]["steps"]) > steps + 200 and len(wrenches) > 100)
        finally:
            reader.kill()
            reader.wait()


@pytest.mark.slow
def test_a_second_node_of_the_name_is_told(client, node, tmp_path):
    """For as long as it is there."""
    told = "another node is named /finger"
    arguments = ("-p", f"scene:={write_block(tmp_path)}")
    with NodeProcess(tmp_path / "log", *arguments, domain=node.domain) as other:
        other.wait_for("ready after")
        for each in (node, other):  # reports of both come on one topic
            each.wait_for(told)
        client.until(lambda: told in client.reports[-1].status[0].message)
        assert other.end() == 0
    client.until(lambda: told not in client.report()[0].message)
    assert node.output.count(told) == 1


@pytest.mark.slow
def test_a_sender_of_another_type_is_told(client, node):
    """Its messages never arrive, and DDS says nothing."""
    told = "/client publishes geometry_msgs/msg/TwistStamped on /command_pose, must be geometry_msgs/msg/PoseStamped"
    with Client(node.domain) as other:
        other.node.create_publisher(TwistStamped, "command_pose", 10).publish(TwistStamped())
        client.until(lambda: told in client.report()[0].message)
    client.until(lambda: told not in client.report()[0].message)
    assert node.output.count(told) == 1


def bad_ones():
    """Commands of no use, each in its own way."""
    for frame in ("map", "", "/world", "World"):
        message = command(0.5)
        message.header.frame_id = frame
        yield message
    for value in (math.nan, math.inf, -math.inf, 1e300, -1e9):
        message = command(0.5)
        message.pose.position.y = value
        yield message
    for quaternion in (
        (0.0,) * 4,
        (math.nan, 0.0, 0.0, 1.0),
        (1e-300, 0.0, 0.0, 0.0),
        (1e308,) * 4,
        (0.0, math.inf, 0.0, 1.0),
    ):
        message = command(0.5)
        q = message.pose.orientation
        q.x, q.y, q.z, q.w = quaternion
        yield message
    for sec, nanosec in ((-1, 0), (2**31 - 1, 2**32 - 1)):
        message = command(0.5)
        message.header.stamp.sec, message.header.stamp.nanosec = sec, nanosec
        yield message
    message = command(0.5)
    message.header.frame_id = "w" * 100_000
    yield message
    yield serialize_message(command(0.5)).replace(b"world", b"w\xffrld")


def test_every_command_of_no_use_is_counted_and_none_followed(client):
    """Among good ones, at full speed; bytes that are no pose too."""
    poses = client.collect(PoseStamped, "pose", MANY)
    before = client.report()[1]
    bad = [*bad_ones(), b"\0\1\0\0", b"\xff" * 96]
    for round_ in range(20):
        for message in bad:
            client.publisher.publish(message)
        client.publisher.publish(command(0.01, 1e-3 * round_))
    client.until(lambda: poses and poses[-1].pose.position.x == 19e-3)
    after = client.report()[1]
    assert int(after["refused commands"]) - int(before["refused commands"]) == 20 * len(bad)
    assert int(after["received commands"]) - int(before["received commands"]) == 20 * (len(bad) + 1)
    assert "no PoseStamped" in after["last refusal"]
    assert {round(p.pose.position.z, 12) for p in poses} == {0.01}
    assert {p.pose.position.y for p in poses} == {0.0}


def test_a_storm_of_parameters_is_answered_one_by_one(client):
    """Right ones and wrong ones, asked for all at once, while commands come: each is answered for itself."""
    service = client.node.create_client(SetParameters, "/finger/set_parameters")
    client.until(service.service_is_ready)
    wanted = [(0.001 * k, True) if k % 3 else (-1.0 - k, False) for k in range(300)]
    press, results = lambda: client.publisher.publish(command(0.01)), []
    for k in range(0, len(wanted), 5):  # a service holds ten requests
        futures = [
            service.call_async(
                SetParameters.Request(parameters=[Parameter("plane.friction", value=value).to_parameter_msg()])
            )
            for value, _ in wanted[k : k + 5]
        ]
        client.until(lambda futures=futures: all(f.done() for f in futures), press)
        results += [f.result().results[0] for f in futures]
    assert [r.successful for r in results] == [good for _, good in wanted]
    assert all("plane.friction" in r.reason for r in results if not r.successful)
    assert client.get("plane.friction") == 0.001 * 299
    pair = [Parameter("plane.friction", value=0.7), Parameter("solver.tolerance", value=7.0)]
    request = SetParametersAtomically.Request(parameters=[p.to_parameter_msg() for p in pair])
    assert not client.call(SetParametersAtomically, "/finger/set_parameters_atomically", request).result.successful
    assert client.get("plane.friction") == 0.001 * 299


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_it_ends_while_it_compiles(tmp_path, number):
    """Code 0, without a traceback; the bag that was asked for was not begun."""
    arguments = ("-p", f"scene:={write_block(tmp_path)}", "-p", f"record:={tmp_path / 'bag'}")
    cache = {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    with NodeProcess(tmp_path / "log", *arguments, changes=cache) as node:
        node.wait_for("compiling kernels")
        assert node.end(number) == 0
        assert "Traceback" not in node.output
    assert not (tmp_path / "bag").exists()


def test_it_ends_under_fire_with_its_bag_closed(tmp_path):
    """SIGTERM amidst commands, sets and a recording: code 0, and the bag is whole."""
    bag = tmp_path / "bag"
    arguments = ("-p", f"scene:={write_block(tmp_path)}", "-p", f"record:={bag}", "-p", RELIABLE)
    with NodeProcess(tmp_path / "log", *arguments) as node, Client(node.domain) as client:
        node.wait_for("ready after")
        publisher = client.node.create_publisher(PoseStamped, "command_pose", MANY)
        service = client.node.create_client(SetParameters, "/finger/set_parameters")
        client.until(lambda: publisher.get_subscription_count() and service.service_is_ready())
        poses = client.collect(PoseStamped, "pose")
        for k in range(2000):
            publisher.publish(numbered(k))
            if k % 20 == 0:
                service.call_async(
                    SetParameters.Request(parameters=[Parameter("plane.friction", value=0.1).to_parameter_msg()])
                )
        client.until(lambda: poses and poses[-1].pose.position.x > 0.0)
        assert node.end(signal.SIGTERM) == 0
        assert "Traceback" not in node.output
    reader = BagReader(bag)
    assert reader.warning is None
    assert all(topic.lost == 0 for topic in reader.topics)
    followed = np.array([m.sequence for m in reader.messages(["/pose"])])
    assert (np.diff(followed) == 1).all()
