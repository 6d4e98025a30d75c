"""A pose in a message, and whether its stamps tell the time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

from ...errors import BagError
from ...physics.rotations import Quaternion, unit
from ...scene import Vec3
from .formats import Clock

POSE, COVARIANCE, TRANSFORM, ODOMETRY = (
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "geometry_msgs/msg/TransformStamped",
    "nav_msgs/msg/Odometry",
)
POSES = (POSE, COVARIANCE, TRANSFORM, ODOMETRY)
"""Types of topics that are poses."""
TRANSFORMS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
"""Types of topics of transforms between frames, of today and of the oldest ROS 1."""
TWISTS = ("geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped")


class Sample(NamedTuple):
    """A pose in a message: `number` on its topic, `receipt` and `stamp` [ns], frames, and the numbers as sent."""

    number: int
    receipt: int
    stamp: int
    frame: str
    child: str
    position: Vec3
    orientation: Quaternion

    def refusal(self) -> str | None:
        """Why its numbers are no pose; None where they are."""
        if not all(map(math.isfinite, self.position)):
            return f"position: got {self.position}, allowed: finite numbers"
        if unit(self.orientation) is None:
            return f"orientation: got {self.orientation}, allowed: a finite quaternion that is not zero"
        return None


def sample(number: int, receipt: int, message: Any) -> Sample:
    """The pose in a message of one of POSES."""
    header = message.header
    child = getattr(message, "child_frame_id", "")
    if hasattr(message, "transform"):
        p, q = message.transform.translation, message.transform.rotation
    else:
        pose = message.pose.pose if hasattr(message.pose, "pose") else message.pose
        p, q = pose.position, pose.orientation
    stamp = header.stamp.sec * 1_000_000_000 + header.stamp.nanosec
    frames = header.frame_id.lstrip("/"), child.lstrip("/")
    return Sample(number, receipt, stamp, *frames, (p.x, p.y, p.z), (q.x, q.y, q.z, q.w))


def clocked(stamps: Sequence[int], clock: Clock | None, where: str) -> tuple[bool, str]:
    """Whether times are header stamps, and why: so they are where stamps run, unless the user wants another clock."""
    fault = _fault(stamps)
    if clock == "header" and fault:
        raise BagError(f"{where}: header stamps {fault}, allowed with --clock header: stamps that never fall")
    if clock == "receipt" or (clock is None and fault):
        return False, "times of receipt" + (f", for header stamps {fault}" if fault and clock is None else "")
    return True, "times of header stamps"


def _fault(stamps: Sequence[int]) -> str | None:
    """Why stamps tell no time; None where they do."""
    if not any(stamps):
        return "are zero"
    if len(stamps) > 1 and len(set(stamps)) == 1:
        return "stand still"
    for i, (before, after) in enumerate(pairwise(stamps), start=2):
        if after < before:
            return f"fall by {(before - after) * 1e-9:.3g} s at pose {i}"
    return None
