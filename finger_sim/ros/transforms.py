"""What is had of tf2 where it is installed: frames are broadcast, and poses in other frames are transformed.

A system ROS 2 brings tf2_ros; the wheels do not. Nothing else of the node imports it.
"""

from __future__ import annotations

import contextlib
import time
from typing import Any

import numpy as np
from geometry_msgs.msg import TransformStamped
from rclpy.time import Time

from ..bags.frames import PLANE
from ..bags.imports.turns import product
from ..bags.poses import StampedPose, check_pose, read_pose
from ..bags.template import doubles
from ..errors import SceneError
from ..scene import Pose, place
from .messages import pose_template, time_of
from .options import NodeOptions

REFRESH = 0.02
"""How long a transform is used before it is looked up anew [s]."""
OLDEST = 1.0
"""Age of a transform that moves, by its stamp, from which on it is refused [s]: whoever broadcast it has stopped."""
_FRAMES = 16
"""Frames whose transforms are kept; anyone may send any frame_id."""


def available() -> bool:
    """Whether tf2_ros can be imported."""
    with contextlib.suppress(ImportError):
        import tf2_ros  # noqa: F401

        return True
    return False


class Broadcast:
    """Broadcasts the finger frame, its world-aligned twin and the plane."""

    def __init__(self, node: Any, options: NodeOptions) -> None:
        from tf2_ros import TransformBroadcaster

        self._broadcaster = TransformBroadcaster(node)
        self._transforms = []
        for child in (options.finger_frame, f"{options.finger_frame}_world_aligned", PLANE):
            transform = TransformStamped(child_frame_id=child)
            transform.header.frame_id = options.world_frame
            self._transforms.append(transform)

    def send(self, finger: Pose, plane: Pose | None, stamp: int) -> None:
        """Of the time `stamp` [ns]."""
        poses = [finger, Pose(finger.position), *([] if plane is None else [plane])]
        sent = self._transforms[: len(poses)]
        for transform, pose in zip(sent, poses, strict=True):
            time_ = transform.header.stamp
            time_.sec, time_.nanosec = divmod(stamp, 1_000_000_000)
            p, q = transform.transform.translation, transform.transform.rotation
            p.x, p.y, p.z = (float(c) for c in pose.position)
            q.x, q.y, q.z, q.w = (float(c) for c in pose.orientation)
        self._broadcaster.sendTransform(sent)


class Lookup:
    """Poses in other frames as poses in the world frame, by the newest transform that was heard.

    Of one thread at a time. The executor of `node` hears the transforms. One is looked up at most every REFRESH,
    so that a thousand commands a second cost fifty look-ups.
    Raises SceneError where tf2_ros cannot be imported.
    """

    def __init__(self, node: Any, world_frame: str) -> None:
        if not available():
            raise SceneError(
                "transform_commands",
                True,
                "false, as tf2_ros cannot be imported: a system ROS 2 has it (ros-jazzy-tf2-ros-py), the wheels do not",
            )
        from tf2_ros import Buffer, TransformException, TransformListener

        self._failure: type[Exception] = TransformException
        self._world, self._clock, self._log = world_frame, node.get_clock(), node.get_logger()
        self._buffer = Buffer()
        self._listener = TransformListener(self._buffer, node)
        self._message = pose_template(world_frame)
        self._found: dict[str, tuple[float, Pose | str]] = {}

    def in_world(self, data: bytes) -> bytes:
        """A PoseStamped in CDR bytes: in the world frame, with the same stamp; as it is, where it cannot be there."""
        try:
            pose = read_pose(data)
        except ValueError:
            return data
        inside = check_pose(pose, pose.frame_id)
        if pose.frame_id == self._world or isinstance(inside, str):
            return data
        frame = self._frame(pose.frame_id)
        if isinstance(frame, str):
            return data
        position = place(np.array(inside.position), frame)
        turn = product(frame.orientation, inside.orientation)
        return self._message.fill(pose.stamp, doubles([*position, *turn]))

    def why(self, pose: StampedPose) -> str:
        """Why it was left in another frame; "" where it was not for a lack of a transform."""
        if pose.frame_id == self._world or isinstance(check_pose(pose, pose.frame_id), str):
            return ""
        frame = self._frame(pose.frame_id)
        return frame if isinstance(frame, str) else ""

    def _frame(self, name: str) -> Pose | str:
        """A frame's pose in the world; or why it is not known."""
        now, found = time.monotonic(), self._found.get(name)
        if found is None or now - found[0] > REFRESH:
            before, new = found, self._looked_up(name)
            if isinstance(new, Pose) and (before is None or isinstance(before[1], str)):
                self._log.info(f"poses in {name!r} are transformed to {self._world!r}")
            if before is None and len(self._found) >= _FRAMES:
                self._found.clear()
            self._found[name] = found = (now, new)
        return found[1]

    def _looked_up(self, name: str) -> Pose | str:
        """The same, of this moment."""
        try:
            transform = self._buffer.lookup_transform(self._world, name, Time())
        except self._failure as error:
            return f"frame_id {name[:80]!r} cannot be transformed to {self._world!r}: {' '.join(str(error).split())}"
        stamp = transform.header.stamp.sec * 1_000_000_000 + transform.header.stamp.nanosec
        age = 1e-9 * (time_of(self._clock) - stamp)
        if stamp != 0 and age > OLDEST:  # a transform that never moves has the stamp 0
            return f"the transform from {name[:80]!r} to {self._world!r} is {age:.1f} s old, allowed: {OLDEST:g} s"
        p, q = transform.transform.translation, transform.transform.rotation
        return Pose((p.x, p.y, p.z), (q.x, q.y, q.z, q.w))
