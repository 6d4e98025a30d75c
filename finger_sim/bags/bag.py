"""`BagReader`: a bag of ROS 2 that is read, whatever state it is in."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path

from .message import Message
from .sources import Opened
from .writer import absolute


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
