"""An end for an MCAP file that was cut off while it was written."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any, NamedTuple

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import DataEnd, Footer

from ..errors import BagError
from .mcap_files import McapSource
from .mcap_records import RECORD, Damaged, NoHeaderError, read_head, read_header
from .packing import MCAP_MAGIC, Stored

ROOM_FOR_END = 1 << 16
"""What finish_cut_off frees on a full disk [byte]: an end of the file and a metadata.yaml are a third of that."""


class Readable(NamedTuple):
    """What can be read of a file."""

    counts: Counter[str]
    """Messages, by topic."""
    first: int
    """Smallest log time [ns]; 2^64 where there is no message."""
    last: int
    """Largest one; 0 where there is none."""


def readable(path: Path) -> Readable:
    """What can be read of an MCAP file, in whatever state it is: nothing if it is not there."""
    try:
        found = McapSource([Stored(path, path, "mcap")])
    except (NoHeaderError, FileNotFoundError):
        return Readable(Counter(), 2**64, 0)
    counts = Counter({topic.name: topic.count for topic in found.topics if topic.count})
    return Readable(counts, 2**64 if found.start is None else found.start, found.end or 0)


def finish_cut_off(path: Path) -> Readable:
    """Ends a file that was cut off: with its last whole record that leaves ROOM_FOR_END of what it takes on the disk.

    The end has no index. Returns what is left. Raises OSError when the disk takes no end either, BagError when no
    message would be left: then the file stays as it is.
    """
    size = path.stat().st_size
    holds = False
    with path.open("r+b") as stream:
        whole = read_header(stream, path)
        try:
            while True:
                opcode, length = read_head(stream, size - ROOM_FOR_END - whole)
                if opcode == Opcode.DATA_END:
                    break
                whole = stream.seek(whole + RECORD.size + length)
                holds = holds or opcode in (Opcode.CHUNK, Opcode.MESSAGE)
        except Damaged:
            pass
        if not holds:
            raise BagError(f"{path}: too short for an end that a full disk takes; it can be read as it is")
        builder: Any = RecordBuilder()  # its methods carry no types
        DataEnd(data_section_crc=0).write(builder)
        Footer(summary_start=0, summary_offset_start=0, summary_crc=0).write(builder)
        stream.truncate(whole)
        stream.seek(whole)
        stream.write(builder.end() + MCAP_MAGIC)
    return readable(path)
