"""Records messages as they pass: they are handed to a process of its own that writes the bag.

Nobody who hands over a message ever waits for the disk, and the disk's work does not hold this process's
interpreter. When too many messages wait, whole ones are dropped and counted; each message gets its sequence
number on arrival, so that a loss shows as a gap in the bag. The bag is finished even where this process is killed.

Log times count on the steady clock from the wall clock's time at the start: when that jumps, the order and the
distances of messages stay true.
"""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import astuple
from pathlib import Path
from typing import Any, NamedTuple

from .. import cdr
from ..bag_process import CLOSE, OPEN, Order
from ..bags import Qos
from ..errors import BagError
from .bag_pipe import BagPipe

HAND_OVER_PERIOD = 0.02
"""Messages are handed over with the first one that comes so long after those before [s]."""
OPEN_TIMEOUT = 5.0
"""How long the making of a bag is waited for [s]."""


class Topic(NamedTuple):
    """One topic to record."""

    name: str
    type: str
    qos: Qos


class Recorder:
    """A bag being written by another process.

    path     : folder of the bag; BagError if it exists or cannot be made
    topics   : announced in this order
    capacity : messages that may wait to be written
    pipe     : the process; lent to this recorder until it is closed
    options  : of the BagWriter
    failed   : is told why, by whoever hands over or closes, when something ends the recording
    """

    def __init__(
        self,
        path: str | Path,
        topics: Sequence[Topic],
        capacity: int,
        pipe: BagPipe,
        options: Mapping[str, Any] | None = None,
        failed: Callable[[str], object] = lambda _: None,
    ) -> None:
        self.path = Path(path).absolute()
        self.written = 0
        self.dropped = 0
        self.error: str | None = None
        self._capacity, self._pipe, self._failed = capacity, pipe, failed
        self._zero = time.time_ns() - time.monotonic_ns()
        self._numbers = {topic.name: number for number, topic in enumerate(topics)}
        self._sequences = {topic.name: 0 for topic in topics}
        self._accepted = self._fresh = 0
        self._due = 0.0
        self._lock = threading.Lock()
        self._opened = self._closing = self._closed = False
        self._untold: str | None = None
        order: Order = {
            "path": str(self.path),
            "topics": [
                {"name": name, "type": type, "definition": cdr.definition(type), "qos": astuple(qos)}
                for name, type, qos in topics
            ],
            "options": dict(options or {}),
        }
        pipe.add(OPEN, json.dumps(order).encode())
        self._exchange_until(lambda: self._opened, OPEN_TIMEOUT)
        if self.error is not None:
            raise BagError(self.error)

    @property
    def active(self) -> bool:
        """Whether messages are still taken."""
        return self.error is None and not self._closing

    def put(self, topic: str, data: bytes, received: int) -> bool:
        """Hands over one message of CDR bytes received at a steady time [ns]; False if it was dropped."""
        with self._lock:
            sequence = self._sequences[topic] = self._sequences[topic] + 1
            if not self.active:
                return False
            if self._full:
                self._exchange()
            taken = not self._full
            if taken:
                self._pipe.add(self._numbers[topic], data, sequence, self._zero + received)
                self._accepted += 1
                self._fresh += 1
            else:
                self.dropped += 1
            if time.monotonic() >= self._due or 4 * self._fresh >= self._capacity:
                self._exchange()
        self._tell()
        return taken

    def close(self, timeout: float = 5.0) -> None:
        """Writes what waits and finishes the bag; `error` says why when that failed."""
        with self._lock:
            if not self.active:
                return
            self._closing = True
            self._pipe.add(CLOSE, b"")
        self._exchange_until(lambda: self._closed, timeout)
        self._tell()

    def summary(self) -> str:
        """One line: the bag, what it holds, and what went wrong."""
        text = f"{self.path}: {self.written} messages, {self.dropped} dropped"
        return f"{text}; {self.error}" if self.error else text

    @property
    def _full(self) -> bool:
        return self._accepted - self.written >= self._capacity

    def _exchange(self) -> None:
        """Hands over what waits and takes the answers."""
        if self.error is not None:
            return
        self._fresh = 0
        self._due = time.monotonic() + HAND_OVER_PERIOD
        try:
            for answer in self._pipe.exchange():
                self.written = answer.get("written", self.written)
                self._opened |= "opened" in answer
                self._closed |= "closed" in answer
                self.error = answer.get("error")
        except BrokenPipeError:
            self._pipe.let_go()
            ending = f"the process that writes it ended{self._pipe.ending()}"
            self.error = f"{self.path}: {ending}; what was recorded before stays readable"
        self._untold = self.error

    def _exchange_until(self, done: Callable[[], bool], timeout: float) -> None:
        end = time.monotonic() + timeout
        self._exchange()
        while not done() and self.error is None:
            if time.monotonic() >= end:
                self._pipe.let_go()
                self.error = self._untold = f"{self.path}: the disk did not take the rest within {timeout:g} s"
            else:
                self._pipe.wait(end - time.monotonic())
                self._exchange()

    def _tell(self) -> None:
        """Says once why the recording ended."""
        reason, self._untold = self._untold, None
        if reason is not None:
            self._failed(f"recording stopped: {reason}")
