"""sqlite3 files of rosbag2, of every version: their messages in the order of time, and what of them cannot be read.

Only the tables `topics` and `messages` are read: definitions of types, whatever they hold, are no obstacle. A file is
never changed: where its recorder left a write-ahead log or a journal, a copy of both is read.
"""

from __future__ import annotations

import heapq
import shutil
import sqlite3
from array import array
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..errors import BagError
from .message import Message, Numbers, Source, Topic, plain_message, topics_of
from .packing import PackingError, Scratch, Stored

BROKEN = (sqlite3.Error, UnicodeDecodeError)
"""What sqlite3 raises on a damaged file; the second where damaged bytes stand in its words on that."""
LOGS = ("-wal", "-journal")
"""Endings of the files beside a database that hold what is not in it yet, or what was before."""
_COPIES = 5
"""Times that a database is copied which changes meanwhile: then its recorder still writes."""
_LOG_HEAD, _FRAME_HEAD = 32, 24
"""Sizes in a write-ahead log [byte]."""
_LONGEST = 1_000_000_000
"""Size of a value that sqlite3 allows [byte]."""


class _Row(NamedTuple):
    """A row of the table `messages`; a damaged file may hold anything."""

    id: int
    topic: Any
    time: Any
    data: Any


@dataclass
class _Database:
    """One file, and what was found in it."""

    stored: Stored
    topics: dict[int, Topic] = field(default_factory=dict)
    damage: list[str] = field(default_factory=list)
    foreign: set[int] = field(default_factory=set)
    """Numbers of topics that are not of ROS 2."""
    ids: array[int] = field(init=False)
    times: array[int] = field(init=False)
    keys: array[int] = field(init=False)
    """Rows of messages, their log times [ns] and the numbers of their topics, as they are in the file."""

    def index(self) -> None:
        """Finds the rows that are messages."""
        self.ids, self.times, self.keys = array("q"), array("q"), array("q")
        broken: list[str] = []
        with closing(self.open()) as connection:
            for row in _rows(connection, self.damage):
                if row.topic in self.foreign:
                    continue
                if why := self._fault(row):
                    broken.append(f"row {row.id}: {why}")
                    continue
                self.ids.append(row.id)
                self.times.append(row.time)
                self.keys.append(row.topic)
        if broken:
            count = f"{len(broken)} message{'s' * (len(broken) > 1)}"
            self.damage.append(f"{count} cannot be read: {broken[0]}")

    def _fault(self, row: _Row) -> str | None:
        """Why a row is no message; None where it is one."""
        if not isinstance(row.time, int) or row.time < 0:
            return f"timestamp {row.time!r}"
        if not isinstance(row.data, bytes):
            return f"data of type {type(row.data).__name__}"
        if row.topic not in self.topics:
            return f"topic_id {row.topic!r} without a topic"
        try:
            plain_message(row.data)
        except PackingError as error:
            return str(error)
        return None

    def salvage(self, scratch: Scratch) -> None:
        """Has a copy of what can be read take the place of a damaged file: reading that twice may give two things."""
        copy = scratch.place(self.stored.path.name)
        self.damage.clear()
        with closing(self.open()) as damaged, closing(sqlite3.connect(copy)) as sound:
            sound.execute("CREATE TABLE topics(id INTEGER PRIMARY KEY, name, type, serialization_format)")
            sound.execute("CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id, timestamp, data)")
            sound.executemany("INSERT INTO topics VALUES(?, ?, ?, ?)", _topics(damaged))
            sound.executemany("INSERT INTO messages VALUES(?, ?, ?, ?)", _rows(damaged, self.damage))
            sound.commit()
        self.stored = self.stored._replace(path=copy)

    def open(self) -> sqlite3.Connection:
        """Opened so that nothing is written, and that a file that was cut off is read as far as it goes."""
        url = f"{self.stored.path.absolute().as_uri()}?mode=ro&immutable=1"
        connection = sqlite3.connect(url, uri=True)
        connection.text_factory = lambda text: text.decode(errors="replace")
        connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, min(_LONGEST, self.stored.path.stat().st_size))
        for setting in ("writable_schema = ON", "trusted_schema = OFF", "cell_size_check = ON"):
            connection.execute(f"PRAGMA {setting}")
        return connection


class SqliteSource(Source):
    """sqlite3 files, read by the numbers of their rows. Raises BagError where nothing of ROS 2 can be read."""

    def __init__(self, files: Sequence[Stored], scratch: Scratch) -> None:
        super().__init__()
        self._scratch = scratch
        self.files = [_Database(_settled(file, scratch)) for file in files]
        numbers: dict[tuple[str, str, int], Numbers] = {}
        for file in self.files:
            cut = _cut_off(file.stored.path)
            if cut:
                file.stored = _whole_pages(file.stored, scratch)
            try:
                self._scan(file, numbers)
            except (*BROKEN, BagError) as error:
                file.damage.append(str(error) if isinstance(error, BagError) else f"cannot be read by sqlite3: {error}")
                if len(self.files) == 1:
                    raise BagError(f"{file.stored.name}: {'; '.join([*cut, *file.damage])}") from None
            file.damage[:0] = cut
        self.topics = topics_of(numbers)
        self.warnings = [file.stored.damage for file in self.files if file.stored.damage]
        self.warnings += [f"{file.stored.name}: {text}" for file in self.files for text in file.damage]

    def _scan(self, file: _Database, numbers: dict[tuple[str, str, int], Numbers]) -> None:
        """Finds the messages of a file that can be read, and counts them by topic and type."""
        with closing(file.open()) as connection:
            topics = _topics(connection)
        formats = {format for *_, format in topics}
        if formats and "cdr" not in formats:
            raise BagError(f"holds no ROS 2 messages (cdr), but {', '.join(sorted(formats))}")
        self.foreign |= {(name, type): format for _, name, type, format in topics if format != "cdr"}
        file.foreign = {number for number, *_, format in topics if format != "cdr"}
        file.topics = {number: Topic(name, type, 0) for number, name, type, format in topics if format == "cdr"}
        file.index()
        if file.damage:
            file.salvage(self._scratch)
            file.index()
        counts = Counter(file.keys)
        for key, topic in file.topics.items():
            channel = numbers.setdefault((topic.name, topic.type, 0), Numbers(lost=None))
            channel.count += counts[key]
        if file.times:
            self.spans(min(file.times), max(file.times))

    def messages(self) -> Iterator[Message]:
        """As of any source; the file numbers no messages, so each has its place on its topic."""
        places: Counter[str] = Counter()
        try:
            for message in heapq.merge(*map(self._of_file, self.files), key=lambda message: message.log_time):
                places[message.topic] += 1
                yield message._replace(sequence=places[message.topic])
        except (OSError, *BROKEN, PackingError, ValueError) as error:
            raise BagError(f"{self.files[0].stored.name.parent}: changed while it was read: {error}") from None

    def _of_file(self, file: _Database) -> Iterator[Message]:
        """Messages of one file in the order of time."""
        if not file.topics:
            return
        with closing(file.open()) as connection:
            ids, times = np.array(file.ids), np.array(file.times)
            for i in np.argsort(times, kind="stable").tolist():
                ((data,),) = connection.execute("SELECT data FROM messages WHERE id = ?", (int(ids[i]),))
                topic, time = file.topics[file.keys[i]], int(times[i])
                yield Message(topic.name, topic.type, time, time, plain_message(data), 0)


def _cut_off(path: Path) -> list[str]:
    """Says so where a file has fewer pages than its head tells."""
    with path.open("rb") as stream:
        head = stream.read(32)
    there, whole = path.stat().st_size, _page_size(head) * int.from_bytes(head[28:32], "big")
    return [f"cut off at byte {there} of {whole}"] if there < whole else []


def _whole_pages(file: Stored, scratch: Scratch) -> Stored:
    """A copy without the part of a page at its end: sqlite3 would read zeros behind it."""
    copy = scratch.place(file.path.name)
    shutil.copyfile(file.path, copy)
    with copy.open("r+b") as stream:
        page, size = _page_size(stream.read(18)), copy.stat().st_size
        stream.truncate(size - size % page)
    return file._replace(path=copy)


def _page_size(head: bytes) -> int:
    """Bytes of a page, by the first bytes of a file; 1 stands for the largest."""
    size = int.from_bytes(head[16:18], "big")
    return 1 << 16 if size == 1 else size


def _topics(connection: sqlite3.Connection) -> list[tuple[int, str, str, str]]:
    """Number, name, type and serialization format of each topic."""
    tables = {row[0] for row in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
    for table in ("topics", "messages"):
        if table not in tables:
            raise BagError(f"a sqlite3 file, but no bag: it has no table {table}")
    rows = connection.execute("SELECT id, name, type, serialization_format FROM topics ORDER BY id")
    return [row for row in rows if isinstance(row[0], int) and all(isinstance(text, str) for text in row[1:])]


def _rows(connection: sqlite3.Connection, damage: list[str]) -> Iterator[_Row]:
    """The messages of a file by rising number; a place that cannot be read is told in `damage`, and skipped."""
    last, step = -1, 0
    reason = ""
    while True:
        try:
            query = "SELECT id, topic_id, timestamp, data FROM messages WHERE id > ? ORDER BY id"
            for row in connection.execute(query, (last + step,)):
                if row[0] <= last + step:
                    raise sqlite3.DatabaseError("rows are not in their order")
                if step:
                    damage.append(f"messages between rows {last} and {row[0]} cannot be read: {reason}")
                last, step = row[0], 0
                yield _Row(*row)
        except (*BROKEN, MemoryError, OverflowError) as error:
            reason = str(error) or type(error).__name__
            step = 2 * step or 1
            if last + step < 2**62:
                continue
        if step:
            damage.append(f"messages behind row {last} cannot be read: {reason}")
        return


def _settled(file: Stored, scratch: Scratch) -> Stored:
    """A file with all that its recorder committed: where some is in a log beside it, a copy. Raises BagError."""
    logs = [Path(f"{file.path}{ending}") for ending in LOGS]
    try:
        logs = [log for log in logs if log.is_file() and log.stat().st_size]
        return _merged(file, logs, scratch) if logs else file
    except (OSError, *BROKEN) as error:
        reason = getattr(error, "strerror", None) or error
        raise BagError(f"{file.name}: its log {logs[0].name} cannot be merged (see TMPDIR): {reason}") from None


def _merged(file: Stored, logs: Sequence[Path], scratch: Scratch) -> Stored:
    """A copy of a database into which its logs are merged."""
    for _ in range(_COPIES):
        copy = scratch.place(file.path.name)
        before = _states((file.path, *logs))
        shutil.copyfile(file.path, copy)
        for log in logs:
            shutil.copyfile(log, copy.with_name(log.name))
        if _states((file.path, *logs)) == before:
            break
    else:
        raise BagError(f"{file.name}: its recorder still writes it; read it when that has ended")
    wal = copy.with_name(f"{copy.name}{LOGS[0]}")
    frames = _frames(wal.read_bytes()) if wal.exists() else 0
    with closing(sqlite3.connect(copy)) as connection:
        connection.execute("SELECT count(*) FROM sqlite_master").fetchone()  # a journal is undone by the first reader
        _, merged, _ = connection.execute("PRAGMA wal_checkpoint(PASSIVE)").fetchone()
        connection.execute("PRAGMA journal_mode = DELETE").fetchone()
    missing = frames - max(merged, 0)
    damage = f"{file.name}: {missing} pages of its write-ahead log are damaged, or were not committed"
    return file._replace(path=copy, damage=damage if missing > 0 else file.damage)


def _states(paths: Sequence[Path]) -> list[tuple[int, int]]:
    return [(path.stat().st_mtime_ns, path.stat().st_size) for path in paths]


def _frames(log: bytes) -> int:
    """Pages in a write-ahead log since it was last begun anew."""
    page, salts = int.from_bytes(log[8:12], "big"), log[16:24]
    size = _FRAME_HEAD + page
    places = range(_LOG_HEAD, len(log) - size + 1, size)
    return sum(log[place + 8 : place + 16] == salts for place in places)
