"""Messages as CDR bytes without a ROS installation: schema text, type hashes and the few messages we write.

Definitions come from the ROS 2 Jazzy type store of `rosbags`, loaded at the first use.
Times are integer nanoseconds, lengths [m], forces [N], torques [N·m]; quaternions are xyzw.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..errors import BagError
from ..scene import Pose
from .layout import FLOAT32, POINT_FIELDS, POINT_STEP

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

POSE_STAMPED = "geometry_msgs/msg/PoseStamped"
WRENCH_STAMPED = "geometry_msgs/msg/WrenchStamped"
POINT_CLOUD = "sensor_msgs/msg/PointCloud2"
MESH = "shape_msgs/msg/Mesh"
TF_MESSAGE = "tf2_msgs/msg/TFMessage"
PARAMETER_EVENT = "rcl_interfaces/msg/ParameterEvent"
LOG = "rcl_interfaces/msg/Log"
EMPTY = "std_msgs/msg/Empty"
BOOL = "std_msgs/msg/Bool"

STAMPS_END = 2**31 * 1_000_000_000
"""Times from here on [ns] cannot be stamps of messages: their seconds have 32 bits."""

Vector = Sequence[float] | NDArray[np.float64]


@functools.cache
def typestore() -> Typestore:
    """The message types of ROS 2 Jazzy."""
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_JAZZY)


@functools.cache
def definition(msgtype: str) -> tuple[str, str]:
    """Full `ros2msg` text of a type and its RIHS01 hash; BagError if Jazzy has no such type."""
    from rosbags.typesys import TypesysError

    try:
        text, _ = typestore().generate_msgdef(msgtype, ros_version=2)
        return text, typestore().hash_rihs01(msgtype)
    except (TypesysError, KeyError):
        raise BagError(f"message type {msgtype!r}: not a ROS 2 Jazzy type, such as {POSE_STAMPED}") from None


def deserialize(data: bytes, msgtype: str) -> Any:
    """The message in CDR bytes; ValueError says what is wrong with them."""
    store = typestore()
    try:
        return store.deserialize_cdr(data, msgtype)
    except Exception as error:  # whatever the bytes make the library do
        raise ValueError(str(error)) from None


def pose_stamped(stamp: int, frame_id: str, position: Vector, orientation: Vector) -> bytes:
    """PoseStamped: position (3,) [m] and orientation (4,) xyzw of a frame in `frame_id`."""
    x, y, z = (float(v) for v in position)
    qx, qy, qz, qw = (float(v) for v in orientation)
    pose = _new(
        "geometry_msgs/msg/Pose",
        _new("geometry_msgs/msg/Point", x, y, z),
        _new("geometry_msgs/msg/Quaternion", qx, qy, qz, qw),
    )
    return _serialize(_new(POSE_STAMPED, _header(stamp, frame_id), pose), POSE_STAMPED)


def wrench_stamped(stamp: int, frame_id: str, wrench: Vector) -> bytes:
    """WrenchStamped: force and torque (6,) [N, N·m] in the axes and about the point that `frame_id` names."""
    w = [float(v) for v in wrench]
    vector = "geometry_msgs/msg/Vector3"
    message = _new("geometry_msgs/msg/Wrench", _new(vector, *w[:3]), _new(vector, *w[3:]))
    return _serialize(_new(WRENCH_STAMPED, _header(stamp, frame_id), message), WRENCH_STAMPED)


def point_cloud(stamp: int, frame_id: str, points: NDArray[np.void]) -> bytes:
    """PointCloud2 of points (n,) packed by `layout.pack_points`."""
    fields = [_new("sensor_msgs/msg/PointField", name, offset, FLOAT32, 1) for name, offset in POINT_FIELDS]
    data = points.view(np.uint8).reshape(-1)
    n = len(points)
    message = _new(POINT_CLOUD, _header(stamp, frame_id), 1, n, fields, False, POINT_STEP, n * POINT_STEP, data, True)
    return _serialize(message, POINT_CLOUD)


def mesh(vertices: NDArray[np.float64], triangles: NDArray[np.integer[Any]]) -> bytes:
    """Mesh: vertices (n, 3) [m] and triangles (k, 3) of indices into them."""
    faces = [_new("shape_msgs/msg/MeshTriangle", face) for face in np.asarray(triangles, dtype=np.uint32)]
    points = [_new("geometry_msgs/msg/Point", float(x), float(y), float(z)) for x, y, z in vertices]
    return _serialize(_new(MESH, faces, points), MESH)


def transforms(stamp: int, frame_id: str, poses: Mapping[str, Pose]) -> bytes:
    """TFMessage: where frames are in `frame_id`, by their names."""
    vector, quaternion = "geometry_msgs/msg/Vector3", "geometry_msgs/msg/Quaternion"
    message = [
        _new(
            "geometry_msgs/msg/TransformStamped",
            _header(stamp, frame_id),
            name,
            _new(
                "geometry_msgs/msg/Transform",
                _new(vector, *(float(v) for v in pose.position)),
                _new(quaternion, *(float(v) for v in pose.orientation)),
            ),
        )
        for name, pose in poses.items()
    ]
    return _serialize(_new(TF_MESSAGE, message), TF_MESSAGE)


PARAMETER_FIELDS = {
    1: "bool_value", 2: "integer_value", 3: "double_value", 4: "string_value", 6: "bool_array_value",
    7: "integer_array_value", 8: "double_array_value", 9: "string_array_value",
}  # fmt: skip
"""Where a ParameterValue has its value, by its type; other types are of no parameter of the node."""


def parameter_event(stamp: int, node: str, changed: Mapping[str, Any]) -> bytes:
    """ParameterEvent: parameters of a node, by name, that have these plain values from now on.

    rclpy serialises this type with bytes behind its end, which `rosbags` does not take.
    """
    time = _new("builtin_interfaces/msg/Time", *divmod(stamp, 1_000_000_000))
    values = {name: _parameter_value(value) for name, value in changed.items()}
    parameters = [_new("rcl_interfaces/msg/Parameter", name, value) for name, value in values.items()]
    return _serialize(_new(PARAMETER_EVENT, time, node, [], parameters, []), PARAMETER_EVENT)


def _parameter_value(value: Any) -> Any:
    """Of type 0, not set, where no parameter of the node has such a value."""
    fields: dict[str, Any] = {
        "bool_value": False, "integer_value": 0, "double_value": 0.0, "string_value": "",
        "byte_array_value": np.zeros(0, np.uint8), "bool_array_value": np.zeros(0, np.bool_),
        "integer_array_value": np.zeros(0, np.int64), "double_array_value": np.zeros(0), "string_array_value": [],
    }  # fmt: skip
    of_one, of_several = {bool: 1, int: 2, float: 3, str: 4}, {bool: 6, int: 7, float: 8, str: 9}
    several = isinstance(value, list) and len(value) > 0
    kind = of_several.get(type(value[0]), 0) if several else of_one.get(type(value), 0)
    if kind in PARAMETER_FIELDS:
        empty = fields[PARAMETER_FIELDS[kind]]
        fields[PARAMETER_FIELDS[kind]] = np.array(value, empty.dtype) if isinstance(empty, np.ndarray) else value
    return _new("rcl_interfaces/msg/ParameterValue", kind, *fields.values())


def empty() -> bytes:
    """Empty: nothing but that it came."""
    return _serialize(_new(EMPTY), EMPTY)


def truth(value: bool) -> bytes:
    """Bool."""
    return _serialize(_new(BOOL, value), BOOL)


def _header(stamp: int, frame_id: str) -> Any:
    seconds, nanoseconds = divmod(stamp, 1_000_000_000)
    return _new("std_msgs/msg/Header", _new("builtin_interfaces/msg/Time", seconds, nanoseconds), frame_id)


def _new(msgtype: str, *values: Any) -> Any:
    return typestore().types[msgtype](*values)


def _serialize(message: Any, msgtype: str) -> bytes:
    return bytes(typestore().serialize_cdr(message, msgtype))
