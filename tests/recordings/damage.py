"""What happens to recordings: recorders that are killed, disks that are full, bytes that change."""

from __future__ import annotations

import shutil
import sqlite3
import struct
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.records import Chunk, Message
from mcap.stream_reader import breakup_chunk

from .content import Content
from .formats import Format, Recording, add_topics

MAGIC = b"\x89MCAP0\r\n"
MESSAGE, CHUNK, DATA_END = 5, 6, 15
"""Opcodes of MCAP records."""
_HEAD = struct.Struct("<BQ")
_CHUNK = struct.Struct("<QQQII")


class Record(NamedTuple):
    """A record of an MCAP file: where it begins and ends."""

    opcode: int
    begin: int
    end: int


class ChunkRecord(NamedTuple):
    """A chunk: where its record and its bytes begin, where both end, the log times of its messages, its checksum."""

    begin: int
    inside: int
    end: int
    first: int
    last: int
    checksum: int


def records(data: bytes) -> Iterator[Record]:
    """The whole records of an MCAP file."""
    begin = len(MAGIC)
    while begin + _HEAD.size <= len(data):
        opcode, length = _HEAD.unpack_from(data, begin)
        end = begin + _HEAD.size + length
        if end > len(data):
            return
        yield Record(opcode, begin, end)
        begin = end


def chunks(data: bytes) -> list[ChunkRecord]:
    """The whole chunks of an MCAP file."""
    found = []
    for record in records(data):
        place = record.begin + _HEAD.size
        if record.opcode == CHUNK and record.end - place >= _CHUNK.size:
            first, last, _, checksum, name = _CHUNK.unpack_from(data, place)
            inside = place + _CHUNK.size + name + 8
            found.append(ChunkRecord(record.begin, inside, record.end, first, last, checksum))
    return found


def log_times(data: bytes, begin: int, end: int) -> list[int]:
    """Log times of the messages in the whole records between two bytes of an MCAP file, also of those in chunks."""
    times: list[int] = []
    for record in records(data):
        body = data[record.begin + _HEAD.size : record.end]
        if record.begin < begin or record.end > end:
            continue
        if record.opcode == MESSAGE:
            times.append(Message.read(ReadDataStream(BytesIO(body)), len(body)).log_time)
        elif record.opcode == CHUNK:
            inside = breakup_chunk(Chunk.read(ReadDataStream(BytesIO(body))))
            times += [each.log_time for each in inside if isinstance(each, Message)]
    return times


def flip(path: Path, offset: int) -> None:
    """Changes a few bytes: of one alone, a compressed chunk may not depend."""
    data = bytearray(path.read_bytes())
    data[offset : offset + 4] = bytes(byte ^ 0xFF for byte in data[offset : offset + 4])
    path.write_bytes(data)


def killed(folder: Path, format: Format, content: Content, checkpointed: int | None) -> Recording:
    """What a recorder that was killed leaves of sqlite3: a log whose first `checkpointed` messages are in the database.

    checkpointed : None where not even the tables are in the database
    """
    place = folder / "recording" if format.folder else folder
    scratch, path = folder / "scratch" / "recording_0.db3", place / "recording_0.db3"
    scratch.parent.mkdir(parents=True)
    place.mkdir(exist_ok=True)
    database = sqlite3.connect(scratch)
    database.execute("PRAGMA journal_mode=WAL")
    database.execute("PRAGMA wal_autocheckpoint=0")
    ids = add_topics(database, format, content)
    database.commit()
    for number, m in enumerate(content.put, start=1):
        row = (ids[m.topic, m.type], m.log_time, m.data)
        database.execute("INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)", row)
        database.commit()
        if number == checkpointed:
            database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    for suffix in ("", "-wal", "-shm"):
        shutil.copyfile(f"{scratch}{suffix}", f"{path}{suffix}")
    database.close()
    return Recording(place if format.folder else path, (path,), content, format)


def killed_while_rolling(folder: Path, format: Format, content: Content, committed: int) -> Recording:
    """What a recorder that was killed in a transaction leaves of sqlite3: a journal that takes it back."""
    path, scratch = folder / "recording_0.db3", folder / "scratch" / "recording_0.db3"
    scratch.parent.mkdir(parents=True)
    database = sqlite3.connect(scratch)
    database.execute("PRAGMA page_size=512")
    database.execute("PRAGMA cache_size=2")  # of pages, so few that the transaction spills over into the file
    ids = add_topics(database, format, content)
    query = "INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)"
    rows = [(ids[m.topic, m.type], m.log_time, m.data) for m in content.put]
    database.executemany(query, rows[:committed])
    database.commit()
    database.executemany(query, rows[committed:])
    for suffix in ("", "-journal"):
        shutil.copyfile(f"{scratch}{suffix}", f"{path}{suffix}")
    database.rollback()
    database.close()
    return Recording(path, (path,), Content(content.put[:committed], content.topics), format)


def state(folder: Path) -> dict[str, tuple[int, bytes]]:
    """What is in a folder: names, times of change and bytes."""
    files = [path for path in folder.rglob("*") if path.is_file()]
    return {str(path.relative_to(folder)): (path.stat().st_mtime_ns, path.read_bytes()) for path in files}
