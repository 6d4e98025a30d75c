"""Others who read recordings, and what every reader of them must hold."""

from __future__ import annotations

import sqlite3
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from rosbags.rosbag2 import Reader

from finger_sim.bags.reader import BagReader, Message, read_commands
from finger_sim.errors import BagError

from .content import COMMANDS, Put
from .formats import Recording

Seen = tuple[str, str, int, bytes]
"""Topic, type, log time and bytes of a message."""


def by_rosbags(recording: Recording) -> list[Seen]:
    """What `rosbags` reads; each file for itself where it does not take the whole."""
    whole = recording.format.folder and recording.format.metadata
    seen = []
    for path in [recording.path] if whole else recording.files:
        with Reader(path) as reader:
            seen += [(c.topic, c.msgtype, time, bytes(data)) for c, time, data in reader.messages()]
    return seen


def by_mcap(recording: Recording) -> list[Seen]:
    """What `mcap` reads."""
    seen = []
    for path in recording.files:
        with path.open("rb") as stream:
            messages = make_reader(stream, validate_crcs=True).iter_messages()
            seen += [(c.topic, s.name if s else "", m.log_time, m.data) for s, c, m in messages]
    return seen


def by_sqlite(recording: Recording, mode: str = "immutable=1") -> list[Seen]:
    """What Python's sqlite3 reads; with `mode=rw` also of the log beside a database, which it then tidies up."""
    seen: list[Seen] = []
    for path in recording.files:
        database = sqlite3.connect(f"file:{path}?{mode}", uri=True)
        query = "SELECT name, type, timestamp, data FROM messages JOIN topics ON topics.id = topic_id"
        seen += database.execute(query).fetchall()
        database.close()
    return seen


def judges(recording: Recording) -> list[Callable[[Recording], list[Seen]]]:
    """Those who can read the recording when it is whole."""
    format = recording.format
    able: list[Callable[[Recording], list[Seen]]] = []
    rising = recording.content.ordered == list(recording.content.put)
    known = format.definitions and format.message_index and (rising or (format.summary and format.chunked))
    if known and (not format.compressed or (format.folder and format.metadata)):
        able.append(by_rosbags)
    if not format.compressed:
        able.append(by_mcap if format.storage == "mcap" else by_sqlite)
    return able


def seen(messages: Iterable[Message]) -> list[Seen]:
    """Messages of our reader as every reader sees them."""
    return [(m.topic, m.type, m.log_time, bytes(m.data)) for m in messages]


def read(path: Path) -> tuple[BagReader, list[Seen]]:
    """The reader and its messages; whatever it found, it must agree with itself."""
    reader = BagReader(path)
    messages = list(reader)
    assert_agrees(reader, messages)
    return reader, seen(messages)


def assert_agrees(reader: BagReader, messages: Sequence[Message]) -> None:
    """Log times never fall; counts and times are those of the messages."""
    times = [message.log_time for message in messages]
    assert times == sorted(times), "log times fall"
    counts = Counter((message.topic, message.type) for message in messages)
    claimed = {(topic.name, topic.type): topic.count for topic in reader.topics}
    assert {topic: n for topic, n in claimed.items() if n} == dict(counts), "counts are not of the messages"
    assert reader.message_count == len(messages)
    assert (reader.start_time, reader.end_time) == ((times[0], times[-1]) if times else (None, None))
    assert abs(reader.duration - (1e-9 * (times[-1] - times[0]) if times else 0.0)) <= 1e-6
    assert reader.truncated == (reader.warning is not None)


def assert_commands(path: Path, expected: Sequence[Put], refused: int = 0) -> None:
    """The commands of a replay are `expected`, in the order of log time."""
    commands = read_commands(path, COMMANDS, allow_gaps=True)
    assert commands.receipt_ns.tolist() == [m.log_time - expected[0].log_time for m in expected]
    poses = [np.frombuffer(m.data[-56:], "<f8") for m in expected]
    np.testing.assert_array_equal(commands.position, [pose[:3] for pose in poses])
    np.testing.assert_array_equal(commands.orientation, [pose[3:] for pose in poses])
    assert commands.refused == refused


def assert_explained(error: BagError, path: Path, *words: str) -> None:
    """The error names the recording and says what is in the way."""
    text = str(error)
    assert path.name in text
    assert "Invalid CDR" not in text
    assert all(word in text.lower() for word in words), text
