"""The node's contract, over real ROS topics and services, the node in a process of its own."""

from __future__ import annotations

import itertools
import math
import re
import resource
import signal
import time
from pathlib import Path

import numpy as np
import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped, WrenchStamped
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from ros_helpers import Client, NodeProcess, bag_process, command, write_block
from rosbags.rosbag2 import Reader as RosbagsReader
from sensor_msgs.msg import PointCloud2
from shape_msgs.msg import Mesh
from small_fingers import SMALL_COUPLED
from std_srvs.srv import SetBool, Trigger
from visualization_msgs.msg import Marker

from finger_sim.bags.reader import BagReader

REPORTED = {
    "real-time factor", "step time p50 [ms]", "step time p99 [ms]", "overruns", "late steps", "iterations",
    "residual", "active rows", "max strain/limit", "penetration [mm]", "status", "command age [s]",
    "refused commands", "dropped records", "loop delay p99 [ms]", "stable stiffness at that delay [N/m]",
    "contact area [mm^2]", "centre of pressure [mm]", "slipping contacts [%]",
}  # fmt: skip
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)

PRESSED = 0.0063
"""Height [m] at which the flat finger is pressed in by a millimetre."""


@pytest.fixture(scope="module")
def node(tmp_path_factory):
    folder = tmp_path_factory.mktemp("node")
    arguments = ("-p", f"scene:={write_block(folder)}", "-p", f"record_directory:={folder / 'bags'}")
    with NodeProcess(folder / "log", *arguments) as node:
        node.wait_for("ready after")
        yield node
        assert node.end() == 0
        ended = re.findall(r"recorded (/\S+):", node.output)
        assert len(ended) == len(set(ended)), "a recording of before was told as new"


@pytest.fixture(scope="module")
def client(node):
    with Client(node.domain) as client:
        yield client


def test_before_any_command_steps_are_sent_with_no_force(client):
    """The finger rests at the scene's initial pose; the wrench of free air is zero; stamps rise."""
    begin = time.time_ns()
    wrenches = client.collect(WrenchStamped, "contact_wrench")
    devices = client.collect(WrenchStamped, "device_wrench")
    poses = client.collect(PoseStamped, "pose")
    client.until(lambda: min(map(len, (wrenches, devices, poses))) >= 20)
    assert all(force(w) == (0.0, 0.0, 0.0) for w in wrenches + devices)
    assert poses[0].pose.position.z == 0.01
    assert wrenches[0].header.frame_id == "finger_world_aligned"
    assert devices[0].header.frame_id == "finger_world_aligned"
    assert poses[0].header.frame_id == "world"
    assert all(a < b for a, b in itertools.pairwise(map(stamp, wrenches)))
    assert begin < stamp(wrenches[-1]) < time.time_ns()


def test_topics_have_the_types_and_qualities_of_the_contract(client):
    """Each topic of the contract, its type, reliability and durability."""
    reliable, effort = ReliabilityPolicy.RELIABLE, ReliabilityPolicy.BEST_EFFORT
    volatile, latched = DurabilityPolicy.VOLATILE, DurabilityPolicy.TRANSIENT_LOCAL
    for topic, kind, reliability, durability in (
        ("/contact_wrench", "geometry_msgs/msg/WrenchStamped", reliable, volatile),
        ("/device_wrench", "geometry_msgs/msg/WrenchStamped", reliable, volatile),
        ("/pose", "geometry_msgs/msg/PoseStamped", reliable, volatile),
        ("/mesh_points", "sensor_msgs/msg/PointCloud2", reliable, volatile),
        ("/mesh_topology", "shape_msgs/msg/Mesh", reliable, latched),
        ("/device_wrench_throttle", "geometry_msgs/msg/WrenchStamped", reliable, volatile),
        ("/mesh_marker", "visualization_msgs/msg/Marker", reliable, volatile),
        ("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", reliable, volatile),
    ):
        (info,) = client.until(lambda topic=topic: client.node.get_publishers_info_by_topic(topic))
        assert info.topic_type == kind
        assert (info.qos_profile.reliability, info.qos_profile.durability) == (reliability, durability), topic
    (info,) = client.node.get_subscriptions_info_by_topic("/command_pose")
    assert info.topic_type == "geometry_msgs/msg/PoseStamped"
    assert info.qos_profile.reliability == effort


def test_diagnostics_hold_every_item(client):
    """One status with all that the contract lists, once a second."""
    _, values = client.report()
    assert set(values) >= REPORTED
    assert values["command age [s]"] == "no command yet"
    assert values["contact area [mm^2]"] == "0.000"
    assert values["centre of pressure [mm]"] == "none"
    assert values["slipping contacts [%]"] == "0.0"


def test_the_first_command_places_the_finger(client):
    """It is not flown to: the next pose is the command, however far."""
    poses = client.collect(PoseStamped, "pose")
    client.next(poses)
    client.until(lambda: poses[-1].pose.position.x != 0.0, lambda: client.command(0.005, x=3.0))
    assert next(p for p in poses if p.pose.position.x != 0.0).pose.position.x == 3.0


def test_pressed_the_plane_pushes_up(client):
    """A wrench of the plane on the finger has fz > 0, and its torque is about the finger frame's origin.

    The bottom's middle is at (10, 5) mm: a force fz there turns with fz · 5 mm about x, −fz · 10 mm about y.
    """
    wrenches = client.collect(WrenchStamped, "contact_wrench")
    devices = client.collect(WrenchStamped, "device_wrench")
    poses = client.collect(PoseStamped, "pose")
    lifted = lambda: poses and position(poses[-1]) == (0.0, 0.0, 0.01)  # noqa: E731
    client.until(lifted, lambda: client.command(0.01))
    client.until(lambda: devices and force(devices[-1])[2] > 0.5, lambda: client.command(-0.0003))
    count = len(wrenches)
    client.until(lambda: len(wrenches) > count + 50, lambda: client.command(-0.0003))
    torque = wrenches[-1].wrench.torque
    fz = force(wrenches[-1])[2]
    assert torque.x == pytest.approx(0.005 * fz, rel=0.2)
    assert torque.y == pytest.approx(-0.010 * fz, rel=0.2)


def test_diagnostics_tell_of_the_touch(client):
    """Pressed, the whole bottom of 20 mm by 10 mm touches; its centre is where the force has the wrench's torque."""
    wrenches = client.collect(WrenchStamped, "contact_wrench")
    _, values = client.report(lambda: client.command(-0.0003))
    assert float(values["contact area [mm^2]"]) == pytest.approx(200.0, rel=0.05)
    centre = [float(number) for number in values["centre of pressure [mm]"].split()]
    up, torque = force(wrenches[-1])[2], wrenches[-1].wrench.torque
    assert centre == pytest.approx([-1e3 * torque.y / up, 1e3 * torque.x / up, 0.0], abs=0.2)
    assert 0.0 <= float(values["slipping contacts [%]"]) <= 100.0


def test_a_stale_command_zeroes_device_wrench_and_holds_the_pose(client, node):
    """The contact stays, the device lets go, the log says so; a new command brings the force back."""
    wrenches = client.collect(WrenchStamped, "contact_wrench")
    devices = client.collect(WrenchStamped, "device_wrench")
    poses = client.collect(PoseStamped, "pose")
    client.until(lambda: devices and force(devices[-1])[2] > 0.5, lambda: client.command(-0.0003))
    client.until(lambda: force(devices[-1]) == (0.0, 0.0, 0.0))
    count = len(devices)
    client.until(lambda: len(devices) > count + 50)
    assert all(force(d) == (0.0, 0.0, 0.0) for d in devices[count:])
    assert force(wrenches[-1])[2] > 0.5
    assert poses[-1].pose.position.z == pytest.approx(-0.0003, abs=1e-12)
    status, _ = client.report()
    assert "stale" in status.message
    assert status.level == b"\x01"
    client.until(lambda: force(devices[-1])[2] > 0.5, lambda: client.command(-0.0003))
    node.wait_for("commands are back")


def test_forces_are_scaled_while_running(client):
    """force_scale is live; a scale below its range is refused."""
    devices = client.collect(WrenchStamped, "device_wrench")
    press = lambda: client.command(-0.0003)  # noqa: E731
    client.until(lambda: devices and force(devices[-1])[2] > 0.5, press)
    assert client.set("force_scale", 1e-3).successful
    client.until(lambda: 0.0 < force(devices[-1])[2] < 0.1, press)
    assert not client.set("force_scale", -1.0).successful
    assert client.set("force_scale", 1.0).successful
    client.until(lambda: force(devices[-1])[2] > 0.5, press)


def test_the_plane_moves_by_its_topic(client):
    """Away from the finger: the contact ends; a pose of another frame is refused and named."""
    wrenches = client.collect(WrenchStamped, "contact_wrench")
    publisher = client.node.create_publisher(PoseStamped, "plane_pose", 10)
    press = lambda: client.command(-0.0003)  # noqa: E731
    client.until(lambda: wrenches and force(wrenches[-1])[2] > 0.5, press)

    def move(height):
        press()
        publisher.publish(command(height))

    client.until(lambda: force(wrenches[-1])[2] == 0.0, lambda: move(-0.01))
    client.until(lambda: force(wrenches[-1])[2] > 0.5, lambda: move(0.0))
    foreign = command(0.0)
    foreign.header.frame_id = "map"
    _, values = client.report(lambda: publisher.publish(foreign))
    assert "plane_pose" in values["last refusal"]
    assert "'map'" in values["last refusal"]


def test_the_port_to_the_device_is_reported(client):
    """Energy, leak, and what transport of commands takes, are in diagnostics; a wrong choice of control is refused."""
    press = lambda: client.command(-0.0003)  # noqa: E731
    _, values = client.report(press)
    for key in ("energy to the device [J]", "leaked [J]", "dissipated [J]", "passivity factor"):
        assert math.isfinite(float(values[key]))
    assert 0.0 <= float(values["command transport p50 [ms]"]) < 1000.0
    assert client.set("passivity", "control").successful
    assert not client.set("passivity", "off").successful
    assert client.set("passivity", "observe").successful


def test_bad_commands_are_counted_named_and_not_followed(client, node):
    """The last good command holds."""
    poses = client.collect(PoseStamped, "pose")
    client.until(lambda: poses and poses[-1].pose.position.z == 0.004, lambda: client.command(0.004))
    _, before = client.report()
    foreign, broken, turnless = command(0.02), command(0.02), command(0.02)
    foreign.header.frame_id = "map"
    broken.pose.position.x = math.nan
    turnless.pose.orientation.w = 0.0
    refused = int(before["refused commands"])
    for message, says in ((foreign, "'map'"), (broken, "position: got (nan"), (turnless, "orientation: got")):
        status, values = client.report(lambda message=message: client.publish(message))
        assert int(values["refused commands"]) > refused
        assert says in values["last refusal"]
        assert "refused" in status.message
        refused = int(values["refused commands"])
    assert poses[-1].pose.position.z == 0.004
    assert node.output.count("command refused") == 1


def test_mesh_topics_show_the_deformed_block(client):
    """Latched topology for late listeners, points that match it, marker corners of the same surface."""
    topologies = client.collect(Mesh, "mesh_topology", LATCHED)
    clouds = client.collect(PointCloud2, "mesh_points")
    markers = client.collect(Marker, "mesh_marker")
    press = lambda: client.command(-0.0003)  # noqa: E731
    client.until(lambda: topologies and len(clouds) > 30 and markers, press)
    (topology,) = topologies
    cloud, marker = client.next(clouds, press), client.next(markers, press)
    assert len(topology.vertices) == cloud.width == 12
    assert max(i for t in topology.triangles for i in t.vertex_indices) < 12
    names = [f.name for f in cloud.fields]
    assert names == ["x", "y", "z", "dx", "dy", "dz", "fx", "fy", "fz", "strain"]
    points = np.frombuffer(cloud.data, "<f4").reshape(12, 10)
    bottom = np.array([v.z == 0.0 for v in topology.vertices])
    assert points[bottom, 8].sum() > 0.5
    np.testing.assert_allclose(points[bottom, 2], 0.0, atol=1e-4)
    np.testing.assert_allclose(points[bottom, 5], 0.0003, atol=1e-4)
    np.testing.assert_allclose(points[~bottom, 3:6], 0.0, atol=1e-9)
    assert points[:, 9].max() > 0.1
    assert len(marker.points) == len(marker.colors) == 3 * len(topology.triangles)
    assert cloud.header.frame_id == marker.header.frame_id == "world"


def test_what_a_device_is_sent_is_repeated_for_viewers(client):
    """Those of some steps, word for word, with the mesh of the same step; also where nobody wants the mesh."""
    press = lambda: client.command(-0.0003)  # noqa: E731
    repeated = client.collect(WrenchStamped, "device_wrench_throttle")
    client.until(lambda: repeated and force(repeated[-1])[2] > 0.1, press)
    clouds = client.collect(PointCloud2, "mesh_points")
    client.next(clouds, press)
    devices = client.collect(WrenchStamped, "device_wrench")
    client.next(devices, press)
    begin = len(repeated)
    client.until(
        lambda: (
            len(repeated) > begin + 20 and min(stamp(devices[-1]), stamp(clouds[-1])) >= stamp(repeated[begin + 20])
        ),
        press,
    )
    sent, meshes = {stamp(device): device for device in devices}, set(map(stamp, clouds))
    for wrench in repeated[begin + 1 : begin + 20]:
        assert wrench == sent[stamp(wrench)]
        assert stamp(wrench) in meshes


def test_marker_colors_can_show_pressure(client):
    """Nodes out of contact have the first colour of the ramp, pressed ones another."""
    assert client.set("marker_color", "pressure").successful
    markers = client.collect(Marker, "mesh_marker")
    press = lambda: client.command(-0.0003)  # noqa: E731
    client.until(lambda: len(markers) > 3, press)
    marker = client.next(markers, press)
    height = np.array([p.z for p in marker.points])
    red = np.array([c.r for c in marker.colors])
    assert red[height < 0.001].min() > red[height > 0.005].max()
    assert client.set("marker_color", "strain").successful


def test_a_live_parameter_takes_effect(client):
    """The clamp bounds device_wrench, and moving the plane away ends the contact."""
    devices = client.collect(WrenchStamped, "device_wrench")
    press = lambda: client.command(-0.0003)  # noqa: E731
    client.until(lambda: devices and force(devices[-1])[2] > 0.5, press)
    assert client.set("coupling.force_limit", 0.25).successful
    client.next(devices, press)
    client.until(lambda: 0.0 < np.linalg.norm(force(devices[-1])) <= 0.25 + 1e-12, press)
    assert client.set("plane.point", [0.0, 0.0, -0.05]).successful
    client.until(lambda: force(devices[-1]) == (0.0, 0.0, 0.0), press)
    assert client.set("plane.point", [0.0, 0.0, 0.0]).successful
    assert client.set("coupling.force_limit", 10.0).successful


def test_a_budget_is_held_by_giving_up_accuracy_and_says_so(client):
    """A budget that no step can meet leads to the last rung; without one nothing is said of it."""
    assert "accuracy" not in client.report()[1]
    assert client.set("solver.budget_ms", 0.001).successful
    status, values = client.until(lambda: held if (held := client.report())[1]["accuracy"].startswith("2 ") else None)
    assert status.level == DiagnosticStatus.WARN
    assert "less accurate to hold 0.001 ms: capped, error not measured for this scene" in status.message
    assert int(values["accuracy changes"]) == 2
    assert not client.set("solver.budget_ms", -1.0).successful
    assert client.set("solver.budget_ms", math.inf).successful
    assert "accuracy" not in client.report()[1]


def test_no_point_cloud_is_made_for_nobody(client):
    """Without a subscriber or a recording none is made; with one they are."""
    client.until(lambda: client.node.count_subscribers("mesh_points") == 0)
    made = lambda: int(client.report()[1]["mesh messages"])  # noqa: E731
    before = made()
    assert made() == before
    client.next(client.collect(PointCloud2, "mesh_points"))
    assert made() > before


def test_reset_says_the_pose(client):
    """Back to rest at the last command."""
    poses = client.collect(PoseStamped, "pose")
    client.until(lambda: poses and poses[-1].pose.position.z == 0.007, lambda: client.command(0.007))
    answer = client.call(Trigger, "/finger/reset", Trigger.Request())
    assert answer.success
    assert "0.007" in answer.message


def test_recordings_on_and_off_twice(client, node):
    """Two files, both readable by an independent reader, with all topics and without a gap; the log tells of both."""
    paths = []
    planes = client.node.create_publisher(PoseStamped, "plane_pose", 10)
    for _ in range(2):
        answer = client.call(SetBool, "/finger/record", SetBool.Request(data=True))
        assert answer.success, answer.message
        paths.append(Path(answer.message.removeprefix("recording ")))
        again = client.call(SetBool, "/finger/record", SetBool.Request(data=True))
        assert not again.success
        assert str(paths[-1]) in again.message
        _, values = client.report(lambda: (client.command(-0.0003), planes.publish(command(0.0))))
        assert values["recording"] == str(paths[-1])
        answer = client.call(SetBool, "/finger/record", SetBool.Request(data=False))
        assert answer.success, answer.message
        assert str(paths[-1]) in answer.message
    assert not client.call(SetBool, "/finger/record", SetBool.Request(data=False)).success
    assert paths[0] != paths[1]
    told = re.findall(r"(recording|recorded) (/[^\s:]+)", node.output)
    assert told == [(word, str(path)) for path in paths for word in ("recording", "recorded")]
    for path in paths:
        assert (path / "metadata.yaml").is_file()
        topics = {t.name: t for t in BagReader(path).topics}
        assert set(topics) == {
            "/command_pose", "/contact_wrench", "/device_wrench", "/pose", "/mesh_points", "/mesh_topology",
            "/diagnostics", "/plane_pose", "/tf", "/tf_static", "/rosout", "/parameter_events", "/finger/reset",
        }  # fmt: skip
        quiet = {"/rosout", "/parameter_events", "/finger/reset"}
        assert all(t.count > 0 for t in topics.values() if t.name not in quiet), topics
        numbers = {name: [m.sequence for m in BagReader(path).messages([name])] for name in topics}
        assert all(n == list(range(1, len(n) + 1)) for n in numbers.values())
        first = next(iter(BagReader(path).messages()))
        assert first.topic == "/mesh_topology"
        with next(path.glob("*.mcap")).open("rb") as stream:
            reader = make_reader(stream, decoder_factories=[DecoderFactory()])
            wrenches = [ros for *_, ros in reader.iter_decoded_messages(topics=["/contact_wrench"])]
        assert max(force(w)[2] for w in wrenches) > 0.5


@pytest.mark.slow
def test_a_hundred_recordings_leave_nothing_behind(client, node):
    """Each bag is whole and holds what its answer says; no thread, no open file and no lost number is left over."""
    assert client.set("record_compression", "lz4").successful
    assert client.set("record_split_time", 0.02).successful
    record = lambda on: client.call(SetBool, "/finger/record", SetBool.Request(data=on)).message  # noqa: E731
    record(True)
    record(False)
    processes = [Path(f"/proc/{pid}") for pid in (node.process.pid, bag_process(node.process.pid))]
    held = lambda: sum(len(list((p / what).iterdir())) for p in processes for what in ("fd", "task"))  # noqa: E731
    before = held()
    answers = []
    for _ in range(100):
        record(True)
        answers.append(record(False))
    assert held() < before + 10
    found = [re.fullmatch(r"(.*): (\d+) messages, 0 dropped", answer) for answer in answers]
    assert all(found)
    assert len({match[1] for match in found}) == 100
    for i, match in enumerate(found):
        reader = BagReader(match[1])
        assert reader.warning is None
        assert reader.message_count == int(match[2]) > 0
        assert all(topic.lost == 0 for topic in reader.topics)
        if i % 10 == 0:  # rosbags takes its time to begin
            with RosbagsReader(match[1]) as other:
                assert other.message_count == int(match[2])
    assert client.set("record_compression", "zstd").successful
    assert client.set("record_split_time", 0.0).successful


def test_a_long_recording_goes_on_in_new_files(client):
    """As record_split_size and record_split_time ask; rosbags reads them as one bag."""
    for name, value, most in (("record_split_time", 0.25, 0.26), ("record_split_size", 0.02, 2.0)):
        assert client.set(name, value).successful
        answer = client.call(SetBool, "/finger/record", SetBool.Request(data=True))
        path = Path(answer.message.removeprefix("recording "))
        client.until(lambda path=path: len(list(path.glob("*.mcap"))) >= 3, lambda: client.command(-0.0003))
        assert client.call(SetBool, "/finger/record", SetBool.Request(data=False)).success
        assert client.set(name, 0.0).successful
        with RosbagsReader(path) as reader:
            count = sum(1 for _ in reader.messages())
        files = yaml.safe_load((path / "metadata.yaml").read_text())["rosbag2_bagfile_information"]["files"]
        assert [file["path"] for file in files] == [f"{path.name}_{i}.mcap" for i in range(len(files))]
        assert len(files) == len(list(path.glob("*.mcap"))) >= 3
        assert all(file["duration"]["nanoseconds"] <= most * 1e9 for file in files)
        assert sum(file["message_count"] for file in files) == count
        assert all(topic.lost == 0 for topic in BagReader(path).topics)


@pytest.mark.slow
def test_a_full_disk_ends_the_recording_not_the_node(client, node):
    """Diagnostics, log and service say why; the bag is finished and says so; with room again recording works again.

    A limit on the size of the files of the process that writes stands for the disk: the system refuses more.
    """
    assert client.set("record_compression", "none").successful
    answer = client.call(SetBool, "/finger/record", SetBool.Request(data=True))
    path = Path(answer.message.removeprefix("recording "))
    writer = bag_process(node.process.pid)
    before = resource.prlimit(writer, resource.RLIMIT_FSIZE, (400_000, resource.RLIM_INFINITY))
    try:
        press = lambda: client.command(-0.0003)  # noqa: E731
        client.until(lambda: client.reports and "recording stopped" in client.reports[-1].status[0].message, press)
        status, values = client.report(press)
    finally:
        resource.prlimit(writer, resource.RLIMIT_FSIZE, before)
    assert status.level == DiagnosticStatus.ERROR
    assert f"{path / path.name}_0.mcap" in status.message
    assert "File too large" in status.message
    assert values["recording"] == "off"
    node.wait_for("File too large")
    answer = client.call(SetBool, "/finger/record", SetBool.Request(data=False))
    assert not answer.success
    assert "File too large" in answer.message
    reader = BagReader(path)
    assert reader.warning is None
    assert reader.cut is not None
    assert "File too large" in reader.cut
    assert {file.name for file in path.iterdir()} == {f"{path.name}_0.mcap", "metadata.yaml"}
    assert {t.name: t.count for t in reader.topics}["/contact_wrench"] > 50
    assert all(topic.lost == 0 for topic in reader.topics)
    _, later = client.report(press)
    assert int(later["steps"]) > int(values["steps"]) + 50
    assert client.set("record_compression", "zstd").successful
    assert client.call(SetBool, "/finger/record", SetBool.Request(data=True)).success
    status, values = client.report(press)
    assert "recording stopped" not in status.message
    assert values["recording"] != "off"
    assert client.call(SetBool, "/finger/record", SetBool.Request(data=False)).success


def test_a_recording_that_cannot_start_says_why(client):
    """The node lives on."""
    bags = Path(client.get("record_directory"))
    bags.rename(bags.with_name("elsewhere"))
    bags.write_text("a file where bags should go")
    answer = client.call(SetBool, "/finger/record", SetBool.Request(data=True))
    assert not answer.success
    assert str(bags) in answer.message
    client.report()


def test_a_peer_cannot_choose_where_bags_go(client, tmp_path):
    """The folder for bags is that of the start: no parameter or service makes folders elsewhere."""
    assert not client.set("record_directory", str(tmp_path)).successful
    assert not client.set("record", str(tmp_path / "bag")).successful
    client.call(SetBool, "/finger/record", SetBool.Request(data=True))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
def test_a_signal_ends_the_node_with_its_bag_closed(tmp_path, number):
    """Exit code 0, bag whole, names remapped in it; sim time does not stop the watchdog."""
    bag = tmp_path / "bag"
    arguments = (
        "-p", f"scene:={write_block(tmp_path)}", "-p", f"record:={bag}", "-r", "command_pose:=/device/pose",
        "-p", "wrench_frame:=world", "-p", "world_frame:=table", "-p", "use_sim_time:=true",
    )  # fmt: skip
    message = command(-0.0003)
    message.header.frame_id = "table"
    with NodeProcess(tmp_path / "log", *arguments) as node:
        with Client(node.domain) as client:
            wrenches = client.collect(WrenchStamped, "contact_wrench")
            devices = client.collect(WrenchStamped, "device_wrench")
            send = lambda: client.publish(message, "/device/pose")  # noqa: E731
            client.until(lambda: devices and force(devices[-1])[2] > 0.5, send)
            client.until(lambda: force(devices[-1]) == (0.0, 0.0, 0.0))
            assert wrenches[-1].header.frame_id == "table"
        assert node.end(number) == 0, node.output
    assert "Traceback" not in node.output
    assert (bag / "metadata.yaml").is_file()
    reader = BagReader(bag)
    assert reader.warning is None
    assert {t.name: t.count for t in reader.topics}["/device/pose"] > 0


@pytest.mark.slow
def test_a_light_touch_at_rest_is_no_warning(tmp_path):
    """A millimetre into the pad some limits lock: that is told as a value, and warned of only with what goes wrong."""
    message = command(0.0)
    q = message.pose.orientation
    q.x = q.w = 0.5**0.5
    with NodeProcess(tmp_path / "log", "-p", f"scene:={SMALL_COUPLED}") as node, Client(node.domain) as client:
        node.wait_for("ready after")
        assert "real-time priority" in node.output
        heights = iter(np.linspace(0.009, PRESSED, 40))

        def press():
            message.pose.position.z = next(heights, PRESSED)
            client.publish(message)

        client.until(lambda: message.pose.position.z == PRESSED, press)
        status, values = client.report(press)
        assert values["status"] == "LOCKED"
        assert int(values["steps with status"]) > 0
        assert not re.search(r"LOCKED| in \d+ of \d+ steps", status.message)
        assert node.end() == 0


STUCK = """
import sys, threading
import finger_sim.ros.node as node

class Stuck(node.Ticker):
    left = 20

    def load(self, tell):
        if {compiling}:
            tell("compiling for ever")
            threading.Event().wait()
        super().load(tell)

    def _run_compiled(self):
        self.left -= 1
        self._ask()  # for a turn after the next step
        if self.left < 0:
            {then}
        return super()._run_compiled()

node.Ticker = Stuck
sys.exit(node.main())
"""


@pytest.mark.parametrize(
    ("compiling", "says"),
    [pytest.param(*case, marks=pytest.mark.slow) for case in ((True, "compiling for ever"), (False, "stalled"))],
)
def test_a_loop_that_does_not_come_back_is_reported_and_can_be_ended(tmp_path, compiling, says):
    """Diagnostics go on, services answer with the reason, SIGTERM ends the node with code 0."""
    program = ("-c", STUCK.format(compiling=compiling, then="threading.Event().wait()"))
    with NodeProcess(tmp_path / "log", "-p", f"scene:={write_block(tmp_path)}", program=program) as node:
        with Client(node.domain) as client:
            client.until(lambda: client.reports and says in client.reports[-1].status[0].message)
            assert client.reports[-1].status[0].level > b"\x00"
            answer = client.call(Trigger, "/finger/reset", Trigger.Request())
            assert not answer.success
            refused = client.set("plane.friction", 0.1)
            assert not refused.successful
            assert refused.reason == answer.message
        assert node.end(signal.SIGTERM) == 0


def test_a_step_that_fails_ends_the_node_with_the_reason(tmp_path):
    """Exit code not 0, bag closed, one line."""
    bag = tmp_path / "bag"
    program = ("-c", STUCK.format(compiling=False, then="raise ValueError('no such luck')"))
    arguments = ("-p", f"scene:={write_block(tmp_path)}", "-p", f"record:={bag}")
    with NodeProcess(tmp_path / "log", *arguments, program=program) as node:
        assert node.code() == 1
    assert "ValueError: no such luck" in node.output
    assert (bag / "metadata.yaml").is_file()


FRAMES = """
import sys, types

class Broadcaster:
    def __init__(self, node): ...

    def sendTransform(self, transforms):
        for t in transforms:
            p, q = t.transform.translation, t.transform.rotation
            print("frame", t.header.frame_id, t.child_frame_id, p.z, q.x, q.w, flush=True)

sys.modules["tf2_ros"] = types.SimpleNamespace(TransformBroadcaster=Broadcaster)
from finger_sim.ros.node import main
sys.exit(main())
"""


@pytest.mark.slow
def test_frames_are_broadcast_where_tf2_is_installed(tmp_path):
    """The finger frame turns with the finger, its world-aligned twin does not; the plane is there too."""
    arguments = (
        "-p",
        f"scene:={write_block(tmp_path)}",
        "-p",
        "initial_pose.orientation:=[1.0, 0.0, 0.0, 0.0]",
    )
    with NodeProcess(tmp_path / "log", *arguments, program=("-c", FRAMES)) as node:
        node.wait_for("frame world finger 0.01 1.0 0.0")
        node.wait_for("frame world finger_world_aligned 0.01 0.0 1.0")
        node.wait_for("frame world plane 0.0 0.0 1.0")
        assert node.end() == 0


def force(message):
    f = message.wrench.force
    return (f.x, f.y, f.z)


def position(message):
    p = message.pose.position
    return (p.x, p.y, p.z)


def stamp(message):
    return message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec
