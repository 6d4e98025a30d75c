"""Memory that two processes share: one puts messages into it, the other takes them out, and neither waits.

Two may put at the same time, each into a ring of its own: a loop in compiled code (`recording.put`), and all other
threads, one at a time (`Ring.put`). Both leave the same bytes: a head, then the message.

The memory begins with a page of words of 64 bits. A word is written by one side only, and tells what that side has
done; `atomics` sees to it that the other side finds done what the word tells.
"""

from __future__ import annotations

import heapq
import mmap
import os
import struct
import sys
from collections.abc import Iterator, Sequence
from operator import attrgetter
from typing import NamedTuple

from ..physics.atomics import fence, load_acquire, store_release

LOOP, OTHERS = range(2)
"""The rings, by who puts."""
SIZES = (1 << 23, 1 << 24)
"""Of the records that may lie in each [byte].

loop   : wrench twice, pose and command in each step, 110 bytes each, and /tf, 300 bytes at 100 Hz: 0.5 MB/s at 1 kHz,
         1.8 MB/s at 4 kHz. It holds 18 s or 4.7 s of that, 75,000 messages.
others : mesh_points, 40 bytes a node at 60 Hz: 2.4 MB/s for 1,000 nodes, 7.2 MB/s for 3,000. It holds 7 s or 2.3 s of
         that; diagnostics, changes and /rosout are some kB/s.
"""

HEAD = struct.Struct("<IHIQ")
"""Before the bytes of a message: how many these are, number of its topic, its sequence there, log time [ns]."""
PUT, ACCEPTED, TAKEN, DONE = 0, 1, 8, 9
"""Words of a ring: bytes put and messages accepted, by who puts; bytes taken and messages done with, by who takes.

Apart by a cache line: none waits for one that the other side writes to."""
OF_RING = 16
"""Words from those of one ring to those of the next."""
_SAVED, _SIZE = 32, 40
_PAGE = mmap.PAGESIZE


class Record(NamedTuple):
    """One message: number of its topic, its sequence there, its log time [ns], CDR bytes."""

    topic: int
    sequence: int
    log_time: int
    data: bytes


class Ring:
    """One of the rings of a Memory; each end is for one thread at a time.

    words    : of the Memory
    data     : the bytes of this ring
    number   : LOOP or OTHERS
    capacity : messages that may wait in both rings together; whoever puts sets it
    """

    def __init__(self, words: memoryview[int], data: memoryview[int], number: int) -> None:
        self.data = data
        self.capacity = sys.maxsize
        self._words, self._size = words, len(data)
        own, other = number * OF_RING, (1 - number) * OF_RING
        self._put, self._accepted, self._taken, self._done = own + PUT, own + ACCEPTED, own + TAKEN, own + DONE
        self._others_accepted, self._others_done = other + ACCEPTED, other + DONE

    @property
    def done(self) -> int:
        """Messages that the other end has done with since it began anew."""
        return self._words[self._done]

    def put(self, topic: int, sequence: int, log_time: int, data: bytes) -> bool:
        """Puts a message where there is room for it; False if there is none, or if too many wait."""
        entry = HEAD.pack(len(data), topic, sequence & 0xFFFFFFFF, log_time) + data
        words, size = self._words, len(entry)
        put, accepted = words[self._put], words[self._accepted]
        room, done = self._size - (put - words[self._taken]), words[self._done] + words[self._others_done]
        if size > room or accepted + words[self._others_accepted] - done >= self.capacity:
            return False
        begin = put % self._size
        end = begin + size
        if end <= self._size:
            self.data[begin:end] = entry
        else:
            self.data[begin:] = entry[: self._size - begin]
            self.data[: end - self._size] = entry[self._size - begin :]
        words[self._accepted] = accepted + 1
        fence()  # the bytes are there before it is told; of two who take the last place one at least sees the other
        if accepted + 1 + words[self._others_accepted] - done > self.capacity:
            words[self._accepted] = accepted
            return False
        words[self._put] = put + size
        return True

    def take(self, end: int | None = None) -> Iterator[Record]:
        """Takes what is there, up to `end` [bytes put]; a message is done with when the next one is asked for."""
        words, at = self._words, self._words[self._taken]
        if end is None:
            end = load_acquire(words, self._put)
        while at < end:
            size, topic, sequence, log_time = HEAD.unpack(self._bytes(at, HEAD.size))
            yield Record(topic, sequence, log_time, self._bytes(at + HEAD.size, size))
            at += HEAD.size + size
            store_release(words, self._taken, at)
            words[self._done] += 1

    def _bytes(self, at: int, size: int) -> bytes:
        begin = at % self._size
        part = bytes(self.data[begin : begin + size])
        return part if len(part) == size else part + bytes(self.data[: size - len(part)])


class Memory:
    """The memory in the file with descriptor `file`, which `make_file` made. Raises OSError.

    words : (words of 64 bits) its first page
    rings : LOOP and OTHERS
    """

    def __init__(self, file: int) -> None:
        whole = memoryview(mmap.mmap(file, 0, mmap.MAP_SHARED | mmap.MAP_POPULATE))
        self.words = whole[:_PAGE].cast("q")
        middle = _PAGE + self.words[_SIZE]
        self.rings = (
            Ring(self.words, whole[_PAGE:middle], LOOP),
            Ring(self.words, whole[middle : middle + self.words[_SIZE + 1]], OTHERS),
        )
        self._due = self._ends()

    @property
    def saved(self) -> int:
        """Messages of which the end that takes says that they are where they last."""
        return self.words[_SAVED]

    @saved.setter
    def saved(self, count: int) -> None:
        self.words[_SAVED] = count

    def take(self, whole: bool = False) -> Iterator[Record]:
        """Takes what was there at the last call, in the order of log times; `whole`: what is there now.

        Of the two rings' next messages the one with the smaller log time comes first, the loop's if they are equal.
        No ring's own order changes. What was put since the last call comes only where it belongs between the others:
        so a message waits for one call, and comes after all of the other ring that had until then to be of an earlier
        time.
        """
        ends = self._ends()
        due, self._due = ends if whole else self._due, ends
        words = self.words
        waiting = (ring.take(end) for ring, end in zip(self.rings, ends, strict=True))
        for record in heapq.merge(*waiting, key=attrgetter("log_time")):
            if words[TAKEN] >= due[LOOP] and words[OF_RING + TAKEN] >= due[OTHERS]:
                return
            yield record

    def begin_anew(self) -> None:
        """Forgets what is there and counts from 0; for the end that takes, while the other puts nothing."""
        words = self.words
        self._due = self._ends()
        for first, end in zip((0, OF_RING), self._due, strict=True):
            words[first + TAKEN] = end
            words[first + ACCEPTED] = words[first + DONE] = 0
        words[_SAVED] = 0

    def _ends(self) -> tuple[int, int]:
        """Bytes put into each ring."""
        return load_acquire(self.words, PUT), load_acquire(self.words, OF_RING + PUT)


def make_file(sizes: Sequence[int] = SIZES) -> int:
    """A file in memory for a Memory with rings of these sizes, without a name; the descriptor is to be closed.

    The system makes all of it now, not when a message is first put there. Raises OSError.
    """
    file = os.memfd_create("finger_sim")
    try:
        os.write(file, bytes(_PAGE + sum(sizes)))
        os.pwrite(file, struct.pack("=2q", *sizes), 8 * _SIZE)
    except OSError:
        os.close(file)
        raise
    return file
