"""Records messages as they pass: they are put into memory from which a process of its own writes the bag.

Nobody who hands over a message ever waits for the disk or calls the system, and the work of writing does not hold
this process's interpreter. When too many messages wait, whole ones are dropped and counted; each message gets its
sequence number on arrival, so that a loss shows as a gap in the bag. Where this process is killed, the bag is
finished all the same.

A loop in compiled code hands over its messages by itself (`bags.recording`), all others by `Recorder.put`. On one topic
only one of the two may put messages at a time; they share its sequence numbers.

Log times count on the steady clock from the wall clock's time at the start: when that jumps, the order and the
distances of messages stay true.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import astuple
from pathlib import Path
from typing import Any, NamedTuple

from ..bags import cdr, recording
from ..bags.process import Order
from ..bags.reader import Qos
from ..bags.ring import OTHERS
from ..errors import BagError
from .bag_pipe import BagPipe

TIMEOUT = 5.0
"""How long the disk may take to begin a bag, and to finish it [s]."""
PUT_TIMEOUT = 1.0
"""How long the loop may be in the middle of a message when a recording ends [s]."""


class RecordedTopic(NamedTuple):
    """One topic to record."""

    name: str
    type: str
    qos: Qos


class Recorder:
    """A bag being written by another process.

    `put` may be called by any thread, all else by one at a time.

    began    : steady time from which messages are taken [ns]
    loop     : where a loop in compiled code puts its messages; of use as long as it likes
    path     : folder of the bag; BagError if it exists or cannot be made
    topics   : announced in this order
    capacity : messages that may wait to be written
    pipe     : the process; lent to this recorder until it is closed
    options  : of the BagWriter
    failed   : is told why, by whoever checks or closes, when something ended the recording
    """

    def __init__(
        self,
        path: str | Path,
        topics: Sequence[RecordedTopic],
        capacity: int,
        pipe: BagPipe,
        options: Mapping[str, Any] | None = None,
        failed: Callable[[str], object] = lambda _: None,
    ) -> None:
        self.path = Path(path).absolute()
        self.error: str | None = None
        self._pipe, self._memory, self._ring = pipe, pipe.memory, pipe.memory.rings[OTHERS]
        self._ring.capacity = capacity
        self._failed: Callable[[str], object] = lambda _: None  # who makes a recorder gets an exception
        self._zero = time.time_ns() - time.monotonic_ns()
        self._numbers = {topic.name: number for number, topic in enumerate(topics)}
        self.loop = recording.build_recording(pipe.memory, len(topics), capacity, self._zero)
        self._sequences = self.loop.sequence.data
        self._lock = threading.Lock()
        self._dropped = 0
        self._written: int | None = None
        self._closing = False
        order: Order = {
            "path": str(self.path),
            "topics": [
                {"name": name, "type": type, "definition": cdr.definition(type), "qos": astuple(qos)}
                for name, type, qos in topics
            ],
            "options": dict(options or {}),
        }
        pipe.order(order, TIMEOUT)
        self._await("opened", TIMEOUT)
        if self.error is not None:
            raise BagError(self.error)
        self._failed = failed
        self.began = time.monotonic_ns()
        recording.begin(self.loop, self.began)

    @property
    def active(self) -> bool:
        """Whether messages are still taken."""
        return self.error is None and not self._closing

    @property
    def dropped(self) -> int:
        """Messages that found no room."""
        return self._dropped + int(self.loop.control[recording.DROPPED])

    @property
    def written(self) -> int:
        """Messages that have reached the bag's file; where its process was killed, or hangs, it may hold more."""
        return self._memory.saved if self._written is None else self._written

    def put(self, topic: str, data: bytes, received: int) -> bool:
        """Hands over one message of CDR bytes received at a steady time [ns]; False if it was dropped."""
        with self._lock:
            if self._closing or self.error is not None:
                return False
            number = self._numbers[topic]
            sequence = self._sequences[number] = self._sequences[number] + 1
            if self._ring.put(number, sequence, self._zero + received, data):
                return True
            self._dropped += 1
            return False

    def number(self, topic: str) -> int:
        """The number of a topic for the loop."""
        return self._numbers[topic]

    def check(self) -> None:
        """Looks whether the recording has ended by itself; to be called now and then."""
        if self.active:
            self._hear()

    def close(self, timeout: float = TIMEOUT, origin: Mapping[str, str] | None = None) -> None:
        """Writes what waits and finishes the bag; `error` says why when that failed.

        origin : what is known only now of what made it (`bags.origin`)
        """
        if not self.active:
            return
        with self._lock:
            self._closing = True
        if recording.end(self.loop, PUT_TIMEOUT):
            self._pipe.order({"origin": dict(origin or {})}, timeout)
            self._await("closed", timeout)
        else:
            self._end(f"{self.path}: the loop did not come to the end of a message within {PUT_TIMEOUT:g} s")

    def summary(self) -> str:
        """One line: the bag, what it holds, and what went wrong."""
        text = f"{self.path}: {self.written} messages, {self.dropped} dropped"
        return f"{text}; {self.error}" if self.error else text

    def _await(self, answer: str, timeout: float) -> None:
        """Waits for an answer, or for the end of the recording."""
        end = time.monotonic() + timeout
        while self.error is None and answer not in self._hear(max(0.0, end - time.monotonic())):
            if time.monotonic() >= end:
                self._pipe.let_go()
                self._end(f"{self.path}: the disk did not take the rest within {timeout:g} s")
        if answer == "closed" and self.error is None:
            self._end(None)

    def _hear(self, timeout: float = 0.0) -> set[str]:
        """Takes the answers that come."""
        try:
            answers = {key: value for answer in self._pipe.answers(timeout) for key, value in answer.items()}
        except BrokenPipeError:
            ending = f"the process that writes it ended{self._pipe.ending()}"
            self._pipe.let_go()
            self._end(f"{self.path}: {ending}; what was recorded before stays readable")
            return set()
        if "error" in answers:
            self._end(answers["error"])
        return set(answers)

    def _end(self, error: str | None) -> None:
        """From now on the process is another's, or nobody's where the loop may still put a message into its memory."""
        if not recording.end(self.loop, PUT_TIMEOUT):
            self._pipe.let_go()
        with self._lock:
            self._written = self._memory.saved
            self.error = error
        if error is not None:
            self._failed(f"recording stopped: {error}")
