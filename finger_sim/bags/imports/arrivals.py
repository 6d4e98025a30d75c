"""Decoded messages of bags of ROS 2 and of ROS 1 alike."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Iterator
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
    warning: str | None
    """What was wrong with it, if it was cut off."""

    def arrivals(self, topics: Collection[str]) -> Iterator[Arrival]: ...


def open_bag(path: Path) -> Bag:
    """The bag at `path`. Raises BagError when there is none that can be read."""
    return Ros1Bag(path) if path.is_file() and kind_of_file(path) == "ros1" else Ros2Bag(path)


class Ros2Bag:
    """A bag of ROS 2."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._reader = BagReader(path)
        self.warning = self._reader.warning
        self.topics = tuple(Topic(absolute(topic.name), topic.type, topic.count) for topic in self._reader.topics)

    def arrivals(self, topics: Collection[str]) -> Iterator[Arrival]:
        numbers: Counter[str] = Counter()
        for message in self._reader.messages(topics):
            name = absolute(message.topic)
            numbers[name] += 1
            try:
                decoded = cdr.deserialize(message.data, message.type)
            except ValueError as error:
                where = f"{self.path}: topic {name}, message {numbers[name]}"
                raise BagError(f"{where}: is no {message.type}: {error}") from None
            yield Arrival(name, numbers[name], message.log_time, decoded)


class Ros1Bag:
    """A bag of ROS 1, read with `rosbags`; its types are named as those of ROS 2."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.warning: str | None = None
        counts: Counter[tuple[str, str]] = Counter()
        with _reading(path) as reader:
            for connection in reader.connections:
                counts[absolute(connection.topic), connection.msgtype] += connection.msgcount
        self.topics = tuple(Topic(name, type, count) for (name, type), count in counts.items())

    def arrivals(self, topics: Collection[str]) -> Iterator[Arrival]:
        numbers: Counter[str] = Counter()
        with _reading(self.path) as reader:
            wanted = [each for each in reader.connections if absolute(each.topic) in topics]
            store = _types_of(wanted)
            for connection, time, data in reader.messages(connections=wanted) if wanted else ():
                name = absolute(connection.topic)
                numbers[name] += 1
                yield Arrival(name, numbers[name], time, store.deserialize_ros1(data, connection.msgtype))


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
