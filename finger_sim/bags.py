"""Bags without a ROS graph: read rosbag2 folders (MCAP and sqlite3), cut-off ones included; BagWriter makes them.

A bag is a folder `<name>/` with `<name>_0.mcap`, `<name>_1.mcap` … and `metadata.yaml`, as rosbag2 Jazzy writes
it. Times are integer nanoseconds: `log_time` is when a message was received, `publish_time` when it was sent.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from . import cdr
from .bag_sources import Message, Topic, open_source
from .bag_writer import FLUSH_PERIOD, BagWriter, Compression, Qos, absolute, require_absent
from .errors import BagError

__all__ = [
    "FLUSH_PERIOD",
    "BagReader",
    "BagWriter",
    "Commands",
    "Compression",
    "Message",
    "Qos",
    "Topic",
    "absolute",
    "read_commands",
    "require_absent",
    "write_commands",
]

START = 1_767_225_600_000_000_000
"""When bags that saw no clock begin [ns]: 2026-01-01 00:00 UTC, the same every time."""

LONGEST = 1e6
"""Longest time between commands that is believed [s]: more comes of a broken or mixed-up clock."""


def write_commands(
    path: Path,
    times: Sequence[int],
    position: NDArray[np.float64],
    orientation: NDArray[np.float64],
    *,
    topic: str = "command_pose",
    frame_id: str = "world",
    custom_data: Mapping[str, str] | None = None,
) -> Path:
    """Makes a bag of commanded poses (n, 3) [m] and (n, 4) xyzw, received and stamped at `times` [ns].

    custom_data : words for the bag's metadata
    Raises BagError as BagWriter does.
    """
    with BagWriter(path, custom_data=custom_data) as bag:
        bag.add_topic(topic, cdr.POSE_STAMPED)
        for time, p, q in zip(times, position, orientation, strict=True):
            bag.write(topic, cdr.pose_stamped(time, frame_id, p, q), time)
    return path


class BagReader:
    """Reads a rosbag2 folder (MCAP or sqlite3), or a bare .mcap or .db3 file.

    A bag that was cut off while it was written is read up to its last whole chunk; `truncated` and `warning`
    then say so. Raises BagError when there is nothing, or nothing of ROS 2, to read.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self._source = open_source(self.path)
        self.topics = self._source.topics
        self.start_time = self._source.start
        self.end_time = self._source.end
        self.warning = self._source.warning
        self.truncated = self.warning is not None

    @property
    def duration(self) -> float:
        """Time from the first to the last message [s]; 0 for an empty bag."""
        if self.start_time is None or self.end_time is None:
            return 0.0
        return (self.end_time - self.start_time) * 1e-9

    @property
    def message_count(self) -> int:
        """Messages on all topics."""
        return sum(topic.count for topic in self.topics)

    def messages(self, topics: Collection[str] | None = None) -> Iterator[Message]:
        """Messages in the order of log time (equal times: as in the file), of all topics or those named."""
        wanted = None if topics is None else {absolute(topic) for topic in topics}
        for message in self._source.messages():
            if wanted is None or absolute(message.topic) in wanted:
                yield message

    def __iter__(self) -> Iterator[Message]:
        return self.messages()


@dataclass(frozen=True)
class Commands:
    """The commanded poses of a bag, in the order of their receipt.

    Repeated stamps, gaps and sign flips of quaternions (q and −q are one rotation) are kept as recorded.
    A non-finite pose, a zero quaternion or a frame other than `frame_id` is left out and counted
    in `refused`: the last good command holds.
    """

    topic: str
    frame_id: str
    start: int
    """Log time of the first good command [ns]."""
    receipt_ns: NDArray[np.int64]
    """(n,) log times since `start` [ns], never falling."""
    stamp: NDArray[np.float64]
    """(n,) header stamps since the first one [s]."""
    position: NDArray[np.float64]
    """(n, 3) origin of the finger frame in `frame_id` [m]."""
    orientation: NDArray[np.float64]
    """(n, 4) orientation of the finger frame, unit quaternions xyzw."""
    refused: int = 0
    refusal: str | None = None
    """Why the first of the refused was refused."""
    warning: str | None = None
    """What was wrong with the bag, if it was cut off."""

    def __len__(self) -> int:
        return len(self.receipt_ns)

    @property
    def receipt(self) -> NDArray[np.float64]:
        """(n,) log times since the first command [s]."""
        return np.multiply(self.receipt_ns, 1e-9, dtype=np.float64)

    @property
    def duration(self) -> float:
        """Time from the first to the last command [s]."""
        return float(self.receipt_ns[-1]) * 1e-9


def read_commands(path: str | Path, topic: str | None = None) -> Commands:
    """The commanded poses in a bag.

    topic : of type PoseStamped; if left out `command_pose` (in any namespace), else the only one of poses
    Raises BagError when there is no such topic, more than one, another type, or no good command on it.
    """
    return commands_of(BagReader(path), topic)


def commands_of(reader: BagReader, topic: str | None = None) -> Commands:
    """As `read_commands`, of a bag that is already open."""
    chosen = _command_topic(reader, topic)
    rows: list[tuple[int, int, str, list[float]]] = []
    for number, message in enumerate(reader.messages([chosen]), start=1):
        if message.type != cdr.POSE_STAMPED:
            raise BagError(f"{reader.path}: topic {chosen}, message {number}: is {message.type}")
        try:
            pose = cdr.deserialize(message.data, cdr.POSE_STAMPED)
        except ValueError as error:
            raise BagError(f"{reader.path}: topic {chosen}, message {number}: {error}") from None
        p, q, stamp = pose.pose.position, pose.pose.orientation, pose.header.stamp
        rows.append(
            (
                message.log_time,
                stamp.sec * 1_000_000_000 + stamp.nanosec,
                pose.header.frame_id,
                [p.x, p.y, p.z, q.x, q.y, q.z, q.w],
            )
        )
    if not rows:
        raise BagError(f"{reader.path}: topic {chosen} has no message")
    frame_id = Counter(row[2] for row in rows).most_common(1)[0][0]
    reasons = [_refusal(row[2], row[3], frame_id) for row in rows]
    good = [row for row, reason in zip(rows, reasons, strict=True) if reason is None]
    refusals = [f"message {i}: {reason}" for i, reason in enumerate(reasons, start=1) if reason]
    if not good:
        raise BagError(f"{reader.path}: topic {chosen} has no good command; {refusals[0]}")
    start, first_stamp = good[0][0], good[0][1]
    if (span := (good[-1][0] - start) * 1e-9) > LONGEST:
        raise BagError(f"{reader.path}: topic {chosen}: log times span {span:.3g} s, allowed: {LONGEST:g} s")
    values = np.array([row[3] for row in good])
    return Commands(
        topic=chosen,
        frame_id=frame_id,
        start=start,
        receipt_ns=np.array([row[0] - start for row in good], dtype=np.int64),
        stamp=np.array([(row[1] - first_stamp) * 1e-9 for row in good]),
        position=values[:, :3],
        orientation=values[:, 3:] / np.linalg.norm(values[:, 3:], axis=1, keepdims=True),
        refused=len(refusals),
        refusal=refusals[0] if refusals else None,
        warning=reader.warning,
    )


def _refusal(frame: str, values: list[float], frame_id: str) -> str | None:
    """Why a command must not be used, or None."""
    if frame != frame_id:
        return f"frame_id {frame!r}, not {frame_id!r}"
    if not np.isfinite(values).all():
        return f"not finite: {values}"
    if np.linalg.norm(values[3:]) < 1e-6:
        return f"orientation {values[3:]} is a zero quaternion"
    return None


def _command_topic(reader: BagReader, topic: str | None) -> str:
    """Name of the topic with the commands."""
    types = {absolute(t.name): t.type for t in reader.topics}
    found = ", ".join(f"{name} ({type})" for name, type in types.items()) or "no topic"
    if topic is not None:
        name = absolute(topic)
        if name not in types:
            raise BagError(f"{reader.path}: no topic {name}; found {found}")
        if types[name] != cdr.POSE_STAMPED:
            raise BagError(f"{reader.path}: topic {name} is {types[name]}, allowed: {cdr.POSE_STAMPED}")
        return name
    poses = [name for name, type in types.items() if type == cdr.POSE_STAMPED]
    commands = [name for name in poses if name.endswith("/command_pose")]
    if "/command_pose" in commands:
        return "/command_pose"
    candidates = commands or poses
    if len(candidates) == 1:
        return candidates[0]
    if not candidates:
        cut = f"; {reader.warning}" if reader.warning else ""
        raise BagError(f"{reader.path}: no topic of type {cdr.POSE_STAMPED}; found {found}{cut}")
    several = ", ".join(candidates)
    raise BagError(f"{reader.path}: several topics of poses: {several}; choose one with --topic")
