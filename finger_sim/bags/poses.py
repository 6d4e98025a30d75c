"""What a PoseStamped in CDR bytes says, and whether it is of use: one rule for what the node hears and bags hold."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Iterable
from typing import NamedTuple

from ..errors import BagError, SceneError
from ..scene import Pose, checked_pose
from .message import Message
from .template import STAMP_OFFSET

_ENCODINGS = {
    order: (struct.Struct(f"{sign}iII"), struct.Struct(f"{sign}7d"))
    for order, sign in ((b"\x00\x00", ">"), (b"\x00\x01", "<"))
}
"""By the first two bytes, plain CDR of either order: header up to the length of its frame_id, and the numbers."""
_HEADER = 12
"""Bytes of the first."""
_NUMBERS = 56
_SHOWN = 80
"""Characters of a frame_id that a refusal shows: what anyone sends is told again in logs and every second."""


class StampedPose(NamedTuple):
    """What a PoseStamped says."""

    stamp: int
    """[ns]"""
    frame_id: str
    values: tuple[float, ...]
    """Position x y z [m] and orientation x y z w, as they were sent."""


def read_pose(data: bytes) -> StampedPose:
    """A PoseStamped in CDR bytes. Raises ValueError for bytes that are none, and for a stamp that is no time.

    Bytes behind its end are passed over, and a frame_id ends with its first zero, as rclpy has it.
    """
    encoding = _ENCODINGS.get(bytes(data[:2]))
    name = STAMP_OFFSET + _HEADER
    if encoding is not None and len(data) >= name:
        header, numbers = encoding
        seconds, nanoseconds, length = header.unpack_from(data, STAMP_OFFSET)
        pose = name + length
        pose += (STAMP_OFFSET - pose) % 8
        if len(data) >= pose + _NUMBERS:
            if seconds < 0 or nanoseconds >= 1_000_000_000:
                allowed = "must be sec >= 0 and nanosec < 1000000000"
                raise ValueError(f"stamp of {seconds} s and {nanoseconds} ns, {allowed}")
            frame_id = bytes(data[name : name + length]).partition(b"\x00")[0].decode(errors="replace")
            return StampedPose(seconds * 1_000_000_000 + nanoseconds, frame_id, numbers.unpack_from(data, pose))
    raise ValueError(f"{len(data)} bytes that are no PoseStamped")


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


class PoseRow(NamedTuple):
    """A recorded message on a topic of poses."""

    number: int
    """On its topic, from 1 on."""
    message: Message
    said: StampedPose | str
    """Why it is refused whatever frame is asked for, where it says no pose."""

    def judged(self, frame_id: str) -> Pose | str:
        """Its pose, at length one; or why it is refused where poses are in `frame_id`."""
        return self.said if isinstance(self.said, str) else check_pose(self.said, frame_id)


def pose_row(number: int, message: Message) -> PoseRow:
    """A recorded pose."""
    try:
        return PoseRow(number, message, read_pose(message.data))
    except ValueError as error:
        return PoseRow(number, message, str(error))


def usual_frame(where: str, rows: Iterable[PoseRow]) -> str:
    """The frame of most poses of a topic; `where` names it. Raises BagError where none of its messages says a pose."""
    frames: Counter[str] = Counter()
    refusal = ""
    for row in rows:
        if isinstance(row.said, str):
            refusal = refusal or f"message {row.number}: {row.said}"
        else:
            frames[row.said.frame_id] += 1
    if not frames:
        lack = f"no good command; {refusal}" if refusal else "no message"
        raise BagError(f"{where} has {lack}")
    return frames.most_common(1)[0][0]
