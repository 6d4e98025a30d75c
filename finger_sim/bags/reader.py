"""Bags without a ROS graph: read rosbag2 folders (MCAP and sqlite3), cut-off ones included; BagWriter makes them.

A bag is a folder `<name>/` with `<name>_0.mcap`, `<name>_1.mcap` … and `metadata.yaml`, as rosbag2 Jazzy writes
it. Times are integer nanoseconds: `log_time` is when a message was received, `publish_time` when it was sent.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import BagError
from ..scene import Pose
from . import cdr
from .gaps import Gap, gaps_in, require_allowed
from .interrupts import deferred
from .message import Message, Topic
from .metadata import Qos
from .poses import PoseRow, pose_row, usual_frame
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
        self.foreign = self._source.foreign
        """Encodings of messages that are not read, by their topic's name and type."""
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
    A message that the node refuses, as `bags.poses` judges, is left out and counted in `refused`: the last good command
    holds.
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
    gaps: tuple[Gap, ...] = ()
    """Times without a good command that are longer than `gaps.GAP_TOLD`."""

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

    def window(self, start: float, duration: float | None = None) -> Commands:
        """Those from `start` [s] on, for `duration`, ends included; the newest by its beginning comes right then.

        Raises BagError for a start past the last command.
        """
        if not 0.0 <= start <= self.duration:
            raise BagError(f"start: got {start:.9g} s, allowed: 0 to {self.duration:.9g} s, where the commands end")
        begin = round(start * 1e9)
        last = int(self.receipt_ns[-1])
        end = last if duration is None else min(begin + round(duration * 1e9), last)
        kept = slice(
            int(np.searchsorted(self.receipt_ns, begin, side="right")) - 1,
            int(np.searchsorted(self.receipt_ns, end, side="right")),
        )
        return replace(
            self,
            start=self.start + begin,
            receipt_ns=np.maximum(self.receipt_ns[kept] - begin, 0),
            stamp=self.stamp[kept] - self.stamp[kept][0],
            position=self.position[kept],
            orientation=self.orientation[kept],
            gaps=tuple(gap for gap in self.gaps if gap.end - self.start > begin and gap.end - self.start <= end),
        )


def read_commands(path: str | Path, topic: str | None = None, *, allow_gaps: bool = False) -> Commands:
    """The commanded poses in a bag.

    topic      : of type PoseStamped; if left out `command_pose` (in any namespace), else the only one but the plane's
    allow_gaps : take also what has gaps longer than `gaps.GAP_ALLOWED`
    Raises BagError when there is no such topic, more than one, another type, no good command on it, or such a gap.
    """
    return commands_of(BagReader(path), topic, allow_gaps=allow_gaps)


def commands_of(reader: BagReader, topic: str | None = None, *, allow_gaps: bool = False) -> Commands:
    """As `read_commands`, of a bag that is already open."""
    chosen = command_topic(reader, topic)
    rows = _rows(reader, chosen)
    frame_id = usual_frame(f"{reader.path}: topic {chosen}", rows)
    good, refusals = _good_ones(rows, frame_id)
    if not good:
        raise BagError(f"{reader.path}: topic {chosen} has no good command; {refusals[0]}")
    start, first_stamp = good[0].log_time, good[0].stamp
    gaps = list(gaps_in((row.log_time, chosen, row.number) for row in good))
    if not allow_gaps:
        require_allowed(reader.path, gaps)
    position, orientation = _arrays(good)
    return Commands(
        topic=chosen,
        frame_id=frame_id,
        start=start,
        receipt_ns=_since(reader, good, start),
        stamp=np.array([(row.stamp - first_stamp) * 1e-9 for row in good]),
        position=position,
        orientation=orientation,
        refused=len(refusals),
        refusal=refusals[0] if refusals else None,
        warning=reader.warning,
        gaps=tuple(gaps),
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
    good, refusals = _good_ones(_rows(reader, chosen), commands.frame_id)
    position, orientation = _arrays(good)
    return PlanePoses(chosen, _since(reader, good, commands.start), position, orientation, len(refusals))


def _rows(reader: BagReader, topic: str) -> list[PoseRow]:
    """All messages of a topic."""
    return [pose_row(number, message) for number, message in enumerate(reader.messages([topic]), start=1)]


class _Good(NamedTuple):
    """A pose that is used; times [ns]."""

    number: int
    log_time: int
    stamp: int
    pose: Pose


def _good_ones(rows: Iterable[PoseRow], frame_id: str) -> tuple[list[_Good], list[str]]:
    """Those to be used, and why the others are not."""
    good, refusals = [], []
    for row in rows:
        pose = row.judged(frame_id)
        if isinstance(pose, str) or isinstance(row.said, str):
            refusals.append(f"message {row.number}: {pose}")
        else:
            good.append(_Good(row.number, row.message.log_time, row.said.stamp, pose))
    return good, refusals


def _since(reader: BagReader, good: Sequence[_Good], start: int) -> NDArray[np.int64]:
    """(n,) log times since `start` [ns]. Raises BagError for one that no clock shows."""
    for row in good:
        if row.log_time >= cdr.STAMPS_END:
            where = f"{reader.path}: message {row.number}: log time of {row.log_time * 1e-9:.9g} s"
            raise BagError(f"{where}, allowed: below 2^31 s, as messages are stamped")
    return np.array([row.log_time - start for row in good], dtype=np.int64)


def _arrays(good: Sequence[_Good]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
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
    candidates = [name for name in _pose_topics(reader, counted=True) if name.endswith("/plane_pose")]
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
    name = absolute(topic)
    types = [each.type for each in reader.topics if absolute(each.name) == name]
    if not types:
        raise BagError(f"{reader.path}: no topic {name}; found {_found(reader)}")
    if cdr.POSE_STAMPED not in types:
        raise BagError(f"{reader.path}: topic {name} is {types[0]}, allowed: {cdr.POSE_STAMPED}")
    return name


def _pose_topics(reader: BagReader, *, counted: bool = False) -> list[str]:
    """Names of topics of poses, each once; `counted`: of those with messages."""
    poses = (topic for topic in reader.topics if topic.type == cdr.POSE_STAMPED and (topic.count or not counted))
    return list(dict.fromkeys(absolute(topic.name) for topic in poses))


def _found(reader: BagReader) -> str:
    """What topics there are."""
    return ", ".join(f"{absolute(topic.name)} ({topic.type})" for topic in reader.topics) or "no topic"
