"""A stand-in for tf2_ros, which no wheel brings: of it what the node uses, with the same names and arguments.

tf2_msgs is in no wheel either, so transforms come and go one by one, as TransformStamped on topics of its own.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from geometry_msgs.msg import TransformStamped
from scipy.spatial.transform import Rotation

HEARD, SENT = "/stand_in_tf", "/stand_in_broadcast"


class TransformException(Exception):
    """Why there is no transform."""


class Buffer:
    """Transforms by their child frame."""

    def __init__(self) -> None:
        self.transforms: dict[str, TransformStamped] = {}

    def set_transform(self, transform: TransformStamped, authority: str) -> None:
        self.transforms[transform.child_frame_id] = transform

    def lookup_transform(self, target_frame: str, source_frame: str, time: Any) -> TransformStamped:
        """Of the newest transforms between two frames; its stamp is the oldest of those that move."""
        ups = [self._up(frame) for frame in (target_frame, source_frame)]
        if ups[0][0] != ups[1][0]:
            raise TransformException(f'"{source_frame}" passed to lookupTransform argument source_frame does not exist')
        out = TransformStamped(child_frame_id=source_frame)
        out.header.frame_id = target_frame
        whole = np.linalg.inv(ups[0][1]) @ ups[1][1]
        p, q = out.transform.translation, out.transform.rotation
        p.x, p.y, p.z = map(float, whole[:3, 3])
        q.x, q.y, q.z, q.w = map(float, Rotation.from_matrix(whole[:3, :3]).as_quat())
        stamps = [stamp for _, _, stamps in ups for stamp in stamps if stamp]
        out.header.stamp.sec, out.header.stamp.nanosec = divmod(min(stamps, default=0), 1_000_000_000)
        return out

    def _up(self, frame: str) -> tuple[str, Any, list[int]]:
        """The root above a frame, the frame's placement there (4, 4), and the stamps on the way [ns]."""
        whole, stamps = np.eye(4), []
        while frame in self.transforms:
            found = self.transforms[frame]
            p, q = found.transform.translation, found.transform.rotation
            step = np.eye(4)
            step[:3, :3] = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix()
            step[:3, 3] = p.x, p.y, p.z
            whole = step @ whole
            stamps.append(found.header.stamp.sec * 1_000_000_000 + found.header.stamp.nanosec)
            frame = found.header.frame_id
        return frame, whole, stamps


class TransformListener:
    """Fills a buffer with what comes."""

    def __init__(self, buffer: Buffer, node: Any) -> None:
        node.create_subscription(TransformStamped, HEARD, lambda message: buffer.set_transform(message, "test"), 10)


class TransformBroadcaster:
    """Sends."""

    def __init__(self, node: Any) -> None:
        self._publisher = node.create_publisher(TransformStamped, SENT, 100)

    def sendTransform(self, transforms: list[TransformStamped]) -> None:
        for transform in transforms:
            self._publisher.publish(transform)
