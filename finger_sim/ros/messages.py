"""Arrays to messages and back: a `Template` per outgoing topic, and the check of what comes in."""

from __future__ import annotations

import struct
from typing import Any, NamedTuple

import numpy as np
from geometry_msgs.msg import Point, PoseStamped
from geometry_msgs.msg import Pose as PoseMessage
from numpy.typing import NDArray
from rclpy.serialization import deserialize_message, serialize_message
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker

from ..arrays import Floats
from ..bags import cdr
from ..bags.layout import POINT_DTYPE
from ..bags.template import STAMP_OFFSET, Template, doubles, marks
from ..errors import SceneError
from ..scene import Pose, checked_pose

_HEADER, _POSE = struct.Struct("<iII"), struct.Struct("<7d")
_SHOWN = 80
"""Characters of a frame_id that a refusal shows: what anyone sends is told again in logs and every second."""

RAMP = np.array([[0.16, 0.30, 0.62], [0.22, 0.62, 0.75], [0.62, 0.82, 0.47], [0.97, 0.76, 0.26], [0.80, 0.16, 0.16]])
"""Colours (5, 3) of mesh_marker for 0, ¼, ½, ¾ and 1 (at the limit)."""


def wrench_template(frame_id: str) -> Template:
    """WrenchStamped; block: force and torque (6,) [N, N·m]."""
    numbers = marks(6)
    return Template(cdr.wrench_stamped(0, frame_id, numbers), doubles(numbers))


def pose_template(frame_id: str) -> Template:
    """PoseStamped; block: position [m] and orientation xyzw (7,)."""
    numbers = marks(7)
    return Template(cdr.pose_stamped(0, frame_id, numbers[:3], numbers[3:]), doubles(numbers))


def cloud_template(frame_id: str, points: int) -> Template:
    """PointCloud2; block: `points` points packed by `layout.pack_points`."""
    numbers = np.random.default_rng(0).bytes(points * POINT_DTYPE.itemsize)
    return Template(cdr.point_cloud(0, frame_id, np.frombuffer(numbers, POINT_DTYPE)), numbers)


def marker_template(frame_id: str, corners: int) -> Template:
    """Marker TRIANGLE_LIST; blocks: corners (corners, 3) float64 [m], colours (corners, 4) float32 rgba."""
    points, colors = marks(3 * corners).reshape(-1, 3), marks(4 * corners).astype("<f4").reshape(-1, 4)
    message = Marker(ns="finger", id=0, type=Marker.TRIANGLE_LIST, action=Marker.ADD, frame_locked=False)
    message.header.frame_id = frame_id
    message.pose = PoseMessage()
    message.pose.orientation.w = 1.0
    message.scale.x = message.scale.y = message.scale.z = 1.0
    message.color = ColorRGBA(r=1.0, g=1.0, b=1.0, a=1.0)
    message.points = [Point(x=x, y=y, z=z) for x, y, z in points.tolist()]
    message.colors = [ColorRGBA(r=r, g=g, b=b, a=a) for r, g, b, a in colors.tolist()]
    return Template(serialize_message(message), doubles(points), colors.tobytes())


def ramp_colors(values: Floats) -> NDArray[np.float32]:
    """Opaque colours rgba (n, 4) of values (n,), 0 to 1."""
    colors = np.ones((len(values), 4), dtype="<f4")
    for channel in range(3):
        colors[:, channel] = np.interp(values, np.linspace(0.0, 1.0, len(RAMP)), RAMP[:, channel])
    return colors


def node_areas(vertices: Floats, triangles: NDArray[np.integer[Any]]) -> Floats:
    """A third of the area of the surface triangles around each node (n,) [m²]; 0 inside."""
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    third = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 6.0
    areas: Floats = np.zeros(len(vertices))
    np.add.at(areas, triangles.ravel(), np.repeat(third, 3))
    return areas


class StampedPose(NamedTuple):
    """What a PoseStamped says."""

    stamp: int
    """[ns]"""
    frame_id: str
    values: tuple[float, ...]
    """Position x y z [m] and orientation x y z w, as they were sent."""


def read_pose(data: bytes) -> StampedPose:
    """A PoseStamped in CDR bytes. Raises ValueError for bytes that are none, and for a stamp that is no time.

    The usual encoding is read in place, in a tenth of the time that rclpy takes.
    """
    if data[:2] == b"\x00\x01" and len(data) > STAMP_OFFSET + _HEADER.size:
        seconds, nanoseconds, length = _HEADER.unpack_from(data, STAMP_OFFSET)
        end = STAMP_OFFSET + _HEADER.size + length
        pose = end + (STAMP_OFFSET - end) % 8
        if length and len(data) >= pose + _POSE.size:
            frame_id = data[end - length : end - 1].decode(errors="replace")
            return StampedPose(_stamp(seconds, nanoseconds), frame_id, _POSE.unpack_from(data, pose))
    try:
        message = deserialize_message(data, PoseStamped)
    except Exception:
        raise ValueError(f"{len(data)} bytes that are no PoseStamped") from None
    p, q, stamp = message.pose.position, message.pose.orientation, message.header.stamp
    values = (p.x, p.y, p.z, q.x, q.y, q.z, q.w)
    return StampedPose(_stamp(stamp.sec, stamp.nanosec), message.header.frame_id, values)


def time_of(clock: Any) -> int:
    """What a ROS clock shows [ns], as the header of a message can hold it: under use_sim_time anyone may set it."""
    return min(max(int(clock.now().nanoseconds), 0), cdr.STAMPS_END - 1)


def _stamp(seconds: int, nanoseconds: int) -> int:
    """Stamp of a header [ns]. Raises ValueError where it is no time."""
    if seconds < 0 or nanoseconds >= 1_000_000_000:
        raise ValueError(f"stamp of {seconds} s and {nanoseconds} ns, must be sec >= 0 and nanosec < 1000000000")
    return seconds * 1_000_000_000 + nanoseconds


def check_pose(message: StampedPose, world_frame: str) -> Pose | str:
    """The pose with a unit quaternion, or why it is refused.

    An empty frame_id is refused as any other wrong one: whoever sends it has not said which frame is meant.
    """
    if message.frame_id != world_frame:
        frame_id = message.frame_id
        cut = f" and {len(frame_id) - _SHOWN} characters more" if len(frame_id) > _SHOWN else ""
        return f"frame_id {frame_id[:_SHOWN]!r}{cut}, must be {world_frame!r}"
    try:
        x, y, z, qx, qy, qz, qw = message.values
        return checked_pose(Pose((x, y, z), (qx, qy, qz, qw)))
    except SceneError as error:
        return str(error)
