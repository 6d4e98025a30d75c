"""Arrays to messages: a `Template` per outgoing topic; and the times that headers can hold."""

from __future__ import annotations

from typing import Any

import numpy as np
from geometry_msgs.msg import Point
from geometry_msgs.msg import Pose as PoseMessage
from numpy.typing import NDArray
from rclpy.serialization import serialize_message
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker

from ..arrays import Floats
from ..bags import cdr
from ..bags.layout import POINT_DTYPE
from ..bags.template import Template, doubles, marks

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


def time_of(clock: Any) -> int:
    """What a ROS clock shows [ns], as the header of a message can hold it: under use_sim_time anyone may set it."""
    return min(max(int(clock.now().nanoseconds), 0), cdr.STAMPS_END - 1)
