"""What bags hold: messages on topics."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple, Protocol


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
    """What a bag holds of one topic; `lost` counts the numbers missing between its messages."""

    name: str
    type: str
    count: int
    lost: int = 0


class Source(Protocol):
    """Where a reader's messages come from: times in ns, None when empty; `warning` if it was cut off."""

    topics: tuple[Topic, ...]
    start: int | None
    end: int | None
    warning: str | None
    cut: str | None
    """Why its writer ended it early, as its metadata says; it is whole all the same."""

    origin: dict[str, str]
    """Words on its making (`bags.origin`), as far as it holds them."""

    def messages(self) -> Iterator[Message]: ...
