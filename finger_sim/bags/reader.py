"""Bags without a ROS graph: read rosbag2 folders (MCAP and sqlite3), cut-off ones included; BagWriter makes them.

A bag is a folder `<name>/` with `<name>_0.mcap`, `<name>_1.mcap` … and `metadata.yaml`, as rosbag2 Jazzy writes
it. Times are integer nanoseconds: `log_time` is when a message was received, `publish_time` when it was sent.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import BagError
from ..scene import Pose
from . import cdr
from .bag import BagReader
from .choice import command_topic, plane_topic
from .gaps import Gap, gaps_in, require_allowed
from .interrupts import deferred
from .message import Message, Topic
from .metadata import Qos
from .poses import PoseRow, pose_row, usual_frame
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
    """All its messages of poses: a subscriber hears no others."""
    messages = reader.messages([topic], cdr.POSE_STAMPED)
    return [pose_row(number, message) for number, message in enumerate(messages, start=1)]


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
