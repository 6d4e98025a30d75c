"""Bags without a ROS graph: read rosbag2 folders (MCAP and sqlite3), cut-off ones included; BagWriter makes them.

A bag is a folder `<name>/` with `<name>_0.mcap`, `<name>_1.mcap` … and `metadata.yaml`, as rosbag2 Jazzy writes
it. Times are integer nanoseconds: `log_time` is when a message was received, `publish_time` when it was sent.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import BagError, SceneError
from ..scene import Pose, checked_pose
from . import cdr
from .interrupts import deferred
from .message import Message, Topic
from .metadata import Qos
from .sources import Opened
from .writer import FLUSH_PERIOD, BagWriter, Compression, absolute, require_absent

__all__ = [
    "FLUSH_PERIOD",
    "BagReader",
    "BagWriter",
    "Commands",
    "Compression",
    "Message",
    "PlanePoses",
    "Qos",
    "Topic",
    "absolute",
    "commands_of",
    "plane_poses_of",
    "read_commands",
    "require_absent",
    "write_commands",
]

START = 1_767_225_600_000_000_000
"""When bags that saw no clock begin [ns]: 2026-01-01 00:00 UTC, the same every time."""

LONGEST_SPAN_SECONDS = 1e6
"""Longest time between two commands of a bag that is believed: more comes of a broken or mixed-up clock."""


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
    Raises BagError as BagWriter does; whatever ends it before its end leaves no bag.
    """
    with deferred() as interrupt:
        bag = BagWriter(path, custom_data=custom_data)
        try:
            bag.add_topic(topic, cdr.POSE_STAMPED)
            for time, p, q in zip(times, position, orientation, strict=True):
                bag.write(topic, cdr.pose_stamped(time, frame_id, p, q), time)
                interrupt()
            bag.close()
        except BaseException:
            bag.discard()
            raise
    return path


class BagReader:
    """Reads a rosbag2 folder, or one of its files: MCAP or sqlite3, compressed or not, told by its content.

    A bag that was cut off or damaged is read as far as it can be: `truncated` and `warning` then say what is missing.
    Raises BagError when there is nothing, or nothing of ROS 2, to read.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        opened = Opened(self.path)
        self._source = opened.source
        self.topics = self._source.topics
        self.start_time = self._source.start
        """Log time of the first message that can be read [ns]; None for an empty bag."""
        self.end_time = self._source.end
        self.warning = "; ".join(self._source.warnings) or None
        """What cannot be read, and why."""
        self.truncated = self.warning is not None
        self.notes = tuple(opened.notes)
        """Where its metadata.yaml is wrong, though no message is missing."""
        self.cut = opened.cut
        """Why its writer ended it early, where it said so; all of such a bag can be read."""
        self.origin = self._source.origin
        """Words on what made it, for `bags.origin`; empty where it says nothing."""

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

    def messages(self, topics: Collection[str] | None = None, type: str | None = None) -> Iterator[Message]:
        """Messages in the order of log time (equal times: as in the file), of all topics or those named.

        type : of the messages; left out: whatever type
        """
        wanted = None if topics is None else {absolute(topic) for topic in topics}
        for message in self._source.messages():
            if (wanted is None or absolute(message.topic) in wanted) and type in (None, message.type):
                yield message

    def __iter__(self) -> Iterator[Message]:
        return self.messages()


@dataclass(frozen=True)
class Commands:
    """The commanded poses of a bag, in the order of their receipt.

    Repeated stamps, gaps and sign flips of quaternions (q and −q are one rotation) are kept as recorded.
    A pose that `checked_pose` refuses, as the node does, or one in another frame than `frame_id` is left out and
    counted in `refused`: the last good command holds.
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

    topic : of type PoseStamped; if left out `command_pose` (in any namespace), else the only one but the plane's poses
    Raises BagError when there is no such topic, more than one, another type, or no good command on it.
    """
    return commands_of(BagReader(path), topic)


def commands_of(reader: BagReader, topic: str | None = None) -> Commands:
    """As `read_commands`, of a bag that is already open."""
    chosen = command_topic(reader, topic)
    rows = _read_poses(reader, chosen)
    if not rows:
        raise BagError(f"{reader.path}: topic {chosen} has no message")
    frame_id = Counter(row.frame_id for row in rows).most_common(1)[0][0]
    good, refusals = _good_ones(rows, frame_id)
    if not good:
        raise BagError(f"{reader.path}: topic {chosen} has no good command; {refusals[0]}")
    start, first_stamp = good[0].log_time, good[0].stamp
    if (span := (good[-1].log_time - start) * 1e-9) > LONGEST_SPAN_SECONDS:
        allowed = f"allowed: {LONGEST_SPAN_SECONDS:g} s"
        raise BagError(f"{reader.path}: topic {chosen}: log times span {span:.3g} s, {allowed}")
    position, orientation = _arrays(good)
    return Commands(
        topic=chosen,
        frame_id=frame_id,
        start=start,
        receipt_ns=np.array([row.log_time - start for row in good], dtype=np.int64),
        stamp=np.array([(row.stamp - first_stamp) * 1e-9 for row in good]),
        position=position,
        orientation=orientation,
        refused=len(refusals),
        refusal=refusals[0] if refusals else None,
        warning=reader.warning,
    )


@dataclass(frozen=True)
class PlanePoses:
    """The poses that the plane was told to take, in the order of their receipt; refused as commands are."""

    topic: str
    receipt_ns: NDArray[np.int64]
    """(n,) log times since the first good command [ns], never falling; negative before it."""
    position: NDArray[np.float64]
    """(n, 3) a point of the plane in the commands' frame [m]."""
    orientation: NDArray[np.float64]
    """(n, 4) unit quaternions xyzw; z is the plane's normal."""
    refused: int = 0

    def __len__(self) -> int:
        return len(self.receipt_ns)


def plane_poses_of(reader: BagReader, commands: Commands, topic: str | None = None) -> PlanePoses | None:
    """The poses of the plane in a bag with these commands; None where there are none.

    topic : of type PoseStamped; if left out `plane_pose` beside the commands, else in the only namespace it is in
    Raises BagError when there is no such topic, more than one, or another type.
    """
    chosen = plane_topic(reader, commands.topic, topic)
    if chosen is None:
        return None
    good, refusals = _good_ones(_read_poses(reader, chosen), commands.frame_id)
    position, orientation = _arrays(good)
    farthest = max((abs(row.log_time - commands.start) for row in good), default=0) * 1e-9
    if farthest > LONGEST_SPAN_SECONDS:
        far = f"{farthest:.3g} s away from the first command, allowed: {LONGEST_SPAN_SECONDS:g} s"
        raise BagError(f"{reader.path}: topic {chosen}: a log time is {far}")
    receipt = np.array([row.log_time - commands.start for row in good], dtype=np.int64)
    return PlanePoses(chosen, receipt, position, orientation, len(refusals))


class PoseRow(NamedTuple):
    """One recorded pose; times [ns]."""

    log_time: int
    stamp: int
    frame_id: str
    pose: Pose
    """As it was sent."""

    def judged(self, frame_id: str) -> Pose | str:
        """Its pose, at length one; or why it is refused where poses are in `frame_id`."""
        if self.frame_id != frame_id:
            return f"frame_id {self.frame_id!r}, not {frame_id!r}"
        try:
            return checked_pose(self.pose)
        except SceneError as error:
            return str(error)


def pose_row(reader: BagReader, message: Message, number: int) -> PoseRow:
    """The pose in a message, the one of that `number` on its topic; BagError if it is no pose."""
    where = f"{reader.path}: topic {absolute(message.topic)}, message {number}"
    if message.type != cdr.POSE_STAMPED:
        raise BagError(f"{where}: is {message.type}")
    try:
        pose = cdr.deserialize(message.data, cdr.POSE_STAMPED)
    except ValueError as error:
        raise BagError(f"{where}: {error}") from None
    p, q, stamp = pose.pose.position, pose.pose.orientation, pose.header.stamp
    sent = Pose((p.x, p.y, p.z), (q.x, q.y, q.z, q.w))
    return PoseRow(message.log_time, stamp.sec * 1_000_000_000 + stamp.nanosec, pose.header.frame_id, sent)


def _read_poses(reader: BagReader, topic: str) -> list[PoseRow]:
    """All messages of a topic; BagError for one that is no pose."""
    return [pose_row(reader, message, number) for number, message in enumerate(reader.messages([topic]), start=1)]


def _good_ones(rows: Sequence[PoseRow], frame_id: str) -> tuple[list[PoseRow], list[str]]:
    """Those to be used, their poses at length one, and why the others are not."""
    judged = [row.judged(frame_id) for row in rows]
    good = [row._replace(pose=pose) for row, pose in zip(rows, judged, strict=True) if isinstance(pose, Pose)]
    return good, [f"message {i}: {reason}" for i, reason in enumerate(judged, start=1) if isinstance(reason, str)]


def _arrays(good: Sequence[PoseRow]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Positions (n, 3) and unit quaternions (n, 4)."""
    position = np.array([each.pose.position for each in good]).reshape(-1, 3)
    return position, np.array([each.pose.orientation for each in good]).reshape(-1, 4)


def command_topic(reader: BagReader, topic: str | None) -> str:
    """Name of the topic with the commands."""
    if topic is not None:
        return _named_topic(reader, topic)
    poses = [name for name in _pose_topics(reader) if not name.endswith("/plane_pose")]
    commands = [name for name in poses if name.endswith("/command_pose")]
    if "/command_pose" in commands:
        return "/command_pose"
    candidates = commands or poses
    if len(candidates) == 1:
        return candidates[0]
    if not candidates:
        cut = f"; {reader.warning}" if reader.warning else ""
        raise BagError(f"{reader.path}: no topic of type {cdr.POSE_STAMPED}; found {_found(reader)}{cut}")
    several = ", ".join(candidates)
    raise BagError(f"{reader.path}: several topics of poses: {several}; choose one with --topic")


def plane_topic(reader: BagReader, commands: str, topic: str | None) -> str | None:
    """Name of the topic with the plane's poses, beside the one with the commands; None if there is none."""
    if topic is not None:
        name = _named_topic(reader, topic)
        if name == commands:
            raise BagError(f"{reader.path}: topic {name} cannot hold both the commands and the plane's poses")
        return name
    counts = {absolute(topic.name): topic.count for topic in reader.topics}
    candidates = [name for name in _pose_topics(reader) if name.endswith("/plane_pose") and counts[name] > 0]
    candidates = [name for name in candidates if name != commands]
    beside = f"{commands.rpartition('/')[0]}/plane_pose"
    if beside in candidates:
        return beside
    if len(candidates) > 1:
        several = ", ".join(candidates)
        raise BagError(f"{reader.path}: several topics of the plane's poses: {several}; choose one with --plane-topic")
    return candidates[0] if candidates else None


def _named_topic(reader: BagReader, topic: str) -> str:
    """The absolute name of a topic of poses that was asked for."""
    name, types = absolute(topic), {absolute(t.name): t.type for t in reader.topics}
    if name not in types:
        raise BagError(f"{reader.path}: no topic {name}; found {_found(reader)}")
    if types[name] != cdr.POSE_STAMPED:
        raise BagError(f"{reader.path}: topic {name} is {types[name]}, allowed: {cdr.POSE_STAMPED}")
    return name


def _pose_topics(reader: BagReader) -> list[str]:
    return [absolute(topic.name) for topic in reader.topics if topic.type == cdr.POSE_STAMPED]


def _found(reader: BagReader) -> str:
    """What topics there are."""
    return ", ".join(f"{absolute(topic.name)} ({topic.type})" for topic in reader.topics) or "no topic"
