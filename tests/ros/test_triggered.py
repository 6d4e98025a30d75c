"""Mode triggered over ROS topics: one step for each command, paired by its stamp, and the same numbers every time."""

from __future__ import annotations

import math

import pytest
from geometry_msgs.msg import PoseStamped, WrenchStamped
from rclpy.qos import QoSProfile, ReliabilityPolicy
from ros_helpers import Client, NodeProcess, command, write_block
from rosgraph_msgs.msg import Clock
from std_srvs.srv import Trigger

from finger_sim.bags.reader import BagReader
from finger_sim.simulation import replay


@pytest.fixture(scope="module")
def node(tmp_path_factory):
    folder = tmp_path_factory.mktemp("triggered")
    arguments = ("-p", f"scene:={write_block(folder)}", "-p", "mode:=triggered", "-p", "command_timeout:=0.5")
    with NodeProcess(folder / "log", *arguments, "-p", "use_sim_time:=true", "-p", "cpu_affinity:=0") as node:
        node.wait_for("one step for each command")
        yield node
        assert node.end() == 0


@pytest.fixture(scope="module")
def client(node):
    with Client(node.domain) as client:
        for topic in ("contact_wrench", "device_wrench", "pose"):
            client.until(lambda topic=topic: client.node.count_publishers(topic))
        yield client


def numbered(number, z):
    """A command whose stamp is a number."""
    message = command(z)
    message.header.stamp.sec, message.header.stamp.nanosec = 7, number
    return message


def numbers(messages):
    return [m.header.stamp.nanosec for m in messages if m.header.stamp.sec == 7]


def press(k):
    """Height of command k [m]: down into the plane and back."""
    return 0.0005 - 0.0008 * math.sin(math.pi * k / 40) ** 2


def started(client):
    """Lists of contact_wrench, device_wrench and pose, to which the node's publishers have been matched."""
    lists = [client.collect(kind, topic) for kind, topic in
             ((WrenchStamped, "contact_wrench"), (WrenchStamped, "device_wrench"), (PoseStamped, "pose"))]  # fmt: skip
    client.until(lambda: all(lists), lambda: client.command(0.01))
    return lists


def test_each_command_is_answered_once_with_its_stamp(client):
    """In lock-step and in a burst; without a command nothing moves."""
    lists = started(client)
    for k in range(1, 21):
        client.publish(numbered(k, press(k)))
        client.until(lambda k=k: all(k in numbers(messages) for messages in lists))
    for k in range(21, 71):
        client.publish(numbered(k, press(k)))
    client.until(lambda: all(70 in numbers(messages) for messages in lists))
    assert all(numbers(messages) == list(range(1, 71)) for messages in lists)
    steps = client.report()[1]["steps"]
    _, values = client.report()
    assert values["steps"] == steps
    assert values["overruns"] == "0"
    assert values["mode"] == "triggered"


def test_without_commands_the_device_is_let_go_and_the_time_goes_on_with_the_next(client):
    """One zero wrench after the time-out on the steady clock, though that of ROS stands; contact is not touched."""
    wrenches, devices, _ = started(client)
    held = lambda: client.publish(numbered(1, -0.0003))  # noqa: E731
    client.until(lambda: devices and devices[-1].wrench.force.z > 0.5, held)
    client.until(lambda: devices[-1].wrench.force.z == 0.0)
    count = len(devices)
    status, _ = client.report()
    assert "stale" in status.message
    assert "stalled" not in status.message
    assert len(devices) == count
    assert wrenches[-1].wrench.force.z > 0.5
    client.until(lambda: devices[-1].wrench.force.z > 0.5, held)


def test_a_command_without_a_stamp_gets_the_time_of_ros(client):
    """Which a lock-step client sets by /clock."""
    _, _, poses = started(client)

    def tick():
        client.publish(Clock(clock=command(0.0).header.stamp.__class__(sec=1234)), "/clock")
        client.command(0.009)

    client.until(lambda: poses[-1].header.stamp.sec == 1234, tick)


def test_a_stamp_or_a_clock_that_is_no_time_ends_nothing(client, node):
    """Such a command or pose of the plane is refused, counted and named; the next good command is answered."""
    _, _, poses = started(client)
    planes, clocks = (
        client.node.create_publisher(*what, 10) for what in ((PoseStamped, "plane_pose"), (Clock, "/clock"))
    )
    for sec, nanosec in ((2**31 - 1, 2**32 - 1), (-1, 0)):
        message = command(0.009)
        message.header.stamp.sec, message.header.stamp.nanosec = sec, nanosec
        for send, what in ((client.publish, "command"), (planes.publish, "plane_pose")):
            told = f"{what}: stamp of {sec} s and {nanosec} ns"
            told_now = lambda told=told: told in client.reports[-1].status[0].message  # noqa: E731
            client.until(told_now, lambda send=send, message=message: send(message))
        client.until(clocks.get_subscription_count)
        clocks.publish(Clock(clock=message.header.stamp))
        count = len(poses)
        client.until(lambda count=count: len(poses) > count, lambda: client.command(0.009))
    node.wait_for("Seconds value must not be negative")
    clocks.publish(Clock(clock=command(0.0).header.stamp.__class__(sec=1234)))
    client.until(lambda: poses[-1].header.stamp.sec == 1234, lambda: client.command(0.009))


def test_parameters_and_services_are_answered_between_commands(client):
    """No command need come for it."""
    assert client.set("plane.friction", 0.3).successful
    assert client.get("plane.friction") == 0.3
    assert client.call(Trigger, "/finger/reset", Trigger.Request()).success
    assert not client.set("mode", "free").successful


@pytest.mark.slow
def test_a_sender_that_cannot_be_heard_is_told(client, node):
    """A best-effort one, for as long as it is there."""
    told = "/client publishes /command_pose best effort, must be reliable"
    with Client(node.domain) as other:
        qos = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        other.node.create_publisher(PoseStamped, "command_pose", qos)
        client.until(lambda: told in client.report()[0].message)
    client.until(lambda: told not in client.report()[0].message)
    assert node.output.count(told) == 1


def test_the_same_commands_give_the_same_bits(client):
    """From rest, twice: every wrench to its last bit."""
    wrenches, _, _ = started(client)
    runs = []
    for _ in range(2):
        client.publish(numbered(0, 0.01))
        client.until(lambda: 0 in numbers(wrenches[-1:]))
        assert client.call(Trigger, "/finger/reset", Trigger.Request()).success
        wrenches.clear()
        for k in range(1, 81):
            client.publish(numbered(k, press(k)))
            client.until(lambda k=k: k in numbers(wrenches))
        runs.append([(w.wrench.force.x, w.wrench.force.z, w.wrench.torque.y) for w in wrenches])
    assert max(fz for _, fz, _ in runs[0]) > 0.5
    assert runs[0] == runs[1]


def test_a_recording_replays_to_the_last_bit(tmp_path):
    """Presses and slides at any pace, live; `run` computes the same wrenches from the recording alone.

    Friction set and resets made between commands, which may then wait for their steps, are in the right ones.
    """
    bag, scene = tmp_path / "bag", write_block(tmp_path)
    arguments = ("-p", f"scene:={scene}", "-p", "mode:=triggered", "-p", f"record:={bag}")
    with NodeProcess(tmp_path / "log", *arguments) as node, Client(node.domain) as client:
        poses = client.collect(PoseStamped, "pose")  # while the node loads, so that it knows of it by the first command
        node.wait_for("ready after")
        client.until(lambda: client.node.count_publishers("pose"))
        for k in range(100):
            message = numbered(k, press(k))
            message.pose.position.x = 1e-4 * k
            q = message.pose.orientation
            q.x, q.y, q.z, q.w = 0.1 * math.sin(0.1 * k), 0.02, -0.07, 1.7
            client.publish(message)
            if k % 20 == 15:
                assert client.set("plane.friction", 0.02 * k).successful
            if k in (37, 73):
                assert client.call(Trigger, "/finger/reset", Trigger.Request()).success
            client.until(lambda k=k: k % 3 or k in numbers(poses))
        client.until(lambda: 99 in numbers(poses))
        assert node.end() == 0
    summary = replay.run(None, bag, tmp_path / "again")
    assert (summary.steps, summary.live_changes, summary.resets) == (100, 5, 2)
    live, again = (
        [m.data[-48:] for m in BagReader(path).messages(["/contact_wrench"])] for path in (bag, tmp_path / "again")
    )
    assert len(set(live)) > 50
    assert live == again


@pytest.mark.slow
def test_an_overridden_quality_hears_best_effort_senders(tmp_path):
    """Reliable unless told otherwise: qos_overrides are those of any ROS node."""
    arguments = ("-p", f"scene:={write_block(tmp_path)}", "-p", "mode:=triggered")
    name = "qos_overrides./command_pose.subscription.reliability"
    with NodeProcess(tmp_path / "log", *arguments, "-p", f"{name}:=best_effort") as node, Client(node.domain) as client:
        node.wait_for("ready after")
        assert "not known" not in node.output
        (info,) = client.until(lambda: client.node.get_subscriptions_info_by_topic("/command_pose"))
        assert info.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT
        poses = client.collect(PoseStamped, "pose")
        qos = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        publisher = client.node.create_publisher(PoseStamped, "command_pose", qos)
        client.until(lambda: poses and poses[-1].pose.position.z == 0.003, lambda: publisher.publish(command(0.003)))
        assert node.end() == 0
