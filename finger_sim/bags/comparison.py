"""What is different in two bags, as records."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..plain import plain
from .lag import Lag


@dataclass
class Difference:
    """How far one quantity of A and B is apart: of vectors the length, of turns the angle."""

    quantity: str
    unit: str
    rms: float = 0.0
    """Over the messages compared (and their points)."""
    max: float = 0.0
    """inf where the two cannot be compared: another frame, number of points, or not a number."""
    max_time: float = 0.0
    """Of the message with the largest difference, since the start of A [s]."""
    peak: float = 0.0
    """Largest value in A, of the messages compared."""


@dataclass
class TopicComparison:
    """What is different on one topic, which is a name with a type."""

    name: str
    type: str
    messages: tuple[int, int]
    """In A and in B."""
    identical: bool = True
    """Whether bytes, times and numbers of all messages are the same."""
    compared: int = 0
    """Messages of A with a B to compare with."""
    outside: tuple[int, int] = (0, 0)
    """Messages of A and of B at times that the other does not hold."""
    before: tuple[int, int] = (0, 0)
    """Of these, those of A before the first one of B, and those of B before the first one of A."""
    after: tuple[int, int] = (0, 0)
    """Of these, those of A after the last one of B, and those of B after the last one of A."""
    differences: list[Difference] = field(default_factory=list)
    """Of the quantities in wrenches, poses, clouds and meshes; of other types none."""
    first: str | None = None
    """The first difference that counts, and when [s since the start of A]."""
    equal: bool = True
    lag: Lag | None = None
    """How B's first quantity lies after A's, of wrenches and poses; None where that cannot be told."""


@dataclass
class LeftOut:
    """A topic that was not compared."""

    name: str
    type: str
    messages: tuple[int, int]
    """In A and in B."""
    reason: str


@dataclass
class Comparison:
    """What is different in two bags; `equal` when nothing that counts is."""

    a: Path
    b: Path
    tolerance: float | None
    topics: list[TopicComparison]
    warnings: list[str]
    left_out: list[LeftOut]

    @property
    def equal(self) -> bool:
        """Whether all topics are equal: bit by bit, or within the tolerance. Of bags with nothing to compare, no."""
        return all(topic.equal for topic in self.topics) and bool(self.topics or not self.left_out)

    def label(self, topic: TopicComparison | LeftOut) -> str:
        """The topic's name, with its type where the name stands for several topics."""
        names = [other.name for other in self.topics] + [other.name for other in self.left_out]
        return f"{topic.name} ({topic.type})" if names.count(topic.name) > 1 else topic.name

    def as_plain(self) -> dict[str, Any]:
        """All of it for JSON; what is not finite is null."""
        return {**plain({"equal": self.equal, **dataclasses.asdict(self)}), "a": str(self.a), "b": str(self.b)}
