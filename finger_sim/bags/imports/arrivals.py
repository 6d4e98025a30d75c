"""Decoded messages of bags of ROS 2 and of ROS 1 alike."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from ...errors import BagError
from .. import cdr
from ..message import Topic
from ..packing import kind_of_file
from ..reader import BagReader, absolute

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore


class Arrival(NamedTuple):
    """A message, its number on its topic from 1 on, and when it was received [ns]."""

    topic: str
    number: int
    log_time: int
    message: Any


class Bag(Protocol):
    """A bag of either ROS: its topics, by absolute names, and their messages in the order of receipt."""

    path: Path
    topics: tuple[Topic, ...]

    @property
    def warning(self) -> str | None:
        """What was wrong with it: that it was cut off, and which of the messages asked for cannot be decoded."""
        ...

    def arrivals(self, topics: Collection[Topic]) -> Iterator[Arrival]:
        """The messages on these topics, each by its name and type.

        Raises BagError where none of them can be decoded, though there are some.
        """
        ...


def open_bag(path: Path) -> Bag:
    """The bag at `path`. Raises BagError when there is none that can be read."""
    return Ros1Bag(path) if path.is_file() and kind_of_file(path) == "ros1" else Ros2Bag(path)


class Ros2Bag:
    """A bag of ROS 2."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._reader = BagReader(path)
        self._decoded = _Decoded(path)
        self.topics = tuple(Topic(absolute(topic.name), topic.type, topic.count) for topic in self._reader.topics)

    @property
    def warning(self) -> str | None:
        return "; ".join(filter(None, (self._reader.warning, self._decoded.warning))) or None

    def arrivals(self, topics: Collection[Topic]) -> Iterator[Arrival]:
        wanted = {(topic.name, topic.type) for topic in topics}
        return self._decoded.arrivals(
            (message.topic, message.type, message.log_time, message.data, cdr.deserialize)
            for message in self._reader.messages([topic.name for topic in topics])
            if (absolute(message.topic), message.type) in wanted
        )


class Ros1Bag:
    """A bag of ROS 1, read with `rosbags`; its types are named as those of ROS 2."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._decoded = _Decoded(path)
        counts: Counter[tuple[str, str]] = Counter()
        with _reading(path) as reader:
            for connection in reader.connections:
                counts[absolute(connection.topic), connection.msgtype] += connection.msgcount
        self.topics = tuple(Topic(name, type, count) for (name, type), count in counts.items())

    @property
    def warning(self) -> str | None:
        return self._decoded.warning

    def arrivals(self, topics: Collection[Topic]) -> Iterator[Arrival]:
        chosen = {(topic.name, topic.type) for topic in topics}
        with _reading(self.path) as reader:
            wanted = [each for each in reader.connections if (absolute(each.topic), each.msgtype) in chosen]
            store = _types_of(wanted)
            yield from self._decoded.arrivals(
                (connection.topic, connection.msgtype, time, data, store.deserialize_ros1)
                for connection, time, data in (reader.messages(connections=wanted) if wanted else ())
            )


Undecoded = tuple[str, str, int, bytes, Callable[[bytes, str], Any]]
"""Topic, type, log time [ns] and bytes of a message, and what decodes bytes of a type."""


class _Decoded:
    """Decodes messages; those that cannot be are left out, and counted in `warning`."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self.warning: str | None = None

    def arrivals(self, messages: Iterable[Undecoded]) -> Iterator[Arrival]:
        numbers: Counter[str] = Counter()
        bad, first = 0, ""
        for topic, kind, time, data, decode in messages:
            name = absolute(topic)
            numbers[name] += 1
            try:
                decoded = decode(data, kind)
            except Exception as error:  # whatever the bytes make the library do
                bad += 1
                first = first or f"topic {name}, message {numbers[name]}: is no {kind}: {error}"
                continue
            yield Arrival(name, numbers[name], time, decoded)
        if bad and bad == numbers.total():
            raise BagError(f"{self._path}: {first}")
        count = f"{bad} messages cannot be decoded and are left out" if bad > 1 else "a message is left out"
        self.warning = f"{count}; {first}" if bad else None


def _types_of(connections: Iterable[Any]) -> Typestore:
    """The types of messages as their connections define them."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.EMPTY)
    types = [get_types_from_msg(each.msgdef.data, each.msgtype) for each in connections]
    store.register({name: definition for each in types for name, definition in each.items()})
    return store


class _reading:
    """An open reader in a `with` block; what `rosbags` raises becomes BagError."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def __enter__(self) -> Any:
        from rosbags.rosbag1 import Reader

        try:
            self._reader = Reader(self._path)
            self._reader.open()
        except Exception as error:  # whatever the bytes make the library do
            raise self._broken(error) from None
        return self._reader

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        self._reader.close()
        if isinstance(error, Exception) and not isinstance(error, BagError):
            raise self._broken(error) from None

    def _broken(self, error: Exception) -> BagError:
        converting = f"rosbags-convert --src {self._path.name} --dst FOLDER"
        advice = f"mend it with `rosbag reindex {self._path.name}` of ROS 1, or convert a whole one: {converting}"
        return BagError(f"{self._path}: a ROS 1 bag that cannot be read: {error}; {advice}")
