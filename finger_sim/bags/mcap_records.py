"""The records of an MCAP file: heads, chunks, and the summary at its end."""

from __future__ import annotations

import os
import struct
import zlib
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Channel, Header, Schema

from ..errors import BagError
from .packing import MCAP_MAGIC, Kind, PackingError, inflated

RECORD = struct.Struct("<BQ")
"""Head of a record: opcode, and length of what follows."""
MESSAGE = struct.Struct("<HIQQ")
"""Head of a message: channel, sequence, log time and publish time."""
_CHUNK = struct.Struct("<QQQII")
_FOOTER = struct.Struct("<BQQQI")
_COMPRESSIONS: dict[bytes, Kind] = {b"zstd": "zstd", b"lz4": "lz4"}

BROKEN = (McapError, struct.error, UnicodeDecodeError, OverflowError, MemoryError, RuntimeError)
"""What the mcap library raises on bytes that are not what they claim to be."""


class NoHeaderError(BagError):
    """A file that was cut off before anything was in it: of several files, the others can be read."""


class Damaged(Exception):
    """Bytes that are not whole MCAP records."""


class ChunkAt(NamedTuple):
    """A chunk in a file's index: its place [byte] and its log times [ns]."""

    offset: int
    start: int
    end: int


@dataclass
class Summary:
    """What stands at the end of a file."""

    schemas: dict[int, Schema]
    channels: dict[int, Channel]
    chunks: list[ChunkAt]
    """In the order of their places."""


def read_header(stream: BinaryIO, name: Path) -> int:
    """Checks magic and profile of an MCAP file; returns the offset after its header."""
    magic = stream.read(len(MCAP_MAGIC))
    if magic != MCAP_MAGIC:
        if MCAP_MAGIC.startswith(magic):
            raise NoHeaderError(f"{name}: cut off before its header, nothing can be read")
        raise BagError(f"{name}: not an MCAP file: starts with {magic!r}, must start with {MCAP_MAGIC!r}")
    try:
        opcode, length = read_head(stream, os.fstat(stream.fileno()).st_size - len(MCAP_MAGIC))
        if opcode != Opcode.HEADER:
            raise BagError(f"{name}: not an MCAP file: its first record is no header")
        header = Header.read(ReadDataStream(BytesIO(stream.read(length))))
    except (Damaged, *BROKEN):
        raise NoHeaderError(f"{name}: cut off before its header, nothing can be read") from None
    if header.profile not in ("ros2", ""):
        raise BagError(f"{name}: holds messages of profile {header.profile!r}, allowed: 'ros2'")
    return len(MCAP_MAGIC) + RECORD.size + length


def read_head(stream: BinaryIO, left: int) -> tuple[int, int]:
    """Opcode and length of the record at the stream's place, of which `left` bytes are in the file."""
    head = stream.read(RECORD.size)
    if len(head) < RECORD.size:
        raise Damaged("no end of data" if not head else "a partial record")
    opcode, length = RECORD.unpack(head)
    if opcode == 0:
        raise Damaged("zeros")
    if length > left - RECORD.size:
        raise Damaged("a partial chunk" if opcode == Opcode.CHUNK else "a partial record")
    return opcode, length


def chunk_times(body: bytes) -> tuple[int, int] | None:
    """The log times [ns] that a chunk record's head tells; None where they cannot be."""
    start, end = struct.unpack_from("<QQ", body.ljust(16, b"\0"))
    return (start, end) if 0 < start <= end else None


def has_checksums(stream: BinaryIO, offset: int, size: int) -> bool:
    """Whether any chunk from that offset on has a checksum: one without is not what was written then."""
    try:
        while True:
            stream.seek(offset)
            opcode, length = read_head(stream, size - offset)
            if opcode == Opcode.DATA_END:
                return False
            if opcode == Opcode.CHUNK and _checksum(stream.read(min(length, _CHUNK.size))):
                return True
            offset += RECORD.size + length
    except Damaged:
        return False


def _checksum(head: bytes) -> int:
    return int.from_bytes(head[24:28], "little")


def chunk_records(body: bytes, summed: bool) -> bytes:
    """The records in a chunk record, unpacked. Raises Damaged where they are not what was written.

    summed : whether chunks of the file have checksums
    """
    try:
        _, _, size, checksum, letters = _CHUNK.unpack_from(body)
        name = body[_CHUNK.size : _CHUNK.size + letters]
        begin = _CHUNK.size + letters + 8
        (length,) = struct.unpack_from("<Q", body, begin - 8)
    except struct.error:
        raise Damaged("a broken chunk: no head") from None
    data = body[begin:]
    if length != len(data):
        raise Damaged("a broken chunk: its lengths do not fit")
    if name:
        if name not in _COMPRESSIONS:
            raise Damaged(f"a chunk compressed as {name.decode(errors='replace')!r}, allowed: zstd, lz4")
        try:
            data = inflated(data, _COMPRESSIONS[name], size)
        except PackingError as error:
            raise Damaged(f"a broken chunk: {error}") from None
    if len(data) != size:
        raise Damaged("a broken chunk: its size does not fit")
    if (checksum or summed) and zlib.crc32(data) != checksum:
        raise Damaged("a chunk with a wrong checksum")
    return data


def data_is_whole(stream: BinaryIO, end: int, checksum: int) -> bool:
    """Whether the bytes of a file up to its DataEnd record have the checksum that stands there; 0 stands for none."""
    found, left = 0, end
    stream.seek(0)
    while checksum and left and (block := stream.read(min(left, 1 << 20))):
        found, left = zlib.crc32(block, found), left - len(block)
    return found == checksum


def read_summary(stream: BinaryIO) -> Summary:
    """What stands at the end of a file; empty where nothing whole does."""
    nothing = Summary({}, {}, [])
    try:
        size = stream.seek(0, os.SEEK_END)
        stream.seek(max(0, size - _FOOTER.size - len(MCAP_MAGIC)))
        opcode, _, start, _, checksum = _FOOTER.unpack(stream.read(_FOOTER.size))
        end = size - len(MCAP_MAGIC) - 4
        if opcode != Opcode.FOOTER or not 0 < start < end:
            return nothing
        stream.seek(start)
        if checksum and zlib.crc32(stream.read(end - start)) != checksum:
            return nothing
        stream.seek(0)
        found = SeekingReader(stream, record_size_limit=size).get_summary()
    except (*BROKEN, ValueError):
        return nothing
    if found is None:
        return nothing
    chunks = [ChunkAt(c.chunk_start_offset, c.message_start_time, c.message_end_time) for c in found.chunk_indexes]
    return Summary(dict(found.schemas), dict(found.channels), sorted(chunks))
