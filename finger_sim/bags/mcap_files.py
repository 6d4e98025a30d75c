"""MCAP files, whole or cut off: their messages in the order of time, and an end for those that have none."""

from __future__ import annotations

import heapq
import os
import struct
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, DataEnd, Footer, Header, Metadata, Schema
from mcap.stream_reader import CRCValidationError, get_chunk_data_stream

from ..errors import BagError
from .message import Message, Topic
from .metadata import ORIGIN

MAGIC = b"\x89MCAP0\r\n"
LONGEST_RUN = 1 << 20
"""Size from which on a run of messages outside of chunks takes no more of them [byte]."""
ROOM_FOR_END = 1 << 16
"""What finish_cut_off frees on a full disk [byte]: an end of the file and a metadata.yaml are a third of that."""

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


class McapSource:
    """MCAP files read front to back: works the same with and without an index at their end."""

    def __init__(self, paths: Iterable[Path], cut: str | None = None, origin: Mapping[str, str] | None = None) -> None:
        self.cut = cut
        self.origin = dict(origin or {})
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
                        if opcode == Opcode.METADATA:
                            self._learn_origin(index, stream, length)
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
                    self._add(segment)
                    self.start = segment.start if self.start is None else min(self.start, segment.start)
                    self.end = segment.end if self.end is None else max(self.end, segment.end)
                offset = stream.seek(offset + segment.size)
            stream.seek(size - len(MAGIC))
            if stream.read() != MAGIC:
                return f"{file.path}: cut off in its index; all messages are there", numbers
        return None, numbers

    def _learn_origin(self, index: int, stream: BinaryIO, length: int) -> None:
        """Words on the bag's making, if the metadata record at the stream's place has some; of each the first counts.

        Which part of a bag a file is matters only where those before it are not read too.
        """
        try:
            record = Metadata.read(ReadDataStream(BytesIO(stream.read(length))))
        except _BROKEN:
            raise _Damaged("a broken record") from None
        if record.name == ORIGIN:
            part = record.metadata.pop("part", None)
            self.origin = record.metadata | self.origin
            if part is not None and index == 0:
                self.origin["part"] = part

    def _add(self, segment: _Segment) -> None:
        """One more segment, the next in its file; messages outside of chunks join the run before them."""
        before = self.segments[-1] if self.segments else segment
        joins = not segment.chunked and not before.chunked and before.file == segment.file
        if joins and before.offset + before.size == segment.offset and before.size < LONGEST_RUN:
            before.size += segment.size
            before.start, before.end = min(before.start, segment.start), max(before.end, segment.end)
        else:
            self.segments.append(segment)

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


def finish_cut_off(path: Path) -> tuple[Counter[str], int, int]:
    """Ends a file that was cut off: with its last whole record that leaves ROOM_FOR_END of what it takes on the disk.

    The end has no index. Returns the messages that are left on each topic, and the first and last of their log times
    [ns]. Raises OSError when the disk takes no end either, BagError when the file has no whole header.
    """
    size = path.stat().st_size
    with path.open("r+b") as stream:
        whole = _read_header(stream, path)
        try:
            while True:
                opcode, length = _read_record_head(stream, size - ROOM_FOR_END - whole)
                if opcode == Opcode.DATA_END:
                    break
                whole = stream.seek(whole + _RECORD.size + length)
        except _Damaged:
            pass
        builder: Any = RecordBuilder()  # its methods carry no types
        DataEnd(data_section_crc=0).write(builder)
        Footer(summary_start=0, summary_offset_start=0, summary_crc=0).write(builder)
        stream.truncate(whole)
        stream.seek(whole)
        stream.write(builder.end() + MAGIC)
    left = McapSource([path])
    return Counter({topic.name: topic.count for topic in left.topics}), left.start or 2**64, left.end or 0
