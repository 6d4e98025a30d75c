"""Recorded poses one message at a time: of a bag, however long, no more than a chunk is in memory."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

from ..errors import BagError
from ..scene import Pose
from .cdr import POSE_STAMPED
from .reader import LONGEST_SPAN_SECONDS, BagReader, Message, command_topic, plane_topic, pose_row


class Received(NamedTuple):
    """A good pose and when it was received."""

    log_time: int
    """[ns]"""
    pose: Pose
    """Its quaternion at length one."""


class Tally(NamedTuple):
    """What an excerpt holds."""

    good: int
    refused: int
    first: int
    """Log time of the first good pose [ns]; 0 where there is none."""
    last: int
    """Of the last one."""


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
    held: Message | None = None
    """What holds at `begin`."""

    def cut(self, begin: int | None, end: int | None) -> Excerpt:
        """The window from `begin` to `end`, log times [ns]; None leaves a side open."""
        held = None
        if begin is not None:
            for message, pose in self._judged():
                if message.log_time > begin:
                    break
                if isinstance(pose, Received):
                    held = message._replace(log_time=begin)
        return replace(self, begin=begin, end=end, held=held)

    def messages(self) -> Iterator[Message]:
        """All its poses as they were recorded, refused ones too, in the order of their receipt."""
        if self.held is not None:
            yield self.held
        for message in self.reader.messages([self.topic], POSE_STAMPED):
            if self.end is not None and message.log_time > self.end:
                return
            if self.begin is None or message.log_time > self.begin:
                yield message

    def poses(self) -> Iterator[Received]:
        """The good ones."""
        return (pose for _, pose in self._judged() if isinstance(pose, Received))

    def first_refusal(self) -> str:
        """Why the first refused one is refused."""
        refusals = (reason for _, reason in self._judged() if isinstance(reason, str))
        return next(refusals, "")

    def tally(self) -> Tally:
        """Counts, and between when."""
        good = refused = first = last = 0
        for message, pose in self._judged():
            if isinstance(pose, str):
                refused += 1
                continue
            first = message.log_time if good == 0 else first
            last = message.log_time
            good += 1
        return Tally(good, refused, first, last)

    def _judged(self) -> Iterator[tuple[Message, Received | str]]:
        """Each message with its pose, or with why that is refused. Raises BagError for one that is no pose."""
        for number, message in enumerate(self.messages(), start=1):
            pose = pose_row(self.reader, message, number).judged(self.frame_id)
            if isinstance(pose, Pose):
                yield message, Received(message.log_time, pose)
            else:
                yield message, f"message {number}: {pose}"


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


def commands_in(reader: BagReader, topic: str | None = None) -> tuple[Excerpt, Tally]:
    """The commanded poses in a bag, and what there is of them.

    topic : as for `read_commands`
    Raises BagError as `read_commands` does.
    """
    chosen = command_topic(reader, topic)
    messages = reader.messages([chosen], POSE_STAMPED)
    frames = Counter(pose_row(reader, message, number).frame_id for number, message in enumerate(messages, start=1))
    if not frames:
        raise BagError(f"{reader.path}: topic {chosen} has no message")
    commands = Excerpt(reader, chosen, frames.most_common(1)[0][0])
    tally = commands.tally()
    if not tally.good:
        raise BagError(f"{reader.path}: topic {chosen} has no good command; {commands.first_refusal()}")
    if (span := (tally.last - tally.first) * 1e-9) > LONGEST_SPAN_SECONDS:
        allowed = f"allowed: {LONGEST_SPAN_SECONDS:g} s"
        raise BagError(f"{reader.path}: topic {chosen}: log times span {span:.3g} s, {allowed}")
    return commands, tally


def plane_poses_in(reader: BagReader, commands: Excerpt, topic: str | None = None) -> Excerpt | None:
    """The poses of the plane in a bag with these commands; None where there are none.

    topic : as for `plane_poses_of`
    Raises BagError as `plane_poses_of` does.
    """
    chosen = plane_topic(reader, commands.topic, topic)
    return None if chosen is None else Excerpt(reader, chosen, commands.frame_id)
