"""An end for an MCAP file that was cut off while it was written."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import DataEnd, Footer

from .mcap_files import McapSource
from .mcap_records import RECORD, Damaged, read_head, read_header
from .packing import MCAP_MAGIC, Stored

ROOM_FOR_END = 1 << 16
"""What finish_cut_off frees on a full disk [byte]: an end of the file and a metadata.yaml are a third of that."""


def finish_cut_off(path: Path) -> tuple[Counter[str], int, int]:
    """Ends a file that was cut off: with its last whole record that leaves ROOM_FOR_END of what it takes on the disk.

    The end has no index. Returns the messages that are left on each topic, and the first and last of their log times
    [ns]. Raises OSError when the disk takes no end either, BagError when the file has no whole header.
    """
    size = path.stat().st_size
    with path.open("r+b") as stream:
        whole = read_header(stream, path)
        try:
            while True:
                opcode, length = read_head(stream, size - ROOM_FOR_END - whole)
                if opcode == Opcode.DATA_END:
                    break
                whole = stream.seek(whole + RECORD.size + length)
        except Damaged:
            pass
        builder: Any = RecordBuilder()  # its methods carry no types
        DataEnd(data_section_crc=0).write(builder)
        Footer(summary_start=0, summary_offset_start=0, summary_crc=0).write(builder)
        stream.truncate(whole)
        stream.seek(whole)
        stream.write(builder.end() + MCAP_MAGIC)
    left = McapSource([Stored(path, path, "mcap")])
    return Counter({topic.name: topic.count for topic in left.topics}), left.start or 2**64, left.end or 0
