"""Recorded poses one message at a time: of a bag, however long, no more than a chunk is in memory."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

from ..errors import BagError
from ..scene import Pose
from . import cdr
from .bag import BagReader
from .choice import command_topic, plane_topic
from .message import Message
from .poses import PoseRow, pose_row, usual_frame


class Received(NamedTuple):
    """A good pose and when it was received."""

    log_time: int
    """[ns]"""
    pose: Pose
    """Its quaternion at length one."""
    number: int
    """Of its message on the topic, from 1 on."""


class Tally(NamedTuple):
    """What an excerpt holds."""

    good: int
    refused: int
    first: int
    """Log time of the first good pose [ns]; 0 where there is none."""
    last: int
    """Of the last one."""
    refusal: str | None = None
    """Why the first of the refused is refused, with the number of its message."""


@dataclass(frozen=True)
class Excerpt:
    """The poses of one topic: all of them, or those of a window of time.

    A window begins with the newest good pose received by then, as if it came right then; what came before is gone.
    """

    reader: BagReader
    topic: str
    frame_id: str
    """Poses in another frame are refused."""
    begin: int | None = None
    """Log time [ns]; None: from the first message on."""
    end: int | None = None
    """Log time [ns], included; None: to the last message."""
    held: tuple[int, Message] | None = None
    """What holds at `begin`, and its number on the topic."""

    def cut(self, begin: int | None, end: int | None) -> Excerpt:
        """The window from `begin` to `end`, log times [ns]; None leaves a side open."""
        held = None
        if begin is not None:
            for row in self._rows():
                if row.message.log_time > begin:
                    break
                if isinstance(row.judged(self.frame_id), Pose):
                    held = row.number, row.message._replace(log_time=begin)
        return replace(self, begin=begin, end=end, held=held)

    def messages(self) -> Iterator[Message]:
        """All its poses as they were recorded, refused ones too, in the order of their receipt."""
        return (message for _, message in self._selected())

    def poses(self) -> Iterator[Received]:
        """The good ones."""
        for row in self._rows():
            pose = row.judged(self.frame_id)
            if isinstance(pose, Pose):
                yield Received(row.message.log_time, pose, row.number)

    def times(self) -> Iterator[tuple[int, str, int]]:
        """Of the good ones: log time [ns], topic and number of the message."""
        return ((pose.log_time, self.topic, pose.number) for pose in self.poses())

    def tally(self) -> Tally:
        """Counts, and between when."""
        good = refused = first = last = 0
        refusal = None
        for row in self._rows():
            pose = row.judged(self.frame_id)
            if isinstance(pose, Pose):
                last = row.message.log_time
                first = last if good == 0 else first
                good += 1
            else:
                refused += 1
                refusal = refusal or f"message {row.number}: {pose}"
        return Tally(good, refused, first, last, refusal)

    def _rows(self) -> Iterator[PoseRow]:
        return (pose_row(number, message) for number, message in self._selected())

    def _selected(self) -> Iterator[tuple[int, Message]]:
        """The messages in the window, with their numbers on the topic."""
        if self.held is not None:
            yield self.held
        for number, message in enumerate(self.reader.messages([self.topic], cdr.POSE_STAMPED), start=1):
            if self.end is not None and message.log_time > self.end:
                return
            if self.begin is None or message.log_time > self.begin:
                yield number, message


class Arrivals:
    """Poses in the order of their receipt, asked for what came."""

    def __init__(self, poses: Iterator[Received]) -> None:
        self._poses = poses
        self._next = next(poses, None)

    def up_to(self, log_time: int) -> list[Received]:
        """Those received by then [ns] that were not asked for before."""
        came = []
        while self._next is not None and self._next.log_time <= log_time:
            came.append(self._next)
            self._next = next(self._poses, None)
        return came


def commands_in(reader: BagReader, topic: str | None = None, frame_id: str | None = None) -> tuple[Excerpt, Tally]:
    """The commanded poses in a bag, and what there is of them.

    topic    : as for `read_commands`
    frame_id : of the good ones; None: that of most
    Raises BagError as `read_commands` does, whatever gaps there are.
    """
    chosen = command_topic(reader, topic)
    where = f"{reader.path}: topic {chosen}"
    if frame_id is None:
        messages = reader.messages([chosen], cdr.POSE_STAMPED)
        rows = (pose_row(number, message) for number, message in enumerate(messages, start=1))
        frame_id = usual_frame(where, rows)
    commands = Excerpt(reader, chosen, frame_id)
    tally = commands.tally()
    if not tally.good:
        raise BagError(f"{where} has no good command; {tally.refusal}" if tally.refusal else f"{where} has no message")
    return commands, tally


def plane_poses_in(reader: BagReader, commands: Excerpt, topic: str | None = None) -> Excerpt | None:
    """The poses of the plane in a bag with these commands; None where there are none.

    topic : as for `plane_poses_of`
    Raises BagError as `plane_poses_of` does.
    """
    chosen = plane_topic(reader, commands.topic, topic)
    return None if chosen is None else Excerpt(reader, chosen, commands.frame_id)
