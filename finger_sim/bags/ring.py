"""Memory that two processes share: one puts records into it, the other takes them out, and neither waits."""

from __future__ import annotations

import mmap
import os
import struct
import threading
from collections.abc import Iterator
from typing import NamedTuple

SIZE = 1 << 24
"""Of the records that may lie in it [byte]: nine seconds of a node at 1 kHz with mesh_points at 60 Hz."""

_HEAD = struct.Struct("<IHIQ")
_PAGE = mmap.PAGESIZE
_PUT, _TAKEN, _DONE, _SAVED = range(4)  # words of the first page: bytes put, bytes taken, records done, records saved


class Record(NamedTuple):
    """One message: number of its topic, its sequence there, its log time [ns], CDR bytes."""

    topic: int
    sequence: int
    log_time: int
    data: bytes


class Ring:
    """One end of the memory in the file with descriptor `file`, which `make_file` made."""

    def __init__(self, file: int) -> None:
        self._memory = mmap.mmap(file, _PAGE + SIZE)
        self._words = memoryview(self._memory)[:_PAGE].cast("Q")
        self._records = memoryview(self._memory)[_PAGE:]
        self._order = threading.Lock()
        self._put, self._free = self._words[_PUT], 0

    @property
    def done(self) -> int:
        """Records that the other end has done with since it began anew."""
        return self._words[_DONE]

    @property
    def saved(self) -> int:
        """Records of which the other end says that they are where they last."""
        return self._words[_SAVED]

    @saved.setter
    def saved(self, count: int) -> None:
        self._words[_SAVED] = count

    def put(self, topic: int, sequence: int, log_time: int, data: bytes) -> bool:
        """Puts a record where there is room for it; False if there is none."""
        entry = _HEAD.pack(len(data), topic, sequence, log_time) + data
        size, put = len(entry), self._put
        if size > self._free:
            self._free = SIZE - (put - self._words[_TAKEN])
            if size > self._free:
                return False
        begin = put % SIZE
        end = begin + size
        if end <= SIZE:
            self._records[begin:end] = entry
        else:
            self._records[begin:] = entry[: SIZE - begin]
            self._records[: end - SIZE] = entry[SIZE - begin :]
        with self._order:  # the record is there before the other process sees that it is
            self._put = put + size
            self._free -= size
        self._words[_PUT] = put + size
        return True

    def take(self) -> Iterator[Record]:
        """Takes what is there now; a record is done with when the next one is asked for."""
        put, at = self._words[_PUT], self._words[_TAKEN]
        with self._order:  # the records are read after that
            pass
        while at < put:
            size, topic, sequence, log_time = _HEAD.unpack(self._bytes(at, _HEAD.size))
            yield Record(topic, sequence, log_time, self._bytes(at + _HEAD.size, size))
            at += _HEAD.size + size
            with self._order:  # the room is free once it has been read
                pass
            self._words[_TAKEN] = at
            self._words[_DONE] += 1

    def begin_anew(self) -> None:
        """Forgets what is there and counts from 0; for the end that takes, while the other puts nothing."""
        self._words[_TAKEN] = self._words[_PUT]
        self._words[_DONE] = self._words[_SAVED] = 0

    def touch(self) -> None:
        """Has the system make all the memory now, not when a record is first put there."""
        for page in range(0, SIZE, _PAGE):
            self._records[page] = 0

    def _bytes(self, at: int, size: int) -> bytes:
        begin = at % SIZE
        part = bytes(self._records[begin : begin + size])
        return part if len(part) == size else part + bytes(self._records[: size - len(part)])


def make_file() -> int:
    """A file in memory for a Ring, without a name; the descriptor is to be closed."""
    file = os.memfd_create("finger_sim")
    os.truncate(file, _PAGE + SIZE)
    return file
