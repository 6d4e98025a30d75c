"""What the node sends arrives as the message that was meant; commands of no sense are refused.

Bytes are not compared with rclpy's: there those that align a number after a name are whatever lay in memory.
"""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
import ros_helpers  # noqa: F401  (skips without ROS; checks fields of messages)
from cases import for_each
from geometry_msgs.msg import PoseStamped, WrenchStamped
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.typesys import Stores, get_typestore
from sensor_msgs.msg import PointCloud2, PointField
from shape_msgs.msg import Mesh
from visualization_msgs.msg import Marker

from finger_sim.bags import cdr, poses
from finger_sim.bags.layout import POINT_DTYPE, pack_points
from finger_sim.bags.template import doubles
from finger_sim.ros import messages
from finger_sim.scene import Pose

STAMP = 1_700_000_000_123_456_789
RNG = np.random.default_rng(5)
WHOLE = serialize_message(PoseStamped())


def stamped(kind, frame_id):
    message = kind()
    message.header.frame_id = frame_id
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(STAMP, 1_000_000_000)
    return message


@for_each("frame_id", ["w", "world", "finger_world_aligned"])
def test_a_wrench_arrives_as_the_message(frame_id):
    """A filled template arrives as the message, whatever the length of the frame's name."""
    values = RNG.normal(size=6)
    message = stamped(WrenchStamped, frame_id)
    f, t = message.wrench.force, message.wrench.torque
    f.x, f.y, f.z, t.x, t.y, t.z = values.tolist()
    filled = messages.wrench_template(frame_id).fill(STAMP, doubles(values))
    assert len(filled) == len(serialize_message(message))
    assert deserialize_message(filled, WrenchStamped) == message


@for_each("frame_id", ["w", "world", "finger_world_aligned"])
def test_a_pose_arrives_as_the_message(frame_id):
    """A filled template arrives as the message; float32 and int values as what they are."""
    values = (np.float32(1.5), 1, -2.0, 0.0, 0.0, 0.0, 1)
    message = stamped(PoseStamped, frame_id)
    p, q = message.pose.position, message.pose.orientation
    p.x, p.y, p.z, q.x, q.y, q.z, q.w = (float(v) for v in values)
    filled = messages.pose_template(frame_id).fill(STAMP, doubles(values))
    assert len(filled) == len(serialize_message(message))
    assert deserialize_message(filled, PoseStamped) == message


@pytest.mark.parametrize("frame_id", ["w", "world", "finger_world_aligned"])
def test_the_node_sends_the_bytes_that_a_replay_writes(frame_id):
    """Also those that align a number after a name: recordings of the same steps are the same files."""
    wrench, pose = RNG.normal(size=6), RNG.normal(size=7)
    filled = messages.wrench_template(frame_id).fill(STAMP, doubles(wrench))
    assert filled == cdr.wrench_stamped(STAMP, frame_id, wrench)
    filled = messages.pose_template(frame_id).fill(STAMP, doubles(pose))
    assert filled == cdr.pose_stamped(STAMP, frame_id, pose[:3], pose[3:])


def test_cloud_arrives_with_its_fields():
    """Every field of every point is where the message's own fields say."""
    n = 7
    x, rest, force, strain = (
        RNG.normal(size=(n, 3)),
        RNG.normal(size=(n, 3)),
        RNG.normal(size=(n, 3)),
        RNG.random(n),
    )
    packed = pack_points(x, rest, force, strain)
    cloud = deserialize_message(messages.cloud_template("world", n).fill(STAMP, packed.tobytes()), PointCloud2)
    assert all(field.datatype == PointField.FLOAT32 and field.count == 1 for field in cloud.fields)
    names, offsets = [f.name for f in cloud.fields], [f.offset for f in cloud.fields]
    layout = {
        "names": names,
        "offsets": offsets,
        "formats": ["<f4"] * len(names),
        "itemsize": cloud.point_step,
    }
    points = np.frombuffer(cloud.data, np.dtype(layout))
    assert points.dtype.names == POINT_DTYPE.names
    for names, values in ((("x", "y", "z"), x), (("dx", "dy", "dz"), x - rest), (("fx", "fy", "fz"), force)):
        found = np.column_stack([points[name] for name in names])
        np.testing.assert_allclose(found, values, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(points["strain"], strain, rtol=1e-6)
    assert (cloud.header.frame_id, cloud.width, cloud.height, cloud.is_dense) == ("world", n, 1, True)


def test_marker_arrives_with_corners_and_colors():
    """A TRIANGLE_LIST with one colour a corner, in the world frame, not scaled or moved."""
    corners, colors = RNG.normal(size=(6, 3)), messages.ramp_colors(np.linspace(0, 1, 6))
    filled = messages.marker_template("world", 6).fill(STAMP, doubles(corners), colors.tobytes())
    marker = deserialize_message(filled, Marker)
    assert marker.type == Marker.TRIANGLE_LIST
    assert (marker.scale.x, marker.pose.orientation.w, marker.header.frame_id) == (1.0, 1.0, "world")
    np.testing.assert_array_equal([[p.x, p.y, p.z] for p in marker.points], corners)
    np.testing.assert_allclose([[c.r, c.g, c.b, c.a] for c in marker.colors], colors)


def test_a_block_of_another_length_is_refused():
    """A message never changes its length."""
    with pytest.raises(ValueError, match="block"):
        messages.pose_template("world").fill(STAMP, doubles(np.zeros(6)))


def test_topology_keeps_indices():
    """Triangles index the vertices as the mesh does."""
    vertices, triangles = RNG.normal(size=(5, 3)), np.array([[0, 1, 2], [2, 3, 4]], np.int32)
    mesh = deserialize_message(cdr.mesh(vertices, triangles), Mesh)
    assert [list(t.vertex_indices) for t in mesh.triangles] == triangles.tolist()
    np.testing.assert_array_equal([[p.x, p.y, p.z] for p in mesh.vertices], vertices)


def test_node_areas_share_out_the_surface():
    """Areas at the nodes of a unit square of two triangles sum to it; its diagonal has two thirds."""
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
    areas = messages.node_areas(square, np.array([[0, 1, 2], [0, 2, 3]]))
    np.testing.assert_allclose(areas, [1 / 3, 1 / 6, 1 / 3, 1 / 6])


def pose_message(position=(0.0, 0.0, 0.0), orientation=(0.0, 0.0, 0.0, 1.0), frame_id="world"):
    message = stamped(PoseStamped, frame_id)
    p, q = message.pose.position, message.pose.orientation
    p.x, p.y, p.z = position
    q.x, q.y, q.z, q.w = orientation
    return message


def checked(message):
    """What becomes of a message that is sent."""
    return poses.check_pose(poses.read_pose(serialize_message(message)), "world")


@for_each("frame_id", ["", "w", "map", "base", "world", "tool_0", "fingers", "ängström", "a" * 1000])
@for_each("swapped", [False, True])
def test_a_pose_is_read_as_it_was_sent(frame_id, swapped):
    """Whatever the length of the frame's name, and whatever order its bytes are in: written by rclpy and by rosbags."""
    values = tuple(RNG.normal(size=7).tolist())
    message = pose_message(values[:3], values[3:], frame_id)
    data = serialize_message(message)
    if swapped:
        store = get_typestore(Stores.ROS2_JAZZY)
        kind = "geometry_msgs/msg/PoseStamped"
        data = bytes(store.serialize_cdr(store.deserialize_cdr(data, kind), kind, little_endian=False))
        assert data[1] == 0
    assert poses.read_pose(data) == (STAMP, frame_id, values)


@for_each("data", [b"", b"\0\1\0\0", b"\0\1\0\0" + b"\xff" * 12, b"\7" * 96, WHOLE[:40], WHOLE[:-1]])
def test_bytes_that_are_no_pose_are_refused(data):
    """Cut off, or never one."""
    with pytest.raises(ValueError, match="bytes that are no PoseStamped"):
        poses.read_pose(data)


def test_bytes_are_judged_as_rclpy_judges_them():
    """Cut anywhere, with any byte changed, in either order of bytes: what rclpy reads is read alike."""
    store, kind = get_typestore(Stores.ROS2_JAZZY), "geometry_msgs/msg/PoseStamped"
    whole = bytes(serialize_message(pose_message((1.0, 2.0, 3.0), (0.1, 0.2, 0.3, 0.4))))
    swapped = bytes(store.serialize_cdr(store.deserialize_cdr(whole, kind), kind, little_endian=False))
    for data in (whole, swapped):
        tried = [data[:n] for n in range(len(data))] + [data + bytes(n) for n in range(9)]
        for _ in range(500):
            changed = bytearray(data)
            for at in RNG.integers(2, len(data), 2):
                changed[at] = RNG.choice([0, 1, 8, 127, 255, RNG.integers(256)])
            tried.append(bytes(changed))
        for each in tried:
            assert _said_by_rclpy(each) == _said_by_us(each), each.hex()


def _said_by_us(data):
    try:
        said = poses.read_pose(data)
    except ValueError:
        return None
    return said.stamp, said.frame_id, np.array(said.values).tobytes()


def _said_by_rclpy(data):
    """None for what it does not read, and for a stamp that is no time."""
    try:
        message = deserialize_message(data, PoseStamped)
    except Exception:
        return None
    p, q, stamp = message.pose.position, message.pose.orientation, message.header.stamp
    if stamp.sec < 0 or stamp.nanosec >= 1_000_000_000:
        return None
    nanoseconds = stamp.sec * 1_000_000_000 + stamp.nanosec
    return nanoseconds, message.header.frame_id, np.array([p.x, p.y, p.z, q.x, q.y, q.z, q.w]).tobytes()


def test_a_stamp_that_is_no_time_is_refused():
    """In either order of bytes; the latest that is one is taken, and can be sent."""
    store, kind = get_typestore(Stores.ROS2_JAZZY), "geometry_msgs/msg/PoseStamped"
    for sec, nanosec in ((-1, 0), (0, 1_000_000_000), (2**31 - 1, 2**32 - 1), (-(2**31), 2**32 - 1)):
        message = pose_message()
        message.header.stamp.sec, message.header.stamp.nanosec = sec, nanosec
        data = serialize_message(message)
        swapped = bytes(store.serialize_cdr(store.deserialize_cdr(data, kind), kind, little_endian=False))
        for way in (data, swapped):
            with pytest.raises(ValueError, match=rf"stamp of {sec} s and {nanosec} ns, must be sec >= 0"):
                poses.read_pose(way)
    message.header.stamp.sec, message.header.stamp.nanosec = 2**31 - 1, 999_999_999
    latest = poses.read_pose(serialize_message(message)).stamp
    filled = messages.pose_template("world").fill(latest, doubles(np.zeros(7)))
    assert deserialize_message(filled, PoseStamped).header.stamp == message.header.stamp


@pytest.mark.parametrize("nanoseconds", [-5, 2**62])
def test_a_clock_that_shows_no_time_of_a_header_gives_the_nearest(nanoseconds):
    """Whoever publishes /clock may set it to what no header can hold."""
    clock = SimpleNamespace(now=lambda: SimpleNamespace(nanoseconds=nanoseconds))
    filled = messages.pose_template("world").fill(messages.time_of(clock), doubles(np.zeros(7)))
    assert deserialize_message(filled, PoseStamped).header.stamp.sec == (0 if nanoseconds < 0 else 2**31 - 1)


def test_a_refusal_shows_the_beginning_of_a_long_frame_id():
    """What anyone sends is told again in the log, and on /diagnostics every second."""
    refusal = checked(pose_message(frame_id="a" * 1_000_000))
    assert len(refusal) < 200
    assert "999920 characters more" in refusal


@for_each(
    "wrong, says",
    [
        ({"frame_id": "map"}, "frame_id 'map'"),
        ({"frame_id": ""}, "frame_id ''"),
        ({"frame_id": "/world"}, "frame_id '/world'"),
        ({"position": (0.0, math.nan, 0.0)}, "position: got (0.0, nan, 0.0), allowed: "),
        ({"orientation": (1e308, 1e308, 1e308, 1e308)}, "orientation: got (1e+308, "),
    ],
)
def test_bad_commands_are_refused_with_the_reason(wrong, says):
    """What cannot be meant is refused, and the reason names it."""
    refusal = checked(pose_message(**wrong))
    assert isinstance(refusal, str)
    assert says in refusal


def test_a_good_command_gets_a_unit_quaternion():
    """Position as it is, orientation of length one."""
    pose = checked(pose_message((0.1, -0.2, 0.3), (0.0, 3.0, 0.0, 4.0)))
    assert pose == Pose((0.1, -0.2, 0.3), (0.0, 0.6, 0.0, 0.8))
