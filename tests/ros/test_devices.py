"""The node with each shipped device and a stand-in for its driver: its topics, its types, forces along its axes.

The stand-ins know nothing of the files: where a handle is to be and where a force must point is worked out here from
what each driver's source says of its axes. The block replaces the finger: its bottom is `z` above the plane.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from geometry_msgs.msg import Point, PoseStamped, Vector3, WrenchStamped
from ros_helpers import Client, NodeProcess, write_block
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import Joy
from std_msgs.msg import Bool, Float32MultiArray, Float64MultiArray

from finger_sim import SceneError
from finger_sim.bags.reader import BagReader
from finger_sim.ros.device import device_from
from finger_sim.ros.device_in import DeviceIn
from finger_sim.ros.device_out import DeviceOut
from finger_sim.scene.resources import shipped_names
from finger_sim.simulation import replay

LEVEL = ("-p", "command_input.orientation:=[0.0, 0.0, 0.0, 1.0]")
"""The block is not laid on its side, as a finger is."""
DEPTH = 0.0005
ALIKE = ("force_dimension", "geomagic_force_command", "moveit_servo")
"""Drivers that are tried as one other is."""
MISSING = {"geomagic_touch": "omni_msgs/msg/OmniFeedback", "geomagic_touch_x": "tf2_msgs/msg/TFMessage"}


def pose_stamped(frame, at, turn=(0.0, 0.0, 0.0, 1.0)):
    message = PoseStamped()
    message.header.frame_id = frame
    p, q = message.pose.position, message.pose.orientation
    p.x, p.y, p.z = map(float, at)
    q.x, q.y, q.z, q.w = map(float, turn)
    return message


def xyz(v):
    return [v.x, v.y, v.z]


class Stand:
    """A driver: what it sends for a handle that presses the block `depth` into the plane, and where it hears forces."""

    more: tuple[str, ...] = ()
    limit = 10.0
    """Of its force [N]: that of the scene, or less."""

    def send(self, client, depth):
        raise NotImplementedError


class ForceDimension(Stand):
    """forcedimension_ros2: ee_pose is the device's p turned by 90° about y; forces are along the device's own axes."""

    more = LEVEL
    topic, kind, up = "/fd/fd_controller/commands", Float64MultiArray, (0.0, 0.0, 1.0)

    def send(self, client, depth):
        device = np.array([0.0, 0.0, -0.03 - depth])  # z is up
        turned = Rotation.from_euler("y", 90, degrees=True).apply(device)
        turn = Rotation.from_euler("y", 90, degrees=True).as_quat()
        client.publish(pose_stamped("fd_base", turned, turn), "/fd/ee_pose")

    def force(self, message):
        return list(message.data)


class RosForceDimension(Stand):
    more = LEVEL
    topic, kind, up = "/robot/command/force", Vector3, (0.0, 0.0, 1.0)

    def send(self, client, depth):
        client.publish(Point(z=-0.03 - depth), "/robot/feedback/position")

    def force(self, message):
        return xyz(message)


class ForceCommand(Stand):
    """OpenHaptics' axes: y is up; a Touch gives 3.3 N."""

    more, limit = LEVEL, 3.3
    topic, kind, up = "/touch/force_command", WrenchStamped, (0.0, 1.0, 0.0)

    def send(self, client, depth):
        client.publish(pose_stamped("base", (0.0, -0.03 - depth, 0.0)), "/touch/pose")

    def force(self, message):
        return xyz(message.wrench.force)


class Haply(Stand):
    """The grip is held so that the finger is level: its x is the grip's y, and so on; the device's x is our −y."""

    topic, kind, up = "/haply_forces", Float32MultiArray, (0.0, 0.0, 1.0)
    base = Rotation.from_matrix([[0, 1, 0], [-1, 0, 0], [0, 0, 1]])
    finger = Rotation.from_matrix(np.array([[0, 1, 0], [0, 0, 1], [1, 0, 0]]).T)

    def send(self, client, depth):
        x, y, z, w = map(float, (self.base.inv() * self.finger.inv()).as_quat())
        client.publish(Float32MultiArray(data=[w, x, y, z]), "/haply_quaternion")
        client.publish(Float32MultiArray(data=[0.0, -0.13, 0.17 - depth, 0.0, 0.0, 0.0]), "/haply_pos_vel")

    def force(self, message):
        return list(message.data)


class Crtk(Stand):
    """A handle that is upside down, on which the finger is not: up is against its z."""

    more = ("-p", "device_frame.rotate:=x=x y=-y z=-z")
    topic, kind, up = "/MTML/body/servo_cf", WrenchStamped, (0.0, 0.0, -1.0)

    def send(self, client, depth, x=0.0):
        client.publish(pose_stamped("MTML_base", (x, 0.0, -depth), (1.0, 0.0, 0.0, 0.0)), "/MTML/measured_cp")

    def force(self, message):
        return xyz(message.wrench.force)


class MoveItServo(Stand):
    """Poses for a tool whose z points down, out of the pad; nothing is sent to it."""

    topic = ""

    def send(self, client, depth):
        turn = Rotation.from_matrix(np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]]).T).inv().as_quat()
        client.publish(pose_stamped("panda_link0", (0.0, 0.0, -depth), turn), "/servo_node/pose_target_cmds")


STANDS = {
    "force_dimension": ForceDimension, "ros_force_dimension": RosForceDimension, "geomagic_force_command": ForceCommand,
    "haply_inverse3": Haply, "crtk": Crtk, "moveit_servo": MoveItServo,
}  # fmt: skip


def arguments(folder, device, *more):
    given = {"scene": write_block(folder), "device": device, "mesh_rate": 0.0, "command_timeout": 1.0}
    return [word for name, value in given.items() for word in ("-p", f"{name}:={value}")] + list(more)


class Pressed:
    """What is heard of a node whose driver presses.

    The finger is where the handle commands it. The force points up along its axes, as device_wrench does.
    """

    def __init__(self, client, stand) -> None:
        self.client, self.stand = client, stand
        self.poses = client.collect(PoseStamped, "pose")
        self.wrenches = client.collect(WrenchStamped, "device_wrench")
        self.forces = client.collect(stand.kind, stand.topic) if stand.topic else []
        press = lambda: stand.send(client, DEPTH)  # noqa: E731
        client.until(lambda: self.poses and abs(self.poses[-1].pose.position.z + DEPTH) < 1e-7, press)
        p, q = self.poses[-1].pose.position, self.poses[-1].pose.orientation
        np.testing.assert_allclose(xyz(p), [0.0, 0.0, -DEPTH], atol=1e-7)
        assert abs(q.w) == pytest.approx(1.0, abs=1e-6)
        client.until(lambda: self.wrenches[-1].wrench.force.z > 0.01, press)
        if stand.topic:
            client.until(lambda: self.forces and np.linalg.norm(self.force) > 0.01, press)
            assert self.force @ stand.up > 0.9 * np.linalg.norm(self.force)
            client.until(lambda: abs(np.linalg.norm(self.force) - min(self.rendered, stand.limit)) < 1e-3, press)

    @property
    def rendered(self) -> float:
        """Size of the last device_wrench's force [N]."""
        return float(np.linalg.norm(xyz(self.wrenches[-1].wrench.force)))

    @property
    def force(self):
        """The last one."""
        return np.array(self.stand.force(self.forces[-1]))


def test_all_that_ships_is_tried() -> None:
    assert {*STANDS, *MISSING} == set(shipped_names()["devices"])


@pytest.mark.parametrize("device", ["haply_inverse3", *(pytest.param(name, marks=pytest.mark.slow) for name in ALIKE)])
def test_a_driver_moves_the_finger_and_gets_its_force(tmp_path, device) -> None:
    """And none after the press, and none when poses stop. Other drivers are in the tests below."""
    stand = STANDS[device]()
    with (
        NodeProcess(tmp_path / "log", *arguments(tmp_path, device, *stand.more)) as node,
        Client(node.domain) as client,
    ):
        heard = Pressed(client, stand)
        if stand.topic:
            client.until(lambda: not heard.force.any(), lambda: stand.send(client, -0.001))
            client.until(lambda: heard.force.any(), lambda: stand.send(client, DEPTH))
            client.until(lambda: not heard.force.any())  # poses have stopped
            count = len(heard.forces)
            client.until(lambda: len(heard.forces) > count + 20)
            assert not any(any(stand.force(message)) for message in heard.forces[count:])
        assert node.end() == 0
    assert "refused" not in node.output


@pytest.mark.parametrize("device", MISSING)
def test_a_type_that_is_not_installed_is_named(device) -> None:
    """The wheels have neither; their bytes are tested in test_device_bytes.py and test_device_out.py."""
    said = device_from(device, {})
    node = SimpleNamespace(create_publisher=lambda kind, topic, qos: None)
    with pytest.raises(SceneError, match=f"type: got .* no {MISSING[device]} is"):
        DeviceIn(said, "world", np.zeros(1)), DeviceOut(node, said, dict.fromkeys(("device", "handle"), ""), None)


@pytest.mark.slow
def test_a_node_does_not_hear_itself(tmp_path) -> None:
    """Its own poses would be its commands."""
    with NodeProcess(tmp_path / "log", *arguments(tmp_path, "crtk", "-p", "command_input.topic:=pose")) as node:
        assert node.code() == 1
        assert "command_input.topic: got 'pose', allowed: a topic on which the node itself does not send" in node.output


def test_the_clutch_takes_force_and_holds_and_is_replayed(tmp_path) -> None:
    """While it is open nothing pushes in any message and the finger stays; closed, motion goes on from there. The bag
    gives poses, contact and device_wrench back to the last bit, from its commands and the clutch alone."""
    stand, bag = Crtk(), tmp_path / "bag"
    gloved = {"topic": "/glove", "rate": "60.0", "type": "Float32MultiArray", "columns": "0 intensity 0 0 0"}
    outputs = [word for key, value in gloved.items() for word in ("-p", f"device_output_1.{key}:={value}")]
    more = (*stand.more, "-p", f"record:={bag}", *outputs)
    with NodeProcess(tmp_path / "log", *arguments(tmp_path, "crtk", *more)) as node, Client(node.domain) as client:
        glove = client.collect(Float32MultiArray, "/glove")
        heard = Pressed(client, stand)
        poses, forces, wrenches = heard.poses, heard.forces, heard.wrenches
        handle = {"x": 0.0, "depth": DEPTH}
        move = lambda: stand.send(client, handle["depth"], handle["x"])  # noqa: E731

        def clutch(pressed):
            client.publish(Joy(buttons=[int(pressed)]), "/footpedals/clutch")
            move()

        client.until(lambda: glove and glove[-1].data[1] > 0.0 and poses[-1].pose.position.z == -DEPTH, move)
        assert [glove[-1].data[k] for k in (0, 2, 3, 4)] == [0.0] * 4
        node_has = lambda text: text in node.output  # noqa: E731
        client.until(lambda: node_has("the clutch is open: holding the pose"), lambda: clutch(True))
        handle |= {"x": 0.004, "depth": -0.01}
        client.until(lambda: not any(xyz(forces[-1].wrench.force)) and not any(xyz(wrenches[-1].wrench.force)), move)
        client.until(lambda: glove[-1].data[1] == 0.0, move)
        count = len(poses), len(forces), len(glove), len(wrenches)
        client.until(lambda: len(poses) > count[0] + 60, move)
        held = np.array([xyz(m.pose.position) for m in poses[count[0] :]])
        np.testing.assert_allclose(held - [0.0, 0.0, -DEPTH], 0.0, atol=1e-12)
        assert not any(
            any(xyz(m.wrench.force) + xyz(m.wrench.torque)) for m in forces[count[1] :] + wrenches[count[3] :]
        )
        assert not any(any(m.data) for m in glove[count[2] :])
        _, values = client.report(move)
        assert values["clutch"] == "open"
        client.until(lambda: node_has("the clutch is closed: device_wrench"), lambda: clutch(False))
        client.until(lambda: forces[-1].wrench.force.z < -0.01, move)
        assert xyz(poses[-1].pose.position) == pytest.approx([0.0, 0.0, -DEPTH], abs=1e-12)
        handle["x"] = 0.006
        client.until(lambda: abs(poses[-1].pose.position.x - 0.002) < 1e-9, move)
        assert node.end() == 0
    replay.run(None, bag, tmp_path / "again", replay.Selection(mode="recorded"))
    for topic, size in (("/pose", 56), ("/contact_wrench", 48), ("/device_wrench", 48)):
        live, again = ([m.data[-size:] for m in BagReader(b).messages([topic])] for b in (bag, tmp_path / "again"))
        assert len(again) > 100
        assert live[-len(again) :] == again, topic
    assert [m.data[4] for m in BagReader(bag).messages(["/finger/clutch"])] == [0, 1, 0]


@pytest.mark.parametrize("way", [pytest.param(way, marks=pytest.mark.slow) for way in ("by hand", "triggered")])
def test_the_same_through_rclpy_and_in_mode_triggered(tmp_path, way) -> None:
    """Force, clutch and time-out; in mode triggered an open clutch takes force without waiting for a command."""
    stand = Haply()
    changes = {"FINGER_SIM_RCL": "0"} if way == "by hand" else {}
    more = ("-p", "clutch.topic:=/clutch", *(("-p", "mode:=triggered") if way == "triggered" else ()),
            "-p", "command_timeout:=3600.0")  # fmt: skip
    given = arguments(tmp_path, "haply_inverse3", *more)
    with NodeProcess(tmp_path / "log", *given, changes=changes) as node, Client(node.domain) as client:
        node.wait_for("ready after")
        forces = client.collect(stand.kind, stand.topic)
        press = lambda: stand.send(client, DEPTH)  # noqa: E731
        client.until(lambda: forces and forces[-1].data[2] > 0.01, press)
        client.until(lambda: not any(forces[-1].data), lambda: client.publish(Bool(data=True), "/clutch"))
        client.until(lambda: forces[-1].data[2] > 0.01, lambda: (client.publish(Bool(data=False), "/clutch"), press()))
        assert node.end() == 0


@pytest.mark.slow
def test_the_end_of_the_node_takes_force(tmp_path) -> None:
    """A driver that keeps the last force it heard is not left with one."""
    stand = RosForceDimension()
    given = arguments(tmp_path, "ros_force_dimension", *stand.more, "-p", "command_timeout:=100.0")
    with NodeProcess(tmp_path / "log", *given) as node, Client(node.domain) as client:
        heard = Pressed(client, stand)
        node.process.terminate()
        client.until(lambda: not heard.force.any() and not any(xyz(heard.wrenches[-1].wrench.force)))
        assert node.code() == 0
