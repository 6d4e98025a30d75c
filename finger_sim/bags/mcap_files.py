"""MCAP files, whole, cut off or damaged: their messages in the order of time, and what is missing."""

from __future__ import annotations

import heapq
import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from io import BytesIO
from typing import BinaryIO

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Metadata, Schema

from ..errors import BagError
from .mcap_records import (
    BROKEN,
    MESSAGE,
    RECORD,
    Damaged,
    NoHeaderError,
    Summary,
    chunk_records,
    chunk_times,
    data_is_whole,
    has_checksums,
    read_head,
    read_header,
    read_summary,
)
from .message import Message, Numbers, Source, plain_message, topics_of
from .metadata import ORIGIN
from .packing import MCAP_MAGIC, PackingError, Scratch, Stored

LONGEST_RUN = 1 << 20
"""Size from which on a run of messages outside of chunks takes no more of them [byte]."""
NAMED_GAPS = 3
"""Damaged places that a warning names; more are counted."""
_INDEX_HEAD, _INDEX_ENTRY = 6, 16
"""Sizes in a record that lists the messages of a chunk [byte]."""


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
class _Gap:
    """A damaged place that reading goes on after."""

    offset: int
    end: int
    reason: str
    times: tuple[int, int] | None = None
    """Log times [ns] of the messages that are missing, where they are known."""
    count: int = 0
    """Messages that are missing; 0 where it is not known."""
    empty: bool = False
    """Whether it is known that no message is missing."""

    def words(self, zero: int) -> str:
        """The place, and what is missing from there; `zero` is the log time from which seconds count."""
        if self.empty:
            return f"{self.reason} at bytes {self.offset} to {self.end}: no message is missing"
        what = f"{self.count} messages" if self.count else "messages"
        when = " of unknown times"
        if self.times is not None:
            when = " from {:.3f} s to {:.3f} s".format(*(1e-9 * (time - zero) for time in self.times))
        return f"{self.reason} at bytes {self.offset} to {self.end}: {what}{when} are missing"


@dataclass
class _File:
    """What the records of one MCAP file announce, and what is wrong with it."""

    stored: Stored
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    gaps: list[_Gap] = field(default_factory=list)
    unpackable: list[str] = field(default_factory=list)
    """Why messages could not be unpacked."""
    damage: str = ""
    """What is wrong with its end."""
    summed: bool = False
    """Whether its chunks have checksums."""

    @cached_property
    def summary(self) -> Summary:
        """What stands at its end."""
        with self.stored.path.open("rb") as stream:
            return read_summary(stream)

    def type_of(self, channel: Channel) -> str:
        schema = self.schemas.get(channel.schema_id)
        return schema.name if schema is not None else ""

    def channel(self, number: int) -> Channel:
        """The channel of that number. Where its record was lost with a chunk, the end of the file tells it too."""
        if number not in self.channels:
            self.channels = self.summary.channels | self.channels
            self.schemas = self.summary.schemas | self.schemas
        if number not in self.channels:
            raise Damaged("a message of an unknown channel")
        return self.channels[number]

    def topic(self, number: int) -> tuple[str, str] | None:
        """Name and type of the channel of that number; None where it is not of ROS 2."""
        channel = self.channel(number)
        return (channel.topic, self.type_of(channel)) if channel.message_encoding == "cdr" else None

    def skip(self, offset: int, reason: str, size: int) -> int | None:
        """Notes a damaged place; where the next chunk that the index names begins, None where there is none."""
        chunks = [chunk for chunk in self.summary.chunks if chunk.offset >= offset]
        later = next((chunk.offset for chunk in chunks if chunk.offset > offset), None)
        lost = [chunk for chunk in chunks if later is None or chunk.offset < later]
        times = (min(chunk.start for chunk in lost), max(chunk.end for chunk in lost)) if lost else None
        self.gaps.append(_Gap(offset, later or size, reason, times, empty=not lost))
        return later

    def warnings(self, zero: int) -> Iterator[str]:
        """What is wrong with it; seconds count from the log time `zero` [ns]."""
        said = [self.stored.damage.partition(": ")[2]] if self.stored.damage else []
        said += [gap.words(zero) for gap in self.gaps[:NAMED_GAPS]]
        if more := self.gaps[NAMED_GAPS:]:
            said.append(f"{len(more)} more damaged places")
        if self.unpackable:
            count = f"{len(self.unpackable)} message{'s' * (len(self.unpackable) > 1)}"
            said.append(f"{count} cannot be unpacked: {self.unpackable[0]}")
        if self.damage:
            said.append(self.damage)
        return (f"{self.stored.name}: {text}" for text in said)


class McapSource(Source):
    """MCAP files read front to back: works the same with and without an index at their end.

    Raises BagError where nothing of ROS 2 can be read.
    """

    def __init__(self, files: Sequence[Stored], scratch: Scratch | None = None) -> None:
        super().__init__()
        self._scratch = scratch
        self.files = [_File(stored) for stored in files]
        self.segments: list[_Segment] = []
        numbers: dict[tuple[str, str, int], Numbers] = {}
        unreadable = []
        for index, file in enumerate(self.files):
            try:
                self._scan(index, numbers)
            except NoHeaderError as error:
                if len(self.files) == 1:
                    raise
                unreadable.append(str(error))
                continue
            encodings = {channel.message_encoding for channel in file.channels.values()}
            if encodings and "cdr" not in encodings:
                raise BagError(f"{file.stored.name}: holds no ROS 2 messages (cdr), but {', '.join(sorted(encodings))}")
            for channel in file.channels.values():
                if channel.message_encoding == "cdr":
                    numbers.setdefault((channel.topic, file.type_of(channel), channel.id), Numbers())
                else:
                    self.foreign[channel.topic, file.type_of(channel)] = channel.message_encoding
        self.topics = topics_of(numbers)
        zero = self.start or 0
        self.warnings = [*(text for file in self.files for text in file.warnings(zero)), *unreadable]
        self.segments.sort(key=lambda segment: segment.start)

    def _scan(self, index: int, numbers: dict[tuple[str, str, int], Numbers]) -> None:
        """Finds the segments of a file, and what is wrong with it; counts its messages by topic, type and channel."""
        file = self.files[index]
        size = file.stored.path.stat().st_size
        if size == 0:
            raise NoHeaderError(f"{file.stored.name}: is empty")
        with file.stored.path.open("rb") as stream:
            offset = read_header(stream, file.stored.name)
            file.summed = has_checksums(stream, offset, size)
            stream.seek(offset)
            while True:
                try:
                    opcode, length = read_head(stream, size - offset)
                    after = offset + RECORD.size + length
                    if opcode == Opcode.DATA_END:
                        break
                    self._take(index, stream, opcode, _Segment(index, offset, after - offset, False), numbers)
                except Damaged as damage:
                    if not file.summary.chunks:
                        file.damage = f"cut off at byte {offset} of {size} ({damage})"
                        return
                    later = file.skip(offset, str(damage), size)
                    if later is None:
                        return
                    after = later
                offset = stream.seek(after)
            checksum = int.from_bytes(stream.read(min(length, 4)), "little")
            stream.seek(size - len(MCAP_MAGIC))
            if stream.read() != MCAP_MAGIC:
                file.damage = "cut off in its index; all messages are there"
            elif not file.gaps and not data_is_whole(stream, offset, checksum):
                file.damage = "the checksum of its data is wrong: some bytes of what was read are not what was written"

    def _take(
        self,
        index: int,
        stream: BinaryIO,
        opcode: int,
        place: _Segment,
        numbers: dict[tuple[str, str, int], Numbers],
    ) -> None:
        """What one record says, at the place of the stream. Raises Damaged where reading cannot go on behind it."""
        file = self.files[index]
        length = place.size - RECORD.size
        if opcode == Opcode.METADATA:
            self._learn_origin(index, stream, place)
        elif opcode == Opcode.MESSAGE_INDEX and file.gaps:
            self._count_missing(file.gaps[-1], stream, place)
        elif opcode == Opcode.MESSAGE and not all(gap.empty for gap in file.gaps):
            raise Damaged("a message outside of the chunks")  # behind a damaged chunk that is rather a piece of it
        elif opcode in (Opcode.CHUNK, Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE):
            place.chunked = opcode == Opcode.CHUNK
            try:
                messages = self._read(stream, place)
                topics = {number: file.topic(number) for number in {message[0] for message in messages}}
            except Damaged as damage:
                if not place.chunked:
                    raise
                stream.seek(place.offset + RECORD.size)
                times = chunk_times(stream.read(min(length, 16)))
                file.gaps.append(_Gap(place.offset, place.offset + place.size, str(damage), times))
                return
            counted = {
                number: numbers.setdefault((*topic, number), Numbers())
                for number, topic in topics.items()
                if topic is not None
            }
            for number, sequence, log_time, _, data in messages:
                if number not in counted:
                    continue
                try:
                    plain_message(data)
                except PackingError as error:
                    file.unpackable.append(f"{error} on topic {file.channels[number].topic}")
                    continue
                counted[number].take(sequence)
                place.start, place.end = min(place.start, log_time), max(place.end, log_time)
            if place.start <= place.end:
                self._add(place)
                self.spans(place.start, place.end)

    def _count_missing(self, gap: _Gap, stream: BinaryIO, place: _Segment) -> None:
        """Counts what a record lists of the messages in the chunk before it, if that is the damaged one."""
        if gap.end == place.offset:
            head = stream.read(min(place.size - RECORD.size, _INDEX_HEAD))
            listed = int.from_bytes(head[2:], "little")
            if listed == place.size - RECORD.size - _INDEX_HEAD:
                gap.count += listed // _INDEX_ENTRY
                gap.end += place.size

    def _learn_origin(self, index: int, stream: BinaryIO, place: _Segment) -> None:
        """Words on the bag's making, if the metadata record at the stream's place has some; of each the first counts.

        Which part of a bag a file is matters only where those before it are not read too.
        """
        try:
            record = Metadata.read(ReadDataStream(BytesIO(stream.read(place.size - RECORD.size))))
        except BROKEN:
            end = place.offset + place.size
            self.files[index].gaps.append(_Gap(place.offset, end, "broken metadata", empty=True))
            return
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
            data = chunk_records(data[RECORD.size :], file.summed)
        messages = []
        offset = 0
        try:
            while offset < len(data):
                opcode, length = RECORD.unpack_from(data, offset)
                start, offset = offset + RECORD.size, offset + RECORD.size + length
                if offset > len(data):
                    raise Damaged("a record longer than its chunk")
                if opcode == Opcode.MESSAGE:
                    if length < MESSAGE.size:
                        raise Damaged("a message without a head")
                    messages.append((*MESSAGE.unpack_from(data, start), data[start + MESSAGE.size : offset]))
                elif opcode == Opcode.SCHEMA:
                    schema = Schema.read(ReadDataStream(BytesIO(data[start:offset])))
                    file.schemas[schema.id] = schema
                elif opcode == Opcode.CHANNEL:
                    channel = Channel.read(ReadDataStream(BytesIO(data[start:offset])))
                    file.channels[channel.id] = channel
        except (*BROKEN, struct.error):
            raise Damaged("a broken record") from None
        return messages

    def messages(self) -> Iterator[Message]:
        pending: list[tuple[int, int, int, int, Message]] = []
        streams = [file.stored.path.open("rb") for file in self.files]
        try:
            for segment in self.segments:
                while pending and pending[0][0] < segment.start:
                    yield heapq.heappop(pending)[-1]
                file = self.files[segment.file]
                read = self._read(streams[segment.file], segment)
                topics = {number: file.topic(number) for number in {message[0] for message in read}}
                for i, (number, sequence, logged, published, data) in enumerate(read):
                    known = topics[number]
                    if known is None:
                        continue
                    try:
                        plain = plain_message(data)
                    except PackingError:
                        continue
                    message = Message(*known, logged, published, plain, sequence)
                    heapq.heappush(pending, (logged, segment.file, segment.offset, i, message))
            while pending:
                yield heapq.heappop(pending)[-1]
        except (OSError, Damaged) as error:
            raise BagError(f"{self.files[0].stored.name.parent}: changed while it was read: {error}") from None
        finally:
            for stream in streams:
                stream.close()
