"""Records messages as they pass: a bounded queue, and a thread that writes the bag.

Nobody who hands over a message ever waits for the disk. When the queue is full, whole messages are dropped
and counted; each message gets its sequence number on arrival, so that a loss shows as a gap in the bag.

Log times count on the steady clock from the wall clock's time at the start: when that jumps, the order and the
distances of messages stay true.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from ..bags import BagWriter, Qos
from ..errors import BagError

WAKE_PERIOD = 0.002
"""Rest of the writer thread between two looks at the queue [s]: so it holds the interpreter for few messages."""
FLUSH_PERIOD = 0.4
"""Longest time that a message taken from the queue stays in memory [s]."""


class Topic(NamedTuple):
    """One topic to record."""

    name: str
    type: str
    qos: Qos


class _Record(NamedTuple):
    topic: str
    data: bytes
    log_time: int
    sequence: int


class Recorder:
    """A bag being written by a thread of its own.

    path     : folder of the bag; BagError if it exists or cannot be made
    topics   : announced in this order
    capacity : messages that may wait
    writer   : makes the BagWriter
    failed   : is told why, from the recorder's thread, when the disk ends the recording
    """

    def __init__(
        self,
        path: str | Path,
        topics: Sequence[Topic],
        capacity: int,
        writer: Callable[[str | Path], BagWriter] = BagWriter,
        failed: Callable[[str], object] = lambda _: None,
    ) -> None:
        self.written = 0
        self.dropped = 0
        self.error: str | None = None
        self._capacity, self._failed = capacity, failed
        self._zero = time.time_ns() - time.monotonic_ns()
        self._sequences = {topic.name: 0 for topic in topics}
        self._queue: deque[_Record] = deque()
        self._lock = threading.Lock()
        self._closing = threading.Event()
        self._bag = writer(path)
        try:
            for topic in topics:
                self._bag.add_topic(topic.name, topic.type, qos=topic.qos)
        except BagError:
            self._bag.abort()
            raise
        self.path = self._bag.path
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        self._thread.start()

    @property
    def active(self) -> bool:
        """Whether messages are still taken."""
        return self.error is None and not self._closing.is_set()

    def put(self, topic: str, data: bytes, received: int) -> bool:
        """Hands over one message of CDR bytes received at a steady time [ns]; False if it was dropped."""
        with self._lock:
            sequence = self._sequences[topic] = self._sequences[topic] + 1
            if not self.active or len(self._queue) >= self._capacity:
                self.dropped += self.active
                return False
            self._queue.append(_Record(topic, data, self._zero + received, sequence))
            return True

    def close(self, timeout: float = 5.0) -> None:
        """Writes what waits and finishes the bag; `error` says why when that failed."""
        with self._lock:
            self._closing.set()
        self._thread.join(timeout)
        if self._thread.is_alive() and self.error is None:
            self.error = f"{self.path}: the disk did not take the rest within {timeout:g} s"

    def summary(self) -> str:
        """One line: the bag, what it holds, and what went wrong."""
        text = f"{self.path}: {self.written} messages, {self.dropped} dropped"
        return f"{text}; {self.error}" if self.error else text

    def _run(self) -> None:
        try:
            flushed = time.monotonic()
            while not self._closing.is_set():
                self._closing.wait(WAKE_PERIOD)
                self._drain()
                if time.monotonic() - flushed >= FLUSH_PERIOD:
                    self._bag.flush()
                    flushed = time.monotonic()
            self._drain()
            self._bag.close()
        except Exception as error:
            self.error = str(error) if isinstance(error, BagError) else f"{self.path}: {error!r}"
            self._queue.clear()
            self._bag.abort()
            self._failed(f"recording stopped: {self.error}")

    def _drain(self) -> None:
        """Writes what waits at this moment."""
        for _ in range(len(self._queue)):
            record = self._queue.popleft()
            self._bag.write(record.topic, record.data, record.log_time, sequence=record.sequence)
            self.written += 1
