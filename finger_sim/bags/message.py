"""What bags hold: messages on topics."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import NamedTuple

from .packing import PACKED, inflated, kind_of


class Message(NamedTuple):
    """One recorded message; `data` is CDR, `sequence` its number on the topic (0: not numbered)."""

    topic: str
    type: str
    log_time: int
    publish_time: int
    data: bytes
    sequence: int


@dataclass(frozen=True)
class Topic:
    """What a bag holds of one type on one topic."""

    name: str
    type: str
    count: int
    """Messages that can be read."""
    lost: int | None = None
    """Numbers missing between them; None where they are not numbered, or not by one writer a channel."""


@dataclass
class Numbers:
    """The messages of one channel, and what their numbers tell."""

    count: int = 0
    lost: int | None = 0
    _last: int = 0

    def take(self, number: int) -> None:
        """The next message. Where numbers do not rise several writers share the channel, or none numbers."""
        if self.count and self.lost is not None:
            self.lost = self.lost + number - self._last - 1 if number > self._last else None
        self.count, self._last = self.count + 1, number


def topics_of(numbers: Mapping[tuple[str, str, int], Numbers]) -> tuple[Topic, ...]:
    """The topics of a bag, from their name, their type and the number of their channel."""
    found: dict[tuple[str, str], list[Numbers]] = {}
    for (name, type, _), channel in numbers.items():
        found.setdefault((name, type), []).append(channel)
    return tuple(_topic(name, type, channels) for (name, type), channels in found.items())


def _topic(name: str, type: str, channels: list[Numbers]) -> Topic:
    known = [channel.lost for channel in channels if channel.lost is not None]
    lost = sum(known) if len(known) == len(channels) else None
    return Topic(name, type, sum(channel.count for channel in channels), lost)


def plain_message(data: bytes) -> bytes:
    """A message's CDR, where it was compressed too; rosbag2 tells that only in metadata.yaml. Raises PackingError."""
    if data.startswith(b"\0"):  # as all CDR does
        return data
    kind = kind_of(data[:4])
    return inflated(data, kind) if kind in PACKED else data


class Source:
    """Where a reader's messages come from."""

    topics: tuple[Topic, ...]

    def __init__(self) -> None:
        self.start: int | None = None
        """Log time of the first message [ns]; None when there is none."""
        self.end: int | None = None
        """Of the last one."""
        self.warnings: list[str] = []
        """What of it cannot be read, and why."""
        self.foreign = False
        """Whether it holds messages that are not of ROS 2, and not counted."""
        self.origin: dict[str, str] = {}
        """Words on its making (`bags.origin`), as far as its files hold them."""

    def spans(self, start: int, end: int) -> None:
        """Takes in that messages are between these log times [ns]."""
        self.start = start if self.start is None else min(self.start, start)
        self.end = end if self.end is None else max(self.end, end)

    @abstractmethod
    def messages(self) -> Iterator[Message]:
        """All of them, in the order of log time; of equal times as they are in the files."""
