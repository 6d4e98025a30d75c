"""What drivers send, read in compiled code: of each type, whole and cut short, in the frame asked for or another."""

from __future__ import annotations

import math

import numpy as np
import pytest
import ros_helpers  # noqa: F401  (skips without ROS; checks fields of messages)
from geometry_msgs.msg import Point, PointStamped, Pose, PoseStamped, Quaternion, QuaternionStamped, TransformStamped
from rclpy.serialization import serialize_message
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import Joy
from std_msgs.msg import Bool, Float32MultiArray, Float64MultiArray, MultiArrayDimension

from finger_sim.ros import device_in
from finger_sim.ros.device import parsed
from finger_sim.ros.device_bytes import (
    CLUTCH,
    CUT,
    ENCODING,
    FEW,
    FRAME,
    NO_POSE,
    NO_TURN,
    OLD_TURN,
    ORIENTATION,
    PASSED_OVER,
    POSITION,
    STAMP,
)
from finger_sim.ros.device_in import DeviceIn

STORE = get_typestore(Stores.ROS2_JAZZY)
TURN = tuple(Rotation.from_euler("xyz", [0.1, -0.7, 2.0]).as_quat())
AT = (0.01, -0.02, 0.03)
TIMEOUT = 0.1


def device(**blocks):
    return DeviceIn(parsed(blocks), "world", np.zeros(1))


def command(of):
    """Frame, stamp, position and orientation of the command that was made last, read by rosbags."""
    message = STORE.deserialize_cdr(of.command, "geometry_msgs/msg/PoseStamped")
    p, q, stamp = message.pose.position, message.pose.orientation, message.header.stamp
    return message.header.frame_id, (stamp.sec, stamp.nanosec), (p.x, p.y, p.z), (q.x, q.y, q.z, q.w)


def stamped(kind, frame="base"):
    message = kind()
    message.header.frame_id = frame
    message.header.stamp.sec, message.header.stamp.nanosec = 7, 8
    return message


def posed(message, at=AT, turn=TURN):
    """Numbers set in a Pose or Transform, whatever its fields are called."""
    position, rotation = ("position", "orientation") if hasattr(message, "position") else ("translation", "rotation")
    for name, value in zip("xyz", at, strict=True):
        setattr(getattr(message, position), name, value)
    for name, value in zip("xyzw", turn, strict=True):
        setattr(getattr(message, rotation), name, float(value))


def in_pose_stamped():
    message = stamped(PoseStamped)
    posed(message.pose)
    return message


def in_transform():
    message = stamped(TransformStamped)
    message.child_frame_id = "tip"
    posed(message.transform)
    return message


def in_pose():
    message = Pose()
    posed(message)
    return message


def in_point():
    x, y, z = AT
    return Point(x=x, y=y, z=z)


def in_point_stamped():
    message = stamped(PointStamped)
    message.point = in_point()
    return message


def in_array(kind):
    """Behind a layout with a name of odd length and an offset: y, nothing, x, z, and the quaternion w first."""
    x, y, z = AT
    a, b, c, d = map(float, TURN)
    message = kind(data=[9.0, 9.0, y, 5.0, x, z, d, a, b, c])
    message.layout.dim = [MultiArrayDimension(label="all of it", size=10, stride=10)]
    message.layout.data_offset = 2
    return message


COLUMNS = "y - x z qw qx qy qz"
WITH_TURN = {
    "PoseStamped": in_pose_stamped, "Pose": in_pose, "TransformStamped": in_transform,
    "Float32MultiArray": lambda: in_array(Float32MultiArray), "Float64MultiArray": lambda: in_array(Float64MultiArray),
}  # fmt: skip
WITHOUT = {"Point": in_point, "PointStamped": in_point_stamped}


def given(kind, **more):
    columns = {"columns": COLUMNS} if "Array" in kind else {}
    return {"topic": "p", "type": kind, **columns, **more}


@pytest.mark.parametrize("kind", [*WITH_TURN, *WITHOUT])
def test_each_type_is_read_and_mapped(kind) -> None:
    """p' = o + s R p and q' = R q T by scipy; stamps are handed on; a Point has the orientation that is said."""
    wanted = Rotation.from_euler("xyz", [1.0, 0.2, -0.4])
    fixed = {"orientation": wanted.as_quat().tolist()} if kind in WITHOUT else {}
    frame = {"axes": "x=-y y=x z=z", "scale": 2.0, "offset": [1.0, 2.0, 3.0], "rotate": "x=z y=-x z=-y"}
    of = device(command_input=given(kind, frame="base", unit=0.5, **fixed), device_frame=frame)
    data = serialize_message({**WITH_TURN, **WITHOUT}[kind]())
    assert of.take_in(POSITION, data, 1, TIMEOUT) == 1
    frame_id, stamp, at, turn = command(of)
    x, y, z = AT
    tolerance = 1e-7 if kind == "Float32MultiArray" else 1e-12
    assert frame_id == "world"
    assert stamp == ((7, 8) if "Stamped" in kind else (0, 0))
    np.testing.assert_allclose(at, [1.0 - y, 2.0 + x, 3.0 + z], atol=tolerance)
    base = Rotation.from_matrix([[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    tool = Rotation.from_matrix(np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]]).T)
    expected = wanted if kind in WITHOUT else base * Rotation.from_quat(TURN) * tool
    assert (expected.inv() * Rotation.from_quat(turn)).magnitude() < 10 * tolerance


@pytest.mark.parametrize("kind", [*WITH_TURN, *WITHOUT])
def test_what_is_cut_short_is_refused_at_every_length(kind) -> None:
    """And so is another encoding; nothing is made of it."""
    of = device(command_input=given(kind))
    data = serialize_message({**WITH_TURN, **WITHOUT}[kind]())
    whole = {"Pose": 60, "Point": 28}.get(kind, len(data.rstrip(b"\0")))
    before = of.command
    for length in range(whole - 8):
        assert of.take_in(POSITION, data[:length], 1, TIMEOUT) in (CUT, ENCODING)
    assert of.take_in(POSITION, b"\0\0" + data[2:], 1, TIMEOUT) == ENCODING
    assert of.command == before
    assert "cut short" in of.words(POSITION, CUT)
    assert "'" not in of.words(POSITION, ENCODING)


def test_lengths_that_lie_are_no_harm() -> None:
    """Each word of four bytes in turn says that there are four billion of something."""
    for kind, make in {**WITH_TURN, **WITHOUT}.items():
        of = device(command_input=given(kind, frame="base"))
        data = bytearray(serialize_message(make()))
        for at in range(4, len(data) - 3, 4):
            broken = bytes(data[:at]) + b"\xff\xff\xff\xff" + bytes(data[at + 4 :])
            assert of.take_in(POSITION, broken, 1, TIMEOUT) in (1, CUT, FRAME, FEW, STAMP, NO_POSE)
    of = device(clutch={"topic": "c", "type": "Joy"})
    data = serialize_message(Joy(buttons=[0, 1]))
    for at in range(4, len(data) - 3, 4):
        assert of.take_in(CLUTCH, data[:at] + b"\xff\xff\xff\xff" + data[at + 4 :], 1, TIMEOUT) in (0, 1, CUT, FEW)


def test_another_frame_is_refused_and_named() -> None:
    of = device(command_input=given("TransformStamped", frame="base", child_frame="tip"))
    message = in_transform()
    assert of.take_in(POSITION, serialize_message(message), 1, TIMEOUT) == 1
    message.child_frame_id = "tips"
    assert of.take_in(POSITION, serialize_message(message), 1, TIMEOUT) == FRAME
    assert "must be 'base' to 'tip'" in of.words(POSITION, FRAME)
    message.child_frame_id, message.header.frame_id = "tip", "bas"
    assert of.take_in(POSITION, serialize_message(message), 1, TIMEOUT) == FRAME


def test_numbers_that_are_no_pose_are_refused_and_shown() -> None:
    """They would stay in the clutch: where the handle was is kept from there."""
    of = device(command_input={"topic": "p", "type": "Float64MultiArray", "columns": "x y z qx qy qz qw"})
    for bad in ([math.nan] + [0.0] * 5 + [1.0], [0.0] * 7, [2e4] + [0.0] * 5 + [1.0], [0.0] * 6 + [math.inf]):
        assert of.take_in(POSITION, serialize_message(Float64MultiArray(data=bad)), 1, TIMEOUT) == NO_POSE
        assert f"x {bad[0]:g}" in of.words(POSITION, NO_POSE)
    assert of.take_in(POSITION, serialize_message(Float64MultiArray(data=[0.0] * 6)), 1, TIMEOUT) == FEW
    assert of.take_in(POSITION, serialize_message(Float64MultiArray(data=[0.0] * 6 + [2.0])), 1, TIMEOUT) == 1
    assert command(of)[3] == (0.0, 0.0, 0.0, 1.0)


@pytest.mark.parametrize("kind", ["Float32MultiArray", "Float64MultiArray", "Quaternion", "QuaternionStamped"])
def test_orientations_that_come_by_themselves(kind) -> None:
    """The newest counts; there is no command before the first, nor with one that is too old."""
    of = device(command_input={
        "topic": "p", "type": "Point", "orientation_topic": "q", "orientation_type": kind,
        "orientation_columns": "qw qx qy qz",
    })  # fmt: skip
    point = serialize_message(in_point())
    assert of.take_in(POSITION, point, 10**9, TIMEOUT) == NO_TURN
    assert "no orientation has come on q" in of.words(POSITION, NO_TURN)
    a, b, c, d = map(float, TURN)
    made = {
        "Float32MultiArray": Float32MultiArray(data=[d, a, b, c]),
        "Float64MultiArray": Float64MultiArray(data=[d, a, b, c]),
        "Quaternion": Quaternion(x=a, y=b, z=c, w=d),
        "QuaternionStamped": QuaternionStamped(quaternion=Quaternion(x=a, y=b, z=c, w=d)),
    }
    assert of.take_in(ORIENTATION, serialize_message(made[kind]), 10**9, TIMEOUT) == 0
    assert of.take_in(POSITION, point, 10**9 + 10**8, TIMEOUT) == 1
    np.testing.assert_allclose(command(of)[3], TURN, atol=1e-7)
    assert of.take_in(POSITION, point, 10**9 + 10**8 + 2, TIMEOUT) == OLD_TURN


def test_a_pair_of_frames_is_found_among_others(monkeypatch) -> None:
    """In the TFMessage of a system ROS 2; the wheels have no such type, so its bytes are made by rosbags."""
    monkeypatch.setattr(device_in, "message_class", lambda key, name: None)
    of = device(command_input={"topic": "/tf", "type": "tf", "frame": "base", "child_frame": "tip"})
    named = {name: STORE.types[f"geometry_msgs/msg/{name}"] for name in ("TransformStamped", "Transform", "Vector3",
                                                                        "Quaternion")}  # fmt: skip
    time, header = STORE.types["builtin_interfaces/msg/Time"], STORE.types["std_msgs/msg/Header"]

    def message(*pairs):
        return bytes(STORE.serialize_cdr(STORE.types["tf2_msgs/msg/TFMessage"]([
            named["TransformStamped"](
                header(time(7, 8), frame), child,
                named["Transform"](named["Vector3"](*at), named["Quaternion"](*TURN)),
            )
            for frame, child, at in pairs
        ]), "tf2_msgs/msg/TFMessage"))  # fmt: skip

    others = (("world", "finger", (1.0, 1.0, 1.0)), ("base", "elbow", (2.0, 2.0, 2.0)))
    assert of.take_in(POSITION, message(*others), 1, TIMEOUT) == PASSED_OVER
    data = message(*others, ("base", "tip", AT), ("world", "x", (3.0, 3.0, 3.0)))
    assert of.take_in(POSITION, data, 1, TIMEOUT) == 1
    _, stamp, at, turn = command(of)
    assert (stamp, at) == ((7, 8), AT)
    np.testing.assert_allclose(turn, TURN, atol=1e-12)
    assert of.take_in(POSITION, data[:100], 1, TIMEOUT) == CUT


@pytest.mark.parametrize("kind", ["Bool", "Joy"])
@pytest.mark.parametrize("opens", ["pressed", "released"])
def test_the_clutch_holds_the_finger_and_goes_on_from_there(kind, opens) -> None:
    """While it is open commands are those of before; then motion is added to them, s times, and turns alike."""
    clutch = {"topic": "c", "type": kind, "button": 1 if kind == "Joy" else 0, "opens": opens}
    of = device(command_input={"topic": "p", "type": "Pose"}, device_frame={"scale": 0.5}, clutch=clutch)

    def button(opened):
        pressed = opened == (opens == "pressed")
        message = Bool(data=pressed) if kind == "Bool" else Joy(axes=[0.5], buttons=[1, int(pressed)])
        return of.take_in(CLUTCH, serialize_message(message), 1, TIMEOUT)

    def pose(x, angle):
        message = Pose()
        posed(message, (x, 0.0, 0.0), Rotation.from_rotvec([0.0, 0.0, angle]).as_quat())
        assert of.take_in(POSITION, serialize_message(message), 1, TIMEOUT) == 1
        _, _, at, turn = command(of)
        return at[0], Rotation.from_quat(turn).as_rotvec()[2]

    assert pose(0.1, 0.2) == pytest.approx((0.05, 0.2))
    assert [button(True), button(True)] == [1, 0]
    assert of.record.clutched[0] == 1.0
    assert pose(0.9, 1.2) == pytest.approx((0.05, 0.2))
    assert [button(False), button(False)] == [1, 0]
    assert of.record.clutched[0] == 0.0
    assert pose(0.9, 1.2) == pytest.approx((0.05, 0.2))
    assert pose(1.0, 1.3) == pytest.approx((0.10, 0.3))
    assert of.button == serialize_message(Bool(data=False))[:5]


def test_a_button_that_is_not_there() -> None:
    of = device(clutch={"topic": "c", "type": "Joy", "button": 2})
    assert of.take_in(CLUTCH, serialize_message(Joy(buttons=[1, 1])), 1, TIMEOUT) == FEW
    assert of.record.clutched[0] == 0.0
