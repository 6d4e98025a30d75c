"""Where the messages of a bag come from: MCAP files, whole or cut off, and what `rosbags` reads (sqlite3)."""

from __future__ import annotations

import heapq
import os
import struct
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, NamedTuple, Protocol

import yaml
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Header, Schema
from mcap.stream_reader import CRCValidationError, get_chunk_data_stream

from ..errors import BagError

MAGIC = b"\x89MCAP0\r\n"


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

    def messages(self) -> Iterator[Message]: ...


def open_source(path: Path) -> Source:
    """The reader for what lies at `path`."""
    try:
        if path.is_file():
            return _RosbagsSource(path) if path.suffix == ".db3" else _McapSource([path])
        if not path.is_dir():
            raise BagError(f"{path}: no such bag; give a rosbag2 folder or an .mcap file")
        metadata = path / "metadata.yaml"
        if metadata.is_file():
            return _open_folder(path, _information(metadata))
        files = sorted(path.glob("*.mcap"), key=_part_number)
        if files:
            return _McapSource(files)
        databases = sorted(path.glob("*.db3"))
        if len(databases) == 1:
            return _RosbagsSource(databases[0])
    except OSError as error:
        raise BagError(f"{error.filename or path}: cannot be read: {error.strerror}") from None
    raise BagError(f"{path}: not a bag: holds neither metadata.yaml nor an .mcap file")


def _open_folder(path: Path, information: dict[str, Any]) -> Source:
    compressed = information.get("compression_mode") not in ("", "NONE", "none", None)
    if information.get("storage_identifier") != "mcap" or compressed:
        return _RosbagsSource(path)
    names = information.get("relative_file_paths")
    if not isinstance(names, list) or not names or not all(isinstance(name, str) for name in names):
        key = f"{path / 'metadata.yaml'}: relative_file_paths"
        raise BagError(f"{key}: got {names!r}, allowed: a list of file names")
    files = [path / Path(name).name for name in names]
    for file in files:
        if not file.is_file():
            raise BagError(f"{path}: {file.name} is named in metadata.yaml but is not there")
    return _McapSource(files)


def _information(metadata: Path) -> dict[str, Any]:
    """The bag information in a metadata.yaml."""
    advice = "give the .mcap file itself to read the bag without it"
    try:
        content = yaml.safe_load(metadata.read_text(encoding="utf-8"))
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        reason = str(error).splitlines()[0]
        raise BagError(f"{metadata}: not YAML: {reason}; {advice}") from None
    information = content.get("rosbag2_bagfile_information") if isinstance(content, dict) else None
    if not isinstance(information, dict):
        raise BagError(f"{metadata}: has no rosbag2_bagfile_information; {advice}")
    return information


def _part_number(path: Path) -> tuple[int, str]:
    """Sorts bag_2.mcap before bag_10.mcap."""
    number = path.stem.rpartition("_")[2]
    return (int(number) if number.isdigit() else 0, path.name)


_RECORD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")


_BROKEN = (McapError, struct.error, UnicodeDecodeError, OverflowError, MemoryError, RuntimeError)
"""What the mcap library raises on bytes that are not what they claim to be."""


class _NoHeaderError(BagError):
    """A file that was cut off before anything was in it: of several files, the others can be read."""


class _Damaged(Exception):
    """Bytes that are not whole MCAP records."""


@dataclass
class _Segment:
    """A run of messages in a file: one chunk, or message records that lie outside of chunks."""

    file: int
    offset: int
    size: int
    chunked: bool
    start: int = 2**64
    end: int = 0


@dataclass
class _File:
    """What the records of one MCAP file announce."""

    path: Path
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)

    def type_of(self, channel: Channel) -> str:
        schema = self.schemas.get(channel.schema_id)
        return schema.name if schema is not None else ""


class _McapSource:
    """MCAP files read front to back: works the same with and without an index at their end."""

    def __init__(self, paths: Iterable[Path]) -> None:
        self.files = [_File(path) for path in paths]
        self.segments: list[_Segment] = []
        self.start: int | None = None
        self.end: int | None = None
        warnings: list[str] = []
        counts: Counter[tuple[str, str]] = Counter()
        lost: Counter[tuple[str, str]] = Counter()
        names: dict[tuple[str, str], None] = {}
        last: dict[str, int] = {}
        for index, file in enumerate(self.files):
            try:
                damage, numbers = self._scan(index, last)
            except _NoHeaderError as error:
                if len(self.files) == 1:
                    raise
                damage, numbers = str(error), {}
            if damage:
                warnings.append(damage)
            used = [channel for channel in file.channels.values() if channel.message_encoding == "cdr"]
            if file.channels and not used:
                found = sorted({channel.message_encoding for channel in file.channels.values()})
                raise BagError(f"{file.path}: holds no ROS 2 messages (cdr), but {', '.join(found)}")
            for channel in used:
                key = (channel.topic, file.type_of(channel))
                names[key] = None
                count, missing = numbers.get(channel.id, (0, 0))
                counts[key] += count
                lost[key] += missing
        self.topics = tuple(Topic(name, type, counts[name, type], lost[name, type]) for name, type in names)
        self.warning = "; ".join(warnings) or None
        self.segments.sort(key=lambda segment: segment.start)

    def _scan(self, index: int, last: dict[str, int]) -> tuple[str | None, dict[int, tuple[int, int]]]:
        """Finds the segments of a file; returns what is wrong with its end, and per channel (count, lost).

        last : number of the last message of each topic, over all files
        """
        file = self.files[index]
        size = file.path.stat().st_size
        if size == 0:
            raise _NoHeaderError(f"{file.path}: is empty")
        numbers: dict[int, tuple[int, int]] = {}
        with file.path.open("rb") as stream:
            offset = _read_header(stream, file.path)
            while True:
                try:
                    opcode, length = _read_record_head(stream, size - offset)
                    if opcode == Opcode.DATA_END:
                        break
                    if opcode == Opcode.CHUNK:
                        segment = _Segment(index, offset, 9 + length, chunked=True)
                    elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE):
                        segment = _Segment(index, offset, 9 + length, chunked=False)
                    else:
                        offset = stream.seek(offset + 9 + length)
                        continue
                    for channel, sequence, log_time, _, _ in self._read(stream, segment):
                        count, missing = numbers.get(channel, (0, 0))
                        topic = file.channels[channel].topic
                        gap = sequence - last.get(topic, sequence - 1) - 1
                        numbers[channel] = (count + 1, missing + max(gap, 0))
                        last[topic] = sequence
                        segment.start = min(segment.start, log_time)
                        segment.end = max(segment.end, log_time)
                except _Damaged as damage:
                    return f"{file.path}: cut off at byte {offset} of {size} ({damage})", numbers
                if segment.start <= segment.end:
                    self.segments.append(segment)
                    self.start = segment.start if self.start is None else min(self.start, segment.start)
                    self.end = segment.end if self.end is None else max(self.end, segment.end)
                offset = stream.seek(offset + segment.size)
            stream.seek(size - len(MAGIC))
            if stream.read() != MAGIC:
                return f"{file.path}: cut off in its index; all messages are there", numbers
        return None, numbers

    def _read(self, stream: BinaryIO, segment: _Segment) -> list[tuple[int, int, int, int, bytes]]:
        """(channel, sequence, log time, publish time, data) in a segment; learns its channels."""
        file = self.files[segment.file]
        stream.seek(segment.offset)
        data = stream.read(segment.size)
        if segment.chunked:
            data = _decompress(data[_RECORD.size :])
        messages = []
        offset = 0
        try:
            while offset < len(data):
                opcode, length = _RECORD.unpack_from(data, offset)
                start, offset = offset + _RECORD.size, offset + _RECORD.size + length
                if offset > len(data):
                    raise _Damaged("a record longer than its chunk")
                if opcode == Opcode.MESSAGE:
                    head = _MESSAGE.unpack_from(data, start)
                    messages.append((*head, data[start + _MESSAGE.size : offset]))
                elif opcode == Opcode.SCHEMA:
                    schema = Schema.read(ReadDataStream(BytesIO(data[start:offset])))
                    file.schemas[schema.id] = schema
                elif opcode == Opcode.CHANNEL:
                    channel = Channel.read(ReadDataStream(BytesIO(data[start:offset])))
                    file.channels[channel.id] = channel
        except _BROKEN:
            raise _Damaged("a broken record") from None
        if any(message[0] not in file.channels for message in messages):
            raise _Damaged("a message of an unknown channel")
        return messages

    def messages(self) -> Iterator[Message]:
        pending: list[tuple[int, int, int, int, Message]] = []
        streams = [file.path.open("rb") for file in self.files]
        try:
            for segment in self.segments:
                while pending and pending[0][0] < segment.start:
                    yield heapq.heappop(pending)[-1]
                file = self.files[segment.file]
                for i, (number, sequence, logged, published, data) in enumerate(
                    self._read(streams[segment.file], segment)
                ):
                    channel = file.channels[number]
                    if channel.message_encoding == "cdr":
                        message = Message(channel.topic, file.type_of(channel), logged, published, data, sequence)
                        heapq.heappush(pending, (logged, segment.file, segment.offset, i, message))
            while pending:
                yield heapq.heappop(pending)[-1]
        except (OSError, _Damaged) as error:
            raise BagError(f"{self.files[0].path.parent}: changed while it was read: {error}") from None
        finally:
            for stream in streams:
                stream.close()


def _read_header(stream: BinaryIO, path: Path) -> int:
    """Checks magic and profile of an MCAP file; returns the offset after its header."""
    magic = stream.read(len(MAGIC))
    if magic != MAGIC:
        if MAGIC.startswith(magic):
            raise _NoHeaderError(f"{path}: cut off before its header, nothing can be read")
        raise BagError(f"{path}: not an MCAP file: starts with {magic!r}, must start with {MAGIC!r}")
    try:
        opcode, length = _read_record_head(stream, os.fstat(stream.fileno()).st_size - len(MAGIC))
        if opcode != Opcode.HEADER:
            raise BagError(f"{path}: not an MCAP file: its first record is no header")
        header = Header.read(ReadDataStream(BytesIO(stream.read(length))))
    except (_Damaged, *_BROKEN):
        raise _NoHeaderError(f"{path}: cut off before its header, nothing can be read") from None
    if header.profile not in ("ros2", ""):
        raise BagError(f"{path}: holds messages of profile {header.profile!r}, allowed: 'ros2'")
    return len(MAGIC) + _RECORD.size + length


def _read_record_head(stream: BinaryIO, left: int) -> tuple[int, int]:
    """Opcode and length of the record at the stream's place, of which `left` bytes are in the file."""
    head = stream.read(_RECORD.size)
    if len(head) < _RECORD.size:
        raise _Damaged("no end of data" if not head else "a partial record")
    opcode, length = _RECORD.unpack(head)
    if opcode == 0:
        raise _Damaged("zeros")
    if length > left - _RECORD.size:
        raise _Damaged("a partial chunk" if opcode == Opcode.CHUNK else "a partial record")
    return opcode, length


def _decompress(body: bytes) -> bytes:
    """Records inside a chunk record."""
    import zstandard

    try:
        chunk = Chunk.read(ReadDataStream(BytesIO(body)))
        stream, length = get_chunk_data_stream(chunk, validate_crc=True)
        return stream.read(length)
    except CRCValidationError:
        raise _Damaged("a chunk with a wrong checksum") from None
    except (zstandard.ZstdError, *_BROKEN) as error:
        raise _Damaged(f"a broken chunk: {error}") from None


class _RosbagsSource:
    """Bags that are not plain MCAP (sqlite3, compressed files), read with the `rosbags` library."""

    def __init__(self, path: Path) -> None:
        from rosbags.rosbag2 import Reader

        self.path = path
        self.warning: str | None = None
        counts: Counter[tuple[str, str]] = Counter()
        with self._reporting(), Reader(path) as reader:
            for connection in reader.connections:
                counts[connection.topic, connection.msgtype] += connection.msgcount
            some = reader.message_count > 0
            self.start = reader.start_time if some else None
            self.end = reader.end_time - 1 if some else None
        self.topics = tuple(Topic(name, type, count) for (name, type), count in counts.items())

    def messages(self) -> Iterator[Message]:
        from rosbags.rosbag2 import Reader

        numbers: defaultdict[str, int] = defaultdict(int)
        with self._reporting(), Reader(self.path) as reader:
            for connection, time, data in reader.messages():
                numbers[connection.topic] += 1
                number = numbers[connection.topic]
                yield Message(connection.topic, connection.msgtype, time, time, bytes(data), number)

    def _reporting(self) -> _Reporting:
        return _Reporting(self.path)


class _Reporting:
    """Turns the errors of `rosbags` and sqlite3 into BagError."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __enter__(self) -> None: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        import sqlite3

        from rosbags.rosbag2 import ReaderError

        if isinstance(error, ReaderError | sqlite3.Error | OSError | KeyError | TypeError | ValueError):
            raise BagError(f"{self.path}: cannot be read: {error}") from None
